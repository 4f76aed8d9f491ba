r"""How the cables tie motors to joints, errors of manufacture included.

:math:`q_{m,i} r_m/r_j = x_i + \psi_i`, with the path
:math:`\psi_i = \sum_{k \le i}(1 + \epsilon_{ik})\theta_k + \rho_i(\sin(\theta_i + \alpha_i) - \sin\alpha_i)` of an
inextensible cable and the lost length :math:`x_i`. Torque follows by virtual work, :math:`\tau = P^T C` with
:math:`P = \partial\psi/\partial\theta`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable


class Cables(NamedTuple):
    """Cable data: ratio errors (n, n) cable by joint, eccentricities, phases, elasticity, backlash, strands."""

    ratio_error: np.ndarray  # lower triangular
    eccentricity: np.ndarray  # (n,)
    phase: np.ndarray  # (n,) [rad]
    stiffness: np.ndarray  # (n,) [N m/rad] of x; inf is rigid
    damping: np.ndarray  # (n,) [N m s/rad]
    half_gap: np.ndarray  # (n,) [rad] of x
    slack: np.ndarray  # (n,) [N m] at which one strand hangs; inf where both always pull
    rotor_coupling: np.ndarray  # (n, n) rad of rotor i per rad of joint k, beyond its own motor angle


def ideal_cables(n: int) -> Cables:
    """Give rigid cables of the nominal map."""
    zero, rigid = np.zeros(n), np.full(n, np.inf)
    return Cables(np.zeros((n, n)), zero, zero.copy(), rigid, zero.copy(), zero.copy(), rigid.copy(), np.zeros((n, n)))


@njit(cache=True)
def path(cables, theta, rate, acceleration, psi, dpsi, ddpsi, P):
    """Fill psi, its two time derivatives (n,) and P (n, n)."""
    n = theta.size
    for i in range(n):
        e, x = cables.eccentricity[i], theta[i] + cables.phase[i]
        psi[i] = e * (np.sin(x) - np.sin(cables.phase[i]))
        dpsi[i] = 0.0
        ddpsi[i] = -e * np.sin(x) * rate[i] * rate[i]
        for k in range(n):
            P[i, k] = 1.0 + cables.ratio_error[i, k] if k <= i else 0.0
            psi[i] += P[i, k] * theta[k]
        P[i, i] += e * np.cos(x)
        for k in range(i + 1):
            dpsi[i] += P[i, k] * rate[k]
            ddpsi[i] += P[i, k] * acceleration[k]


@njit(cache=True)
def cable_torques(P, tau, C):
    """Solve P^T C = tau for the cable torques (n,) [N m]; P is lower triangular."""
    for i in range(tau.size - 1, -1, -1):
        C[i] = tau[i]
        for j in range(i + 1, tau.size):
            C[i] -= P[j, i] * C[j]
        C[i] /= P[i, i]


@njit(cache=True)
def stretch_torque(cables, i, x, dx):
    """Torque [N m] of cable pair `i` at lost length `x` [rad]: gap, two strands of which one may hang, damping."""
    gap, k = cables.half_gap[i], cables.stiffness[i]
    if abs(x) <= gap:
        return 0.0
    y = x - gap if x > 0 else x + gap
    C = k * y
    if abs(C) > cables.slack[i]:  # one strand left: half the stiffness
        C = np.sign(C) * (cables.slack[i] + 0.5 * (abs(C) - cables.slack[i]))
    C += cables.damping[i] * dx
    return C if gap == 0.0 or C * y > 0 else 0.0


@register_jitable
def strained(C, stiffness, slack):
    """Stretch [rad] at which cables hold torques `C` [N m] at rest, zero for rigid ones: `stretch_torque` turned round.

    Without its gap and damping.
    """
    return (C + np.sign(C) * np.maximum(np.abs(C) - slack, 0.0)) / stiffness


def stretched(cables: Cables, C: np.ndarray, step: float) -> np.ndarray:
    """Lost length (N, n) [rad] of cables under slowly changing torques C (N, n): elasticity, slack, gap."""
    x = strained(C, cables.stiffness, cables.slack)
    lag = np.where(np.isfinite(cables.stiffness), cables.damping / cables.stiffness, 0.0)
    return x - lag * np.gradient(x, step, axis=0) + cables.half_gap * np.tanh(C / 0.02)


def joints_from_motors(cables: Cables, ratio: float, q_m: np.ndarray) -> np.ndarray:
    """Solve the inextensible path for the joint angles (N, n) [rad] that motor angles `q_m` (N, n) stand for."""
    psi = q_m * ratio
    n = psi.shape[1]
    A = np.tril(1.0 + cables.ratio_error)
    theta = np.linalg.solve(A, psi.T).T
    for _ in range(20 if cables.eccentricity.any() else 0):
        bend = cables.eccentricity * (np.sin(theta + cables.phase) - np.sin(cables.phase))
        theta = np.linalg.solve(A, (psi - bend).T).T
    return theta.reshape(-1, n)
