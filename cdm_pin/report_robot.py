"""The picture of the robot in a report, with the places of the findings marked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from . import svg
from .cablepath import cable_paths, cable_sides, motor_centres
from .model import CableModel
from .poses import body_poses
from .routing import route
from .svg import BLUE, VERMILLION

Points = np.ndarray


def robot_picture(model: CableModel, locations: Sequence[Mapping[str, Any]], q: np.ndarray | None = None) -> str:
    """Draw the robot as lines and circles, and ring each of the given places with its number.

    Parameters
    ----------
    model : CableModel
    locations : sequence of mappings
        Places as in diagnosis.json, numbered from 1.
    q : ndarray, shape (n_joints,), optional
        The pose [rad or m]; a bent one by default.

    Returns
    -------
    str
        An SVG element.
    """
    robot = Skeleton(model, bent_pose(model) if q is None else np.asarray(q, float))
    paper = _Paper(np.vstack([robot.joints, robot.ends, robot.motors, robot.base[None], *robot.pulleys]))
    ink = [paper.base(robot.base)]
    for joint, end in zip(robot.joints, robot.ends, strict=True):
        ink.append(paper.path([joint, end], "#C9D3DC", 14) + paper.path([joint, end], "#7A8894", 2))
    ink += [paper.path(circle, "#9AA5AF", 1.2, fill="#EEF1F4") for circle in robot.pulleys]
    ink += [paper.path(cable, BLUE, 1.3) for cable in robot.cables]
    for i, joint in enumerate(robot.joints):
        ink.append(paper.circle(joint, 8, "#FFFFFF", "#333333") + paper.number(joint, i + 1))
    if robot.cables:
        for i, motor in enumerate(robot.motors):
            ink.append(paper.square(motor) + paper.number(motor, i + 1))
    marks = [_mark(paper, number, location, robot) for number, location in enumerate(locations, start=1)]
    names = f"robot with {model.n_joints} joints and {len(locations)} marked places"
    return svg.svg(paper.width, paper.height, "".join(ink + marks), names)


def bent_pose(model: CableModel) -> np.ndarray:
    """Give a pose in which every joint is seen to be one, shape (n_joints,)."""
    q = np.where(np.arange(model.n_joints) % 2 == 0, 0.5, -0.7)
    return np.where(model.chain.prismatic, 0.1 * q, q)


class Skeleton:
    """Points of a robot on paper [m]: a planar arm along its axes, any other from the side and above."""

    def __init__(self, model: CableModel, q: np.ndarray):
        poses = body_poses(model.chain, q[None])[0]
        view = np.eye(3)[:2] if model.planar else np.array([[0.83, -0.55, 0.0], [-0.16, -0.24, 0.96]])
        self.joints = poses[:, :3, 3] @ view.T
        self.ends = self.joints + np.einsum("kij,kj->ki", poses[:, :3, :3], reach(model)) @ view.T
        self.base = np.zeros(2)
        self.cables: list[Points] = []
        self.pulleys: list[Points] = []
        sides = cable_sides(model.manipulator)
        pulleys = model.manipulator.pulleys
        if pulleys is None or not sides:
            self.motors = self.joints[np.abs(model.joint_from_motor).argmax(0)]
            return
        self.cables = [path[0] @ view.T for path in cable_paths(sides, poses[None], q[None])]
        first = model.manipulator.links[0]
        frame = route(model.manipulator.links).run(0)
        centres = first.origin_xyz + motor_centres(pulleys) @ frame.T
        self.motors = centres @ view.T
        self.base = self.joints[0]
        ring = np.linspace(0, 2 * np.pi, 33)
        ring = np.column_stack([np.cos(ring), np.sin(ring), 0 * ring])
        for centre, radius in zip(centres, pulleys.motor_pulley_radius, strict=True):
            self.pulleys.append((centre + radius * ring @ frame.T) @ view.T)
        frames = route(model.manipulator.links).frames
        for pose, radius, local in zip(poses, pulleys.joint_pulley_radius, frames[1:], strict=True):
            turned = pose[:3, :3] @ (np.eye(3) if local is None else local)
            self.pulleys.append((pose[:3, 3] + radius * ring @ turned.T) @ view.T)


def reach(model: CableModel) -> Points:
    """Give where each link ends, in its own frame [m]: at its child's joint, else along its length or its mass."""
    ends = np.zeros((model.n_joints, 3))
    for k in range(model.n_joints):
        children = np.flatnonzero(model.chain.parent == k)
        links = model.manipulator.links
        if len(children):
            ends[k] = model.chain.translation[children[0]]
        elif links:
            ends[k] = [links[k].length, 0.0, 0.0]
        else:
            ends[k] = 2 * np.asarray(model.pin_model.inertias[model.joint_ids[k]].lever)
    return ends


class _Paper:
    """Metres to pixels, and the few shapes of the picture."""

    def __init__(self, points: Points, width: int = 440, height: int = 300, margin: int = 34):
        low, high = points.min(0), points.max(0)
        span = np.maximum(high - low, 1e-6)
        self.scale = float(min((width - 2 * margin) / span[0], (height - 2 * margin) / span[1]))
        self.width, self.height = width, int(self.scale * span[1] + 2 * margin)
        self.offset = np.array([(width - self.scale * span[0]) / 2, margin]) - self.scale * low
        self.marked: Counter[tuple[int, int]] = Counter()  # how many numbers stand at a spot

    def at(self, point: Points) -> tuple[float, float]:
        x, y = self.scale * np.asarray(point) + self.offset
        return float(x), float(self.height - y)

    def path(self, points: Iterable[Points], colour: str, width: float, extra: str = "", fill: str = "none") -> str:
        words = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(self.at, points))
        return (
            f'<polyline points="{words}" fill="{fill}" stroke="{colour}" stroke-width="{width}" '
            f'stroke-linecap="round" stroke-linejoin="round" {extra}/>'
        )

    def circle(self, point: Points, radius: float, fill: str, stroke: str, extra: str = "") -> str:
        x, y = self.at(point)
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{fill}" stroke="{stroke}" {extra}/>'

    def square(self, point: Points) -> str:
        x, y = self.at(point)
        return f'<rect x="{x - 8:.1f}" y="{y - 8:.1f}" width="16" height="16" rx="2" fill="#FFFFFF" stroke="#333333"/>'

    def number(self, point: Points, number: int) -> str:
        x, y = self.at(point)
        return svg.text(x, y + 4, str(number), anchor="middle")

    def base(self, point: Points) -> str:
        x, y = self.at(point)
        hatch = "".join(f"M{x - 14 + 7 * k:.1f} {y + 10:.1f}l-6 7" for k in range(5))
        return f'<path d="M{x - 16:.1f} {y + 10:.1f}h32{hatch}" stroke="#333333" fill="none"/>'


def _mark(paper: _Paper, number: int, location: Mapping[str, Any], robot: Skeleton) -> str:
    kind, index = location.get("kind"), int(location.get("index", 1)) - 1
    joints, ends, motors = robot.joints, robot.ends, robot.motors
    spots, under = [robot.base], ""
    if kind == "joint" and index < len(joints):
        spots = [joints[index]]
    elif kind == "motor" and index < len(motors):
        spots = [motors[index]]
    elif kind == "link" and index < len(joints):
        under = paper.path([joints[index], ends[index]], VERMILLION, 5)
        spots = [(joints[index] + ends[index]) / 2]
    elif kind == "cable" and index < len(motors):
        under = "".join(paper.path(side, VERMILLION, 3) for side in robot.cables[2 * index : 2 * index + 2])
        spots = [_cable_spot(location, index, robot)]
    elif kind == "combination":
        weights = np.asarray(location.get("weights", []), float)
        spots = [motors[i] for i in np.flatnonzero(np.abs(weights) > 1e-9) if i < len(motors)]
        under = paper.path(spots, VERMILLION, 2, 'stroke-dasharray="4 3"') if len(spots) > 1 else ""
    return under + "".join(_ring(paper, spot, number) for spot in spots)


def _cable_spot(location: Mapping[str, Any], index: int, robot: Skeleton) -> Points:
    """Give the place on a cable that is meant: a joint or the guides of a link on its way, else its own joint."""
    last = len(robot.joints) - 1
    if "link" in location and 0 < int(location["link"]) <= last + 1:
        link = int(location["link"]) - 1
        return (robot.joints[link] + robot.ends[link]) / 2
    if "link" in location:
        return (robot.base + robot.motors[index]) / 2
    return robot.joints[min(int(location.get("joint", index + 1)) - 1, last)]


def _ring(paper: _Paper, spot: Points, number: int) -> str:
    """Ring a spot; numbers at one spot stand side by side."""
    x, y = paper.at(spot)
    ring = paper.circle(spot, 15, "none", VERMILLION, 'stroke-width="3.5" class="mark"')
    right = x + 16 + 19 * paper.marked[round(x), round(y)]
    paper.marked[round(x), round(y)] += 1
    badge = f'<circle cx="{right:.1f}" cy="{y - 17:.1f}" r="9" fill="{VERMILLION}"/>'
    return (
        ring + badge + svg.text(right, y - 13, str(number), anchor="middle", extra='fill="#FFFFFF" font-weight="700"')
    )
