"""Patching: corrections without a name where the catalogue falls short, and laws that stand for them after all."""

from __future__ import annotations

import numpy as np

from .asked import unnamed
from .bank import Bank
from .candidates import Candidate, shares_motor
from .effects import MAPS
from .explanation import Explanation, explained
from .fit import Fit
from .leaders import STRONG, best_of, leading
from .leftover import clear_noise
from .likelihood import gain, likelihood
from .patches import MISREAD
from .search import Search
from .settling import settled
from .shapes import loosened
from .significance import holds, is_loud, is_seconded, passes

OFF, ERRS = 0.01, 0.0025
"""Share of its likelihood that one law, or several together, may lose by errors of their own."""
NEAR = 0.8
"""Share of their gain, in the noise beside them, from which on a correction without a name may be likelier."""


def patch(search: Search, bank: Bank, accepted: list[Candidate]) -> list[Candidate] | None:
    """Put a correction without a name where the catalogue falls short; None where it does not.

    It may be added to what was found, or take the place of all effects that sit at one place: of one or two if it
    explains clearly more, of three and more already if it explains as much.
    """
    s = search.settings
    fit = search.fit(accepted)
    clear = search.fit(accepted, clear_noise(search, accepted))
    added = unnamed(search, bank, accepted)
    if added is not None:
        rest = [c for c in accepted if not c.meets(added)]
        kept = _worth(search, clear, accepted, rest, added)
        return [*(accepted if kept else rest), added]
    for taken in _by_place(accepted):
        rest, without, statistic, old = _given_up(search, clear, accepted, taken)
        for candidate, score, weight in leading(search, without, bank, 2, rest, named=False):
            margin = 0.5 * s.patch_law_error**2 * statistic * (1 if len(taken) < 3 else -1)
            if (
                is_loud(score)
                and passes(search, candidate, score, weight, without)
                and gain(search, without, candidate, score) > old + margin
                and is_seconded(search, search.fit(rest, fit.whitener), candidate, score, weight)
            ):
                return [*rest, candidate]
    return _misreading(search, bank, accepted, clear)


def outdone(search: Search, bank: Bank, accepted: list[Candidate]) -> list[Candidate]:
    """Put a correction without a name in the place of laws, of those at one place or of all, if it is likelier.

    Each in noise of its own: what was estimated beside wrong laws holds what they leave, and then hides by how much
    another one is better. One law has to be clearly less likely, several together no more than they may be wrong by.
    """
    if not accepted or not all(c.named for c in accepted):
        return accepted
    clear, groups = search.fit(accepted, clear_noise(search, accepted)), _by_place(accepted)
    near = []
    for taken in groups if accepted in groups else [*groups, accepted]:
        rest, without, _, old = _given_up(search, clear, accepted, taken)
        for candidate, score, weight in leading(search, without, bank, 1, rest, named=False):
            close = gain(search, without, candidate, score) > NEAR * old
            if close and is_loud(score) and passes(search, candidate, score, weight, without):
                near.append((rest, [*rest, candidate]))
    if not near:
        return accepted
    known, ways = likelihood(search, accepted), [(0.0, accepted)]
    for rest, instead in near:
        worth = known - likelihood(search, rest)
        margin = ERRS * worth if len(accepted) - len(rest) > 1 else max(20.0, OFF * worth)
        ways.append((likelihood(search, instead) - known - margin, instead))
    return max(ways, key=lambda way: way[0])[1]


def _by_place(accepted: list[Candidate]) -> list[list[Candidate]]:
    """Give, for the coordinate of every law, what acts along one that shares a joint or a motor with it."""
    places = {(c.place.A, c.place.B): c for c in accepted if c.named and c.place.A}.values()
    return [[c for c in accepted if c.meets(place)] for place in places]


def _misreading(search: Search, bank: Bank, accepted: list[Candidate], clear: Fit) -> list[Candidate] | None:
    """Put the reading of one encoder in the place of several errors of the cable map; None where it explains less."""
    taken = [c for c in accepted if c.effect.name in MAPS]
    if len(taken) < 2:
        return None
    rest, without, _, old = _given_up(search, clear, accepted, taken)
    readings = [c for c in bank.candidates if c.effect.name == MISREAD]
    gains = [gain(search, without, c, search.score(without, c)) for c in readings]
    return [*rest, readings[int(np.argmax(gains))]] if max(gains, default=old) > old else None


def _given_up(
    search: Search, clear: Fit, accepted: list[Candidate], taken: list[Candidate]
) -> tuple[list[Candidate], Fit, float, float]:
    """Give what is left without some effects, its fit, and what they explained: its size, and their gain as `gain`."""
    rest = [c for c in accepted if c not in taken]
    without = search.fit(rest, clear.whitener)
    statistic = without.deviance - clear.deviance
    return rest, without, statistic, 0.5 * statistic - 0.5 * np.log(clear.n_judged) * search.size(*taken)


def _worth(search: Search, clear: Fit, accepted: list[Candidate], rest: list[Candidate], patch: Candidate) -> bool:
    """Whether the named effects beside a patch explain what the patch alone does not."""
    both = search.fit([*accepted, patch], clear.whitener).deviance
    alone = search.fit([*rest, patch], clear.whitener).deviance
    whole = search.fit(rest, clear.whitener).deviance
    return alone - both > 0.05 * (whole - both)


def has_a_name(search: Search, bank: Bank, grown: list[Candidate], patched: list[Candidate]):
    """Whether one more effect of the catalogue explains all that a correction without a name would."""
    if len(grown) >= search.most:
        return False
    clear = search.fit(grown, clear_noise(search, grown))
    new = [c for c in patched if not c.named and c not in grown]
    winner = best_of(search, clear, [c for c, _, _ in leading(search, clear, bank, 6, grown)])
    if winner is None or not new or not passes(search, *winner, 0.01, clear):
        return False
    own = gain(search, clear, new[0], search.score(clear, new[0]))
    return gain(search, clear, *winner) > own - _nearly(own)


def beside_looser(
    search: Search, bank: Bank, grown: list[Candidate], patched: list[Candidate], most: int = 3
) -> tuple[Search, list[Candidate]] | None:
    """Find the law that explains more than a correction without a name once the shapes of those beside it give way.

    Estimated without it, they may have taken most of it up, such as a ratio of two motors what a gain is off by.
    """
    if not grown or len(grown) >= search.most:
        return None
    clear = search.fit(grown, clear_noise(search, grown))
    loose = loosened(search, clear)
    for law, score, _ in leading(search, loose, bank, most, grown):
        if not law.is_plausible(score.beta, grown) or not is_loud(score):
            continue
        there, laws = settled(search, [*grown, law], rounds=4)
        whitener = clear_noise(there, laws)
        fit, other = there.fit(laws, whitener), search.fit(patched, whitener)
        fewer = search.size(*patched) - there.size(*laws)
        without = there.without(fit, len(laws) - 1)
        stands = holds(there, laws[-1], there.score(without, laws[-1]), without)
        if stands and other.deviance - fit.deviance + np.log(fit.n_judged) * fewer > 0.0:
            return there, laws
    return None


def unpatched(search: Search, bank: Bank, accepted: list[Candidate]) -> tuple[Search, list[Candidate]]:
    """Leave out the corrections without a name if the laws, estimated anew without them, ask for none.

    One that came early may have taken up what a law's shape was off by, and held it there; one that explains less than
    the laws in its place may be wrong by is none, nor is one without which all is likelier.
    """
    named = [c for c in accepted if c.named]
    if not named or len(named) == len(accepted):
        return search, accepted
    alone, laws = settled(search, named, rounds=4)
    left = unnamed(alone, alone.renewed(bank), laws)
    if left is not None:
        fit = alone.fit(laws, clear_noise(alone, laws))
        own = [j for j, c in enumerate(laws) if shares_motor(c, left, search.problem.model)]
        worth = [laws[j].effect.error ** 2 * alone.score(alone.without(fit, j), laws[j]).statistic for j in own]
        asked = alone.score(fit, left).statistic > sum(worth)
        if asked and likelihood(search, accepted) > likelihood(alone, laws):
            return search, accepted
    return alone, laws


def renamed(explanation: Explanation) -> Explanation:
    """Let a law stand for a correction without a name that explains hardly more, if none is asked for beside it.

    A series of many coefficients finds a little more in any noise.
    """
    accepted = [f.candidate for f in explanation.found]
    for j, found in enumerate(explanation.found):
        if found.candidate.named:
            continue
        near = [c for c, d in found.rivals if c.named and d > -_nearly(found.gain)][:2]
        if found.score.statistic > STRONG:  # what is left open of a law may also spoil it
            forms = [(c, c.detailed(explanation.search.problem.motions)) for c in near]
            near = [form for c, free in forms for form in ((c,) if free is c else (free, c))]
        if not near:
            continue
        known, rest = (likelihood(explanation.search, e) for e in (accepted, accepted[:j] + accepted[j + 1 :]))
        least = known - _nearly(known - rest)
        for law in near:
            search, laws = settled(explanation.search, [*accepted[:j], law, *accepted[j + 1 :]], rounds=4)
            bank, without = search.renewed(explanation.bank), search.without(search.fit(laws), j)
            score = search.score(without, laws[j])
            stands = laws[j].is_plausible(score.beta, without.effects) and holds(search, laws[j], score, without)
            stands = stands and likelihood(search, laws) > least
            if stands and unnamed(search, bank, laws) is None:
                return renamed(explained(search, bank, laws))
    return explanation


def _nearly(worth: float) -> float:
    """Give the log-likelihood by which a law may explain less than a correction without a name, worth so much."""
    return max(20.0, 0.03 * worth)
