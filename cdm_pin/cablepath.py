"""The path of every cable side through space: tangents and wraps as polylines, ready to be drawn.

A side leaves the winch of its motor, bends over a guide pulley of the base, and then, at every joint on its way, wraps
the joint pulley and runs along the next link between that link's guide pulleys, until it ends on the pulley that drives
its own link. In a link's cable frame everything but the wraps is fixed (eqs 1, 2 and 26-31), so a polyline is made of
points that move with bodies, and of arcs about joint axes whose sweep follows the joint angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .geometry import Manipulator, Pulleys
from .routing import SIDE_SIGN, SIDES, Routing, route

ARC, GUIDE_ARC, RUN = 7, 2, 3  # segments of a joint wrap, of a guide wrap, of the run along a link


@dataclass(frozen=True)
class CableSide:
    """One side of one cable.

    Attributes
    ----------
    cable : int
        From 0; cable i drives link i.
    side : str
        "upper" or "lower".
    height : float
        Of its plane along the joint axis [m], so that cables lie beside each other.
    pieces : tuple
        From the winch on, see `Fixed` and `Wrap`.
    """

    cable: int
    side: str
    height: float
    pieces: tuple[Fixed | Wrap, ...]


@dataclass(frozen=True)
class Fixed:
    """Points that move with one body.

    Attributes
    ----------
    body : int
        Row of E; -1 is the base.
    points : ndarray, shape (m, 3)
        In the body's frame [m].
    sag : ndarray, shape (m, 3)
        Where each point moves for a slack cable [m].
    """

    body: int
    points: np.ndarray
    sag: np.ndarray


@dataclass(frozen=True)
class Wrap:
    """An arc about a joint axis.

    Attributes
    ----------
    joint : int
        Row of E; the arc is described in the frame of this joint's body.
    frame : ndarray, shape (3, 3)
        Columns along the cables, to the upper side and along the axis, in that frame.
    radius, height : float
        [m].
    end : float
        Angle at which the arc ends, in `frame` [rad].
    sweep : float
        Angle from start to end at joint position zero, to which the joint position adds [rad].
    side : float
        +1 for an upper side (its sweep is never positive), -1 for a lower one.
    """

    joint: int
    frame: np.ndarray
    radius: float
    height: float
    end: float
    sweep: float
    side: float


def cable_sides(manipulator: Manipulator) -> tuple[CableSide, ...]:
    """Lay out both sides of every cable, cable 1 first, upper before lower.

    Parameters
    ----------
    manipulator : Manipulator
        Given by links and pulleys; else there are no cables and the result is empty. The same holds for cables that
        pass a link whose joint axes are not parallel: their path is not defined.
    """
    if manipulator.pulleys is None or not manipulator.links:
        return ()
    routing = route(manipulator.links)
    n = len(manipulator.links)
    pitch = 0.25 * float(manipulator.pulleys.joint_pulley_radius.min())
    sides = []
    for cable in range(n):
        if any(routing.frames[link] is None for link in range(cable + 2)):
            break
        height = pitch * (cable - (n - 1) / 2)
        for side, sign in zip(SIDES, SIDE_SIGN, strict=True):
            pieces = _pieces(manipulator, manipulator.pulleys, routing, cable, float(sign), height)
            sides.append(CableSide(cable, side, height, pieces))
    return tuple(sides)


def cable_paths(
    sides: Sequence[CableSide], poses: np.ndarray, q: np.ndarray, slack: np.ndarray | None = None, arc: int = ARC
) -> list[np.ndarray]:
    """Give the polylines of all cable sides.

    Parameters
    ----------
    sides : sequence of CableSide
    poses : ndarray, shape (n_samples, n_joints, 4, 4)
        From `poses.body_poses`.
    q : ndarray, shape (n_samples, n_joints)
        [rad].
    slack : ndarray, shape (n_samples, n_sides), optional
        1 for a side that hangs slack, 0 for a taut one.
    arc : int
        Segments per wrap of a joint pulley.

    Returns
    -------
    list of ndarray, shape (n_samples, m, 3)
        One per side [m], from the winch to the end on the driven link.
    """
    paths = []
    for k, side in enumerate(sides):
        loose = np.zeros(len(q)) if slack is None else np.asarray(slack, float)[:, k]
        parts = []
        for piece in side.pieces:
            if isinstance(piece, Wrap):
                parts.append(_to_base(poses, piece.joint, _arc_points(piece, q[:, piece.joint], arc)))
            else:
                points = piece.points + loose[:, None, None] * piece.sag
                parts.append(points if piece.body < 0 else _to_base(poses, piece.body, points))
        paths.append(np.concatenate(parts, axis=1))
    return paths


def motor_centres(pulleys: Pulleys) -> np.ndarray:
    """Give the axes of the winches in the base's cable frame [m], shape (n_motors, 3): in a row behind the base."""
    radius = float(pulleys.motor_pulley_radius.max())
    first = pulleys.link_pulley_distance + pulleys.link_pulley_radius + 1.6 * radius
    count = len(pulleys.motor_pulley_radius)
    return np.column_stack([-first - 2.4 * radius * np.arange(count), np.zeros(count), np.zeros(count)])


def _pieces(m: Manipulator, pulleys: Pulleys, routing: Routing, cable: int, sign: float, height: float):
    """From winch to driven link; the upper side is laid out and mirrored for the lower one."""
    r_j, r_g = pulleys.joint_pulley_radius, pulleys.link_pulley_radius
    d_j, d_g = pulleys.link_pulley_distance, pulleys.link_pulley_offset
    mirror = np.array([1.0, sign])
    winch = (motor_centres(pulleys)[cable, :2], float(pulleys.motor_pulley_radius[cable]))
    guide = (np.array([-d_j, d_g]), -r_g)
    joint = (np.zeros(2), float(r_j[0]))
    out, into = tangent(*winch, *guide), tangent(*guide, *joint)
    base = [_arc(*winch, np.pi, out, 4), _arc(*guide, out, into, GUIDE_ARC)]
    pieces: list[Fixed | Wrap] = [_fixed(-1, m.links[0].origin_xyz, routing.run(0), mirror, height, base)]
    for link in range(cable + 1):
        arrive = into
        if link == cable:
            pieces.append(_wrap(link, routing, float(r_j[link]), height, arrive, 0.0, sign))
            break
        length = float(routing.length[link + 1])
        near, far = (np.array([d_j, d_g]), -r_g), (np.array([length - d_j, d_g]), -r_g)
        leave = tangent(np.zeros(2), float(r_j[link]), *near)
        into = tangent(*far, np.array([length, 0.0]), float(r_j[link + 1]))
        pieces.append(_wrap(link, routing, float(r_j[link]), height, arrive, leave, sign))
        along = [_arc(*near, leave, LEVEL, GUIDE_ARC), _arc(*far, LEVEL, into, GUIDE_ARC)]
        pieces.append(_fixed(link, np.zeros(3), routing.run(link + 1), mirror, height, along, 0.3 * float(r_j[link])))
    return tuple(pieces)


LEVEL = np.pi / 2  # normal of a strand that runs along its link


def tangent(c1: np.ndarray, s1: float, c2: np.ndarray, s2: float) -> float:
    r"""Give the angle of the left normal of the strand from one pulley to the next.

    A strand along :math:`d` with left normal :math:`n` touches pulley i at :math:`c_i + s_i n`, with :math:`s_i` its
    radius, positive where the pulley lies to the right. Hence :math:`c_2 - c_1 = L d + (s_1 - s_2) n`.

    Parameters
    ----------
    c1, c2 : ndarray, shape (2,)
        Centres [m].
    s1, s2 : float
        Signed radii [m].

    Returns
    -------
    float
        [rad].
    """
    apart = c2 - c1
    length = np.sqrt(apart @ apart - (s1 - s2) ** 2)
    return float(np.arctan2(apart[1], apart[0]) - np.arctan2(s1 - s2, length) + np.pi / 2)


def _arc(centre: np.ndarray, s: float, start: float, end: float, count: int) -> np.ndarray:
    """Give points on a pulley between the normals of two strands."""
    angle = np.linspace(start, end, count + 1)
    return centre + s * np.column_stack([np.cos(angle), np.sin(angle)])


def _fixed(body, origin, frame, mirror, height, arcs: list[np.ndarray], sag: float = 0.0) -> Fixed:
    """Join two arcs by a straight run, cut in pieces that can sag, and place them in the body."""
    before, after = arcs
    s = np.linspace(0, 1, RUN + 1)[1:-1, None]
    run = (1 - s) * before[-1] + s * after[0]
    flat = np.vstack([before, run, after]) * mirror
    drop = np.zeros_like(flat)
    drop[len(before) : len(before) + len(run), 1] = (4 * sag * s * (1 - s))[:, 0] * mirror[1]
    points = np.column_stack([flat, np.full(len(flat), height)])
    return Fixed(body, origin + points @ frame.T, np.column_stack([drop, np.zeros(len(flat))]) @ frame.T)


def _wrap(joint: int, routing: Routing, radius: float, height: float, arrive: float, leave: float, sign: float) -> Wrap:
    """Describe the arc about a joint, from a strand that is fixed before it to one (or to an end) fixed behind it."""
    sweep = sign * (leave - arrive) + float(routing.bend[joint])
    return Wrap(joint, routing.run(joint + 1), radius, height, sign * leave, sweep, sign)


def _arc_points(wrap: Wrap, q: np.ndarray, count: int) -> np.ndarray:
    """Give the points of a wrap in the frame of its body; an arc that has run out is a point."""
    sweep = wrap.sweep + q
    sweep = np.minimum(sweep, 0.0) if wrap.side > 0 else np.maximum(sweep, 0.0)
    angle = wrap.end - np.linspace(1, 0, count + 1) * sweep[:, None]
    flat = np.stack([wrap.radius * np.cos(angle), wrap.radius * np.sin(angle), np.full_like(angle, wrap.height)], -1)
    return flat @ wrap.frame.T


def _to_base(poses: np.ndarray, body: int, points: np.ndarray) -> np.ndarray:
    pose = poses[:, body]
    return points @ pose[:, :3, :3].transpose(0, 2, 1) + pose[:, None, :3, 3]
