r"""An oracle that knows every fault's law and place and the noise, but not the masses: what could be seen at best.

The signature of a fault is what the log would lose without it: the motor torques that the arm with all faults and the
arm without this one need for the same logged motion, :math:`s = y(\text{all}) - y(\text{all but this})`, whitened with
the generator's own noise and made orthogonal to the whitened columns of every rigid body (3 per link, in closed form)
and of the drift. Its length is the visibility; 3.86 is 90 % power at 1 % false alarms. Where both positions are logged,
the motors' angles beyond the nominal map, in units of the two encoders' rounding, are a second, kinematic part of it.
Where within a step an encoder reads, and how far it lags behind where it turns, is as unknown as its rounding is large.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from .absolute import motor_torques
from .catalogue import CATALOGUE, draw_fault
from .compile import compile_laws
from .faults import Fault
from .paths import joints_from_motors, stretched
from .planar import Arm, rigid_columns
from .run import altered
from .sensing import Motion, Noise, Sensors, drift_basis, encoder_offsets, interpolate, relative, torque_as_logged

SURE = 3.86  # visibility that a matched filter sees in 90 % of cases at 1 % false alarms
_KINEMATIC = (
    "transmission_ratio_error", "pulley_eccentricity", "encoder_offset", "cable_elasticity", "cable_slack", "backlash",
)  # fmt: skip
_NUDGE = 1e-4  # of a parameter, for derivatives
_DRAWS, _SMALLEST = 5, 0.03  # of a rival's shapes; share of the largest below which a direction of theirs is left out


@dataclass(frozen=True)
class Scene:
    """What happened in one recording and how it was logged.

    Parameters
    ----------
    arm : Arm
        The true arm without its faults.
    faults : tuple of Fault
    motion : Motion
        With all faults.
    sensors, noise
        How it was logged.
    t : ndarray, shape (m,)
        Sampling instants [s].
    scale : float
        The arm's largest static torque [N m].
    """

    arm: Arm
    faults: tuple[Fault, ...]
    motion: Motion
    sensors: Sensors
    noise: Noise
    t: np.ndarray
    scale: float


class Oracle:
    """Signatures of faults along one recording.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene):
        self.scene = scene
        theta = relative(scene.motion.q_m * scene.arm.ratio)
        if scene.sensors.positions != "motor":
            theta = relative(scene.motion.phi) + encoder_offsets(scene.faults, theta.shape[1])
        self._logged = theta  # joint angles (N, n) as read off the log by the nominal map, rounding left out
        self._ways = np.sign(interpolate(relative(scene.motion.w), scene.motion.step, scene.t)).T
        self._rigid = self._rigid_basis()
        self._without: tuple[np.ndarray, np.ndarray] | None = None

    def visibility(self, index: int) -> dict[str, float]:
        """Give torque, kinematic and total visibility of a fault, and the share of its torque that no mass absorbs."""
        faults = self.scene.faults
        others = tuple(f for k, f in enumerate(faults) if k != index)
        happened = faults[index].effect in _KINEMATIC
        everything = self._actual() if happened else self._predicted(faults)
        torque, gap = self._difference(everything, self._predicted(others) if others else self._alone())
        seen = torque - self._rigid @ (self._rigid.T @ torque)
        lengths = [float(np.linalg.norm(part)) for part in (torque, seen, gap)]
        return {
            "torque": lengths[1],
            "kinematic": lengths[2],
            "visibility": float(np.hypot(lengths[1], lengths[2])),
            "fraction": lengths[1] / lengths[0] if lengths[0] > 1e-9 else 0.0,
        }

    def signature(self, fault: Fault, others: Sequence[Fault] | None = None) -> np.ndarray:
        """Give the signature of a fault beside `others` (default: the scene's), in units of the noise.

        Shape (m n,), or (2 m n,) where both positions are logged.
        """
        beside = tuple(self.scene.faults if others is None else others)
        without = self._predicted(beside) if beside else self._alone()
        torque, gap = self._difference(self._predicted((*beside, fault)), without)
        return np.concatenate([torque - self._rigid @ (self._rigid.T @ torque), gap])

    def bounds(self) -> list[dict[str, float]]:
        """Give the Cramer-Rao bound of every numeric parameter of every fault, by name.

        The least standard deviation of an unbiased estimate from this recording where laws, places, noise and motion
        are known, but neither the masses nor the other faults' parameters.
        """
        names, slopes = [], []
        for k, fault in enumerate(self.scene.faults):
            for name, value in fault.parameters.items():
                if not isinstance(value, int | float) or value == 0.0:
                    continue
                h = _NUDGE * abs(value)
                ends = [self._predicted(self._nudged(k, name, value + d)) for d in (h, -h)]
                torque, gap = self._difference(*ends)
                slope = np.concatenate([torque - self._rigid @ (self._rigid.T @ torque), gap]) / (2.0 * h)
                if np.linalg.norm(slope) > 0.0:
                    names.append((k, name))
                    slopes.append(slope)
        bounds: list[dict[str, float]] = [{} for _ in self.scene.faults]
        if slopes:
            J = np.column_stack(slopes)
            size = np.linalg.norm(J, axis=0)
            std = np.sqrt(np.diag(np.linalg.pinv((J / size).T @ (J / size), rcond=1e-12))) / size
            for (k, name), s in zip(names, std, strict=True):
                bounds[k][name] = float(s)
        return bounds

    def _nudged(self, index: int, name: str, value: float) -> list[Fault]:
        faults = list(self.scene.faults)
        faults[index] = replace(faults[index], parameters=faults[index].parameters | {name: value})
        return faults

    def likeness(self, index: int, rival: Mapping[str, Any], seed: int = 0) -> float:
        """Tell how much of a fault's signature a rival could make: their canonical correlation, 0 to 1.

        Parameters
        ----------
        index : int
            Which of the scene's faults.
        rival : mapping
            "effect" and "location". Its parameters are free: a few draws of them span what it can look like. Zero for
            a place that its law does not have.
        seed : int
            Of those draws.
        """
        if rival["effect"] not in CATALOGUE:
            return 0.0
        scene, rng = self.scene, np.random.default_rng(seed)
        others = [f for k, f in enumerate(scene.faults) if k != index]
        own = self.signature(scene.faults[index], others)
        shapes = []
        place = dict(rival["location"])
        if rival["effect"] == "transmission_ratio_error":
            place = {"kind": "cable", "joint": place["index"]} | place
        for _ in range(_DRAWS):
            fault = draw_fault(rival["effect"], rng, max(2, scene.arm.length.size), scale=scene.scale)
            while fault.form == "tension" and place["kind"] != "cable":  # memory in the tension of no cable
                fault = draw_fault(rival["effect"], rng, max(2, scene.arm.length.size), scale=scene.scale)
            placed = replace(fault, location=place, width=scene.faults[index].width)
            try:
                shape = self.signature(placed, others)
            except (KeyError, IndexError):  # the law does not have this place
                return 0.0
            shapes.append(shape / max(float(np.linalg.norm(shape)), 1e-6))
        U, size, _ = np.linalg.svd(np.column_stack(shapes), full_matrices=False)
        U = U[:, size > _SMALLEST * max(size[0], 1e-300)]
        return float(np.linalg.norm(U.T @ own) / max(float(np.linalg.norm(own)), 1e-300))

    def _alone(self) -> tuple[np.ndarray, np.ndarray]:
        """Predict the log of the arm with no fault, once."""
        if self._without is None:
            self._without = self._predicted(())
        return self._without

    def _predicted(self, faults: Sequence[Fault]) -> tuple[np.ndarray, np.ndarray]:
        """Give motor torques, and motor angles beyond the nominal map, each (m, n), that `faults` make of the log."""
        scene = self.scene
        motion, n = scene.motion, scene.arm.length.size
        true, cables = altered(scene.arm, faults)
        if scene.sensors.positions == "motor":
            theta = joints_from_motors(cables, scene.arm.ratio, motion.q_m)
            phi = np.cumsum(theta, axis=1)
            if not any(f.effect in _KINEMATIC for f in (*faults, *scene.faults)):
                w, a = motion.w, motion.a
            else:
                w = np.gradient(phi, motion.step, axis=0)
                a = np.gradient(w, motion.step, axis=0)
        else:
            theta = self._logged - encoder_offsets(faults, n)
            phi, w, a = np.cumsum(theta, axis=1), motion.w, motion.a
        endless = np.full(n, np.inf)
        rigid = cables._replace(stiffness=endless, slack=endless, half_gap=np.zeros(n))
        laws = compile_laws(faults, true.ratio, n)
        tau_m, _, C = motor_torques(true, laws, rigid, phi, w, a, motion.step)
        bend = cables.eccentricity * (np.sin(theta + cables.phase) - np.sin(cables.phase))
        path = theta @ np.tril(1.0 + cables.ratio_error).T + bend + stretched(cables, C, motion.step)
        gap = path - np.cumsum(self._logged, axis=1)
        return torque_as_logged(faults, tau_m, motion.step, scene.t), interpolate(gap, motion.step, scene.t)

    def _actual(self) -> tuple[np.ndarray, np.ndarray]:
        """Give what happened, as `_predicted` does."""
        scene = self.scene
        gap = scene.motion.q_m * scene.arm.ratio - np.cumsum(self._logged, axis=1)
        tau_m = torque_as_logged(scene.faults, scene.motion.tau_m, scene.motion.step, scene.t)
        return tau_m, interpolate(gap, scene.motion.step, scene.t)

    def _difference(self, one, other) -> tuple[np.ndarray, np.ndarray]:
        """Take the difference of two predictions in units of the noise, flattened; kinematic only if both sides log."""
        scene = self.scene
        torque = _whiten(one[0] - other[0], scene.noise)
        if scene.sensors.positions != "both":
            return torque, np.zeros(0)
        n, ratio = one[1].shape[1], scene.arm.ratio
        tick = 2.0 * np.pi / 2**scene.sensors.bits / np.sqrt(12.0)
        spread = tick * np.sqrt(ratio**2 + np.arange(1, n + 1))
        gap = (one[1] - other[1]) / spread
        return torque, np.column_stack([_beyond_steps(x, w) for x, w in zip(gap.T, self._ways, strict=True)]).ravel()

    def _rigid_basis(self) -> np.ndarray:
        """Orthonormal basis of the whitened rigid-body (and drift) columns along the logged motion."""
        scene = self.scene
        motion, t, n = scene.motion, scene.t, scene.arm.length.size
        phi = np.cumsum(self._logged, axis=1)
        w, a = motion.w, motion.a
        if scene.sensors.positions == "motor":
            w = np.gradient(phi, motion.step, axis=0)
            a = np.gradient(w, motion.step, axis=0)
        at = [interpolate(x, motion.step, t) for x in (phi, w, a)]
        columns = rigid_columns(scene.arm.length, scene.arm.gravity, *at)
        if scene.noise.drift:
            slow = np.einsum("td,ij->tijd", drift_basis(t), np.eye(n)).reshape(len(t), n, -1)
            columns = np.concatenate([columns, slow], axis=2)
        W = _whiten(columns, scene.noise)
        Q, R = np.linalg.qr(W / (np.linalg.norm(W, axis=0) + 1e-300))
        U, size, _ = np.linalg.svd(R)
        return Q @ U[:, size > 1e-9 * size[0]]


def _beyond_steps(gap: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Whiten a gap (m,) in units of the rounding, of which a mean and what turns with the speed are as unknown."""
    U, size, _ = np.linalg.svd(np.column_stack([np.ones(len(way)), way]), full_matrices=False)
    return gap - U @ ((1.0 - 1.0 / np.sqrt(1.0 + size**2)) * (U.T @ gap))


def _whiten(y: np.ndarray, noise: Noise) -> np.ndarray:
    """Whiten (m, n, ...) samples by the noise's own AR(1) filter and spread; flattened (m * n, ...)."""
    r = noise.correlation
    shape = (-1,) + (1,) * (y.ndim - 2)
    e = lfilter([1.0, -r], [1.0], y, axis=0) / np.sqrt(1.0 - r * r)
    e[0] = y[0]
    return (e / noise.std.reshape(shape)).reshape(y.shape[0] * y.shape[1], *y.shape[2:])
