"""Scores: what columns would add to a fit, from their inner products beside it and with its residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .candidates import Candidate
from .geometry import Vector
from .whitening import log_p


@dataclass(frozen=True)
class Score:
    """What a candidate would add to a fit.

    Attributes
    ----------
    statistic : float
        Twice the gain of log-likelihood; -inf where the signs are not admissible.
    k : int
        Number of columns that are independent of the fit.
    beta : ndarray
        Coefficients.
    visible : float
        Share of the columns that the fit leaves over.
    norm : float
        Norm of the (first) whitened column that is left over, per unit coefficient.
    """

    statistic: float
    k: int
    beta: Vector
    visible: float
    norm: float


def family_wise(score: Score, candidate: Candidate, weight: float) -> float:
    """Natural log of the family-wise p-value of a candidate (Bonferroni, weighted)."""
    if not np.isfinite(score.statistic):
        return 0.0
    one_sided = np.log(0.5) if score.k == 1 and any(candidate.signs) else 0.0
    return log_p(score.statistic, score.k) + one_sided - float(np.log(weight))


def scored(gram: Vector, c: Vector, full: Vector, left: Vector, signs: Sequence[int]) -> Score:
    """Score columns from their inner products beside a fit, and with its residual."""
    if len(c) == 1:
        return single(score_single(c, full, left), 0, signs)
    visible = float(np.sqrt(np.max(left / np.maximum(full, 1e-300)))) if len(full) else 0.0
    keep = left > 1e-6 * full
    nothing = Score(-np.inf, int(keep.sum()), np.zeros(len(c)), visible, 0.0)
    if not keep.any():
        return nothing
    scale = np.sqrt(np.where(keep, left, 1.0))
    values, vectors = np.linalg.eigh((gram / scale[:, None] / scale)[np.ix_(keep, keep)])
    good = values > 1e-7 * values[-1]
    u = vectors[:, good].T @ (c / scale)[keep]
    beta = np.zeros(len(c))
    beta[keep] = vectors[:, good] @ (u / values[good])
    beta /= scale
    wrong = [i for i, (s, b) in enumerate(zip(signs, beta, strict=False)) if s and b < 0]
    if wrong:
        return _without(gram, c, full, left, signs, min(wrong, key=lambda i: beta[i] * scale[i]), nothing)
    return Score(float(np.sum(u**2 / values[good])), int(good.sum()), beta, visible, float(np.sqrt(left[0])))


def _without(
    gram: Vector, c: Vector, full: Vector, left: Vector, signs: Sequence[int], i: int, nothing: Score
) -> Score:
    """Score again with the coefficient of the wrong sign at its bound, zero (active set)."""
    if len(c) == 1 or (i == 0 and not any(signs[1:])):
        return nothing
    rest = [j for j in range(len(c)) if j != i]
    signs = [signs[j] for j in rest if j < len(signs)]
    score = scored(gram[np.ix_(rest, rest)], c[rest], full[rest], left[rest], signs)
    return replace(score, beta=np.insert(score.beta, i, 0.0)) if np.isfinite(score.statistic) else nothing


def score_single(c: Vector, full: Vector, left: Vector) -> tuple[Vector, Vector, Vector, Vector]:
    """Score each column alone: statistic, coefficient, visible share, norm."""
    there = (left > 1e-6 * full) & (full > 0.0)
    safe = np.where(there, left, 1.0)
    visible = np.sqrt(np.maximum(left, 0.0) / np.maximum(full, 1e-300))
    return np.where(there, c * c / safe, -np.inf), np.where(there, c / safe, 0.0), visible, np.sqrt(there * safe)


def single(parts: tuple[Vector, ...], i: int, signs: Sequence[int]) -> Score:
    """Give the score of one column, none where its sign is not admissible."""
    statistic, beta, visible, norm = (float(x[i]) for x in parts)
    if np.isfinite(statistic) and signs and signs[0] and beta < 0:
        statistic, beta = -np.inf, 0.0
    return Score(statistic, int(norm > 0), np.array([beta]), visible, norm)


def score_wide(grams: Vector, c: Vector, full: Vector, left: Vector, signs: Sequence[Sequence[int]]) -> list[Score]:
    """Score many candidates of k columns each as `scored` does one, shapes (n, k, k), (n, k), (n, k), (n, k)."""
    whole = np.all(left > 1e-6 * full, axis=1)
    scale = np.sqrt(np.where(whole[:, None], left, 1.0))
    values, vectors = np.linalg.eigh(grams / scale[:, :, None] / scale[:, None])
    good = values > 1e-7 * values[:, -1:]
    u = np.einsum("nij,ni->nj", vectors, c / scale)
    part = np.where(good, u / np.where(good, values, 1.0), 0.0)
    beta = np.einsum("nij,nj->ni", vectors, part) / scale
    statistic = np.sum(u * part, axis=1)
    visible = np.sqrt(np.max(left / np.maximum(full, 1e-300), axis=1))
    out = []
    for i, own in enumerate(signs):
        if not whole[i] or any(s and b < 0 for s, b in zip(own, beta[i], strict=False)):
            out.append(scored(grams[i], c[i], full[i], left[i], own))
        else:
            norm = float(np.sqrt(left[i, 0]))
            out.append(Score(float(statistic[i]), int(good[i].sum()), beta[i], float(visible[i]), norm))
    return out
