"""Where effects can sit on a robot: joints, motors, cables, guides, bearings, pairs of motors, the base."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from .effect import Place, Shape
from .geometry import Vector
from .model import CableModel


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


def kinds_of(places: Callable[[CableModel], list[Place]], model: CableModel) -> set[str]:
    """Give the kinds of places of an effect: what may sit at joints and motors is of both, where these are one, too."""
    kinds = {str(place.location["kind"]) for place in places(model)}
    return kinds | {"motor"} if "joint" in kinds and places not in (joint_places, own_joint_places) else kinds


def twin_places(model: CableModel, place: Place, kinds: Collection[str]) -> list[Place]:
    """Other joints and motors, of some kinds, that turn with a place at a constant ratio; a wrong cable map parts them.

    The kinds are those of an effect (`kinds_of`).
    """
    if not len(place.A) or place.is_pair:
        return []
    own = place.weights(model)
    sides = joint_places(model) if any(place.B) else all_motor_places(model)
    return [x for x in sides if x.location["kind"] in kinds and parallel(x.weights(model), own)]


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


def rub_place(model: CableModel, location: Mapping[str, Any]) -> Place:
    """Give the joint, motor or cable on guides of a location."""
    return next(place for place in rub_places(model) if place.location == location)


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
