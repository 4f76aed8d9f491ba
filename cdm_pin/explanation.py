"""An explanation: the effects that the search arrived at, each set against its rivals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from .bank import Bank
from .candidates import Candidate
from .fit import Fit, own_covariance
from .leaders import drives, hides_in_masses, leading, same_form, same_width
from .likelihood import confined, freed, gain, likeliest
from .scores import Score, family_wise
from .search import Search
from .settling import tied
from .shapes import refine, tuned

Weighed = tuple[Candidate, float]


@dataclass(frozen=True)
class Found:
    """An effect in the model, with what was compared with it.

    Attributes
    ----------
    candidate : Candidate
    score : Score
        Given all the others.
    gain : float
        Penalised log-likelihood (half of BIC's difference).
    log_p : float
        Natural log of the family-wise p-value.
    find_rivals : callable
        Gives `rivals`.
    agreement : float
        With what the unseen recordings alone make of it, 1 where that was not asked.
    """

    candidate: Candidate
    score: Score
    gain: float
    log_p: float
    find_rivals: Callable[[], Sequence[Weighed]] = tuple
    agreement: float = 1.0

    @property
    def rivals(self) -> Sequence[Weighed]:
        """Others in its place, with their penalised log-likelihood less this one's; best first.

        Friction counts in that form, on either side, that is likeliest (`likeliest`). They are not looked for before
        they are asked for: what is still to be changed needs none.
        """
        return self.find_rivals()


@dataclass(frozen=True)
class Explanation:
    """The set of effects that the search arrived at.

    Attributes
    ----------
    found : tuple of Found
    fit : Fit
    rigid : Fit
        Without any effect, in the same noise.
    bank : Bank
        All candidates that were screened.
    search : Search
        What computes further scores.
    everywhere : bool
        Whether nearly every axis rubs, so that corrections without a name did not compete.
    outdid : tuple of Candidate
        Laws in whose place there is a correction without a name, as it is a little likelier.
    """

    found: tuple[Found, ...]
    fit: Fit
    rigid: Fit
    bank: Bank
    search: Search
    everywhere: bool = False
    outdid: tuple[Candidate, ...] = ()

    @property
    def scores(self) -> list[Score]:
        """Of all candidates with a name, given the found ones."""
        return self.search.score_all(self.fit, self.bank.laws)

    @property
    def worth(self) -> float:
        """Fall of the whitened sum of squares by all effects together."""
        return self.rigid.deviance - self.fit.deviance


def explained(search: Search, bank: Bank, accepted: list[Candidate]) -> Explanation:
    """Fit a set of effects and set each against its rivals."""
    search = tied(search, accepted)
    bank = search.renewed(bank) if search.problem.posture != bank.problem.posture else bank
    fit = search.fit(accepted)
    rigid = search.fit([], fit.whitener)
    found = tuple(_compare(search, bank, accepted, j) for j in range(len(accepted)))
    return Explanation(found, fit, rigid, bank, search)


def _compare(search: Search, bank: Bank, accepted: list[Candidate], j: int) -> Found:
    """Set an accepted effect against everything that could stand in its place."""
    candidate = accepted[j]
    without = search.without(search.fit(accepted), j)
    score = freed(search, without, candidate, search.score(without, candidate))
    own = gain(search, without, candidate, score)
    rivals = cache(lambda: _rivals(search, bank, without, accepted, candidate, score))
    return Found(candidate, score, own, family_wise(score, candidate, 0.01), rivals)


def _rivals(
    search: Search, bank: Bank, without: Fit, accepted: list[Candidate], candidate: Candidate, score: Score
) -> list[Weighed]:
    """List what could stand in the place of an effect beside a fit, the likeliest first."""
    own = gain(search, without, candidate, score)
    likely = max(own, gain(search, without, *likeliest(search, without, candidate, score)))
    rivals = []
    for leader, _, _ in leading(search, without, bank, 12, accepted, None, [candidate]):
        if leader.key == candidate.key:  # another push
            continue
        if candidate.detail:
            leader = leader.detailed(search.problem.motions)
        leader = same_form(same_width(leader, candidate), candidate)
        s = freed(search, without, leader, search.score(without, leader))
        if gain(search, without, leader, s) > own - max(30.0, 0.1 * abs(own)):
            refined, s = likeliest(search, without, *refine(search, without, leader, plausibly=True))
            s = freed(search, without, refined, s)
            s = confined(without, refined, search.white(without.whitener, search.columns(refined)), s)
            sound = np.isfinite(s.statistic) and refined.is_plausible(s.beta, without.effects)
            if sound and not (hides_in_masses(search, without, refined) or drives(search, without, refined)):
                rivals.append((refined, gain(search, without, refined, s) - likely))
    return sorted(rivals, key=lambda item: -item[1])


def with_effects(explanation: Explanation, effects: list[Candidate]) -> Explanation:
    """Give the explanation by these effects, unless that makes one of them no such law; see `estimated`."""
    changed = estimated(explanation, effects)
    return explanation if unsound(changed, explanation) else changed


def estimated(explanation: Explanation, effects: list[Candidate]) -> Explanation:
    """Give the explanation by these effects, their shapes estimated together; itself if they are its own."""
    if effects == [f.candidate for f in explanation.found]:
        return explanation
    search = explanation.search
    return explained(search, explanation.bank, tuned(search, effects, search.noise(effects)))


def unsound(explanation: Explanation, before: Explanation) -> frozenset[tuple[str, str]]:
    """List the laws that stood not there before and whose coefficients are not such as they may have.

    What the others leave nothing of has none: it is superfluous.
    """
    effects, out = [f.candidate for f in explanation.found], set()
    known = {f.candidate.key for f in before.found}
    for j, found in enumerate(explanation.found):
        law, score, others = found.candidate, found.score, [*effects[:j], *effects[j + 1 :]]
        sound = np.isfinite(score.statistic) and (
            law.is_plausible(score.beta, others) or _nearly_brakes(explanation, j)
        )
        if law.named and law.key not in known and score.k and not sound:
            out.add(law.key)
    return frozenset(out)


def _nearly_brakes(explanation: Explanation, j: int) -> bool:
    """Whether finding `j` brakes everywhere (`Effect.brakes`) for all that is known: it is off that by no error."""
    n = explanation.found[j].candidate.effect.brakes
    if not n:
        return False
    level, waves = explanation.fit.beta[j][0], explanation.fit.beta[j][1:n]
    depth = np.linalg.norm(waves)
    slope = np.r_[-1.0, waves / max(depth, 1e-300)]
    spread = own_covariance(explanation.fit, j)[:n, :n]
    return bool(level > 0.0 and depth - level <= np.sqrt(slope @ spread @ slope))
