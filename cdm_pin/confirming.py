"""Whether unseen recordings confirm a finding: are they likelier with it, does their plain error fall."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .drifting import still, still_errors
from .explanation import Explanation
from .fit import Fit
from .geometry import Vector
from .likelihood import likelihood
from .search import Search, errors, foretold, rms
from .significance import is_loud
from .unexplained import noise_floor
from .unseen import deviance_unseen, updated

ONCE = ("external_torque", "unnamed_time", "unnamed_wear", "unnamed_stiffening", "unnamed_gain_drift", "unnamed_tone")
"""What happens at a time of its own: another recording cannot judge it."""
CARRIED = 0.1
"""Share of the squared error on unseen recordings that a finding beyond doubt leaves."""
MOSTLY = 0.4
"""Share that is left on its motors of the squared error by a finding that is louder there than all else."""
BLIND = 3.0
"""Whitened sum of squares of a finding on unseen recordings that cannot show it."""
SURE = 15.0
"""Penalised log-likelihood of a finding in the training that chance does not give."""
RARE = 4.7
"""By how many times the root of what is due chance takes from it in one of a hundred cases."""
RISES = ((0.8, 100.0, 1.3), (0.5, 20.0, 1.03))
"""Share of what is due by which the whitened sum falls, least fall, and times that the plain error may rise then."""


def helps(judge: Search, explanation: Explanation, j: int) -> bool:
    """Whether the unseen recordings are likelier with finding `j` than without it, by as much as they should be.

    Where it is right, the whitened sum of squares falls by that of what it changes there, give or take twice the root
    (`asked_of`). The plain error, drifts aside, must not rise either, or hardly where nearly all is there that was due,
    unless masses that the training could not tell make most of it.
    Where nearly all of the plain error goes, no more is asked: slow noise could hide a constant from the likelihood.
    What is loud in the training, and would not show on the unseen recordings, they cannot speak against. What is little
    more than other laws may be wrong by is none of that only if it leaves nothing but noise.
    """
    found, fit = explanation.found[j], explanation.fit
    if fit.effects[j].effect.name in ONCE:
        return True
    without = explanation.search.without(fit, j)
    if fit.effects[j].is_swinging(explanation.search.problem.motions[0]):  # its columns say nothing of a rigid cable
        if swing_gain(explanation.search, fit, without) <= 0.0:
            return False
        rigid = explanation.search.stiff.fit(list(without.effects))
        level = np.maximum(noise_floor(judge, fit.effects), 1e-12)
        rest = still(judge, errors(judge.stiff, rigid.base, rigid.effects, rigid.beta))
        return plain_errors(judge, fit)[0] < in_noise(judge, rest, level)
    with_it, without_it = plain_errors(judge, fit, without)
    if with_it < CARRIED * without_it:
        return True
    due = change_unseen(judge, explanation, j)
    if due < BLIND and is_loud(found.score):
        return True
    fall = deviance_unseen(judge, without) - deviance_unseen(judge, fit)
    if fall < asked_of(due, found.gain, found.candidate.named):
        return False
    rise = next((rise for share, least, rise in RISES if fall > max(share * due, least)), 1.01)
    others = sum(f.score.statistic for f in explanation.found) - found.score.statistic
    if found.score.statistic < (2.0 * explanation.search.settings.law_error) ** 2 * others:
        return with_it < min(without_it, 1.5 * judge.problem.n_channels)
    return with_it < rise * without_it or with_it > 9.0 * judge.problem.n_channels


def asked_of(due: float, gain: float, named: bool = True) -> float:
    """Say by how much the sum of squares on unseen recordings has to fall, of which `due` is what is to be expected.

    A tenth, and 3 for what has a name; of what the training is sure of no more than what chance leaves of what is due.
    """
    least = max(3.0 * named, 0.1 * due)
    return min(least, max(due - RARE * float(np.sqrt(due)), 0.0)) if gain > SURE else least


def change_unseen(judge: Search, explanation: Explanation, j: int) -> float:
    """Give the whitened sum of squares of what finding `j` changes on the unseen recordings."""
    fit, without = explanation.fit, explanation.search.without(explanation.fit, j)
    change = [(a - b)[None] for a, b in zip(foretold(judge, fit), foretold(judge, without), strict=True)]
    return updated(judge, without, change)[0]


def plain_errors(judge: Search, fit: Fit, *others: Fit) -> list[float]:
    """Give the squared errors of fits on the unseen recordings, drifts aside, in units of the first one's noise."""
    level = np.maximum(noise_floor(judge, fit.effects), 1e-12)
    return [in_noise(judge, still_errors(judge, f), level) for f in (fit, *others)]


def carries(judge: Search, explanation: Explanation, j: int) -> bool:
    """Whether finding `j` takes nearly all of the plain error of recordings away, whatever is left."""
    with_it, without_it = plain_errors(judge, explanation.fit, explanation.search.without(explanation.fit, j))
    return with_it < CARRIED * without_it


def is_loud_there(judge: Search, explanation: Explanation, j: int) -> bool:
    """Whether finding `j` takes most of the plain error of recordings away on a motor on which it acts."""
    place, model = explanation.found[j].candidate.place, judge.problem.model
    if not place.A + place.B:
        return False
    fits = explanation.fit, explanation.search.without(explanation.fit, j)
    own = np.abs(place.weights(model)) > 0.0
    with_it, without_it = (rms(judge, still_errors(judge, f))[: model.n_motors][own] ** 2 for f in fits)
    return bool(np.any(with_it < MOSTLY * without_it))


def in_noise(search: Search, errors: Sequence[Vector], level: Vector) -> float:
    """Give the squared errors of all channels, each in units of its noise `level`, shape (n_channels,)."""
    return float(np.sum((rms(search, errors) / level) ** 2))


def swing_gain(search: Search, fit: Fit, without: Fit) -> float:
    """Give the penalised log-likelihood that links which swing on a soft cable gain over those on a rigid one."""
    return likelihood(search, fit.effects) - likelihood(search.stiff, without.effects)
