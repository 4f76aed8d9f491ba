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
        "box", "cylinder" (along z), "cone" (along z), "sphere" or "mesh".
    size : ndarray
        Box: three lengths; cylinder, cone: radius and length; sphere: radius [m]; mesh: empty.
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
        """Nodes moved by `Frames.rigid`, in order: bodies, pulleys, discs, marks, contact forces."""
        bodies = [f"body_{i + 1}" for i in range(len(self.chain.parent))]
        movers = [*self.turning, *self.discs, *self.marks]
        forces = [f"force_{i + 1}" for i in range(len(self.contacts))]
        return [f"{self.root}/{path}" for path in [*bodies, *(mover.path for mover in movers), *forces]]

    @property
    def line_paths(self) -> list[str]:
        """Nodes of the cable sides; their segments are the children ``0, 1, ...``."""
        return [f"{self.root}/cable_{side.cable + 1}_{side.side}" for side in self.sides]

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
    colours : ndarray, shape (n, n_coloured, 4)
        Red, green, blue, opacity.
    """

    rigid: np.ndarray
    lines: tuple[np.ndarray, ...]
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
    movers = [np.broadcast_to(m, (n, 4, 4)) for m in (*pulleys, *discs, *marks, *_arrows(scene, poses, display))]
    rigid = np.concatenate([poses, np.stack(movers, 1)], axis=1) if movers else poses
    lit = [np.broadcast_to(SUSPECT if state is None else state, (n, 4)) for state in states]
    colours = [*_cable_colours(scene, n, display), *_disc_colours(size), *lit]
    return Frames(rigid, tuple(lines), np.stack(colours, 1) if colours else np.zeros((n, 0, 4)))


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
    q = np.atleast_2d(q)
    q = q[np.unique(np.linspace(0, len(q) - 1, min(len(q), 200)).astype(int))]
    placed = frames(scene, q)
    clouds = [placed.rigid[:, : len(scene.chain.parent), :3, 3].reshape(-1, 3), np.zeros((1, 3))]
    tips = body_poses(scene.chain, q)[:, -1] @ np.array([0.0, 0.0, 0.0, 1.0])
    clouds += [tips[:, :3], *(line.reshape(-1, 3) for line in placed.lines)]
    points = np.vstack(clouds) @ scene.upright[:3, :3].T
    low, high = points.min(0), points.max(0)
    return (low + high) / 2, max(float(np.linalg.norm(high - low) / 2), 0.55 * scene.size)


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


def _arrows(scene: Scene, poses: np.ndarray, display: Display) -> list[np.ndarray]:
    """Place a cone of unit length along each contact force."""
    out = []
    for k, body in enumerate(scene.contacts):
        arrow = np.tile(HIDDEN * np.eye(4), (len(poses), 1, 1))
        arrow[:, 3, 3] = 1.0
        if display.force is not None and display.point is not None:
            force = display.force[:, k] / display.full_force * (scene.size / 5)
            across = np.cross(force, [0.0, 0.0, 1.0]) + 1e-12 * np.array([1.0, 0.0, 0.0])
            across /= np.linalg.norm(across, axis=1)[:, None]
            length = np.maximum(np.linalg.norm(force, axis=1), HIDDEN)[:, None]
            arrow[:, :3, 0] = 0.012 * scene.size * across
            arrow[:, :3, 1] = 0.012 * scene.size * np.cross(force / length, across)
            arrow[:, :3, 2] = force
            arrow[:, :3, 3] = display.point[:, k]
        out.append(_body(poses, body) @ arrow)
    return out


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
