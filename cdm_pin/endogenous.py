"""Columns that are made from measured torques share their noise, and with it some of what a fit leaves over.

On which side of its play a cable lies, motors alone tell by the torque that they feel. Where that is little more than
its noise, noise decides when the side changes, and the column follows it: a play is found where there is none, in any
recording of that sensor.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from .candidates import Candidate
from .explanation import Explanation, explained
from .fit import Fit
from .geometry import Vector
from .problem import Problem, Run
from .scores import Score
from .search import Search, raw_errors

DRAWS = 8
"""Other noises of the same spectrum that are tried."""
OFTEN, FAR = 3.0, 12.0
"""How many times the mean statistic of these that of a law has to be, and from which on two of them do."""


def without_followers(explanation: Explanation) -> Explanation:
    """Take those plays from an explanation that only follow the noise of the torques by which they are told."""
    search, fit = explanation.search, explanation.fit
    left = [
        f.candidate
        for j, f in enumerate(explanation.found)
        if not follows_noise(search, search.without(fit, j), f.candidate, f.score)
    ]
    return explanation if len(left) == len(explanation.found) else explained(search, explanation.bank, left)


def follows_noise(search: Search, fit: Fit, candidate: Candidate, score: Score) -> bool:
    """Whether a play told by measured torques alone would be found much alike in other noise, without any play.

    What a fit leaves over is taken from the measured torques, and comes back shifted in time, in them and in what is to
    be explained: a play that is there does not move with it.

    Parameters
    ----------
    search : Search
    fit : Fit
        Without the candidate.
    candidate : Candidate
    score : Score
        Of the candidate beside the fit.
    """
    motions = search.problem.motions
    told = candidate.effect.name == "backlash" and all(motion.felt is not None for motion in motions)
    if not told or candidate.is_swinging(motions[0]):
        return False
    rests = raw_errors(search, fit.base, fit.effects, fit.beta)
    found = []
    for k in range(DRAWS):
        found.append(_chance(search, fit, candidate, rests, (k + 1.0) / (DRAWS + 1.0)))
        if k == 1 and score.statistic > FAR * np.mean(found):
            return False
    return bool(score.statistic < OFTEN * np.mean(found))


def _chance(search: Search, fit: Fit, candidate: Candidate, rests: list[Vector], share: float) -> float:
    """Give the statistic of a candidate in noise that is what a fit leaves over, shifted by a share of the time."""
    noises = [np.roll(rest, round(share * rest.shape[1]), axis=1) for rest in rests]
    pairs = zip(search.problem.runs, noises, rests, strict=True)
    runs = tuple(_feeling(run, noise - rest, search.problem) for run, noise, rest in pairs)
    columns = [lines.dense() for lines in replace(search.problem, runs=runs).reduce(candidate.columns)]
    W = fit.rest(search.white(fit.whitener, columns))
    y = fit.rest(search.white(fit.whitener, [noise[None] for noise in noises]))[0]
    return float(np.linalg.lstsq(W.T, y, rcond=1e-9)[0] @ (W @ y))


def _feeling(run: Run, change: Vector, problem: Problem) -> Run:
    """Give a run whose motors feel other torques, by a change in the band, shape (n_channels, n_reduced)."""
    felt, m = run.motion.felt, problem.model.n_motors
    assert felt is not None
    at = np.arange(change.shape[1]) * problem.band.step
    more = CubicSpline(at, change[:m].T)(np.minimum(np.arange(run.motion.n), at[-1]))
    return replace(run, motion=replace(run.motion, felt=replace(felt, torque=felt.torque + more)))
