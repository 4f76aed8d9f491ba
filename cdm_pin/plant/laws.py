r"""Laws of what a cable-driven arm does beyond a rigid body, each in its exact, nonlinear form, evaluated at run time.

A law acts along one coordinate :math:`s = A\theta + B q_m` of joint angles and motor angles: joint `i` is
:math:`A = e_i`, motor `i` is :math:`B = e_i`, cable `i` against link `k` is
:math:`s = (r_m/r_j) q_{m,i} - \sum_{m \le k}\theta_m`. Its force `f` opposes :math:`\dot s` and enters by virtual work,
:math:`A^T f` on the joints and :math:`B^T f` on the motors, so that no law creates power unless it means to. A second
coordinate `s2` is what a law may depend on besides. Units: N m per rad of `s`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit

(VISCOUS, COULOMB, STRIBECK, ASYMMETRIC, QUADRATIC, LOAD, TORQUE, POSITION, DAHL, LUGRE, BOUC_WEN, MAXWELL, TENSION,
 DRIFT, SPRING, RIPPLE, EXTERNAL, CAPSTAN) = range(18)  # fmt: skip
(BUMP, CROSS_ANGLE, CUBIC, SINUSOID, RUB, SPEED_GAIN, DETENT, CROSS_SPRING, BREAK_IN, RANDOM_WALK, DEAD_BAND, SWITCH_ON,
 CROSS_SPEED, TOOTH, WARMING_SPRING, THERMAL_GAIN) = range(100, 116)  # fmt: skip
N_PARAMETERS, N_STATES = 8, 5
WIDTH = 7  # index of the width [rad/s] of the smooth sign in a law's parameters; negative [rad]: it sticks
STUCK = 4  # index of the bristle among a law's states, from -1 to 1


class Laws(NamedTuple):
    """Laws side by side: kind (m,), coordinates A, B and A2 (m, n), parameters (m, 8), the cable whose load counts.

    Dry friction has a smooth sign, or it sticks: a bristle that bends by so much [rad] before it slides, where the
    width among its parameters is the negative of that.
    """

    kind: np.ndarray
    A: np.ndarray
    B: np.ndarray
    A2: np.ndarray
    parameters: np.ndarray
    cable: np.ndarray


@njit(cache=True)
def advance(kind, p, z, ds, dt):
    """Move a law's internal states `z` on by `dt` under the mean rate `ds` (exact for a constant rate)."""
    if p[WIDTH] < 0:
        way = 1.0 if ds > 0 else -1.0
        z[STUCK] = way + (z[STUCK] - way) * np.exp(abs(ds) * dt / p[WIDTH])
    if kind == DAHL or kind == TENSION or kind == LUGRE:
        limit = 1.0
        if kind == LUGRE:
            limit += p[3] * np.exp(-((ds / p[4]) ** 2))
        goal = limit if ds > 0 else -limit
        z[0] = goal + (z[0] - goal) * np.exp(-abs(ds) * dt * p[0] / (p[1] * limit))
    elif kind == BOUC_WEN:
        steps = 1 + int(abs(ds) * dt * p[0] / p[1] / 0.1)
        for _ in range(steps):
            grow = 1.0 - z[0] * z[0] if ds * z[0] > 0 else 1.0
            z[0] += p[0] / p[1] * ds * dt / steps * grow
        z[0] = min(max(z[0], -1.0), 1.0)
    elif kind == MAXWELL:
        for j in range(4):
            z[j] = min(max(z[j] + ds * dt, -_MAXWELL[j] * p[1] / p[0]), _MAXWELL[j] * p[1] / p[0])
    elif kind == BREAK_IN:
        if ds * z[0] < 0 or z[0] == 0.0:
            z[0] = 1.0 if ds > 0 else -1.0
            z[1] = 0.0
        z[1] += dt


_MAXWELL = np.array([0.25, 0.5, 1.0, 2.25])


@njit(cache=True)
def strand_torque(mu, load, wrap_upper, wrap_lower, sign, pretension, radius):
    """Torque [N m] that capstan friction adds to what a pair must pull, its load-side tensions being T0 -+ load/2r."""
    upper = max(0.0, pretension + 0.5 * load / radius)
    lower = max(0.0, pretension - 0.5 * load / radius)
    before = radius * (upper - lower)
    return radius * (upper * np.exp(mu * wrap_upper * sign) - lower * np.exp(-mu * wrap_lower * sign)) - before


@njit(cache=True)
def force(kind, p, z, t, s, ds, s2, ds2, load, reaction, arm):
    """Give the force [N m] of one law at rate `ds`; `load` is the torque carried there, `reaction` the hinge force."""
    sign = np.tanh(ds / p[WIDTH]) if p[WIDTH] > 0 else z[STUCK]
    if kind == VISCOUS:
        return p[0] * ds
    if kind == COULOMB:
        return p[0] * sign
    if kind == STRIBECK:
        return (p[0] + p[1] * np.exp(-((ds / p[2]) ** 2))) * sign
    if kind == ASYMMETRIC:
        return 0.5 * (p[0] - p[1]) + 0.5 * (p[0] + p[1]) * sign
    if kind == QUADRATIC:
        return p[0] * ds * abs(ds)
    if kind == LOAD:
        return p[0] * reaction * sign
    if kind == TORQUE:
        return p[0] * abs(load) * sign
    if kind == POSITION:
        return p[0] * (1.0 + p[1] * np.sin(p[2] * s + p[3])) * sign
    if kind == DAHL or kind == TENSION or kind == BOUC_WEN:
        return p[1] * z[0]
    if kind == LUGRE:
        limit = 1.0 + p[3] * np.exp(-((ds / p[4]) ** 2))
        return p[1] * z[0] + p[2] * ds * max(0.0, 1.0 - z[0] / limit * np.sign(ds))
    if kind == MAXWELL:
        return 0.25 * p[0] * (z[0] + z[1] + z[2] + z[3])
    if kind == DRIFT:
        return p[0] * (1.0 + p[1] * np.exp(-t / p[2])) * sign
    if kind == SPRING:
        return p[0] * (s - p[1]) + p[2] * (s - p[1]) ** 3
    if kind == RIPPLE:
        return p[0] * np.sin(p[1] * s + p[2])
    if kind == EXTERNAL:
        return -p[0] * 0.5 * (np.tanh((t - p[1]) / 0.005) - np.tanh((t - p[2]) / 0.005))
    if kind == CAPSTAN:
        wrap = 2.0 * arm.cable_angle
        return strand_torque(p[0], load, wrap - s2, wrap + s2, sign, arm.pretension, arm.joint_pulley_radius)
    return strange_force(kind, p, z, t, s, ds, s2, ds2, load, sign)


@njit(cache=True)
def strange_force(kind, p, z, t, s, ds, s2, ds2, load, sign):
    """Give the force [N m] of a law that stands in no catalogue."""
    if kind == BUMP:  # a torque at one angle
        return p[0] * np.exp(-(((s - p[1]) / p[2]) ** 2))
    if kind == CROSS_ANGLE:  # friction that depends on another joint's angle
        return p[0] * 0.5 * (1.0 + np.tanh((s2 - p[1]) / p[2])) * sign
    if kind == CUBIC:
        return p[0] * ds**3
    if kind == SINUSOID:  # a disturbance of its own frequency
        return p[0] * np.sin(2.0 * np.pi * p[1] * t + p[2])
    if kind == RUB:  # rubs inside a window of angles only
        return p[0] * sign * 0.25 * (1.0 + np.tanh((s - p[1]) / 0.01)) * (1.0 - np.tanh((s - p[2]) / 0.01))
    if kind == SPEED_GAIN:  # torque constant that falls with speed
        return p[0] * abs(ds) * load
    if kind == DETENT:  # magnets: narrow notches
        x = np.cos(0.5 * (p[1] * s + p[2]))
        return p[0] * np.sin(p[1] * s + p[2]) * np.exp(-8.0 * x * x)
    if kind == CROSS_SPRING:  # a spring between two joints
        return p[0] * (s - p[1]) + p[2] * (s - p[1]) ** 3
    if kind == BREAK_IN:  # friction that wears off with time since the reversal
        return p[0] * np.exp(-z[1] / p[1]) * sign
    if kind == RANDOM_WALK:  # smooth, never the same twice
        f = 0.0
        for k in range(1, 13):
            x = np.sin(p[1] * k * k + 7.0 * k) * 1e3
            f += np.sin(2.0 * np.pi * (0.021 * k**1.4 * t + x)) / k
        return p[0] * f
    if kind == DEAD_BAND:  # the amplifier loses a fixed torque about zero
        return p[0] * np.tanh(load / p[1])
    if kind == SWITCH_ON:  # dry friction from one moment on
        return p[0] * sign * 0.5 * (1.0 + np.tanh((t - p[1]) / 0.05))
    if kind == CROSS_SPEED:  # braked by another joint's speed
        return p[0] * ds2 * ds2 * sign
    if kind == TOOTH:  # a damaged tooth: a kick against the motion, at every passage
        x = np.sin(0.5 * (p[1] * s + p[2]))
        return p[0] * sign * np.exp(-((x / 0.08) ** 2))
    if kind == WARMING_SPRING:
        return p[0] * (1.0 + p[2] * t) * np.sin(s - p[1]) ** 3
    if kind == THERMAL_GAIN:  # torque constant that falls as the motor warms
        return p[0] * (1.0 - np.exp(-t / p[1])) * load
    return 0.0


@njit(cache=True)
def apply_laws(
    laws, z, arm, t, theta, rate, q_m, v_m, joint_load, motor_load, cable_torque, reaction, f_joint, f_motor
):
    """Sum all laws into `f_joint` (n_joints,) and `f_motor` (n_motors,) [N m]."""
    f_joint[:] = 0.0
    f_motor[:] = 0.0
    for m in range(laws.kind.size):
        s = ds = s2 = ds2 = load = hinge = 0.0
        for i in range(theta.size):
            s += laws.A[m, i] * theta[i]
            ds += laws.A[m, i] * rate[i]
            s2 += laws.A2[m, i] * theta[i]
            ds2 += laws.A2[m, i] * rate[i]
            load += laws.A[m, i] * joint_load[i]
            hinge += abs(laws.A[m, i]) * reaction[i]
        for i in range(q_m.size):
            s += laws.B[m, i] * q_m[i]
            ds += laws.B[m, i] * v_m[i]
            load += laws.B[m, i] * motor_load[i]
        if laws.cable[m] >= 0:
            load = cable_torque[laws.cable[m]]
        f = force(laws.kind[m], laws.parameters[m], z[m], t, s, ds, s2, ds2, load, hinge, arm)
        for i in range(theta.size):
            f_joint[i] += laws.A[m, i] * f
        for i in range(q_m.size):
            f_motor[i] += laws.B[m, i] * f


@njit(cache=True)
def advance_laws(laws, z, rate, v_m, cable_rate, dt):
    """Move all internal states on by `dt`, given mean rates over it (`cable_rate` [N m/s] for memory in tension)."""
    for m in range(laws.kind.size):
        ds = 0.0
        for i in range(rate.size):
            ds += laws.A[m, i] * rate[i]
        for i in range(v_m.size):
            ds += laws.B[m, i] * v_m[i]
        if laws.kind[m] == TENSION:
            ds = cable_rate[laws.cable[m]]
        advance(laws.kind[m], laws.parameters[m], z[m], ds, dt)


# The step that dry friction makes at a reversal, half of it [N m], by law: it sets how stiff the arm is to integrate.
DRY: dict[int, Callable[[np.ndarray], float]] = {
    **dict.fromkeys((COULOMB, POSITION, CROSS_ANGLE, RUB, BREAK_IN, SWITCH_ON, TOOTH), lambda p: 2.0 * p[0]),
    STRIBECK: lambda p: p[0] + p[1],
    ASYMMETRIC: lambda p: 0.5 * (p[0] + p[1]),
    LOAD: lambda p: 500.0 * p[0],
    TORQUE: lambda p: 10.0 * p[0],
    DRIFT: lambda p: p[0] * (1.0 + p[1]),
    CAPSTAN: lambda p: 20.0 * p[0],
    CROSS_SPEED: lambda p: 2.0 * p[0],
}
