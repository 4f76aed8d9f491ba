"""The model every computation starts from: a Pinocchio model, a transmission, and one order of joints."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin

from .errors import GeometryError, ManipulatorError, ShapeError, nearest
from .geometry import Manipulator, Vector, frozen_array
from .manipulator import load_manipulator
from .routing import PARALLEL, Routing, route
from .transmission import joint_from_motor
from .urdf import generate_urdf, moving_joints, read_urdf


@dataclass(frozen=True)
class Chain:
    """The kinematic tree as plain arrays, bodies in the order of the rows of E.

    Attributes
    ----------
    order : ndarray of int, shape (n_joints,)
        Rows in an order in which parents come before their children.
    parent : ndarray of int, shape (n_joints,)
        Row of the parent body, -1 for the base.
    rotation : ndarray, shape (n_joints, 3, 3)
        Joint frame in its parent's frame, at joint position zero.
    translation : ndarray, shape (n_joints, 3)
        [m].
    axis : ndarray, shape (n_joints, 3)
    prismatic : ndarray of bool, shape (n_joints,)
    gravity : ndarray, shape (3,)
        [m/s^2].
    """

    order: np.ndarray
    parent: np.ndarray
    rotation: Vector
    translation: Vector
    axis: Vector
    prismatic: np.ndarray
    gravity: Vector


@dataclass(frozen=True)
class CableModel:
    """A robot with its transmission; every array of joints is in the order of the rows of E.

    Attributes
    ----------
    manipulator : Manipulator
        What the file said.
    pin_model : pinocchio.Model
        Only the joints named by the rows of E, the others locked; in Pinocchio's own order. Read only.
    joints, motors : tuple of str
        Names of rows and columns of E.
    joint_from_motor : ndarray, shape (n_joints, n_motors)
        E of q = E q_m + offset and tau_m = E' tau.
    offset : ndarray, shape (n_joints,)
        [rad or m].
    rotor_inertia : ndarray, shape (n_motors,)
        [kg m^2].
    """

    manipulator: Manipulator
    pin_model: pin.Model
    joints: tuple[str, ...]
    motors: tuple[str, ...]
    joint_from_motor: Vector
    offset: Vector
    rotor_inertia: Vector

    @property
    def n_joints(self) -> int:
        """Number of joints (rows of E)."""
        return len(self.joints)

    @property
    def n_motors(self) -> int:
        """Number of motors (columns of E)."""
        return len(self.motors)

    @property
    def motor_from_joint(self) -> Vector:
        """Pseudo-inverse of E: q_m = motor_from_joint @ (q - offset), shape (n_motors, n_joints)."""
        return self._inverse

    @cached_property
    def _inverse(self) -> Vector:
        return frozen_array(np.linalg.pinv(self.joint_from_motor))

    @cached_property
    def joint_ids(self) -> tuple[int, ...]:
        """Pinocchio's joint id of each row."""
        return tuple(self.pin_model.getJointId(name) for name in self.joints)

    @cached_property
    def chain(self) -> Chain:
        """The kinematic tree as plain arrays."""
        return _chain(self.pin_model, self.joint_ids)

    @cached_property
    def standard_parameters(self) -> Vector:
        """Inertial parameters of the bodies, row by row of E, shape (10 n_joints,).

        Pinocchio's order per body: m, m c (3), and the inertia about the joint's origin as xx, xy, yy, xz, yz, zz.
        """
        inertias = self.pin_model.inertias
        return frozen_array(np.concatenate([inertias[i].toDynamicParameters() for i in self.joint_ids]))

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of `standard_parameters`: ``m_1, mx_1, my_1, mz_1, Ixx_1, Ixy_1, ...`` (rows count from 1)."""
        stems = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
        return tuple(f"{stem}_{i + 1}" for i in range(self.n_joints) for stem in stems)

    @cached_property
    def arm_scale(self) -> Vector:
        """Angle of a link's cable per motor angle, r_m / r_j (1 without pulleys), shape (n_motors,)."""
        pulleys = self.manipulator.pulleys
        if pulleys is None:
            return np.ones(self.n_motors)
        return pulleys.motor_pulley_radius / pulleys.joint_pulley_radius

    @cached_property
    def linear_motors(self) -> np.ndarray:
        """Which motors slide as their joints do, one to one, shape (n_motors,) of bool; others turn, like a spool."""
        E, slides = np.abs(self.joint_from_motor), self.chain.prismatic[:, None]
        return np.all((E < 1e-12) | (slides & (np.abs(E - 1.0) < 1e-9)), axis=0)

    @cached_property
    def planar(self) -> bool:
        """Whether the robot is an arm of cables over pulleys whose joint axes are all parallel to the base's z."""
        if not self.manipulator.links:
            return False
        base, *others = self.routing.frames
        flat = base is not None and abs(base[2, 2]) > 1 - PARALLEL
        return flat and all(frame is not None for frame in others)

    @cached_property
    def routing(self) -> Routing:
        """Where the cables run.

        Raises
        ------
        GeometryError
            If the robot is given by its URDF: nothing is known of its pulleys.
        """
        if not self.manipulator.links:
            raise GeometryError(
                "the cable layer does not apply: the robot is given by a URDF, without pulleys",
                source=self.manipulator.source,
            )
        return route(self.manipulator.links)

    def configuration(self, q: Vector) -> Vector:
        """Turn joint positions into Pinocchio configurations (cosine and sine for continuous joints).

        Parameters
        ----------
        q : ndarray, shape (n_samples, n_joints)
            [rad or m].

        Returns
        -------
        ndarray, shape (n_samples, nq)
        """
        q = self.joint_array(q, "q")
        out = np.zeros((len(q), self.pin_model.nq))
        for row, i in enumerate(self.joint_ids):
            joint = self.pin_model.joints[i]
            if joint.nq == 2:
                out[:, joint.idx_q], out[:, joint.idx_q + 1] = np.cos(q[:, row]), np.sin(q[:, row])
            else:
                out[:, joint.idx_q] = q[:, row]
        return out

    @cached_property
    def velocity_index(self) -> np.ndarray:
        """Pinocchio's velocity index of each row, shape (n_joints,)."""
        return np.array([self.pin_model.joints[i].idx_v for i in self.joint_ids])

    def joint_array(self, values: Vector, name: str) -> Vector:
        """Check that `values` is (n_samples, n_joints); one sample may come as (n_joints,).

        Raises
        ------
        ShapeError
            If it is not.
        """
        array = np.atleast_2d(np.asarray(values, dtype=float))
        if array.ndim != 2 or array.shape[1] != self.n_joints:
            raise ShapeError(f"{name} has shape {np.shape(values)}, (n_samples, {self.n_joints}) was expected")
        return array

    def joint_position(self, q_m: Vector) -> Vector:
        """Give q = E q_m + offset, shape (n_samples, n_joints)."""
        return np.asarray(q_m) @ self.joint_from_motor.T + self.offset

    def motor_position(self, q: Vector) -> Vector:
        """Give q_m of q = E q_m + offset (least squares where E has more rows than columns)."""
        return (np.asarray(q) - self.offset) @ self.motor_from_joint.T

    def motor_torque(self, tau: Vector) -> Vector:
        """Give tau_m = E' tau, shape (n_samples, n_motors)."""
        return np.asarray(tau) @ self.joint_from_motor

    def joints_per_travel(self, cable: int) -> Vector:
        """How far joints move per travel of a cable whose motor stands still, -E e_i / s_i, shape (n_joints,)."""
        return -self.joint_from_motor[:, cable] / self.arm_scale[cable]

    def with_standard_parameters(self, pi_std: Vector) -> CableModel:
        """Give the same robot with other inertial parameters, shape (10 n_joints,)."""
        model = self.pin_model.copy()
        for row, i in enumerate(self.joint_ids):
            ten = np.array(pi_std[10 * row : 10 * row + 10])
            model.inertias[i] = pin.Inertia.FromDynamicParameters(ten) if ten.any() else pin.Inertia.Zero()
        return replace(self, pin_model=model)


def load_model(path: str | os.PathLike[str]) -> CableModel:
    """Read a manipulator.yaml or model.yaml and build its model.

    Raises
    ------
    ManipulatorError, GeometryError
        If the file, or the URDF it names, cannot describe a robot.
    """
    return build_model(load_manipulator(path))


def build_model(manipulator: Manipulator) -> CableModel:
    """Build the model of a manipulator.

    Raises
    ------
    ManipulatorError
        If its URDF cannot be read or lacks a joint that the transmission names.
    """
    if manipulator.urdf is None:
        pin_model = pin.buildModelFromXML(generate_urdf(manipulator))
        joints = tuple(f"joint_{i + 1}" for i in range(len(manipulator.links)))
        motors = tuple(f"motor_{i + 1}" for i in range(len(manipulator.links)))
        assert manipulator.pulleys is not None
        E, offset = joint_from_motor(manipulator.pulleys), np.zeros(len(joints))
    else:
        pin_model, joints, motors, E, offset = _from_urdf(manipulator, manipulator.urdf)
    pin_model.gravity.linear = manipulator.gravity
    if manipulator.motors and len(manipulator.motors) != len(motors):
        raise ManipulatorError(
            f"{len(motors)} motors were expected, found {len(manipulator.motors)}",
            source=manipulator.source,
            place="motors",
        )
    rotor = [motor.rotor_inertia for motor in manipulator.motors] or [0.0] * len(motors)
    return CableModel(
        manipulator, pin_model, joints, motors, frozen_array(E), frozen_array(offset), frozen_array(rotor)
    )


def _from_urdf(manipulator: Manipulator, path: Path):
    model = read_urdf(path)
    moving = moving_joints(path)
    if not moving:
        raise ManipulatorError("has no joint that moves", source=path)
    t = manipulator.transmission
    if t is None:
        joints, motors, E, offset = moving, moving, np.eye(len(moving)), np.zeros(len(moving))
    else:
        joints, motors, E, offset = t.joints, t.motors, t.joint_from_motor, t.offset
    for name in joints:
        if name not in moving:
            hint = nearest(name, moving) or f"; it has {', '.join(moving)}"
            raise ManipulatorError(
                f"the URDF has no moving joint {name!r}{hint}", source=manipulator.source, place="transmission.joints"
            )
    locked = [model.getJointId(name) for name in model.names[1:] if name not in joints]
    if locked:
        model = pin.buildReducedModel(model, locked, pin.neutral(model))
    return model, tuple(joints), tuple(motors), E, offset


def _chain(model: pin.Model, ids: tuple[int, ...]) -> Chain:
    row = {i: k for k, i in enumerate(ids)}
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    axis, prismatic = [], []
    for i in ids:
        # one moving joint: Pinocchio gives a vector, not a matrix of one column
        motion = np.reshape(pin.getJointJacobian(model, data, i, pin.LOCAL), (6, -1))[:, model.joints[i].idx_v]
        prismatic.append(bool(motion[:3].any()))
        axis.append(motion[:3] if prismatic[-1] else motion[3:])
    placements = [model.jointPlacements[i] for i in ids]
    return Chain(
        order=np.array(sorted(range(len(ids)), key=lambda k: ids[k])),
        parent=np.array([row.get(model.parents[i], -1) for i in ids]),
        rotation=frozen_array([placement.rotation for placement in placements]),
        translation=frozen_array([placement.translation for placement in placements]),
        axis=frozen_array(axis),
        prismatic=np.array(prismatic),
        gravity=frozen_array(model.gravity.linear),
    )
