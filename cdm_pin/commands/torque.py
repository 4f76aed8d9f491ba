"""``cdm-pin torque MODEL RECORDING -o FILE``: the motor torques that a recorded motion takes, one row per input row."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from ..console import emit, notice, table
from ..errors import InputError
from ..model import load_model
from ..recording import Recording, load_recording, save_recording
from ..torques import recorded_torques, rms
from ..units import either, motor_units


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("model", metavar="MODEL", help="manipulator.yaml or model.yaml")
    parser.add_argument("recording", metavar="RECORDING", help="recording with joint or motor positions")
    parser.add_argument(
        "-o", "--output", metavar="FILE", required=True, help="recording to write: time, motor_torque_i"
    )
    parser.add_argument(
        "--cutoff", type=float, metavar="HZ", help="low-pass before differentiating (default: where the noise begins)"
    )


def run(args: argparse.Namespace) -> int:
    """Run the command."""
    if args.cutoff is not None and not args.cutoff > 0.0:
        raise InputError(f"must be above 0 Hz, found {args.cutoff:g}", place="--cutoff")
    model = load_model(args.model)
    recording = load_recording(args.recording, model)
    result = recorded_torques(model, recording, args.cutoff)
    tau_m = result.tau_m
    save_recording(Recording(recording.time, {"motor_torque": tau_m}, source=Path(args.output)), args.output)
    for text in (*recording.notices, *(result.cables.warnings() if result.cables else ())):
        notice(args, text)
    measured = recording.channels.get("motor_torque")
    motors = [
        {
            "motor": name,
            "rms": rms(tau_m)[i],
            "peak": np.abs(tau_m[:, i]).max(),
            "recorded_rms": None if measured is None else rms(measured)[i],
            "difference_rms": None if measured is None else rms(measured - tau_m)[i],
        }
        for i, name in enumerate(model.motors)
    ]
    unit = either(motor_units(model, torque=True))
    header = ("motor", f"rms [{unit}]", f"peak [{unit}]", "recorded rms", "difference rms")
    emit(
        args,
        {"file": args.output, "rows": len(tau_m), "motors": motors},
        table(f"{model.manipulator.name} along {recording.name}", header, [list(motor.values()) for motor in motors]),
        f"wrote {args.output}, {len(tau_m)} rows",
    )
    return 0
