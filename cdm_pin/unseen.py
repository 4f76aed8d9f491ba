"""How well a fit predicts recordings that it has not seen, given how well it knows its parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .doubts import stretches
from .drifting import own_drifts
from .fit import Fit, left_open
from .geometry import Vector
from .search import Search, errors


def deviance_unseen(judge: Search, fit: Fit) -> float:
    """Twice the negative logarithm of how likely the unseen recordings are after a fit, up to a constant."""
    return sum(updated(judge, fit, stacked(judge, fit)))


def updated(judge: Search, fit: Fit, series: Sequence[Vector]) -> tuple[float, float]:
    """Sum the squares of whitened series after what a fit leaves uncertain, and drifting zeros, are taken out.

    Parameters move as far as their covariance allows; the second value is the logarithm of how much room they have.
    Those of the rigid body act through soft cables, too.
    """
    own = [judge.columns(c) for c in fit.effects]
    rigid = [a + b for a, b in zip(judge.rigid, stretches(judge, fit), strict=True)]
    waves = own_drifts(judge)
    banks = [np.concatenate([rigid[r], *[columns[r] for columns in own], waves[r], x]) for r, x in enumerate(series)]
    W = judge.white(fit.whitener, banks)
    k = len(fit.covariance)
    values, vectors = np.linalg.eigh(fit.covariance)
    X, b = beside(W[k:-1], (vectors * np.sqrt(np.maximum(values, 0.0))).T @ W[:k], W[-1])
    room = np.eye(k) + X @ X.T
    moved = X @ b
    return float(b @ b - moved @ np.linalg.solve(room, moved)), float(np.linalg.slogdet(room)[1])


def loosened(fit: Fit, covariance: Vector, where: Sequence[np.ndarray]) -> Vector:
    """Let what laws leave open about signs of velocities be anything their friction can be, whatever the training says.

    It is told by passages through zero and standstills, and of those other recordings may have others.

    Parameters
    ----------
    fit : Fit
    covariance : ndarray, shape (k, k)
        Of parameters.
    where : sequence of ndarray of int
        Where those of each effect stand in it, its coefficients first.
    """
    out = covariance.copy()
    for beta, left, at in zip(fit.beta, left_open(fit), where, strict=True):
        size = np.maximum(np.abs(beta[left]), np.abs(beta[:1]))
        out[at[left], at[left]] += size**2
    return out


def beside(drifts: Vector, *series: Vector) -> list[Vector]:
    """Give of whitened series, shape (..., n), what those of drifting zeros, shape (k, n), do not span."""
    scale = np.linalg.norm(drifts, axis=1)
    Q = np.linalg.qr((drifts[scale > 0] / scale[scale > 0, None]).T)[0]
    return [x - (x @ Q) @ Q.T for x in series]


def stacked(judge: Search, fit: Fit) -> list[Vector]:
    """Give the errors of a fit on the unseen recordings as columns, per run (1, n_channels, n_reduced)."""
    return [e[None] for e in errors(judge, fit.base, fit.effects, fit.beta)]
