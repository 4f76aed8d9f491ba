r"""Motor torques as linear functions of inertial parameters, :math:`\tau_m = E^T Y(q, v, a)\,\pi_{std}`.

Nothing here keeps the observation matrix of a recording: rows are folded into a `Triangle`, whose size does not depend
on their number.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import reduce

import numpy as np
from scipy.linalg.lapack import dgeqrf

from .dynamics import joint_torque_regressor
from .errors import ShapeError
from .geometry import Vector, frozen_array
from .model import CableModel

BLOCK = 2048  # samples


def motor_regressor(model: CableModel, q: Vector, v: Vector, a: Vector) -> Vector:
    r"""Compute the regressor of the motor torques, :math:`Y_m = E^T Y`, eq. (43).

    Parameters
    ----------
    model : CableModel
    q, v, a : ndarray, shape (n_samples, n_joints)
        Joint positions, velocities, accelerations [rad or m, s].

    Returns
    -------
    ndarray, shape (n_samples, n_motors, 10 n_joints)
        Columns in the order of `CableModel.standard_parameters`; rotor inertia is not among them.

    Raises
    ------
    ShapeError
        If the arrays disagree with the model or with each other.
    """
    Y = joint_torque_regressor(model, q, v, a)
    E = model.joint_from_motor
    return Y if np.array_equal(E, np.eye(len(E))) else np.matmul(E.T, Y)


def blocks(n_samples: int, size: int = BLOCK) -> Iterator[slice]:
    """Cut ``range(n_samples)`` into slices of at most `size`."""
    for start in range(0, n_samples, size):
        yield slice(start, min(start + size, n_samples))


@dataclass(frozen=True)
class Triangle:
    r"""Triangular factor R of a tall matrix A = Q R: all that a linear fit needs of its rows.

    For any columns x, y of A, :math:`x^T y` is that of the same columns of R, without squaring the condition number.

    Attributes
    ----------
    R : ndarray, shape (width, width)
        Upper triangular, diagonal not negative.
    n_rows : int
        Rows of A so far.
    """

    R: Vector
    n_rows: int = 0

    @classmethod
    def empty(cls, width: int) -> Triangle:
        """Give the triangle of no rows."""
        return cls(frozen_array(np.zeros((width, width))))

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.R.shape[1]

    @property
    def gram(self) -> Vector:
        """A' A, shape (width, width)."""
        return self.R.T @ self.R

    def add(self, rows: Vector) -> Triangle:
        """Fold in more rows, shape (n, width).

        Raises
        ------
        ShapeError
            If the width differs.
        """
        if rows.ndim != 2 or rows.shape[1] != self.width:
            raise ShapeError(f"rows have shape {rows.shape}, (n, {self.width}) was expected")
        if not len(rows):
            return self
        known = 0 if self.n_rows == 0 else self.width
        stacked = np.empty((known + len(rows), self.width), order="F")
        stacked[:known], stacked[known:] = self.R[:known], rows
        return Triangle(frozen_array(_triangle(stacked, self.width)), self.n_rows + len(rows))

    def merge(self, other: Triangle) -> Triangle:
        """Give the triangle of both matrices on top of each other."""
        merged = self.add(other.R)
        return Triangle(merged.R, self.n_rows + other.n_rows)

    def select(self, columns: Iterable[int] | Vector) -> Triangle:
        """Give the triangle of these columns alone, in this order."""
        part = self.R[:, np.asarray(columns, dtype=int)]
        return Triangle(frozen_array(_triangle(part, part.shape[1])), self.n_rows)

    def transform(self, matrix: Vector) -> Triangle:
        """Give the triangle of A @ matrix, matrix of shape (width, new_width)."""
        part = self.R @ matrix
        return Triangle(frozen_array(_triangle(part, part.shape[1])), self.n_rows)


def merge(triangles: Iterable[Triangle]) -> Triangle:
    """Merge triangles in the order given.

    Raises
    ------
    TypeError
        If there is none.
    """
    return reduce(Triangle.merge, triangles)


def _triangle(rows: Vector, width: int) -> Vector:
    """R of the QR factorisation, square and with a diagonal that is not negative; rows in Fortran order are used up."""
    R = np.zeros((width, width))
    if not len(rows) or not width:
        return R
    factor = np.triu(dgeqrf(rows, lwork=64 * width, overwrite_a=True)[0][:width])
    R[: len(factor)] = factor
    R[np.diag(R) < 0] *= -1.0
    return R
