"""Score a diagnosis against the sealed truth of a blind trial.

The truth is a JSON object, schema ``cdm_pin.truth/1``::

    {"schema": "cdm_pin.truth/1", "plant": "absolute", "seed": 7, "n_links": 3, "pulley_ratio": 1.0,
     "effects": [{"effect": "coulomb_friction", "location": {"kind": "joint", "index": 2},
                  "parameters": {"coulomb": 0.31}, "form": "", "in_catalogue": true,
                  "visibility": 120.0, "torque_visibility": 120.0, "kinematic_visibility": 0.0,
                  "visible_fraction": 0.8}],
     "links": [{"mass": 2.0, "center_of_mass": [0.2, 0.0, 0.0], "inertia_zz": 0.03}], "rotor_inertia": [0.0],
     "gravity": [0.0, -9.81], "scale": 10.0, "noise": {"std": [0.02], "correlation": 0.0, "drift": 0.0},
     "sensors": {"positions": "joint", "bits": 17, "jitter": 0.05}, "motion": "loop"}

Only ``n_links``, ``pulley_ratio`` (r_m/r_j; 1 if missing), ``effects`` (``effect``, ``location``, ``in_catalogue``,
``parameters``) and ``sensors.positions`` are read here. Effects and locations are named as in a diagnosis; an effect
with ``in_catalogue: false`` has no name that a diagnosis could give, and may have two joints in its location (``index``
and ``other``).

A finding meets an effect *exactly* (name and place), as a *class* (the effect stands in its ``indistinguishable_from``,
which may list three others at most, or the two are one by the identities of the paper's arm: see `same`), or not at
all. Effects inside the span of the rigid body (`in_rigid_body`) are met when ``rigid_body`` lists them, and call for no
finding. An effect without a name may be called by that of a law which on these recordings is the same: what sets it
apart is less than a matched filter sees.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from .plant.oracle import SURE

Meeting = Literal["exact", "class", "rigid_body", "missed"]
_SLIDING = ("viscous_friction", "coulomb_friction", "stribeck_friction", "asymmetric_friction", "hysteresis",
            "friction_drift", "position_dependent_friction", "torque_dependent_friction")  # fmt: skip
_AS_COULOMB = ("cable_friction", "capstan_friction")  # one pretension: the same step at reversals
_REFINED = ("stribeck_friction", "asymmetric_friction", "position_dependent_friction", "friction_drift")
_MOST_RIVALS, _ALIKE = 3, 0.95


@dataclass(frozen=True)
class ParameterScore:
    """One estimated parameter against its true value: `z` is the error in stated standard errors."""

    effect: str
    name: str
    true: float
    value: float
    std: float

    @property
    def z(self) -> float:
        """Error in stated standard errors."""
        return (self.value - self.true) / self.std if self.std > 0 else math.inf

    @property
    def inside(self) -> bool:
        """Whether the true value lies in the stated 95 % interval."""
        return abs(self.z) <= 1.96


@dataclass(frozen=True)
class Score:
    """What a diagnosis got right.

    Parameters
    ----------
    meetings : tuple of str
        Per true effect: "exact", "class", "rigid_body" or "missed".
    first_right : bool
        The strongest finding meets a true effect; without findings to expect: there is none, and what is in the rigid
        body is listed there.
    false_findings : tuple of str
        Findings that meet no true effect, as "name at place".
    verdict_right : bool
        The verdict is the one this truth calls for.
    unexplained_right : bool or None
        For effects of no catalogue: `unexplained` was said, at the right joint, or a law named that on these recordings
        is the same; None if there are none.
    parameters : tuple of ParameterScore
        The parameters of exactly met effects.
    holdout_over_floor : float or None
        Torque error of the completed model over the noise floor on the unseen recording.
    """

    meetings: tuple[Meeting, ...]
    first_right: bool
    false_findings: tuple[str, ...]
    verdict_right: bool
    unexplained_right: bool | None
    parameters: tuple[ParameterScore, ...]
    holdout_over_floor: float | None

    @property
    def all_right(self) -> bool:
        """Every effect met, nothing false beside them, the right verdict."""
        named = all(meeting != "missed" for meeting in self.meetings)
        return named and not self.false_findings and self.verdict_right and self.unexplained_right is not False

    def as_dict(self) -> dict[str, Any]:
        """Give the score as a JSON-able dictionary."""
        return {
            "meetings": list(self.meetings),
            "first_right": self.first_right,
            "all_right": self.all_right,
            "false_findings": list(self.false_findings),
            "verdict_right": self.verdict_right,
            "unexplained_right": self.unexplained_right,
            "parameters": [vars(p) | {"z": p.z, "inside": p.inside} for p in self.parameters],
            "holdout_over_floor": self.holdout_over_floor,
        }


def score(
    truth: Mapping[str, Any],
    diagnosis: Mapping[str, Any],
    likeness: Callable[[int, Mapping[str, Any]], float] | None = None,
) -> Score:
    """Score a diagnosis (schema ``cdm_pin.diagnosis/1``) against a truth (``cdm_pin.truth/1``).

    Parameters
    ----------
    truth, diagnosis : mapping
    likeness : callable, optional
        ``likeness(k, finding)``: canonical correlation of true effect `k` with what the finding's effect can look like
        there (`cdm_pin.plant.oracle.Oracle.likeness`). With it a class that is no identity counts only above 0.95;
        without it the diagnosis is believed.
    """
    n, positions = truth["n_links"], truth.get("sensors", {}).get("positions", "joint")
    pulleys = float(truth.get("pulley_ratio", 1.0))
    named = [_coupled(effect, n, pulleys) for effect in truth["effects"] if effect.get("in_catalogue", True)]
    places = [k for k, effect in enumerate(truth["effects"]) if effect.get("in_catalogue", True)]
    strange = [k for k, effect in enumerate(truth["effects"]) if not effect.get("in_catalogue", True)]
    rigid = [in_rigid_body(effect, n, positions) for effect in named]
    findings = [_coupled(finding, n, pulleys) for finding in diagnosis["findings"]]

    meetings: list[Meeting] = []
    used: set[int] = set()
    parameters: list[ParameterScore] = []
    for place, effect, hidden in zip(places, named, rigid, strict=True):

        def alike(finding: Mapping[str, Any], place=place) -> bool:
            return likeness is None or likeness(place, finding) >= _ALIKE

        meeting, index = _meet(effect, findings, n, positions, alike)
        if meeting == "missed" and not hidden:
            pair = _split_asymmetry(effect, findings, n, positions)
            meeting, used = ("class", used | pair) if pair else (meeting, used)
        if index is not None:
            used.add(index)
            if meeting == "exact":
                parameters += _parameters(effect, findings[index])
        if hidden and meeting == "missed" and _listed_in_rigid_body(effect, diagnosis, n, positions):
            meeting = "rigid_body"
        meetings.append(meeting)
    refined = [findings[k] | {"effect": "coulomb_friction"} for k in used if findings[k]["effect"] in _REFINED]
    for k, effect in enumerate(named):  # dry friction is the first part of a refined law where that sits
        if meetings[k] == "missed" and any(same(effect, law, n, positions) for law in refined):
            meetings[k] = "class"
    untold = []
    for k in strange:
        visibility = truth["effects"][k].get("visibility", math.inf)
        same_there = [j for j, f in enumerate(findings) if likeness and _apart(likeness(k, f), visibility) < SURE]
        used |= set(same_there)
        untold += [] if same_there else [truth["effects"][k]]
    coupled = [e for e in [*named, *(findings[k] for k in used)] if e["effect"] == "transmission_coupling"]
    motors = {e["location"].get("index") for e in coupled}
    false = [
        k for k, finding in enumerate(findings) if k not in used and not _joins(finding, named, n, positions, motors)
    ]

    expected = "unexplained" if untold else "missing_physics" if strange or not all(rigid) else "consistent"
    return Score(
        meetings=tuple(meetings),
        first_right=(0 not in false) if findings else "missed" not in meetings,
        false_findings=tuple(f"{findings[k]['effect']} at {describe(findings[k]['location'])}" for k in false),
        verdict_right=diagnosis["verdict"] == expected,
        unexplained_right=(not untold or _unexplained(untold, diagnosis)) if strange else None,
        parameters=tuple(parameters),
        holdout_over_floor=_over_floor(diagnosis),
    )


def describe(location: Mapping[str, Any]) -> str:
    """Say a location in a few words: ``"joint 2"``, ``"cable 3 on link 1"``, ``"motor 2 with joint 1"``."""
    kind = str(location["kind"])
    words = {"index": "", "weights": "", "link": "on link ", "joint": "at joint ", "other": f"with {kind} "}
    if kind == "motor":
        words["joint"] = "with joint "
    return " ".join([kind, *(f"{word}{location[key]}" for key, word in words.items() if key in location)])


def describe_sizes(parameters: Mapping[str, Any]) -> str:
    """Say parameters that are numbers in a few words: ``"coulomb 0.31, stribeck 0.2"``."""
    return ", ".join(f"{name} {value:.4g}" for name, value in parameters.items() if isinstance(value, int | float))


def in_rigid_body(effect: Mapping[str, Any], n: int, positions: str) -> bool:
    """Tell whether an effect lies in the span of the base parameters: it then stands under ``rigid_body``."""
    name = effect["effect"]
    last_encoder = name == "encoder_offset" and effect["location"].get("index") == n and positions != "both"
    return name in ("rotor_inertia", "payload") or last_encoder


def sliding_weights(location: Mapping[str, Any], n: int) -> np.ndarray | None:
    """Give the motor velocities whose combination slides at a place of the paper's arm, scaled; None elsewhere.

    Joint i is ``e_i - e_(i-1)``, cable i on link k is ``e_i - e_k`` (the base being 0), a motor or its cable ``e_i``.
    """
    kind, w = location["kind"], np.zeros(n)
    if kind == "combination":
        w[:] = location["weights"]
    elif kind in ("joint", "motor", "cable"):
        i = location["index"]
        w[i - 1] = 1.0
        against = i - 1 if kind == "joint" else location.get("link", 0)
        if against:
            w[against - 1] -= 1.0
    if not w.any():
        return None
    w = w / np.abs(w).max()
    return w * np.sign(w[np.flatnonzero(w)[0]])


def same(one: Mapping[str, Any], other: Mapping[str, Any], n: int, positions: str) -> bool:
    """Tell whether two (effect, location) pairs are one and the same by the identities of the paper's arm.

    Sliding parts that move alike (joint 1 and motor 1; cable i on guides of link i-1 and joint i); a motor coupled to a
    joint and friction of that combination of motors, or another motor that turns alike with a joint; dry friction and
    capstan friction of a cable at one pretension; base tilt and the encoder offset of joint 1 (unless motor encoders
    tell); a gain on one of two motors and the inverse gain on the other.
    """
    names = [one["effect"], other["effect"]]
    places = [one["location"], other["location"]]
    if set(names) == {"base_tilt", "encoder_offset"}:
        encoder = places[names.index("encoder_offset")]
        return encoder.get("index") == 1 and positions != "both"
    if names == ["torque_gain_error"] * 2 and n == 2:
        return True
    names = ["coulomb_friction" if name in _AS_COULOMB else name for name in names]
    if names[0] != names[1]:
        both = [item.get("slides") for item in (one, other)]
        both = [sliding_weights(place, n) if w is None else w for w, place in zip(both, places, strict=True)]
        coupled = "transmission_coupling" in names and set(names) & {"coulomb_friction", "viscous_friction"}
        return bool(coupled) and _alike(*both)
    if names[0] in _SLIDING:
        return _alike(*(sliding_weights(place, n) for place in places))
    if names[0] == "transmission_coupling" and "turns" in one and "turns" in other:
        return _alike(one["turns"], other["turns"])
    if names[0] == "transmission_ratio_error":
        places = [_map_entry(place) for place in places]
    return _normal(places[0]) == _normal(places[1])


def _alike(first: np.ndarray | None, second: np.ndarray | None) -> bool:
    return first is not None and second is not None and bool(np.allclose(first, second, atol=0.1))


def _coupled(item: Mapping[str, Any], n: int, pulleys: float) -> dict[str, Any]:
    """Add to a coupling the combination of motors that turns, ``v_i + ratio v_k``.

    It slides if friction is all that it has.
    """
    parameters, place = item.get("parameters", {}), item["location"]
    ratio, inertia = (parameters.get(name) for name in ("ratio", "inertia"))
    ratio, inertia = (x.get("value") if isinstance(x, Mapping) else x for x in (ratio, inertia))
    if item["effect"] != "transmission_coupling" or ratio is None or "joint" not in place:
        return dict(item)
    w, k = np.zeros(n), place["joint"] - 1
    w[place["index"] - 1] = 1.0
    w[k] += ratio * pulleys
    if k:
        w[k - 1] -= ratio * pulleys
    turns = {"turns": sliding_weights({"kind": "combination", "weights": w}, n)}
    if "visibility" in item and inertia:  # the truth has a rotor as well
        return dict(item) | turns
    return dict(item) | turns | {"slides": turns["turns"]}


def _map_entry(place: Mapping[str, Any]) -> dict[str, Any]:
    return {"kind": "cable", "index": place["index"], "joint": place.get("joint", place["index"])}


def _normal(place: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in place.items() if value is not None}


def _meet(
    effect, findings: Sequence[Mapping[str, Any]], n: int, positions: str, alike: Callable[[Mapping[str, Any]], bool]
) -> tuple[Meeting, int | None]:
    for k, finding in enumerate(findings):
        if finding["effect"] == effect["effect"] and _normal(finding["location"]) == _normal(effect["location"]):
            return "exact", k
    for k, finding in enumerate(findings):
        if same(effect, finding, n, positions):
            return "class", k
    for k, finding in enumerate(findings):
        rivals = finding.get("indistinguishable_from") or []
        if any(same(effect, rival, n, positions) for rival in rivals[:_MOST_RIVALS]) and alike(finding):
            return "class", k
    return "missed", None


def _split_asymmetry(effect, findings: Sequence[Mapping[str, Any]], n: int, positions: str) -> set[int]:
    """Find asymmetric friction given as symmetric friction and a constant torque on that motor, or the reverse."""
    location = effect["location"]
    weights = sliding_weights(location, n)
    if weights is None or np.count_nonzero(weights) != 1:
        return set()
    motor = {"kind": "motor", "index": int(np.argmax(weights)) + 1}

    def find(name: str) -> set[int]:
        wanted = {"effect": name, "location": motor}
        return {k for k, finding in enumerate(findings) if same(wanted, finding, n, positions)}

    if effect["effect"] == "asymmetric_friction":
        dry, constant = find("coulomb_friction"), find("torque_offset")
        return dry | constant if dry and constant else set()
    if effect["effect"] in ("coulomb_friction", "torque_offset"):
        return find("asymmetric_friction")
    return set()


def _joins(
    finding: Mapping[str, Any], named: Sequence[Mapping[str, Any]], n: int, positions: str, coupled: set[int]
) -> bool:
    """Tell whether a finding names a true effect again, or a part of it.

    That is: an identity apart, the elasticity of a slack cable, the friction of one of the `coupled` motors.
    """
    dry = finding["effect"] in ("coulomb_friction", "viscous_friction") and finding["location"]["kind"] == "motor"
    if dry and finding["location"]["index"] in coupled:
        return True
    elastic = (
        {"effect": "cable_slack", "location": finding["location"]} if finding["effect"] == "cable_elasticity" else {}
    )
    return any(same(told, effect, n, positions) for effect in named for told in (finding, elastic) if told)


def _listed_in_rigid_body(effect, diagnosis: Mapping[str, Any], n: int, positions: str) -> bool:
    changed = diagnosis.get("rigid_body", {}).get("changed", [])
    rivals = [rival for item in changed for rival in item.get("indistinguishable_from") or []]
    return any(same(effect, rival, n, positions) for rival in rivals)


def _apart(likeness: float, visibility: float) -> float:
    """Give the visibility of what a law cannot look like of an effect, from their canonical correlation."""
    return visibility * math.sqrt(max(1.0 - likeness**2, 0.0)) if math.isfinite(visibility) else math.inf


def _unexplained(strange: Sequence[Mapping[str, Any]], diagnosis: Mapping[str, Any]) -> bool:
    told = diagnosis.get("unexplained")
    if diagnosis["verdict"] != "unexplained" or not told:
        return False
    joints = {effect["location"].get(key) for effect in strange for key in ("index", "other")} - {None}
    return told["location"].get("index") in joints


def _parameters(effect: Mapping[str, Any], finding: Mapping[str, Any]) -> list[ParameterScore]:
    out = []
    for name, true in effect.get("parameters", {}).items():
        told = finding.get("parameters", {}).get(name)
        if not isinstance(true, int | float) or not told or told.get("value") is None or told.get("std") is None:
            continue
        value = float(told["value"])
        if name == "phase":
            value = true + math.remainder(value - true, 2.0 * math.pi)
        out.append(ParameterScore(effect["effect"], name, float(true), value, float(told["std"])))
    return out


def _over_floor(diagnosis: Mapping[str, Any]) -> float | None:
    holdout = (diagnosis.get("fit") or {}).get("holdout")
    if not holdout:
        return None
    error, floor = (np.asarray(holdout[key], dtype=float) for key in ("rmse_augmented", "noise_floor"))
    return float(np.sqrt(np.mean(error**2) / np.mean(floor**2))) if floor.all() else None
