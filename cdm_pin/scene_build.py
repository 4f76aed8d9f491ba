"""A scene from a model: links, pulleys, winches and cables of an arm given by its links; meshes of any other robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from .cablepath import ARC, cable_sides, motor_centres
from .geometry import Manipulator, Pulleys
from .model import CableModel
from .report_robot import reach
from .routing import Routing, route
from .scene import Part, Scene, Spot, Turning

Colour = tuple[float, float, float, float]
LINK, JOINT, GUIDE, WINCH, SPOKE = (
    (0.76, 0.80, 0.84, 1.0), (0.45, 0.53, 0.60, 1.0), (0.55, 0.61, 0.66, 1.0), (0.30, 0.35, 0.40, 1.0),
    (0.95, 0.95, 0.95, 1.0),
)  # fmt: skip
WHITE = (1.0, 1.0, 1.0, 1.0)  # of what is coloured at every frame


def build_scene(
    model: CableModel,
    root: str = "robot",
    *,
    colour: Colour | None = None,
    contacts: tuple[int, ...] = (),
    arc: int = ARC,
) -> Scene:
    """Build the scene of a robot.

    Parameters
    ----------
    model : CableModel
    root : str
        First part of all its paths, for several robots in one scene.
    colour : tuple of float, optional
        Of everything, with opacity, in place of the parts' own; such a robot is a ghost: it has no discs and no marks.
    contacts : tuple of int
        Bodies of the pulley contacts whose forces are to be drawn (row of E, -1 for the base).
    arc : int
        Segments of each wrap.
    """
    size = float(np.linalg.norm(model.chain.translation, axis=1).sum() + np.linalg.norm(reach(model)[-1])) or 1.0
    m = model.manipulator
    if m.pulleys is not None and m.links:
        parts, turning, discs, marks, radius = _arm(model, m.pulleys)
    else:
        parts, discs, marks, radius = _robot(model, size)
        turning = ()
    if colour is not None:
        bare = [p for p in parts if not p.path.startswith(("residual_", "mark_"))]
        parts = tuple(replace(part, colour=colour) for part in bare)
        discs, marks = (), ()
    sides = cable_sides(m)
    return Scene(
        root, _upright(m), model.chain, parts, turning, sides, radius, tuple(discs), tuple(marks), size, contacts, arc
    )


def _upright(manipulator: Manipulator) -> np.ndarray:
    """Turn the base so that gravity points down."""
    out = np.eye(4)
    strength = np.linalg.norm(manipulator.gravity)
    if strength > 0:
        quaternion = pin.Quaternion.FromTwoVectors(manipulator.gravity / strength, np.array([0.0, 0.0, -1.0]))
        out[:3, :3] = quaternion.toRotationMatrix()
    return out


def _arm(model: CableModel, pulleys: Pulleys):
    """Parts of an arm of cables over pulleys."""
    links, routing, n = model.manipulator.links, route(model.manipulator.links), model.n_joints
    thin = float(pulleys.joint_pulley_radius.min())
    pitch, stack = 0.25 * thin, 0.25 * thin * n
    parts, turning, discs, marks = [], [], [], []
    for k in range(n):
        frame = _frame(routing, k + 1)
        radius = float(pulleys.joint_pulley_radius[k])
        length = float(routing.length[k + 1]) or links[k].length
        plate = frame @ _at(length / 2, 0, -stack / 2 - pitch)
        parts.append(Part(f"body_{k + 1}/link", "box", (length, 0.9 * radius, pitch), plate, LINK))
        parts += _guides(pulleys, k + 1, length, frame, stack, last=k == n - 1)
        before = _moved(model.chain.translation[k]) @ _frame(routing, k)
        for cable in range(k, n):
            ratio = np.zeros(n)
            ratio[k : cable + 1] = pulleys.joint_pulley_radius[k : cable + 1] / radius
            path = f"joint_{k + 1}_pulley_{cable + 1}"
            turning.append(Turning(path, k - 1, before @ _at(0, 0, _height(cable, n, pitch)), ratio))
            parts += _pulley(path, radius, 0.8 * pitch, JOINT)
        discs.append(Spot(f"residual_joint_{k + 1}", "joint", k + 1, k, frame @ _at(0, 0, stack / 2 + pitch), radius))
        marks.append(Spot(f"mark_joint_{k + 1}", "joint", k + 1, k, frame, 1.35 * radius))
        marks.append(Spot(f"mark_link_{k + 1}", "link", k + 1, k, frame @ _at(length / 2, 0, 0), radius))
    base = _moved(links[0].origin_xyz) @ _frame(routing, 0)
    parts += _base(pulleys, base, stack, pitch)
    for cable, centre in enumerate(motor_centres(pulleys)):
        radius = float(pulleys.motor_pulley_radius[cable])
        ratio = np.where(np.arange(n) <= cable, pulleys.joint_pulley_radius, 0.0) / radius
        turning.append(
            Turning(f"winch_{cable + 1}", -1, base @ _at(centre[0], centre[1], _height(cable, n, pitch)), ratio)
        )
        parts += _pulley(f"winch_{cable + 1}", radius, 0.8 * pitch, WINCH)
        top = base @ _at(centre[0], centre[1], stack / 2 + pitch)
        discs.append(Spot(f"residual_motor_{cable + 1}", "motor", cable + 1, -1, top, radius))
        marks.append(Spot(f"mark_motor_{cable + 1}", "motor", cable + 1, -1, base @ _moved(centre), 1.3 * radius))
    marks.append(Spot("mark_base", "base", 0, -1, base @ _at(-pulleys.link_pulley_distance, 0, 0), thin))
    return _with_spots(parts, discs, marks, 0.4 * pitch), tuple(turning), discs, marks, 0.05 * thin


def _guides(pulleys: Pulleys, link: int, length: float, frame: np.ndarray, stack: float, *, last: bool) -> list[Part]:
    """Guide pulleys of a link, which the last one does not need."""
    if last:
        return []
    parts = []
    for end, x in (("near", pulleys.link_pulley_distance), ("far", length - pulleys.link_pulley_distance)):
        for side, y in (("upper", pulleys.link_pulley_offset), ("lower", -pulleys.link_pulley_offset)):
            path, size = f"body_{link}/guide_{end}_{side}", (pulleys.link_pulley_radius * 0.97, stack)
            parts.append(Part(path, "cylinder", size, frame @ _at(x, y, 0), GUIDE))
    return parts


def _base(pulleys: Pulleys, base: np.ndarray, stack: float, pitch: float) -> list[Part]:
    """Draw the plate that carries the winches, and the guide pulleys behind joint 1."""
    end = float(motor_centres(pulleys)[-1, 0])
    plate = base @ _at(end / 2, 0, -stack / 2 - 2 * pitch)
    size = (-end, 1.2 * float(pulleys.motor_pulley_radius.max()), pitch)
    parts = [Part("base", "box", size, plate, WINCH)]
    for side, y in (("upper", pulleys.link_pulley_offset), ("lower", -pulleys.link_pulley_offset)):
        place = base @ _at(-pulleys.link_pulley_distance, y, 0)
        parts.append(Part(f"base_guide_{side}", "cylinder", (pulleys.link_pulley_radius * 0.97, stack), place, GUIDE))
    return parts


def _pulley(path: str, radius: float, width: float, colour: Colour) -> list[Part]:
    """Draw a disc with a spoke, so that one sees it turn."""
    spoke = (1.7 * radius, 0.12 * radius, 1.15 * width)
    return [
        Part(f"{path}/disc", "cylinder", (0.97 * radius, width), np.eye(4), colour),
        Part(f"{path}/spoke", "box", spoke, np.eye(4), SPOKE),
    ]


def _with_spots(parts: list[Part], discs: list[Spot], marks: list[Spot], width: float) -> tuple[Part, ...]:
    """Add what residual discs and marks look like, at full size."""
    parts += [Part(f"{s.path}/disc", "cylinder", (1.1 * s.radius, width), np.eye(4), WHITE) for s in discs]
    parts += [Part(f"{s.path}/ball", "sphere", (s.radius,), np.eye(4), WHITE) for s in marks]
    return tuple(parts)


def _robot(model: CableModel, size: float):
    """Parts of any other robot: its meshes, or rods between its joints; discs and marks at its joints."""
    parts = _visuals(model) or _rods(model, size)
    discs, marks = [], []
    for k in range(model.n_joints):
        turned = np.eye(4)
        turned[:3, :3] = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), model.chain.axis[k]).matrix()
        discs.append(Spot(f"residual_joint_{k + 1}", "joint", k + 1, k, turned, 0.07 * size))
        marks.append(Spot(f"mark_joint_{k + 1}", "joint", k + 1, k, turned, 0.09 * size))
        half = _moved(0.5 * reach(model)[k])
        marks.append(Spot(f"mark_link_{k + 1}", "link", k + 1, k, half, 0.07 * size))
    for i, k in enumerate(np.abs(model.joint_from_motor).argmax(0)):
        marks.append(Spot(f"mark_motor_{i + 1}", "motor", i + 1, int(k), np.eye(4), 0.07 * size))
    marks.append(Spot("mark_base", "base", 0, -1, np.eye(4), 0.09 * size))
    return _with_spots(parts, discs, marks, 0.015 * size), discs, marks, 0.004 * size


def _rods(model: CableModel, size: float) -> list[Part]:
    parts = []
    for k, end in enumerate(reach(model)):
        parts.append(Part(f"body_{k + 1}/hub", "sphere", (0.03 * size,), np.eye(4), JOINT))
        length = float(np.linalg.norm(end))
        if length > 1e-9:
            middle = _moved(end / 2)
            middle[:3, :3] = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end / length).matrix()
            parts.append(Part(f"body_{k + 1}/rod", "cylinder", (0.02 * size, length), middle, LINK))
    return parts


def _visuals(model: CableModel) -> list[Part]:
    """Visual shapes of a URDF, those of locked joints with the body that carries them; none if a mesh is missing."""
    path = model.manipulator.urdf
    if path is None:
        return []
    try:
        full = pin.buildModelFromUrdf(str(path))
        shapes = pin.buildGeomFromUrdf(full, str(path), pin.GeometryType.VISUAL, package_dirs=_package_folders(path))
        locked = [full.getJointId(name) for name in full.names[1:] if name not in model.joints]
        reduced, (shapes,) = pin.buildReducedModel(full, [shapes], locked, pin.neutral(full))
    except (ValueError, RuntimeError):
        return []
    row = {reduced.getJointId(name): k for k, name in enumerate(model.joints)}
    parts = [_visual(shape, row.get(shape.parentJoint, -1), i) for i, shape in enumerate(shapes.geometryObjects)]
    return [part for part in parts if part is not None]


def _visual(shape: pin.GeometryObject, body: int, number: int) -> Part | None:
    path, placement = f"{_body(body)}visual_{number}", np.array(shape.placement.homogeneous)
    red, green, blue, opacity = (float(c) for c in shape.meshColor)
    colour = (red, green, blue, opacity)
    geometry = shape.geometry
    kind = type(geometry).__name__
    if kind == "Box":
        return Part(path, "box", tuple(2 * geometry.halfSide), placement, colour)
    if kind == "Cylinder":
        return Part(path, "cylinder", (geometry.radius, 2 * geometry.halfLength), placement, colour)
    if kind == "Sphere":
        return Part(path, "sphere", (geometry.radius,), placement, colour)
    if not kind.startswith("BVHModel"):
        return None
    corners = (geometry.tri_indices(i) for i in range(geometry.num_tris))
    faces = np.array([(c[0], c[1], c[2]) for c in corners], dtype=np.uint32)
    return Part(path, "mesh", (), placement, colour, np.array(geometry.vertices(), dtype=np.float32), faces)


def _package_folders(path: Path) -> list[str]:
    """Folders in which ``package://`` may start: all that hold the URDF."""
    return [str(folder) for folder in path.resolve().parents]


def _frame(routing: Routing, link: int) -> np.ndarray:
    out, frame = np.eye(4), routing.frames[link]
    if frame is not None:
        out[:3, :3] = frame
    return out


def _height(cable: int, n: int, pitch: float) -> float:
    return pitch * (cable - (n - 1) / 2)


def _body(row: int) -> str:
    return f"body_{row + 1}/" if row >= 0 else ""


def _at(x: float, y: float, z: float) -> np.ndarray:
    return _moved(np.array([x, y, z]))


def _moved(xyz: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, 3] = xyz
    return out
