"""What likelihoods weigh: models in the noise that suits each best, and what a candidate beside a fit is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .candidates import Candidate
from .effects import SHARING
from .fit import Fit
from .geometry import Vector
from .scores import Score
from .search import Search, errors, rms
from .shapes import refine
from .whitening import Whitener, fit_whitener, log_likelihood, quiet_segments

REFINING = ("stribeck_friction", *SHARING)
"""Laws whose first column is dry friction, the others what refines it."""
ODD = 4.0
"""By how much log-evidence likelier what turns at a ratio of its own with two axes must be than what turns with one."""


def likelihood(search: Search, effects: Sequence[Candidate]) -> float:
    """Give the log-likelihood of effects in the noise that suits them best, less half of BIC's penalty."""
    noise, size = search.noise(effects), search.size(*effects) + len(search.problem.states[0]) + search.n_rigid
    return log_likelihood(noise, search.problem.segments) - 0.5 * np.log(search.fit(effects, noise).n_judged) * size


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


def likeliest(search: Search, fit: Fit, candidate: Candidate, score: Score | None = None) -> tuple[Candidate, Score]:
    """Give friction as it is or without what its law leaves open about its sign, whichever is likelier beside a fit.

    Among laws, one must not pay for what the data do not ask it for.
    """
    score = search.score(fit, candidate) if score is None else score
    if candidate.bare is candidate:
        return candidate, score
    bare, plain = refine(search, fit, candidate.bare, plausibly=True)
    plain = confined(fit, bare, search.white(fit.whitener, search.columns(bare)), plain)
    sound = np.isfinite(plain.statistic) and bare.is_plausible(plain.beta, fit.effects)
    better = sound and gain(search, fit, bare, plain) > gain(search, fit, candidate, score)
    return (bare, plain) if better else (candidate, score)


def gain(search: Search, fit: Fit, candidate: Candidate, score: Score) -> float:
    """Give the log-likelihood gained less half of BIC's penalty."""
    return 0.5 * score.statistic - 0.5 * np.log(fit.n_judged) * (score.k + candidate.extra)


def evidence(search: Search, without: Fit, candidate: Candidate, size: float) -> float:
    """Give the log-likelihood that a candidate gains, less what its parameters could have fitted of anything.

    Before the data are seen, each coefficient may bring a torque as large as that which is explained, `size`, the
    whitened sum of squares: a refinement that the data hardly see costs nothing, one that they would see well costs as
    much as it could have been off. What refines dry friction has coefficients as large as its own. What is estimated of
    the shape counts as it does in Akaike's criterion, but a ratio of speeds, which may be anything, as `ODD`.
    """
    columns = search.white(without.whitener, search.columns(candidate))
    norm = np.linalg.norm(columns, axis=1, keepdims=True)
    left = without.rest(np.divide(columns, norm, out=np.zeros_like(columns), where=norm > 0))
    if candidate.effect.name in REFINING and norm[0] > 0:
        own = slice(1, len(candidate.effect.signs))  # without what details the sign of a velocity
        left[own] *= np.minimum(norm[own] / norm[0], 1.0)
    room = float(np.linalg.slogdet(np.eye(len(left)) + max(size, 1.0) * left @ left.T)[1])
    score = confined(without, candidate, columns, freed(search, without, candidate, search.score(without, candidate)))
    return 0.5 * score.statistic - 0.5 * room - candidate.extra - ODD * has_ratio(candidate)


def has_ratio(candidate: Candidate) -> bool:
    """Whether a law turns at a ratio of its own with two axes."""
    return candidate.place.is_pair or candidate.effect.name == "transmission_coupling"


def confined(fit: Fit, candidate: Candidate, columns: Vector, score: Score) -> Score:
    """Give the score, beside a fit, of friction that brakes everywhere (`Effect.brakes`), near the best that does.

    What drives zeros away leaves the constant of asymmetric friction free to be anything; so it may be none.
    """
    n = candidate.effect.brakes
    if not n or not np.isfinite(score.statistic) or candidate.is_plausible(score.beta, fit.effects):
        return score
    rest = fit.rest(columns)
    gram, c = rest @ rest.T, rest @ fit.residual
    for weight in np.geomspace(1e-6, 1e3, 28) * max(gram[0, 0], 1e-300):
        beta = np.linalg.lstsq(gram + weight * np.diag([0.0 < i < n for i in range(len(c))]), c, rcond=1e-12)[0]
        if candidate.is_plausible(beta, fit.effects):
            return replace(score, statistic=float(2.0 * beta @ c - beta @ gram @ beta), beta=beta)
    return replace(score, statistic=-np.inf)


def freed(search: Search, fit: Fit, candidate: Candidate, score: Score) -> Score:
    """Give the score with what the fit gains where it has coefficients that signs hold at zero, as a candidate may not.

    A peak of friction is none as long as the drag beside it is missing.
    """
    pairs = zip(fit.effects, fit.beta, strict=True)
    held = any(s and b == 0.0 for c, own in pairs for s, b in zip(c.signs, own, strict=False))
    if not held or not np.isfinite(score.statistic):
        return score
    both = search.fit([*fit.effects, candidate], fit.whitener)
    return replace(score, statistic=fit.deviance - both.deviance)
