#!/usr/bin/env python3
"""Time whole diagnoses: recordings in, findings out, the whole catalogue, start-up left out.

Arms, faults and recordings are drawn as in the proof. Every trial is diagnosed twice; the second time counts.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from blind_trial import published

from cdm_pin.diagnose import diagnose
from cdm_pin.files import write_text
from cdm_pin.model import load_model
from cdm_pin.plant.draw import draw
from cdm_pin.recording import load_recording

FAULTS = {"nothing missing": 0, "one effect": 1, "two effects": 2, "three effects": 3}
DURATIONS = (30.0, 60.0, 120.0, 240.0)


def seconds(folder: Path) -> float:
    """Diagnose the trial of a folder: how long that takes, once all is compiled [s]."""
    model = load_model(folder / "manipulator.yaml")
    runs, unseen = ([load_recording(path, model) for path in published(folder, kind)] for kind in ("run", "holdout"))
    for _ in range(2):
        begin = time.perf_counter()
        diagnose(model, runs, unseen)
    return time.perf_counter() - begin


def table(title: str, drawn: dict[str, list[Path]]) -> list[str]:
    """Time groups of trials and write one line per group."""
    lines = [f"| {title} | trials | median [s] | longest [s] |", "|---|---|---|---|"]
    taken = {name: [seconds(folder) for folder in folders] for name, folders in drawn.items()}
    if min(map(len, taken.values())) > 1:
        taken["all"] = [x for own in taken.values() for x in own]
    lines += [f"| {name} | {len(own)} | {statistics.median(own):.2f} | {max(own):.2f} |" for name, own in taken.items()]
    return [*lines, ""]


def main() -> None:
    """Draw, time and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=8, help="of each kind")
    parser.add_argument("--seed", type=int, default=1, help="of the first trial; the others follow")
    parser.add_argument("-o", "--output", type=Path, help="a page to write, beside the terminal")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:

        def write(seed: int, name: str, **settings) -> Path:
            folder = Path(place) / name
            folder.mkdir()
            draw(seed, n_links=3, **settings).write(folder)
            return folder

        seeds = range(args.seed, args.seed + args.trials)
        drawn = {
            name: [write(seed, f"{count}_{seed}", effects=count) for seed in seeds] for name, count in FAULTS.items()
        }
        long = {
            f"{t:.0f} s": [write(args.seed, f"long_{t:.0f}", effects=["coulomb_friction"], bits=17, duration=t)]
            for t in DURATIONS
        }
        text = [
            "# Time of a diagnosis",
            "",
            f"Written by `scripts/benchmark_diagnosis.py --trials {args.trials} --seed {args.seed}`: arms of three "
            "links as in the proof, 60 s at 200 Hz and as much unseen, the whole catalogue; one thread, start-up left "
            "out, nothing else running.",
            "",
            *table("what is missing", drawn),
            "The same arm with dry friction, recorded for longer:",
            "",
            *table("recording", long),
        ]
    page = "\n".join(text)
    print(page)
    if args.output:
        write_text(args.output, page)


if __name__ == "__main__":
    main()
