"""Whether an effect is larger than what clocks, steps, drifts and friction leave open: then it is resolved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .candidates import Candidate
from .completed import effect_candidates
from .doubts import COMPLIANT, PUNCTUAL
from .drifting import most_drift, with_drift
from .effect_shapes import greatest_load, sign_width
from .fit import Fit
from .geometry import Vector
from .patches import MISREAD, RUBS
from .pushes import briefest, run_of
from .robust import UNSURE, is_coarse
from .search import Search, brought, errors, rms
from .walking import walking_noise
from .whitening import blanked, inside_of

ALIKE = 0.95
"""Cosine of the motors' shares beyond which two effects act along one coordinate."""
OPEN = 4.0
"""Speed, over that which is told from noise, up to which the law of dry friction leaves its sign open."""
ROUNDED = 2.0
"""How many times the torque that steps of encoders bring a correction without a name has to make."""
THROUGHOUT = 0.95
"""Share of its recording that a push lasts for at most."""
SEEN = 0.02
"""Share of a push's square that is judged at least."""
MOST_STRETCH = 0.35
"""By how much no cable gives under what it carries [rad]."""


def is_resolved(search: Search, candidate: Candidate, beta: Vector, fit: Fit) -> bool:
    """Whether an effect is larger than what clocks, derivatives and filters leave wrong in the torque of a rigid body.

    Of a correction without a name that share counts which the fit leaves over, and where positions are too coarse for
    the accelerations in the band, it has to be larger still; it has to exceed what steps of encoders and of the torque
    can bring, and where they are too coarse what the sensors bring by themselves. A push has to last for as long as the
    band can tell from an outlier, and to be judged while it does; it has to exceed half a step of the torque, and where
    nothing moves what dry friction holds. A reading has to be off by more than encoders on both sides round. A cable
    gives as a spring first, then as a damper. What a zero is off by has to be more than it drifts by, a delay more than
    the instants of samples are unsure by.
    """
    problem, push = search.problem, candidate.effect.name == "external_torque"
    if candidate.effect.name == "time_delay" and abs(beta[0]) * problem.motions[0].rate < PUNCTUAL:
        return False
    if push and (candidate.shape[1] - candidate.shape[0] < briefest(problem.band) or _is_throughout(search, candidate)):
        return False
    if push and (_is_held(search, candidate, float(np.abs(beta[0])), fit) or not _is_judged(search, candidate)):
        return False
    if candidate.effect.name == "encoder_offset" and problem.kinematic and not _is_in_means(search, candidate, fit):
        return False
    if candidate.effect.name == MISREAD and problem.kinematic and _is_rounded(search, candidate, beta):
        return False
    if not problem.torque:
        return True
    m = problem.model.n_motors
    torque = brought(search, candidate, beta)
    peak = np.max([np.abs(x[:m]).max(axis=1) for x in torque], axis=0)
    if push and np.all(peak <= 0.5 * problem.sensors.torque_steps):
        return False
    if candidate.effect.name in COMPLIANT and _is_no_cable(search, candidate, beta):
        return False
    if candidate.effect.name == "torque_offset" and np.all(peak <= unsure_zeros(search, fit, candidate)):
        return False
    own, visible = rms(search, torque), 1.0
    if own[m:].any():
        return True
    least = search.settings.torque_error * search.loads[:m]
    if not candidate.named:
        least = least * (problem.band.cutoff / max(problem.sensors.trusted, 1e-3)) ** 2
        W = beta @ search.white(fit.whitener, search.columns(candidate))
        visible = float(np.linalg.norm(fit.rest(W)) / max(np.linalg.norm(W), 1e-300))
        least = np.maximum(least, ROUNDED * problem.sensors.rounding)
        least = np.maximum(least, problem.sensors.torque_stairs)
        if is_coarse(problem):
            least = np.maximum(least, UNSURE * problem.sensed[:m])
    if not np.any(visible * own[:m] > least):
        return False
    return candidate.effect.name not in RUBS or not _is_pushed(search, torque, fit)


def _is_throughout(search: Search, push: Candidate) -> bool:
    """Whether a push lasts for nearly all of its recording: its zero is elsewhere than on others, then."""
    time = search.problem.motions[run_of(search.problem.motions, push)].time
    there = np.mean((time >= push.shape[0]) & (time <= push.shape[1]))
    return bool(there > THROUGHOUT)


def _is_judged(search: Search, push: Candidate) -> bool:
    """Whether motors are judged while a push lasts, and not only before it and after."""
    columns = search.columns(push)
    seen = [blanked(x, run) for x, run in zip(columns, search.problem.segments, strict=True)]
    whole, judged = (sum(float(np.sum(x**2)) for x in part) for part in (columns, seen))
    return judged >= SEEN * whole


def _is_rounded(search: Search, reading: Candidate, beta: Vector) -> bool:
    """Whether an encoder's reading is off by no more than half steps of the encoders between which that is seen.

    At rest these are off by something that depends on where it is.
    """
    problem, model = search.problem, search.problem.model
    m = model.n_motors * problem.torque
    most = problem.half_steps
    bound = model.arm_scale * (np.abs(model.motor_from_joint) @ most["joint_position"] + most["motor_position"])
    travel = [np.abs(x[m:]).max(axis=1) for x in brought(search, reading, beta)]
    return bool(np.all(np.max(travel, axis=0) <= bound))


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


def unsure_zeros(search: Search, fit: Fit, offset: Candidate) -> Vector:
    """Say by how much the torques' zeros may be off in a fit, shape (n_motors,) [N m].

    It is what they drift by beside a constant offset, which the slowest waves would take up; where they walk, the
    recordings need not show how far.
    """
    drifted = _drifted(search, search.fit([*fit.effects, offset], fit.whitener))
    if walking_noise(search, fit) is None:
        return drifted
    return np.maximum(drifted, most_drift(search))


def differs_by_zeros(search: Search, fit: Fit, law: Candidate) -> bool:
    """Whether friction beside a fit differs in its two directions by no more than zeros that move may be off."""
    if law.effect.name != "asymmetric_friction":
        return False
    constant, m = search.score(fit, law).beta[1], search.problem.model.n_motors
    torque = [np.abs(constant * columns[1]).max(axis=1) for columns in search.columns(law)]
    if np.any(np.max(torque, axis=0)[:m] > most_drift(search)):
        return False
    if search.drift is not None or walking_noise(search, fit) is not None:
        return True
    return with_drift(search, fit.effects).drift is not None


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
    model, motions = search.problem.model, search.problem.motions
    motion = motions[run_of(motions, push)]
    inside = (motion.time >= push.shape[0]) & (motion.time <= push.shape[1])
    own = push.place.weights(model)
    for law, beta in [*zip(fit.effects, fit.beta, strict=True), *effect_candidates(model)]:
        if not (law.effect.name.endswith("_friction") and law.has_doubts) or law.place.is_pair:
            continue
        series, other = law.raw_columns(motion).along or (None, own)
        if series is None or abs(own @ other) <= ALIKE * np.linalg.norm(own) * np.linalg.norm(other):
            continue
        k = len(law.effect.signs)
        level = float(np.abs(beta[:k] @ series[:k]).max() * np.linalg.norm(other) / np.linalg.norm(own))
        speed = np.abs(law.place.along(motion.v, motion.v_m))[inside]
        if size < level and np.mean(speed < OPEN * sign_width(motions, law.place)) > 0.5:
            return True
    return False


def _is_in_means(search: Search, candidate: Candidate, fit: Fit) -> bool:
    """Whether the plain means of the travels between encoders tell an offset that is more than these round by.

    Of those means a small share counts, so that what else is left of a travel can look like a large offset.
    """
    own = _travel_means(search, [columns[0] for columns in search.columns(candidate)])
    left = _travel_means(search, errors(search, fit.base, fit.effects, fit.beta))
    if not len(own):
        return True
    return bool(abs(own @ left) > 0.5 * search.problem.steps_at(candidate.place.index[0]) * (own @ own))


def outdoes_in_means(search: Search, candidate: Candidate, beta: Vector, fit: Fit) -> bool:
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
        series = brought(search, law, its)
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
