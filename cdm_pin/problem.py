"""Recordings and a model as one linear problem in a band: data, columns of the rigid body and of effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .band import Band, light, make_band
from .candidates import Candidate, loaded, passed, torque_of
from .completed import added
from .effect import Columns
from .geometry import Vector
from .inertia_band import LOWEST, SLOWEST, inertia_cutoff
from .measured import both_positions, measured_torques
from .model import CableModel
from .motion import Felt, Motion
from .recording import Recording
from .regressor import motor_regressor
from .sensor_noise import SensorNoise, inertia_limit, inertia_noise, motion_limit, position_noise, speeds, travel_noise
from .signals import Signals, decimated, prepare, read_grid
from .signals_filters import differentiate, lowpass, noise_floor
from .standstill import Still, judged, resting_axes, standing
from .whitening import Lines, Segments, Stretches

MARGIN = 1.5
"""How far above the frequency where accelerations drown in noise they are still taken."""
MUCH = 4e8
"""Numbers that the whitened columns of all effects may take."""
ENOUGH = 200.0
"""Samples per second that motions are thinned to, where there are twice as many: ten times the widest band [Hz]."""


@dataclass(frozen=True)
class Run:
    """One recording made ready.

    Attributes
    ----------
    signals : Signals
    motion : Motion
        Lightly filtered, at the full rate.
    data : ndarray, shape (n_channels, n)
        Motor torques, then the travel that the kinematic model leaves over (`without_mean`); not filtered.
    sure : ndarray, shape (n_motors,), optional
        What the mean of each travel counts for, 0 to 1; default 1.
    shares : ndarray, shape (n,), optional
        What each sample counts for in that mean.
    judged : ndarray of bool, shape (n_motors, n_reduced), optional
        By which samples in the band each torque is judged; default all.
    """

    signals: Signals
    motion: Motion
    data: Vector
    sure: Vector | None = None
    shares: Vector | None = None
    judged: np.ndarray | None = None

    def without_mean(self, travel: Vector) -> Vector:
        """Take from travels, shape (..., n_motors, n), that share of their mean which rounding may have made."""
        if self.sure is None or self.shares is None:
            return travel
        return travel - (1.0 - self.sure[:, None]) * (travel @ self.shares)[..., None]

    @property
    def payload(self) -> float:
        """Mass that the recording says was held [kg]."""
        return self.signals.recording.payload or 0.0

    @property
    def name(self) -> str:
        """Name of the recording."""
        return self.signals.recording.name

    @property
    def notices(self) -> list[str]:
        """What is to be said of the recording, and of which motors torques are not judged for how long."""
        out = list(self.signals.notices)
        if self.judged is not None:
            shares = 1.0 - self.judged.mean(axis=1)
            motors = [f"motor {k + 1} for {100 * x:.0f} % of the time" for k, x in enumerate(shares) if x > 0.0]
            words = "torques are not judged while axes rest, as friction may hold anything there"
            out.append(f"{words}: {', '.join(motors)}")
        return out

    def carrying(self, model: CableModel) -> CableModel:
        """Give a robot with the payload that was held."""
        load = tip_load(model, self.payload)
        return model.with_standard_parameters(model.standard_parameters + load) if load.any() else model

    def with_model(self, model: CableModel, bearings: CableModel | None = None) -> Run:
        """Give the same run of a robot with other inertial parameters, to which those of the payload come."""
        motion = self.motion.with_model(self.carrying(model), self.carrying(bearings) if bearings else None)
        return replace(self, motion=motion)


def tip_load(model: CableModel, mass: float) -> Vector:
    """Give the standard parameters of a payload [kg] at the tip of the last link, shape (10 n_joints,)."""
    change, links = np.zeros(10 * model.n_joints), model.manipulator.links
    if mass and links:
        tip = links[-1].length
        change[-10:] = mass * np.array([1.0, tip, 0.0, 0.0, 0.0, 0.0, tip**2, 0.0, 0.0, tip**2])
    return change


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
    sensors : SensorNoise
        What the sensors bring by themselves.
    loads : tuple of (Candidate, ndarray)
        Effects with coefficients whose torques are in the motions.
    bearings : CableModel, optional
        With the masses that load the hinges, where these are others than the model's (`Motion.bearings`).
    resting : frozenset of int
        Axes that rest now and then, and are not judged while they do (`standstill`).
    """

    model: CableModel
    runs: tuple[Run, ...]
    band: Band
    torque: bool
    kinematic: bool
    sensors: SensorNoise
    loads: tuple[tuple[Candidate, Vector], ...] = ()
    bearings: CableModel | None = None
    resting: frozenset[int] = frozenset()

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
        """Per run the stretches without gaps; where axes rest now and then, with what each channel is judged by."""
        return [self._stretches(run) for run in self.runs]

    def _stretches(self, run: Run) -> Segments:
        bounds = self.band.segments(run.signals.valid)
        if run.judged is None:
            return bounds
        further = np.ones((self.n_channels - len(run.judged), run.judged.shape[1]), bool)
        return Stretches(bounds, np.concatenate([run.judged, further]))

    @cached_property
    def still(self) -> list[list[Still]]:
        """Per run, when each coordinate along which friction may hold stands still (`standing`)."""
        return [standing(run.motion, run.signals.valid, self.band.rate) for run in self.runs]

    def judged_without(self, axes: frozenset[int]) -> Problem:
        """Give the same problem with all samples judged but those at which some axes rest."""
        if not self.torque:
            return replace(self, resting=axes)
        runs = [
            replace(run, judged=judged(still, run.signals.valid, self.band, axes))
            for run, still in zip(self.runs, self.still, strict=True)
        ]
        return replace(self, runs=tuple(runs), resting=axes)

    @property
    def partly(self) -> bool:
        """Whether some samples of some channels are not judged."""
        return any(run.judged is not None for run in self.runs)

    @property
    def sensed(self) -> Vector:
        """Noise in the band that the sensors alone bring, shape (n_channels,)."""
        parts = [self.sensors.torque] if self.torque else []
        return np.concatenate([*parts, self.sensors.travel] if self.kinematic else parts)

    @property
    def rounded(self) -> Vector:
        """Share of each motor's torque that steps of encoders bring through the inertia, shape (n_motors,)."""
        m = self.model.n_motors
        parts = [x[0, :m, a:b] for x, own in zip(self.data, self.segments, strict=True) for a, b in own]
        size = np.sqrt(np.mean(np.concatenate(parts, axis=1) ** 2, axis=1)) if parts else np.ones(m)
        return self.sensors.rounding / np.maximum(size, 1e-300)

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
                bank[:, :m] = passed(Y, motion).transpose(2, 1, 0)
            banks.append(self.band.reduce(bank))
        return banks

    @property
    def swings(self) -> bool:
        """Whether the links swing on a soft cable in the motions."""
        return any(run.motion.swing is not None for run in self.runs)

    @property
    def shifted(self) -> bool:
        """Whether known effects move the joints from where the motors say they are, or the motors from the joints."""
        return any(run.motion.moved is not None for run in self.runs)

    @property
    def posture(self) -> tuple[tuple[int, ...], ...]:
        """About how far soft cables and errors of the cable map move joints or motors; equal where columns may be kept.

        On which cable the links swing and how stiff it is, on a scale of thirds; by how much others move, of tenths.
        """
        swing = self.runs[0].motion.swing
        hung = () if swing is None else (swing.cable, round(np.log(swing.stiffness) / np.log(4.0 / 3.0)))
        if swing is not None and swing.half_gap:
            hung = (*hung, round(np.log(swing.half_gap) / np.log(1.1)))
        shifts = [run.motion.moved for run in self.runs if run.motion.moved is not None]
        size = np.sqrt(np.mean(np.concatenate(shifts) ** 2, axis=0)) if shifts else np.array([])
        return hung, tuple(np.round(np.log(np.maximum(size, 1e-5)) / np.log(1.1)).astype(int).tolist())

    def is_loaded_like(self, other: Problem, share: float = 0.005) -> bool:
        """Whether the same effects bring the same torques, but for a share of them that no score of a column shows."""
        if [c.key for c, _ in self.loads] != [c.key for c, _ in other.loads]:
            return False
        pairs = [(x.cable_torque, y.cable_torque) for x, y in zip(self.motions, other.motions, strict=True)]
        return all(np.all(np.sum((x - y) ** 2, axis=0) <= share**2 * np.sum(y**2, axis=0)) for x, y in pairs)

    @cached_property
    def states(self) -> list[Vector]:
        """Per run the motor torque of free swings on a soft cable, shape (k, n_channels, n_reduced); mostly none."""
        free = [np.zeros((0, 0, 0)) if run.motion.swing is None else run.motion.swing.free for run in self.runs]
        first = np.cumsum([0, *map(len, free)])
        out = []
        for k, own, run in zip(first, free, self.runs, strict=False):
            bank = np.zeros((first[-1], self.n_channels, run.motion.n))
            if len(own):
                bank[k : k + len(own), : self.model.n_motors] = own.transpose(0, 2, 1)
            out.append(self.band.reduce(bank))
        return out

    @property
    def known(self) -> list[Vector]:
        """What is known of the torque along motions that swing, less what the columns of the loads say of it.

        The torque of the links where they are, and with it that of the loads, which are in the cable already.

        Returns
        -------
        list of ndarray, shape (n_channels, n_reduced)
        """
        out = []
        for run in self.runs:
            torque = run.motion.tau_m.copy()
            for candidate, beta in self.loads:
                torque += torque_of(candidate.raw_columns(run.motion), beta, torque.shape)
                torque -= torque_of(candidate.columns(run.motion), beta, torque.shape)
            out.append(self.band.reduce(torque.T))
        return out

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
        return [tip_load(self.model, run.payload) for run in self.runs]

    @property
    def half_steps(self) -> dict[str, Vector]:
        """Half a step [rad] of the encoders on each side that is logged, of the coarsest recording.

        Where no steps were seen, those that would make the noise of a position.
        """
        errors = [rounding_errors(run.signals) for run in self.runs]
        return {side: np.sqrt(3.0) * np.max([own[side] for own in errors], axis=0) for side in errors[0]}

    def steps_at(self, joint: int) -> float:
        """Sum of the steps [rad] of the encoders that say where a joint is, of the coarsest recording.

        Where no steps were seen, those that would make the noise of a position. It says little where they were: what
        jitter of the clock makes of it all encoders have in common.
        """
        to_joints, largest = np.abs(self.model.joint_from_motor), []
        shares = {"joint_position": np.eye(len(to_joints)), "motor_position": to_joints}
        for run in self.runs:
            errors = rounding_errors(run.signals)
            sides = [np.sqrt(12.0) * share @ errors[side] for side, share in shares.items() if side in errors]
            largest.append(float(np.sum(sides, axis=0)[joint]))
        return max(largest)

    def reduce(self, columns: Callable[[Motion], Columns]) -> list[Lines]:
        """Compute columns on every run and bring them into the band."""
        return [self._reduce(columns(run.motion), run) for run in self.runs]

    def _reduce(self, columns: Columns, run: Run) -> Lines:
        m, n = self.model.n_motors, run.motion.n
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
            full[:, m * self.torque :] = run.without_mean(columns.kinematic.transpose(2, 1, 0))
        lines = Lines.of(full)
        return Lines(self.band.reduce(lines.series), lines.weights, lines.owner, lines.n_columns)

    def with_model(self, model: CableModel, bearings: CableModel | None = None) -> Problem:
        """Give the same problem with other inertial parameters in the motions, of the load on hinges maybe others."""
        runs = tuple(run.with_model(model, bearings) for run in self.runs)
        return replace(self, model=model, bearings=bearings, runs=runs)

    def with_loads(self, effects: Sequence[tuple[Candidate, Vector]]) -> Problem:
        """Give the same problem with the torques that these effects bring in the motions."""
        motions = [loaded(motion, effects) for motion in self.motions]
        swing = [motion.swing is not None for motion in motions]
        if any(swing) and not all(swing):  # all or none: one bank of columns is for all of them
            motions = [loaded(motion, effects, swings=False) for motion in self.motions]
        runs = tuple(replace(run, motion=m) for run, m in zip(self.runs, motions, strict=True))
        return replace(self, runs=runs, loads=tuple(effects))


def make_problem(
    model: CableModel,
    recordings: Sequence[Recording],
    band: Band | None = None,
    first: int = 0,
    resting: frozenset[int] = frozenset(),
) -> Problem:
    """Prepare recordings and choose the band in which motion and torque are both known.

    What happens once happens on the recording of one number; those of others start at `first`. Axes that rest now and
    then on other recordings (`Problem.resting`) are not judged where they rest on these.

    Raises
    ------
    RecordingError
        If a recording contradicts the model.
    """
    logs = [(recording, read_grid(recording, model)) for recording in recordings]
    signals = [prepare(recording, model, grid=grid) for recording, grid in logs]
    rate = min(s.rate for s in signals)
    if any(abs(s.rate - rate) > 1e-3 * rate for s in signals):
        signals = [prepare(recording, model, rate=rate, grid=grid) for recording, grid in logs]
    torque = all(_has_torque(s) for s in signals)
    kinematic = all("joint_position" in s.logged and "motor_position" in s.logged for s in signals)
    samples = sum(len(s.time) for s in signals) * (torque + kinematic) * model.n_motors
    cutoff = band.cutoff if band else min(_cutoff(model, signals), _affordable(model.n_motors, samples, rate))
    chosen = make_band(rate, cutoff)

    def made(band: Band) -> Problem:
        ready = [prepare(recording, model, rate=rate, cutoff=band.cutoff, grid=grid) for recording, grid in logs]
        thin = _thinned(band)
        runs = [_run(model, s, band, torque, kinematic, i) for i, s in enumerate(ready, first)]
        runs = [_without_means(_thinned_run(run, thin), thin) for run in runs]
        sensors = SensorNoise(model, tuple(ready), band)
        runs = tuple(run.with_model(model) for run in runs)
        own = Problem(model, runs, thin, torque, kinematic, sensors)
        axes = [resting]
        if torque:
            axes += [resting_axes(still, run.signals.valid) for still, run in zip(own.still, runs, strict=True)]
        return own.judged_without(frozenset().union(*axes))

    known = _heard(model, signals, chosen) if torque else np.inf
    problem = made(replace(chosen, slow=known))
    coarse = torque and problem.sensors.trusted < 0.5 * chosen.cutoff <= 0.5 * LOWEST
    if not torque or (band is not None and not coarse):
        return problem
    slower = [
        inertia_cutoff(run.motion, run.data[: model.n_motors], problem.band, own, coarse)
        for run, own in zip(problem.runs, problem.segments, strict=True)
    ]
    cutoff = float(np.max(slower) if coarse else np.median(slower))  # as quick as any recording asks for
    if cutoff >= chosen.cutoff:
        return problem
    if coarse:
        return made(replace(chosen, slow=min(cutoff, known)))
    return made(replace(make_band(rate, cutoff), slow=known if known < cutoff else np.inf))


def _heard(model: CableModel, signals: Sequence[Signals], band: Band) -> float:
    """Give the frequency [Hz] up to which accelerations are worth taking; infinity where that is the whole band.

    Or where what rings beside gaps would cost much of the recordings.
    """
    limit = max(MARGIN * max(motion_limit(model, s, MARGIN * band.cutoff) for s in signals), 2 * SLOWEST)
    if limit >= band.cutoff:
        return np.inf
    lengths = [
        sum(stop - start for s in signals for start, stop in own.segments(s.valid))
        for own in (replace(band, slow=limit), band)
    ]
    return limit if lengths[0] > 0.6 * lengths[1] else np.inf


def _affordable(n_motors: int, samples: int, rate: float) -> float:
    """Give the cut-off [Hz] up to which the columns of all effects, some 190 per pair of motors, find room."""
    return max(3.0, MUCH / (190 * n_motors**2) / samples * rate / 2.6)


def _has_torque(signals: Signals) -> bool:
    return "motor_torque" in signals.logged or "joint_torque" in signals.logged


def _cutoff(model: CableModel, signals: Sequence[Signals]) -> float:
    """Choose a band in which the inertia torque of the encoders' noise stays below the noise of the torque.

    Above it the columns of the rigid body carry noise of their own, which biases a least-squares fit.
    """
    limits = []
    for s in signals:
        if not _has_torque(s):
            limits.append(min(10.0, 0.2 * s.rate))
            continue
        limits.append(np.clip(inertia_limit(model, s), 3.0, min(20.0, 0.3 * s.rate)))
    return float(np.median(limits))


def _parted(travel: Vector, band: Band, signals: Signals, model: CableModel, limit: float = 5.0) -> bool:
    """Whether motors and joints move apart by more than their encoders' noise explains, means aside."""
    inside = band.segments(signals.valid)
    if not inside:
        return False
    moved = np.concatenate([band.reduce(travel.T)[:, a:b] for a, b in inside], axis=1)
    share = min(1.0, 2 * band.cutoff / signals.rate)
    return bool(np.any(np.std(moved, axis=1) > limit * np.sqrt(share) * travel_noise(model, signals)))


def _dithered(travel: Vector, signals: Signals, model: CableModel, least: float = 1e-3) -> Vector:
    """Give encoders on both sides that agree to the last digit the noise that they must have: they say no more."""
    noise = travel_noise(model, signals)
    alike = np.std(travel, axis=0) < least * noise
    return travel + alike * noise * np.random.default_rng(0).standard_normal(travel.shape)


def _sure_of_mean(model: CableModel, signals: Signals) -> Vector:
    """Tell what the mean of each travel counts for, beside encoders whose rounding shifts it, shape (n_motors,).

    Such a shift of up to half a step on either side is as good as a known variance of the mean: the square root of the
    share of it that noise alone would have.
    """
    steps, n = signals.steps, int(signals.valid.sum())
    shift = 0.5 * (steps["motor_position"] + np.abs(model.motor_from_joint) @ steps["joint_position"])
    own = np.maximum(travel_noise(model, signals), 1e-300) / np.sqrt(max(n, 1))
    return own / np.hypot(own, shift)


def _sharp(model: CableModel, signals: Signals, q: Vector, share: float = 0.01) -> float:
    """Find the widest band [Hz] in which the noise of velocity stays below a share of the velocity."""
    v = speeds(q, signals.rate)
    noise = position_noise(model, signals)
    moving = v > 1e-4
    if not moving.any():
        return 0.0
    ratio = np.median(v[moving] / noise[moving])
    wide = (share * ratio * np.sqrt(1.5 * signals.rate) / (2 * np.pi)) ** (2 / 3)
    return float(min(wide, 0.2 * signals.rate, 0.4 * ENOUGH))


def _quieter(model: CableModel, signals: Signals, q: Vector, q_m: Vector) -> Vector:
    """Give positions of the joints by that side which measures each with less noise, shape (n, n_joints) [rad].

    Noise that columns share with the travel would look like travel in proportion to them.
    """
    by_motors = np.sqrt(model.joint_from_motor**2 @ signals.noise["motor_position"] ** 2)
    return np.where(by_motors < signals.noise["joint_position"], model.joint_position(q_m), q)


def rounding_errors(signals: Signals) -> dict[str, Vector]:
    """Give the standard deviation of what steps of encoders, or noise where none were seen, make of positions [rad].

    Keys are the logged sides, ``joint_position`` and ``motor_position``.
    """
    return {
        side: np.where(signals.steps[side] > 0.0, signals.steps[side] / np.sqrt(12.0), noise)
        for side, noise in signals.noise.items()
        if side in ("joint_position", "motor_position")
    }


def _position_errors(model: CableModel, signals: Signals, sharp: float, parted: bool) -> tuple[Vector, Vector]:
    """Give what encoders' steps, or noise where none were seen, make of positions up to a frequency [Hz].

    Nothing of a side that follows from the other: of motors where they do not move apart from logged joints.
    """
    share = np.sqrt(min(2.0 * sharp / signals.rate, 1.0))
    own = {  # what differs from period to period may be motion
        side: np.minimum(error, noise_floor(signals.logged[side], signals.rate, steps=signals.steps[side]))
        for side, error in rounding_errors(signals).items()
    }
    joints = share * own.get("joint_position", np.zeros(model.n_joints))
    motors = share * own.get("motor_position", np.zeros(model.n_motors))
    return joints, motors if parted or "joint_position" not in own else np.zeros_like(motors)


def _run(model: CableModel, signals: Signals, band: Band, torque: bool, kinematic: bool, index: int) -> Run:
    rate, lightly = signals.rate, light(band.cutoff, signals.rate)
    q_raw, q_m_raw = both_positions(model, signals.logged)
    travel = q_m_raw - model.motor_position(q_raw)
    if kinematic and not torque:
        q_raw = _quieter(model, signals, q_raw, q_m_raw)
    sharp = max(lightly, _sharp(model, signals, q_raw))
    parted = kinematic and _parted(travel, band, signals, model)
    if kinematic and not parted:
        q_m_raw = model.motor_position(q_raw)  # both encoders see one motion: two noisy copies would fit the noise
    q, q_m = lowpass(q_raw, rate, sharp), lowpass(q_m_raw, rate, sharp)
    slow, slow_m = (lowpass(x, rate, min(lightly, band.slow)) for x in (q_raw, q_m_raw))
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
        inertia_noise=inertia_noise(model, signals) if torque else None,
        torque_measured=torque,
        position_errors=_position_errors(model, signals, sharp, parted),
    )
    if torque and "joint_position" not in signals.logged:
        felt = Felt(
            measured_torques(model, signals.logged), q_m_raw, (sharp, min(lightly, band.slow)), signals.valid, rate
        )
        motion = replace(motion, felt=felt)
    channels = [measured_torques(model, signals.logged)] if torque else []
    stated = np.zeros_like(travel)
    if model.manipulator.effects:
        push, stated = added(motion)
        channels = [torques - push for torques in channels]
        if motion.felt is not None:
            motion = replace(motion, felt=replace(motion.felt, torque=channels[0]))
    run = Run(signals, motion, np.concatenate([*channels, np.zeros((motion.n, 0))], axis=1).T)
    if not kinematic:
        return run
    left = (_dithered(travel, signals, model) * model.arm_scale - stated).T
    return replace(run, sure=_sure_of_mean(model, signals), data=np.concatenate([run.data, left]))


def _without_means(run: Run, band: Band) -> Run:
    """Take from the travels of a run what rounding may have made of their means, at the rate at which columns are."""
    if run.sure is None:
        return run
    m = len(run.sure)
    run = replace(run, shares=band.shares(run.motion.n, band.segments(run.signals.valid)))
    return replace(run, data=np.concatenate([run.data[:-m], run.without_mean(run.data[-m:])]))


def _thinned(band: Band) -> Band:
    """Give the band for what comes in at as many samples as the laws of effects need; about as many are kept of them.

    Of the ways to thin within a factor of two, that is taken which least changes how many samples are kept.
    """
    most = int(1.02 * band.rate / ENOUGH)  # clocks are a little slow
    if most < 2:
        return band
    every = min(range(most, most // 2, -1), key=lambda k: band.step % k)
    return replace(make_band(band.rate / every, band.cutoff, max(band.step // every, 1)), slow=band.slow)


def _thinned_run(run: Run, band: Band) -> Run:
    """Give a run at the rate of a band: one of so many samples, of data that were not filtered after a low-pass."""
    signals, motion = run.signals, run.motion
    every = round(signals.rate / band.rate)
    if every < 2:
        return run

    def slow(x: Vector) -> Vector:
        return lowpass(x, signals.rate, 0.4 * band.rate, signals.order)[::every]

    fewer = decimated(signals, band.rate)
    names = ("time", "q", "v", "a", "q_m", "v_m", "a_m")
    motion = replace(motion, **{name: getattr(motion, name)[::every] for name in names})
    if motion.inertia_noise is not None:  # white noise of that density
        motion = replace(motion, inertia_noise=motion.inertia_noise / np.sqrt(every))
    if motion.felt is not None:
        felt = replace(motion.felt, torque=slow(motion.felt.torque), position=slow(motion.felt.position))
        motion = replace(motion, felt=replace(felt, valid=fewer.valid, rate=band.rate))
    return replace(run, signals=fewer, motion=motion, data=slow(run.data.T).T)
