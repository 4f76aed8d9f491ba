"""Unseen recordings judge an explanation: what fails there is withdrawn, what they decide is changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from . import findings as fi
from .asked import asked_but_for_laws, drowned_pushes, next_law
from .bank import all_candidates
from .candidates import Candidate
from .confirming import ONCE, helps
from .everywhere import agreements, confirmed
from .explanation import Explanation, Found, explained
from .fit import Fit
from .likelihood import REFINING, evidence, likeliest
from .parts import deviance_apart, parts_of
from .patching import patch
from .plainness import EVIDENT, PREFERENCE, is_sound, plainer
from .problem import Problem, Run
from .pruning import undivided
from .resolved import differs_by_zeros
from .search import Search
from .settling import settled, tied
from .shapes import tuned
from .unexplained import noise_floor
from .unseen import deviance_unseen

DECIDED = 10.0
"""Log-likelihood by which the unseen recordings decide between two laws."""
CLOSE = 2.0
"""Whitened sum of squares on unseen recordings, per sample, up to which a finer law may be told by them."""
MOST = 0.5
"""Share of what a law leaves of unseen recordings that a finer one leaves at most where it takes most of it."""
CONTRADICTED = 1.0
"""Sum of squares by which parts of the recordings are less likely with a finding that the others make."""


def validated(seen: Problem | None, explanation: Explanation) -> tuple[Search | None, Explanation]:
    """Keep of an explanation what the unseen recordings confirm; give the search on them, about the same model, too."""
    if seen is None:
        return None, _weighed(None, explanation) if explanation.everywhere else _crossed(explanation)
    seen = _undisturbed(seen, explanation)
    judge = judge_of(seen, explanation)
    if explanation.everywhere:
        return judge, _weighed(judge, explanation)
    more = _seconded(judge, _opened(judge, explanation))
    if more is not explanation:
        judge = judge_of(seen, more)
    left = _judged(judge, more)
    if left.search is not more.search:
        judge = judge_of(seen, left)
    return _tied(judge, left), left


def _undisturbed(seen: Problem, explanation: Explanation) -> Problem:
    """Leave out where something pushes in unseen recordings, on a joint on which it pushes in the others.

    They judge laws, which hold at all times; when a push comes again is no part of any.
    """
    keys = {f.candidate.key for f in explanation.found if f.candidate.effect.name == "external_torque"}
    if not keys:
        return seen
    judge = judge_of(seen, explanation)
    bank = judge.bank([c for c in all_candidates(judge.problem, ["external_torque"]) if c.key in keys])
    pushes = drowned_pushes(judge, bank, [f.candidate for f in explanation.found if f.candidate.key not in keys])
    if not pushes:
        return seen
    return replace(seen, runs=tuple(_without_pushes(run, pushes, 1.0 / seen.band.cutoff) for run in seen.runs))


def _without_pushes(run: Run, pushes: Sequence[Candidate], margin: float) -> Run:
    """Leave out of a recording when something pushes, and some seconds before and after it."""
    valid, notices, time = run.signals.valid, run.signals.notices, run.motion.time
    for push in pushes:
        if int(push.shape[2]) == run.motion.index:
            start, end = push.shape[0] - margin, push.shape[1] + margin
            valid = valid & ~((time >= start) & (time <= end))
            told = max(np.floor(10 * start), 0.0) / 10, np.ceil(10 * end) / 10  # no less than is left out
            words = "{:.1f} to {:.1f} s left out: something pushes on joint {}".format(*told, push.location["index"])
            notices = (*notices, words)
    return replace(run, signals=replace(run.signals, valid=valid, notices=notices))


def judge_of(seen: Problem, explanation: Explanation) -> Search:
    """Give the search on the unseen recordings, about the model of an explanation."""
    search, fit = explanation.search, explanation.fit
    pairs = [(c, c.admissible(beta)) for c, beta in zip(fit.effects, fit.beta, strict=True)]
    return search.judge(seen.with_model(search.problem.model, search.problem.bearings).with_loads(pairs))


def _seconded(judge: Search, explanation: Explanation, most: int = 8) -> Explanation:
    """Add what errors of the found laws could explain in the training, but without which the unseen recordings fail.

    Where their whitened errors are far above the noise, beyond what the training leaves uncertain, and one effect that
    the training asks for takes at least half of the excess away, no error of a law does as much.
    """
    search, fit = explanation.search, explanation.fit
    rows = judge.body(fit.whitener).data.size
    own = deviance_unseen(judge, fit)
    if not fit.effects or own < 4.0 * rows:
        return explanation
    effects = list(fit.effects)
    candidates = asked_but_for_laws(search, explanation.bank, effects, most)
    worth = [deviance_unseen(judge, search.fit([*effects, c], fit.whitener)) for c in candidates]
    if min(worth, default=own) > 0.5 * (own + rows):
        return explanation
    search, accepted = settled(search, [*effects, candidates[int(np.argmin(worth))]])
    return undivided(explained(search, search.renewed(explanation.bank), accepted))


def _opened(judge: Search, explanation: Explanation) -> Explanation:
    """Leave the sign of friction open where that takes most of what the unseen recordings err by.

    The training may hold few passages through zero, and need no more than one width of the sign.
    """
    search, fit = explanation.search, explanation.fit
    laws = [c.detailed(search.problem.motions) if c.has_doubts else c for c in fit.effects]
    if laws == list(fit.effects) or deviance_unseen(judge, fit) < CLOSE * judge.body(fit.whitener).data.size:
        return explanation
    laws = tuned(search, laws, fit.whitener)
    if not _takes_most(judge, search.fit(laws, fit.whitener), fit):
        return explanation
    return explained(search, explanation.bank, laws)


def _judged(judge: Search, explanation: Explanation) -> Explanation:
    """Withdraw what does not help on the unseen recordings; what then stands out has no name.

    One at a time, first that without which they are likeliest: the others may have failed, or helped, only beside it.
    """
    withdrawn: list[Candidate] = []
    patched = False
    for _ in range(2 * explanation.search.most):
        before, explanation = explanation, _reconsidered(judge, explanation)
        if explanation is not before:
            effects = [f.candidate for f in explanation.found]
            more = patch(explanation.search, explanation.bank, effects)
            if more is not None and all(c in more for c in effects):
                explanation = explained(explanation.search, explanation.bank, more)
        judge, search = _tied(judge, explanation), explanation.search
        failing = [j for j in range(len(explanation.found)) if not helps(judge, explanation, j)]
        if failing:
            worst = min(failing, key=lambda j: deviance_unseen(judge, search.without(explanation.fit, j)))
            withdrawn.append(explanation.found[worst].candidate)
            explanation = _restricted(explanation, [f for j, f in enumerate(explanation.found) if j != worst])
            continue
        left = [f.candidate for f in explanation.found]
        if not withdrawn or patched:
            break
        law = next_law(search, explanation.bank, left, withdrawn)
        if law is not None:  # kept out by what was withdrawn
            search, more = settled(search, [*left, law])
            withdrawn.append(law)
        elif (more := patch(search, explanation.bank, left)) is None:
            break
        explanation, patched = explained(search, search.renewed(explanation.bank), more), law is None
        judge = judge if law is None else judge_of(judge.problem, explanation)
    return explanation


def _crossed(explanation: Explanation) -> Explanation:
    """Withdraw, one at a time, what makes parts of the recordings less likely after the fit to the others.

    Whatever is seen in one part alone does not, nor what happens once.
    """
    parts = parts_of(explanation.search) if explanation.found else []
    while parts:
        fit, search = explanation.fit, explanation.search
        own, motion = deviance_apart(parts, fit), search.problem.motions[0]
        gains = {
            j: deviance_apart(parts, search.without(fit, j)) - own
            for j, c in enumerate(fit.effects)
            if c.effect.name not in ONCE and not c.is_swinging(motion)
        }
        worst = min(gains, key=lambda j: gains[j], default=None)
        if worst is None or gains[worst] > -CONTRADICTED:
            break
        explanation = _restricted(explanation, [f for j, f in enumerate(explanation.found) if j != worst])
        if explanation.search is not search:
            parts = parts_of(explanation.search)
    return explanation


def _tied(judge: Search, explanation: Explanation) -> Search:
    """Give the search on the unseen recordings with rigid cables where an explanation has let go of a soft one."""
    swings = judge is not None and judge.problem.swings
    return judge.stiff if swings and not explanation.search.problem.swings else judge


def _weighed(judge: Search | None, explanation: Explanation) -> Explanation:
    """Keep of many findings what helps on the unseen recordings, and set each against its rivals."""
    search = explanation.search
    effects = [f.candidate for f in explanation.found]
    if judge is not None:
        effects = confirmed(search, judge, effects, np.maximum(noise_floor(judge, effects), 1e-12))
    effects = _without_trifles(search, effects)
    explanation = replace(explained(search, explanation.bank, effects), everywhere=True)
    if judge is None:
        return explanation
    alike = agreements(judge, explanation.fit)
    found = tuple(replace(f, agreement=a) for f, a in zip(explanation.found, alike, strict=True))
    return replace(explanation, found=found)


def _without_trifles(search: Search, effects: list[Candidate]) -> list[Candidate]:
    """Let dry friction stand for a refinement that differs from it by no more than a trifle."""
    fit, effects = search.fit(effects), list(effects)
    for j, candidate in enumerate(effects):
        dry = candidate.dry if candidate.effect.name in REFINING else candidate
        taken = any(dry.key == c.key for c in effects)
        if not taken and fi.is_plainer(search, search.without(fit, j), dry, candidate):
            effects[j] = dry
    return effects


def sized(explanation: Explanation, judge: Search | None, near: float = 15.0) -> Explanation:
    """Let a simpler law stand, if one is near and as likely, for a law of which no parameter is known.

    Dry friction stands for what refines it unless that is evident; for one whose peak is another one in the unseen
    recordings, unless that explains these; and for one that differs in its two directions by no more than zeros that
    move may be off, unless the unseen recordings are for it or no law explains all: what is left then looks like zeros
    that move.
    """
    if explanation.everywhere or not explanation.found:
        return explanation
    lawful = all(found.candidate.named for found in explanation.found)
    if lawful and not is_sound(explanation.fit):
        explanation = plainer(explanation)
    search = explanation.search
    for j, found in enumerate(explanation.found if lawful else ()):
        if differs_by_zeros(search, search.without(explanation.fit, j), found.candidate):
            simpler = _instead(explanation, j, found.candidate.dry)
            if judge is None or not _is_for(judge, explanation.fit, simpler.fit):
                return sized(simpler, judge)
    if lawful and judge is not None:
        for j in fi.unsure_peaks(search, judge, explanation.fit):
            simpler = _instead(explanation, j, explanation.found[j].candidate.dry)
            if not _takes_most(judge, explanation.fit, simpler.fit):
                return sized(simpler, judge)
    for j in fi.unsized(explanation):
        found = explanation.found[j]
        without = search.without(explanation.fit, j)
        likely = likeliest(search, without, found.candidate)[0]
        own = evidence(search, without, likely, found.score.statistic)
        dry = found.candidate.dry.key if found.candidate.effect.name in REFINING else None
        dry_first = sorted(found.rivals, key=lambda r: -r[1] - PREFERENCE * (r[0].effect.name == "coulomb_friction"))
        for rival, difference in dry_first:
            if not rival.named or search.size(rival) >= search.size(likely) or difference < -near:
                continue
            close = EVIDENT if rival.key == dry else search.settings.close
            if evidence(search, without, rival, found.score.statistic) < own - close:
                continue
            simpler = _instead(explanation, j, rival)
            if j not in fi.unsized(simpler):
                return sized(simpler, judge)
    return explanation


def _instead(explanation: Explanation, j: int, law: Candidate) -> Explanation:
    """Give the explanation with a law in the place of finding `j`."""
    effects = [f.candidate for f in explanation.found]
    return explained(explanation.search, explanation.bank, [*effects[:j], law, *effects[j + 1 :]])


def _is_for(judge: Search, fit: Fit, other: Fit) -> bool:
    """Whether the unseen recordings are clearly for one fit, and not for another."""
    own, its = (deviance_unseen(judge, f) for f in (fit, other))
    return _unseen_gain(its, own, judge.body(fit.whitener).data.size) > DECIDED


def _takes_most(judge: Search, fit: Fit, other: Fit) -> bool:
    """Whether a fit takes most of what another one leaves of unseen recordings beyond their noise."""
    rows = judge.body(fit.whitener).data.size
    own, its = (deviance_unseen(judge, f) for f in (fit, other))
    taken = max(own - rows, 0.0) < MOST * max(its - rows, 0.0)
    return taken and _unseen_gain(its, own, rows) > DECIDED


def _unseen_gain(own: float, other: float, rows: int) -> float:
    """Give by how much likelier the unseen recordings are after another fit, from both deviances (`deviance_unseen`).

    The noise counts as no less than what the better one leaves in so many rows.
    """
    return 0.5 * (own - other) / max(min(own, other) / max(rows, 1), 1.0)


def _reconsidered(judge: Search, explanation: Explanation) -> Explanation:
    """Let the unseen recordings choose between laws that the others hardly tell apart.

    A named law takes the place of another one where the evidence of all recordings is clearly for it, and that of a
    correction without a name where it does better on the unseen ones. It may be finer than another law of
    torques if that leaves little but noise, but no friction that refines dry friction: what the laws are off by is off
    in all recordings.
    """
    search, whitener = explanation.search, explanation.fit.whitener
    for j, found in enumerate(explanation.found):
        if found.candidate.effect.name in ONCE:
            continue
        size = _physics(search, found.candidate)
        near = [(c, d) for c, d in found.rivals if c.named and d > -15.0 - 0.02 * found.score.statistic]
        others = [f.candidate for i, f in enumerate(explanation.found) if i != j]
        if not near:
            continue
        own = deviance_unseen(judge, search.fit([*others, found.candidate], whitener))
        rows = judge.body(whitener).data.size
        told = found.candidate.named and search.problem.torque and own < CLOSE * rows
        finer = [c for c, _ in near if told and c.effect.name not in REFINING]
        near = [(c, d) for c, d in near if c in finer or _physics(search, c) <= size][:3]
        for rival, difference in near:
            more = _unseen_gain(own, deviance_unseen(judge, search.fit([*others, rival], whitener)), rows)
            if more > 0.0 if not found.candidate.named else difference + more > DECIDED:
                return explained(search, explanation.bank, [*others, rival])
    return explanation


def _physics(search: Search, candidate: Candidate) -> int:
    """Count the parameters of a candidate that are neither smoothing nor what is left open about a sign."""
    return search.size(candidate.bare) - candidate.effect.nuisance_shape


def _restricted(explanation: Explanation, found: Sequence[Found]) -> Explanation:
    """Give the explanation with only these findings, fitted anew."""
    search = tied(explanation.search, [f.candidate for f in found])
    fit = search.fit([f.candidate for f in found])
    rigid = search.fit([], fit.whitener)
    renewed = []
    for j, f in enumerate(found):
        renewed.append(replace(f, score=search.score(search.without(fit, j), f.candidate)))
    bank = explanation.bank if search is explanation.search else search.renewed(explanation.bank)
    return Explanation(tuple(renewed), fit, rigid, bank, search, explanation.everywhere)
