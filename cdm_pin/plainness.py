"""Plainness: of the laws that are about as likely in a place, the simplest; a peak of friction only where it shows."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from .candidates import Candidate, at_known_place
from .doubts import COMPLIANT
from .drifting import still
from .effects import CATALOGUE
from .explanation import Explanation, estimated, explained, unsound, with_effects
from .findings import EVIDENT_PEAK, joint_covariance, stribeck_of
from .fit import Fit
from .friction_effects import peaks_by_its_sign
from .leaders import UNLIKELIER, drives, same_width
from .likelihood import REFINING, evidence, gain, has_ratio, likeliest, likelihood
from .patches import REPELS
from .search import Search, brought, errors, rms
from .shapes import refine
from .significance import from_errors_of_laws

ABOUT = 0.02
"""Share of the likelihood gained that the next best law may lose where the best is none that friction can have."""
EVIDENT = 5.0
"""By how much log-evidence more a refinement is named that has more parameters than its likelihood seems to pay for."""
PASSAGE = 0.02
"""Share of friction below which its sign's passage through zero, as measured, shows no peak."""
FINER = {
    "stribeck_friction": PASSAGE,
    "cable_slack": 0.05,
    "asymmetric_friction": 0.05,
    "position_dependent_friction": 0.05,
    "friction_drift": 0.03,
}
"""Share by which a law may be wrong that is a special case of one named here; the stiffness of a spring varies."""
WRONG = 0.1
"""Share of its torque by which no law is wrong."""
PREFERENCE, DRY = 2.0, 1.0
"""By how much log-likelihood less a simpler law is named nevertheless, and by how much less still dry friction is."""


def plainer(explanation: Explanation, equal: float = 1.0) -> Explanation:
    """Put a law where it is as likely if friction elsewhere is dry then, without more.

    A constant torque on one motor is one on another and friction that is not the same both ways; friction that drives
    one way is dry friction and a constant torque.
    """
    search, whitener = explanation.search, explanation.fit.whitener
    accepted, found = [f.candidate for f in explanation.found], explanation.found
    trials, sound = [], is_sound(explanation.fit)
    for i, refined in enumerate(accepted):
        if refined.effect.name not in REFINING:
            continue
        for j, rival in ((j, c) for j, f in enumerate(found) for c, d in f.rivals if i != j and abs(d) < equal):
            trial = [refined.dry if k == i else rival if k == j else c for k, c in enumerate(accepted)]
            if rival.named and not any(a.clashes(b) for a, b in itertools.combinations(trial, 2)):
                trials.append(trial)
    trials += [
        trial for trial in _evened(accepted, explanation, 2 if sound else 1) if is_sound(search.fit(trial, whitener))
    ]
    best, chosen = search.settings.close * (1.0 if sound else -1.0), accepted
    for trial in trials:
        fit = search.fit(trial, whitener)
        fewer = search.size(*accepted) - search.size(*trial)
        more = 0.5 * (explanation.fit.deviance - fit.deviance + np.log(fit.n_judged) * fewer)
        if more > best:
            best, chosen = more, trial
    return explanation if chosen is accepted else explained(search, explanation.bank, chosen)


def is_sound(fit: Fit) -> bool:
    """Whether all effects of a fit have coefficients such as their laws may have."""
    others = [[c for c in fit.effects if c is not own] for own in fit.effects]
    return all(c.is_plausible(b, beside) for c, b, beside in zip(fit.effects, fit.beta, others, strict=True))


def _evened(accepted: list[Candidate], explanation: Explanation, least: int) -> list[list[Candidate]]:
    """Give explanations by dry friction and a constant torque on one motor where so many axes rub unequally.

    What they rub unequally by may cancel on all motors but one.
    """
    uneven = [c for c in accepted if c.effect.name == "asymmetric_friction"]
    taken = {c.key for c in accepted}
    if len(uneven) < least or any(c.dry.key in taken for c in uneven):
        return []
    offsets = [c for c in explanation.bank.laws.candidates if c.effect.name == "torque_offset" and c.key not in taken]
    return [[*(c.dry if c in uneven else c for c in accepted), offset] for offset in offsets]


def placed(explanation: Explanation) -> Explanation:
    """Give the coordinate of two motors the name of a joint or a motor that its ratio, estimated last, has come to."""
    accepted, model = [f.candidate for f in explanation.found], explanation.search.problem.model
    taken = {c.key for c in accepted}
    known = [at_known_place(c, model) for c in accepted]
    laws = [new if new.key not in taken else c for c, new in zip(accepted, known, strict=True)]
    return with_effects(explanation, laws)


def whole(explanation: Explanation) -> Explanation:
    """Give a ripple a whole number of cycles a turn, as a motor's is, where the data hardly speak against it.

    A little off, it would be out of phase where other recordings turn the motor further.
    """
    laws = [f.candidate for f in explanation.found]
    for j, law in enumerate(laws):
        if law.effect.name == "torque_ripple" and law.named:
            turns = max(round(law.shape[0]), 1)
            even = [*laws[:j], replace(law, shape=(float(turns), *law.shape[1:])), *laws[j + 1 :]]
            fit, its = explanation.fit, explanation.search.fit(even, explanation.fit.whitener)
            if its.deviance - fit.deviance < np.log(fit.n_judged):  # what an order that is free has to be worth
                laws = even
    same = laws == [f.candidate for f in explanation.found]
    return explanation if same else explained(explanation.search, explanation.bank, laws)


def simplest(explanation: Explanation, spoilt: frozenset[tuple[str, str]] = frozenset()) -> Explanation:
    """Let that of the laws stand which the data make likeliest, at a place above all; of equals the simplest.

    Dry friction is the simplest of its kin. Laws that are alike in penalised likelihood are weighed by their evidence.
    One that is no such law any more once its shape is estimated beside all others is `spoilt`.
    """
    known = [f.candidate for f in explanation.found]
    accepted = list(known)
    for j in range(len(accepted)):
        accepted[j] = _named_at(explanation, j, spoilt.union(c.key for c in accepted))
    changed = [j for j, law in enumerate(accepted) if law != known[j]]
    simpler = estimated(explanation, accepted)
    if len(changed) > 1 and _loses(explanation, simpler, changed):  # together they are not what each is by itself
        accepted = list(known)
        for j in changed:
            law = _named_at(explanation, j, spoilt.union(c.key for c in accepted))
            alone = estimated(explanation, [*accepted[:j], law, *accepted[j + 1 :]])
            if not _loses(explanation, alone, changed):
                accepted, simpler = [f.candidate for f in alone.found], alone
        simpler = estimated(explanation, accepted)
    worse = unsound(simpler, explanation)
    return simplest(explanation, spoilt | worse) if worse else simpler


def _loses(before: Explanation, after: Explanation, changed: list[int]) -> bool:
    """Whether an explanation is less likely than one before it by more than the laws that changed may be wrong by."""
    search, found = before.search, before.found
    room = sum(_within(search, found[j].candidate, found[j].score.statistic, search.settings.close) for j in changed)
    own, its = (likelihood(x.search, [f.candidate for f in x.found]) for x in (before, after))
    return its < own - room


def _named_at(explanation: Explanation, j: int, taken: frozenset[tuple[str, str]]) -> Candidate:
    """Give the simplest law that may stand for finding `j`, at a joint, a motor or a cable if that turns alike."""
    chosen = _simplest_at(explanation, j, taken)
    known = at_known_place(chosen, explanation.search.problem.model)
    return chosen if known.key in taken - {explanation.found[j].candidate.key} else known


def _simplest_at(explanation: Explanation, j: int, taken: frozenset[tuple[str, str]]) -> Candidate:
    """Give the simplest law that may stand for finding `j`; one that friction cannot be gives way to the next best.

    So does one with a ratio of its own to one without that the evidence is more for.
    """
    search, found, lead = explanation.search, explanation.found[j], 0.0
    without = search.without(explanation.fit, j)
    plainest = _as_wide(search, without, _plainest(explanation, j), [c for c, _ in found.rivals])
    best = own = likeliest(search, without, plainest)[0]
    rivals = [
        (c, d)
        for c, d in found.rivals
        if c.key not in taken
        and c.named == best.named
        and c.is_plausible(search.score(without, c).beta, without.effects)
        and (
            c.effect.name != "stribeck_friction"
            or bool(c.detail) == bool(found.candidate.detail)
            or _rises(search, without, c)
        )
    ]
    if has_ratio(best):
        even = [(evidence(search, without, c, found.score.statistic), d, c) for c, d in rivals if not has_ratio(c)]
        top = max(even, key=lambda item: item[0], default=(-np.inf, lead, best))
        if top[0] > evidence(search, without, best, found.score.statistic):
            _, lead, best = top
    here = {c.key for c, _ in rivals if c.place.location == best.place.location}
    if best.named and not best.is_plausible(search.score(without, best).beta, without.effects):
        least = -ABOUT * found.gain
        best, lead = next(((c, d) for c, d in rivals if c.key in here and d > least), (best, lead))
    statistic, close = found.score.statistic, search.settings.close
    slack = _within(search, best, statistic, close)
    alike = [best]
    alike += [c for c, d in rivals if c is not best and d - lead > -(slack if c.key in here else close)]
    if best.named:
        finer = [c for c, _ in rivals if c not in alike and c.key in here and c.effect.name in REFINING]
        known = {c.identity: evidence(search, without, c, statistic) for c in (*alike, *finer)}
        alike += [c for c in finer if known[c.identity] > known[best.identity] + EVIDENT]
        simplest = min(search.size(c) for c in alike)
        for c in sorted((c for c, _ in rivals if c.key in here and search.size(c) < simplest), key=search.size):
            if _is_all_but_errors(search, without, best, c):
                return c
        top = max(alike, key=lambda c: known[c.identity])
        worst = known[top.identity] - _within(search, top, statistic, PREFERENCE)
        alike = [c for c in alike if known[c.identity] >= worst - DRY * (c.effect.name == "coulomb_friction")]
    rubs = "coulomb_friction" in best.effect.confounded

    def order(c: Candidate) -> tuple[int, bool, bool]:
        return search.size(c), rubs and c.effect.name != "coulomb_friction", c.effect.name == UNLIKELIER

    chosen = min(alike, key=order)
    return plainest if chosen is own else chosen


def _plainest(explanation: Explanation, j: int) -> Candidate:
    """Give finding `j` with the fewest coefficients with which its law is as likely; mostly it has one number of them.

    A spring may have had to stiffen before all else was found; where it hardly does, its rest is not where it would be
    softest.
    """
    search, found = explanation.search, explanation.found[j]
    own, without = found.candidate, search.without(explanation.fit, j)
    if own.detail:
        return own
    fewer = [c for c in explanation.bank.laws.candidates if c.key == own.key and search.size(c) < search.size(own)]
    worth = [gain(search, without, c, search.score(without, c)) for c in fewer]
    least = found.gain - _within(search, own, found.score.statistic, search.settings.close)
    return own if max(worth, default=-np.inf) <= least else fewer[int(np.argmax(worth))]


def _as_wide(search: Search, fit: Fit, law: Candidate, rivals: list[Candidate]) -> Candidate:
    """Give a law the width of the smooth sign that was found for a rival in its place, if it explains more with it.

    Else what the rival gains by its width would look like what it is finer by.
    """
    trials = [trial for c in rivals if (trial := same_width(law, c)) is not law]
    if not trials:
        return law
    best = max([law, *trials], key=lambda c: gain(search, fit, c, search.score(fit, c)))
    return law if best is law else refine(search, fit, best, 3)[0]


def _rises(search: Search, without: Fit, law: Candidate) -> bool:
    """Whether Stribeck's friction says more than dry friction by what its sign's passage may be wrong by."""
    score = search.score(without, law)
    passage = _within(search, law, score.statistic, search.settings.close)
    return gain(search, without, law, score) > gain(search, without, *refine(search, without, law.dry, 3)) + passage


def _within(search: Search, law: Candidate, statistic: float, least: float) -> float:
    """Say by how much log-likelihood another law may be worse than this one, of some statistic, to be as good."""
    return search.settings.within(statistic, FINER.get(law.effect.name), least)


def _is_all_but_errors(search: Search, without: Fit, own: Candidate, rival: Candidate) -> bool:
    """Whether a law explains, beside a fit, all that another one does but for what the laws may be wrong by.

    How much a cable gives is a spring's error; that it gives no more beyond some torque is none. Nor is a good part of
    the torque, such as a constant where slow noise hides constants.
    """
    others = without.effects
    if own.effect.name == "cable_slack" and rival.effect.name in COMPLIANT:
        return False
    beside, both = (search.fit(effects, without.whitener) for effects in ([*others, rival], [*others, rival, own]))
    more = beside.residual - both.residual
    if float(more @ more) >= from_errors_of_laws(search, own, more, beside):
        return False
    plain = (errors(search, f.base, f.effects, f.beta) for f in (beside, both))
    apart = still(search, [one - two for one, two in zip(*plain, strict=True)])
    law = brought(search, own, search.fit([*others, own], without.whitener).beta[-1])
    return bool(np.linalg.norm(rms(search, apart)) < WRONG * np.linalg.norm(rms(search, law)))


def peaked(explanation: Explanation) -> Explanation:
    """Let friction be Stribeck's where what dry friction leaves open about its sign rises far above it.

    A sign that is blurred or smooth does not. The peak has to explain as much in its place, and more than dry friction
    without either by what a sign's passage may be wrong by.
    """
    search, law = explanation.search, CATALOGUE["stribeck_friction"]
    accepted = [f.candidate for f in explanation.found]
    places = [place.location for place in law.places(search.problem.model)]
    for j, (candidate, found) in enumerate(zip(accepted, explanation.found, strict=True)):
        dry = candidate.effect.name == "coulomb_friction" and candidate.place.location in places
        if not dry or not peaks_by_its_sign(explanation.fit.beta[j], candidate.shape, candidate.detail):
            continue
        without, grid = search.without(explanation.fit, j), law.grid(search.problem.motions, candidate.place)
        trials = [Candidate(law, candidate.place, (candidate.shape[0], *shape[1:])) for shape in grid]
        refined = [refine(search, without, trial, 3) for trial in trials]
        peaks = [(gain(search, without, *t), i) for i, t in enumerate(refined) if t[0].is_plausible(t[1].beta)]
        if not peaks:
            continue
        (worth, i), statistic = max(peaks), found.score.statistic
        quick = replace(candidate, creeps=False)
        free = min(found.gain, gain(search, without, quick, search.score(without, quick)))
        passage = _within(search, refined[i][0], statistic, search.settings.close)
        if worth > free - passage and _rises(search, without, refined[i][0]):
            accepted[j] = refined[i][0]
    return with_effects(explanation, accepted)


def repelled(explanation: Explanation) -> Explanation:
    """Take the name from springs that drive on the whole (`drives`): what does so is none, whatever it looks like."""
    search, fit = explanation.search, explanation.fit
    laws = [f.candidate for f in explanation.found]
    pulls = [j for j, law in enumerate(laws) if law.effect.least is not None]
    wrong = [j for j in pulls if drives(search, search.without(fit, j), laws[j])]
    for j in wrong:
        laws[j] = replace(laws[j], effect=REPELS)
    return explained(search, explanation.bank, laws) if wrong else explanation


def peakless(explanation: Explanation, least: float = EVIDENT_PEAK) -> Explanation:
    """Let Stribeck's friction be dry where its peak is no more than so many errors, or than its sign's passage.

    Its errors are those of chance, its velocity being as unknown as it is, and of a peak that may be part of the
    passage of its sign.
    """
    fit, accepted = explanation.fit, [f.candidate for f in explanation.found]
    peaks = stribeck_of(fit)
    if not peaks:
        return explanation
    covariance, where = joint_covariance(explanation.search, fit)
    for j in peaks:
        candidate, (level, peak) = accepted[j], fit.beta[j][:2]
        passing = candidate.effect.errors(candidate.place, candidate.shape)["stribeck"]
        error = np.hypot(np.sqrt(np.diag(covariance)[where[j]][1]), passing * peak)
        if peak <= max(least * error, PASSAGE * level) and candidate.dry.key not in [c.key for c in accepted]:
            accepted[j] = candidate.dry
    return with_effects(explanation, accepted)
