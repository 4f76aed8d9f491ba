r"""The forces that rigid-body dynamics alone cannot see: tensions, contacts of cables and pulleys, hinges, wrap.

With :math:`c, s = \cos, \sin \theta_{g0}` of a joint, a strand under unit tension that leaves link i's guide pulleys
for the joint at its far end pulls the link by :math:`(c, \pm s)` (upper, lower); one that leaves for the joint at its
near end by :math:`(-c, \pm s)`. Everything else is a sum of these: see docs/cables.md, also for where the printed
equations (13), (20)-(41) differ.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .dynamics import inverse_dynamics, joint_wrenches
from .errors import GeometryError
from .geometry import Pulleys, Vector
from .model import CableModel
from .routing import SIDE_SIGN, SIDES, link_points


@dataclass(frozen=True)
class CableState:
    """How tight the cables are along a trajectory; sides are upper and lower.

    Attributes
    ----------
    cable_torque : ndarray, shape (n_samples, n_cables)
        n_i of eq. (17), the torque that cable i puts on link i [N m].
    tension : ndarray, shape (n_samples, n_cables, 2)
        [N]; negative where that side would have to push. Without a known pretension, the change from it.
    slack : ndarray of bool, shape (n_samples, n_cables, 2)
        Where the tension is negative; nowhere if the pretension is not known.
    past_wrap : ndarray of bool, shape (n_samples, n_joints)
        Where a joint is bent past the mechanism's limit, so that a cable has left its joint pulley.
    """

    cable_torque: Vector
    tension: Vector
    slack: np.ndarray
    past_wrap: np.ndarray

    @property
    def valid(self) -> np.ndarray:
        """Where the cable model holds, shape (n_samples,)."""
        return np.logical_not(np.any(self.slack, axis=(1, 2)) | np.any(self.past_wrap, axis=1))

    def warnings(self) -> tuple[str, ...]:
        """Say where it does not hold, one sentence per cable side and joint."""
        n = len(self.tension)
        found = []
        for cable, side in zip(*np.nonzero(self.slack.any(axis=0)), strict=True):
            lowest = self.tension[:, cable, side].min()
            found.append(
                f"cable {cable + 1}, {SIDES[side]} side: would go slack in {self.slack[:, cable, side].sum()} of {n} "
                f"samples (down to {lowest:.4g} N); {-lowest:.4g} N more pretension would keep it tight"
            )
        for joint in np.flatnonzero(self.past_wrap.any(axis=0)):
            found.append(
                f"joint {joint + 1}: past its wrap limit in {self.past_wrap[:, joint].sum()} of {n} samples, "
                "where a cable leaves its joint pulley"
            )
        return tuple(found)


@dataclass(frozen=True)
class Contact:
    """One side of one cable on one pulley; cables, links and joints count from 1, link 0 is the base.

    Attributes
    ----------
    kind : str
        ``near_guide`` or ``far_guide`` (link guide pulleys), ``joint_guide``, or ``drive``.
    cable, joint : int
    link : int
        That carries the pulley.
    side : str
        ``upper`` or ``lower``.
    """

    kind: Literal["near_guide", "far_guide", "joint_guide", "drive"]
    cable: int
    joint: int
    link: int
    side: str


@dataclass(frozen=True)
class CableForces:
    """Contacts along a trajectory.

    Attributes
    ----------
    state : CableState
    contacts : tuple of Contact
        Names of the columns below.
    force : ndarray, shape (n_samples, n_contacts, 3)
        Of the cable on the pulley, in the frame of the link that carries it [N].
    point : ndarray, shape (n_samples, n_contacts, 3)
        Where it acts, in that frame [m]: the pulley's centre, for drive pulleys where the strand meets them.
    wrap : ndarray, shape (n_samples, n_contacts)
        Angle of contact [rad].
    hinge : ndarray, shape (n_samples, n_joints, 3)
        Force of link i - 1 on link i through the hinge, in link i's frame [N]; NaN where the layer does not apply.
    """

    state: CableState
    contacts: tuple[Contact, ...]
    force: Vector
    point: Vector
    wrap: Vector
    hinge: Vector

    def bearing_load(self) -> dict[tuple[str, int, int, str], Vector]:
        """Give the load of every pulley's bearing [N].

        Returns
        -------
        dict
            ``(kind, cable, joint, side)`` to shape (n_samples,); joint pulleys carry both sides on one bearing, their
            side is ``"both"``.
        """
        loads: dict[tuple[str, int, int, str], Vector] = {}
        for k, contact in enumerate(self.contacts):
            side = contact.side if contact.kind in ("near_guide", "far_guide") else "both"
            key = (contact.kind, contact.cable, contact.joint, side)
            loads[key] = loads.get(key, 0.0) + self.force[:, k]
        return {key: np.linalg.norm(force, axis=-1) for key, force in loads.items()}


def cable_state(model: CableModel, q: Vector, tau: Vector, pretension: float | None = None) -> CableState:
    r"""Compute tensions from joint torques, eqs (16), (17): :math:`\tau_{2,1} = \tau_0 \pm n_i / (2 r_j)`.

    Parameters
    ----------
    model : CableModel
        An arm of cables (given by links and pulleys), spatial ones included.
    q, tau : ndarray, shape (n_samples, n_joints)
        Joint positions [rad] and the joint torques that the cables make together [N m].
    pretension : float, optional
        tau_0 [N]; default the manipulator's.

    Raises
    ------
    GeometryError
        If the robot has no pulleys.
    """
    pulleys = _pulleys(model)
    q, tau = model.joint_array(q, "q"), model.joint_array(tau, "tau")
    pretension = model.manipulator.pretension if pretension is None else pretension
    pull = model.motor_torque(tau) / pulleys.motor_pulley_radius  # tau_2 - tau_1
    tension = (pretension or 0.0) + 0.5 * pull[..., None] * SIDE_SIGN
    return CableState(
        cable_torque=pull * pulleys.joint_pulley_radius,
        tension=tension,
        slack=(tension < 0.0) & (pretension is not None),
        past_wrap=np.asarray(np.any(wrap_angles(model, q) < 0.0, axis=-1)),
    )


def wrap_angles(model: CableModel, q: Vector) -> Vector:
    r"""Compute the angle over which each side lies on a joint guide pulley, :math:`2\theta_{g0} \mp \theta_i`.

    Parameters
    ----------
    model : CableModel
    q : ndarray, shape (n_samples, n_joints)
        [rad].

    Returns
    -------
    ndarray, shape (n_samples, n_joints, 2)
        Upper and lower side [rad]; negative past the mechanism's limit. Where the neighbouring axes are not parallel,
        the joint is taken to be straight at joint position zero.

    Raises
    ------
    GeometryError
        If the robot has no pulleys.
    """
    bend = model.joint_array(q, "q") + model.routing.bend
    return 2 * _pulleys(model).wrap_half_angle[:, None] - bend[..., None] * SIDE_SIGN


def hinge_reaction(
    model: CableModel,
    q: Vector,
    v: Vector,
    a: Vector,
    pretension: float | None = None,
    tau: Vector | None = None,
) -> Vector:
    r"""Compute the force that each hinge carries, the pull of the cables included.

    Cut free everything distal of hinge i. Inertia and gravity ask for the force that `joint_wrenches` gives; of it the
    strands that are cut provide :math:`-(c\Sigma_i, s\Delta_i)` in link i-1's frame (cable i, on its drive pulley) and
    :math:`(-c\Sigma_j, s\Delta_j)` in link i's (cables j > i, on its guide pulleys), with
    :math:`\Delta, \Sigma = \tau_2 \mp \tau_1`; the hinge provides the rest.

    Parameters
    ----------
    model : CableModel
    q, v, a : ndarray, shape (n_samples, n_joints)
        [rad, s].
    pretension : float, optional
        Tension of each side at rest [N]; default the manipulator's.
    tau : ndarray, shape (n_samples, n_joints), optional
        Joint torques that the cables make together [N m]; default those that the motion asks for.

    Returns
    -------
    ndarray, shape (n_samples, n_joints, 3)
        Force of link i - 1 on link i, in link i's frame [N].

    Raises
    ------
    GeometryError
        If the robot has no pulleys, or joint axes that are not parallel.
    """
    for link in range(model.n_joints):
        model.routing.run(link)
    tau = inverse_dynamics(model, q, v, a) if tau is None else tau
    return _hinge(model, q, v, a, cable_state(model, q, tau, pretension))


def cable_forces(
    model: CableModel,
    q: Vector,
    v: Vector,
    a: Vector,
    pretension: float | None = None,
    tau: Vector | None = None,
) -> CableForces:
    """Compute every contact of a cable with a pulley, and the hinge reactions.

    Contacts exist on the base and where a link's two joint axes are parallel; on other links the cable layer does not
    apply and they are left out.

    Parameters
    ----------
    model, q, v, a, pretension, tau
        As for `hinge_reaction`.

    Raises
    ------
    GeometryError
        If the robot has no pulleys.
    """
    tau = inverse_dynamics(model, q, v, a) if tau is None else tau
    state = cable_state(model, q, tau, pretension)
    contacts, unit_force, point, wrap = zip(*contact_geometry(model, model.joint_array(q, "q")), strict=True)
    tension = [state.tension[:, contact.cable - 1, SIDES.index(contact.side)] for contact in contacts]
    force = np.stack(unit_force, axis=1) * np.stack(tension, axis=1)[..., None]
    hinge = _hinge(model, q, v, a, state)
    return CableForces(state, contacts, force, np.stack(point, axis=1), np.stack(wrap, axis=1), hinge)


def contact_geometry(model: CableModel, q: Vector) -> Iterator[tuple[Contact, Vector, Vector, Vector]]:
    """Walk the contacts from the base to the tip.

    Yields
    ------
    contact : Contact
    unit_force : ndarray, shape (n_samples, 3)
        On the pulley per tension [N/N], in the frame of the link that carries it.
    point : ndarray, shape (n_samples, 3)
        [m].
    wrap : ndarray, shape (n_samples,)
        [rad].
    """
    n, pulleys, frames = model.n_joints, _pulleys(model), model.routing.frames
    turned = joint_rotations(model, q)
    wraps = wrap_angles(model, q)
    one = np.ones((len(q), 1))
    for joint in range(1, n + 1):
        link = joint - 1  # that the cables come along
        before, after = frames[link], frames[joint]
        theta = pulleys.wrap_half_angle[link]
        centre, radius = model.chain.translation[link], pulleys.joint_pulley_radius[link]
        R = turned[:, link]
        for k, (side, sign) in enumerate(zip(SIDES, SIDE_SIGN, strict=True)):
            along, arriving, leaving = np.eye(3)[0], _strand(1, sign, theta), _strand(-1, sign, theta)
            if before is not None:
                point = one * (before @ _link_points(model, link)["DC"[k]] + (centre if link == 0 else 0.0))
                for cable in range(joint, n + 1):
                    pull = one * (before @ (arriving - along))
                    yield Contact("far_guide", cable, joint, link, side), pull, point, one[:, 0] * theta
                meets = before @ (radius * np.array([-np.sin(theta), sign * np.cos(theta), 0.0]))  # V, U less O
                on_drive = -(before @ arriving) @ R, meets @ R, one[:, 0] * (np.pi / 2 + theta)  # eq. (19)
                yield Contact("drive", joint, joint, joint, side), *on_drive
            if after is not None and joint < n:
                point = one * (after @ _link_points(model, joint)["BA"[k]])
                for cable in range(joint + 1, n + 1):
                    pull = one * (after @ (leaving + along))
                    yield Contact("near_guide", cable, joint, joint, side), pull, point, one[:, 0] * theta
            if before is not None and after is not None:
                on_hub = -(before @ arriving) - R @ (after @ leaving)
                for cable in range(joint + 1, n + 1):
                    wrap = wraps[:, link, k]
                    yield Contact("joint_guide", cable, joint, link, side), on_hub, one * centre, wrap


def joint_rotations(model: CableModel, q: Vector) -> Vector:
    """Give the rotation of each link in the link before, shape (n_samples, n_joints, 3, 3) (revolute joints)."""
    chain = model.chain
    x, y, z = chain.axis.T
    zero = np.zeros_like(x)
    K = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    s, c = np.sin(q)[..., None, None], np.cos(q)[..., None, None]
    return chain.rotation @ (np.eye(3) + s * K + (1.0 - c) * (K @ K))


def _strand(direction: int, sign: float, theta: float) -> Vector:
    """Pull on a link by a strand of unit tension: direction 1 to the joint at its far end, -1 at its near end."""
    return np.array([direction * np.cos(theta), sign * np.sin(theta), 0.0])


def _hinge(model: CableModel, q: Vector, v: Vector, a: Vector, state: CableState) -> Vector:
    q = model.joint_array(q, "q")
    total = joint_wrenches(model, q, v, a)[..., :3]
    turned, frames, theta = joint_rotations(model, q), model.routing.frames, _pulleys(model).wrap_half_angle
    hinge = np.full_like(total, np.nan)
    for i in range(model.n_joints):
        before, after = frames[i], frames[i + 1]
        if before is None or (after is None and i + 1 < model.n_joints):
            continue
        hinge[:, i] = total[:, i]
        for k, sign in enumerate(SIDE_SIGN):
            arriving = before @ _strand(1, sign, theta[i])
            hinge[:, i] += state.tension[:, i, k, None] * (arriving @ turned[:, i])
            if after is not None:
                leaving = after @ _strand(-1, sign, theta[i])
                hinge[:, i] -= state.tension[:, i + 1 :, k].sum(axis=1)[:, None] * leaving
    return hinge


def _link_points(model: CableModel, link: int) -> dict[str, Vector]:
    """Points A to D of a link in its cable frame; the base's lie behind joint 1, its frame's origin."""
    return link_points(_pulleys(model), link, float(model.routing.length[link]))


def _pulleys(model: CableModel) -> Pulleys:
    if model.manipulator.pulleys is None:
        raise GeometryError(
            "the cable layer does not apply: the robot is given by a URDF, without pulleys",
            source=model.manipulator.source,
        )
    return model.manipulator.pulleys
