"""Up to which frequency the torques hold what the accelerations ask for.

An encoder at the motor sees cables and links vibrate as if the whole link did, and samples that jitter look like
vibration too. In a band that is wider than this the inertias come out too small, and what is missing then looks like a
delay of the torque and hides all else.

Where encoders are too coarse even for a narrow band, the accelerations in it are mostly their steps; those quicker than
the torques ask for are left out, unless they ask for them somewhere: a motion may get quicker and quicker.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .accelerations import left_of
from .base import massive_columns
from .effects import CATALOGUE
from .geometry import Vector
from .motion import Motion
from .regressor import motor_regressor
from .signals_filters import lowpass

STEPS = 5  # candidates, half an octave apart
LOWEST = 4.0  # [Hz]
SLOWEST = 0.5  # [Hz], of accelerations that are mostly noise
CLEAR = 0.85  # of a motor's residual in the whole band: what a narrower one has to leave at most
NEAR = 1.03  # of the least residual
LONGEST = 12000  # samples that are looked at
PARTS = 8  # of what is looked at, where all of it is
LOCALLY = 1.2  # of the least residual in a part


def inertia_cutoff(
    motion: Motion, torque: Vector, band: Any, segments: Sequence[tuple[int, int]], coarse: bool = False
) -> float:
    """Find where a motor's torque stops to follow its accelerations, the lowest of all motors' [Hz].

    Parameters
    ----------
    motion : Motion
    torque : ndarray, shape (n_motors, n)
        Measured.
    band : Band
        The common filter.
    segments : sequence of (start, stop)
        Stretches of decimated samples that count.
    coarse : bool
        Whether the accelerations in the band are mostly noise. Then the whole stretch is looked at, also part by part.

    Returns
    -------
    float
        The band's own cut-off where no motor is explained clearly better by slower accelerations; where they are
        mostly noise, what slower ones would not do for.
    """
    lowest, sure = (SLOWEST, 1e-4) if coarse else (LOWEST, 1e-3)
    limits = [f for f in band.cutoff * 2.0 ** (-0.5 * np.arange(1, STEPS + 1)) if f >= lowest]
    if not limits or not segments:
        return band.cutoff
    a, b = max(segments, key=lambda s: s[1] - s[0])
    if not coarse:
        b = min(b, a + max(LONGEST // band.step, 64))
    model, heavy = motion.model, massive_columns(motion.model)
    y = band.reduce(torque)[:, a:b]
    rub = _rub(motion, band)[..., a:b]

    def left(accelerations: Vector, own: Vector) -> Vector:
        Y = motor_regressor(model, motion.q, motion.v, accelerations)[..., heavy].transpose(2, 1, 0)
        rotors = np.zeros((model.n_motors, model.n_motors, motion.n))
        rotors[range(model.n_motors), range(model.n_motors)] = own.T
        X = np.concatenate([band.reduce(np.concatenate([Y, rotors]))[..., a:b], rub])
        if X.shape[2] < 2 * len(X):
            return np.full((1, model.n_motors), np.nan)
        scale = np.sqrt(np.mean(y**2, axis=1))
        rests = np.array([left_of(X[:, i].T, y[i]) for i in range(model.n_motors)]) ** 2
        parts = [rests, *np.array_split(rests, PARTS, axis=1)] if coarse else [rests]
        return np.maximum([np.sqrt(part.mean(axis=1)) for part in parts], sure * scale)

    table = [left(motion.a, motion.a_m)]
    for f in limits:
        table.append(left(lowpass(motion.a, motion.rate, f), lowpass(motion.a_m, motion.rate, f)))
    errors = np.array(table)  # cut-offs, the whole and its parts, motors
    if not np.isfinite(errors).all():  # too few samples to tell
        return band.cutoff
    if coarse:
        near = np.r_[NEAR, np.full(PARTS, LOCALLY)]
        enough = errors <= near[:, None] * errors.min(axis=0)
        last = len(errors) - 1 - np.argmax(enough[::-1], axis=0)
        return float([band.cutoff, *limits][last.min()])
    errors = errors[:, 0]
    best = np.minimum(errors.min(axis=0), errors[0])
    found = [band.cutoff]
    for i in np.flatnonzero(best < CLEAR * errors[0]):
        first = int(np.argmax(errors[:, i] <= NEAR * best[i]))
        found.append([band.cutoff, *limits][first])
    return float(min(found))


def _rub(motion: Motion, band: Any) -> Vector:
    """Columns of the friction and the constant torque that most machines have, in the band."""
    series = []
    for name in ("viscous_friction", "coulomb_friction", "torque_offset"):
        effect = CATALOGUE[name]
        for place in effect.places(motion.model):
            if place.is_pair:
                continue
            shape = effect.grid([motion], place)[0]
            along = effect.columns(motion, place, shape).along
            assert along is not None
            series.append(along[0][:, None] * along[1][None, :, None])
    return band.reduce(np.concatenate(series))
