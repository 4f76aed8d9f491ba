"""What has no name: where it is, in which region of the state, how large; in the words of the diagnosis format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .asked import unnamed
from .candidates import Candidate
from .drifting import all_drifting, is_swamped, most_drift, still_errors
from .effect import Place
from .explanation import Explanation, Found
from .fit import Fit
from .geometry import Vector
from .leftover import clear_noise, follows_state, left_over, loosely_left_over, tones_at
from .measured import both_positions
from .model import CableModel
from .motion import Motion
from .places import axis_places
from .problem import Problem, Run
from .regions import change_time
from .resonance import resonance
from .search import Search, brought, rms
from .signals_filters import differentiate, lowpass
from .significance import is_loud
from .spectra import rises, steepness, tone_peaks, wandering
from .units import unit_at
from .unseen import deviance_unseen
from .walking import walking_noise
from .whitening import Segments, rms_judged

WANDERING = 300.0
"""Slow power over quick power that no noise of a torque's measurement has; a drift that is no fault stays below 30."""
STEEP = 25.0
"""The same over the power at some six times the frequency; noise that forgets within a second stays below 15."""
LINE = 300.0
"""Power of a line in a torque's spectrum over the median around it that no noise has; noise alone reaches some 15."""
ROUGH = 1.5
"""What is left over that beside smooth functions of the state, from which something is still to be explained."""
FAR = 5.0
"""What is left over the noise of the sensors that no noise of theirs is."""
HALF = 0.5
"""Share of how far zeros may walk that a residual is nothing below."""
ALIKE, TOGETHER = 1.2, 1.5
"""How many times the noise a residual has to be in training and in unseen recordings, and in the (geometric) mean."""
LEAVES = 0.05
"""Share (of squares) of what a law explains that its errors may leave."""
EVIDENTLY = 2.0
"""How many times the least residual that is too large one is that need not follow the state."""
PEAK, ROUNDER = 30.0, 10.0
"""Power of a residual at some frequency over that at a lower one, alone and beside smooth functions of the state, that
noise has of no sensor, unless what encoders make of accelerations is most of it."""
SHRILL, RISING, RISES = 10.0, 12.0, 4.0
"""The same of a residual that is so many times the noise of the sensors and the errors of laws."""
UNTOLD = 4.0
"""How many times what the noise of positions makes of accelerations a swinging torque has to be."""
LOUDER = 1.5
"""How many times the noise of the training that of unseen recordings may be."""
ADRIFT = 3.0
"""What a travel between encoders leaves over, in steps of these, that no rounding does."""
STEADY = 30.0
"""Slow power over quick power that no travel between two encoders has; these do not drift."""
LEAP = 0.4
"""Time on either side of a leap in which a travel is averaged [s]."""
COLOUR, OTHERS = 3.0, 5.0
"""How many times the noise of single samples a residual is, and how many times what that is of the other motors."""
BURSTS = 3.0
"""How many times what it mostly is a residual is on the whole (rms) that is no noise of sensors."""
MOVING = 0.1
"""Share of a joint's speed (rms) from which on it moves."""
AS_ONE, ERRING = 0.99, 10.0
"""Share of a residual along one direction, and how many times the noise, that no two sensors have alike."""
ONE, TOGETHER = 0.9, 0.9
"""Shares of what swings, in units of its noise, that one place makes up, or that is in phase, where it is no hum."""
HIGHEST = 20.0
"""Frequency up to which a line is taken for a disturbance of the arm [Hz]; above it mains and amplifiers hum."""


def noise_floor(search: Search, effects: Sequence[Candidate] = ()) -> Vector:
    """Estimate each channel's noise in the band without a law, shape (n_channels,).

    It is what smooth functions of position, speed, direction and time leave over beside the rigid body and what was
    found, less what these functions take of the noise.
    """
    return left_over(search, effects)[1].rms


def at_corrections(explanation: Explanation, corrections: Sequence[Found]) -> dict[str, Any]:
    """Describe the largest of those corrections without a name that are in the model."""
    search = explanation.search
    main = max(corrections, key=lambda f: f.score.statistic)
    j = explanation.found.index(main)
    size = _size(explanation, j)
    law, place = main.candidate, main.candidate.location
    nearest = [{"effect": r.effect.name, "location": r.location} for r, _ in main.rivals if r.named][:3]
    time = change_time(law, explanation.fit.beta[j], search.problem.motions[0])
    return something(place["kind"], place["index"], _region(law), size, time, nearest)


def _region(law: Candidate) -> str:
    """Say where and in which state a correction without a name is."""
    place = law.location
    return law.effect.revealed_by.format(place=f"{place['kind']} {place['index']}", shape=law.shape)


def of_no_size(
    explanation: Explanation, which: Sequence[int], words: str = "by a law of which these data tell no parameter"
) -> dict[str, Any] | None:
    """Describe the largest of some findings of whose laws no parameter is known; None where there is none.

    What several motors share is on that which has most of it; what has no place in the arm is none of these.
    """
    places = {j: place for j in which if (place := _indexed(explanation.found[j].candidate)) is not None}
    if not places:
        return None
    j = max(places, key=lambda j: explanation.found[j].score.statistic)
    main, place, size = explanation.found[j], places[j], _size(explanation, j)
    laws = [main.candidate, *(rival for rival, _ in main.rivals if rival.named)][:3]
    nearest = [{"effect": c.effect.name, "location": c.location} for c in laws]
    return something(place["kind"], place["index"], words, size, nearest=nearest)


def _indexed(candidate: Candidate) -> dict[str, Any] | None:
    """Give the place of a candidate as one joint, motor, cable or link."""
    if "weights" in candidate.location:
        return {"kind": "motor", "index": int(np.argmax(np.abs(candidate.location["weights"]))) + 1}
    return candidate.location if "index" in candidate.location else None


def _size(explanation: Explanation, j: int) -> float:
    """Give the root mean square of the torques of finding `j`, all motors together."""
    search, beta = explanation.search, explanation.fit.beta[j]
    torque = brought(search, explanation.found[j].candidate, beta)
    return float(np.sqrt(np.sum(rms(search, torque) ** 2)))


def _inside(torques: Sequence[Vector], problem: Problem) -> list[Vector]:
    """Give what motors have of channels per run, in each stretch without gaps, shape (n_motors, fewer)."""
    m = problem.model.n_motors
    return [e[:m, a:b] for e, run in zip(torques, problem.segments, strict=True) for a, b in run]


def _torque_that(does: str, parts: Sequence[Vector], model: CableModel) -> dict[str, Any]:
    """Say of which joint or motor torques are, shape (n_motors, any number of samples) each, and what they do there."""
    torque = np.concatenate(parts, axis=1)
    place = _place_of(torque, model)
    words = f"torque on {place['kind']} {place['index']} that {does}"
    return something(place["kind"], place["index"], words, float(np.sqrt(np.mean(np.sum(torque**2, axis=0)))))


def something(
    kind: str,
    index: int | Sequence[int],
    region: str,
    size: float,
    time: list[float] | None = None,
    nearest: Sequence[dict[str, Any]] = (),
) -> dict[str, Any]:
    """Say where something is that has no name, as the diagnosis format does; `size` is a root mean square."""
    return {
        "location": {"kind": kind, "index": index},
        "time": time,
        "region": region,
        "rms": size,
        "nearest": list(nearest),
    }


def nameless(explanation: Explanation, only_loud: bool = False) -> dict[str, Any] | None:
    """Describe what is left beside the findings by the correction that explains most of it.

    Zeros of sensors that are elsewhere on every recording are none of it, if only what is loud counts.
    """
    search, effects = explanation.search, [f.candidate for f in explanation.found]
    patch = unnamed(search, explanation.bank, effects)
    if patch is None:
        return None
    found = Found(patch, search.score(explanation.fit, patch), 0.0, 0.0)
    if only_loud and not is_loud(found.score):
        clear = search.fit(effects, clear_noise(search, effects))  # slow bursts pass for noise otherwise
        if not is_loud(search.score(clear, patch)):
            return None
    if only_loud and search.problem.torque and search.drift is None:
        drifting = all_drifting(search)
        beside = drifting.fit(effects)
        if not is_loud(drifting.score(beside, patch)) and not is_swamped(drifting, beside):
            return None
    fit = search.fit([*effects, patch], explanation.fit.whitener)
    return at_corrections(replace(explanation, found=(*explanation.found, found), fit=fit), [found])


def beyond_floor(
    search: Search, judge: Search | None, explanation: Explanation, *, shared: bool = False
) -> tuple[dict[str, Any] | None, float]:
    """Say where a residual is left that no correction describes either; None where it is near the floor.

    The second value is how large it is, as a sum of squares in units of the noise. Corrections without a name see
    torques only, so where there is travel alone less may be left without a word. On unseen recordings shapes may be
    others: those of the training need not tell them well, such as how friction rises at speeds that it hardly has.
    Where zeros may walk, half of how far they may is no more than that. Of what both have in common, if `shared`, less
    is enough, and what is far too large need not follow the state.
    """
    limit = 2.0 if search.problem.torque else 1.5
    fit, both = explanation.fit, [search] if judge is None else [search, judge]
    rests = [left_over(search, fit.effects, smooth=False)[1].rms]
    rests += [] if judge is None else [loosely_left_over(judge, fit)]
    least = np.max([_least(there) for there in both], axis=0)
    floors = [_floor(there, fit, least) for there in both]
    ratios = np.divide(rests, floors)
    rest, ratio = rests[0], np.maximum(np.min(ratios, axis=0), 0.5 * ratios[-1] * (judge is not None))
    common = (np.min(ratios, axis=0) > ALIKE) & (shared and judge is not None)
    if np.any(common) and fit.effects:  # strong laws that are a little wrong leave some of themselves
        before = left_over(search, (), smooth=False)[1].rms / floors[0]
        common &= ratios[0] ** 2 - 1.0 > LEAVES * (before**2 - 1.0)
    mean = np.where(common, np.sqrt(ratios[0] * ratios[-1]), 0.0)
    large = np.maximum(ratio / limit, mean / TOGETHER)
    worst = int(np.argmax(large))
    follows = (common[worst] and large[worst] > EVIDENTLY) or follows_state(search, fit)
    if not search.problem.segments or large[worst] < 1.0 or not follows:
        return None, 0.0
    m = search.problem.model.n_motors
    unsure = HALF * most_drift(search)[worst] if search.problem.torque and worst < m else 0.0
    if max(own[worst] for own in rests) < unsure and walking_noise(search, fit) is not None:
        return None, 0.0
    if search.problem.torque and worst < m and _are_zeros(both, fit, floors, worst, limit):
        return None, 0.0
    motor = worst % m + 1
    times = max(float(ratio[worst]), float(mean[worst]))
    words = f"the error of motor {motor} is {times:.1f} times its noise, in no shape that was tried"
    samples = fit.n_judged / search.problem.n_channels
    return something("motor", motor, words, float(rest[worst])), (times**2 - 1) * samples


def is_far(search: Search, fit: Fit) -> bool:
    """Whether a fit leaves torques far above the sensors' noise, much of which smooth functions of the state take."""
    if not search.problem.torque or not any(search.problem.segments):
        return False
    left, noise = (left_over(search, fit.effects, smooth=smooth)[1].rms for smooth in (False, True))
    far = (left > ROUGH * noise) & (left > FAR * search.problem.sensed)
    return bool(np.any(far[: search.problem.model.n_motors]))


def beyond_samples(search: Search, judge: Search | None, fit: Fit) -> Vector:
    """Give by how much motors err where that is no noise of their sensors nor an error of laws, shape (n_motors,).

    Sensors of one robot have noise of much the same colour: in the band it is not many times more of that of single
    samples on one motor than on the others. In training and unseen recordings alike, drifts aside; zero elsewhere.
    """
    sizes, m = [], search.problem.model.n_motors
    if not search.problem.torque or not any(search.problem.segments) or m < 2:
        return np.zeros(m)
    for there in _searches(search, judge):
        size, laws = rms(there, still_errors(there, fit))[:m], np.hypot(_least(there), _accuracy(there, fit))[:m]
        colour = size / np.maximum(there.problem.sensors.sampled, 1e-300)
        others = np.array([np.median(np.delete(colour, i)) for i in range(m)])
        far = (colour > np.maximum(COLOUR, OTHERS * others)) & (size > EVIDENTLY * laws)
        sizes.append(np.where(far, size, 0.0))
    return np.min(sizes, axis=0)


def times_noise(search: Search, judge: Search | None, fit: Fit) -> Vector:
    """Give how many times the noise, and what laws may be wrong by, motors err in unseen recordings, shape (n_motors,).

    In the training where there are none; zero without torques.
    """
    there, m = _searches(search, judge)[-1], search.problem.model.n_motors
    if not search.problem.torque or not any(there.problem.segments):
        return np.zeros(m)
    return rms(there, still_errors(there, fit))[:m] / np.maximum(_floor(search, fit, _least(search))[:m], 1e-300)


def _are_zeros(searches: Sequence[Search], fit: Fit, floors: Sequence[Vector], motor: int, limit: float) -> bool:
    """Whether what is left on a motor is no more than the zero of its sensor, elsewhere on every recording."""
    if any(search.drift is not None for search in searches):
        return False
    for search, floor in zip(searches, floors, strict=True):
        drifting = all_drifting(search)
        if left_over(drifting, fit.effects, smooth=False)[1].rms[motor] > limit * floor[motor]:
            return False
        if is_swamped(drifting, drifting.fit(fit.effects)):
            return False
    return True


def beyond_training(search: Search, judge: Search, fit: Fit, limit: float = 4.0) -> dict[str, Any] | None:
    """Say where unseen recordings hold something that the others do not tell of; None where they do not.

    Their error is then many times the noise, and what the training leaves uncertain does not explain it. Nor is what
    no function of the state describes noise, if the training has far less of it.
    """
    if not any(judge.problem.segments):
        return None
    if deviance_unseen(judge, fit) < limit**2 * judge.body(fit.whitener).data.size:
        return None
    own = _floor(search, fit, _least(search))
    floor = np.maximum(np.minimum(_floor(judge, fit, _least(judge)), LOUDER * own), _least(judge))
    anew = left_over(judge, fit.effects, smooth=False)[1].rms  # other poses may need masses that the training left open
    rest = still_errors(judge, fit)
    size = rms(judge, rest)
    times = np.minimum(2.0 * anew, size) / floor
    worst = int(np.argmax(times))
    if times[worst] < limit:
        return None
    model, times_noise = judge.problem.model, f"{size[worst] / floor[worst]:.1f} times the noise"
    if judge.problem.kinematic and (cable := worst - model.n_motors * judge.problem.torque) >= 0:
        words = f"in unseen recordings alone, where the error of the {{travel}} is {times_noise}"
        return _on_travel(model, cable + 1, words, float(size[worst]))
    place = _place_of(np.concatenate(_inside(rest, judge.problem), axis=1), model)
    words = f"in unseen recordings alone, whose error is {times_noise}"
    return something(place["kind"], place["index"], words, float(size[worst]))


def _on_travel(model: CableModel, index: int, words: str, size: float) -> dict[str, Any]:
    """Say what is of one motor's travel between encoders, named in words, in that travel's unit."""
    place = {"kind": "cable" if model.manipulator.links else "motor", "index": index}
    travel = f"travel of {place['kind']} {index} between its encoders"
    said = something(place["kind"], index, words.format(travel=travel), size)
    return said | {"unit": unit_at(model, place, "rad")}


def _searches(search: Search, judge: Search | None) -> list[Search]:
    """Give the searches on the training and, where some of their rows count, on the unseen recordings."""
    return [search] if judge is None or not any(judge.problem.segments) else [search, judge]


def _least(search: Search) -> Vector:
    """Say below what nothing is unexplained: what the sensors bring, or the accuracy of the rigid body's torque."""
    return np.maximum(search.problem.sensed, search.settings.torque_error * search.loads)


def _floor(search: Search, fit: Fit, least: Vector) -> Vector:
    """Give the error that noise, at least so large, and the accuracy of the laws leave, shape (n_channels,)."""
    return np.hypot(np.maximum(noise_floor(search, fit.effects), least), _accuracy(search, fit))


def _accuracy(search: Search, fit: Fit) -> Vector:
    """Say by how much the laws of a fit may be wrong, shape (n_channels,)."""
    total = np.zeros(search.problem.n_channels)
    for candidate, beta in zip(fit.effects, fit.beta, strict=True):
        own = rms(search, brought(search, candidate, beta))
        total += (candidate.law_error(search.problem.motions[0]) * own) ** 2
    return np.sqrt(total)


def wandering_torque(search: Search, fit: Fit) -> dict[str, Any] | None:
    """Say where a torque wanders slowly with time, in no repeatable way; None where it does not.

    Its place is that joint or motor along whose coordinate the slow part of the residual lies. It has to be more than
    an error of the rigid body's torque and of the laws, than zeros of sensors drift by, and than steps of encoders
    bring, which are slow where motions are.
    """
    problem, m = search.problem, search.problem.model.n_motors
    rest, noise = left_over(search, fit.effects, smooth=False)
    if not problem.torque or not problem.segments:
        return None
    if not np.any((wandering(noise)[:m] > WANDERING) & (steepness(noise)[:m] > STEEP)):
        return None
    width = max(3, int(0.25 / max(float(noise.centres[0]), 1e-3)))
    long = [x - x.mean(axis=1, keepdims=True) for x in _inside(rest, problem) if x.shape[1] > 2 * width]
    slow = [np.array([np.convolve(row, np.ones(width) / width, mode="valid") for row in x]) for x in long]
    if not slow:
        return None
    size = np.sqrt(np.mean(np.concatenate(slow, axis=1) ** 2, axis=1))
    rigid, laws = search.settings.torque_error * search.loads, _accuracy(search, fit)
    least = np.max([rigid[:m], laws[:m], most_drift(search), 2.0 * problem.sensors.rounding], axis=0)
    return None if np.all(size < least) else _torque_that("wanders slowly with time", slow, problem.model)


def moving_torque(search: Search, fit: Fit) -> dict[str, Any] | None:
    """Say where a torque moves by itself: that wanders slowly, or swings above the band, and leaks into it."""
    wanders = wandering_torque(search, fit)
    return None if wanders is None else swinging_torque(search, fit) or wanders


def shared_torque(search: Search, judge: Search | None, fit: Fit) -> dict[str, Any] | None:
    """Say where the errors of several motors are one and the same, far above the noise; None where they are not.

    Sensors do not err alike, so that it is something on the arm, whatever it follows; it may swing above the band. What
    laws explain may leave some of itself.
    """
    problem, m = search.problem, search.problem.model.n_motors
    if not problem.torque or not any(problem.segments):
        return None
    before = left_over(search, (), smooth=False)[1].rms[:m]
    least = ERRING * np.hypot(_least(search), _accuracy(search, fit))[:m]
    both = [_inside(still_errors(there, fit), there.problem) for there in _searches(search, judge)]
    torques = [np.concatenate(parts, axis=1) for parts in both]
    directions = []
    for torque in torques:
        size = rms_judged(torque, axis=1)
        _, values, along = np.linalg.svd(torque @ torque.T)
        loud = (size > least) & (size**2 > LEAVES * before**2) & (np.abs(along[0]) > 0.1)
        if np.sum(loud) < 2 or values[0] < AS_ONE * values.sum():
            return None
        directions.append(along[0])
    if abs(directions[0] @ directions[-1]) < AS_ONE:
        return None
    return swinging_torque(search, fit) or _torque_that("no law describes", torques[-1:], problem.model)


def wandering_travel(search: Search, fit: Fit) -> dict[str, Any] | None:
    """Say which cable's travel moves by itself, slowly or in leaps, far beyond the encoders' steps; None where none.

    Noise is what an autoregression makes of it, however large; but two encoders have none that moves for long.
    """
    problem, m = search.problem, search.problem.model.n_motors
    if not (problem.torque and problem.kinematic) or not any(problem.segments):
        return None
    rest, noise = left_over(search, fit.effects, smooth=False)
    steps = max(problem.steps_at(i) for i in range(problem.model.n_joints))
    size = noise.rms[m:] / np.hypot(steps, _accuracy(search, fit)[m:])
    size = np.where(wandering(noise)[m:] > STEADY, size, 0.0)
    worst = int(np.argmax(size))
    if size[worst] < ADRIFT:
        return None
    rate, leaps = problem.band.reduced_rate, []
    for e, inside, run in zip(rest, problem.segments, problem.runs, strict=True):
        for a, b in inside:
            leaps += _leaps_of(e[m + worst, a:b], run.motion.time[:: problem.band.step][a:b], rate)
    most = max([abs(step) for _, step in leaps], default=0.0)
    times = ", ".join(f"{t:.1f}" for t, step in sorted(leaps) if abs(step) > 0.5 * most)
    words = f"{{travel}} that moves by itself, most at {times} s"
    return _on_travel(problem.model, worst + 1, words, float(noise.rms[m + worst]))


def _leaps_of(x: Vector, time: Vector, rate: float, most: int = 6) -> list[tuple[float, float]]:
    """Give when a series changes most within a short time, and by how much: the largest in each stretch of its own."""
    width = max(int(LEAP * rate), 2)
    if len(x) < 4 * width:
        return []
    mean = np.convolve(x, np.ones(width) / width, mode="valid")
    steps = mean[width:] - mean[:-width]
    out = []
    while len(out) < most and np.abs(steps).max() > 0.0:
        k = int(np.argmax(np.abs(steps)))
        out.append((float(time[k + width]), float(steps[k])))
        steps[max(k - width, 0) : k + width + 1] = 0.0
    return out


def ringing_torque(search: Search, fit: Fit) -> dict[str, Any] | None:
    """Say where a torque rings at a frequency of its own within the band, however it is struck; None where it does not.

    The noise of sensors is white or slow, and drifts are slower still: what the residual has more of at some frequency
    than at a lower one is none of these.
    """
    problem, m = search.problem, search.problem.model.n_motors
    if not problem.torque or not any(problem.segments):
        return None
    rest, noise = left_over(search, fit.effects, smooth=False)
    rounder = left_over(search, fit.effects)[1]
    times = noise.rms / np.hypot(_least(search), _accuracy(search, fit))
    own, beside = rises(noise.power), rises(rounder.power)
    peak, rounded = own.max(axis=1), beside.max(axis=1)
    rings = (times > FAR) & (rounded > ROUNDER) & (peak > PEAK)
    rings |= (times > SHRILL) & (rounded > RISES) & (peak > RISING)
    peaks = np.where(rings, peak, 0.0)[:m]
    worst = int(np.argmax(peaks))
    if not peaks[worst]:
        return None
    frequency = float(noise.centres[np.argmax(own[worst])]) * problem.band.reduced_rate
    return _torque_that(f"rings at about {frequency:.2g} Hz", _inside(rest, problem), problem.model)


def answering_torque(search: Search, judge: Search | None, fit: Fit) -> dict[str, Any] | None:
    """Say on which axis something swings that its motion shakes; None where nothing does."""
    least = EVIDENTLY * np.hypot(_least(search), _accuracy(search, fit))
    found = resonance(_searches(search, judge), fit, least)
    if found is None:
        return None
    law, size = found
    return something(law.location["kind"], law.location["index"], _region(law), size)


def bursting_torque(search: Search, judge: Search | None, fit: Fit) -> dict[str, Any] | None:
    """Say where a torque is far off for short times, in all recordings alike, and near its noise else; None if nowhere.

    What takes part of the spectrum of such a residual for that of noise finds nothing in it. While a robot rests there
    is less noise; that does not count.
    """
    if not search.problem.torque:
        return None
    ratios, sizes = zip(*(_bursts(there, fit) for there in _searches(search, judge)), strict=True)
    ratio, size = np.min(ratios, axis=0), sizes[0]
    worst = int(np.argmax(ratio))
    if ratio[worst] < BURSTS:
        return None
    words = f"in short bursts, in which the error of motor {worst + 1} is far above what it mostly is"
    return something("motor", worst + 1, words, float(size[worst]))


def _bursts(search: Search, fit: Fit, least: int = 100) -> tuple[Vector, Vector]:
    """Give how many times what it mostly is each motor's residual is while joints move, and its size (n_motors,).

    Zero where it is not far above what sensors and laws leave, and where there are fewer than `least` samples.
    """
    problem, m = search.problem, search.problem.model.n_motors
    usual = np.sqrt(np.mean(np.concatenate([motion.v for motion in problem.motions]) ** 2, axis=0))
    parts = [np.zeros((m, 0))]
    for e, run, segments in zip(still_errors(search, fit), problem.runs, problem.segments, strict=True):
        moves = np.any(np.abs(run.motion.v[:: problem.band.step]) > MOVING * usual, axis=1)
        parts += [e[:m, a:b][:, moves[a:b]] for a, b in segments]
    rest = np.concatenate(parts, axis=1)
    if rest.shape[1] < least:
        return np.zeros(m), np.zeros(m)
    judged = (x[x != 0.0] if problem.partly else x for x in rest)
    size, mostly = (
        rms_judged(rest, axis=1),
        np.array([1.4826 * np.median(np.abs(x)) if len(x) else 0.0 for x in judged]),
    )
    loud = size > FAR * np.hypot(_least(search), _accuracy(search, fit))[:m]
    return np.where(loud, size / np.maximum(mostly, 1e-300), 0.0), size


def _place_of(torque: Vector, model: CableModel) -> dict[str, Any]:
    """Give the place along which most of a torque of the motors acts, shape (n_motors, n)."""
    return _place_along(np.linalg.svd(torque, full_matrices=False)[0][:, 0], model)


def _place_along(direction: Vector, model: CableModel) -> dict[str, Any]:
    """Give the joint or motor whose coordinate lies best along a direction of motor torques, shape (n_motors,)."""

    def along(place: Place) -> float:
        w = place.weights(model)
        return abs(complex(w @ direction)) / float(np.linalg.norm(w))

    return max(axis_places(model), key=along).location


def _quick(run: Run, cutoff: float) -> Motion:
    """Give the motion of a run with accelerations up to a frequency [Hz]."""
    model, rate = run.motion.model, run.signals.rate
    q, q_m = (lowpass(x, rate, cutoff) for x in both_positions(model, run.signals.logged))
    a, a_m = (differentiate(differentiate(x, rate), rate) for x in (q, q_m))
    return replace(run.motion, a=a, a_m=a_m)


def _lines(problem: Problem, run: Run, own: Segments, high: float) -> tuple[int, int, list[dict[float, float]]]:
    """Give the longest stretch of a run, in samples, and the strongest line above the band of each torque in it."""
    start, stop = (k * problem.band.step for k in max(own, key=lambda s: s[1] - s[0], default=(0, 0)))
    if stop - start < 512:
        return start, stop, []
    y, low = run.data[: problem.model.n_motors, start:stop], 0.9 * problem.band.cutoff
    return start, stop, [tone_peaks(x, problem.band.rate, low, high, 1, LINE) for x in y]


def _beside_lines(search: Search, fit: Fit, lines: set[float]) -> Search:
    """Give the search about the effects of a fit, with masses that owe nothing to lines above the band [Hz].

    Such lines leak into it; where the arm moves with a disturbance, wrong masses explain it.
    """
    leaking = {f for f in lines if f < 0.5 * search.problem.band.reduced_rate}
    distinct = [f for f in sorted(leaking) if not any(g < f < g + 0.02 for g in leaking)]
    plain = search.fit([*fit.effects, *tones_at(search, distinct)], search.plain)
    own = list(zip(fit.effects, fit.beta, strict=True))
    return search.at(plain.base[: len(search.base.columns)], own)


def _swings_near(x: Vector, t: Vector, frequency: float) -> Vector:
    """Give how series (m, n) swing at frequencies near one [Hz], where noise alone is, shape (k, m)."""
    near = frequency + np.r_[-12:-1, 2:13] * 2.0 / (t[-1] - t[0])
    return np.array([np.abs(x @ np.exp(-2j * np.pi * f * t)) * 2.0 / len(t) for f in near])


def _usual(x: Vector, t: Vector, frequency: float) -> float:
    """Give how large series (m, n) usually swing, all together, at frequencies near one [Hz]."""
    return float(np.median(np.linalg.norm(_swings_near(x, t, frequency), axis=1)))


def _is_one(amplitude: Vector, model: CableModel, noise: Vector) -> bool:
    """Whether torques that swing at one frequency are those of one place, or at least go to and fro together.

    Complex amplitudes and what noise makes of them there, each of shape (n_motors,).
    """
    A = amplitude / noise
    whole = float(np.linalg.norm(A))
    along = [place.weights(model) / noise for place in axis_places(model)]
    most = max(abs(complex(w @ A)) / float(np.linalg.norm(w)) for w in along)
    return most > ONE * whole or abs(complex(A @ A)) > TOGETHER * whole**2


def swinging_torque(search: Search, fit: Fit) -> dict[str, Any] | None:
    """Say where a torque swings at a frequency of its own above the band; None where it does not.

    It is looked for in the torques at the full rate. The motion at that frequency must not explain it, with masses that
    owe nothing to it, nor be too coarsely measured to tell, and it has to be alike in both halves of a recording. A hum
    in the sensors is in every torque, each with a phase of its own.
    """
    if not search.problem.torque:
        return None
    problem, rate, m = search.problem, search.problem.band.rate, search.problem.model.n_motors
    high = min(3.6 * problem.band.cutoff, HIGHEST, 0.4 * rate)
    heard = [_lines(problem, run, own, high) for run, own in zip(problem.runs, problem.segments, strict=True)]
    frequencies = {f for _, _, lines in heard for line in lines for f in line}
    if not frequencies:
        return None
    problem = _beside_lines(search, fit, frequencies).problem
    best, told = LINE, None
    for run, (start, stop, lines) in zip(problem.runs, heard, strict=True):
        if not any(lines):
            continue
        t, y = run.motion.time[start:stop], run.data[:m, start:stop]
        moving = _quick(run, min(2.0 * high, 0.45 * rate)).logged_torque.T[:, start:stop]
        e = y - moving
        for found in lines:
            for frequency, height in found.items():
                turn = 2.0 * np.exp(-2j * np.pi * frequency * t)
                early, late = (e[:, part] @ turn[part] / part.size for part in np.array_split(np.arange(len(t)), 2))
                size, spread = np.linalg.norm(0.5 * (early + late)), np.linalg.norm(early - late)
                alike = size > 0.5 * np.linalg.norm(y @ turn) / len(t) and spread < 0.5 * size
                if height > best and alike and size > UNTOLD * _usual(moving, t, frequency):
                    noise = np.median(_swings_near(e, t, frequency), axis=0)
                    if _is_one(0.5 * (early + late), problem.model, noise):
                        best, told = height, (frequency, 0.5 * (early + late))
    if told is None:
        return None
    frequency, amplitude = told
    place = _place_along(amplitude, problem.model)
    words = f"torque on {place['kind']} {place['index']} that swings with time at {frequency:.3g} Hz"
    return something(place["kind"], place["index"], words, float(np.linalg.norm(amplitude) / np.sqrt(2.0)))
