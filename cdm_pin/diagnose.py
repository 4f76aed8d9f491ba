"""Recordings and a model in, a diagnosis out: what physics the model leaves out, where, how large, how sure."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from . import findings as fi
from .asked import asked_but_for_laws, drowned, next_law
from .bank import Bank, all_candidates
from .base import base_parameters, massive_columns
from .candidates import Candidate
from .consistency import nearest_standard
from .drifting import drifts_like, is_swamped, shorter_drift, still, still_errors, with_drift
from .events import ProgressCallback
from .everywhere import agreements, confirmed
from .explain import explain
from .explanation import Explanation, Found, explained
from .fit import Fit
from .friction_effects import STOPS
from .geometry import Manipulator, Vector, frozen_array
from .leftover import left_over
from .likelihood import REFINING, evidence, likeliest, likelihood
from .masses import about
from .model import CableModel
from .next_experiment import Experiment, plan_next
from .patching import patch
from .plainness import EVIDENT, PREFERENCE
from .problem import Problem, Run, make_problem
from .pruning import still_standing
from .recording import Recording
from .regions import region
from .replay import Replay, simulated_position
from .replay_runs import replay_runs
from .resolved import differs_by_zeros
from .search import Search, errors, rms
from .settings import Settings
from .settling import settled, tied
from .significance import is_loud
from .soft import looser, softest
from .unexplained import (
    at_corrections,
    beyond_floor,
    beyond_training,
    bursting_torque,
    is_far,
    moving_torque,
    nameless,
    noise_floor,
    of_no_size,
    ringing_torque,
    swinging_torque,
    wandering_travel,
)
from .units import motor_units, unit_at
from .unseen import deviance_unseen, stacked, updated

BLURRED = 0.15
"""Share of the torque that steps of encoders may make through accelerations."""
SOFT = ("cable_elasticity", "cable_slack", "pulley_eccentricity", "transmission_ratio_error")
"""Effects for which links that swing on a soft cable may be taken."""
ROUGH = 1.15
"""Error over that beside smooth functions of the state, from which something is still to be explained."""
DECIDED = 10.0
"""Log-likelihood by which the unseen recordings decide between two laws."""
ONCE = ("external_torque", "unnamed_time", "unnamed_wear", "unnamed_stiffening", "unnamed_gain_drift", "unnamed_tone")
"""What happens at a time of its own: another recording cannot judge it."""
AGREEMENT = 0.3
"""Of many effects, what the unseen recordings make of one alone has to be like it by so much for it to be listed."""
CARRIED = 0.1
"""Share of the squared error on unseen recordings that a finding beyond doubt leaves."""
MOSTLY = 0.4
"""Share that is left on its motors of the squared error by a finding that is louder there than all else."""
LIKE = 0.5
"""How like it the unseen recordings have to make such a finding by themselves."""
ANY, VAGUE = 1.0, 2.0
"""Standard errors, by unseen recordings too, up to which a finding is none, and beside something unexplained."""
CLOSE = 2.0
"""Whitened sum of squares on unseen recordings, per sample, up to which a finer law may be told by them."""
BLIND = 3.0
"""Whitened sum of squares of a finding on unseen recordings that cannot show it."""
SURE = 15.0
"""Penalised log-likelihood of a finding in the training that chance does not give."""
RARE = 4.7
"""By how many times the root of what is due chance takes from it in one of a hundred cases."""
FAR = 25.0
"""Squared error on unseen recordings, in units of the noise, beside which a finding has to carry most of it."""
RISES = ((0.8, 100.0, 1.3), (0.5, 20.0, 1.03))
"""Share of what is due by which the whitened sum falls, least fall, and times that the plain error may rise then."""
SCHEMA = "cdm_pin.diagnosis/1"


@dataclass(frozen=True)
class Diagnosis:
    """What was found.

    Attributes
    ----------
    content : dict
        What diagnosis.json says.
    model : CableModel
        With the re-identified inertial parameters.
    manipulator : Manipulator
        The completed model, as model.yaml says it.
    explanation : Explanation or None
        Fits and scores behind it; None where the data are insufficient.
    search, holdout : Search or None
        The training and the unseen recordings.
    replays : tuple of Replay
        Recorded motion beside that of the rigid and of the completed model.
    experiment : Experiment or None
        What to record next where rivals are left.
    listed : tuple of int
        The findings of the content, by their number in the explanation.
    """

    content: dict[str, Any]
    model: CableModel
    manipulator: Manipulator
    explanation: Explanation | None = None
    search: Search | None = None
    holdout: Search | None = None
    replays: tuple[Replay, ...] = ()
    experiment: Experiment | None = None
    listed: tuple[int, ...] = ()


def diagnose(
    model: CableModel,
    recordings: Sequence[Recording],
    holdout: Sequence[Recording] = (),
    *,
    settings: Settings | None = None,
    progress: ProgressCallback | None = None,
) -> Diagnosis:
    """Find, name and size the physics that a model leaves out.

    Parameters
    ----------
    model : CableModel
        Its inertial parameters are a first guess; they are identified anew.
    recordings : sequence of Recording
        To learn from; copies are counted once and the order does not matter.
    holdout : sequence of Recording
        To judge on.
    settings : Settings, optional
    progress : callable, optional
        Called with the name of the step and the fraction done.

    Returns
    -------
    Diagnosis

    Raises
    ------
    RecordingError
        If a recording contradicts the model.
    """
    settings = settings or Settings()
    say = progress or (lambda step, fraction: None)
    recordings = distinct(recordings)
    unseen = [r for r in distinct(holdout) if _digest(r) not in {_digest(x) for x in recordings}]
    say("preparing", 0.0)
    problem = make_problem(model, recordings)
    reason = insufficient(problem)
    if reason:
        return Diagnosis(_insufficient(problem, reason), model, model.manipulator)
    base = base_parameters(model, columns=massive_columns(model))
    search = Search(problem, base, settings)
    search = about(search, search.fit([]))
    first = _beside_drifts(search, progress)
    seen = make_problem(model, unseen, problem.band, len(recordings)) if unseen else None
    soft = _swinging(Search(problem, base, settings), seen, first, progress)
    judge, explanation = _validated(seen, soft)
    if explanation.search.problem.swings:
        first = soft
    elif soft is not first:  # what else was found was found beside that cable
        judge, explanation = _validated(seen, first)
    named = [f.candidate.key for f in first.found if f.candidate.named]
    if named and not explanation.found:  # another explanation may have been second to those that were withdrawn
        second = explain(first.search.stiff, progress, frozenset(named))
        if second.found and _likely(second) > _likely(first) - settings.close:
            there, again = _validated(seen, second)
            if again.found and not {f.candidate.effect.name for f in again.found} & {name for name, _ in named}:
                judge, explanation = there, again
    explanation = _sized(explanation if explanation.everywhere else still_standing(explanation), judge)
    lost = [f for f in first.found if f.candidate not in explanation.fit.effects and is_loud(f.score)]
    rough = explanation.fit.deviance > 2.0 * explanation.fit.n_rows  # bursts that no estimate of the noise has in it
    say("sensitivities", 0.95)
    disputed = bool(lost) or rough or is_far(explanation.search, explanation.fit)
    return _report(model, judge, explanation, disputed and not first.everywhere)


def _beside_drifts(search: Search, progress: ProgressCallback | None) -> Explanation:
    """Explain the recordings beside drifting zeros, where these drift; the likeliest explanation stands.

    If pushes were found, it is done anew beside the drift that is left then, as they may have hid or made one, and
    beside none, as a few more pushes may still look like one; what finds no push there says nothing of that.
    """
    drifting = _drifting(search)
    first = explain(drifting, progress)
    if is_swamped(first.search, first.fit):  # by a constant, which waves that are slow enough take up
        first = explain(shorter_drift(drifting), progress)
        if is_swamped(first.search, first.fit):
            return explain(search, progress)

    def pushed(explanation: Explanation) -> bool:
        return any(f.candidate.effect.name == "external_torque" for f in explanation.found)

    if not pushed(first):
        return first
    found, ways = [f.candidate for f in first.found], [first]
    for other in (search, with_drift(search, found)):
        if not any(drifts_like(other, way.search) for way in ways):
            there = explain(other, progress)
            if pushed(there) and not is_swamped(there.search, there.fit):
                ways.append(there)
    return max(ways, key=_likely)


def _drifting(search: Search) -> Search:
    """Give the search with drifting zeros beside the rigid body; quick ones only where no pushes are likelier."""
    own = with_drift(search)
    if own.drift is None or not own.drift.quicker:
        return own
    slow = with_drift(search, most=0)
    pushes = _pushes(slow, slow.bank(all_candidates(search.problem, ["external_torque"])), [])
    if not pushes:
        return own
    ways = [(own, []), (slow, pushes), (with_drift(search, pushes), pushes)]
    return max(ways, key=lambda way: likelihood(*way))[0]


def _pushes(search: Search, bank: Bank, effects: Sequence[Candidate], most: int = 3) -> list[Candidate]:
    """Find pushes of a bank beside some effects, one after another, also where they pass for slow noise."""
    pushes: list[Candidate] = []
    while len(pushes) < most and (push := drowned(search, bank, [*effects, *pushes])) is not None:
        pushes.append(push[1])
    return pushes


def _swinging(
    search: Search, seen: Problem | None, first: Explanation, progress: ProgressCallback | None
) -> Explanation:
    """Explain the recordings by links that swing on a soft cable or within a cable's play, where that is likelier.

    It is looked at only where motors alone are measured and something of that kind was found, or no law explains what
    is left; and it has to predict unseen recordings as well.
    """
    if any(motion.felt is None for motion in search.problem.motions) or first.everywhere:
        return first
    found = [f.candidate for f in first.found]
    plays = [(c, beta) for c, beta in zip(found, first.fit.beta, strict=True) if c.effect.name == "backlash"]
    rough = any(c.effect.name in SOFT or not c.named for c in found)
    if not rough:
        left, noise = (left_over(first.search, found, smooth=smooth)[1].rms for smooth in (False, True))
        rough = bool(np.any(left > ROUGH * noise))
    if not (plays or rough):
        return first
    if progress is not None:
        progress("soft cables", 0.9)
    laws = [c for c in found if c.named and c.effect.name not in SOFT and c.effect.name != "backlash"]
    own = _likely(first)
    best: tuple[float, Search, list[Candidate]] = (own, search, [])
    for beside in ([], laws)[: 1 + bool(laws)]:  # what was found may only stand for the soft cable
        ways = [looser(search, plays, beside)]
        if rough:
            ways.append(softest(search, beside))
        best = max([best, *((likelihood(*way), *way) for way in ways if way is not None)], key=lambda way: way[0])
        if best[0] > own:
            break
    _, there, effects = best
    if not effects:
        return first
    instead = frozenset({("cable_slack", effects[0].key[1])})  # of first order, where this one is integrated
    again = explain(with_drift(there, effects), progress, instead, start=effects)
    if not any(f.candidate.is_swinging(again.search.problem.motions[0]) for f in again.found):
        return first
    if _likely(again) < own:
        return first
    if seen is not None:
        judges = [_judge(seen, e) for e in (first, again)]
        rests = [rms(judge, still_errors(judge, e.fit)) for judge, e in zip(judges, (first, again), strict=True)]
        if np.mean((rests[1] / np.maximum(rests[0], 1e-12)) ** 2) > 1.0:
            return first
    return again


def _likely(explanation: Explanation) -> float:
    """Give the log-likelihood of an explanation."""
    return likelihood(explanation.search, [f.candidate for f in explanation.found])


def _swing_gain(search: Search, fit: Fit, without: Fit) -> float:
    """Give the penalised log-likelihood that links which swing on a soft cable gain over those on a rigid one."""
    return likelihood(search, fit.effects) - likelihood(search.stiff, without.effects)


def _validated(seen: Problem | None, explanation: Explanation) -> tuple[Search | None, Explanation]:
    """Keep of an explanation what the unseen recordings confirm; give the search on them, about the same model, too."""
    if seen is None:
        return None, _weighed(None, explanation) if explanation.everywhere else explanation
    seen = _undisturbed(seen, explanation)
    judge = _judge(seen, explanation)
    if explanation.everywhere:
        return judge, _weighed(judge, explanation)
    more = _seconded(judge, explanation)
    if more is not explanation:
        judge = _judge(seen, more)
    left = _judged(judge, more)
    if left.search is not more.search:
        judge = _judge(seen, left)
    return _tied(judge, left), left


def _undisturbed(seen: Problem, explanation: Explanation) -> Problem:
    """Leave out where something pushes in unseen recordings, on a joint on which it pushes in the others.

    They judge laws, which hold at all times; when a push comes again is no part of any.
    """
    keys = {f.candidate.key for f in explanation.found if f.candidate.effect.name == "external_torque"}
    if not keys:
        return seen
    judge = _judge(seen, explanation)
    bank = judge.bank([c for c in all_candidates(judge.problem, ["external_torque"]) if c.key in keys])
    pushes = _pushes(judge, bank, [f.candidate for f in explanation.found if f.candidate.key not in keys])
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
            words = f"{max(start, 0.0):.1f} to {end:.1f} s left out: something pushes on joint {push.location['index']}"
            notices = (*notices, words)
    return replace(run, signals=replace(run.signals, valid=valid, notices=notices))


def _judge(seen: Problem, explanation: Explanation) -> Search:
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
    return explained(search, search.renewed(explanation.bank), accepted)


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
        failing = [j for j in range(len(explanation.found)) if not _helps(judge, explanation, j)]
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
        judge = judge if law is None else _judge(judge.problem, explanation)
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


def _sized(explanation: Explanation, judge: Search | None, near: float = 15.0) -> Explanation:
    """Let a simpler law stand, if one is near and as likely, for a law of which no parameter is known.

    Dry friction stands for what refines it unless that is evident, and for one that differs in its two directions by no
    more than zeros that move may be off, unless the unseen recordings are for it or no law explains all: what is left
    then looks like zeros that move.
    """
    search = explanation.search
    if explanation.everywhere or not explanation.found:
        return explanation
    lawful = all(found.candidate.named for found in explanation.found)
    for j, found in enumerate(explanation.found if lawful else ()):
        if differs_by_zeros(search, search.without(explanation.fit, j), found.candidate):
            simpler = _instead(explanation, j, found.candidate.dry)
            if judge is None or not _is_for(judge, explanation.fit, simpler.fit):
                return _sized(simpler, judge)
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
                return _sized(simpler, judge)
    return explanation


def _instead(explanation: Explanation, j: int, law: Candidate) -> Explanation:
    """Give the explanation with a law in the place of finding `j`."""
    effects = [f.candidate for f in explanation.found]
    return explained(explanation.search, explanation.bank, [*effects[:j], law, *effects[j + 1 :]])


def _is_for(judge: Search, fit: Fit, other: Fit) -> bool:
    """Whether the unseen recordings are clearly for one fit, and not for another."""
    own, its = (deviance_unseen(judge, f) for f in (fit, other))
    return _unseen_gain(its, own, judge.body(fit.whitener).data.size) > DECIDED


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


def distinct(recordings: Sequence[Recording]) -> list[Recording]:
    """Give each recording once, in an order that depends on its content alone."""
    return list({_digest(r): r for r in sorted(recordings, key=_digest)}.values())


def _digest(recording: Recording) -> str:
    digest = hashlib.sha256(np.ascontiguousarray(recording.time - recording.time[0]).tobytes())
    for name in sorted(recording.channels):
        digest.update(name.encode() + np.ascontiguousarray(recording.channels[name]).tobytes())
    return digest.hexdigest()


def insufficient(problem: Problem) -> str:
    """Say why the recordings cannot support a diagnosis; empty if they can."""
    samples = sum(stop - start for run in problem.segments for start, stop in run)
    duration = samples * problem.band.step / problem.band.rate
    if samples < 100:
        return f"only {duration:.3g} s of usable motion in the band up to {problem.band.cutoff:.3g} Hz"
    moving = max(float(np.ptp(m.q, axis=0).max()) for m in problem.motions)
    if moving < 1e-3:
        return f"nothing moves (largest range of a joint {moving:.2g})"
    if problem.torque and np.median(problem.rounded) > BLURRED:
        share = 100 * np.median(problem.rounded)
        return f"too slow a motion for the encoders: by inertia their steps alone make {share:.0f} % of the torque"
    return ""


def _insufficient(problem: Problem, reason: str) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "verdict": "insufficient_data",
        "reason": reason,
        "rigid_body": {"changed": []},
        "findings": [],
        "fit": {"train": None, "holdout": None, "simulated_position": None},
        "sensitivity": [],
        "unexplained": None,
        "next_experiment": None,
        "data": _data(problem),
    }


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


def _weighted(search: Search, errors: Sequence[Vector], level: Vector) -> float:
    return float(np.sum((rms(search, errors) / level) ** 2))


def _helps(judge: Search, explanation: Explanation, j: int) -> bool:
    """Whether the unseen recordings are likelier with finding `j` than without it, by as much as they should be.

    Where it is right, the whitened sum of squares falls by that of what it changes there, give or take twice the root
    (`asked_of`). The plain error, drifts aside, must not rise either, or hardly where nearly all is there that was due,
    unless masses that the training could not tell make most of it.
    Where nearly all of the plain error goes, no more is asked: slow noise could hide a constant from the likelihood.
    What is loud in the training, and would not show on the unseen recordings, they cannot speak against. What is little
    more than other laws may be wrong by is none of that only if it leaves nothing but noise.
    """
    found, fit = explanation.found[j], explanation.fit
    if fit.effects[j].effect.name in ONCE:
        return True
    without = explanation.search.without(fit, j)
    if fit.effects[j].is_swinging(explanation.search.problem.motions[0]):  # its columns say nothing of a rigid cable
        if _swing_gain(explanation.search, fit, without) <= 0.0:
            return False
        rigid = explanation.search.stiff.fit(list(without.effects))
        level = np.maximum(noise_floor(judge, fit.effects), 1e-12)
        rest = still(judge, errors(judge.stiff, rigid.base, rigid.effects, rigid.beta))
        return _plain(judge, fit)[0] < _weighted(judge, rest, level)
    with_it, without_it = _plain(judge, fit, without)
    if with_it < CARRIED * without_it:
        return True
    due = _due(judge, explanation, j)
    if due < BLIND and is_loud(found.score):
        return True
    fall = deviance_unseen(judge, without) - deviance_unseen(judge, fit)
    if fall < asked_of(due, found.gain, found.candidate.named):
        return False
    rise = next((rise for share, least, rise in RISES if fall > max(share * due, least)), 1.01)
    others = sum(f.score.statistic for f in explanation.found) - found.score.statistic
    if found.score.statistic < (2.0 * explanation.search.settings.law_error) ** 2 * others:
        return with_it < min(without_it, 1.5 * judge.problem.n_channels)
    return with_it < rise * without_it or with_it > 9.0 * judge.problem.n_channels


def asked_of(due: float, gain: float, named: bool = True) -> float:
    """Say by how much the sum of squares on unseen recordings has to fall, of which `due` is what is to be expected.

    A tenth, and 3 for what has a name; of what the training is sure of no more than what chance leaves of what is due.
    """
    least = max(3.0 * named, 0.1 * due)
    return min(least, max(due - RARE * float(np.sqrt(due)), 0.0)) if gain > SURE else least


def _due(judge: Search, explanation: Explanation, j: int) -> float:
    """Give the whitened sum of squares of what finding `j` changes on the unseen recordings."""
    fit, without = explanation.fit, explanation.search.without(explanation.fit, j)
    change = [a - b for a, b in zip(stacked(judge, fit), stacked(judge, without), strict=True)]
    return updated(judge, without, change)[0]


def _plain(judge: Search, fit: Fit, *others: Fit) -> list[float]:
    """Give the squared errors of fits on the unseen recordings, drifts aside, in units of the first one's noise."""
    level = np.maximum(noise_floor(judge, fit.effects), 1e-12)
    return [_weighted(judge, still_errors(judge, f), level) for f in (fit, *others)]


def _carries(judge: Search, explanation: Explanation, j: int) -> bool:
    """Whether finding `j` takes nearly all of the plain error of recordings away, whatever is left."""
    with_it, without_it = _plain(judge, explanation.fit, explanation.search.without(explanation.fit, j))
    return with_it < CARRIED * without_it


def _is_loud_there(judge: Search, explanation: Explanation, j: int) -> bool:
    """Whether finding `j` takes most of the plain error of recordings away on a motor on which it acts."""
    place, model = explanation.found[j].candidate.place, judge.problem.model
    if not place.A + place.B:
        return False
    fits = explanation.fit, explanation.search.without(explanation.fit, j)
    own = np.abs(place.weights(model)) > 0.0
    with_it, without_it = (rms(judge, still_errors(judge, f))[: model.n_motors][own] ** 2 for f in fits)
    return bool(np.any(with_it < MOSTLY * without_it))


def _fit_content(search: Search, rigid: Fit, fit: Fit, judged: Search) -> dict[str, Any]:
    m = search.problem.model.n_motors
    rest = errors(judged, fit.base, fit.effects, fit.beta)
    left = still(judged, rest)
    drift = [a - b for a, b in zip(rest, left, strict=True)]  # noise, too, where zeros were seen to drift
    sizes = {
        "rmse_rigid": rms(judged, errors(judged.stiff, rigid.base, (), ())),
        "rmse_augmented": rms(judged, rest),
        "noise_floor": np.hypot(noise_floor(judged, fit.effects), rms(judged, drift)),
    }
    content: dict[str, Any] = {name: values[:m].tolist() for name, values in sizes.items()}
    if search.problem.torque and search.problem.kinematic:
        units = _together(motor_units(search.problem.model, False))
        content["travel"] = {name: values[m:].tolist() for name, values in sizes.items()} | {"unit": units}
    return content


def _together(units: Sequence[str]) -> str | list[str]:
    return units[0] if len(set(units)) == 1 else list(units)


def _report(model: CableModel, judge: Search | None, explanation: Explanation, disputed: bool) -> Diagnosis:
    search, fit = explanation.search, explanation.fit
    patches = [f for f in explanation.found if not f.candidate.named]
    named = [j for j, f in enumerate(explanation.found) if f.candidate.named]
    if patches:
        named = [j for j in named if fi.is_sure(model, explanation.found[j], patches)]
    named.sort(key=lambda j: -explanation.found[j].score.statistic)
    covariance, betas, shapes = fi.joint_covariance(search, fit)
    where = [np.r_[beta, shape] for beta, shape in zip(betas, shapes, strict=True)]
    own_rigid = search.stiff.fit([])
    stated = {}
    fitted: dict[int, dict[str, Any]] = {}
    for j in named:
        found = explanation.found[j]
        spread = covariance[np.ix_(where[j], where[j])]
        values = fi.parameters(found.candidate, fit.beta[j], spread)
        known = fi.is_known(values, found.candidate, fit.beta[j], spread)
        lawful = explanation.everywhere or fi.is_lawful(fit, j)
        sure = known and lawful and fi.is_admissible(found.candidate.effect, values) and found.gain >= 5.0
        if sure and fi.is_above_steps(search, found.candidate, values):
            stated[j] = values
        fitted[j] = values
    if explanation.everywhere:
        found = explanation.found
        stated = {j: v for j, v in stated.items() if not fi.is_outdone(found[j]) and found[j].agreement >= AGREEMENT}
    if patches:
        unexplained = at_corrections(explanation, patches)
        if judge is not None and not explanation.everywhere and _plain(judge, fit)[0] > FAR * judge.problem.n_channels:
            repeated = [agreement >= LIKE for agreement in agreements(judge, fit)]
            stated = {
                j: v
                for j, v in stated.items()
                if _carries(judge, explanation, j) or (repeated[j] and _is_loud_there(judge, explanation, j))
            }
    else:
        unexplained, excess = beyond_floor(search, judge, explanation)
        if unexplained is not None and not explanation.everywhere:
            stated = _outweighing(model, explanation, stated, unexplained, excess)
        if explanation.everywhere:
            unexplained = nameless(explanation) or unexplained
        unexplained = unexplained or moving_torque(search, fit) or wandering_travel(search, fit)
        if unexplained is None:
            unexplained = ringing_torque(search, fit) or (judge and beyond_training(search, judge, fit))
            if unexplained is not None:
                stated = {j: v for j, v in stated.items() if _carries(judge or search, explanation, j)}
        if unexplained is None and named and not stated:
            unsure = [j for j in fi.unsized(explanation) if fi.is_above_steps(search, fit.effects[j], fitted[j])]
            unexplained = of_no_size(explanation, unsure)
        if disputed and unexplained is None:
            unexplained = nameless(explanation, only_loud=True)
            if unexplained is not None:  # nor can what happens once be confirmed then
                stated = {j: v for j, v in stated.items() if explanation.found[j].candidate.effect.name not in ONCE}
            if unexplained is not None and is_far(search, fit):  # nor what sits where something else is
                place = unexplained["location"]
                stated = {j: v for j, v in stated.items() if explanation.found[j].candidate.location != place}
    if unexplained is None and not stated:
        unexplained = swinging_torque(search, fit) or bursting_torque(search, judge, fit)
    if unexplained is None and not explanation.everywhere:
        unexplained, excess = beyond_floor(search, judge, explanation, shared=True)
        if unexplained is not None:
            stated = _outweighing(model, explanation, stated, unexplained, excess)
    for j, values in stated.items():
        stated[j] = fi.with_law_errors(search, fit, j, covariance, where[j], values)
    lasting = [j for j in stated if fit.effects[j].effect.name not in ONCE]
    if lasting and judge is not None and any(judge.problem.segments):
        step, chance = fi.unseen_shift(judge, fit, covariance)
        told = {j: fitted[j] for j in stated}  # by the recordings, whatever else its law may be wrong by
        for j in lasting:
            own = step[where[j]], chance[np.ix_(where[j], where[j])]
            told[j] = fi.with_scatter(fit.effects[j], fit.beta[j], *own, told[j])
            stated[j] = fi.with_scatter(fit.effects[j], fit.beta[j], *own, stated[j])
        least = ANY if unexplained is None else VAGUE  # what the recordings disagree about may be part of that
        vague = [j for j, v in told.items() if max(fi.sizes_in_errors(v).values(), default=np.inf) <= least]
        vague = [j for j in vague if not (_carries(judge, explanation, j) or _is_loud_there(judge, explanation, j))]
        stated = {j: v for j, v in stated.items() if j not in vague}
        if vague and not stated:
            unexplained = unexplained or of_no_size(explanation, vague)
    items = [_finding(search, judge, explanation, j, values) for j, values in stated.items()]
    written = fitted if explanation.everywhere else stated  # also those whose names are not sure
    records = [
        r for j, values in written.items() for r in _records(model, explanation.found[j].candidate, values, fit.beta[j])
    ]
    verdict = "unexplained" if unexplained else ("missing_physics" if items else "consistent")
    if unexplained and not (search.problem.torque and search.problem.kinematic):  # of torques and travel at once: none
        own = "N m" if search.problem.torque else "rad"
        unexplained = unexplained | {"unit": unit_at(model, unexplained["location"], own)}
    content = {
        "schema": SCHEMA,
        "verdict": verdict,
        "rigid_body": {"changed": changed_parameters(model, search, explanation)},
        "findings": items,
        "fit": {
            "train": _fit_content(search, own_rigid, fit, search),
            "holdout": _fit_content(search, own_rigid, fit, judge) if judge is not None else None,
            "simulated_position": None,
            "unit": _together(motor_units(model, search.problem.torque)),
        },
        "sensitivity": fi.sensitivities(search, explanation),
        "unexplained": unexplained,
        "next_experiment": None,
        "data": _data(search.problem, judge.problem if judge is not None else None),
        "names": {"joint": list(model.joints), "motor": list(model.motors)},
    }
    experiment = plan_next(search, explanation, _unresolved(explanation, dict(zip(stated, items, strict=True))))
    if experiment is not None:
        content["next_experiment"] = {
            "file": "next.csv",
            "change": experiment.change,
            "power": experiment.power,
            "separates": [{"effect": c.name, "location": c.location} for c in experiment.rivals],
        }
    completed = completed_manipulator(model, search, fit, tuple(records), covariance)
    replays = replay_runs(search, judge, own_rigid, fit, completed)
    content["fit"]["simulated_position"] = simulated_position(replays)
    return Diagnosis(
        content, search.problem.model, completed, explanation, search, judge, replays, experiment, tuple(stated)
    )


def _outweighing(
    model: CableModel, explanation: Explanation, stated: dict[int, Any], unexplained: dict[str, Any], excess: float
) -> dict[int, Any]:
    """Keep of findings, by their number, those that are sure beside what is left at a motor without a name."""
    motor = unexplained["location"]["index"]
    return {j: v for j, v in stated.items() if fi.outweighs(model, explanation.found[j], motor, excess)}


def _unresolved(explanation: Explanation, items: Mapping[int, dict[str, Any]]) -> list[tuple[int, Candidate]]:
    """List findings, by their number, with the rivals that were listed beside them and are other effects."""
    out = []
    for j, item in items.items():
        listed = [(e["effect"], e["location"]) for e in item["indistinguishable_from"]]
        out += [(j, c) for c, _ in explanation.found[j].rivals if (c.name, c.location) in listed]
    return out[:2]


def _data(problem: Problem, seen: Problem | None = None) -> dict[str, Any]:
    return {
        "band": [0.0, problem.band.cutoff],
        "rate": problem.band.reduced_rate,
        "torque": problem.torque,
        "kinematic": problem.kinematic,
        "recordings": _recordings(problem),
        "unseen": _recordings(seen) if seen is not None else [],
    }


def _recordings(problem: Problem) -> list[dict[str, Any]]:
    return [
        {"name": run.name, "duration": float(run.motion.time[-1]), "notices": list(run.signals.notices)}
        for run in problem.runs
    ]


def _finding(
    search: Search, judge: Search | None, explanation: Explanation, j: int, values: dict[str, Any]
) -> dict[str, Any]:
    found, fit = explanation.found[j], explanation.fit
    candidate, reduction, delta_bic = found.candidate, None, fi.refit_gain(found)
    without, there = search.without(fit, j), judge
    if candidate.is_swinging(search.problem.motions[0]):  # its columns say nothing of a cable that is rigid
        without, there = search.stiff.fit(list(without.effects)), judge.stiff if judge is not None else None
        delta_bic = 2 * _swing_gain(search, fit, without)
    if judge is not None and there is not None:
        rests = [errors(s, f.base, f.effects, f.beta) for s, f in ((judge, fit), (there, without))]
        level = np.maximum(rms(judge, rests[0]), 1e-12)
        after, before = (_weighted(judge, rest, level) for rest in rests)
        reduction = 1 - float(np.sqrt(after / before))
    time = [candidate.shape[0], candidate.shape[1]] if candidate.effect.name == "external_torque" else None
    item = {
        "effect": candidate.name,
        "location": candidate.location,
        "parameters": {
            name: v | {"unit": unit_at(search.problem.model, candidate.location, v["unit"], name)}
            for name, v in candidate.parameters_said(search.problem.model, values).items()
            if name not in ("start", "end", "recording")
        },
        "evidence": {
            "delta_bic": delta_bic,
            "log10_p": found.log_p / np.log(10),
            "holdout_rmse_reduction": reduction,
        },
        "indistinguishable_from": fi.indistinguishable(search, explanation, j),
        "time": time,
        "region": None if candidate.effect.name in ONCE else region(search, fit, j),
    }
    if time is not None and len(search.problem.runs) > 1:
        item["recording"] = search.problem.runs[int(candidate.shape[2])].name
    if candidate.effect.name == "hysteresis":
        item["memory"] = "cable tension" if candidate.remembers_tension else "angle"
    if judge is None or (candidate.effect.name not in ONCE and _due(judge, explanation, j) < BLIND):
        item["unconfirmed"] = True
    return item


def _records(
    model: CableModel, candidate: Candidate, values: dict[str, dict[str, Any]], beta: Vector
) -> list[dict[str, Any]]:
    """Say an effect as model files do; a hysteresis of several elements is one entry for each.

    A stiffening spring was fitted as a polynomial: the constant that its law does not have is one of the motors.
    """
    if candidate.effect.name == "hysteresis" and candidate.detail:
        out = []
        for limit, share, form in zip(beta, (1.0, *STOPS), (candidate.shape[1], *[0.5] * len(STOPS)), strict=False):
            distance = share * candidate.shape[0]
            own = {"stiffness": limit / distance, "limit": limit, "form": form}
            if limit > 0:
                own = {name: round(float(x), 10) for name, x in own.items()}
                out.append({"effect": "hysteresis", "location": candidate.location, "parameters": own})
        return out
    parameters = {name: round(float(v["value"]), 10) for name, v in values.items()}
    if candidate.effect.nuisance_shape:
        parameters["width"] = round(float(candidate.shape[0]), 10)
    own = {"effect": candidate.effect.name, "location": candidate.location, "parameters": parameters}
    if "cubic" not in parameters:
        return [own]
    constant = beta[1] - candidate.effect.coefficients(parameters)[0][1]
    offsets = [
        {
            "effect": "torque_offset",
            "location": {"kind": "motor", "index": i + 1},
            "parameters": {"offset": round(float(-w * constant), 10)},
        }
        for i, w in enumerate(candidate.place.weights(model))
        if w
    ]
    return [own, *offsets]


def changed_parameters(model: CableModel, search: Search, explanation: Explanation) -> list[dict[str, Any]]:
    """List the base parameters that differ from the file: by more than 4 standard errors and 1 % of themselves."""
    base, fit = search.base, explanation.fit
    p = len(base.columns)
    nominal = base.values(model.standard_parameters)
    value = base.values(search.problem.model.standard_parameters) + fit.base[:p]
    std = np.sqrt(np.diag(fit.covariance)[:p])
    alternatives = fi.absorbed(search, explanation) + _payloads(search)
    out = []
    for k in np.argsort(-np.abs(value - nominal) / np.maximum(std, 1e-12)):
        change = abs(value[k] - nominal[k])
        if change < 4 * std[k] or change < 0.01 * abs(nominal[k]):
            continue
        same = [
            {"effect": e["effect"], "location": e["location"]}
            for e in sorted(alternatives, key=partial(_likeness, links=base.links[k], last=model.n_joints))
            if base.names[k] in e["parameters"]
        ]
        out.append(
            {
                "base_parameter": base.names[k],
                "links": list(base.links[k]),
                "nominal": float(nominal[k]),
                "value": float(value[k]),
                "std": float(std[k]),
                "indistinguishable_from": same[:4],
            }
        )
    return out


def _likeness(effect: dict[str, Any], links: Sequence[int], last: int) -> int:
    """Rank what a base parameter of some links may as well be: what is nothing but inertia first, at its own link."""
    if effect["effect"] == "payload":
        return {links[0]: 0, last: 1}.get(effect["location"]["index"], 2)
    return 0 if effect["effect"] == "rotor_inertia" else 3


def _payloads(search: Search) -> list[dict[str, Any]]:
    """List a payload on each link with the base parameters that it would change."""
    base, out = search.base, []
    for link in range(search.problem.model.n_joints):
        moved = np.abs(base.matrix[:, 10 * link : 10 * link + 10]).sum(axis=1) > 1e-9
        names = [name for name, yes in zip(base.names, moved, strict=True) if yes]
        out.append({"effect": "payload", "location": {"kind": "link", "index": link + 1}, "parameters": names})
    return out[::-1]


def completed_manipulator(
    model: CableModel, search: Search, fit: Fit, effects: tuple[dict[str, Any], ...], covariance: Vector
) -> Manipulator:
    """Give the manipulator with physically valid links that reproduce the base parameters, and with effects."""
    base = search.base
    values = base.values(search.problem.model.standard_parameters) + fit.base[: len(base.columns)]
    std = np.sqrt(np.diag(covariance)[: len(values)])
    records = tuple(
        {"name": name, "value": float(value), "std": float(s)}
        for name, value, s in zip(base.names, values, std, strict=True)
    )
    manipulator = replace(model.manipulator, effects=model.manipulator.effects + effects, base_parameters=records)
    standard = nearest_standard(base.matrix, values, model.standard_parameters)
    if standard is None or not manipulator.links:
        return manipulator
    return replace(manipulator, links=links_from_parameters(manipulator, standard.parameters))


def links_from_parameters(manipulator: Manipulator, pi_std: Vector):
    """Give the links with these standard parameters."""
    links = []
    for link, (m, hx, hy, hz, xx, xy, yy, xz, yz, zz) in zip(
        manipulator.links, np.reshape(pi_std, (-1, 10)), strict=True
    ):
        c = np.array([hx, hy, hz]) / m
        about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        inertia = about_origin - m * (c @ c * np.eye(3) - np.outer(c, c))
        links.append(replace(link, mass=float(m), center_of_mass=frozen_array(c), inertia=frozen_array(inertia)))
    return tuple(links)
