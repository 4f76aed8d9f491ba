"""Robots on which nearly every axis rubs: whole kinds of physics first, at all places at once, then single effects.

Adding one effect after the other fails there: what is still missing elsewhere counts as noise, and the first effects
take over what others will explain. So each kind that most machines have is put in everywhere, and what the data do not
ask for is taken out again, with care: what is still missing counts as noise. Corrections without a name do not compete;
they describe what is left (`diagnose`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .bank import Bank
from .candidates import Candidate
from .effect import Place
from .effects import CATALOGUE
from .events import Reporter
from .explanation import Explanation, Found
from .fit import Estimate, Fit, own_covariance, where_in
from .leaders import best_of, leading
from .leftover import clear_noise
from .masses import about
from .model import CableModel
from .places import axis_places, joint_places, parallel
from .scores import family_wise
from .search import Search

RUBBING = ("viscous_friction", "coulomb_friction")
FRICTION = (*RUBBING, "torque_offset")
LOUD = 170.0
"""Fall of the whitened sum of squares by the friction of one axis that is many times any threshold."""
MANY, APART = 4, 2.0
"""Axes that rub, and how many times what these leave the laws found first leave over, so that those are no start."""
SLIP = 0.03
"""Distance of the middle element of a hysteresis, over the range of its coordinate."""


def rubs_everywhere(search: Search, bank: Bank, found: Sequence[Candidate], least: int = 3) -> bool:
    """Whether friction is missing at most axes, beside what was found first and given that at all the others.

    No place alone may be the whole story, nor any correction without a name, nor what was found, friction at few axes
    with it, and one more law that is none: an effect that acts on several motors, such as a delay, may look like
    friction everywhere.
    """
    model = search.problem.model
    axes = apart(axis_places(model), model)
    if not search.problem.torque or len(axes) < least:
        return False
    common = at_all_axes(search, FRICTION)
    all_found, found = found, [c for c in found if not _rubs(c)]
    clear = clear_noise(search, [*found, *common])
    whole = search.fit([*found, *common], clear).deviance
    alone = search.fit(all_found, clear)
    if alone.deviance < whole + LOUD and alone.deviance < alone.n_judged + 4.0 * np.sqrt(2.0 * alone.n_judged):
        return False  # what was found is all
    worth = []
    for place in axes:
        own = place.weights(model)
        rest = [c for c in common if c.effect.name == "torque_offset" or not parallel(c.place.weights(model), own)]
        worth.append(max(search.fit([*found, *rest], clear).deviance - whole, 0.0))
    spread = np.sum(worth) ** 2 / max(np.sum(np.square(worth)), 1e-300)
    loud = int(np.sum(np.array(worth) > LOUD))
    rubbing = {(c.place.A, c.place.B): 1 + c.place.is_pair for c in all_found if c.place.A and _rubs(c)}
    few = loud >= sum(rubbing.values()) + 2  # most are yet to be found
    slow = loud >= MANY and alone.deviance > APART * whole  # or what was found first stands for what is not yet
    n = model.n_motors if few or slow else len(axes)
    if loud < max(least, 0.75 * n) or spread <= max(2.0, 0.3 * n):
        return False
    rigid = search.fit([], clear)
    patch = max(score.statistic for score in search.score_all(rigid, bank.corrections))
    if rigid.deviance - patch <= whole:
        return False
    if 2 * len(rubbing) >= len(axes):
        return True
    scores = zip(bank.laws.candidates, search.score_all(alone, bank.laws), strict=True)
    law = max((score.statistic for c, score in scores if not _rubs(c)), default=0.0)
    return bool(alone.deviance - law > whole)


def everything(search: Search, bank: Bank, say: Reporter, start: Sequence[Candidate] = ()) -> Explanation:
    """Put in whole kinds of physics first, beside what is evident, then what else has a name and is sure with care.

    Not so what changes the torques of the model itself, like gains and delays: that is no finding while the model is
    still far from the data. What moves the travel between encoders is one, as these tell it by themselves.
    """
    accepted = kinds_first(search, start)
    motion = search.problem.motions[0]

    def may_stand(c: Candidate) -> bool:
        own = not c.effect.follows or (search.problem.kinematic and c.raw_columns(motion).kinematic is not None)
        return own and c.effect.name not in ("external_torque", "friction_drift")

    for k in range(search.problem.model.n_motors):
        say("searching", 0.3 + 0.4 * k / search.problem.model.n_motors)
        fit, clear = search.fit(accepted), search.fit(accepted, clear_noise(search, accepted))
        search = about(search, clear)
        bank = search.renewed(bank)
        leaders = [c for c, _, _ in leading(search, clear, bank, 40, accepted) if may_stand(c)][:12]
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
        winner = best_of(search, clear, leaders)
        if winner is None:
            return None
        candidate = winner[0]
        if family_wise(search.score(fit, candidate), candidate, 1e-3) <= np.log(search.settings.alarm):
            return candidate
        leaders = [c for c in leaders if c.key != candidate.key]
    return None


def apart(places: Sequence[Place], model: CableModel) -> list[Place]:
    """Give of places that are the same coordinate, but for a ratio, the first."""
    out: list[Place] = []
    for place in places:
        if not any(parallel(place.weights(model), other.weights(model)) for other in out):
            out.append(place)
    return out


def _rubs(candidate: Candidate) -> bool:
    """Whether it is friction of some kind along one coordinate, or what a motor's may pass for beside other joints'."""
    return candidate.rubs or candidate.effect.name == "transmission_coupling"


def at_all_axes(search: Search, names: Sequence[str]) -> list[Candidate]:
    """Give effects at every place they can sit, with their first shape, where the rigid body does not hide them."""
    motions, model = search.problem.motions, search.problem.model
    empty = search.fit([], search.plain)
    out = []
    for name in names:
        effect = CATALOGUE[name]
        for place in effect.places(model):
            if place.is_pair:
                continue
            candidate = Candidate(effect, place, effect.grid(motions, place)[0])
            if search.score(empty, candidate).visible > 0.02:
                out.append(candidate)
    return out


def kinds_first(search: Search, start: Sequence[Candidate] = ()) -> list[Candidate]:
    """Put friction, rotors, hysteresis and springs in everywhere, beside others; leave what the data ask for."""
    effects = widened(search, [*start, *at_all_axes(search, FRICTION)])
    for more in (at_all_axes(search, ("rotor_inertia",)), slips(search)):
        effects = needed(search, [*effects, *more])
    return needed(search, sprung(search, effects))


def widened(search: Search, effects: list[Candidate]) -> list[Candidate]:
    """Make the smooth sign of each friction as wide as the torques show it."""
    for j, candidate in enumerate(effects):
        if not candidate.effect.nuisance_shape:
            continue
        others = [c for i, c in enumerate(effects) if i != j]
        fit = search.fit(others, clear_noise(search, effects))
        trials = [replace(candidate, shape=(f * candidate.shape[0], *candidate.shape[1:])) for f in (1, 2, 4, 8, 16)]
        scores = [search.score(fit, trial).statistic for trial in trials]
        effects = [*effects[:j], trials[int(np.argmax(scores))], *effects[j + 1 :]]
    return effects


def slips(search: Search) -> list[Candidate]:
    """Hysteresis at every axis, with elements that let go at six distances."""
    out = []
    for place in axis_places(search.problem.model):
        reach = max(float(np.ptp(place.along(m.q, m.q_m))) for m in search.problem.motions)
        if reach > 0:
            out.append(Candidate(CATALOGUE["hysteresis"], place, (SLIP * reach, 0.0), 1.0))
    return out


def sprung(search: Search, effects: list[Candidate]) -> list[Candidate]:
    """Let a spring take the place of a constant torque where the data ask for it, strongest first."""
    model = search.problem.model
    for _ in range(model.n_motors):
        fit = search.fit(effects, clear_noise(search, effects))
        best: tuple[float, list[Candidate]] | None = None
        for place in joint_places(model):
            w = place.weights(model)
            if any(c.effect.name == "joint_spring" and parallel(c.place.weights(model), w, 0.999) for c in effects):
                continue
            rest = [
                c for c in effects if c.effect.name != "torque_offset" or not parallel(c.place.weights(model), w, 0.999)
            ]
            without = search.fit(rest, fit.whitener)
            for shape in ((0.0,), (1.0,)):
                spring = Candidate(CATALOGUE["joint_spring"], place, shape)
                score = search.score(without, spring)
                if not _restores(search, spring, score.beta):
                    continue
                gain = score.statistic - (without.deviance - fit.deviance) - np.log(fit.n_judged) * (score.k - 1)
                if gain > max(150.0, best[0] if best else 0.0):
                    best = gain, [*rest, spring]
        if best is None:
            break
        effects = best[1]
    return effects


def _restores(search: Search, spring: Candidate, beta: np.ndarray) -> bool:
    """Whether a spring's torque grows with its angle nearly everywhere it was."""
    q = np.concatenate([spring.place.along(m.q, m.q_m) for m in search.problem.motions])
    slope = beta[0] + (2 * beta[2] * q + 3 * beta[3] * q**2 if len(beta) > 2 else 0.0 * q)
    return bool(np.mean(slope > 0) > 0.9)


def needed(search: Search, effects: list[Candidate], rounds: int = 3, least: float = 30.0) -> list[Candidate]:
    """Leave out, one by one, what the others make superfluous.

    In the noise that the whole leaves over or, where an effect is so slow and strong that it passes for noise, in the
    clear one.
    """
    for _ in range(rounds):
        before = len(effects)
        careful, clear = search.fit(effects), search.fit(effects, clear_noise(search, effects))
        while effects:
            sizes = np.array([len(b) for b in careful.beta])
            margin = np.maximum(worths(careful) - least - 4.0 * sizes, worths(clear) - 5 * least - 25.0 * sizes)
            margin[[is_backwards(c, b) for c, b in zip(effects, careful.beta, strict=True)]] = -np.inf
            weakest = int(np.argmin(margin))
            if margin[weakest] > 0:
                break
            effects = [c for i, c in enumerate(effects) if i != weakest]
            careful, clear = (search.fit(effects, fit.whitener) for fit in (careful, clear))
        if len(effects) == before:
            break
    return effects


def is_backwards(candidate: Candidate, beta: np.ndarray) -> bool:
    """Whether a law has the wrong sign: friction that pushes, a linear spring that repels."""
    return candidate.leads and bool(beta[0] < 0)


def worths(fit: Fit) -> np.ndarray:
    """By how much the sum of squares would rise without each effect, from the covariance of the fit (Wald)."""
    out = []
    for j, beta in enumerate(fit.beta):
        live = beta != 0
        block = own_covariance(fit, j)[np.ix_(live, live)]
        b = beta[live]
        out.append(float(b @ np.linalg.pinv(block, rcond=1e-9, hermitian=True) @ b) if live.any() else 0.0)
    return np.array(out)


def confirmed(search: Search, judge: Search, effects: list[Candidate], levels: np.ndarray) -> list[Candidate]:
    """Withdraw, the most useless first, what does not help on the unseen recordings by its share, or harms there.

    Each removal moves all other parameters; that follows from the covariance of the fit.

    Parameters
    ----------
    search, judge : Search
        The training and the unseen recordings.
    effects : list of Candidate
    levels : ndarray, shape (n_channels,)
        What errors are measured by where they are not whitened.
    """
    withdrawn: list[Candidate] = []
    for _ in range(3):
        fit = search.fit(effects)
        unseen = _Unseen.of(judge, fit, levels)
        left = Estimate.of(fit)
        slots = dict(enumerate(where_in(fit)))
        kept = list(slots)
        while kept:
            now, useless = unseen.errors(left.values), {}
            for j in kept:
                after = unseen.errors(left.without(slots[j]).values)
                share = 0.1 * unseen.share * left.worth(slots[j])
                wrong = is_backwards(effects[j], left.values[slots[j]])
                if wrong or after[0] - now[0] < max(6.0, share) or after[1] < 0.99 * now[1]:
                    useless[j] = after[0] / now[0] + after[1] / now[1]
            if not useless:
                break
            worst = min(useless, key=lambda j: useless[j])
            left = left.without(slots[worst])
            kept.remove(worst)
        if len(kept) == len(effects):
            break
        withdrawn += [c for j, c in enumerate(effects) if j not in kept]
        effects = [effects[j] for j in kept]
    return _readmitted(search, judge, effects, withdrawn, levels)


def _readmitted(
    search: Search, judge: Search, effects: list[Candidate], withdrawn: list[Candidate], levels: np.ndarray
) -> list[Candidate]:
    """Take back what helps after all: it may have seemed useless beside something that is gone since."""
    fit = search.fit(effects)
    now = _Unseen.of(judge, fit, levels).errors(np.concatenate([fit.base, *fit.beta]))
    for candidate in withdrawn:
        trial = search.fit([*fit.effects, candidate], fit.whitener)
        unseen = _Unseen.of(judge, trial, levels)
        after = unseen.errors(np.concatenate([trial.base, *trial.beta]))
        share = 0.1 * unseen.share * (fit.deviance - trial.deviance)
        if not any(is_backwards(c, b) for c, b in zip(trial.effects, trial.beta, strict=True)) and (
            now[0] - after[0] > max(6.0, share) and after[1] < 0.99 * now[1]
        ):
            fit, now = trial, after
    return list(fit.effects)


def agreements(judge: Search, fit: Fit) -> list[float]:
    """Compare each effect of a fit with what the unseen recordings alone make of it.

    Returns
    -------
    list of float
        Cosine of the two torques along the unseen recordings, times the smaller of their sizes over the larger.
    """
    own = judge.fit(fit.effects, fit.whitener)
    out = []
    for candidate, here, there in zip(fit.effects, fit.beta, own.beta, strict=True):
        W = judge.white(fit.whitener, judge.columns(candidate))
        a, b = here @ W, there @ W
        out.append(float(a @ b / max(a @ a, b @ b, 1e-300)))
    return out


@dataclass(frozen=True)
class _Unseen:
    """Unseen recordings as rows of numbers: columns of the fit, then the data, whitened and in units of a level."""

    white: np.ndarray
    plain: np.ndarray
    share: float

    @classmethod
    def of(cls, judge: Search, fit: Fit, levels: np.ndarray) -> _Unseen:
        """Take the columns of a fit along the unseen recordings."""
        own = [judge.columns(c) for c in fit.effects]
        banks = [
            np.concatenate([judge.rigid[r], *[x[r] for x in own], judge.nominal[r][None]])
            for r in range(len(judge.rigid))
        ]
        white = judge.white(fit.whitener, banks)
        inside = [bank[..., a:b] for bank, run in zip(banks, judge.problem.segments, strict=True) for a, b in run]
        plain = np.concatenate(inside, axis=2) / levels[None, :, None]
        return cls(white, plain.reshape(len(plain), -1), white.shape[1] / max(fit.n_judged, 1))

    def errors(self, values: np.ndarray) -> tuple[float, float]:
        """Sum the squares of what parameters leave over, whitened and plain."""
        first, second = (W[-1] - values @ W[:-1] for W in (self.white, self.plain))
        return float(first @ first), float(second @ second)
