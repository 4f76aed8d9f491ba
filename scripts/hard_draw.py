"""Arms, motions, sensors and effects of the hard recordings, drawn; torques are those of Pinocchio's RNEA."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, lfilter, sosfiltfilt

from cdm_pin.console import plain
from cdm_pin.recording import Recording

GRID = 0.002  # [s] of the prescribed motion
SIGN = 0.004  # [rad/s] over which dry friction turns
DELAY = 0.0073  # [s]
CONDITIONS: dict[str, tuple[Any, ...]] = {
    "arm": (2, 3, 4, 5, 6),
    "motion": ("point to point", "steps of a person", "ramps", "noise", "very slow"),
    "at rest": ("no joint", "no joint", "one joint"),
    "torque noise": ("white", "autoregression", "resonance", "hum", "grows with speed", "coarse steps"),
    "encoder": (12, 13, 14, 16, 18),
    "rounding": ("to the nearest step", "down"),
    "encoders": ("joint", "motor", "both"),
    "sampling": ("even", "5 % jitter", "20 % jitter"),
    "rate": (100, 200, 500),
    "duration": (15, 30, 60, 120),
}
EFFECTS = {  # and what it sits on
    "viscous_friction": "joint",
    "coulomb_friction": "joint",
    "hysteresis": "joint",
    "joint_spring": "joint",
    "torque_offset": "motor",
    "torque_gain_error": "motor",
    "time_delay": "system",
    "base_tilt": "base",
}


def draw(
    rng: np.random.Generator, condition: dict[str, Any], effect: str | None
) -> tuple[dict[str, Any], list[Recording], dict[str, Any]]:
    """Give a manipulator file whose masses are wrong by up to a tenth, two recordings of the arm, and the truth."""
    n, ratio = condition["arm"], float(rng.choice([1.0, rng.uniform(0.3, 1.0)]))
    manipulator, arm = _arm(rng, n, ratio)
    E = ratio * (np.eye(n) - np.eye(n, k=-1))
    j, still = rng.choice(n, 2, replace=False)
    change, level = rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.12), 10 ** rng.uniform(-3.0, -2.0)
    recordings: list[Recording] = []
    for k in range(2):
        time = np.arange(int(condition["duration"] / GRID) + 1) * GRID
        q = rng.uniform(-0.5, 0.5, n) + MOTIONS[condition["motion"]](rng, time, n)
        if condition["at rest"] == "one joint":
            q[:, still] = q[0, still]
        path = make_interp_spline(time, q, k=5)
        v, a = path.derivative(1)(time), path.derivative(2)(time)
        torque = _rnea(arm, q, v, a, change * (effect == "base_tilt"))
        if k == 0:
            size, usual, scale = abs(change) * np.abs(torque[:, j]).max(), v[:, j].std(), np.abs(torque @ E).max(axis=0)
        if effect in LAWS:
            torque[:, j] += LAWS[effect](q[:, j], v[:, j], size, usual)
        torque = torque @ E
        torque[:, j] *= 1.0 + change * (effect == "torque_gain_error")
        torque[:, j] += change * scale[j] * (effect == "torque_offset")
        std = level * np.maximum(scale, 0.1 * scale.max())
        late = DELAY * (effect == "time_delay")
        recordings.append(_record(rng, condition, E, path, make_interp_spline(time + late, torque), std))
    truth = {"n_links": n, "pulley_ratio": ratio, "sensors": {"positions": condition["encoders"]}, "effects": []}
    if effect:
        index = {"index": int(j) + 1} if EFFECTS[effect] in ("joint", "motor") else {}
        truth["effects"] = [{"effect": effect, "location": {"kind": EFFECTS[effect], **index}}]
    return manipulator, recordings, truth


def _arm(rng: np.random.Generator, n: int, ratio: float) -> tuple[dict[str, Any], pin.Model]:
    """Draw an arm, planar or with twisted axes: its file, masses wrong, and the true one."""
    twisted, radius, links = rng.random() < 0.4, rng.uniform(0.03, 0.06), []
    gravity = 9.81 * (np.array([0.0, -1.0, 0.0]) if rng.random() < 0.7 else np.array([0.0, 0.0, -1.0]))
    arm, before = pin.Model(), 0.0
    arm.gravity = pin.Motion(np.r_[gravity, np.zeros(3)])
    for i in range(n):
        length, mass = rng.uniform(0.2, 0.5), rng.uniform(0.5, 3.0) * (1.5 - 0.25 * i)
        center = length * np.array([rng.uniform(0.3, 0.65), *(rng.uniform(-0.08, 0.08, 2) * [1.0, twisted])])
        inertia = mass * length**2 / 12 * rng.uniform(0.8, 1.5) * np.array([0.2, 1.0, 1.05])
        twist = rng.choice([0.0, 0.5, -0.5]) * np.pi * (twisted and i > 0)
        placement = pin.SE3(pin.rpy.rpyToMatrix(float(twist), 0.0, 0.0), np.array([before, 0.0, 0.0]))
        arm.addJoint(i, pin.JointModelRZ(), placement, f"joint_{i + 1}")
        arm.appendBodyToJoint(i + 1, pin.Inertia(mass, center, np.diag(inertia)), pin.SE3.Identity())
        wrong = 1.0 + rng.uniform(-0.1, 0.1, 3)
        link = {"name": f"link_{i + 1}", "length": length, "mass": mass * wrong[0]}
        link |= {"center_of_mass": list(center * wrong[1]), "inertia": list(inertia * wrong[2])}
        link |= {"origin": {"xyz": [before, 0.0, 0.0], "rpy": [twist, 0.0, 0.0]}} if twist else {}
        links.append(link)
        before = length
    content = {"name": "hard", "gravity": list(gravity), "links": links, "pretension": 150.0}
    content["pulleys"] = {"joint_pulley_radius": radius, "motor_pulley_radius": ratio * radius,
                          "link_pulley_radius": 0.2 * radius, "link_pulley_offset": 0.22 * radius,
                          "link_pulley_distance": 1.24 * radius}  # fmt: skip
    return plain(content), arm


def _rnea(arm: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray, tilt: float) -> np.ndarray:
    """Torques of the joints (N, n); `tilt` [rad] turns gravity about an axis that is level."""
    tilted, down = pin.Model(arm), arm.gravity.linear
    axis = np.array([0.0, 0.0, 1.0]) if down[1] else np.array([1.0, 0.0, 0.0])
    tilted.gravity = pin.Motion(np.r_[pin.exp3(tilt * axis) @ down, np.zeros(3)])
    data = tilted.createData()
    return np.array([pin.rnea(tilted, data, *row) for row in zip(q, v, a, strict=True)])


def _dahl(q: np.ndarray, limit: float, reach: float = 0.03) -> np.ndarray:
    """Friction that takes a way of `reach` [rad] to turn."""
    friction = np.zeros_like(q)
    for k, step in enumerate(np.diff(q)):
        end = limit * np.sign(step)
        friction[k + 1] = end + (friction[k] - end) * np.exp(-abs(step) / reach)
    return friction


Law = Callable[[np.ndarray, np.ndarray, float, float], np.ndarray]
LAWS: dict[str, Law] = {  # of position, speed, size [N m] and usual speed
    "viscous_friction": lambda q, v, size, usual: size * v / usual,
    "coulomb_friction": lambda q, v, size, usual: size * np.tanh(v / SIGN),
    "hysteresis": lambda q, v, size, usual: _dahl(q, size),
    "joint_spring": lambda q, v, size, usual: 2.0 * size * (q - 0.2),
}


def _slow(rng: np.random.Generator, time: np.ndarray, n: int) -> np.ndarray:
    f, phase, size = rng.uniform([0.008, 0.0, 0.2], [0.04, 6.3, 0.5], (3, n, 3)).transpose(2, 0, 1)
    return np.sum(size * np.sin(2 * np.pi * f * time[:, None, None] + phase), axis=1)


def _random(rng: np.random.Generator, time: np.ndarray, n: int) -> np.ndarray:
    edges = [rng.uniform(0.1, 0.2), rng.uniform(0.8, 2.5)]
    band = butter(2, edges, "bandpass", fs=1 / GRID, output="sos")
    q = sosfiltfilt(band, rng.standard_normal((len(time), n)), axis=0)
    return q / q.std(axis=0) * rng.uniform(0.25, 0.45, n) * min(1.0, 1.0 / edges[1])


def _goals(
    rng: np.random.Generator, time: np.ndarray, n: int, speed: tuple[float, float], pause: float, some: bool = False
) -> np.ndarray:
    """Go from goal to goal, all joints or some, with pauses; corners are rounded within a tenth of a second or two."""
    q, now, t = np.zeros((len(time), n)), np.zeros(n), rng.uniform(0.5, 1.5)
    while t < time[-1] - 0.5:
        goal = np.where(rng.random(n) < (0.6 if some else 1.0), rng.uniform(-1.1, 1.1, n), now)
        takes = max(np.abs(goal - now).max() / rng.uniform(*speed), 0.25)
        q += np.clip((time - t) / takes, 0.0, 1.0)[:, None] * (goal - now)
        now, t = goal, t + takes + rng.exponential(pause)
    window = np.hanning(int(rng.uniform(0.1, 0.4) / GRID))
    padded = np.pad(q, ((len(window), len(window)), (0, 0)), mode="edge")
    smooth = np.stack([np.convolve(x, window / window.sum(), "same") for x in padded.T], axis=1)
    return smooth[len(window) : -len(window)]


MOTIONS: dict[str, Callable[[np.random.Generator, np.ndarray, int], np.ndarray]] = {
    "point to point": partial(_goals, speed=(0.3, 2.0), pause=0.4),
    "steps of a person": partial(_goals, speed=(0.2, 1.0), pause=0.8, some=True),
    "ramps": partial(_goals, speed=(0.05, 0.2), pause=0.15),
    "noise": _random,
    "very slow": _slow,
}


def _noise(rng: np.random.Generator, kind: str, v: np.ndarray, rate: float) -> np.ndarray:
    """Noise of unit size on each motor, whose speeds are `v` (N, n)."""
    e, time = rng.standard_normal(v.shape), np.arange(len(v))[:, None] / rate
    if kind == "autoregression":
        e = lfilter([1.0], [1.0, -0.9], e, axis=0)
    elif kind == "resonance":
        turn, r = 2 * np.pi * rng.uniform(0.03, 0.2), rng.uniform(0.93, 0.985)
        e = lfilter([1.0], [1.0, -2.0 * r * np.cos(turn), r * r], e, axis=0)
    elif kind == "hum":
        e += rng.uniform(1.0, 3.0, e.shape[1]) * np.sin(2 * np.pi * 50.02 * time)
    elif kind == "grows with speed":
        e *= 0.4 + 1.5 * np.abs(v) / np.abs(v).max()
    return e / e.std(axis=0)


def _record(
    rng: np.random.Generator, condition: dict[str, Any], E: np.ndarray, path: Any, torque: Any, std: np.ndarray
) -> Recording:
    """Sample motion and torque as sensors would."""
    rate, jitter = condition["rate"], {"5 % jitter": 0.05, "20 % jitter": 0.2}.get(condition["sampling"], 0.0)
    count = int(condition["duration"] * rate) - 10
    t = (np.arange(count) + 5 + jitter * rng.uniform(-1.0, 1.0, count)) / rate
    q, to_motor = path(t), np.linalg.inv(E).T
    noise = _noise(rng, condition["torque noise"], path.derivative(1)(t) @ to_motor, rate)
    measured, coarse = torque(t) + std * noise, 3.0 * std
    if condition["torque noise"] == "coarse steps":
        measured = np.round(measured / coarse) * coarse
    channels = {"motor_torque": measured}
    step, rounded = 2 * np.pi / 2 ** condition["encoder"], np.floor if condition["rounding"] == "down" else np.round
    for side, angle in (("joint", q), ("motor", q @ to_motor)):
        if condition["encoders"] in (side, "both"):
            channels[f"{side}_position"] = step * rounded(angle / step)
    return Recording(t, channels)
