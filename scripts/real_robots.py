"""Fit the public recordings of real robots and write docs/real_robots.md and docs/real_robots.csv.

Usage: python scripts/real_robots.py [ROBOT ...] [--data FOLDER] [-o docs]

The recordings come from scripts/get_data.py. Every figure is the error on a recording that was not fitted, by the
metric of the robot's publication; the physics is put in by name, one effect after the other. If README.md holds the
lines ``<!-- real robots -->`` and ``<!-- end -->``, its table between them is written too.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import real_identify
import real_tool
from real_fit import (
    Law,
    Log,
    Treatment,
    coulomb,
    harmonics,
    hysteresis,
    load,
    offset,
    phase_folds,
    position_friction,
    position_torque,
    prepare,
    rotor,
    spring,
    stop,
    structure,
    transfer,
    vibration,
    viscous,
)
from real_report import Chapter, Row, csv_text, document, table_text, write_readme

from cdm_pin.errors import CdmError, InputError
from cdm_pin.files import write_text
from cdm_pin.model import CableModel, load_model

ROOT = Path(__file__).resolve().parent.parent
REAL = ROOT / "urdf" / "real"
PSM_WINDOW = slice(200, 200 + 1111)
MTM_WINDOW = slice(200, 200 + 2000)


def motors(model: CableModel, which: Sequence[int] | None = None) -> list[tuple[str, np.ndarray]]:
    """Name the motors and give their coordinates."""
    which = range(model.n_motors) if which is None else which
    return [(f"motor {i + 1}", np.eye(model.n_motors)[i]) for i in which]


def joints(model: CableModel, names: Sequence[str]) -> list[tuple[str, np.ndarray]]:
    """Give the coordinates of joints by name: rows of E."""
    return [(name, model.joint_from_motor[model.joints.index(f"{name}_joint")]) for name in names]


def baseline(model: CableModel, places: Sequence[tuple[str, np.ndarray]]) -> list[Law]:
    """Viscous and Coulomb friction at places, constant torque at every motor."""
    laws = [law(name, w) for name, w in places for law in (viscous, coulomb)]
    return laws + [offset(name, w) for name, w in motors(model)]


def memory(places: Sequence[tuple[str, np.ndarray]], logs: Sequence[Log]) -> list[Law]:
    """Hysteresis at places, thresholds by the largest reach of the logs that are fitted."""
    return [hysteresis(name, w, max(log.reach(w) for log in logs)) for name, w in places]


def psm(data: Path) -> Chapter:
    """Judge the patient-side manipulator on the trajectory that was not fitted."""
    model, layout = load_model(REAL / "psm.yaml"), REAL / "recordings" / "dvrk_psm_wpi.yaml"
    folder = data / "dvrk_psm_wpi"
    recordings = {name: load(folder / f"{name}_results.csv.gz", model, layout) for name in ("one", "two")}
    metric = np.pi * 5.4
    as_published = {name: prepare(r, model, Treatment(metric)) for name, r in recordings.items()}
    treatment = Treatment(metric, light=20.0, acceleration=(5, 5, 5, 8, 8, 8, 8))
    logs = {name: prepare(r, model, treatment) for name, r in recordings.items()}
    whole = structure(model, _psm_published(model), free_signs=True)
    _, error = transfer(whole, as_published, ["one"], "two", window=PSM_WINDOW, ridge=1e-7, physical=True)
    rows = [
        Row("psm", "one -> two", "published, full model", (0.093, 0.178, 0.191, 0.134, 0.239, 0.213, 0.264)),
        Row("psm", "one -> two", "published structure and treatment, reproduced", tuple(error)),
    ]
    ways = (("one", "two"), ("two", "one"))
    for band, cutoff in (("", None), (", published band", metric)):
        for train, test in ways:
            found = real_identify.errors(
                model, [recordings[train]], recordings[test], real_identify.PSM, cutoff=cutoff, window=PSM_WINDOW
            )
            rows.append(Row("psm", f"{train} -> {test}", f"{real_identify.STEP}, published structure{band}", found))
    ladders = [_psm_ladder(model, logs[train]) for train, _ in ways]
    for k, (step, _) in enumerate(ladders[0]):
        for (train, test), ladder in zip(ways, ladders, strict=True):
            _, error = transfer(structure(model, ladder[k][1]), logs, [train], test, window=PSM_WINDOW)
            rows.append(Row("psm", f"{train} -> {test}", step, tuple(error)))
    text = (
        "Trained on one trajectory of 30 s, judged on the other; filter and window of Wang et al. (RA-L 2019). "
        "`cdm-pin identify` gets the published structure by the names of its effects, and chooses all filters itself: "
        "in the band it chooses (8 Hz) and in the published one. "
        "Treated signals: friction columns from lightly filtered motion (20 Hz), then the metric's filter on both "
        "sides; accelerations from their own band (5 Hz, wrist 8 Hz), the vibration of motor 3 from its measured "
        "velocity (5-17 Hz); friction never negative. Rotor inertia is left free in that row: without hysteresis it "
        "comes out negative, which is how missing hysteresis looks; from the next row on it is not negative either. "
        "Trajectory `two` turns motor 4 by half a radian to each side and `one` by 1.3: trained on `two`, the roll "
        "spring is extrapolated."
    )
    return Chapter("da Vinci patient-side manipulator (7 motors)", text, _columns(7), tuple(rows))


def _columns(n: int) -> tuple[str, ...]:
    return tuple(f"m{i}" for i in range(1, n + 1))


def _fingers(model: CableModel) -> list[tuple[str, np.ndarray]]:
    first, second = joints(model, ("finger_1", "finger_2"))
    return [first, second, ("fingers on each other", second[1] - first[1])]


def _psm_published(model: CableModel) -> list[Law]:
    every = motors(model)
    return [*baseline(model, every + _fingers(model)), spring(*every[3]), *(rotor(*place) for place in every[3:])]


def _psm_ladder(model: CableModel, log: Log) -> list[tuple[str, list[Law]]]:
    """List the laws step by step; thresholds and scales are those of the training log."""
    every = motors(model)
    pitch, w = every[1], every[1][1]
    laws = [*_psm_published(model), vibration(*every[2], motor=2, band=(5, 17))]
    loose = [replace(law, nonnegative=False) if law.name.startswith("rotor") else law for law in laws]
    steps = [("published structure, signals treated", loose)]
    for step, more in (
        ("+ hysteresis at the motors", memory(every, [log])),
        ("+ hysteresis at the fingers", memory(_fingers(model), [log])),
        ("+ position-dependent torque, motor 2", [position_torque(*pitch, log.middle(w), log.reach(w), order=5)]),
        ("+ position-dependent friction, motor 2", [position_friction(*pitch, log.middle(w), log.reach(w))]),
    ):
        laws = [*laws, *more]
        steps.append((step, laws))
    return steps


def mtm(data: Path) -> Chapter:
    """Judge the master manipulator by what one trajectory allows: training error and folds over its period."""
    model, layout = load_model(REAL / "mtm.yaml"), REAL / "recordings" / "dvrk_mtm_wpi.yaml"
    recording = load(data / "dvrk_mtm_wpi" / "one_results.csv.gz", model, layout)
    every = motors(model)
    rubbing = joints(
        model, ("shoulder_yaw", "arm", "forearm", "parallel_crank", "platform", "wrist_5", "wrist_6", "wrist_7")
    )
    metric = np.pi * 1.8
    treatment = Treatment(metric, 20.0, (4, 5, 5, 8, 8, 8, 8), (True, True, True, True, False, False, False))
    log = prepare(recording, model, treatment)
    published = [
        *baseline(model, rubbing),
        rotor(*every[3]),
        harmonics(*every[4], orders=(1, 2)),
        position_torque(*every[3], log.middle(every[3][1]), log.reach(every[3][1]), order=5),
    ]
    slip = memory(every, [log])
    coupled = memory(joints(model, ("forearm", "platform")), [log])
    last = position_torque(*every[6], log.middle(every[6][1]), log.reach(every[6][1]), order=4)
    rows = [
        Row("mtm", "training", "published, full model", (0.086, 0.162, 0.125, 0.189, 0.248, 0.181, 0.280)),
        Row("mtm", "one -> two", "published, full model", (0.077, 0.149, 0.170, 0.223, 0.280, 0.234, 0.340)),
    ]
    found = real_identify.errors(model, [recording], recording, real_identify.MTM, cutoff=metric, window=MTM_WINDOW)
    rows.append(Row("mtm", "training", f"{real_identify.STEP}, published structure", found))
    for step, laws in (
        ("published structure, signals treated", published),
        ("+ hysteresis at the motors", [*published, *slip]),
        ("+ hysteresis at forearm and platform", [*published, *slip, *coupled]),
        ("+ position-dependent torque, motor 7", [*published, *slip, *coupled, last]),
    ):
        robot, logs = structure(model, laws), {"one": log}
        rows.append(
            Row("mtm", "training", step, tuple(transfer(robot, logs, ["one"], "one", window=MTM_WINDOW, ridge=3e-3)[1]))
        )
        rows.append(Row("mtm", "folds of the period", step, tuple(phase_folds(robot, log, 2333, ridge=3e-3))))
    text = (
        "Only the training trajectory is at hand; the published test errors are on another one. Shown are the error on "
        "the training recording and that of four folds over the period (2333 samples, all repeats of a part left out "
        "together). Folds of one trajectory leave out whole parts of the workspace, so they are harsher than another "
        "trajectory on motors 2 and 5; they veto effects, they do not choose them. Accelerations of motors 1 to 4 come "
        "from the measured velocities, whose samples do not jitter."
    )
    return Chapter("da Vinci master manipulator (7 motors)", text, _columns(7), tuple(rows))


def psm3(data: Path) -> Chapter:
    """Judge the first three joints on four trajectories, each left out in turn."""
    model, layout = load_model(REAL / "psm3.yaml"), REAL / "recordings" / "dvrk_psm_3dof_gondokaryono.yaml"
    treatment = Treatment(np.pi * 5.4, 20.0, (5, 5, 5))
    recordings = {}
    for name in ("test", "test2", "test3", "test4"):
        path = data / "dvrk_psm_3dof_gondokaryono" / f"psm1_fourier_{name}_results.csv.gz"
        recordings[name] = load(path, model, layout)
    logs = {name: prepare(recording, model, treatment) for name, recording in recordings.items()}
    rows = []
    for test in logs:
        train = [recording for name, recording in recordings.items() if name != test]
        found = real_identify.errors(model, train, recordings[test], cutoff=treatment.metric)
        rows.append(Row("psm3", f"others -> {test}", f"{real_identify.STEP}, {_PSM3_STEPS[0]}", found))
    for k, step in enumerate(_PSM3_STEPS):
        for test in logs:
            train = [name for name in logs if name != test]
            laws = _psm3_laws(model, [logs[name] for name in train])[: k + 1]
            _, error = transfer(structure(model, [law for part in laws for law in part]), logs, train, test)
            rows.append(Row("psm3", f"others -> {test}", step, tuple(error)))
    text = (
        "Four trajectories of an earlier campaign, each judged by a fit of the other three; no published error exists. "
        "The same two effects at the same place as in the newer recordings help on every one of them. In `test` the "
        "carriage runs into its end at less than 1 cm (spikes of force at each arrival), which no model of the others "
        "predicts."
    )
    return Chapter("da Vinci patient-side manipulator, first three joints", text, _columns(3), tuple(rows))


_PSM3_STEPS = (
    "Coulomb and viscous friction, offsets",
    "+ hysteresis at the motors",
    "+ position-dependent torque, motor 2",
    "+ position-dependent friction, motor 2",
)


def _psm3_laws(model: CableModel, logs: Sequence[Log]) -> list[list[Law]]:
    """List the laws of each step; thresholds and scales are those of the logs that are fitted."""
    every = motors(model)
    w = every[1][1]
    widest = max(logs, key=lambda log: log.reach(w))
    scale = widest.middle(w), widest.reach(w)
    return [
        [*baseline(model, every), vibration(*every[2], motor=2, band=(5, 17))],
        memory(every, logs),
        [position_torque(*every[1], *scale, order=5)],
        [position_friction(*every[1], *scale)],
    ]


def panda(data: Path) -> Chapter:
    """Judge the control, which has no cables, on the end of its run."""
    return _single_run(
        data / "franka_panda_gaz" / "trajectory_1.csv.gz",
        "panda",
        "franka_panda_gaz",
        range(7),
        Treatment(10.0, 30.0, (10.0,) * 7),
        "Franka Panda (control: no cables)",
        "One run; the first 60 % are fitted, the rest is judged. Torques come from link-side sensors. Viscous and "
        "Coulomb friction are what it shows; nothing here asks for cables.",
    )


def wam(data: Path) -> Chapter:
    """Judge a cable-driven arm on the end of its one short run."""
    return _single_run(
        data / "wam_2dof_noohian" / "state_4_gravity_4.csv.gz",
        "wam",
        "wam_2dof_noohian",
        (1, 3),
        Treatment(10.0, 30.0, (5.0,) * 7),
        "Barrett WAM (joints 2 and 4)",
        "One run of 10 s, one period: the first 60 % are fitted, the rest is judged. It cannot support more than "
        "Coulomb and viscous friction: there is no other trajectory to confirm anything finer.",
    )


def _single_run(path, robot, layout, moving, treatment, title, text) -> Chapter:
    model = load_model(REAL / f"{robot}.yaml")
    recording = load(path, model, REAL / "recordings" / f"{layout}.yaml")
    log = prepare(recording, model, treatment)
    log = _hold(log, [i for i in range(model.n_motors) if i not in moving])
    places = motors(model, moving)
    offsets = [offset(*place) for place in places]
    rub = [law(name, w) for name, w in places for law in (viscous, coulomb)]
    logs = _halves(log, 0.6)
    first, rest = real_identify.halves(recording, 0.6)
    found = real_identify.errors(model, [first], rest)
    step = f"{real_identify.STEP}, Coulomb and viscous friction, offsets"
    rows = [Row(robot, "first 60 % -> rest", step, tuple(found[i] for i in moving))]
    for step, laws in (("rigid body and offsets", offsets), ("+ Coulomb and viscous friction", offsets + rub)):
        _, error = transfer(structure(model, laws), logs, ["first"], "rest", ridge=1e-3)
        rows.append(Row(robot, "first 60 % -> rest", step, tuple(error[list(moving)])))
    return Chapter(title, text, tuple(f"j{i + 1}" for i in moving), tuple(rows))


def _hold(log: Log, still: Sequence[int]) -> Log:
    """Hold joints that were not excited exactly still."""
    q, v, a = (x.copy() for x in log.rigid)
    for i in still:
        q[:, i], v[:, i], a[:, i] = q[:, i].mean(), 0.0, 0.0
    return replace(log, rigid=(q, v, a))


def _halves(log: Log, share: float) -> dict[str, Log]:
    """Cut one log in two that share no samples; the ends of each are left out as everywhere."""
    cut = int(share * len(log.q))

    def part(name: str, s: slice) -> Log:
        rigid = tuple(x[s] for x in log.rigid)
        return replace(log, name=name, q=log.q[s], v=log.v[s], rigid=rigid, torque=log.torque[s], raw_velocity=None)

    return {"first": part("first", slice(0, cut)), "rest": part("rest", slice(cut, None))}


def tool(data: Path) -> Chapter:
    """Judge the output side of a tool, told from its input side."""
    model, layout = load_model(REAL / "davinci_tool.yaml"), REAL / "recordings" / "davinci_tool_mrd.yaml"
    rows = [Row("davinci_tool", "published", "neural network, closing strokes, inside the same files", (0.37, 4.42))]
    for folder, train in (("L_4", ("00", "04", "09")), ("L_2", ("00", "21", "43"))):
        files = sorted((data / "davinci_tool_mrd" / f"Tool_4_Maryland_{folder}").glob("*.TXT.gz"))
        runs = {file.name[:2]: real_tool.stroke(load(file, model, layout)) for file in files}
        errors = real_tool.transfer(runs, train)
        unseen = np.array([error for name, error in errors.items() if name not in train])
        case = f"{folder}: {', '.join(train)} -> the other {len(unseen)}"
        step = "tension memory along the path, softer when slack"
        rows.append(Row("davinci_tool", case, step, tuple(np.sqrt(np.mean(unseen**2, axis=0)))))
    text = (
        "Jaw angle and output torque from spindle angle, its history and input torque alone; all strokes with their "
        "reversals, 2 s of start-up left out, files not trained on. Friction along the cable path remembers tension: "
        "the load follows the input torque as a play operator whose width grows with the load, and the tensions along "
        "the path stretch the cable. `L_4/07` holds a runaway of the spindle: it is cut there. Training files are "
        "those with the least, a middle and the largest load (and slow, middle, fast)."
    )
    return Chapter("da Vinci tool, both cable ends measured", text, ("angle [deg]", "torque [mN m]"), tuple(rows))


def wrist(data: Path) -> Chapter:
    """Judge the cables of a wrist by where its joints stand, without torque."""
    model, layout = load_model(REAL / "psm_serial.yaml"), REAL / "recordings" / "dvrk_wrist_hysteresis_berkeley.yaml"
    folder, names = data / "dvrk_wrist_hysteresis_berkeley", ("random", *(f"exp{i}" for i in range(1, 6)))
    runs = {}
    for name in names:
        channels = load(folder / f"{name}_{{}}_raw.npy", model, layout).channels
        runs[name] = channels["motor_position"], channels["joint_position"] - channels["motor_position"]
    q, error = runs["random"]
    split = int(0.7 * len(q))
    rows = []
    for step, columns in (("offsets", _constant), ("+ coupling", _coupled), ("+ hysteresis", _remembering)):
        A = columns(q)
        c, *_ = np.linalg.lstsq(A[:split], error[:split, 3:], rcond=None)
        rows.append(Row("wrist", "first 70 % -> rest", step, tuple(_rms(error[split:, 3:] - A[split:] @ c))))
        others = [runs[name][1][:, 3:] - columns(runs[name][0]) @ c for name in names[1:]]
        rows.append(Row("wrist", "first 70 % -> five experiments", step, tuple(_rms(np.concatenate(others)))))
    text = (
        "Commanded against camera-measured joint angles, way points at rest, no torque: rms of measured minus "
        "commanded, in rad. The wrist joints follow each other (coupling through the cables) and remember where they "
        "turned (hysteresis). What is left of roll does not depend on the motion."
    )
    return Chapter("da Vinci wrist, two positions", text, ("roll [rad]", "pitch [rad]", "yaw [rad]"), tuple(rows))


def _constant(q: np.ndarray) -> np.ndarray:
    return np.ones((len(q), 1))


def _coupled(q: np.ndarray) -> np.ndarray:
    return np.column_stack([_constant(q), q[:, 3:]])


def _remembering(q: np.ndarray) -> np.ndarray:
    limits = (0.05, 0.1, 0.2, 0.4, 0.8)
    return np.column_stack(
        [_coupled(q), *(stop(np.ascontiguousarray(x), limit) for x in q[:, 3:].T for limit in limits)]
    )


def _rms(x: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(x**2, axis=0))


ROBOTS: dict[str, Callable[[Path], Chapter]] = {
    "psm": psm,
    "mtm": mtm,
    "psm3": psm3,
    "davinci_tool": tool,
    "wrist": wrist,
    "wam": wam,
    "panda": panda,
}


def data_folder() -> Path:
    """Find the recordings: CDM_PIN_DATA, else ./data, else shared/data beside the repository."""
    named = os.environ.get("CDM_PIN_DATA")
    for folder in [Path(named)] if named else [ROOT / "data", ROOT.parent / "shared" / "data"]:
        if (folder / "dvrk_psm_wpi").is_dir():
            return folder
    raise InputError("the public recordings are missing: run scripts/get_data.py, or set CDM_PIN_DATA")


def main(arguments: Sequence[str] | None = None) -> int:
    """Fit the robots asked for, default all; write the report only where all were."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robots", nargs="*", help=f"{', '.join(ROBOTS)}; default: all")
    parser.add_argument("--data", type=Path, help="folder of the recordings")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs", help="folder to write to; default docs")
    options = parser.parse_args(arguments)
    try:
        unknown = [name for name in options.robots if name not in ROBOTS]
        if unknown:
            raise InputError(f"unknown robot {unknown[0]!r}; known: {', '.join(ROBOTS)}")
        data = options.data or data_folder()
        chapters = []
        for name in options.robots or ROBOTS:
            chapters.append(ROBOTS[name](data))
            print(f"{chapters[-1].title}\n{table_text(chapters[-1])}\n", flush=True)
        if not options.robots:
            write_text(options.output / "real_robots.md", document(chapters))
            write_text(options.output / "real_robots.csv", csv_text(chapters))
            if options.output == ROOT / "docs":
                write_readme(chapters, ROOT / "README.md")
    except CdmError as exc:
        print(f"real_robots: {exc}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
