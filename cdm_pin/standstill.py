"""Standstill: while an axis rests among moving ones, friction takes up whatever it must, and torques tell nothing.

What nobody can predict is not judged: samples of those motors do not count, for no law and against none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from .band import Band
from .geometry import Vector
from .model import CableModel
from .motion import Motion
from .places import Place, pair_places, rub_places
from .reversing import stops

HOLD = 0.25
"""Time [s] for which an axis has to rest, so that it stands and does not turn."""
CREEPS, BLURRED, ERRORS = 0.005, 0.1, 4.0
"""Shares of an axis's speed (rms) up to which it rests: at least, and at most where errors of positions hide more."""
OFTEN, MOSTLY = 0.08, 0.85
"""Shares of the time between which an axis rests now and then: friction alone sticks for less, more is no motion."""
REACH, NEARLY = 1.0, 0.5
"""Periods of the band's edge by which what happens at rest is spread, and by which what is nearly known there is."""
LEAST = 0.05
"""Share of its samples that a motor keeps, or all are judged."""
FELT = 0.05
"""Share of an axis's friction from which on a motor feels it."""


@dataclass(frozen=True)
class Still:
    """When a coordinate stands still.

    Attributes
    ----------
    felt : ndarray, shape (n_motors,)
        How much of its friction each motor feels.
    when : ndarray of bool, shape (n,)
    brief : ndarray of bool, shape (n,)
        Those of them that belong to brief stops before it turns back.
    """

    felt: Vector
    when: np.ndarray
    brief: np.ndarray


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


def resting_axes(still: Sequence[Still], valid: np.ndarray) -> frozenset[int]:
    """Tell which coordinates rest now and then.

    Parameters
    ----------
    still : sequence of Still
        Of a recording (`standing`).
    valid : ndarray of bool, shape (n,)
    """
    shares = [np.mean(own.when[valid]) for own in still]
    return frozenset(k for k, x in enumerate(shares) if OFTEN < x < MOSTLY)


def judged(still: Sequence[Still], valid: np.ndarray, band: Band, axes: frozenset[int]) -> np.ndarray | None:
    """Tell by which samples in the band each motor's torque is judged.

    Parameters
    ----------
    still : sequence of Still
        Of a recording (`standing`).
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
    resting, briefly = np.zeros((2, len(still[0].felt), len(valid)), bool)
    for k in axes:
        own = still[k]
        if np.mean(own.when[valid]) < MOSTLY:
            felt = own.felt > FELT * own.felt.max()
            resting[felt] |= own.when & ~own.brief
            briefly[felt] |= own.brief
    if not (resting | briefly).any():
        return None
    spread = [maximum_filter1d(x, reach(band, y), axis=1) for x, y in ((resting, REACH), (briefly, NEARLY))]
    live = np.logical_not(np.logical_or(*spread))
    live[np.mean(live[:, valid], axis=1) < LEAST] = True
    live = live[:, :: band.step]
    return None if live.all() else live


def reach(band: Band, periods: float = REACH) -> int:
    """Count the samples over which the band spreads what happens at rest."""
    return 2 * round(periods * band.rate / band.cutoff) + 1


def standing_places(model: CableModel) -> list[Place]:
    """Every coordinate along which friction may hold: where parts slide on each other, and every two motors."""
    return rub_places(model) + pair_places(model)


def standing(motion: Motion, valid: np.ndarray, rate: float) -> list[Still]:
    """Tell when each coordinate (`standing_places`) stands still.

    What two motors have in common does so where both do, as nobody knows at which ratio.

    Parameters
    ----------
    motion : Motion
    valid : ndarray of bool, shape (n,)
    rate : float
        [Hz].
    """
    model = motion.model

    def when(A: Vector, B: Vector) -> tuple[np.ndarray, np.ndarray]:
        position, error = motion.q @ A + motion.q_m @ B, motion.position_error(A, B)
        turning, near = np.zeros((2, len(position)), bool)
        for stop in stops(position, error, rate):
            turning[int(np.ceil(stop.begin)) : int(stop.end) + 1] = True
            near[max(int(stop.begin - HOLD * rate), 0) : int(stop.end + HOLD * rate) + 1] = True
        rest = (rests(position, valid, rate, error) | turning) & valid
        return rest, rest & near

    alone = [when(np.array(place.A), np.array(place.B)) for place in rub_places(model)]
    motors = [when(np.zeros(model.n_joints), own) for own in np.eye(model.n_motors)]
    both = []
    for i, k in (place.index for place in pair_places(model)):
        rest = motors[i][0] & motors[k][0]
        both.append((rest, rest & (motors[i][1] | motors[k][1])))
    places = standing_places(model)
    return [Still(np.abs(p.weights(model)), *own) for p, own in zip(places, [*alone, *both], strict=True)]
