"""When a push began and when it ended, both at once.

Where most of a push passes for slow noise, what tells it are its two edges. A window that has one of them right and the
other wrong explains little of it, so that no way leads from one pair of edges to the next: all pairs are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .band import Band
from .candidates import Candidate
from .effect import Shape
from .fit import Fit
from .geometry import Vector
from .motion import Motion
from .search import Search

EDGES = 400  # on one recording
LIKELY = 50.0
"""Statistic from which on a push is worth to be looked at so; none so large comes by chance."""


def briefest(band: Band) -> float:
    """Time that a push has to last for a band to tell it from an outlier [s]."""
    return 1.5 / band.cutoff


def run_of(motions: Sequence[Motion], push: Candidate) -> int:
    """Say on which of some motions a push is."""
    return next(r for r, motion in enumerate(motions) if motion.index == int(push.shape[2]))


def edged(search: Search, fit: Fit, push: Candidate) -> tuple[Candidate, float]:
    """Give a push the pair of edges, of all on its recording, that explains most beside a fit.

    A step of torque at one sample is the step at another one, later. With steps s at all of them, whitened and beside
    the fit, a push between two is their difference, and its statistic ((s_a - s_b)' e)^2 / |s_a - s_b|^2.

    Parameters
    ----------
    search : Search
    fit : Fit
    push : Candidate
        An external torque.

    Returns
    -------
    push : Candidate
        With the best edges.
    apart : float
        Time between two neighbouring edges that were compared [s].
    """
    recent, own = search.recent("edged", 32), (fit, push.key, push.shape[2])
    shape, apart = recent.get(*own) or recent.keep(_best_edges(search, fit, push), *own)
    return replace(push, shape=shape), apart


def _best_edges(search: Search, fit: Fit, push: Candidate) -> tuple[Shape, float]:
    """Give the shape of a push with the best edges, and how far those that are compared lie apart [s]."""
    band = search.problem.band
    run = run_of(search.problem.motions, push)
    n = search.problem.data[run].shape[2]
    stride = -(-n // EDGES)
    edges = np.arange(0, n, stride)
    banks = [np.zeros((len(edges), *data.shape[1:])) for data in search.problem.data]
    banks[run] = _steps(search, push, run, edges)
    S = fit.rest(search.white(fit.whitener, banks))
    c, gram = S @ fit.residual, S @ S.T
    size = np.diag(gram)
    between = size[:, None] + size - 2.0 * gram
    shortest = -(-round(briefest(band) * band.reduced_rate) // stride) + 1
    possible = np.triu(between > 1e-6 * max(size.max(), 1e-300), shortest)
    statistic = np.where(possible, (c[:, None] - c) ** 2 / np.where(possible, between, 1.0), -np.inf)
    a, b = np.unravel_index(int(np.argmax(statistic)), statistic.shape)
    start, end = ((edges[i] * band.step - 0.5) / band.rate for i in (a, b))
    return (float(max(start, 0.0)), float(end), *push.shape[2:]), stride / band.reduced_rate


def _steps(search: Search, push: Candidate, run: int, edges: Vector) -> Vector:
    """Columns of pushes from each of some samples on, shape (n_edges, n_channels, n_reduced)."""
    band, n = search.problem.band, search.problem.data[run].shape[2]
    middle, half = n // 2, len(band.taps) // 2 // band.step + 1
    endless = replace(push, shape=((middle * band.step - 0.5) / band.rate, np.inf, *push.shape[2:]))
    step = search.in_band(endless.columns)[run][0]
    since = np.arange(n) - edges[:, None]
    return np.moveaxis(step[:, np.clip(middle + since, max(middle - half, 0), min(middle + half, n - 1))], 0, 1)
