"""The verdict: which findings are stated and with what errors, and what is there beside them that has no name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from . import findings as fi
from .candidates import shares_motor
from .confirming import ONCE, carries, is_loud_there, plain_errors
from .drifting import still_errors
from .everywhere import agreements
from .explanation import Explanation, Found
from .fit import Fit
from .geometry import Vector
from .model import CableModel
from .parts import Part
from .places import parallel, rub_place
from .search import Search, brought, rms
from .significance import is_loud
from .sticking import sticking
from .unexplained import (
    answering_torque,
    at_corrections,
    beyond_floor,
    beyond_samples,
    beyond_training,
    bursting_torque,
    is_far,
    moving_torque,
    nameless,
    of_no_size,
    ringing_torque,
    shared_torque,
    something,
    swinging_torque,
    times_noise,
    wandering_travel,
)

AGREEMENT = 0.3
"""Of many effects, what the unseen recordings make of one alone has to be like it by so much for it to be listed."""
LIKE = 0.5
"""How like a finding beside a correction the unseen recordings have to make it by themselves."""
FAR = 25.0
"""Squared error on unseen recordings, in units of the noise, beside which a finding has to carry most of it."""
BURIED = 10.0
"""Times its noise by which a motor errs, beside something without a name, where no law that acts on it is sure."""
TRIFLE = 0.05
"""Share of what was found beside it that a finding is which unseen recordings see elsewhere, and which is none then."""
SECOND = 0.05
"""Share of its second order that a gain may be off by which is friction's that its own torque loads."""
CONTACT = 0.1
"""Share of half a cable's play that it gives (rms), up to which that is how hard the play's ends are."""
ANY, VAGUE, DRIFTING = 1.0, 2.0, 3.0
"""Standard errors, by unseen recordings too, up to which a finding is none, beside something unexplained, and where it
is a zero, which drifts, and not loud."""
AS_MUCH = 0.25
"""Share by which pushes of a joint may differ that are as large as each other."""

Values = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Verdict:
    """What a diagnosis states of an explanation.

    Attributes
    ----------
    model : CableModel
        As the file says it.
    judge : Search or None
        The unseen recordings.
    explanation : Explanation
    disputed : bool
        Whether something loud was withdrawn, or far more is left than noise.
    covariance : ndarray
        Of base parameters, coefficients and shapes together.
    where : tuple of ndarray of int
        Where those of each finding stand in it.
    fitted : dict
        Parameters of the findings with a name, by their number in the explanation, with the errors of their fit.
    stated : dict
        Of those that are listed, with all errors that they may have.
    unexplained : dict or None
        What is there that has no name, as the format says it.
    unlisted : dict
        What belongs to a finding and is not listed beside it, and to which, by their numbers.
    """

    model: CableModel
    judge: Search | None
    explanation: Explanation
    disputed: bool
    covariance: Vector
    where: tuple[np.ndarray, ...]
    fitted: Mapping[int, Values]
    stated: Mapping[int, Values]
    unexplained: dict[str, Any] | None = None
    unlisted: Mapping[int, int] = field(default_factory=dict)

    @property
    def search(self) -> Search:
        """The training recordings."""
        return self.explanation.search

    @property
    def fit(self) -> Fit:
        """Fit of the explanation."""
        return self.explanation.fit

    @property
    def everywhere(self) -> bool:
        """Whether nearly every axis rubs."""
        return self.explanation.everywhere

    @property
    def corrections(self) -> list[Found]:
        """What stands in the explanation without a name."""
        return [f for f in self.explanation.found if not f.candidate.named]

    @property
    def said(self) -> str:
        """The word for it."""
        return "unexplained" if self.unexplained else ("missing_physics" if self.stated else "consistent")

    @property
    def written(self) -> Mapping[int, Values]:
        """Parameters of what the completed model has; where nearly every axis rubs, also of what has no sure name."""
        if self.everywhere:
            return self.fitted
        return {**self.stated, **{j: self.fitted[j] for j, other in self.unlisted.items() if other in self.stated}}

    def spread(self, j: int) -> Vector:
        """Covariance of the coefficients and the shape of finding `j`."""
        return self.covariance[np.ix_(self.where[j], self.where[j])]

    def motors(self, j: int) -> np.ndarray:
        """Tell on which motors finding `j` acts all the time, shape (n_motors,); none where it has no coordinate."""
        candidate = self.fit.effects[j]
        if candidate.effect.name in ONCE or not candidate.place.A:
            return np.zeros(self.model.n_motors, bool)
        return np.abs(candidate.place.weights(self.model)) > 1e-9

    def keeping(self, holds: Callable[[int], bool]) -> Verdict:
        """State only those findings for which something holds."""
        return replace(self, stated={j: v for j, v in self.stated.items() if holds(j)})

    def unlisting(self, belong: Mapping[int, int]) -> Verdict:
        """State no more what belongs to other findings, and to which; the completed model has it."""
        return replace(self, unlisted={**self.unlisted, **belong}).keeping(lambda j: j not in belong)


def reached(model: CableModel, judge: Search | None, explanation: Explanation, disputed: bool) -> Verdict:
    """Reach a verdict on an explanation.

    The first gate that finds something without a name says what it is, and which findings stand beside it.
    """
    verdict = _named(model, judge, explanation, disputed)
    for gate in GATES:
        if verdict.unexplained is None:
            verdict = gate(verdict)
    return _agreed(_buried(verdict))


def _named(model: CableModel, judge: Search | None, explanation: Explanation, disputed: bool) -> Verdict:
    """State the findings with a name of which it is known how large they are, the strongest first."""
    covariance, where = fi.joint_covariance(explanation.search, explanation.fit)
    verdict = Verdict(model, judge, explanation, disputed, covariance, where, {}, {})
    found, beta = explanation.found, explanation.fit.beta
    named = [j for j, f in enumerate(found) if f.candidate.named]
    if verdict.corrections:
        named = [j for j in named if fi.is_sure(model, found[j], verdict.corrections)]
    named.sort(key=lambda j: -found[j].score.statistic)
    fitted = {j: fi.parameters(found[j].candidate, beta[j], verdict.spread(j)) for j in named}

    confused = fi.confused_plays(explanation.search, explanation)
    for offset, play in confused.items():
        if offset in fitted and play in fitted:
            gap, shift = fitted[play]["half_gap"], fitted[offset]["offset"]["value"]
            fitted[play] = fitted[play] | {"half_gap": gap | {"std": float(np.hypot(gap["std"], shift))}}

    def holds(j: int) -> bool:
        candidate, values = found[j].candidate, fitted[j]
        known = fi.is_known(values, candidate, beta[j], verdict.spread(j))
        lawful = explanation.everywhere or fi.is_lawful(explanation.fit, j)
        sure = known and lawful and fi.is_admissible(candidate.effect, values) and found[j].gain >= 5.0
        sure = sure and fi.is_late(candidate, values)
        return sure and j not in confused and fi.is_above_steps(explanation.search, candidate, values)

    verdict = replace(verdict, fitted=fitted, stated=fitted).keeping(holds)
    if not explanation.everywhere:
        return verdict
    return verdict.keeping(lambda j: not fi.is_outdone(found[j]) and found[j].agreement >= AGREEMENT)


def _corrected(verdict: Verdict) -> Verdict:
    """Whether corrections without a name stand in the explanation; where much is left, little stands beside them.

    Masses that err with what has no name make small pushes.
    """
    if not verdict.corrections:
        return verdict
    judge, explanation = verdict.judge, verdict.explanation
    verdict, found = replace(verdict, unexplained=at_corrections(explanation, verdict.corrections)), explanation.found
    verdict = verdict.keeping(lambda j: found[j].candidate.effect.name not in ONCE or is_loud(found[j].score))
    if judge is None or explanation.everywhere:
        return verdict
    if plain_errors(judge, explanation.fit)[0] <= FAR * judge.problem.n_channels:
        return verdict
    repeated = [agreement >= LIKE for agreement in agreements(judge, explanation.fit)]
    return verdict.keeping(
        lambda j: carries(judge, explanation, j) or (repeated[j] and is_loud_there(judge, explanation, j))
    )


def _uncorrected(verdict: Verdict) -> Verdict:
    """Whether a correction would explain more where nearly every axis rubs and none competed."""
    return replace(verdict, unexplained=nameless(verdict.explanation)) if verdict.everywhere else verdict


def _above_noise(verdict: Verdict, *, shared: bool = False) -> Verdict:
    """Whether far more is left than noise; `shared`, whether training and unseen recordings have some of it alike."""
    search, judge, explanation = verdict.search, verdict.judge, verdict.explanation
    unexplained, excess = beyond_floor(search, judge, explanation, shared=shared)
    if unexplained is None:
        return verdict
    verdict = replace(verdict, unexplained=unexplained)
    if explanation.everywhere:
        return verdict
    motor = unexplained["location"]["index"]
    return verdict.keeping(lambda j: fi.outweighs(verdict.model, explanation.found[j], motor, excess))


def _moving(verdict: Verdict) -> Verdict:
    """Whether a torque or a travel moves by itself."""
    search, fit = verdict.search, verdict.fit
    return replace(verdict, unexplained=moving_torque(search, fit) or wandering_travel(search, fit))


def _elsewhere(verdict: Verdict) -> Verdict:
    """Whether a torque answers the motion, or rings, or unseen recordings hold what the training does not tell of.

    A line in its spectrum is a swing, which does not need to be struck.
    """
    search, judge, fit = verdict.search, verdict.judge, verdict.fit
    unexplained = answering_torque(search, judge, fit)
    if unexplained is None:
        unexplained = ringing_torque(search, fit) or (judge and beyond_training(search, judge, fit))
        if unexplained is not None and not verdict.stated:
            unexplained = swinging_torque(search, fit) or unexplained
    if unexplained is None:
        return verdict
    verdict = replace(verdict, unexplained=unexplained)
    return verdict.keeping(lambda j: carries(judge or search, verdict.explanation, j))


def _shared(verdict: Verdict) -> Verdict:
    """Whether several motors err alike, far above the noise; what acts there is not known then."""
    unexplained = shared_torque(verdict.search, verdict.judge, verdict.fit)
    if unexplained is None:
        return verdict
    verdict, found = replace(verdict, unexplained=unexplained), verdict.explanation.found
    place = unexplained["location"]
    return verdict.keeping(lambda j: found[j].candidate.location != place)


def _unsized(verdict: Verdict) -> Verdict:
    """Whether something was found, but nothing of a known size."""
    if verdict.stated or not verdict.fitted:
        return verdict
    effects = verdict.fit.effects
    unsure = [
        j for j in fi.unsized(verdict.explanation) if fi.is_above_steps(verdict.search, effects[j], verdict.fitted[j])
    ]
    return replace(verdict, unexplained=of_no_size(verdict.explanation, unsure))


def _odd(verdict: Verdict) -> Verdict:
    """Whether something loud was found with parameters that no such law has: it is another, and spoils what is near."""
    odd = [j for j, values in verdict.fitted.items() if fi.is_odd(verdict.explanation.found[j], values)]
    return _of_another_law(verdict, odd, "by a law like one that is known, with parameters that none has")


def _recurring(verdict: Verdict) -> Verdict:
    """Whether a joint is pushed time and again by as much: what comes back is a law that is not known."""
    effects, stated = verdict.fit.effects, verdict.stated
    torque = {j: v["torque"]["value"] for j, v in stated.items() if effects[j].effect.name == "external_torque"}

    def is_back(i: int, j: int) -> bool:
        alike = abs(torque[i] - torque[j]) < AS_MUCH * max(abs(torque[i]), abs(torque[j]))
        return i != j and alike and effects[i].location == effects[j].location

    back = [j for j in torque if any(is_back(i, j) for i in torque)]
    return _of_another_law(verdict, back, "by pushes that come back")


def _of_another_law(verdict: Verdict, which: Sequence[int], words: str) -> Verdict:
    """Take their names from some findings, and from what is near them and does not outweigh them."""
    found = verdict.explanation.found
    unexplained = of_no_size(verdict.explanation, which, words)
    if unexplained is None:
        return verdict
    most = fi.OUTWEIGHS * max(found[j].score.statistic for j in which)

    def stands(j: int) -> bool:
        pairs = [(found[j].candidate, found[i].candidate) for i in which]
        near = any(shares_motor(a, b, verdict.model) or shares_motor(b, a, verdict.model) for a, b in pairs)
        return j not in which and (found[j].score.statistic > most or not near)

    return replace(verdict, unexplained=unexplained).keeping(stands)


def _contact(verdict: Verdict) -> Verdict:
    """List no soft cable that gives next to nothing beside its play: that is how hard the play's ends are."""
    search, effects, beta = verdict.search, verdict.fit.effects, verdict.fit.beta
    plays = {effects[j].place.index: j for j in verdict.stated if effects[j].effect.name == "backlash"}
    soft = [j for j in verdict.stated if effects[j].effect.name == "cable_elasticity"]
    pairs = {j: plays[effects[j].place.index] for j in soft if effects[j].place.index in plays}
    contacts = {
        j: play
        for j, play in pairs.items()
        if fi.largest_travel(search, effects[j], beta[j]) <= CONTACT * beta[play][0]
    }
    return verdict.unlisting(contacts)


def _own_torque(verdict: Verdict) -> Verdict:
    """List no gain that friction by torque brings where its own torque loads it, too.

    Of c times the magnitude of the whole torque, 1 / (1 - c^2) of the others' torque is even in the velocity.
    """
    effects, fitted = verdict.fit.effects, verdict.fitted
    rubs = [j for j in verdict.stated if effects[j].effect.name == "torque_dependent_friction"]
    gains = [j for j in verdict.stated if effects[j].effect.name == "torque_gain_error"]

    def is_own(j: int, rub: int) -> bool:
        gain, square = fitted[j]["gain"], fitted[rub]["coefficient"]["value"] ** 2
        alone = np.flatnonzero(verdict.motors(rub)).tolist() == [effects[j].place.index[0]]
        return alone and abs(gain["value"] - 1.0 / (1.0 - square)) <= max(2.0 * gain["std"], SECOND * square)

    return verdict.unlisting({j: rub for j in gains for rub in rubs if is_own(j, rub)})


def _loud(verdict: Verdict) -> Verdict:
    """Whether, of a disputed explanation, something loud is left; what happens once cannot be confirmed then.

    Nor can, far above the noise, what sits where that is.
    """
    if not verdict.disputed:
        return verdict
    unexplained = nameless(verdict.explanation, only_loud=True)
    if unexplained is None:
        return verdict
    candidates, far = verdict.fit.effects, is_far(verdict.search, verdict.fit)
    verdict = replace(verdict, unexplained=unexplained)
    verdict = verdict.keeping(lambda j: candidates[j].effect.name not in ONCE)
    return verdict.keeping(lambda j: not far or candidates[j].location != unexplained["location"])


def _drowned(verdict: Verdict) -> Verdict:
    """Whether a motor errs by what no sensor does; what was found on it and takes less than most of that has no name.

    What happens once is seen at its time.
    """
    if verdict.everywhere or not verdict.stated:
        return verdict
    search, explanation = verdict.search, verdict.explanation
    errs = beyond_samples(search, verdict.judge, verdict.fit)
    there = [j for j in verdict.stated if np.any(errs[verdict.motors(j)] > 0.0)]
    drowning = [j for j in there if not is_loud_there(search, explanation, j)]
    if not drowning:
        return verdict
    worst = int(np.argmax(errs))
    words = f"an error of motor {worst + 1} that is far above its sensor's noise, in no shape that was tried"
    verdict = replace(verdict, unexplained=something("motor", worst + 1, words, float(errs[worst])))
    return verdict.keeping(lambda j: j not in drowning)


def _swinging(verdict: Verdict) -> Verdict:
    """Whether, where nothing else is said, a torque swings above the band or comes in bursts."""
    if verdict.stated:
        return verdict
    search, judge, fit = verdict.search, verdict.judge, verdict.fit
    return replace(verdict, unexplained=swinging_torque(search, fit) or bursting_torque(search, judge, fit))


def _in_common(verdict: Verdict) -> Verdict:
    """Whether training and unseen recordings have some residual alike."""
    return verdict if verdict.everywhere else _above_noise(verdict, shared=True)


def _sticking(verdict: Verdict) -> Verdict:
    """Whether an axis holds more at rest than what was found there can; that has no name then."""
    unexplained = sticking(verdict.search, verdict.fit)
    if unexplained is None:
        return verdict
    verdict, found = replace(verdict, unexplained=unexplained), verdict.explanation.found
    axis = rub_place(verdict.model, unexplained["location"]).weights(verdict.model)

    def stands(j: int) -> bool:
        place = found[j].candidate.place
        return not place.A or not parallel(place.weights(verdict.model), axis)

    return verdict.keeping(stands)


GATES: Sequence[Callable[[Verdict], Verdict]] = (
    _corrected,
    _uncorrected,
    _above_noise,
    _moving,
    _elsewhere,
    _shared,
    _unsized,
    _odd,
    _recurring,
    _contact,
    _own_torque,
    _loud,
    _drowned,
    _swinging,
    _in_common,
    _sticking,
)


def _buried(verdict: Verdict) -> Verdict:
    """State nothing of a motor that errs by many times its noise, beside something without a name, but what takes most.

    What happens once is seen at its time, and what encoders misread between them.
    """
    if verdict.everywhere or verdict.unexplained is None or not verdict.stated:
        return verdict
    search, judge, fit = verdict.search, verdict.judge, verdict.fit
    times = times_noise(search, judge, fit)

    def stands(j: int) -> bool:
        seen = search.problem.kinematic and fit.effects[j].effect.exact_travel
        calm = seen or bool(np.all(times[verdict.motors(j)] < BURIED))
        return calm or carries(judge or search, verdict.explanation, j)

    return verdict.keeping(stands)


def _agreed(verdict: Verdict) -> Verdict:
    """Widen the errors of parameters by those of laws and by how far the unseen recordings see them elsewhere.

    A finding of which no size is left then is none; what the recordings disagree about may be part of what has no name,
    and has none itself where they do so far beyond chance.
    """
    search, judge, explanation, fit = verdict.search, verdict.judge, verdict.explanation, verdict.fit
    where, covariance = verdict.where, verdict.covariance
    stated = {
        j: fi.with_law_errors(search, fit, j, covariance, where[j], values) for j, values in verdict.stated.items()
    }
    lasting = [j for j in stated if fit.effects[j].effect.name not in ONCE]
    told = {j: verdict.fitted[j] for j in stated}  # by the recordings, whatever else its law may be wrong by
    parted = [] if explanation.everywhere else _changing_parts(verdict, told, lasting)
    if not lasting or judge is None or not any(judge.problem.segments):
        return _without_changing(replace(verdict, stated=stated), parted, "some parts of the recordings")
    step, chance = fi.unseen_shift(judge, fit, covariance, where)
    changing = []
    for j in lasting:
        own = step[where[j]], chance[np.ix_(where[j], where[j])]
        if not explanation.everywhere and fi.is_another_there(search, judge, fit, j, *own, told[j]):
            changing.append(j)
        told[j] = fi.with_scatter(fit.effects[j], fit.beta[j], *own, told[j])
        stated[j] = fi.with_scatter(fit.effects[j], fit.beta[j], *own, stated[j])

    def faded(j: int, least: float) -> bool:
        before, after = (fi.most_sure(fit.effects[j].effect.name, values[j]) for values in (verdict.fitted, told))
        if not before > least or after > least:
            return False
        return not (carries(judge, explanation, j) or is_loud_there(judge, explanation, j))

    vague = [j for j in told if faded(j, ANY if verdict.unexplained is None else VAGUE)]
    zeros = [
        j for j in told if fit.effects[j].effect.name == "torque_offset" and not is_loud(explanation.found[j].score)
    ]
    drifting = [j for j in zeros if faded(j, DRIFTING)]
    verdict = replace(verdict, stated=stated).keeping(lambda j: j not in vague and j not in drifting)
    verdict = _without_changing(verdict, changing, "the unseen recordings")
    verdict = _without_changing(verdict, [j for j in parted if j in verdict.stated], "some parts of the recordings")
    if not vague or verdict.stated:
        return verdict
    return replace(verdict, unexplained=verdict.unexplained or of_no_size(explanation, vague))


def _changing_parts(verdict: Verdict, told: Mapping[int, Values], lasting: Sequence[int]) -> list[int]:
    """List the findings whose laws have another size in one part of the recordings than in all others."""
    fit, where = verdict.fit, verdict.where
    seen = fi.shifts_apart(verdict.search, fit) if lasting else []

    def changes(j: int, part: Part, step: Vector, chance: Vector) -> bool:
        own = step[where[j]], chance[np.ix_(where[j], where[j])]
        return fi.is_another_there(part.others, part.own, fit, j, *own, told[j])

    return [j for j in lasting if any(changes(j, *each) for each in seen)]


def _is_trifle(verdict: Verdict, j: int) -> bool:
    """Whether a finding is a small share of the others that are stated, or below the noise, wherever it is seen."""
    search, fit = verdict.search, verdict.fit
    both = (j, *(i for i in verdict.stated if i != j))
    own, *others = (rms(search, brought(search, fit.effects[i], fit.beta[i])) for i in both)
    if not others:
        return False
    noise = rms(search, still_errors(search, fit))
    return bool(np.all(own <= np.maximum(TRIFLE * np.linalg.norm(others, axis=0), noise)))


def _without_changing(verdict: Verdict, changing: Sequence[int], there: str) -> Verdict:
    """Take their names from findings whose laws are others somewhere, and from what hangs on them.

    What is a trifle beside other findings is then what these are a little wrong by, and nothing without a name.
    """
    trifles = {j for j in changing if _is_trifle(verdict, j)}
    verdict, changing = verdict.keeping(lambda j: j not in trifles), [j for j in changing if j not in trifles]
    if not changing:
        return verdict
    found = verdict.explanation.found
    beside = [found[j] for j in changing]
    words = f"its law has another size in {there} than in the others"
    unexplained = verdict.unexplained or of_no_size(verdict.explanation, changing, words)
    most = fi.OUTWEIGHS * max(f.score.statistic for f in beside)
    return replace(verdict, unexplained=unexplained).keeping(
        lambda j: j not in changing and (found[j].score.statistic > most or fi.is_sure(verdict.model, found[j], beside))
    )
