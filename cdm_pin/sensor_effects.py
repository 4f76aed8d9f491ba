"""What sensors and clocks are off by: gains, zeros, delays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import correlate1d

from .effect import Columns, Place, Shape, acting
from .geometry import Vector
from .motion import Motion


def gain_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Column of a wrong gain: the torque as logged."""
    return acting(motion, place, motion.logged_torque[:, place.index[0]])


def offset_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Column of a wrong zero: 1."""
    return acting(motion, place, np.ones(motion.n))


def encoder_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Columns of an encoder whose zero is off, to first order about what is known of it."""
    k = place.index[0]
    d = np.zeros_like(motion.q)
    d[:, k] = -1.0
    zero = np.zeros_like(d)
    half = motion if motion.offset is None else replace(motion, q=motion.q - 0.5 * motion.offset)
    torque = half.torque_along(d, (zero, zero))[..., None]
    if not (motion.joints_measured and motion.motors_measured):
        return Columns(torque)
    x = motion.model.arm_scale * motion.model.motor_from_joint[:, k]
    return Columns(torque, np.broadcast_to(-x, (motion.n, len(x)))[..., None])


def moved_by_offset(motion: Motion, place: Place, beta: Vector, shape: Shape) -> Motion:
    """Add an encoder's offset to those that are known."""
    offset = np.zeros(motion.q.shape[1]) if motion.offset is None else motion.offset
    return replace(motion, offset=offset + beta[0] * np.eye(len(offset))[place.index[0]])


def amplified_by_gain(motion: Motion, place: Place, beta: Vector, shape: Shape) -> Motion:
    """Add an error of a gain to those that are known."""
    return replace(motion, gains=motion.gains + beta[0] * np.eye(motion.model.n_motors)[place.index[0]])


def delay_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Shift the model's torque in time, as far as it is known.

    The noise that a model's torque has from positions would call for a delay, as shifting smooths it, and make one look
    shorter than it is, as what is shifted is not all torque.
    """
    known = motion.clear_logged_torque
    late = motion.gains * (delayed(known, motion.rate, shape[0]) - known) / shape[0]
    if place.index:
        late = late * np.eye(motion.model.n_motors)[place.index[0]]
    return Columns(late[..., None])


DELAYS = (1e-3, 0.2)
"""Delays about which columns are taken [s]."""


def delayed(x: Vector, rate: float, delay: float, half: int = 8) -> Vector:
    """Shift columns by a delay [s] that need not be whole samples (Lagrange interpolation, odd extension at the ends).

    Interpolation by `half` samples on either side keeps what is wrong with the ends of a recording at its ends.
    """
    whole = int(np.floor(delay * rate))
    nodes = np.arange(1 - half, half + 1)
    apart = np.where(np.eye(2 * half, dtype=bool), 1.0, nodes[:, None] - nodes)
    reach = np.where(np.eye(2 * half, dtype=bool), 1.0, whole + 1 - delay * rate - nodes)
    weights = np.prod(reach / apart, axis=1)
    pad = abs(whole) + half + 1
    padded = np.pad(x, ((pad, pad), (0, 0)), mode="reflect", reflect_type="odd")
    first = pad - whole - half  # where the first sample's first node is
    return correlate1d(padded, weights, axis=0)[first + half : first + half + len(x)]
