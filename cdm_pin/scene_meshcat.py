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
from .scene_mesh import Mesh, arrows, merged, tube

FORCE = (0.0, 0.62, 0.45, 1.0)
WHITE = (1.0, 1.0, 1.0, 1.0)


def scene_commands(scene: Scene) -> list[bytes]:
    """Give the commands that draw everything of a scene once; nothing stands at its place before the first frame.

    What moves together is one object: the parts of a body, of a pulley and of the base, each cable side, all arrows.
    """
    out = [_pack(SetTransform(scene.upright, _path(scene.root)))]
    for path, parts in _together(scene.parts).items():
        solid = all(part.shape != "mesh" for part in parts)
        out.append(_draw(f"{scene.root}/{path}", merged(parts), parts[0].colour, inside=not solid))
    points = [line.shape[1] for line in frames(scene, np.zeros((1, len(scene.chain.parent)))).lines]
    for line, count in zip(scene.line_paths, points, strict=True):
        out.append(_draw(line, tube(count), WHITE, lit=False))
    if scene.contacts:
        out.append(_draw(scene.arrow_path, arrows(len(scene.contacts)), FORCE, lit=False))
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
            {"path": path, "rings": line.shape[1], "radius": scene.cable_radius}
            for scene, frame in zip(scenes, still, strict=True)
            for path, line in zip(scene.line_paths, frame.lines, strict=True)
        ],
        "arrows": [
            {"path": scene.arrow_path, "rings": 2 * len(scene.contacts), "radius": 0.012 * scene.size}
            for scene in scenes
            if scene.contacts
        ],
        "colours": [path for scene in scenes for path in scene.colour_paths],
    }


def pack_frames(placed: Sequence[Frames]) -> np.ndarray:
    """Pack frames of several scenes for the page.

    Returns
    -------
    ndarray of float32, shape (n, m)
        Per sample the upper three rows of every rigid transform, the points of every cable side, the ends of every
        arrow, every colour.
    """
    n = len(placed[0].rigid)
    rigid = [frame.rigid[:, :, :3].reshape(n, -1) for frame in placed]
    lines = [line.reshape(n, -1) for frame in placed for line in frame.lines]
    ends = [frame.arrows.reshape(n, -1) for frame in placed]
    colours = [frame.colours.reshape(n, -1) for frame in placed]
    return np.ascontiguousarray(np.hstack([*rigid, *lines, *ends, *colours]), dtype=np.float32)


def _together(parts: Sequence[Part]) -> dict[str, list[Part]]:
    """Group parts that move together and are equally opaque, under the path of the node they hang on."""
    groups: dict[tuple[str, float], list[Part]] = {}
    for part in parts:
        node, _, name = part.path.partition("/")
        groups.setdefault((node if name else "base", part.colour[3]), []).append(part)
    out: dict[str, list[Part]] = {}
    for (node, opacity), group in groups.items():
        out[f"{node}/opacity_{100 * opacity:.0f}" if node in out else node] = group
    return out


class _Triangles(g.Geometry):
    """A mesh with normals, and colours at its vertices if it has several."""

    def __init__(self, mesh: Mesh):
        super().__init__()
        self.mesh = mesh

    def lower(self, object_data: Any) -> dict[str, Any]:
        """Give it as three.js reads it."""
        mesh = self.mesh
        arrays = {"position": mesh.vertices, "normal": mesh.normals}
        if mesh.colours is not None:
            arrays["color"] = mesh.colours
        attributes = {name: g.pack_numpy_array(array.T) for name, array in arrays.items()}
        data = {"attributes": attributes, "index": g.pack_numpy_array(mesh.faces.T)}
        return {"uuid": self.uuid, "type": "BufferGeometry", "data": data}


def _draw(path: str, mesh: Mesh, colour: Sequence[float], *, inside: bool = False, lit: bool = True) -> bytes:
    """Draw a mesh, in one colour unless it has its own; `inside`: from behind too; not `lit`: without shading."""
    red, green, blue = (round(255 * c) for c in (WHITE if mesh.colours is not None else colour)[:3])
    material = (g.MeshLambertMaterial if lit else g.MeshBasicMaterial)(
        color=red << 16 | green << 8 | blue,
        opacity=float(colour[3]),
        vertexColors=mesh.colours is not None,
        side=2 if inside else 0,
    )
    return _pack(SetObject(_Triangles(mesh), material, _path(path)))


def _path(path: str) -> Path:
    return Path(tuple(part for part in path.split("/") if part))


def _pack(command: Any) -> bytes:
    stream = io.BytesIO()
    umsgpack.pack(command.lower(), stream)
    return stream.getvalue()
