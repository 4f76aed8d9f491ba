r"""A recording and a robot as rows of :math:`y = X\beta`: block by block, through one filter on both sides.

The columns of X are the base parameters, then one per effect that is asked for, then those of the baseline effects that
are not (`spare`: only to say what they would explain). What the model file states (rotor inertia, effects) is
subtracted from y. Joints and motors that do not move are held exactly still, so that their noise excites nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import norm

from .accelerations import Acceleration, candidates, choose_accelerations, said, with_accelerations
from .band import Band, make_band
from .cables import cable_state
from .completed import added_torque
from .effect import Columns
from .effect_shapes import speed_scale
from .effects import CATALOGUE
from .errors import RecordingError
from .geometry import Vector
from .measured import both_positions, measured_torques
from .model import CableModel
from .motion import Motion
from .recording import Recording
from .regressor import blocks, motor_regressor
from .sign_widths import choose_factors
from .signals import Signals, prepare
from .signals_checks import check
from .signals_filters import differentiate, lowpass, moves, noise_floor, spectrum
from .terms import Plan, Term
from .units import either, motor_units
from .whitening import Segments

BLOCK = 4096  # samples of the recording
MOTION_BANDS = 6.0  # torque is fitted up to this many times the band of the motion: above it accelerations are noise
FEWEST_SAMPLES = 60  # after decimation
STILL = 4.0  # standard deviations of noise, after the light filter, that count as movement
REST = 0.02  # of the farthest travel of its kind, below which an axis rests
LONGEST = 1 << 15  # samples by which accelerations are chosen
SIGN_WIDTH = 2e-3  # of the smooth sign of velocity, at least, in root mean square speeds


@dataclass(frozen=True)
class Observation:
    """A recording made ready to give rows.

    Attributes
    ----------
    signals : Signals
    motion : Motion
        Lightly filtered, at the full rate; what stands still is exactly still.
    shaken : Motion
        The same with another sample of the positions' noise on top.
    torque : ndarray, shape (n, n_motors)
        Motor torques less what the model file states, not filtered [N m].
    band : Band
        The common filter, with decimation.
    segments : sequence of (start, stop)
        Of decimated samples.
    shapes : tuple
        Nonlinear shape of every term's effect (the width of the smooth sign).
    notices : tuple of str
    left_out : dict of str to int
        Samples not used, by reason.
    accelerations : tuple of Acceleration, length n_motors
        How each motor's acceleration was made.
    resting : ndarray of bool, shape (n_motors,)
        Motors that do not move: what friction holds there is no equation of motion.
    """

    signals: Signals
    motion: Motion
    shaken: Motion
    torque: Vector
    band: Band
    segments: Segments
    shapes: tuple[tuple[float, ...], ...]
    notices: tuple[str, ...]
    left_out: dict[str, int]
    accelerations: tuple[Acceleration, ...] = ()
    resting: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))

    @property
    def n_samples(self) -> int:
        """Decimated samples that give rows."""
        return sum(stop - start for start, stop in self.segments)


def observe(plan: Plan, recording: Recording) -> Observation:
    """Prepare a recording: filter, differentiate, find what is locked, leave out what the model does not cover.

    Raises
    ------
    RecordingError
        If torque or position is missing, or the recording contradicts the robot.
    """
    _check_channels(recording)
    signals = prepare(recording, plan.model)
    _check_units(signals, plan.model)
    band = make_band(signals.rate, plan.cutoff or choose_band(plan.model, signals))
    q, q_m = both_positions(plan.model, signals.logged)
    sigma, sigma_m = _position_noise(plan.model, signals)
    motion = _motion(plan.model, signals, band.cutoff, q, q_m)
    still = (np.std(motion.q, axis=0) < STILL * sigma + 1e-9) | _rests(motion.q, plan.model.chain.prismatic)
    still_m = (np.std(motion.q_m, axis=0) < STILL * sigma_m + 1e-9) | _rests(motion.q_m, plan.model.linear_motors)
    valid = whole(signals.valid, 5 + int(4 * signals.rate / light_cutoff(signals, band.cutoff)))
    left_out = {"in gaps and at the ends": int((~valid).sum())} if not valid.all() else {}
    torque = measured_torques(plan.model, signals.logged)
    for reason, bad in _outside(motion, lowpass(torque, signals.rate, band.cutoff)).items():
        if (bad & valid).any():
            left_out[reason] = int((bad & valid).sum())
        valid &= ~bad
    noise, noise_m = _noise_like(plan.model, signals.logged, sigma, sigma_m)
    shaken = _motion(plan.model, signals, band.cutoff, q + noise, q_m + noise_m)
    notices = (
        f"both sides through one zero-phase low-pass of {band.cutoff:.3g} Hz, {signals.rate / band.step:.4g} samples/s",
        *(text for text in signals.notices if "zero-phase" not in text),  # that filter is not the one used here
        *_torque_check(plan.model, signals),
        *(f"{plan.model.joints[k]} is locked" for k in np.flatnonzero(still)),
        *(
            f"{plan.model.motors[k]} rests: friction can hold any torque, so it is not fitted"
            for k in np.flatnonzero(still_m)
        ),
    )
    observation = Observation(
        signals=signals,
        motion=_held(motion, still, still_m),
        shaken=_held(shaken, still, still_m),
        torque=torque - stated_torque(_held(motion, still, still_m)),
        band=band,
        segments=band.segments(valid),
        shapes=tuple(_shape(term, motion) for term in plan.terms),
        notices=notices,
        left_out=left_out,
        resting=still_m,
    )

    def moved(chosen: Sequence[Acceleration]) -> Observation:
        made = _held(with_accelerations(plan.model, motion, signals, q, q_m, chosen), still, still_m)
        return replace(observation, motion=made, torque=torque - stated_torque(made))

    part = _middle(observation.segments, LONGEST // band.step)
    chosen = plan.accelerations
    if chosen is None:
        tried = candidates(signals, band.cutoff, motion_band(signals, slowest=True))
        alike = lambda choice: _stacked(plan, replace(moved((choice,) * plan.model.n_motors), segments=part))  # noqa: E731
        chosen = choose_accelerations(tried, alike, plan.present)
    observation = moved(chosen)
    trembling = with_accelerations(plan.model, shaken, signals, q + noise, q_m + noise_m, chosen)
    return replace(
        observation,
        shaken=_held(trembling, still, still_m),
        shapes=plan.shapes or _widened(plan, replace(observation, segments=part)),
        accelerations=chosen,
        notices=(notices[0], *said(chosen, plan.model.motors), *notices[1:]),
    )


def _stacked(plan: Plan, observation: Observation) -> tuple[Vector, Vector]:
    """Give all rows at once."""
    found = [(X, y) for _, X, y in rows(plan, observation)]
    width = plan.base.rank + len(plan.terms)
    X = np.concatenate([np.zeros((0, plan.model.n_motors, width)), *(X for X, _ in found)])
    return X, np.concatenate([np.zeros((0, plan.model.n_motors)), *(y for _, y in found)])


def _widened(plan: Plan, observation: Observation) -> tuple[tuple[float, ...], ...]:
    """Give the shapes of all terms, the signs of dry friction as wide as the torques show them."""
    where = [k for k, term in enumerate(plan.terms) if CATALOGUE[term.effect].nuisance_shape]
    alone = replace(plan, base=plan.base.empty, terms=tuple(plan.terms[k] for k in where))
    narrow = [observation.shapes[k][0] for k in where]

    def signs(factor: float) -> Vector:
        return _stacked(alone, replace(observation, shapes=tuple((factor * width,) for width in narrow)))[0]

    columns = [plan.base.rank + k for k in where]
    factors = choose_factors(*_stacked(plan, observation), signs, columns, plan.present)
    shapes = list(observation.shapes)
    for k, width, factor in zip(where, narrow, factors, strict=True):
        shapes[k] = (float(factor * width),)
    return tuple(shapes)


def _rests(x: Vector, linear: np.ndarray) -> np.ndarray:
    """Mark what travels by less than a small share of the farthest of its kind."""
    travel, rests = np.ptp(x, axis=0), np.zeros(len(linear), bool)
    for kind in (linear, ~linear):
        rests[kind] = travel[kind] < REST * np.max(travel[kind], initial=0.0)
    return rests


def _middle(segments: Segments, most: int) -> Segments:
    """Keep at most so many samples, those around the middle."""
    total = sum(stop - start for start, stop in segments)
    skip, kept = max(total - most, 0) // 2, []
    left = min(most, total)
    for start, stop in segments:
        start, skip = start + min(skip, stop - start), skip - min(skip, stop - start)
        stop = min(stop, start + left)
        left -= stop - start
        kept += [(start, stop)] if stop > start else []
    return kept


def choose_band(model: CableModel, signals: Signals) -> float:
    r"""Choose the common filter's cut-off [Hz].

    It is a few times the band of the motion, so that harmonics of the torque count and samples are many, but not beyond
    where noise becomes a thousandth of the accelerations' power: below f it has :math:`\sigma^2 \omega^4 \cdot 2f/5r`.
    """
    duration = float(signals.time[-1] - signals.time[0])
    wanted = max(MOTION_BANDS * motion_band(signals), FEWEST_SAMPLES / (2.6 * max(duration, 1e-9)))
    for side, noise in zip(("joint", "motor"), _position_noise(model, signals), strict=True):
        a = signals.channels.get(f"{side}_acceleration")
        if a is None or not signals.valid.any():
            continue
        power = np.mean(a[signals.valid] ** 2, axis=0)
        ratio = power * signals.rate / (400 * (2 * np.pi) ** 4 * np.maximum(noise, 1e-150) ** 2)
        moving = np.ptp(signals.channels[f"{side}_position"], axis=0) > 20 * noise + 1e-9
        wanted = min(wanted, max(signals.cutoff, float(np.min(ratio[moving], initial=np.inf)) ** 0.2))
    return float(min(wanted, 0.4 * signals.rate))


def motion_band(signals: Signals, share: float = 0.99, *, slowest: bool = False) -> float:
    """Frequency below which this share of a velocity's power lies, at most the signals' own cut-off [Hz].

    Of the axes that move, the fastest one's; with `slowest` that of the slowest.
    """
    positions = np.hstack([x for name, x in signals.logged.items() if name in ("joint_position", "motor_position")])
    moving = moves(positions, signals.rate)
    if len(signals.time) < 16 or not moving.any():
        return signals.cutoff
    frequency, density = spectrum(positions[:, moving], signals.rate)
    power = np.cumsum(frequency[:, None] ** 2 * density * (frequency[:, None] <= signals.cutoff), axis=0)
    beyond = frequency[np.argmax(power >= share * power[-1], axis=0)]
    return float(min(signals.cutoff, beyond.min() if slowest else beyond.max()))


def light_cutoff(signals: Signals, cutoff: float) -> float:
    """Cut-off of the filter before differentiation [Hz]; the common filter comes after it."""
    return min(max(signals.light_cutoff, 2 * cutoff), 0.4 * signals.rate)


def whole(valid: np.ndarray, margin: int) -> np.ndarray:
    """Keep only samples with `margin` valid ones on either side."""
    bad = np.concatenate([np.ones(margin, bool), ~valid, np.ones(margin, bool)])
    return np.convolve(bad, np.ones(2 * margin + 1), mode="valid") < 0.5


def rows(
    plan: Plan,
    observation: Observation,
    torque: Vector | None = None,
    *,
    noise: bool = False,
    block: int = BLOCK,
    resting: bool = False,
) -> Iterator[tuple[int, Vector, Vector]]:
    """Yield (segment, X, y) block by block.

    Parameters
    ----------
    plan : Plan
    observation : Observation
    torque : ndarray, shape (n, n_motors), optional
        In place of the observed one.
    noise : bool
        Give the change of X by a sample of the positions' noise in place of X.
    block : int
        Samples of the recording.
    resting : bool
        Keep the equations of motors that do not move; else they are zero.

    Yields
    ------
    segment : int
    X : ndarray, shape (k, n_motors, n_columns)
    y : ndarray, shape (k, n_motors)
    """
    band, y = observation.band, observation.torque if torque is None else torque
    half, per_block = len(band.taps) // 2, max(block // band.step, 64)
    for number, (start, stop) in enumerate(observation.segments):
        for first in range(start, stop, per_block):
            last = min(first + per_block, stop)
            part = slice(first * band.step - half, (last - 1) * band.step + half + 1)
            X = columns(plan, observation, part)
            if noise:
                X = columns(plan, observation, part, shaken=True) - X
            raw = np.concatenate([X, y[part, :, None]], axis=2)
            kept = band.reduce(np.ascontiguousarray(raw.transpose(2, 1, 0)))
            kept = kept[..., half // band.step : half // band.step + last - first].transpose(2, 1, 0)
            if not resting:
                kept[:, observation.resting] = 0.0
            yield number, kept[..., :-1], kept[..., -1]


def columns(plan: Plan, observation: Observation, part: slice, *, shaken: bool = False) -> Vector:
    """Compute the columns at samples of the recording, not filtered, shape (n, n_motors, n_columns)."""
    motion = (observation.shaken if shaken else observation.motion).part(part)
    parts = [np.zeros((motion.n, plan.model.n_motors, 0))]
    if plan.base.rank:
        parts.append(motor_regressor(plan.model, motion.q, motion.v, motion.a)[..., plan.base.columns])
    for term, shape in zip(plan.terms, observation.shapes, strict=True):
        own = torque_columns(CATALOGUE[term.effect].columns(motion, term.place, shape), motion)
        parts.append(own[..., term.number : term.number + 1])
    return np.concatenate(parts, axis=2)


def cleaned_torque(plan: Plan, observation: Observation, values: Vector, quantile: float = 0.99) -> Vector:
    r"""Pull outlying torques towards a fit, before any filter smears them: Huber's pseudo-values.

    :math:`y^* = X\beta + \psi(y - X\beta)`, where :math:`\psi` cuts at a Gaussian quantile of the residual's robust
    scale; least squares on :math:`y^*`, repeated, is Huber's estimator.

    Parameters
    ----------
    plan : Plan
    observation : Observation
    values : ndarray, shape (n_columns,)
    quantile : float
        Share of Gaussian residuals that stay as they are.

    Returns
    -------
    ndarray, shape (n, n_motors)
    """
    n = len(observation.torque)
    predicted = np.concatenate([columns(plan, observation, part) @ values for part in blocks(n, BLOCK)])
    residual = observation.torque - predicted
    scale = np.median(np.abs(residual - np.median(residual, axis=0)), axis=0) / norm.ppf(0.75)
    limit = norm.ppf(0.5 + 0.5 * quantile) * scale
    return predicted + np.clip(residual, -limit, limit)


def stated_torque(motion: Motion) -> Vector:
    """Motor torque of the rotors and of the effects that the model file states, shape (n, n_motors) [N m]."""
    return motion.a_m * motion.model.rotor_inertia + added_torque(motion)


def torque_columns(columns: Columns, motion: Motion) -> Vector:
    """Give an effect's columns as motor torques, shape (n, n_motors, k)."""
    if columns.along is not None:
        series, weights = columns.along
        return np.einsum("kn,m->nmk", series, weights)
    if columns.torque is not None:
        return columns.torque
    return np.zeros((motion.n, motion.model.n_motors, 1))


def _motion(model: CableModel, signals: Signals, cutoff: float, q: Vector, q_m: Vector) -> Motion:
    """Differentiate positions after the light filter."""
    rate, light = signals.rate, light_cutoff(signals, cutoff)
    raw, (q, q_m) = q_m, (lowpass(x, rate, light) for x in (q, q_m))
    v, v_m = differentiate(q, rate), differentiate(q_m, rate)
    noise = np.std(raw - q_m, axis=0) * 2 * np.pi * light * np.sqrt(2 * light / rate / 3)
    return Motion(
        model=model,
        time=signals.time - signals.time[0],
        q=q,
        v=v,
        a=differentiate(v, rate),
        q_m=q_m,
        v_m=v_m,
        a_m=differentiate(v_m, rate),
        joints_measured="joint_position" in signals.logged,
        motors_measured="motor_position" in signals.logged,
        velocity_noise=noise,
        pretension=signals.recording.pretension or model.manipulator.pretension,
    )


def _position_noise(model: CableModel, signals: Signals) -> tuple[Vector, Vector]:
    """Give the standard deviation of each joint's and each motor's position noise as logged.

    It is that of the quiet end of the spectrum: what differs from period to period was measured and did move the arm.
    """
    found = {}
    for side in ("joint", "motor"):
        if f"{side}_position" in signals.logged:
            found[side] = noise_floor(signals.logged[f"{side}_position"], signals.rate)
    if "joint" not in found:
        return np.sqrt(model.joint_from_motor**2 @ found["motor"] ** 2), found["motor"]
    return found["joint"], found.get("motor", np.sqrt(model.motor_from_joint**2 @ found["joint"] ** 2))


def _noise_like(
    model: CableModel, logged: Mapping[str, Vector], sigma: Vector, sigma_m: Vector
) -> tuple[Vector, Vector]:
    """Draw noise for both sides as it is in the log: independent where both were logged, else by E."""
    rng = np.random.default_rng(0)
    n = len(next(iter(logged.values())))
    noise = sigma * rng.normal(size=(n, len(sigma)))
    noise_m = sigma_m * rng.normal(size=(n, len(sigma_m)))
    if "joint_position" not in logged:
        return noise_m @ model.joint_from_motor.T, noise_m
    return noise, noise_m if "motor_position" in logged else noise @ model.motor_from_joint.T


def _held(motion: Motion, still: np.ndarray, still_m: np.ndarray) -> Motion:
    """Replace joints and motors that do not move beyond their noise by constants."""
    arrays = {}
    for names, held in ((("q", "v", "a"), still), (("q_m", "v_m", "a_m"), still_m)):
        for name in names:
            value = getattr(motion, name).copy()
            value[:, held] = np.mean(value[:, held], axis=0) if name in ("q", "q_m") else 0.0
            arrays[name] = value
    return replace(motion, **arrays)


def _shape(term: Term, motion: Motion) -> tuple[float, ...]:
    effect = CATALOGUE[term.effect]
    if term.shape:
        return term.shape
    if effect.nuisance_shape:
        noise = float(np.abs(term.place.weights(motion.model)) @ motion.velocity_noise)
        return (max(2 * noise, SIGN_WIDTH * speed_scale([motion], term.place)),)
    return effect.grid([motion], term.place)[0]


def _check_channels(recording: Recording) -> None:
    for what in ("torque", "position"):
        if not {f"motor_{what}", f"joint_{what}"} & set(recording.channels):
            found = ", ".join(recording.channels)
            message = f"identify needs motor_{what}_i or joint_{what}_i; it has {found}"
            raise RecordingError(message, source=recording.source)


def _check_units(signals: Signals, model: CableModel) -> None:
    for found in check(signals, model):
        if found.kind == "units" and model.manipulator.pulleys is not None:
            source = signals.recording.source
            raise RecordingError(found.message, source=source, place=f"column {found.channel}")


def _torque_check(model: CableModel, signals: Signals) -> tuple[str, ...]:
    """Where both torques are logged the motors' is fitted; say how well the joints' agrees."""
    if not {"motor_torque", "joint_torque"} <= set(signals.channels):
        return ()
    difference = signals.channels["motor_torque"] - model.motor_torque(signals.channels["joint_torque"])
    rms = np.sqrt(np.mean(difference[signals.valid] ** 2, axis=0)) if signals.valid.any() else np.zeros(0)
    unit = either(motor_units(model, True))
    return (f"motor torques are fitted; E' joint_torque differs from them by {_list(rms)} {unit} rms",)


def _list(values: Vector) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def _outside(motion: Motion, tau_m: Vector) -> dict[str, np.ndarray]:
    """Mark samples at which a cable leaves its pulley or, by the measured torque, one of its sides is slack."""
    model = motion.model
    if model.manipulator.pulleys is None:
        return {}
    state = cable_state(model, motion.q, tau_m @ model.motor_from_joint, motion.pretension or None)
    reasons = {f"joint {k + 1} past the wrap of its cable": past for k, past in enumerate(state.past_wrap.T)}
    if motion.pretension:
        slack = state.slack[..., 0] | state.slack[..., 1]
        reasons |= {f"cable {k + 1} slack": column for k, column in enumerate(slack.T)}
    return reasons
