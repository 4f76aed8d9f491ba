"""What is wrong with a log, in plain words: clock, units, lagging velocities, torque sign, saturation, standstill."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .errors import RecordingError
from .signals_filters import differentiate, lowpass, moves, quantisation_step, stretches

if TYPE_CHECKING:
    from .recording import Robot
    from .signals import Signals

DEGREES = 180 / np.pi


@dataclass(frozen=True)
class Check:
    """One thing found in a log.

    Attributes
    ----------
    kind : str
        "velocity", "units", "torque_sign", "saturation", "standstill", "locked" or "transmission".
    channel : str
        The column it is about, such as "joint_velocity_5"; a quantity or "" where it is about all.
    message : str
        What was found, in plain words.
    """

    kind: str
    channel: str
    message: str


def check(signals: Signals, model: Robot | None = None) -> tuple[Check, ...]:
    """Look for what robots and loggers get wrong; nothing is changed.

    Parameters
    ----------
    signals : Signals
    model : optional
        A model with `joint_from_motor`, `motor_from_joint` and `offset`; relates motors to joints.

    Raises
    ------
    RecordingError
        If positions and velocities, or joint and motor positions, are in different units.
    """
    return (
        *velocity_checks(signals),
        *_range_checks(signals),
        *_transmission_checks(signals, model),
        *_torque_sign_checks(signals, model),
        *_saturation_checks(signals),
        *_standstill_checks(signals),
    )


def clock_factor(logged: Mapping[str, np.ndarray], rate: float, cutoff: float, source: Path | None = None) -> float:
    """Compare recorded velocities with differentiated positions: how many times longer a second must be.

    Returns
    -------
    float
        Factor on time by which all moving joints agree that the clock is wrong, a ratio of small whole numbers if it is
        within 3 % of one; 1.0 if there is nothing to correct.

    Raises
    ------
    RecordingError
        If a velocity is 57.3 times the derivative of its position, or the inverse: degrees and radians mixed.
    """
    ratios = []
    for name in _recorded_velocities(logged):
        ratio, correlation = _velocity_ratio(logged, name, rate, cutoff)
        correlation = np.where(moves(logged[name.replace("velocity", "position")], rate), correlation, 0.0)
        for j in np.flatnonzero(correlation > 0.7):
            for factor, units in ((DEGREES, "degrees per second"), (1 / DEGREES, "radians per second")):
                if 0.9 < ratio[j] / factor < 1.1:
                    other = "radians" if factor > 1 else "degrees"
                    message = f"is {ratio[j]:.3g} times the derivative of the position: {units} beside {other}?"
                    raise RecordingError(message, source=source, place=f"column {name}_{j + 1}")
        ratios += list(ratio[correlation > 0.9])
    if not ratios or min(ratios) <= 0:
        return 1.0
    common = float(np.median(ratios))
    if abs(common - 1) < 0.1 or np.ptp(ratios) > 0.1 * common:
        return 1.0
    simple = float(Fraction(1 / common).limit_denominator(5))
    return simple if simple > 0 and abs(simple * common - 1) < 0.03 else 1 / common


def velocity_checks(signals: Signals) -> tuple[Check, ...]:
    """Compare each recorded velocity with the differentiated position: scale, lag, agreement."""
    found = []
    for name in _recorded_velocities(signals.logged) if signals.valid.sum() > 32 else ():
        position = name.replace("velocity", "position")
        recorded = signals.filter(signals.logged[name])[signals.valid]
        v = differentiate(signals.channels[position], signals.rate)
        a = differentiate(v, signals.rate)[signals.valid]
        v = v[signals.valid]
        for j in np.flatnonzero(_moving(signals, position)):
            design = np.column_stack([v[:, j], a[:, j], np.ones(len(v))])
            gain, slope, _ = np.linalg.lstsq(design, recorded[:, j], rcond=None)[0]
            r = np.corrcoef(v[:, j], recorded[:, j])[0, 1]
            lag = -slope / gain if gain else 0.0
            faults = [f"is {gain:.2f} of the differentiated position"] if abs(gain - 1) > 0.05 else []
            faults += [f"lags it by {1e3 * lag:.2g} ms"] if lag > max(1e-3, 0.2 / signals.rate) else []
            faults += [f"agrees with it only to r = {r:.3f}"] if r < 0.95 else []
            if faults:
                message = f"{' and '.join(faults)}: positions are differentiated instead"
                found.append(Check("velocity", f"{name}_{j + 1}", message))
    return tuple(found)


def standstill(signals: Signals, shortest: float = 0.25) -> np.ndarray:
    """Mark stretches of at least `shortest` seconds in which nothing moves.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    still = np.ones(len(signals.time), bool)
    for name in ("joint_position", "motor_position"):
        if name in signals.channels:
            v = signals.channels[name.replace("position", "velocity")]
            still &= np.all(np.abs(v) < 0.01 * np.abs(v).max(axis=0) + 1e-12, axis=1)
    for start, stop in stretches(still):
        if stop - start < shortest * signals.rate:
            still[start:stop] = False
    return still


def _recorded_velocities(logged: Mapping[str, np.ndarray]) -> list[str]:
    pairs = (("joint_velocity", "joint_position"), ("motor_velocity", "motor_position"))
    return [velocity for velocity, position in pairs if velocity in logged and position in logged]


def _velocity_ratio(
    logged: Mapping[str, np.ndarray], name: str, rate: float, cutoff: float
) -> tuple[np.ndarray, np.ndarray]:
    """Give what recorded velocities are times the derivative, and how well they agree, shape (width,) each.

    The ratio is that of slow motion: one that was filtered lags and is less the quicker it is.
    """
    v = differentiate(lowpass(logged[name.replace("velocity", "position")], rate, cutoff), rate)
    recorded = lowpass(logged[name], rate, cutoff)
    rates = [v, differentiate(v, rate), differentiate(differentiate(v, rate), rate)]
    ratio, agreement = np.zeros(v.shape[1]), np.zeros(v.shape[1])
    for j, own in enumerate((recorded - recorded.mean(axis=0)).T):
        design = np.column_stack([x[:, j] - x[:, j].mean() for x in rates])
        size = np.linalg.norm(design, axis=0) + 1e-150
        fitted = np.linalg.lstsq(design / size, own, rcond=None)[0]
        ratio[j] = fitted[0] / size[0]
        agreement[j] = np.sign(ratio[j]) * np.linalg.norm(design / size @ fitted) / (np.linalg.norm(own) + 1e-150)
    return ratio, agreement


def _moving(signals: Signals, position: str) -> np.ndarray:
    """Tell which columns of a position move by more than their noise."""
    return np.ptp(signals.channels[position], axis=0) > 10 * signals.noise[position] + 1e-9


def _range_checks(signals: Signals) -> list[Check]:
    found = []
    span = np.ptp(signals.channels["joint_position"], axis=0) if "joint_position" in signals.channels else []
    for j, width in enumerate(span):
        if width > 25:
            message = f"spans {width:.4g}: degrees in place of radians?"
            found.append(Check("units", f"joint_position_{j + 1}", message))
    return found


def _transmission_checks(signals: Signals, model: Robot | None) -> list[Check]:
    if model is None or not {"joint_position", "motor_position"} <= set(signals.channels):
        return []
    q = signals.channels["joint_position"][signals.valid]
    expected = signals.channels["motor_position"][signals.valid] @ model.joint_from_motor.T
    q, expected = q - q.mean(axis=0), expected - expected.mean(axis=0)
    found = []
    for j in np.flatnonzero(_moving(signals, "joint_position") & (np.ptp(expected, axis=0) > 1e-9)):
        ratio = float(q[:, j] @ expected[:, j] / (expected[:, j] @ expected[:, j]))
        name = f"joint_position_{j + 1}"
        if min(abs(ratio / DEGREES - 1), abs(ratio * DEGREES - 1)) < 0.2:
            message = f"is {ratio:.3g} times what the motor positions and the transmission give: degrees and radians?"
            raise RecordingError(message, source=signals.recording.source, place=f"column {name}")
        if ratio < 0 or not 0.8 < ratio < 1.25:
            message = f"is {ratio:.3g} times what the motor positions and the transmission give"
            found.append(Check("transmission", name, message))
    return found


def _torque_sign_checks(signals: Signals, model: Robot | None, threshold: float = 12.0) -> list[Check]:
    """Fit each torque by all accelerations, its own friction, and sines and cosines of all positions.

    The diagonal of a mass matrix is positive and friction dissipates: a sign is wrong where their t-values together are
    below minus `threshold` and neither speaks for it. Where the robot's masses are known the torques that they ask for
    must be opposite too, as the fit knows neither centrifugal torques nor how inertia changes with posture.
    """
    found = []
    for side in ("joint", "motor"):
        motion = _motion_of(signals, side, model)
        if f"{side}_torque" not in signals.channels or motion is None or signals.valid.sum() < 200:
            continue
        stride = max(int(signals.valid.sum() // 8000), 1)
        q, v, a = (x[signals.valid][::stride] for x in motion)
        tau = signals.channels[f"{side}_torque"][signals.valid][::stride]
        independent = 2 * signals.cutoff * signals.valid.sum() / signals.rate
        for j in np.flatnonzero(np.ptp(v, axis=0) > 1e-3 * np.ptp(v)):
            if j >= tau.shape[1] or np.ptp(tau[:, j]) == 0:
                continue
            direction = np.tanh(v[:, j] / (0.1 * v[:, j].std()))
            others = np.column_stack([v[:, j], np.delete(a, j, axis=1), np.ones(len(q)), np.sin(q), np.cos(q)])
            t = _t_values(np.column_stack([direction, a[:, j], others]), tau[:, j], independent)[:2]
            if t.sum() < -threshold and t.max() < 3 and _opposite(signals, side, model, int(j)):
                message = f"accelerates and rubs backwards (inertia and friction negative, t = {t[1]:.0f}, {t[0]:.0f})"
                found.append(Check("torque_sign", f"{side}_torque_{j + 1}", message + ": is its sign wrong?"))
    return found


def _opposite(signals: Signals, side: str, model: Robot | None, j: int) -> bool:
    """Whether a torque and that of the model are of opposite signs, means aside; true where there is no such model."""
    from .dynamics import inverse_dynamics
    from .model import CableModel

    motion = _motion_of(signals, "joint", model)
    if not isinstance(model, CableModel) or motion is None:
        return True
    offset = 0.0 if "joint_position" in signals.channels else model.offset
    q, v, a = (x[signals.valid] for x in motion)
    tau = inverse_dynamics(model, q + offset, v, a)
    if side == "motor":
        tau = model.motor_torque(tau) + model.rotor_inertia * (a @ model.motor_from_joint.T)
    measured = signals.channels[f"{side}_torque"][signals.valid, j]
    return float((tau[:, j] - tau[:, j].mean()) @ (measured - measured.mean())) < 0


def _t_values(design: np.ndarray, y: np.ndarray, independent: float) -> np.ndarray:
    """Give least-squares coefficients over their standard errors, for so many independent samples."""
    design = design / np.maximum(np.abs(design).max(axis=0), 1e-300)
    inverse = np.linalg.pinv(design.T @ design, rcond=1e-12, hermitian=True)
    coefficients = inverse @ (design.T @ y)
    variance = np.mean((y - design @ coefficients) ** 2) * len(y) / max(independent - design.shape[1], 1)
    return coefficients / np.sqrt(variance * np.maximum(np.diag(inverse), 1e-300) + 1e-300)


def _motion_of(signals: Signals, side: str, model: Robot | None) -> tuple[np.ndarray, ...] | None:
    quantities = ("position", "velocity", "acceleration")
    if f"{side}_position" in signals.channels:
        return tuple(signals.channels[f"{side}_{quantity}"] for quantity in quantities)
    other = "joint" if side == "motor" else "motor"
    if model is None or f"{other}_position" not in signals.channels:
        return None
    matrix = model.motor_from_joint if side == "motor" else model.joint_from_motor
    return tuple(signals.channels[f"{other}_{quantity}"] @ matrix.T for quantity in quantities)


def _saturation_checks(signals: Signals) -> list[Check]:
    found = []
    for name in ("joint_torque", "motor_torque"):
        for j, x in enumerate(signals.recording.channels.get(name, np.zeros((0, 0))).T):
            step = quantisation_step(x)
            for limit in (x.max(), x.min()) if np.ptp(x) > 0 else ():
                starts, stops = np.array(stretches(x == limit)).reshape(-1, 2).T
                long = stops - starts >= 3
                entries = np.abs(x[np.maximum(starts[long] - 5, 0)] - limit)
                share = np.sum((stops - starts)[long]) / len(x)
                if share > 0.002 and len(entries) and np.median(entries) > 2 * step:
                    message = f"stands at {limit:.4g} in {100 * share:.2g} % of the samples: saturated?"
                    found.append(Check("saturation", f"{name}_{j + 1}", message))
    return found


def _standstill_checks(signals: Signals) -> list[Check]:
    found = []
    for name in ("joint_position", "motor_position"):
        if name in signals.channels:
            for j in np.flatnonzero(~_moving(signals, name)):
                found.append(Check("locked", f"{name}_{j + 1}", "does not move"))
    share = standstill(signals).mean()
    if 0.02 < share < 1:
        found.append(Check("standstill", "", f"the robot stands still in {100 * share:.2g} % of the time"))
    return found
