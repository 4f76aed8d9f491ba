"""Recording -> Signals: one uniform grid, one zero-phase filter for everything, derivatives, noise floors, notices."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import CubicSpline

from .recording import Recording, Robot, check_widths
from .signals_checks import Check, check, clock_factor, standstill
from .signals_clock import Clock, read_clock, sampling_instants
from .signals_filters import (
    choose_cutoff,
    differentiate,
    lowpass,
    noise_floor,
    quantisation_step,
    quantisation_steps,
    resample_uniform,
    rounding_std,
    torque_bandwidth,
    velocity_cutoff,
)
from .signals_period import Periods, average_channels, estimate_period

__all__ = [
    "Check",
    "Clock",
    "Grid",
    "Periods",
    "Signals",
    "average_periods",
    "check",
    "choose_cutoff",
    "decimated",
    "differentiate",
    "estimate_period",
    "logged_steps",
    "lowpass",
    "motion_at_rows",
    "noise_floor",
    "prepare",
    "quantisation_step",
    "read_clock",
    "read_grid",
    "resample_uniform",
    "sampling_instants",
    "standstill",
    "torque_bandwidth",
]

_MOTION = ("position", "velocity", "acceleration")
_POSITIONS = ("joint_position", "motor_position")


@dataclass(frozen=True)
class Signals:
    """A recording made fit for fitting; arrays of `n` samples on one uniform grid.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Seconds, uniform.
    rate : float
        Samples per second [Hz].
    cutoff : float
        Of the common filter [Hz].
    channels : dict of str to ndarray, shape (n, width)
        Every recorded quantity through the common filter; velocities and accelerations are the derivatives of the
        filtered positions, wherever a position was recorded.
    noise : dict of str to ndarray, shape (width,)
        Standard deviation of the noise as logged, per recorded quantity: between periods where the motion is periodic,
        else from the quiet end of the spectrum.
    valid : ndarray of bool, shape (n,)
        False in and around gaps and at the ends, where the filter has no neighbours.
    recording : Recording
        Where it all came from, untouched.
    notices : tuple of str
        What was found and what was done about it.
    floor : dict of str to ndarray, shape (width,)
        Standard deviation of the noise that the common filter leaves, per recorded quantity.
    light : dict of str to ndarray, shape (n, width)
        Positions, velocities, accelerations through the light filter only, to build columns that are not linear in the
        motion (the sign of velocity) before the common filter is applied to them.
    light_cutoff : float
        Of the light filter [Hz].
    logged : dict of str to ndarray, shape (n, width)
        The recorded quantities on the grid, not filtered.
    order : int
        Of each of the two passes of the filters.
    steps : dict of str to ndarray, shape (width,)
        In which each recorded quantity was logged, zero where there are none (`logged_steps`).
    period : float or None
        Of the motion [s], where it repeats.
    unsure : float
        By how much the samples' instants may still be off [s] (`Clock`).
    """

    time: np.ndarray
    rate: float
    cutoff: float
    channels: dict[str, np.ndarray]
    noise: dict[str, np.ndarray]
    valid: np.ndarray
    recording: Recording
    notices: tuple[str, ...] = ()
    floor: dict[str, np.ndarray] = field(default_factory=dict)
    light: dict[str, np.ndarray] = field(default_factory=dict)
    light_cutoff: float = np.inf
    logged: dict[str, np.ndarray] = field(default_factory=dict)
    order: int = 4
    steps: dict[str, np.ndarray] = field(default_factory=dict)
    period: float | None = None
    unsure: float = 0.0

    def filter(self, x: np.ndarray) -> np.ndarray:
        """Pass columns on the same grid, shape (n, ...), through the common filter."""
        return lowpass(x, self.rate, self.cutoff, self.order)


@dataclass(frozen=True)
class Grid:
    """A recording on one uniform grid, before any filter.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Seconds, uniform.
    rate : float
        Samples per second [Hz].
    logged : dict of str to ndarray, shape (n, width)
        The recorded quantities.
    stamps : ndarray, shape (m,)
        When the rows were taken that were kept [s].
    steps : dict of str to ndarray, shape (width,)
        As in `Signals`.
    noise : dict of str to ndarray, shape (width,)
        From the quiet end of the spectra.
    notices : tuple of str
        What was found about the clock and done about it.
    unsure : float
        As in `Signals`.
    """

    time: np.ndarray
    rate: float
    logged: dict[str, np.ndarray]
    stamps: np.ndarray
    steps: dict[str, np.ndarray]
    noise: dict[str, np.ndarray]
    notices: tuple[str, ...]
    unsure: float = 0.0


def read_grid(recording: Recording, model: Robot | None = None, *, repair_clock: bool = True) -> Grid:
    """Bring a recording onto one uniform grid; see `prepare`.

    Raises
    ------
    RecordingError
        If the recording contradicts itself or the model.
    """
    if model is not None:
        check_widths(recording, model)
    clock = read_clock(recording, repair=repair_clock)
    time, rate, logged = _on_grid(recording, clock)
    steps = logged_steps(recording)
    notices = [*recording.notices, *clock.notices]
    stamps = clock.time[clock.keep]
    factor = _clock_factor(recording, logged, rate, steps) if repair_clock else 1.0
    if factor != 1.0:
        notices.append(_wrong_rate(rate, factor))
        time, stamps, rate = time * factor, stamps * factor, rate / factor
    noise = {name: noise_floor(x, rate, steps=steps[name]) for name, x in logged.items()}
    return Grid(time, rate, logged, stamps, steps, noise, tuple(notices), clock.unsure * factor)


def prepare(
    recording: Recording,
    model: Robot | None = None,
    *,
    cutoff: float | None = None,
    light_cutoff: float | None = None,
    rate: float | None = None,
    order: int = 4,
    max_gap: float | None = None,
    repair_clock: bool = True,
    grid: Grid | None = None,
) -> Signals:
    """Resample, filter and differentiate a recording, and say what was found in it.

    Parameters
    ----------
    recording : Recording
    model : optional
        A model with `joints`, `motors`, `joint_from_motor`, `motor_from_joint`: widths and units are held against it.
    cutoff : float, optional
        Of the common filter [Hz]; default the lower of where the positions' spectra meet their noise
        (`choose_cutoff`) and where the torques cease to follow the motion (`torque_bandwidth`).
    light_cutoff : float, optional
        Of the light filter [Hz]; default the widest that leaves 1 % of noise in the velocities (`velocity_cutoff`),
        never below the common one.
    rate : float, optional
        Of the grid [Hz]; default the recording's own. A lower one limits both cut-offs to 0.4 of it.
    order : int
        Of each of the two Butterworth passes.
    max_gap : float, optional
        Longest step between samples that is bridged without a word [s]; default half a period of the cut-off,
        at least 2.5 steps.
    repair_clock : bool
        Whether a wrong nominal rate, and stamps that all joints contradict, may be corrected.
    grid : Grid, optional
        The recording on its grid, where `read_grid` has brought it there already.

    Raises
    ------
    RecordingError
        If the recording contradicts itself (degrees beside radians) or the model.
    """
    grid = grid or read_grid(recording, model, repair_clock=repair_clock)
    own_rate, logged, notices = grid.rate, grid.logged, list(grid.notices)
    highest = 0.4 * min(own_rate, rate or own_rate)
    cutoff, reason = (cutoff, "as asked for") if cutoff else _common_cutoff(logged, own_rate, grid.steps)
    cutoff = min(cutoff, highest)
    notices.append(f"one zero-phase low-pass of {cutoff:.3g} Hz for everything, {reason}; samples at {own_rate:.4g} Hz")
    light_cutoff = min(light_cutoff or max(cutoff, _light_cutoff(logged, own_rate, grid.steps)), highest)
    light = {name: x for name, x in _filtered(logged, own_rate, light_cutoff, order).items() if _is_motion(name)}
    longest = max_gap or max(2.5 / own_rate, 0.5 / cutoff)
    signals = Signals(
        time=grid.time,
        rate=own_rate,
        cutoff=cutoff,
        channels=_filtered(logged, own_rate, cutoff, order),
        noise=grid.noise,
        valid=_valid(grid.time, grid.stamps, 1.5 / cutoff, longest, notices),
        recording=recording,
        floor={name: noise_floor(x, own_rate, cutoff, grid.steps[name]) for name, x in logged.items()},
        light=light,
        light_cutoff=light_cutoff,
        logged=logged,
        order=order,
        steps=grid.steps,
        unsure=grid.unsure,
    )
    signals = _with_period(signals, notices)
    notices += [f"{c.channel}: {c.message}".removeprefix(": ") for c in check(signals, model)]
    notices += _said(grid.steps)
    signals = replace(signals, notices=tuple(notices))
    return signals if rate is None else decimated(signals, rate)


def average_periods(signals: Signals, period: float | None = None) -> Periods:
    """Average the filtered channels over periods, with the covariance between periods.

    Parameters
    ----------
    signals : Signals
    period : float, optional
        [s]; default the one found by `prepare`.

    Raises
    ------
    ValueError
        If the motion does not repeat and no period is given.
    """
    period = period or signals.period
    if period is None:
        raise ValueError("the motion does not repeat: no period to average over")
    return average_channels(signals.time, signals.channels, signals.valid, period, signals.rate)


def motion_at_rows(recording: Recording, side: str, cutoff: float | None = None) -> dict[str, np.ndarray]:
    """Give position, velocity and acceleration of one side at every row, as logged, else differentiated.

    What is not logged is the derivative of what is: low-passed at the cut-off where noise begins, differentiated on a
    uniform grid, carried back to the rows' stamps by a cubic spline. No row is left out.

    Parameters
    ----------
    recording : Recording
    side : str
        "joint" or "motor".
    cutoff : float, optional
        [Hz]; default `choose_cutoff` of the positions.

    Returns
    -------
    dict of str to ndarray, shape (n, width)
        "position", "velocity", "acceleration".
    """
    logged = {what: recording.channels.get(f"{side}_{what}") for what in _MOTION}
    found = {what: x for what, x in logged.items() if x is not None}
    keep = np.concatenate([[True], np.diff(recording.time) > 0])
    time = recording.time[keep]
    rate = _rate(time)
    if len(found) == len(_MOTION):
        return found
    limit = cutoff or _row_cutoff(time, found["position"][keep], rate)
    for of, derivative in (("position", "velocity"), ("velocity", "acceleration")):
        if derivative not in found:
            grid, x = resample_uniform(time, found[of][keep], rate)
            slope = differentiate(lowpass(x, rate, limit) if limit < 0.39 * rate else x, rate)
            found[derivative] = _carried(grid, slope, recording.time)
    return found


def _row_cutoff(time: np.ndarray, position: np.ndarray, rate: float) -> float:
    return choose_cutoff(resample_uniform(time, position, rate)[1], rate, steps=quantisation_steps(position))


def _carried(grid: np.ndarray, x: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Read values on a grid at other times; exactly, where the times are the grid's."""
    if len(grid) == len(time) and np.max(np.abs(grid - time)) < 1e-6 * (grid[-1] - grid[0]) / len(grid):
        return x
    if len(grid) < 4:
        return np.column_stack([np.interp(time, grid, column) for column in x.T])
    return CubicSpline(grid, x)(np.clip(time, grid[0], grid[-1]))


def _rate(time: np.ndarray) -> float:
    """Give the rate of increasing stamps [Hz]: whole steps, as many as fit in each difference, over their span."""
    if len(time) < 2:
        return 1.0
    steps = np.diff(time)
    return float(np.sum(np.round(steps / np.median(steps))) / (time[-1] - time[0]))


def _on_grid(recording: Recording, clock: Clock) -> tuple[np.ndarray, float, dict[str, np.ndarray]]:
    time = clock.time[clock.keep]
    rate = _rate(recording.time[clock.keep])
    logged, grid = {}, time[:1]
    for name, x in recording.channels.items():
        grid, logged[name] = resample_uniform(time, x[clock.keep], rate)
    return grid, rate, logged


def _positions(logged: dict[str, np.ndarray]) -> np.ndarray | None:
    found = [logged[name] for name in _POSITIONS if name in logged]
    return np.hstack(found) if found else None


def _clock_factor(
    recording: Recording, logged: dict[str, np.ndarray], rate: float, steps: dict[str, np.ndarray]
) -> float:
    """Correct only a clock that was counted, not one that was stamped: stamps are believed over velocities."""
    positions = _positions(logged)
    if positions is None or len(positions) < 64:
        return 1.0
    cutoff = choose_cutoff(positions, rate, derivative=1, steps=_position_steps(logged, steps))
    factor = clock_factor(logged, rate, cutoff, recording.source)
    counted = np.ptp(np.diff(recording.time)) < 1e-6 / rate
    return factor if counted else 1.0


def _wrong_rate(rate: float, factor: float) -> str:
    message = f"recorded velocities say that a second of this log lasts {factor:.4g} s: "
    return message + f"taken as sampled at {rate / factor:.4g} Hz, not {rate:.4g} Hz"


def _common_cutoff(logged: dict[str, np.ndarray], rate: float, steps: dict[str, np.ndarray]) -> tuple[float, str]:
    positions = _positions(logged)
    if positions is None:
        return 0.4 * rate, "as there is no position to choose by"
    cutoff = choose_cutoff(positions, rate, steps=_position_steps(logged, steps))
    reason = "where the positions' spectra meet their noise"
    torque = logged.get("motor_torque", logged.get("joint_torque"))
    limit = None if torque is None else torque_bandwidth(positions, torque, rate)
    if limit is not None and limit < cutoff:
        cutoff, reason = limit, "up to where the torques follow the motion"
    return cutoff, reason


def _light_cutoff(logged: dict[str, np.ndarray], rate: float, steps: dict[str, np.ndarray]) -> float:
    positions = _positions(logged)
    if positions is None:
        return 0.4 * rate
    return velocity_cutoff(positions, rate, steps=_position_steps(logged, steps))


def _position_steps(logged: dict[str, np.ndarray], steps: dict[str, np.ndarray]) -> np.ndarray:
    return np.hstack([steps[name] for name in _POSITIONS if name in logged])


def _is_motion(name: str) -> bool:
    return name.partition("_")[2] in _MOTION


def _filtered(logged: dict[str, np.ndarray], rate: float, cutoff: float, order: int) -> dict[str, np.ndarray]:
    channels = {name: lowpass(x, rate, cutoff, order) for name, x in logged.items()}
    for side in ("joint", "motor"):
        given = f"{side}_position" in channels
        for of, derivative in (("position", "velocity"), ("velocity", "acceleration")):
            if f"{side}_{of}" in channels and (given or f"{side}_{derivative}" not in channels):
                channels[f"{side}_{derivative}"] = differentiate(channels[f"{side}_{of}"], rate)
    return channels


def _valid(grid: np.ndarray, time: np.ndarray, margin: float, max_gap: float, notices: list[str]) -> np.ndarray:
    """Mark what is far enough from the ends and from gaps; a short record gives up a tenth at each end at most."""
    margin = min(margin, 0.1 * (grid[-1] - grid[0]))
    valid = (grid >= grid[0] + margin) & (grid <= grid[-1] - margin)
    gaps = np.flatnonzero(np.diff(time) > max_gap)
    for k in gaps:
        valid &= (grid < time[k] - margin) | (grid > time[k + 1] + margin)
    if len(gaps):
        longest = np.max(np.diff(time)[gaps])
        notices.append(f"{len(gaps)} gap(s), the longest {longest:.3g} s: left out with {margin:.2g} s around each")
    if len(grid) < 32:
        notices.append(f"only {len(grid)} samples: too few to judge noise or to filter well")
    return valid


def _with_period(signals: Signals, notices: list[str]) -> Signals:
    """Find the period, and where there is one, read the noise off what differs between periods."""
    names = [name for name in ("joint_position", "motor_position") if name in signals.channels]
    if not names or signals.valid.sum() < 64:
        return signals
    inside = np.flatnonzero(signals.valid)
    x = np.hstack([signals.channels[name] for name in names])[inside[0] : inside[-1] + 1]
    period = estimate_period(x, signals.rate)
    if period is None:
        return signals
    turns = (signals.time[-1] - signals.time[0]) / period
    notices.append(f"the motion repeats every {period:.5g} s ({period * signals.rate:.5g} samples), {turns:.2g} times")
    deviations = []
    filtered = {name: signals.channels[name] for name in signals.logged}
    for channels, cutoff in ((signals.logged, None), (filtered, signals.cutoff)):
        periods = average_channels(signals.time, channels, signals.valid, period, signals.rate)
        rounding = {name: rounding_std(signals.steps[name], signals.rate, cutoff) for name in channels}  # repeats, too
        deviations.append({name: np.maximum(x, rounding[name]) for name, x in periods.deviation.items()})
    if np.sum(periods.count > 1) < 0.25 * len(periods.count):
        return replace(signals, period=period)
    return replace(signals, period=period, noise=deviations[0], floor=deviations[1])


def logged_steps(recording: Recording) -> dict[str, np.ndarray]:
    """Give the steps in which every quantity was logged, per channel; zero where there are none.

    They are those of the rows: samples carried over to other instants have none. An encoder that rests does not show
    its steps; they are taken to be the largest of the others on its side.
    """
    found = {name: quantisation_steps(x) for name, x in recording.channels.items()}
    for name in _POSITIONS:
        if name in found:
            rests = np.ptp(recording.channels[name], axis=0) <= found[name].max()
            found[name] = np.where(rests, found[name].max(), found[name])
    return found


def _said(steps: dict[str, np.ndarray]) -> list[str]:
    notices = []
    for name in (*_POSITIONS, "joint_torque", "motor_torque"):
        if name in steps and steps[name].any():
            notices.append(f"{name} comes in steps of {', '.join(f'{s:.3g}' if s else '-' for s in steps[name])}")
    return notices


def decimated(signals: Signals, rate: float) -> Signals:
    """Give signals at a lower rate [Hz]; what was not filtered passes a low-pass first."""

    def carry(group: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {name: resample_uniform(signals.time, x, rate)[1] for name, x in group.items()}

    time = signals.time[0] + np.arange(int((signals.time[-1] - signals.time[0]) * rate * (1 + 1e-12) + 1e-6) + 1) / rate
    valid = np.interp(time, signals.time, signals.valid) > 0.999
    logged = {name: lowpass(x, signals.rate, 0.4 * rate, signals.order) for name, x in signals.logged.items()}
    carried = {"channels": carry(signals.channels), "light": carry(signals.light), "logged": carry(logged)}
    return replace(signals, time=time, rate=rate, valid=valid, **carried)
