r"""A Newton-Euler recursion in which every pulley pulls its own link: a second route to the motor torques.

It shares no line with `cdm_pin.dynamics` and does not know the transmission matrix: from the tip to the base, the
moment balance of each link gives the tension difference of its cable from the points and directions of its contacts
alone, and the force balance gives the hinge. That it agrees with RNEA and E says that contacts and hinges are right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .cables import contact_geometry, joint_rotations
from .errors import GeometryError
from .geometry import Vector
from .model import CableModel
from .routing import SIDE_SIGN, SIDES


@dataclass(frozen=True)
class Recursion:
    """What the recursion finds along a trajectory.

    Attributes
    ----------
    cable_torque : ndarray, shape (n_samples, n_cables)
        n_i, the torque that cable i puts on link i [N m].
    motor_torque : ndarray, shape (n_samples, n_motors)
        [N m].
    tension : ndarray, shape (n_samples, n_cables, 2)
        Upper and lower side [N].
    hinge : ndarray, shape (n_samples, n_joints, 3)
        Force of link i - 1 on link i through the hinge, in link i's frame [N].
    """

    cable_torque: Vector
    motor_torque: Vector
    tension: Vector
    hinge: Vector


def newton_euler(model: CableModel, q: Vector, v: Vector, a: Vector, pretension: float = 0.0) -> Recursion:
    r"""Balance forces and moments link by link, eqs (7)-(15) with each pulley's contact force where it acts.

    .. math::
        f_i &= F_i + R f_{i+1} - \sum\text{(forces of cables on pulleys of link i)} \\
        n_i &= \hat z \cdot (N_i + R m_{i+1} + P_{i+1} \times R f_{i+1} - \sum\text{(their moments)})

    The hinge is free of moment about its axis, so n_i comes from the drive pulley of cable i. Equation (13) as printed
    adds the cables' forces and (8) mixes up indices; these are the standard balances.

    Parameters
    ----------
    model : CableModel
        An arm of cables whose joint axes are all parallel.
    q, v, a : ndarray, shape (n_samples, n_joints)
        [rad, s].
    pretension : float
        tau_0 [N].

    Returns
    -------
    Recursion

    Raises
    ------
    GeometryError
        If the robot has no pulleys, or joint axes that are not parallel.
    """
    pulleys = model.manipulator.pulleys
    if pulleys is None:
        raise GeometryError("the cable layer does not apply: the robot is given by a URDF, without pulleys")
    n = model.n_joints
    for link in range(n):
        model.routing.run(link)
    q, v, a = (model.joint_array(x, name) for x, name in ((q, "q"), (v, "v"), (a, "a")))
    turned, F, N = link_wrenches(model, q, v, a)
    contacts = list(contact_geometry(model, q))
    tension = np.full((len(q), n, 2), np.nan)
    hinge, cable_torque = np.empty((len(q), n, 3)), np.empty((len(q), n))
    moment = np.zeros((len(q), 3))  # that the hinge of the link beyond carries, in this link's frame
    force = np.zeros((len(q), 3))
    for i in range(n - 1, -1, -1):
        force, moment = force + F[:, i], moment + N[:, i]
        drive: dict[str, tuple[Vector, Vector]] = {}
        for contact, unit_force, point, _ in contacts:
            if contact.link != i + 1:
                continue
            unit_moment = np.cross(point, unit_force)
            if contact.kind == "drive":
                drive[contact.side] = unit_force, unit_moment
                continue
            pull = tension[:, contact.cable - 1, SIDES.index(contact.side), None]
            force, moment = force - pull * unit_force, moment - pull * unit_moment
        axis = model.chain.axis[i]
        arms = np.stack([drive[side][1] @ axis for side in SIDES], axis=1)
        difference = (moment @ axis - pretension * arms.sum(axis=1)) / (0.5 * (arms @ SIDE_SIGN))
        tension[:, i] = pretension + 0.5 * difference[:, None] * SIDE_SIGN
        cable_torque[:, i] = np.sum(tension[:, i] * arms, axis=1)
        for k, side in enumerate(SIDES):
            force = force - tension[:, i, k, None] * drive[side][0]
            moment = moment - tension[:, i, k, None] * drive[side][1]
        hinge[:, i] = force
        force = _turn(turned[:, i], force)
        moment = _turn(turned[:, i], moment) + np.cross(model.chain.translation[i], force)
    motor_torque = (tension @ SIDE_SIGN) * pulleys.motor_pulley_radius
    return Recursion(cable_torque, motor_torque, tension, hinge)


def link_wrenches(model: CableModel, q: Vector, v: Vector, a: Vector) -> tuple[Vector, Vector, Vector]:
    """Advance the motion from base to tip and give what each link's own inertia and weight ask for, eqs (7)-(12).

    Returns
    -------
    rotation : ndarray, shape (n_samples, n_joints, 3, 3)
        Of each link in the link before.
    force, moment : ndarray, shape (n_samples, n_joints, 3)
        F_i [N] and the moment about O_i [N m], in link i's frame (the paper's N_i + P_C x F_i).
    """
    chain = model.chain
    turned = joint_rotations(model, q)
    w, dw = np.zeros((len(q), 3)), np.zeros((len(q), 3))
    acceleration = np.broadcast_to(-chain.gravity, (len(q), 3))
    force, moment = np.empty((len(q), model.n_joints, 3)), np.empty((len(q), model.n_joints, 3))
    for i in range(model.n_joints):
        back, p, axis = np.swapaxes(turned[:, i], 1, 2), chain.translation[i], chain.axis[i]
        acceleration = _turn(back, acceleration + np.cross(dw, p) + np.cross(w, np.cross(w, p)))
        spin = v[:, i, None] * axis
        w_before = _turn(back, w)
        dw = _turn(back, dw) + np.cross(w_before, spin) + a[:, i, None] * axis
        w = w_before + spin
        m, mc, (xx, xy, yy, xz, yz, zz) = np.split(model.standard_parameters[10 * i : 10 * i + 10], [1, 4])
        I = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        force[:, i] = m * acceleration + np.cross(dw, mc) + np.cross(w, np.cross(w, mc))
        moment[:, i] = dw @ I + np.cross(w, w @ I) + np.cross(mc, acceleration)
    return turned, force, moment


def _turn(R: Vector, x: np.ndarray) -> Vector:
    return np.einsum("sij,sj->si", R, x)
