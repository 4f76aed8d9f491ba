"""Springs, ripple, rotors, a tilted base and pushes: columns, known motion, parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from .effect import Columns, Place, Shape, acting, position_along
from .geometry import Vector
from .model import CableModel
from .motion import Motion

TURNS = 2.0
"""Turns of a motor beyond which its ripple is known to repeat with each."""


def spring_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Columns of a spring about its rest: s, -1, and where it stiffens s^2, s^3."""
    q = position_along(motion, place)
    if not shape[0]:
        return acting(motion, place, q, -np.ones_like(q))
    return acting(motion, place, q, -np.ones_like(q), q**2, q**3)


def mean_stiffness(motions: Sequence[Motion], place: Place, shape: Shape) -> Vector:
    """Give what each coefficient of a spring adds to its stiffness from one end of the motion to the other."""
    low, high = np.percentile(np.concatenate([position_along(m, place) for m in motions]), [2.5, 97.5])
    powers = (1, 0, 2, 3) if shape[0] else (1, 0)
    return np.array([(high**p - low**p) / max(high - low, 1e-9) for p in powers])


def spring_powers(beta: Vector) -> Vector:
    """Turn the coefficients of a spring into those of powers of its angle, the lowest first."""
    return np.array([-beta[1], beta[0], *beta[2:]])


def ripple_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Columns of a wave along the motor's angle: sin(n q_m), cos(n q_m)."""
    x = shape[0] * motion.q_m[:, place.index[0]]
    return acting(motion, place, np.sin(x), np.cos(x))


def ripple_grid(motions: Sequence[Motion], place: Place) -> list[Shape]:
    """Screen cycles per turn, as closely as the range of the motor tells them apart; of many turns whole numbers alone.

    What differs from turn to turn is no ripple of the motor.
    """
    span = max(float(np.ptp(m.q_m[:, place.index[0]])) for m in motions)
    fastest = max(float(np.quantile(np.abs(m.v_m[:, place.index[0]]), 0.7)) for m in motions)
    rate = motions[0].rate
    if span < 0.05 or fastest <= 0:
        return []
    highest = min(2 * np.pi * 0.1 * rate / fastest, 60.0)
    lowest = max(1.9, 2.5 * 2 * np.pi / span / 2)
    cycles = np.arange(2.0, highest) if span > TURNS * 2 * np.pi else np.arange(lowest, highest, 1.2 / span)
    return [(float(c),) for c in cycles]


def rotor_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Column of a rotor's inertia: the motor's acceleration."""
    return acting(motion, place, motion.a_m[:, place.index[0]])


def tilt_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Columns of a tilted base: gravity's change about each axis that is not vertical."""
    from .dynamics import inverse_dynamics

    model, g = motion.model, motion.model.chain.gravity
    axes = _tilt_axes(model)
    if motion.tilt is not None:
        g = Rotation.from_rotvec(0.5 * np.array(motion.tilt[: len(axes)]) @ np.array(axes)).inv().apply(np.array(g))
    zero = np.zeros_like(motion.q)
    columns = []
    for axis in axes:
        turned = model.pin_model.copy()
        turned.gravity.linear = -np.cross(axis, g)
        columns.append(
            inverse_dynamics(replace(model, pin_model=turned), motion.q, zero, zero) @ model.joint_from_motor
        )
    return Columns(np.stack(columns, axis=-1))


def unlevelled_columns(motion: Motion, changes: Vector, beta: Vector) -> Columns:
    """Give what changes of the standard parameters, (10 n_joints, k), bring under a tilt beyond a level base.

    About a vertical axis the first moments of a link are felt only where the base is tilted, or other joints move.
    """
    from .regressor import motor_regressor

    model = motion.model
    axes, zero = np.array(_tilt_axes(model)), np.zeros_like(motion.q)
    turned = model.pin_model.copy()
    turned.gravity.linear = -np.cross(beta[: len(axes)] @ axes, model.chain.gravity)
    return Columns(motor_regressor(replace(model, pin_model=turned), motion.q, zero, zero) @ changes)


def moved_by_tilt(motion: Motion, place: Place, beta: Vector, shape: Shape) -> Motion:
    """Tell the motion a tilt that is known."""
    return replace(motion, tilt=tuple(map(float, beta)))


def _tilt_axes(model: CableModel) -> list[Vector]:
    """Axes about which a base can be out of level: +z of an arm in a vertical plane, else two that are level."""
    g = model.chain.gravity / (np.linalg.norm(model.chain.gravity) or 1.0)
    if model.planar and np.linalg.norm(g[:2]) > 0.05:
        return [np.array([0.0, 0.0, 1.0])]
    ahead = np.eye(3)[0 if abs(g[0]) < 0.9 else 1]
    first = ahead - (ahead @ g) * g
    first /= np.linalg.norm(first)
    return [np.asarray(first, float), np.asarray(np.cross(first, g), float)]


def push_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Column of a push on a joint: -1 while it lasts, on one recording."""
    inside = (motion.time >= shape[0]) & (motion.time <= shape[1]) & (motion.index == int(shape[2]))
    return acting(motion, place, -inside.astype(float))


def push_windows(motions: Sequence[Motion], place: Place) -> list[Shape]:
    """Overlapping windows of four lengths, on every recording."""
    shapes = []
    for motion in motions:
        end, r = float(motion.time[-1]), motion.index
        for width in end / 75 * 2.5 ** np.arange(4):
            shapes += [(float(t), float(t + width), float(r)) for t in np.arange(0.0, end - width, width / 2)]
    return shapes


def spring_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    """Tell stiffness at rest, rest and cubic part."""
    if not shape[0]:
        return {"stiffness": float(beta[0]), "rest": float(beta[1] / beta[0]) if beta[0] else 0.0}
    c = float(beta[3])
    rest = -float(beta[2]) / (3 * c) if c else 0.0
    return {"stiffness": float(beta[0]) - 3 * c * rest**2, "rest": rest, "cubic": c}


def spring_inverse(p: dict[str, float]) -> tuple[list[float], list[float]]:
    """Invert `spring_physical`."""
    k, rest, c = p.get("stiffness", 0.0), p.get("rest", 0.0), p.get("cubic", 0.0)
    if not c:
        return [k, k * rest], [0.0]
    return [k + 3 * c * rest**2, k * rest + c * rest**3, -3 * c * rest, c], [1.0]
