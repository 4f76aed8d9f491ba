"""Torques that answer the motion like something on an axis that swings: a mass on a spring, a liquid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.signal import cont2discrete, lfilter, ss2tf

from .candidates import Candidate
from .drifting import still_errors
from .effect import Columns, Effect, Place, Shape
from .fit import Fit
from .geometry import Vector
from .leftover import left_over
from .likelihood import even_noise
from .motion import Motion
from .places import axis_places
from .search import Search, rms
from .shapes import refine
from .spectra import rises

LOWEST, HIGHEST = 0.2, 0.1
"""Frequencies that are looked at: from this [Hz] up to this share of the rate of the samples."""
DAMPING = (0.01, 0.5)
"""Damping ratios of what swings."""
COARSE = (20, (0.05, 0.25))
"""How many frequencies are tried first, and with which damping ratios."""
SHARE = 0.5
"""Share (of squares) of a motor's error that its answer to the motion makes, in training and unseen recordings."""
RISES = 4.0
"""Power of a residual at some frequency over that at a lower one, from which on it is asked what swings."""


def swing(drive: Vector, rate: float, frequency: float, damping: float) -> Vector:
    """Give swing and its speed, over the natural frequency, of what hangs on an axis, shape (2, n).

    A mass on a spring on an axis of acceleration u swings by x'' + 2 d w x' + w^2 x = -u and acts on the axis with a
    torque that is linear in x and x'.

    Parameters
    ----------
    drive : ndarray, shape (n,)
        Acceleration of the axis [rad/s^2].
    rate : float
        Of the samples [Hz].
    frequency, damping : float
        Natural frequency [Hz] and damping ratio.

    Returns
    -------
    ndarray, shape (2, n)
        w^2 x and w x', as large as the acceleration [rad/s^2].

    Notes
    -----
    Exact for what is linear between samples (first-order hold).
    """
    w = 2.0 * np.pi * frequency
    law = np.array([[0.0, 1.0], [-(w**2), -2.0 * damping * w]]), np.array([[0.0], [-1.0]])
    sampled: Any = cont2discrete((*law, np.diag([w**2, w]), np.zeros((2, 1))), 1.0 / rate, method="foh")
    above, below = ss2tf(*sampled[:4])
    return np.array([lfilter(b, below, drive) for b in above])


def _columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    return Columns(along=(swing(place.along(motion.a, motion.a_m), motion.rate, *shape), place.weights(motion.model)))


def _bounds(motions: Sequence[Motion], place: Place) -> list[tuple[float, float]]:
    return [(LOWEST, HIGHEST * motions[0].rate), DAMPING]


SWING = Effect(
    "unnamed_swing",
    (),
    axis_places,
    _columns,
    lambda beta, shape: {},
    bounds=_bounds,
    signs=(),
    revealed_by="a torque on {place} that answers its motion like something on it that swings at {shape[0]:.3g} Hz",
    reach=0.1,
)
"""What hangs on an axis and swings; the search adds it where it finds one in what the rigid body leaves."""


def swings(search: Search, effects: Sequence[Candidate]) -> list[Candidate]:
    """Give a candidate for what swings on an axis beside some effects, if the spectrum of what is left rises."""
    found = _likeliest(search, effects)
    return [] if found is None else [found[0]]


def _likeliest(search: Search, effects: Sequence[Candidate]) -> tuple[Candidate, Fit] | None:
    """Find what swings on an axis and explains most beside some effects; give their fit in white noise, too.

    None where the spectrum of what a plain fit leaves does not rise anywhere, as that of no smooth law does.
    """
    if not search.problem.torque or not any(search.problem.segments):
        return None
    noise = left_over(search, effects, smooth=False)[1]
    if rises(noise.power)[: search.problem.model.n_motors].max() < RISES:
        return None
    fit = search.fit(effects, even_noise(search, effects))
    count, damping = COARSE
    tried, scores = [], []
    for place in axis_places(search.problem.model):
        low, high = SWING.bounds(search.problem.motions, place)[0]
        high = min(high, search.problem.band.cutoff)
        tried += [Candidate(SWING, place, (f, d)) for f in np.geomspace(low, high, count) for d in damping]
    for candidate in tried:
        scores.append(search.score(fit, candidate).statistic)
        search.forget(candidate)
    return refine(search, fit, tried[int(np.argmax(scores))], rounds=3)[0], fit


def resonance(searches: Sequence[Search], fit: Fit, least: Vector) -> tuple[Candidate, float] | None:
    """Find what swings on an axis and makes most of some motor's error, in training and unseen recordings.

    Masses and effects are estimated anew beside it, in white noise: an autoregression takes its torque for noise.

    Parameters
    ----------
    searches : sequence of Search
        On the training, and on unseen recordings where there are any.
    fit : Fit
    least : ndarray, shape (n_channels,)
        Errors of channels that are not worth asking of.

    Returns
    -------
    (Candidate, float) or None
        What swings, and the root mean square of what it brings that nothing else explains, all motors together [N m].
    """
    found = _likeliest(searches[0], fit.effects)
    if found is None:
        return None
    law, without = found
    beside = searches[0].fit([*fit.effects, law], without.whitener)
    own = np.abs(law.place.weights(fit.problem.model)) > 0.0
    torques, told = [], []
    for there in searches:
        before, after = (rms(there, still_errors(there, f)) for f in (without, beside))
        share = 1.0 - (after / np.maximum(before, 1e-300)) ** 2
        told.append((share > SHARE) & (before > least))
        torques.append(np.sqrt(np.maximum(before**2 - after**2, 0.0)))
    if not np.any(np.all(told, axis=0)[: len(own)] & own):
        return None
    return law, float(np.linalg.norm(torques[0][: len(own)]))
