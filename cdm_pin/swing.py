r"""A soft cable seen from its motor alone: the links swing on it, and all that loads the cable does so through it.

Motors say where cables begin. Where the links are follows from what the soft cable carries: with x its travel and
b = -E e_i / s_i the joints' motion per travel,

.. math::  K x + D \dot x = C_i(q, \dot q, \ddot q),  \qquad q = E q_m + b x,

an oscillator that the motors drive. First-order columns, C_i / K, are those far below its resonance; here it is
integrated, and whatever acts on the joints is passed on as its linearisation about that motion answers
(Spong, J. Dyn. Syst. Meas. Control 109(4), 1987, for the model).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numba
import numpy as np

from .geometry import Vector
from .motion import Motion
from .signals_filters import stretches

ROUNDS = 3
LEAST_DAMPING = 2e-3
"""Least damping ratio that is integrated with: an estimate may pass through less."""
FARTHEST = 0.6
"""Travel that is taken for possible [rad]."""
CONTACT = 0.3
"""Damping ratio of the contact at the ends of a play."""
LONGEST = 8
"""Stretches without gaps whose first state is estimated, the longest."""


@dataclass(frozen=True)
class Swing:
    """How the links swing on one cable along a motion.

    Attributes
    ----------
    cable : int
    stiffness, damping : float
        [N m/rad], [N m s/rad].
    oscillator : ndarray, shape (3, n)
        What its travel, speed and acceleration ask of the cable: stiffness, damping and inertia, those of the links
        included.
    slopes : ndarray, shape (3, n, n_motors)
        Motor torque per travel, speed and acceleration.
    travel : ndarray, shape (3, n)
        x and its rates [rad, s].
    free : ndarray, shape (k, n, n_motors)
        Motor torque of unit swings from the first states of stretches without gaps.
    still : Motion
        As if the cable were rigid.
    half_gap : float
        Travel to either side within which the cable carries nothing: its play [rad].
    """

    cable: int
    stiffness: float
    damping: float
    oscillator: Vector
    slopes: Vector
    travel: Vector
    free: Vector
    still: Motion
    half_gap: float = 0.0

    def answer(self, load: Vector) -> Vector:
        """Give travel, speed and acceleration under a further load of the cable, shapes (n,) -> (3, n)."""
        return oscillate(self.oscillator, np.ascontiguousarray(load), 1.0 / self.still.rate)

    def through(self, torque: Vector) -> Vector:
        """Pass on torques that load the cables, as the motors feel them, shape (n, n_motors)."""
        load = torque[:, self.cable] / self.still.model.arm_scale[self.cable]
        return torque + np.einsum("dn,dnm->nm", self.answer(load), self.slopes)

    @property
    def compliant(self) -> Vector:
        """Derivatives of the motors' torque by beta, shape (n, n_motors, k).

        By (1/K, D/K^2) of a soft cable, by half of the play of one that has it.
        """
        K, D = self.stiffness, self.damping
        if self.half_gap:
            touching = np.abs(self.travel[0]) > self.half_gap
            by_gap = self.answer(K * np.sign(self.travel[0]) * touching)
            return np.einsum("dn,dnm->nm", by_gap, self.slopes)[..., None]
        by_K, by_D = (np.einsum("dn,dnm->nm", self.answer(-x), self.slopes) for x in self.travel[:2])
        return np.stack([-(K**2) * by_K - 2.0 * D * K * by_D, K**2 * by_D], axis=-1)


def swung(motion: Motion, cable: int, stiffness: float, damping: float, carried: Vector) -> Motion:
    """Give the motion of links that hang on one soft cable.

    The first state of every stretch without gaps is that with which the motors' torques agree best. As it is where the
    links would swing further than any cable lets them.

    Parameters
    ----------
    motion : Motion
        As if the cable were rigid, with what its motors felt.
    cable : int
    stiffness, damping : float
    carried : ndarray, shape (n, n_motors)
        What the cables carry beside the rigid body's torque [N m].
    """
    model, felt = motion.model, motion.felt
    assert felt is not None
    scale, b = model.arm_scale[cable], model.joints_per_travel(cable)
    measured = felt.torque - motion.a_m * model.rotor_inertia - carried
    if motion.extra_motor is not None:
        measured = measured - motion.extra_motor
    parts = sorted(stretches(felt.valid), key=lambda s: s[0] - s[1])[:LONGEST]
    if not parts:
        return motion

    def linearised(moved: Motion) -> tuple[Vector, Vector, Vector, Vector]:
        slopes = slopes_along(moved, b)
        mass = np.maximum(-slopes[2, :, cable] / scale, 1e-9)
        spring = np.maximum(stiffness - slopes[0, :, cable] / scale, 0.2 * stiffness)
        drag = damping - slopes[1, :, cable] / scale
        oscillator = np.stack([spring, np.maximum(drag, LEAST_DAMPING * 2.0 * np.sqrt(mass * spring)), mass])
        own = _released(oscillator, parts, motion.rate)
        return slopes, oscillator, own, np.nan_to_num(np.einsum("kdn,dnm->knm", own, slopes))

    x, moved = np.zeros((3, motion.n)), motion
    slopes, oscillator, own, free = linearised(moved)
    for k in range(ROUNDS):
        if k == 1:
            slopes, oscillator, own, free = linearised(moved)
        torque = _asked(moved, motion)
        load = (torque + carried)[:, cable] / scale - stiffness * x[0] - damping * x[1]
        step = _tame(oscillate(oscillator, load, 1.0 / motion.rate))
        rest = np.nan_to_num(measured - torque - np.einsum("dn,dnm->nm", step, slopes))
        states = np.linalg.lstsq(free[:, felt.valid].reshape(len(free), -1).T, rest[felt.valid].ravel(), rcond=None)[0]
        x = _tame(x + step + np.tensordot(np.asarray(states, float), own, 1))
        moved = _moved(motion, x, b)
    if not np.isfinite(moved.tau_m).all() or np.abs(x[0, felt.valid]).max() > 0.999 * FARTHEST:
        return motion
    return replace(moved, swing=Swing(cable, stiffness, damping, oscillator, slopes, x, free, motion))


def rattling(motion: Motion, cable: int, stiffness: float, half_gap: float, carried: Vector) -> Motion:
    """Give the motion of links on one cable that has play, within which it carries nothing.

    Where its sides touch, the contact is a stiff spring that is well damped: of how it bounces the band tells nothing.
    The first state is at rest on that side on which the load lies.

    Parameters
    ----------
    motion : Motion
        As if the cable were rigid, with what its motors felt.
    cable : int
    stiffness : float
        Of the contact [N m/rad].
    half_gap : float
        [rad].
    carried : ndarray, shape (n, n_motors)
        What the cables carry beside the rigid body's torque [N m].
    """
    scale, b = motion.model.arm_scale[cable], motion.model.joints_per_travel(cable)
    x, moved, damping = np.zeros((3, motion.n)), motion, 0.0
    slopes = own = np.zeros((3, 0))
    for k in range(ROUNDS):
        if k < 2:
            slopes = slopes_along(moved, b)
            own = -slopes[..., cable] / scale
            usual = float(np.median(own[2]))
            if not usual > 0.0:
                return motion
            own[2] = np.maximum(own[2], 0.1 * usual)
            damping = 2.0 * CONTACT * np.sqrt(usual * stiffness)
        torque = _asked(moved, motion)
        load = (torque + carried)[:, cable] / scale + np.einsum("dn,dn->n", own, x)
        fine = int(np.ceil(6.0 * np.sqrt(stiffness / own[2].min()) / motion.rate))
        x = _tame(_rattle(own, load, stiffness, damping, half_gap, 1.0 / motion.rate, fine))
        moved = _moved(motion, x, b)
    if not np.isfinite(moved.tau_m).all() or np.abs(x[0]).max() > 0.999 * FARTHEST:
        return motion
    touching = np.abs(x[0]) > half_gap
    oscillator = own + touching * np.array([stiffness, damping, 0.0])[:, None]
    oscillator[0] = np.maximum(oscillator[0], 1e-3 * stiffness)
    none = np.zeros((0, motion.n, motion.model.n_motors))
    return replace(moved, swing=Swing(cable, stiffness, damping, oscillator, slopes, x, none, motion, half_gap))


def _tame(x: Vector) -> Vector:
    """Keep a travel that no cable has, as of a stiffness that is far too low, from running away."""
    if not np.isfinite(x).all():
        return np.zeros_like(x)
    return np.asarray(x * min(1.0, FARTHEST / max(float(np.abs(x[0]).max()), 1e-12)))


def _moved(motion: Motion, x: Vector, b: Vector) -> Motion:
    q, v, a = (old + np.outer(own, b) for old, own in zip((motion.q, motion.v, motion.a), x, strict=True))
    return replace(motion, q=q, v=v, a=a)


def _asked(moved: Motion, motion: Motion) -> Vector:
    """Give the motors' torque of the rigid body, and of known springs beyond that on `motion`, where the links are."""
    return moved.tau_m + moved.spring_torque() - motion.spring_torque()


def slopes_along(motion: Motion, b: Vector) -> Vector:
    """Differentiate the motors' torque along b of positions, speeds and accelerations, shape (3, n, n_motors).

    Known springs are among what depends on positions.
    """

    def at(k: int, step: float) -> Vector:
        return _moved(motion, step * np.outer(np.eye(3)[k], np.ones(motion.n)), b).tau_m

    by_position = (at(0, 1e-4) - at(0, -1e-4)) / 2e-4 + motion.spring_torque(np.tile(b, (motion.n, 1)))
    return np.stack([by_position, 0.5 * (at(1, 1.0) - at(1, -1.0)), at(2, 1.0) - motion.tau_m])


def _released(oscillator: Vector, parts: Sequence[tuple[int, int]], rate: float) -> Vector:
    """Let an oscillator swing freely from unit travel and from unit speed at the start of stretches, (k, 3, n)."""
    out = np.zeros((2 * len(parts), *oscillator.shape))
    for k, (start, stop) in enumerate(parts):
        own = np.ascontiguousarray(oscillator[:, start:stop])
        for j, (x, v) in enumerate(np.eye(2)):
            out[2 * k + j, :, start:stop] = _integrate(own, np.zeros(stop - start), x, v, 1.0 / rate)
    return out


def oscillate(oscillator: Vector, load: Vector, dt: float) -> Vector:
    """Drive an oscillator whose coefficients change slowly by a load, from where it would rest, shape (3, n)."""
    return _integrate(oscillator, load, float(load[0] / oscillator[0, 0]), 0.0, dt)


@numba.njit(cache=True)
def _integrate(oscillator, load, x, v, dt):
    """Step m x'' + c x' + k x = load exactly for a load that is linear within each step (m, c, k constant there)."""
    n = len(load)
    out = np.empty((3, n))
    for t in range(n):
        k, c, m = oscillator[0, t], oscillator[1, t], oscillator[2, t]
        out[0, t], out[1, t], out[2, t] = x, v, (load[t] - c * v - k * x) / m
        if t + 1 == n:
            break
        k, c, m = (
            0.5 * (k + oscillator[0, t + 1]),
            0.5 * (c + oscillator[1, t + 1]),
            0.5 * (m + oscillator[2, t + 1]),
        )
        slope = (load[t + 1] - load[t]) / dt
        # a motion that follows the load: p + r s, with k r = slope, k p + c r = load
        r = slope / k
        p = (load[t] - c * r) / k
        y, w = x - p, v - r
        a, wn2 = 0.5 * c / m, k / m
        d = wn2 - a * a
        e = np.exp(-a * dt)
        if d > 1e-12:
            o = np.sqrt(d)
            co, si = e * np.cos(o * dt), e * np.sin(o * dt) / o
        elif d < -1e-12:
            o = np.sqrt(-d)
            slow, fast = np.exp((o - a) * dt), np.exp(-(o + a) * dt)
            co, si = 0.5 * (slow + fast), 0.5 * (slow - fast) / o
        else:
            co, si = e, e * dt
        x = y * co + (w + a * y) * si + p + r * dt
        v = w * co - (a * w + wn2 * y) * si + r
    return out


@numba.njit(cache=True)
def _rattle(own, load, stiffness, damping, gap, dt, fine):
    """Step the links' m x'' + c x' + k x, and a contact beyond a gap on either side, under a load, in fine steps.

    By the trapezoidal rule, with the contact as it is at the start of each of them.
    """
    n, h = len(load), dt / fine
    out = np.empty((3, n))
    x, v = np.sign(load[0]) * (gap + abs(load[0]) / stiffness), 0.0
    for t in range(n):
        touches = abs(x) > gap
        force = own[1, t] * v + own[0, t] * x
        if touches:
            force += stiffness * (x - np.sign(x) * gap) + damping * v
        out[0, t], out[1, t], out[2, t] = x, v, (load[t] - force) / own[2, t]
        if t + 1 == n:
            break
        for s in range(fine):
            share = (s + 0.5) / fine
            k, c, m = own[:, t] + share * (own[:, t + 1] - own[:, t])
            r = load[t] + share * (load[t + 1] - load[t])
            if abs(x) > gap:
                r += stiffness * np.sign(x) * gap
                k += stiffness
                c += damping
            late = 0.5 * h * c / m + 0.25 * h * h * k / m
            speed = (v * (1.0 - late) + h * (r - k * x) / m) / (1.0 + late)
            x += 0.5 * h * (v + speed)
            v = speed
    return out
