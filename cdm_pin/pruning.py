"""Pruning: effects that the others make superfluous are dropped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .bank import Bank
from .candidates import Candidate
from .everywhere import RUBBING
from .explanation import Explanation, estimated, explained, with_effects
from .fit import Fit, own_covariance
from .friction_effects import DRAG_RATIO
from .leftover import clear_noise
from .likelihood import REFINING, gain, has_ratio, likelihood
from .search import Search
from .settling import settled
from .significance import holds

SINGLY = 0.02
"""Share of what laws at ratios of their own explain by which friction along single axes in their place may be wrong."""


def prune(search: Search, accepted: list[Candidate]) -> list[Candidate]:
    """Drop effects that the others make superfluous."""
    while accepted:
        fit = search.fit(accepted)
        weakest, worst = -1, np.inf
        for j, candidate in enumerate(accepted):
            without = search.without(fit, j)
            score = search.score(without, candidate)
            statistic = -np.inf if _backwards(fit, j) else score.statistic
            if statistic < worst and (statistic < 0.0 or not holds(search, candidate, score, without)):
                weakest, worst = j, statistic
        if weakest < 0:
            return accepted
        accepted = [c for i, c in enumerate(accepted) if i != weakest]
    return accepted


def _backwards(fit: Fit, j: int) -> bool:
    """Whether the leading coefficient of effect `j` cannot be negative but is, by more than three standard errors."""
    std = np.sqrt(max(own_covariance(fit, j)[0, 0], 0.0))
    return fit.effects[j].leads and bool(fit.beta[j][0] < -3 * std)


def pruned(explanation: Explanation) -> Explanation:
    """Drop what is superfluous beside the laws that now stand; when it was asked for, others may have stood there."""
    return with_effects(explanation, prune(explanation.search, [f.candidate for f in explanation.found]))


def still_standing(explanation: Explanation) -> Explanation:
    """Drop pushes that are not significant any more beside what the unseen recordings have left."""
    search, effects = explanation.search, [f.candidate for f in explanation.found]

    def stands(j: int, candidate: Candidate) -> bool:
        if candidate.effect.name != "external_torque":
            return True
        without = search.without(explanation.fit, j)
        return holds(search, candidate, search.score(without, candidate), without)

    kept = [candidate for j, candidate in enumerate(effects) if stands(j, candidate)]
    return explanation if len(kept) == len(effects) else explained(search, explanation.bank, kept)


def warmed(explanation: Explanation) -> Explanation:
    """Let drag drift with the dry friction of its place where that is likelier than drag that stays as it is."""
    search, accepted = explanation.search, [f.candidate for f in explanation.found]
    sized = list(zip(accepted, explanation.fit.beta, strict=True))
    drifts = [(c, b) for c, b in sized if c.effect.name == "friction_drift" and len(c.shape) <= DRAG_RATIO]
    drags = [(c, b) for c, b in sized if c.effect.name == "viscous_friction"]
    pairs = [(x, y) for x in drifts for y in drags if x[0].place.location == y[0].place.location]
    own = likelihood(search, accepted) if pairs else 0.0
    for (drift, friction), (drag, viscous) in pairs:
        ratio = max(float(viscous[0] / max(friction[0], 1e-300)), 0.0)
        both = replace(drift, shape=(*drift.shape, ratio))
        trial = [both if c is drift else c for c in accepted if c is not drag]
        there, laws = settled(search, trial, rounds=6)
        if likelihood(there, laws) > own:
            return warmed(explained(there, there.renewed(explanation.bank), laws))
    return explanation


def coupled(explanation: Explanation) -> Explanation:
    """Leave out what has a ratio of two speeds of its own if another such law, estimated anew, explains as much.

    A coupling that was found beside a friction of the same two motors stays where both together do.
    """
    search, accepted = explanation.search, [f.candidate for f in explanation.found]
    odd = [c for c in accepted if has_ratio(c)]
    if len(odd) < 2:
        return explanation
    own = likelihood(search, accepted)
    for c in sorted(odd, key=search.size):
        there, laws = settled(search, [law for law in accepted if law is not c], rounds=6)
        if likelihood(there, laws) >= own:
            return coupled(explained(there, there.renewed(explanation.bank), laws))
    return explanation


def uncoupled(explanation: Explanation) -> Explanation:
    """Let friction along single axes stand for what turns at a ratio of its own, where it does as well (`singly`)."""
    accepted = [f.candidate for f in explanation.found]
    search, laws = singly(explanation.search, explanation.bank, accepted)
    return explanation if laws is accepted else explained(search, search.renewed(explanation.bank), laws)


def singly(search: Search, bank: Bank, accepted: list[Candidate]) -> tuple[Search, list[Candidate]]:
    """Put dry and viscous friction along single axes in the place of what turns at a ratio of its own, if as likely.

    At a ratio of its own one law is as many in one, whose common errors that ratio takes up.
    """
    odd = [j for j, c in enumerate(accepted) if has_ratio(c) and c.named]
    if not odd:
        return search, accepted
    own, fit = likelihood(search, accepted), search.fit(accepted)
    worth = {j: search.score(search.without(fit, j), accepted[j]).statistic for j in odd}
    for group in ([odd] if len(odd) > 1 else []) + [[j] for j in odd]:
        rest = [c for j, c in enumerate(accepted) if j not in group]
        plain = _rubbing_beside(search, bank, rest, [accepted[j] for j in group])
        if not plain:
            continue
        there, laws = settled(search, [*rest, *plain], rounds=4)
        room = search.settings.within(sum(worth[j] for j in group), SINGLY)
        if own - likelihood(there, laws) < room:
            return singly(there, there.renewed(bank), laws)
    return search, accepted


def _rubbing_beside(search: Search, bank: Bank, rest: list[Candidate], odd: list[Candidate]) -> list[Candidate]:
    """Give the dry and viscous friction, of axes that meet those of some laws, that explain most without them."""
    out: list[Candidate] = []
    taken, model = {c.dry.key for c in rest} | {c.key for c in rest}, search.problem.model
    turned = sum(np.abs(c.place.weights(model)) for c in odd)
    plain = [c for c in bank.laws.candidates if c.effect.name in RUBBING and not c.place.is_pair]
    near = [c for c in plain if c.key not in taken and np.abs(c.place.weights(model)) @ turned > 1e-9]
    whitener = clear_noise(search, [*rest, *odd])
    while near:
        fit = search.fit([*rest, *out], whitener)
        worth = [gain(search, fit, c, search.score(fit, c)) for c in near]
        best = int(np.argmax(worth))
        if worth[best] <= 0.0:
            break
        out.append(near.pop(best))
    return out


def undivided(explanation: Explanation) -> Explanation:
    """Let one law stand where dry friction was found beside what refines it there: it has dry friction in it.

    It takes over what dry friction leaves open about its sign. Not so where that is less likely by more than the two of
    them may be wrong by.
    """
    search, accepted = explanation.search, [f.candidate for f in explanation.found]
    finer = [c for c in accepted if c.effect.name in REFINING]
    pairs = [(j, law) for j, dry in enumerate(accepted) for law in finer if law.dry.key == dry.key]
    own = likelihood(search, accepted) if pairs else 0.0
    for j, law in pairs:
        dry = accepted[j]
        shape = (dry.shape[0], *law.shape[1:])
        whole = replace(law, shape=shape, detail=dry.detail, creeps=dry.creeps, gives=dry.gives)
        single = estimated(explanation, [whole if c is law else c for c in accepted if c is not dry])
        lost = own - likelihood(single.search, [f.candidate for f in single.found])
        if lost < search.settings.within(explanation.found[j].score.statistic):
            return undivided(single)
    return explanation
