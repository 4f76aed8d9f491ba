"""Zeros of sensors that drift: seen in what is left over, put beside the rigid body, taken out of errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .candidates import Candidate
from .drift import (
    LONG,
    QUICKER,
    SAMPLED,
    SHORT,
    Drift,
    drift_columns,
    drifting_channels,
    faint,
    slow_shapes,
    without_drift,
)
from .fit import Fit
from .geometry import Vector
from .leftover import plain_rest, smooth_columns
from .recent import kept
from .search import Search, foretold, rms


def with_drift(search: Search, effects: Sequence[Candidate] = (), most: int = QUICKER) -> Search:
    """Give the same search with the slow shapes of sensors' zeros beside the rigid body, where the data show them.

    Judged in what effects and smooth functions of the state leave over, by the frequencies next to theirs; at most
    so many waves are quicker than usual.
    """
    problem, rate = search.problem, search.problem.band.reduced_rate
    if not problem.torque or not any(problem.segments):
        return search
    rest, basis = plain_rest(search, effects, smooth_columns(search))
    seen = rest, basis, problem.segments, rate, problem.model.n_motors
    sampled = problem.sensors.sampled
    channels = drifting_channels(*seen, sampled=sampled)
    if not channels:
        return search
    quicker = 0
    while quicker < most and set(channels) & set(drifting_channels(*seen, quicker + 1, sampled)):
        quicker += 1
    return search.drifting(Drift(slow_waves(search, channels, LONG, quicker), tuple(channels), quicker))


def all_drifting(search: Search) -> Search:
    """Give the same search with slow shapes of every motor's zero, whether these were seen to drift or not."""
    channels = tuple(range(search.problem.model.n_motors))
    return search.drifting(Drift(slow_waves(search, channels, LONG), channels))


def drifts_like(search: Search, other: Search) -> bool:
    """Whether the zeros of the same motors drift as quickly in another search, or none in either."""
    own, theirs = ((d.channels, d.quicker) if d is not None else None for d in (search.drift, other.drift))
    return own == theirs


def is_swamped(search: Search, fit: Fit) -> bool:
    """Whether the drift in a fit is so much larger than what is left that it is no drift of a sensor.

    The drift is that beside laws alone: corrections without a name wander themselves.
    """
    if search.drift is None:
        return False
    own = search.fit([c for c in fit.effects if c.named], fit.whitener).base[search.n_bodies : search.n_rigid]
    drift = [np.tensordot(own, columns, 1) for columns in search.drift.columns]
    m = search.problem.model.n_motors
    size, rest = (rms(search, x)[:m] ** 2 for x in (drift, still_errors(search, fit)))
    return bool(np.any(size > faint(rest, search.problem.sensors.sampled)))


@kept
def own_drifts(search: Search) -> list[Vector]:
    """Columns of what the zeros of torques do on recordings that are judged: for every motor and run alone.

    Something of a constant stays visible beside them, unless they were seen to drift; those of encoders do not.
    """
    channels = range(search.problem.model.n_motors * search.problem.torque)
    if search.drift is None:
        return slow_waves(search, channels, 1.0)
    return slow_waves(search, channels, search.drift.stretch, search.drift.quicker)


def most_drift(search: Search) -> Vector:
    """Say how far the zeros of torques may drift and be no fault, whatever the band holds, shape (n_motors,) [N m]."""
    return SAMPLED * search.problem.sensors.sampled


def shorter_drift(search: Search) -> Search:
    """Give a search with drifts that are no slower than the recordings are long: these leave constants alone."""
    drift = search.drift
    assert drift is not None
    columns = slow_waves(search, drift.channels, SHORT, drift.quicker)
    return search.drifting(replace(drift, columns=columns, stretch=SHORT))


def slow_waves(search: Search, channels: Sequence[int], stretch: float, quicker: int = 0) -> list[Vector]:
    """Give slow shapes of their own to some channels of every run (`drift_columns`)."""
    lengths = [data.shape[2] for data in search.problem.data]
    rate, n = search.problem.band.reduced_rate, search.problem.n_channels
    return drift_columns(lengths, rate, n, channels, stretch, quicker)


def still(search: Search, errors: Sequence[Vector]) -> list[Vector]:
    """Take slow shapes out of torque errors where zeros were seen to drift, per run (n_channels, n_reduced)."""
    if search.drift is None:
        return list(errors)
    rate, m = search.problem.band.reduced_rate, search.problem.model.n_motors
    out = []
    for e, run in zip(errors, search.problem.segments, strict=True):
        shapes = slow_shapes(e.shape[1], rate, search.drift.stretch, search.drift.quicker)
        out.append(np.concatenate([without_drift(e[:m], run, shapes), e[m:]]))
    return out


def still_errors(search: Search, fit: Fit) -> list[Vector]:
    """Compute what a fit leaves of a search's recordings, drifts aside."""
    return still(search, foretold(search, fit))
