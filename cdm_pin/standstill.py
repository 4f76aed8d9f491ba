"""Standstill: while an axis rests among moving ones, friction takes up whatever it must, and torques tell nothing.

What nobody can predict is not judged: samples of those motors do not count, for no law and against none.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from .band import Band
from .geometry import Vector
from .model import CableModel
from .motion import Motion
from .places import Place, pair_places, rub_places

HOLD = 0.25
"""Time [s] for which an axis has to rest, so that it stands and does not turn."""
CREEPS, BLURRED, ERRORS = 0.005, 0.1, 4.0
"""Shares of an axis's speed (rms) up to which it rests: at least, and at most where errors of positions hide more."""
OFTEN, MOSTLY = 0.1, 0.85
"""Shares of the time between which an axis rests now and then: friction alone sticks for less, more is no motion."""
REACH = 1.0
"""Periods of the band's edge by which what happens at rest is spread."""
LEAST = 0.05
"""Share of its samples that a motor keeps, or all are judged."""
FELT = 0.05
"""Share of an axis's friction from which on a motor feels it."""


def rests(position: Vector, valid: np.ndarray, rate: float, error: float) -> np.ndarray:
    """Tell when a coordinate stands still.

    Parameters
    ----------
    position : ndarray, shape (n,)
        [rad]
    valid : ndarray of bool, shape (n,)
    rate : float
        [Hz]
    error : float
        Standard deviation of the position's error [rad].

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    steps = np.diff(position, prepend=position[:1])[valid]
    usual = float(np.sqrt(np.mean(steps**2))) * rate * HOLD if len(steps) else 0.0
    if usual <= 0.0:
        return np.zeros(len(position), bool)
    size = max(round(HOLD * rate), 3) | 1
    span = maximum_filter1d(position, size, mode="nearest") - minimum_filter1d(position, size, mode="nearest")
    return maximum_filter1d(span <= np.clip(ERRORS * error, CREEPS * usual, BLURRED * usual), size) & valid


def resting_axes(motion: Motion, valid: np.ndarray, rate: float) -> frozenset[int]:
    """Tell which coordinates (`standing_places`) rest now and then.

    Parameters
    ----------
    motion : Motion
    valid : ndarray of bool, shape (n,)
    rate : float
        [Hz].
    """
    share = {k: np.mean(still[valid]) for k, _, still in standing(motion, valid, rate)}
    return frozenset(k for k, x in share.items() if OFTEN < x < MOSTLY)


def judged(motion: Motion, valid: np.ndarray, band: Band, axes: frozenset[int]) -> np.ndarray | None:
    """Tell by which samples in the band each motor's torque is judged.

    Parameters
    ----------
    motion : Motion
    valid : ndarray of bool, shape (n,)
    band : Band
        Of the rate of the motion.
    axes : frozenset of int
        Those that rest now and then (`resting_axes`), on this recording or on others.

    Returns
    -------
    ndarray of bool, shape (n_motors, n_reduced), or None
        None where all are.
    """
    if not axes:
        return None
    resting = np.zeros((motion.model.n_motors, len(motion.time)), bool)
    for k, weights, still in standing(motion, valid, band.rate):
        if k in axes and np.mean(still[valid]) < MOSTLY:
            resting[weights > FELT * weights.max()] |= still
    if not resting.any():
        return None
    live = np.logical_not(maximum_filter1d(resting, reach(band), axis=1))
    live[np.mean(live[:, valid], axis=1) < LEAST] = True
    live = live[:, :: band.step]
    return None if live.all() else live


def reach(band: Band) -> int:
    """Count the samples over which the band spreads what happens at rest."""
    return 2 * round(REACH * band.rate / band.cutoff) + 1


def standing_places(model: CableModel) -> list[Place]:
    """Every coordinate along which friction may hold: where parts slide on each other, and every two motors."""
    return rub_places(model) + pair_places(model)


def standing(motion: Motion, valid: np.ndarray, rate: float) -> Iterator[tuple[int, Vector, np.ndarray]]:
    """Give the number of every coordinate, how much of its friction each motor feels, and when it stands still.

    What two motors have in common does so where both do, as nobody knows at which ratio.
    """
    for k, place in enumerate(standing_places(motion.model)):
        parts = np.diag(place.B)[np.array(place.B) != 0.0] if place.is_pair else np.array(place.B)[None]
        still = np.ones(len(motion.time), bool)
        for B in parts:
            error = motion.position_error(np.array(place.A), B)
            still &= rests(motion.q @ np.array(place.A) + motion.q_m @ B, valid, rate, error)
        yield k, np.abs(place.weights(motion.model)), still
