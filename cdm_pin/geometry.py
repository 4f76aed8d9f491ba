"""What a cable-driven arm is made of, and the geometry of its pulleys (eqs 1, 2).

The paper is Yan et al., "Dynamic modelling and parameter identification for cable-driven manipulator".
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import GeometryError

Vector = NDArray[np.float64]


def frozen_array(values: Any, shape: tuple[int, ...] | None = None) -> Vector:
    """Copy `values` into a read-only float array."""
    array = np.array(values, dtype=float)
    if shape is not None:
        array = array.reshape(shape)
    array.setflags(write=False)
    return array


@dataclass(frozen=True)
class Link:
    """One rigid link, in its own frame: origin on its joint, x along the link.

    Attributes
    ----------
    name : str
    length : float
        From this joint's axis to the next joint's axis [m].
    mass : float
        [kg].
    center_of_mass : ndarray, shape (3,)
        [m].
    inertia : ndarray, shape (3, 3)
        About the centre of mass [kg m^2].
    axis : ndarray, shape (3,)
        Unit vector of this link's joint axis.
    origin_xyz, origin_rpy : ndarray, shape (3,)
        This joint's frame in the previous link's frame [m, rad].
    """

    name: str
    length: float
    mass: float
    center_of_mass: Vector
    inertia: Vector
    axis: Vector
    origin_xyz: Vector
    origin_rpy: Vector


@dataclass(frozen=True)
class Pulleys:
    """Radii and places of the pulleys; see Figure 3.

    Attributes
    ----------
    joint_pulley_radius : ndarray, shape (n_joints,)
        r_j, joint guide and joint drive pulleys [m].
    motor_pulley_radius : ndarray, shape (n_motors,)
        r_m, winches of the motors [m].
    link_pulley_radius : float
        r_g [m].
    link_pulley_offset : float
        d_g0, centre of a link guide pulley from the centre line [m].
    link_pulley_distance : float
        d_j0, from the joint axis along the link [m].
    """

    joint_pulley_radius: Vector
    motor_pulley_radius: Vector
    link_pulley_radius: float
    link_pulley_offset: float
    link_pulley_distance: float

    @cached_property
    def wrap_half_angle(self) -> Vector:
        """theta_g0 per joint [rad], shape (n_joints,)."""
        r_g, d_g0, d_j0 = self.link_pulley_radius, self.link_pulley_offset, self.link_pulley_distance
        return frozen_array([wrap_half_angle(r_j, r_g, d_g0, d_j0) for r_j in self.joint_pulley_radius])


@dataclass(frozen=True)
class Motor:
    """A motor at the base.

    Attributes
    ----------
    rotor_inertia : float
        At the winch [kg m^2].
    torque_limit, velocity_limit : float or None
        [N m], [rad/s].
    """

    rotor_inertia: float = 0.0
    torque_limit: float | None = None
    velocity_limit: float | None = None


@dataclass(frozen=True)
class Transmission:
    """The motor/joint map of a robot given by its URDF: q = E q_m + offset, tau_m = E' tau.

    Attributes
    ----------
    joints, motors : tuple of str
        Names of the rows and of the columns of E.
    joint_from_motor : ndarray, shape (n_joints, n_motors)
        E.
    offset : ndarray, shape (n_joints,)
        [rad or m].
    """

    joints: tuple[str, ...]
    motors: tuple[str, ...]
    joint_from_motor: Vector
    offset: Vector


@dataclass(frozen=True)
class Manipulator:
    """What a manipulator file or a model file says.

    Either `links` (with `pulleys`), or `urdf` (with an optional `transmission`).

    Attributes
    ----------
    name : str
    gravity : ndarray, shape (3,)
        In the base frame [m/s^2].
    links : tuple of Link
    pulleys : Pulleys or None
    pretension : float or None
        Tension of each side of a cable at rest [N]; None if it is not known.
    motors : tuple of Motor
        One per motor, or empty.
    urdf : Path or None
        The robot description of a robot that is not given by its links.
    transmission : Transmission or None
    effects : tuple of dict
        ``{effect, location, parameters}`` of a completed model.
    base_parameters : tuple of dict
        ``{name, value, std}`` of an identified model.
    source : Path or None
        The file it was read from.
    """

    name: str
    gravity: Vector
    links: tuple[Link, ...] = ()
    pulleys: Pulleys | None = None
    pretension: float | None = None
    motors: tuple[Motor, ...] = ()
    urdf: Path | None = None
    transmission: Transmission | None = None
    effects: tuple[dict[str, Any], ...] = field(default=())
    base_parameters: tuple[dict[str, Any], ...] = field(default=())
    source: Path | None = None


def wrap_half_angle(r_j: float, r_g: float, d_g0: float, d_j0: float) -> float:
    r"""Give the angle theta_g0 between the cable and the link, the physical root of eqs (1), (2).

    The cable is the inner tangent between joint pulley and link guide pulley, hence
    :math:`\theta_{g0} = \arcsin\frac{r_j + r_g}{D} - \mathrm{atan2}(d_{g0}, d_{j0})` with
    :math:`D = \sqrt{d_{j0}^2 + d_{g0}^2}`. Equation (1) is squared and has a second root, often the smaller one.

    Parameters
    ----------
    r_j, r_g : float
        Radii of the joint pulley and of the link guide pulley [m].
    d_g0, d_j0 : float
        Centre of the link guide pulley, across and along the link [m].

    Returns
    -------
    float
        theta_g0 [rad]; theta_j0 is its complement, eq. (2).

    Raises
    ------
    GeometryError
        If the pulleys overlap or the tangent leaves (0, 90) degrees.
    """
    distance = float(np.hypot(d_j0, d_g0))
    if r_j + r_g >= distance:
        raise GeometryError(
            f"eq. (1) has no root: joint pulley and link guide pulley overlap "
            f"(r_j + r_g = {r_j + r_g:g} m, distance of their centres {distance:g} m)"
        )
    theta = float(np.arcsin((r_j + r_g) / distance) - np.arctan2(d_g0, d_j0))
    if not 0.0 < theta < np.pi / 2:
        raise GeometryError(
            f"the cable cannot reach: its tangent makes {np.degrees(theta):.4g} deg with the link, "
            "between 0 and 90 deg was expected; link_pulley_offset is too large or too small for these radii"
        )
    return theta


def tangent_residual(theta_j0: float, r_j: float, r_g: float, d_g0: float, d_j0: float) -> float:
    """Give left side minus right side of eq. (1) [m^2]."""
    left = ((r_g * np.sin(theta_j0) - d_g0) / np.cos(theta_j0)) ** 2 + r_g**2
    return float(left - d_g0**2 - (d_j0 - r_j / np.cos(theta_j0)) ** 2)
