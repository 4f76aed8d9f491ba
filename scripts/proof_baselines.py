"""What usual practice says about the same recordings: three baselines that share no code with the diagnosis.

All see the rigid body of the right lengths and pulleys, filter positions and torques alike (zero-phase Butterworth),
differentiate and decimate. They are scored as the diagnosis is.

- `every_friction`: least squares with every friction term in; whatever has ``|t| > 3`` is named.
- `stepwise`: forward and backward selection by BIC over a wider list of terms.
- `sparse`: SINDy (sequentially thresholded least squares, pysindy) on what the rigid body leaves over, in a Python of
  its own; the library is that of each joint's state, the threshold is chosen over folds.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from cdm_pin.plant.planar import Arm, lumped, rigid_columns

_CUTOFF, _DECIMATE, _TRIM = 8.0, 10, 100  # [Hz]; rows; rows left out at each end
_SIGN, _SLOW = 0.02, 0.2  # [rad/s]: of the smooth sign, of the Stribeck term
_SIGNIFICANT, _MOST = 3.0, 15


@dataclass(frozen=True)
class Term:
    """One column and what it would be called."""

    effect: str
    location: dict[str, Any]
    column: np.ndarray  # (rows,)


@dataclass(frozen=True)
class Plain:
    """A recording as usual practice sees it.

    Parameters
    ----------
    rigid : ndarray, shape (m n, 3 n)
        Columns of the link parameters (D, s_x, s_y).
    y : ndarray, shape (m n,)
        Motor torques [N m].
    theta, rate : ndarray, shape (m, n)
        Joint angles [rad] and rates [rad/s].
    ratio : float
        r_m / r_j.
    """

    rigid: np.ndarray
    y: np.ndarray
    theta: np.ndarray
    rate: np.ndarray
    ratio: float


def prepare(manipulator: Mapping[str, Any], columns: Mapping[str, np.ndarray]) -> Plain:
    """Filter, differentiate and decimate a recording (columns by name) of the arm in a manipulator file."""
    length = np.array([link["length"] for link in manipulator["links"]])
    n, t = length.size, columns["time"]
    pulleys = manipulator["pulleys"]
    ratio = pulleys["motor_pulley_radius"] / pulleys["joint_pulley_radius"]
    step = float(np.median(np.diff(t)))

    def stack(name: str) -> np.ndarray:
        return np.column_stack([columns[f"{name}_{i + 1}"] for i in range(n)])

    if "joint_position_1" in columns:
        phi = np.cumsum(stack("joint_position"), axis=1)
    else:
        phi = stack("motor_position") * ratio
    sos = butter(4, 2.0 * _CUTOFF * step, output="sos")
    phi, tau = (sosfiltfilt(sos, x, axis=0) for x in (phi, stack("motor_torque")))
    w = np.gradient(phi, step, axis=0)
    a = np.gradient(w, step, axis=0)
    phi, w, a, tau = (np.ascontiguousarray(x[_TRIM:-_TRIM:_DECIMATE]) for x in (phi, w, a, tau))
    rigid = ratio * rigid_columns(length, np.array(manipulator["gravity"][:2]), phi, w, a)
    theta, rate = np.diff(phi, axis=1, prepend=0.0), np.diff(w, axis=1, prepend=0.0)
    return Plain(rigid.reshape(-1, 3 * n), tau.ravel(), theta, rate, ratio)


def joined(parts: Sequence[Plain]) -> Plain:
    """Put several recordings of one arm behind each other."""
    rows = {name: np.concatenate([getattr(p, name) for p in parts]) for name in ("rigid", "y", "theta", "rate")}
    return Plain(**rows, ratio=parts[0].ratio)


def rigid_fit(plain: Plain, arm: Arm) -> dict[str, float]:
    """Fit the base parameters alone, by plain least squares, and hold them against the true arm.

    Returns
    -------
    dict
        "residual": what is left over, relative to the torque; "error": the largest error of a link's inertia about its
        joint or of its first moment, relative to the largest of its kind.
    """
    p = _solve(plain.rigid, plain.y)
    residual = float(np.linalg.norm(plain.y - plain.rigid @ p) / np.linalg.norm(plain.y))
    D, sx, sy = lumped(arm)
    true = np.array([D + arm.rotor / arm.ratio**2, sx, sy])
    size = np.array([[D.max()], [np.hypot(sx, sy).max()], [np.hypot(sx, sy).max()]])
    return {"residual": residual, "error": float(np.abs((p.reshape(3, -1) - true) / size).max())}


def every_friction(plain: Plain) -> list[dict[str, Any]]:
    """Least squares with every friction term in; findings are what has ``|t| > 3``, largest first."""
    return _named(plain, _terms(plain, friction=True))


def stepwise(plain: Plain) -> list[dict[str, Any]]:
    """Select terms forward and backward by BIC on unwhitened residuals; findings in order of their ``|t|``."""
    terms = _terms(plain, friction=False)
    A = np.column_stack([plain.rigid, *(t.column for t in terms), plain.y])
    A = A / np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    G, rows, base = A.T @ A, len(plain.y), list(range(plain.rigid.shape[1]))

    def bic(chosen: Sequence[int]) -> float:
        index = [*base, *(len(base) + j for j in chosen)]
        left = G[-1, -1] - G[-1, index] @ np.linalg.lstsq(G[np.ix_(index, index)], G[index, -1], rcond=1e-10)[0]
        return rows * np.log(max(left, 1e-12)) + len(chosen) * np.log(rows)

    chosen: list[int] = []
    best = bic(chosen)
    while len(chosen) < _MOST:
        value, j = min((bic([*chosen, j]), j) for j in range(len(terms)) if j not in chosen)
        if value >= best:
            break
        chosen, best = [*chosen, j], value
        shorter = [(bic([i for i in chosen if i != j]), j) for j in chosen[:-1]]
        if shorter and min(shorter)[0] < best:
            best, worst = min(shorter)
            chosen.remove(worst)
    return _named(plain, [terms[j] for j in chosen], least=0.0)


def as_diagnosis(findings: list[dict[str, Any]]) -> dict[str, Any]:
    """Give findings the form that is scored."""
    return {"verdict": "missing_physics" if findings else "consistent", "findings": findings}


class Sindy:
    """Sparse regression of what the rigid body leaves over, by pysindy in another Python.

    Parameters
    ----------
    python : path
        An interpreter that has pysindy.
    """

    def __init__(self, python: str | Path):
        self._process = subprocess.Popen(
            [str(python), str(Path(__file__).with_name("proof_sindy.py"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __call__(self, plain: Plain) -> list[dict[str, Any]]:
        """Find terms per joint; cross terms that have no name are named as they are."""
        n = plain.theta.shape[1]
        residual = (plain.y - plain.rigid @ _solve(plain.rigid, plain.y)).reshape(-1, n) / plain.ratio
        torque = np.cumsum(residual[:, ::-1], axis=1)[:, ::-1]
        told = {"theta": plain.theta.tolist(), "rate": plain.rate.tolist(), "torque": torque.tolist(), "sign": _SIGN}
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(json.dumps(told) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            raise RuntimeError("the Python of pysindy ended")
        return json.loads(answer)

    def close(self) -> None:
        """End the other process."""
        self._process.communicate()


def _solve(A: np.ndarray, y: np.ndarray) -> np.ndarray:
    size = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    return np.linalg.lstsq(A / size, y, rcond=1e-9)[0] / size


def _terms(plain: Plain, *, friction: bool) -> list[Term]:
    """List the columns: friction of every kind at joints and motors, or (not `friction`) the rest as well."""
    n, terms = plain.theta.shape[1], []
    phi, w = np.cumsum(plain.theta, axis=1), np.cumsum(plain.rate, axis=1)
    model = (plain.rigid @ _solve(plain.rigid, plain.y)).reshape(-1, n)  # measured torque would explain itself
    joint_torque = np.cumsum(model[:, ::-1], axis=1)[:, ::-1] / plain.ratio

    def add(effect: str, location: dict[str, Any], f: np.ndarray, entry: np.ndarray) -> None:
        terms.append(Term(effect, location, (f[:, None] * entry).ravel()))

    for i in range(n):
        own = np.eye(n)[i]
        across = plain.ratio * (own - np.eye(n)[i - 1] if i else own)
        sides = [("joint", plain.theta[:, i], plain.rate[:, i], joint_torque[:, i], across)]
        if i:  # motor 1 is joint 1
            sides.append(("motor", phi[:, i], w[:, i] / plain.ratio, model[:, i], own))
        for kind, x, v, tau, entry in sides:
            place, sign = {"kind": kind, "index": i + 1}, np.tanh(v / _SIGN)
            add("viscous_friction", place, v, entry)
            add("coulomb_friction", place, sign, entry)
            add("stribeck_friction", place, np.exp(-((v / _SLOW) ** 2)) * sign, entry)
            add("torque_dependent_friction", place, np.abs(tau) * sign, entry)
            add("position_dependent_friction", place, np.sin(x) * sign, entry)
            if kind == "joint":
                add("quadratic_drag", place, v * np.abs(v), entry)
                if not friction:
                    add("joint_spring", place, x, entry)
        motor = {"kind": "motor", "index": i + 1}
        add("torque_offset", motor, np.ones(len(phi)), own)
        if not friction:
            add("time_delay", motor, np.gradient(model[:, i]), own)
            add("torque_gain_error", motor, model[:, i], own)
    if not friction:
        terms.append(Term("time_delay", {"kind": "system"}, np.gradient(model, axis=0).ravel()))
    return terms


def _named(plain: Plain, terms: Sequence[Term], least: float = _SIGNIFICANT) -> list[dict[str, Any]]:
    A = np.column_stack([plain.rigid, *(t.column for t in terms)])
    size = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    inverse = np.linalg.pinv((A / size).T @ (A / size), rcond=1e-10, hermitian=True)
    p = inverse @ ((A / size).T @ plain.y)
    spread = np.sqrt(np.sum((plain.y - A / size @ p) ** 2) / max(len(plain.y) - len(p), 1) * np.diag(inverse))
    t = np.abs(p / np.maximum(spread, 1e-300))[plain.rigid.shape[1] :]
    order = [j for j in np.argsort(-t) if t[j] > least]
    return [{"effect": terms[j].effect, "location": terms[j].location} for j in order]
