"""Candidates: effects at a place with a shape, and what a motion is once some of them are known."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from .body_effects import spring_powers
from .cable_effects import is_felt_by_joint
from .effect import Columns, Effect, Place, Shape, speed_along, unbounded
from .effect_shapes import sign_width
from .effects import CATALOGUE, DRAGS, SHARING
from .friction_effects import PAUSES, PRESLIDING, Presliding, creeping, sign_transitions
from .geometry import Vector
from .model import CableModel
from .motion import Motion
from .places import is_whole_cable, kinds_of, motor_joint_places, paired, parallel, rub_places, twin_places

SWUNG = 0.01
"""Share that the law of a soft cable may be wrong by, where the links' swing on it is integrated."""


class Identity(NamedTuple):
    """What tells the columns of one candidate from those of another, and whether they change with the model."""

    key: tuple[str, str]
    shape: Shape
    detail: float
    creeps: bool
    gives: float
    hangs_on_torques: bool


@dataclass(frozen=True)
class Candidate:
    """An effect at a place with given nonlinear parameters.

    Attributes
    ----------
    effect : Effect
    place : Place
    shape : tuple of float
    detail : float
        Where it is not zero, a few free columns more, on this scale, say what the law leaves open (`Effect.detail`).
    creeps : bool
        Whether friction before and after standstills, which encoders do not show, is among that.
    gives : float
        What the distances within which friction gives before it slides are multiplied by; zero where it gives nothing.
    """

    effect: Effect
    place: Place
    shape: Shape = ()
    detail: float = 0.0
    creeps: bool = False
    gives: float = 0.0

    @cached_property
    def key(self) -> tuple[str, str]:
        """Effect and place, whatever the shape."""
        return self.effect.name, str(sorted(self.place.location.items()))

    def clashes(self, other: Candidate) -> bool:
        """Whether the two are one effect at one place, so that one says it all; pushes may come at two times.

        They are two where more time passes between them than the shorter one takes: what is left beside one that
        swells and fades is no other.
        """
        if self.key != other.key or self.effect.name != "external_torque":
            return self.key == other.key
        (start, end, run), (first, last, there) = self.shape[:3], other.shape[:3]
        return run == there and max(start, first) - min(end, last) < min(end - start, last - first)

    @cached_property
    def identity(self) -> Identity:
        """Effect, place, shape, what is left open, and whether its columns change with the model's torques."""
        return Identity(self.key, self.shape, self.detail, self.creeps, self.gives, self.hangs_on_torques)

    def admissible(self, beta: Vector) -> Vector:
        """Give the coefficients with which a soft cable can be integrated; others as they are."""
        if self.effect.name != "cable_elasticity":
            return beta
        return np.array([beta[0], *np.maximum(beta[1:], 0.0)])

    @property
    def hangs_on_torques(self) -> bool:
        """Whether its columns depend on the torques of the body or of other effects."""
        return self.effect.follows or self.effect.weighs or self.remembers_tension

    @property
    def remembers_tension(self) -> bool:
        """Whether it is a hysteresis whose memory is in a cable's torque, not in an angle."""
        return self.effect.name == "hysteresis" and is_whole_cable(self.place.location)

    @cached_property
    def _here(self) -> tuple[Place, Shape]:
        return paired(self.place, self.shape)

    def columns(self, motion: Motion) -> Columns:
        """Columns on one motion; what acts on joints that swing on a soft cable, as it comes through to the motors."""
        swing = motion.swing
        if swing is None:
            return self.raw_columns(motion)
        if self.is_swinging(motion):
            return Columns(swing.compliant)
        columns = self.raw_columns(motion)
        if columns.torque is not None and self.effect.carried:
            return Columns(passed(columns.torque, motion))
        if columns.along is not None and any(self._here[0].A):
            series, w = columns.along
            own = motion.model.joint_from_motor.T @ np.array(self._here[0].A)
            torque = series.T[:, None, :] * own[:, None]
            return Columns(passed(torque, motion) + series.T[:, None, :] * (w - own)[:, None])
        return columns

    def is_swinging(self, motion: Motion) -> bool:
        """Whether this is the soft cable, or the one with play, on which the links swing in a motion."""
        swing = motion.swing
        if swing is None or not (self.rattles if swing.half_gap else self.effect.name == "cable_elasticity"):
            return False
        return self.place.index[0] == swing.cable

    @property
    def rattles(self) -> bool:
        """Whether it is a play whose links' motion is integrated, beyond it with a contact's stiffness (in `shape`)."""
        return self.effect.name == "backlash" and len(self.shape) > 1

    def law_error(self, motion: Motion) -> float:
        """Share of itself that the law may be wrong by on a motion: less where the links swing on its cable."""
        return SWUNG if self.is_swinging(motion) and not self.rattles else self.effect.error

    def raw_columns(self, motion: Motion) -> Columns:
        """Columns on one motion, as torques act where they act."""
        if self.is_swinging(motion):
            return Columns(np.zeros((motion.n, motion.model.n_motors, 1 if self.rattles else 2)))
        columns = self.effect.columns(motion, *self._here)
        if self.rattles and columns.torque is not None:  # where nothing is integrated
            return Columns(columns.torque[..., :1])
        if not self.detail or columns.along is None or self.effect.detail is None:
            return columns
        series, w = columns.along
        own = self.effect.detail(motion, *self._here, self.detail)
        if self.creeps:
            own = [*own, creeping(speed_along(motion, self._here[0]), self.detail, motion.rate)]
        if self.gives:
            own = [*own, *(sliding[0] - series[0] for sliding in self._slidings(motion, self.detail))]
        return Columns(along=(np.vstack([series, *own]), w))

    def _slidings(self, motion: Motion, width: float) -> list[Vector]:
        """Give the law's series if friction gives before it slides, for some distances; `width` of its sign."""
        place, shape = self._here
        distances = [Presliding(f * (self.gives or 1.0) * width) for f in PRESLIDING]
        columns = [self.effect.columns(motion, place, (distance, *shape[1:])) for distance in distances]
        return [own.along[0] for own in columns if own.along is not None]

    def bounds(self, motions: Sequence[Motion]) -> list[tuple[float, float]]:
        """Give (lower, upper) of those elements of the shape that are estimated."""
        return self.effect.bounds(motions, self.place) + ([(-3.0, 3.0)] if self.place.is_pair else [])

    def detailed(self, motions: Sequence[Motion]) -> Candidate:
        """Free what the law leaves open, where it leaves anything open."""
        if self.effect.detail is None or self.detail or not self.named:
            return self
        if not self.effect.nuisance_shape:
            return replace(self, detail=1.0)
        width, dry = sign_width(motions, self.place), self.effect.detail is sign_transitions
        return replace(self, detail=width, creeps=dry and self._rests(motions, width), gives=float(dry))

    @cached_property
    def signs(self) -> tuple[int, ...]:
        """Signs that its coefficients must have, 0 where any will do."""
        return self.effect.signs if self.effect.signed(self.shape) else (0,) * len(self.effect.signs)

    def meets(self, other: Candidate) -> bool:
        """Whether it and another act along coordinates that share a joint or a motor."""
        x, y = (np.abs(np.array(c.place.A + c.place.B)) for c in (self, other))
        return bool(len(x) and len(y) and x @ y > 1e-9)

    def is_plausible(self, beta: Vector, beside: Sequence[Candidate] = ()) -> bool:
        """Whether coefficients are such as its law may have; dry friction `beside` it, at its place, has its own share.

        Not so a peak: without friction of its own, the sign of the other would only pass through zero in another way.
        """
        shared = self.effect.name in SHARING and any(c.has_doubts and self.meets(c) for c in beside)
        brakes = float(np.linalg.norm(beta[1 : self.effect.brakes])) <= beta[0] if self.effect.brakes else True
        return shared or (brakes and self.effect.plausible(beta, self.shape, self.detail))

    def least(self, motions: Sequence[Motion]) -> Vector:
        """Give weights with which the sum of its coefficients is not negative (`Effect.least`)."""
        assert self.effect.least is not None
        return self.effect.least(motions, self._here[0], self.shape)

    @property
    def leads(self) -> bool:
        """Whether of its coefficients the first alone has a sign, so that it is none where that one is negative."""
        return self.signs[:1] == (1,) and not any(self.signs[1:])

    @property
    def rubs(self) -> bool:
        """Whether it is friction of some kind along one coordinate."""
        return bool(self.place.A) and ("friction" in self.effect.name or self.effect.name == "hysteresis")

    @property
    def dry(self) -> Candidate:
        """Dry friction in its place, as wide about standstill."""
        return replace(self, effect=CATALOGUE["coulomb_friction"], shape=self.shape[:1])

    @property
    def bare(self) -> Candidate:
        """Itself without what is left open about the sign of its velocity."""
        return replace(self, detail=0.0, creeps=False, gives=0.0) if self.detail and self.has_doubts else self

    def _rests(self, motions: Sequence[Motion], width: float) -> bool:
        """Whether its coordinate stands still now and then."""
        parts = [np.abs(creeping(speed_along(m, self._here[0]), width, m.rate)) for m in motions]
        return bool(np.mean(np.concatenate(parts)) > PAUSES)

    @property
    def has_doubts(self) -> bool:
        """Whether its law turns on the sign of a velocity."""
        return bool(self.effect.nuisance_shape) and self.effect.detail is not None

    def doubts(self, motion: Motion, beta: Vector, share: float = 0.2) -> Columns:
        """Give what may be wrong about how its sign of velocity passes through zero.

        Parameters
        ----------
        motion : Motion
        beta : ndarray, shape (k,)
        share : float
            Of the torque, where nothing was left open; a quarter of it where that was (`detail`).
        """
        columns = self.raw_columns(motion)
        assert self.effect.detail is not None and columns.along is not None
        series, w = columns.along
        share *= 0.25 if self.detail else 1.0
        size = float(np.sqrt(np.mean((beta @ series[: len(beta)]) ** 2))) * share
        own = [size * x for x in self.effect.detail(motion, *self._here, self.shape[0])]
        if self.effect.detail is sign_transitions:
            k = len(self.effect.signs)
            own += [share * (beta[:k] @ (x - series[:k])) for x in self._slidings(motion, self.shape[0])]
        return Columns(along=(np.stack(own), w))

    def centred(self, beta: Vector) -> Candidate:
        """Take the columns about coefficients, where these are known to be others than so far (`Effect.centre`)."""
        if self.effect.centre is None:
            return self
        shape = self.effect.centre(beta)
        return self if np.allclose(shape, self.shape, rtol=1e-3, atol=0.0) else replace(self, shape=shape)

    def left_open(self, motion: Motion, beta: Vector) -> Columns:
        """Give what else it may bring on a motion (`Effect.leaves_open`)."""
        assert self.effect.leaves_open is not None
        return self.effect.leaves_open(motion, *self._here, beta)

    def revealed(self, motion: Motion, changes: Vector, beta: Vector) -> Columns:
        """Give what changes of the standard parameters bring on a motion beside it (`Effect.reveals`)."""
        assert self.effect.reveals is not None
        return self.effect.reveals(motion, changes, beta)

    @property
    def name(self) -> str:
        """What a diagnosis calls it: a motor that turns with a joint with which it should not is coupled to it."""
        coupled = self.effect.name == "transmission_ratio_error" and self.place.location["kind"] == "motor"
        return "transmission_coupling" if coupled else self.effect.name

    def parameters_said(self, model: CableModel, values: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        """Give parameters as a diagnosis says them: of a coupling the ratio of the motor's speed to the joint's."""
        if self.name == self.effect.name:
            return values
        value, scale = values["relative_error"], 1.0 / model.arm_scale[self.place.index[0]]
        return {"ratio": value | {"value": scale * value["value"], "std": scale * value["std"]}}

    @property
    def location(self) -> dict[str, Any]:
        """Where it sits, in the words of the diagnosis format."""
        return dict(self._here[0].location)

    @property
    def loads(self) -> bool:
        """Whether its torque is part of other effects' columns (`Effect.follows`)."""
        return self.effect.carried and not self.effect.follows and self.effect.moves is None

    @property
    def named(self) -> bool:
        """Whether it is an effect of the catalogue, not an unnamed correction."""
        return self.effect.name in CATALOGUE

    @property
    def extra(self) -> int:
        """Number of nonlinear parameters that count as physics."""
        estimated = self.effect.counts and (self.effect.bounds is not unbounded or not self.named)
        own = len(self.shape) - self.place.is_pair if estimated else 0
        return max(min(own, 2 + self.effect.nuisance_shape) - self.effect.nuisance_shape, 0) + self.place.is_pair


def twins(candidate: Candidate, model: CableModel) -> list[Place]:
    """List the other places at which an effect is the same for any motion; a wrong cable map parts them."""
    return twin_places(model, candidate.place, kinds_of(candidate.effect.places, model))


def at_known_place(candidate: Candidate, model: CableModel, alike: float = 0.9995) -> Candidate:
    """Give two motors' coordinate the name of a joint, a motor or a cable where it is the same within 3 %.

    Dry friction along that of a cable on the guides of a link is the cable's.
    """
    if not candidate.place.is_pair:
        return candidate
    pair, shape = paired(candidate.place, candidate.shape)
    w, laws = np.array(pair.B), [candidate.effect]
    if candidate.effect.name == "coulomb_friction":
        laws.append(CATALOGUE["cable_friction"])
    for law, place in itertools.product(laws, rub_places(model)):
        own = place.weights(model)
        if place in law.places(model) and parallel(own, w, alike):
            scale = float(np.linalg.norm(own) / np.linalg.norm(w))
            return replace(candidate, effect=law, place=place, shape=(*(x * scale for x in shape[:1]), *shape[1:]))
    return candidate


def shares_motor(a: Candidate, other: Candidate, model: CableModel) -> bool:
    """Whether an effect acts along a coordinate that meets another's, or on a cable whose motor the other moves."""
    if a.place.A:
        return a.meets(other)
    motor = list(a.place.index[:1])
    if other.place.A:
        return bool(np.any(np.abs(other.place.weights(model)[motor]) > 1e-9))
    return bool(motor) and motor == list(other.place.index[:1])


def coupled_alike(model: CableModel, candidate: Candidate) -> list[dict[str, Any]]:
    """List the motors and joints whose coupling, at a ratio of its own, is the same combination of motors.

    Friction between two motors is a coupling without inertia.
    """
    E, eye, own = model.joint_from_motor, np.eye(model.n_motors), None
    if candidate.effect.name == "transmission_coupling":
        if not is_felt_by_joint(candidate.shape):
            return []
        own = candidate.place.index
        w = eye[own[0]] + candidate.shape[1] * E[own[1]]
    elif candidate.effect.name in ("coulomb_friction", "viscous_friction") and candidate.place.is_pair:
        w = np.array(paired(candidate.place, candidate.shape)[0].B)
    else:
        return []
    out = []
    for place in motor_joint_places(model):
        pair = np.stack([eye[place.index[0]], E[place.index[1]]], axis=1)
        x = np.linalg.lstsq(pair, w, rcond=1e-9)[0]
        alike = np.linalg.norm(pair @ x - w) < 1e-6 * np.linalg.norm(w)
        if alike and place.index != own and 0.0 < abs(x[1]) <= 1.5 * abs(x[0]):
            out.append(place.location)
    return out


def passed(torque: Vector, motion: Motion) -> Vector:
    """Pass on torques that load the cables, shape (n, n_motors, k), where the links swing on one of them."""
    if motion.swing is None:
        return torque
    return np.stack([motion.swing.through(torque[..., k]) for k in range(torque.shape[2])], axis=-1)


def torque_of(columns: Columns, beta: Vector, shape: tuple[int, ...]) -> Vector:
    """Give the motors' torque of columns with coefficients, shape (n, n_motors) [N m]."""
    if columns.along is not None:
        series, w = columns.along
        k = min(len(beta), len(series))
        return np.outer(beta[:k] @ series[:k], w)
    if columns.torque is not None:
        k = min(len(beta), columns.torque.shape[2])
        return np.asarray(columns.torque[..., :k] @ beta[:k])
    return np.zeros(shape)


def loaded(motion: Motion, effects: Sequence[tuple[Candidate, Vector]], *, swings: bool = True) -> Motion:
    """Give the motion with the torques that effects bring, for those other effects that depend on them.

    Where only motors are measured and a cable is soft, the links swing on it, unless `swings` forbids it.
    """
    if motion.swing is not None:
        motion = replace(motion.swing.still, model=motion.model)
    motion = _loaded(motion, effects)
    soft = [(c, c.admissible(b)) for c, b in effects if c.effect.name == "cable_elasticity" and b[0] > 0.0]
    soft = [(c, b) for c, b in effects if c.rattles and b[0] > 0.0] or soft
    if motion.felt is None or not soft or not swings:
        return motion
    from .swing import rattling, swung

    candidate, beta = max(soft, key=lambda item: float(item[1][0]))
    cable = candidate.place.index[0]
    carried = motion.driven_torque - motion.tau_m
    if motion.extra_driven is not None:
        carried = carried + motion.extra_driven
    if candidate.rattles:
        moved = rattling(motion, cable, candidate.shape[1], float(beta[0]), carried)
    else:
        moved = swung(motion, cable, 1.0 / beta[0], float(beta[1] / beta[0] ** 2), carried)
    return motion if moved.swing is None else _loaded(moved, effects)


def _speed_powers(drag: Candidate, beta: Vector) -> tuple[float, float]:
    """Give the coefficients of known drag of the speed and of that times its magnitude."""
    linear = drag.effect.name == "viscous_friction"
    return float(beta[0]) * linear, float(beta[0]) * (not linear)


def _loaded(motion: Motion, effects: Sequence[tuple[Candidate, Vector]]) -> Motion:
    springs = tuple(
        (np.array(c.place.A), spring_powers(beta)) for c, beta in effects if c.effect.name == "joint_spring"
    )
    drags = [(c._here[0], *_speed_powers(c, beta)) for c, beta in effects if c.effect.name in DRAGS]
    at_joints = tuple((np.array(place.A), *powers) for place, *powers in drags if any(place.A))
    at_motors = tuple((np.array(place.B), *powers) for place, *powers in drags if any(place.B))
    blank: dict[str, Any] = {"offset": None, "tilt": None, "extra_driven": None, "shift": None, "map_errors": ()}
    blank |= {"extra_logged": None, "gains": 1.0}
    motion = replace(motion.stretched(None), **blank, springs=springs, drags=at_joints, motor_drags=at_motors)
    joint, motor = np.zeros_like(motion.q), np.zeros_like(motion.q_m)
    effects = [(c, beta) for c, beta in effects if not c.rattles]  # by how far is integrated
    moving = [(c.effect.moves, c, beta) for c, beta in effects if c.effect.moves is not None]
    for moves, candidate, beta in sorted(moving, key=lambda item: item[1].effect.follows):
        motion = moves(motion, candidate.place, beta, candidate.shape)
    displaced = [torque_of(c.raw_columns(motion), beta, motor.shape) for _, c, beta in moving if not c.effect.follows]
    driven = displaced if motion.shift is None else [motion.midway.torque_change(motion.shift), *displaced]
    if driven:
        motion = replace(motion, extra_driven=np.sum(driven, axis=0))
    for candidate, beta in effects:
        if not candidate.loads:
            continue
        columns = candidate.raw_columns(motion)
        if columns.along is not None:
            f = beta @ columns.along[0][: len(beta)]
            if candidate.place.A and any(candidate.place.A):
                joint += f[:, None] * np.array(candidate.place.A)
                motor += f[:, None] * np.array(candidate.place.B)
            else:
                motor += f[:, None] * columns.along[1]
        else:
            motor += torque_of(columns, beta, motor.shape)
    motion = replace(motion, extra_joint=joint, extra_motor=motor)
    following = [(c, beta) for c, beta in effects if c.effect.carried and c.effect.follows]
    logged = displaced + [torque_of(c.raw_columns(motion), beta, motor.shape) for c, beta in following]
    return replace(motion, extra_logged=np.sum(logged, axis=0)) if logged else motion
