"""Drifting zeros of torque sensors: the shapes they take, and whether a recording shows them.

An autoregression takes slow wander for noise of all slow frequencies and so hides slow effects. Where a wander is seen,
its shapes are fitted beside the rigid body instead, for every motor and recording alone; no two recordings share them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution

from .geometry import Vector
from .whitening import Segments, inside, live_in

ALARM = 1e-3
"""Probability of seeing a wander in noise that has none."""
LONG = 1.5
"""Longest period over the duration: a zero that moves so slowly leaves a constant behind that tells nothing."""
SHORT = 0.99
"""The same where constants are to be left alone."""
LOUD = 6.0
"""What is so many times the rest of the noise in the band is no drift of a sensor: a fault."""
SAMPLED = 3.0
"""Unless it is below so many times the noise of single samples, of which the band holds little."""
QUICKER = 3
"""How many more waves a drift may take that is quicker than usual."""


@dataclass(frozen=True)
class Drift:
    """What the zeros of sensors do on some recordings.

    Attributes
    ----------
    columns : list of ndarray, shape (k, n_channels, n)
        One per run.
    channels : tuple of int
        Motors whose zeros were seen to move.
    quicker : int
        By how many waves more than usual (`slow_shapes`) the zeros were seen to move.
    stretch : float
        Longest period over the duration.
    """

    columns: list[Vector]
    channels: tuple[int, ...]
    quicker: int = 0
    stretch: float = LONG


def slow_shapes(n: int, rate: float, stretch: float, quicker: int = 0) -> Vector:
    """Give a ramp and slow waves, no quicker than one period in some 30 s, shape (n_shapes, n).

    Parameters
    ----------
    n : int
        Number of samples.
    rate : float
        [Hz].
    stretch : float
        Longest period over the duration; of less than one all shapes have a mean of zero.
    quicker : int
        How many harmonics more.
    """
    t = np.arange(n) / rate
    period = stretch * max(t[-1], 40.0)
    count = int(np.clip(round(period / 30.0), 2, 8)) + quicker
    phase = 2 * np.pi * t / period
    waves = [f(k * phase) for k in range(1, count + 1) for f in (np.sin, np.cos)]
    shapes = np.stack([t / max(t[-1], 1e-9), *waves])
    return shapes - shapes.mean(axis=1, keepdims=True) if stretch < 1.0 else shapes


def drift_columns(
    lengths: Sequence[int],
    rate: float,
    n_channels: int,
    channels: Sequence[int],
    stretch: float,
    quicker: int = 0,
) -> list[Vector]:
    """Give each of some channels slow shapes of its own on every run, per run (n_columns, n_channels, n)."""
    shapes = [slow_shapes(n, rate, stretch, quicker) for n in lengths]
    total = sum(len(s) for s in shapes) * len(channels)
    out, first = [], 0
    for own in shapes:
        bank = np.zeros((total, n_channels, own.shape[1]))
        for c in channels:
            bank[first : first + len(own), c] = own
            first += len(own)
        out.append(bank)
    return out


def drifting_channels(
    residuals: Sequence[Vector],
    basis: Sequence[Vector],
    segments: Sequence[Segments],
    rate: float,
    n_motors: int,
    quicker: int = 0,
    sampled: Vector | float = 0.0,
) -> list[int]:
    """Find the motors in whose torque the slow shapes have more power than the frequencies next to them.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (n_channels, n)
        Of a fit whose columns took what the motion repeats, one per run.
    basis : sequence of ndarray, shape (rank, n_channels, n)
        Orthonormal basis, over all runs, of those columns.
    segments : sequence of Segments
    rate : float
        [Hz].
    n_motors : int
        Their torques are the first channels.
    quicker : int
        Where it is not 0, it is the quickest of that many further waves that is asked for, beside all others; it has to
        be likely only.
    sampled : ndarray, shape (n_motors,) or float
        Noise of single samples of each torque.
    """
    power, room = np.zeros((2, n_motors, 2))
    total, count = np.zeros((2, n_motors))
    for e, q, run in zip(residuals, basis, segments, strict=True):
        for a, b in run:
            n = b - a
            if n < 0.5 * e.shape[1]:
                continue
            live, x = live_in(run), e[:n_motors, a:b]
            known = None
            for c in range(n_motors):
                kept = slice(None) if live is None else np.flatnonzero(live[c, a:b])
                own, basis_there = x[c, kept], q[:, c, a:b][:, kept]
                if known is None or live is not None:
                    known = _waves(n, rate, quicker, kept)
                total[c] += np.sum((own - own.mean()) ** 2)
                count[c] += len(own)
                for k, U in enumerate(known):
                    power[c, k] += float(np.sum((own @ U) ** 2))
                    room[c, k] += U.shape[1] - float(np.sum((basis_there @ U) ** 2))
    room = np.maximum(room, 1.0)
    ratio = (power[:, 0] / room[:, 0]) / np.maximum(power[:, 1] / room[:, 1], 1e-300)
    sure, likely = (f_distribution.isf(p / n_motors, room[:, 0], room[:, 1]) for p in (ALARM, 100 * ALARM))
    rest = np.maximum(total - power[:, 0], 0.0) / np.maximum(count, 1)
    slow = power[:, 0] < count * faint(rest, sampled)
    seen = np.any((ratio > (likely if quicker else sure)) & slow)
    return [int(c) for c in np.flatnonzero((ratio > likely) & slow)] if seen else []


def _waves(n: int, rate: float, quicker: int, kept: slice | np.ndarray) -> tuple[Vector, Vector]:
    """Give orthonormal slow shapes, the quickest of them alone if any is, and waves of the frequencies next to theirs.

    Over those of `n` samples that are kept, shape (n_kept, any) each.
    """
    slow = slow_shapes(n, rate, LONG, quicker)
    Q = np.linalg.qr(np.concatenate([np.ones((1, n)), slow]).T[kept])[0]
    t = np.arange(n) / rate
    top = len(slow) // 2 / (LONG * max(t[-1], 40.0))  # the quickest of the slow ones
    near = np.arange(1.5 * top, 6.0 * top, 0.5 / t[-1])
    phase = 2 * np.pi * np.outer(t[kept], near)
    R = np.linalg.qr(np.concatenate([Q, np.cos(phase), np.sin(phase)], axis=1))[0][:, Q.shape[1] :]
    return (Q[:, -2:] if quicker else Q[:, 1:]), R


def faint(rest: Vector, sampled: Vector | float) -> Vector:
    """Say how large a drift of a sensor may be beside the rest of a torque in the band, both mean squares."""
    return np.maximum(LOUD**2 * rest, (SAMPLED * np.asarray(sampled)) ** 2)


def without_drift(errors: Vector, run: Segments, shapes: Vector) -> Vector:
    """Take slow shapes (n_shapes, n) out of errors (n_channels, n) by least squares over the segments of a run."""
    known, live = inside(run, errors.shape[1]), live_in(run, slice(len(errors)))
    if live is not None:
        rows = zip(errors, live, strict=True)
        return np.concatenate([_without(e[None], known & own, shapes) * own for e, own in rows])
    return _without(errors, known, shapes)


def _without(errors: Vector, known: np.ndarray, shapes: Vector) -> Vector:
    if known.sum() <= len(shapes):
        return errors
    theta = np.linalg.lstsq(shapes[:, known].T, errors[:, known].T, rcond=None)[0]
    return errors - theta.T @ shapes
