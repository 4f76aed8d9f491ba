"""Periodic joint motion as a Fourier series: eqs (45), (47), and the refit (52)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .errors import ShapeError
from .geometry import Vector, frozen_array


@dataclass(frozen=True)
class FourierSeries:
    r"""One finite Fourier series per joint over a shared base frequency, eq. (45).

    :math:`q_i(t) = c_i + \sum_k a_{ik} \cos(k w t) + b_{ik} \sin(k w t)`; the paper has no constant.

    Attributes
    ----------
    frequency : float
        Base frequency w [rad/s].
    center : ndarray, shape (n_joints,)
        Constant c [rad or m].
    cosine, sine : ndarray, shape (n_joints, n_harmonics)
        Coefficients a, b of harmonics 1, 2, ... [rad or m].

    Raises
    ------
    ShapeError
        If the arrays disagree, or there is no harmonic.
    """

    frequency: float
    center: Vector
    cosine: Vector
    sine: Vector

    def __post_init__(self):
        for name in ("center", "cosine", "sine"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))
        if self.cosine.ndim != 2 or self.cosine.shape != self.sine.shape or len(self.center) != len(self.cosine):
            raise ShapeError(
                f"center {self.center.shape}, cosine {self.cosine.shape} and sine {self.sine.shape} disagree; "
                "(n_joints,) and twice (n_joints, n_harmonics) were expected"
            )
        if not self.cosine.shape[1]:
            raise ShapeError("a Fourier series without harmonics does not move; at least 1 was expected")

    @classmethod
    def closed(cls, frequency: float, cosine: Vector, sine: Vector) -> FourierSeries:
        """Append the harmonic that makes the series start at zero, eq. (47).

        Parameters
        ----------
        frequency : float
            [rad/s].
        cosine, sine : ndarray, shape (n_joints, n)
            Free coefficients; the series gets n + 1 harmonics.
        """
        cosine, sine = close(np.asarray(cosine, float)), close(np.asarray(sine, float))
        return cls(frequency, np.zeros(len(cosine)), cosine, sine)

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return self.cosine.shape[1]

    @property
    def period(self) -> float:
        """Duration of one period [s]."""
        return 2 * np.pi / self.frequency

    def __call__(self, time: Vector) -> tuple[Vector, Vector, Vector]:
        """Evaluate positions, velocities and accelerations, each of shape (n_samples, n_joints), at times [s]."""
        k = self.frequency * np.arange(1, self.harmonics + 1)
        phase = np.multiply.outer(np.atleast_1d(np.asarray(time, float)), k)
        c, s = np.cos(phase), np.sin(phase)
        q = c @ self.cosine.T + s @ self.sine.T
        v = c @ (k * self.sine).T - s @ (k * self.cosine).T
        a = -c @ (k**2 * self.cosine).T - s @ (k**2 * self.sine).T
        return q + self.center, v, a

    def scaled(self, factor: float | Vector) -> FourierSeries:
        """Multiply the amplitudes (not the centre) of all joints, or of each by its own factor."""
        column = np.broadcast_to(factor, self.center.shape)[:, None]
        return replace(self, cosine=self.cosine * column, sine=self.sine * column)

    def delayed(self, time: float) -> FourierSeries:
        """Give the series whose value at zero is this one's at `time` [s]."""
        phase = self.frequency * time * np.arange(1, self.harmonics + 1)
        c, s = np.cos(phase), np.sin(phase)
        return replace(self, cosine=self.cosine * c + self.sine * s, sine=self.sine * c - self.cosine * s)


def close(coefficients: Vector) -> Vector:
    """Append minus their sum along the last axis, eq. (47)."""
    return np.concatenate([coefficients, -coefficients.sum(axis=-1, keepdims=True)], axis=-1)


@dataclass(frozen=True)
class PeriodGrid:
    """Evaluates many series at once on a uniform grid over one period of each.

    Attributes
    ----------
    samples, harmonics : int
        Size of the grid and of the series.
    """

    samples: int
    harmonics: int

    def __post_init__(self):
        phase = np.multiply.outer(np.arange(1, self.harmonics + 1), 2 * np.pi * np.arange(self.samples) / self.samples)
        object.__setattr__(self, "_c", np.cos(phase))
        object.__setattr__(self, "_s", np.sin(phase))

    def __call__(self, frequency: Vector, cosine: Vector, sine: Vector) -> tuple[Vector, Vector, Vector]:
        """Evaluate m series without their centres.

        Parameters
        ----------
        frequency : ndarray, shape (m,)
            [rad/s].
        cosine, sine : ndarray, shape (m, n_joints, harmonics)

        Returns
        -------
        dq, v, a : ndarray, shape (m, n_joints, samples)
        """
        c, s = self._c, self._s  # type: ignore[attr-defined]
        k = np.arange(1, self.harmonics + 1)
        w = np.asarray(frequency)[:, None, None]
        dq = cosine @ c + sine @ s
        v = w * ((k * sine) @ c - (k * cosine) @ s)
        a = -(w**2) * ((k**2 * cosine) @ c + (k**2 * sine) @ s)
        return dq, v, a

    @property
    def overshoot(self) -> float:
        """Bound on peak over largest sample, 1/cos(pi K / N): a series of K harmonics cannot hide more between samples.

        Raises
        ------
        ShapeError
            If the grid has too few samples for such a bound.
        """
        if self.samples <= 2 * self.harmonics:
            raise ShapeError(f"{self.samples} samples cannot carry {self.harmonics} harmonics")
        return 1.0 / np.cos(np.pi * self.harmonics / self.samples)


def fit_series(time: Vector, q: Vector, harmonics: int, frequency: float, *, constant: bool = False) -> FourierSeries:
    """Refit coefficients and base frequency to an actual trajectory by least squares, eq. (52).

    Parameters
    ----------
    time : ndarray, shape (n_samples,)
        [s].
    q : ndarray, shape (n_samples, n_joints)
        Measured joint positions [rad or m].
    harmonics : int
    frequency : float
        First guess of the base frequency, that of the desired trajectory [rad/s].
    constant : bool
        Also fit a centre, which eq. (52) leaves out.

    Returns
    -------
    FourierSeries

    Raises
    ------
    ShapeError
        If the arrays disagree or there are fewer samples than coefficients.
    """
    time, q = np.asarray(time, float), np.atleast_2d(np.asarray(q, float))
    if len(time) != len(q) or len(time) < 2 * harmonics + 2:
        raise ShapeError(
            f"{len(time)} times and {len(q)} positions; equal numbers and more than {2 * harmonics + 1} were expected"
        )
    middle = 0.5 * (time[0] + time[-1])
    for _ in range(20):
        step = _frequency_step(time, q, harmonics, frequency, constant, middle)
        frequency += step
        if abs(step) < 1e-13 * frequency:
            break
    columns = _columns(time, harmonics, frequency, constant)
    x = frozen_array(np.linalg.lstsq(columns, q, rcond=None)[0].T)
    center = x[:, -1] if constant else np.zeros(len(x))
    return FourierSeries(frequency, center, x[:, :harmonics], x[:, harmonics : 2 * harmonics])


def _columns(time: Vector, harmonics: int, frequency: float, constant: bool) -> Vector:
    phase = np.multiply.outer(time, frequency * np.arange(1, harmonics + 1))
    parts = [np.cos(phase), np.sin(phase)]
    return np.hstack([*parts, np.ones((len(time), 1))] if constant else parts)


def _frequency_step(time, q, harmonics, frequency, constant, middle) -> float:
    """Gauss-Newton step of the base frequency with the coefficients eliminated (variable projection)."""
    columns = _columns(time, harmonics, frequency, constant)
    x = np.linalg.lstsq(columns, q, rcond=None)[0]
    k = np.arange(1, harmonics + 1)
    c, s = columns[:, :harmonics], columns[:, harmonics : 2 * harmonics]
    slope = (time - middle)[:, None] * ((c * k) @ x[harmonics : 2 * harmonics] - (s * k) @ x[:harmonics])
    rest = q - columns @ x
    slope = slope - columns @ np.linalg.lstsq(columns, slope, rcond=None)[0]
    return float((slope * rest).sum() / max((slope**2).sum(), 1e-300))
