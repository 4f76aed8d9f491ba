"""Triangles of what a scene draws: the shapes of parts, many parts of one body as one mesh, tubes and arrows.

A browser pays for each object that it draws, and hardly for its triangles. So what moves together becomes one mesh with
its colours at the vertices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .scene import Part

TUBE, ARROW = 6, 8  # sides of a cable, of an arrow


@dataclass(frozen=True)
class Mesh:
    """Triangles with outward normals.

    Attributes
    ----------
    vertices, normals : ndarray of float32, shape (n, 3)
        [m], unit vectors.
    faces : ndarray of uint32, shape (m, 3)
        Counterclockwise as seen from outside.
    colours : ndarray of float32, shape (n, 3), optional
        Red, green, blue, if not all the same.
    """

    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    colours: np.ndarray | None = None


def merged(parts: Sequence[Part]) -> Mesh:
    """Give all parts of one node as one mesh in its frame.

    Parameters
    ----------
    parts : sequence of Part
        At least one.
    """
    vertices, normals, faces, colours, count = [], [], [], [], 0
    for part in parts:
        mesh, turn = shape(part), part.placement[:3, :3]
        vertices.append(mesh.vertices @ turn.T + part.placement[:3, 3])
        normals.append(mesh.normals @ turn.T)
        faces.append(mesh.faces + count)
        colours.append(np.tile(part.colour[:3], (len(mesh.vertices), 1)))
        count += len(mesh.vertices)
    several = len({part.colour[:3] for part in parts}) > 1
    return _mesh(vertices, normals, faces, colours if several else None)


def shape(part: Part) -> Mesh:
    """Give the triangles of a part in its own frame; of a mesh with normals averaged over the faces at each vertex."""
    if part.shape == "box":
        return _box(np.asarray(part.size, float))
    if part.shape == "sphere":
        angle = np.linspace(-np.pi / 2, np.pi / 2, 13)
        outline = np.column_stack([np.cos(angle), np.sin(angle)])
        return _turned([(part.size[0] * outline, outline)], 20)
    if part.shape == "cylinder":
        radius, half = float(part.size[0]), float(part.size[1]) / 2
        corners = np.array([[0.0, -half], [radius, -half], [radius, half], [0.0, half]])
        outward = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0]])
        outlines = [(corners[k : k + 2], outward[[k, k]]) for k in range(3)]
        return _turned(outlines, 24 if radius > half else 12)
    assert part.vertices is not None and part.faces is not None
    corners = np.asarray(part.vertices, float)[part.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros((len(part.vertices), 3))
    for corner in part.faces.T:
        np.add.at(normals, corner, across)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-30)[:, None]
    return _mesh([part.vertices], [normals], [part.faces])


def tube(points: int) -> Mesh:
    """Give the triangles of a tube along a polyline; its vertices, `TUBE` a point, are put in place by the page."""
    ring = np.arange(TUBE)
    strip = _strip(ring, ring + TUBE)
    faces = [strip + TUBE * k for k in range(points - 1)]
    return _unplaced(points * TUBE, faces)


def arrows(count: int) -> Mesh:
    """Give the triangles of arrows, for each a rim and the tip, of `ARROW` vertices each; placed by the page too."""
    ring = np.arange(ARROW)
    foot = np.column_stack([np.zeros(ARROW - 2, int), ring[2:], ring[1:-1]])
    one = np.vstack([foot, _strip(ring, ring + ARROW)])
    return _unplaced(count * 2 * ARROW, [one + 2 * ARROW * k for k in range(count)])


def _strip(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Join two rings of vertices, counterclockwise as seen along the axis from high to low."""
    return np.vstack([
        np.column_stack([low, np.roll(low, -1), high]),
        np.column_stack([np.roll(low, -1), np.roll(high, -1), high]),
    ])  # fmt: skip


def _box(size: np.ndarray) -> Mesh:
    vertices, normals, faces = [], [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            u, v, w = np.roll(np.eye(3), -axis, axis=0)  # right-handed, u out of the face
            square = np.array([v + w, w - v, -v - w, v - w])[:: int(sign)]
            faces.append(np.array([[0, 1, 2], [0, 2, 3]]) + 4 * len(vertices))
            vertices.append(0.5 * size * (sign * u + square))
            normals.append(np.tile(sign * u, (4, 1)))
    return _mesh(vertices, normals, faces)


def _turned(outlines: list[tuple[np.ndarray, np.ndarray]], count: int) -> Mesh:
    """Turn outlines (radius and height, and normals, from below to above) about z."""
    angle = 2 * np.pi * np.arange(count) / count
    c, s = np.cos(angle), np.sin(angle)
    vertices, normals, faces, first = [], [], [], 0
    for points, outward in outlines:
        for (r, z), (n_r, n_z) in zip(points, outward, strict=True):
            vertices.append(np.column_stack([r * c, r * s, np.full(count, z)]))
            normals.append(np.column_stack([n_r * c, n_r * s, np.full(count, n_z)]))
        for k in range(len(points) - 1):
            ring = first + count * k + np.arange(count)
            strip = _strip(ring, ring + count)
            flat = points[[k, k + 1], 0] < 1e-12  # a ring that is a point has no triangle along it
            faces.append(strip[count * int(flat[0]) : count * (2 - int(flat[1]))])
        first += count * len(points)
    return _mesh(vertices, normals, faces)


def _unplaced(count: int, faces: list[np.ndarray]) -> Mesh:
    return _mesh([np.zeros((count, 3))], [np.zeros((count, 3))], faces or [np.zeros((0, 3))])


def _mesh(vertices, normals, faces, colours=None) -> Mesh:
    return Mesh(
        np.concatenate(vertices).astype(np.float32),
        np.concatenate(normals).astype(np.float32),
        np.concatenate(faces).astype(np.uint32),
        None if colours is None else np.concatenate(colours).astype(np.float32),
    )
