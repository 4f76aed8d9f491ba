"""Doubts beside a fit: what sensors, laws and masses that are as unsure as they are may bring, whitened."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import interp1d

from .bank import all_candidates
from .candidates import Candidate
from .completed import effect_candidates
from .drift import QUICKER
from .drifting import slow_waves
from .dynamics import inverse_dynamics
from .effect import Columns
from .fit import Fit
from .geometry import Vector
from .masses import hidden
from .motion import Motion
from .recent import kept
from .search import Search, brought
from .whitening import Segments, inside_of

PUNCTUAL = 0.05
"""Share of the time between two samples by which it is not sure what instant one stands for."""
COMPLIANT = ("cable_elasticity", "cable_slack")
"""Effects whose first coefficient is how much a cable gives per torque."""


@kept
def errors_of_laws(search: Search, fit: Fit) -> Vector:
    """Add up the magnitudes of the errors that the laws in a fit may have, whitened.

    Those that the model states already count as one, the root of the sum of their squares.

    Returns
    -------
    ndarray, shape (n_rows,)
    """
    known = np.zeros(fit.n_rows)
    for candidate, beta in zip(fit.effects, fit.beta, strict=True):
        known = known + error_of(search, candidate, beta, fit)
    stated = [error_of(search, c, beta, fit) ** 2 for c, beta in effect_candidates(search.problem.model)]
    return known + np.sqrt(np.sum(stated, axis=0))


def error_of(search: Search, candidate: Candidate, beta: Vector, fit: Fit) -> Vector:
    """Give the magnitude of the error that a law of some size may have, whitened as a fit is, shape (n_rows,)."""
    parts = [x[None] for x in brought(search, candidate, beta)]
    if candidate.effect.exact_travel and search.problem.torque:
        for part in parts:
            part[:, search.problem.model.n_motors :] = 0.0
    known = candidate.law_error(search.problem.motions[0]) * np.abs(search.white(fit.whitener, parts)[0])
    if candidate.has_doubts:
        doubts = search.in_band(lambda motion: candidate.doubts(motion, beta))
        known = known + np.abs(search.white(fit.whitener, doubts)).sum(axis=0)
    if candidate.effect.leaves_open is not None:
        further = search.in_band(lambda motion: candidate.left_open(motion, beta))
        known = known + np.abs(search.white(fit.whitener, further)).sum(axis=0)
    if candidate.effect.reveals is not None:
        _, beside, A, _ = hidden(search, fit)
        open_still = np.linalg.solve(np.linalg.cholesky(A @ A.T + np.eye(len(A))), beside)
        known = known + np.linalg.norm(open_still, axis=0)
    return known


@kept
def offsets(search: Search, fit: Fit) -> Vector:
    """Give what constant errors of the encoders may bring, whitened, as far as a fit leaves it.

    Each is as large as half a step of the encoder, at the joint. Where both sides have encoders, these may be off
    alike, as where both round down, which is in the torques alone; the travel between them counts for as much
    already (`Run.without_mean`).

    Returns
    -------
    ndarray, shape (n, n_rows)
    """
    steps, m = search.problem.sensors.joint_steps, search.problem.model.n_motors * search.problem.torque
    held = {c.location["index"] for c in fit.effects if c.effect.name == "encoder_offset"}
    places = [c for c in all_candidates(search.problem, ("encoder_offset",)) if c.location["index"] not in held]
    rows = [np.zeros((0, fit.n_rows))]
    for c in places:
        torque = [x * (np.arange(x.shape[1]) < m)[:, None] for x in search.columns(c)]
        rows.append(0.5 * steps[c.place.index[0]] * search.white(fit.whitener, torque))
    return fit.rest(np.concatenate(rows))


@kept
def lags(search: Search, fit: Fit) -> Vector:
    """Give what encoders on both sides bring that lag behind where they turn, whitened, as far as a fit leaves it.

    Each by half a step, after the sign of its own velocity: what turns a magnet or slips on a shaft may do so.

    Returns
    -------
    ndarray, shape (n, n_rows)
    """
    model, most = search.problem.model, search.problem.half_steps

    def columns(motion: Motion) -> Columns:
        joints = model.motor_from_joint * (most["joint_position"] * np.sign(motion.v))[:, None, :]
        motors = np.eye(model.n_motors) * (most["motor_position"] * np.sign(motion.v_m))[:, None, :]
        return Columns(kinematic=model.arm_scale[:, None] * np.concatenate([-joints, motors], axis=2))

    return fit.rest(search.white(fit.whitener, search.in_band(columns)))


@kept
def rests(search: Search, fit: Fit) -> Vector:
    """Draw what rounding leaves in the travels where encoders rest or turn, whitened, as far as a fit leaves it.

    Returns
    -------
    ndarray, shape (n_draws, n_rows)
    """
    problem, rows = search.problem, []
    parts = zip(problem.runs, problem.segments, problem.data, problem.sensors.resting, strict=True)
    for run, inside, data, drawn in parts:
        own, n = drawn, data.shape[2]
        if drawn.shape[2] != n:  # thinned recordings may have a few samples more or less
            own = interp1d(np.arange(drawn.shape[2]), drawn)(np.linspace(0.0, drawn.shape[2] - 1.0, n))
        if run.sure is not None:
            own = _as_counted(own, inside, run.sure[:, None])
        rows.append(np.concatenate([np.zeros((len(own), problem.n_channels - own.shape[1], n)), own], axis=1))
    return fit.rest(search.white(fit.whitener, rows))


def _as_counted(travel: Vector, inside: Segments, sure: Vector | float) -> Vector:
    """Take from travels in the band, (..., n), that share of their mean for which it does not count (`Run.sure`)."""
    if not inside:
        return travel
    return travel - (1.0 - sure) * inside_of(travel, inside).mean(axis=-1, keepdims=True)


@kept
def instants(search: Search, fit: Fit) -> Vector:
    """Give what torques bring that were read not quite when positions were, whitened, as far as a fit leaves it.

    Returns
    -------
    ndarray, shape (n, n_rows)
        None beside a delay.
    """
    told = not search.problem.torque or any(c.effect.name == "time_delay" for c in fit.effects)
    delays = [c for c in all_candidates(search.problem, () if told else ("time_delay",)) if not c.place.index]
    share = PUNCTUAL / search.problem.motions[0].rate
    rows = [share * search.white(fit.whitener, search.columns(c)) for c in delays]
    return fit.rest(np.concatenate([np.zeros((0, fit.n_rows)), *rows]))


@kept
def sides(search: Search, fit: Fit) -> Vector:
    """Give what the rigid body takes more where joints accelerate as one motor says and not as each one's encoder.

    Of more joints than motors some move together. Links turn with their own encoders, rotors with what all of these
    make of their motor: where one is finer than the others, inertia seems to be on the other side.

    Returns
    -------
    ndarray, shape (n, n_rows)
        One per joint, whitened, as far as the fit leaves it over; none where no joints move together.
    """
    problem, model = search.problem, search.problem.model
    if not (problem.torque and problem.motions[0].joints_measured and model.n_joints > model.n_motors):
        return np.zeros((0, fit.n_rows))

    def columns(motion: Motion) -> Columns:
        apart = motion.a_m @ model.joint_from_motor.T - motion.a
        own = inverse_dynamics(motion.model, motion.q, motion.v, motion.a)
        each = [motion.a + apart * axis for axis in np.eye(model.n_joints)]
        more = [inverse_dynamics(motion.model, motion.q, motion.v, a) - own for a in each]
        return Columns(np.stack([model.motor_torque(x) for x in more], axis=-1))

    return fit.rest(search.white(fit.whitener, search.in_band(columns)))


@kept
def unsure_stretches(search: Search, fit: Fit) -> Vector:
    """Give what masses that are as unsure as they are may stretch the soft cables of a fit, whitened.

    Returns
    -------
    ndarray, shape (n, n_rows)
        As far as the fit leaves it over.
    """
    if not any(_is_seen_to_stretch(search, c) for c in fit.effects):
        return np.zeros((0, fit.n_rows))
    p = search.n_bodies
    values, vectors = np.linalg.eigh(fit.covariance[:p, :p])
    W = search.white(fit.whitener, [rows[:p] for rows in stretches(search, fit)])
    return fit.rest((vectors * np.sqrt(np.maximum(values, 0.0))).T @ W)


def stretches(search: Search, fit: Fit) -> list[Vector]:
    """Give by how much each parameter of the rigid body stretches the soft cables of a fit, in the travel.

    Where the links swing on a cable, that is in the columns of the rigid body itself.

    Returns
    -------
    list of ndarray, shape (n_rigid, n_channels, n_reduced)
        One per run.
    """
    problem, m = search.problem, search.problem.model.n_motors
    out = [np.zeros_like(rigid) for rigid in search.rigid]
    for candidate, beta in zip(fit.effects, fit.beta, strict=True):
        if not _is_seen_to_stretch(search, candidate):
            continue
        i = candidate.place.index[0]
        for rows, rigid, run, inside in zip(out, search.rigid, problem.runs, problem.segments, strict=True):
            own = beta[0] / problem.model.arm_scale[i] * rigid[: search.n_bodies, i]
            if run.sure is not None:
                own = _as_counted(own, inside, run.sure[i])
            rows[: search.n_bodies, m + i] += own
    return out


def _is_seen_to_stretch(search: Search, candidate: Candidate) -> bool:
    """Whether an effect is a soft cable whose travel is measured, and the torque that stretches it."""
    return search.problem.torque and search.problem.kinematic and candidate.effect.name in COMPLIANT


@kept
def quicker_drifts(search: Search, fit: Fit) -> Vector:
    """Give waves a little quicker than zeros were seen to move, whitened, as far as a fit leaves them over.

    Each is given as much room as all noise.

    Returns
    -------
    ndarray, shape (n, n_rows)
    """
    if search.drift is None:
        return np.zeros((0, fit.n_rows))
    waves = slow_waves(search, search.drift.channels, search.drift.stretch, search.drift.quicker + QUICKER)
    left = fit.rest(search.white(fit.whitener, waves))
    values, vectors = np.linalg.eigh(left @ left.T)
    seen = values > 1e-9 * np.max(values, initial=0.0)
    rows = (vectors[:, seen] / np.sqrt(values[seen])).T @ left
    return np.sqrt(fit.n_judged) * rows
