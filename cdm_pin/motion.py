"""What an effect may look at: one recorded motion, with the torques that the rigid body asks for on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numba
import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from scipy.fft import dst, idst
from scipy.signal import find_peaks, welch
from scipy.signal.windows import tukey

from .cables import hinge_reaction
from .dynamics import inverse_dynamics, joint_wrenches
from .geometry import Vector
from .model import CableModel

if TYPE_CHECKING:
    from .swing import Swing

MUCH = 2e7
"""Numbers that derivatives by all coordinates may take."""
ON_SIDE, CLEAR_SIDES, TIGHT_SIDES = 3.0, 8.0, 0.35
"""Least torque on a side of a play, in widths; least play, in errors of the travel; most spread of a side, in plays."""
ARRIVED, FLIGHT = 0.9, 0.5
"""Share of a play after which a side is reached, and how long that may take [s]."""
SLOW_ROTORS = 4.0
"""Up to which frequency rotors' accelerations are taken from torques that tell where the joints are [Hz]."""
MANY_LEAPS = 300
"""More changes of side than these are not looked at one by one."""
LEAP = 0.05
"""Time before and after a leap of a position in which all else of it is smooth [s]."""
LEAPS = 15.0
"""How many times its usual size a leap has to be."""
FEW_LEAPS, ALIKE = 4, 0.8
"""How many leaps say where a torque's zero is at least, and which share of them has to be as those of a play."""
FELT = 5.0
"""Up to which frequency torques tell on which side of its play a cable is [Hz]."""
CLEAR = 10.0
"""Power over that of the positions' noise from which a torque is known at a frequency."""
WINDOW, RAMP, SLOWEST = 8.0, 0.25, 1.0
"""Over what a torque's power is taken, how long its ends fade [s], and up to where it is always known [Hz]."""


@dataclass(frozen=True)
class Felt:
    """What motors tell of joints that have no encoders.

    Attributes
    ----------
    torque, position : ndarray, shape (n, n_motors)
        As logged, on the uniform grid [N m], [rad].
    cutoffs : tuple of float
        Of the filters that gave positions and velocities, and accelerations [Hz].
    valid : ndarray of bool, shape (n,)
        Samples away from gaps and ends.
    rate : float
        Samples per second.
    """

    torque: Vector
    position: Vector
    cutoffs: tuple[float, float]
    valid: np.ndarray
    rate: float

    @cached_property
    def _leaps(self) -> list[tuple[np.ndarray, Vector]]:
        """The leaps of each motor away from gaps and ends."""
        every = [leaps(x, self.rate) for x in self.position.T]
        return [(at[self.valid[at]], up[self.valid[at]]) for at, up in every]

    def zero(self, i: int, load: Vector) -> float:
        """Give what a load of cable i (n,) seems to be where the cable changes sides: what its zero is off by.

        It does where its motor leaps, and then from the side on which it lay to the other. Nothing where there are few
        leaps, or such as no play makes.
        """
        (at, up), half = self._leaps[i], max(round(0.5 * LEAP * self.rate), 1)
        if len(at) < FEW_LEAPS:
            return 0.0
        rising = np.sign(load[at + half] - load[at - half]) == np.sign(up)
        sizes = np.abs(up) / np.median(np.abs(up))
        if np.mean(rising) < ALIKE or np.mean(np.abs(sizes - 1.0) < 0.5) < ALIKE:
            return 0.0
        there = float(np.median(load[at]))
        spread = float(np.median(np.abs(load[at] - there)))
        return there if abs(there) > 3.0 * spread else 0.0


def leaps(position: Vector, rate: float) -> tuple[np.ndarray, Vector]:
    """Find the samples at which a position leaps beside a cubic polynomial, and half of by how much.

    Parameters
    ----------
    position : ndarray, shape (n,)
        [rad].
    rate : float
        [Hz].

    Returns
    -------
    at : ndarray of int, shape (k,)
        A few tenths of a second from the ends at least.
    up : ndarray, shape (k,)
        [rad].
    """
    half = max(round(LEAP * rate), 6)
    if len(position) < 6 * half:
        return np.zeros(0, int), np.zeros(0)
    t = (np.arange(2 * half) - half + 0.5) / half
    smooth = np.linalg.qr(np.stack([t**0, t, t**2, t**3], axis=1))[0]
    side = np.sign(t) - smooth @ (smooth.T @ np.sign(t))
    around = np.lib.stride_tricks.sliding_window_view(position, 2 * half)
    rest = around - (around @ smooth) @ smooth.T
    up = rest @ side / (side @ side)
    share = up**2 * (side @ side) / np.maximum(np.einsum("ij,ij->i", rest, rest), 1e-300)
    size = np.abs(up) * (share > 0.7)
    peaks = find_peaks(size, height=LEAPS * float(np.median(np.abs(up))), distance=half)[0]
    peaks = peaks[(peaks > 2 * half) & (peaks < len(up) - 2 * half)]
    return peaks + half, up[peaks]


def leaping(torque: Vector, position: Vector, width: float, rate: float, near: float = 0.1) -> Vector:
    """Give on which side of its play a cable lies, tanh(torque / width), in time with how its motor's position leaps.

    The torque may be wrong by what it does not know of rotors and friction, and so be early or late. At every change of
    its sign the position tells by how much: that at which the side, beside a cubic polynomial, explains it best.

    Parameters
    ----------
    torque, position : ndarray, shape (n,)
        [N m], [rad].
    width : float
        [N m].
    rate : float
        [Hz].
    near : float
        How early or late it may be [s].

    Returns
    -------
    ndarray, shape (n,)
    """
    step = max(1, round(rate / 250.0))  # of samples that are compared
    reach = step * max(int(near * rate / step), 2)
    crossings = np.flatnonzero(np.diff(np.sign(torque)))
    crossings = crossings[(crossings >= 3 * reach) & (crossings < len(torque) - 3 * reach)]
    shifts, share = _shifts(np.tanh(torque / width), position, crossings, reach, step)
    sure = share > 0.8
    if not sure.any():
        return np.tanh(torque / width)
    t = np.arange(len(torque), dtype=float)
    side = np.tanh(np.interp(t - np.interp(t, crossings[sure], shifts[sure]), t, torque) / width)
    if sure.sum() > MANY_LEAPS:
        return side
    return _leapt(side, position, np.round(crossings[sure] + shifts[sure]).astype(int), rate)


def crossing(torque: Vector, travel: Vector, width: float, error: float, rate: float) -> Vector | None:
    """Give on which side of its play a cable lies, and where between, -1 to 1, as encoders on both sides say.

    The links are free in between: the torque says which side they leave, and which they go to, the travel how far they
    are.

    Parameters
    ----------
    torque, travel : ndarray, shape (n,)
        Of the cable on its link [N m], and of its motor beyond what its joints say [rad].
    width : float
        Torque within which the play may be crossed [N m].
    error : float
        Standard deviation of the travel's error [rad].
    rate : float
        [Hz].

    Returns
    -------
    ndarray or None, shape (n,)
        None unless the sides are much farther apart than the travel is wrong by, and little but a spring moves it else.
    """
    on = np.where(np.abs(torque) > ON_SIDE * width, np.sign(torque), 0.0)
    if min(np.sum(on > 0.0), np.sum(on < 0.0)) < max(2.0 * LEAP * rate, 8.0):
        return None
    least = [np.median(np.abs(torque[on == way])) for way in (1.0, -1.0)]  # by half of the time it has arrived
    sure = np.abs(torque) >= np.where(on > 0.0, *least)
    X = np.stack([np.ones(len(torque)), on, torque], axis=1)
    beta = np.linalg.lstsq(X[sure & (on != 0.0)], travel[sure & (on != 0.0)], rcond=None)[0]
    half, rest = float(beta[1]), travel - X @ beta
    spread = max(float(np.median(np.abs(rest[sure & (on == way)]))) for way in (1.0, -1.0))
    if half <= CLEAR_SIDES * error or spread > TIGHT_SIDES * half:
        return None
    part = np.clip((rest + half * on) / half, -1.0, 1.0)
    there = part * on > ARRIVED
    free = on == 0.0
    for start in np.flatnonzero((on[1:] != 0.0) & (on[1:] != on[:-1])) + 1:  # it may not have arrived there
        stop = start + int(FLIGHT * rate)
        reached = np.flatnonzero(there[start:stop] | (on[start:stop] != on[start]))
        free[start : start + reached[0] if len(reached) else stop] = True
    return np.where(free, part, np.sign(torque))


def _leapt(side: Vector, position: Vector, crossings: np.ndarray, rate: float) -> Vector:
    """Give the side while it changes as the position says: how far it is between cubic polynomials a step apart."""
    flank, most = max(round(0.05 * rate), 6), max(round(0.08 * rate), 8)
    out, between = side.copy(), np.abs(side) < 0.99
    for k in crossings:
        if k < most + flank + 2 or k >= len(side) - most - flank - 2:
            continue
        low, high = k, k + 1
        while k - low < most and between[low - 1]:
            low -= 1
        while high - k < most and between[high]:
            high += 1
        low, high = low - 2, high + 2
        part = np.arange(low - flank, high + flank)
        if k - low >= most or high - k >= most:
            continue
        t = (part - k) / flank
        X = np.stack([t**0, t, t**2, t**3, np.sign(side[part])], axis=1)
        known = (part < low) | (part >= high)
        if not np.all(np.sign(side[part[:flank]]) == -np.sign(side[part[-1]])):
            continue
        beta = np.linalg.lstsq(X[known], position[part[known]], rcond=None)[0]
        if beta[4] > 0.0:
            out[low:high] = np.clip((position[part] - X[:, :4] @ beta[:4]) / beta[4], -1.5, 1.5)[~known]
    return out


@numba.njit(cache=True)
def _shifts(side, position, crossings, reach, step):
    """Find by how many samples each change of side has to move, and which share of what a cubic leaves it explains."""
    half = 2 * reach
    n = 2 * half // step + 1
    basis = np.empty((4, n))
    for d in range(4):
        for k in range(n):
            basis[d, k] = ((k * step - half) / half) ** d
        for e in range(d):
            basis[d] -= (basis[e] @ basis[d]) * basis[e]
        basis[d] /= np.sqrt(basis[d] @ basis[d])
    shifts, share = np.zeros(len(crossings)), np.zeros(len(crossings))
    for m in range(len(crossings)):
        k = crossings[m]
        x = position[k - half : k + half + 1 : step].copy()
        for d in range(4):
            x -= (basis[d] @ x) * basis[d]
        whole, found = max(x @ x, 1e-300), np.zeros(2 * reach // step + 1)
        for s in range(len(found)):
            j = s * step - reach
            y = side[k - half - j : k + half + 1 - j : step].copy()
            for d in range(4):
                y -= (basis[d] @ y) * basis[d]
            own, along = y @ y, x @ y
            if own > 1e-12 and along > 0.0:
                found[s] = along**2 / own / whole
        best = np.argmax(found)
        shifts[m], share[m] = best * step - reach, found[best]
        if 0 < best < len(found) - 1:
            bend = 2.0 * found[best] - found[best - 1] - found[best + 1]
            if bend > 0.0:
                shifts[m] += 0.5 * step * (found[best + 1] - found[best - 1]) / bend
    return shifts, share


@dataclass(frozen=True)
class Motion:
    """One motion on a uniform grid, joints in the order of the rows of E.

    Attributes
    ----------
    model : CableModel
        Its inertial parameters are the current estimate.
    time : ndarray, shape (n,)
        Since the start of the recording [s].
    q, v, a : ndarray, shape (n, n_joints)
        Joint motion; it drives the rigid body [rad or m, s].
    q_m, v_m, a_m : ndarray, shape (n, n_motors)
        Motor motion; it drives rotors and motor friction.
    joints_measured, motors_measured : bool
        Which side was logged; the other one follows from E.
    velocity_noise : ndarray, shape (n_motors,)
        Standard deviation of `v_m` [rad/s].
    pretension : float or None
        Of this recording [N].
    index : int
        Which recording it is.
    inertia_noise : ndarray, shape (n_motors,), optional
        Noise of positions, as if white, times the inertia that each motor feels; none if not given [N m s^2].
    torque_measured : bool
        Whether the motors' torques were logged.
    position_errors : tuple of ndarray, shapes (n_joints,) and (n_motors,), optional
        Standard deviation of what encoders' steps make of `q` and `q_m`, or their noise; zero on a side that follows
        from the other, none if not given [rad].
    bearings : CableModel, optional
        With the masses that load the hinges, where these are told from others than the model's.
    extra_joint, extra_motor : ndarray, optional
        Torques beside the rigid body's, at the joints, shape (n, n_joints), and at the motors, shape (n, n_motors)
        [N m].
    offset : ndarray, shape (n_joints,), optional
        Known offsets of the joints' encoders [rad].
    tilt : tuple of float, optional
        Known tilt of the base, about the axes that `base_tilt` has [rad].
    extra_driven : ndarray, shape (n, n_motors), optional
        What known offsets, tilts and shifts change of the torque that the motors' cables carry [N m].
    extra_logged : ndarray, shape (n, n_motors), optional
        What effects bring before the logger that follow the torques of others, or move joints from where they seem
        [N m].
    gains : ndarray, shape (n_motors,) or float
        Known gains of the torques' logger.
    shift : ndarray, shape (n, n_joints), optional
        How far known errors of the cable map move the joints from where the motors say they are [rad].
    stretch : ndarray, shape (n, n_motors), optional
        How far soft cables and errors of the cable map, as known, turn the motors, in `q_m`, from where the joints say
        they are [rad].
    map_errors : tuple of (int, int, ndarray, shape (n,))
        Known errors of the cable map: cable, joint, and how much more the cable runs per angle of that joint.
    springs : tuple of (ndarray, shape (n_joints,), ndarray, shape (k,))
        Known springs: coordinate, and coefficients of powers of it that make the torque, the lowest first.
    drags : tuple of (ndarray, shape (n_joints,), float, float)
        Known drag: coordinate, and coefficients of the speed along it and of that times its magnitude.
    motor_drags : tuple of (ndarray, shape (n_motors,), float, float)
        The same along coordinates of the motors.
    felt : Felt, optional
        What the motors alone tell of where the joints are, where no encoder does.
    swing : Swing, optional
        How the links swing on a soft cable, where that is in the motion.
    """

    model: CableModel
    time: Vector
    q: Vector
    v: Vector
    a: Vector
    q_m: Vector
    v_m: Vector
    a_m: Vector
    joints_measured: bool
    motors_measured: bool
    velocity_noise: Vector
    pretension: float | None = None
    index: int = 0
    inertia_noise: Vector | None = None
    torque_measured: bool = True
    position_errors: tuple[Vector, Vector] | None = None
    bearings: CableModel | None = None
    extra_joint: Vector | None = None
    extra_motor: Vector | None = None
    offset: Vector | None = None
    tilt: tuple[float, ...] | None = None
    extra_driven: Vector | None = None
    extra_logged: Vector | None = None
    gains: Vector | float = 1.0
    shift: Vector | None = None
    stretch: Vector | None = None
    map_errors: tuple[tuple[int, int, Vector], ...] = ()
    springs: tuple[tuple[Vector, Vector], ...] = ()
    drags: tuple[tuple[Vector, float, float], ...] = ()
    motor_drags: tuple[tuple[Vector, float, float], ...] = ()
    felt: Felt | None = None
    swing: Swing | None = None

    def position_error(self, A: Vector, B: Vector) -> float:
        """Give the standard deviation, at most, of what encoders make of a coordinate A q + B q_m [rad]."""
        if self.position_errors is None:
            return 0.0
        joints, motors = self.position_errors
        if not motors.any():
            A, B = A + B @ self.model.motor_from_joint, np.zeros_like(B)
        elif not joints.any():
            A, B = np.zeros_like(A), A @ self.model.joint_from_motor + B
        return float(np.abs(A) @ joints + np.abs(B) @ motors)

    @property
    def joints_alone(self) -> bool:
        """Whether nothing but the joints' encoders says where the motors are."""
        return self.joints_measured and not self.motors_measured

    @property
    def n(self) -> int:
        """Number of samples."""
        return len(self.time)

    @property
    def rate(self) -> float:
        """Samples per second."""
        return float((self.n - 1) / (self.time[-1] - self.time[0]))

    @cached_property
    def tau(self) -> Vector:
        """Rigid-body joint torques, shape (n, n_joints) [N m]."""
        return inverse_dynamics(self.model, self.q, self.v, self.a)

    @cached_property
    def tau_m(self) -> Vector:
        """Rigid-body torques at the motors, E' tau, shape (n, n_motors) [N m]."""
        return self.tau @ self.model.joint_from_motor

    @cached_property
    def hinge_force(self) -> Vector:
        """Magnitude of the force that each hinge carries, shape (n, n_joints) [N]."""
        model = self.bearings or self.model
        if model.planar and model.manipulator.pulleys is not None:
            return np.linalg.norm(hinge_reaction(model, self.q, self.v, self.a, self.pretension), axis=-1)
        return self.link_force

    @cached_property
    def link_force(self) -> Vector:
        """Magnitude of the force between a link and the one before, without that of cables, shape (n, n_joints) [N]."""
        return np.linalg.norm(joint_wrenches(self.bearings or self.model, self.q, self.v, self.a)[..., :3], axis=-1)

    @cached_property
    def driven_torque(self) -> Vector:
        """Torque that the motors' cables carry, E' (tau and what rubs at the joints), shape (n, n_motors) [N m]."""
        return self.tau_m if self.extra_joint is None else self.tau_m + self.extra_joint @ self.model.joint_from_motor

    @cached_property
    def logged_torque(self) -> Vector:
        """Torque of the motors before the logger, shape (n, n_motors) [N m]."""
        torque = self.driven_torque + self.a_m * self.model.rotor_inertia
        torque = torque if self.extra_motor is None else torque + self.extra_motor
        return torque if self.extra_logged is None else torque + self.extra_logged

    @cached_property
    def cable_torque(self) -> Vector:
        """Torque that cable i puts on link i, shape (n, n_motors) [N m]."""
        driven = self.driven_torque if self.extra_driven is None else self.driven_torque + self.extra_driven
        torque = driven / self.model.arm_scale
        for _ in range(4 if self.map_errors else 0):  # what a cable carries more changes what it takes from the others
            changed = driven.copy()
            for i, k, slope in self.map_errors:
                changed -= (torque[:, i] * slope)[:, None] * self.model.joint_from_motor[k]
            torque = changed / self.model.arm_scale
        return torque

    @cached_property
    def felt_load(self) -> Vector:
        """Slow part of the torque that cable i puts on link i, as measured, shape (n, n_motors) [N m]."""
        from .signals_filters import lowpass

        assert self.felt is not None
        rotors = lowpass(self.a_m, self.rate, SLOW_ROTORS) * self.model.rotor_inertia
        torque = lowpass(self.felt.torque, self.rate, FELT) - rotors
        return (torque if self.extra_motor is None else torque - self.extra_motor) / self.model.arm_scale

    @cached_property
    def played_load(self) -> Vector:
        """Torque of each cable on its link that says on which side of a play it lies, shape (n, n_motors) [N m].

        `felt_load`, less what a sensor's zero is off by, where leaps of the motors tell it.
        """
        assert self.felt is not None
        load = self.felt_load
        return load - np.array([self.felt.zero(i, x) for i, x in enumerate(load.T)])

    def changes_sides(self, i: int) -> bool:
        """Whether cable i pulls both ways, or may for all that is known: else its play would be an encoder's offset."""
        return self.felt is None or bool(np.ptp(np.sign(self.played_load[self.felt.valid, i])) > 0)

    def felt_side(self, i: int, width: float) -> tuple[Vector, Vector, Vector]:
        """Give on which side of its play cable i lies, -1 to 1, and the rates, by torque and positions of the motors.

        The torque's sign says the side and roughly when it changes; at which sample, the leap of the motor's position.

        Parameters
        ----------
        i : int
        width : float
            Torque at the joint within which the play is crossed [N m].

        Returns
        -------
        tuple of ndarray, shape (n,)
            Filtered as the positions were.
        """
        from .signals_filters import lowpass

        assert self.felt is not None
        side = leaping(self.played_load[:, i], self.felt.position[:, i], width, self.rate)
        x, slow = (lowpass(side, self.rate, cutoff) for cutoff in self.felt.cutoffs)
        return x, derivatives(x, self.rate)[0], derivatives(slow, self.rate)[1]

    def crossed_side(self, i: int, width: float) -> Vector | None:
        """Give on which side of its play cable i lies, shape (n,), where encoders on both sides say it; else None.

        Parameters
        ----------
        i : int
        width : float
            Torque at the joint within which the play may be crossed [N m].
        """
        if not (self.joints_measured and self.motors_measured):
            return None
        scale, back = self.model.arm_scale[i], self.model.motor_from_joint[i]
        travel = (self.q_m[:, i] - self.q @ back) * scale
        error = scale * self.position_error(back, np.eye(self.model.n_motors)[i])
        return crossing(self.cable_torque[:, i], travel, width, error, self.rate)

    @cached_property
    def joint_angles(self) -> Vector:
        """Where the joints are by all that is known, shape (n, n_joints) [rad]."""
        q = self.q if self.offset is None else self.q - self.offset
        return q if self.shift is None else q + self.shift

    @cached_property
    def joint_speeds(self) -> Vector:
        """How fast the joints turn by all that is known, shape (n, n_joints) [rad/s]."""
        return self.v if self.shift is None else self.v + derivatives(self.shift, self.rate)[0]

    @cached_property
    def motor_speeds(self) -> Vector:
        """How fast the motors turn by what the joints say, or as measured, shape (n, n_motors) [rad/s]."""
        return self.v_m if self.stretch is None else self.v_m - derivatives(self.stretch, self.rate)[0]

    @cached_property
    def midway(self) -> Motion:
        """The motion halfway between where the motors say that the joints are and where they are (`shift`)."""
        if self.shift is None:
            return self
        d1, d2 = derivatives(self.shift, self.rate)
        return replace(self, q=self.q + 0.5 * self.shift, v=self.v + 0.5 * d1, a=self.a + 0.5 * d2, shift=None)

    @cached_property
    def clear_torque(self) -> Vector:
        """`cable_torque` at those frequencies at which it is known, shape (n, n_motors) [N m]."""
        return self._clear(self.cable_torque, 1.0 / self.model.arm_scale)

    @cached_property
    def clear_logged_torque(self) -> Vector:
        """`logged_torque` at those frequencies at which it is known, shape (n, n_motors) [N m].

        Noise of positions is in what accelerations bring, not in what rubs.
        """
        rubs = 0.0 if self.extra_joint is None else self.extra_joint @ self.model.joint_from_motor
        rubs = rubs if self.extra_motor is None else rubs + self.extra_motor
        return self._clear(self.logged_torque - rubs, np.ones(self.model.n_motors)) + rubs

    def _clear(self, torque: Vector, scale: Vector) -> Vector:
        """Give torques (n, n_motors) at those frequencies at which they are known; `scale` is theirs to the motors'.

        Elsewhere they are mostly the positions' noise, which the residual holds too and would seem to follow from it.
        """
        if self.inertia_noise is None:
            return torque
        from .band import ONE_SIDED
        from .signals_filters import lowpass

        ends = min(ONE_SIDED, self.n // 2)
        torque = torque[np.clip(np.arange(self.n), ends, self.n - 1 - ends)]  # accelerations there are wild
        slow, ramp = lowpass(torque, self.rate, SLOWEST), min(2.0 * RAMP * self.rate / self.n, 1.0)
        sines = np.asarray(dst(((torque - slow) * tukey(self.n, ramp)[:, None])[1:-1], type=1, axis=0))
        window = min(self.n, round(WINDOW * self.rate))  # medians: accelerations beside gaps are wild, too
        lines, power = welch(torque, self.rate, nperseg=window, average="median", axis=0)
        noise = (self.inertia_noise * scale * (2 * np.pi * lines[:, None]) ** 2) ** 2 / (0.5 * self.rate)
        known = power > CLEAR * noise
        f = np.arange(1, self.n - 1) * self.rate / (2 * (self.n - 1))
        sines *= known[np.rint(f * window / self.rate).astype(int)]
        return slow + np.pad(np.asarray(idst(sines, type=1, axis=0)), ((1, 1), (0, 0)))

    def part(self, part: slice) -> Motion:
        """Give some samples of the motion alone."""
        arrays = {name: getattr(self, name)[part] for name in ("time", "q", "v", "a", "q_m", "v_m", "a_m")}
        felt = self.felt
        if felt is not None:
            felt = replace(felt, torque=felt.torque[part], position=felt.position[part], valid=felt.valid[part])
        return replace(self, **arrays, felt=felt)

    @property
    def moved(self) -> Vector | None:
        """How far known effects move the side that was not measured, joints or motors; None if none do [rad]."""
        return self.stretch if self.shift is None else self.shift

    def stretched(self, travel: Vector | None) -> Motion:
        """Give the motion with motors turned by `travel` (n, n_motors) from where the joints say that they are."""
        if self.stretch is None and travel is None:
            return self
        old, new = (np.zeros_like(self.q_m) if x is None else x for x in (self.stretch, travel))
        change = new - old
        speeds = self.v_m + derivatives(change, self.rate)[0]
        return replace(self, q_m=self.q_m + change, v_m=speeds, stretch=travel)

    def with_model(self, model: CableModel, bearings: CableModel | None = None) -> Motion:
        """Give the same motion of a robot with other inertial parameters."""
        return replace(self, model=model, bearings=bearings)

    @cached_property
    def torque_slopes(self) -> Vector:
        r"""Derivatives of the motors' torque, :math:`E' \partial \tau` by :math:`q`, :math:`\dot q`, :math:`\ddot q`.

        Central differences; those by rates and accelerations, a quadratic and a linear function, are exact.

        Returns
        -------
        ndarray, shape (3, n_joints, n, n_motors)
        """
        out = np.empty((3, self.model.n_joints, self.n, self.model.n_motors))
        for k, h in enumerate((1e-4, 1.0, 1.0)):
            for j, step in enumerate(h * np.eye(self.model.n_joints)):
                sides = []
                for s in (step, -step):
                    moved = [x + s if i == k else x for i, x in enumerate((self.q, self.v, self.a))]
                    sides.append(inverse_dynamics(self.model, *moved))
                out[k, j] = (sides[0] - sides[1]) @ self.model.joint_from_motor / (2 * h)
        return out

    def torque_change(self, d: Vector, rates: tuple[Vector, Vector] | None = None) -> Vector:
        r"""Differentiate the motors' torque, of rigid body, known springs and drag, along a change of joint positions.

        :math:`E'((\partial_q \tau + K)\, d + (\partial_v \tau + D)\, \dot d + \partial_a \tau\, \ddot d)`.

        Parameters
        ----------
        d : ndarray, shape (n, n_joints)
            Change of joint positions per unit of the effect [rad].
        rates : pair of ndarray, optional
            Its first and second time derivative; differentiated numerically if not given.

        Returns
        -------
        ndarray, shape (n, n_motors)
            [N m per unit of the effect].
        """
        d1, d2 = rates if rates is not None else derivatives(d, self.rate)
        known = self.spring_torque(d) + self.drag_change(d1)
        if 3 * self.model.n_joints * self.n * self.model.n_motors < MUCH:
            change = np.zeros((self.n, self.model.n_motors))
            for slopes, x in zip(self.torque_slopes, (d, d1, d2), strict=True):
                for slope, column in zip(slopes, x.T, strict=True):
                    change += slope * column[:, None]
            return change + known
        return self.torque_along(d, (d1, d2)) + known

    def spring_torque(self, d: Vector | None = None) -> Vector:
        """Give the motors' torque of known springs, or its derivative along a change `d` of positions (n, n_joints)."""
        out = np.zeros_like(self.q)
        for A, powers in self.springs:
            x = self.q @ A
            out += (polyval(x, powers) if d is None else polyval(x, polyder(powers)) * (d @ A))[:, None] * A
        return out @ self.model.joint_from_motor

    def drag_change(self, rate: Vector) -> Vector:
        """Differentiate the motors' torque of known drag along a change of joint speeds (n, n_joints)."""
        out = np.zeros_like(self.q)
        for A, linear, quadratic in self.drags:
            out += ((linear + 2.0 * quadratic * np.abs(self.v @ A)) * (rate @ A))[:, None] * A
        return out @ self.model.joint_from_motor

    def motor_drag_change(self, rate: Vector) -> Vector:
        """Differentiate the motors' torque of their known drag along a change of their speeds, both (n, n_motors).

        Halfway to what known effects make of the speeds, where the change is exact for those.
        """
        speeds, out = 0.5 * (self.v_m + self.motor_speeds), np.zeros_like(self.q_m)
        for B, linear, quadratic in self.motor_drags:
            out += ((linear + 2.0 * quadratic * np.abs(speeds @ B)) * (rate @ B))[:, None] * B
        return out

    def torque_along(self, d: Vector, rates: tuple[Vector, Vector]) -> Vector:
        """Differentiate the rigid body's torque by a central difference along this one direction: less work there."""
        d1, d2 = rates
        h = 1e-4 / max(float(np.abs(d).max()), 1e-12)
        plus = inverse_dynamics(self.model, self.q + h * d, self.v + h * d1, self.a + h * d2)
        minus = inverse_dynamics(self.model, self.q - h * d, self.v - h * d1, self.a - h * d2)
        return (plus - minus) @ self.model.joint_from_motor / (2 * h)


def derivatives(d: Vector, rate: float) -> tuple[Vector, Vector]:
    """Give the first and second derivative of samples at an even rate."""
    from .signals_filters import differentiate

    first = differentiate(d, rate)
    return first, differentiate(first, rate)
