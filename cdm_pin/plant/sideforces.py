"""Laws that a physics engine does not carry, evaluated at every step of a simulation and applied as torques."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import InputError
from ..geometry import Manipulator
from .compile import compile_laws
from .faults import Fault
from .laws import DRY, N_STATES, WIDTH, advance_laws, apply_laws
from .planar import Arm

LOGGED = ("time_delay", "torque_gain_error", "torque_offset", "encoder_offset")  # of the sensors, not of the machine
NOT_APPLIED = ("backlash", "cable_slack", "pulley_eccentricity", "transmission_coupling", "load_dependent_friction")


class SideForces:
    """Torques of laws along joint and motor coordinates, with their internal states.

    Parameters
    ----------
    manipulator : Manipulator
        For the pulleys and the pretension, where it has any.
    faults : sequence of Fault
        Those that are laws; `LOGGED` ones are passed over.
    joints, motors : int
        How many of each.

    Raises
    ------
    InputError
        If a fault cannot be applied as a torque.
    """

    def __init__(self, manipulator: Manipulator, faults: Sequence[Fault], joints: int, motors: int):
        pulleys = manipulator.pulleys
        for fault in faults:
            on_cable = fault.location["kind"] == "cable" and pulleys is None
            if fault.effect in NOT_APPLIED or on_cable or fault.form == "tension":
                raise InputError(f"this plant cannot simulate {fault.effect} at {fault.location}", place="effects")
        ratio = float(pulleys.motor_pulley_radius[0] / pulleys.joint_pulley_radius[0]) if pulleys else 1.0
        none, radius = np.zeros(joints), float(pulleys.joint_pulley_radius[0]) if pulleys else 1.0
        angle = float(pulleys.wrap_half_angle[0]) if pulleys else 1.0
        tension = float(manipulator.pretension or 0.0)
        self._arm = Arm(none, none, none, none, none, np.zeros(2), np.zeros(motors), ratio, radius, angle, tension)
        self._laws = compile_laws(faults, ratio, joints, motors)
        self._none = none
        self.reset()

    @property
    def any(self) -> bool:
        """Whether there is anything to apply."""
        return self._laws.kind.size > 0

    def ease(self, joint_from_motor: np.ndarray, mobility: np.ndarray, step: float) -> None:
        """Widen the smooth sign of dry friction where steps of `step` [s] could not follow it.

        Parameters
        ----------
        joint_from_motor : ndarray, shape (n_joints, n_motors)
        mobility : ndarray, shape (n_motors, n_motors)
            Inverse inertia the motors feel [1/(kg m^2)].
        step : float
            [s].
        """
        along = self._laws.A @ joint_from_motor + self._laws.B
        for kind, g, p in zip(self._laws.kind, along, self._laws.parameters, strict=True):
            if kind in DRY:
                p[WIDTH] = max(p[WIDTH], DRY[kind](p) * (g @ mobility @ g) * step / 0.7)

    def reset(self) -> None:
        """Forget all internal states."""
        joints, motors = self._laws.A.shape[1], self._laws.B.shape[1]
        self._states = np.zeros((self._laws.kind.size, N_STATES))
        self._before: tuple[np.ndarray, np.ndarray] | None = None
        self._f_joint, self._f_motor = np.zeros(joints), np.zeros(motors)

    def __call__(
        self, t: float, step: float, q: np.ndarray, v: np.ndarray, q_m: np.ndarray, v_m: np.ndarray, tau_m: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Give the torques that oppose the motion at joints and motors [N m] at time `t`, a `step` after the last call.

        Loads are those of the motor torques `tau_m` (n_motors,): a cable's is ``tau_m r_j / r_m``, a joint's the sum of
        those of the cables from it on.
        """
        if self._before is not None:
            v0, v_m0 = self._before
            advance_laws(self._laws, self._states, 0.5 * (v + v0), 0.5 * (v_m + v_m0), np.zeros(v_m.size), step)
        self._before = v.copy(), v_m.copy()
        cable = tau_m / self._arm.ratio
        joint = np.cumsum(cable[::-1])[::-1].copy() if cable.size == v.size else self._none
        apply_laws(
            self._laws, self._states, self._arm, t, q, v, q_m, v_m, joint, tau_m, cable, self._none, self._f_joint,
            self._f_motor,
        )  # fmt: skip
        return self._f_joint, self._f_motor
