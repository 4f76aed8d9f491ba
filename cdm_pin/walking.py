"""Zeros of torque sensors that walk: noise with a unit root, which an autoregression takes for less slow than it is.

Least squares draw the roots of an autoregression towards zero (Dickey, Fuller, J. American Statistical Association 74,
1979), and what a fit takes with it does so, too: the slowest frequencies then count for more than they tell.
"""

from __future__ import annotations

import numpy as np

from .fit import Fit
from .geometry import Vector
from .search import Search, errors
from .whitening import Segments, Whitener, autoregressions, whitener_from

REJECTED = 12.0
"""Twice the log-likelihood by which noise without a unit root must be likelier for it to have none."""
SLOW = 4.0
"""Power of slow noise over that of most, at least, where zeros walk."""


def walking_noise(search: Search, fit: Fit) -> Whitener | None:
    """Give the noise that a fit leaves with a unit root in the torques that may have one; None where none may."""
    recent = search.recent("walking_noise", 64)
    known = recent.get(fit)
    if known is None:
        known = recent.keep((_walking_noise(search, fit),), fit)
    return known[0]


def _walking_noise(search: Search, fit: Fit) -> Whitener | None:
    problem, order = search.problem, search.settings.order
    m = problem.model.n_motors * problem.torque
    if not m or not any(problem.segments):
        return None
    rest = errors(search, fit.base, fit.effects, fit.beta)
    slow = slowness(rest, problem.segments)[:m] > SLOW
    if not slow.any():
        return None
    free, without = autoregressions(rest, problem.segments, order)
    steps = [np.diff(e, axis=1) for e in rest]
    shorter = [[(a, b - 1) for a, b in run] for run in problem.segments]
    stepping, within = autoregressions(steps, shorter, free.shape[1] - 1)
    walks = []
    for c in np.flatnonzero(slow):
        own, other = (np.concatenate([run[c] for run in e if len(run)]) for e in (within, without))
        if len(other) and len(own) * np.log(np.mean(own**2) / np.mean(other**2)) < REJECTED:
            walks.append(c)
    if not walks:
        return None
    for c in walks:
        free[c] = -np.convolve([1.0, -1.0], [1.0, *-stepping[c]])[1:]
        for r, run in enumerate(within):
            if len(run):
                without[r][c] = run[c]
    return whitener_from(free, without, problem.blocks)


def slowness(rest: list[Vector], segments: list[Segments], share: float = 0.04) -> Vector:
    """Give the power of the slowest share of frequencies over the median of all, shape (n_channels,)."""
    power, usual = np.zeros(len(rest[0])), np.full(len(rest[0]), 1e-300)
    for e, run in zip(rest, segments, strict=True):
        for a, b in run:
            if b - a < 64:
                continue
            x = e[:, a:b] - e[:, a:b].mean(axis=1, keepdims=True)
            own = np.abs(np.fft.rfft(x * np.hanning(b - a), axis=1)[:, 1:]) ** 2
            power += own[:, : max(round(share * own.shape[1]), 3)].mean(axis=1) * (b - a)
            usual += np.median(own, axis=1) / np.log(2.0) * (b - a)
    return power / usual
