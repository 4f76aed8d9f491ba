"""From what happened to what was logged: clocks, encoders, torque sensors, delays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.signal import lfilter

from .faults import Fault
from .planar import Arm

Positions = Literal["joint", "motor", "both"]


@dataclass(frozen=True)
class Motion:
    """What happened, on a uniform grid of `step` [s]: absolute link angles and rates, motor torque and angle, cables.

    All arrays (N, n), rad, rad/s, rad/s^2, N m.
    """

    phi: np.ndarray
    w: np.ndarray
    a: np.ndarray
    tau_m: np.ndarray
    q_m: np.ndarray
    C: np.ndarray
    step: float


@dataclass(frozen=True)
class Noise:
    """Torque noise per motor: standard deviation [N m], AR(1) coefficient (0: white), drift [N m]."""

    std: np.ndarray
    correlation: float = 0.0
    drift: float = 0.0


@dataclass(frozen=True)
class Sensors:
    """What is logged and how well: positions of "joint", "motor" or "both", encoder bits per turn, clock jitter."""

    positions: Positions = "joint"
    bits: int = 17
    rate: float = 200.0  # [Hz]
    jitter: float = 0.05  # standard deviation of a sampling instant, in sample intervals
    tensions: bool = False


def interpolate(values: np.ndarray, step: float, t: np.ndarray) -> np.ndarray:
    """Interpolate (N, n) values on a grid from 0 at `step`, by cubics through four neighbours, at times `t` (m,)."""
    x = np.clip(t / step, 0.0, len(values) - 1.0)
    k = np.clip(x.astype(int), 1, len(values) - 3)
    u = (x - k)[:, None]
    before, here, after, far = values[k - 1], values[k], values[k + 1], values[k + 2]
    return (
        -u * (u - 1) * (u - 2) / 6 * before
        + (u + 1) * (u - 1) * (u - 2) / 2 * here
        - (u + 1) * u * (u - 2) / 2 * after
        + (u + 1) * u * (u - 1) / 6 * far
    )


def relative(phi: np.ndarray) -> np.ndarray:
    """Turn absolute link angles (N, n) into joint angles."""
    return np.diff(phi, axis=1, prepend=0.0)


def noise_series(noise: Noise, t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw the torque noise (m, n) [N m]: AR(1) of the stated spread, plus a drift of a few slow sines."""
    m, n = len(t), len(noise.std)
    e = rng.standard_normal((m, n))
    e[1:] *= np.sqrt(1.0 - noise.correlation**2)
    e = lfilter([1.0], [1.0, -noise.correlation], e, axis=0)
    slow = drift_basis(t)
    return e * noise.std + noise.drift * slow @ rng.standard_normal((slow.shape[1], n)) / np.sqrt(slow.shape[1])


def drift_basis(t: np.ndarray) -> np.ndarray:
    """Give the shapes that drift takes: a ramp and sines slower than 25 s, (m, 5)."""
    x = 2.0 * np.pi * t[:, None] * np.array([0.011, 0.027])
    return np.column_stack([t / 30.0 - 1.0, np.sin(x), np.cos(x)])


def sampling_times(sensors: Sensors, duration: float, rng: np.random.Generator) -> np.ndarray:
    """Draw the instants at which samples are taken, as the log states them."""
    t = np.arange(round(duration * sensors.rate)) / sensors.rate
    return t + rng.normal(scale=sensors.jitter, size=len(t)).clip(-0.4, 0.4) / sensors.rate + 0.01


def torque_as_logged(faults: Sequence[Fault], tau_m: np.ndarray, step: float, t: np.ndarray) -> np.ndarray:
    """Sample motor torques (N, n) through delay, gain and offset, without noise: (m, n)."""
    n = tau_m.shape[1]
    delay, gain, offset = np.zeros(n), np.ones(n), np.zeros(n)
    for f in faults:
        where = slice(None) if f.location["kind"] == "system" else f.location.get("index", 1) - 1
        if f.effect == "time_delay":
            delay[where] += f.parameters["delay"]
        elif f.effect == "torque_gain_error":
            gain[where] *= f.parameters["gain"]
        elif f.effect == "torque_offset":
            offset[where] += f.parameters["offset"]
    late = [interpolate(tau_m[:, i : i + 1], step, t - delay[i]) for i in range(n)]
    return np.hstack(late) * gain + offset


def encoder_offsets(faults: Sequence[Fault], n: int) -> np.ndarray:
    """Give what the joint encoders add (n,) [rad]."""
    offset = np.zeros(n)
    for f in faults:
        if f.effect == "encoder_offset":
            offset[f.location["index"] - 1] += f.parameters["offset"]
    return offset


def record(
    motion: Motion,
    faults: Sequence[Fault],
    sensors: Sensors,
    noise: Noise,
    t: np.ndarray,
    rng: np.random.Generator,
    arm: Arm,
) -> dict[str, np.ndarray]:
    """Log a motion at times `t`: columns by name."""
    n = motion.phi.shape[1]
    tick = 2.0 * np.pi / 2**sensors.bits
    columns = {"time": t}

    def add(name: str, values: np.ndarray) -> None:
        columns.update({f"{name}_{i + 1}": values[:, i] for i in range(values.shape[1])})

    if sensors.positions in ("joint", "both"):
        q = interpolate(relative(motion.phi), motion.step, t) + encoder_offsets(faults, n)
        add("joint_position", np.round(q / tick) * tick)
    if sensors.positions in ("motor", "both"):
        add("motor_position", np.round(interpolate(motion.q_m, motion.step, t) / tick) * tick)
    add("motor_torque", torque_as_logged(faults, motion.tau_m, motion.step, t) + noise_series(noise, t, rng))
    if sensors.tensions:
        pull = interpolate(motion.C, motion.step, t) / (2.0 * arm.joint_pulley_radius)
        tension_noise = rng.standard_normal((2, *pull.shape)) * 0.002 * arm.pretension
        add("cable_tension_upper", np.maximum(arm.pretension + pull, 0.0) + tension_noise[0])
        add("cable_tension_lower", np.maximum(arm.pretension - pull, 0.0) + tension_noise[1])
    return columns
