"""The motor torques that a model asks for along a recording, row by row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .cables import CableState, cable_state
from .completed import added_torque
from .dynamics import inverse_dynamics
from .errors import RecordingError
from .geometry import Vector
from .model import CableModel
from .motion import Motion
from .recording import Recording
from .signals import motion_at_rows


@dataclass(frozen=True)
class RecordedTorques:
    """A recorded motion and what it takes.

    Attributes
    ----------
    q, v, a : ndarray, shape (n_rows, n_joints)
        The joints' motion, which drives the rigid body [rad or m, s].
    a_m : ndarray, shape (n_rows, n_motors)
        Acceleration of the rotors [rad/s^2].
    tau : ndarray, shape (n_rows, n_joints)
        Of the joints [N m or N].
    tau_m : ndarray, shape (n_rows, n_motors)
        Of the motors [N m].
    cables : CableState or None
        Tensions and wrap; None for a robot without pulleys.
    """

    q: Vector
    v: Vector
    a: Vector
    a_m: Vector
    tau: Vector
    tau_m: Vector
    cables: CableState | None


def recorded_torques(model: CableModel, recording: Recording, cutoff: float | None = None) -> RecordedTorques:
    r"""Compute :math:`\tau_m = E'\tau(q, v, a) + J a_m` and the model's effects at every row of a recording.

    Where both positions were logged the joints' drive the rigid body and the motors' the rotors; else one follows from
    the other by E. Velocities and accelerations are taken as logged, else differentiated (`motion_at_rows`).

    Parameters
    ----------
    model : CableModel
    recording : Recording
    cutoff : float, optional
        Of the low-pass before a differentiation [Hz]; default where the positions' noise begins.

    Raises
    ------
    RecordingError
        If it holds no position.
    """
    E, B = model.joint_from_motor, model.motor_from_joint
    sides = [side for side in ("joint", "motor") if f"{side}_position" in recording.channels]
    if not sides:
        raise RecordingError("holds no joint_position and no motor_position: one is needed", source=recording.source)
    motion = {side: motion_at_rows(recording, side, cutoff) for side in sides}
    if "joint" in motion:
        q, v, a = (motion["joint"][what] for what in ("position", "velocity", "acceleration"))
    else:
        q = model.joint_position(motion["motor"]["position"])
        v, a = motion["motor"]["velocity"] @ E.T, motion["motor"]["acceleration"] @ E.T
    a_m = motion["motor"]["acceleration"] if "motor" in motion else a @ B.T
    tau = inverse_dynamics(model, q, v, a)
    tau_m = model.motor_torque(tau) + model.rotor_inertia * a_m
    if model.manipulator.effects:
        q_m = motion["motor"]["position"] if "motor" in motion else model.motor_position(q)
        v_m = motion["motor"]["velocity"] if "motor" in motion else v @ B.T
        tau_m = tau_m + added_torque(
            Motion(
                model=model,
                time=recording.time - recording.time[0],
                q=q,
                v=v,
                a=a,
                q_m=q_m,
                v_m=v_m,
                a_m=a_m,
                joints_measured="joint" in motion,
                motors_measured="motor" in motion,
                velocity_noise=np.zeros(model.n_motors),
                pretension=recording.pretension or model.manipulator.pretension,
            )
        )
    cables = None
    if model.manipulator.pulleys is not None:
        cables = cable_state(model, q, tau, recording.pretension)
    return RecordedTorques(q, v, a, a_m, tau, tau_m, cables)


def rms(x: Vector) -> Vector:
    """Give the root mean square of each column."""
    return np.sqrt(np.mean(np.square(x), axis=0))
