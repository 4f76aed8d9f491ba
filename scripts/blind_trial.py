#!/usr/bin/env python3
"""One blind trial: an independent plant conceals something, the tool says what, and only then is the seal opened.

Three processes, in folders of their own:

1. the plant draws arm, trajectories, noise and faults from a seed, publishes recordings, a manipulator file with wrong
   masses and the SHA-256 of the truth, and keeps the truth (with a random salt, so that nothing can be guessed from
   the hash);
2. ``cdm-pin diagnose`` gets the published files and nothing else;
3. the seal is checked against the published hash, opened, and the diagnosis scored.

Usage: scripts/blind_trial.py [--seed N | --commit HASH] [--plant absolute|mujoco] [--effects NAME ... | --count K]
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import secrets
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from cdm_pin.console import output, table
from cdm_pin.errors import CdmError, InputError
from cdm_pin.files import write_text
from cdm_pin.plant.draw import draw
from cdm_pin.plant.oracle import Oracle
from cdm_pin.scoring import Score, describe, describe_sizes, score
from cdm_pin.wording import sentence

SAY = output().print


def seed_from_commit(commit: str, index: int | str = 0) -> int:
    """Derive a seed from a commit hash (or any word), so that it could not have been chosen."""
    return int.from_bytes(hashlib.sha256(f"{commit}:{index}".encode()).digest()[:6], "big")


def conceal(folder: Path, seed: int, settings: dict[str, Any]) -> None:
    """Draw a trial, publish what may be seen and the hash of what may not."""
    trial = draw(seed, **settings)
    paths = trial.write(folder / "published")
    paths["truth"].unlink()
    sealed = json.dumps({"salt": secrets.token_hex(16), "settings": settings, "truth": trial.truth})
    (folder / "sealed").mkdir(mode=0o700, exist_ok=True)
    write_text(folder / "sealed" / "truth.json", sealed)
    write_text(folder / "published" / "truth.sha256", hashlib.sha256(sealed.encode()).hexdigest() + "\n")


def published(folder: Path, kind: str) -> list[Path]:
    """List the recordings of one kind ("run" or "holdout"), by their conditions where these are stated."""
    paths = sorted(folder.glob(f"{kind}_*.csv"))
    return [own if (own := path.with_suffix(".yaml")).exists() else path for path in paths]


def diagnose(folder: Path) -> dict[str, Any]:
    """Run the command on the published files, in a process that is told of nothing else."""
    seen = folder / "published"
    runs = [path.name for path in published(seen, "run")]
    holdouts = [word for path in published(seen, "holdout") for word in ("--holdout", path.name)]
    command = [sys.executable, "-m", "cdm_pin.cli", "diagnose", "manipulator.yaml", *runs, *holdouts]
    result = folder / "diagnosis"
    subprocess.run([*command, "-o", str(result.resolve()), "--quiet"], cwd=seen, check=True)
    return json.loads((result / "diagnosis.json").read_text(encoding="utf-8"))


def open_seal(folder: Path) -> dict[str, Any]:
    """Check the sealed truth against the hash published before, and read it.

    Raises
    ------
    InputError
        If the truth is not the one that was sealed.
    """
    path = folder / "sealed" / "truth.json"
    sealed = path.read_text(encoding="utf-8")
    if hashlib.sha256(sealed.encode()).hexdigest() != (folder / "published" / "truth.sha256").read_text().strip():
        raise InputError("is not what was sealed: its SHA-256 differs from the published one", source=path)
    return json.loads(sealed)


def likeness(sealed: dict[str, Any]) -> Callable[[int, Mapping[str, Any]], float]:
    """Give the oracle's judgement whether a fault could pass for another; the trial is drawn again when it is asked."""
    oracles: list[Oracle] = []

    def judge(index: int, rival: Mapping[str, Any]) -> float:
        if not oracles:
            oracles.append(Oracle(draw(sealed["truth"]["seed"], **sealed["settings"]).scene))
        return oracles[0].likeness(index, rival)

    return judge


def tell(truth: dict[str, Any], result: Score) -> None:
    """Print truth and score side by side."""
    named = [e for e in truth["effects"] if e["in_catalogue"]]
    meetings = dict(zip((id(e) for e in named), result.meetings, strict=True))
    rows = [
        [
            effect["effect"],
            describe(effect["location"]),
            describe_sizes(effect["parameters"]),
            effect["visibility"],
            meetings.get(id(effect), "no name to give"),
        ]
        for effect in truth["effects"]
    ]
    SAY(table("What was concealed", ["effect", "where", "size", "visibility", "found"], rows) if rows else "Nothing.")
    for p in result.parameters:
        SAY(f"  {p.name} {p.value:.4g} +- {1.96 * p.std:.2g}, true {p.true:.4g}{'' if p.inside else ' (outside)'}")
    for finding in result.false_findings:
        SAY(f"  false: {finding}")
    if result.unexplained_right is not None:
        right = "yes" if result.unexplained_right else "no"
        SAY(f"  said to be unexplained, at the right joint, or named as what it is the same as here: {right}")
    if result.holdout_over_floor:
        SAY(f"  torque error on the unseen run: {result.holdout_over_floor:.2f} times the noise floor")
    SAY("All right." if result.all_right else "Not all right.")


def trial(folder: Path, seed: int, settings: dict[str, Any]) -> Score:
    """Run all three parts in `folder`, saying what happens."""
    told = json.dumps({"folder": str(folder), "seed": seed, "settings": settings})
    subprocess.run([sys.executable, __file__, "--conceal", told], check=True)
    SAY(f"Seed {seed}. Published in {folder / 'published'}; the truth is sealed, SHA-256")
    SAY(f"  {(folder / 'published' / 'truth.sha256').read_text().strip()}\n")
    diagnosis = diagnose(folder)
    SAY(f"The tool says: {sentence(diagnosis)}\n")
    sealed = open_seal(folder)
    SAY("The seal is opened; its hash agrees.")
    result = score(sealed["truth"], diagnosis, likeness(sealed))
    tell(sealed["truth"], result)
    write_text(folder / "score.json", json.dumps(result.as_dict(), indent=1) + "\n")
    return result


def add_trial_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what says how a trial is drawn; what is left out is drawn too."""
    parser.add_argument("--plant", choices=("absolute", "mujoco"), default="absolute")
    parser.add_argument("--effects", nargs="*", metavar="NAME", help="conceal these (default: drawn)")
    parser.add_argument("--count", type=int, default=1, help="how many effects to draw; 0: nothing is wrong")
    parser.add_argument("--links", type=int, help="2..6")
    parser.add_argument("--size", choices=("plain", "quarter"), default="plain")
    parser.add_argument("--visibility", type=float, help="scale the effect to this visibility")
    parser.add_argument("--at-least", type=float, default=0.0, help="draw until every effect is this visible")
    parser.add_argument("--strange", action="store_true", help="conceal something that no catalogue has")
    parser.add_argument("--positions", choices=("joint", "motor", "both"))
    parser.add_argument("--bits", type=int, choices=(14, 17), help="of the encoders")
    parser.add_argument("--noise", choices=("white", "coloured"))
    parser.add_argument("--motion", choices=("loop", "prescribed", "moves"))
    parser.add_argument("--duration", type=float, default=60.0, help="of each recording [s]")
    parser.add_argument("--recordings", type=int, default=1, help="to learn from")
    parser.add_argument("--vary", nargs="*", choices=("pretension", "payload"), default=[], help="between recordings")


def trial_settings(args: argparse.Namespace) -> dict[str, Any]:
    """Give the settings of `cdm_pin.plant.draw.draw` that arguments ask for."""
    return {
        "effects": args.effects if args.effects is not None else args.count,
        "plant": args.plant,
        "n_links": args.links,
        "size": args.size,
        "visibility": args.visibility,
        "at_least": args.at_least,
        "out_of_catalogue": args.strange,
        "positions": args.positions,
        "bits": args.bits,
        "noise": args.noise,
        "motion": args.motion,
        "duration": args.duration,
        "n_recordings": args.recordings,
        "conditions": args.vary,
    }


def main(argv: list[str] | None = None) -> int:
    """Parse arguments and run one trial; 0 whatever the tool found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, help="default: at random")
    parser.add_argument("--commit", metavar="HASH", help="derive the seed from this commit hash instead")
    parser.add_argument("--index", default="0", help="which of the seeds derived from the commit")
    add_trial_arguments(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="keep everything here (default: thrown away)")
    parser.add_argument("--conceal", help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.conceal:
        told = json.loads(args.conceal)
        conceal(Path(told["folder"]), told["seed"], told["settings"])
        return 0
    seed = args.seed if args.seed is not None else secrets.randbits(32)
    if args.commit:
        seed = seed_from_commit(args.commit, args.index)
    settings = trial_settings(args)
    try:
        if args.output:
            args.output.mkdir(parents=True, exist_ok=True)
            trial(args.output, seed, settings)
        else:
            with tempfile.TemporaryDirectory() as folder:
                trial(Path(folder), seed, settings)
    except CdmError as exc:
        print(f"blind_trial: {exc}", file=sys.stderr)
        return 2
    except subprocess.CalledProcessError as exc:
        return exc.returncode
    return 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
