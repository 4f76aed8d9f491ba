r"""Closed-loop runs of a plant along a wanted motion, with the controllers of Figure 7.

The controller acts at the motors: :math:`\tau_m = u_{PID}(q_{m,d} - q_m) + u_{model}`, the second part given by the
caller as an array, so that no plant knows any model of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..errors import ShapeError, SimulationError
from .faults import Fault
from .sensing import Noise, Sensors, encoder_offsets, interpolate, noise_series, sampling_times, torque_as_logged


class Plant(Protocol):
    """What a plant offers: see `cdm_pin.plant.mujoco_plant.MujocoPlant`."""

    step: float
    midway: bool
    n_joints: int
    n_motors: int
    tension: np.ndarray | None

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        """Start at joint positions and velocities (n_joints,)."""
        ...

    @property
    def joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Joint positions and velocities now."""
        ...

    @property
    def motors(self) -> tuple[np.ndarray, np.ndarray]:
        """Motor positions and velocities now."""
        ...

    def advance(self, tau_m: np.ndarray, *, note: bool = True) -> None:
        """Make one step under motor torques (n_motors,); keep its tensions if `note`."""
        ...


@dataclass(frozen=True)
class Pid:
    """Gains of a PID controller on motor positions, each (n_motors,).

    Parameters
    ----------
    proportional, integral, derivative : ndarray
        [N m/rad], [N m/(rad s)], [N m s/rad].
    encoder_bits : int, optional
        Steps per turn, as a power of two, of the encoder it sees; none: positions and velocities are exact.
    derivative_cutoff : float
        With an encoder: corner of the filtered difference that stands for velocity [Hz].
    torque_limit : ndarray, optional
        [N m].
    """

    proportional: np.ndarray
    integral: np.ndarray
    derivative: np.ndarray
    encoder_bits: int | None = None
    derivative_cutoff: float = 50.0
    torque_limit: np.ndarray | None = None


def pid_of_bandwidth(
    inertia: np.ndarray, *, bandwidth: float = 2.0, damping: float = 0.7, integral: float = 0.3, **settings
) -> Pid:
    r"""Place the poles of a PID on the nominal inertia of each motor.

    The error of a lone inertia then obeys
    :math:`(s + \alpha)(s^2 + 2 \zeta \omega s + \omega^2) = 0` with :math:`\alpha` = `integral` times :math:`\omega`.

    Parameters
    ----------
    inertia : ndarray, shape (n_motors,)
        [kg m^2] at the motor.
    bandwidth : float
        omega / 2 pi [Hz].
    damping : float
        zeta.
    integral : float
        alpha / omega; 0 is a PD.
    **settings
        The rest of `Pid`.
    """
    omega, J = 2.0 * np.pi * bandwidth, np.asarray(inertia, float)
    alpha = integral * omega
    proportional = J * (omega**2 + 2.0 * damping * omega * alpha)
    return Pid(proportional, J * alpha * omega**2, J * (2.0 * damping * omega + alpha), **settings)


@dataclass(frozen=True)
class Run:
    """What happened in a closed loop, at every control instant; nothing is measured yet.

    Parameters
    ----------
    step : float
        Time between rows [s].
    q, q_desired, q_m : ndarray, shape (n, n_joints) or (n, n_motors)
        Joint positions, wanted joint positions, motor positions [rad].
    tau_m, tau_pid : ndarray, shape (n, n_motors)
        Motor torques and the controller's share of them [N m]; the rest is the model's.
    tension : ndarray, shape (n, 2, n_motors), or None
        Upper and lower strand at the drive pulleys [N].
    """

    step: float
    q: np.ndarray
    q_desired: np.ndarray
    q_m: np.ndarray
    tau_m: np.ndarray
    tau_pid: np.ndarray
    tension: np.ndarray | None

    @property
    def time(self) -> np.ndarray:
        """Control instants [s], shape (n,)."""
        return self.step * np.arange(len(self.q))


def control_instants(plant: Plant, duration: float, rate: float | None = None) -> np.ndarray:
    """Give the instants [s] at which a controller of `rate` [Hz] (default: every step) acts, up to `duration`."""
    every = 1 if rate is None else max(1, round(1.0 / (rate * plant.step)))
    return np.arange(0.0, duration + 0.5 * every * plant.step, every * plant.step)


def simulate(
    plant: Plant,
    time: np.ndarray,
    q_desired: np.ndarray,
    v_desired: np.ndarray,
    pid: Pid,
    *,
    feedforward: np.ndarray | None = None,
    motor_from_joint: np.ndarray,
    offset: np.ndarray | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Run:
    """Run a plant in closed loop.

    Parameters
    ----------
    plant : Plant
        Starts at the first wanted position and velocity.
    time : ndarray, shape (n,)
        Control instants from `control_instants`.
    q_desired, v_desired : ndarray, shape (n, n_joints)
        Wanted joint positions [rad] and velocities there.
    pid : Pid
    feedforward : ndarray, shape (n, n_motors), optional
        Torque added to the controller's [N m].
    motor_from_joint : ndarray, shape (n_motors, n_joints)
        The nominal map the controller uses.
    offset : ndarray, shape (n_joints,), optional
        Joint positions at motor positions zero.
    progress : callable, optional

    Raises
    ------
    ShapeError
        If arrays do not fit the plant.
    SimulationError
        If the run diverges; says when and what to lower.
    """
    n, motors, joints = len(time), plant.n_motors, plant.n_joints
    feedforward = np.zeros((n, motors)) if feedforward is None else feedforward
    for name, x, width in (
        ("q_desired", q_desired, joints),
        ("v_desired", v_desired, joints),
        ("feedforward", feedforward, motors),
    ):
        if x.shape != (n, width):
            raise ShapeError(f"{name} has shape {x.shape}, ({n}, {width}) was expected")
    step = time[1] - time[0] if n > 1 else plant.step
    every = round(step / plant.step)
    wanted = (q_desired - (0.0 if offset is None else offset)) @ motor_from_joint.T
    wanted_rate = v_desired @ motor_from_joint.T
    plant.reset(q_desired[0], v_desired[0])
    slip = wanted[0] - plant.motors[0]  # stretch of elastic cables at the start
    q, q_m, tau_m, tau_pid = np.empty((n, joints)), np.empty((n, motors)), np.empty((n, motors)), np.empty((n, motors))
    tension = None if plant.tension is None else np.empty((n, 2, motors))
    feedback = _Feedback(pid, step, plant.motors)
    far = 10.0 + np.abs(wanted).max()
    for k in range(n):
        q[k], (q_m[k], v_m) = plant.joints[0], plant.motors
        tau_pid[k] = feedback(wanted[k], wanted_rate[k], q_m[k], v_m)
        tau_m[k] = tau_pid[k] + feedforward[k]
        if pid.torque_limit is not None:
            tau_m[k] = np.clip(tau_m[k], -pid.torque_limit, pid.torque_limit)
        if not np.abs(q_m[k] + slip).max() < far:
            raise SimulationError(f"the closed loop diverges at {time[k]:.3f} s: lower the controller's bandwidth")
        try:
            for part in range(every):
                plant.advance(tau_m[k], note=part == 0)
        except SimulationError as exc:
            raise SimulationError(f"{exc}; if the loop is unstable, lower the controller's bandwidth") from None
        if tension is not None:
            tension[k] = plant.tension
        if progress and k % 2000 == 0:
            progress("simulate", k / n)
    now = 0.5 if plant.midway else 0.5 + 0.5 / every  # of a torque held: the rest of it acts after its instant
    tau_m[1:] = now * tau_m[1:] + (1.0 - now) * tau_m[:-1]
    return Run(step, q, q_desired, q_m, tau_m, tau_pid, tension)


class _Feedback:
    """The controller's memory: integral, encoder, filtered velocity."""

    def __init__(self, pid: Pid, step: float, motors: tuple[np.ndarray, np.ndarray]):
        self._pid, self._step = pid, step
        self._tick = 2.0 * np.pi / 2**pid.encoder_bits if pid.encoder_bits else 0.0
        self._share = 1.0 - np.exp(-2.0 * np.pi * pid.derivative_cutoff * step)
        self._sum = np.zeros(len(motors[0]))
        self._before, self._rate = self._seen(motors[0]), motors[1].copy()

    def _seen(self, q_m: np.ndarray) -> np.ndarray:
        return np.round(q_m / self._tick) * self._tick if self._tick else q_m.copy()

    def __call__(self, wanted: np.ndarray, wanted_rate: np.ndarray, q_m: np.ndarray, v_m: np.ndarray) -> np.ndarray:
        pid, seen = self._pid, self._seen(q_m)
        if self._tick:
            self._rate = self._rate + self._share * ((seen - self._before) / self._step - self._rate)
            self._before, v_m = seen, self._rate
        error = wanted - seen
        self._sum += error * self._step
        return pid.proportional * error + pid.integral * self._sum + pid.derivative * (wanted_rate - v_m)


def measured(
    run: Run, sensors: Sensors, noise: Noise | None = None, *, faults: Sequence[Fault] = (), seed: int = 0
) -> dict[str, np.ndarray]:
    """Log a run as a robot would: quantities by name, and "time" [s].

    Parameters
    ----------
    run : Run
    sensors : Sensors
        Which positions, how many encoder bits (0: exact), rate, jitter, tensions.
    noise : Noise, optional
        Of the torques; none by default.
    faults : sequence of Fault
        Those of sensors (delay, gain, offset, encoder offset) distort what is logged.
    seed : int

    Returns
    -------
    dict of str to ndarray
        "time" (n,), the others (n, width).
    """
    rng = np.random.default_rng(seed)
    t = (
        sampling_times(sensors, run.time[-1] - 0.02, rng)
        if sensors.jitter
        else np.arange(0.0, run.time[-1] + 1e-9, 1.0 / sensors.rate)
    )
    tick = 2.0 * np.pi / 2**sensors.bits if sensors.bits else 0.0

    def sampled(x: np.ndarray, tick: float = 0.0) -> np.ndarray:
        y = interpolate(x, run.step, t)
        return np.round(y / tick) * tick if tick else y

    out = {"time": t}
    if sensors.positions in ("joint", "both"):
        out["joint_position"] = sampled(run.q + encoder_offsets(faults, run.q.shape[1]), tick)
    if sensors.positions in ("motor", "both"):
        out["motor_position"] = sampled(run.q_m, tick)
    out["joint_position_desired"] = sampled(run.q_desired)
    out["motor_torque"] = torque_as_logged(faults, run.tau_m, run.step, t)
    if noise is not None:
        out["motor_torque"] += noise_series(noise, t, rng)
    if sensors.tensions and run.tension is not None:
        out["cable_tension_upper"], out["cable_tension_lower"] = (sampled(run.tension[:, k]) for k in (0, 1))
    return out
