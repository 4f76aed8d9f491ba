"""How well a fit predicts recordings that it has not seen, given how well it knows its parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .geometry import Vector
from .selection import Fit, Search, errors


def deviance_unseen(judge: Search, fit: Fit, carried: Sequence[Vector] | None = None) -> float:
    """Twice the negative logarithm of how likely the unseen recordings are after a fit, up to a constant."""
    return sum(updated(judge, fit, stacked(judge, fit), carried))


def updated(
    judge: Search, fit: Fit, series: Sequence[Vector], carried: Sequence[Vector] | None = None
) -> tuple[float, float]:
    """Sum the squares of whitened series after what a fit leaves uncertain, and drifting zeros, are taken out.

    Parameters move as far as their covariance allows; the second value is the logarithm of how much room they have.
    Those of the rigid body may act through other effects, too (`carried_by`).
    """
    own = [judge.columns(c) for c in fit.effects]
    rigid = judge.rigid if carried is None else [a + b for a, b in zip(judge.rigid, carried, strict=True)]
    banks = [
        np.concatenate([rigid[r], *[columns[r] for columns in own], judge.drifts[r], x]) for r, x in enumerate(series)
    ]
    W = judge.white(fit.whitener, banks)
    k = len(fit.covariance)
    values, vectors = np.linalg.eigh(fit.covariance)
    X, drift, b = (vectors * np.sqrt(np.maximum(values, 0.0))).T @ W[:k], W[k:-1].T, W[-1]
    scale = np.linalg.norm(drift, axis=0)
    Q = np.linalg.qr(drift[:, scale > 0] / scale[scale > 0])[0]
    X, b = X - (X @ Q) @ Q.T, b - Q @ (Q.T @ b)
    room = np.eye(k) + X @ X.T
    moved = X @ b
    return float(b @ b - moved @ np.linalg.solve(room, moved)), float(np.linalg.slogdet(room)[1])


def carried_by(judge: Search, fit: Fit) -> list[Vector]:
    """Differentiate by the parameters of the rigid body what effects of a fit bring that follow its torques.

    Returns
    -------
    list of ndarray, shape (n_rigid, n_channels, n_reduced)
        One per run.
    """
    pairs = list(zip(fit.effects, fit.beta, strict=True))
    steps = np.sqrt(np.diag(fit.covariance))[: len(judge.base.columns)]
    out = [np.zeros_like(rigid) for rigid in judge.rigid]
    if judge.problem.swings:  # what the masses do to the soft cable is in the rigid body's columns then
        return out
    for k in np.flatnonzero(steps):
        there = judge.at(steps[k] * np.eye(len(steps))[k], pairs)
        for candidate, beta in pairs:
            if candidate.hangs_on_torques:
                for r, (a, b) in enumerate(zip(there.columns(candidate), judge.columns(candidate), strict=True)):
                    out[r][k] += np.tensordot(beta, a - b, 1) / steps[k]
    return out


def stacked(judge: Search, fit: Fit) -> list[Vector]:
    """Give the errors of a fit on the unseen recordings as columns, per run (1, n_channels, n_reduced)."""
    return [e[None] for e in errors(judge, fit.base, fit.effects, fit.beta)]
