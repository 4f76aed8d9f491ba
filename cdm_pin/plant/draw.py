"""Blind trials: an arm, its trajectories, its sensors and what is wrong with it, drawn from one seed.

`draw(seed)` gives recordings as named columns, a manipulator file whose masses are wrong by up to 10 %, and the truth.
The truth is a plain dictionary (schema ``cdm_pin.truth/1``, described in `cdm_pin.scoring`).
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml

from ..errors import InputError, SimulationError, nearest
from ..files import whole_file, whole_folder
from .arms import arm_from_file, draw_arm, draw_moves, draw_reference, draw_servo, manipulator_file
from .catalogue import CATALOGUE, EVERYTHING, draw_fault
from .faults import Entry, Fault
from .mujoco_run import CANNOT, simulate_in_mujoco
from .oracle import Oracle, Scene
from .planar import Arm
from .run import altered, simulate_run
from .sensing import Motion, Noise, Positions, Sensors, record, sampling_times
from .strange import STRANGE

Condition = Literal["pretension", "payload"]


@dataclass(frozen=True)
class Trial:
    """A blind trial: what the diagnosis may see, and the truth it may not.

    Parameters
    ----------
    manipulator : dict
        Content of manipulator.yaml, masses wrong.
    recordings, holdout : tuple of dict
        Columns of each recording by name, each (n_samples,).
    truth : dict
        JSON-able; see `cdm_pin.scoring`.
    scene : Scene
        What an oracle needs to know about the first recording.
    conditions : tuple of dict
        Per recording, hold-outs last: pretension [N] and payload [kg] where they are not those of the manipulator file.
    """

    manipulator: dict[str, Any]
    recordings: tuple[dict[str, np.ndarray], ...]
    holdout: tuple[dict[str, np.ndarray], ...]
    truth: dict[str, Any]
    scene: Scene
    conditions: tuple[dict[str, float], ...] = ()

    def write(self, folder: str | Path) -> dict[str, Any]:
        """Write the trial; return the paths of manipulator, truth, recordings and holdout by these names.

        Recordings are run_i.csv and holdout_i.csv, with a run_i.yaml or holdout_i.yaml beside those that were made
        under conditions of their own.
        """
        folder = Path(folder)
        names = [f"run_{i + 1}" for i in range(len(self.recordings))]
        names += [f"holdout_{i + 1}" for i in range(len(self.holdout))]
        own = dict(zip(names, self.conditions or [{}] * len(names), strict=True))
        with whole_folder(folder) as inside:
            (inside / "manipulator.yaml").write_text(
                yaml.safe_dump(self.manipulator, sort_keys=False), encoding="utf-8"
            )
            (inside / "truth.json").write_text(json.dumps(self.truth, indent=1), encoding="utf-8")
            for name, columns in zip(names, (*self.recordings, *self.holdout), strict=True):
                write_csv(inside / f"{name}.csv", columns)
                if own[name]:
                    (inside / f"{name}.yaml").write_text(yaml.safe_dump({"file": f"{name}.csv"} | own[name]))
        paths = [folder / f"{name}.{'yaml' if own[name] else 'csv'}" for name in names]
        return {
            "manipulator": folder / "manipulator.yaml",
            "truth": folder / "truth.json",
            "recordings": paths[: len(self.recordings)],
            "holdout": paths[len(self.recordings) :],
        }


def write_csv(path: str | Path, columns: dict[str, np.ndarray]) -> None:
    """Write equally long columns under a header line, to ten significant digits."""
    with whole_file(path) as temporary:
        table = np.column_stack(list(columns.values()))
        np.savetxt(temporary, table, fmt="%.10g", delimiter=",", header=",".join(columns), comments="")


def draw(
    seed: int,
    *,
    n_links: int | None = None,
    effects: Sequence[str] | int = 1,
    size: Literal["plain", "quarter"] | float = "plain",
    visibility: float | None = None,
    at_least: float = 0.0,
    out_of_catalogue: bool = False,
    positions: Positions | None = None,
    bits: int | None = None,
    noise: Literal["white", "coloured"] | None = None,
    motion: Literal["loop", "prescribed", "moves"] | None = None,
    plant: Literal["absolute", "mujoco"] = "absolute",
    jitter: float = 0.05,
    tensions: bool = False,
    rate: float = 200.0,
    duration: float = 60.0,
    n_recordings: int = 1,
    n_holdout: int = 1,
    conditions: Sequence[Condition] = (),
) -> Trial:
    """Draw a blind trial; what is left open is drawn too.

    An arm whose servo cannot follow is drawn again with a slower reference; if it follows none, all that is left
    open is drawn anew.

    Parameters
    ----------
    seed : int
        Everything follows from it and the other arguments.
    n_links : int, optional
        2..6.
    effects : sequence of str or int
        Names of the effects, or how many to draw (0: clean).
    size : "plain", "quarter" or float
        Factor on the amplitudes a mechanic would call a fault.
    visibility : float, optional
        Scale the (last) effect until its visibility on the first recording is this, within 5 %.
    at_least : float
        Redraw places and parameters, up to 20 times, until every effect that is no part of a rigid body is at least
        this visible.
    out_of_catalogue : bool
        Draw from laws that no catalogue has.
    positions, bits, noise : optional
        Which positions are logged, encoder bits (14 or 17), white or AR(1)-with-drift torque noise.
    motion : "loop", "prescribed" or "moves", optional
        Under a servo with wrong masses, or held exactly on the reference; "moves" go from point to point under a servo,
        with rests at which dry friction sticks, and are never drawn where this is left out.
    plant : "absolute" or "mujoco"
        What makes the motion; MuJoCo always runs a servo, and carries fewer effects.
    jitter : float
        Standard deviation of the sampling instants, in sample intervals.
    tensions : bool
        Log cable tensions too.
    rate, duration : float
        Sampling [Hz] and length [s] of each recording.
    n_recordings, n_holdout : int
        How many recordings to train on and to hold out, each with its own trajectory.
    conditions : sequence of "pretension", "payload"
        What differs from the second recording on, and is stated with it; a payload is a point mass at the arm's end.

    Raises
    ------
    InputError
        If an effect is unknown or cannot be shown by the positions asked for, or MuJoCo is asked for friction that
        sticks.
    SimulationError
        If no servo can follow at any speed tried; says what was wrong at first.
    """
    settings = {name: value for name, value in locals().items() if name != "seed"}
    if motion == "moves" and plant == "mujoco":
        raise InputError("the MuJoCo plant has no friction that sticks; moves need the other")
    first: SimulationError | None = None
    for again, slower in itertools.product(range(_ANEW), _SLOWER):
        try:
            return _draw(seed, np.random.default_rng([seed, again] if again else seed), slower, **settings)
        except SimulationError as exc:
            first = first or exc
    raise first or SimulationError("no arm can be moved")


_SLOWER, _ANEW = (1.0, 0.75, 0.55, 0.4), 3
_LINKS, _SHARE = (2, 3, 4, 5, 6), (0.3, 0.35, 0.1, 0.2, 0.05)


def _draw(
    seed, rng, slower, n_links, effects, size, visibility, at_least, out_of_catalogue, positions, bits, noise, motion,
    plant, jitter, tensions, rate, duration, n_recordings, n_holdout, conditions,
) -> Trial:  # fmt: skip
    n = int(n_links or rng.choice(_LINKS, p=_SHARE))
    names = _names(rng, effects, n, _table(plant, out_of_catalogue), positions)
    compliant = any(EVERYTHING[name].compliant for name in names)
    arm, scale = draw_arm(rng, n, rotors=compliant or ("transmission_coupling" not in names and rng.random() < 0.4))
    content = manipulator_file(arm, rng)
    model = arm_from_file(content, arm)
    sensors = Sensors(_positions(rng, names, positions), int(bits or rng.choice([14, 17])), rate, jitter, tensions)
    level = _noise(rng, 0.1 * scale * arm.ratio * np.ones(n), noise)
    looped = compliant or plant == "mujoco" or (motion or rng.choice(["loop", "prescribed"])) != "prescribed"
    servo = draw_servo(rng, model, scale) if looped else None
    references = [
        draw_moves(rng, n, duration, speed=speed) if motion == "moves" else draw_reference(rng, n, speed=speed)
        for speed in (slower * rng.uniform(0.7, 1.3) for _ in range(n_recordings + n_holdout))
    ]
    own = [_conditions(rng, conditions if k else (), arm, scale) for k in range(len(references))]
    times = [sampling_times(sensors, duration, rng) for _ in references]

    factor = _SIZES[size] if isinstance(size, str) else float(size)

    def moved(faults: Sequence[Fault], k: int) -> Motion:
        own_arm = arm._replace(pretension=own[k].get("pretension", arm.pretension))
        if "payload" in own[k]:
            faults = [*faults, Fault("payload", {"kind": "link", "index": n}, {"mass": own[k]["payload"]}, ("mass",))]
        if plant == "mujoco" and servo is not None:
            return simulate_in_mujoco(own_arm, faults, model, servo, references[k], duration)
        return simulate_run(own_arm, faults, model, servo, references[k], duration)

    def shown(faults: Sequence[Fault]) -> tuple[Scene, list[dict[str, float]]]:
        run = moved(faults, 0)
        oracle = Oracle(Scene(arm, tuple(faults), run, sensors, level, times[0], scale))
        return oracle.scene, [oracle.visibility(k) for k in range(len(faults))]

    for _ in range(20):
        faults = [fault.scaled(factor) for fault in _faults(rng, names, n, scale, arm, plant, motion)]
        scene, seen = shown(faults)
        told = [s for s, f in zip(seen, faults, strict=True) if not _in_rigid_body(f, n, sensors.positions)]
        if all(s["visibility"] >= at_least for s in told):
            break
    whole = 1.0
    for _ in range(8 if visibility and faults else 0):
        more = float(visibility or 1.0) / max(seen[-1]["visibility"], 1e-9)
        step = float(np.clip(more, 0.02, 50.0))
        if abs(more - 1.0) < 0.05 or more > 1e6 or not FAINTEST < whole * step < 1.0 / FAINTEST:
            break
        whole *= step
        faults[-1] = faults[-1].scaled(step)
        scene, seen = shown(faults)
    runs = [scene.motion, *(moved(faults, k) for k in range(1, len(references)))]
    logs = [
        record(run, faults, sensors, level, t, rng, arm._replace(pretension=its.get("pretension", arm.pretension)))
        for run, t, its in zip(runs, times, own, strict=True)
    ]
    way = motion if motion == "moves" else "loop" if looped else "prescribed"
    truth = _truth(seed, plant, altered(arm, faults)[0], faults, seen, sensors, level, way, scale)
    return Trial(content, tuple(logs[:n_recordings]), tuple(logs[n_recordings:]), truth, scene, tuple(own))


FAINTEST = 1e-4
"""An effect is made so many times smaller at most, to be as visible as asked for: a rigid cable is never seen."""
_SIZES = {"plain": 1.0, "quarter": 0.25}


def _conditions(rng: np.random.Generator, names: Sequence[str], arm: Arm, scale: float) -> dict[str, float]:
    """Draw what is different in a recording, in figures that a file can state."""
    drawn = {}
    if "pretension" in names:
        drawn["pretension"] = round(float(arm.pretension * rng.uniform(1.2, 1.8)), 1)
    if "payload" in names:
        drawn["payload"] = round(float(0.02 * scale * rng.uniform(1.0, 3.0)), 3)
    return drawn


def _in_rigid_body(fault: Fault, n: int, positions: Positions) -> bool:
    last = fault.effect == "encoder_offset" and fault.location["index"] == n and positions != "both"
    return last or fault.effect in ("rotor_inertia", "payload")


def _table(plant: str, out_of_catalogue: bool) -> dict[str, Entry]:
    table = STRANGE if out_of_catalogue else CATALOGUE
    return {name: entry for name, entry in table.items() if plant == "absolute" or name not in CANNOT}


def _positions(rng: np.random.Generator, names: Sequence[str], positions: Positions | None) -> Positions:
    """Draw which positions are logged, of those that can show every effect."""
    choices: list[Positions] = ["both", "joint", "motor"]
    able: list[Positions] = [c for c in choices if all(c in EVERYTHING[name].sensors for name in names)]
    return positions if positions else able[int(rng.integers(len(able)))]


def _noise(rng: np.random.Generator, unit: np.ndarray, kind: str | None) -> Noise:
    """Draw torque noise of 0.1-0.3 % of the arm's scale, white or AR(1) with drift."""
    std = unit * rng.uniform(0.01, 0.03)
    if (kind or rng.choice(["white", "coloured"])) == "white":
        return Noise(std)
    return Noise(std, rng.uniform(0.5, 0.9), float(std[0] * rng.uniform(0.3, 1.0)))


def _names(rng, effects, n, table, positions) -> list[str]:
    """Settle which effects a trial has; drawn ones go together and suit the positions that are logged."""
    if not isinstance(effects, int):
        for name in effects:
            if name not in EVERYTHING:
                raise InputError(f"unknown effect {name!r}{nearest(name, EVERYTHING)}")
            if positions and positions not in EVERYTHING[name].sensors:
                raise InputError(
                    f"{name} needs positions logged at: {', '.join(EVERYTHING[name].sensors)}; got {positions}"
                )
        return list(effects)
    names: list[str] = []
    pool = [name for name in table if positions is None or positions in table[name].sensors]
    while len(names) < effects and pool:
        name = str(rng.choice(pool))
        pool.remove(name)
        together = [table[other] for other in [*names, name]]
        if set.intersection(*(set(entry.sensors) for entry in together)) and not (
            len(together) > 1 and any(entry.compliant for entry in together) and {*names, name} & set(_PATHS)
        ):
            names.append(name)
    return names


_PATHS = ("transmission_ratio_error", "pulley_eccentricity", "transmission_coupling", "backlash")


_BENDS = 5e-5
"""By how much [rad] parts that stick bend before they slide."""


def _faults(rng, names, n, scale, arm, plant, motion) -> list[Fault]:
    """Draw the faults by name; amplitudes drawn for joints are made those of motors where a motor is the place."""
    tension = plant == "absolute"  # no other has cables that remember theirs
    faults: list[Fault] = []
    for name in names:
        fault = draw_fault(name, rng, n, scale, tension)
        if name == "cable_slack":
            beyond = slice(fault.location["index"] - 1, None)
            carried = 9.81 * float(arm.mass[beyond] @ arm.length[beyond]) / 2.0
            fault = replace(fault, parameters=fault.parameters | {"torque": fault.parameters["torque"] * carried})
        if fault.location["kind"] in ("motor", "combination") and fault.effect not in _UNSCALED_AT_MOTOR:
            fault = fault.scaled(arm.ratio)
        width = -_BENDS if motion == "moves" else float(rng.uniform(0.01, 0.03))
        faults.append(replace(fault, width=width))
    return faults


_UNSCALED_AT_MOTOR = ("torque_dependent_friction", "torque_gain_error", "time_delay", "rotor_inertia",
                      "gain_falls_as_motor_warms")  # fmt: skip


def _truth(seed, plant, true, faults, seen, sensors, noise, motion, scale) -> dict[str, Any]:
    effects = [
        {
            "effect": f.effect,
            "location": f.location,
            "parameters": f.parameters,
            "form": f.form,
            "in_catalogue": f.in_catalogue,
            "visibility": s["visibility"],
            "torque_visibility": s["torque"],
            "kinematic_visibility": s["kinematic"],
            "visible_fraction": s["fraction"],
        }
        for f, s in zip(faults, seen, strict=True)
    ]
    links = [
        {"mass": m, "center_of_mass": [x, y, 0.0], "inertia_zz": z}
        for m, x, y, z in zip(*(v.tolist() for v in (true.mass, true.cx, true.cy, true.inertia)), strict=True)
    ]
    return {
        "schema": "cdm_pin.truth/1",
        "plant": plant,
        "seed": seed,
        "n_links": len(links),
        "pulley_ratio": float(true.ratio),
        "effects": effects,
        "links": links,
        "rotor_inertia": true.rotor.tolist(),
        "gravity": true.gravity.tolist(),
        "scale": scale,
        "noise": {"std": noise.std.tolist(), "correlation": noise.correlation, "drift": noise.drift},
        "sensors": {"positions": sensors.positions, "bits": sensors.bits, "jitter": sensors.jitter},
        "motion": motion,
    }
