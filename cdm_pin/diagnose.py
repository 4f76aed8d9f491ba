"""Recordings and a model in, a diagnosis out: what physics the model leaves out, where, how large, how sure."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from . import findings as fi
from .base import base_parameters, massive_columns
from .consistency import nearest_standard
from .effects import Candidate
from .explain import Explanation, Found, explain, explained, patch
from .geometry import Manipulator, Vector, frozen_array
from .model import CableModel
from .next_experiment import Experiment, plan_next
from .problem import Problem, make_problem
from .recording import Recording
from .replay import Replay, simulated_position
from .replay_runs import replay_runs
from .selection import Fit, ProgressCallback, Search, Settings, errors, rms, updated_model

ONCE = ("external_torque", "unnamed_time", "unnamed_wear", "unnamed_gain_drift", "unnamed_tone")
"""What happens at a time of its own: another recording cannot judge it."""
SCHEMA = "cdm_pin.diagnosis/1"


@dataclass(frozen=True)
class Diagnosis:
    """What was found.

    Attributes
    ----------
    content : dict
        What diagnosis.json says.
    model : CableModel
        With the re-identified inertial parameters.
    manipulator : Manipulator
        The completed model, as model.yaml says it.
    explanation : Explanation or None
        Fits and scores behind it; None where the data are insufficient.
    search, holdout : Search or None
        The training and the unseen recordings.
    replays : tuple of Replay
        Recorded motion beside that of the rigid and of the completed model.
    experiment : Experiment or None
        What to record next where rivals are left.
    """

    content: dict[str, Any]
    model: CableModel
    manipulator: Manipulator
    explanation: Explanation | None = None
    search: Search | None = None
    holdout: Search | None = None
    replays: tuple[Replay, ...] = ()
    experiment: Experiment | None = None


def diagnose(
    model: CableModel,
    recordings: Sequence[Recording],
    holdout: Sequence[Recording] = (),
    *,
    settings: Settings | None = None,
    progress: ProgressCallback | None = None,
) -> Diagnosis:
    """Find, name and size the physics that a model leaves out.

    Parameters
    ----------
    model : CableModel
        Its inertial parameters are a first guess; they are identified anew.
    recordings : sequence of Recording
        To learn from; copies are counted once and the order does not matter.
    holdout : sequence of Recording
        To judge on.
    settings : Settings, optional
    progress : callable, optional
        Called with the name of the step and the fraction done.

    Returns
    -------
    Diagnosis

    Raises
    ------
    RecordingError
        If a recording contradicts the model.
    """
    settings = settings or Settings()
    say = progress or (lambda step, fraction: None)
    recordings = distinct(recordings)
    unseen = [r for r in distinct(holdout) if _digest(r) not in {_digest(x) for x in recordings}]
    say("preparing", 0.0)
    problem = make_problem(model, recordings)
    reason = insufficient(problem)
    if reason:
        return Diagnosis(_insufficient(problem, reason), model, model.manipulator)
    base = base_parameters(model, columns=massive_columns(model))
    search = _linearised(Search(problem, base, settings), [], 1)
    explanation = explain(search, progress)
    search, explanation = _settle(explanation.search, explanation)
    judge = None
    if unseen:
        judge = Search(make_problem(search.problem.model, unseen, problem.band), base, settings, search.held)
        judge = judge.with_loads(explanation.fit)
    if judge is not None:
        explanation = _judged(search, judge, explanation)
    say("sensitivities", 0.95)
    return _report(model, search, judge, explanation)


def _judged(search: Search, judge: Search, explanation: Explanation) -> Explanation:
    """Withdraw what does not help on the unseen recordings; what then stands out has no name.

    What is left is judged again each time, for it may have helped only against what was withdrawn.
    """
    for turn in range(5):
        explanation = _named_after_all(search, judge, explanation)
        kept = [f for j, f in enumerate(explanation.found) if _helps(judge, explanation, j)]
        if len(kept) == len(explanation.found):
            break
        patched = None if turn else patch(search, explanation.bank, [f.candidate for f in kept])
        if patched is None:
            explanation = _restricted(search, explanation, kept)
        else:
            explanation = explained(search, explanation.bank, patched)
    return explanation


def _named_after_all(search: Search, judge: Search, explanation: Explanation) -> Explanation:
    """Let a law stand where a correction without a name explains hardly more, and less on the unseen recordings."""
    for j, found in enumerate(explanation.found):
        if found.candidate.named or found.candidate.effect.name in ONCE:
            continue
        near = [c for c, difference in found.rivals if c.named and difference > -15.0 - 0.02 * found.score.statistic]
        for rival in near[:2]:
            others = [f.candidate for i, f in enumerate(explanation.found) if i != j]
            whitener = explanation.fit.whitener
            named, unnamed = (search.fit([*others, c], whitener) for c in (rival, found.candidate))
            if _unseen(judge, named) < _unseen(judge, unnamed):
                return explained(search, explanation.bank, [*others, rival])
    return explanation


def distinct(recordings: Sequence[Recording]) -> list[Recording]:
    """Give each recording once, in an order that depends on its content alone."""
    return list({_digest(r): r for r in sorted(recordings, key=_digest)}.values())


def _digest(recording: Recording) -> str:
    digest = hashlib.sha256(np.ascontiguousarray(recording.time - recording.time[0]).tobytes())
    for name in sorted(recording.channels):
        digest.update(name.encode() + np.ascontiguousarray(recording.channels[name]).tobytes())
    return digest.hexdigest()


def insufficient(problem: Problem) -> str:
    """Say why the recordings cannot support a diagnosis; empty if they can."""
    samples = sum(stop - start for run in problem.segments for start, stop in run)
    duration = samples * problem.band.step / problem.band.rate
    if samples < 100:
        return f"only {duration:.3g} s of usable motion in the band up to {problem.band.cutoff:.3g} Hz"
    moving = max(float(np.ptp(m.q, axis=0).max()) for m in problem.motions)
    if moving < 1e-3:
        return f"nothing moves (largest range of a joint {moving:.2g})"
    return ""


def _insufficient(problem: Problem, reason: str) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "verdict": "insufficient_data",
        "reason": reason,
        "rigid_body": {"changed": []},
        "findings": [],
        "fit": {"train": None, "holdout": None, "simulated_position": None},
        "sensitivity": [],
        "unexplained": None,
        "next_experiment": None,
        "data": _data(problem),
    }


def _linearised(search: Search, effects: Sequence[Candidate], rounds: int) -> Search:
    """Move the model to the fitted base parameters, about which first-order columns are taken."""
    for _ in range(rounds):
        fit = search.fit(effects)
        moved = updated_model(search.problem.model, search.base, fit.base)
        search = Search(search.problem.with_model(moved), search.base, search.settings, search.held)
    return search


def _settle(search: Search, explanation: Explanation) -> tuple[Search, Explanation]:
    """Take the columns of what was found about the completed model, and fit again."""
    if not explanation.found:
        return search, explanation
    candidates = [f.candidate for f in explanation.found]
    search = _linearised(search, candidates, 2)
    search = search.with_loads(search.fit(candidates))
    return search, _restricted(search, explanation, explanation.found)


def _restricted(search: Search, explanation: Explanation, found: Sequence[Found]) -> Explanation:
    """Give the explanation with only these findings, fitted anew."""
    candidates = [f.candidate for f in found]
    fit = search.fit(candidates)
    rigid = search.fit([], fit.whitener)
    renewed = []
    for j, f in enumerate(found):
        without = search.fit([c for i, c in enumerate(candidates) if i != j], fit.whitener)
        renewed.append(replace(f, score=search.score(without, f.candidate)))
    return Explanation(tuple(renewed), fit, rigid, explanation.bank, search)


def _weighted(search: Search, errors: Sequence[Vector], level: Vector) -> float:
    return float(np.sum((rms(search, errors) / level) ** 2))


def _helps(judge: Search, explanation: Explanation, j: int) -> bool:
    """Whether finding `j` lowers the error on the unseen recordings as it should, and does not raise it anywhere.

    In whitened units it should lower it by its statistic, in proportion to the samples; a tenth is asked for.
    """
    found, fit = explanation.found[j], explanation.fit
    if fit.effects[j].effect.name in ONCE:
        return True
    without = explanation.search.fit([c for i, c in enumerate(fit.effects) if i != j], fit.whitener)
    whole, rest = _unseen(judge, fit), _unseen(judge, without)
    share = sum(b - a for run in judge.problem.segments for a, b in run) / max(
        sum(b - a for run in explanation.search.problem.segments for a, b in run), 1
    )
    if rest - whole < max(6.0 * found.candidate.named, 0.1 * share * found.score.statistic):
        return False
    level = np.maximum(noise_floor(judge, fit.effects), 1e-12)
    with_it, without_it = (_weighted(judge, errors(judge, f.base, f.effects, f.beta), level) for f in (fit, without))
    return with_it < 1.01 * without_it


def _unseen(judge: Search, fit: Fit) -> float:
    """Sum the squares of a fit's error on the unseen recordings, in whitened units."""
    return float(np.sum(judge.white(fit.whitener, _stacked(judge, fit)) ** 2))


def _stacked(judge: Search, fit: Fit) -> list[Vector]:
    return [e[None] for e in errors(judge, fit.base, fit.effects, fit.beta)]


def noise_floor(search: Search, effects: Sequence[Candidate] = ()) -> Vector:
    """Estimate each channel's noise in the band without a law, shape (n_channels,).

    It is what smooth functions of position, speed, direction and time leave over beside the rigid body and what was
    found, less what these functions take of the noise.
    """
    return search.left_over(effects)[1].rms


def _fit_content(search: Search, rigid: Fit, fit: Fit, judged: Search) -> dict[str, Any]:
    m = search.problem.model.n_motors
    return {
        "rmse_rigid": rms(judged, errors(judged, rigid.base, (), ()))[:m].tolist(),
        "rmse_augmented": rms(judged, errors(judged, fit.base, fit.effects, fit.beta))[:m].tolist(),
        "noise_floor": noise_floor(judged, fit.effects)[:m].tolist(),
    }


def _report(model: CableModel, search: Search, judge: Search | None, explanation: Explanation) -> Diagnosis:
    fit = explanation.fit
    patches = [f for f in explanation.found if not f.candidate.named]
    named = [j for j, f in enumerate(explanation.found) if f.candidate.named]
    if patches:
        named = [j for j in named if fi.is_sure(explanation.found[j], explanation.found[j].score, patches)]
    named.sort(key=lambda j: -explanation.found[j].score.statistic)
    covariance, betas, shapes = fi.joint_covariance(search, fit)
    own_rigid = search.fit([])
    items, records = [], []
    for j in named:
        found = explanation.found[j]
        index = np.r_[betas[j], shapes[j]]
        values = fi.parameters(found.candidate, fit.beta[j], covariance[np.ix_(index, index)])
        if not (fi.is_known(values) and fi.is_admissible(found.candidate.effect, values)) or found.gain < 5.0:
            continue
        items.append(_finding(search, judge, explanation, j, values))
        records.append(_record(found.candidate, values))
    verdict = "unexplained" if patches else ("missing_physics" if items else "consistent")
    unexplained = (
        _unexplained(explanation, patches, search)
        if patches
        else _beyond_floor(search, judge, explanation, 3.0 if items else 2.0)
    )
    if unexplained is not None:
        verdict = "unexplained"
    content = {
        "schema": SCHEMA,
        "verdict": verdict,
        "rigid_body": {"changed": changed_parameters(model, search, explanation)},
        "findings": items,
        "fit": {
            "train": _fit_content(search, own_rigid, fit, search),
            "holdout": _fit_content(search, own_rigid, fit, judge) if judge is not None else None,
            "simulated_position": None,
            "unit": "N m" if search.problem.torque else "rad",
        },
        "sensitivity": fi.sensitivities(search, explanation),
        "unexplained": unexplained,
        "next_experiment": None,
        "data": _data(search.problem),
    }
    experiment = plan_next(search, explanation, _unresolved(explanation, items))
    if experiment is not None:
        content["next_experiment"] = {
            "file": "next.csv",
            "change": experiment.change,
            "power": experiment.power,
            "separates": [{"effect": c.effect.name, "location": fi.location(c)} for c in experiment.rivals],
        }
    completed = completed_manipulator(model, search, fit, tuple(records), covariance)
    replays = replay_runs(search, judge, own_rigid, fit, completed)
    content["fit"]["simulated_position"] = simulated_position(replays)
    return Diagnosis(content, search.problem.model, completed, explanation, search, judge, replays, experiment)


def _unresolved(explanation: Explanation, items: Sequence[dict[str, Any]]) -> list[tuple[int, Candidate]]:
    """List findings, by their number, with the rivals that were listed beside them and are other effects."""
    out = []
    for item in items:
        for j, found in enumerate(explanation.found):
            if (found.candidate.effect.name, fi.location(found.candidate)) != (item["effect"], item["location"]):
                continue
            listed = [(e["effect"], e["location"]) for e in item["indistinguishable_from"]]
            out += [(j, c) for c, _ in found.rivals if (c.effect.name, fi.location(c)) in listed][:2]
    return out[:2]


def _data(problem: Problem) -> dict[str, Any]:
    return {
        "band": [0.0, problem.band.cutoff],
        "rate": problem.band.rate / problem.band.step,
        "torque": problem.torque,
        "kinematic": problem.kinematic,
        "recordings": [
            {"name": run.name, "duration": float(run.motion.time[-1]), "notices": list(run.signals.notices)}
            for run in problem.runs
        ],
    }


def _finding(
    search: Search, judge: Search | None, explanation: Explanation, j: int, values: dict[str, Any]
) -> dict[str, Any]:
    found, fit = explanation.found[j], explanation.fit
    reduction = None
    if judge is not None:
        without = search.fit([c for i, c in enumerate(fit.effects) if i != j], fit.whitener)
        level = np.maximum(rms(judge, errors(judge, fit.base, fit.effects, fit.beta)), 1e-12)
        after, before = (_weighted(judge, errors(judge, f.base, f.effects, f.beta), level) for f in (fit, without))
        reduction = 1 - float(np.sqrt(after / before))
    candidate = found.candidate
    time = [candidate.shape[0], candidate.shape[1]] if candidate.effect.name == "external_torque" else None
    item = {
        "effect": candidate.effect.name,
        "location": fi.location(candidate),
        "parameters": {k: v for k, v in values.items() if k not in ("start", "end")},
        "evidence": {
            "delta_bic": fi.refit_gain(found),
            "log10_p": found.log_p / np.log(10),
            "holdout_rmse_reduction": reduction,
        },
        "indistinguishable_from": fi.indistinguishable(search, explanation, j),
        "time": time,
        "region": None,
    }
    if judge is None:
        item["unconfirmed"] = True
    return item


def _record(candidate: Candidate, values: dict[str, Any]) -> dict[str, Any]:
    parameters = {name: round(float(v["value"]), 10) for name, v in values.items()}
    if candidate.effect.nuisance_shape:
        parameters["width"] = round(float(candidate.shape[0]), 10)
    return {"effect": candidate.effect.name, "location": fi.location(candidate), "parameters": parameters}


def _unexplained(explanation: Explanation, patches: Sequence[Found], search: Search) -> dict[str, Any]:
    main = max(patches, key=lambda f: f.score.statistic)
    j = explanation.found.index(main)
    columns = search.columns(main.candidate)
    torque = [np.tensordot(explanation.fit.beta[j], c, 1) for c in columns]
    size = float(np.sqrt(np.sum(rms(search, torque) ** 2)))
    place = fi.location(main.candidate)
    words = f"{place['kind']} {place.get('index', '')}".strip()
    nearest = [{"effect": r.effect.name, "location": fi.location(r)} for r, _ in main.rivals if r.named][:3]
    return {
        "location": {"kind": place["kind"], "index": place["index"]},
        "time": None,
        "region": main.candidate.effect.revealed_by.format(place=words),
        "rms": size,
        "nearest": nearest,
    }


def _beyond_floor(
    search: Search, judge: Search | None, explanation: Explanation, limit: float
) -> dict[str, Any] | None:
    """Say where a residual is left that no correction describes either; None where it is near the floor."""
    fit, both = explanation.fit, [search] if judge is None else [search, judge]
    rests = [rms(there, errors(there, fit.base, fit.effects, fit.beta)) for there in both]
    floors = [np.maximum(noise_floor(there, fit.effects), 1e-12) for there in both]
    rest, ratio = rests[0], np.min(np.divide(rests, floors), axis=0)
    worst = int(np.argmax(ratio))
    if not search.problem.segments or ratio[worst] < limit:
        return None
    motor = worst % search.problem.model.n_motors + 1
    return {
        "location": {"kind": "motor", "index": motor},
        "time": None,
        "region": f"the error of motor {motor} is {ratio[worst]:.1f} times its noise, in no shape that was tried",
        "rms": float(rest[worst]),
        "nearest": [],
    }


def changed_parameters(model: CableModel, search: Search, explanation: Explanation) -> list[dict[str, Any]]:
    """List the base parameters that differ from the file: by more than 4 standard errors and 1 % of themselves."""
    base, fit = search.base, explanation.fit
    p = len(base.columns)
    nominal = base.values(model.standard_parameters)
    value = base.values(search.problem.model.standard_parameters) + fit.base[:p]
    std = np.sqrt(np.diag(fit.covariance)[:p])
    alternatives = fi.absorbed(search, explanation) + _payloads(search)
    out = []
    for k in np.argsort(-np.abs(value - nominal) / np.maximum(std, 1e-12)):
        change = abs(value[k] - nominal[k])
        if change < 4 * std[k] or change < 0.01 * abs(nominal[k]):
            continue
        same = [
            {"effect": e["effect"], "location": e["location"]} for e in alternatives if base.names[k] in e["parameters"]
        ]
        out.append(
            {
                "base_parameter": base.names[k],
                "links": list(base.links[k]),
                "nominal": float(nominal[k]),
                "value": float(value[k]),
                "std": float(std[k]),
                "indistinguishable_from": same[:4],
            }
        )
    return out


def _payloads(search: Search) -> list[dict[str, Any]]:
    """List a payload on each link with the base parameters that it would change."""
    base, out = search.base, []
    for link in range(search.problem.model.n_joints):
        moved = np.abs(base.matrix[:, 10 * link : 10 * link + 10]).sum(axis=1) > 1e-9
        names = [name for name, yes in zip(base.names, moved, strict=True) if yes]
        out.append({"effect": "payload", "location": {"kind": "link", "index": link + 1}, "parameters": names})
    return out[::-1]


def completed_manipulator(
    model: CableModel, search: Search, fit: Fit, effects: tuple[dict[str, Any], ...], covariance: Vector
) -> Manipulator:
    """Give the manipulator with physically valid links that reproduce the base parameters, and with effects."""
    base = search.base
    values = base.values(search.problem.model.standard_parameters) + fit.base[: len(base.columns)]
    std = np.sqrt(np.diag(covariance)[: len(values)])
    records = tuple(
        {"name": name, "value": float(value), "std": float(s)}
        for name, value, s in zip(base.names, values, std, strict=True)
    )
    manipulator = replace(model.manipulator, effects=model.manipulator.effects + effects, base_parameters=records)
    standard = nearest_standard(base.matrix, values, model.standard_parameters)
    if standard is None or not manipulator.links:
        return manipulator
    return replace(manipulator, links=links_from_parameters(manipulator, standard.parameters))


def links_from_parameters(manipulator: Manipulator, pi_std: Vector):
    """Give the links with these standard parameters."""
    links = []
    for link, (m, hx, hy, hz, xx, xy, yy, xz, yz, zz) in zip(
        manipulator.links, np.reshape(pi_std, (-1, 10)), strict=True
    ):
        c = np.array([hx, hy, hz]) / m
        about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        inertia = about_origin - m * (c @ c * np.eye(3) - np.outer(c, c))
        links.append(replace(link, mass=float(m), center_of_mass=frozen_array(c), inertia=frozen_array(inertia)))
    return tuple(links)
