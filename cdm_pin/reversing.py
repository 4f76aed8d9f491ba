"""Reversals: an axis that stops briefly before it turns back is held, while friction goes from one side to the other.

Dry friction is anything between its limits at rest. What drives the axis back grows while it stands, so the friction
that holds it does, about evenly. Passing through zero without a stop, a position is a parabola: it stays within four
times a distance for twice as long as within that distance. What it stays longer than that is the stop.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from .geometry import Vector

NEAR, SHARE = 4.0, 1e-4
"""How near a position is where it turns: in errors of encoders, and in its range at least."""
FARTHER = 4.0
"""Times that distance, at which it has left; what is uniformly accelerated takes twice the time."""
STOPS = 0.3
"""Share of the time within that distance from which on an axis stood rather than passed."""
BRIEF = 0.3
"""How long friction holds what is driven back [s]; what stands longer is at rest, and nobody drives it."""


class Stop(NamedTuple):
    """A stop before a position turns back.

    Attributes
    ----------
    begin, end : float
        Samples between which it stands.
    first, last : int
        Samples between which it is near.
    way : float
        1 if it came from below, else -1.
    """

    begin: float
    end: float
    first: int
    last: int
    way: float


def reversing(position: Vector, velocity: Vector, width: float, error: float, rate: float) -> Vector:
    """Give the sign of a velocity, with stops between motions of both directions passed evenly.

    Parameters
    ----------
    position, velocity : ndarray, shape (n,)
        [rad], [rad/s].
    width : float
        Of the smooth sign, tanh(velocity / width) [rad/s].
    error : float
        Standard deviation of the position's error [rad].
    rate : float
        [Hz].

    Returns
    -------
    ndarray, shape (n,)
    """
    sign = np.tanh(velocity / width)
    for stop in stops(position, error, rate):
        k = np.arange(stop.first, stop.last + 1)
        sign[k] = stop.way * (1.0 - 2.0 * np.clip((k - stop.begin) / (stop.end - stop.begin), 0.0, 1.0))
    return sign


def stops(position: Vector, error: float, rate: float) -> list[Stop]:
    """Find where a position stops briefly before it turns back.

    Parameters
    ----------
    position : ndarray, shape (n,)
        [rad].
    error : float
        Standard deviation of its error [rad].
    rate : float
        [Hz].
    """
    near = max(NEAR * error, SHARE * float(np.ptp(position)))
    if near <= 0.0:
        return []
    found = _stops(np.ascontiguousarray(position), near, FARTHER * near, STOPS)
    every = (Stop(begin, end, int(first), int(last), way) for begin, end, first, last, way in found)
    return [stop for stop in every if stop.end - stop.begin <= BRIEF * rate]


@numba.njit(cache=True)
def _passes(x, start, step, level, distance, outwards):
    """Find when, in samples, a position passes a distance from a level, on the way out or in from a sample."""
    k = start
    while 0 <= k + step < len(x):
        here, there = abs(x[k] - level), abs(x[k + step] - level)
        if (there > distance) == outwards:
            return k + step * min(max((distance - here) / (there - here), 0.0), 1.0) if there != here else k
        k += step
    return -1.0


@numba.njit(cache=True)
def _surroundings(x, k, level, far):
    """Give the first and the last sample around one between which a position is no farther from a level; -1 if none."""
    before, after = _passes(x, k, -1, level, far, True), _passes(x, k, 1, level, far, True)
    return (int(np.ceil(before)), int(np.floor(after))) if before >= 0.0 and after >= 0.0 else (-1, -1)


@numba.njit(cache=True)
def _stops(x, near, far, share):
    """Give begin, end, first and last sample of the surroundings, and direction before, of every stop."""
    found = []
    k = 1
    while k < len(x) - 1:
        if (x[k + 1] - x[k]) * (x[k] - x[k - 1]) > 0.0:
            k += 1
            continue
        first, last = _surroundings(x, k, x[k], far)
        if first < 1:
            k += 1
            continue
        way = np.sign(x[k] - x[first - 1])
        if way * (x[last + 1] - x[k]) > 0.0:  # it went on, or noise alone turned it back
            k = max(int(_passes(x, k, 1, x[k], near, True)), k) + 1
            continue
        farthest = first + np.argmax(way * x[first : last + 1])
        part = x[first : last + 1]
        level = np.median(part[way * (x[farthest] - part) < 2.0 * near])
        first, last = _surroundings(x, farthest, level, far)
        if first >= 1:
            a1, b1 = _passes(x, first - 1, 1, level, near, False), _passes(x, last + 1, -1, level, near, False)
            a2, b2 = _passes(x, first, -1, level, far, True), _passes(x, last, 1, level, far, True)
            begin, end = 2.0 * a1 - a2, 2.0 * b1 - b2
            if end - begin > share * (b2 - a2):
                found.append((begin, end, float(first), float(last), way))
        k = max(last, k) + 1
    return found
