"""Hide one known piece of physics of a real robot and see whether `cdm-pin diagnose` puts it back.

Usage: scripts/real_recover.py [psm] [mtm] [strokes] [payload] [-o docs]

The robot's file is completed with what `cdm-pin diagnose` found, then one entry is taken out again and the command is
asked what is missing. Writes docs/real_recovery.md and docs/real_recovery.csv. The recordings are where CDM_PIN_DATA
says or scripts/get_data.py puts them.
"""

from __future__ import annotations

import argparse
import csv
import io
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from real_diagnoses import CASES, REAL, ROOT, Case, parts
from real_diagnoses import recording as read

from cdm_pin.base import base_parameters, massive_columns
from cdm_pin.completed import added_torque, effect_candidates
from cdm_pin.console import output
from cdm_pin.diagnose import Diagnosis, diagnose
from cdm_pin.errors import CdmError
from cdm_pin.everywhere import kinds_first
from cdm_pin.files import write_text
from cdm_pin.model import CableModel, load_model
from cdm_pin.problem import make_problem
from cdm_pin.recording import Recording
from cdm_pin.search import Search
from cdm_pin.settings import Settings
from cdm_pin.wording import candidate

HEAD = ("robot", "hidden", "size hidden", "said", "place", "size found", "verdict", "outcome")


@dataclass(frozen=True)
class Piece:
    """A published piece of physics: a kind of effect on some of the motors.

    Attributes
    ----------
    title : str
    effects : tuple of str
        Names that say it.
    motors : tuple of int
        It acts on these and on no others.
    size : str
        The parameter that tells how large it is.
    """

    title: str
    effects: tuple[str, ...]
    motors: tuple[int, ...]
    size: str


RUBBING = ("hysteresis", "coulomb_friction")
PIECES = {
    "psm": (
        Piece("spring at roll", ("joint_spring",), (4,), "stiffness"),
        Piece("cable coupling of the wrist", RUBBING, (5, 6), "limit"),
        Piece("friction of the fingers on each other", RUBBING, (6, 7), "limit"),
        Piece("rotor inertia of motor 6", ("rotor_inertia",), (6,), "inertia"),
        Piece("rotor inertia of motor 7", ("rotor_inertia",), (7,), "inertia"),
        Piece("friction of the insertion axis", RUBBING, (3,), "coulomb"),
    ),
    "mtm": (
        Piece("torque of the electrical cable", ("torque_ripple", "joint_spring"), (5,), "amplitude"),
        Piece("spring of the platform", ("joint_spring",), (2, 3, 4), "stiffness"),
        Piece("friction of the last wrist joint", RUBBING, (7,), "coulomb"),
    ),
}


def weights(model: CableModel, entry: dict[str, Any]) -> np.ndarray:
    """Give how an entry of a model file acts on the motors, shape (n_motors,)."""
    manipulator = replace(model.manipulator, effects=(entry,))
    place = effect_candidates(replace(model, manipulator=manipulator))[0][0].place
    return np.abs(place.weights(model)) if place.A else np.zeros(model.n_motors)


def is_piece(model: CableModel, entry: dict[str, Any], piece: Piece) -> bool:
    """Whether an entry of a model file is (part of) a piece."""
    if entry["effect"] not in piece.effects:
        return False
    moved = set((np.flatnonzero(weights(model, entry) > 1e-9) + 1).tolist())
    return moved == set(piece.motors)


def size(entries: Sequence[dict[str, Any]], piece: Piece) -> float:
    """Add up the size of entries: friction levels, stiffness, inertia, amplitude."""
    total = 0.0
    for entry in entries:
        values = entry["parameters"]
        for name in (piece.size, "coulomb", "limit", "stiffness"):
            if name in values and not (name == "stiffness" and entry["effect"] == "hysteresis"):
                value = values[name]
                total += float(value["value"] if isinstance(value, dict) else value)
                break
    return total


def hide(model: CableModel, entries: Sequence[dict[str, Any]]) -> CableModel:
    """Give the model whose file says these effects."""
    return replace(model, manipulator=replace(model.manipulator, effects=tuple(entries)))


def recover(case: Case, model: CableModel, runs: Sequence[Recording], unseen: Sequence[Recording]) -> list[list[str]]:
    """Complete a robot, hide its pieces one by one, diagnose again."""
    full = diagnose(model, runs, unseen)
    entries = full.manipulator.effects
    rows = []
    for piece in PIECES[case.robot]:
        hidden = [e for e in entries if is_piece(model, e, piece)]
        if not hidden:
            rows.append([case.robot, piece.title, "", "", "", "", "", "not in the completed model"])
            continue
        output().print(f"{case.robot}: {piece.title}")
        again = diagnose(hide(model, [e for e in entries if e not in hidden]), runs, unseen)
        rows.append([case.robot, piece.title, f"{size(hidden, piece):.3g}", *answer(model, again, piece)])
        output().print("  " + "; ".join(rows[-1]))
    return rows


def answer(model: CableModel, again: Diagnosis, piece: Piece) -> list[str]:
    """Compare what was said with what was hidden: effect, place, size, verdict, outcome."""
    said = again.content["findings"]
    same = [e for e in said if is_piece(model, e, piece)]
    verdict = again.content["verdict"]
    if same:
        outcome = "found" if same[0] in said[: len(same) + 1] else "found, not first"
        others = len(said) - len(same)
        outcome += f"; {others} more" if others else ""
        return [same[0]["effect"], candidate(same[0]), f"{size(same, piece):.3g}", verdict, outcome]
    near = [e for e in said if set((np.flatnonzero(weights(model, e) > 1e-9) + 1).tolist()) & set(piece.motors)]
    if near:
        return [near[0]["effect"], candidate(near[0]), "", verdict, "called something else"]
    left = again.content["unexplained"]
    if left:
        return ["", left["region"], "", verdict, "not named"]
    return ["", "", "", verdict, "not found"]


def payload() -> list[list[str]]:
    """Estimate a mass of 105 g from its run beside one without, and what the drift of a session passes for."""
    case = CASES[0]
    model = load_model(REAL / f"{case.robot}.yaml")
    names = {
        "105 g on the carriage": "one_1.0_scale_105_grams_insertion.csv.gz",
        "105 g on the parallelogram": "one_1.0_scale_105_grams_parallel.csv.gz",
        "nothing, another session": "one_results.csv.gz",
    }
    without = "one_no_weight_results.csv.gz"
    with tempfile.TemporaryDirectory() as folder:
        runs = {name: read(case, name, model, Path(folder)) for name in (*names.values(), without)}
    base = base_parameters(model, columns=massive_columns(model))
    effects = kinds_first(Search(make_problem(model, [runs[without]]), base, Settings()))
    links = {"105 g on the carriage": "carriage", "105 g on the parallelogram": "parallelogram"}
    rows = []
    for title, name in names.items():
        problem = make_problem(model, [runs[without], runs[name]])
        search = Search(problem, base, Settings())
        for link in [links[title]] if title in links else list(links.values()):
            rows.append(
                [
                    "psm",
                    title,
                    "0.105" if title in links else "0",
                    "mass",
                    f"{link} frame",
                    *_mass(search, effects, model, link),
                ]
            )
    return rows


def _mass(search: Search, effects: Sequence[Any], model: CableModel, link: str) -> list[str]:
    """Fit a point mass at a link's frame, held in the second run only."""
    k = 10 * model.joints.index(f"{link}_joint")
    offsets = [c for c in search.common if c.effect.name == "torque_offset"]
    effects = [*effects, *(c for c in offsets if c.key not in {e.key for e in effects})]
    whitener = search.noise(effects)
    own = [search.columns(c) for c in effects]
    banks = []
    for r, rigid in enumerate(search.rigid):
        held = search.problem.rigid[r][k : k + 1] * (r == 1)
        parts = [rigid, *[x[r] for x in own], held, search.nominal[r][None]]
        banks.append(np.concatenate(parts))
    W = search.white(whitener, banks)
    A, b = W[:-1].T, W[-1]
    scale = np.linalg.norm(A, axis=0)
    scale[scale == 0] = np.inf
    theta = np.linalg.lstsq(A / scale, b, rcond=1e-9)[0] / scale
    covariance = np.linalg.pinv((A / scale).T @ (A / scale), rcond=1e-9, hermitian=True)
    std = float(np.sqrt(covariance[-1, -1]) / scale[-1])
    return [f"{theta[-1]:.3g} ± {std:.2g} kg", "", ""]


def strokes() -> list[list[str]]:
    """Compare the friction of the insertion axis with the force at constant speeds.

    Both as half the difference between the two directions.
    """
    case = CASES[1]
    model = load_model(REAL / f"{case.robot}.yaml")
    with tempfile.TemporaryDirectory() as folder:
        tests = [read(case, f"psm1_frtest{sign}_results.csv.gz", model, Path(folder)) for sign in ("", "_neg")]
    tests = [replace(test, time=2 * test.time) for test in tests]  # logged at half the rate of the others
    found = diagnose(model, *parts(case, model))
    entries = [e for e in found.manipulator.effects if abs(weights(model, e)) @ np.eye(3)[2] > 0]
    rub = [e for e in entries if e["effect"] in RUBBING or "friction" in e["effect"]]
    motions = make_problem(model, tests).motions
    modelled = [added_torque(motion.with_model(hide(model, rub)))[:, 2] for motion in motions]
    speed = np.concatenate([motion.v_m[:, 2] for motion in motions])
    logged = [
        np.interp(m.time, t.time - t.time[0], t.channels["motor_torque"][:, 2])
        for m, t in zip(motions, tests, strict=True)
    ]

    def level(force: Sequence[np.ndarray]) -> float:
        f = np.concatenate(force)
        slow = (np.abs(speed) > 0.005) & (np.abs(speed) < 0.03)
        return 0.5 * float(np.mean(f[slow & (speed > 0)]) - np.mean(f[slow & (speed < 0)]))

    said = "; ".join(dict.fromkeys(e["effect"] for e in rub))
    size, verdict = f"{level(modelled):.3g} N", found.content["verdict"]
    title = "friction of the insertion axis at constant speeds, 5 to 30 mm/s"
    return [["psm3", title, f"{level(logged):.3g} N", said, "joint 7", size, verdict, "compared"]]


PARTS = ("psm", "mtm", "strokes", "payload")


def _part(name: str) -> list[list[str]]:
    """Compute the rows of one part."""
    if name in ("strokes", "payload"):
        return strokes() if name == "strokes" else payload()
    case = {c.robot: c for c in CASES if c.robot in PIECES}[name]
    model = load_model(REAL / f"{case.robot}.yaml")
    return recover(case, model, *parts(case, model))


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the document and the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", default=str(ROOT / "docs"))
    parser.add_argument("parts", nargs="*", metavar="PART", help="which of them; the rows of the others stay")
    args = parser.parse_args(arguments)
    path = Path(args.output) / "real_recovery.csv"
    known: dict[str, list[list[str]]] = {}
    if path.exists():
        for part, *row in list(csv.reader(path.open(encoding="utf-8")))[1:]:
            known.setdefault(part, []).append(row)
    try:
        for part in args.parts or PARTS:
            known[part] = _part(part)
    except KeyError as exc:
        print(f"real_recover: unknown part {exc}; known: {', '.join(PARTS)}", file=sys.stderr)
        return 2
    except CdmError as exc:
        print(f"real_recover: {exc}", file=sys.stderr)
        return 2
    rows = [[part, *row] for part in PARTS for row in known.get(part, [])]
    table = io.StringIO()
    csv.writer(table, lineterminator="\n").writerows([["part", *HEAD], *rows])
    write_text(path, table.getvalue())
    lines = ["| " + " | ".join(row) + " |" for row in [HEAD, ["---"] * len(HEAD), *(row[1:] for row in rows)]]
    write_text(Path(args.output) / "real_recovery.md", "\n".join([*TEXT, *lines, ""]))
    return 0


TEXT = (
    "# Hidden and found again: real robots",
    "",
    "Written by `scripts/real_recover.py`. The robot's file is completed by `cdm-pin diagnose`; one published piece of",
    "physics is taken out of it again, all its entries at once, and the command is asked what is missing. Sizes are",
    "those of the completed file and of what was found: stiffness in N m/rad, friction in N m or N (levels of dry",
    "friction and limits of hysteresis added up), inertia in kg m^2, amplitude in N m. Masses are fitted in a run with",
    "a payload beside one without, all else equal; a run of another session shows what drift passes for.",
    "",
)


if __name__ == "__main__":
    sys.exit(main())
