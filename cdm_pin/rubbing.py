"""Arms on which most axes rub: friction at all of them is where the search starts, with a delay that is evident.

Found one after another, each law would take over what those not yet found will explain. Where dry and viscous friction
of most axes together explain far more than any one or two laws, they are put in at once, and what the data do not ask
for is taken out again. A logger that is late passes for drag, rotors and hysteresis everywhere, as long as it is not
among them.
"""

from __future__ import annotations

from collections.abc import Sequence

from .bank import Bank, all_candidates
from .candidates import Candidate
from .everywhere import FRICTION, LOUD, RUBBING, apart, at_all_axes, needed, widened
from .fit import Fit
from .leaders import leading
from .leftover import clear_noise
from .masses import about
from .places import axis_places
from .search import Search
from .shapes import refine

MOST = 0.6
"""Axes that rub, over motors, that are most of them."""
EVIDENT, SHARED = 0.5, 0.8
"""Share of what friction leaves over that an evident delay explains; and of what a delay of each motor's own does."""
LIKELY = 0.3
"""Share of that beside signs of one width, from which on it is worth a closer look."""


def evident_delay(search: Search, but: frozenset[tuple[str, str]]) -> tuple[Search, list[Candidate]]:
    """Find the delay of the whole logger that explains most of what friction at all axes leaves over, if one does."""
    motors = search.problem.model.n_motors
    loggers = all_candidates(search.problem, ["time_delay"])
    if not search.problem.torque or motors < 2 or loggers[0].key in but:  # of one motor alone, much looks late
        return search, []
    common = at_all_axes(search, FRICTION)
    beside = search.fit(common, clear_noise(search, common))
    first = refine(about(search, beside), beside, loggers[0], 1)[1]
    if first.statistic <= max(LOUD * motors, LIKELY * EVIDENT * beside.deviance):
        return search, []
    common = widened(search, common)
    beside = search.fit(common, clear_noise(search, common))
    there = about(search, beside)
    logger, *own = (refine(there, beside, c, 3)[0] for c in loggers)
    for _ in range(3):
        there = about(search, there.fit([*common, logger], beside.whitener))
        beside = there.fit(common, beside.whitener)
        logger, score = refine(there, beside, logger, 3)
    each = beside.deviance - there.fit([*common, *own], beside.whitener).deviance
    evident = score.statistic > max(LOUD * motors, EVIDENT * beside.deviance, SHARED * each)
    return (there, [logger]) if evident else (search, [])


def rubbing(search: Search, bank: Bank, start: Sequence[Candidate] = ()) -> list[Candidate]:
    """Give the friction to start from, beside what is found; none where one or two laws explain as much, or few rub."""
    if not search.problem.torque:
        return []
    model = search.problem.model
    axes = apart(axis_places(model), model)
    clear = search.fit(start, clear_noise(search, start))
    common = [*start, *(c for c in at_all_axes(search, RUBBING) if c.place in axes)]
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
    laws = list(fit.effects)
    beside = fit
    for _ in range(2):
        laws += [c for c, _, _ in leading(search, beside, bank, 1, laws)]
        beside = search.fit(laws, fit.whitener)
    return min([beside.deviance, *(fit.deviance - s for s in patches)])
