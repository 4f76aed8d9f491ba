r"""Dynamics of a planar serial arm in absolute link angles, in closed Lagrangian form.

With :math:`\varphi_i` the angle of link `i` against the base, the arm is

.. math:: \sum_j M_{ij}\ddot\varphi_j + h_i = Q_i, \qquad
   M_{ij} = l_j (s_{xi}\cos(\varphi_i-\varphi_j) - s_{yi}\sin(\varphi_i-\varphi_j)), \; j < i, \qquad M_{ii} = D_i

with the lumped first moments :math:`s_i = m_i c_i + (l_i \sum_{k>i} m_k, 0)` and
:math:`D_i = I_i + m_i |c_i|^2 + l_i^2 \sum_{k>i} m_k`. No recursion and no joint frame occurs; motor `i` of the paper's
arm drives :math:`\varphi_i` itself, so :math:`Q_i` is the torque of cable pair `i` on its drive pulley.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit


class Arm(NamedTuple):
    """A planar arm with cables: link data (n,) in SI units, the plane's gravity (2,), pulleys and pretension."""

    length: np.ndarray
    mass: np.ndarray
    cx: np.ndarray
    cy: np.ndarray
    inertia: np.ndarray  # about the centre of mass, zz [kg m^2]
    gravity: np.ndarray
    rotor: np.ndarray  # [kg m^2] at the motor
    ratio: float  # r_m / r_j
    joint_pulley_radius: float
    cable_angle: float  # theta_g0 [rad]; half a strand's wrap around a straight joint's pulley
    pretension: float  # [N] per strand


@njit(cache=True)
def lumped(arm):
    """Lump masses: D [kg m^2], s_x, s_y [kg m], each (n,)."""
    n = arm.length.size
    D, sx, sy = np.empty(n), np.empty(n), np.empty(n)
    beyond = 0.0
    for i in range(n - 1, -1, -1):
        m, l = arm.mass[i], arm.length[i]
        D[i] = arm.inertia[i] + m * (arm.cx[i] ** 2 + arm.cy[i] ** 2) + l * l * beyond
        sx[i] = m * arm.cx[i] + l * beyond
        sy[i] = m * arm.cy[i]
        beyond += m
    return D, sx, sy


@njit(cache=True)
def mass_and_bias(phi, w, length, D, sx, sy, gravity, M, h):
    """Fill M (n, n) and h (n,) [N m] of ``M a + h = Q`` at angles `phi` [rad] and rates `w` [rad/s]."""
    n = phi.size
    gx, gy = gravity[0], gravity[1]
    for i in range(n):
        c, s = np.cos(phi[i]), np.sin(phi[i])
        M[i, i] = D[i]
        h[i] = sx[i] * (s * gx - c * gy) + sy[i] * (c * gx + s * gy)
    for i in range(1, n):
        for j in range(i):
            c, s = np.cos(phi[i] - phi[j]), np.sin(phi[i] - phi[j])
            M[i, j] = M[j, i] = length[j] * (sx[i] * c - sy[i] * s)
            slope = -length[j] * (sx[i] * s + sy[i] * c)
            h[i] -= slope * w[j] * w[j]
            h[j] += slope * w[i] * w[i]


@njit(cache=True)
def solve_in_place(M, b):
    """Solve ``M x = b`` for a symmetric positive definite M; both are overwritten, `b` by x."""
    n = b.size
    for j in range(n):
        for k in range(j):
            M[j, j] -= M[j, k] * M[j, k]
        M[j, j] = np.sqrt(M[j, j])
        for i in range(j + 1, n):
            for k in range(j):
                M[i, j] -= M[i, k] * M[j, k]
            M[i, j] /= M[j, j]
    for i in range(n):
        for k in range(i):
            b[i] -= M[i, k] * b[k]
        b[i] /= M[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= M[k, i] * b[k]
        b[i] /= M[i, i]


@njit(cache=True)
def hinge_reactions(arm, phi, w, a, cable_torque, out):
    r"""Fill `out` (n,) with the size of the force [N] that each hinge carries, cables' pull included.

    Everything distal of hinge `i` is cut free. The strands of cable `j > i` are cut where they leave for link `i`
    (frame `i`: :math:`(-c\Sigma, s\Delta_j)`), those of cable `i` where they arrive from link `i-1` (frame `i-1`:
    :math:`-(c\Sigma, s\Delta_i)`), with :math:`\Delta_j = C_j / r_j`, :math:`\Sigma = 2 T_0`.
    """
    n = phi.size
    fx, fy = np.zeros(n), np.zeros(n)  # inertia force of link i alone
    ox, oy = -arm.gravity[0], -arm.gravity[1]  # acceleration of O_i less gravity
    for i in range(n):
        c, s = np.cos(phi[i]), np.sin(phi[i])
        ux = -w[i] * w[i] * arm.cx[i] - a[i] * arm.cy[i]
        uy = a[i] * arm.cx[i] - w[i] * w[i] * arm.cy[i]
        fx[i] = arm.mass[i] * (ox + c * ux - s * uy)
        fy[i] = arm.mass[i] * (oy + s * ux + c * uy)
        ox += arm.length[i] * (-w[i] * w[i] * c - a[i] * s)
        oy += arm.length[i] * (-w[i] * w[i] * s + a[i] * c)
    cg, sg = np.cos(arm.cable_angle), np.sin(arm.cable_angle)
    pull = 2.0 * arm.pretension * cg
    x = y = 0.0
    beyond = 0.0  # sum of Delta of the cables that go on past hinge i
    for i in range(n - 1, -1, -1):
        x += fx[i]
        y += fy[i]
        crossing = n - 1 - i
        c, s = np.cos(phi[i]), np.sin(phi[i])
        px, py = -pull * crossing, sg * beyond
        cx, cy = c * px - s * py, s * px + c * py
        before = phi[i - 1] if i > 0 else 0.0
        c, s = np.cos(before), np.sin(before)
        delta = cable_torque[i] / arm.joint_pulley_radius
        px, py = -pull, -sg * delta
        cx += c * px - s * py
        cy += s * px + c * py
        out[i] = np.hypot(x - cx, y - cy)
        beyond += delta


@njit(cache=True)
def rigid_columns(length, gravity, phi, w, a):
    """Give derivatives (N, n, 3 n) of the link torques Q with respect to (D, s_x, s_y): they are linear in them.

    Taken as differences of the closed form itself, at unit parameters; the exact span of every rigid body of these
    lengths (a rotor's inertia included, which adds to D).
    """
    N, n = phi.shape
    out = np.empty((N, n, 3 * n))
    M, h = np.empty((n, n)), np.empty(n)
    for p in range(3 * n):
        D, sx, sy = np.zeros(n), np.zeros(n), np.zeros(n)
        (D if p < n else sx if p < 2 * n else sy)[p % n] = 1.0
        for k in range(N):
            mass_and_bias(phi[k], w[k], length, D, sx, sy, gravity, M, h)
            out[k, :, p] = M @ a[k] + h
    return out
