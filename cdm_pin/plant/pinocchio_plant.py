r"""Any robot of a Pinocchio model behind a motor/joint map, stepped by motor torques with Pinocchio's own dynamics.

With :math:`q = E q_m + b` and :math:`\tau_m = E^T \tau` the motors obey

.. math:: (E^T M E + J)\,\dot v_m = \tau_m - f_m - E^T (h + f)

which for as many joints as motors and no rotors is :func:`pinocchio.aba` itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ..errors import InputError, SimulationError
from ..geometry import Manipulator
from .faults import Fault
from .sideforces import LOGGED, SideForces


class PinocchioPlant:
    """A robot with rigid transmissions.

    Parameters
    ----------
    manipulator : Manipulator
        For pulleys and pretension, where it has any.
    model : pinocchio.Model
        Joints of one degree of freedom each; not changed.
    joint_ids : sequence of int
        Pinocchio's joint id of every row of `joint_from_motor`.
    joint_from_motor : ndarray, shape (n_joints, n_motors)
        E.
    offset : ndarray, shape (n_joints,)
        b [rad or m].
    rotor_inertia : ndarray, shape (n_motors,)
        J [kg m^2].
    faults : sequence of Fault
        Laws are applied as torques; payload, tilt and rotor inertia change the robot.
    step : float
        Time step [s] of classical Runge-Kutta.

    Attributes
    ----------
    midway : bool
        Whether the torque of a step belongs to the step's middle (as against its beginning).
    """

    midway = True

    def __init__(
        self,
        manipulator: Manipulator,
        model: pin.Model,
        joint_ids: Sequence[int],
        joint_from_motor: np.ndarray,
        *,
        offset: np.ndarray | None = None,
        rotor_inertia: np.ndarray | None = None,
        faults: Sequence[Fault] = (),
        step: float = 5e-4,
    ):
        self.step = step
        self.n_joints, self.n_motors = joint_from_motor.shape
        self._E = np.array(joint_from_motor, float)
        self._offset = np.zeros(self.n_joints) if offset is None else np.array(offset, float)
        self._model, self._ids = pin.Model(model), list(joint_ids)
        if any(self._model.joints[i].nv != 1 or self._model.joints[i].nq != 1 for i in self._ids):
            raise InputError("the pinocchio plant needs joints of one coordinate each", source=manipulator.urdf)
        self._rows = np.array([self._model.joints[i].idx_v for i in self._ids])
        self._rotor = np.zeros(self.n_motors) if rotor_inertia is None else np.array(rotor_inertia, float)
        rest = [f for f in faults if not self._takes(f, manipulator) and f.effect not in LOGGED]
        if any(f.effect in ("cable_elasticity", "transmission_ratio_error") for f in rest):
            raise InputError("the pinocchio plant has rigid, exact cables; use the mujoco plant", place="effects")
        self._data = self._model.createData()
        self._side = SideForces(manipulator, rest, self.n_joints, self.n_motors)
        self.tension: np.ndarray | None = None  # its cables are not modelled
        self.reset(self._offset, np.zeros(self.n_joints))
        self._side.ease(self._E, np.linalg.inv(self._inertia(self._q_m)[0]), step)

    def _takes(self, fault: Fault, manipulator: Manipulator) -> bool:
        """Build a fault into the robot, if it is one of the body."""
        p, i = fault.parameters, fault.location.get("index", 1) - 1
        if fault.effect == "rotor_inertia":
            self._rotor[i] += p["inertia"]
        elif fault.effect == "base_tilt":
            turn = pin.exp3(np.array([0.0, 0.0, -p["angle"]]))
            self._model.gravity.linear = turn @ self._model.gravity.linear
        elif fault.effect == "payload":
            end = [manipulator.links[i].length, 0.0, 0.0] if manipulator.links else [0.0, 0.0, 0.0]
            place = np.array(p.get("center_of_mass", end))
            self._model.inertias[self._ids[i]] += pin.Inertia(p["mass"], place, np.zeros((3, 3)))
        else:
            return False
        return True

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        """Start at joint positions `q` and velocities `v` (n_joints,), as near as the motors can come."""
        back = np.linalg.pinv(self._E)
        self._time, self._q_m, self._v_m = 0.0, back @ (q - self._offset), back @ v
        self._side.reset()

    @property
    def joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Joint positions and velocities now, each (n_joints,)."""
        return self._E @ self._q_m + self._offset, self._E @ self._v_m

    @property
    def motors(self) -> tuple[np.ndarray, np.ndarray]:
        """Motor positions and velocities now, each (n_motors,)."""
        return self._q_m, self._v_m

    def acceleration(self, q_m: np.ndarray, v_m: np.ndarray, tau_m: np.ndarray, f_joint: np.ndarray) -> np.ndarray:
        """Give the motors' acceleration (n_motors,) under motor torques `tau_m` and joint losses `f_joint`."""
        inertia, q = self._inertia(q_m)
        v = np.zeros(self._model.nv)
        v[self._rows] = self._E @ v_m
        h = pin.nonLinearEffects(self._model, self._data, q, v)[self._rows]
        return np.linalg.solve(inertia, tau_m - self._E.T @ (h + f_joint))

    def _inertia(self, q_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inertia that the motors feel (n_motors, n_motors) and Pinocchio's configuration there."""
        q = np.zeros(self._model.nq)
        q[self._rows] = self._E @ q_m + self._offset
        M = pin.crba(self._model, self._data, q)[np.ix_(self._rows, self._rows)]
        return self._E.T @ M @ self._E + np.diag(self._rotor), q

    def advance(self, tau_m: np.ndarray, *, note: bool = True) -> None:
        """Make one step under the motor torques `tau_m` (n_motors,) [N m], held over it; there are no tensions to note.

        Raises
        ------
        SimulationError
            If the integration breaks down.
        """
        f_joint, f_motor = np.zeros(self.n_joints), np.zeros(self.n_motors)
        if self._side.any:
            f_joint, f_motor = self._side(self._time, self.step, *self.joints, self._q_m, self._v_m, np.asarray(tau_m))
        push, h = tau_m - f_motor, self.step
        x, v = self._q_m, self._v_m
        a1 = self.acceleration(x, v, push, f_joint)
        a2 = self.acceleration(x + 0.5 * h * v, v + 0.5 * h * a1, push, f_joint)
        a3 = self.acceleration(x + 0.5 * h * v + 0.25 * h * h * a1, v + 0.5 * h * a2, push, f_joint)
        a4 = self.acceleration(x + h * v + 0.5 * h * h * a2, v + h * a3, push, f_joint)
        self._q_m = x + h * v + h * h / 6.0 * (a1 + a2 + a3)
        self._v_m = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        self._time += h
        if not (np.isfinite(self._v_m).all() and np.abs(self._v_m).max() < 1e4):
            raise SimulationError(f"the simulation diverged at {self._time:.3f} s")
