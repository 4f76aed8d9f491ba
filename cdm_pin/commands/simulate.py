"""``cdm-pin simulate MODEL TRAJECTORY -o FILE``: a closed-loop run on an independent simulator, as a recording."""

from __future__ import annotations

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("model", metavar="MODEL", help="manipulator.yaml or model.yaml, its effects included")
    parser.add_argument(
        "trajectory", metavar="TRAJECTORY", help="recording with desired, joint or motor positions to follow"
    )
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help="recording to write")
    parser.add_argument("--plant", choices=("mujoco", "pinocchio"), default="mujoco", help="default: mujoco")
    parser.add_argument(
        "--controller",
        metavar="FILE",
        help="controller.yaml; default: PID of 2 Hz with model feed-forward, exact sensors",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the sensors' noise (default 0)")


def run(args: argparse.Namespace) -> int:
    """Run the command."""
    import numpy as np

    from ..console import emit, notice, progress_bar, table
    from ..errors import InputError
    from ..model import load_model
    from ..recording import load_recording, save_recording
    from ..simulation import load_settings, simulate_recording
    from ..units import either, joint_units, motor_units

    if args.seed < 0:
        raise InputError(f"a whole number from 0 on was expected, found {args.seed}", place="--seed")
    model = load_model(args.model)
    trajectory = load_recording(args.trajectory, model)
    settings = load_settings(args.controller) if args.controller else None
    with progress_bar(args) as progress:
        result = simulate_recording(model, trajectory, settings, plant=args.plant, seed=args.seed, progress=progress)
    save_recording(result.recording, args.output)
    for text in trajectory.notices:
        notice(args, text)
    run, error = result.run, result.tracking_error
    if run.tension is not None and run.tension.min() < 0:
        notice(args, f"a cable would hang slack: its tension falls to {run.tension.min():.3g} N; raise the pretension")
    worst = np.abs(run.q - run.q_desired).max(axis=0)
    joints = [
        {"joint": name, "tracking_rms": error[i], "tracking_worst": worst[i]} for i, name in enumerate(model.joints)
    ]
    motors = [
        {
            "motor": name,
            "torque_rms": np.sqrt(np.mean(run.tau_m[:, i] ** 2)),
            "pid_rms": np.sqrt(np.mean(run.tau_pid[:, i] ** 2)),
        }
        for i, name in enumerate(model.motors)
    ]
    position, torque = either(joint_units(model)), either(motor_units(model, torque=True))
    emit(
        args,
        {
            "file": args.output,
            "rows": result.recording.n_samples,
            "plant": args.plant,
            "joints": joints,
            "motors": motors,
        },
        table(f"Tracking error [{position}]", ("joint", "rms", "worst"), [list(joint.values()) for joint in joints]),
        table(f"Torque [{torque}]", ("motor", "rms", "of the PID"), [list(motor.values()) for motor in motors]),
        f"wrote {args.output}, {result.recording.n_samples} rows",
    )
    return 0
