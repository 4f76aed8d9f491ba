"""Compiled loops over samples: the recursive Newton-Euler algorithm and its regressor on a tree of bodies.

Arrays describe the tree as `cdm_pin.model.Chain` does. Vectors are in the body's own frame and gravity enters as an
acceleration of the base.
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, inline="always")
def _cross(x, y):
    return x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]


@numba.njit(cache=True, inline="always")
def _dot(x, y):
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@numba.njit(cache=True, inline="always")
def _sum(x, y):
    return x[0] + y[0], x[1] + y[1], x[2] + y[2]


@numba.njit(cache=True, inline="always")
def _times(c, x):
    return c * x[0], c * x[1], c * x[2]


@numba.njit(cache=True, inline="always")
def _row(X, k):
    return X[k, 0], X[k, 1], X[k, 2]


@numba.njit(cache=True, inline="always")
def _put(X, k, x):
    X[k, 0], X[k, 1], X[k, 2] = x


@numba.njit(cache=True, inline="always")
def _to_parent(R, k, x):
    """Turn a vector of body k into its parent's frame, R[k] x."""
    return (
        R[k, 0, 0] * x[0] + R[k, 0, 1] * x[1] + R[k, 0, 2] * x[2],
        R[k, 1, 0] * x[0] + R[k, 1, 1] * x[1] + R[k, 1, 2] * x[2],
        R[k, 2, 0] * x[0] + R[k, 2, 1] * x[1] + R[k, 2, 2] * x[2],
    )


@numba.njit(cache=True, inline="always")
def _to_body(R, k, x):
    """Turn a vector of the parent into the frame of body k, R[k]' x."""
    return (
        R[k, 0, 0] * x[0] + R[k, 1, 0] * x[1] + R[k, 2, 0] * x[2],
        R[k, 0, 1] * x[0] + R[k, 1, 1] * x[1] + R[k, 2, 1] * x[2],
        R[k, 0, 2] * x[0] + R[k, 1, 2] * x[1] + R[k, 2, 2] * x[2],
    )


@numba.njit(cache=True, inline="always")
def _axes_turned(z, angle):
    """Say where a turn about a unit vector takes the three axes: the columns of its rotation."""
    c, s = np.cos(angle), np.sin(angle)
    u = 1 - c
    return (
        (c + z[0] * z[0] * u, z[0] * z[1] * u + z[2] * s, z[0] * z[2] * u - z[1] * s),
        (z[0] * z[1] * u - z[2] * s, c + z[1] * z[1] * u, z[1] * z[2] * u + z[0] * s),
        (z[0] * z[2] * u + z[1] * s, z[1] * z[2] * u - z[0] * s, c + z[2] * z[2] * u),
    )


@numba.njit(cache=True)
def _motion(s, order, parent, rotation, translation, axis, prismatic, gravity, q, v, a, R, p, w, dw, dv):
    """Advance pose in parent (R, p), angular velocity w, angular and linear acceleration dw, dv from base to tip."""
    for k in order:
        z, at, up = _row(axis, k), _row(translation, k), parent[k]
        if prismatic[k]:
            for i in range(3):
                for j in range(3):
                    R[k, i, j] = rotation[k, i, j]
            at = _sum(at, _to_parent(rotation, k, _times(q[s, k], z)))
        else:
            x_axis, y_axis, z_axis = _axes_turned(z, q[s, k])
            R[k, 0, 0], R[k, 1, 0], R[k, 2, 0] = _to_parent(rotation, k, x_axis)
            R[k, 0, 1], R[k, 1, 1], R[k, 2, 1] = _to_parent(rotation, k, y_axis)
            R[k, 0, 2], R[k, 1, 2], R[k, 2, 2] = _to_parent(rotation, k, z_axis)
        if up < 0:
            spin, spun, moved = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (-gravity[0], -gravity[1], -gravity[2])
        else:
            spin, spun, moved = _row(w, up), _row(dw, up), _row(dv, up)
        # acceleration of the joint's origin, still in the parent's frame
        moved = _sum(moved, _sum(_cross(spun, at), _cross(spin, _cross(spin, at))))
        spin, spun, moved = _to_body(R, k, spin), _to_body(R, k, spun), _to_body(R, k, moved)
        across = _cross(spin, z)
        if prismatic[k]:
            moved = _sum(moved, _sum(_times(a[s, k], z), _times(2.0 * v[s, k], across)))
        else:
            spun = _sum(spun, _sum(_times(a[s, k], z), _times(v[s, k], across)))
            spin = _sum(spin, _times(v[s, k], z))
        _put(p, k, at)
        _put(w, k, spin)
        _put(dw, k, spun)
        _put(dv, k, moved)


@numba.njit(cache=True)
def rnea(order, parent, rotation, translation, axis, prismatic, gravity, pi_std, q, v, a):
    """Give joint torques (n_samples, n) and the wrench that crosses each joint (n_samples, n, 6)."""
    n_samples, n = q.shape
    tau = np.empty((n_samples, n))
    wrench = np.empty((n_samples, n, 6))
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    w, dw, dv = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    force, moment = np.empty((n, 3)), np.empty((n, 3))
    for s in range(n_samples):
        _motion(s, order, parent, rotation, translation, axis, prismatic, gravity, q, v, a, R, p, w, dw, dv)
        for k in range(n):
            spin, spun, moved = _row(w, k), _row(dw, k), _row(dv, k)
            mass, h = pi_std[10 * k], (pi_std[10 * k + 1], pi_std[10 * k + 2], pi_std[10 * k + 3])
            xx, xy, yy = pi_std[10 * k + 4], pi_std[10 * k + 5], pi_std[10 * k + 6]
            xz, yz, zz = pi_std[10 * k + 7], pi_std[10 * k + 8], pi_std[10 * k + 9]
            x_row, y_row, z_row = (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)
            rate = (_dot(x_row, spun), _dot(y_row, spun), _dot(z_row, spun))
            momentum = (_dot(x_row, spin), _dot(y_row, spin), _dot(z_row, spin))
            # f = m dv + dw x h + w x (w x h);  n = I dw + w x I w + h x dv
            _put(force, k, _sum(_times(mass, moved), _sum(_cross(spun, h), _cross(spin, _cross(spin, h)))))
            _put(moment, k, _sum(_sum(rate, _cross(spin, momentum)), _cross(h, moved)))
        for j in range(n - 1, -1, -1):
            k = order[j]
            up, f, m = parent[k], _row(force, k), _row(moment, k)
            if up >= 0:
                f_up = _to_parent(R, k, f)
                m_up = _sum(_to_parent(R, k, m), _cross(_row(p, k), f_up))
                _put(force, up, _sum(_row(force, up), f_up))
                _put(moment, up, _sum(_row(moment, up), m_up))
            tau[s, k] = _dot(_row(axis, k), f if prismatic[k] else m)
            wrench[s, k, 0], wrench[s, k, 1], wrench[s, k, 2] = f
            wrench[s, k, 3], wrench[s, k, 4], wrench[s, k, 5] = m
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
    for s in range(n_samples):
        _motion(s, order, parent, rotation, translation, axis, prismatic, gravity, q, v, a, R, p, w, dw, dv)
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
                    turn = _row(angular[up], k)
                    _put(angular[b], k, _to_body(R, b, turn))
                    _put(linear[b], k, _to_body(R, b, _sum(_row(linear[up], k), _cross(turn, _row(p, b)))))
                row = Y[s, k, 10 * b : 10 * b + 10]
                for c in range(4):
                    row[c] = l[0] * F[0, c] + l[1] * F[1, c] + l[2] * F[2, c]
                for c in range(1, 10):
                    row[c] += r[0] * F[3, c] + r[1] * F[4, c] + r[2] * F[5, c]
                k = parent[k]
    return Y
