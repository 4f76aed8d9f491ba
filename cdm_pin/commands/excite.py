"""``cdm-pin excite``: plan a safe, informative excitation trajectory."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import get_args

import numpy as np

from ..base import base_parameters
from ..console import emit, notice, plain, progress_bar, table
from ..dynamics import motor_torques
from ..errors import InputError
from ..excitation import Design, Excitation, Optimiser, at_rest, plan
from ..files import whole_file
from ..limits import (
    DEFAULT_ACCELERATION,
    DEFAULT_VELOCITY,
    InfeasibleLimits,
    Limits,
    default_limits,
    load_limits,
    usage,
)
from ..model import CableModel, load_model
from ..objectives import ObjectiveName, make_objective, predicted_errors
from ..recording import Recording, save_recording
from ..units import either, joint_units

INTERRUPTED = 130
NOISE_SHARE = 0.01  # of the root mean square motor torque


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("manipulator", help="manipulator.yaml or model.yaml")
    parser.add_argument("-o", "--output", required=True, help="trajectory to write, in recording format (.csv, ...)")
    parser.add_argument("--limits", help="limits.yaml; default: the mechanism's, with moderate speeds")
    parser.add_argument("--objective", default="d_optimal", choices=get_args(ObjectiveName))
    parser.add_argument("--optimiser", default="sequential", choices=get_args(Optimiser))
    parser.add_argument("--harmonics", type=int, default=5, help="free harmonics per joint (default 5)")
    parser.add_argument("--zero-start", action="store_true", help="centre at zero and start there, eq. (47)")
    parser.add_argument("--duration", type=float, default=60.0, help="of the whole trajectory [s] (default 60)")
    parser.add_argument("--frequency", type=float, nargs=2, metavar=("LOW", "HIGH"), help="base frequency [rad/s]")
    parser.add_argument("--rate", type=float, default=100.0, help="samples per second of the output (default 100)")
    parser.add_argument("--cycles", type=int, help="of the optimiser (default: its own)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--torque-noise",
        type=float,
        nargs="+",
        help="standard deviation per motor, or one for all [N m] (default 1 %% of the torques' root mean square)",
    )
    parser.add_argument("--figure", help="also draw the objective over the cycles (.png, .svg)")


def run(args: argparse.Namespace) -> int:
    """Plan, and write trajectory and design; 130 if it was interrupted (the best so far is written)."""
    model = load_model(args.manipulator)
    limits = load_limits(args.limits, model) if args.limits else default_limits(model)
    if not 0 < args.rate < np.inf:
        raise InputError(f"a rate above 0 samples/s was expected, found {args.rate:g}")
    if args.seed < 0:
        raise InputError(f"a whole number from 0 on was expected, found {args.seed}", place="--seed")
    noise = _noise(args.torque_noise, model)
    output = Path(args.output)
    with whole_file(output.with_name(output.name.split(".")[0] + ".design.json")) as sidecar:
        base = base_parameters(model)
        with progress_bar(args, delay=2.0) as progress:
            design, excitation = _planned(args, model, limits, base, 1.0 if noise is None else noise, progress)
        time, q, v, a = excitation.sample(args.rate)
        if noise is None:
            noise = np.full(model.n_motors, NOISE_SHARE * np.sqrt(np.mean(motor_torques(model, q, v, a) ** 2)))
        errors = predicted_errors(model, q, v, a, noise=noise, base=base)
        shares = usage(model, limits, q, v, a)
        result = _content(args, limits, design, excitation, noise, errors, shares)
        sidecar.write_text(json.dumps(plain(result), indent=2) + "\n", encoding="utf-8")
        save_recording(_recording(time, q, v, a, model, design), output)
    if args.figure:
        _draw(design, args.objective, args.figure)
    if not args.limits:
        unit = either(joint_units(model))
        moderate = f"{DEFAULT_VELOCITY:g} {unit} per s and {DEFAULT_ACCELERATION:g} {unit} per s^2"
        notice(args, f"no limits given; used: the mechanism's with a margin, {moderate}")
    emit(args, result, *_tables(args, design, excitation, errors, shares))
    unseen = [error.name for error in errors if not np.isfinite(error.std)]
    if unseen:
        notice(args, f"this motion does not show {', '.join(unseen)}: give it more time or wider limits")
    if design.interrupted:
        notice(args, f"interrupted: {output} holds the best trajectory found until then")
    return INTERRUPTED if design.interrupted else 0


def _planned(args, model: CableModel, limits: Limits, base, noise, progress) -> tuple[Design, Excitation]:
    """Search, and lead in and out; what the limits forbid is said of their file."""
    try:
        design = plan(
            model,
            limits,
            make_objective(args.objective, model, base=base, noise=noise),
            harmonics=args.harmonics,
            zero_start=args.zero_start,
            duration=args.duration,
            frequency=tuple(args.frequency) if args.frequency else None,
            optimiser=args.optimiser,
            cycles=args.cycles,
            seed=args.seed,
            progress=progress,
        )
        return design, at_rest(model, limits, design.series, duration=args.duration)
    except InfeasibleLimits as exc:
        raise InputError(exc.message, source=args.limits or args.manipulator) from None


def _noise(values: list[float] | None, model: CableModel) -> np.ndarray | None:
    if values is None:
        return None
    if len(values) not in (1, model.n_motors) or min(values) <= 0:
        raise InputError(f"--torque-noise: one positive number, or {model.n_motors} (one per motor), was expected")
    return np.broadcast_to(np.array(values), (model.n_motors,))


def _recording(time, q, v, a, model: CableModel, design: Design) -> Recording:
    return Recording(
        time,
        {"joint_position": q, "joint_velocity": v, "joint_acceleration": a, "joint_position_desired": q},
        label="excitation (interrupted)" if design.interrupted else "excitation",
        pretension=model.manipulator.pretension or None,
    )


def _content(args, limits: Limits, design: Design, excitation: Excitation, noise, errors, shares) -> dict:
    series = excitation.series
    return {
        "schema": "cdm_pin.excitation/1",
        "interrupted": design.interrupted,
        "objective": {"name": args.objective, "value": design.value, "evaluations": design.evaluations},
        "optimiser": {"name": args.optimiser, "seed": args.seed, "history": design.history},
        "series": {
            "frequency": series.frequency,
            "center": series.center,
            "cosine": series.cosine,
            "sine": series.sine,
        },
        "run_in": excitation.run_in.duration,
        "run_out": excitation.run_out.duration,
        "duration": excitation.duration,
        "limits": asdict(limits),
        "limit_usage": shares,
        "torque_noise": noise,
        "base_parameters": [asdict(error) for error in errors],
    }


def _tables(args, design: Design, excitation: Excitation, errors, shares):
    series = excitation.series
    yield (
        f"{args.objective} {design.value:.5g} after {design.evaluations} candidates; "
        f"base period {series.period:.4g} s, "
        f"run-in {excitation.run_in.duration:.3g} s, run-out {excitation.run_out.duration:.3g} s"
    )
    yield table(
        "Largest share of each limit",
        ("limit", *(f"{k + 1}" for k in range(max(len(x) for x in shares.values())))),
        ((name.replace("_", " "), *(f"{x:.3f}" for x in values)) for name, values in shares.items() if values.any()),
    )
    yield table(
        "Predicted standard errors",
        ("base parameter", "nominal", "std", "relative"),
        ((e.name, e.value, e.std, f"{100 * e.relative:.3g} %") for e in errors),
    )


def _draw(design: Design, objective: str, path: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
    axes.semilogy(design.history)
    axes.set(xlabel="cycle", ylabel=f"best {objective.replace('_', ' ')} so far")
    with whole_file(path) as temporary:
        figure.savefig(temporary)
    plt.close(figure)
