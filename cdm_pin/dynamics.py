"""Rigid-body dynamics over whole trajectories, in joint and in motor coordinates.

Everything takes (n_samples, n) arrays and works sample by sample in compiled code, in the order of the rows of E; the
tests hold it to Pinocchio. In both coordinates the state is given by the joints. Motor coordinates follow from
q = E q_m + offset: M_m = E' M E + J and so on, J the rotors' inertia; E may have more rows than columns.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from . import kernels
from .errors import ShapeError
from .geometry import Vector, frozen_array
from .model import CableModel, Chain

Coordinates = Literal["joint", "motor"]


def inverse_dynamics(
    model: CableModel,
    q: Vector,
    v: Vector,
    a: Vector,
    *,
    coordinates: Coordinates = "joint",
    rotors: bool | None = None,
) -> Vector:
    r"""Compute torques along a trajectory, :math:`\tau = M a + C v + G`, eq. (42).

    Parameters
    ----------
    model : CableModel
    q, v, a : ndarray, shape (n_samples, n_joints)
        Joint positions, velocities, accelerations [rad or m, s].
    coordinates : str
        "joint": torques of the joints, tau; "motor": of the motors, :math:`\tau_m = E'\tau`, eq. (16).
    rotors : bool, optional
        Add what accelerates the rotors; default in motor coordinates yes, in joint coordinates no.

    Returns
    -------
    ndarray, shape (n_samples, n_joints) or (n_samples, n_motors)
        [N m or N]; friction and other effects are not in it.

    Raises
    ------
    ShapeError
        If the arrays disagree with the model or with each other.
    """
    tau, _ = _rnea(model, q, v, a)
    if _with_rotors(coordinates, rotors):
        tau = tau + model.joint_array(a, "a") @ _reflected_rotors(model)
    return _choose(coordinates, joint=tau, motor=lambda: model.motor_torque(tau))


def motor_torques(model: CableModel, q: Vector, v: Vector, a: Vector, a_m: Vector | None = None) -> Vector:
    r"""Compute motor torques, :math:`\tau_m = E' \tau(q, v, a) + J a_m`.

    Parameters
    ----------
    model, q, v, a
        As for `inverse_dynamics`.
    a_m : ndarray, shape (n_samples, n_motors), optional
        Measured accelerations of the motors [rad/s^2]; default those that the joints' imply.

    Returns
    -------
    ndarray, shape (n_samples, n_motors)
        [N m].
    """
    rigid = model.motor_torque(inverse_dynamics(model, q, v, a))
    if a_m is None:
        a_m = model.joint_array(a, "a") @ model.motor_from_joint.T
    return rigid + model.rotor_inertia * a_m


def mass_matrix(
    model: CableModel, q: Vector, *, coordinates: Coordinates = "joint", rotors: bool | None = None
) -> Vector:
    """Compute M of eq. (42), shape (n_samples, n, n), as `inverse_dynamics` has it.

    Returns
    -------
    ndarray, shape (n_samples, n_joints, n_joints) or (n_samples, n_motors, n_motors)
        Symmetric; positive definite if all bodies are.
    """
    q = model.joint_array(q, "q")
    zero = np.zeros_like(q)
    units = [np.broadcast_to(unit, q.shape) for unit in np.eye(model.n_joints)]
    M = np.stack([_rnea(model, q, zero, unit, weight=False)[0] for unit in units], axis=-1)
    M = 0.5 * (M + np.swapaxes(M, 1, 2))
    if _with_rotors(coordinates, rotors):
        M = M + _reflected_rotors(model)
    E = model.joint_from_motor
    return _choose(coordinates, joint=M, motor=lambda: E.T @ M @ E)


def coriolis_matrix(model: CableModel, q: Vector, v: Vector, *, coordinates: Coordinates = "joint") -> Vector:
    r"""Compute C of eq. (42) by Christoffel symbols, so that :math:`\dot M - 2 C` is skew-symmetric.

    The Coriolis torque h(v) is quadratic in v; its symmetric bilinear form is
    :math:`C(q, v)\,u = (h(v + u) - h(v - u)) / 4`.

    Returns
    -------
    ndarray, shape (n_samples, n_joints, n_joints) or (n_samples, n_motors, n_motors)
    """
    q, v = model.joint_array(q, "q"), model.joint_array(v, "v")
    zero, E = np.zeros_like(q), model.joint_from_motor
    columns = []
    for unit in np.eye(model.n_joints):
        ahead, behind = (_rnea(model, q, v + u, zero, weight=False)[0] for u in (unit, -unit))
        columns.append((ahead - behind) / 4.0)
    C = np.stack(columns, axis=-1)
    return _choose(coordinates, joint=C, motor=lambda: E.T @ C @ E)


def gravity_torques(model: CableModel, q: Vector, *, coordinates: Coordinates = "joint") -> Vector:
    """Compute G of eq. (42), shape (n_samples, n_joints) or (n_samples, n_motors) [N m or N]."""
    zero = np.zeros_like(model.joint_array(q, "q"))
    return inverse_dynamics(model, q, zero, zero, coordinates=coordinates, rotors=False)


def forward_dynamics(
    model: CableModel,
    q: Vector,
    v: Vector,
    tau: Vector,
    *,
    coordinates: Coordinates = "joint",
    rotors: bool | None = None,
) -> Vector:
    """Compute accelerations from torques: the inverse of `inverse_dynamics`.

    Parameters
    ----------
    model : CableModel
    q, v : ndarray, shape (n_samples, n_joints)
        [rad or m, s].
    tau : ndarray, shape (n_samples, n_joints) or (n_samples, n_motors)
        In these coordinates [N m or N].
    coordinates, rotors
        As for `inverse_dynamics`.

    Returns
    -------
    ndarray, shape (n_samples, n_joints) or (n_samples, n_motors)
        Of the joints, or of the motors (joints: E a_m).

    Raises
    ------
    ShapeError
        If the arrays disagree with the model or with each other.
    """
    M = mass_matrix(model, q, coordinates=coordinates, rotors=rotors)
    zero = np.zeros_like(model.joint_array(q, "q"))
    bias = inverse_dynamics(model, q, v, zero, coordinates=coordinates)
    tau = np.atleast_2d(np.asarray(tau, dtype=float))
    if tau.shape != bias.shape:
        raise ShapeError(f"tau has shape {tau.shape}, {bias.shape} was expected")
    return np.asarray(np.linalg.solve(M, (tau - bias)[..., None])[..., 0], dtype=np.float64)


def joint_wrenches(model: CableModel, q: Vector, v: Vector, a: Vector) -> Vector:
    """Compute the wrench that crosses each joint, from parent to child.

    Returns
    -------
    ndarray, shape (n_samples, n_joints, 6)
        Force [N] and moment about the joint's origin [N m] in the child body's frame.
    """
    return _rnea(model, q, v, a)[1]


def joint_torque_regressor(model: CableModel, q: Vector, v: Vector, a: Vector) -> Vector:
    r"""Compute Y of :math:`\tau = Y(q, v, a)\,\pi_{std}` along a trajectory.

    Returns
    -------
    ndarray, shape (n_samples, n_joints, 10 n_joints)
        Columns in the order of `CableModel.standard_parameters`.
    """
    q, v, a = _trajectory(model, q, v, a)
    return kernels.regressor(*_tree(model.chain), q, v, a)


def _rnea(model: CableModel, q: Vector, v: Vector, a: Vector, *, weight: bool = True) -> tuple[Vector, Vector]:
    chain = model.chain if weight else replace(model.chain, gravity=frozen_array(np.zeros(3)))
    return kernels.rnea(*_tree(chain), model.standard_parameters, *_trajectory(model, q, v, a))


def _trajectory(model: CableModel, q: Vector, v: Vector, a: Vector) -> tuple[Vector, Vector, Vector]:
    arrays = [_read_only(model.joint_array(x, name)) for x, name in ((q, "q"), (v, "v"), (a, "a"))]
    if len({len(x) for x in arrays}) != 1:
        raise ShapeError(
            f"q, v and a have {', '.join(str(len(x)) for x in arrays)} samples, equal numbers were expected"
        )
    return arrays[0], arrays[1], arrays[2]


def _read_only(array: Vector) -> Vector:
    """Give a contiguous read-only view: to the compiler, arrays that may be written are of another type."""
    view = np.ascontiguousarray(array).view()
    view.setflags(write=False)
    return view


def _with_rotors(coordinates: Coordinates, rotors: bool | None) -> bool:
    return coordinates == "motor" if rotors is None else rotors


def _reflected_rotors(model: CableModel) -> Vector:
    """Give the rotors' inertia as the joints feel it, B' J B with q_m = B (q - offset); E' B' J B E = J."""
    B = model.motor_from_joint
    return B.T @ (model.rotor_inertia[:, None] * B)


def _choose(coordinates: Coordinates, *, joint: Vector, motor) -> Vector:
    if coordinates not in ("joint", "motor"):
        raise ValueError(f"coordinates are 'joint' or 'motor', found {coordinates!r}")
    return motor() if coordinates == "motor" else joint


def _tree(chain: Chain):
    return (
        chain.order,
        chain.parent,
        chain.rotation,
        chain.translation,
        chain.axis,
        chain.prismatic,
        chain.gravity,
    )
