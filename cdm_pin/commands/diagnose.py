"""``cdm-pin diagnose``: recordings and a model to diagnosis.json, report.html and the completed model.yaml."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..console import emit, plain, table
from ..files import whole_folder
from ..manipulator import save_manipulator
from ..model import load_model
from ..recording import Recording, load_recording, save_recording
from ..wording import place, quantity, sentence

if TYPE_CHECKING:
    from ..diagnose import Diagnosis

GHOSTS = "ghosts.html"
NEXT = "next.csv"
WINDOWS = 20  # that the ghosts play


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    from ..viewer import add_view_arguments

    parser.add_argument("manipulator", help="manipulator.yaml or model.yaml")
    parser.add_argument("recordings", nargs="+", metavar="recording", help="recordings to learn from")
    parser.add_argument("--holdout", action="append", default=[], metavar="RECORDING", help="a recording to judge on")
    parser.add_argument("-o", "--output", required=True, metavar="DIR", help="output folder")
    add_view_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the command."""
    from ..diagnose import diagnose
    from ..gather import gather
    from ..report import write_report
    from ..viewer import watch

    model = load_model(args.manipulator)
    recordings = [load_recording(path, model) for path in args.recordings]
    holdout = [load_recording(path, model) for path in args.holdout]
    with watch(args, model, recordings) as watching:
        with watching.progress() as progress:
            result = diagnose(model, recordings, holdout, progress=progress)
        content = plain(result.content)
        watching.tell(content)
        with whole_folder(args.output) as folder:
            (folder / "diagnosis.json").write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n")
            save_manipulator(result.manipulator, folder / "model.yaml", Path(args.output))
            if result.experiment is not None:
                planned = result.experiment
                save_recording(Recording(planned.motion.time, planned.channels), folder / NEXT)
            evidence = gather(result)
            if result.replays:
                _write_ghosts(folder / GHOSTS, result)
                evidence = replace(evidence, animation=GHOSTS)
            write_report(folder / "report.html", content, evidence, result.model)
        emit(args, content, *_shown(content, args.output))
    return 0


def _write_ghosts(path: Path, result: Diagnosis) -> None:
    """Save recorded and simulated motion side by side."""
    from ..animation import write_ghosts

    replay = result.replays[0]
    write_ghosts(path, result.model, *replay.stretch(WINDOWS), restart=replay.horizon)


def _shown(content: dict[str, Any], output: str) -> list[Any]:
    """Put a diagnosis into words and a table."""
    rows = [
        [
            item["effect"],
            _place(item["location"]),
            ", ".join(f"{name} {quantity(p)}" for name, p in item["parameters"].items()),
            item["evidence"]["delta_bic"],
            "; ".join(f"{o['effect']} {_place(o['location'])}" for o in item["indistinguishable_from"]),
        ]
        for item in content["findings"]
    ]
    header = ["effect", "where", "size", "delta BIC", "cannot be told from"]
    shown = [table("Findings", header, rows)] if rows else []
    files = ["diagnosis.json", "report.html", *([GHOSTS] if content["fit"]["simulated_position"] else []), "model.yaml"]
    files += [NEXT] if content["next_experiment"] else []
    return [sentence(content), *shown, f"Written: {output}/{', '.join(files)}"]


def _place(location: dict) -> str:
    if location["kind"] == "combination":
        return f"motors by {location['weights']}"
    return place(location)
