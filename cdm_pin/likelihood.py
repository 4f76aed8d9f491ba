"""Likelihoods of models, each in the noise that suits it best."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .effects import Candidate
from .geometry import Vector
from .search import Search, errors, rms
from .whitening import Whitener, fit_whitener, log_likelihood, quiet_segments


def likelihood_ratio(
    search: Search, effects: Sequence[Candidate], candidate: Candidate, least: float = 0.0
) -> tuple[Whitener, float]:
    """Set a model with a candidate against the model without it, each in the noise that suits it best.

    A slow effect looks like slow noise as long as it is not in the model; what tells them apart is that noise
    would do the same all the time.

    Parameters
    ----------
    effects : sequence of Candidate
        In either model.
    candidate : Candidate
    least : float
        A ratio below this need not be exact.

    Returns
    -------
    whitener : Whitener
        The noise where the candidate is in the model.
    ratio : float
        Twice the log-likelihood gained.
    """
    whole, shared = [*effects, candidate], search.noise(effects)
    residuals = _errors(search, whole, shared)
    quiet = quiet_segments(residuals, search.problem.segments)

    def noise(residuals: Sequence[Vector]) -> tuple[Whitener, float]:
        whitener = fit_whitener(residuals, quiet, search.settings.order, search.problem.blocks)
        return whitener, log_likelihood(whitener, quiet)

    own, with_it = noise(residuals)
    without = noise(_errors(search, effects, shared))[1]
    fitted = noise(_errors(search, whole, search.noise(whole)))  # in slow noise, a slow effect may not have been
    if fitted[1] > with_it:
        own, with_it = fitted
    if 2.0 * (with_it - without) > least - 5.0:
        own, with_it = noise(_errors(search, whole, own))
        without = max(without, noise(_errors(search, effects, own))[1])
    return own, 2.0 * (with_it - without)


def even_noise(search: Search, effects: Sequence[Candidate]) -> Whitener:
    """White noise as large as what rigid body and effects leave over."""
    level = np.maximum(rms(search, _errors(search, effects, search.plain)), 1e-12)
    return Whitener.white(level, len(search.problem.runs))


def _errors(search: Search, effects: Sequence[Candidate], whitener: Whitener) -> list[Vector]:
    """Take rigid body and effects, fitted in a given noise, from the data."""
    fit = search.fit(effects, whitener)
    return errors(search, fit.base, fit.effects, fit.beta)
