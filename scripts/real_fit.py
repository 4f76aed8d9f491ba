r"""Fits of real robots by the metric of their publications: signals, columns of named laws, bounded least squares.

A law f along a coordinate w'q_m of the motors enters as :math:`\tau_m = w f(w' \dot q_m)`, which conserves power. All
columns and the torque pass the one filter of the metric.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numba
import numpy as np
import yaml
from scipy.optimize import nnls
from scipy.signal import butter, sosfiltfilt

from cdm_pin.base import BaseParameters, base_parameters
from cdm_pin.consistency import consistent_standard
from cdm_pin.files import read_yaml
from cdm_pin.model import CableModel
from cdm_pin.recording import Recording, load_recording
from cdm_pin.regressor import motor_regressor
from cdm_pin.signals_filters import differentiate, lowpass, resample_uniform

THRESHOLDS = (0.003, 0.01, 0.03, 0.06, 0.12, 0.3)  # of the Maxwell-slip elements, as shares of the coordinate's range
TRIM = 200  # samples left out at each end, as published


@dataclass(frozen=True)
class Treatment:
    """How signals are prepared.

    Attributes
    ----------
    metric : float
        Cut-off of the zero-phase Butterworth filter (order 6) of the metric [Hz].
    light : float or None
        Low-pass of the motion that friction columns are built from [Hz]; None: as published, the metric's filter on
        positions, logged velocities and their slopes, and none on the columns made of them.
    acceleration : tuple of float
        Low-pass of the motion that the rigid body gets, per motor [Hz].
    logged : tuple of bool
        Whether a motor's velocity is the logged one there (else the derivative of its position).
    """

    metric: float
    light: float | None = None
    acceleration: tuple[float, ...] = ()
    logged: tuple[bool, ...] = ()


@dataclass(frozen=True)
class Log:
    """A recording prepared: arrays of shape (n, n_motors), in motor coordinates.

    Attributes
    ----------
    name : str
    rate : float
        [Hz].
    q, v : ndarray
        For friction columns.
    rigid : tuple of three ndarray
        Position, velocity, acceleration for the rigid body and rotors.
    torque : ndarray
        Filtered.
    raw_velocity : ndarray or None
        As logged.
    filter : callable
        Of the columns, along the first axis: the metric's.
    """

    name: str
    rate: float
    q: np.ndarray
    v: np.ndarray
    rigid: tuple[np.ndarray, np.ndarray, np.ndarray]
    torque: np.ndarray
    raw_velocity: np.ndarray | None
    filter: Callable[[np.ndarray], np.ndarray]

    @property
    def kept(self) -> slice:
        """Samples that count: all but the ends."""
        return slice(TRIM, len(self.q) - TRIM)

    def along(self, w: Sequence[float]) -> np.ndarray:
        """Position along the coordinate w'q_m, shape (n,)."""
        return self.q @ np.asarray(w)

    def reach(self, w: Sequence[float]) -> float:
        """Range of the coordinate w'q_m."""
        return float(np.ptp(self.along(w)))

    def middle(self, w: Sequence[float]) -> float:
        """Middle of the range of the coordinate w'q_m."""
        return float(np.ptp(self.along(w)) / 2 + self.along(w).min())


def prepare(recording: Recording, model: CableModel, treatment: Treatment, rate: float | None = None) -> Log:
    """Filter and differentiate a recording as a treatment says."""
    side = "motor" if "motor_torque" in recording.channels else "joint"
    time = recording.time
    keep = np.concatenate([[True], np.diff(time) > 0])
    rate = rate or round(float(1 / np.median(np.diff(time[keep]))), 3)

    def channel(what: str) -> np.ndarray | None:
        x = recording.channels.get(f"{side}_{what}")
        return None if x is None else resample_uniform(time[keep], x[keep], rate)[1]

    q, v, tau = channel("position"), channel("velocity"), channel("torque")
    assert q is not None and tau is not None
    sos = butter(6, treatment.metric / (0.5 * rate), output="sos")

    def metric(x: np.ndarray) -> np.ndarray:
        return sosfiltfilt(sos, x, axis=0)

    if treatment.light is None:
        assert v is not None
        slope = np.gradient(v, 1 / rate, axis=0)
        motion = metric(q), metric(v)
        return Log(recording.name, rate, *motion, (*motion, metric(slope)), metric(tau), v, lambda x: x)
    light = lowpass(q, rate, treatment.light)
    low = np.stack([lowpass(q[:, i], rate, f) for i, f in enumerate(treatment.acceleration)], axis=1)
    speed = differentiate(low, rate)
    for i, logged in enumerate(treatment.logged):
        if logged and v is not None:
            speed[:, i] = lowpass(v[:, i], rate, treatment.acceleration[i])
    rigid = low, speed, differentiate(speed, rate)
    return Log(recording.name, rate, light, differentiate(light, rate), rigid, metric(tau), v, metric)


@dataclass(frozen=True)
class Law:
    """A named law: its coordinate, its columns, and whether its coefficients can be negative.

    Attributes
    ----------
    name : str
    w : tuple of float
        Weights of the motors.
    series : callable
        Log -> (n, k).
    nonnegative : bool
    """

    name: str
    w: tuple[float, ...]
    series: Callable[[Log], np.ndarray]
    nonnegative: bool = False

    def columns(self, log: Log) -> np.ndarray:
        """Give torque columns, shape (n, n_motors, k), not filtered."""
        return np.asarray(self.w)[:, None] * self.series(log)[:, None, :]


def viscous(name: str, w) -> Law:
    """Viscous friction."""
    return Law(f"viscous friction, {name}", tuple(w), lambda log: (log.v @ np.asarray(w))[:, None], True)


def coulomb(name: str, w) -> Law:
    """Coulomb friction."""
    return Law(f"Coulomb friction, {name}", tuple(w), lambda log: np.sign(log.v @ np.asarray(w))[:, None], True)


def offset(name: str, w) -> Law:
    """Constant torque."""
    return Law(f"offset, {name}", tuple(w), lambda log: np.ones((len(log.q), 1)))


def rotor(name: str, w) -> Law:
    """Inertia of a rotor."""
    return Law(f"rotor inertia, {name}", tuple(w), lambda log: (log.rigid[2] @ np.asarray(w))[:, None], True)


def hysteresis(name: str, w, reach: float, thresholds: Sequence[float] = THRESHOLDS) -> Law:
    """Maxwell-slip elements side by side: friction with memory of the angle; thresholds are shares of `reach`."""
    return Law(
        f"hysteresis, {name}",
        tuple(w),
        lambda log: np.stack([stop(log.along(w), share * reach) for share in thresholds], axis=1),
        True,
    )


def spring(name: str, w) -> Law:
    """Linear spring; where it rests is part of the offset."""
    return Law(f"spring, {name}", tuple(w), lambda log: log.along(w)[:, None], True)


def position_torque(name: str, w, middle: float, reach: float, order: int) -> Law:
    """Torque that depends on position alone (springs, electrical cables), a polynomial."""
    powers = range(1, order + 1)
    return Law(
        f"position-dependent torque, {name}",
        tuple(w),
        lambda log: np.stack([(2 * (log.along(w) - middle) / reach) ** k for k in powers], axis=1),
    )


def position_friction(name: str, w, middle: float, reach: float, share: float = 0.01, nodes: int = 5) -> Law:
    """Friction whose level, dry and viscous, varies with position: linear between nodes, constant beyond the last."""

    def series(log: Log) -> np.ndarray:
        x = (log.along(w) - middle) / reach
        at = np.linspace(-0.5, 0.5, nodes)
        level = np.stack([np.interp(x, at, unit) for unit in np.eye(nodes)], axis=1)
        z, v = stop(log.along(w), share * reach), log.v @ np.asarray(w)
        return np.concatenate([level * z[:, None], level * v[:, None]], axis=1)

    return Law(f"position-dependent friction, {name}", tuple(w), series, True)


def harmonics(name: str, w, orders: Sequence[int]) -> Law:
    """Torque that depends on an angle as sines and cosines of its multiples (a spring on a crank)."""
    return Law(
        f"crank spring, {name}",
        tuple(w),
        lambda log: np.stack([f(k * log.along(w)) for k in orders for f in (np.sin, np.cos)], axis=1),
    )


def vibration(name: str, w, motor: int, band: tuple[float, float]) -> Law:
    """Vibration of one motor in a band, seen in its logged velocity: what its controller answers to disturbances."""

    def series(log: Log) -> np.ndarray:
        assert log.raw_velocity is not None
        v = log.raw_velocity[:, motor]
        inside = lowpass(v, log.rate, band[1]) - lowpass(v, log.rate, band[0])
        return np.stack([differentiate(inside, log.rate), inside], axis=1)

    return Law(f"vibration, {name}", tuple(w), series)


@numba.njit(cache=True)
def stop(x: np.ndarray, limit: float) -> np.ndarray:
    """Torque of an element that is elastic up to `limit` of its coordinate and slides beyond, over its limit."""
    z = np.zeros(len(x))
    for k in range(1, len(x)):
        z[k] = min(1.0, max(-1.0, z[k - 1] + (x[k] - x[k - 1]) / limit))
    return z


@dataclass(frozen=True)
class Structure:
    """A robot's rigid body and a list of laws."""

    model: CableModel
    base: BaseParameters
    laws: tuple[Law, ...]
    free_signs: bool = False
    cache: dict = field(default_factory=dict, compare=False)

    @property
    def nonnegative(self) -> np.ndarray:
        """Which columns cannot be negative, shape (p,)."""
        signs = [np.zeros(self.base.rank, bool)]
        for law, (_, width) in zip(self.laws, self._widths, strict=True):
            signs.append(np.full(width, law.nonnegative and not self.free_signs))
        return np.concatenate(signs)

    @property
    def _widths(self):
        return [(law.name, self.cache[law.name]) for law in self.laws]

    def columns(self, log: Log) -> np.ndarray:
        """Give all columns of a log, filtered, shape (n, n_motors, p)."""
        E = self.model.joint_from_motor
        q, v, a = (x @ E.T for x in log.rigid)
        parts = [motor_regressor(self.model, q + self.model.offset, v, a)[..., self.base.columns]]
        for law in self.laws:
            parts.append(law.columns(log))
            self.cache[law.name] = parts[-1].shape[2]
        return log.filter(np.concatenate(parts, axis=2))


def structure(model: CableModel, laws: Sequence[Law], free_signs: bool = False) -> Structure:
    """Join a robot and laws; bodies without mass in the file stay massless."""
    pi = model.standard_parameters
    columns = [k for k in range(len(pi)) if pi[10 * (k // 10)] > 0]
    return Structure(model, base_parameters(model, columns=columns), tuple(laws), free_signs)


def fit(A: np.ndarray, y: np.ndarray, nonnegative: np.ndarray, ridge: float = 1e-2, rounds: int = 8) -> np.ndarray:
    """Fit by least squares weighted per motor with its own residual, a little ridge, and bounds.

    Parameters
    ----------
    A : ndarray, shape (n, n_motors, p)
    y : ndarray, shape (n, n_motors)
    nonnegative : ndarray of bool, shape (p,)
    ridge : float
        Of columns of norm 1.
    rounds : int
        Of re-weighting.
    """
    weight = 1 / np.std(y, axis=0)
    x = np.zeros(A.shape[2])
    for _ in range(rounds):
        rows, rhs = (A * weight[:, None]).reshape(-1, A.shape[2]), (y * weight).ravel()
        scale = np.linalg.norm(rows, axis=0)
        scale[scale == 0] = 1.0
        gram = rows.T @ rows / np.outer(scale, scale) + ridge**2 * np.eye(len(scale))
        x = bounded(gram, rows.T @ rhs / scale, nonnegative) / scale
        weight = 1 / np.sqrt(np.mean((y - A @ x) ** 2, axis=0))
    return x


def bounded(gram: np.ndarray, rhs: np.ndarray, nonnegative: np.ndarray) -> np.ndarray:
    """Minimise x'Gx - 2 b'x with some x >= 0: the free ones are eliminated, the rest solved as NNLS."""
    free = ~nonnegative
    if not nonnegative.any():
        return np.linalg.solve(gram, rhs)
    solved = np.linalg.solve(gram[np.ix_(free, free)], np.column_stack([gram[np.ix_(free, nonnegative)], rhs[free]]))
    schur = gram[np.ix_(nonnegative, nonnegative)] - gram[np.ix_(nonnegative, free)] @ solved[:, :-1]
    reduced = rhs[nonnegative] - gram[np.ix_(nonnegative, free)] @ solved[:, -1]
    L = np.linalg.cholesky(schur + 1e-10 * np.trace(schur) / len(schur) * np.eye(len(schur)))
    x = np.empty(len(rhs))
    x[nonnegative], _ = nnls(L.T, np.linalg.solve(L, reduced), maxiter=50 * len(schur))
    x[free] = solved[:, -1] - solved[:, :-1] @ x[nonnegative]
    return x


def consistent(robot: Structure, A: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Replace the rigid body of a weighted fit by the nearest one that bodies of positive mass can have."""
    weight = 1 / np.sqrt(np.mean((y - A @ x) ** 2, axis=0))
    rows = (A * weight[:, None]).reshape(-1, A.shape[2])
    found = consistent_standard(robot.base.matrix, x, rows.T @ rows, robot.model.standard_parameters)
    return np.concatenate([robot.base.values(found.parameters), found.free])


def relative_error(y: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Norm of the error over the norm of the torque, per motor."""
    return np.linalg.norm(y - predicted, axis=0) / np.linalg.norm(y, axis=0)


def transfer(
    robot: Structure,
    logs: Mapping[str, Log],
    train: Sequence[str],
    test: str,
    *,
    window: slice | None = None,
    ridge: float = 1e-2,
    physical: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Fit on some logs and judge on another.

    Returns
    -------
    on_train, on_test : ndarray, shape (n_motors,)
        Relative errors; the test's within `window`, default all samples that count.
    """
    columns = {name: robot.columns(logs[name]) for name in {*train, test}}
    A = np.concatenate([columns[name][logs[name].kept] for name in train])
    y = np.concatenate([logs[name].torque[logs[name].kept] for name in train])
    x = fit(A, y, robot.nonnegative, ridge)
    if physical:
        x = consistent(robot, A, y, x)
    judged = window or logs[test].kept
    return relative_error(y, A @ x), relative_error(logs[test].torque[judged], columns[test][judged] @ x)


def phase_folds(robot: Structure, log: Log, period: int, folds: int = 4, ridge: float = 1e-2) -> np.ndarray:
    """Cross-validate within one periodic log: parts of the period are left out in turn, all its repeats together."""
    A, kept = robot.columns(log), np.arange(log.kept.start, log.kept.stop)
    part = (kept - kept[0]) % period * folds // period
    error, power = 0.0, 0.0
    for fold in range(folds):
        learn, judge = kept[part != fold], kept[part == fold]
        x = fit(A[learn], log.torque[learn], robot.nonnegative, ridge)
        error = error + np.sum((log.torque[judge] - A[judge] @ x) ** 2, axis=0)
        power = power + np.sum(log.torque[judge] ** 2, axis=0)
    return np.sqrt(error / power)


def load(path: Path, model: CableModel, layout: Path, rate: float | None = None) -> Recording:
    """Read a raw file through the column mapping of its data set; ``{}`` in its name stands for the names of arrays."""
    content = read_yaml(layout) | ({"rate": rate} if rate else {}) | {"label": path.name.split(".")[0]}
    if "files" in content:
        content["files"] = {name: str(path.resolve()).format(name) for name in content["files"]}
    else:
        content["file"] = str(path.resolve())
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "recording.yaml"
        target.write_text(yaml.safe_dump(content))
        return load_recording(target, model)
