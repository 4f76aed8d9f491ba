"""The part of the proof's third baseline that runs where pysindy is installed: one JSON line in, one out."""

from __future__ import annotations

import json
import sys
import warnings

import numpy as np
import pysindy as ps

_THRESHOLDS = np.geomspace(0.003, 1.0, 8)  # [N m] of a term's root mean square
_FOLDS = 5


def library(theta: np.ndarray, rate: np.ndarray, width: float) -> tuple[np.ndarray, list]:
    """Build the columns (m, k) from joint states (m, n) and what each would be called: (effect, joint) or a text."""
    n = theta.shape[1]
    columns, names = [np.ones(len(theta))], [("torque_offset", None)]
    for j in range(n):
        x, v = theta[:, j], rate[:, j]
        sign = np.tanh(v / width)
        for effect, column in (
            ("joint_spring", x),
            ("viscous_friction", v),
            ("coulomb_friction", sign),
            ("quadratic_drag", v * np.abs(v)),
            ("stribeck_friction", np.exp(-((v / 0.2) ** 2)) * sign),
            ("position_dependent_friction", np.sin(x) * sign),
        ):
            columns.append(column)
            names.append((effect, j))
    return np.column_stack(columns), names


def fit(A: np.ndarray, y: np.ndarray, threshold: float) -> np.ndarray:
    """Fit sequentially thresholded least squares: coefficients (k,) of the columns of `A` (m, k)."""
    model = ps.STLSQ(threshold=threshold, alpha=1e-6)
    model.fit(A, y[:, None])
    return np.ravel(model.coef_)


def discover(theta: np.ndarray, rate: np.ndarray, torque: np.ndarray, width: float) -> list[dict]:
    """Find the terms of each joint's torque (m, n), the strongest first.

    The threshold is the largest whose error over contiguous folds is within one standard error of the best.
    """
    A, names = library(theta, rate, width)
    A = A / np.sqrt(np.mean(A**2, axis=0))
    folds = np.arange(len(A)) * _FOLDS // len(A)
    found = []
    for i in range(theta.shape[1]):
        y, errors = torque[:, i], np.empty((len(_THRESHOLDS), _FOLDS))
        for t, threshold in enumerate(_THRESHOLDS):
            for k in range(_FOLDS):
                seen = folds != k
                errors[t, k] = np.mean((y[~seen] - A[~seen] @ fit(A[seen], y[seen], threshold)) ** 2)
        mean, best = errors.mean(axis=1), int(np.argmin(errors.mean(axis=1)))
        good = np.flatnonzero(mean <= mean[best] + errors[best].std() / np.sqrt(_FOLDS))
        p = fit(A, y, float(_THRESHOLDS[good[-1]]))
        for k in np.flatnonzero(p):
            effect, j = names[k]
            if effect == "torque_offset":
                place = {"kind": "motor", "index": i + 1}
            else:
                place = {"kind": "joint", "index": i + 1}
                effect = effect if j == i else f"{effect} of joint {j + 1}"
            found.append((abs(float(p[k])), {"effect": effect, "location": place}))
    return [finding for _, finding in sorted(found, key=lambda pair: -pair[0])]


if __name__ == "__main__":
    warnings.simplefilter("ignore")  # that a threshold leaves nothing
    for line in sys.stdin:
        told = json.loads(line)
        state = (np.array(told[name]) for name in ("theta", "rate", "torque"))
        print(json.dumps(discover(*state, told["sign"])), flush=True)
