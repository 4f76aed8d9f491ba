"""Random spatial arms and noise-free samples, for the tests of identification."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from arms import paper_radii
from scipy.signal import lfilter

from cdm_pin.dynamics import inverse_dynamics, motor_torques
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.model import CableModel, build_model
from cdm_pin.recording import Recording


def spatial_content(n: int, seed: int) -> dict[str, Any]:
    """Content of a manipulator file of a random arm in space: any axes, origins and inertias."""
    rng = np.random.default_rng(seed)
    links = []
    for i in range(n):
        mass, size = rng.uniform(0.5, 4.0), rng.uniform(0.1, 0.5, 3)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        I = turn @ np.diag(mass * (np.sum(size**2) - size**2) / 12) @ turn.T
        links.append(
            {
                "name": f"link_{i + 1}",
                "origin": {"xyz": rng.uniform(-0.5, 0.5, 3), "rpy": rng.uniform(-1.5, 1.5, 3)},
                "axis": rng.normal(size=3),
                "mass": mass,
                "center_of_mass": rng.uniform(-0.2, 0.2, 3),
                "inertia": [I[k] for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))],
            }
        )
    links[-1]["length"] = 0.3
    gravity = rng.normal(size=3)
    content = {
        "name": "spatial",
        "gravity": 9.81 * gravity / np.linalg.norm(gravity),
        "links": links,
        "pulleys": paper_radii,
    }
    return json.loads(json.dumps(content, default=lambda x: x.tolist()))


def spatial_arm(n: int, seed: int) -> CableModel:
    """Model of a random arm in space."""
    return build_model(parse_manipulator(spatial_content(n, seed)))


def fourier(n: int, duration: float, rate: float, seed: int, amplitude: float = 0.5, base: float = 0.1):
    """Time, positions, velocities and accelerations of a random series of five harmonics."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(duration * rate)) / rate
    q, v, a = np.zeros((3, len(t), n))
    for k in range(1, 6):
        A, B = rng.normal(size=(2, n)) * amplitude / k
        w = 2 * np.pi * base * k
        c, s = np.cos(w * t)[:, None], np.sin(w * t)[:, None]
        q, v, a = q + A * c + B * s, v + w * (B * c - A * s), a - w**2 * (A * c + B * s)
    return t, q, v, a


def logged(
    model: CableModel,
    seed: int = 0,
    *,
    duration: float = 30.0,
    rate: float = 100.0,
    noise: float = 0.05,
    phi: float = 0.9,
    encoder: float = 1e-5,
    viscous: float = 0.0,
    coulomb: float = 0.0,
    locked: tuple[int, ...] = (),
    amplitude: float = 0.5,
    channels: tuple[str, ...] = ("joint_position", "motor_torque"),
) -> Recording:
    """Record a random motion: torque with autoregressive noise, positions with white noise, motor friction."""
    rng = np.random.default_rng([seed, 1])
    t, q, v, a = fourier(model.n_joints, duration, rate, seed, amplitude)
    for k in locked:
        q[:, k], v[:, k], a[:, k] = 0.4, 0.0, 0.0
    v_m = v @ model.motor_from_joint.T
    tau_m = motor_torques(model, q, v, a) + viscous * v_m + coulomb * np.sign(v_m)
    e = lfilter([np.sqrt(1 - phi**2)], [1.0, -phi], rng.normal(size=(len(t) + 300, model.n_motors)), axis=0)[300:]
    tau = inverse_dynamics(model, q, v, a)
    known = {
        "joint_position": q + encoder * rng.normal(size=q.shape),
        "motor_position": model.motor_position(q) + encoder * rng.normal(size=v_m.shape),
        "motor_torque": tau_m + noise * e,
        "joint_torque": tau + noise * rng.normal(size=tau.shape),
    }
    return Recording(t, {name: known[name] for name in channels}, label=f"run {seed}")
