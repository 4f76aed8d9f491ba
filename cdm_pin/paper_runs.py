"""The paper's simulations in closed loop in MuJoCo: cases 1-4 (Figures 7-9) and the experiment of (61)-(68)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .dynamics import mass_matrix, motor_torques
from .fourier import FourierSeries, fit_series
from .geometry import Vector
from .model import CableModel
from .paper import DROPPED, RATE, coefficient_matrices, per_joint_estimate, shared_estimate
from .plant.mjcf import Strands
from .plant.mujoco_plant import MujocoPlant
from .plant.simulate import Pid, Run, control_instants, pid_of_bandwidth, simulate

Trajectory = Callable[[Vector], tuple[Vector, Vector, Vector]]

STEP = 1e-3  # [s] of plant and controller
CASE_DURATION, SETTLED = 10.0, 2.0  # [s] of a case; of it until errors count


def sine_motion(time: Vector) -> tuple[Vector, Vector, Vector]:
    """Give the motion of cases 1 and 2: each joint a sine, 30 deg at 0.2 Hz and 45 deg at 0.3 Hz.

    Figure 8 states no numbers; these are ours.
    """
    amplitude, w = np.radians([30.0, 45.0]), 2 * np.pi * np.array([0.2, 0.3])
    phase = np.multiply.outer(np.asarray(time, float), w)
    return amplitude * np.sin(phase), amplitude * w * np.cos(phase), -amplitude * w**2 * np.sin(phase)


def quadratic_motion(time: Vector) -> tuple[Vector, Vector, Vector]:
    """Give the motion of cases 3 and 4: segments of quadratic polynomials, acceleration jumping between two values.

    Joint 1 swings by 36 deg in 4 s, joint 2 by 45 deg in 3 s and back, each resting at its ends. Figure 9 states no
    numbers; these are ours.
    """
    swing, half = np.radians([36.0, 45.0]), np.array([2.0, 1.5])
    rate = swing / half**2
    phase = np.asarray(time, float)[:, None] / half % 4.0
    part, s = phase.astype(int), phase % 1.0
    a = rate * np.choose(part, (1.0, -1.0, -1.0, 1.0))
    v = rate * half * np.choose(part, (s, 1 - s, -s, s - 1))
    q = swing * np.choose(part, (s**2 / 2, 1 - (1 - s) ** 2 / 2, 1 - s**2 / 2, (1 - s) ** 2 / 2))
    return q, v, a


CASES: dict[int, tuple[Trajectory, bool]] = {
    1: (sine_motion, False),
    2: (sine_motion, True),
    3: (quadratic_motion, False),
    4: (quadratic_motion, True),
}
"""Motion, and whether the model is fed forward."""


def controller(model: CableModel, *, bandwidth: float = 2.0, **settings) -> Pid:
    """Give the PID of all runs: `bandwidth` [Hz] and damping 0.7 on each motor's nominal inertia, arm stretched out."""
    inertia = mass_matrix(model, np.zeros((1, model.n_joints)), coordinates="motor")[0]
    return pid_of_bandwidth(np.diag(inertia), bandwidth=bandwidth, damping=0.7, **settings)


def closed_loop(
    model: CableModel,
    motion: Trajectory,
    duration: float,
    *,
    feedforward: bool = False,
    strands: Strands | None = None,
    pid: Pid | None = None,
    step: float = STEP,
) -> Run:
    """Run the arm in MuJoCo along a motion, Figure 7.

    Parameters
    ----------
    model : CableModel
        Plant and feed-forward have its parameters.
    motion : callable
        From times [s] to wanted q, v, a.
    duration : float
        [s].
    feedforward : bool
        Add the model's torques to the PID's (Figure 7 b).
    strands : Strands, optional
        Elasticity of the cables; rigid by default.
    pid : Pid, optional
        Default `controller`.
    step : float
        Of plant and controller [s].

    Raises
    ------
    SimulationError
        If the loop diverges.
    """
    plant = MujocoPlant(model.manipulator, strands=strands, step=step)
    time = control_instants(plant, duration)
    q, v, a = motion(time)
    extra = motor_torques(model, q, v, a) if feedforward else None
    pid = pid or controller(model)
    return simulate(plant, time, q, v, pid, feedforward=extra, motor_from_joint=model.motor_from_joint)


@dataclass(frozen=True)
class Tracking:
    """How well a case tracks, after the first two seconds.

    Attributes
    ----------
    error : ndarray, shape (n_joints,)
        Root mean square joint position error [rad].
    pid_share : ndarray, shape (n_motors,)
        Root mean square of the PID's part of the control input over that of the whole.
    """

    error: Vector
    pid_share: Vector


def tracking(run: Run, after: float = SETTLED) -> Tracking:
    """Sum up a run."""
    late = run.time >= after

    def rms(x: Vector) -> Vector:
        return np.sqrt(np.mean(x[late] ** 2, axis=0))

    return Tracking(rms(run.q - run.q_desired), rms(run.tau_pid) / rms(run.tau_m))


def stretch(model: CableModel, run: Run, strands: Strands) -> Vector:
    r"""Give the joint deflection that elastic cables leave, unseen by the motors, shape (n, n_joints) [rad].

    Cable i with two strands of stiffness k turns link i back by :math:`n_i / (2 k r_j^2)`; a joint sees the difference
    between its link's and the one before.
    """
    pulleys = model.manipulator.pulleys
    assert pulleys is not None
    r_m, r_j = pulleys.motor_pulley_radius, pulleys.joint_pulley_radius
    absolute = -run.tau_m * (r_j / r_m) / (2 * strands.stiffness * r_j**2)
    return np.diff(absolute, axis=1, prepend=0.0)


@dataclass(frozen=True)
class Experiment:
    """The identification experiment: the run's samples, the refit, both estimates.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Of the samples used [s].
    refit : FourierSeries
        Eq. (52).
    tau_m : ndarray, shape (n, 2)
        Logged control input [N m].
    per_joint, shared : ndarray, shape (6,)
        P_11 .. P_32 by eq. (44), and with the coupling shared.
    """

    time: Vector
    refit: FourierSeries
    tau_m: Vector
    per_joint: Vector
    shared: Vector


def samples(run: Run, *, rate: float = RATE, dropped: float = DROPPED) -> tuple[Vector, Vector, Vector]:
    """Take time, joint positions and motor torques of a run at `rate` [Hz], without the first `dropped` seconds."""
    every = round(1.0 / (rate * run.step))
    keep = slice(round(dropped / run.step), None, every)
    return run.time[keep], run.q[keep], run.tau_m[keep]


def identification(
    run: Run, frequency: float, *, harmonics: int = 4, constant: bool = False, noise: Vector | float = 0.0
) -> Experiment:
    """Refit the actual motion to eq. (52) and estimate the parameters, eqs (63)-(66).

    Parameters
    ----------
    run : Run
    frequency : float
        Base frequency of the desired trajectory [rad/s].
    harmonics : int
        Of the refit; 4 as printed. A PID loop adds higher ones: with gravity the arm is not linear.
    constant : bool
        Also refit a constant.
    noise : ndarray, shape (n, 2)
        Added to the logged torques [N m].
    """
    time, q, tau_m = samples(run)
    refit = fit_series(time, q, harmonics, frequency, constant=constant)
    matrices = coefficient_matrices(*refit(time))
    tau_m = tau_m + noise
    return Experiment(time, refit, tau_m, per_joint_estimate(*matrices, tau_m), shared_estimate(*matrices, tau_m))
