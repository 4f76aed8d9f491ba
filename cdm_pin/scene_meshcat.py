"""Scenes as meshcat commands: what the viewer's page is told, as the bytes that meshcat sends."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
import umsgpack
from meshcat import geometry as g
from meshcat.commands import SetObject, SetProperty, SetTransform
from meshcat.path import Path

from .scene import Frames, Part, Scene, frames

# meshcat's cylinders stand along y, ours along z.
_Z_FROM_Y = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


def scene_commands(scene: Scene) -> list[bytes]:
    """Give the commands that draw everything of a scene once; nothing stands at its place before the first frame."""
    out = [_pack(SetTransform(scene.upright, _path(scene.root)))]
    for part in scene.parts:
        path = _path(f"{scene.root}/{part.path}")
        out.append(_pack(SetObject(_geometry(part), _material(part.colour), path)))
        turned = part.placement @ _Z_FROM_Y if part.shape in ("cylinder", "cone") else part.placement
        out.append(_pack(SetTransform(turned, path)))
    segment = _round(g.Cylinder(1.0, 1.0), 6)
    points = [line.shape[1] for line in frames(scene, np.zeros((1, len(scene.chain.parent)))).lines]
    for line, count in zip(scene.line_paths, points, strict=True):
        for k in range(count - 1):
            out.append(_pack(SetObject(segment, _material((1, 1, 1, 1)), _path(f"{line}/{k}"))))
    return out


def stage_commands() -> list[bytes]:
    """Give the commands that clear meshcat's own decoration: a plain light background, no grid, no axes."""
    return [
        _pack(SetProperty("top_color", [0.97, 0.98, 1.0], _path("/Background"))),
        _pack(SetProperty("bottom_color", [0.86, 0.89, 0.93], _path("/Background"))),
        _pack(SetProperty("visible", False, _path("/Grid"))),
        _pack(SetProperty("visible", False, _path("/Axes"))),
    ]


def layout(scenes: Sequence[Scene]) -> dict[str, Any]:
    """Say what the numbers of a packed frame mean (see `pack_frames`)."""
    still = [frames(scene, np.zeros((1, len(scene.chain.parent)))) for scene in scenes]
    return {
        "rigid": [path for scene in scenes for path in scene.rigid_paths],
        "lines": [
            {"path": path, "points": line.shape[1], "radius": scene.cable_radius}
            for scene, frame in zip(scenes, still, strict=True)
            for path, line in zip(scene.line_paths, frame.lines, strict=True)
        ],
        "colours": [path for scene in scenes for path in scene.colour_paths],
    }


def pack_frames(placed: Sequence[Frames]) -> np.ndarray:
    """Pack frames of several scenes for the page.

    Returns
    -------
    ndarray of float32, shape (n, m)
        Per sample the upper three rows of every rigid transform, the points of every cable side, every colour.
    """
    n = len(placed[0].rigid)
    rigid = [frame.rigid[:, :, :3].reshape(n, -1) for frame in placed]
    lines = [line.reshape(n, -1) for frame in placed for line in frame.lines]
    colours = [frame.colours.reshape(n, -1) for frame in placed]
    return np.ascontiguousarray(np.hstack([*rigid, *lines, *colours]), dtype=np.float32)


def _geometry(part: Part) -> g.Geometry:
    if part.shape == "box":
        return g.Box(list(map(float, part.size)))
    if part.shape == "cylinder":
        return _round(g.Cylinder(float(part.size[1]), float(part.size[0])), 24)
    if part.shape == "cone":
        return _round(g.Cylinder(float(part.size[1]), radiusTop=0.0, radiusBottom=float(part.size[0])), 16)
    if part.shape == "sphere":
        return g.Sphere(float(part.size[0]))
    assert part.vertices is not None and part.faces is not None
    return g.TriangularMeshGeometry(part.vertices, part.faces)


def _round(cylinder: g.Cylinder, segments: int) -> g.Cylinder:
    cylinder.radialSegments = segments
    return cylinder


def _material(colour: Sequence[float]) -> g.Material:
    red, green, blue = (round(255 * c) for c in colour[:3])
    return g.MeshLambertMaterial(color=red << 16 | green << 8 | blue, opacity=float(colour[3]))


def _path(path: str) -> Path:
    return Path(tuple(part for part in path.split("/") if part))


def _pack(command: Any) -> bytes:
    stream = io.BytesIO()
    umsgpack.pack(command.lower(), stream)
    return stream.getvalue()
