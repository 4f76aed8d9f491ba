"""Motor and joint coordinates of an arm of cables: q = E q_m + offset, tau_m = E' tau (eqs 6, 16)."""

from __future__ import annotations

import numpy as np

from .geometry import Pulleys, Vector


def cable_travel(pulleys: Pulleys) -> Vector:
    r"""Give how far each cable runs per joint angle: row i of the moment-arm matrix.

    Cable i passes the joints before its own over joint guide pulleys and drives joint i, so
    :math:`r_{m,i} q_i = \sum_{k \le i} r_{j,k} \theta_k`, which is eq. (6) summed up and allows radii that differ.

    Returns
    -------
    ndarray, shape (n, n)
        Lower triangular [m/rad].
    """
    return np.tril(np.broadcast_to(pulleys.joint_pulley_radius, (len(pulleys.joint_pulley_radius),) * 2))


def motor_from_joint(pulleys: Pulleys) -> Vector:
    r"""Give the inverse of E, :math:`q_i = \sum_{k \le i} (r_{j,k} / r_{m,i})\,\theta_k`, shape (n, n)."""
    return cable_travel(pulleys) / pulleys.motor_pulley_radius[:, None]


def joint_from_motor(pulleys: Pulleys) -> Vector:
    r"""Give E of :math:`\theta = E q`, eq. (6); with one radius it is (r_m / r_j) bidiagonal(1, -1).

    Virtual work then gives :math:`\tau_{m,i} = r_{m,i} (\tau_i / r_{j,i} - \tau_{i+1} / r_{j,i+1})`, eq. (16).

    Returns
    -------
    ndarray, shape (n, n)
    """
    r_m, r_j = pulleys.motor_pulley_radius, pulleys.joint_pulley_radius
    return np.diag(r_m / r_j) - np.diag(r_m[:-1] / r_j[1:], -1)
