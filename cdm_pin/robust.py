"""What a statistic is worth where noise comes in bursts, and where encoders are off by a constant they cannot show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.stats import chi2

from .candidates import Candidate
from .doubts import instants, lags, offsets, quicker_drifts, rests, sides, unsure_stretches
from .fit import Fit
from .geometry import Vector
from .problem import Problem
from .scores import Score, scored
from .search import Search
from .walking import walking_noise
from .whitening import Whitener

OF_TIME = ("external_torque", "unnamed_time", "unnamed_stiffening")
"""Functions of time: slow ones look like drifts of zeros."""
BLOCKS = (1, 8, 24)
"""Lengths of bursts, in samples of the band."""
COARSE = 0.7
"""Share of the band up to which positions have to be fine enough for accelerations."""
UNSURE = 1.5
"""How many times larger the errors of accelerations may be than they are estimated to be."""
SURE = 0.95
"""Probability with which noise must be known to be more where an effect acts than elsewhere, for it to count."""


def is_coarse(problem: Problem) -> bool:
    """Whether positions are too coarse for the accelerations in the band."""
    return problem.torque and problem.sensors.trusted < COARSE * problem.band.cutoff


def robust_score(search: Search, fit: Fit, candidate: Candidate) -> Score:
    """Score one candidate beside a fit, with care about what the noise of the fit leaves out.

    Where positions are too coarse for the accelerations in the band, the statistic is no more than where white noise
    clearly larger than what the sensors bring by themselves is there beside what the fit leaves: no residual shows what
    errors of accelerations have in common with the columns. Where zeros walk, what has no name is no more than beside
    noise that does.
    """
    score, cautious = _in_bursts(search, fit, candidate), []
    if not candidate.named and (walking := walking_noise(search, fit)) is not None:
        cautious.append(walking)
    if is_coarse(search.problem) and not _is_travel(search, candidate):
        cautious.append(_with_sensors(search, fit.whitener))
    for noise in cautious:
        other = _in_bursts(search, search.fit(fit.effects, noise), candidate)
        score = replace(score, statistic=min(score.statistic, other.statistic))
    return score


def _with_sensors(search: Search, noise: Whitener) -> Whitener:
    """Give a noise with clearly more than what the sensors bring by themselves beside it."""
    recent = search.recent("with_sensors")
    known = recent.get(noise)
    return known if known is not None else recent.keep(noise.with_white(UNSURE * search.problem.sensed), noise)


def _is_travel(search: Search, candidate: Candidate) -> bool:
    """Whether a candidate is seen where encoders on both sides part, and not in torques alone."""
    m = search.problem.model.n_motors
    return search.problem.kinematic and any(columns[:, m:].any() for columns in search.columns(candidate))


def _in_bursts(search: Search, fit: Fit, candidate: Candidate) -> Score:
    """Score one candidate where noise may come in bursts, and beside constant errors of the encoders.

    Encoders that round down, or whose zero is known to half a step, are off by up to that: such offsets are fitted with
    that much room beside the candidate; and so is what unsure masses stretch soft cables by, what instants bring that
    are as unsure as they are, beside what is a function of time, drifts of zeros a little quicker than was seen, and,
    beside a rotor, what encoders of joints that move together disagree by. Then the statistic is divided by how much
    larger than usual the residual is where the candidate acts, if it is sure to be: the variance of its coefficient is
    then the sandwich's, in blocks (White, Econometrica 48(4), 1980; Newey, West, Econometrica 55(3), 1987). Of a push,
    also just before and after.
    """
    W = search.white(fit.whitener, search.columns(candidate))
    X, Z = fit.rest(W), np.concatenate([offsets(search, fit), unsure_stretches(search, fit)])
    travels = _is_travel(search, candidate)
    if candidate.effect.name in OF_TIME:  # it looks like a drift for a while
        Z = np.concatenate([Z, quicker_drifts(search, fit)])
    if travels:
        Z = np.concatenate([Z, lags(search, fit)])
    if candidate.effect.name == "rotor_inertia":
        Z = np.concatenate([Z, sides(search, fit)])
    if candidate.effect.name != "time_delay":
        Z = np.concatenate([Z, instants(search, fit)])
    room = np.linalg.inv(np.eye(len(Z)) + Z @ Z.T)
    c = X @ fit.residual - (X @ Z.T) @ room @ (Z @ fit.residual)
    gram = X @ X.T - (X @ Z.T) @ room @ (Z @ X.T)
    score = scored(gram, c, np.einsum("ij,ij->i", W, W), np.diag(gram), candidate.signs)
    if not np.isfinite(score.statistic) or not candidate.named:  # the latter leaves what it does not describe
        return score
    own = score.beta @ X
    rest = fit.residual - own
    rest = rest - (room @ (Z @ rest)) @ Z
    worst = bursts(own, rest)
    if travels:
        worst = max(worst, at_rest(own, rests(search, fit)))
    if candidate.effect.name == "external_torque":  # by chance noise may be small for as long as it lasts
        width = round((candidate.shape[1] - candidate.shape[0]) * search.problem.band.reduced_rate)
        worst = max(worst, bursts(around(own, width), rest))
    return replace(score, statistic=score.statistic / max(worst, 1.0))


def at_rest(own: Vector, draws: Vector) -> float:
    """Say how many times the variance of the noise rounding makes along an effect; zero unless it is sure to be more.

    Parameters
    ----------
    own : ndarray, shape (n_rows,)
        What the effect brings, whitened.
    draws : ndarray, shape (n_draws, n_rows)
        What rounding leaves where encoders rest (`doubts.rests`).
    """
    size, n = float(own @ own), len(draws)
    ratio = float(np.mean((draws @ own) ** 2)) / size if size and n else 0.0
    return ratio if ratio * n > float(chi2.ppf(SURE, n)) else 0.0


def around(own: Vector, width: int) -> Vector:
    """Spread what an effect brings over as many samples before and after as it lasts."""
    return np.sqrt(np.maximum(uniform_filter1d(own**2, 3 * max(width, 1)), 0.0))


def bursts(own: Vector, rest: Vector) -> float:
    """Say how many times the noise is larger where an effect acts than on the whole, in variance.

    Zero unless it is sure to be larger at all.

    Parameters
    ----------
    own, rest : ndarray, shape (n_rows,)
        What the effect brings, and what is left beside it, whitened.
    """
    worst = 0.0
    for length in BLOCKS:
        n = len(own) // length * length
        size = (own[:n] ** 2).reshape(-1, length).sum(axis=1)
        if not size.any():
            continue
        together = (own[:n] * rest[:n]).reshape(-1, length).sum(axis=1)
        ratio = float(together @ together / size.sum())
        free = float(size.sum() ** 2 / (size @ size))
        if ratio * free > float(chi2.ppf(SURE, free)):
            worst = max(worst, ratio)
    return worst
