"""A motion made ready to be watched: recordings and simulations at the viewer's rate, with tensions and residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from .cables import cable_forces, cable_state
from .dynamics import inverse_dynamics
from .errors import RecordingError
from .model import CableModel
from .recording import Recording
from .report_robot import bent_pose
from .scene import Display, Frames, Scene, bounds, frames, outermost
from .scene_build import build_scene
from .signals import Signals, prepare

RATE = 30.0  # samples per second that are kept [Hz]
MOST = 400_000  # rows that are prepared; longer recordings are averaged down to about that many


@dataclass(frozen=True)
class Show:
    """A motion to be replayed.

    Attributes
    ----------
    title : str
    scenes : tuple of Scene
        One robot, or several ghosts.
    time : ndarray, shape (n,)
        From zero [s].
    q : tuple of ndarray, shape (n, n_joints)
        One per scene [rad or m].
    tension : ndarray, shape (n, n_sides), optional
        Of the first scene; zero or less is slack [N].
    residual : ndarray, shape (n, n_discs), optional
        Of the first scene, in units of the largest.
    residual_rms : ndarray, shape (n_motors,), optional
        Per motor, before anything was fitted [N m].
    from_motors : ndarray, shape (n_discs, n_motors), optional
        How much each motor's residual counts for each disc.
    force, point : ndarray, shape (n, n_contacts, 3), optional
        Contact forces of the first scene, see `scene.Display`.
    news : dict
        What the panel shows first.
    """

    title: str
    scenes: tuple[Scene, ...]
    time: np.ndarray
    q: tuple[np.ndarray, ...]
    tension: np.ndarray | None = None
    residual: np.ndarray | None = None
    residual_rms: np.ndarray | None = None
    from_motors: np.ndarray | None = None
    force: np.ndarray | None = None
    point: np.ndarray | None = None
    news: dict[str, Any] = field(default_factory=dict)

    @property
    def duration(self) -> float:
        """Length of the motion [s]."""
        return float(self.time[-1] - self.time[0])

    @cached_property
    def full_tension(self) -> float:
        """The tension drawn in the brightest colour [N]."""
        return _largest(self.tension)

    @cached_property
    def full_force(self) -> float:
        """The force drawn as a full arrow [N]."""
        return _largest(self.force)


def show_model(model: CableModel, news: Mapping[str, Any] | None = None) -> Show:
    """Show a robot at rest, bent so that one sees its joints."""
    title = model.manipulator.name
    return Show(title, (build_scene(model),), np.zeros(1), (bent_pose(model)[None],), news=dict(news or {}))


def show_recording(
    model: CableModel, recording: Recording, *, forces: bool = False, news: Mapping[str, Any] | None = None
) -> Show:
    """Show a recording: the motion, and where torques were logged tensions and what the model does not explain.

    Parameters
    ----------
    model : CableModel
    recording : Recording
        With a position of the joints or of the motors.
    forces : bool
        Whether to draw the contact forces of cables on pulleys; they follow from the motion.
    news : mapping, optional
        What the panel shows first.

    Raises
    ------
    RecordingError
        If no position was logged, or the recording contradicts the robot.
    """
    signals = prepare(_thinned(recording), model)
    keep = slice(None, None, max(1, round(signals.rate / RATE)))
    q, v, a, a_m = _motion(model, signals)
    torque = _motor_torque(model, signals)
    show = Show(
        title=f"{model.manipulator.name}: {recording.name}",
        scenes=(build_scene(model),),
        time=(signals.time - signals.time[0])[keep],
        q=(q[keep],),
        news={"lines": [f"{recording.name}: {signals.time[-1] - signals.time[0]:.1f} s"], **(news or {})},
    )
    if torque is not None:
        rigid = model.motor_torque(inverse_dynamics(model, q, v, a)) + a_m * model.rotor_inertia
        show = _with_residual(show, model, (torque - rigid), signals.valid, keep)
    show = replace(show, tension=_tension(model, signals, recording, q, torque, keep))
    return _with_forces(show, model, recording, q[keep], v[keep], a[keep]) if forces else show


def show_ghosts(model: CableModel, time: np.ndarray, motions: Mapping[str, np.ndarray]) -> Show:
    """Show several motions of one robot at once, each in its own colour.

    Parameters
    ----------
    model : CableModel
    time : ndarray, shape (n,)
        [s].
    motions : mapping of str to ndarray, shape (n, n_joints)
        "recorded", "rigid" and "completed" have colours of their own.
    """
    grid = np.arange(0.0, float(time[-1] - time[0]) + 1e-9, 1 / RATE)
    scenes, q = [], []
    for k, (name, motion) in enumerate(motions.items()):
        scene = build_scene(model, name, colour=GHOSTS.get(name, (0.6, 0.4, 0.6, 0.6)), arc=5)
        beside = np.eye(4)
        beside[2, 3] = -0.008 * k * scene.size  # so that faces at the same place do not flicker
        scenes.append(replace(scene, upright=scene.upright @ beside))
        q.append(np.column_stack([np.interp(grid, time - time[0], column) for column in np.asarray(motion).T]))
    return Show(f"{model.manipulator.name}: {', '.join(motions)}", tuple(scenes), grid, tuple(q), news={"ghosts": True})


GHOSTS = {
    "recorded": (0.25, 0.25, 0.25, 1.0),
    "rigid": (0.84, 0.37, 0.0, 0.55),
    "completed": (0.0, 0.45, 0.70, 0.55),
}


def frame_at(show: Show, t: float | np.ndarray, news: Mapping[str, Any]) -> list[Frames]:
    """Place every scene at one or several times from the start [s], with what the news of a computation add."""
    now = float(show.time[0]) + np.atleast_1d(np.asarray(t, float))
    first = Display(
        tension=None if show.tension is None else _at(show.time, show.tension, now),
        full_tension=show.full_tension,
        residual=None if show.residual is None else _at(show.time, show.residual, now) * _shrunk(show, news),
        force=None if show.force is None else _at(show.time, show.force, now),
        point=None if show.point is None else _at(show.time, show.point, now),
        full_force=show.full_force,
        suspects=news.get("suspects_at") or (),
        accepted=news.get("accepted_at") or (),
    )
    displays = [first, *[Display()] * (len(show.scenes) - 1)]
    motions = zip(show.scenes, show.q, displays, strict=True)
    return [frames(scene, _at(show.time, q, now), display) for scene, q, display in motions]


def camera(scenes: Sequence[Scene], q: Sequence[np.ndarray]) -> dict[str, Any]:
    """Say what the camera sees: a ball around everything, and the points it must hold, in the viewer's frame [m]."""
    balls = [bounds(scene, motion) for scene, motion in zip(scenes, q, strict=True)]
    centre = np.mean([ball[0] for ball in balls], axis=0)
    radius = max(float(np.linalg.norm(c - centre)) + r for c, r in balls)
    points = np.vstack([outermost(scene, motion) for scene, motion in zip(scenes, q, strict=True)])
    return {"centre": centre.tolist(), "radius": radius, "points": points.round(4).tolist()}


def _thinned(recording: Recording) -> Recording:
    """Average runs of rows of a recording too long to be prepared while one waits."""
    size = -(-recording.n_samples // MOST)
    if size < 2:
        return recording
    n = recording.n_samples // size * size

    def mean(x: np.ndarray) -> np.ndarray:
        return x[:n].reshape(-1, size, *x.shape[1:]).mean(1)

    channels = {name: mean(x) for name, x in recording.channels.items()}
    return replace(recording, time=mean(recording.time), channels=channels)


def _motion(model: CableModel, signals: Signals):
    """Joint positions, velocities, accelerations, and motor accelerations."""
    if "joint_position" in signals.channels:
        q, v, a = (signals.channels[f"joint_{what}"] for what in ("position", "velocity", "acceleration"))
        return q, v, a, signals.channels.get("motor_acceleration", a @ model.motor_from_joint.T)
    if "motor_position" in signals.channels:
        q_m, v_m, a_m = (signals.channels[f"motor_{what}"] for what in ("position", "velocity", "acceleration"))
        E = model.joint_from_motor.T
        return model.joint_position(q_m), v_m @ E, a_m @ E, a_m
    raise RecordingError(
        "joint_position or motor_position was expected, found neither", source=signals.recording.source
    )


def _motor_torque(model: CableModel, signals: Signals) -> np.ndarray | None:
    if "motor_torque" in signals.channels:
        return signals.channels["motor_torque"]
    tau = signals.channels.get("joint_torque")
    return None if tau is None else model.motor_torque(tau)


def _with_residual(show: Show, model: CableModel, error: np.ndarray, valid: np.ndarray, keep: slice) -> Show:
    """Add what the rigid body leaves, at the joints and, where they are drawn, at the motors."""
    error = np.where(valid[:, None], error, 0.0)
    to_joints = np.linalg.pinv(model.joint_from_motor.T)
    spots = show.scenes[0].discs
    share = np.array(
        [to_joints[s.index - 1] if s.kind == "joint" else np.eye(model.n_motors)[s.index - 1] for s in spots]
    )
    at_spots = error @ share.T
    largest = max(float(np.percentile(np.abs(at_spots).max(1), 99.5)), 1e-12)
    rms = np.sqrt((error[valid] ** 2).mean(0)) if valid.any() else np.zeros(model.n_motors)
    shown = np.clip(at_spots[keep] / largest, -1, 1)
    news = {**show.news, "residual": rms.tolist()}
    return replace(show, residual=shown, residual_rms=rms, from_motors=share, news=news)


def _tension(model, signals: Signals, recording: Recording, q, torque, keep: slice) -> np.ndarray | None:
    """Tension per cable side, upper before lower: as logged, else from torque and pretension if that is known."""
    sides = ("cable_tension_upper", "cable_tension_lower")
    if all(name in signals.channels for name in sides):
        pair = np.stack([signals.channels[name] for name in sides], -1)
        return pair.reshape(len(pair), -1)[keep]
    pretension = recording.pretension or model.manipulator.pretension
    if model.manipulator.pulleys is None or not pretension or torque is None:
        return None
    tau = torque @ np.linalg.pinv(model.joint_from_motor)
    tension = cable_state(model, q, tau, pretension).tension
    return tension.reshape(len(tension), -1)[keep]


def _with_forces(show: Show, model: CableModel, recording: Recording, q, v, a) -> Show:
    if model.manipulator.pulleys is None:
        return show
    found = cable_forces(model, q, v, a, recording.pretension)
    bodies = tuple(contact.link - 1 for contact in found.contacts)
    return replace(show, scenes=(build_scene(model, contacts=bodies),), force=found.force, point=found.point)


def _shrunk(show: Show, news: Mapping[str, Any]) -> np.ndarray | float:
    """How far the residual of each disc has come down since the first model."""
    rms, first, share = news.get("residual"), show.residual_rms, show.from_motors
    if rms is None or first is None or share is None or len(rms) != len(first):
        return 1.0
    before = np.linalg.norm(share * first, axis=1)
    return np.minimum(np.linalg.norm(share * np.asarray(rms, float), axis=1) / np.maximum(before, 1e-12), 1.0)


def _largest(values: np.ndarray | None) -> float:
    """Give what nearly all values stay below."""
    return 1.0 if values is None else max(float(np.percentile(np.abs(values), 99)), 1e-9)


def _at(time: np.ndarray, values: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Interpolate at each of n times, shape (n, ...)."""
    if len(time) < 2:
        return values[np.zeros(len(t), int)]
    k = np.clip(np.searchsorted(time, t) - 1, 0, len(time) - 2)
    s = np.clip((t - time[k]) / np.maximum(time[k + 1] - time[k], 1e-12), 0, 1)
    s = s.reshape(-1, *[1] * (values.ndim - 1))
    return (1 - s) * values[k] + s * values[k + 1]
