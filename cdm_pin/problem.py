"""Recordings and a model as one linear problem in a band: data, columns of the rigid body and of effects."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.signal import firwin, kaiserord, upfirdn

from .effects import Candidate, Columns, loaded
from .geometry import Vector
from .inertia_band import inertia_cutoff
from .model import CableModel
from .motion import Motion
from .recording import Recording
from .regressor import motor_regressor
from .signals import Signals, prepare
from .signals_filters import differentiate, lowpass, noise_floor, quantisation_step
from .whitening import Lines, Segments

MUCH = 4e8
"""Numbers that the whitened columns of all effects may take."""


@dataclass(frozen=True)
class Band:
    """Zero-phase low-pass and decimation: the one filter of both sides of the equation.

    Attributes
    ----------
    rate : float
        Of what comes in [Hz].
    cutoff : float
        [Hz].
    step : int
        Every which sample is kept.
    taps : ndarray, shape (2 half + 1,)
        Symmetric kernel; half is a multiple of `step`.
    """

    rate: float
    cutoff: float
    step: int
    taps: Vector

    def reduce(self, x: Vector) -> Vector:
        """Filter and decimate along the last axis, (..., n) -> (..., ceil(n / step)); `segments` cuts the ends."""
        half = len(self.taps) // 2
        y = upfirdn(self.taps, x, 1, self.step, axis=-1)
        first = half // self.step
        return y[..., first : first + -(-x.shape[-1] // self.step)]

    def segments(self, valid: np.ndarray) -> list[tuple[int, int]]:
        """Stretches of decimated samples whose whole kernel lies on valid samples."""
        half = len(self.taps) // 2
        bad = np.concatenate([[True], ~valid, [True]])
        edges = np.flatnonzero(bad)
        stretches = []
        for left, right in itertools.pairwise(edges):
            start = -(-(left + half) // self.step)  # valid samples are left .. right - 2
            stop = (right - 2 - half) // self.step + 1
            if stop - start > 8:
                stretches.append((start, stop))
        return stretches


def make_band(rate: float, cutoff: float) -> Band:
    """Design the common filter: flat to `cutoff`, decimated so that little lies above it."""
    step = max(1, int(rate / (2.6 * cutoff)))
    if step == 1 and cutoff >= 0.38 * rate:
        return Band(rate, 0.5 * rate, 1, np.ones(1))
    nyquist = 0.5 * rate / step
    width = max(2 * (nyquist - cutoff), 0.3 * cutoff)
    length, beta = kaiserord(50.0, min(width / (0.5 * rate), 0.99))
    half = -(-(length // 2) // step) * step
    corner = min(cutoff + 0.5 * width, 0.49 * rate)
    ideal = firwin(2 * half + 1, corner, window="boxcar", fs=rate, scale=False)
    taps = np.asarray(ideal, float) * np.kaiser(2 * half + 1, float(beta))
    return Band(rate, cutoff, step, taps / taps.sum())


@dataclass(frozen=True)
class Run:
    """One recording made ready.

    Attributes
    ----------
    signals : Signals
    motion : Motion
        Lightly filtered, at the full rate.
    data : ndarray, shape (n_channels, n)
        Motor torques, then the travel that the kinematic model leaves over; not filtered.
    """

    signals: Signals
    motion: Motion
    data: Vector

    @property
    def payload(self) -> float:
        """Mass that the recording says was held [kg]."""
        return self.signals.recording.payload or 0.0

    @property
    def name(self) -> str:
        """Name of the recording."""
        return self.signals.recording.name


@dataclass(frozen=True)
class Problem:
    """What is measured and what the rigid body explains, through one band.

    Attributes
    ----------
    model : CableModel
    runs : tuple of Run
    band : Band
    torque, kinematic : bool
        Which channels there are.
    stated : CableModel
        With the inertial parameters of the file. Through them it is told how loud encoders are: those that are fitted
        to noisy accelerations come out too small.
    """

    model: CableModel
    runs: tuple[Run, ...]
    band: Band
    torque: bool
    kinematic: bool
    stated: CableModel

    @property
    def n_channels(self) -> int:
        """Motor torques and kinematic residuals."""
        return self.model.n_motors * (self.torque + self.kinematic)

    @property
    def blocks(self) -> list[slice]:
        """Channels of torque, and of travel; their noises come from different sensors."""
        m = self.model.n_motors
        return [slice(k, k + m) for k in range(0, self.n_channels, m)]

    @property
    def motions(self) -> list[Motion]:
        """The motions of all runs."""
        return [run.motion for run in self.runs]

    @cached_property
    def segments(self) -> list[Segments]:
        """Per run the stretches without gaps."""
        return [self.band.segments(run.signals.valid) for run in self.runs]

    @cached_property
    def sensed(self) -> Vector:
        """Noise in the band that the sensors alone bring, shape (n_channels,).

        Of torque: its own above the band, as if white, and that of positions through the inertia, as if white or from
        rounding this motion, whichever is more; of travel: that of the encoders, as if they rounded down.
        """
        parts = []
        for run in self.runs:
            signals, rate = run.signals, run.signals.rate
            share, own = np.sqrt(min(1.0, 2 * self.band.cutoff / rate)), []
            if self.torque:
                through = inertia_noise(self.stated, signals) * share * (2 * np.pi * self.band.cutoff) ** 2 / np.sqrt(5)
                through = np.maximum(through, _rounded(self.stated, signals, self.band))
                own.append(np.hypot(noise_floor(_torque(self.model, signals), rate, self.band.cutoff), through))
            if self.kinematic:  # encoders may round down: half a step, at any frequency
                own.append(_both_noise(signals, self.model) * run.motion.arm_scale * np.sqrt(3.0))
            parts.append(np.concatenate(own))
        return np.max(parts, axis=0)

    @cached_property
    def rounded(self) -> Vector:
        """Share of each motor's torque that steps of encoders bring through the inertia, shape (n_motors,)."""
        made = [_rounded(self.stated, run.signals, self.band) for run in self.runs]
        m = self.model.n_motors
        parts = [x[0, :m, a:b] for x, own in zip(self.data, self.segments, strict=True) for a, b in own]
        size = np.sqrt(np.mean(np.concatenate(parts, axis=1) ** 2, axis=1)) if parts else np.ones(m)
        return np.max(made, axis=0) / np.maximum(size, 1e-300)

    @cached_property
    def trusted(self) -> float:
        """Frequency up to which torque is noisier than positions are through the inertia [Hz]; beyond, they are alike.

        Columns with accelerations and the residual then share the noise of the encoders.
        """
        if not self.torque:
            return self.band.cutoff
        return min(self.band.cutoff, float(np.median([_limit(self.stated, run.signals) for run in self.runs])))

    @cached_property
    def torque_steps(self) -> Vector:
        """Steps in which torque was logged, as the motors see them, shape (n_motors,) [N m]; zero where there are none.

        What is logged may be wrong by half of one for as long as the torque hardly changes.
        """
        steps = np.zeros(self.model.n_motors)
        for run in self.runs:
            logged = run.signals.recording.channels
            name = "motor_torque" if "motor_torque" in logged else "joint_torque"
            own = np.array([quantisation_step(x) for x in logged[name].T]) if name in logged else np.zeros(1)
            steps = np.maximum(steps, own if name == "motor_torque" else np.abs(self.model.joint_from_motor.T) @ own)
        return steps

    @cached_property
    def data(self) -> list[Vector]:
        """Per run the data in the band, shape (1, n_channels, n_reduced)."""
        return [self.band.reduce(run.data)[None] for run in self.runs]

    @cached_property
    def rigid(self) -> list[Vector]:
        """Per run the regressor of all standard parameters in the band, shape (10 n_joints, n_channels, n_reduced)."""
        banks = []
        for run in self.runs:
            m, motion = self.model.n_motors, run.motion
            Y = motor_regressor(self.model, motion.q, motion.v, motion.a)
            bank = np.zeros((Y.shape[2], self.n_channels, motion.n))
            if self.torque:
                bank[:, :m] = Y.transpose(2, 1, 0)
            banks.append(self.band.reduce(bank))
        return banks

    @cached_property
    def rotors(self) -> list[Vector]:
        """Per run the motor torque that the stated rotor inertias take, shape (1, n_channels, n_reduced)."""
        banks = []
        for run in self.runs:
            bank = np.zeros((1, self.n_channels, run.motion.n))
            if self.torque:
                bank[0, : self.model.n_motors] = (run.motion.a_m * self.model.rotor_inertia).T
            banks.append(self.band.reduce(bank))
        return banks

    @property
    def payloads(self) -> list[Vector]:
        """Per run the standard parameters of the stated payload, taken to sit at the tip of the last link."""
        links, out = self.model.manipulator.links, []
        for run in self.runs:
            mass, change = run.payload, np.zeros(10 * self.model.n_joints)
            if mass and links:
                tip = links[-1].length
                change[-10:] = mass * np.array([1.0, tip, 0.0, 0.0, 0.0, 0.0, tip**2, 0.0, 0.0, tip**2])
            out.append(change)
        return out

    def reduce(self, columns: Callable[[Motion], Columns]) -> list[Lines]:
        """Compute columns on every run and bring them into the band."""
        return [self._reduce(columns(run.motion), run.motion.n) for run in self.runs]

    def _reduce(self, columns: Columns, n: int) -> Lines:
        m = self.model.n_motors
        if columns.along is not None:
            series, w = columns.along
            weights = np.zeros((len(series), self.n_channels))
            if self.torque:
                weights[:, :m] = w
            return Lines(self.band.reduce(series), weights, np.arange(len(series)), len(series))
        known = columns.torque if columns.torque is not None else columns.kinematic
        full = np.zeros((1 if known is None else known.shape[2], self.n_channels, n))
        if self.torque and columns.torque is not None:
            full[:, :m] = columns.torque.transpose(2, 1, 0)
        if self.kinematic and columns.kinematic is not None:
            full[:, m * self.torque :] = columns.kinematic.transpose(2, 1, 0)
        lines = Lines.of(full)
        return Lines(self.band.reduce(lines.series), lines.weights, lines.owner, lines.n_columns)

    def with_model(self, model: CableModel) -> Problem:
        """Give the same problem with other inertial parameters in the motions."""
        runs = tuple(replace(run, motion=run.motion.with_model(model)) for run in self.runs)
        return replace(self, model=model, runs=runs)

    def with_loads(self, effects: Sequence[tuple[Candidate, Vector]]) -> Problem:
        """Give the same problem with the torques that these effects bring in the motions."""
        return replace(self, runs=tuple(replace(run, motion=loaded(run.motion, effects)) for run in self.runs))


def make_problem(model: CableModel, recordings: Sequence[Recording], band: Band | None = None) -> Problem:
    """Prepare recordings and choose the band in which motion and torque are both known.

    Raises
    ------
    RecordingError
        If a recording contradicts the model.
    """
    signals = [prepare(recording, model) for recording in recordings]
    rate = min(s.rate for s in signals)
    if any(abs(s.rate - rate) > 1e-3 * rate for s in signals):
        signals = [prepare(recording, model, rate=rate) for recording in recordings]
    torque = all(_has(s, "torque") for s in signals)
    kinematic = all("joint_position" in s.logged and "motor_position" in s.logged for s in signals)
    samples = sum(len(s.time) for s in signals) * (torque + kinematic) * model.n_motors
    chosen = band or make_band(rate, min(_cutoff(model, signals), _affordable(model.n_motors, samples, rate)))

    def made(band: Band) -> Problem:
        ready = [prepare(recording, model, rate=rate, cutoff=band.cutoff) for recording in recordings]
        runs = tuple(_run(model, s, band, torque, kinematic, i) for i, s in enumerate(ready))
        return Problem(model, runs, band, torque, kinematic, model)

    problem = made(chosen)
    if band is not None or not torque:
        return problem
    slower = [
        inertia_cutoff(run.motion, run.data[: model.n_motors], chosen, own)
        for run, own in zip(problem.runs, problem.segments, strict=True)
    ]
    cutoff = float(np.median(slower))
    return problem if cutoff >= chosen.cutoff else made(make_band(rate, cutoff))


def _affordable(n_motors: int, samples: int, rate: float) -> float:
    """Give the cut-off [Hz] up to which the columns of all effects, some 190 per pair of motors, find room."""
    return max(3.0, MUCH / (190 * n_motors**2) / samples * rate / 2.6)


def _has(signals: Signals, what: str) -> bool:
    return f"motor_{what}" in signals.logged or f"joint_{what}" in signals.logged


def _positions(model: CableModel, signals: Signals) -> tuple[Vector, Vector]:
    logged = signals.logged
    if "joint_position" in logged:
        q = logged["joint_position"]
        return q, logged.get("motor_position", model.motor_position(q))
    return model.joint_position(logged["motor_position"]), logged["motor_position"]


def _torque(model: CableModel, signals: Signals) -> Vector:
    logged = signals.logged
    return logged["motor_torque"] if "motor_torque" in logged else model.motor_torque(logged["joint_torque"])


def _cutoff(model: CableModel, signals: Sequence[Signals]) -> float:
    """Choose a band in which the inertia torque of the encoders' noise stays below the noise of the torque.

    Above it the columns of the rigid body carry noise of their own, which biases a least-squares fit.
    """
    limits = []
    for s in signals:
        if not _has(s, "torque"):
            limits.append(min(10.0, 0.2 * s.rate))
            continue
        limits.append(np.clip(_limit(model, s), 3.0, min(20.0, 0.3 * s.rate)))
    return float(np.median(limits))


def _limit(model: CableModel, signals: Signals) -> float:
    """Give the frequency [Hz] above which the noise of positions, through the inertia, exceeds that of torque."""
    tau = noise_floor(_torque(model, signals), signals.rate)
    ratio = np.median(tau / np.maximum(inertia_noise(model, signals), 1e-12))
    return float(0.8 * np.sqrt(ratio) / (2 * np.pi))


def inertia_noise(model: CableModel, signals: Signals) -> Vector:
    """Noise of positions times the inertia that each motor feels, shape (n_motors,) [N m s^2]."""
    q, _ = _positions(model, signals)
    noise = np.maximum(noise_floor(q, signals.rate), 1e-9)
    return np.abs(model.joint_from_motor.T @ _mass(model, q) * noise) @ (np.ptp(q, axis=0) > 1e-6)


def _rounded(model: CableModel, signals: Signals, band: Band) -> Vector:
    """Torque that rounding brings through accelerations and inertia, shape (n_motors,) [N m].

    Slow motions are rounded alike for long: such errors are no white noise, and more of them lies in the band. They are
    made once more by rounding the motion as far as it is known.
    """
    q, _ = _positions(model, signals)
    smooth, logged = lowpass(q, signals.rate, band.cutoff), signals.recording.channels
    measured = "joint_position" if "joint_position" in signals.logged else "motor_position"
    if measured not in logged:
        return np.zeros(model.n_motors)
    x = smooth if measured == "joint_position" else model.motor_position(smooth)
    steps = np.array([quantisation_step(column) for column in logged[measured].T])
    own = np.where(steps > 0, steps, 1.0)
    error = (np.round(x / own) * own - x) * (steps > 0)
    if measured == "motor_position":
        error = error @ model.joint_from_motor.T
    error = lowpass(error, signals.rate, min(4.0 * band.cutoff, 0.45 * signals.rate))
    a = differentiate(differentiate(error, signals.rate), signals.rate)
    torque = band.reduce((a @ _mass(model, q) @ model.joint_from_motor).T)
    inside = [torque[:, start:stop] for start, stop in band.segments(signals.valid)]
    return np.sqrt(np.mean(np.concatenate(inside, axis=1) ** 2, axis=1)) if inside else np.zeros(model.n_motors)


def _mass(model: CableModel, q: Vector) -> Vector:
    from .dynamics import inverse_dynamics

    pose = np.repeat(np.median(q, axis=0)[None], model.n_joints + 1, axis=0)
    a = np.vstack([np.zeros(model.n_joints), np.eye(model.n_joints)])
    tau = inverse_dynamics(model, pose, np.zeros_like(pose), a)
    return (tau[1:] - tau[0]).T


def _parted(travel: Vector, band: Band, signals: Signals, model: CableModel, limit: float = 5.0) -> bool:
    """Whether motors and joints move apart by more than their encoders' noise explains, means aside."""
    inside = band.segments(signals.valid)
    if not inside:
        return False
    moved = np.concatenate([band.reduce(travel.T)[:, a:b] for a, b in inside], axis=1)
    share = min(1.0, 2 * band.cutoff / signals.rate)
    return bool(np.any(np.std(moved, axis=1) > limit * np.sqrt(share) * _both_noise(signals, model)))


def _dithered(travel: Vector, signals: Signals, model: CableModel, least: float = 1e-3) -> Vector:
    """Give encoders on both sides that agree to the last digit the noise that they must have: they say no more."""
    noise = _both_noise(signals, model)
    alike = np.std(travel, axis=0) < least * noise
    return travel + alike * noise * np.random.default_rng(0).standard_normal(travel.shape)


def _both_noise(signals: Signals, model: CableModel) -> Vector:
    """Noise of the travel from that of the encoders on both sides, shape (n_motors,) [rad]."""
    own, other = signals.noise["motor_position"], signals.noise["joint_position"]
    return np.sqrt(own**2 + model.motor_from_joint**2 @ other**2)


def _sharp(model: CableModel, signals: Signals, q: Vector, share: float = 0.01) -> float:
    """Find the widest band [Hz] in which the noise of velocity stays below a share of the velocity."""
    v = np.sqrt(np.mean(differentiate(lowpass(q, signals.rate, 0.05 * signals.rate), signals.rate) ** 2, axis=0))
    noise = np.maximum(noise_floor(q, signals.rate), 1e-9)
    moving = v > 1e-4
    if not moving.any():
        return 0.0
    ratio = np.median(v[moving] / noise[moving])
    wide = (share * ratio * np.sqrt(1.5 * signals.rate) / (2 * np.pi)) ** (2 / 3)
    return float(min(wide, 0.2 * signals.rate))


def _run(model: CableModel, signals: Signals, band: Band, torque: bool, kinematic: bool, index: int) -> Run:
    rate, light = signals.rate, min(4.0 * band.cutoff, 0.45 * signals.rate)
    q_raw, q_m_raw = _positions(model, signals)
    sharp = max(light, _sharp(model, signals, q_raw))
    travel = q_m_raw - model.motor_position(q_raw)
    if kinematic and not _parted(travel, band, signals, model):
        q_m_raw = model.motor_position(
            q_raw
        )  # both encoders see one motion: two noisy copies of it would fit the noise
    q, q_m = lowpass(q_raw, rate, sharp), lowpass(q_m_raw, rate, sharp)
    slow, slow_m = lowpass(q_raw, rate, light), lowpass(q_m_raw, rate, light)
    if kinematic:  # accelerations from two encoders would fit each other's noise
        slow_m = model.motor_position(slow)
    noise = np.sqrt(np.mean((q_m_raw - q_m) ** 2, axis=0)) * 2 * np.pi * sharp * np.sqrt(2 * sharp / rate / 3)
    motion = Motion(
        model=model,
        time=signals.time - signals.time[0],
        q=q,
        v=differentiate(q, rate),
        a=differentiate(differentiate(slow, rate), rate),
        q_m=q_m,
        v_m=differentiate(q_m, rate),
        a_m=differentiate(differentiate(slow_m, rate), rate),
        joints_measured="joint_position" in signals.logged,
        motors_measured="motor_position" in signals.logged,
        velocity_noise=noise,
        pretension=signals.recording.pretension or model.manipulator.pretension,
        index=index,
    )
    channels = [_torque(model, signals)] if torque else []
    if torque and model.manipulator.effects:
        from .completed import added_torque

        channels[0] = channels[0] - added_torque(motion)
    if kinematic:
        channels.append(_dithered(travel, signals, model) * motion.arm_scale)
    return Run(signals, motion, np.concatenate(channels, axis=1).T)
