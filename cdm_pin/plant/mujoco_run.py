"""One run of a drawn arm with its faults in MuJoCo, under the same servo as the absolute-angle plant has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from .absolute import Reference, Servo, motor_torques, prescribed
from .arms import to_manipulator
from .compile import compile_laws
from .faults import Fault
from .mujoco_plant import MujocoPlant
from .paths import ideal_cables
from .planar import Arm
from .sensing import Motion
from .sideforces import NOT_APPLIED
from .simulate import Pid, control_instants, simulate

CANNOT = NOT_APPLIED  # effects that this plant does not carry
_STEP, _RATE = 2.5e-4, 1000.0  # [s] of MuJoCo, [Hz] of the servo


def simulate_in_mujoco(
    arm: Arm, faults: Sequence[Fault], model: Arm, servo: Servo, reference: Reference, duration: float
) -> Motion:
    """Run the arm in MuJoCo: PD on the motors and the wrong model's torque along the reference.

    Raises
    ------
    SimulationError
        If the loop diverges or a joint leaves its pulleys.
    InputError
        If MuJoCo cannot carry a fault.
    """
    n = arm.length.size
    plant = MujocoPlant(to_manipulator(arm), faults=faults, step=_STEP)
    time = control_instants(plant, duration + 0.1, _RATE)
    step = time[1]
    phi, w, a = prescribed(reference, step, len(time))
    wanted, _, _ = motor_torques(model, compile_laws([], model.ratio, n), ideal_cables(n), phi, w, a, step)
    ripple = servo.ripple[:, 0] * np.sin(servo.ripple[:, 1] * time[:, None] + servo.ripple[:, 2])
    pid = Pid(servo.stiffness * arm.ratio**2, np.zeros(n), servo.damping * arm.ratio**2)
    to_joint = np.eye(n) - np.eye(n, k=-1)
    run = simulate(
        plant,
        time,
        phi @ to_joint.T,
        w @ to_joint.T,
        pid,
        feedforward=servo.feedforward * wanted + arm.ratio * ripple,
        motor_from_joint=np.linalg.inv(to_joint) / arm.ratio,
    )
    links = CubicSpline(time, np.cumsum(run.q, axis=1))
    assert run.tension is not None
    pulled = (run.tension[:, 0] - run.tension[:, 1]) * arm.joint_pulley_radius
    return Motion(links(time), links(time, 1), links(time, 2), run.tau_m, run.q_m, pulled, step)
