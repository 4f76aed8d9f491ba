"""Growing: effects of the catalogue are added one by one, each on the side of the cable map where it explains more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .asked import asked, drowned, shouted
from .bank import Bank
from .candidates import Candidate, at_known_place, twins
from .effects import CATALOGUE, DRAGS
from .events import Reporter
from .fit import Fit
from .leaders import best_of, leading, same_width
from .leftover import clear_noise
from .likelihood import gain
from .masses import about
from .model import CableModel
from .polishing import is_provisional, polish
from .search import Search
from .settling import in_turn
from .shapes import tuned
from .significance import passes
from .whitening import Whitener

NEARLY_PARALLEL = 0.97
"""Cosine beyond which two motors' coordinate may be a joint's behind a wrong cable map."""


def grow(search: Search, bank: Bank, accepted: list[Candidate], say: Reporter) -> tuple[Search, Bank, list[Candidate]]:
    """Add effects of the catalogue, one by one, as long as the data ask for any, a few at once.

    What is in the model already loads the cables and passes through the logger, so the columns that depend on these
    torques are renewed each time.
    """
    for _ in range(search.settings.at_once):
        if len(accepted) >= search.most:
            break
        fit = search.fit(accepted)
        clear = search.fit(accepted, clear_noise(search, accepted))
        if not asked(search, fit, bank, accepted) and not shouted(search, clear, bank, accepted):
            alone = drowned(search, bank, accepted)
            if alone is None:
                break
            clear = search.fit(accepted, alone[0])
        leaders = [c for c, _, _ in leading(search, clear, bank, 12, accepted)]
        say.looked(clear, leaders)
        winner = best_of(search, clear, leaders)
        if winner is None or (accepted and _is_outdone(search, clear, bank, accepted, winner)):
            break
        if any(winner[0].clashes(c) for c in accepted):  # a push that grew into another one
            break
        search, bank, accepted = adjusted(search, bank, [*accepted, winner[0]], clear.whitener)
    return search, bank, accepted


def adjusted(
    search: Search, bank: Bank, accepted: list[Candidate], whitener: Whitener
) -> tuple[Search, Bank, list[Candidate]]:
    """Adjust effects to each other: their shapes in a given noise, then which of them stand, and on what side."""
    accepted = tuned(search, accepted, whitener)
    search = about(search, search.fit(accepted, whitener))
    bank = search.renewed(bank)
    for _ in range(3):
        before, accepted = accepted, polish(search, bank, accepted)
        if not is_provisional(before, accepted):
            break
        search, accepted = in_turn(search, accepted, clear_noise(search, accepted), rounds=3)
        bank = search.renewed(bank)
    accepted = tuned(search, accepted, clear_noise(search, accepted))
    return _sided(search, bank, accepted)


def _is_outdone(search: Search, clear: Fit, bank: Bank, accepted: list[Candidate], winner) -> bool:
    """Whether a correction without a name explains far more than the best effect of the catalogue."""
    best = leading(search, clear, bank, 1, accepted, named=False)
    own = gain(search, clear, *winner)
    return any(gain(search, clear, c, s) > 2.5 * own + 50.0 and passes(search, c, s, w, clear) for c, s, w in best)


def _sided(search: Search, bank: Bank, accepted: list[Candidate]) -> tuple[Search, Bank, list[Candidate]]:
    """Put friction on that side of a wrong cable map, joint or motor, where it explains more.

    Where the map is right the two are the same.
    """
    if not any(c.effect.follows for c in accepted):
        return search, bank, accepted
    whitener = clear_noise(search, accepted)

    def judged(effects: list[Candidate], rounds: int = 2) -> tuple[float, Search, list[Candidate]]:
        there, effects = in_turn(search, effects, whitener, rounds)
        fit = there.fit(effects, whitener)
        return fit.deviance + np.log(fit.n_judged) * there.size(*effects), there, effects

    model, best = search.problem.model, None
    for j, candidate in enumerate(accepted):
        if not (candidate.named and candidate.loads and candidate.place.A):
            continue
        for law in _elsewhere(candidate, model):
            best = best or judged(accepted)
            laws = [law, law.dry] if law.effect.nuisance_shape and law.dry != law else [law]
            others = [*accepted[:j], *accepted[j + 1 :]]
            trials = [[*accepted[:j], trial, *accepted[j + 1 :]] for trial in laws]
            if any(c.place == law.place and "coulomb_friction" in c.effect.confounded for c in others):
                trials = [[same_width(c, law) for c in others]]  # it is dry itself
            for trial in trials:
                other = judged(trial, 5) if candidate.place.is_pair else judged(trial)
                if other[0] < best[0] - (0.0 if candidate.place.is_pair else 10.0):
                    best = other
    return (search, bank, accepted) if best is None else (best[1], best[1].renewed(bank), best[2])


def _elsewhere(candidate: Candidate, model: CableModel) -> list[Candidate]:
    """Give what a law may be once an error of the cable map is known: the same at a joint or a motor that turns alike.

    Of two motors' coordinate, at one that it may be; of drag, with the other power of speed too.
    """
    known = at_known_place(candidate, model, NEARLY_PARALLEL)
    if candidate.place.is_pair:
        return [known] if known is not candidate else []
    places = twins(candidate, model) if len(candidate.place.index) == 1 else []
    laws = [replace(candidate, place=place) for place in places]
    others = [CATALOGUE[name] for name in DRAGS if name != candidate.effect.name and candidate.effect.name in DRAGS]
    return laws + [replace(law, effect=effect) for effect in others for law in (candidate, *laws)]
