"""What an excitation may ask of a robot: limits at joints and motors, eq. (46), of cables and of the mechanism."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from .dynamics import motor_torques
from .errors import InputError
from .files import check_keys, read_yaml
from .geometry import Vector, frozen_array
from .model import CableModel
from .routing import joint_limits
from .units import joint_units, motor_units

DEFAULT_VELOCITY = 1.0  # [rad/s or m/s]
DEFAULT_ACCELERATION = 2.0  # [rad/s^2 or m/s^2]
MARGIN = 0.02  # of each joint's range, kept at both ends of the mechanism's


class InfeasibleLimits(InputError):
    """Limits that leave no motion, or none that tells anything."""


@dataclass(frozen=True)
class Limits:
    """Limits of a robot's motion; infinity where there is none.

    Attributes
    ----------
    position : ndarray, shape (n_joints, 2)
        Lowest and highest joint position [rad or m].
    velocity, acceleration : ndarray, shape (n_joints,)
        Largest magnitudes at the joints.
    motor_velocity, motor_acceleration, motor_torque : ndarray, shape (n_motors,)
        Largest magnitudes at the motors; the torque limit includes what the cables' tension allows.
    """

    position: Vector
    velocity: Vector
    acceleration: Vector
    motor_velocity: Vector
    motor_acceleration: Vector
    motor_torque: Vector

    def __post_init__(self):
        for name in self.__dataclass_fields__:
            object.__setattr__(self, name, frozen_array(getattr(self, name)))

    def replace(self, **changes: Any) -> Limits:
        """Give these limits with some replaced."""
        return replace(self, **changes)


def mechanism_limits(model: CableModel, *, minimum_tension: float = 0.0) -> Limits:
    r"""Collect what the robot itself allows: cables on their pulleys and in tension, URDF limits, motors.

    A cable stays on its joint pulley for :math:`|q_i| \le 2 \theta_{g0}` (Figure 3). With both sides pretensioned,
    their tensions are the pretension plus and minus :math:`n_i / (2 r_j)`, eq. (17), which limits the motor torque.

    Parameters
    ----------
    model : CableModel
    minimum_tension : float
        What must remain in the slacker side [N].

    Returns
    -------
    Limits
        Accelerations are unlimited.

    Raises
    ------
    InputError
        If the pretension is below `minimum_tension`.
    """
    n, n_m, robot = model.n_joints, model.n_motors, model.pin_model
    position, velocity = np.tile([-np.inf, np.inf], (n, 1)), np.full(n, np.inf)
    for row, i in enumerate(model.joint_ids):
        joint = robot.joints[i]
        if joint.nq == 1:
            position[row] = robot.lowerPositionLimit[joint.idx_q], robot.upperPositionLimit[joint.idx_q]
        if robot.velocityLimit[joint.idx_v] > 0:
            velocity[row] = robot.velocityLimit[joint.idx_v]
    torque, motor_velocity = np.full(n_m, np.inf), np.full(n_m, np.inf)
    m = model.manipulator
    for k, motor in enumerate(m.motors):
        torque[k] = motor.torque_limit or np.inf
        motor_velocity[k] = motor.velocity_limit or np.inf
    if m.pulleys is not None:
        reach = joint_limits(m.links, m.pulleys)
        position = np.column_stack([np.maximum(position[:, 0], reach[:, 0]), np.minimum(position[:, 1], reach[:, 1])])
        if m.pretension:
            if m.pretension <= minimum_tension:
                raise InputError(
                    f"a pretension of {m.pretension:g} N leaves nothing above a minimum of {minimum_tension:g} N",
                    source=m.source,
                    place="pretension",
                )
            torque = np.minimum(torque, 2 * m.pulleys.motor_pulley_radius * (m.pretension - minimum_tension))
    return Limits(position, velocity, np.full(n, np.inf), motor_velocity, np.full(n_m, np.inf), torque)


def default_limits(model: CableModel) -> Limits:
    """Take the mechanism's limits with a margin for tracking errors, and moderate velocities and accelerations."""
    own = mechanism_limits(model)
    position = np.clip(own.position, -np.pi, np.pi)
    position = position + MARGIN * np.ptp(position, axis=1)[:, None] * [1.0, -1.0]
    velocity = np.minimum(own.velocity, DEFAULT_VELOCITY)
    return own.replace(position=position, velocity=velocity, acceleration=np.full(model.n_joints, DEFAULT_ACCELERATION))


def load_limits(path: str | PathLike[str], model: CableModel) -> Limits:
    """Read limits.yaml and join it with what the mechanism allows; what it leaves out is as in `default_limits`.

    Raises
    ------
    InputError
        Naming file and key, if a key is unknown, a number is missing or not positive, or nothing is left to move in.
    """
    content = read_yaml(path)
    try:
        return parse_limits(content, model)
    except InputError as exc:
        raise InputError(exc.message, source=exc.source or Path(path), place=exc.place) from None


def parse_limits(content: Mapping[str, Any], model: CableModel) -> Limits:
    """Make `Limits` of the content of limits.yaml (see `load_limits`)."""
    check_keys(content, ("joints", "motors", "minimum_tension"))
    tension = _number(content.get("minimum_tension", 0.0), "minimum_tension", at_least=0.0)
    limits = default_limits(model)
    own = mechanism_limits(model, minimum_tension=tension)
    joints = _entries(content, "joints", ("position", "velocity", "acceleration"), model.n_joints)
    motors = _entries(content, "motors", ("velocity", "acceleration", "torque"), model.n_motors)
    position, velocity, acceleration = (np.array(x) for x in (limits.position, limits.velocity, limits.acceleration))
    for i, joint in enumerate(joints):
        place = f"joints[{i + 1}]"
        if "position" in joint:
            asked = _range(joint["position"], f"{place}.position")
            position[i] = max(own.position[i, 0], asked[0]), min(own.position[i, 1], asked[1])
            if position[i, 0] >= position[i, 1]:
                low, high = own.position[i]
                raise InputError(
                    f"{asked} lies outside what the mechanism allows, {low:.4g} to {high:.4g} {joint_units(model)[i]}",
                    place=f"{place}.position",
                )
        if "velocity" in joint:
            velocity[i] = min(own.velocity[i], _number(joint["velocity"], f"{place}.velocity"))
        if "acceleration" in joint:
            acceleration[i] = _number(joint["acceleration"], f"{place}.acceleration")
    motor = {"velocity": own.motor_velocity, "acceleration": own.motor_acceleration, "torque": own.motor_torque}
    for name, mechanism in motor.items():
        asked = [_number(x[name], f"motors[{i + 1}].{name}") if name in x else np.inf for i, x in enumerate(motors)]
        motor[name] = np.minimum(mechanism, asked) if asked else mechanism
    return Limits(position, velocity, acceleration, motor["velocity"], motor["acceleration"], motor["torque"])


def usage(model: CableModel, limits: Limits, q: Vector, v: Vector, a: Vector) -> dict[str, Vector]:
    """Compare a trajectory's peaks with the limits: 1 is the edge, more breaks it.

    Parameters
    ----------
    model : CableModel
    limits : Limits
    q, v, a : ndarray, shape (n_samples, n_joints)

    Returns
    -------
    dict of str to ndarray
        By the names of the fields of `Limits`, one number per joint or motor.
    """
    E_inverse = model.motor_from_joint.T
    middle, half = limits.position.mean(axis=1), 0.5 * np.ptp(limits.position, axis=1)
    with np.errstate(invalid="ignore"):
        share = np.where(np.isfinite(half), np.abs(np.asarray(q) - middle).max(axis=0) / half, 0.0)
    return {
        "position": share,
        "velocity": np.abs(v).max(axis=0) / limits.velocity,
        "acceleration": np.abs(a).max(axis=0) / limits.acceleration,
        "motor_velocity": np.abs(v @ E_inverse).max(axis=0) / limits.motor_velocity,
        "motor_acceleration": np.abs(a @ E_inverse).max(axis=0) / limits.motor_acceleration,
        "motor_torque": np.abs(motor_torques(model, q, v, a)).max(axis=0) / limits.motor_torque,
    }


def worst_usage(model: CableModel, limits: Limits, q: Vector, v: Vector, a: Vector) -> tuple[float, str]:
    """Give the largest share of any limit and which one it is, in words."""
    shares = usage(model, limits, q, v, a)
    name = max(shares, key=lambda key: shares[key].max())
    index = int(shares[name].argmax()) + 1
    return float(shares[name].max()), f"{name.replace('_', ' ')} of {'motor' if 'motor' in name else 'joint'} {index}"


def check_posture(model: CableModel, limits: Limits, q: Vector) -> None:
    """Refuse limits that leave no room around a posture.

    Raises
    ------
    InputError
        If standing still there already takes more torque than the motors may give or the cables can carry.
    """
    zero = np.zeros((1, model.n_joints))
    tau_m = motor_torques(model, np.atleast_2d(q), zero, zero)[0]
    worst = int((np.abs(tau_m) / limits.motor_torque).argmax())
    if abs(tau_m[worst]) >= limits.motor_torque[worst]:
        unit = motor_units(model, True)[worst]
        raise InfeasibleLimits(
            f"infeasible limits: standing still at the middle of the excitation takes {abs(tau_m[worst]):.4g} {unit} "
            f"at motor {worst + 1}, {limits.motor_torque[worst]:.4g} {unit} are allowed (torque limit or cable tension)"
        )


def scale_to_edge(
    model: CableModel,
    limits: Limits,
    center: Vector,
    dq: Vector,
    v: Vector,
    a: Vector,
    *,
    coordinates: Vector,
    torque_stride: int = 1,
) -> Vector:
    """Find how far each candidate motion must shrink (or may grow) to touch the limits.

    Each coordinate is scaled to its own edge where the coordinates are the joints; what couples them (motor limits, or
    coordinates that move several joints) is met by one common factor.

    Parameters
    ----------
    model : CableModel
    limits : Limits
    center : ndarray, shape (m, n_joints)
    dq, v, a : ndarray, shape (m, n_coordinates, n_samples)
        Motion about the centre in the coordinates of the series.
    coordinates : ndarray, shape (n_joints, n_coordinates)
        Joint motion per coordinate.
    torque_stride : int
        Look at the torques of every so many samples only.

    Returns
    -------
    ndarray, shape (m, n_coordinates)
    """
    m, n_c, _ = dq.shape
    factor = np.ones((m, n_c))
    if n_c == model.n_joints:
        factor = 1.0 / np.maximum(_joint_shares(limits, center, dq, v, a), 1e-300)
    J, M = coordinates, model.motor_from_joint @ coordinates
    scaled = [x * factor[..., None] for x in (dq, v, a)]
    shares = [_joint_shares(limits, center, *(J @ x for x in scaled))] if n_c != model.n_joints else []
    for limit, x in ((limits.motor_velocity, scaled[1]), (limits.motor_acceleration, scaled[2])):
        if np.isfinite(limit).any():
            shares.append(np.abs(M @ x).max(axis=-1) / limit)
    if shares:
        worst = np.concatenate(shares, axis=1).max(axis=1)
        common = np.minimum(1.0, 1.0 / worst) if n_c == model.n_joints else 1.0 / np.maximum(worst, 1e-300)
        factor = factor * common[:, None]
    if np.isfinite(limits.motor_torque).any():
        motion = [J @ (x * factor[..., None])[..., ::torque_stride] for x in (dq, v, a)]
        factor = factor * _torque_factor(model, limits, center, motion)
    return factor


def _joint_shares(limits: Limits, center: Vector, dq: Vector, v: Vector, a: Vector) -> Vector:
    return np.maximum.reduce(
        [
            dq.max(axis=-1) / (limits.position[:, 1] - center),
            -dq.min(axis=-1) / (center - limits.position[:, 0]),
            np.abs(v).max(axis=-1) / limits.velocity,
            np.abs(a).max(axis=-1) / limits.acceleration,
        ]
    )


def _torque_factor(model: CableModel, limits: Limits, center: Vector, motion: list[Vector]) -> Vector:
    """Find the largest common factor in (0, 1] that keeps the motor torques within limits, shape (m, 1)."""
    joint_major = [np.swapaxes(x, 1, 2) for x in motion]

    def share(factor: Vector, rows: np.ndarray) -> Vector:
        dq, v, a = (factor[:, None, None] * x[rows] for x in joint_major)
        q = dq + center[rows][:, None]
        tau_m = motor_torques(model, *(x.reshape(-1, model.n_joints) for x in (q, v, a)))
        return (np.abs(tau_m) / limits.motor_torque).max(axis=1).reshape(len(rows), -1).max(axis=1)

    high = np.ones(len(center))
    rows = np.flatnonzero(share(high, np.arange(len(high))) > 1.0)
    if len(rows):
        low, top = np.zeros(len(rows)), np.ones(len(rows))
        for _ in range(10):
            middle = 0.5 * (low + top)
            inside = share(middle, rows) <= 1.0
            low, top = np.where(inside, middle, low), np.where(inside, top, middle)
        high[rows] = low
    return high[:, None]


def _entries(content: Mapping[str, Any], key: str, allowed: tuple[str, ...], n: int) -> list[Mapping[str, Any]]:
    items = content.get(key, [])
    if not isinstance(items, list) or (items and len(items) != n):
        found = len(items) if isinstance(items, list) else repr(items)
        raise InputError(f"a list of {n}, one per {key[:-1]} of this robot, was expected, found {found}", place=key)
    for i, item in enumerate(items):
        check_keys(item, allowed, place=f"{key}[{i + 1}]")
    return items


def _number(value: Any, place: str, *, at_least: float | None = None) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"a number was expected, found {value!r}", place=place)
    if value < 0 if at_least is not None else value <= 0:
        raise InputError(f"must be {'at least 0' if at_least is not None else 'above 0'}, found {value:g}", place=place)
    return float(value)


def _range(value: Any, place: str) -> tuple[float, float]:
    numbers = (
        isinstance(value, list)
        and len(value) == 2
        and all(isinstance(x, int | float) and not isinstance(x, bool) and np.isfinite(x) for x in value)
    )
    if not numbers or value[0] >= value[1]:
        raise InputError(f"[lowest, highest] was expected, found {value!r}", place=place)
    return float(value[0]), float(value[1])
