"""The catalogue of physics that a rigid-body model leaves out: one entry per effect, all of them at the end.

An entry says where the effect can sit, which columns it adds to the inverse dynamics for given nonlinear parameters
(`shape`), which signs its coefficients must have, and how coefficients and shape become its physical parameters.
To add an effect, add one `Effect` to `CATALOGUE`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numba
import numpy as np
from scipy.ndimage import correlate1d
from scipy.spatial.transform import Rotation

from .geometry import Vector
from .model import CableModel
from .motion import Motion, derivatives

Shape = tuple[float, ...]


@dataclass(frozen=True)
class Columns:
    """Columns of one effect, per unit of each coefficient.

    Attributes
    ----------
    torque : ndarray, shape (n, n_motors, k) or None
        Added to the motor torques.
    along : (ndarray, shape (k, n); ndarray, shape (n_motors,)) or None
        Instead of `torque` where all motors see the same series, each with its weight.
    kinematic : ndarray, shape (n, n_motors, k) or None
        Added to x_i = (r_m/r_j) q_m,i - sum of the joints before and at i, where both sides are measured.
    """

    torque: Vector | None = None
    kinematic: Vector | None = None
    along: tuple[Vector, Vector] | None = None


@dataclass(frozen=True)
class Place:
    """Where an effect sits: the coordinate s = A q + B q_m it acts along, and what this place is called.

    Attributes
    ----------
    location : dict
        In the words of the diagnosis format.
    A, B : tuple of float
        Weights over joints and motors; a torque f along s adds A f to the joints and B f to the motors.
    index : tuple of int
        Zero-based numbers that the effect's functions need.
    aliases : tuple of dict
        Other locations that are the same coordinate on this robot.
    """

    location: dict[str, Any]
    A: Shape = ()
    B: Shape = ()
    index: tuple[int, ...] = ()
    aliases: tuple[dict[str, Any], ...] = ()

    @property
    def is_pair(self) -> bool:
        """Whether it stands for two motors at a ratio of speeds that is still to be told (`pair_places`)."""
        return self.location.get("kind") == "combination" and "weights" not in self.location

    def along(self, joints: Vector, motors: Vector) -> Vector:
        """Give A x + B x_m along a motion, shape (n,)."""
        return joints @ np.array(self.A) + motors @ np.array(self.B)

    def weights(self, model: CableModel) -> Vector:
        """Give w of tau_m = w f(w' v_m), shape (n_motors,)."""
        return model.joint_from_motor.T @ np.array(self.A) + np.array(self.B)


@dataclass(frozen=True)
class Parameter:
    """A physical parameter: name, unit, admissible range.

    Attributes
    ----------
    error, error_unseen : float
        Share of itself that it may be wrong by because its law is: with the cable's travel measured, and without.
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf
    error: float = 0.0
    error_unseen: float = 0.0


def _unbounded(motions: Sequence[Motion], place: Place) -> list[tuple[float, float]]:
    """Give no bounds: nothing of the shape is estimated."""
    return []


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue.

    Attributes
    ----------
    name : str
    parameters : tuple of Parameter
    places : callable
        Model -> places.
    columns : callable
        Motion, place, shape -> `Columns`.
    grid : callable
        Motions, place -> coarse list of shapes to screen.
    bounds : callable
        Motions, place -> (lower, upper) per element of the shape, for its estimation.
    signs : tuple of int
        Per coefficient +1 (never negative) or 0 (free).
    physical : callable
        Coefficients, shape -> parameter values.
    exact : bool
        Whether the columns are exact or to first order in the effect.
    detail : callable, optional
        Motion, place, shape, scale -> series that no law fixes: how a sign of velocity passes through zero (what
        encoder steps, filters and standstill make of it), or how the elements of a hysteresis are spread.
    follows : bool
        Whether the columns depend on the torques that other effects bring.
    weighs : bool
        Whether the columns depend on the robot's inertial parameters.
    moves : callable, optional
        Motion, place, coefficients, shape -> the motion about which first-order columns are exact for these.
    carried : bool
        Whether the drive carries the effect's torque; what the logger adds it does not.
    errors : callable
        Place, shape -> further shares of themselves that parameters may be wrong by, besides `Parameter.error`.
    error : float
        Share of itself that the law may be wrong by; what else is found at the same time has to be larger. How a sign
        of velocity passes through zero is counted apart (`Candidate.doubts`).
    signed : callable
        Shape -> whether the signs hold; by default always.
    plausible : callable
        Coefficients, shape, scale of the detail -> whether they are such as the law may have.
    brakes : int
        How many leading coefficients make friction that brakes both ways and everywhere: the first is no less than the
        norm of the others, as what drives is none. Zero for other laws.
    least : callable, optional
        Motions, place, shape -> weights of the coefficients with which their sum is not negative, as far as is sure.
    leaves_open : callable, optional
        Motion, place, shape, coefficients -> what else it may bring, from torques of which its law may or may not
        speak.
    centre : callable, optional
        Coefficients -> the shape about which columns to first order are exact for them.
    reveals : callable, optional
        Motion, changes of the standard parameters, coefficients -> what these bring beside it and not without it.
    exact_travel : bool
        Whether the kinematic column is exact where the torque's is not.
    confounded : tuple of str
        Effects it is easily taken for.
    revealed_by : str
        The experiment that shows it.
    reference : str
    """

    name: str
    parameters: tuple[Parameter, ...]
    places: Callable[[CableModel], list[Place]]
    columns: Callable[[Motion, Place, Shape], Columns]
    physical: Callable[[Vector, Shape], dict[str, float]]
    grid: Callable[[Sequence[Motion], Place], list[Shape]] = lambda motions, place: [()]
    bounds: Callable[[Sequence[Motion], Place], list[tuple[float, float]]] = _unbounded
    signs: tuple[int, ...] = (0,)
    exact: bool = True
    exact_travel: bool = False
    follows: bool = False
    weighs: bool = False
    moves: Callable[[Motion, Place, Vector, Shape], Motion] | None = None
    carried: bool = True
    errors: Callable[[Place, Shape], dict[str, float]] = lambda place, shape: {}
    error: float = 0.01
    signed: Callable[[Shape], bool] = lambda shape: True
    plausible: Callable[[Vector, Shape, float], bool] = lambda beta, shape, detail: True
    brakes: int = 0
    least: Callable[[Sequence[Motion], Place, Shape], Vector] | None = None
    leaves_open: Callable[[Motion, Place, Shape, Vector], Columns] | None = None
    centre: Callable[[Vector], Shape] | None = None
    reveals: Callable[[Motion, Vector, Vector], Columns] | None = None
    detail: Callable[[Motion, Place, Shape, float], list[Vector]] | None = None
    confounded: tuple[str, ...] = ()
    revealed_by: str = ""
    reference: str = ""
    nuisance_shape: int = field(default=0)  # leading elements of the shape that are smoothing, not physics
    counts: bool = True  # whether its shape counts as parameters beside its coefficients
    sized_by: str = ""  # the parameter that its first coefficient is, if not the first one
    reach: float = 0.35  # share of the (logarithmic) range of a shape that one estimate may move through
    inverse: Callable[[dict[str, float]], tuple[list[float], list[float]]] | None = None  # of `physical`

    @property
    def size(self) -> Parameter:
        """What its first coefficient is; of a gain what it is off by, of a stiffness its inverse, of slack neither."""
        return {p.name: p for p in self.parameters}[self.sized_by or self.parameters[0].name]

    def coefficients(self, parameters: dict[str, float]) -> tuple[Vector, Shape]:
        """Turn physical parameters (and the `width` of a smooth sign, in rad/s or N m) into coefficients and shape."""
        if self.inverse is None:
            beta, shape = [float(parameters.get(p.name, 0.0)) for p in self.parameters], []
        else:
            beta, shape = self.inverse(parameters)
        width = [float(parameters.get("width", 0.01))] * self.nuisance_shape
        return np.array(beta), (*width, *map(float, shape))


# ---------------------------------------------------------------------------------------------------- places


def _unit(n: int, i: int) -> Shape:
    return tuple(float(k == i) for k in range(n))


def joint_places(model: CableModel) -> list[Place]:
    """Every joint that is a coordinate of its own; what turns with it by a constant ratio of one is an alias.

    On the paper's arm motor 1 is an alias of joint 1; on a robot with parallelograms many joints are one coordinate.
    """
    nj, nm = model.n_joints, model.n_motors
    rows = model.joint_from_motor
    places: list[Place] = []
    for i in range(nj):
        aliases: list[dict[str, Any]] = []
        moving = np.flatnonzero(np.abs(rows[i]) > 1e-12)
        if len(moving) == 1 and abs(rows[i, moving[0]] - 1) < 1e-9:
            aliases.append({"kind": "motor", "index": int(moving[0]) + 1})
        if model.manipulator.links:
            aliases.append({"kind": "cable", "index": i + 1, "link": i})
        elif any(parallel(rows[i], rows[place.index[0]]) for place in places):
            continue
        places.append(Place({"kind": "joint", "index": i + 1}, _unit(nj, i), (0.0,) * nm, (i,), tuple(aliases)))
    return places


def parallel(a: Vector, b: Vector, least: float = 1 - 1e-9) -> bool:
    """Whether the cosine between two directions, of either sign, is more than `least`."""
    return bool(abs(a @ b) > least * np.linalg.norm(a) * np.linalg.norm(b))


def motor_places(model: CableModel) -> list[Place]:
    """Every motor that is not the same coordinate as a joint."""
    joints = joint_places(model)
    taken = {alias["index"] for place in joints for alias in place.aliases if alias["kind"] == "motor"}
    if not model.manipulator.links:
        own = model.joint_from_motor[[place.index[0] for place in joints]]
        taken |= {i + 1 for i in range(model.n_motors) if any(parallel(np.eye(model.n_motors)[i], row) for row in own)}
    return [place for place in all_motor_places(model) if place.location["index"] not in taken]


def all_motor_places(model: CableModel) -> list[Place]:
    """Every motor."""
    nj, nm = model.n_joints, model.n_motors
    aliases = [({"kind": "cable", "index": i + 1, "link": 0},) if model.manipulator.links else () for i in range(nm)]
    return [Place({"kind": "motor", "index": i + 1}, (0.0,) * nj, _unit(nm, i), (i,), aliases[i]) for i in range(nm)]


def twin_places(model: CableModel, place: Place) -> list[Place]:
    """Other joints and motors that turn with a place at a constant ratio; a wrong cable map parts them."""
    if not len(place.A) or place.is_pair:
        return []
    own = place.weights(model)
    sides = joint_places(model) if any(place.B) else all_motor_places(model)
    return [other for other in sides if parallel(other.weights(model), own)]


def guide_places(model: CableModel) -> list[Place]:
    """Cable i on guides of link k, for the links that are not the same coordinate as a joint or a motor."""
    nj, nm = model.n_joints, model.n_motors
    pulleys = model.manipulator.pulleys
    if pulleys is None:
        return []
    places = []
    for i in range(nm):
        for k in range(1, i):
            A = -1.0 * (np.arange(nj) < k) * pulleys.joint_pulley_radius / pulleys.joint_pulley_radius[i]
            B = np.eye(nm)[i] * pulleys.motor_pulley_radius[i] / pulleys.joint_pulley_radius[i]
            location = {"kind": "cable", "index": i + 1, "link": k}
            places.append(Place(location, tuple(A), tuple(B), (i, k)))
    return places


def axis_places(model: CableModel) -> list[Place]:
    """Every joint and every motor."""
    return joint_places(model) + motor_places(model)


def bearing_places(model: CableModel) -> list[Place]:
    """Every joint and every motor, told apart where they turn alike but carry different torques.

    Motor 1 of the paper's arm turns with joint 1, but the cables of the others hang on that joint as well.
    """
    alone = np.count_nonzero(np.abs(model.joint_from_motor) > 1e-12, axis=0) == 1

    def is_same(alias: dict[str, Any]) -> bool:
        return alias["kind"] != "motor" or bool(alone[alias["index"] - 1])

    joints = [
        replace(place, aliases=tuple(alias for alias in place.aliases if is_same(alias)))
        for place in joint_places(model)
    ]
    taken = {place.location["index"] for place in motor_places(model)} | set(np.flatnonzero(~alone) + 1)
    return joints + [place for place in all_motor_places(model) if place.location["index"] in taken]


def rub_places(model: CableModel) -> list[Place]:
    """Everywhere parts slide on each other along one coordinate: joints, motors, cables on guides."""
    return axis_places(model) + guide_places(model)


def pair_places(model: CableModel) -> list[Place]:
    """Every two motors whose parts may rub on each other, at a ratio of speeds that the shape tells."""
    nj, nm = model.n_joints, model.n_motors
    return [
        Place(
            {"kind": "combination", "index": i + 1, "other": k + 1},
            (0.0,) * nj,
            tuple(np.eye(nm)[i] + np.eye(nm)[k]),
            (i, k),
        )
        for k in range(nm)
        for i in range(k)
    ]


def tension_places(model: CableModel) -> list[Place]:
    """Every cable pair, as what remembers the torque that it carried; its motor feels what it does."""
    nj, nm = model.n_joints, model.n_motors
    return [
        Place({"kind": "cable", "index": i + 1}, (0.0,) * nj, tuple(np.eye(nm)[i] * model.arm_scale[i]), (i,))
        for i in range(nm)
    ]


def is_whole_cable(location: Mapping[str, Any]) -> bool:
    """Whether a place is a cable pair as a whole, not where it passes a link; a hysteresis there is one of tension."""
    return location["kind"] == "cable" and "link" not in location


def base_places(model: CableModel) -> list[Place]:
    """Give the base alone, where there is gravity."""
    return [Place({"kind": "base"})] if np.linalg.norm(model.chain.gravity) > 0 else []


def cable_places(model: CableModel) -> list[Place]:
    """Every cable pair."""
    return [Place({"kind": "cable", "index": i + 1}, index=(i,)) for i in range(model.n_motors)]


def cable_joint_places(model: CableModel) -> list[Place]:
    """Every cable at every joint that it passes, and the motors at those joints with which they should not turn.

    By E alone a cable may pass any joint.
    """
    by_map = not model.manipulator.links
    passes = by_map | (np.abs(model.motor_from_joint) > 1e-12)
    return [
        Place({"kind": "cable" if passes[i, k] else "motor", "index": i + 1, "joint": k + 1}, index=(i, k))
        for i in range(model.n_motors)
        for k in range(model.n_joints)
    ]


def own_joint_places(model: CableModel) -> list[Place]:
    """Give the joint that each cable drives."""
    n = min(model.n_joints, model.n_motors)
    return [Place({"kind": "joint", "index": i + 1}, index=(i, i)) for i in range(n)]


def delay_places(model: CableModel) -> list[Place]:
    """Give the whole logger, and every motor alone."""
    motors = [Place({"kind": "motor", "index": i + 1}, index=(i,)) for i in range(model.n_motors)]
    return [Place({"kind": "system"}), *motors] if model.n_motors > 1 else [Place({"kind": "system"})]


# ---------------------------------------------------------------------------------------------------- shapes


def speed_scale(motions: Sequence[Motion], place: Place) -> float:
    """Root mean square speed along the place's coordinate."""
    return float(np.sqrt(np.mean(np.concatenate([place.along(m.v, m.v_m) ** 2 for m in motions])))) or 1.0


def reach(motions: Sequence[Motion], place: Place) -> float:
    """Range of positions along the place's coordinate."""
    s = np.concatenate([place.along(m.q, m.q_m) for m in motions])
    return float(np.ptp(s)) or 1.0


def sign_width(motions: Sequence[Motion], place: Place) -> float:
    """Width of the smooth sign of velocity to start from: the speed's own uncertainty, at least 2 % of its scale."""
    noise = max(float(np.abs(place.weights(m.model)) @ m.velocity_noise) for m in motions)
    return max(2 * noise, 0.02 * speed_scale(motions, place))


def _narrowest(motions: Sequence[Motion], place: Place) -> float:
    """Width of the narrowest peak of friction that the sign of velocity, as far as it is known, does not hide."""
    return max(0.03 * speed_scale(motions, place), 2.5 * sign_width(motions, place))


def _peak_widths(motions: Sequence[Motion], place: Place) -> Vector:
    return np.maximum(speed_scale(motions, place) * np.array([0.08, 0.2, 0.5]), _narrowest(motions, place))


def _width_grid(motions: Sequence[Motion], place: Place) -> list[Shape]:
    return [(sign_width(motions, place),)]


def _width_bounds(motions: Sequence[Motion], place: Place) -> list[tuple[float, float]]:
    w = sign_width(motions, place)
    return [(0.1 * w, 8 * w)]


def _grid(*values: Callable[[Sequence[Motion], Place], Any]):
    def grid(motions: Sequence[Motion], place: Place) -> list[Shape]:
        shapes: list[Shape] = [()]
        for value in values:
            shapes = [(*shape, float(x)) for shape in shapes for x in value(motions, place)]
        return shapes

    return grid


def _one_width(motions: Sequence[Motion], place: Place) -> list[float]:
    return [sign_width(motions, place)]


def _bounds(*pairs: Callable[[Sequence[Motion], Place], tuple[float, float]]):
    return lambda motions, place: _width_bounds(motions, place) + [pair(motions, place) for pair in pairs]


# ---------------------------------------------------------------------------------------------------- columns


def _rub(motion: Motion, place: Place, *series: Vector) -> Columns:
    """Columns of torques f along the place's coordinate."""
    return Columns(along=(np.stack(series), place.weights(motion.model)))


def _speed(motion: Motion, place: Place) -> Vector:
    """Give the speed by all that is known; of smooth laws, what known shifts change is in `Motion.drag_change`."""
    return place.along(motion.joint_speeds, motion.v_m)


def _position(motion: Motion, place: Place) -> Vector:
    return place.along(motion.q, motion.q_m)


class Presliding(float):
    """Distance within which dry friction gives before it slides, in the place of the width of a sign [rad]."""


PRESLIDING = (0.02, 0.1)
"""Distances within which dry friction may give before it slides, over the width of its sign [s]."""
GIVES = (1 / 64, 4.0)
"""Least and largest multiple of these distances."""


def _sign(motion: Motion, place: Place, shape: Shape) -> Vector:
    if isinstance(shape[0], Presliding):
        band = motion.position_error(np.array(place.A), np.array(place.B))
        return dahl(dragged(_position(motion, place), band), shape[0])
    return np.tanh(_speed(motion, place) / shape[0])


def _transition(motion: Motion, place: Place, shape: Shape, scale: float) -> list[Vector]:
    return transitions(_speed(motion, place), scale)


CREEP = 0.02
"""Time [s] for which a position may creep within a step of its encoder before and after a standstill."""
RESTS = 0.2
"""Share of the sign's width below which a velocity is that of a rest; one that passes through zero is there briefly."""
PAUSES = 0.01
"""Share of the time just before and after standstills from which on these count."""


def creeping(v: Vector, scale: float, rate: float) -> Vector:
    """Give the sign of velocity that comes before a standstill or after it, for a short time.

    Friction is there while positions creep within a step of their encoder, which shows them at rest. Where the velocity
    passes slowly through zero, or to the other side, it is zero.
    """
    sign, n = np.tanh(v / scale), max(round(CREEP * rate), 1)
    around = np.pad(sign, n, mode="edge")
    series = (1.0 - np.abs(sign)) * (around[: len(v)] + around[2 * n :])
    edges = np.diff(np.r_[False, np.abs(v) < scale, False].astype(int))
    for a, b in zip(np.flatnonzero(edges > 0), np.flatnonzero(edges < 0), strict=True):
        if b - a < 2 * n or np.mean(np.abs(v[a:b]) < RESTS * scale) < 0.5:
            series[a:b] = 0.0
    return np.where(np.abs(v) < scale, series, 0.0)


def transitions(v: Vector, scale: float) -> list[Vector]:
    """Give how a sign of velocity may pass through zero beside the smooth one, on a scale of velocity."""
    signs = [np.tanh(v / (f * scale)) for f in (0.35, 0.9, 2.0)]
    return [signs[0] - signs[1], signs[1] - signs[2]]


UNCOUPLED = 0.03
"""Ratio below which a motor that turns with a joint only turns by itself."""
PEAK = 4.0
"""How many times sliding friction breaking away may take at most; what peaks higher is the velocity's noise."""
RISEN, UNDONE = 0.05, 0.5
"""Shares by which Stribeck's friction, with all that its sign leaves open, has to rise above that of sliding, and by
which it may drive at standstill."""


def extremes(beta: Vector, shape: Shape, detail: float) -> tuple[float, float]:
    """Give the least and the most that dry or Stribeck's friction takes over sliding, with what is left open."""
    width, *peak = shape
    v = np.linspace(0.0, max([4.0 * detail, *(3.0 * x for x in peak)]), 200)
    series = [np.tanh(v / width)]
    if peak:
        series.append(series[0] * np.exp(-((v / peak[0]) ** 2)))
    if detail:
        series += transitions(v, detail)
    law = beta[: len(series)] @ series / max(beta[0], 1e-300)
    return float(law.min()), float(law.max())


def _peaks(beta: Vector, shape: Shape, detail: float) -> bool:
    """Whether friction rises towards standstill, and no more than it may."""
    least, peak = extremes(beta, shape, detail)
    return bool(least > -UNDONE and peak > 1.0 + RISEN and beta[1] <= PEAK * beta[0])


def _starts(beta: Vector, shape: Shape, detail: float) -> bool:
    """Whether friction that drifts brakes from the start on."""
    return bool(beta[0] + beta[1] >= 0.0)


STOPS = (0.3, 0.8, 2.0, 5.0)
"""Distances of the further elements of a hysteresis, over its own."""
YIELDING = 0.25
"""Least share of its elements' limits in those that have given way within a hysteresis's own distance."""


def _stops(motion: Motion, place: Place, shape: Shape, scale: float) -> list[Vector]:
    x = remembered(motion, place)
    return [maxwell(x, f * scale * shape[0], 1.0) for f in STOPS]


def _yields(beta: Vector, shape: Shape, detail: float) -> bool:
    """Whether a good part of a hysteresis yields within its own distance; what only gives way later is a spring."""
    early = beta[0] + sum(b for b, share in zip(beta[1:], STOPS, strict=False) if share < 1.0)
    return bool(early >= YIELDING * beta.sum())


def remembered(motion: Motion, place: Place) -> Vector:
    """Give what a hysteresis remembers: the position of its coordinate [rad], or the torque of its cable [N m]."""
    if is_whole_cable(place.location):
        return motion.clear_torque[:, place.index[0]]
    return _position(motion, place)


def _viscous(motion: Motion, place: Place, shape: Shape) -> Columns:
    return _rub(motion, place, place.along(motion.v, motion.motor_speeds))


def _coulomb(motion: Motion, place: Place, shape: Shape) -> Columns:
    return _rub(motion, place, _sign(motion, place, shape))


def _stribeck(motion: Motion, place: Place, shape: Shape) -> Columns:
    s = _sign(motion, place, shape)
    return _rub(motion, place, s, s * np.exp(-((_speed(motion, place) / shape[1]) ** 2)))


def _asymmetric(motion: Motion, place: Place, shape: Shape) -> Columns:
    s = _sign(motion, place, shape)
    return _rub(motion, place, s, np.ones(motion.n))


def _drag(motion: Motion, place: Place, shape: Shape) -> Columns:
    v = place.along(motion.v, motion.motor_speeds)
    return _rub(motion, place, v * np.abs(v))


def _load(motion: Motion, place: Place, shape: Shape) -> Columns:
    return _rub(motion, place, motion.hinge_force[:, place.index[0]] * _sign(motion, place, shape))


def _torque(motion: Motion, place: Place, shape: Shape) -> Columns:
    tau = motion.tau if any(place.A) else motion.tau_m
    return _rub(motion, place, np.abs(tau[:, place.index[0]]) * _sign(motion, place, shape))


def _other_torques(motion: Motion, place: Place, shape: Shape, beta: Vector) -> Columns:
    """Give what friction by torque brings if it follows the rotor's torque, or that of other effects, too.

    Where its own torque is in the motion, that counts with these.
    """
    i = place.index[0]
    if any(place.A):
        own = motion.tau[:, i]
        others = [own] if motion.extra_joint is None else [own + motion.extra_joint[:, i]]
    else:
        own = motion.tau_m[:, i]
        others = [motion.driven_torque[:, i], own + motion.a_m[:, i] * motion.model.rotor_inertia[i]]
    size = beta[0] * _sign(motion, place, shape)
    return _rub(motion, place, *((np.abs(other) - np.abs(own)) * size for other in others))


def _by_position(motion: Motion, place: Place, shape: Shape) -> Columns:
    s, x = _sign(motion, place, shape), shape[1] * _position(motion, place)
    return _rub(motion, place, s, s * np.sin(x), s * np.cos(x))


def _capstan(motion: Motion, place: Place, shape: Shape) -> Columns:
    i, k = place.index
    pulleys = motion.model.manipulator.pulleys
    assert pulleys is not None
    r = pulleys.joint_pulley_radius[i]
    wrap = 2 * pulleys.wrap_half_angle[k]
    load = motion.cable_torque[:, i]
    pull = motion.pretension or 0.0
    f = 2 * r * pull * wrap - load * motion.q[:, k]  # at the pulley of joint i
    if not any(place.A):  # felt by the motor alone, over its own pulley
        f = f * motion.model.arm_scale[i]
    return _rub(motion, place, f * _sign(motion, place, shape))


def capstan_places(model: CableModel) -> list[Place]:
    """Cable i over the joint pulley at the end of link k: it slides there as it does on the guides of link k."""
    places = []
    for place in guide_places(model) + _outer_guides(model):
        i, k = place.index
        if k < model.n_joints:
            places.append(Place(place.location, place.A, place.B, (i, k)))
    return places


def _outer_guides(model: CableModel) -> list[Place]:
    if model.manipulator.pulleys is None:
        return []
    joints, motors = joint_places(model), all_motor_places(model)
    own = [
        Place({"kind": "cable", "index": i + 1, "link": i}, joints[i].A, joints[i].B, (i, i))
        for i in range(1, len(joints))
    ]
    base = [
        Place({"kind": "cable", "index": i + 1, "link": 0}, motors[i].A, motors[i].B, (i, 0))
        for i in range(len(motors))
    ]
    return own + base


@numba.njit(cache=True)
def dahl(x: Vector, distance: float) -> Vector:
    """Integrate dz/dx = (1 - z sign(dx)) / distance: friction over its limit, with memory of where it turned."""
    z = np.zeros(len(x))
    for k in range(1, len(x)):
        dx = x[k] - x[k - 1]
        s = 1.0 if dx > 0 else -1.0
        z[k] = s + (z[k - 1] - s) * np.exp(-abs(dx) / distance)
    return z


@numba.njit(cache=True)
def dragged(x: Vector, band: float) -> Vector:
    """Follow a position that moves by more than a band, to either side; what stays within it is taken for rest.

    Without it the errors of an encoder at standstill, to and fro, would wear a memory of where the motion came from.
    """
    out, here = np.empty(len(x)), x[0]
    for k in range(len(x)):
        here = min(max(here, x[k] - band), x[k] + band)
        out[k] = here
    return out


@numba.njit(cache=True)
def maxwell(x: Vector, distance: float, spread: float) -> Vector:
    """Sum four elastic-sliding elements that let go between distance/spread and distance*spread, over their limit."""
    total = np.zeros(len(x))
    for e in range(4):
        d = distance * spread ** ((e - 1.5) / 1.5)
        z = 0.0
        for k in range(1, len(x)):
            z = min(1.0, max(-1.0, z + (x[k] - x[k - 1]) / d))
            total[k] += 0.25 * z
    return total


def _hysteresis(motion: Motion, place: Place, shape: Shape) -> Columns:
    x = remembered(motion, place)
    z = dahl(x, shape[0]) if shape[1] < 0.5 else maxwell(x, shape[0], 1.0 + 4.0 * (shape[1] - 0.5))
    return _rub(motion, place, z)


RATIOS = (-1.8, -0.7, 0.7, 1.8)
"""Ratios of speeds of two motors that are screened."""


def paired(place: Place, shape: Shape) -> tuple[Place, Shape]:
    """Give the coordinate of two motors at the ratio of speeds that ends the shape; another place as it is.

    The larger weight is one.
    """
    if not place.is_pair:
        return place, shape
    pair = np.array([shape[-1], 1.0])
    weights = np.zeros(len(place.B))
    weights[list(place.index)] = pair / pair[np.argmax(np.abs(pair))]
    location = {"kind": "combination", "weights": [round(float(w), 4) for w in weights]}
    return replace(place, location=location, B=tuple(map(float, weights))), shape[:-1]


def at_known_place(candidate: Candidate, model: CableModel, alike: float = 0.9995) -> Candidate:
    """Give two motors' coordinate the name of a joint, a motor or a cable where it is the same within 3 %."""
    if not candidate.place.is_pair:
        return candidate
    pair, shape = paired(candidate.place, candidate.shape)
    w, possible = np.array(pair.B), candidate.effect.places(model)
    for place in rub_places(model):
        own = place.weights(model)
        if place in possible and parallel(own, w, alike):
            scale = float(np.linalg.norm(own) / np.linalg.norm(w))
            return replace(candidate, place=place, shape=(*(x * scale for x in shape[:1]), *shape[1:]))
    return candidate


def _hysteresis_grid(motions: Sequence[Motion], place: Place) -> list[Shape]:
    if is_whole_cable(place.location):
        return [(f * (greatest_load(motions, place) or 1.0), 0.0) for f in (0.1, 0.4)]
    r = reach(motions, place)
    if place.is_pair:
        return [(0.02 * r, 0.0), (0.1 * r, 0.0)]
    return [(f * r, form) for f in (0.01, 0.03, 0.1, 0.3) for form in (0.0, 0.75)]


def _hysteresis_bounds(motions: Sequence[Motion], place: Place) -> list[tuple[float, float]]:
    if is_whole_cable(place.location):
        most = greatest_load(motions, place) or 1.0
        return [(0.03 * most, 3.0 * most), (0.0, 1.0)]
    r = reach(motions, place)
    return [(0.003 * r, 1.0 * r), (0.0, 1.0)]


def _drift(motion: Motion, place: Place, shape: Shape) -> Columns:
    s = _sign(motion, place, shape)
    return _rub(motion, place, s, s * np.exp(-motion.time / shape[1]))


def _spring(motion: Motion, place: Place, shape: Shape) -> Columns:
    q = _position(motion, place)
    if not shape[0]:
        return _rub(motion, place, q, -np.ones_like(q))
    return _rub(motion, place, q, -np.ones_like(q), q**2, q**3)


def _mean_stiffness(motions: Sequence[Motion], place: Place, shape: Shape) -> Vector:
    """Give what each coefficient of a spring adds to its stiffness from one end of the motion to the other."""
    low, high = np.percentile(np.concatenate([_position(m, place) for m in motions]), [2.5, 97.5])
    powers = (1, 0, 2, 3) if shape[0] else (1, 0)
    return np.array([(high**p - low**p) / max(high - low, 1e-9) for p in powers])


def _powers(beta: Vector) -> Vector:
    """Turn the coefficients of a spring into those of powers of its angle, the lowest first."""
    return np.array([-beta[1], beta[0], *beta[2:]])


def _moved(motion: Motion, travel: Vector, i: int, torque: Vector | None) -> Columns:
    """Columns of effects that change where joint and motor stand: extra travel of cable i, seen or felt.

    Where the joints are measured the travel appears in the kinematic residual; where only the motors are, the joints
    stand elsewhere than E q_m says. `torque` is what the changed map does to the motors' torque, besides their known
    drag, which was taken at the speeds that E says.
    """
    from .signals_filters import differentiate

    n, nm = motion.n, motion.model.n_motors
    x = np.zeros((n, nm))
    x[:, i] = travel
    if motion.joints_measured:
        if torque is not None and motion.motor_drags and motion.joints_alone:
            torque = torque + motion.motor_drag_change(differentiate(x, motion.rate) / motion.model.arm_scale)
        return Columns(
            torque[..., None] if torque is not None else None, x[..., None] if motion.motors_measured else None
        )
    moved = motion.midway.torque_change(-(x / motion.model.arm_scale) @ motion.model.joint_from_motor.T)
    return Columns((moved + (torque if torque is not None else 0.0))[..., None])


def _stack(parts: Sequence[Columns]) -> Columns:
    def join(pieces: list[Vector | None]) -> Vector | None:
        known = [piece for piece in pieces if piece is not None]
        if not known:
            return None
        zero = np.zeros_like(known[0])
        return np.concatenate([zero if piece is None else piece for piece in pieces], axis=-1)

    return Columns(join([p.torque for p in parts]), join([p.kinematic for p in parts]))


def _map_torque(motion: Motion, i: int, k: int, slope: Vector | float) -> Vector:
    """Change of E' tau when cable i runs `slope` more per angle of joint k (virtual work)."""
    E = motion.model.joint_from_motor
    return -(motion.cable_torque[:, i] * slope)[:, None] * E[k]


def _entry(model: CableModel, i: int, k: int) -> float:
    """Give the entry of joint k in the map of motor i, which errors are relative to; without one, of its own joint.

    Travel of cables over pulleys counts as the angle of the link that is driven, in which each joint's entry is one.
    """
    if model.manipulator.links:
        return 1.0
    entries = model.motor_from_joint[i]
    return float(entries[k] if abs(entries[k]) > 1e-12 else entries[np.argmax(np.abs(entries))])


def _misled(motion: Motion, i: int, k: int, travel: Vector, slope: Vector | float, turn: Vector) -> Columns:
    """Columns of a cable i that runs `travel` more, `slope` per angle of joint k; `turn` is how that accelerates.

    Where the joints are measured the motor's rotor turns with it, unseen.
    """
    entry = _entry(motion.model, i, k)
    travel, slope, turn = entry * travel, entry * slope, entry * turn
    torque = _map_torque(motion, i, k, slope)
    if motion.joints_measured:
        torque[:, i] += motion.model.rotor_inertia[i] / motion.model.arm_scale[i] * turn
    return _moved(motion, travel, i, torque)


def _ratio(motion: Motion, place: Place, shape: Shape) -> Columns:
    i, k = place.index
    known = i == k or (motion.model.manipulator.links and place.location["kind"] == "cable")
    if not known and not (motion.joints_measured and motion.motors_measured):
        return Columns()  # torques alone do not tell which joints a cable passes
    return _misled(motion, i, k, motion.joint_angles[:, k], 1.0, motion.a[:, k])


def _eccentricity(motion: Motion, place: Place, shape: Shape) -> Columns:
    i, k = place.index
    q, v, a = motion.joint_angles[:, k], motion.v[:, k], motion.a[:, k]
    s, c = np.sin(q), np.cos(q)
    return _stack(
        [
            _misled(motion, i, k, s, c, c * a - s * v**2),
            _misled(motion, i, k, c - 1, -s, -s * a - c * v**2),
        ]
    )


LARGE_SLOPE = 0.4
"""An estimated error of the cable map that is larger is none: columns are not taken about it."""


def _wrong_map(travel: Callable[[Vector, Vector], tuple[Vector, Vector]]):
    """Give what a known error of the cable map does to a motion, from its travel and slope at a joint's angles."""

    def moves(motion: Motion, place: Place, beta: Vector, shape: Shape) -> Motion:
        i, k = place.index
        E, scale, entry = motion.model.joint_from_motor, motion.model.arm_scale, _entry(motion.model, i, k)
        known = np.zeros_like(motion.q) if motion.shift is None else motion.shift
        shift, own = known, np.zeros(motion.n)
        q = motion.joint_angles[:, k] - known[:, k]
        for _ in range(1 if motion.joints_measured else 4):
            own, slope = (entry * x for x in travel(q + shift[:, k], beta))
            shift = known - (own / scale[i])[:, None] * E[:, i]
        if np.abs(slope).max() > LARGE_SLOPE * abs(entry):
            return motion
        motion = replace(motion, map_errors=(*motion.map_errors, (i, k, slope)))
        if not motion.joints_measured:
            return replace(motion, shift=shift)
        return _turned(motion, i, own) if motion.joints_alone else motion

    return moves


def _elasticity(motion: Motion, place: Place, shape: Shape) -> Columns:
    return _compliant(motion, place.index[0])


def _stretch(load: Vector, slack: float) -> Vector:
    """Give by how much a cable gives to a torque per unit of compliance; twice as fast where one strand hangs."""
    return load + np.sign(load) * np.maximum(np.abs(load) - slack, 0.0)


def _stretch_slope(load: Vector, slack: float) -> Vector:
    """Differentiate `_stretch` by the torque."""
    return np.where(np.abs(load) > slack, 2.0, 1.0)


def _travels(motion: Motion, load: Vector, slack: float) -> tuple[Vector, Vector]:
    """Give by what a cable gives to its torque, per unit of compliance and of damping (`_compliant`)."""
    from .signals_filters import differentiate

    stretch = _stretch(load, slack)
    return stretch, -_stretch_slope(load, slack) * differentiate(stretch, motion.rate)


def _gives(motion: Motion, place: Place, beta: Vector, shape: Shape) -> Motion:
    """Turn a motor by what its known cable gives, where the joints alone say where it is: it rubs at its own speed."""
    if not motion.joints_alone:
        return motion
    i = place.index[0]
    return _turned(motion, i, beta[:2] @ _travels(motion, motion.clear_torque[:, i], shape[0] if shape else np.inf))


def _turned(motion: Motion, i: int, travel: Vector) -> Motion:
    """Turn motor `i` by a travel of its cable from where the joints say it is."""
    own = np.zeros_like(motion.q_m)
    own[:, i] = travel / motion.model.arm_scale[i]
    return motion.stretched(own if motion.stretch is None else motion.stretch + own)


def _compliant(motion: Motion, i: int, slack: float = np.inf) -> Columns:
    """Columns of a cable's travel per unit of compliance, and of damping in units of stiffness squared.

    Beyond the torque `slack` one strand hangs: travel grows twice as fast, and the damper takes twice the travel. Where
    the joints are measured the motor turns by the travel more than they say, and its rotor with it; of that the torque
    tells the stated inertia over the stiffness, and known drag where the motor's speed is not measured.
    """
    from .signals_filters import differentiate

    seen = _travels(motion, (motion.clear_torque if motion.joints_alone else motion.cable_torque)[:, i], slack)
    if not motion.joints_measured:
        return _stack([_moved(motion, x, i, None) for x in seen])
    slope = _stretch_slope(motion.cable_torque[:, i], slack)
    speed = differentiate(_stretch(motion.clear_torque[:, i], slack), motion.rate)
    turns = [differentiate(speed, motion.rate), -differentiate(slope * differentiate(speed, motion.rate), motion.rate)]
    rotor = np.eye(motion.model.n_motors)[i] * motion.model.rotor_inertia[i] / motion.model.arm_scale[i]
    return _stack([_moved(motion, x, i, np.outer(turn, rotor)) for x, turn in zip(seen, turns, strict=True)])


def _backlash(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Columns of a cable's travel per half of its play; motors that alone are measured may leap with less torque."""
    i, model = place.index[0], motion.model
    rotor = np.eye(model.n_motors)[i] * model.rotor_inertia[i] / model.arm_scale[i]
    if motion.joints_measured:
        side = motion.crossed_side(i, shape[0])
        seen = _moved(motion, np.tanh(motion.cable_torque[:, i] / shape[0]) if side is None else side, i, None)
        if seen.kinematic is None or not rotor.any():
            return seen
        turn = np.zeros(motion.n) if side is None else derivatives(side, motion.rate)[1]
        return _stack([seen, Columns((turn[:, None] * rotor)[..., None], np.zeros_like(seen.kinematic))])
    if motion.felt is not None:
        side = motion.felt_side(i, shape[0])
    else:
        x = np.tanh(motion.cable_torque[:, i] / shape[0])
        side = (x, *derivatives(x, motion.rate))
    along = model.joints_per_travel(i)
    d, *rates = (x[:, None] * along for x in side)
    felt = motion.midway.torque_change(d, (rates[0], rates[1]))
    leap = side[2] if motion.changes_sides(i) else np.zeros(motion.n)  # else what is left of it could be anything
    parts = [felt, np.outer(leap, -rotor)] if rotor.any() else [felt]
    return Columns(np.asarray(np.stack(parts, axis=-1), float))


def _played(motion: Motion, place: Place, beta: Vector, shape: Shape) -> Motion:
    """Move the joints by a known play to where they are, where the motors alone say so."""
    if motion.felt is None:
        return motion
    i = place.index[0]
    own = beta[0] * motion.felt_side(i, shape[0])[0][:, None] * motion.model.joints_per_travel(i)
    return replace(motion, shift=own if motion.shift is None else motion.shift + own)


def _crossing_grid(motions: Sequence[Motion], place: Place) -> list[Shape]:
    most = greatest_load(motions, place) or 1.0
    return [(share * most,) for share in (0.015, 0.005)]


def _crossing_bounds(motions: Sequence[Motion], place: Place) -> list[tuple[float, float]]:
    most = greatest_load(motions, place) or 1.0
    return [(0.001 * most, 0.03 * most)]


def _cable_run(motion: Motion, i: int) -> Vector:
    """Give how far cable i has run by its motor, beyond what the joints that it only passes take, shape (n,) [rad]."""
    passes = motion.model.motor_from_joint[i].copy()
    passes[np.argmax(np.abs(passes))] = 0.0
    return (motion.q_m[:, i] - motion.q @ passes) * motion.model.arm_scale[i]


def _lost(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Column of a cable's travel that follows where its motor turned last, per half of what is lost at a reversal."""
    if motion.torque_measured:
        return Columns()  # the torque tells on which side a cable lies
    i = place.index[0]
    return _moved(motion, maxwell(_cable_run(motion, i), shape[0], 1.0), i, None)


def _cable_range(motions: Sequence[Motion], place: Place) -> float:
    return float(np.ptp(np.concatenate([_cable_run(m, place.index[0]) for m in motions]))) or 1.0


def _slack(motion: Motion, place: Place, shape: Shape) -> Columns:
    return _compliant(motion, place.index[0], shape[0])


def greatest_load(motions: Sequence[Motion], place: Place) -> float:
    """Give the torque at its link that a cable hardly ever exceeds [N m]."""
    load = np.concatenate([m.cable_torque[:, place.index[0]] for m in motions])
    return float(np.quantile(np.abs(load), 0.99))


def _load_grid(motions: Sequence[Motion], place: Place) -> list[Shape]:
    most = greatest_load(motions, place)
    return [(share * most,) for share in (0.1, 0.25, 0.45, 0.7, 0.9) if most > 0]


def _load_bounds(motions: Sequence[Motion], place: Place) -> list[tuple[float, float]]:
    """Keep off both ends: with all loads beyond it or none, slack is elasticity."""
    most = greatest_load(motions, place)
    return [(0.05 * most, 0.95 * most)] if most > 0 else []


def _coupling_transition(motion: Motion, place: Place, shape: Shape, scale: float) -> list[Vector]:
    i, k = place.index
    return transitions(motion.v_m[:, i] + shape[1] * motion.v[:, k], scale)


def _coupling(motion: Motion, place: Place, shape: Shape) -> Columns:
    i, k = place.index
    s = motion.v_m[:, i] + shape[1] * motion.v[:, k]
    a = motion.a_m[:, i] + shape[1] * motion.a[:, k]
    w = np.eye(motion.model.n_motors)[i] + shape[1] * motion.model.joint_from_motor[k]
    return Columns(along=(np.stack([a, s, np.tanh(s / shape[0])]), w))


def motor_joint_places(model: CableModel) -> list[Place]:
    """Every motor with every joint that is not its own, on arms whose cables are known."""
    nj, nm = model.n_joints, model.n_motors
    if not model.manipulator.links:
        return []
    return [
        Place({"kind": "motor", "index": i + 1, "joint": k + 1}, (0.0,) * nj, _unit(nm, i), (i, k))
        for i in range(nm)
        for k in range(nj)
        if k != i
    ]


def coupled_alike(model: CableModel, candidate: Candidate) -> list[dict[str, Any]]:
    """List the motors and joints whose coupling, at a ratio of its own, is the same combination of motors.

    Friction between two motors is a coupling without inertia.
    """
    E, eye, own = model.joint_from_motor, np.eye(model.n_motors), None
    if candidate.effect.name == "transmission_coupling":
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


def _turns(motions: Sequence[Motion], place: Place) -> float:
    """Give by how much a coupled motor turns at most while a joint turns by one: as much as with any of its own."""
    return float(np.abs(motions[0].model.motor_from_joint[place.index[0]]).max())


def _ripple(motion: Motion, place: Place, shape: Shape) -> Columns:
    x = shape[0] * motion.q_m[:, place.index[0]]
    return _rub(motion, place, np.sin(x), np.cos(x))


def _ripple_grid(motions: Sequence[Motion], place: Place) -> list[Shape]:
    span = max(float(np.ptp(m.q_m[:, place.index[0]])) for m in motions)
    fastest = max(float(np.quantile(np.abs(m.v_m[:, place.index[0]]), 0.7)) for m in motions)
    rate = motions[0].rate
    if span < 0.05 or fastest <= 0:
        return []
    step = 1.2 / span
    highest = min(2 * np.pi * 0.1 * rate / fastest, 60.0)
    return [(float(c),) for c in np.arange(max(1.9, 2.5 * 2 * np.pi / span / 2), highest, step)]


def _rotor(motion: Motion, place: Place, shape: Shape) -> Columns:
    return _rub(motion, place, motion.a_m[:, place.index[0]])


def _gain(motion: Motion, place: Place, shape: Shape) -> Columns:
    return _rub(motion, place, motion.logged_torque[:, place.index[0]])


def _offset(motion: Motion, place: Place, shape: Shape) -> Columns:
    return _rub(motion, place, np.ones(motion.n))


def _encoder(motion: Motion, place: Place, shape: Shape) -> Columns:
    k = place.index[0]
    d = np.zeros_like(motion.q)
    d[:, k] = -1.0
    zero = np.zeros_like(d)
    half = motion if motion.offset is None else replace(motion, q=motion.q - 0.5 * motion.offset)
    torque = half.torque_along(d, (zero, zero))[..., None]
    if not (motion.joints_measured and motion.motors_measured):
        return Columns(torque)
    x = motion.model.arm_scale * motion.model.motor_from_joint[:, k]
    return Columns(torque, np.broadcast_to(-x, (motion.n, len(x)))[..., None])


def _tilt(motion: Motion, place: Place, shape: Shape) -> Columns:
    from .dynamics import inverse_dynamics

    model, g = motion.model, motion.model.chain.gravity
    axes = _tilt_axes(model)
    if motion.tilt is not None:
        g = Rotation.from_rotvec(0.5 * np.array(motion.tilt[: len(axes)]) @ np.array(axes)).inv().apply(np.array(g))
    zero = np.zeros_like(motion.q)
    columns = []
    for axis in axes:
        turned = model.pin_model.copy()
        turned.gravity.linear = -np.cross(axis, g)
        columns.append(
            inverse_dynamics(replace(model, pin_model=turned), motion.q, zero, zero) @ model.joint_from_motor
        )
    return Columns(np.stack(columns, axis=-1))


def _unlevelled(motion: Motion, changes: Vector, beta: Vector) -> Columns:
    """Give what changes of the standard parameters, (10 n_joints, k), bring under a tilt beyond a level base.

    About a vertical axis the first moments of a link are felt only where the base is tilted, or other joints move.
    """
    from .regressor import motor_regressor

    model = motion.model
    axes, zero = np.array(_tilt_axes(model)), np.zeros_like(motion.q)
    turned = model.pin_model.copy()
    turned.gravity.linear = -np.cross(beta[: len(axes)] @ axes, model.chain.gravity)
    return Columns(motor_regressor(replace(model, pin_model=turned), motion.q, zero, zero) @ changes)


def _displaced(motion: Motion, place: Place, beta: Vector, shape: Shape) -> Motion:
    """Add an encoder's offset to those that are known."""
    offset = np.zeros(motion.q.shape[1]) if motion.offset is None else motion.offset
    return replace(motion, offset=offset + beta[0] * np.eye(len(offset))[place.index[0]])


def _amplified(motion: Motion, place: Place, beta: Vector, shape: Shape) -> Motion:
    """Add an error of a gain to those that are known."""
    return replace(motion, gains=motion.gains + beta[0] * np.eye(motion.model.n_motors)[place.index[0]])


def _tilted(motion: Motion, place: Place, beta: Vector, shape: Shape) -> Motion:
    return replace(motion, tilt=tuple(map(float, beta)))


def _tilt_axes(model: CableModel) -> list[Vector]:
    """Axes about which a base can be out of level: +z of an arm in a vertical plane, else two that are level."""
    g = model.chain.gravity / (np.linalg.norm(model.chain.gravity) or 1.0)
    if model.planar and np.linalg.norm(g[:2]) > 0.05:
        return [np.array([0.0, 0.0, 1.0])]
    ahead = np.eye(3)[0 if abs(g[0]) < 0.9 else 1]
    first = ahead - (ahead @ g) * g
    first /= np.linalg.norm(first)
    return [np.asarray(first, float), np.asarray(np.cross(first, g), float)]


def _delay(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Shift the model's torque in time, as far as it is known.

    The noise that a model's torque has from positions would call for a delay, as shifting smooths it, and make one look
    shorter than it is, as what is shifted is not all torque.
    """
    known = motion.clear_logged_torque
    late = motion.gains * (delayed(known, motion.rate, shape[0]) - known) / shape[0]
    if place.index:
        late = late * np.eye(motion.model.n_motors)[place.index[0]]
    return Columns(late[..., None])


DELAYS = (1e-3, 0.2)
"""Delays about which columns are taken [s]."""


def delayed(x: Vector, rate: float, delay: float, half: int = 8) -> Vector:
    """Shift columns by a delay [s] that need not be whole samples (Lagrange interpolation, odd extension at the ends).

    Interpolation by `half` samples on either side keeps what is wrong with the ends of a recording at its ends.
    """
    whole = int(np.floor(delay * rate))
    nodes = np.arange(1 - half, half + 1)
    apart = np.where(np.eye(2 * half, dtype=bool), 1.0, nodes[:, None] - nodes)
    reach = np.where(np.eye(2 * half, dtype=bool), 1.0, whole + 1 - delay * rate - nodes)
    weights = np.prod(reach / apart, axis=1)
    pad = abs(whole) + half + 1
    padded = np.pad(x, ((pad, pad), (0, 0)), mode="reflect", reflect_type="odd")
    first = pad - whole - half  # where the first sample's first node is
    return correlate1d(padded, weights, axis=0)[first + half : first + half + len(x)]


def _external(motion: Motion, place: Place, shape: Shape) -> Columns:
    inside = (motion.time >= shape[0]) & (motion.time <= shape[1]) & (motion.index == int(shape[2]))
    return _rub(motion, place, -inside.astype(float))


def _windows(motions: Sequence[Motion], place: Place) -> list[Shape]:
    """Overlapping windows of four lengths, on every recording."""
    shapes = []
    for motion in motions:
        end, r = float(motion.time[-1]), motion.index
        for width in end / 75 * 2.5 ** np.arange(4):
            shapes += [(float(t), float(t + width), float(r)) for t in np.arange(0.0, end - width, width / 2)]
    return shapes


# ---------------------------------------------------------------------------------------------------- physical


def _named(*names: str):
    return lambda beta, shape: dict(zip(names, map(float, beta), strict=False))


def _asymmetric_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    """Tell the levels of both directions from their mean and half their difference."""
    return {"coulomb_positive": float(beta[0] + beta[1]), "coulomb_negative": float(beta[0] - beta[1])}


def _asymmetric_inverse(p: dict[str, float]) -> tuple[list[float], list[float]]:
    forwards, backwards = p["coulomb_positive"], p["coulomb_negative"]
    return [0.5 * (forwards + backwards), 0.5 * (forwards - backwards)], []


def _peak_errors(place: Place, shape: Shape) -> dict[str, float]:
    """Take a peak that is as narrow as the velocity's sign is smooth for no more than known to be there."""
    width, velocity = shape
    return {"stribeck": (width / velocity) ** 2, "stribeck_velocity": 0.2 * (width / velocity) ** 2}


def _memory_errors(place: Place, shape: Shape) -> dict[str, float]:
    """Take a torque for less well known than an angle."""
    return {"limit": 0.022} if is_whole_cable(place.location) else {}


def _stribeck_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    return {"coulomb": float(beta[0]), "stribeck": float(beta[1]), "stribeck_velocity": shape[1]}


def _position_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    depth = float(np.hypot(beta[1], beta[2]))
    return {
        "coulomb": float(beta[0]),
        "depth": depth / float(beta[0]) if beta[0] else 0.0,
        "cycles": shape[1],
        "phase": float(np.arctan2(beta[2], beta[1])),
    }


def _spring_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    if not shape[0]:
        return {"stiffness": float(beta[0]), "rest": float(beta[1] / beta[0]) if beta[0] else 0.0}
    c = float(beta[3])
    rest = -float(beta[2]) / (3 * c) if c else 0.0
    return {"stiffness": float(beta[0]) - 3 * c * rest**2, "rest": rest, "cubic": c}


def _sinusoid(amplitude: str):
    def physical(beta: Vector, shape: Shape) -> dict[str, float]:
        named = {amplitude: float(np.hypot(beta[0], beta[1]))}
        if shape:
            named["cycles"] = shape[0]
        return named | {"phase": float(np.arctan2(beta[1], beta[0]))}

    return physical


def _stiffness(beta: Vector, shape: Shape) -> dict[str, float]:
    k = 1.0 / float(beta[0]) if beta[0] else np.inf
    return {"stiffness": k, "damping": float(beta[1]) * k**2 if len(beta) > 1 else 0.0}


def _slack_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    return {"torque": shape[0]} | _stiffness(beta, ())


def _hysteresis_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    stops = zip(beta[1:], STOPS, strict=False)
    stiffness = beta[0] + sum(b / f for b, f in stops)
    return {"stiffness": float(stiffness) / shape[0], "limit": float(np.sum(beta)), "form": shape[1]}


def _drift_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    return {
        "friction": float(beta[0]),
        "extra": float(beta[1] / beta[0]) if beta[0] else 0.0,
        "time_constant": shape[1],
    }


def _rotor_coupling(beta: Vector, shape: Shape) -> dict[str, float]:
    return {"ratio": shape[1], "inertia": float(beta[0]), "viscous": float(beta[1]), "coulomb": float(beta[2])}


def _wave(p: dict[str, float], amplitude: str) -> list[float]:
    return [p[amplitude] * np.cos(p.get("phase", 0.0)), p[amplitude] * np.sin(p.get("phase", 0.0))]


def _position_inverse(p: dict[str, float]) -> tuple[list[float], list[float]]:
    depth, phase = p["coulomb"] * p.get("depth", 0.0), p.get("phase", 0.0)
    return [p["coulomb"], depth * np.cos(phase), depth * np.sin(phase)], [p.get("cycles", 1.0)]


def _spring_inverse(p: dict[str, float]) -> tuple[list[float], list[float]]:
    k, rest, c = p.get("stiffness", 0.0), p.get("rest", 0.0), p.get("cubic", 0.0)
    if not c:
        return [k, k * rest], [0.0]
    return [k + 3 * c * rest**2, k * rest + c * rest**3, -3 * c * rest, c], [1.0]


def _elastic_inverse(p: dict[str, float]) -> tuple[list[float], list[float]]:
    return [1 / p["stiffness"], p.get("damping", 0.0) / p["stiffness"] ** 2], []


# ---------------------------------------------------------------------------------------------------- catalogue

_NM, _RAD = "N m", "rad"
_FRICTION = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994"
_MAP = "Yan et al., eqs (6), (16)"

SHARING = ("asymmetric_friction", "position_dependent_friction", "friction_drift")
"""Refinements of dry friction that another law at their place may have the dry part of."""
DRAGS = ("viscous_friction", "quadratic_drag")
"""Powers of speed that pass for each other beside dry friction."""
CATALOGUE: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        Effect(
            "viscous_friction",
            (Parameter("viscous", "N m s/rad", 0.0),),
            lambda model: axis_places(model) + pair_places(model),
            _viscous,
            _named("viscous"),
            signs=(1,),
            confounded=("time_delay", "quadratic_drag"),
            revealed_by="the same motion at several speeds",
            reference=_FRICTION,
        ),
        Effect(
            "coulomb_friction",
            (Parameter("coulomb", _NM, 0.0),),
            lambda model: axis_places(model) + pair_places(model),
            _coulomb,
            _named("coulomb"),
            _width_grid,
            _width_bounds,
            (1,),
            confounded=("hysteresis", "capstan_friction", "torque_offset"),
            revealed_by="slow strokes both ways",
            reference=_FRICTION,
            nuisance_shape=1,
            detail=_transition,
        ),
        Effect(
            "stribeck_friction",
            (
                Parameter("coulomb", _NM, 0.0),
                Parameter("stribeck", _NM, 0.0),
                Parameter("stribeck_velocity", "rad/s", 0.0),
            ),
            axis_places,
            _stribeck,
            _stribeck_physical,
            _grid(_one_width, _peak_widths),
            _bounds(lambda m, p: (_narrowest(m, p), max(1.5 * speed_scale(m, p), _narrowest(m, p)))),
            (1, 1),
            confounded=("hysteresis", "quadratic_drag"),
            revealed_by="slow reversals",
            inverse=lambda p: ([p["coulomb"], p["stribeck"]], [p["stribeck_velocity"]]),
            errors=_peak_errors,
            reference=_FRICTION,
            nuisance_shape=1,
            plausible=_peaks,
            detail=_transition,
        ),
        Effect(
            "asymmetric_friction",
            (Parameter("coulomb_positive", _NM, 0.0), Parameter("coulomb_negative", _NM, 0.0)),
            axis_places,
            _asymmetric,
            _asymmetric_physical,
            _width_grid,
            _width_bounds,
            (1, 0),
            inverse=_asymmetric_inverse,
            confounded=("coulomb_friction", "torque_offset"),
            revealed_by="nothing beside symmetric friction and a constant torque on that joint, which it equals",
            reference=_FRICTION,
            nuisance_shape=1,
            brakes=2,
            detail=_transition,
        ),
        Effect(
            "quadratic_drag",
            (Parameter("coefficient", "N m s^2/rad^2", 0.0),),
            joint_places,
            _drag,
            _named("coefficient"),
            signs=(1,),
            confounded=("viscous_friction",),
            revealed_by="fast strokes",
            reference=_FRICTION,
        ),
        Effect(
            "load_dependent_friction",
            (Parameter("coefficient", "m", 0.0),),
            joint_places,
            _load,
            _named("coefficient"),
            _width_grid,
            _width_bounds,
            (1,),
            confounded=("coulomb_friction", "torque_dependent_friction"),
            revealed_by="another pretension or payload",
            reference="Hamon, Gautier, Garrec, IEEE/RSJ IROS 2010",
            nuisance_shape=1,
            detail=_transition,
            weighs=True,
        ),
        Effect(
            "torque_dependent_friction",
            (Parameter("coefficient", "1", 0.0),),
            bearing_places,
            _torque,
            _named("coefficient"),
            _width_grid,
            _width_bounds,
            (1,),
            confounded=("coulomb_friction", "load_dependent_friction", "torque_gain_error"),
            revealed_by="two payloads",
            reference="Hamon, Gautier, Garrec, IEEE/RSJ IROS 2010",
            nuisance_shape=1,
            detail=_transition,
            weighs=True,
            leaves_open=_other_torques,
        ),
        Effect(
            "position_dependent_friction",
            (
                Parameter("coulomb", _NM, 0.0),
                Parameter("depth", "1", 0.0, 1.0),
                Parameter("cycles", "1/rad"),
                Parameter("phase", _RAD),
            ),
            axis_places,
            _by_position,
            _position_physical,
            _grid(_one_width, lambda m, p: np.array([2.3, 3.2, 4.5, 6.5, 9.0, 12.0]) / max(reach(m, p), 0.3)),
            _bounds(lambda m, p: (2.0 / max(reach(m, p), 0.3), 16.0 / max(reach(m, p), 0.3))),
            (1, 0, 0),
            confounded=("torque_dependent_friction", "capstan_friction"),
            revealed_by="slow strokes over the whole range, both ways",
            inverse=_position_inverse,
            reference=_FRICTION,
            nuisance_shape=1,
            brakes=3,
            detail=_transition,
        ),
        Effect(
            "cable_friction",
            (Parameter("coulomb", _NM, 0.0),),
            guide_places,
            _coulomb,
            _named("coulomb"),
            _width_grid,
            _width_bounds,
            (1,),
            confounded=("coulomb_friction", "capstan_friction"),
            revealed_by="moving the joints before and after that link one at a time",
            reference=_FRICTION,
            nuisance_shape=1,
            detail=_transition,
        ),
        Effect(
            "capstan_friction",
            (Parameter("mu", "1", 0.0),),
            capstan_places,
            _capstan,
            _named("mu"),
            _width_grid,
            _width_bounds,
            (1,),
            exact=False,
            confounded=("coulomb_friction", "cable_friction"),
            revealed_by="two pretensions",
            reference="Euler-Eytelwein; to first order in mu",
            nuisance_shape=1,
            detail=_transition,
            weighs=True,
        ),
        Effect(
            "hysteresis",
            (
                Parameter("stiffness", "N m/rad", 0.0, error=0.05, error_unseen=0.05),
                Parameter("limit", _NM, 0.0, error=0.008, error_unseen=0.008),
                Parameter("form", "1"),
            ),
            lambda model: rub_places(model) + pair_places(model) + tension_places(model),
            _hysteresis,
            _hysteresis_physical,
            _hysteresis_grid,
            _hysteresis_bounds,
            (1, 1, 1, 1, 1),
            confounded=("coulomb_friction", "backlash", "stribeck_friction"),
            revealed_by="small nested reversals",
            inverse=lambda p: ([p["limit"]], [p["limit"] / p["stiffness"], p.get("form", 0.0)]),
            errors=_memory_errors,
            reference="Dahl 1968; Maxwell-slip: Lampaert, Swevers, Al-Bender 2002",
            detail=_stops,
            plausible=_yields,
            error=0.1,
            sized_by="limit",
        ),
        Effect(
            "friction_drift",
            (Parameter("friction", _NM, 0.0), Parameter("extra", "1"), Parameter("time_constant", "s", 0.0)),
            axis_places,
            _drift,
            _drift_physical,
            _grid(_one_width, lambda m, p: np.array([0.05, 0.15, 0.4, 1.0]) * m[0].time[-1]),
            _bounds(lambda m, p: (0.05 * m[0].time[-1], 3.0 * m[0].time[-1])),
            (1, 0),
            confounded=("coulomb_friction",),
            revealed_by="a cold start, repeated warm",
            inverse=lambda p: ([p["friction"], p["friction"] * p["extra"]], [p["time_constant"]]),
            reference=_FRICTION,
            nuisance_shape=1,
            plausible=_starts,
            detail=_transition,
        ),
        Effect(
            "joint_spring",
            (Parameter("stiffness", "N m/rad"), Parameter("rest", _RAD), Parameter("cubic", "N m/rad^3")),
            joint_places,
            _spring,
            _spring_physical,
            lambda m, p: [(0.0,), (1.0,)],
            signs=(1, 0),
            signed=lambda shape: not shape[0],  # that of a polynomial hangs on where zero is
            least=_mean_stiffness,
            error=0.001,  # a polynomial of a measured angle
            confounded=("base_tilt", "encoder_offset"),
            revealed_by="slow strokes both ways over the whole range",
            inverse=_spring_inverse,
            reference="Wang et al., IEEE RA-L 4(4), 2019",
        ),
        Effect(
            "cable_elasticity",
            (
                Parameter("stiffness", "N m/rad", 0.0, error=0.003, error_unseen=0.04),
                Parameter("damping", "N m s/rad", 0.0, error=0.05, error_unseen=0.3),
            ),
            cable_places,
            _elasticity,
            _stiffness,
            signs=(1, 0),
            exact=False,
            moves=_gives,
            error=0.06,
            follows=True,
            confounded=("time_delay", "rotor_inertia"),
            revealed_by="encoders on both sides, or a chirp",
            inverse=_elastic_inverse,
            reference="Spong, J. Dyn. Syst. Meas. Control 109(4), 1987",
        ),
        Effect(
            "backlash",
            (Parameter("half_gap", _RAD, 0.0, error=0.005, error_unseen=0.15),),
            cable_places,
            _backlash,
            _named("half_gap"),
            _crossing_grid,
            _crossing_bounds,
            (1, 0),
            exact=False,
            moves=_played,
            error=0.06,
            follows=True,
            confounded=("hysteresis", "cable_slack", "encoder_offset"),
            revealed_by="small reversals under a bias load, encoders on both sides",
            nuisance_shape=1,
            reference="Nordin, Gutman, Automatica 38(10), 2002",
        ),
        Effect(
            "lost_motion",
            (Parameter("half_gap", _RAD, 0.0), Parameter("distance", _RAD, 0.0)),
            cable_places,
            _lost,
            lambda beta, shape: {"half_gap": float(beta[0]), "distance": shape[0]},
            lambda m, p: [(share * _cable_range(m, p),) for share in (0.02, 0.06, 0.15)],
            lambda m, p: [(0.002 * _cable_range(m, p), 0.5 * _cable_range(m, p))],
            (1,),
            confounded=("backlash", "transmission_ratio_error"),
            revealed_by="torque of the motors beside both encoders",
            inverse=lambda p: ([p["half_gap"]], [p["distance"]]),
            reference="stop operator: Brokate, Sprekels, Hysteresis and Phase Transitions, 1996",
        ),
        Effect(
            "cable_slack",
            (
                Parameter("torque", _NM, 0.0, error=0.012, error_unseen=0.04),
                Parameter("stiffness", "N m/rad", 0.0, error=0.003, error_unseen=0.04),
                Parameter("damping", "N m s/rad", 0.0, error=0.05, error_unseen=0.3),
            ),
            cable_places,
            _slack,
            _slack_physical,
            _load_grid,
            _load_bounds,
            (1, 0),
            exact=False,
            moves=_gives,
            error=0.06,
            follows=True,
            confounded=("backlash", "cable_elasticity"),
            revealed_by="torque ramps, pretension steps",
            inverse=lambda p: (_elastic_inverse(p)[0] if p.get("stiffness") else [0.0, 0.0], [p["torque"]]),
            reference="one strand carries where both did: stiffness halves",
        ),
        Effect(
            "transmission_ratio_error",
            (Parameter("relative_error", "1"),),
            cable_joint_places,
            _ratio,
            _named("relative_error"),
            exact=False,
            exact_travel=True,
            moves=_wrong_map(lambda q, beta: (beta[0] * q, np.full_like(q, beta[0]))),
            error=0.08,
            follows=True,
            confounded=("torque_gain_error", "cable_elasticity", "pulley_eccentricity"),
            revealed_by="the full range, encoders on both sides",
            reference=_MAP,
        ),
        Effect(
            "transmission_coupling",
            (
                Parameter("ratio", "1"),
                Parameter("inertia", "kg m^2", 0.0),
                Parameter("viscous", "N m s/rad", 0.0),
                Parameter("coulomb", _NM, 0.0),
            ),
            motor_joint_places,
            _coupling,
            _rotor_coupling,
            _grid(_one_width, lambda m, p: _turns(m, p) * np.array([-0.6, -0.3, 0.3, 0.6])),
            _bounds(lambda m, p: (-0.9 * _turns(m, p), 0.9 * _turns(m, p))),  # beyond, it would be a cable on a link
            (1, 1, 1),
            confounded=("coulomb_friction",),
            revealed_by="moving that joint alone",
            inverse=lambda p: ([p.get("inertia", 0.0), p.get("viscous", 0.0), p.get("coulomb", 0.0)], [p["ratio"]]),
            reference=_MAP,
            nuisance_shape=1,
            plausible=lambda beta, shape, detail: abs(shape[1]) > UNCOUPLED,
            detail=_coupling_transition,
            error=0.02,
            sized_by="inertia",
        ),
        Effect(
            "pulley_eccentricity",
            (Parameter("relative_eccentricity", "1", 0.0), Parameter("phase", _RAD)),
            own_joint_places,
            _eccentricity,
            _sinusoid("relative_eccentricity"),
            signs=(0, 0),
            exact=False,
            exact_travel=True,
            moves=_wrong_map(
                lambda q, b: (b[0] * np.sin(q) + b[1] * (np.cos(q) - 1.0), b[0] * np.cos(q) - b[1] * np.sin(q))
            ),
            error=0.08,
            follows=True,
            confounded=("transmission_ratio_error", "torque_ripple"),
            revealed_by="the full range at two loads",
            inverse=lambda p: (_wave(p, "relative_eccentricity"), []),
            reference=_MAP,
        ),
        Effect(
            "torque_ripple",
            (Parameter("amplitude", _NM, 0.0), Parameter("cycles", "1/rad", 0.0), Parameter("phase", _RAD)),
            all_motor_places,
            _ripple,
            _sinusoid("amplitude"),
            _ripple_grid,
            lambda m, p: [(1.0, 80.0)],
            signs=(0, 0),
            confounded=("pulley_eccentricity", "joint_spring"),
            revealed_by="slow constant speed",
            inverse=lambda p: (_wave(p, "amplitude"), [p["cycles"]]),
            reach=0.034,
            reference="Holtz, Springob, IEEE Trans. Ind. Electron. 43(2), 1996",
        ),
        Effect(
            "rotor_inertia",
            (Parameter("inertia", "kg m^2", 0.0),),
            all_motor_places,
            _rotor,
            _named("inertia"),
            signs=(1,),
            confounded=("payload",),
            revealed_by="nothing on an arm whose motors turn with the links' absolute angles",
            reference="Yan et al., eq. (42)",
        ),
        Effect(
            "torque_gain_error",
            (Parameter("gain", "1"),),
            all_motor_places,
            _gain,
            lambda beta, shape: {"gain": 1.0 + float(beta[0])},
            exact=False,
            follows=True,
            carried=False,
            moves=_amplified,
            error=0.02,
            confounded=("payload", "torque_dependent_friction"),
            revealed_by="a known mass",
            inverse=lambda p: ([p["gain"] - 1.0], []),
            reference="Gautier, Briot, J. Dyn. Syst. Meas. Control 136(5), 2014",
        ),
        Effect(
            "torque_offset",
            (Parameter("offset", _NM),),
            all_motor_places,
            _offset,
            _named("offset"),
            carried=False,
            confounded=("asymmetric_friction", "joint_spring"),
            revealed_by="standstill, approached from both sides",
            reference="Swevers et al., IEEE Trans. Robot. Autom. 13(5), 1997",
        ),
        Effect(
            "encoder_offset",
            (Parameter("offset", _RAD),),
            joint_places,
            _encoder,
            _named("offset"),
            exact=False,
            exact_travel=True,
            weighs=True,
            moves=_displaced,
            error=0.02,
            confounded=("base_tilt", "payload"),
            revealed_by="encoders on both sides, or a spirit level",
            reference="kinematic calibration",
        ),
        Effect(
            "base_tilt",
            (Parameter("angle", _RAD), Parameter("angle_2", _RAD)),
            base_places,
            _tilt,
            _named("angle", "angle_2"),
            signs=(0, 0),
            exact=False,
            weighs=True,
            moves=_tilted,
            error=0.02,
            reveals=_unlevelled,
            confounded=("encoder_offset", "joint_spring"),
            revealed_by="a spirit level",
            reference="gravity turned in the base frame",
        ),
        Effect(
            "time_delay",
            (Parameter("delay", "s", 0.0),),
            delay_places,
            _delay,
            _named("delay"),
            lambda m, p: [(0.012,)],
            lambda m, p: [],
            (1,),
            counts=False,
            follows=True,
            exact=False,
            centre=lambda beta: (float(np.clip(beta[0], *DELAYS)),),
            carried=False,
            confounded=("viscous_friction", "cable_elasticity"),
            revealed_by="two speeds",
            reference="tau(t - d) = tau + d (tau(t - d) - tau) / d",
            inverse=lambda p: ([p["delay"]], [p["delay"]]),
        ),
        Effect(
            "external_torque",
            (
                Parameter("torque", _NM, error=0.001, error_unseen=0.001),
                Parameter("start", "s"),
                Parameter("end", "s"),
            ),
            joint_places,
            _external,
            lambda beta, shape: {
                "torque": float(beta[0]),
                "start": shape[0],
                "end": shape[1],
                "recording": shape[2] + 1,
            },
            _windows,
            lambda m, p: [(0.0, float(max(x.time[-1] for x in m)))] * 2,
            confounded=("torque_offset",),
            revealed_by="a repeat of the same trajectory",
            inverse=lambda p: ([p["torque"]], [p["start"], p["end"], p.get("recording", 1.0) - 1]),
            reach=0.05,
            reference="Haddadin, De Luca, Albu-Schaeffer, IEEE Trans. Robot. 33(6), 2017",
        ),
    )
}
"""Every effect by name."""


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
            own = [*own, creeping(_speed(motion, self._here[0]), self.detail, motion.rate)]
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
        width, dry = sign_width(motions, self.place), self.effect.detail is _transition
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
    def dry(self) -> Candidate:
        """Dry friction in its place, as wide about standstill."""
        return replace(self, effect=CATALOGUE["coulomb_friction"], shape=self.shape[:1])

    @property
    def bare(self) -> Candidate:
        """Itself without what is left open about the sign of its velocity."""
        return replace(self, detail=0.0, creeps=False, gives=0.0) if self.detail and self.has_doubts else self

    def _rests(self, motions: Sequence[Motion], width: float) -> bool:
        """Whether its coordinate stands still now and then."""
        parts = [np.abs(creeping(_speed(m, self._here[0]), width, m.rate)) for m in motions]
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
        if self.effect.detail is _transition:
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
        estimated = self.effect.counts and (self.effect.bounds is not _unbounded or not self.named)
        own = len(self.shape) - self.place.is_pair if estimated else 0
        return max(min(own, 2 + self.effect.nuisance_shape) - self.effect.nuisance_shape, 0) + self.place.is_pair


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
    springs = tuple((np.array(c.place.A), _powers(beta)) for c, beta in effects if c.effect.name == "joint_spring")
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
