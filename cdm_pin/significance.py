"""Whether an effect is significant: visible, resolved, no burst of noise and no error of the other laws."""

from __future__ import annotations

import numpy as np

from .candidates import Candidate
from .doubts import errors_of_laws
from .drifting import still_errors
from .fit import Fit
from .geometry import Vector
from .resolved import is_resolved, outdoes_in_means
from .robust import robust_score
from .scores import Score, family_wise
from .search import Search, rms
from .shapes import refine

FAR = 10.0
"""How many times its noise what a fit leaves has to be for one law that explains it wholly to need no more."""
WHOLE = 0.95
"""Share that is as good as all of it."""


def passes(search: Search, candidate: Candidate, score: Score, weight: float, fit: Fit) -> bool:
    """Whether a candidate is significant, visible, and more than an error of the laws in the fit or in the model.

    What it leaves open about the sign of its velocity, which may look like much else, does not count.
    """
    candidate, score = _bare(search, fit, candidate, score)
    if not candidate.effect.counts:
        candidate, score = refine(search, fit, candidate)
    robust = is_significant(search, candidate, score, weight, fit)
    if robust is None or _worsens(search, fit, candidate):
        return False
    if not (fit.effects or search.problem.model.manipulator.effects):
        return True
    own = score.beta @ fit.rest(search.white(fit.whitener, search.columns(candidate)))
    if robust.statistic > from_errors_of_laws(search, candidate, own, fit) or _leaves_noise(search, fit, candidate):
        return True
    return outdoes_in_means(search, candidate, score.beta, fit)


def holds(search: Search, candidate: Candidate, score: Score, without: Fit) -> bool:
    """Whether an effect in the model passes as a new one would, or is resolved and too loud for an error of laws."""
    if passes(search, candidate, score, 0.01, without):
        return True
    bare, score = _bare(search, without, candidate, score)
    return is_resolved(search, bare, score.beta, without) and is_loud(robust_score(search, without, bare))


def is_significant(search: Search, candidate: Candidate, score: Score, weight: float, fit: Fit) -> Score | None:
    """Give the robust score of a candidate that is visible, resolved and significant, also robustly; else None.

    A shape that is a little wrong leaves bursts behind, so it is estimated before a candidate is given up for them.
    """
    s = search.settings
    if score.visible <= s.visible or family_wise(score, candidate, weight) >= np.log(s.alarm):
        return None
    if not is_resolved(search, candidate, score.beta, fit):
        return None
    for own in (lambda: candidate, lambda: refine(search, fit, candidate)[0]):
        robust = robust_score(search, fit, own())
        if family_wise(robust, candidate, weight) < np.log(s.alarm):
            return robust
    return None


def _bare(search: Search, fit: Fit, candidate: Candidate, score: Score) -> tuple[Candidate, Score]:
    """Give a candidate, and its score, without what it leaves open about the sign of its velocity."""
    return (candidate, score) if candidate.bare is candidate else (candidate.bare, search.score(fit, candidate.bare))


def _leaves_noise(search: Search, fit: Fit, candidate: Candidate) -> bool:
    """Whether a law, its shape estimated, leaves of what is far above the noise next to nothing but noise.

    An error of other laws is not all of one simple shape.
    """
    excess = fit.deviance - fit.n_judged
    if not candidate.named or excess < FAR * fit.n_judged:
        return False
    return refine(search, fit, candidate, 3)[1].statistic > WHOLE * excess


def _worsens(search: Search, fit: Fit, candidate: Candidate, most: float = 10.0) -> bool:
    """Whether the plain error, drifts aside, grows many times with what makes the whitened one fall.

    It does where next to nothing counts at some frequencies, as slow noise is large there, and masses and a candidate
    may cancel each other.
    """
    both = search.fit([*fit.effects, candidate], fit.whitener)
    own, other = (rms(search, still_errors(search, f)) for f in (both, fit))
    return bool(np.mean((own / np.maximum(other, 1e-300)) ** 2) > most**2)


def from_errors_of_laws(search: Search, candidate: Candidate, own: Vector, fit: Fit) -> float:
    """Bound the statistic that a candidate gets from laws in the fit that are right up to a small share of themselves.

    The error may take any sign at any sample, so that it can look like the candidate's `own` part, as far as the fit
    leaves it over, where the two are there together.
    """
    share = 1.0 if candidate.named and candidate.effect.name != "external_torque" else search.settings.patch_error
    return float((np.abs(own) @ errors_of_laws(search, fit)) ** 2 / max(own @ own, 1e-300)) * share**2


def is_seconded(search: Search, fit: Fit, candidate: Candidate, score: Score, weight: float) -> bool:
    """Whether a correction that is loud in the clear noise is significant with care too, unless it drowns all."""
    if score.statistic > 2000.0:
        return True
    return family_wise(search.score(fit, candidate), candidate, weight) < np.log(search.settings.alarm)


def is_loud(score: Score) -> bool:
    """Whether a statistic is many times any threshold."""
    return score.statistic > 120.0 + 25.0 * score.k
