"""A model and a wanted trajectory to a simulated recording: which plant, which controller, which sensors.

``controller.yaml`` has three sections, all of whose keys have defaults::

    control: {feedforward: true, bandwidth: 2.0, damping: 0.7, integral: 0.3, rate: 2000.0,
              gains: {proportional: [..], integral: [..], derivative: [..]}, encoder_bits: 17, derivative_cutoff: 50.0}
    sensors: {positions: both, encoder_bits: 17, rate: 200.0, jitter: 0.0, torque_noise: 0.02, noise_correlation: 0.0,
              tensions: true}
    plant: {cable_stiffness: 2.0e5, cable_damping: 50.0, step: 5.0e-4}

`gains` (per motor) replace `bandwidth`, `damping` and `integral`. Without `encoder_bits` positions are exact; without
`cable_stiffness` (N/m per strand) cables are rigid.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from os import PathLike
from typing import Any, Literal, get_args

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from .dynamics import mass_matrix, motor_torques
from .errors import InputError, RecordingError
from .files import check_keys, read_yaml
from .geometry import Vector
from .model import CableModel
from .places import is_whole_cable
from .plant.faults import Fault
from .plant.mjcf import Strands
from .plant.mujoco_plant import MujocoPlant
from .plant.pinocchio_plant import PinocchioPlant
from .plant.sensing import Noise, Positions, Sensors
from .plant.sideforces import NOT_APPLIED
from .plant.simulate import Pid, Plant, Run, control_instants, measured, pid_of_bandwidth, simulate
from .recording import Recording
from .signals import motion_at_rows

PlantName = Literal["mujoco", "pinocchio"]
NEEDS_CABLES = ("cable_elasticity", "transmission_ratio_error")  # carried by the mujoco plant alone
_KEYS = {
    "control": (
        "feedforward", "bandwidth", "damping", "integral", "rate", "gains", "encoder_bits", "derivative_cutoff",
    ),
    "sensors": ("positions", "encoder_bits", "rate", "jitter", "torque_noise", "noise_correlation", "tensions"),
    "plant": ("cable_stiffness", "cable_damping", "step"),
}  # fmt: skip
_GAINS = ("proportional", "integral", "derivative")


@dataclass(frozen=True)
class Settings:
    """What controller.yaml says.

    Attributes
    ----------
    control, sensors, plant : mapping
        Its sections, keys checked; see the module.
    """

    control: Mapping[str, Any] = field(default_factory=dict)
    sensors: Mapping[str, Any] = field(default_factory=dict)
    plant: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Simulated:
    """A simulated recording and the run behind it.

    Attributes
    ----------
    recording : Recording
        As the sensors logged it, wanted joint positions beside it.
    run : Run
        As it was, at every control instant.
    """

    recording: Recording
    run: Run

    @property
    def tracking_error(self) -> Vector:
        """Root mean square joint position error, shape (n_joints,) [rad]."""
        return np.sqrt(np.mean((self.run.q - self.run.q_desired) ** 2, axis=0))


def load_settings(path: str | PathLike[str]) -> Settings:
    """Read controller.yaml.

    Raises
    ------
    InputError
        If it cannot be read, or a key or value is not known.
    """
    content = read_yaml(path)
    check_keys(content, _KEYS, source=path)
    for name, keys in _KEYS.items():
        check_keys(content.get(name) or {}, keys, source=path, place=name)
    sections = {name: content.get(name) or {} for name in _KEYS}
    _check_values(sections, path)
    return Settings(**sections)


def _check_values(sections: Mapping[str, Mapping[str, Any]], path) -> None:
    zero = ("integral", "jitter", "torque_noise", "cable_damping")
    for name, section in sections.items():
        for key, value in section.items():
            place = f"{name}.{key}"
            if key == "positions":
                good, wanted = value in get_args(Positions), f"one of {', '.join(get_args(Positions))}"
            elif key in ("feedforward", "tensions"):
                good, wanted = isinstance(value, bool), "true or false"
            elif key == "gains":
                check_keys(value, _GAINS, required=_GAINS, source=path, place=place)
                continue
            elif key == "encoder_bits":
                good, wanted = isinstance(value, int) and 2 <= value <= 40, "a whole number from 2 to 40"
            elif key == "noise_correlation":
                good, wanted = _number(value) and 0 <= value < 1, "a number from 0 to below 1"
            else:
                good = _number(value) and (value >= 0 if key in zero else value > 0)
                wanted = "a number, zero or above" if key in zero else "a number above zero"
            if not good:
                raise InputError(f"{wanted} was expected, found {value!r}", source=path, place=place)


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def simulate_recording(
    model: CableModel,
    trajectory: Recording,
    settings: Settings | None = None,
    *,
    plant: PlantName = "mujoco",
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> Simulated:
    """Run a model's robot, its effects included, along a trajectory in closed loop on an independent plant.

    Parameters
    ----------
    model : CableModel
        The robot; its rigid body is also what is fed forward.
    trajectory : Recording
        Wanted motion: desired joint positions if there are any, else joint positions, else motor positions; velocities
        and accelerations as given, else differentiated.
    settings : Settings, optional
    plant : "mujoco" or "pinocchio"
    seed : int
        Of the sensors' noise.
    progress : callable, optional

    Raises
    ------
    InputError
        If the trajectory holds no position, or the plant cannot be this robot.
    SimulationError
        If the loop diverges.
    """
    settings = settings or Settings()
    faults = [_fault(record) for record in model.manipulator.effects]
    machine = _machine(model, plant, settings, faults)
    rate = settings.control.get("rate")
    start, q, v, a = _wanted(model, trajectory)
    time = control_instants(machine, start[-1] - start[0], rate)
    time = time[time <= start[-1] - start[0] + 1e-9]
    position, velocity = CubicHermiteSpline(start - start[0], q, v), CubicHermiteSpline(start - start[0], v, a)
    wanted = position(time), velocity(time), velocity(time, 1)
    feedforward = motor_torques(model, *wanted) if settings.control.get("feedforward", True) else None
    run = simulate(
        machine,
        time,
        wanted[0],
        wanted[1],
        _controller(model, settings),
        feedforward=feedforward,
        motor_from_joint=model.motor_from_joint,
        offset=model.offset,
        progress=progress,
    )
    columns = _log(run, model, settings, faults, seed)
    stamps = columns.pop("time") + trajectory.time[0]
    recording = Recording(stamps, columns, label=trajectory.label, pretension=model.manipulator.pretension)
    return Simulated(recording, run)


def _fault(record: Mapping[str, Any]) -> Fault:
    """Turn an effect of a model file into what a plant understands."""
    parameters = {name: float(value) for name, value in record["parameters"].items() if _number(value)}
    form = ""
    if record["effect"] == "hysteresis":
        whole = is_whole_cable(record["location"])
        form = "tension" if whole else "maxwell_slip" if parameters.get("form") else "dahl"
    return Fault(record["effect"], dict(record["location"]), parameters, (), form)


def _machine(model: CableModel, plant: PlantName, settings: Settings, faults: list[Fault]) -> Plant:
    elastic, step = "cable_stiffness" in settings.plant, settings.plant.get("step", 5e-4)
    if elastic and plant != "mujoco":
        raise InputError("elastic cables run on the mujoco plant", place="plant.cable_stiffness")
    _check_carried(model, plant, faults)
    if plant == "mujoco":
        strands = Strands(settings.plant.get("cable_stiffness", np.inf), settings.plant.get("cable_damping", 0.0))
        return MujocoPlant(model.manipulator, strands=strands, faults=faults, step=step)
    return PinocchioPlant(
        model.manipulator,
        model.pin_model,
        model.joint_ids,
        model.joint_from_motor,
        offset=model.offset,
        rotor_inertia=model.rotor_inertia,
        faults=faults,
        step=step,
    )


def _check_carried(model: CableModel, plant: PlantName, faults: list[Fault]) -> None:
    """Refuse effects that a plant does not have, naming them all."""
    cannot = set(NOT_APPLIED) | (set(NEEDS_CABLES) if plant == "pinocchio" else set())
    for k, fault in enumerate(faults):
        own = "hysteresis of tension" if fault.form == "tension" else fault.effect
        if fault.effect in cannot or own != fault.effect:
            other = "; the mujoco plant can" if fault.effect in NEEDS_CABLES else ""
            raise InputError(
                f"the {plant} plant cannot carry {own}{other} (it carries all effects but {', '.join(sorted(cannot))})",
                source=model.manipulator.source,
                place=f"effects[{k + 1}]",
            )


def _wanted(model: CableModel, trajectory: Recording) -> tuple[Vector, Vector, Vector, Vector]:
    """Time, wanted joint positions, velocities, accelerations; one row per instant."""
    channels = trajectory.channels
    if trajectory.n_samples < 4:
        raise RecordingError(f"holds {trajectory.n_samples} rows; at least 4 are needed", source=trajectory.source)
    keep = np.concatenate([[True], np.diff(trajectory.time) > 0])
    if "joint_position_desired" in channels:
        trajectory = Recording(trajectory.time, {"joint_position": channels["joint_position_desired"]})
    elif "joint_position" not in channels and "motor_position" not in channels:
        message = "holds no joint_position_desired, joint_position or motor_position: one is needed"
        raise RecordingError(message, source=trajectory.source)
    side = "joint" if "joint_position" in trajectory.channels else "motor"
    motion = motion_at_rows(trajectory, side)
    q, v, a = (motion[what][keep] for what in ("position", "velocity", "acceleration"))
    if side == "motor":
        E = model.joint_from_motor
        q, v, a = model.joint_position(q), v @ E.T, a @ E.T
    return trajectory.time[keep], q, v, a


def _controller(model: CableModel, settings: Settings) -> Pid:
    control = settings.control
    limits = [motor.torque_limit for motor in model.manipulator.motors]
    own = {
        "encoder_bits": control.get("encoder_bits"),
        "derivative_cutoff": control.get("derivative_cutoff", 50.0),
        "torque_limit": np.array([np.inf if limit is None else limit for limit in limits]) if limits else None,
    }
    if "gains" in control:
        gains = {}
        for name in _GAINS:
            gains[name] = np.atleast_1d(np.asarray(control["gains"][name], float))
            if gains[name].shape != (model.n_motors,):
                message = f"{model.n_motors} numbers were expected, one per motor, found {control['gains'][name]!r}"
                raise InputError(message, place=f"control.gains.{name}")
        return Pid(**gains, **own)
    inertia = np.diag(mass_matrix(model, np.zeros((1, model.n_joints)), coordinates="motor")[0])
    poles = {name: control[name] for name in ("bandwidth", "damping", "integral") if name in control}
    return pid_of_bandwidth(inertia, **poles, **own)


def _log(run: Run, model: CableModel, settings: Settings, faults: list[Fault], seed: int) -> dict[str, np.ndarray]:
    said = settings.sensors
    sensors = Sensors(
        positions=said.get("positions", "both"),
        bits=said.get("encoder_bits", 0),
        rate=said.get("rate", 200.0),
        jitter=said.get("jitter", 0.0),
        tensions=said.get("tensions", True),
    )
    noise = None
    if said.get("torque_noise"):
        noise = Noise(np.full(model.n_motors, float(said["torque_noise"])), float(said.get("noise_correlation", 0.0)))
    return measured(run, sensors, noise, faults=faults, seed=seed)
