"""Polishing: each effect is looked at again given the others; a better one, or one for two, may take its place."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .bank import Bank
from .candidates import Candidate, twins
from .effects import DRAGS
from .leaders import best_of, leading, same_width
from .leftover import clear_noise
from .likelihood import gain, has_ratio, likelihood
from .masses import about
from .model import CableModel
from .places import delay_places
from .search import Search
from .settling import settled
from .shapes import refine
from .significance import from_errors_of_laws, passes
from .whitening import Whitener

MANY = 6
"""Effects beyond which those that have been looked at together are not again with each one that comes."""


def polish(search: Search, bank: Bank, accepted: list[Candidate], rounds: int = 2) -> list[Candidate]:
    """Look again at each effect given the others: let a better one take its place, or one take the place of two.

    Not the latter while columns are provisional: what they are off by would look like a second effect.
    """
    for _ in range(rounds):
        before, whitener = accepted, clear_noise(search, accepted)
        for j in _named(accepted):
            others = [c for i, c in enumerate(accepted) if i != j]
            fit = search.fit(others, whitener)
            rivals = leading(search, fit, bank, 6, others, instead=[accepted[j]])
            leaders = [c for c, _, _ in rivals if not _is_same(c, accepted[j], search.problem.model)]
            trial = best_of(search, fit, [accepted[j], *leaders])
            if trial is not None:
                accepted = [*others[:j], trial[0], *others[j:]]
        if is_provisional(before, accepted):
            break
        accepted = _merge(search, bank, accepted, whitener)
        accepted = _split(search, bank, accepted, whitener)
        if {c.key for c in accepted} == {c.key for c in before}:
            break
        if _leans_on(search, whitener, before, accepted):
            return before
    return accepted


def _named(accepted: Sequence[Candidate]) -> list[int]:
    return [j for j, c in enumerate(accepted) if c.named]


def _is_same(candidate: Candidate, other: Candidate, model: CableModel) -> bool:
    """Whether two are the same effect at the same place, or at one that turns with it."""
    if candidate.effect != other.effect:
        return False
    return candidate.key == other.key or candidate.place in twins(other, model)


def all_late(search: Search, accepted: list[Candidate]) -> tuple[Search, list[Candidate]]:
    """Let the whole logger be late in the place of those motors that were found to be, where that is likelier.

    What a delay brings at other motors may have passed for drag.
    """
    late = [c for c in accepted if c.effect.name == "time_delay" and c.location["kind"] == "motor"]
    if not late:
        return search, accepted
    others, best = [c for c in accepted if c not in late], likelihood(search, accepted)
    logger = replace(late[0], place=delay_places(search.problem.model)[0])
    logger = refine(search, search.fit(others), logger, 3)[0]
    for beside in ([c for c in others if c.effect.name not in DRAGS], others):
        there, laws = settled(search, [*beside, logger], rounds=4)
        if likelihood(there, laws) > best:
            return there, laws
    return search, accepted


def is_provisional(before: Sequence[Candidate], after: Sequence[Candidate]) -> bool:
    """Whether effects are others than before, and columns of one, taken about those, are not yet what they will be."""
    if {c.key for c in before} == {c.key for c in after}:
        return False
    return any(c.effect.follows and not c.effect.exact for c in after)


def _leans_on(search: Search, whitener: Whitener, before: list[Candidate], after: list[Candidate]) -> bool:
    """Whether effects on the torque of others explain less once what they took the place of is out of that torque."""
    lost = [c for c in before if c.loads and c.key not in {x.key for x in after}]
    if not lost or not any(c.effect.follows for c in after):
        return False
    there = about(search, search.fit(after, whitener))
    old, new = search.fit(before, whitener), there.fit(after, whitener)
    penalty = np.log(old.n_judged) * (search.size(*after) - search.size(*before))
    return new.deviance + penalty > old.deviance + 10.0


def _merge(search: Search, bank: Bank, accepted: list[Candidate], whitener: Whitener) -> list[Candidate]:
    """Replace two effects by one where one explains as much; of many, the newest and another."""
    n, close = len(accepted), search.settings.close
    for i, j in itertools.combinations(range(n), 2):
        if not (accepted[i].named and accepted[j].named) or (n > MANY and j < n - 1):
            continue
        without = search.without(search.fit(accepted, whitener), i, j)
        others = list(without.effects)
        pair = without.deviance - search.fit(accepted, whitener).deviance
        k = sum(search.score(without, c).k + c.extra for c in (accepted[i], accepted[j]))
        both = 0.5 * pair - 0.5 * np.log(without.n_judged) * k
        leaders = leading(search, without, bank, 4, others, instead=[accepted[i], accepted[j]])
        single = best_of(search, without, [c for c, _, _ in leaders])
        if single is None:
            continue
        if has_ratio(single[0]):  # at the right ratio it may come near any two
            least = both + close
        else:
            least = both - max(close, 0.02 * min(_alone(search, accepted, x, whitener) for x in (i, j)))
        if gain(search, without, *single) >= least:
            return [*others, single[0]]
    return accepted


def _split(search: Search, bank: Bank, accepted: list[Candidate], whitener: Whitener) -> list[Candidate]:
    """Put two effects in the place of one that stood for both, where it and any next one explain less."""
    whole = search.fit(accepted, whitener)
    reached = whole.deviance < whole.n_judged + 4.0 * np.sqrt(2.0 * whole.n_judged)
    large = [j for j in _named(accepted) if not reached or search.size(accepted[j]) > 2]
    after = [gain(search, whole, c, s) for c, s, _ in leading(search, whole, bank, 1, accepted)] if large else []
    for j in large:
        old, without = accepted[j], search.without(whole, j)
        others = list(without.effects)
        own = search.score(without, old)
        if not np.isfinite(own.statistic):
            continue
        base = gain(search, without, old, own) + max([0.0, *after])
        slack = 0.5 * search.settings.law_error**2 * own.statistic
        best: tuple[float, list[Candidate]] | None = None
        leaders = [c for c, _, _ in leading(search, without, bank, 4 if reached else 7, others, instead=[old])]
        leaders = [c.detailed(search.problem.motions) if old.detail else c for c in leaders if c.key != old.key]
        firsts = [refine(search, without, same_width(c, old)) for c in leaders]
        firsts = [(first, s) for first, s in firsts if np.isfinite(s.statistic)]
        fits = [search.fit([*others, first], whitener) for first, _ in firsts]
        search.meet(fits, bank.laws)
        for (first, s), beside in zip(firsts, fits, strict=True):
            second = best_of(search, beside, [c for c, _, _ in leading(search, beside, bank, 3, [*others, first])])
            if second is None or not passes(search, *second, 0.01, beside):
                continue
            value = gain(search, without, first, s) + gain(search, beside, *second)
            simpler = s.k + first.extra + second[1].k + second[0].extra < own.k + old.extra
            margin = -slack if simpler else 10.0 + 0.5 * old.effect.error**2 * own.statistic
            if value > base + margin and (best is None or value > best[0]):
                best = value, [*others[:j], first, *others[j:], second[0]]
        if best is not None:
            return best[1]
    return accepted


def _alone(search: Search, accepted: list[Candidate], j: int, whitener: Whitener) -> float:
    """Bound the statistic that effect `j` would get from errors of the other laws."""
    candidate, without = accepted[j], search.without(search.fit(accepted, whitener), j)
    if not without.effects:
        return 0.0
    columns = without.rest(search.white(whitener, search.columns(candidate)))
    return from_errors_of_laws(search, candidate, search.score(without, candidate).beta @ columns, without)
