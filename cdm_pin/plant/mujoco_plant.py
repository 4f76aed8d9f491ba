"""A planar cable-driven arm in MuJoCo, stepped by motor torques; `cdm_pin.plant.mjcf` says how its cables are made."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from ..errors import SimulationError
from ..geometry import Manipulator
from .faults import Fault
from .mjcf import Strands, cable_strands, compile_arm, in_model, planar_pulleys, rotor_inertia
from .sideforces import LOGGED, SideForces


class MujocoPlant:
    """The arm with rigid or elastic cables.

    Parameters
    ----------
    manipulator : Manipulator
        A planar arm with pulleys.
    strands : Strands, optional
        Elasticity of all cables; rigid by default.
    faults : sequence of Fault
        What is wrong with it. Viscous and dry friction, springs, payloads, tilt, rotors, ratio errors and cable
        elasticity are MuJoCo's own; other laws are applied as torques at every step.
    step : float
        Time step [s].

    Attributes
    ----------
    midway : bool
        Whether the torque of a step belongs to the step's middle (as against its beginning).
    """

    midway = False  # symplectic steps: torque and position of the same index belong together

    def __init__(
        self,
        manipulator: Manipulator,
        *,
        strands: Strands | None = None,
        faults: Sequence[Fault] = (),
        step: float = 5e-4,
    ):
        self.step, self.n_joints = step, len(manipulator.links)
        self.n_motors = self.n_joints
        self.model = compile_arm(manipulator, strands=strands, faults=faults, timestep=step)
        self.data = mujoco.MjData(self.model)
        pulleys, cables = planar_pulleys(manipulator), cable_strands(manipulator, strands or Strands(), faults)
        self._elastic = np.flatnonzero([cable.elastic for cable in cables])
        self._stiffness = np.array([cable.stiffness for cable in cables])
        self._joint_radius, self._radius = pulleys.joint_pulley_radius, pulleys.motor_pulley_radius
        self._pretension = float(manipulator.pretension or 0.0)
        self._reach = 2.0 * pulleys.wrap_half_angle
        joints = [self.model.joint(f"joint_{k + 1}") for k in range(self.n_joints)]
        winches = [self.model.joint(f"motor_{i + 1}") for i in self._elastic]
        self._q, self._s = (np.array([j.qposadr[0] for j in each], int) for each in (joints, winches))
        self._v, self._w = (np.array([j.dofadr[0] for j in each], int) for each in (joints, winches))
        self._pull = {i: self._actuators(i) for i in range(self.n_motors)}
        rest = [f for f in faults if not in_model(f) and f.effect not in LOGGED]
        self._side = SideForces(manipulator, rest, self.n_joints, self.n_motors)
        self.reset(np.zeros(self.n_joints), np.zeros(self.n_joints))
        if self._side.any:
            self._ease(rotor_inertia(manipulator, faults))

    def _ease(self, rotor: np.ndarray) -> None:
        ratio = self._radius / self._joint_radius
        E = np.eye(self.n_joints) * ratio - np.eye(self.n_joints, k=-1) * np.roll(ratio, 1)[:, None]
        inertia = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, inertia)
        mobility = np.linalg.inv(E.T @ inertia[np.ix_(self._v, self._v)] @ E)
        for i in self._elastic:
            mobility[i, i] += 1.0 / rotor[i]
        self._side.ease(E, mobility, self.step)

    def _actuators(self, i: int) -> list[int]:
        names = [f"motor_{i + 1}"] if i in self._elastic else [f"cable_{i + 1}_upper", f"cable_{i + 1}_lower"]
        return [self.model.actuator(name).id for name in names]

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        """Put the arm at joint positions `q` [rad] and velocities `v`, every winch where its cable carries the load."""
        data = self.data
        mujoco.mj_resetData(self.model, data)
        self._side.reset()
        data.qpos[self._q], data.qvel[self._v] = q, v
        mujoco.mj_forward(self.model, data)
        load = data.qfrc_bias[self._v]
        load = load - np.append(load[1:], 0.0)  # of each cable about its drive pulley
        travel, speed = self._travel()
        for j, i in enumerate(self._elastic):
            stretch = 0.5 * load[i] / (self._stiffness[i] * self._joint_radius[i])
            data.qpos[self._s[j]], data.qvel[self._w[j]] = travel[i] + stretch, speed[i]
        self.tension = np.full((2, self.n_motors), self._pretension)
        mujoco.mj_step1(self.model, data)

    def _travel(self) -> tuple[np.ndarray, np.ndarray]:
        """Cable drawn in at the winches (n_motors,) [m] and its rate [m/s], elastic cables' winches at rest."""
        n = 2 * self.n_motors
        change = (self.data.ten_length - self.model.tendon_length0)[:n].reshape(-1, 2)
        rate = self.data.ten_velocity[:n].reshape(-1, 2)
        return 0.5 * (change[:, 1] - change[:, 0]), 0.5 * (rate[:, 1] - rate[:, 0])

    @property
    def joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Joint positions and velocities now, each (n_joints,)."""
        return self.data.qpos[self._q], self.data.qvel[self._v]

    @property
    def motors(self) -> tuple[np.ndarray, np.ndarray]:
        """Motor angles and velocities now, each (n_motors,)."""
        travel, speed = self._travel()
        travel[self._elastic], speed[self._elastic] = self.data.qpos[self._s], self.data.qvel[self._w]
        return travel / self._radius, speed / self._radius

    def advance(self, tau_m: np.ndarray, *, note: bool = True) -> None:
        """Make one step under the motor torques `tau_m` (n_motors,) [N m]; keep its tensions if `note`.

        Raises
        ------
        SimulationError
            If the integration breaks down or a cable leaves its joint pulley.
        """
        data = self.data
        q, v = self.joints
        push = np.asarray(tau_m, float)
        if self._side.any:
            f_joint, f_motor = self._side(data.time, self.step, q, v, *self.motors, push)
            data.qfrc_applied[self._v] = -f_joint
            push = push - f_motor
        for i, actuators in self._pull.items():
            force = push[i] / self._radius[i]
            pair = [-self._pretension - 0.5 * force, -self._pretension + 0.5 * force]
            data.ctrl[actuators] = force if i in self._elastic else pair
        mujoco.mj_step2(self.model, data)
        if note:
            self._note_tension()
        mujoco.mj_step1(self.model, data)
        if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number or not np.isfinite(data.qpos).all():
            raise SimulationError(f"the simulation diverged at {data.time:.3f} s")
        out = np.flatnonzero(np.abs(data.qpos[self._q]) > self._reach)
        if out.size:
            degrees = np.degrees(self._reach[out[0]])
            raise SimulationError(
                f"joint {out[0] + 1} leaves its pulleys at {data.time:.3f} s (beyond {degrees:.1f} deg)"
            )

    def _note_tension(self) -> None:
        """Keep the tension of every strand at its drive pulley in the step just made."""
        model, data, n = self.model, self.data, 2 * self.n_motors
        beyond = np.maximum(data.ten_length - model.tendon_lengthspring[:, 1], 0.0)
        pull = (model.tendon_stiffness * beyond + model.tendon_damping * data.ten_velocity)[:n].reshape(-1, 2)
        lost = model.tendon_damping[n:] * data.ten_velocity[n:]  # by the motors of rigid cables
        moment = np.zeros((model.ntendon, model.nv))
        mujoco.mju_sparse2dense(moment, data.ten_J, model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind)
        lost += model.tendon_armature[n:] * (moment[n:] @ data.qacc)
        dry = data.efc_type == mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON
        np.subtract.at(lost, data.efc_id[dry] - n, data.efc_force[dry])
        for j, i in enumerate(i for i in range(self.n_motors) if i not in self._elastic):
            half = 0.5 * lost[j] / self._radius[i]
            pull[i] = -data.ctrl[self._pull[i]] + np.array([-half, half])
        self.tension = pull.T
