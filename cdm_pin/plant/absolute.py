r"""Simulated motions of a planar cable-driven arm and the motor torques that go with them, in absolute link angles.

Three passes over a fine time grid:

- `prescribed`: the reference itself is the motion (a perfect servo);
- `closed_loop`: rigid cables, PD with feed-forward of another arm (wrong masses), classical Runge-Kutta;
- `compliant_loop`: motors, rotors and links apart, joined by elastic cables with gap and slack.

`motor_torques` then gives the torque of a rigid-cable arm exactly along any motion, all laws and path errors included.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from .laws import N_STATES, advance_laws, apply_laws
from .paths import cable_torques, path, strained, stretch_torque
from .planar import hinge_reactions, lumped, mass_and_bias, solve_in_place


class Reference(NamedTuple):
    """Joint angles [rad] over time: a Fourier series, moves from point to point, or both.

    Centre (n,), sine and cosine (n, K), base frequency [rad/s]; moves (m, 4) of one joint each: which (from 0), when it
    begins [s], how long it takes [s] and how far it goes [rad], along a polynomial of fifth order.
    """

    centre: np.ndarray
    sine: np.ndarray
    cosine: np.ndarray
    omega: float
    moves: np.ndarray = np.zeros((0, 4))


class Servo(NamedTuple):
    """PD on link angle [N m/rad, N m s/rad] (n,), share of feed-forward, and a band-limited ripple of the command."""

    stiffness: np.ndarray
    damping: np.ndarray
    feedforward: float
    ripple: np.ndarray  # (n, 3): amplitude [N m], angular frequency [rad/s], phase


@njit(cache=True)
def reference_at(reference, t, phi, w, a):
    """Fill the desired absolute angles, rates and accelerations (n,) at time t [s]."""
    n = phi.size
    phi[:] = reference.centre
    w[:] = 0.0
    a[:] = 0.0
    s1, c1 = np.sin(reference.omega * t), np.cos(reference.omega * t)
    s, c = 0.0, 1.0
    for k in range(reference.sine.shape[1]):
        o = (k + 1) * reference.omega
        s, c = s * c1 + c * s1, c * c1 - s * s1
        for i in range(n):
            p, q = reference.sine[i, k], reference.cosine[i, k]
            phi[i] += p * s + q * c
            w[i] += o * (p * c - q * s)
            a[i] -= o * o * (p * s + q * c)
    for joint, start, length, far in reference.moves:
        u = min(max((t - start) / length, 0.0), 1.0)
        i = int(joint)
        phi[i] += far * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
        w[i] += far / length * 30.0 * u * u * (1.0 - u) ** 2
        a[i] += far / length**2 * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)
    for i in range(1, n):
        phi[i] += phi[i - 1]
        w[i] += w[i - 1]
        a[i] += a[i - 1]


@njit(cache=True)
def prescribed(reference, dt, N):
    """Tabulate the reference: absolute angles, rates, accelerations, each (N, n)."""
    n = reference.centre.size
    phi, w, a = np.empty((N, n)), np.empty((N, n)), np.empty((N, n))
    for k in range(N):
        reference_at(reference, k * dt, phi[k], w[k], a[k])
    return phi, w, a


@njit(cache=True)
def relative(x, out):
    """Fill joint values from absolute ones."""
    for i in range(x.size - 1, 0, -1):
        out[i] = x[i] - x[i - 1]
    out[0] = x[0]


@njit(cache=True)
def joint_torques(Q, out):
    """Fill joint torques tau_i = sum of the link torques Q from link i on."""
    total = 0.0
    for i in range(Q.size - 1, -1, -1):
        total += Q[i]
        out[i] = total


@njit(cache=True)
def motor_torques(arm, laws, cables, phi, w, a, dt):
    """Inverse dynamics along a motion (N, n) given at steps `dt`.

    Returns
    -------
    tau_m, q_m, C : ndarray, shape (N, n)
        Motor torques [N m], motor angles [rad] and cable torques on the links [N m].
    """
    N, n = phi.shape
    D, sx, sy = lumped(arm)
    tau_m, q_out, C_out = np.empty((N, n)), np.empty((N, n)), np.empty((N, n))
    M, P, h, Q = np.empty((n, n)), np.empty((n, n)), np.empty(n), np.empty(n)
    theta, rate, acc = np.empty(n), np.empty(n), np.empty(n)
    psi, v_m, a_m, q_m = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    tau, total, C, motor, inertial = np.empty(n), np.empty(n), np.zeros(n), np.empty(n), np.empty(n)
    f_joint, f_motor, reaction = np.zeros(n), np.zeros(n), np.zeros(n)
    rate0, v0, C0, mean, v_mean, C_rate = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    z = np.zeros((laws.kind.size, N_STATES))
    sweeps = 3 if laws.kind.size else 1
    for k in range(N):
        mass_and_bias(phi[k], w[k], arm.length, D, sx, sy, arm.gravity, M, h)
        for i in range(n):
            Q[i] = h[i]
            for j in range(n):
                Q[i] += M[i, j] * a[k, j]
        joint_torques(Q, tau)
        relative(phi[k], theta)
        relative(w[k], rate)
        relative(a[k], acc)
        path(cables, theta, rate, acc, psi, v_m, a_m, P)
        for i in range(n):
            q_m[i], v_m[i], a_m[i] = psi[i] / arm.ratio, v_m[i] / arm.ratio, a_m[i] / arm.ratio
            turn = a_m[i]
            for j in range(n):
                turn += cables.rotor_coupling[i, j] * acc[j]
            inertial[i] = arm.rotor[i] * turn
        for i in range(n):
            for j in range(n):
                tau[j] += cables.rotor_coupling[i, j] * inertial[i]
        hinge_reactions(arm, phi[k], w[k], a[k], C, reaction)
        for sweep in range(sweeps):  # laws depend on the cable torque that they change: repeated to 1e-6 of it
            for i in range(n):
                total[i] = tau[i] + f_joint[i]
            cable_torques(P, total, C)
            if sweep == 0:
                if k > 0:
                    for i in range(n):
                        mean[i], v_mean[i] = 0.5 * (rate[i] + rate0[i]), 0.5 * (v_m[i] + v0[i])
                        C_rate[i] = (C[i] - C0[i]) / dt
                    advance_laws(laws, z, mean, v_mean, C_rate, dt)
                rate0[:], v0[:], C0[:] = rate, v_m, C
            for i in range(n):
                motor[i] = arm.ratio * (tau[i] - (tau[i + 1] if i + 1 < n else 0.0)) + inertial[i]
            apply_laws(laws, z, arm, k * dt, theta, rate, q_m, v_m, tau, motor, C, reaction, f_joint, f_motor)
        for i in range(n):
            total[i] = tau[i] + f_joint[i]
        cable_torques(P, total, C)
        for i in range(n):
            tau_m[k, i] = arm.ratio * C[i] + inertial[i] + f_motor[i]
            q_out[k, i] = q_m[i]
            C_out[k, i] = C[i]
            if cables.half_gap[i] > 0.0 and np.isinf(
                cables.stiffness[i]
            ):  # massless rotor: it rests on the side it pulls
                q_out[k, i] += cables.half_gap[i] * np.tanh(C[i] / 0.02) / arm.ratio
    return tau_m, q_out, C_out


@njit(cache=True)
def _plan(servo, model, D, sx, sy, reference, t, desired, M, h, feed):
    """Fill the reference at time t and `feed` (n,) [N m], the wrong model's torque along it and the servo's ripple."""
    reference_at(reference, t, desired[0], desired[1], desired[2])
    mass_and_bias(desired[0], desired[1], model.length, D, sx, sy, model.gravity, M, h)
    n = feed.size
    for i in range(n):
        forward = h[i]
        for j in range(n):
            forward += M[i, j] * desired[2, j]
        feed[i] = servo.feedforward * forward + servo.ripple[i, 0] * np.sin(servo.ripple[i, 1] * t + servo.ripple[i, 2])


@njit(cache=True)
def _command(servo, desired, feed, phi, w, ratio, u):
    """Fill the link-side command u (n,) [N m]: `feed` plus PD on angles and rates that are `ratio` times phi, w."""
    for i in range(u.size):
        u[i] = feed[i] + servo.stiffness[i] * (desired[0, i] - ratio * phi[i])
        u[i] += servo.damping[i] * (desired[1, i] - ratio * w[i])


@njit(cache=True)
def _shift(x, dx, h, out):
    """Fill `out` with x + h dx (no temporaries: this is the innermost loop)."""
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            out[i, j] = x[i, j] + h * dx[i, j]


@njit(cache=True)
def _extrapolate(z, z_old, part, out):
    for i in range(z.shape[0]):
        for j in range(z.shape[1]):
            out[i, j] = z[i, j] + part * (z[i, j] - z_old[i, j])


@njit(cache=True)
def closed_loop(arm, laws, model, servo, reference, dt, substeps, N, lead=0):
    """Integrate the rigid-cable arm under its servo; returns absolute angles, rates, accelerations, each (N, n).

    It moves for `lead` samples before time 0, the first that is returned, so that how it starts has died away.

    Hysteresis states move on between Runge-Kutta steps and are extrapolated inside one. Path errors are left to
    `motor_torques`: a servo can hold any motion.
    """
    n = arm.length.size
    D, sx, sy = lumped(arm)
    D += arm.rotor / arm.ratio**2
    Dm, sxm, sym = lumped(model)
    out = np.full((3, N, n), np.nan)  # what a loop that diverges leaves behind
    state, stage, slope, rise = np.zeros((2, n)), np.zeros((2, n)), np.zeros((2, n)), np.zeros((2, n))
    desired = np.empty((3, n))
    M, h, u, Q, feed = np.empty((n, n)), np.empty(n), np.empty(n), np.zeros(n), np.empty(n)
    _plan(servo, model, Dm, sxm, sym, reference, -lead * dt, desired, M, h, feed)
    state[:] = desired[:2]
    theta, rate, rate0, motor, v_m, q_m = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    tau, cable, f_joint, f_motor, reaction = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    cable0, cable_rate = np.zeros(n), np.zeros(n)
    z = np.zeros((laws.kind.size, N_STATES))
    z_old, z_stage = z.copy(), z.copy()
    relative(state[1], rate0)
    step = dt / substeps
    for k in range((N + lead) * substeps):
        t = k * step - lead * dt
        rise[:] = 0.0
        for r in range(4):
            part = 0.0 if r == 0 else (1.0 if r == 3 else 0.5)
            _shift(state, slope, part * step if r else 0.0, stage)
            _extrapolate(z, z_old, part, z_stage)
            relative(stage[0], theta)
            relative(stage[1], rate)
            now = t + part * step
            if r == 1 or r == 3:  # the other two stages share their instants
                _plan(servo, model, Dm, sxm, sym, reference, now, desired, M, h, feed)
            _command(servo, desired, feed, stage[0], stage[1], 1.0, u)
            for i in range(n):
                q_m[i], v_m[i], motor[i] = stage[0, i] / arm.ratio, stage[1, i] / arm.ratio, arm.ratio * Q[i]
            apply_laws(laws, z_stage, arm, now, theta, rate, q_m, v_m, tau, motor, cable, reaction, f_joint, f_motor)
            mass_and_bias(stage[0], stage[1], arm.length, D, sx, sy, arm.gravity, M, h)
            for i in range(n):
                u[i] -= h[i] + f_motor[i] / arm.ratio + f_joint[i] - (f_joint[i + 1] if i + 1 < n else 0.0)
            solve_in_place(M, u)
            slope[0], slope[1] = stage[1], u
            _shift(rise, slope, 1.0 if r == 0 or r == 3 else 2.0, rise)
            if r == 0:
                row = k // substeps - lead
                if k % substeps == 0 and row >= 0:
                    out[0, row], out[1, row], out[2, row] = state[0], state[1], u
                mass_and_bias(stage[0], stage[1], arm.length, D, sx, sy, arm.gravity, M, h)
                Q[:] = M @ u + h  # what laws with load see until the next step
                joint_torques(Q, tau)
                if k > 0:
                    cable_rate[:] = (Q - cable0) / step
                cable0[:] = Q
                cable[:] = Q
                hinge_reactions(arm, stage[0], stage[1], u, cable, reaction)
        _shift(state, rise, step / 6.0, state)
        relative(state[1], rate)
        z_old[:] = z
        advance_laws(laws, z, 0.5 * (rate + rate0), 0.5 * (state[1] + stage[1]) / arm.ratio, cable_rate, step)
        rate0[:] = rate
        if not np.all(np.isfinite(state)) or np.max(np.abs(state[1])) > 1e4:
            break
    return out[0], out[1], out[2]


@njit(cache=True)
def compliant_loop(arm, laws, cables, model, servo, reference, dt, substeps, N, lead=0):
    """Integrate links and motors apart, joined by elastic cables; the servo sees the motors.

    A cable of infinite stiffness ties its motor to its link by the nominal map. `lead` is as in `closed_loop`.

    Returns
    -------
    phi, w, a : ndarray, shape (N, n)
        Absolute link angles and their derivatives.
    tau_m, q_m, C : ndarray, shape (N, n)
        As `motor_torques`.
    """
    n = arm.length.size
    D, sx, sy = lumped(arm)
    Dm, sxm, sym = lumped(model)
    elastic = np.isfinite(cables.stiffness)
    tied = np.where(elastic, 0.0, arm.rotor / arm.ratio**2)
    D += tied
    out = np.full((6, N, n), np.nan)
    state, stage, slope, rise = np.zeros((4, n)), np.zeros((4, n)), np.zeros((4, n)), np.zeros((4, n))
    desired = np.empty((3, n))
    M, P, h, u, feed = np.empty((n, n)), np.empty((n, n)), np.empty(n), np.empty(n), np.empty(n)
    _plan(servo, model, Dm, sxm, sym, reference, -lead * dt, desired, M, h, feed)
    state[:2] = desired[:2]
    theta, rate, rate0, zero = np.empty(n), np.empty(n), np.empty(n), np.zeros(n)
    psi, dpsi, ddpsi, v0 = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    C, C0, tau, total, motor = np.zeros(n), np.zeros(n), np.zeros(n), np.empty(n), np.zeros(n)
    f_joint, f_motor, reaction = np.zeros(n), np.zeros(n), np.zeros(n)
    z = np.zeros((laws.kind.size, N_STATES))
    z_old, z_stage = z.copy(), z.copy()
    relative(state[0], theta)
    relative(state[1], rate0)
    path(cables, theta, rate0, zero, psi, dpsi, ddpsi, P)
    mass_and_bias(state[0], state[1], arm.length, D, sx, sy, arm.gravity, M, h)
    joint_torques(M @ desired[2] + h, tau)
    cable_torques(P, tau, C)
    C -= tied * desired[2]
    for i in range(n):  # the motors start where the cables carry the load
        x = strained(C[i], cables.stiffness[i], cables.slack[i]) + np.sign(C[i]) * cables.half_gap[i]
        state[2, i] = (psi[i] + x) / arm.ratio
        state[3, i] = dpsi[i] / arm.ratio
    v0[:] = state[3]
    step = dt / substeps
    for k in range((N + lead) * substeps):
        t = k * step - lead * dt
        rise[:] = 0.0
        for r in range(4):
            part = 0.0 if r == 0 else (1.0 if r == 3 else 0.5)
            _shift(state, slope, part * step if r else 0.0, stage)
            _extrapolate(z, z_old, part, z_stage)
            relative(stage[0], theta)
            relative(stage[1], rate)
            path(cables, theta, rate, zero, psi, dpsi, ddpsi, P)
            for i in range(n):
                if elastic[i]:
                    x, dx = stage[2, i] * arm.ratio - psi[i], stage[3, i] * arm.ratio - dpsi[i]
                    C[i] = stretch_torque(cables, i, x, dx)
            now = t + part * step
            if r == 1 or r == 3:  # the other two stages share their instants
                _plan(servo, model, Dm, sxm, sym, reference, now, desired, M, h, feed)
            _command(servo, desired, feed, stage[2], stage[3], arm.ratio, u)
            tau[:] = P.T @ C
            motor[:] = arm.ratio * C
            q_m, v_m = stage[2], stage[3]
            apply_laws(laws, z_stage, arm, now, theta, rate, q_m, v_m, tau, motor, C, reaction, f_joint, f_motor)
            for i in range(n):
                slope[0, i], slope[2, i] = stage[1, i], stage[3, i]
                if elastic[i]:
                    slope[3, i] = (arm.ratio * (u[i] - C[i]) - f_motor[i]) / arm.rotor[i]
                else:
                    C[i] = u[i] - f_motor[i] / arm.ratio
            total[:] = P.T @ C - f_joint
            mass_and_bias(stage[0], stage[1], arm.length, D, sx, sy, arm.gravity, M, h)
            for i in range(n):
                slope[1, i] = total[i] - (total[i + 1] if i + 1 < n else 0.0) - h[i]
            solve_in_place(M, slope[1])
            for i in range(n):
                if not elastic[i]:
                    slope[3, i] = slope[1, i] / arm.ratio
                    C[i] -= tied[i] * slope[1, i]
            _shift(rise, slope, 1.0 if r == 0 or r == 3 else 2.0, rise)
            if r == 0:
                row = k // substeps - lead
                if k % substeps == 0 and row >= 0:
                    out[0, row], out[1, row], out[2, row] = state[0], state[1], slope[1]
                    out[3, row], out[4, row], out[5, row] = arm.ratio * u, state[2], C
                hinge_reactions(arm, stage[0], stage[1], slope[1], C, reaction)
                C0[:] = C
        _shift(state, rise, step / 6.0, state)
        relative(state[1], rate)
        z_old[:] = z
        advance_laws(laws, z, 0.5 * (rate + rate0), 0.5 * (state[3] + v0), (C - C0) / step, step)
        rate0[:] = rate
        v0[:] = state[3]
        if not np.all(np.isfinite(state)) or np.max(np.abs(state[1])) > 1e4:
            break
    return out[0], out[1], out[2], out[3], out[4], out[5]
