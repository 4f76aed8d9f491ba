r"""A cable-driven jaw measured at both ends: output torque and angle from input angle, its history and input torque.

Friction along a cable path remembers tension. With the load x at the far end, the near end pulls with
:math:`T = a_u + b_u x + g_u z` while the cable is drawn in and with :math:`T = a_l + b_l x + g_l z` while it is let
out; in between the load stays (a play operator whose width, Coulomb and capstan friction, grows with the load); z is
the position, for wraps that change with it. Part of the way along the path the same holds with a part of the width:
those tensions stretch the cable,

.. math:: \theta = o - \rho q + c_2 q^2 + c_3 q^3 - \sum_f k_f X_f - k_0 e^{-X_0/x_0} - k_1 e^{-X_1/x_0},

with compliances k >= 0, the exponentials because slack strands are softer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numba
import numpy as np
from scipy.optimize import least_squares, lsq_linear

from cdm_pin.recording import Recording

NODES = (0.0, 0.25, 0.5, 0.75, 1.0)  # shares of the friction path at which tension is followed
SOFT = 0.015  # load below which the cable is softer [N m]
SETTLE = 2.0  # start-up left out [s]


@dataclass(frozen=True)
class Stroke:
    """A recording of the tool at 100 Hz.

    Attributes
    ----------
    time, spindle, drive, jaw, load : ndarray, shape (n,)
        [s], spindle angle [rad], torque at the spindle and at the jaw in closing direction [N m], jaw angle [rad].
    valid : ndarray of bool, shape (n,)
        False during start-up and where it was cut.
    """

    time: np.ndarray
    spindle: np.ndarray
    drive: np.ndarray
    jaw: np.ndarray
    load: np.ndarray
    valid: np.ndarray


def stroke(recording: Recording, step: int = 10) -> Stroke:
    """Average the log over `step` samples; cut it where the spindle runs away, far faster than it is driven."""

    def mean(name: str) -> np.ndarray:
        x = recording.channels[name][:, 0]
        return x[: len(x) // step * step].reshape(-1, step).mean(axis=1)

    time = recording.time[: len(recording.time) // step * step : step]
    spindle = mean("motor_position")
    speed = np.abs(np.gradient(spindle, time))
    valid = time - time[0] > SETTLE
    runaway = np.flatnonzero(speed > 4 * np.percentile(speed, 99))
    if len(runaway):
        valid &= time < time[runaway[0]] - 0.1
    return Stroke(time, spindle, -mean("motor_torque"), mean("joint_position"), mean("joint_torque"), valid)


@numba.njit(cache=True)
def play(lower: np.ndarray, upper: np.ndarray, start: float) -> np.ndarray:
    """Follow a value that moves only as far as its bounds push it."""
    x = np.empty(len(lower))
    value = start
    for k in range(len(lower)):
        value = min(max(value, lower[k]), upper[k])
        x[k] = value
    return x


def tension(run: Stroke, p: np.ndarray, share: float = 1.0) -> np.ndarray:
    """Follow the load that arrives behind a share of the friction path, shape (n,) [N m].

    Parameters
    ----------
    run : Stroke
    p : ndarray, shape (6,)
        a_u, b_u, g_u, a_l, b_l, g_l.
    share : float
        Of the width of the play.
    """
    z = (run.spindle - np.deg2rad(30)) / np.deg2rad(30)
    up, low = p[0] + p[2] * z, p[3] + p[5] * z
    middle, half = 0.5 * (up + low), 0.5 * share * (up - low)
    slope, spread = 0.5 * (p[1] + p[4]), 0.5 * share * (p[1] - p[4])
    first, second = (run.drive - middle - half) / (slope + spread), (run.drive - middle + half) / (slope - spread)
    lower, upper = np.minimum(first, second), np.maximum(first, second)
    early = 60  # samples: the first stroke says which branch the log starts on
    closing = run.spindle[min(50, len(lower) - 1)] < run.spindle[0]
    start = lower[0] if closing else max(lower[0], min(upper[0], float(np.min(upper[:early]))))
    return play(lower, upper, start)


def fit_torque(runs: Sequence[Stroke]) -> np.ndarray:
    """Fit the play, shape (6,): from the spindle's torque alone to the jaw's."""

    def residual(p: np.ndarray) -> np.ndarray:
        return np.concatenate([1e3 * (tension(run, p) - run.load)[run.valid] for run in runs])

    start = np.array([0.03, 1.4, -0.012, -0.058, 0.68, -0.01])
    return least_squares(residual, start, x_scale=[0.05, 1, 0.01, 0.05, 1, 0.01], loss="soft_l1", f_scale=2.0).x


def angle_columns(run: Stroke, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Give the columns of the jaw's angle, shape (n, k), and which cannot be negative."""
    q = run.spindle
    columns = [q, np.ones_like(q), q**2, q**3]
    for share in NODES:
        X = tension(run, p, share)
        columns.append(-X)
        if share in (NODES[0], NODES[-1]):
            columns.append(np.exp(-np.clip(X, -2 * SOFT, None) / SOFT))
    return np.array(columns).T, np.arange(len(columns)) >= 4


def fit_angle(runs: Sequence[Stroke], p: np.ndarray) -> np.ndarray:
    """Fit the angle's coefficients, given the play."""
    A = np.concatenate([angle_columns(run, p)[0][run.valid] for run in runs])
    y = np.concatenate([run.jaw[run.valid] for run in runs])
    nonnegative = angle_columns(runs[0], p)[1]
    scale = np.linalg.norm(A, axis=0)
    return lsq_linear(A / scale, y, bounds=(np.where(nonnegative, 0.0, -np.inf), np.inf)).x / scale


def transfer(runs: Mapping[str, Stroke], train: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Fit on some files and judge on the others.

    Returns
    -------
    dict
        By file: root mean square errors of angle [deg] and torque [mN m].
    """
    learned = [runs[name] for name in train]
    p = fit_torque(learned)
    c = fit_angle(learned, p)
    errors = {}
    for name, run in runs.items():
        angle = np.rad2deg(run.jaw - angle_columns(run, p)[0] @ c)[run.valid]
        torque = 1e3 * (run.load - tension(run, p))[run.valid]
        errors[name] = float(np.sqrt(np.mean(angle**2))), float(np.sqrt(np.mean(torque**2)))
    return errors
