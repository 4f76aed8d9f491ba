"""Smooth corrections without a name: what is left when no effect of the catalogue fits.

They compete with the catalogue in the search. Having many coefficients they lose to a law that is right, and win where
none is; the diagnosis then says `unexplained`, where it happens and in which state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numba
import numpy as np

from .body_effects import spring_columns
from .effect import Columns, Effect, Place, Shape
from .effect_shapes import sign_width, speed_scale
from .geometry import Vector
from .model import CableModel
from .motion import Motion
from .places import all_motor_places, axis_places, joint_places


def bumps(x: Vector, count: int, low: float, high: float) -> Vector:
    """Evaluate cubic bumps on a grid over [low, high] that sum to nearly a constant; x is held at the ends.

    Returns
    -------
    ndarray, shape (count, n)
    """
    width = (high - low) / max(count - 1, 1)
    return _bumps((np.clip(x, low, high) - low) / width, count)


@numba.njit(cache=True, nogil=True)
def _bumps(x, count):
    """Fill the four bumps that reach each sample of `x`, counted in steps of the grid."""
    out = np.zeros((count, len(x)))
    for i in range(len(x)):
        first = int(x[i]) - 1
        for k in range(max(first, 0), min(first + 4, count)):
            u = abs(x[i] - k)
            out[k, i] = 2 / 3 - u**2 + 0.5 * u**3 if u < 1 else (2 - u) ** 3 / 6
    return out


MISREAD = "unnamed_reading"
"""What an encoder's own error is called."""
Variable = Callable[[Motion, Place, float], Vector]


def _own_position(motion: Motion, place: Place, scale: float) -> Vector:
    return place.along(motion.q, motion.q_m)


def _own_speed(motion: Motion, place: Place, scale: float) -> Vector:
    return np.arcsinh(place.along(motion.joint_speeds, motion.v_m) / (0.05 * scale))


def _other_position(motion: Motion, place: Place, scale: float) -> Vector:
    return motion.q[:, place.index[1]]


def _other_speed(motion: Motion, place: Place, scale: float) -> Vector:
    return motion.v[:, place.index[1]]


def _difference(motion: Motion, place: Place, scale: float) -> Vector:
    return motion.q[:, place.index[0]] - motion.q[:, place.index[1]]


def _time(motion: Motion, place: Place, scale: float) -> Vector:
    return motion.time


def _load(motion: Motion, place: Place, scale: float) -> Vector:
    return motion.tau_m[:, place.index[0]]


def _rotor_speed(motion: Motion, place: Place, scale: float) -> Vector:
    return np.abs(motion.v_m[:, place.index[0]])


def _grid(variable: Variable):
    """Shape of a patch: width of the sign, scale of the speed, range of the variable, over all recordings."""

    def grid(motions: Sequence[Motion], place: Place) -> list[Shape]:
        width, scale = sign_width(motions, place), speed_scale(motions, place)
        x = np.concatenate([variable(motion, place, scale) for motion in motions])
        low, high = np.quantile(x, [0.005, 0.995])
        return [(width, scale, float(low), float(max(high, low + 1e-9)))]

    return grid


def _function(variable: Variable, count: int, times: Callable[[Motion, Place, Shape], Vector] | None = None):
    """Columns of a smooth function of a variable, times a factor, as a torque along the place's coordinate."""

    def columns(motion: Motion, place: Place, shape: Shape) -> Columns:
        parts = bumps(variable(motion, place, shape[1]), count, *shape[2:])
        factor = times(motion, place, shape) if times else 1.0
        return Columns(along=(factor * parts, place.weights(motion.model)))

    return columns


def _sign(motion: Motion, place: Place, shape: Shape) -> Vector:
    return np.tanh(place.along(motion.joint_speeds, motion.v_m) / shape[0])


def _torque(motion: Motion, place: Place, shape: Shape) -> Vector:
    return motion.tau_m[:, place.index[0]]


def since_reversal(v: Vector, rate: float, still: float) -> Vector:
    """Time since the velocity last changed its sign, shape (n,) [s]."""
    moving = np.where(np.abs(v) > still, np.sign(v), 0.0)
    known = np.flatnonzero(moving)
    if not len(known):
        return np.zeros(len(v))
    last = moving[known[np.maximum(np.searchsorted(known, np.arange(len(v)), side="right") - 1, 0)]]
    turns = np.concatenate([[0], np.flatnonzero(np.diff(last)) + 1])
    index = np.searchsorted(turns, np.arange(len(v)), side="right") - 1
    return (np.arange(len(v)) - turns[index]) / rate


def _reversal(motion: Motion, place: Place, shape: Shape) -> Columns:
    v = place.along(motion.joint_speeds, motion.v_m)
    t, s = since_reversal(v, motion.rate, shape[0]), _sign(motion, place, shape)
    series = [s, *(s * np.exp(-t / T) for T in (0.05, 0.15, 0.45, 1.3))]
    return Columns(along=(np.stack(series), place.weights(motion.model)))


def _stiffening(motion: Motion, place: Place, shape: Shape) -> Columns:
    parts, q = bumps(motion.time, 5, *shape[2:]), place.along(motion.q, motion.q_m)
    return Columns(along=(np.stack([*parts, *(q * part for part in parts)]), place.weights(motion.model)))


def _tone(motion: Motion, place: Place, shape: Shape) -> Columns:
    phase = 2 * np.pi * shape[0] * motion.time
    return Columns(along=(np.stack([np.sin(phase), np.cos(phase)]), place.weights(motion.model)))


def _reading(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Travel and torque of an encoder whose reading is off by a sine of what it reads, as that of an eccentric disc."""
    if not (motion.joints_measured and motion.motors_measured):
        return Columns()
    model, k = motion.model, place.index[0]
    if any(place.B):
        x, along, torque = motion.q_m[:, k], np.eye(model.n_motors)[k] * model.arm_scale, None
    else:
        x, along = motion.q[:, k], -model.arm_scale * model.motor_from_joint[:, k]
        torque = np.stack([_misread(motion, k, x + turn) for turn in (0.0, 0.5 * np.pi)], axis=-1)
    waves = np.stack([np.sin(x), np.sin(x + 0.5 * np.pi)], axis=-1)
    return Columns(torque, along[:, None] * waves[:, None])


def _misread(motion: Motion, k: int, phase: Vector) -> Vector:
    """Give the torque, shape (n, n_motors), that joint k takes more where it reads a sine of a phase (n,) too much."""
    s, c, own = np.sin(phase)[:, None], np.cos(phase)[:, None], np.eye(motion.q.shape[1])[k]
    v, a = motion.v[:, k, None], motion.a[:, k, None]
    return motion.torque_along(-s * own, (-c * v * own, (s * v**2 - c * a) * own))


def _encoders(model: CableModel) -> list[Place]:
    """Every encoder, of joints and of motors."""
    return [*joint_places(model), *all_motor_places(model)]


TONE = Effect(
    "unnamed_tone",
    (),
    axis_places,
    _tone,
    lambda beta, shape: {},
    bounds=lambda motions, place: [(0.2, 0.5 * motions[0].rate)],
    signs=(),
    revealed_by="torque on {place} that swings with time at a frequency of its own",
    reach=0.005,
)
"""A disturbance with its own frequency; the search adds it at the peaks of the residual's spectrum."""
REPELS = Effect(
    "unnamed_repulsion",
    (),
    joint_places,
    spring_columns,
    lambda beta, shape: {},
    signs=(),
    revealed_by="a torque that drives {place} away from some position",
)
"""What a spring is called that pushes on, as no passive one does on the whole; it stands where one was found."""


def _with_others(places: Sequence[Place], count: int) -> list[Place]:
    """Every place with every other joint or motor, of so many; none where these are too many to search."""
    if count > 6:
        return []
    return [
        Place(place.location, place.A, place.B, (i, j))
        for i, place in enumerate(places)
        for j in range(count)
        if j != i
    ]


def _pairs(model: CableModel) -> list[Place]:
    return _with_others(joint_places(model), model.n_joints)


def _between(model: CableModel) -> list[Place]:
    """Every pair of joints once, as the coordinate that their difference is."""
    if model.n_joints > 6:
        return []
    nj, nm = model.n_joints, model.n_motors
    places = []
    for i in range(nj):
        for j in range(i):
            A = np.eye(nj)[i] - np.eye(nj)[j]
            places.append(Place({"kind": "joint", "index": i + 1, "other": j + 1}, tuple(A), (0.0,) * nm, (i, j)))
    return places


def _motor_pairs(model: CableModel) -> list[Place]:
    """Every motor with every other one, which its location names: two may be heard at one motor."""
    pairs = _with_others(all_motor_places(model), model.n_motors)
    return [replace(pair, location={**pair.location, "other": pair.index[1] + 1}) for pair in pairs]


def _crosstalk(motion: Motion, place: Place, shape: Shape) -> Columns:
    return Columns(along=(motion.tau_m[:, place.index[1]][None], place.weights(motion.model)))


def _patch(name: str, places, variable: Variable, columns, region: str) -> Effect:
    return Effect(
        name,
        (),
        places,
        columns,
        lambda beta, shape: {},
        _grid(variable),
        signs=(),
        revealed_by=region,
        nuisance_shape=4,
    )


PATCHES: dict[str, Effect] = {
    name: _patch(name, places, variable, columns, region)
    for name, places, variable, columns, region in (
        (
            "unnamed_position",
            axis_places,
            _own_position,
            _function(_own_position, 14),
            "a torque that depends on the position of {place}",
        ),
        (
            "unnamed_rub",
            axis_places,
            _own_position,
            _function(_own_position, 14, _sign),
            "friction that depends on the position of {place}",
        ),
        (
            "unnamed_velocity",
            axis_places,
            _own_speed,
            _function(_own_speed, 13),
            "a torque that depends on the speed of {place}",
        ),
        (
            "unnamed_cross_position",
            _pairs,
            _other_position,
            _function(_other_position, 9),
            "torque on {place} that depends on another joint's position",
        ),
        (
            "unnamed_cross_rub",
            _pairs,
            _other_position,
            _function(_other_position, 9, _sign),
            "friction of {place} that depends on another joint's position",
        ),
        (
            "unnamed_difference",
            _between,
            _difference,
            _function(_difference, 9),
            "a torque between {place} and another joint",
        ),
        (
            "unnamed_brake",
            _pairs,
            _other_speed,
            _function(_other_speed, 7, _sign),
            "friction of {place} that depends on another joint's speed",
        ),
        ("unnamed_time", axis_places, _time, _function(_time, 16), "torque on {place} that wanders with time"),
        ("unnamed_wear", axis_places, _time, _function(_time, 10, _sign), "friction of {place} that changes with time"),
        ("unnamed_stiffening", joint_places, _time, _stiffening, "a spring at {place} that changes with time"),
        ("unnamed_load", all_motor_places, _load, _function(_load, 14), "a torque that depends on the load of {place}"),
        (
            "unnamed_gain_drift",
            all_motor_places,
            _time,
            _function(_time, 6, _torque),
            "gain of {place} that changes with time",
        ),
        (
            "unnamed_gain_speed",
            all_motor_places,
            _rotor_speed,
            _function(_rotor_speed, 5, _torque),
            "gain of {place} that changes with speed",
        ),
        (
            "unnamed_reversal",
            axis_places,
            _time,
            _reversal,
            "friction of {place} that depends on the time since it turned",
        ),
    )
} | {
    "unnamed_crosstalk": Effect(
        "unnamed_crosstalk",
        (),
        _motor_pairs,
        _crosstalk,
        lambda beta, shape: {},
        signs=(),
        revealed_by="a torque of {place} that follows that of another motor",
    ),
    MISREAD: Effect(
        MISREAD,
        (),
        _encoders,
        _reading,
        lambda beta, shape: {},
        signs=(),
        revealed_by="a reading of the encoder of {place} that is off by a sine of its angle",
    ),
}
"""Every unnamed correction by name; `revealed_by` holds the words for the region of the state."""
RUBS = ("unnamed_rub", "unnamed_velocity", "unnamed_cross_rub", "unnamed_brake", "unnamed_wear", "unnamed_reversal")
"""Those of them that are frictions."""
