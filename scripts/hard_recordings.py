"""Diagnose arms with nothing or one thing missing, recorded under hard conditions; write docs/hard_recordings.md.

Usage: scripts/hard_recordings.py [--trials N] [--seed WORD] [--jobs K] [-o docs/hard_recordings.md]

Joints follow prescribed motions, Pinocchio's RNEA gives the torques, and nothing of `cdm_pin.plant` is used. Every
other trial conceals nothing; every condition is drawn as often as any other of its kind.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from blind_trial import seed_from_commit
from hard_draw import CONDITIONS, DELAY, EFFECTS, draw
from rich.progress import track

from cdm_pin.console import output, plain
from cdm_pin.diagnose import diagnose
from cdm_pin.files import write_text
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.model import build_model
from cdm_pin.scoring import describe, score

ROOT = Path(__file__).resolve().parent.parent
UNITS = {"arm": " links", "encoder": " bits", "encoders": " encoders", "rate": " Hz", "duration": " s"}


class Outcome(NamedTuple):
    """What was concealed under what condition, what was said, and how the two meet."""

    condition: dict[str, Any]
    effect: str | None
    verdict: str
    meeting: str
    false: int
    told: str


def main(argv: Sequence[str] | None = None) -> int:
    """Run the trials and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--seed", default="hard", metavar="WORD", help="what everything drawn follows from")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "hard_recordings.md")
    args = parser.parse_args(argv)
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
        told = pool.map(partial(trial, args.seed), range(args.trials))
        outcomes = list(track(told, total=args.trials, console=output(stderr=True)))
    write_text(args.output, document(outcomes, args.trials, args.seed))
    output().print(f"Written: {args.output}")
    return 0


def trial(word: str, index: int) -> Outcome:
    """Draw one trial, diagnose it and score what is said; a diagnosis that raises is an outcome as well."""
    rng = np.random.default_rng(seed_from_commit(word, index))
    condition = {kind: _dealt(f"{word}:{kind}:{index % 2}", index // 2, values) for kind, values in CONDITIONS.items()}
    effect = str(_dealt(f"{word}:effect", index // 2, tuple(EFFECTS))) if index % 2 else None
    manipulator, recordings, truth = draw(rng, condition, effect)
    model = build_model(parse_manipulator(manipulator))
    hidden = [f"{e['effect']} at {describe(e['location'])}" for e in truth["effects"]] or ["nothing"]
    try:
        content = plain(diagnose(model, recordings[:1], recordings[1:]).content)
    except Exception as exc:  # stays in the table
        return Outcome(condition, effect, "failed", "missed", 0, f"{hidden[0]} | {type(exc).__name__}")
    result, verdict = score(truth, content), content["verdict"]
    said = [f"{f['effect']} at {describe(f['location'])}" for f in content["findings"]]
    said += [f"something at {describe(x['location'])}"] if (x := content["unexplained"]) else []
    meeting = result.meetings[0] if effect else ""
    if meeting == "missed" and verdict == "unexplained":
        meeting = verdict
    meeting = "class" if meeting == "rigid_body" else meeting
    told = f"{hidden[0]} | {', '.join(said) or '-'}"
    return Outcome(condition, effect, verdict, meeting, len(result.false_findings), told)


def _dealt(word: str, k: int, values: tuple[Any, ...]) -> Any:
    """Give entry `k` of one shuffled pack of the values after another."""
    around, j = divmod(k, len(values))
    return values[np.random.default_rng(seed_from_commit(word, around)).permutation(len(values))[j]]


def document(outcomes: Sequence[Outcome], trials: int, word: str) -> str:
    """Write the page."""
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True)
    lines = [
        "# Hard recordings",
        "",
        f"Written by `scripts/hard_recordings.py --trials {trials} --seed {word}` at `{commit.stdout.strip()}`. "
        "Conditions are harder than those of [the proof](proof.md): people's and robots' jerky or very slow motions, "
        "joints that never move, encoders down to 12 bits that may round down, torque noise of many colours, sampling "
        "instants off by up to a fifth of a step, recordings as short as 15 s. Motions are prescribed and Pinocchio "
        "gives the torques; some arms have twisted axes. One recording is learned from, one is "
        "unseen, and masses in the file are wrong by up to a tenth. Effects are 5 to 12 % of the largest torque, "
        f"whether that can be seen or not; delays are {1000 * DELAY:g} ms. *Alarms*: anything said about an arm from "
        "which nothing is missing. *Right*: name and place; *class*: listed among what cannot be told apart; "
        "*unexplained*: not named, but something was said to be missing.",
    ]
    for kind in ("all", *CONDITIONS, "effect"):
        lines += ["", f"| {kind} | nothing missing | alarms | one effect | right | class | unexplained | missed | "
                  "false names |", "|---|---|---|---|---|---|---|---|---|"]  # fmt: skip
        for value in {"all": ("all",), "effect": tuple(EFFECTS)}.get(kind) or tuple(dict.fromkeys(CONDITIONS[kind])):
            own = [o for o in outcomes if {"effect": o.effect, "all": "all", **o.condition}[kind] == value]
            lines.append(_row(f"{value}{UNITS.get(kind, '')}", own))
    lines += ["", "## Every trial", "", "| condition | concealed | said |", "|---|---|---|"]
    for o in outcomes:
        told = ", ".join(f"{value}{UNITS.get(kind, '')}" for kind, value in o.condition.items())
        lines.append(f"| {told} | {o.told} |")
    return "\n".join(lines) + "\n"


def _row(title: str, outcomes: Sequence[Outcome]) -> str:
    clean, hidden = ([o for o in outcomes if bool(o.effect) == full] for full in (False, True))
    alarms = sum(o.verdict not in ("consistent", "insufficient_data") for o in clean)
    met = [sum(o.meeting == kind for o in hidden) for kind in ("exact", "class", "unexplained", "missed")]
    counts = (len(clean), alarms, len(hidden), *met, sum(o.false for o in hidden))
    return f"| {title} | {' | '.join(map(str, counts))} |"


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(main())
