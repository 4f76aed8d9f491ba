"""A recording run again by a model: joint positions from the recorded motor torques, window by window.

Each window starts in the recorded state and is driven by the recorded torque alone, so that what a model lacks shows as
the distance that builds up within the horizon. Effects of the model run forward: friction sticks, hysteresis remembers,
springs and rotors follow the simulated motion. Levels of friction that depend on load, position or time are those of
the recorded state. Effects that move joints and motors apart (elastic cables, backlash, slack, wrong ratios), tilt and
encoder offsets enter as their first-order torque along the record; `Replay.along_record` names them. Links on a soft
cable behind measured motors are where they swing along the record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numba
import numpy as np

from .candidates import Candidate, loaded, torque_of
from .completed import effect_candidates
from .errors import ShapeError
from .friction_effects import Sliding
from .geometry import Vector
from .model import CableModel
from .motion import Motion
from .sensor_effects import delayed
from .stepping import Laws, advance

MOST = 60  # windows that are run
RATE = 300.0  # steps a second, at least [Hz]
EXACT = 1e-12  # width of the smooth sign where its level alone is wanted [rad/s]
KNOWN_IN_TIME = ("torque_offset", "torque_gain_error", "time_delay", "external_torque")  # whatever the state is


@dataclass(frozen=True)
class Replay:
    """Windows of a recording, as recorded and as two models run them.

    Attributes
    ----------
    label : str
    start : ndarray, shape (n_windows,)
        Time of the recording at which each window begins [s].
    time : ndarray, shape (n,)
        Since the start of the window [s].
    recorded, rigid, completed : ndarray, shape (n_windows, n, n_joints)
        Joint positions [rad or m].
    along_record : tuple of dict
        Effects, as ``{effect, location}``, that were not run forward but taken along the record.
    """

    label: str
    start: Vector
    time: Vector
    recorded: Vector
    rigid: Vector
    completed: Vector
    along_record: tuple[dict[str, Any], ...] = ()

    @property
    def horizon(self) -> float:
        """Length of a window [s]."""
        return round(float(self.time[-1]), 6)

    def stretch(self, most: int) -> tuple[Vector, Vector, Vector, Vector]:
        """Put the first windows, at most so many, one after another.

        Returns
        -------
        time : ndarray, shape (n,)
            [s].
        recorded, rigid, completed : ndarray, shape (n, n_joints)
            [rad or m].
        """
        count = min(most, len(self.start))
        time = (np.arange(count)[:, None] * self.time[-1] + self.time[:-1]).ravel()
        recorded, rigid, completed = (
            x[:count, :-1].reshape(-1, x.shape[2]) for x in (self.recorded, self.rigid, self.completed)
        )
        return time, recorded, rigid, completed


def simulated_position(replays: Sequence[Replay]) -> dict[str, Any] | None:
    """Sum up how far simulated joints part from recorded ones, as diagnosis.json has it; None without windows.

    Parameters
    ----------
    replays : sequence of Replay

    Returns
    -------
    dict or None
        ``rmse_rigid`` and ``rmse_augmented`` per joint [rad or m], ``horizon`` [s], ``windows``, ``along_record``.
    """
    if not replays:
        return None

    def rmse(name: str) -> list[float]:
        error = np.concatenate([getattr(r, name) - r.recorded for r in replays])
        return np.sqrt(np.mean(error**2, axis=(0, 1))).tolist()

    return {
        "rmse_rigid": rmse("rigid"),
        "rmse_augmented": rmse("completed"),
        "horizon": replays[0].horizon,
        "windows": sum(len(r.start) for r in replays),
        "along_record": list(replays[0].along_record),
    }


def replay(
    rigid: CableModel,
    completed: CableModel,
    motion: Motion,
    torque: Vector,
    valid: np.ndarray,
    *,
    horizon: float = 1.0,
    most: int = MOST,
    label: str = "",
) -> Replay | None:
    """Run a recording again with two models, in windows that follow on one another.

    Parameters
    ----------
    rigid, completed : CableModel
        Identified inertial parameters, and effects as ``manipulator.effects``.
    motion : Motion
        As recorded.
    torque : ndarray, shape (n, n_motors)
        Logged motor torque on the same grid [N m].
    valid : ndarray of bool, shape (n,)
        Samples that are judged.
    horizon : float
        [s].
    most : int
        At most so many windows, spread evenly.
    label : str
        Name of the recording.

    Returns
    -------
    Replay or None
        None where no window is wholly valid.
    """
    steps = max(2, round(horizon * motion.rate))
    starts = _windows(valid, steps)
    if not len(starts):
        return None
    starts = starts[np.unique(np.linspace(0, len(starts) - 1, min(most, len(starts))).astype(int))]
    rows = starts[:, None] + np.arange(steps + 1)
    _, held = forward_laws(completed, motion)
    return Replay(
        label=label,
        start=motion.time[starts],
        time=np.arange(steps + 1) / motion.rate,
        recorded=motion.q[rows],
        rigid=run_windows(rigid, motion, torque, starts, steps),
        completed=run_windows(completed, motion, torque, starts, steps),
        along_record=tuple(
            {"effect": c.effect.name, "location": dict(c.place.location)}
            for c, _ in held
            if c.effect.name not in KNOWN_IN_TIME
        ),
    )


def _windows(valid: np.ndarray, steps: int) -> np.ndarray:
    """First samples of windows of `steps` + 1 valid samples that follow on one another."""
    starts, k = [], 0
    bad = np.flatnonzero(np.append(~valid, True))
    while k + steps < len(valid):
        stop = bad[np.searchsorted(bad, k)]
        if stop > k + steps:
            starts.append(k)
            k += steps
        else:
            k = stop + 1
    return np.array(starts, int)


def run_windows(model: CableModel, motion: Motion, torque: Vector, starts: np.ndarray, steps: int) -> Vector:
    """Run a model, its effects included, from recorded states by the recorded torque.

    Parameters
    ----------
    model : CableModel
    motion : Motion
        As recorded; it gives the state at the start of each window.
    torque : ndarray, shape (n, n_motors)
        Logged motor torque [N m].
    starts : ndarray of int, shape (n_windows,)
        Samples at which windows start.
    steps : int
        Samples of a window.

    Returns
    -------
    ndarray, shape (n_windows, steps + 1, n_joints)
        Joint positions [rad or m]; NaN from where a simulation diverges on.

    Raises
    ------
    ShapeError
        If the torque does not belong to the motion.
    """
    if np.shape(torque) != (motion.n, model.n_motors):
        raise ShapeError(f"torque has shape {np.shape(torque)}, ({motion.n}, {model.n_motors}) was expected")
    motion = loaded(motion, effect_candidates(model))
    laws, held = forward_laws(model, motion)
    drive = _true_torque(model, motion, np.asarray(torque, float), held)
    try:
        q_m = _advanced(model, motion, laws, drive, starts, steps)
    except np.linalg.LinAlgError:  # no mass moves along some coordinate
        return np.full((len(starts), steps + 1, model.n_joints), np.nan)
    q = model.joint_position(q_m)
    return np.where(np.isfinite(q), q, np.nan)


def _advanced(model: CableModel, motion: Motion, laws: Laws, drive: Vector, starts: np.ndarray, steps: int) -> Vector:
    """Motor positions, shape (n_windows, steps + 1, n_motors)."""
    substeps = max(1, int(np.ceil(RATE / motion.rate - 1e-6)))
    inverse, chain = model.motor_from_joint.T, model.chain
    return advance(
        (chain.order, chain.parent, chain.rotation, chain.translation, chain.axis, chain.prismatic, chain.gravity),
        model.standard_parameters,
        np.ascontiguousarray(model.joint_from_motor),
        np.ascontiguousarray(model.offset),
        laws,
        np.ascontiguousarray(drive),
        starts,
        np.ascontiguousarray((motion.q[starts] - model.offset) @ inverse),
        np.ascontiguousarray(motion.v[starts] @ inverse),
        1.0 / (motion.rate * substeps),
        substeps,
        steps,
    )


def forward_laws(model: CableModel, motion: Motion) -> tuple[Laws, list[tuple[Candidate, Vector]]]:
    """Turn the effects of a model into laws that run forward; give those that cannot beside them."""
    parts = _Parts(model, motion)
    held = [(candidate, beta) for candidate, beta in effect_candidates(model) if not parts.take(candidate, beta)]
    return parts.laws(), held


class _Parts:
    """Collects the laws of a model's effects."""

    def __init__(self, model: CableModel, motion: Motion):
        self.model, self.motion = model, motion
        m = model.n_motors
        self.inertia, self.viscous = np.diag(model.rotor_inertia).astype(float), np.zeros((m, m))
        self.drag: list[Any] = []
        self.dry: list[Any] = []
        self.spring: list[Any] = []
        self.ripple: list[Any] = []
        self.memory: list[Any] = []

    def take(self, candidate: Candidate, beta: Vector) -> bool:
        """Take an effect; False if it cannot be run forward."""
        name, place, motion = candidate.effect.name, candidate.place, self.motion
        if name in KNOWN_IN_TIME:
            return False
        p = candidate.effect.physical(beta, candidate.shape)
        if name == "transmission_coupling":
            if p.get("motor_only"):
                return False
            i, k = place.index
            w = np.eye(self.model.n_motors)[i] + p["ratio"] * self.model.joint_from_motor[k]
            self.inertia += p["inertia"] * np.outer(w, w)
            self.viscous += p["viscous"] * np.outer(w, w)
            self._rub(w, p["coulomb"], p["coulomb"])
            return True
        if not (place.A or place.B):
            return False
        w = place.weights(self.model)
        at = np.append(w, np.array(place.A) @ self.model.offset)
        if name == "viscous_friction":
            self.viscous += p["viscous"] * np.outer(w, w)
        elif name == "quadratic_drag":
            self.drag.append((w, p["coefficient"]))
        elif name == "rotor_inertia":
            self.inertia += p["inertia"] * np.outer(w, w)
        elif name == "joint_spring":
            self.spring.append((at, (p["stiffness"], p.get("rest", 0.0), p.get("cubic", 0.0))))
        elif name == "torque_ripple":
            self.ripple.append((at, (p["amplitude"], p["cycles"], p["phase"])))
        elif name == "hysteresis" and not candidate.remembers_tension:
            self._remember(w, place.along(motion.q, motion.q_m), p)
        elif name == "stribeck_friction":
            self._rub(w, p["coulomb"], p["coulomb"], (p["stribeck"], p["stribeck_velocity"]))
        elif name == "asymmetric_friction":
            self._rub(w, p["coulomb_positive"], p["coulomb_negative"])
        elif candidate.effect.nuisance_shape == 1 and not candidate.effect.follows:
            level = self._level(candidate, beta)
            if level is None:
                return False
            self._rub(w, level, level)
        else:
            return False
        return True

    def _level(self, candidate: Candidate, beta: Vector) -> Vector | None:
        """Level of a friction along the record: its torque with a sharp sign, less that sign."""
        sharp = Candidate(candidate.effect, candidate.place, (Sliding(EXACT), *candidate.shape[1:]))
        v, v_m = (np.where(x == 0.0, 1e3 * EXACT, x) for x in (self.motion.v, self.motion.v_m))  # at rest: either sign
        moving = replace(self.motion, v=v, v_m=v_m)
        columns = sharp.raw_columns(moving)
        if columns.along is None:
            return None
        series, _ = columns.along
        return (beta[: len(series)] @ series[: len(beta)]) * np.sign(candidate.place.along(v, v_m))

    def _rub(self, w: Vector, forwards: Any, backwards: Any, stribeck: tuple[float, float] = (0.0, 0.0)) -> None:
        limits = [np.maximum(np.broadcast_to(x, self.motion.n), 0.0) for x in (forwards, backwards)]
        self.dry.append((w, *limits, stribeck))

    def _remember(self, w: Vector, x: Vector, p: dict[str, float]) -> None:
        distance, form = p["limit"] / p["stiffness"], p.get("form", 0.0)
        if form < 0.5:
            elements = [(p["limit"], distance)]
        else:  # four elements that let go one after another
            spread = 1.0 + 4.0 * (form - 0.5)
            elements = [(p["limit"] / 4, distance * spread ** ((e - 1.5) / 1.5)) for e in range(4)]
        for limit, reach in elements:
            self.memory.append((w, (limit, reach), form >= 0.5, _remembered(x, reach, form >= 0.5)))

    def laws(self) -> Laws:
        """Stack what was taken."""
        m, n = self.model.n_motors, self.motion.n

        def stacked(rows: list[Any], part: int, *shape: int) -> Vector:
            return np.array([row[part] for row in rows], float).reshape(len(rows), *shape)

        return Laws(
            inertia=self.inertia,
            viscous=self.viscous,
            drag_w=stacked(self.drag, 0, m),
            drag=stacked(self.drag, 1),
            dry_w=stacked(self.dry, 0, m),
            forwards=stacked(self.dry, 1, n),
            backwards=stacked(self.dry, 2, n),
            stribeck=stacked(self.dry, 3, 2),
            spring_w=stacked(self.spring, 0, m + 1),
            spring=stacked(self.spring, 1, 3),
            ripple_w=stacked(self.ripple, 0, m + 1),
            ripple=stacked(self.ripple, 1, 3),
            memory_w=stacked(self.memory, 0, m),
            memory=stacked(self.memory, 1, 2),
            slips=stacked(self.memory, 2).astype(bool),
            memory_start=stacked(self.memory, 3, n),
        )


@numba.njit(cache=True)
def _remembered(x: Vector, distance: float, slips: bool) -> Vector:
    """State of a hysteresis over its limit along a motion, from rest."""
    z = np.zeros(len(x))
    for k in range(1, len(x)):
        dx = x[k] - x[k - 1]
        if slips:
            z[k] = min(1.0, max(-1.0, z[k - 1] + dx / distance))
        else:
            s = 1.0 if dx > 0 else -1.0
            z[k] = s + (z[k - 1] - s) * np.exp(-abs(dx) / distance)
    return z


def _true_torque(model: CableModel, motion: Motion, torque: Vector, held: Sequence[tuple[Candidate, Vector]]) -> Vector:
    """Take from the logged torque what the logger did to it, and what is taken along the record."""
    gain, delay, drive = np.ones(model.n_motors), np.zeros(model.n_motors), torque.copy()
    for candidate, beta in held:
        name, index = candidate.effect.name, candidate.place.index
        if name == "torque_gain_error":
            gain[index[0]] *= 1.0 + beta[0]
        elif name == "time_delay":
            delay[list(index) if index else slice(None)] += beta[0]
        else:
            drive -= torque_of(candidate.raw_columns(motion), beta, torque.shape)
    drive /= gain
    for i in np.flatnonzero(delay):
        drive[:, i : i + 1] = delayed(drive[:, i : i + 1], motion.rate, -delay[i])
    return drive
