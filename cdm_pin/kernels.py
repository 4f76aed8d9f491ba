"""Compiled loops over samples: the recursive Newton-Euler algorithm and its regressor on a tree of bodies.

Arrays describe the tree as `cdm_pin.model.Chain` does. Vectors are in the body's own frame and gravity enters as an
acceleration of the base.
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, inline="always")
def _cross(x, y, out):
    out[0] = x[1] * y[2] - x[2] * y[1]
    out[1] = x[2] * y[0] - x[0] * y[2]
    out[2] = x[0] * y[1] - x[1] * y[0]


@numba.njit(cache=True)
def _rotation(axis, angle, R):
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = axis[0], axis[1], axis[2]
    R[0, 0] = c + x * x * (1 - c)
    R[0, 1] = x * y * (1 - c) - z * s
    R[0, 2] = x * z * (1 - c) + y * s
    R[1, 0] = y * x * (1 - c) + z * s
    R[1, 1] = c + y * y * (1 - c)
    R[1, 2] = y * z * (1 - c) - x * s
    R[2, 0] = z * x * (1 - c) - y * s
    R[2, 1] = z * y * (1 - c) + x * s
    R[2, 2] = c + z * z * (1 - c)


@numba.njit(cache=True)
def _motion(order, parent, rotation, translation, axis, prismatic, gravity, q, v, a, R, p, w, dw, dv):
    """Advance pose in parent (R, p), angular velocity w, angular and linear acceleration dw, dv from base to tip."""
    spin = np.empty((3, 3))
    wp, dwp, dvp = np.empty(3), np.empty(3), np.empty(3)
    t1, t2, t3 = np.empty(3), np.empty(3), np.empty(3)
    for k in order:
        if prismatic[k]:
            R[k] = rotation[k]
            for i in range(3):
                p[k, i] = translation[k, i]
                for j in range(3):
                    p[k, i] += rotation[k, i, j] * axis[k, j] * q[k]
        else:
            _rotation(axis[k], q[k], spin)
            for i in range(3):
                p[k, i] = translation[k, i]
                for j in range(3):
                    R[k, i, j] = 0.0
                    for m in range(3):
                        R[k, i, j] += rotation[k, i, m] * spin[m, j]
        if parent[k] < 0:
            wp[:] = 0.0
            dwp[:] = 0.0
            dvp[:] = -gravity
        else:
            wp[:] = w[parent[k]]
            dwp[:] = dw[parent[k]]
            dvp[:] = dv[parent[k]]
        # acceleration of the joint's origin, still in the parent's frame
        _cross(dwp, p[k], t1)
        _cross(wp, p[k], t2)
        _cross(wp, t2, t3)
        for i in range(3):
            t1[i] += t3[i] + dvp[i]
        for i in range(3):
            w[k, i] = 0.0
            dw[k, i] = 0.0
            dv[k, i] = 0.0
            for j in range(3):
                w[k, i] += R[k, j, i] * wp[j]
                dw[k, i] += R[k, j, i] * dwp[j]
                dv[k, i] += R[k, j, i] * t1[j]
        _cross(w[k], axis[k], t2)
        if prismatic[k]:
            for i in range(3):
                dv[k, i] += axis[k, i] * a[k] + 2.0 * v[k] * t2[i]
        else:
            for i in range(3):
                dw[k, i] += axis[k, i] * a[k] + v[k] * t2[i]
                w[k, i] += axis[k, i] * v[k]


@numba.njit(cache=True)
def rnea(order, parent, rotation, translation, axis, prismatic, gravity, pi_std, q, v, a):
    """Give joint torques (n_samples, n) and the wrench that crosses each joint (n_samples, n, 6)."""
    n_samples, n = q.shape
    tau = np.empty((n_samples, n))
    wrench = np.empty((n_samples, n, 6))
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    w, dw, dv = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    f, m = np.empty((n, 3)), np.empty((n, 3))
    t1, t2, t3 = np.empty(3), np.empty(3), np.empty(3)
    I = np.empty((3, 3))
    for s in range(n_samples):
        _motion(order, parent, rotation, translation, axis, prismatic, gravity, q[s], v[s], a[s], R, p, w, dw, dv)
        for k in range(n):
            mass, h = pi_std[10 * k], pi_std[10 * k + 1 : 10 * k + 4]
            xx, xy, yy, xz, yz, zz = pi_std[10 * k + 4 : 10 * k + 10]
            I[0, 0], I[0, 1], I[0, 2] = xx, xy, xz
            I[1, 0], I[1, 1], I[1, 2] = xy, yy, yz
            I[2, 0], I[2, 1], I[2, 2] = xz, yz, zz
            _cross(dw[k], h, t1)
            _cross(w[k], h, t2)
            _cross(w[k], t2, t3)
            for i in range(3):
                f[k, i] = mass * dv[k, i] + t1[i] + t3[i]
                t1[i] = I[i, 0] * dw[k, 0] + I[i, 1] * dw[k, 1] + I[i, 2] * dw[k, 2]
                t2[i] = I[i, 0] * w[k, 0] + I[i, 1] * w[k, 1] + I[i, 2] * w[k, 2]
            _cross(w[k], t2, t3)
            _cross(h, dv[k], t2)
            for i in range(3):
                m[k, i] = t1[i] + t3[i] + t2[i]
        for j in range(n - 1, -1, -1):
            k = order[j]
            wrench[s, k, :3] = f[k]
            wrench[s, k, 3:] = m[k]
            up = parent[k]
            if up >= 0:
                for i in range(3):
                    t1[i] = R[k, i, 0] * f[k, 0] + R[k, i, 1] * f[k, 1] + R[k, i, 2] * f[k, 2]
                    t2[i] = R[k, i, 0] * m[k, 0] + R[k, i, 1] * m[k, 1] + R[k, i, 2] * m[k, 2]
                _cross(p[k], t1, t3)
                for i in range(3):
                    f[up, i] += t1[i]
                    m[up, i] += t2[i] + t3[i]
            tau[s, k] = 0.0
            for i in range(3):
                tau[s, k] += axis[k, i] * (f[k, i] if prismatic[k] else m[k, i])
    return tau, wrench


@numba.njit(cache=True)
def _body_regressor(w, dw, dv, F):
    """Write force (rows 0-2) and moment (rows 3-5) of one body against m, m c, Ixx Ixy Iyy Ixz Iyz Izz."""
    F[:] = 0.0
    for i in range(3):
        F[i, 0] = dv[i]
    # S = [dw]x + [w]x [w]x maps m c to force; the moment takes -[dv]x
    ww = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    for i in range(3):
        for j in range(3):
            F[i, 1 + j] = w[i] * w[j] - (ww if i == j else 0.0)
    F[0, 2] -= dw[2]
    F[0, 3] += dw[1]
    F[1, 1] += dw[2]
    F[1, 3] -= dw[0]
    F[2, 1] -= dw[1]
    F[2, 2] += dw[0]
    F[3, 2], F[3, 3] = dv[2], -dv[1]
    F[4, 1], F[4, 3] = -dv[2], dv[0]
    F[5, 1], F[5, 2] = dv[1], -dv[0]
    # I dw + w x (I w), columns xx xy yy xz yz zz
    F[3, 4], F[4, 4], F[5, 4] = dw[0], w[0] * w[2], -w[0] * w[1]
    F[3, 5], F[4, 5], F[5, 5] = dw[1] - w[0] * w[2], dw[0] + w[1] * w[2], w[0] * w[0] - w[1] * w[1]
    F[3, 6], F[4, 6], F[5, 6] = -w[1] * w[2], dw[1], w[0] * w[1]
    F[3, 7], F[4, 7], F[5, 7] = dw[2] + w[0] * w[1], w[2] * w[2] - w[0] * w[0], dw[0] - w[1] * w[2]
    F[3, 8], F[4, 8], F[5, 8] = w[1] * w[1] - w[2] * w[2], dw[2] - w[0] * w[1], dw[1] + w[0] * w[2]
    F[3, 9], F[4, 9], F[5, 9] = w[1] * w[2], -w[0] * w[2], dw[2]


@numba.njit(cache=True)
def regressor(order, parent, rotation, translation, axis, prismatic, gravity, q, v, a):
    """Give Y of tau = Y pi_std, shape (n_samples, n, 10 n).

    Row k, body b is the twist of joint k carried to body b's frame, times the body's own force and moment.
    """
    n_samples, n = q.shape
    Y = np.zeros((n_samples, n, 10 * n))
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    w, dw, dv = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    linear, angular = np.empty((n, n, 3)), np.empty((n, n, 3))  # of joint k, at body b: [b, k]
    F = np.empty((6, 10))
    t1, t2 = np.empty(3), np.empty(3)
    for s in range(n_samples):
        _motion(order, parent, rotation, translation, axis, prismatic, gravity, q[s], v[s], a[s], R, p, w, dw, dv)
        for b in order:
            _body_regressor(w[b], dw[b], dv[b], F)
            up = parent[b]
            k = b
            while k >= 0:
                l, r = linear[b, k], angular[b, k]
                if k == b:
                    for i in range(3):
                        l[i] = axis[b, i] if prismatic[b] else 0.0
                        r[i] = 0.0 if prismatic[b] else axis[b, i]
                else:
                    _cross(angular[up, k], p[b], t1)
                    for i in range(3):
                        t2[i] = linear[up, k, i] + t1[i]
                    for i in range(3):
                        l[i] = R[b, 0, i] * t2[0] + R[b, 1, i] * t2[1] + R[b, 2, i] * t2[2]
                        r[i] = (
                            R[b, 0, i] * angular[up, k, 0]
                            + R[b, 1, i] * angular[up, k, 1]
                            + R[b, 2, i] * angular[up, k, 2]
                        )
                row = Y[s, k, 10 * b : 10 * b + 10]
                for c in range(4):
                    row[c] = l[0] * F[0, c] + l[1] * F[1, c] + l[2] * F[2, c]
                for c in range(1, 10):
                    row[c] += r[0] * F[3, c] + r[1] * F[4, c] + r[2] * F[5, c]
                k = parent[k]
    return Y
