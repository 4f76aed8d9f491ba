"""Where the cables run: planes, sides, limits and points of contact (eqs 19, 26-31 and Figures 3, 4).

The cables of a link lie in a plane across its joint axes. Along link i they run from O_i to O_{i+1}, and "upper" is the
side to the left of that direction, seen against the joint axis (+y of the paper's link frames); each cable has an upper
and a lower side, the paper's tau_2 and tau_1.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .errors import GeometryError
from .geometry import Link, Pulleys, Vector, frozen_array

SIDES = ("upper", "lower")
SIDE_SIGN = frozen_array([1.0, -1.0])  # of y, and of the moment that a tension makes about the joint
PARALLEL = 1e-9  # how far unit vectors may differ and still be called parallel


@dataclass(frozen=True)
class Routing:
    """Where the cables run along each link; link 0 is the base.

    Attributes
    ----------
    frames : tuple of ndarray or None, length n_joints + 1
        Columns: along the cables, towards the upper side, along the joint axis, in the link's frame. None where the two
        joint axes of a link are not parallel, so that no plane holds its cables. For the last link, which no cable
        passes, x is the link's own.
    length : ndarray, shape (n_joints + 1,)
        From joint axis to joint axis [m]; zero for the base and the last link.
    bend : ndarray, shape (n_joints,)
        Angle between the cable directions of the two links at each joint, at joint position zero [rad].
    """

    frames: tuple[Vector | None, ...]
    length: Vector
    bend: Vector

    def run(self, link: int) -> Vector:
        """Give the frame of `link` (0 is the base).

        Raises
        ------
        GeometryError
            If its joint axes are not parallel.
        """
        frame = self.frames[link]
        if frame is None:
            raise GeometryError(
                f"the cable layer does not apply to link {link}: its two joint axes are not parallel, "
                "or lie in different planes of cables"
            )
        return frame


def route(links: tuple[Link, ...]) -> Routing:
    """Find the plane and the direction of the cables along every link.

    A paper arm (axes along z, links along x) has identity frames and no bend.

    Parameters
    ----------
    links : tuple of Link
        Base first.

    Returns
    -------
    Routing
    """
    first, last = links[0], links[-1]
    base = rotation_from_rpy(first.origin_rpy)
    frames: list[Vector | None] = [_frame(base @ first.axis, base[:, 0])]
    length = [0.0]
    for link, child in pairwise(links):
        child_axis = rotation_from_rpy(child.origin_rpy) @ child.axis
        along = float(child.origin_xyz @ link.axis)
        across = child.origin_xyz - along * link.axis
        distance = float(np.linalg.norm(across))
        flat = np.linalg.norm(child_axis - link.axis) < PARALLEL and abs(along) < PARALLEL and distance > PARALLEL
        frames.append(_frame(link.axis, across) if flat else None)
        length.append(distance)
    frames.append(_frame(last.axis, np.eye(3)[0]))
    bend = []
    for k, link in enumerate(links):
        before, after = frames[k], frames[k + 1]
        if before is None or after is None:
            bend.append(0.0)
            continue
        turned = before.T @ rotation_from_rpy(link.origin_rpy) @ after[:, 0]
        bend.append(float(np.arctan2(turned[1], turned[0])))
    return Routing(tuple(frames), frozen_array([*length, 0.0]), frozen_array(bend))


def _frame(z: Vector, x: Vector) -> Vector | None:
    """Give the frame with this axis whose x is nearest to `x`; None if they are parallel."""
    x = x - (x @ z) * z
    if np.linalg.norm(x) < PARALLEL:
        return None
    x = x / np.linalg.norm(x)
    return frozen_array(np.column_stack([x, np.cross(z, x), z]) + 0.0)


def rotation_from_rpy(rpy: Vector) -> Vector:
    """Give the rotation matrix of roll, pitch, yaw about fixed axes [rad], as URDF means them."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def joint_limits(links: tuple[Link, ...], pulleys: Pulleys) -> Vector:
    r"""Give how far each joint may turn before a cable leaves its joint pulley.

    Straight, each side wraps :math:`2\theta_{g0}`, hence the joint may bend by that much to either side (Figure 3,
    where the interior angle between the links is :math:`2\theta_{j0} = \pi - 2\theta_{g0}`).

    Returns
    -------
    ndarray, shape (n_joints, 2)
        Lower and upper joint position [rad].
    """
    bend = route(links).bend[:, None]
    return 2 * pulleys.wrap_half_angle[:, None] * [-1.0, 1.0] - bend


def link_points(pulleys: Pulleys, link: int, length: float) -> dict[str, Vector]:
    r"""Give the points of a link that cables touch, eqs (26)-(31).

    Parameters
    ----------
    pulleys : Pulleys
    link : int
        1 .. n_joints - 1, as the paper counts; joint `link` + 1 is at its far end.
    length : float
        l_i [m].

    Returns
    -------
    dict of str to ndarray, shape (3,)
        In the link's cable frame [m]: ``A, B`` (lower, upper) and ``C, D`` are the centres of the link guide pulleys at
        the near and at the far end, ``V, U`` (upper, lower) where the cable meets the pulley of the far joint.
    """
    d_j, d_g = pulleys.link_pulley_distance, pulleys.link_pulley_offset
    r_j, theta = pulleys.joint_pulley_radius[link], pulleys.wrap_half_angle[link]
    x, y = length - r_j * np.sin(theta), r_j * np.cos(theta)
    return {
        "A": np.array([d_j, -d_g, 0.0]),
        "B": np.array([d_j, d_g, 0.0]),
        "C": np.array([length - d_j, -d_g, 0.0]),
        "D": np.array([length - d_j, d_g, 0.0]),
        "V": np.array([x, y, 0.0]),
        "U": np.array([x, -y, 0.0]),
    }
