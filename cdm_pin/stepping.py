"""Compiled time steps of a robot with friction that sticks, driven by given motor torques.

Motor coordinates: q = E q_m + offset. Along each law's coordinate w' q_m a torque f enters as tau_m = w f, and opposes
the motion. One step of length h is second order where the forces are smooth: everything is taken half a step ahead,
damping and stiffness implicitly, so that stiff laws stay stable. Dry friction is whatever between its two limits brings
the coordinate to rest at the end of the step, and the limit where that is not enough; coordinates that share motors
are settled in turns (projected Gauss-Seidel).
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from .geometry import Vector
from .kernels import rnea

TURNS = 100  # at most, of the settling of dry friction


class Laws(NamedTuple):
    """Laws along coordinates w' q_m + w_0, with n the number of samples of the record.

    Attributes
    ----------
    inertia, viscous : ndarray, shape (n_motors, n_motors)
        Sums of w w' times inertia or viscosity.
    drag_w, drag : ndarray, shapes (k, n_motors) and (k,)
        Quadratic drag.
    dry_w, forwards, backwards, stribeck : ndarray, shapes (k, n_motors), (k, n), (k, n), (k, 2)
        Dry friction: its limits for motion up and down at each sample, and Stribeck's addition with its velocity.
    spring_w, spring : ndarray, shapes (k, n_motors + 1) and (k, 3)
        w and w_0; stiffness, rest and cubic stiffness.
    ripple_w, ripple : ndarray, shapes (k, n_motors + 1) and (k, 3)
        w and w_0; amplitude, cycles and phase.
    memory_w, memory, slips, memory_start : ndarray, shapes (k, n_motors), (k, 2), (k,), (k, n)
        Hysteresis: limit and distance, whether it slips at once (Maxwell) or bends (Dahl), and its state over its
        limit along the record, to start from.
    """

    inertia: Vector
    viscous: Vector
    drag_w: Vector
    drag: Vector
    dry_w: Vector
    forwards: Vector
    backwards: Vector
    stribeck: Vector
    spring_w: Vector
    spring: Vector
    ripple_w: Vector
    ripple: Vector
    memory_w: Vector
    memory: Vector
    slips: np.ndarray
    memory_start: Vector


@numba.njit(cache=True)
def _rigid(tree, pi_std, E, offset, q_m, v_m):
    """Give mass matrix and remaining torque of the rigid body in motor coordinates."""
    m, n = E.shape[1], E.shape[0]
    q, v, a = np.zeros((m + 2, n)), np.zeros((m + 2, n)), np.zeros((m + 2, n))
    for i in range(n):
        for k in range(m):
            q[0, i] += E[i, k] * q_m[k]
            v[0, i] += E[i, k] * v_m[k]
            a[2 + k, i] = E[i, k]
        q[0, i] += offset[i]
    for row in range(1, m + 2):
        q[row] = q[0]
    order, parent, rotation, translation, axis, prismatic, gravity = tree
    tau = rnea(order, parent, rotation, translation, axis, prismatic, gravity, pi_std, q, v, a)[0] @ E
    M = np.empty((m, m))
    for k in range(m):
        M[:, k] = tau[2 + k] - tau[1]
    return 0.5 * (M + M.T), tau[0]


@numba.njit(cache=True)
def _slide(state, dx, distance, slips):
    if slips:
        return min(1.0, max(-1.0, state + dx / distance))
    s = 1.0 if dx > 0 else -1.0
    return s + (state - s) * np.exp(-abs(dx) / distance)


@numba.njit(cache=True)
def advance(tree, pi_std, E, offset, laws, torque, start, q_m, v_m, h, substeps, steps):
    """Run windows forward.

    Parameters
    ----------
    tree : tuple
        As `kernels.rnea` takes it, first seven arguments.
    pi_std, E, offset
    laws : Laws
    torque : ndarray, shape (n, n_motors)
        Along the record, interpolated between samples [N m].
    start : ndarray, shape (n_windows,)
        Sample at which each window starts.
    q_m, v_m : ndarray, shape (n_windows, n_motors)
        State there.
    h : float
        Length of a step [s].
    substeps, steps : int
        Steps to a sample, and samples of a window.

    Returns
    -------
    ndarray, shape (n_windows, steps + 1, n_motors)
        Motor positions.
    """
    m = E.shape[1]
    out = np.empty((len(start), steps + 1, m))
    dry, memories = len(laws.dry_w), len(laws.memory_w)
    friction, state = np.zeros(dry), np.zeros(memories)
    for w in range(len(start)):
        q, v, a = q_m[w].copy(), v_m[w].copy(), np.zeros(m)
        state[:] = laws.memory_start[:, start[w]]
        friction[:] = 0.0
        before = q.copy()  # where the memories were last brought up to date
        out[w, 0] = q
        for step in range(steps):
            k = start[w] + step
            for sub in range(substeps):
                along = (sub + 0.5) / substeps
                tau = (1.0 - along) * torque[k] + along * torque[k + 1]
                middle, v_middle = q + 0.5 * h * v, v + 0.5 * h * a
                M, bias = _rigid(tree, pi_std, E, offset, middle, v_middle)
                M, D, K = M + laws.inertia, laws.viscous.copy(), np.zeros((m, m))
                tau = tau - bias
                for i in range(len(laws.drag_w)):
                    x = laws.drag_w[i]
                    D += laws.drag[i] * abs(x @ v_middle) * np.outer(x, x)
                for i in range(len(laws.spring_w)):
                    x = laws.spring_w[i, :m]
                    bent = x @ middle + laws.spring_w[i, m] - laws.spring[i, 1]
                    tau -= x * (laws.spring[i, 0] + laws.spring[i, 2] * bent * bent) * bent
                    K += max(laws.spring[i, 0] + 3 * laws.spring[i, 2] * bent * bent, 0.0) * np.outer(x, x)
                for i in range(len(laws.ripple_w)):
                    x = laws.ripple_w[i, :m]
                    turned = laws.ripple[i, 1] * (x @ middle + laws.ripple_w[i, m]) + laws.ripple[i, 2]
                    tau -= x * laws.ripple[i, 0] * np.sin(turned)
                for i in range(memories):
                    x = laws.memory_w[i]
                    state[i] = _slide(state[i], x @ (middle - before), laws.memory[i, 1], laws.slips[i])
                    tau -= x * laws.memory[i, 0] * state[i]
                    K += laws.memory[i, 0] / laws.memory[i, 1] * np.outer(x, x)
                before = middle
                A = np.linalg.inv(M + 0.5 * h * D + 0.25 * h * h * K)
                new = v + h * (A @ (tau - D @ v))
                # dry friction
                limits = np.empty((dry, 2))
                for i in range(dry):
                    x = laws.dry_w[i]
                    more = 0.0
                    if laws.stribeck[i, 1] > 0:
                        more = laws.stribeck[i, 0] * np.exp(-((x @ v_middle / laws.stribeck[i, 1]) ** 2))
                    limits[i, 0] = -(1 - along) * laws.backwards[i, k] - along * laws.backwards[i, k + 1] - more
                    limits[i, 1] = (1 - along) * laws.forwards[i, k] + along * laws.forwards[i, k + 1] + more
                    friction[i] = min(max(friction[i], limits[i, 0]), limits[i, 1])
                    new -= h * friction[i] * (A @ x)
                for _ in range(TURNS):
                    moved = 0.0
                    for i in range(dry):
                        x = laws.dry_w[i]
                        Ax = A @ x
                        wanted = friction[i] + (x @ new) / (h * (x @ Ax))
                        wanted = min(max(wanted, limits[i, 0]), limits[i, 1])
                        change = wanted - friction[i]
                        if change != 0.0:
                            new -= h * change * Ax
                            friction[i] = wanted
                            moved = max(moved, abs(change) / max(limits[i, 1] - limits[i, 0], 1e-12))
                    if moved < 1e-9 or dry == 1:
                        break
                a = (new - v) / h
                q = q + 0.5 * h * (v + new)
                v = new
            out[w, step + 1] = q
    return out
