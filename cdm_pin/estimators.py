r"""Linear fits of torque, from the triangle of a recording alone.

A sample gives one equation per motor, :math:`y_i = X_i\,\beta + \varepsilon_i`, with noise that is correlated between
the motors (a disturbance of one joint reaches several) and in time. `Moments` holds what any such fit needs; its size
does not depend on the number of samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .errors import ShapeError
from .geometry import Vector, frozen_array
from .regressor import Triangle


@dataclass(frozen=True)
class Moments:
    """Sufficient statistic of every linear fit of motor torques to shared parameters.

    Attributes
    ----------
    triangle : Triangle
        Of rows, one per sample, that hold the columns of motor 1, of motor 2, ..., then the torques of all motors.
    names : tuple of str, length p
        Of the parameters.
    present : ndarray of bool, shape (n_motors, p)
        Which parameters reach which motor; the others have no column.
    """

    triangle: Triangle
    names: tuple[str, ...]
    present: np.ndarray

    @classmethod
    def empty(cls, names: Sequence[str], present: np.ndarray) -> Moments:
        """Give the moments of no samples."""
        return cls(Triangle.empty(int(present.sum()) + len(present)), tuple(names), np.array(present, dtype=bool))

    @property
    def n_samples(self) -> int:
        """Number of samples so far."""
        return self.triangle.n_rows

    @property
    def n_motors(self) -> int:
        """Number of equations per sample."""
        return len(self.present)

    def add(self, X: Vector, y: Vector) -> Moments:
        """Fold in samples.

        Parameters
        ----------
        X : ndarray, shape (n, n_motors, p)
        y : ndarray, shape (n, n_motors)
            Motor torques [N m].

        Raises
        ------
        ShapeError
            If the shapes do not fit.
        """
        if X.shape[1:] != self.present.shape or y.shape != X.shape[:2]:
            raise ShapeError(f"X has shape {X.shape}, y {y.shape}; (n, {', '.join(map(str, self.present.shape))})")
        return replace(self, triangle=self.triangle.add(np.hstack([X[:, self.present], y])))

    def merge(self, other: Moments) -> Moments:
        """Give the moments of both sets of samples."""
        return replace(self, triangle=self.triangle.merge(other.triangle))

    def select(self, columns: Sequence[int]) -> Moments:
        """Keep these parameters alone, in this order."""
        place = np.full(self.present.shape, -1)
        place[self.present] = np.arange(self.present.sum())
        part = place[:, np.asarray(columns, dtype=int)]
        torques = np.arange(self.triangle.width - self.n_motors, self.triangle.width)
        triangle = self.triangle.select(np.concatenate([part[part >= 0], torques]))
        return Moments(triangle, tuple(self.names[k] for k in columns), part >= 0)

    def equations(self) -> tuple[Vector, Vector]:
        """Unfold into X of shape (w, n_motors, p) and y of shape (w, n_motors) that have the same moments."""
        R = self.triangle.R
        X = np.zeros((len(R), *self.present.shape))
        X[:, self.present] = R[:, : -self.n_motors]
        return X, R[:, -self.n_motors :]


@dataclass(frozen=True)
class Fit:
    r"""A linear fit.

    Attributes
    ----------
    names : tuple of str, length p
    values : ndarray, shape (p,)
    noise_covariance : ndarray, shape (n_motors, n_motors)
        Of one sample's residual [N^2 m^2].
    information : ndarray, shape (p, p)
        :math:`\sum X^T \Sigma^{-1} X`; its inverse is the covariance if the noise is white in time.
    condition_number : float
        Of the weighted observation matrix, its columns scaled to norm 1.
    n_samples : int
    iterations : int
        Until the weights settled.
    """

    names: tuple[str, ...]
    values: Vector
    noise_covariance: Vector
    information: Vector
    condition_number: float
    n_samples: int
    iterations: int = 1

    @property
    def noise(self) -> Vector:
        """Standard deviation of the residual per motor, shape (n_motors,) [N m]."""
        return frozen_array(np.sqrt(np.diag(self.noise_covariance)))

    @cached_property
    def whitener(self) -> Vector:
        """L^-1 of the noise covariance L L', shape (n_motors, n_motors)."""
        return whitener(self.noise_covariance, self.noise)

    @property
    def white_covariance(self) -> Vector:
        """Covariance of the values if the noise were white in time, shape (p, p)."""
        return frozen_array(inverse(self.information))


def residual_covariance(moments: Moments, values: Vector) -> Vector:
    """Mean over the samples of residual times residual', shape (n_motors, n_motors)."""
    X, y = moments.equations()
    r = y - X @ values
    return r.T @ r / max(moments.n_samples, 1)


def mean_square(moments: Moments, values: Vector) -> Vector:
    """Mean squared residual per motor, shape (n_motors,)."""
    return np.diag(residual_covariance(moments, values)).copy()


def ordinary(moments: Moments) -> Fit:
    """Fit by least squares, every motor with the same weight."""
    return solve(moments, np.eye(moments.n_motors))


def weighted(moments: Moments, *, tolerance: float = 1e-6, max_iterations: int = 50) -> Fit:
    r"""Fit by least squares weighted with the noise covariance over motors, both iterated until they agree.

    :math:`\hat\beta = (\sum X^T \Sigma^{-1} X)^{-1} \sum X^T \Sigma^{-1} y`, with :math:`\Sigma` the covariance of the
    residuals: the maximum likelihood under Gaussian noise that is white in time.

    Parameters
    ----------
    moments : Moments
    tolerance : float
        On the change of a value, in its own standard deviations.
    max_iterations : int
    """
    fit = ordinary(moments)
    for iteration in range(2, max_iterations + 1):
        previous, fit = fit, solve(moments, whitener(fit.noise_covariance, _torque_scale(moments)))
        fit = replace(fit, iterations=iteration)
        std = np.sqrt(np.diag(fit.white_covariance))
        if np.all(np.abs(fit.values - previous.values) <= tolerance * std):
            break
    return fit


def per_joint(moments: Moments) -> list[Fit]:
    """Fit each motor by itself with the pseudo-inverse, eq. (44); a parameter of several motors is found several times.

    Returns
    -------
    list of Fit
        One per motor, over the parameters that reach it.
    """
    fits = []
    X, y = moments.equations()
    for i, present in enumerate(moments.present):
        columns = np.flatnonzero(present)
        A, b = X[:, i, columns], y[:, i]
        values = np.linalg.pinv(A, rcond=1e-12) @ b
        variance = float(np.sum((b - A @ values) ** 2) / max(moments.n_samples, 1))
        names = tuple(moments.names[k] for k in columns)
        information = A.T @ A / max(variance, np.finfo(float).tiny)
        fits.append(Fit(names, values, np.array([[variance]]), information, _condition(A), moments.n_samples))
    return fits


def whitener(covariance: Vector, scale: Vector) -> Vector:
    r"""Give L^-1 of :math:`\Sigma = L L^T`, with a floor that keeps noise-free torques solvable.

    Parameters
    ----------
    covariance : ndarray, shape (n_motors, n_motors)
    scale : ndarray, shape (n_motors,)
        Size of the torques; noise below 1e-9 of it counts as that [N m].
    """
    std = np.maximum(np.sqrt(np.diag(covariance)), np.maximum(1e-9 * scale, 1e-150))
    correlation = covariance / np.outer(std, std)
    values, vectors = np.linalg.eigh(correlation)
    values = np.maximum(values, 1e-6)
    L = np.linalg.cholesky((vectors * values) @ vectors.T + 1e-12 * np.eye(len(std)))
    return np.linalg.inv(L) / std


def attenuation(information: Vector, noise: Vector, most: float = 0.5) -> tuple[Vector, Vector]:
    r"""Say what noise in the columns does to a fit, and undo it: errors in variables.

    With columns :math:`X + \delta`, least squares gives :math:`(X^T X + N)^{-1} X^T X\,\beta`, :math:`N` the mean of
    :math:`\delta^T \delta`: too small values where noise is a part of what excites them.

    Parameters
    ----------
    information : ndarray, shape (p, p)
        Of the noisy columns, X'X + N.
    noise : ndarray, shape (p, p)
        N.
    most : float
        Share of noise beyond which it is no longer undone.

    Returns
    -------
    correction : ndarray, shape (p, p)
        To be multiplied with the fitted values.
    share : ndarray, shape (p,)
        Of noise in what is left of each column beside the others.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    H, N = information * np.outer(scale, scale), noise * np.outer(scale, scale)
    root = np.linalg.inv(np.linalg.cholesky(H + 1e-14 * np.eye(len(H))))
    shares, V = np.linalg.eigh(root @ N @ root.T)
    V = root.T @ V
    lifted = 1.0 / (1.0 - np.clip(shares, 0.0, most))
    correction = scale[:, None] * ((V * lifted) @ V.T @ H) / scale
    inverse = np.linalg.pinv(H, hermitian=True)
    share = np.diag(inverse @ N @ inverse) / np.maximum(np.diag(inverse), np.finfo(float).tiny)
    return correction, share


def autocovariance(segments: Sequence[Vector], lags: int) -> Vector:
    """Mean lagged products over pieces of one series, shape (lags + 1,)."""
    total = np.zeros(lags + 1)
    for x in segments:
        for lag in range(min(lags, len(x) - 1) + 1):
            total[lag] += x[lag:] @ x[: len(x) - lag]
    return total / max(sum(map(len, segments)), 1)


def autoregression(segments: Sequence[Vector], max_order: int) -> tuple[Vector, float]:
    r"""Fit an autoregressive process to pieces of one series, by Burg's recursion, its order by Akaike's criterion.

    Parameters
    ----------
    segments : sequence of ndarray, each of shape (n,)
        Of mean zero.
    max_order : int

    Returns
    -------
    coefficients : ndarray, shape (order,)
        a of :math:`u_t = \sum_k a_k u_{t-k} + s w_t`; always stable.
    scale : float
        s.
    """
    n = sum(map(len, segments))
    variance = sum(float(x @ x) for x in segments) / max(n, 1)
    forward, backward = [x[1:] for x in segments], [x[:-1] for x in segments]
    a, best, chosen = np.zeros(0), np.inf, (np.zeros(0), variance)
    for order in range(min(max_order, n // 4) + 1):
        if variance <= 0:
            break
        criterion = n * np.log(variance) + 2 * n * order / max(n - order - 2, 1)
        if criterion < best:
            best, chosen = criterion, (a, variance)
        power = sum(float(f @ f + b @ b) for f, b in zip(forward, backward, strict=True))
        if power <= 0:
            break
        k = 2 * sum(float(f @ b) for f, b in zip(forward, backward, strict=True)) / power
        a = np.concatenate([a - k * a[::-1], [k]])
        pairs = [(f - k * b, b - k * f) for f, b in zip(forward, backward, strict=True)]
        forward, backward = [f[1:] for f, _ in pairs], [b[:-1] for _, b in pairs]
        variance *= 1 - k**2
    return frozen_array(chosen[0]), float(np.sqrt(chosen[1]))


def lost_freedom(covariance: Vector, n_samples: int, n_parameters: float, independent: float) -> float:
    r"""Factor on the variance of the noise for what the fit took out of its residual.

    Three things are made good: parameters take their share of the residual's independent values; few values make the
    variance itself uncertain (Student's t); and noise that changes as slowly as the columns do is fitted away unseen,
    by :math:`1 + (p/d)^2` for p parameters and a motion of d independent values, a rule found by simulation.

    Parameters
    ----------
    covariance : ndarray, shape (lags + 1,)
        Of the residual: noise that changes slowly has fewer independent values than samples.
    n_samples : int
    n_parameters : float
        That this series paid for.
    independent : float
        Values that the motion gives.
    """
    from scipy.stats import norm, t  # not at the top: it takes longer to load than most fits

    if covariance[0] <= 0:
        return 1.0
    values = n_samples * covariance[0] ** 2 / (covariance[0] ** 2 + 2 * np.sum(covariance[1:] ** 2))
    left = max(values - n_parameters, 0.25 * values, 3.0)
    slow = 1 + (n_parameters / max(independent, 1.0)) ** 2
    return float(slow * values / left * (t.ppf(0.95, left) / norm.ppf(0.95)) ** 2)


class Colour:
    r"""Accumulates :math:`X^T \Omega X` of columns under an autoregressive noise, block by block.

    With :math:`\Omega = s^2 A^{-1} A^{-T}` the product is the square of the columns filtered by s/A.

    Parameters
    ----------
    coefficients, scale
        Of the noise, from `autoregression`.
    width : int
        Number of columns.
    """

    def __init__(self, coefficients: Vector, scale: float, width: int):
        self.denominator, self.scale = np.concatenate([[1.0], -coefficients]), scale
        self.total = np.zeros((width, width))
        self.restart()

    def restart(self) -> None:
        """Begin a new stretch of samples."""
        self._state = np.zeros((len(self.denominator) - 1, len(self.total)))

    def add(self, X: Vector) -> None:
        """Fold in the next samples of a stretch, shape (n, width)."""
        from scipy.signal import lfilter

        if len(self._state):
            X, self._state = lfilter([self.scale], self.denominator, X, axis=0, zi=self._state)
        else:
            X = self.scale * X
        self.total += X.T @ X


def inverse(matrix: Vector, share: float = 1e-13) -> Vector:
    """Invert a symmetric positive matrix whose rows have units of their own, leaving out its null space.

    Parameters
    ----------
    matrix : ndarray, shape (p, p)
    share : float
        Of the largest eigenvalue, once all diagonal entries are scaled to 1, below which a direction counts as null.
    """
    scale = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = 1.0 / np.where(scale > 0, scale, 1.0)
    return np.linalg.pinv(matrix * np.outer(scale, scale), rcond=share, hermitian=True) * np.outer(scale, scale)


def sandwich(information: Vector, middle: Vector) -> Vector:
    """Covariance of a weighted fit, information^-1 middle information^-1, shape (p, p)."""
    bread = inverse(information)
    return bread @ middle @ bread


def solve(moments: Moments, white: Vector) -> Fit:
    """Fit by least squares after mixing the motors' equations with `white`, L^-1 of their noise covariance."""
    X, y = moments.equations()
    A = np.einsum("ij,wjp->iwp", white, X).reshape(y.size, X.shape[2])
    b = np.einsum("ij,wj->iw", white, y).reshape(y.size)
    norms = np.linalg.norm(A, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    values = np.linalg.lstsq(A / norms, b, rcond=None)[0] / norms if A.shape[1] else np.zeros(0)
    return Fit(
        moments.names,
        frozen_array(values),
        frozen_array(residual_covariance(moments, values)),
        frozen_array(A.T @ A),
        _condition(A),
        moments.n_samples,
    )


def _condition(A: Vector) -> float:
    if not A.size:
        return 1.0
    norms = np.linalg.norm(A, axis=0)
    singular = np.linalg.svd(A / np.where(norms > 0, norms, 1.0), compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")


def _torque_scale(moments: Moments) -> Vector:
    _, y = moments.equations()
    return np.linalg.norm(y, axis=0) / np.sqrt(max(moments.n_samples, 1))
