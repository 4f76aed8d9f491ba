"""The worked example of Yan et al.: the arm of Table 1, Table 2's limits, and eqs (44), (53)-(68) as printed.

Nothing of the general toolkit depends on this module; it is what the toolkit's results are held against.
"""

from __future__ import annotations

import numba
import numpy as np

from .fourier import FourierSeries
from .geometry import Vector, frozen_array
from .limits import Limits, parse_limits
from .model import CableModel
from .objectives import Largest, Objective, condition_number

GRAVITY = 9.8  # [m/s^2]
HARMONICS = 3  # free ones; eq. (47) appends the fourth
FREQUENCY = (1e-3, np.pi / 6)  # [rad/s], Table 2's w_max
DURATION, RATE, DROPPED = 300.0, 100.0, 10.0  # [s], [1/s], [s]

NAMES = ("P_11", "P_21", "P_31", "P_12", "P_22", "P_32")
NOMINAL = frozen_array([0.6, 0.36, 1.2, 0.12, 0.36, 0.6])
"""Eqs (67), (68)."""
PRINTED_ESTIMATE = frozen_array([0.5997, 0.3501, 1.2007, 0.1195, 0.3686, 0.6001])
"""Eqs (65), (66)."""


def _series(*rows: tuple[list[float], list[float]]) -> FourierSeries:
    return FourierSeries(0.345, np.zeros(2), np.array([row[0] for row in rows]), np.array([row[1] for row in rows]))


DESIRED = _series(
    ([0.0174, 0.00872, -0.00194, -0.0242], [-0.0114, 0.0234, -0.0122, 2.0e-4]),
    ([-0.113, 0.0717, 0.0146, 0.0267], [-0.0233, -0.0197, -0.00164, 0.0446]),
)
"""Eqs (61), (62): the printed optimum. It breaks Table 2's acceleration limit at joint 2 by a factor of 2.28."""
ACTUAL = _series(
    ([0.0177, 0.00893, -0.00198, -0.0247], [-0.0117, 0.0239, -0.0125, 2.35e-4]),
    ([-0.114, 0.0723, 0.0147, 0.0267], [-0.0235, -0.0197, -0.00176, 0.045]),
)
"""Eqs (63), (64): the printed refit of the motion that came of it."""


def table_2(model: CableModel) -> Limits:
    """Give the limits of Table 2, the same for both joints."""
    joint = {"position": [-np.pi / 6, np.pi / 6], "velocity": np.pi / 24, "acceleration": np.pi / 48}
    return parse_limits({"joints": [joint, joint]}, model)


def coefficient_matrices(q: Vector, v: Vector, a: Vector, gravity: float = GRAVITY) -> tuple[Vector, Vector]:
    """Compute the coefficient matrices of both motors, eqs (55), (56), (59), (60).

    Parameters
    ----------
    q, v, a : ndarray, shape (n_samples, 2)
    gravity : float
        [m/s^2].

    Returns
    -------
    tuple of ndarray, shape (n_samples, 3)
        Columns of P_11, P_21, P_31 and of P_12, P_22, P_32.
    """
    c2, s2 = np.cos(q[:, 1]), np.sin(q[:, 1])
    both = a[:, 0] + a[:, 1]
    coupling = 0.5 * c2 * both - 0.5 * s2 * (v[:, 0] ** 2 + v[:, 1] ** 2) - v[:, 0] * v[:, 1] * s2
    first = np.column_stack([a[:, 0], coupling, gravity * np.cos(q[:, 0])])
    coupling = 0.5 * a[:, 0] * c2 + 0.5 * v[:, 0] ** 2 * s2
    second = np.column_stack([both, coupling, 0.5 * gravity * np.cos(q[:, 0] + q[:, 1])])
    return first, second


def stacked_matrix(first: Vector, second: Vector) -> Vector:
    """Stack both motors' rows over P_11, P_21, P_31, P_12, P_32, the coupling l_1 l_2 m_2 being one parameter."""
    stacked = np.zeros((2 * len(first), 5))
    stacked[: len(first), :3] = first
    stacked[len(first) :, [3, 1, 4]] = second
    return stacked


def per_joint_estimate(first: Vector, second: Vector, tau_m: Vector) -> Vector:
    """Estimate P_11 .. P_32 motor by motor with the pseudo-inverse, eq. (44).

    Parameters
    ----------
    first, second : ndarray, shape (n_samples, 3)
    tau_m : ndarray, shape (n_samples, 2)
        [N m].

    Returns
    -------
    ndarray, shape (6,)
    """
    return frozen_array(np.concatenate([np.linalg.pinv(first) @ tau_m[:, 0], np.linalg.pinv(second) @ tau_m[:, 1]]))


def shared_estimate(first: Vector, second: Vector, tau_m: Vector) -> Vector:
    """Estimate with P_21 = P_22 shared by both motors; shape (6,), the shared value given twice."""
    x = frozen_array(np.linalg.lstsq(stacked_matrix(first, second), tau_m.T.ravel(), rcond=None)[0])
    return x[[0, 1, 2, 3, 1, 4]]


def relative_errors(matrix: Vector, nominal: Vector, noise: float = 1.0) -> Vector:
    """Predict relative standard errors of a least-squares estimate from its matrix and torque noise [N m]."""
    return noise * np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix))) / nominal


def paper_condition(*, stacked: bool = False) -> Objective:
    """Give the paper's objective: the larger condition number of eqs (59), (60).

    Parameters
    ----------
    stacked : bool
        That of `stacked_matrix` instead.
    """
    if stacked:
        return lambda q, v, a: condition_number(_stacked_gram(_grams(q, v, a, GRAVITY)))
    return Largest(lambda q, v, a: condition_number(_grams(q, v, a, GRAVITY)))


def _stacked_gram(grams: Vector) -> Vector:
    total = np.zeros((len(grams), 5, 5))
    total[:, :3, :3] = grams[:, 0]
    total[:, [[3], [1], [4]], [3, 1, 4]] += grams[:, 1]
    return total


@numba.njit(cache=True)
def _grams(q, v, a, gravity):
    """Sum the products of the columns of eqs (59), (60) over the samples, shape (m, 2, 3, 3)."""
    m, n_samples, _ = q.shape
    result = np.zeros((m, 2, 3, 3))
    row = np.empty((2, 3))
    for i in range(m):
        for k in range(n_samples):
            c2, s2 = np.cos(q[i, k, 1]), np.sin(q[i, k, 1])
            v1, v2, a1, both = v[i, k, 0], v[i, k, 1], a[i, k, 0], a[i, k, 0] + a[i, k, 1]
            row[0, 0] = a1
            row[0, 1] = 0.5 * c2 * both - 0.5 * s2 * (v1 * v1 + v2 * v2) - v1 * v2 * s2
            row[0, 2] = gravity * np.cos(q[i, k, 0])
            row[1, 0] = both
            row[1, 1] = 0.5 * a1 * c2 + 0.5 * v1 * v1 * s2
            row[1, 2] = 0.5 * gravity * np.cos(q[i, k, 0] + q[i, k, 1])
            for j in range(2):
                for r in range(3):
                    for c in range(3):
                        result[i, j, r, c] += row[j, r] * row[j, c]
    return result
