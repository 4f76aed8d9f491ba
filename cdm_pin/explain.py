"""The search: add the effect that the data ask for most, look again at all, stop when nothing is asked for."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .bank import Bank, all_candidates
from .completed import effect_candidates
from .doubts import COMPLIANT, PUNCTUAL, errors_of_laws
from .drifting import still, still_errors
from .effects import (
    CATALOGUE,
    DRAGS,
    SHARING,
    Candidate,
    at_known_place,
    extremes,
    greatest_load,
    sign_width,
    twin_places,
)
from .events import ProgressCallback, Reporter
from .everywhere import kinds_first, needed, rubs_everywhere
from .fit import Fit, own_covariance
from .geometry import Vector
from .leftover import clear_noise, tones
from .likelihood import even_noise, likelihood_ratio
from .masses import about
from .model import CableModel
from .patches import MISREAD, RUBS
from .robust import UNSURE, is_coarse, robust_score
from .scores import Score, family_wise
from .search import Search, errors, rms
from .shapes import loosened, refine, tuned, yielding
from .whitening import Whitener, inside_of, log_likelihood

REFINING = ("stribeck_friction", *SHARING)
"""Laws whose first column is dry friction, the others what refines it."""
UNLIKELIER = "transmission_ratio_error"
"""Less likely than what is as simple and explains as much: radii of pulleys are known better than gains of torques."""
MAPS = ("transmission_ratio_error", "pulley_eccentricity")
"""Errors of the cable map."""
POSTURE = ("encoder_offset", "base_tilt")
"""What moves links to where no encoder says they are, at rest already."""
WANDERS = "unnamed_time"
"""What the columns of drifting zeros say already, where there are any."""
ABOUT = 0.02
"""Share of the likelihood gained that the next best law may lose where the best is none that friction can have."""
ALIKE = 0.95
"""Cosine of the motors' shares beyond which two effects act along one coordinate."""
NEARLY_PARALLEL = 0.97
"""Cosine beyond which two motors' coordinate may be a joint's behind a wrong cable map."""
OPEN = 4.0
"""Speed, over that which is told from noise, up to which the law of dry friction leaves its sign open."""
STRONG = 400.0
"""Statistic from which on friction shows how its sign passes through zero."""
ROUNDED = 2.0
"""How many times the torque that steps of encoders bring a correction without a name has to make."""
EVIDENT = 5.0
"""By how much log-evidence more a refinement is named that has more parameters than its likelihood seems to pay for."""
PASSAGE = 0.02
"""Share of friction below which its sign's passage through zero, as measured, shows no peak."""
FAR = 10.0
"""How many times its noise what a fit leaves has to be for one law that explains it wholly to need no more."""
WHOLE = 0.95
"""Share that is as good as all of it."""
ODD = 4.0
"""By how much log-evidence likelier what turns at a ratio of its own with two axes must be than what turns with one."""
WRONG = 0.1
"""Share of its torque by which no law is wrong."""
MOST_STRETCH = 0.35
"""By how much no cable gives under what it carries [rad]."""
SETTLING = 12
"""Rounds in which columns that follow the torques of others come to rest; delayed friction takes the most."""
PREFERENCE = 2.0
"""By how much log-likelihood less a simpler law, dry friction above all, is named nevertheless."""


@dataclass(frozen=True)
class Found:
    """An effect in the model, with what was compared with it.

    Attributes
    ----------
    candidate : Candidate
    score : Score
        Given all the others.
    gain : float
        Penalised log-likelihood (half of BIC's difference).
    log_p : float
        Natural log of the family-wise p-value.
    rivals : tuple of (Candidate, float)
        Others in its place, with their penalised log-likelihood less this one's; best first.
    agreement : float
        With what the unseen recordings alone make of it, 1 where that was not asked.
    """

    candidate: Candidate
    score: Score
    gain: float
    log_p: float
    rivals: tuple[tuple[Candidate, float], ...] = ()
    agreement: float = 1.0


@dataclass(frozen=True)
class Explanation:
    """The set of effects that the search arrived at.

    Attributes
    ----------
    found : tuple of Found
    fit : Fit
    rigid : Fit
        Without any effect, in the same noise.
    bank : Bank
        All candidates that were screened.
    search : Search
        What computes further scores.
    everywhere : bool
        Whether nearly every axis rubs, so that corrections without a name did not compete.
    """

    found: tuple[Found, ...]
    fit: Fit
    rigid: Fit
    bank: Bank
    search: Search
    everywhere: bool = False

    @property
    def scores(self) -> list[Score]:
        """Of all candidates with a name, given the found ones."""
        return self.search.score_all(self.fit, self.bank.laws)

    @property
    def worth(self) -> float:
        """Fall of the whitened sum of squares by all effects together."""
        return self.rigid.deviance - self.fit.deviance


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
            for c in (*all_candidates(search.problem), *tones(search, start))
            if c.key not in but and (search.drift is None or c.effect.name != WANDERS)
        ]
    )
    accepted = list(start)
    turns = 1 + search.most // search.settings.at_once
    for turn in range(turns):
        say("searching", 0.1 + 0.8 * turn / turns)
        search, bank, grown = _grow(search, bank, accepted, say)
        if not turn and grown and rubs_everywhere(search, bank, grown):
            return _everything(search, bank, say)
        accepted = patch(search, bank, grown) or grown
        if accepted is grown:
            if len(grown) < search.settings.at_once:
                break
        elif _has_a_name(search, bank, grown, accepted):
            accepted = grown
        elif (law := _beside_looser(search, bank, grown, accepted)) is not None:
            search, accepted = law
            bank = search.renewed(bank)
    say("rivals", 0.9)
    kept = prune(search, accepted)
    left = unnamed(search, search.renewed(bank), kept) if len(kept) < len(accepted) else None
    search, accepted = settled(search, kept if left is None else [*kept, left])  # two may have hidden each other
    if accepted and all(c.named for c in accepted):  # or an estimate have hid one
        bank = search.renewed(bank)
        there, _, more = _grow(search, bank, accepted, say)
        if len(more) > len(accepted):
            search, accepted = settled(there, prune(there, more))
    search, accepted = _unpatched(search, bank, accepted)
    explanation = _plainer(_renamed(explained(search, search.renewed(bank), accepted)))
    explanation = _coupled(_pruned(_peakless(_peaked(_simplest(explanation)))))
    say.looked(explanation.fit)
    return explanation


def still_standing(explanation: Explanation) -> Explanation:
    """Drop pushes that are not significant any more beside what the unseen recordings have left."""
    search, effects = explanation.search, [f.candidate for f in explanation.found]

    def stands(j: int, candidate: Candidate) -> bool:
        if candidate.effect.name != "external_torque":
            return True
        without = search.without(explanation.fit, j)
        return _stands(search, candidate, search.score(without, candidate), without)

    kept = [candidate for j, candidate in enumerate(effects) if stands(j, candidate)]
    return explanation if len(kept) == len(effects) else explained(search, explanation.bank, kept)


def _pruned(explanation: Explanation) -> Explanation:
    """Drop what is superfluous beside the laws that now stand; when it was asked for, others may have stood there."""
    return _with(explanation, prune(explanation.search, [f.candidate for f in explanation.found]))


def _coupled(explanation: Explanation) -> Explanation:
    """Leave out what has a ratio of two speeds of its own if another such law, estimated anew, explains as much.

    A coupling that was found beside a friction of the same two motors stays where both together do.
    """
    search, accepted = explanation.search, [f.candidate for f in explanation.found]
    odd = [c for c in accepted if c.place.is_pair or c.effect.name == "transmission_coupling"]
    if len(odd) < 2:
        return explanation
    own = likelihood(search, accepted)
    for c in sorted(odd, key=search.size):
        there, laws = settled(search, [law for law in accepted if law is not c], rounds=6)
        if likelihood(there, laws) >= own:
            return _coupled(explained(there, there.renewed(explanation.bank), laws))
    return explanation


def _unpatched(search: Search, bank: Bank, accepted: list[Candidate]) -> tuple[Search, list[Candidate]]:
    """Leave out the corrections without a name if the laws, estimated anew without them, ask for none.

    One that came early may have taken up what a law's shape was off by, and held it there; one that explains less than
    the laws in its place may be wrong by is none.
    """
    named = [c for c in accepted if c.named]
    if not named or len(named) == len(accepted):
        return search, accepted
    alone, laws = settled(search, named, rounds=4)
    left = unnamed(alone, alone.renewed(bank), laws)
    if left is not None:
        fit = alone.fit(laws, clear_noise(alone, laws))
        own = [j for j, c in enumerate(laws) if _shares_motor(c, left, search.problem.model)]
        worth = [laws[j].effect.error ** 2 * alone.score(alone.without(fit, j), laws[j]).statistic for j in own]
        if alone.score(fit, left).statistic > sum(worth):
            return search, accepted
    return alone, laws


def _renamed(explanation: Explanation) -> Explanation:
    """Let a law stand for a correction without a name that explains hardly more, if none is asked for beside it.

    A series of many coefficients finds a little more in any noise.
    """
    accepted = [f.candidate for f in explanation.found]
    for j, found in enumerate(explanation.found):
        if found.candidate.named:
            continue
        near = [c for c, d in found.rivals if c.named and d > -_nearly(found.gain)]
        for law in near[:2]:
            law = law.detailed(explanation.search.problem.motions) if found.score.statistic > STRONG else law
            search, laws = settled(explanation.search, [*accepted[:j], law, *accepted[j + 1 :]], rounds=4)
            bank, without = search.renewed(explanation.bank), search.without(search.fit(laws), j)
            score = search.score(without, laws[j])
            stands = laws[j].is_plausible(score.beta, without.effects) and _stands(search, laws[j], score, without)
            if stands and unnamed(search, bank, laws) is None:
                return _renamed(explained(search, bank, laws))
    return explanation


def settled(search: Search, accepted: list[Candidate], rounds: int = 2) -> tuple[Search, list[Candidate]]:
    """Take the columns of what was found about the completed model, and estimate all shapes together.

    Where columns depend on what is estimated, that takes as many rounds as it changes by more than its errors.
    """
    search = tied(search, accepted)
    if accepted:
        search, accepted = _in_turn(search, accepted, rounds=rounds)
        for _ in range(SETTLING if any(c.effect.follows and not c.effect.exact for c in accepted) else 0):
            before = search.fit(accepted)
            search, accepted = _in_turn(search, accepted, rounds=1)
            if not _has_moved(before, search.fit(accepted)):
                break
        accepted = yielding(search, accepted, search.noise(accepted))
        search = about(search, search.fit(accepted))
    return search, accepted


def tied(search: Search, accepted: Sequence[Candidate]) -> Search:
    """Give the search with all cables rigid if the soft one, on which the links swing, is not among some effects."""
    if any(c.is_swinging(search.problem.motions[0]) for c in accepted):
        return search
    return search.stiff


def _has_moved(before: Fit, after: Fit, least: float = 0.3) -> bool:
    """Whether any coefficient of a fit differs from that of another one by more than a share of its error."""
    step = np.concatenate(after.beta) - np.concatenate(before.beta)
    std = np.sqrt(np.diag(after.covariance)[-len(step) :])
    return bool(np.any(np.abs(step) > least * np.maximum(std, 1e-300)))


def _in_turn(
    search: Search, effects: list[Candidate], whitener: Whitener | None = None, rounds: int = 2
) -> tuple[Search, list[Candidate]]:
    """Move the search about the completed model and estimate all shapes, in turn; in one noise or in what is left."""
    for _ in range(rounds):
        search = about(search, search.fit(effects, whitener))
        effects = tuned(search, effects, whitener or search.noise(effects))
    return search, effects


def _plainer(explanation: Explanation, equal: float = 1.0) -> Explanation:
    """Put a law where it is as likely if friction elsewhere is dry then, without more.

    A constant torque on one motor is one on another and friction that is not the same both ways.
    """
    search, whitener = explanation.search, explanation.fit.whitener
    accepted, found = [f.candidate for f in explanation.found], explanation.found
    best, chosen = search.settings.close, accepted
    for i, refined in enumerate(accepted):
        if refined.effect.name not in REFINING:
            continue
        for j, rival in ((j, c) for j, f in enumerate(found) for c, d in f.rivals if i != j and abs(d) < equal):
            trial = [refined.dry if k == i else rival if k == j else c for k, c in enumerate(accepted)]
            if not rival.named or any(a.clashes(b) for a, b in itertools.combinations(trial, 2)):
                continue
            fit = search.fit(trial, whitener)
            fewer = search.size(*accepted) - search.size(*trial)
            more = 0.5 * (explanation.fit.deviance - fit.deviance + np.log(fit.n_rows) * fewer)
            if more > best:
                best, chosen = more, trial
    return explanation if chosen is accepted else explained(search, explanation.bank, chosen)


def _simplest(explanation: Explanation, spoilt: frozenset[tuple[str, str]] = frozenset()) -> Explanation:
    """Let that of the laws stand which the data make likeliest, at a place above all; of equals the simplest.

    Dry friction is the simplest of its kin. Laws that are alike in penalised likelihood are weighed by their evidence.
    One that is no such law any more once its shape is estimated beside all others is `spoilt`.
    """
    accepted = [f.candidate for f in explanation.found]
    for j in range(len(accepted)):
        accepted[j] = _simplest_at(explanation, j, spoilt.union(c.key for c in accepted))
    simpler = _estimated(explanation, accepted)
    worse = _unsound(simpler, explanation)
    return _simplest(explanation, spoilt | worse) if worse else simpler


def _unsound(explanation: Explanation, before: Explanation) -> frozenset[tuple[str, str]]:
    """List the laws that stood not there before and whose coefficients are not such as they may have.

    What the others leave nothing of has none: it is superfluous.
    """
    effects, out = [f.candidate for f in explanation.found], set()
    known = {f.candidate.key for f in before.found}
    for j, found in enumerate(explanation.found):
        law, score, others = found.candidate, found.score, [*effects[:j], *effects[j + 1 :]]
        sound = np.isfinite(score.statistic) and (
            law.is_plausible(score.beta, others) or _nearly_brakes(explanation, j)
        )
        if law.named and law.key not in known and score.k and not sound:
            out.add(law.key)
    return frozenset(out)


def _nearly_brakes(explanation: Explanation, j: int) -> bool:
    """Whether finding `j` brakes everywhere (`Effect.brakes`) for all that is known: it is off that by no error."""
    n = explanation.found[j].candidate.effect.brakes
    if not n:
        return False
    level, waves = explanation.fit.beta[j][0], explanation.fit.beta[j][1:n]
    depth = np.linalg.norm(waves)
    slope = np.r_[-1.0, waves / max(depth, 1e-300)]
    spread = own_covariance(explanation.fit, j)[:n, :n]
    return bool(level > 0.0 and depth - level <= np.sqrt(slope @ spread @ slope))


def _plainest(explanation: Explanation, j: int) -> Candidate:
    """Give finding `j` with the fewest coefficients with which its law is as likely; mostly it has one number of them.

    A spring may have had to stiffen before all else was found.
    """
    search, found = explanation.search, explanation.found[j]
    own, without = found.candidate, search.without(explanation.fit, j)
    fewer = [c for c in explanation.bank.laws.candidates if c.key == own.key and search.size(c) < search.size(own)]
    worth = [gain(search, without, c, search.score(without, c)) for c in fewer]
    return own if own.detail or max(worth, default=-np.inf) <= found.gain else fewer[int(np.argmax(worth))]


def _simplest_at(explanation: Explanation, j: int, taken: frozenset[tuple[str, str]]) -> Candidate:
    """Give the simplest law that may stand for finding `j`; one that friction cannot be gives way to the next best."""
    search, found, lead = explanation.search, explanation.found[j], 0.0
    best = _plainest(explanation, j)
    without = search.without(explanation.fit, j)
    rivals = [
        (c, d)
        for c, d in found.rivals
        if c.key not in taken
        and c.named == best.named
        and c.is_plausible(search.score(without, c).beta, without.effects)
        and not drives(search, without, c)
    ]
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
        alike = [c for c in alike if known[c.identity] >= worst]
    rubs = "coulomb_friction" in best.effect.confounded

    def order(c: Candidate) -> tuple[int, bool, bool]:
        return search.size(c), rubs and c.effect.name != "coulomb_friction", c.effect.name == UNLIKELIER

    return min(alike, key=order)


def _within(search: Search, law: Candidate, statistic: float, least: float) -> float:
    """Say by how much log-likelihood another law may be worse than this one, of some statistic, to be as good."""
    error = PASSAGE if law.effect.name == "stribeck_friction" else None
    return search.settings.within(statistic, error, least)


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
    if float(more @ more) >= _error_of_laws(search, own, more, beside):
        return False
    plain = (errors(search, f.base, f.effects, f.beta) for f in (beside, both))
    apart = still(search, [one - two for one, two in zip(*plain, strict=True)])
    law = [np.tensordot(search.fit([*others, own], without.whitener).beta[-1], x, 1) for x in search.columns(own)]
    return bool(np.linalg.norm(rms(search, apart)) < WRONG * np.linalg.norm(rms(search, law)))


def _peaked(explanation: Explanation, most: float = 0.2) -> Explanation:
    """Let friction be Stribeck's where what dry friction leaves open about its sign rises far above it.

    A sign that is blurred or smooth does not. The peak has to explain as much in its place, and more than dry friction
    without either by what a sign's passage may be wrong by.
    """
    search, law = explanation.search, CATALOGUE["stribeck_friction"]
    accepted = [f.candidate for f in explanation.found]
    places = [place.location for place in law.places(search.problem.model)]
    for j, (candidate, found) in enumerate(zip(accepted, explanation.found, strict=True)):
        dry = candidate.effect.name == "coulomb_friction" and candidate.detail and candidate.place.location in places
        if not dry or extremes(explanation.fit.beta[j], candidate.shape, candidate.detail)[1] < 1.0 + most:
            continue
        without, grid = search.without(explanation.fit, j), law.grid(search.problem.motions, candidate.place)
        trials = [Candidate(law, candidate.place, (candidate.shape[0], *shape[1:])) for shape in grid]
        refined = [refine(search, without, trial, 3) for trial in trials]
        peaks = [(gain(search, without, *t), i) for i, t in enumerate(refined) if t[0].is_plausible(t[1].beta)]
        if not peaks:
            continue
        (worth, i), statistic = max(peaks), found.score.statistic
        quick, plain = replace(candidate, creeps=False), refine(search, without, refined[i][0].dry, 3)
        free = min(found.gain, gain(search, without, quick, search.score(without, quick)))
        passage = _within(search, refined[i][0], statistic, search.settings.close)
        if worth > max(free - search.settings.within(statistic), gain(search, without, *plain) + passage):
            accepted[j] = refined[i][0]
    return _with(explanation, accepted)


def _peakless(explanation: Explanation, least: float = 2.0) -> Explanation:
    """Let Stribeck's friction be dry where its peak is no more than so many errors, or than its sign's passage."""
    fit, accepted = explanation.fit, [f.candidate for f in explanation.found]
    for j, candidate in enumerate(accepted):
        if candidate.effect.name == "stribeck_friction":
            (level, peak), error = fit.beta[j][:2], np.sqrt(own_covariance(fit, j)[1, 1])
            if peak <= max(least * error, PASSAGE * level) and candidate.dry.key not in [c.key for c in accepted]:
                accepted[j] = candidate.dry
    return _with(explanation, accepted)


def _with(explanation: Explanation, effects: list[Candidate]) -> Explanation:
    """Give the explanation by these effects, unless that makes one of them no such law; see `_estimated`."""
    changed = _estimated(explanation, effects)
    return explanation if _unsound(changed, explanation) else changed


def _estimated(explanation: Explanation, effects: list[Candidate]) -> Explanation:
    """Give the explanation by these effects, their shapes estimated together; itself if they are its own."""
    if effects == [f.candidate for f in explanation.found]:
        return explanation
    search = explanation.search
    return explained(search, explanation.bank, tuned(search, effects, search.noise(effects)))


def _everything(search: Search, bank: Bank, say: Reporter) -> Explanation:
    """Put in whole kinds of physics first, then what else has a name and is significant with care.

    Not so what changes the torques of the model itself, like gains and delays: that is no finding while the model is
    still far from the data. What moves the travel between encoders is one, as these tell it by themselves.
    """
    accepted = kinds_first(search)
    motion = search.problem.motions[0]

    def may_stand(c: Candidate) -> bool:
        own = not c.effect.follows or (search.problem.kinematic and c.raw_columns(motion).kinematic is not None)
        return own and c.effect.name not in ("external_torque", "friction_drift")

    for k in range(search.problem.model.n_motors):
        say("searching", 0.3 + 0.4 * k / search.problem.model.n_motors)
        fit, clear = search.fit(accepted), search.fit(accepted, clear_noise(search, accepted))
        search = about(search, clear)
        bank = search.renewed(bank)
        leaders = [c for c, _, _ in _leaders(search, clear, bank, 40, accepted) if may_stand(c)][:12]
        say.looked(clear, leaders)
        winner = _careful_winner(search, fit, clear, leaders)
        if winner is None:
            break
        accepted = [*accepted, winner]
    accepted = needed(search, accepted)
    search = about(search, search.fit(accepted))
    bank = search.renewed(bank)
    fit = search.fit(accepted)
    found = [Found(c, search.score(search.without(fit, j), c), 0.0, 0.0) for j, c in enumerate(accepted)]
    say.looked(fit)
    return Explanation(tuple(found), fit, search.fit([], fit.whitener), bank, search, everywhere=True)


def _careful_winner(search: Search, fit: Fit, clear: Fit, leaders: list[Candidate], most: int = 3) -> Candidate | None:
    """Pick the best candidate that is significant with care too; the first few that are not keep no other one out."""
    for _ in range(most):
        winner = _winner(search, clear, leaders)
        if winner is None:
            return None
        candidate = winner[0]
        if family_wise(search.score(fit, candidate), candidate, 1e-3) <= np.log(search.settings.alarm):
            return candidate
        leaders = [c for c in leaders if c.key != candidate.key]
    return None


def unnamed(search: Search, bank: Bank, accepted: list[Candidate]) -> Candidate | None:
    """Give the correction without a name that explains most of what is left; None where none is asked for."""
    fit = search.fit(accepted)
    clear = search.fit(accepted, clear_noise(search, accepted))
    for f in (fit, clear):
        for candidate, score, weight in _leaders(search, f, bank, 3, accepted, named=False):
            heard = f is fit or (is_loud(score) and _is_seconded(search, fit, candidate, score, weight))
            if heard and gain(search, f, candidate, score) > 0 and _passes(search, candidate, score, weight, f):
                return candidate
    return None


def next_law(search: Search, bank: Bank, accepted: list[Candidate], withdrawn: Sequence[Candidate]) -> Candidate | None:
    """Give the law that the data ask for most beside some effects, with all that is left as noise; None for none.

    Not one that something explains away which was withdrawn: it would only stand for that, and less well.
    """
    fit, own, but = search.fit(accepted), {c.key for c in accepted}, {c.key for c in withdrawn}
    gone = [(c, gain(search, fit, c, search.score(fit, c))) for c in withdrawn if c.key not in own]
    for candidate, score, weight in _leaders(search, fit, bank, 6, accepted):
        if candidate.key in but or not _passes(search, candidate, score, weight, fit):
            continue
        candidate, score = refine(search, fit, candidate)
        worth = gain(search, fit, candidate, score)
        more = [c for c, its in gone if its > worth + search.settings.close]
        besides = [search.fit([*accepted, c], fit.whitener) for c in more]
        if all(gain(search, f, candidate, search.score(f, candidate)) > 0.5 * worth for f in besides):
            return candidate
    return None


def explained(search: Search, bank: Bank, accepted: list[Candidate]) -> Explanation:
    """Fit a set of effects and set each against its rivals."""
    search = tied(search, accepted)
    bank = search.renewed(bank) if search.problem.posture != bank.problem.posture else bank
    fit = search.fit(accepted)
    rigid = search.fit([], fit.whitener)
    found = tuple(_compare(search, bank, accepted, j) for j in range(len(accepted)))
    return Explanation(found, fit, rigid, bank, search)


def _grow(search: Search, bank: Bank, accepted: list[Candidate], say: Reporter) -> tuple[Search, Bank, list[Candidate]]:
    """Add effects of the catalogue, one by one, as long as the data ask for any, a few at once.

    What is in the model already loads the cables and passes through the logger, so the columns that depend on these
    torques are renewed each time.
    """
    for _ in range(search.settings.at_once):
        if len(accepted) >= search.most:
            break
        fit = search.fit(accepted)
        clear = search.fit(accepted, clear_noise(search, accepted))
        if not _asked(search, fit, bank, accepted) and not _shouted(search, clear, bank, accepted):
            alone = drowned(search, bank, accepted)
            if alone is None:
                break
            clear = search.fit(accepted, alone[0])
        leaders = [c for c, _, _ in _leaders(search, clear, bank, 12, accepted)]
        say.looked(clear, leaders)
        winner = _winner(search, clear, leaders)
        if winner is None or (accepted and _is_outdone(search, clear, bank, accepted, winner)):
            break
        if any(winner[0].clashes(c) for c in accepted):  # a push that grew into another one
            break
        accepted = tuned(search, [*accepted, winner[0]], clear.whitener)
        search = about(search, search.fit(accepted, clear.whitener))
        bank = search.renewed(bank)
        for _ in range(3):
            before, accepted = accepted, polish(search, bank, accepted)
            if not _is_provisional(before, accepted):
                break
            search, accepted = _in_turn(search, accepted, clear_noise(search, accepted), rounds=3)
            bank = search.renewed(bank)
        accepted = tuned(search, accepted, clear_noise(search, accepted))
        search, bank, accepted = _sided(search, bank, accepted)
    return search, bank, accepted


def _is_outdone(search: Search, clear: Fit, bank: Bank, accepted: list[Candidate], winner) -> bool:
    """Whether a correction without a name explains far more than the best effect of the catalogue."""
    best = _leaders(search, clear, bank, 1, accepted, named=False)
    own = gain(search, clear, *winner)
    return any(gain(search, clear, c, s) > 2.5 * own + 50.0 and _passes(search, c, s, w, clear) for c, s, w in best)


def _sided(search: Search, bank: Bank, accepted: list[Candidate]) -> tuple[Search, Bank, list[Candidate]]:
    """Put friction on that side of a wrong cable map, joint or motor, where it explains more.

    Where the map is right the two are the same.
    """
    if not any(c.effect.follows for c in accepted):
        return search, bank, accepted
    whitener = clear_noise(search, accepted)

    def judged(effects: list[Candidate], rounds: int = 2) -> tuple[float, Search, list[Candidate]]:
        there, effects = _in_turn(search, effects, whitener, rounds)
        fit = there.fit(effects, whitener)
        return fit.deviance + np.log(fit.n_rows) * there.size(*effects), there, effects

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
                trials = [[_same_width(c, law) for c in others]]  # it is dry itself
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
    kinds = {place.location["kind"] for place in candidate.effect.places(model)}
    twins = twin_places(model, candidate.place) if len(candidate.place.index) == 1 else []
    laws = [replace(candidate, place=twin) for twin in twins if twin.location["kind"] in kinds]
    others = [CATALOGUE[name] for name in DRAGS if name != candidate.effect.name and candidate.effect.name in DRAGS]
    return laws + [replace(law, effect=effect) for effect in others for law in (candidate, *laws)]


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
    for place in {(c.place.A, c.place.B): c for c in accepted if c.named and c.place.A}.values():
        taken = [c for c in accepted if c.meets(place)]
        rest, without, statistic, old = _given_up(search, clear, accepted, taken)
        for candidate, score, weight in _leaders(search, without, bank, 2, rest, named=False):
            margin = 0.5 * s.patch_law_error**2 * statistic * (1 if len(taken) < 3 else -1)
            if (
                is_loud(score)
                and _passes(search, candidate, score, weight, without)
                and gain(search, without, candidate, score) > old + margin
                and _is_seconded(search, search.fit(rest, fit.whitener), candidate, score, weight)
            ):
                return [*rest, candidate]
    return _misreading(search, bank, accepted, clear)


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
    return rest, without, statistic, 0.5 * statistic - 0.5 * np.log(clear.n_rows) * search.size(*taken)


def _has_a_name(search: Search, bank: Bank, grown: list[Candidate], patched: list[Candidate]):
    """Whether one more effect of the catalogue explains all that a correction without a name would."""
    if len(grown) >= search.most:
        return False
    clear = search.fit(grown, clear_noise(search, grown))
    new = [c for c in patched if not c.named and c not in grown]
    winner = _winner(search, clear, [c for c, _, _ in _leaders(search, clear, bank, 6, grown)])
    if winner is None or not new or not _passes(search, *winner, 0.01, clear):
        return False
    own = gain(search, clear, new[0], search.score(clear, new[0]))
    return gain(search, clear, *winner) > own - _nearly(own)


def _beside_looser(
    search: Search, bank: Bank, grown: list[Candidate], patched: list[Candidate], most: int = 3
) -> tuple[Search, list[Candidate]] | None:
    """Find the law that explains more than a correction without a name once the shapes of those beside it give way.

    Estimated without it, they may have taken most of it up, such as a ratio of two motors what a gain is off by.
    """
    if not grown or len(grown) >= search.most:
        return None
    clear = search.fit(grown, clear_noise(search, grown))
    loose = loosened(search, clear)
    for law, score, _ in _leaders(search, loose, bank, most, grown):
        if not law.is_plausible(score.beta, grown) or not is_loud(score):
            continue
        there, laws = settled(search, [*grown, law], rounds=4)
        whitener = clear_noise(there, laws)
        fit, other = there.fit(laws, whitener), search.fit(patched, whitener)
        fewer = search.size(*patched) - there.size(*laws)
        without = there.without(fit, len(laws) - 1)
        stands = _stands(there, laws[-1], there.score(without, laws[-1]), without)
        if stands and other.deviance - fit.deviance + np.log(fit.n_rows) * fewer > 0.0:
            return there, laws
    return None


def _nearly(worth: float) -> float:
    """Give the log-likelihood by which a law may explain less than a correction without a name, worth so much."""
    return max(20.0, 0.03 * worth)


def _shares_motor(a: Candidate, patch: Candidate, model: CableModel) -> bool:
    """Whether an effect acts along the coordinate of a correction without a name, or on its motor's cable."""
    on_cable = not a.place.A and np.abs(patch.place.weights(model)[list(a.place.index[:1])]) > 1e-9
    return a.meets(patch) or bool(np.any(on_cable))


def _worth(search: Search, clear: Fit, accepted: list[Candidate], rest: list[Candidate], patch: Candidate) -> bool:
    """Whether the named effects beside a patch explain what the patch alone does not."""
    both = search.fit([*accepted, patch], clear.whitener).deviance
    alone = search.fit([*rest, patch], clear.whitener).deviance
    whole = search.fit(rest, clear.whitener).deviance
    return alone - both > 0.05 * (whole - both)


def likelihood(search: Search, effects: Sequence[Candidate]) -> float:
    """Give the log-likelihood of effects in the noise that suits them best, less half of BIC's penalty."""
    noise, size = search.noise(effects), search.size(*effects) + len(search.problem.states[0]) + search.n_rigid
    return log_likelihood(noise, search.problem.segments) - 0.5 * np.log(search.fit(effects, noise).n_rows) * size


def gain(search: Search, fit: Fit, candidate: Candidate, score: Score) -> float:
    """Give the log-likelihood gained less half of BIC's penalty."""
    return 0.5 * score.statistic - 0.5 * np.log(fit.n_rows) * (score.k + candidate.extra)


def evidence(search: Search, without: Fit, candidate: Candidate, size: float) -> float:
    """Give the log-likelihood that a candidate gains, less what its parameters could have fitted of anything.

    Before the data are seen, each coefficient may bring a torque as large as that which is explained, `size`, the
    whitened sum of squares: a refinement that the data hardly see costs nothing, one that they would see well costs as
    much as it could have been off. What refines dry friction has coefficients as large as its own. What is estimated of
    the shape counts as it does in Akaike's criterion, but a ratio of speeds, which may be anything, as `ODD`.
    """
    columns = search.white(without.whitener, search.columns(candidate))
    norm = np.linalg.norm(columns, axis=1, keepdims=True)
    left = without.rest(np.divide(columns, norm, out=np.zeros_like(columns), where=norm > 0))
    if candidate.effect.name in REFINING and norm[0] > 0:
        own = slice(1, len(candidate.effect.signs))  # without what details the sign of a velocity
        left[own] *= np.minimum(norm[own] / norm[0], 1.0)
    room = float(np.linalg.slogdet(np.eye(len(left)) + max(size, 1.0) * left @ left.T)[1])
    score = confined(without, candidate, columns, freed(search, without, candidate, search.score(without, candidate)))
    own_ratio = candidate.place.is_pair or candidate.effect.name == "transmission_coupling"
    return 0.5 * score.statistic - 0.5 * room - candidate.extra - ODD * own_ratio


def confined(fit: Fit, candidate: Candidate, columns: Vector, score: Score) -> Score:
    """Give the score, beside a fit, of friction that brakes everywhere (`Effect.brakes`), near the best that does.

    What drives zeros away leaves the constant of asymmetric friction free to be anything; so it may be none.
    """
    n = candidate.effect.brakes
    if not n or not np.isfinite(score.statistic) or candidate.is_plausible(score.beta, fit.effects):
        return score
    rest = fit.rest(columns)
    gram, c = rest @ rest.T, rest @ fit.residual
    for weight in np.geomspace(1e-6, 1e3, 28) * max(gram[0, 0], 1e-300):
        beta = np.linalg.lstsq(gram + weight * np.diag([0.0 < i < n for i in range(len(c))]), c, rcond=1e-12)[0]
        if candidate.is_plausible(beta, fit.effects):
            return replace(score, statistic=float(2.0 * beta @ c - beta @ gram @ beta), beta=beta)
    return replace(score, statistic=-np.inf)


def freed(search: Search, fit: Fit, candidate: Candidate, score: Score) -> Score:
    """Give the score with what the fit gains where it has coefficients that signs hold at zero, as a candidate may not.

    A peak of friction is none as long as the drag beside it is missing.
    """
    pairs = zip(fit.effects, fit.beta, strict=True)
    held = any(s and b == 0.0 for c, own in pairs for s, b in zip(c.signs, own, strict=False))
    if not held or not np.isfinite(score.statistic):
        return score
    both = search.fit([*fit.effects, candidate], fit.whitener)
    return replace(score, statistic=fit.deviance - both.deviance)


def _passes(search: Search, candidate: Candidate, score: Score, weight: float, fit: Fit) -> bool:
    """Whether a candidate is significant, visible, and more than an error of the laws in the fit or in the model.

    What it leaves open about the sign of its velocity, which may look like much else, does not count.
    """
    candidate, score = _bare(search, fit, candidate, score)
    if not candidate.effect.counts:
        candidate, score = refine(search, fit, candidate)
    robust = _is_significant(search, candidate, score, weight, fit)
    if robust is None or _worsens(search, fit, candidate):
        return False
    if not (fit.effects or search.problem.model.manipulator.effects):
        return True
    own = score.beta @ fit.rest(search.white(fit.whitener, search.columns(candidate)))
    if robust.statistic > _error_of_laws(search, candidate, own, fit) or _leaves_noise(search, fit, candidate):
        return True
    return _outdoes_in_means(search, candidate, score.beta, fit)


def _leaves_noise(search: Search, fit: Fit, candidate: Candidate) -> bool:
    """Whether a law, its shape estimated, leaves of what is far above the noise next to nothing but noise.

    An error of other laws is not all of one simple shape.
    """
    excess = fit.deviance - fit.n_rows
    if not candidate.named or excess < FAR * fit.n_rows:
        return False
    return refine(search, fit, candidate, 3)[1].statistic > WHOLE * excess


def _worsens(search: Search, fit: Fit, candidate: Candidate, most: float = 10.0) -> bool:
    """Whether the plain error, drifts aside, grows many times with what makes the whitened one fall.

    It does where next to nothing counts at some frequencies, as slow noise is large there, and masses and a candidate
    may cancel each other.
    """
    both = search.fit([*fit.effects, candidate], fit.whitener)
    own, other = (rms(search, still_errors(search, f)) for f in (both, fit))
    return bool(np.mean((own / np.maximum(other, 1e-300)) ** 2) > most**2)


def _bare(search: Search, fit: Fit, candidate: Candidate, score: Score) -> tuple[Candidate, Score]:
    """Give a candidate, and its score, without what it leaves open about the sign of its velocity."""
    return (candidate, score) if candidate.bare is candidate else (candidate.bare, search.score(fit, candidate.bare))


def _is_significant(search: Search, candidate: Candidate, score: Score, weight: float, fit: Fit) -> Score | None:
    """Give the robust score of a candidate that is visible, resolved and significant, also robustly; else None.

    A shape that is a little wrong leaves bursts behind, so it is estimated before a candidate is given up for them.
    """
    s = search.settings
    if score.visible <= s.visible or family_wise(score, candidate, weight) >= np.log(s.alarm):
        return None
    if not is_resolved(search, candidate, score.beta, fit):
        return None
    for own in (lambda: candidate, lambda: refine(search, fit, candidate)[0]):
        robust = robust_score(search, fit, own())
        if family_wise(robust, candidate, weight) < np.log(s.alarm):
            return robust
    return None


def asked_but_for_laws(search: Search, bank: Bank, accepted: list[Candidate], most: int) -> list[Candidate]:
    """List what is significant beside a fit, whether or not errors of the laws in it could explain as much."""
    out: dict[tuple[str, str], Candidate] = {}
    for whitener in (None, clear_noise(search, accepted)):
        fit = search.fit(accepted, whitener)
        for candidate, score, weight in _leaders(search, fit, bank, most, accepted):
            if _is_significant(search, candidate, score, weight, fit) is not None:
                out.setdefault(candidate.key, candidate)
    return list(out.values())


def is_resolved(search: Search, candidate: Candidate, beta: Vector, fit: Fit) -> bool:
    """Whether an effect is larger than what clocks, derivatives and filters leave wrong in the torque of a rigid body.

    Where positions are too coarse for the accelerations in the band, that is more. Of a correction without a name that
    share counts which the fit leaves over; it has to exceed what steps of encoders can bring, and where they are too
    coarse what the sensors bring by themselves. A push has to last for as long as the band can tell from an outlier,
    to exceed half a step of the torque, and where nothing moves to exceed what dry friction holds. A cable gives as a
    spring first, then as a damper. What a zero is off by has to be more than it drifts by, a delay more than the
    instants of samples are unsure by.
    """
    problem, push = search.problem, candidate.effect.name == "external_torque"
    if candidate.effect.name == "time_delay" and abs(beta[0]) * problem.motions[0].rate < PUNCTUAL:
        return False
    if push and candidate.shape[1] - candidate.shape[0] < 1.5 / problem.band.cutoff:
        return False
    if push and _is_held(search, candidate, float(np.abs(beta[0])), fit):
        return False
    if candidate.effect.name == "encoder_offset" and problem.kinematic and not _is_in_means(search, candidate, fit):
        return False
    if not problem.torque:
        return True
    m = problem.model.n_motors
    torque = [np.tensordot(beta, columns, 1) for columns in search.columns(candidate)]
    peak = np.max([np.abs(x[:m]).max(axis=1) for x in torque], axis=0)
    if push and np.all(peak <= 0.5 * problem.sensors.torque_steps):
        return False
    if candidate.effect.name in COMPLIANT and _is_no_cable(search, candidate, beta):
        return False
    if candidate.effect.name == "torque_offset" and np.all(peak <= _drifted(search, fit)):
        return False
    own, visible = rms(search, torque), 1.0
    if own[m:].any():
        return True
    least = search.settings.torque_error * (problem.band.cutoff / max(problem.sensors.trusted, 1e-3)) ** 2
    least = least * search.loads[:m]
    if not candidate.named:
        W = beta @ search.white(fit.whitener, search.columns(candidate))
        visible = float(np.linalg.norm(fit.rest(W)) / max(np.linalg.norm(W), 1e-300))
        least = np.maximum(least, ROUNDED * problem.sensors.rounding)
        if is_coarse(problem):
            least = np.maximum(least, UNSURE * problem.sensed[:m])
    if not np.any(visible * own[:m] > least):
        return False
    return candidate.effect.name not in RUBS or not _is_pushed(search, torque, fit)


def _is_pushed(search: Search, torque: Sequence[Vector], fit: Fit) -> bool:
    """Whether a friction no larger than the noise drives on the whole: noise that acts on the arm then moves it.

    Velocities of a closed loop follow the noise in its torques (Van den Hof, Annual Reviews in Control 22, 1998).
    """
    m = search.problem.model.n_motors
    noise = rms(search, errors(search, fit.base, fit.effects, fit.beta))[:m]
    if np.any(rms(search, torque)[:m] > noise):
        return False
    moved = [search.problem.band.reduce(motion.v_m.T) for motion in search.problem.motions]
    power = np.concatenate([np.sum(x[:m] * v, axis=0) for x, v in zip(torque, moved, strict=True)])
    return bool(np.sum(power) < -0.5 * np.sum(np.abs(power)))


def _drifted(search: Search, fit: Fit) -> Vector:
    """Say by how much the torques' zeros drift in a fit, rms, shape (n_motors,) [N m].

    Where most were seen to, the others' drift no less than the least of them: their sensors are of a kind.
    """
    first = search.n_bodies
    drifts = [np.tensordot(fit.base[first:], rigid[first:], 1) for rigid in search.rigid]
    size = rms(search, drifts)[: search.problem.model.n_motors]
    seen = size[size > 0.0]
    return np.maximum(size, seen.min()) if 2 * len(seen) > len(size) else size


def _is_no_cable(search: Search, cable: Candidate, beta: Vector) -> bool:
    """Whether a cable would give less to a torque than to its rate of change, or further than any cable does."""
    gives = [rms(search, [b * columns[k] for columns in search.columns(cable)]) for k, b in enumerate(beta[:2])]
    if len(gives) > 1 and float(np.linalg.norm(gives[1])) > float(np.linalg.norm(gives[0])):
        return True
    return float(beta[0]) * greatest_load(search.problem.motions, cable.place) > MOST_STRETCH


def _is_held(search: Search, push: Candidate, size: float, fit: Fit) -> bool:
    """Whether dry friction in a fit may hold a push of some size [N m] where it acts.

    It does where nothing moves, and in motion as slow as that in which the law leaves its sign open (`transitions`).
    """
    model, motion = search.problem.model, next(m for m in search.problem.motions if m.index == int(push.shape[2]))
    inside = (motion.time >= push.shape[0]) & (motion.time <= push.shape[1])
    own = push.place.weights(model)
    for law, beta in [*zip(fit.effects, fit.beta, strict=True), *effect_candidates(model)]:
        dry = law.effect.name == "coulomb_friction" or "coulomb_friction" in law.effect.confounded
        if not (dry and law.has_doubts) or law.place.is_pair:
            continue
        series, other = law.raw_columns(motion).along or (None, own)
        if series is None or abs(own @ other) <= ALIKE * np.linalg.norm(own) * np.linalg.norm(other):
            continue
        k = len(law.effect.signs)
        level = float(np.abs(beta[:k] @ series[:k]).max() * np.linalg.norm(other) / np.linalg.norm(own))
        speed = np.abs(law.place.along(motion.v, motion.v_m))[inside]
        if size < level and np.mean(speed < OPEN * sign_width(search.problem.motions, law.place)) > 0.5:
            return True
    return False


def _error_of_laws(search: Search, candidate: Candidate, own: Vector, fit: Fit) -> float:
    """Bound the statistic that a candidate gets from laws in the fit that are right up to a small share of themselves.

    The error may take any sign at any sample, so that it can look like the candidate's `own` part, as far as the fit
    leaves it over, where the two are there together.
    """
    share = 1.0 if candidate.named and candidate.effect.name != "external_torque" else search.settings.patch_error
    return float((np.abs(own) @ errors_of_laws(search, fit)) ** 2 / max(own @ own, 1e-300)) * share**2


def _leaders(
    search: Search,
    fit: Fit,
    bank: Bank,
    most: int,
    taken: Sequence[Candidate] = (),
    named: bool | None = True,
    instead: Sequence[Candidate] = (),
):
    """Best shape of each effect and place, the likeliest first: (candidate, score, weight).

    Of those that would stand `instead` of effects whose torque they contain, none: it would come back by the back door.
    Nor a play that never changes sides: it is an offset, as which it is named, unless it stands instead of several of
    which no encoders on both sides tell each.
    """
    loads = any(c.loads for c in instead)
    several = len(instead) > 1 and not search.problem.kinematic and all(c.effect.name in POSTURE for c in instead)
    best: dict[tuple[str, str], tuple[float, int, Score]] = {}
    pool = [p for p, own in ((bank.laws, True), (bank.corrections, False)) if named in (own, None)]
    candidates = [c for part in pool for c in part.candidates]
    weight = [w for part in pool for w in part.weight]
    scores = [score for part in pool for score in search.score_all(fit, part)]
    for i, (candidate, score) in enumerate(zip(candidates, scores, strict=True)):
        if score.visible < search.settings.visible or any(candidate.clashes(other) for other in taken):
            continue
        if loads and candidate.effect.follows:
            continue
        if candidate.effect.name == "backlash" and not (several or search.is_crossed(candidate)):
            continue
        value = gain(search, fit, candidate, score)
        if np.isfinite(value) and (candidate.key not in best or value > best[candidate.key][0]):
            best[candidate.key] = (value, i, score)
    order = sorted(best.values(), key=lambda item: (-_rough(item[0]), item[1]))[:most]
    return [(candidates[i], score, weight[i]) for _, i, score in order]


def _asked(search: Search, fit: Fit, bank: Bank, taken: Sequence[Candidate]) -> bool:
    """Whether the data ask for any further effect."""
    return any(_passes(search, *leader, fit) for leader in _leaders(search, fit, bank, 40, taken))


def _shouted(search: Search, clear: Fit, bank: Bank, taken: Sequence[Candidate]) -> bool:
    """Whether an effect stands out so far once common effects are taken out that no care about the noise is needed.

    A strong slow effect can pass for slow noise; its statistic in the clear noise is then many times the threshold.
    """
    loud = [x for x in _leaders(search, clear, bank, 10, taken) if is_loud(x[1])]
    return any(_passes(search, *leader, clear) for leader in loud)


def drowned(search: Search, bank: Bank, taken: Sequence[Candidate], most: int = 6) -> tuple[Whitener, Candidate] | None:
    """Find a slow effect that passes for slow noise as long as it is not in the model; give the noise beside it, too.

    Such an effect is looked for in white noise, and has to be significant by the likelihood ratio of the models with it
    and without it, each in a noise of its own; what is estimated of its shape counts.
    """
    even, alarm = search.fit(taken, even_noise(search, taken)), np.log(search.settings.alarm)
    least, best, alone = 15.0, 0.0, None  # no less is significant
    for candidate, score, weight in _leaders(search, even, bank, most, taken):
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
        if p < min(alarm, best) and _passes(search, candidate, score, weight, fit):
            best, alone = p, (whitener, candidate)
    return alone


def _is_seconded(search: Search, fit: Fit, candidate: Candidate, score: Score, weight: float) -> bool:
    """Whether a correction that is loud in the clear noise is significant with care too, unless it drowns all."""
    if score.statistic > 2000.0:
        return True
    return family_wise(search.score(fit, candidate), candidate, weight) < np.log(search.settings.alarm)


def is_loud(score: Score) -> bool:
    """Whether a statistic is many times any threshold."""
    return score.statistic > 120.0 + 25.0 * score.k


def _winner(search: Search, fit: Fit, candidates: Sequence[Candidate]):
    """Pick the best of some candidates, shapes estimated: the simplest of those that the laws' accuracy cannot tell.

    The width of the smooth sign is estimated once, for the leader; rivals at the same place start from it.
    """
    if not candidates:
        return None
    first = refine(search, fit, candidates[0])
    if first[1].statistic > STRONG:
        candidates = [c.detailed(search.problem.motions) for c in (first[0], *candidates[1:])]
        first = _braking(search, fit, *refine(search, fit, candidates[0]))
    pool = [first]
    rest = [_same_width(c, first[0]) for c in candidates[1:]]
    scored = [(gain(search, fit, c, s), n, c, s) for n, c in enumerate(rest) for s in [search.score(fit, c)]]
    best = gain(search, fit, *first)
    for n, (value, _, c, s) in enumerate(sorted(scored, key=lambda item: -item[0])):
        fine = c.effect.reach < 0.1  # its grid is coarse beside its peak
        if (n < 4 and value > best - max(40.0, 0.15 * abs(best))) or (fine and value > 0.3 * best):
            pool.append(_braking(search, fit, *refine(search, fit, c)) if c.shape else (c, s))
    pool = [(c, s) for c, s in pool if gain(search, fit, c, s) > 0 and c.is_plausible(s.beta, fit.effects)]
    pool = [(c, s) for c, s in pool if not hides_in_masses(search, fit, c)]
    if not pool:
        return None
    top = max(pool, key=lambda item: gain(search, fit, *item))
    error = search.settings.law_error if top[0].named else search.settings.patch_law_error
    slack = 0.5 * error**2 * top[1].statistic
    near = [item for item in pool if gain(search, fit, *item) >= gain(search, fit, *top) - slack]

    def order(item: tuple[Candidate, Score]) -> tuple[int, bool, float]:
        return item[1].k + item[0].extra, item[0].effect.name == UNLIKELIER, -_rough(gain(search, fit, *item))

    best = min(near, key=order)
    known = at_known_place(best[0], search.problem.model)
    if known is best[0] or any(known.key == c.key for c in fit.effects):
        return best
    return known, search.score(fit, known)


def _braking(search: Search, fit: Fit, candidate: Candidate, score: Score) -> tuple[Candidate, Score]:
    """Let friction that would drive if it gave before it slides give nothing."""
    if not candidate.gives or candidate.is_plausible(score.beta, fit.effects):
        return candidate, score
    return refine(search, fit, replace(candidate, gives=0.0))


def drives(search: Search, fit: Fit, candidate: Candidate) -> bool:
    """Whether an effect beside a fit does what it hardly can, as a spring that pushes on, by three standard errors."""
    if candidate.effect.least is None:
        return False
    weights = candidate.least(search.problem.motions)
    both = search.fit([*fit.effects, candidate], fit.whitener)
    k = len(weights)
    spread = both.covariance[-len(both.beta[-1]) :, -len(both.beta[-1]) :][:k, :k]
    return bool(weights @ both.beta[-1][:k] < -3.0 * np.sqrt(max(weights @ spread @ weights, 0.0)))


def hides_in_masses(search: Search, fit: Fit, candidate: Candidate, most: float = 2.0) -> bool:
    """Whether an effect needs masses that are much further from the file's than those without it.

    Their torque is then some times all that is measured: what masses cancel to nearly all of it may be any multiple of
    what is seen.
    """
    if not candidate.named or not search.problem.torque:
        return False
    p, problem = len(search.base.columns), search.problem
    file = search.base.values(problem.sensors.model.standard_parameters)
    without = search.base.values(problem.model.standard_parameters) - file + fit.base[:p]
    changed = without + (search.fit([*fit.effects, candidate], fit.whitener).base - fit.base)[:p]
    loads = search.loads[: problem.model.n_motors]

    def torque(change: Vector) -> Vector:
        return rms(search, [np.tensordot(change, rigid[:p], 1) for rigid in search.rigid])[: len(loads)]

    return bool(np.any(torque(changed) > most * np.maximum(loads, torque(without))))


def _rough(x: float) -> float:
    """Round to six digits, so that what differs by rounding alone stands in a fixed order."""
    return float(f"{x:.6g}")


def _same_width(candidate: Candidate, other: Candidate) -> Candidate:
    same = bool(other.place.A) and (candidate.place.A, candidate.place.B) == (other.place.A, other.place.B)
    if same and candidate.gives and other.gives:
        candidate = replace(candidate, gives=other.gives)
    if same and candidate.effect.nuisance_shape == 1 == other.effect.nuisance_shape:
        return replace(candidate, shape=(other.shape[0], *candidate.shape[1:]))
    return candidate


def _is_provisional(before: Sequence[Candidate], after: Sequence[Candidate]) -> bool:
    """Whether effects are others than before, and columns of one, taken about those, are not yet what they will be."""
    if {c.key for c in before} == {c.key for c in after}:
        return False
    return any(c.effect.follows and not c.effect.exact for c in after)


def polish(search: Search, bank: Bank, accepted: list[Candidate], rounds: int = 2) -> list[Candidate]:
    """Look again at each effect given the others: let a better one take its place, or one take the place of two.

    Not the latter while columns are provisional: what they are off by would look like a second effect.
    """
    for _ in range(rounds):
        before, whitener = accepted, clear_noise(search, accepted)
        for j in range(len(accepted)):
            if not accepted[j].named:
                continue
            others = [c for i, c in enumerate(accepted) if i != j]
            fit = search.fit(others, whitener)
            rivals = _leaders(search, fit, bank, 6, others, instead=[accepted[j]])
            leaders = [c for c, _, _ in rivals if c.key != accepted[j].key]
            trial = _winner(search, fit, [accepted[j], *leaders])
            if trial is not None:
                accepted = [*others[:j], trial[0], *others[j:]]
        if _is_provisional(before, accepted):
            break
        accepted = _merge(search, bank, accepted, whitener)
        accepted = _split(search, bank, accepted, whitener)
        if {c.key for c in accepted} == {c.key for c in before}:
            break
        if _leans_on(search, whitener, before, accepted):
            return before
    return accepted


def _leans_on(search: Search, whitener: Whitener, before: list[Candidate], after: list[Candidate]) -> bool:
    """Whether effects on the torque of others explain less once what they took the place of is out of that torque."""
    lost = [c for c in before if c.loads and c.key not in {x.key for x in after}]
    if not lost or not any(c.effect.follows for c in after):
        return False
    there = about(search, search.fit(after, whitener))
    old, new = search.fit(before, whitener), there.fit(after, whitener)
    penalty = np.log(old.n_rows) * (search.size(*after) - search.size(*before))
    return new.deviance + penalty > old.deviance + 10.0


def _merge(search: Search, bank: Bank, accepted: list[Candidate], whitener: Whitener) -> list[Candidate]:
    """Replace two effects by one where one explains as much."""
    for i in range(len(accepted)):
        for j in range(i + 1, len(accepted)):
            if not (accepted[i].named and accepted[j].named):
                continue
            without = search.without(search.fit(accepted, whitener), i, j)
            others = list(without.effects)
            pair = without.deviance - search.fit(accepted, whitener).deviance
            k = sum(search.score(without, c).k + c.extra for c in (accepted[i], accepted[j]))
            both = 0.5 * pair - 0.5 * np.log(without.n_rows) * k
            leaders = _leaders(search, without, bank, 4, others, instead=[accepted[i], accepted[j]])
            single = _winner(search, without, [c for c, _, _ in leaders])
            slack = max(search.settings.close, 0.02 * min(_alone(search, accepted, x, whitener) for x in (i, j)))
            if single is not None and gain(search, without, *single) >= both - slack:
                return [*others, single[0]]
    return accepted


def _split(search: Search, bank: Bank, accepted: list[Candidate], whitener: Whitener) -> list[Candidate]:
    """Put two effects in the place of one that stood for both, where it and any next one explain less."""
    whole = search.fit(accepted, whitener)
    reached = whole.deviance < whole.n_rows + 4.0 * np.sqrt(2.0 * whole.n_rows)
    for j, old in enumerate(accepted):
        if not old.named or (reached and search.size(old) < 3):
            continue
        without = search.without(whole, j)
        others = list(without.effects)
        own = search.score(without, old)
        if not np.isfinite(own.statistic):
            continue
        after = [gain(search, whole, c, s) for c, s, _ in _leaders(search, whole, bank, 1, accepted)]
        base = gain(search, without, old, own) + max([0.0, *after])
        slack = 0.5 * search.settings.law_error**2 * own.statistic
        best: tuple[float, list[Candidate]] | None = None
        for leader, _, _ in _leaders(search, without, bank, 4 if reached else 7, others, instead=[old]):
            if leader.key == old.key:
                continue
            if old.detail:
                leader = leader.detailed(search.problem.motions)
            first, s = refine(search, without, _same_width(leader, old))
            if not np.isfinite(s.statistic):
                continue
            beside = search.fit([*others, first], whitener)
            second = _winner(search, beside, [c for c, _, _ in _leaders(search, beside, bank, 3, [*others, first])])
            if second is None or not _passes(search, *second, 0.01, beside):
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
    return _error_of_laws(search, candidate, search.score(without, candidate).beta @ columns, without)


def prune(search: Search, accepted: list[Candidate]) -> list[Candidate]:
    """Drop effects that the others make superfluous."""
    while accepted:
        fit = search.fit(accepted)
        weakest, worst = -1, np.inf
        for j, candidate in enumerate(accepted):
            without = search.without(fit, j)
            score = search.score(without, candidate)
            statistic = -np.inf if _backwards(fit, j) else score.statistic
            if statistic < worst and (statistic < 0.0 or not _stands(search, candidate, score, without)):
                weakest, worst = j, statistic
        if weakest < 0:
            return accepted
        accepted = [c for i, c in enumerate(accepted) if i != weakest]
    return accepted


def _stands(search: Search, candidate: Candidate, score: Score, without: Fit) -> bool:
    """Whether an effect in the model passes as a new one would, or is resolved and too loud for an error of laws."""
    if _passes(search, candidate, score, 0.01, without):
        return True
    bare, score = _bare(search, without, candidate, score)
    return is_resolved(search, bare, score.beta, without) and is_loud(robust_score(search, without, bare))


def _is_in_means(search: Search, candidate: Candidate, fit: Fit) -> bool:
    """Whether the plain means of the travels between encoders tell an offset that is more than these round by.

    Of those means a small share counts, so that what else is left of a travel can look like a large offset.
    """
    own = _travel_means(search, [columns[0] for columns in search.columns(candidate)])
    left = _travel_means(search, errors(search, fit.base, fit.effects, fit.beta))
    if not len(own):
        return True
    return bool(abs(own @ left) > 0.5 * search.problem.steps_at(candidate.place.index[0]) * (own @ own))


def _outdoes_in_means(search: Search, candidate: Candidate, beta: Vector, fit: Fit) -> bool:
    """Whether plain means of the travels show an offset between encoders that is more than laws may be wrong by there.

    Of those means a small share counts, so that what varies of a law's error can look like a large offset.
    """
    if candidate.effect.name != "encoder_offset" or not search.problem.kinematic:
        return False
    own = _travel_means(search, [beta[0] * columns[0] for columns in search.columns(candidate)])
    left = _travel_means(search, errors(search, fit.base, fit.effects, fit.beta))
    if not len(own) or own @ left < 0.5 * (own @ own):
        return False
    known = np.zeros_like(own)
    for law, its in zip(fit.effects, fit.beta, strict=True):
        series = [np.tensordot(its, columns[: len(its)], 1) for columns in search.columns(law)]
        known = known + law.law_error(search.problem.motions[0]) * np.abs(_travel_means(search, series))
    return bool(own @ own > 9.0 * (known @ known))


def _travel_means(search: Search, series: Sequence[Vector]) -> Vector:
    """Give the plain means of the travels in series (n_channels, n_reduced), run by run; those that count at all."""
    problem, means = search.problem, [np.zeros(0)]
    m = problem.model.n_motors * problem.torque
    for x, run, segments in zip(series, problem.runs, problem.segments, strict=True):
        if segments and run.sure is not None:
            means.append(inside_of(x[m:], segments).mean(axis=1) / run.sure)
    return np.concatenate(means)


def _backwards(fit: Fit, j: int) -> bool:
    """Whether the leading coefficient of effect `j` cannot be negative but is, by more than three standard errors."""
    std = np.sqrt(max(own_covariance(fit, j)[0, 0], 0.0))
    return fit.effects[j].leads and bool(fit.beta[j][0] < -3 * std)


def _compare(search: Search, bank: Bank, accepted: list[Candidate], j: int) -> Found:
    """Set an accepted effect against everything that could stand in its place."""
    candidate = accepted[j]
    without = search.without(search.fit(accepted), j)
    score = freed(search, without, candidate, search.score(without, candidate))
    own = gain(search, without, candidate, score)
    rivals = []
    for leader, _, _ in _leaders(search, without, bank, 12, accepted, None, [candidate]):
        if leader.key == candidate.key:  # another push
            continue
        if candidate.detail:
            leader = leader.detailed(search.problem.motions)
        leader = _same_width(leader, candidate)
        s = freed(search, without, leader, search.score(without, leader))
        if gain(search, without, leader, s) > own - max(30.0, 0.1 * abs(own)):
            refined, s = refine(search, without, leader, plausibly=True)
            s = freed(search, without, refined, s)
            s = confined(without, refined, search.white(without.whitener, search.columns(refined)), s)
            if refined.is_plausible(s.beta, without.effects) and not hides_in_masses(search, without, refined):
                rivals.append((refined, gain(search, without, refined, s) - own))
    rivals.sort(key=lambda item: -item[1])
    return Found(candidate, score, own, family_wise(score, candidate, 0.01), tuple(rivals))
