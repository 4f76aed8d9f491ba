"""The output side of a transmission from its input side: joints from motors, joint torques from motor torques."""

from __future__ import annotations

import numpy as np

from .cables import cable_state
from .completed import added
from .errors import RecordingError
from .geometry import Vector
from .model import CableModel
from .motion import Motion
from .recording import Recording
from .signals import motion_at_rows


def estimated_output(model: CableModel, recording: Recording) -> dict[str, Vector]:
    r"""Predict joint positions, joint torques and cable tensions from motor positions and motor torques.

    The completed model says how far each cable's travel x differs from the ideal one (elasticity, backlash, ratio
    errors), so that :math:`q = E (q_m - x / s) + \text{offset}`, and what of the motors' torque its effects and rotors
    take, so that :math:`\tau = E'^{+} (\tau_m - f - J \ddot q_m)`.

    Parameters
    ----------
    model : CableModel
    recording : Recording
        With motor positions; torques and tensions are given where motor torques are there.

    Returns
    -------
    dict of str to ndarray, shape (n_rows, n_joints) or (n_rows, n_motors)
        ``joint_position``, ``joint_torque``, ``cable_tension_upper``, ``cable_tension_lower``.

    Raises
    ------
    RecordingError
        If there is no motor position.
    """
    if "motor_position" not in recording.channels:
        raise RecordingError("holds no motor_position: the input side is needed", source=recording.source)
    side = motion_at_rows(recording, "motor", None)
    q_m, v_m, a_m = side["position"], side["velocity"], side["acceleration"]
    E = model.joint_from_motor
    motion = Motion(
        model=model,
        time=recording.time - recording.time[0],
        q=model.joint_position(q_m),
        v=v_m @ E.T,
        a=a_m @ E.T,
        q_m=q_m,
        v_m=v_m,
        a_m=a_m,
        joints_measured=True,
        motors_measured=True,
        velocity_noise=np.zeros(model.n_motors),
        pretension=recording.pretension or model.manipulator.pretension,
    )
    taken, travel = added(motion)
    taken = taken + model.rotor_inertia * a_m
    out = {"joint_position": model.joint_position(q_m - travel / model.arm_scale)}
    if "motor_torque" in recording.channels:
        out["joint_torque"] = (recording.channels["motor_torque"] - taken) @ np.linalg.pinv(E)
        if model.manipulator.pulleys is not None:
            state = cable_state(model, out["joint_position"], out["joint_torque"], motion.pretension)
            out["cable_tension_upper"], out["cable_tension_lower"] = state.tension[..., 0], state.tension[..., 1]
    return out
