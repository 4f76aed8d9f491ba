"""Fits: rigid body and effects by least squares in whitened data, coefficients at their bounds where signs say so."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .candidates import Candidate
from .geometry import Vector
from .problem import Problem
from .whitening import Whitener


@dataclass(frozen=True)
class Body:
    """The rigid body in whitened data.

    Attributes
    ----------
    Q : ndarray, shape (n_rows, rank)
        Orthonormal basis of its columns.
    inverse : ndarray, shape (n_parameters, rank)
        Base parameters per coordinate in that basis.
    data, residual : ndarray, shape (n_rows,)
        What is measured, and what is left of it.
    """

    Q: Vector
    inverse: Vector
    data: Vector
    residual: Vector

    @cached_property
    def n_judged(self) -> int:
        """Whitened samples that are not zero."""
        return int(np.count_nonzero(self.data))


@dataclass(frozen=True)
class Fit:
    """Rigid body and effects fitted to whitened data.

    Attributes
    ----------
    problem : Problem
    whitener : Whitener
    effects : tuple of Candidate
    body : Body
    Q : ndarray, shape (n_rows, rank)
        Orthonormal basis of the effects' columns as far as the rigid body leaves them over.
    free : tuple of ndarray, shape (k, n_rows)
        These columns, per effect.
    weights : ndarray, shape (sum k, rank), or None
        What Q is made of them with; None where it has more in it.
    carried : ndarray, shape (n_parameters, sum k)
        By how much base parameters move per coefficient of the effects.
    residual : ndarray, shape (n_rows,)
        Whitened.
    base : ndarray
        Base parameters, differences from the model's.
    beta : tuple of ndarray
        Coefficients of each effect.
    covariance : ndarray
        Of base parameters and all coefficients, in that order.
    """

    problem: Problem
    whitener: Whitener
    effects: tuple[Candidate, ...]
    body: Body
    Q: Vector
    free: tuple[Vector, ...]
    weights: Vector | None
    carried: Vector
    residual: Vector
    base: Vector
    beta: tuple[Vector, ...]
    covariance: Vector

    @property
    def n_rows(self) -> int:
        """Whitened samples of all channels."""
        return len(self.residual)

    @property
    def n_judged(self) -> int:
        """Those of them by which channels are judged."""
        return self.body.n_judged if self.problem.partly else self.n_rows

    @property
    def deviance(self) -> float:
        """Residual sum of squares in whitened units."""
        return float(self.residual @ self.residual)

    def rest(self, W: Vector) -> Vector:
        """Take from whitened columns what the fit spans, shape (n_columns, n_rows)."""
        W = W - (W @ self.body.Q) @ self.body.Q.T
        return W - (W @ self.Q) @ self.Q.T


@dataclass(frozen=True)
class Estimate:
    """Parameters of a fit, those of the rigid body first, with their covariance.

    Attributes
    ----------
    values : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
    """

    values: Vector
    covariance: Vector

    @classmethod
    def of(cls, fit: Fit) -> Estimate:
        """Take all parameters of a fit."""
        return cls(np.concatenate([fit.base, *fit.beta]), fit.covariance)

    def worth(self, own: np.ndarray) -> float:
        """By how much the sum of squares rises without these parameters."""
        return float(self.values[own] @ self._inverse(own) @ self.values[own])

    def without(self, own: np.ndarray) -> Estimate:
        """Give what the others become where these are zero."""
        gain = self.covariance[:, own] @ self._inverse(own)
        values = self.values - gain @ self.values[own]
        values[own] = 0.0
        return Estimate(values, self.covariance - gain @ self.covariance[own])

    def _inverse(self, own: np.ndarray) -> Vector:
        return np.asarray(np.linalg.pinv(self.covariance[np.ix_(own, own)], rcond=1e-10, hermitian=True), float)


def moved_masses(fit: Fit, W: Vector) -> Vector:
    """Give by how much base parameters move per coefficient of further whitened columns (k, n_rows), others moving too.

    Returns
    -------
    ndarray, shape (n_parameters, k)
    """
    assert fit.weights is not None
    return -fit.body.inverse @ (W @ fit.body.Q).T - fit.carried @ (fit.weights @ (W @ fit.Q).T)


def where_in(fit: Fit) -> list[np.ndarray]:
    """Say where the coefficients of each effect stand among all parameters of a fit."""
    ends = np.cumsum([len(fit.base), *[len(beta) for beta in fit.beta]])
    return [np.arange(a, b) for a, b in itertools.pairwise(ends)]


def own_covariance(fit: Fit, j: int) -> Vector:
    """Give the covariance of the coefficients of effect `j` of a fit."""
    own = where_in(fit)[j]
    return fit.covariance[np.ix_(own, own)]


def left_open(fit: Fit) -> list[np.ndarray]:
    """Tell which coefficients of each effect of a fit say what its law leaves open about the sign of a velocity."""
    own = (len(b) if c.bare is c else len(c.effect.signs) for c, b in zip(fit.effects, fit.beta, strict=True))
    return [np.arange(n, len(b)) for n, b in zip(own, fit.beta, strict=True)]


def fitted(
    problem: Problem, whitener: Whitener, effects: Sequence[Candidate], body: Body, own: Sequence[Vector]
) -> Fit:
    """Fit effects, whose own whitened columns are given, beside the rigid body."""
    X = np.concatenate([np.zeros((0, len(body.data))), *own])
    inside = X @ body.Q
    whole, size = X - inside @ body.Q.T, np.linalg.norm(X, axis=1)
    free = whole.copy()
    signs = np.array([s for c, x in zip(effects, own, strict=True) for s in _minor_signs(c, len(x))])
    if len(free) > 40:
        free[at_bound(free, body.residual, size, signs)] = 0.0
    theta, Q, inverse = least_squares(free, body.residual, size)
    while len(signs) and np.any((signs > 0) & (theta < 0)):  # held at their bound, zero
        free[np.argmin(np.where(signs > 0, theta * size, np.inf))] = 0.0
        theta, Q, inverse = least_squares(free, body.residual, size)
    carried = -body.inverse @ inside.T  # base parameters per coefficient
    base = body.inverse @ (body.Q.T @ body.data) + carried @ theta
    p, k = len(base), len(theta)
    covariance = np.zeros((p + k, p + k))
    covariance[p:, p:] = inverse @ inverse.T
    covariance[:p, p:] = carried @ covariance[p:, p:]
    covariance[p:, :p] = covariance[:p, p:].T
    covariance[:p, :p] = body.inverse @ body.inverse.T + covariance[:p, p:] @ carried.T
    ends = list(itertools.pairwise(np.cumsum([0, *[len(x) for x in own]])))
    beta, parts = tuple(theta[a:b] for a, b in ends), tuple(whole[a:b] for a, b in ends)
    residual = body.residual - Q @ (Q.T @ body.residual)
    return Fit(problem, whitener, tuple(effects), body, Q, parts, inverse, carried, residual, base, beta, covariance)


def _minor_signs(candidate: Candidate, k: int) -> list[int]:
    """Signs of those coefficients that may be zero; where only the first has one, it decides on the effect itself."""
    signs = candidate.signs
    return [*(signs if any(signs[1:]) else [0, *signs[1:]]), *[0] * k][:k]


def least_squares(A: Vector, b: Vector, size: Vector | None = None) -> tuple[Vector, Vector, Vector]:
    """Solve A' x = b for the rows of A; give x, an orthonormal basis of the rows, and x per coordinate in it.

    `size` is what the rows are measured by where their own norm would not tell noise from nothing; by default that is
    the largest of all, beside which a rounding error is nothing.
    """
    own = np.linalg.norm(A, axis=1)
    least = 1e-12 * np.max(own, initial=0.0) if size is None else 1e-7 * size
    scale = np.where(own > least, own, np.inf)
    if not len(A) or not np.isfinite(scale).any():
        return np.zeros(len(A)), np.zeros((len(b), 0)), np.zeros((len(A), 0))
    U, s, Vt = np.linalg.svd((A / scale[:, None]).T, full_matrices=False)
    keep = s > 1e-6 * s[0]
    U, inverse = U[:, keep], (Vt[keep].T / s[keep]) / scale[:, None]
    return inverse @ (U.T @ b), U, inverse


def at_bound(A: Vector, b: Vector, size: Vector, signs: np.ndarray) -> np.ndarray:
    """Find the coefficients that signs hold at zero, from inner products: for many columns."""
    scale = np.where(np.linalg.norm(A, axis=1) > 1e-7 * size, np.maximum(size, 1e-300), np.inf)
    gram, c = (A / scale[:, None]) @ (A / scale[:, None]).T, (A / scale[:, None]) @ b
    held = np.zeros(len(A), bool)
    while True:
        live = np.flatnonzero(~held)
        theta = np.zeros(len(A))
        theta[live] = np.linalg.lstsq(gram[np.ix_(live, live)], c[live], rcond=1e-10)[0]
        wrong = (signs > 0) & (theta < 0)
        if not wrong.any():
            return held
        held[np.argmin(np.where(wrong, theta, np.inf))] = True
