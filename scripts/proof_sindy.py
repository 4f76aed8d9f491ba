"""The part of the proof's third baseline that runs where pysindy is installed: one JSON line in, one out."""

from __future__ import annotations

import json
import sys

import numpy as np
import pysindy as ps

_THRESHOLDS = np.geomspace(0.003, 0.3, 12)  # [N m] of a term's root mean square


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
            ("sine", np.sin(x)),
            ("cosine", np.cos(x)),
            ("square", x * x),
        ):
            columns.append(column)
            names.append((effect, j))
    return np.column_stack(columns), names


def discover(theta: np.ndarray, rate: np.ndarray, torque: np.ndarray, width: float) -> list[dict]:
    """Find the terms of each joint's torque (m, n), the threshold chosen by BIC; the strongest first."""
    A, names = library(theta, rate, width)
    size = np.sqrt(np.mean(A**2, axis=0))
    found = []
    for i in range(theta.shape[1]):
        best = (np.inf, np.zeros(len(size)))
        for threshold in _THRESHOLDS:
            model = ps.STLSQ(threshold=float(threshold), alpha=1e-6)
            model.fit(A / size, torque[:, i : i + 1])
            p = np.ravel(model.coef_)
            left = float(np.mean((torque[:, i] - A / size @ p) ** 2))
            bic = len(A) * np.log(max(left, 1e-12)) + np.count_nonzero(p) * np.log(len(A))
            best = min(best, (bic, p), key=lambda pair: pair[0])
        for k in np.flatnonzero(best[1]):
            effect, j = names[k]
            if effect == "torque_offset":
                place = {"kind": "motor", "index": i + 1}
            else:
                place = {"kind": "joint", "index": i + 1}
                effect = effect if j == i else f"{effect} of joint {j + 1}"
            found.append((abs(float(best[1][k])), {"effect": effect, "location": place}))
    return [finding for _, finding in sorted(found, key=lambda pair: -pair[0])]


if __name__ == "__main__":
    for line in sys.stdin:
        told = json.loads(line)
        state = (np.array(told[name]) for name in ("theta", "rate", "torque"))
        print(json.dumps(discover(*state, told["sign"])), flush=True)
