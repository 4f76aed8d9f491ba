"""Cables: errors of their map, stretch, play, slack, coupling: columns, known motion, parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from .effect import Columns, Place, Shape, stacked_columns
from .effect_shapes import greatest_load
from .friction_effects import maxwell, transitions
from .geometry import Vector
from .model import CableModel
from .motion import Motion, derivatives


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


def ratio_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Columns of a cable that runs more per angle of joint k (eq. 6), in units of its entry of the map."""
    i, k = place.index
    known = i == k or (motion.model.manipulator.links and place.location["kind"] == "cable")
    if not known and not (motion.joints_measured and motion.motors_measured):
        return Columns()  # torques alone do not tell which joints a cable passes
    return _misled(motion, i, k, motion.joint_angles[:, k], 1.0, motion.a[:, k])


def eccentricity_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Columns of an eccentric pulley: travel e (sin(q + phase) - sin(phase)), in two parts."""
    i, k = place.index
    q, v, a = motion.joint_angles[:, k], motion.v[:, k], motion.a[:, k]
    s, c = np.sin(q), np.cos(q)
    return stacked_columns(
        [
            _misled(motion, i, k, s, c, c * a - s * v**2),
            _misled(motion, i, k, c - 1, -s, -s * a - c * v**2),
        ]
    )


UNCOUPLED = 0.03
"""Ratio below which a motor that turns with a joint only turns by itself."""
LARGE_SLOPE = 0.4
"""An estimated error of the cable map that is larger is none: columns are not taken about it."""


def moved_by_map(travel: Callable[[Vector, Vector], tuple[Vector, Vector]]):
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


def elasticity_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Columns of a soft cable (`_compliant`)."""
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


def moved_by_stretch(motion: Motion, place: Place, beta: Vector, shape: Shape) -> Motion:
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
        return stacked_columns([_moved(motion, x, i, None) for x in seen])
    slope = _stretch_slope(motion.cable_torque[:, i], slack)
    speed = differentiate(_stretch(motion.clear_torque[:, i], slack), motion.rate)
    turns = [differentiate(speed, motion.rate), -differentiate(slope * differentiate(speed, motion.rate), motion.rate)]
    rotor = np.eye(motion.model.n_motors)[i] * motion.model.rotor_inertia[i] / motion.model.arm_scale[i]
    return stacked_columns([_moved(motion, x, i, np.outer(turn, rotor)) for x, turn in zip(seen, turns, strict=True)])


def backlash_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Columns of a cable's travel per half of its play; motors that alone are measured may leap with less torque."""
    i, model = place.index[0], motion.model
    rotor = np.eye(model.n_motors)[i] * model.rotor_inertia[i] / model.arm_scale[i]
    if motion.joints_measured:
        side = motion.crossed_side(i, shape[0])
        seen = _moved(motion, np.tanh(motion.cable_torque[:, i] / shape[0]) if side is None else side, i, None)
        if seen.kinematic is None or not rotor.any():
            return seen
        turn = np.zeros(motion.n) if side is None else derivatives(side, motion.rate)[1]
        return stacked_columns([seen, Columns((turn[:, None] * rotor)[..., None], np.zeros_like(seen.kinematic))])
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


def moved_by_play(motion: Motion, place: Place, beta: Vector, shape: Shape) -> Motion:
    """Move the joints by a known play to where they are, where the motors alone say so."""
    if motion.felt is None:
        return motion
    i = place.index[0]
    own = beta[0] * motion.felt_side(i, shape[0])[0][:, None] * motion.model.joints_per_travel(i)
    return replace(motion, shift=own if motion.shift is None else motion.shift + own)


def crossing_grid(motions: Sequence[Motion], place: Place) -> list[Shape]:
    """Screen two torques within which a cable crosses its play."""
    most = greatest_load(motions, place) or 1.0
    return [(share * most,) for share in (0.015, 0.005)]


def crossing_bounds(motions: Sequence[Motion], place: Place) -> list[tuple[float, float]]:
    """Bound that torque by shares of the greatest."""
    most = greatest_load(motions, place) or 1.0
    return [(0.001 * most, 0.03 * most)]


def _cable_run(motion: Motion, i: int) -> Vector:
    """Give how far cable i has run by its motor, beyond what the joints that it only passes take, shape (n,) [rad]."""
    passes = motion.model.motor_from_joint[i].copy()
    passes[np.argmax(np.abs(passes))] = 0.0
    return (motion.q_m[:, i] - motion.q @ passes) * motion.model.arm_scale[i]


def lost_motion_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Column of a cable's travel that follows where its motor turned last, per half of what is lost at a reversal."""
    if motion.torque_measured:
        return Columns()  # the torque tells on which side a cable lies
    i = place.index[0]
    return _moved(motion, maxwell(_cable_run(motion, i), shape[0], 1.0), i, None)


def cable_range(motions: Sequence[Motion], place: Place) -> float:
    """Range of what the cable has run (`_cable_run`)."""
    return float(np.ptp(np.concatenate([_cable_run(m, place.index[0]) for m in motions]))) or 1.0


def slack_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Columns of a soft cable of which one strand hangs beyond a torque."""
    return _compliant(motion, place.index[0], shape[0])


def slack_grid(motions: Sequence[Motion], place: Place) -> list[Shape]:
    """Screen torques beyond which a strand hangs."""
    most = greatest_load(motions, place)
    return [(share * most,) for share in (0.1, 0.25, 0.45, 0.7, 0.9) if most > 0]


def slack_bounds(motions: Sequence[Motion], place: Place) -> list[tuple[float, float]]:
    """Keep off both ends: with all loads beyond it or none, slack is elasticity."""
    most = greatest_load(motions, place)
    return [(0.05 * most, 0.95 * most)] if most > 0 else []


def coupling_transitions(motion: Motion, place: Place, shape: Shape, scale: float) -> list[Vector]:
    """Give how the sign of the coupled speed may pass through zero."""
    i, k = place.index
    return transitions(motion.v_m[:, i] + shape[1] * motion.v[:, k], scale)


def is_felt_by_joint(shape: Shape) -> bool:
    """Whether a joint with which a motor turns feels what that motor does."""
    return shape[2:] != (1.0,)


def coupling_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Columns of inertia, drag and dry friction of a motor that turns with a joint at a ratio.

    Friction brakes motor and joint as it turns with them, or, where something else carries what the joint would feel,
    the motor alone; inertia is felt by both.
    """
    i, k = place.index
    both = is_felt_by_joint(shape)
    s = motion.v_m[:, i] + shape[1] * motion.v[:, k]
    a = both * (motion.a_m[:, i] + shape[1] * motion.a[:, k])
    w = np.eye(motion.model.n_motors)[i] + both * shape[1] * motion.model.joint_from_motor[k]
    return Columns(along=(np.stack([a, s, np.tanh(s / shape[0])]), w))


def most_turns(motions: Sequence[Motion], place: Place) -> float:
    """Give by how much a coupled motor turns at most while a joint turns by one: as much as with any of its own."""
    return float(np.abs(motions[0].model.motor_from_joint[place.index[0]]).max())


def elastic_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    """Tell stiffness and damping from compliance and damping over stiffness squared."""
    k = 1.0 / float(beta[0]) if beta[0] else np.inf
    return {"stiffness": k, "damping": float(beta[1]) * k**2 if len(beta) > 1 else 0.0}


def slack_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    """Tell the torque beyond which a strand hangs, stiffness and damping."""
    return {"torque": shape[0]} | elastic_physical(beta, ())


def coupling_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    """Tell the ratio, what turns at it, and whether the motor alone feels it."""
    turning = {"inertia": float(beta[0]), "viscous": float(beta[1]), "coulomb": float(beta[2])}
    return {"ratio": shape[1], **turning, "motor_only": shape[2] if len(shape) > 2 else 0.0}


def elastic_inverse(p: dict[str, float]) -> tuple[list[float], list[float]]:
    """Invert `elastic_physical`."""
    return [1 / p["stiffness"], p.get("damping", 0.0) / p["stiffness"] ** 2], []
