"""A robot as a meshcat scene: what is drawn once, and where everything is at each sample.

A `Scene` holds parts (drawn once, as meshcat objects) and movers. `frames` turns joint positions, tensions and
residuals into transforms, cable polylines and colours; it is plain numpy and knows neither browser nor server.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .cablepath import ARC, CableSide, cable_paths
from .model import Chain
from .poses import body_poses, turn

HIDDEN = 1e-6  # scale of a mover that is not to be seen
TENSION_COLOURS = np.array([[0, 32, 76], [85, 91, 108], [165, 156, 116], [255, 233, 69]]) / 255  # cividis
SLACK_COLOUR = np.array([0.8, 0.8, 0.8, 0.55])
MORE, LESS = np.array([230, 159, 0]) / 255, np.array([0, 114, 178]) / 255  # measured more, less than the model
SUSPECT, ACCEPTED = np.array([240, 228, 66, 130]) / 255, np.array([213, 94, 0, 190]) / 255


@dataclass(frozen=True)
class Part:
    """Something drawn once; it moves with the node it hangs on.

    Attributes
    ----------
    path : str
        In the scene tree, below the root of the robot.
    shape : str
        "box", "cylinder" (along z), "sphere" or "mesh".
    size : ndarray
        Box: three lengths; cylinder: radius and length; sphere: radius [m]; mesh: empty.
    placement : ndarray, shape (4, 4)
        In the frame of its parent node.
    colour : tuple of float
        Red, green, blue, opacity (0 to 1).
    vertices, faces : ndarray, shape (n, 3)
        Of a mesh [m].
    """

    path: str
    shape: str
    size: tuple[float, ...]
    placement: np.ndarray
    colour: tuple[float, float, float, float]
    vertices: np.ndarray | None = None
    faces: np.ndarray | None = None


@dataclass(frozen=True)
class Turning:
    """A pulley that turns with its cable: its angle in the frame of `body` is `ratio` times the joint positions."""

    path: str
    body: int
    placement: np.ndarray
    ratio: np.ndarray


@dataclass(frozen=True)
class Spot:
    """A place of the robot that can carry a residual disc or light up.

    Attributes
    ----------
    path : str
    kind, index :
        As in a location of diagnosis.json; index counts from 1.
    body : int
        Row of E it moves with; -1 is the base.
    placement : ndarray, shape (4, 4)
    radius : float
        [m].
    """

    path: str
    kind: str
    index: int
    body: int
    placement: np.ndarray
    radius: float


@dataclass(frozen=True)
class Scene:
    """A robot to be drawn.

    Attributes
    ----------
    root : str
        First part of all its paths.
    upright : ndarray, shape (4, 4)
        Turns gravity to point down in the viewer.
    chain : Chain
    parts : tuple of Part
    turning : tuple of Turning
    sides : tuple of CableSide
    cable_radius : float
        [m].
    discs, marks : tuple of Spot
        Residual discs; places that can light up.
    size : float
        Reach of the robot [m].
    contacts : tuple of int
        Body of each pulley contact whose force is drawn; -1 is the base.
    arc : int
        Segments of a wrap.
    """

    root: str
    upright: np.ndarray
    chain: Chain
    parts: tuple[Part, ...]
    turning: tuple[Turning, ...] = ()
    sides: tuple[CableSide, ...] = ()
    cable_radius: float = 0.002
    discs: tuple[Spot, ...] = ()
    marks: tuple[Spot, ...] = ()
    size: float = 1.0
    contacts: tuple[int, ...] = ()
    arc: int = ARC

    @property
    def rigid_paths(self) -> list[str]:
        """Nodes moved by `Frames.rigid`, in order: bodies, pulleys, discs, marks."""
        bodies = [f"body_{i + 1}" for i in range(len(self.chain.parent))]
        movers = [*self.turning, *self.discs, *self.marks]
        return [f"{self.root}/{path}" for path in [*bodies, *(mover.path for mover in movers)]]

    @property
    def line_paths(self) -> list[str]:
        """Nodes of the cable sides."""
        return [f"{self.root}/cable_{side.cable + 1}_{side.side}" for side in self.sides]

    @property
    def arrow_path(self) -> str:
        """Node of all contact forces."""
        return f"{self.root}/forces"

    @property
    def colour_paths(self) -> list[str]:
        """Nodes coloured by `Frames.colours`, in order: cables, discs, marks."""
        return [*self.line_paths, *(f"{self.root}/{spot.path}" for spot in (*self.discs, *self.marks))]


@dataclass(frozen=True)
class Frames:
    """Where everything is, at each of n samples, in the frame of the robot's base.

    Attributes
    ----------
    rigid : ndarray, shape (n, n_rigid, 4, 4)
    lines : tuple of ndarray, shape (n, m, 3)
        Points of each cable side [m].
    arrows : ndarray, shape (n, n_contacts, 2, 3)
        Foot and tip of each contact force [m].
    colours : ndarray, shape (n, n_coloured, 4)
        Red, green, blue, opacity.
    """

    rigid: np.ndarray
    lines: tuple[np.ndarray, ...]
    arrows: np.ndarray
    colours: np.ndarray


@dataclass(frozen=True)
class Display:
    """What is shown beside the motion.

    Attributes
    ----------
    tension : ndarray, shape (n, n_sides), optional
        Of each cable side [N]; zero is slack.
    full_tension : float
        The tension drawn in the brightest colour [N].
    residual : ndarray, shape (n, n_discs), optional
        Of each disc, as a fraction of the largest; the sign chooses the colour.
    force, point : ndarray, shape (n, n_contacts, 3), optional
        Of each cable contact on its pulley, in the frame of the body that carries it [N, m].
    full_force : float
        The force drawn as an arrow of a fifth of the robot's reach [N].
    suspects, accepted : tuple of mapping
        Locations under suspicion, and those of accepted findings.
    """

    tension: np.ndarray | None = None
    full_tension: float = 1.0
    residual: np.ndarray | None = None
    force: np.ndarray | None = None
    point: np.ndarray | None = None
    full_force: float = 1.0
    suspects: Sequence[Mapping[str, Any]] = field(default=())
    accepted: Sequence[Mapping[str, Any]] = field(default=())


def frames(scene: Scene, q: np.ndarray, display: Display = Display()) -> Frames:
    """Place everything that moves.

    Parameters
    ----------
    scene : Scene
    q : ndarray, shape (n, n_joints)
        Joint positions [rad or m].
    display : Display
    """
    q = np.atleast_2d(np.asarray(q, float))
    n = len(q)
    poses = body_poses(scene.chain, q)
    slack = None if display.tension is None else np.atleast_2d(display.tension) <= 0
    lines = cable_paths(scene.sides, poses, q, slack, scene.arc)
    pulleys = [_body(poses, t.body) @ t.placement @ _turned(q @ t.ratio) for t in scene.turning]
    size = np.zeros((n, len(scene.discs))) if display.residual is None else np.atleast_2d(display.residual)
    discs = [_scaled(_body(poses, s.body) @ s.placement, np.abs(size[:, k])) for k, s in enumerate(scene.discs)]
    states = [mark_state(spot, display) for spot in scene.marks]
    marks = [
        _scaled(_body(poses, s.body) @ s.placement, np.full(n, float(state is not None)), even=True)
        for s, state in zip(scene.marks, states, strict=True)
    ]
    movers = [np.broadcast_to(m, (n, 4, 4)) for m in (*pulleys, *discs, *marks)]
    rigid = np.concatenate([poses, np.stack(movers, 1)], axis=1) if movers else poses
    lit = [np.broadcast_to(SUSPECT if state is None else state, (n, 4)) for state in states]
    colours = [*_cable_colours(scene, n, display), *_disc_colours(size), *lit]
    coloured = np.stack(colours, 1) if colours else np.zeros((n, 0, 4))
    return Frames(rigid, tuple(lines), _arrows(scene, poses, display), coloured)


def mark_state(spot: Spot, display: Display) -> np.ndarray | None:
    """Give the colour a place lights up in, None if it does not: the accepted win over the suspects."""
    for locations, colour in ((display.accepted, ACCEPTED), (display.suspects, SUSPECT)):
        if any(lights(spot, location) for location in locations):
            return colour
    return None


def lights(spot: Spot, location: Mapping[str, Any]) -> bool:
    """Whether a location of a diagnosis lights this place up."""
    kind = location.get("kind")
    if kind == "system":
        return spot.kind in ("motor", "base")
    if kind == "combination":
        weights = list(location.get("weights") or [])
        return spot.kind == "motor" and spot.index <= len(weights) and abs(weights[spot.index - 1]) > 1e-9
    if kind == "base":
        return spot.kind == "base"
    if kind == "cable":
        at = next(((other, location[other]) for other in ("joint", "link") if other in location), None)
        return (spot.kind, spot.index) == (at or ("joint", location.get("index")))
    return (spot.kind, spot.index) == (kind, location.get("index"))


def bounds(scene: Scene, q: np.ndarray) -> tuple[np.ndarray, float]:
    """Give centre and radius [m] of a ball around robot and motion, in the viewer's frame, for the camera."""
    points = _cloud(scene, q)
    low, high = points.min(0), points.max(0)
    return (low + high) / 2, max(float(np.linalg.norm(high - low) / 2), 0.55 * scene.size)


def outermost(scene: Scene, q: np.ndarray) -> np.ndarray:
    """Give the points of robot and motion that reach furthest in any of 26 directions, in the viewer's frame [m]."""
    points = _cloud(scene, q)
    steps = np.array([-1.0, 0.0, 1.0])
    directions = np.stack(np.meshgrid(steps, steps, steps), -1).reshape(-1, 3)
    return points[np.unique((points @ directions.T).argmax(0))]


def _cloud(scene: Scene, q: np.ndarray) -> np.ndarray:
    """Give the corners of all parts of bodies, and the cables, along a motion, in the viewer's frame."""
    q = np.atleast_2d(q)
    q = q[np.unique(np.linspace(0, len(q) - 1, min(len(q), 200)).astype(int))]
    placed = frames(scene, q)
    clouds = [np.zeros((1, 3)), placed.rigid[:, : len(scene.chain.parent), :3, 3].reshape(-1, 3)]
    clouds += [line.reshape(-1, 3) for line in placed.lines]
    rows = {path: k for k, path in enumerate(scene.rigid_paths[: len(scene.chain.parent)])}
    for part in scene.parts:
        row = rows.get(f"{scene.root}/{part.path.partition('/')[0]}")
        if row is not None:
            corners = _corners(part) @ part.placement[:3, :3].T + part.placement[:3, 3]
            pose = placed.rigid[:, row]
            clouds.append((corners @ pose[:, :3, :3].transpose(0, 2, 1) + pose[:, None, :3, 3]).reshape(-1, 3))
    return np.vstack(clouds) @ scene.upright[:3, :3].T


def _corners(part: Part) -> np.ndarray:
    """Give the corners of a box around a part, in its own frame."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    if part.vertices is not None:
        low, high = part.vertices.min(0), part.vertices.max(0)
        return (low + high) / 2 + signs * (high - low) / 2
    if part.shape == "box":
        return signs * np.asarray(part.size) / 2
    radius = part.size[0]
    return signs * np.array([radius, radius, part.size[1] / 2 if part.shape == "cylinder" else radius])


def _body(poses: np.ndarray, body: int) -> np.ndarray:
    return np.eye(4) if body < 0 else poses[:, body]


def _turned(angle: np.ndarray) -> np.ndarray:
    matrix = np.zeros((len(angle), 4, 4))
    matrix[:, :3, :3] = turn(np.array([0.0, 0.0, 1.0]), angle)
    matrix[:, 3, 3] = 1.0
    return matrix


def _scaled(pose: np.ndarray, scale: np.ndarray, even: bool = False) -> np.ndarray:
    """Scale a pose across its z axis (`even`: along it too)."""
    scale = np.maximum(scale, HIDDEN)[:, None]
    factors = np.concatenate([scale, scale, scale if even else np.ones_like(scale), np.ones_like(scale)], axis=1)
    return pose * factors[:, None, :]


def _arrows(scene: Scene, poses: np.ndarray, display: Display) -> np.ndarray:
    """Place foot and tip of each contact force."""
    arrows = np.zeros((len(poses), len(scene.contacts), 2, 3))
    if display.force is None or display.point is None:
        return arrows
    reach = display.force / display.full_force * (scene.size / 5)
    ends = np.stack([display.point, display.point + reach], axis=2)
    for k, body in enumerate(scene.contacts):
        pose = _body(poses, body)
        arrows[:, k] = ends[:, k] @ np.swapaxes(pose[..., :3, :3], -1, -2) + pose[..., None, :3, 3]
    return arrows


def _cable_colours(scene: Scene, n: int, display: Display) -> list[np.ndarray]:
    if display.tension is None:
        return [np.tile([*TENSION_COLOURS[1], 1.0], (n, 1)) for _ in scene.sides]
    out = []
    for k in range(len(scene.sides)):
        tension = np.atleast_2d(display.tension)[:, k]
        place = np.clip(tension / display.full_tension, 0, 1) * (len(TENSION_COLOURS) - 1)
        rgb = [np.interp(place, np.arange(len(TENSION_COLOURS)), TENSION_COLOURS[:, c]) for c in range(3)]
        colour = np.column_stack([*rgb, np.ones(n)])
        out.append(np.where((tension <= 0)[:, None], SLACK_COLOUR, colour))
    return out


def _disc_colours(size: np.ndarray) -> list[np.ndarray]:
    return [
        np.column_stack([np.where(column[:, None] > 0, MORE, LESS), np.full(len(column), 0.7)]) for column in size.T
    ]
