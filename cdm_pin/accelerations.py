r"""Which accelerations the rigid body gets: derived from which log, and up to which frequency.

Accelerations are the weakest columns of an identification. Differentiating twice lifts an encoder's noise and the
jitter of its samples, and an encoder at the motor sees cables and links vibrate as if the whole link did. Both show in
the torques: above some frequency they do not hold what the accelerations ask for. So each motor's own coordinate is
low-passed where its torque is explained best, before both sides pass the common filter; and where a velocity was
logged, its derivative is tried in place of the second derivative of the position.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .geometry import Vector
from .model import CableModel
from .motion import Motion
from .signals import Signals
from .signals_filters import differentiate, lowpass

STEPS = 6  # candidates, half an octave apart
GAIN = 0.02  # of a residual, below which the wider band stays
NEGLIGIBLE = 1e-3  # of a torque: a residual below it asks for nothing
ROWS_PER_COLUMN = 4  # fewer rows cannot choose

Rows = tuple[Vector, Vector]


class Acceleration(NamedTuple):
    """How a motor's acceleration is made.

    Attributes
    ----------
    source : str
        "position" or "velocity": what is differentiated.
    cutoff : float
        Of the low-pass before [Hz]; inf leaves the motion as it is.
    """

    source: str = "position"
    cutoff: float = np.inf


def candidates(signals: Signals, cutoff: float, lowest: float) -> list[Acceleration]:
    """List what may be chosen, the one that leaves the motion as it is first, then from wide to narrow.

    Parameters
    ----------
    signals : Signals
    cutoff : float
        Of the common filter [Hz].
    lowest : float
        No candidate is below [Hz].
    """
    limits = [limit for limit in cutoff * 2.0 ** (-0.5 * np.arange(STEPS)) if limit >= lowest]
    found = [Acceleration(), *(Acceleration("position", limit) for limit in limits)]
    if any(f"{side}_velocity" in signals.logged for side in _sides(signals)):
        found += [Acceleration("velocity", limit) for limit in limits]
    return found


def choose_accelerations(
    tried: Sequence[Acceleration], rows: Callable[[Acceleration], Rows], present: np.ndarray
) -> tuple[Acceleration, ...]:
    """Choose per motor the candidate that explains its torque best; the widest band within a few per cent of it.

    Parameters
    ----------
    tried : sequence of Acceleration
        The first is kept where none is clearly better.
    rows : callable
        Gives X (n, n_motors, n_columns) and y (n, n_motors) if all motors' accelerations are made in one way.
    present : ndarray of bool, shape (n_motors, n_columns)
        Which columns reach which motor.

    Returns
    -------
    tuple of Acceleration, length n_motors
    """
    n_motors = len(present)
    residuals = []
    for candidate in tried:
        X, y = rows(candidate)
        if len(y) < ROWS_PER_COLUMN * present.sum(axis=1).max():
            return (tried[0],) * n_motors
        residuals.append([residual(X[:, i, present[i]], y[:, i]) for i in range(n_motors)])
        scale = np.sqrt(np.mean(y**2, axis=0))
        if len(residuals) == 1 and np.all(np.array(residuals[0]) <= NEGLIGIBLE * scale):
            return (tried[0],) * n_motors
    table = np.array(residuals)
    good = table <= (1 + GAIN) * np.maximum(table.min(axis=0), NEGLIGIBLE * scale)
    return tuple(tried[int(first)] for first in np.argmax(good, axis=0))


def with_accelerations(
    model: CableModel, motion: Motion, signals: Signals, q: Vector, q_m: Vector, chosen: Sequence[Acceleration]
) -> Motion:
    """Make accelerations as chosen; the others stay.

    Parameters
    ----------
    model : CableModel
    motion : Motion
    signals : Signals
        Where velocities were logged.
    q, q_m : ndarray, shape (n, n_joints) and (n, n_motors)
        Positions as logged.
    chosen : sequence of Acceleration, length n_motors
    """
    if all(np.isinf(choice.cutoff) for choice in chosen):
        return motion
    E, B = model.joint_from_motor, model.motor_from_joint
    joint = signals.logged.get("joint_velocity")
    from_joints = _made(q @ B.T, None if joint is None else joint @ B.T, motion.a @ B.T, signals.rate, chosen)
    a = motion.a + (from_joints - motion.a @ B.T) @ E.T
    if "motor_position" not in signals.logged:
        return replace(motion, a=a, a_m=from_joints)
    a_m = _made(q_m, signals.logged.get("motor_velocity"), motion.a_m, signals.rate, chosen)
    return replace(motion, a=a if "joint_position" in signals.logged else a_m @ E.T, a_m=a_m)


def said(chosen: Sequence[Acceleration], motors: Sequence[str]) -> tuple[str, ...]:
    """Say what was chosen, in words."""
    words = [
        f"{motor} {'from its logged velocity, ' if choice.source == 'velocity' else ''}up to {choice.cutoff:.3g} Hz"
        for motor, choice in zip(motors, chosen, strict=True)
        if np.isfinite(choice.cutoff)
    ]
    return (f"accelerations as far as the torques show them: {'; '.join(words)}",) if words else ()


def _made(x: Vector, logged: Vector | None, otherwise: Vector, rate: float, chosen: Sequence[Acceleration]) -> Vector:
    out = np.array(otherwise)
    for i, (source, cutoff) in enumerate(chosen):
        if np.isinf(cutoff):
            continue
        if source == "velocity" and logged is not None:
            out[:, i] = differentiate(lowpass(logged[:, i], rate, cutoff), rate)
        else:
            out[:, i] = differentiate(differentiate(lowpass(x[:, i], rate, cutoff), rate), rate)
    return out


def residual(A: Vector, b: Vector) -> float:
    """Give the root mean square of what columns A (n, p) leave of b (n,)."""
    return float(np.sqrt(np.mean(left_of(A, b) ** 2)))


def left_of(A: Vector, b: Vector) -> Vector:
    """Give what columns A (n, p) leave of b (n,)."""
    norms = np.linalg.norm(A, axis=0)
    A = A / np.where(norms > 0, norms, 1.0)
    return b - A @ np.linalg.lstsq(A, b, rcond=1e-9)[0]


def _sides(signals: Signals) -> list[str]:
    return [side for side in ("joint", "motor") if f"{side}_position" in signals.logged]
