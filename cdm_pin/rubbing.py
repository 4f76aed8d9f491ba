"""Arms on which most axes rub: friction at all of them is where the search starts.

Found one after another, each law would take over what those not yet found will explain. Where dry and viscous friction
of most axes together explain far more than any one or two laws, they are put in at once, and what the data do not ask
for is taken out again.
"""

from __future__ import annotations

from .bank import Bank
from .candidates import Candidate
from .everywhere import LOUD, RUBBING, apart, at_all_axes, needed, widened
from .fit import Fit
from .leaders import leading
from .leftover import clear_noise
from .places import axis_places
from .search import Search

MOST = 0.6
"""Axes that rub, over motors, that are most of them."""


def rubbing(search: Search, bank: Bank) -> list[Candidate]:
    """Give the friction to start from; none where one or two laws of a bank explain as much, or few axes rub."""
    if not search.problem.torque:
        return []
    model = search.problem.model
    axes = apart(axis_places(model), model)
    clear = search.fit([], clear_noise(search, []))
    common = [c for c in at_all_axes(search, RUBBING) if c.place in axes]
    whole = search.fit(common, clear.whitener)
    if clear.deviance - whole.deviance < LOUD * len(common):
        return []
    least = _by_two(search, bank, clear) - LOUD
    if whole.deviance > least:
        return []
    kept = needed(search, widened(search, common))
    rub = [axis for axis in axes if any(c.place == axis for c in kept)]
    if len(kept) < 3 or len(rub) < max(2.0, MOST * model.n_motors):
        return []
    return kept if search.fit(kept, clear.whitener).deviance < least else []


def _by_two(search: Search, bank: Bank, fit: Fit) -> float:
    """Give the sum of squares that the best two laws leave, or the best correction without a name."""
    patches = [score.statistic for _, score, _ in leading(search, fit, bank, 1, named=False)]
    laws: list[Candidate] = []
    beside = fit
    for _ in range(2):
        laws += [c for c, _, _ in leading(search, beside, bank, 1, laws)]
        beside = search.fit(laws, fit.whitener)
    return min([beside.deviance, *(fit.deviance - s for s in patches)])
