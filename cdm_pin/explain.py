"""The search: add the effect that the data ask for most, look again at all, stop when nothing is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from .asked import unnamed
from .bank import Bank, all_candidates
from .candidates import Candidate
from .events import ProgressCallback, Reporter
from .everywhere import everything, rubs_everywhere
from .explanation import Explanation, explained
from .growing import adjusted, grow
from .leftover import clear_noise, tones
from .patching import beside_looser, has_a_name, outdone, patch, renamed, unpatched
from .plainness import peaked, peakless, placed, plainer, repelled, simplest, whole
from .polishing import all_late
from .pruning import coupled, prune, pruned, singly, uncoupled, warmed
from .resonance import swings
from .rubbing import evident_delay, rubbing
from .search import Search
from .settling import settled

WANDERS = "unnamed_time"
"""What the columns of drifting zeros say already, where there are any."""


def explain(
    search: Search,
    progress: ProgressCallback | None = None,
    but: frozenset[tuple[str, str]] = frozenset(),
    start: Sequence[Candidate] = (),
) -> Explanation:
    """Find the effects that the rigid body leaves out.

    Two estimates of the noise are used: significance is judged in the residual of the model as it stands, in which
    whatever is still missing counts as noise (exact when nothing is missing, cautious otherwise); rivals are compared
    in the residual that common effects have been taken out of as well.

    Parameters
    ----------
    search : Search
    progress : callable, optional
        Called with the name of the step and the fraction done.
    but : frozenset of (str, str)
        Keys of candidates that are left out.
    start : sequence of Candidate
        What is in the model already.

    Returns
    -------
    Explanation
    """
    say = Reporter(search, progress)
    say("columns of every effect", 0.0)
    bank = search.bank(
        [
            c
            for c in (*all_candidates(search.problem), *tones(search, start), *swings(search, start))
            if c.key not in but and (search.drift is None or c.effect.name != WANDERS)
        ]
    )
    accepted, late = list(start), list[Candidate]()
    if not start:
        search, late = evident_delay(search, but)
        bank, accepted = search.renewed(bank), late
        if common := [c for c in rubbing(search, bank, late) if c.key not in but]:
            search, bank, accepted = adjusted(search, bank, common, clear_noise(search, common))
            search.settings = replace(search.settings, most=search.settings.most + len(accepted))  # faults beside it
    turns = 1 + search.most // search.settings.at_once
    for turn in range(turns):
        say("searching", 0.1 + 0.8 * turn / turns)
        before = {c.key for c in accepted}
        search, bank, grown = grow(search, bank, accepted, say)
        if not turn and grown and rubs_everywhere(search, bank, grown):
            return everything(search, bank, say, late)
        accepted = patch(search, bank, grown) or grown
        if accepted is grown:
            if len(grown) < search.settings.at_once or {c.key for c in grown} == before:
                break
        elif has_a_name(search, bank, grown, accepted):
            accepted = grown
        elif (law := beside_looser(search, bank, grown, accepted)) is not None:
            search, accepted = law
            bank = search.renewed(bank)
    say("rivals", 0.9)
    search, accepted = all_late(search, accepted)
    kept = prune(search, accepted)
    left = unnamed(search, search.renewed(bank), kept) if len(kept) < len(accepted) else None
    search, accepted = settled(search, kept if left is None else [*kept, left])  # two may have hidden each other
    if accepted and all(c.named for c in accepted):  # or an estimate have hid one
        bank = search.renewed(bank)
        there, _, more = grow(search, bank, accepted, say)
        if len(more) > len(accepted):
            search, accepted = settled(there, prune(there, more))
    search, accepted = unpatched(search, bank, accepted)
    search, accepted = singly(search, search.renewed(bank), accepted)
    bank = search.renewed(bank)
    better = outdone(search, bank, accepted)
    explanation = finished(search, bank, better)
    say.looked(explanation.fit)
    return explanation if better is accepted else replace(explanation, outdid=tuple(accepted))


def finished(search: Search, bank: Bank, accepted: list[Candidate]) -> Explanation:
    """Explain by what was found, in the plainest words that are as likely."""
    explanation = plainer(renamed(explained(search, bank, accepted)))
    return whole(repelled(coupled(placed(uncoupled(pruned(warmed(peakless(peaked(simplest(placed(explanation)))))))))))
