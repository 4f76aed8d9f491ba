"""What sensors bring by themselves: noise and steps of torque, and of positions through accelerations and inertia."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import welch
from scipy.stats import chi2

from .band import Band, light
from .dynamics import inverse_dynamics
from .geometry import Vector
from .measured import both_positions, measured_torques
from .model import CableModel
from .signals import Signals
from .signals_filters import differentiate, lowpass, noise_floor, stretches, window_length

BEYOND = 4.0
"""How many times the band's frequencies are too quick for what the motion brings, but for moments."""
DRAWS = 32
"""Times that what rounding leaves is drawn."""
SMOOTH = 1.0
"""Frequency up to which positions are taken to round them once more [Hz]: beyond it they hold the first rounding."""


@dataclass(frozen=True)
class SensorNoise:
    """Noise that the sensors of some recordings bring into a band.

    Attributes
    ----------
    model : CableModel
        With the inertial parameters of the file: those that are fitted to noisy accelerations come out too small.
    signals : tuple of Signals
        One per recording.
    band : Band
    """

    model: CableModel
    signals: tuple[Signals, ...]
    band: Band

    @cached_property
    def torque(self) -> Vector:
        """Of torque, its own above the band, as if white, and that of positions, shape (n_motors,) [N m].

        That of positions goes through the inertia; as if white or from rounding this motion, whichever is more.
        """
        parts = []
        for signals, rounding in zip(self.signals, self._roundings, strict=True):
            quickest = min(self.band.cutoff, self.band.slow)
            share = np.sqrt(min(1.0, 2 * quickest / signals.rate))
            white = inertia_noise(self.model, signals) * share * (2 * np.pi * quickest) ** 2 / np.sqrt(5)
            steps = _torque_steps(self.model, signals)
            own = noise_floor(measured_torques(self.model, signals.logged), signals.rate, self.band.cutoff, steps)
            parts.append(np.hypot(own, np.maximum(white, rounding)))
        return np.max(parts, axis=0)

    @cached_property
    def sampled(self) -> Vector:
        """Of single samples of torque, what most of them have far above the band, shape (n_motors,) [N m]."""
        parts = [np.zeros((1, self.model.n_motors))]
        for signals in self.signals:
            tau = measured_torques(self.model, signals.logged)
            if len(tau) >= 64:
                quick = tau - lowpass(tau, signals.rate, min(BEYOND * self.band.cutoff, 0.25 * signals.rate))
                parts.append(quick[signals.valid])
        return 1.4826 * np.median(np.abs(np.concatenate(parts)), axis=0)

    @cached_property
    def travel(self) -> Vector:
        """Of the travel between the encoders of both sides, as if they rounded down, shape (n_motors,) [rad].

        An encoder that rounds down is wrong by half a step, at any frequency.
        """
        return np.max([travel_noise(self.model, s) for s in self.signals], axis=0) * self.model.arm_scale * np.sqrt(3.0)

    @cached_property
    def resting(self) -> list[Vector]:
        """Draws of what rounding leaves in the travels where encoders rest or turn (`resting_errors`), in the band.

        Per recording, shape (`DRAWS`, n_motors, n_reduced) [rad].
        """
        rng, scale = np.random.default_rng(0), self.model.arm_scale
        return [
            np.stack([self.band.reduce((resting_errors(self.model, s, rng) * scale).T) for _ in range(DRAWS)])
            for s in self.signals
        ]

    @property
    def rounding(self) -> Vector:
        """Torque that steps of encoders bring through the inertia, shape (n_motors,) [N m]."""
        return np.max(self._roundings, axis=0)

    @cached_property
    def _roundings(self) -> list[Vector]:
        return [_rounding(self.model, signals, self.band) for signals in self.signals]

    @cached_property
    def trusted(self) -> float:
        """Frequency up to which torque is noisier than positions are through the inertia [Hz]; beyond, they are alike.

        Columns with accelerations and the residual then share the noise of the encoders.
        """
        limit, band = float(np.median([inertia_limit(self.model, s) for s in self.signals])), self.band
        slow_enough = band.slow**2.5 <= limit**2 * np.sqrt(band.cutoff)  # noise of accelerations below that of torque
        return band.cutoff if slow_enough else min(band.cutoff, limit)

    @cached_property
    def joint_steps(self) -> Vector:
        """Steps of the joints' positions as logged, or as they follow from the motors', shape (n_joints,) [rad]."""
        return np.max([_joint_steps(self.model, signals) for signals in self.signals], axis=0)

    @cached_property
    def torque_steps(self) -> Vector:
        """Steps in which torque was logged, as the motors see them, shape (n_motors,) [N m]; zero where there are none.

        What is logged may be wrong by half of one for as long as the torque hardly changes.
        """
        return np.max([_torque_steps(self.model, signals) for signals in self.signals], axis=0)

    @cached_property
    def torque_stairs(self) -> Vector:
        """Amplitude of the stairs that steps of torque leave, shape (n_motors,) [N m].

        Noise smooths them: a reading that is rounded is off by a series of sines of what is read, the first of which
        keeps ``exp(-2 (pi noise / step)^2)`` of its amplitude, ``step / pi``, on average over Gaussian noise (Widrow,
        Kollar, Quantization Noise, 2008, ch. 5). What is left looks like physics that depends on the load.
        """
        return np.max([_torque_stairs(self.model, signals) for signals in self.signals], axis=0)


def inertia_limit(model: CableModel, signals: Signals) -> float:
    """Give the frequency [Hz] above which the noise of positions, through the inertia, exceeds that of torque."""
    tau = noise_floor(measured_torques(model, signals.logged), signals.rate, steps=_torque_steps(model, signals))
    moved = inertia_noise(model, signals)
    felt = moved > 0.0  # by a motor that moves no inertia nothing is told
    ratio = np.median(tau[felt] / moved[felt]) if felt.any() else np.inf
    return float(0.8 * np.sqrt(ratio) / (2 * np.pi))


def motion_limit(model: CableModel, signals: Signals, most: float, chance: float = 1e-7) -> float:
    """Give the frequency [Hz] up to which accelerations stand out of what the noise of positions makes, at any joint.

    Slow motions are rounded alike for long, so that lines stand out of the noise that are none of the motion: rounding
    is made once more.

    Parameters
    ----------
    model : CableModel
    signals : Signals
    most : float
        Frequencies above it are not looked at [Hz].
    chance : float
        With which half a hertz, or a single line, of noise alone would be taken for motion; they also have to have
        twice, and eight times, the power of the noise.
    """
    start, stop = max(stretches(signals.valid), key=lambda s: s[1] - s[0], default=(0, 0))
    if stop - start < 64:
        return np.inf
    q = both_positions(model, signals.logged)[0][start:stop]
    smooth = lowpass(q, signals.rate, SMOOTH)
    n = window_length(len(q) - 2, 16.0 * signals.rate)
    f, power = welch(np.diff(q, 2, axis=0), signals.rate, nperseg=n, axis=0)
    rounding = _rounded(model, signals, smooth) - smooth
    steps = welch(np.diff(rounding, 2, axis=0), signals.rate, nperseg=n, axis=0)[1]
    gain = (2.0 - 2.0 * np.cos(2.0 * np.pi * f / signals.rate)) ** 2
    noise = np.maximum(gain[:, None] * position_noise(model, signals) ** 2 / (0.5 * signals.rate), steps)
    width = max(int(0.5 * n / signals.rate), 1)  # half a hertz
    free = 2.0 * (1.0 + 0.95 * (len(q) / n - 1.0))  # degrees of freedom of a line, Hann's windows overlapping by half
    many = free * max(width / 1.5, 1.0)
    least, line = max(2.0, chi2.isf(chance, many) / many), max(8.0, chi2.isf(chance, free) / free)
    heard = uniform_filter1d(power, width, axis=0) > least * uniform_filter1d(noise, width, axis=0)
    heard = (heard | (power > line * noise)).any(axis=1) & (f <= most)
    return float(f[np.flatnonzero(heard)].max(initial=0.0))


def inertia_noise(model: CableModel, signals: Signals) -> Vector:
    """Noise of positions times the inertia that each motor feels, shape (n_motors,) [N m s^2]."""
    q, _ = both_positions(model, signals.logged)
    noise = position_noise(model, signals)
    return np.abs(model.joint_from_motor.T @ _mass(model, q) * noise) @ (np.ptp(q, axis=0) > 1e-6)


def position_noise(model: CableModel, signals: Signals) -> Vector:
    """Noise of the joints' positions, also where they follow from the motors', shape (n_joints,) [rad].

    With what they are displaced by at instants that are not sure.
    """
    q, steps = both_positions(model, signals.logged)[0], _joint_steps(model, signals)
    own = np.maximum(noise_floor(q, signals.rate, steps=steps), 1e-9)
    return np.hypot(own, signals.unsure * speeds(q, signals.rate)) if signals.unsure else own


def speeds(q: Vector, rate: float) -> Vector:
    """Root mean square of the velocities of positions, shape (n, n_joints), without what is quick: (n_joints,)."""
    return np.sqrt(np.mean(differentiate(lowpass(q, rate, 0.05 * rate), rate) ** 2, axis=0))


def _joint_steps(model: CableModel, signals: Signals) -> Vector:
    steps = signals.steps
    if "joint_position" in steps:
        return steps["joint_position"]
    return np.sqrt(model.joint_from_motor**2 @ steps["motor_position"] ** 2)


def travel_noise(model: CableModel, signals: Signals) -> Vector:
    """Noise of the travel from that of the encoders on both sides, shape (n_motors,) [rad]."""
    own, other = signals.noise["motor_position"], signals.noise["joint_position"]
    return np.sqrt(own**2 + model.motor_from_joint**2 @ other**2)


def _rounded(model: CableModel, signals: Signals, q: Vector) -> Vector:
    """Round positions of the joints, shape (n, n_joints), as the encoders of a recording do."""
    measured = "joint_position" if "joint_position" in signals.logged else "motor_position"
    x = q if measured == "joint_position" else model.motor_position(q)
    steps = signals.steps[measured]
    own = np.where(steps > 0, steps, 1.0)
    error = (np.round(x / own) * own - x) * (steps > 0)
    return q + (error if measured == "joint_position" else error @ model.joint_from_motor.T)


def resting_errors(model: CableModel, signals: Signals, rng: np.random.Generator) -> Vector:
    """Draw what rounding may leave in the travel where readings do not change or turn, shape (n, n_motors) [rad].

    An encoder at rest is off by the same for as long as it rests, somewhere in its step; one that passes through a step
    is not on the whole.
    """

    def off(side: str) -> Vector:
        readings = zip(signals.logged[side].T, signals.steps[side], strict=True)
        return np.stack([_at_rest(x, step, rng) for x, step in readings], axis=1)

    return off("motor_position") - off("joint_position") @ model.motor_from_joint.T


def _at_rest(x: Vector, step: float, rng: np.random.Generator) -> Vector:
    """Draw by how much one encoder's readings may be off where it rests or turns, shape (n,)."""
    if step <= 0.0:
        return np.zeros(len(x))
    counts = np.round((x - np.median(x)) / step)  # readings brought to other instants lie between two
    starts = np.flatnonzero(np.r_[True, np.diff(counts) != 0.0])
    stops, change = np.r_[starts[1:], len(x)], np.diff(counts[starts])
    length, before, after = stops - starts, np.r_[0.0, change], np.r_[change, 0.0]
    nearby = np.maximum(np.r_[0, length[:-1]], np.r_[length[1:], 0])
    rests = (before * after <= 0.0) | (length > 3 * nearby)
    off = np.where(rests, rng.uniform(-0.5, 0.5, len(starts)), 0.0) * step
    inner = np.maximum(length - 1, 0) * rests / 2.0  # all of a rest is off alike, of a passage its middle by nothing
    middle = 0.5 * (starts + stops - 1)
    knots, values = np.stack([middle - inner, middle + inner], axis=1).ravel(), np.repeat(off, 2)
    return np.interp(np.arange(len(x)), knots, values)


def _rounding(model: CableModel, signals: Signals, band: Band) -> Vector:
    """Torque that rounding of positions brings, through accelerations and poses, shape (n_motors,) [N m].

    Slow motions are rounded alike for long: such errors are no white noise, and more of them lies in the band. They are
    made once more by rounding the motion as far as it is known.
    """
    rate = signals.rate
    smooth = lowpass(both_positions(model, signals.logged)[0], rate, min(band.cutoff, band.slow))
    error = _rounded(model, signals, smooth) - smooth
    cutoffs = light(band.cutoff, rate), min(light(band.cutoff, rate), band.slow)  # of poses, of accelerations

    def torque(error: Vector) -> Vector:
        q, slow = (smooth + lowpass(error, rate, cutoff) for cutoff in cutoffs)
        v, a = differentiate(q, rate), differentiate(differentiate(slow, rate), rate)
        return inverse_dynamics(model, q, v, a) @ model.joint_from_motor

    reduced = band.reduce((torque(error) - torque(np.zeros_like(error))).T)
    inside = [reduced[:, start:stop] for start, stop in band.segments(signals.valid)]
    return np.sqrt(np.mean(np.concatenate(inside, axis=1) ** 2, axis=1)) if inside else np.zeros(model.n_motors)


def _torque_steps(model: CableModel, signals: Signals) -> Vector:
    steps = signals.steps
    if "motor_torque" in steps:
        return steps["motor_torque"]
    return np.abs(model.joint_from_motor.T) @ steps.get("joint_torque", np.zeros(model.n_joints))


def _torque_stairs(model: CableModel, signals: Signals) -> Vector:
    steps = _torque_steps(model, signals)
    own = noise_floor(measured_torques(model, signals.logged), signals.rate, steps=steps)
    noise = np.sqrt(np.maximum(own**2 - steps**2 / 12.0, 0.0))  # without what rounding adds
    smoothed = np.divide(np.pi * noise, steps, out=np.zeros_like(steps), where=steps > 0.0)
    return steps / np.pi * np.exp(-2.0 * smoothed**2)


def _mass(model: CableModel, q: Vector) -> Vector:
    """Mass matrix at the median of the positions, shape (n_joints, n_joints) [kg m^2]."""
    pose = np.repeat(np.median(q, axis=0)[None], model.n_joints + 1, axis=0)
    a = np.vstack([np.zeros(model.n_joints), np.eye(model.n_joints)])
    tau = inverse_dynamics(model, pose, np.zeros_like(pose), a)
    return (tau[1:] - tau[0]).T
