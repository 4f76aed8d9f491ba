"""The space an excitation is searched in: vectors to Fourier series, series to motions at the edge of the limits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .dynamics import motor_torques
from .fourier import FourierSeries, PeriodGrid, close
from .geometry import Vector
from .limits import InfeasibleLimits, Limits, check_posture, scale_to_edge
from .model import CableModel
from .objectives import Objective

PENALTY = 1e6
"""What the paper's objective adds for a candidate that breaks a limit."""


@dataclass(frozen=True)
class SearchSpace:
    """Candidates x = (base frequency, centres, cosine and sine coefficients joint by joint) and what they mean.

    The series live in the joints' coordinates, or in the motors' where there are fewer of them.

    Attributes
    ----------
    model : CableModel
    limits : Limits
    harmonics : int
        Free ones.
    zero_start : bool
        Whether eq. (47) appends a harmonic and forbids centres.
    frequency : pair of float
        Lowest and highest base frequency [rad/s].
    amplitude : float
        Bound of each coefficient, a_max and b_max of eq. (48).
    grid : PeriodGrid
        Where candidates are judged.
    """

    model: CableModel
    limits: Limits
    harmonics: int
    zero_start: bool
    frequency: tuple[float, float]
    amplitude: float
    grid: PeriodGrid

    @cached_property
    def coordinates(self) -> Vector:
        """Joint motion per coordinate, shape (n_joints, n): the identity, or E if it has more rows than columns."""
        model = self.model
        return np.eye(model.n_joints) if model.n_joints == model.n_motors else model.joint_from_motor

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self.coordinates.shape[1]

    @property
    def free_center(self) -> bool:
        """Whether the centre of the motion is searched too."""
        return not self.zero_start and self.n == self.model.n_joints

    @cached_property
    def middle(self) -> Vector:
        """Joint positions about which candidates move, or may be centred, shape (n_joints,).

        Raises
        ------
        InputError
            If the limits do not contain it.
        """
        low, high = self.limits.position.T
        if self.zero_start:
            middle = np.zeros(len(low)) if self.n == len(low) else np.array(self.model.offset)
        else:
            middle = np.where(np.isfinite(low + high), 0.5 * (low + high), 0.0)
            if self.n != len(low):
                middle = self.model.joint_position(self.model.motor_position(middle))
        outside = np.flatnonzero((middle <= low) | (middle >= high))
        if len(outside):
            i = outside[0]
            hint = "; a motion that starts at zero needs limits on both sides of it" if self.zero_start else ""
            raise InfeasibleLimits(
                f"infeasible limits: joint {i + 1} would move about {middle[i]:.4g}, outside "
                f"[{low[i]:.4g}, {high[i]:.4g}]{hint}"
            )
        return middle

    def check(self) -> None:
        """Refuse limits that leave no motion.

        Raises
        ------
        InputError
            If they do not contain the middle of the motion, or standing still there takes too much torque.
        """
        middle = self.middle
        if not self.free_center:
            check_posture(self.model, self.limits, middle)

    @property
    def box(self) -> tuple[Vector, Vector]:
        """Lower and upper bounds of the candidates, each of shape (d,)."""
        centers = np.ones(self.n if self.free_center else 0)
        coefficients = np.full(2 * self.n * self.harmonics, self.amplitude)
        upper = np.concatenate([[self.frequency[1]], centers, coefficients])
        return np.concatenate([[self.frequency[0]], -upper[1:]]), upper

    @cached_property
    def reach(self) -> Vector:
        """How far a centre may lie from the middle, shape (n_joints,) [rad or m]."""
        half = 0.5 * np.ptp(self.limits.position, axis=1)
        return 0.9 * np.where(np.isfinite(half), half, np.pi)

    def decode(self, X: Vector) -> tuple[Vector, Vector, Vector, Vector]:
        """Give base frequency (m,), centre (m, n_joints), cosine and sine (m, n, harmonics) of candidates (m, d)."""
        first = 1 + (self.n if self.free_center else 0)
        center = np.broadcast_to(self.middle, (len(X), len(self.middle)))
        if self.free_center:
            center = center + self.reach * X[:, 1:first]
        coefficients = X[:, first:].reshape(len(X), self.n, 2, self.harmonics)
        if self.zero_start:
            coefficients = close(coefficients)
        return X[:, 0], center, coefficients[:, :, 0], coefficients[:, :, 1]

    def at_edge(self, X: Vector) -> tuple[Vector, Vector, tuple[Vector, Vector, Vector]]:
        """Scale candidates to the edge of the limits: centre, factors (m, n), and motion (m, n, samples) before it."""
        w, center, cosine, sine = self.decode(X)
        motion = self.grid(w, cosine, sine)
        stride = max(1, self.grid.samples // (8 * self.grid.harmonics))
        factor = scale_to_edge(
            self.model, self.limits, center, *motion, coordinates=self.coordinates, torque_stride=stride
        )
        return center, factor, motion

    def rescaled(self, X: Vector) -> Vector:
        """Give the candidates whose coefficients lie at the edge of the limits, shape (m, d)."""
        _, factor, _ = self.at_edge(X)
        result = X.copy()
        first = X.shape[1] - 2 * self.n * self.harmonics
        result[:, first:] *= np.repeat(factor, 2 * self.harmonics, axis=1)
        return result

    def joint_motion(self, center: Vector, dq: Vector, v: Vector, a: Vector) -> tuple[Vector, Vector, Vector]:
        """Turn motions (m, n, samples) of the coordinates into q, v, a of shape (m, samples, n_joints)."""
        if self.n != self.model.n_joints:
            dq, v, a = (self.coordinates @ x for x in (dq, v, a))
        q, v, a = (np.ascontiguousarray(np.swapaxes(x, 1, 2)) for x in (dq, v, a))
        return q + center[:, None], v, a

    def motion(self, X: Vector) -> tuple[Vector, Vector, Vector]:
        """Give q, v, a of candidates as they are, each of shape (m, samples, n_joints)."""
        w, center, cosine, sine = self.decode(X)
        return self.joint_motion(center, *self.grid(w, cosine, sine))

    def scaled(self, score: Objective):
        """Make the function that judges candidates at the edge of the limits."""

        def evaluate(X: Vector) -> Vector:
            center, factor, motion = self.at_edge(X)
            return score(*self.joint_motion(center, *(factor[..., None] * x for x in motion)))

        return evaluate

    def penalised(self, score: Objective):
        """Make the function that adds a constant to candidates that break a limit, eqs (46), (49), as printed."""

        def evaluate(X: Vector) -> Vector:
            center, factor, motion = self.at_edge(X)
            _, _, cosine, sine = self.decode(X)
            sums = np.abs(np.stack([cosine, sine])[..., : self.harmonics].sum(axis=-1)).max(axis=(0, 2))
            broken = (factor.min(axis=1) < 1.0) | (sums > self.amplitude)
            return score(*self.joint_motion(center, *motion)) + PENALTY * broken

        return evaluate

    def natural(self, x: Vector) -> Vector:
        """Give the size that each entry of a candidate has within the limits, shape (d,)."""
        kw = x[0] * np.arange(1, self.harmonics + 1)
        to_coordinate = np.abs(np.linalg.pinv(self.coordinates))
        limits = self.limits
        position, velocity, acceleration = (
            to_coordinate @ np.where(np.isfinite(limit), limit, 1e3)
            for limit in (0.5 * np.ptp(limits.position, axis=1), limits.velocity, limits.acceleration)
        )
        size = np.minimum.reduce(
            [np.repeat(position[:, None], len(kw), axis=1), velocity[:, None] / kw, acceleration[:, None] / kw**2]
        )
        centers = np.full(self.n if self.free_center else 0, 0.5)
        return np.concatenate([[0.3 * x[0]], centers, np.repeat(size, 2, axis=0).ravel()])

    def linear_limits(self, x: Vector, steps: Vector) -> tuple[Vector, Vector]:
        """Linearise the limits about a candidate: ``A @ d <= b`` for a change ``steps * d`` of it.

        Limits of position, velocity and acceleration are linear in all but the base frequency. Only those of which more
        than half is used are listed.

        Parameters
        ----------
        x, steps : ndarray, shape (d,)

        Returns
        -------
        A : ndarray, shape (n_rows, d)
        b : ndarray, shape (n_rows,)
        """
        stack, inverse, limits = np.vstack([x, np.diag(steps)]), self.model.motor_from_joint, self.limits
        stack[1:, 0] = x[0]
        q, v, a = self.motion(stack)
        q[1:] -= self.middle
        v[1], a[1] = v[0] * steps[0] / x[0], 2 * a[0] * steps[0] / x[0]
        q[1] = 0.0
        half, middle = 0.5 * np.ptp(limits.position, axis=1), limits.position.mean(axis=1)
        pairs = [(q, half, middle), (v, limits.velocity, 0.0), (a, limits.acceleration, 0.0)]
        pairs += [(v @ inverse.T, limits.motor_velocity, 0.0), (a @ inverse.T, limits.motor_acceleration, 0.0)]
        if np.isfinite(limits.motor_torque).any():
            pairs.append((self._torques(x, steps), limits.motor_torque, 0.0))
        rows, bounds = [], []
        for change, limit, zero in pairs:
            value = change[0] - zero
            for sign in (1.0, -1.0):
                sample, joint = np.nonzero(np.isfinite(limit) & (sign * value > 0.5 * limit))
                rows.append(sign * change[1:, sample, joint].T)
                bounds.append(limit[joint] - sign * value[sample, joint])
        return np.vstack(rows), np.concatenate(bounds)

    def _torques(self, x: Vector, steps: Vector) -> Vector:
        """Motor torques and their derivatives per step, shape (1 + d, some samples, n_motors)."""
        h = 1e-5
        stack = np.vstack([x, x + h * np.diag(steps)])
        stride = max(1, self.grid.samples // (8 * self.grid.harmonics))
        motion = [y[:, ::stride] for y in self.motion(stack)]
        tau_m = motor_torques(self.model, *(y.reshape(-1, y.shape[-1]) for y in motion))
        tau_m = tau_m.reshape(len(stack), -1, tau_m.shape[-1])
        tau_m[1:] = (tau_m[1:] - tau_m[0]) / h
        return tau_m

    def series(self, x: Vector) -> FourierSeries:
        """Scale a candidate to the edge on a fine grid, with a bound on what lies between its samples.

        Raises
        ------
        InputError
            If standing still at its centre takes more torque than allowed.
        """
        w, center, cosine, sine = self.decode(x[None])
        check_posture(self.model, self.limits, center[0])
        grid = PeriodGrid(max(4096, 256 * self.grid.harmonics), self.grid.harmonics)
        motion = (y * grid.overshoot for y in grid(w, cosine, sine))
        factor = scale_to_edge(self.model, self.limits, center, *motion, coordinates=self.coordinates)
        J = self.coordinates * factor[0] * (1 - 1e-9)
        return FourierSeries(float(w[0]), center[0], J @ cosine[0], J @ sine[0])
