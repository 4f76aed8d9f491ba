"""What a cable arm looks like, as visual elements of its URDF: links, joint, guide and drive pulleys, winches, motors.

Each cable has its own layer across the joint axes and its own colour, so that one can follow it from its winch at the
base over the joints to the link it drives. Pulleys hang on the link that carries them: a link's drive pulley turns with
it, the joint guide pulleys of the cables that go on sit on the link before.
"""

from __future__ import annotations

import colorsys
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from .geometry import Link, Pulleys, Vector
from .routing import Routing, link_points, rotation_from_rpy, route

_GREY = {"plate": "0.75 0.77 0.8 1", "motor": "0.2 0.2 0.22 1"}


@dataclass(frozen=True)
class _Body:
    """A link element and the frame its cables run in."""

    element: Element
    rotation: Vector
    origin: Vector

    def _place(self, name: str, point: Vector, material: str) -> Element:
        visual = SubElement(self.element, "visual", name=name)
        xyz = self.origin + self.rotation @ point
        SubElement(visual, "origin", xyz=_text(xyz), rpy=_text(_rpy(self.rotation)))
        geometry = SubElement(visual, "geometry")
        SubElement(visual, "material", name=material)
        return geometry

    def disc(self, name: str, point: Vector, radius: float, width: float, material: str) -> None:
        SubElement(self._place(name, point, material), "cylinder", radius=_text([radius]), length=_text([width]))

    def box(self, name: str, point: Vector, size: tuple[float, float, float], material: str) -> None:
        SubElement(self._place(name, point, material), "box", size=_text(np.array(size)))


def add_materials(robot: Element, n: int) -> None:
    """Declare the colours: one per cable, greys for plates and motors."""
    colours = {f"cable_{i + 1}": colorsys.hsv_to_rgb(0.05 + 0.9 * i / max(n, 1), 0.75, 0.85) for i in range(n)}
    texts = {name: _text(np.array([*rgb, 1.0])) for name, rgb in colours.items()}
    for name, rgba in {**_GREY, **texts}.items():
        SubElement(SubElement(robot, "material", name=name), "color", rgba=rgba)


def add_visuals(elements: list[Element], links: tuple[Link, ...], pulleys: Pulleys) -> None:
    """Add visuals to the link elements of an arm, the base's first.

    Guide pulleys are drawn where the cable layer applies: on the base and on links whose joint axes are parallel.
    """
    n, routing = len(links), route(links)
    pitch = 0.6 * pulleys.link_pulley_radius
    spine, full = _plate_widths(pulleys)
    layer = pitch * (np.arange(n, dtype=np.float64) - (n - 1) / 2)
    _base(_bodies(elements[0], links, routing, 0)[0], pulleys, layer)
    for i, link in enumerate(links, start=1):
        body, plates = _bodies(elements[i], links, routing, i)
        body.disc(
            f"drive_pulley_{i}", _at(0, 0, layer[i - 1]), pulleys.joint_pulley_radius[i - 1], 0.7 * pitch, _own(i)
        )
        reach = float(np.linalg.norm(links[i].origin_xyz)) if i < n else link.length
        if reach:
            thickness = 0.5 * pitch
            side = n * pitch / 2 + (0.5 + i % 2) * thickness
            for name, z, height in (("front", side, spine), ("back", -side, full)):
                plates.box(f"plate_{name}", _at(reach / 2, 0, z), (reach, height, thickness), "plate")
        if i == n or routing.frames[i] is None:
            continue
        points = link_points(pulleys, i, reach)
        for j in range(i + 1, n + 1):
            for letter, place in (("A", "near_lower"), ("B", "near_upper"), ("C", "far_lower"), ("D", "far_upper")):
                point = points[letter] + _at(0, 0, layer[j - 1])
                body.disc(f"guide_{place}_{j}", point, pulleys.link_pulley_radius, 0.7 * pitch, _own(j))
        _joint_guides(body, i + 1, _at(reach, 0, 0), pulleys, layer)


def _base(body: _Body, pulleys: Pulleys, layer: Vector) -> None:
    """Plates, guide pulleys before joint 1, its joint guide pulleys, and the motors with their winches in a row."""
    n, pitch = len(layer), 0.6 * pulleys.link_pulley_radius
    x0, r_m = -2 * pulleys.link_pulley_distance, pulleys.motor_pulley_radius
    centres = x0 - r_m[0] - np.concatenate([[0.0], np.cumsum(r_m[:-1] + r_m[1:] + pitch)])
    depth = n * pitch / 2 + 0.25 * pitch
    for i in range(n):
        for place, sign in (("lower", -1), ("upper", 1)):
            point = _at(-pulleys.link_pulley_distance, sign * pulleys.link_pulley_offset, layer[i])
            body.disc(f"guide_far_{place}_{i + 1}", point, pulleys.link_pulley_radius, 0.7 * pitch, _own(i + 1))
        body.disc(f"winch_{i + 1}", _at(centres[i], 0, layer[i]), r_m[i], 0.7 * pitch, _own(i + 1))
        body.disc(f"motor_{i + 1}", _at(centres[i], 0, -depth - 0.5 * r_m[i]), 0.6 * r_m[i], r_m[i], "motor")
    _joint_guides(body, 1, np.zeros(3), pulleys, layer)
    length = -float(centres[-1]) + float(r_m[-1])
    spine, full = _plate_widths(pulleys)
    for name, z, height in (("front", depth, spine), ("back", -depth, full)):
        body.box(f"plate_{name}", _at(-length / 2, 0, z), (length, height, 0.5 * pitch), "plate")


def _plate_widths(pulleys: Pulleys) -> tuple[float, float]:
    """Give the widths of the front plates, a spine that leaves the guide pulleys in sight, and of the back plates."""
    return 0.8 * pulleys.link_pulley_offset, 2 * (pulleys.link_pulley_offset + pulleys.link_pulley_radius)


def _joint_guides(body: _Body, joint: int, centre: Vector, pulleys: Pulleys, layer: Vector) -> None:
    for j in range(joint + 1, len(layer) + 1):
        point = centre + _at(0, 0, layer[j - 1])
        radius, width = pulleys.joint_pulley_radius[joint - 1], 0.7 * 0.6 * pulleys.link_pulley_radius
        body.disc(f"joint_guide_{joint}_{j}", point, radius, width, _own(j))


def _bodies(element: Element, links: tuple[Link, ...], routing: Routing, k: int) -> tuple[_Body, _Body]:
    """Give link `k` (0 is the base) with the frame of its pulleys and with that of its plates."""
    origin = links[0].origin_xyz if k == 0 else np.zeros(3)
    frame = routing.frames[k]
    if frame is not None:
        return _Body(element, frame, origin), _Body(element, frame, origin)
    axis = links[k - 1].axis if k else rotation_from_rpy(links[0].origin_rpy) @ links[0].axis
    child = links[k].origin_xyz if 0 < k < len(links) else np.zeros(3)
    along = child if np.linalg.norm(child) > 0 else np.eye(3)[0]
    z, x = _triad(axis, along)
    pulleys = np.column_stack([x, np.cross(z, x), z])
    x, z = _triad(along, axis)
    return _Body(element, pulleys, origin), _Body(element, np.column_stack([x, np.cross(z, x), z]), origin)


def _triad(first: Vector, second: Vector) -> tuple[Vector, Vector]:
    """Give `first` as a unit vector and a unit vector across it, nearest to `second` where that is not parallel."""
    first = first / np.linalg.norm(first)
    across = second - (second @ first) * first
    if np.linalg.norm(across) < 1e-9:
        across = np.cross(first, np.eye(3)[np.argmin(np.abs(first))])
    return first, np.asarray(across / np.linalg.norm(across), dtype=np.float64)


def _rpy(rotation: Vector) -> Vector:
    """Roll, pitch, yaw of a rotation matrix."""
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    if np.hypot(rotation[0, 0], rotation[1, 0]) < 1e-9:
        return np.array([np.arctan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0])
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    return np.array([roll, pitch, np.arctan2(rotation[1, 0], rotation[0, 0])])


def _own(cable: int) -> str:
    return f"cable_{cable}"


def _at(x: float, y: float, z: float) -> Vector:
    return np.array([x, y, z], dtype=float)


def _text(values) -> str:
    return " ".join(repr(round(float(value), 12) + 0.0) for value in values)
