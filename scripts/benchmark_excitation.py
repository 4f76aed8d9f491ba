#!/usr/bin/env python3
"""Time the optimisers on the paper's problem (Table 2): objective evaluations a second and what they reach.

Best conditioning known before for these 13 parameters: 471 (the larger of both motors' matrices), 378 (stacked).
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from cdm_pin.excitation import plan
from cdm_pin.model import load_model
from cdm_pin.paper import FREQUENCY, HARMONICS, paper_condition, table_2

ROOT = Path(__file__).resolve().parent.parent
KNOWN = {False: 471.0, True: 378.0}


def main() -> None:
    """Print one line per optimiser, objective and seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2, help="how many seeds to try")
    parser.add_argument("--cycles", type=int, default=2000, help="of the bees and the adaptation")
    args = parser.parse_args()
    model = load_model(ROOT / "urdf" / "cdm2.yaml")
    limits = table_2(model)

    def run(optimiser, stacked, seed, cycles):
        start = time.perf_counter()
        found = plan(
            model,
            limits,
            paper_condition(stacked=stacked),
            harmonics=HARMONICS,
            zero_start=True,
            frequency=FREQUENCY,
            optimiser=optimiser,
            cycles=cycles,
            seed=seed,
        )
        return found, time.perf_counter() - start

    run("bees", False, 0, 2)
    run("bees", True, 0, 2)
    print(f"{'optimiser':12} {'matrix':8} seed  condition   to known  evaluations  seconds  evaluations/s")
    for stacked in (False, True):
        for optimiser, cycles in (("bees", args.cycles), ("adaptation", args.cycles), ("sequential", 250)):
            for seed in range(args.seeds):
                found, seconds = run(optimiser, stacked, seed, cycles)
                print(
                    f"{optimiser:12} {'stacked' if stacked else 'larger':8} {seed:4}  {found.value:9.2f}  "
                    f"{100 * (found.value / KNOWN[stacked] - 1):+8.2f} %  {found.evaluations:10}  {seconds:7.2f}  "
                    f"{found.evaluations / seconds:10.0f}"
                )


if __name__ == "__main__":
    main()
