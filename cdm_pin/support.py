"""What recordings can tell: which parameters they excite, and which values mean something."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from . import estimators
from .base import BaseParameters, group, massive_columns
from .estimators import Fit, Moments
from .geometry import Vector, frozen_array
from .model import CableModel
from .regressor import Triangle
from .terms import Plan


def supported(
    plan: Plan, moments: Moments, tolerance: float = 1e-7, independent: float = np.inf
) -> tuple[BaseParameters, list[int], tuple[tuple[str, str], ...]]:
    """Decide which parameters the recordings excite.

    Parameters
    ----------
    plan : Plan
    moments : Moments
    tolerance : float
        See `identify`.
    independent : float
        Values that the motion gives per motor; less than two for three parameters is too few.

    Returns
    -------
    base : BaseParameters
        Of these motions.
    columns : list of int
        Of the plan: those of `base`, then those of the effects that are distinguishable.
    missing : tuple of (name, reason)
        What is not identifiable.
    """
    X, y = moments.equations()
    scale = np.linalg.norm(y, axis=0)
    flat = (X / np.where(scale > 0, scale, 1.0)[:, None]).reshape(-1, X.shape[2])
    p = plan.base.rank
    wanted = range(p, p + plan.n_wanted)
    few = moments.n_samples * moments.n_motors < 3 * (p + plan.n_wanted)
    if few or independent * moments.n_motors < 0.75 * (p + plan.n_wanted):
        count = f"{moments.n_samples} samples" if few else f"{independent:.1f} independent values per motor"
        reason = f"too short or too slow: {count} for {p + plan.n_wanted} parameters"
        empty = group(plan.model, Triangle.empty(10 * plan.model.n_joints), columns=massive_columns(plan.model))
        return empty, [], tuple((plan.names[k], reason) for k in range(p + plan.n_wanted))
    width = 10 * plan.model.n_joints
    rigid = Triangle.empty(width).add(flat[:, :p] @ plan.base.matrix) if p else Triangle.empty(width)
    base = group(plan.model, rigid, columns=massive_columns(plan.model), tolerance=tolerance)
    place = {int(column): k for k, column in enumerate(plan.base.columns)}
    columns = [place[int(column)] for column in base.columns]
    missing = _regrouped(plan.base, base)
    unit = unit_columns(flat)
    for k in wanted:
        if not columns:
            share, blame = float(np.linalg.norm(unit[:, k])), []
        else:
            weights, *_ = np.linalg.lstsq(unit[:, columns], unit[:, k], rcond=None)
            share = float(np.linalg.norm(unit[:, k] - unit[:, columns] @ weights))
            blame = [plan.names[columns[j]] for j in np.argsort(-np.abs(weights))[:2] if abs(weights[j]) > 0.05]
        if share > tolerance:
            columns.append(k)
        else:
            seen = f"cannot be told from {' and '.join(blame)}" if blame else "nothing moves there"
            missing.append((plan.names[k], seen))
    return base, columns, tuple(missing)


def _regrouped(structural: BaseParameters, base: BaseParameters) -> list[tuple[str, str]]:
    """Name the structural parameters that these motions do not show by themselves."""
    missing = []
    for name, row, column in zip(structural.names, structural.matrix, structural.columns, strict=True):
        same = np.flatnonzero(base.columns == column)
        if len(same) and np.allclose(base.matrix[same[0]], row, atol=1e-6 * np.abs(row).max()):
            continue
        inside = [n for n, r in zip(base.names, base.matrix, strict=True) if abs(r[column]) > 1e-9]
        reason = f"not excited by itself: seen only within {' and '.join(inside[:2])}" if inside else "not excited"
        missing.append((name, reason))
    return missing


def unattenuated(fit: Fit, covariance: Vector, noise: Moments) -> tuple[Fit, Vector, Vector]:
    """Undo what the positions' noise does to a fit; also give its share in what excites each value."""
    if not len(fit.values):
        return fit, covariance, np.zeros(0)
    X, _ = noise.equations()
    A = np.einsum("ij,wjp->wip", fit.whitener, X).reshape(-1, X.shape[2])
    correction, share = estimators.attenuation(fit.information, A.T @ A)
    return (
        replace(fit, values=frozen_array(correction @ fit.values)),
        correction @ covariance @ correction.T,
        share,
    )


def reliable_values(
    model: CableModel, base: BaseParameters, fit: Fit, covariance: Vector, moments: Moments, share: Vector
) -> tuple[np.ndarray, list[tuple[str, str]]]:
    """Mark values that mean something.

    Their standard deviation is below half of what links of the nominal size could have (for an effect: of what the
    torques could be), and less than half of what excites them is noise.
    """
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    torque = np.sqrt(estimators.mean_square(moments, np.zeros(len(std))))
    X, _ = moments.equations()
    size = np.linalg.norm(X, axis=0) / np.sqrt(max(moments.n_samples, 1))
    limit = np.abs(base.matrix) @ parameter_scale(model.standard_parameters)
    effect = [float(np.max(np.divide(torque, s, where=s > 0, out=np.zeros_like(s)))) for s in size.T[base.rank :]]
    limit = np.concatenate([np.where(limit > 0, limit, np.inf), effect])
    weak, noisy = std > 0.5 * limit, share > 0.5
    names = [*base.names, *fit.names[base.rank :]]
    vague = []
    for k in np.flatnonzero(weak | noisy):
        why = f"{100 * share[k]:.0f} % of what excites it is noise" if noisy[k] else f"standard deviation {std[k]:.2g}"
        vague.append((names[k], f"too weakly excited: {why}"))
    return ~(weak | noisy), vague


def parameter_scale(pi_std: Vector) -> Vector:
    """Size that each standard parameter of a link of this mass and extent could have, shape (10 n_links,)."""
    scale = []
    for pi in np.reshape(pi_std, (-1, 10)):
        m = pi[0]
        second = max(0.5 * (pi[4] + pi[6] + pi[9]), 0.0)  # integral of squared distance from the joint
        scale += [m, *[np.sqrt(m * second)] * 3, *[second] * 6]
    return np.array(scale)


def unit_columns(columns: Vector) -> Vector:
    """Scale columns to norm 1; zeros stay."""
    norms = np.linalg.norm(columns, axis=0)
    return columns / np.where(norms > 0, norms, 1.0)
