"""Time motor torques of a whole trajectory against a Python loop of pin.rnea plus the coupling, side by side.

Usage: python scripts/benchmark_dynamics.py [MANIPULATOR] [--samples N] [--repeats N]
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import pinocchio as pin

from cdm_pin.console import output, table
from cdm_pin.dynamics import joint_torque_regressor, motor_torques
from cdm_pin.model import CableModel, load_model

ROOT = Path(__file__).resolve().parent.parent


def loop(model: CableModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Compute motor torques sample by sample with Pinocchio."""
    pin_model, data, E, J = model.pin_model, model.pin_model.createData(), model.joint_from_motor, model.rotor_inertia
    B = model.motor_from_joint
    tau_m = np.empty((len(q), model.n_motors))
    for k in range(len(q)):
        tau_m[k] = E.T @ pin.rnea(pin_model, data, q[k], v[k], a[k]) + J * (B @ a[k])
    return tau_m


def main() -> None:
    """Run both, in turns, and print the medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("manipulator", nargs="?", default=ROOT / "urdf" / "spatial7.yaml")
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args()
    model = load_model(args.manipulator)
    q, v, a = np.random.default_rng(0).normal(size=(3, args.samples, model.n_joints))
    np.testing.assert_allclose(motor_torques(model, q, v, a)[:100], loop(model, q[:100], v[:100], a[:100]), atol=1e-9)
    ways = {
        "Python loop of pin.rnea": lambda: loop(model, q, v, a),
        "motor_torques": lambda: motor_torques(model, q, v, a),
        "joint_torque_regressor": lambda: joint_torque_regressor(model, q[:20_000], v[:20_000], a[:20_000]),
    }
    ways["joint_torque_regressor"]()
    taken: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(args.repeats):
        for name, way in ways.items():
            start = time.perf_counter()
            way()
            taken[name].append(time.perf_counter() - start)
    rate = {name: (20_000 if "regressor" in name else args.samples) / np.median(taken[name]) for name in ways}
    slowest = rate["Python loop of pin.rnea"]
    rows = [[name, rate[name], 1e6 / rate[name], rate[name] / slowest] for name in ways]
    header = ("way", "samples/s", "us a sample", "times the loop")
    output().print(table(f"{model.manipulator.name}: {model.n_joints} joints, {args.samples} samples", header, rows))


if __name__ == "__main__":
    main()
