"""Recordings and a model in, a diagnosis out: what physics the model leaves out, where, how large, how sure."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .asked import drowned_pushes
from .bank import all_candidates
from .base import base_parameters, massive_columns
from .candidates import Candidate
from .completing import completed_manipulator, stated_laws
from .content import content_of, experiment_content, insufficient_content, unresolved
from .drifting import drifts_like, is_swamped, shorter_drift, still_errors, with_drift
from .endogenous import without_followers
from .events import ProgressCallback
from .explain import explain, finished
from .explanation import Explanation, Found
from .geometry import Manipulator
from .judging import CLOSE, judge_of, sized, validated
from .leftover import holding_axes, left_over
from .likelihood import likelihood
from .masses import about
from .model import CableModel
from .next_experiment import Experiment, plan_next
from .problem import Problem, make_problem
from .pruning import still_standing
from .recording import Recording
from .replay import Replay, simulated_position
from .replay_runs import replay_runs
from .search import Search, rms
from .settings import Settings
from .significance import is_loud
from .soft import looser, softest
from .unexplained import is_far
from .unseen import deviance_unseen
from .verdict import Verdict, reached

EVIDENT = 50.0
"""Log-likelihood that pushes gain which no drift of a zero is."""
BLURRED = 0.15
"""Share of the torque that steps of encoders may make through accelerations."""
SOFT = ("cable_elasticity", "cable_slack", "pulley_eccentricity", "transmission_ratio_error")
"""Effects for which links that swing on a soft cable may be taken."""
ROUGH = 1.15
"""Error over that beside smooth functions of the state, from which something is still to be explained."""


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
        return Diagnosis(insufficient_content(problem, reason), model, model.manipulator)
    base = base_parameters(model, columns=massive_columns(model))
    search = Search(problem, base, settings)
    holding = holding_axes(search) if problem.partly else problem.resting
    free = problem.resting - holding
    if free:
        problem = problem.judged_without(holding)
        search = Search(problem, base, settings)
    search = about(search, search.fit([]))
    first = _beside_drifts(search, progress)
    seen = make_problem(model, unseen, problem.band, len(recordings), holding) if unseen else None
    if seen is not None and seen.resting & free:
        seen = seen.judged_without(seen.resting - free)
    soft = _swinging(Search(problem, base, settings), seen, first, progress)
    if soft is first:
        first = soft = without_followers(first)
    else:
        first, soft = without_followers(first), without_followers(soft)
    judge, explanation = validated(seen, soft)
    if explanation.search.problem.swings:
        first = soft
    elif soft is not first:  # what else was found was found beside that cable
        judge, explanation = validated(seen, first)
    first, judge, explanation = _lawful(seen, first, judge, explanation)
    judge, explanation = _second_to(seen, first, judge, explanation, progress)
    explanation = sized(explanation if explanation.everywhere else still_standing(explanation), judge)
    say("sensitivities", 0.95)
    return _told(reached(model, judge, explanation, _is_disputed(first, explanation)))


def _lawful(
    seen: Problem | None, first: Explanation, judge: Search | None, explanation: Explanation
) -> tuple[Explanation, Search | None, Explanation]:
    """Let laws stand which a correction without a name outdid, if they explain the unseen recordings, and it less.

    A smooth function of the state takes what is a little wrong in laws, of the training; laws hold elsewhere, too.
    """
    if judge is None or not first.outdid or all(f.candidate.named for f in explanation.found):
        return first, judge, explanation
    laws = finished(first.search, first.bank, list(first.outdid))
    there, again = validated(seen, laws)
    if there is None or not again.found or not all(f.candidate.named for f in again.found):
        return first, judge, explanation
    left, rows = deviance_unseen(there, again.fit), there.body(again.fit.whitener).data.size
    holds = left < CLOSE * rows and left < deviance_unseen(judge, explanation.fit)
    return (laws, there, again) if holds else (first, judge, explanation)


def _second_to(
    seen: Problem | None,
    first: Explanation,
    judge: Search | None,
    explanation: Explanation,
    progress: ProgressCallback | None,
) -> tuple[Search | None, Explanation]:
    """Let another explanation stand that was second to one of which the unseen recordings left nothing."""
    named = [f.candidate.key for f in first.found if f.candidate.named]
    if not named or explanation.found:
        return judge, explanation
    second = explain(first.search.stiff, progress, frozenset(named))
    if second.found and _likely(second) > _likely(first) - first.search.settings.close:
        there, again = validated(seen, second)
        if again.found and not {f.candidate.effect.name for f in again.found} & {name for name, _ in named}:
            return there, again
    return judge, explanation


def _is_disputed(first: Explanation, explanation: Explanation) -> bool:
    """Whether something loud of the first explanation was withdrawn, or far more is left than noise."""
    if first.everywhere:
        return False
    lost = any(f.candidate not in explanation.fit.effects and is_loud(f.score) for f in first.found)
    rough = explanation.fit.deviance > 2.0 * explanation.fit.n_judged  # bursts that no estimate of the noise has in it
    return lost or rough or is_far(explanation.search, explanation.fit)


def _told(verdict: Verdict) -> Diagnosis:
    """Say a verdict as files do: the content of diagnosis.json, the completed model, what to record next."""
    search, fit, explanation, judge = verdict.search, verdict.fit, verdict.explanation, verdict.judge
    rigid = search.stiff.fit([])
    content = content_of(verdict, rigid)
    experiment = plan_next(search, explanation, unresolved(verdict, content["findings"]))
    content["next_experiment"] = experiment_content(experiment)
    completed = completed_manipulator(verdict.model, search, fit, stated_laws(verdict), verdict.covariance)
    replays = replay_runs(search, judge, rigid, fit, completed)
    content["fit"]["simulated_position"] = simulated_position(replays)
    listed = tuple(verdict.stated)
    return Diagnosis(content, search.problem.model, completed, explanation, search, judge, replays, experiment, listed)


def _beside_drifts(search: Search, progress: ProgressCallback | None) -> Explanation:
    """Explain the recordings beside drifting zeros, where these drift; the likeliest explanation stands.

    If pushes were found, it is done anew beside the drift that is left then, as they may have hid or made one, beside
    that which the loudest alone leaves, as the others may be parts of it, and beside none, as a few more pushes may
    still look like one; what finds no push there says nothing of that.
    """
    drifting = _drifting(search)
    first = explain(drifting, progress)
    if is_swamped(first.search, first.fit):  # by a constant, which waves that are slow enough take up
        first = explain(shorter_drift(drifting), progress)
        if is_swamped(first.search, first.fit):
            return explain(search, progress)

    def is_push(found: Found) -> bool:
        return found.candidate.effect.name == "external_torque"

    pushes = [f for f in first.found if is_push(f)]
    if not pushes:
        return first
    loudest, ways = max(pushes, key=lambda f: f.score.statistic), [first]
    others = [search, with_drift(search, [f.candidate for f in first.found])]
    if len(pushes) > 1:
        others.append(with_drift(search, [f.candidate for f in first.found if f is loudest or not is_push(f)]))
    for other in others:
        if not any(drifts_like(other, way.search) for way in ways):
            there = explain(other, progress)
            if any(map(is_push, there.found)) and not is_swamped(there.search, there.fit):
                ways.append(there)
    return max(ways, key=_likely)


def _drifting(search: Search) -> Search:
    """Give the search with drifting zeros beside the rigid body, where no pushes are likelier.

    Those that could be the drift itself, beside none, have to be evident: several seconds of a drift look like one.
    """
    own = with_drift(search)
    if own.drift is None:
        return own
    ways: list[tuple[Search, list[Candidate]]] = [(own, [])]
    for calmer, least in [(search, EVIDENT), *([(with_drift(search, most=0), 0.0)] if own.drift.quicker else [])]:
        pushes = drowned_pushes(calmer, calmer.bank(all_candidates(search.problem, ["external_torque"])), [])
        if pushes and likelihood(calmer, pushes) > likelihood(calmer, []) + least:
            ways += [(calmer, pushes), (with_drift(search, pushes), pushes)]
    return max(ways, key=lambda way: likelihood(*way))[0]


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
        judges = [judge_of(seen, e) for e in (first, again)]
        rests = [rms(judge, still_errors(judge, e.fit)) for judge, e in zip(judges, (first, again), strict=True)]
        if np.mean((rests[1] / np.maximum(rests[0], 1e-12)) ** 2) > 1.0:
            return first
    return again


def _likely(explanation: Explanation) -> float:
    """Give the log-likelihood of an explanation."""
    return likelihood(explanation.search, [f.candidate for f in explanation.found])


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
