"""What the data ask for beside some effects: in the noise that is left, in a clear one, or drowned in slow noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .bank import Bank
from .candidates import Candidate
from .fit import Fit
from .leaders import leading
from .leftover import clear_noise
from .likelihood import even_noise, gain, likelihood_ratio
from .scores import family_wise
from .search import Search
from .shapes import refine
from .significance import is_loud, is_seconded, is_significant, passes
from .whitening import Whitener


def asked(search: Search, fit: Fit, bank: Bank, taken: Sequence[Candidate]) -> bool:
    """Whether the data ask for any further effect."""
    return any(passes(search, *leader, fit) for leader in leading(search, fit, bank, 40, taken))


def shouted(search: Search, clear: Fit, bank: Bank, taken: Sequence[Candidate]) -> bool:
    """Whether an effect stands out so far once common effects are taken out that no care about the noise is needed.

    A strong slow effect can pass for slow noise; its statistic in the clear noise is then many times the threshold.
    """
    loud = [x for x in leading(search, clear, bank, 10, taken) if is_loud(x[1])]
    return any(passes(search, *leader, clear) for leader in loud)


def drowned(search: Search, bank: Bank, taken: Sequence[Candidate], most: int = 6) -> tuple[Whitener, Candidate] | None:
    """Find a slow effect that passes for slow noise as long as it is not in the model; give the noise beside it, too.

    Such an effect is looked for in white noise, and has to be significant by the likelihood ratio of the models with it
    and without it, each in a noise of its own; what is estimated of its shape counts.
    """
    even, alarm = search.fit(taken, even_noise(search, taken)), np.log(search.settings.alarm)
    least, best, alone = 15.0, 0.0, None  # no less is significant
    for candidate, score, weight in leading(search, even, bank, most, taken):
        if family_wise(score, candidate, weight) >= alarm:
            continue
        candidate, _ = refine(search, even, candidate)
        whitener, ratio = likelihood_ratio(search, taken, candidate, least)
        if ratio < least:
            continue
        fit = search.fit(taken, whitener)
        score = search.score(fit, candidate)
        whole = replace(score, statistic=min(ratio, score.statistic), k=score.k + candidate.extra)
        p = family_wise(whole, candidate, weight)
        if p < min(alarm, best) and passes(search, candidate, score, weight, fit):
            best, alone = p, (whitener, candidate)
    return alone


def drowned_pushes(search: Search, bank: Bank, effects: Sequence[Candidate], most: int = 3) -> list[Candidate]:
    """Find pushes of a bank beside some effects, one after another, also where they pass for slow noise."""
    pushes: list[Candidate] = []
    while len(pushes) < most and (push := drowned(search, bank, [*effects, *pushes])) is not None:
        pushes.append(push[1])
    return pushes


def unnamed(search: Search, bank: Bank, accepted: list[Candidate]) -> Candidate | None:
    """Give the correction without a name that explains most of what is left; None where none is asked for."""
    fit = search.fit(accepted)
    clear = search.fit(accepted, clear_noise(search, accepted))
    for f in (fit, clear):
        for candidate, score, weight in leading(search, f, bank, 3, accepted, named=False):
            heard = f is fit or (is_loud(score) and is_seconded(search, fit, candidate, score, weight))
            if heard and gain(search, f, candidate, score) > 0 and passes(search, candidate, score, weight, f):
                return candidate
    return None


def next_law(search: Search, bank: Bank, accepted: list[Candidate], withdrawn: Sequence[Candidate]) -> Candidate | None:
    """Give the law that the data ask for most beside some effects, with all that is left as noise; None for none.

    Not one that something explains away which was withdrawn: it would only stand for that, and less well.
    """
    fit, own, but = search.fit(accepted), {c.key for c in accepted}, {c.key for c in withdrawn}
    gone = [(c, gain(search, fit, c, search.score(fit, c))) for c in withdrawn if c.key not in own]
    for candidate, score, weight in leading(search, fit, bank, 6, accepted):
        if candidate.key in but or not passes(search, candidate, score, weight, fit):
            continue
        candidate, score = refine(search, fit, candidate)
        worth = gain(search, fit, candidate, score)
        more = [c for c, its in gone if its > worth + search.settings.close]
        besides = [search.fit([*accepted, c], fit.whitener) for c in more]
        if all(gain(search, f, candidate, search.score(f, candidate)) > 0.5 * worth for f in besides):
            return candidate
    return None


def asked_but_for_laws(search: Search, bank: Bank, accepted: list[Candidate], most: int) -> list[Candidate]:
    """List what is significant beside a fit, whether or not errors of the laws in it could explain as much."""
    out: dict[tuple[str, str], Candidate] = {}
    for whitener in (None, clear_noise(search, accepted)):
        fit = search.fit(accepted, whitener)
        for candidate, score, weight in leading(search, fit, bank, most, accepted):
            if is_significant(search, candidate, score, weight, fit) is not None:
                out.setdefault(candidate.key, candidate)
    return list(out.values())
