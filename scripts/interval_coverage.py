"""Say how often stated 90 % intervals hold the truth, on arms that an independent program simulates.

Usage: python scripts/interval_coverage.py [--seeds N] [--first K] [-o docs/interval_coverage.md]

Arms, motions, encoders and torque noise are drawn by `cdm_pin.plant.draw`, which shares no code with the
identification. Every arm is recorded once; its base parameters, and friction where it was drawn, are identified from
that recording, the masses of the file being wrong by up to a tenth.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from cdm_pin.completed import find_place
from cdm_pin.effects import CATALOGUE
from cdm_pin.files import write_text
from cdm_pin.identify import identify
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.model import CableModel, build_model
from cdm_pin.plant.draw import Trial, draw
from cdm_pin.recording import Recording
from cdm_pin.terms import Term

DOCS = Path(__file__).resolve().parent.parent / "docs"
LEVEL, QUANTILE = 0.90, 1.6448536269514722
FRICTION = ("viscous_friction", "coulomb_friction")


class Case(NamedTuple):
    """A kind of recordings: what is said of it, its torque noise, what is drawn into the arm, what is fitted too."""

    title: str
    noise: Literal["white", "coloured"]
    drawn: tuple[str, ...] = ()
    fitted: tuple[str, ...] = ()


CASES = (
    Case("white noise", "white"),
    Case("coloured noise with drift, offsets fitted", "coloured", (), ("torque_offset",)),
    Case("the same, viscous and Coulomb friction drawn and fitted", "coloured", FRICTION, ("torque_offset",)),
)


def main(argv: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=80, help="arms per case")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, default=DOCS / "interval_coverage.md")
    args = parser.parse_args(argv)
    seeds = range(args.first, args.first + args.seeds)
    found = {case: [deviations(seed, case) for seed in seeds] for case in CASES}
    write_text(args.output, document(found))
    print(args.output.read_text())


def deviations(seed: int, case: Case, **settings: Any) -> np.ndarray:
    """Give the errors of all identified values of one drawn arm, in their stated standard deviations."""
    settings = {"n_links": 2 + seed % 2, "duration": 30.0, "n_holdout": 0, "noise": case.noise} | settings
    trial = draw(seed, effects=case.drawn, **settings)
    model = build_model(parse_manipulator(trial.manipulator))
    drawn = [(effect, drawn_term(model, effect)) for effect in trial.truth["effects"]]
    result = identify(model, [recording_of(trial)], effects=[*(term for _, term in drawn), *case.fitted])
    truth = list(result.base.values(true_parameters(trial, model)))
    for fitted in result.terms:  # offsets have no truth: drift is a part of them
        values = [next(iter(effect["parameters"].values())) for effect, term in drawn if term == fitted]
        truth += values or [np.nan]
    z = (result.fit.values - truth) / result.std
    return z[result.reliable & np.isfinite(z)]


def drawn_term(model: CableModel, effect: dict[str, Any]) -> Term:
    """Give the term of the fit that is the effect drawn, at its place."""
    return Term(effect["effect"], find_place(model, CATALOGUE[effect["effect"]], effect["location"]))


def recording_of(trial: Trial) -> Recording:
    """Give the first recording of a trial."""
    log = dict(trial.recordings[0])
    time, channels = log.pop("time"), {}
    for name, x in log.items():
        channels.setdefault(name.rpartition("_")[0], []).append(x)
    return Recording(time, {name: np.column_stack(columns) for name, columns in channels.items()})


def true_parameters(trial: Trial, model: CableModel) -> np.ndarray:
    """Give the links' true parameters; what a rotor differs from the file's cannot be told from its link's inertia."""
    parameters = []
    rotors = trial.truth["rotor_inertia"] or np.zeros(model.n_motors)
    more = (np.array(rotors) - model.rotor_inertia) / trial.truth["pulley_ratio"] ** 2
    for link, rotor in zip(trial.truth["links"], more, strict=True):
        m, (x, y, _) = link["mass"], link["center_of_mass"]
        parameters += [m, m * x, m * y, 0, 0, 0, 0, 0, 0, link["inertia_zz"] + m * (x**2 + y**2) + rotor]
    return np.array(parameters)


def document(found: dict[Case, list[np.ndarray]]) -> str:
    """Write the table."""
    lines = [
        "# Do stated intervals hold the truth?",
        "",
        f"Written by `scripts/interval_coverage.py`. {len(next(iter(found.values())))} arms per line, each with "
        "lengths, masses, motion, servo, encoders (14 or 17 bits, at joints, motors or both) and jitter of the "
        "sampling instants of its own, simulated by `cdm_pin.plant`, which shares no code with the identification; one "
        "recording of 30 s at 200 Hz each. Torque noise is 0.1 to 0.3 % of the arm's scale: white, or an "
        "autoregression of coefficient 0.5 to 0.9 plus a drift slower than 25 s. A stated "
        f"{100 * LEVEL:.0f} % interval should hold the truth in {100 * LEVEL:.0f} % of all values.",
        "",
        "| recordings | values | hold the truth | median error [std] |",
        "|---|---|---|---|",
    ]
    for case, parts in found.items():
        z = np.abs(np.concatenate(parts))
        share = 100 * np.mean(z < QUANTILE)
        lines.append(f"| {case.title} | {len(z)} | {share:.1f} % | {np.median(z):.2f} (0.67 expected) |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
