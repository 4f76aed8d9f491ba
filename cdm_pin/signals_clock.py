r"""When was each row really sampled? Repeated rows, frozen stretches, and sampling instants told by the motion itself.

A logger stamps or counts rows; the robot sampled them at other instants, some milliseconds off. A row sampled late by
:math:`\delta_k` shows every joint displaced by its own velocity times the same delay,

.. math:: q_j(t_k) - \bar q_j(t_k) = \dot{\bar q}_j(t_k)\, \delta_k + e_{jk},

with the smooth motion :math:`\bar q`. One unknown per row and as many equations as joints: the delays are estimated by
weighted least squares, and believed only where each joint's displacement is predicted by the *other* joints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from .recording import Recording
from .signals_filters import differentiate, lowpass, resample_uniform, stretches

LEAST = 2e-3  # of a step: what rows are off their stamps in the highest band, else there is nothing to put right
SLOW = 0.1  # of a joint's speed (rms), below which it tells no displacement from what its encoder rounds
EVEN = 0.2  # of the size of delays in a lower band (rms), that half of them have: a few starts and stops are the motion
MATTERS = 8.0  # [Hz]: delays that are slower make little of accelerations
STUCK = 5  # rows: a longer run of equal rows is a stretch without data, a shorter one a logger that read too early


@dataclass(frozen=True)
class Clock:
    """When the rows of a recording were sampled.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Sampling instants [s]; increasing over the rows kept.
    keep : ndarray of bool, shape (n,)
        False for rows that repeat an earlier one.
    notices : tuple of str
        What was found.
    unsure : float
        By how much rows may still be off (rms), as if they were so at any frequency, where slow delays look like motion
        [s].
    """

    time: np.ndarray
    keep: np.ndarray
    notices: tuple[str, ...] = ()
    unsure: float = 0.0


def read_clock(recording: Recording, *, repair: bool = True) -> Clock:
    """Find the rows that are samples of their own, and when they were taken.

    Parameters
    ----------
    recording : Recording
    repair : bool
        Whether sampling instants may be estimated from the motion (`sampling_instants`).
    """
    time = np.array(recording.time)
    notices = []
    stamped_twice = np.concatenate([[False], np.diff(time) <= 0])
    if stamped_twice.any():
        notices.append(f"{_share(stamped_twice)} of the rows repeat the stamp before them: left out")
    repeats = repeated_rows(recording) & ~stamped_twice
    if repeats.any():
        notices.append(f"{_share(repeats)} of the rows repeat the row before them while the robot moves: left out")
    keep = ~(stamped_twice | repeats)
    positions = recording.channels.get("joint_position", recording.channels.get("motor_position"))
    unsure = 0.0
    if repair and positions is not None and keep.sum() > 64:
        estimate = sampling_instants(time[keep], positions[keep])
        if estimate is not None:
            time[keep], notice, unsure = estimate
            notices.append(notice)
            keep = _leave_out_ties(time, keep)
    return Clock(time, keep, tuple(notices), unsure)


def repeated_rows(recording: Recording) -> np.ndarray:
    """Mark rows in which nothing changed although the positions moved on just before and after.

    Rows without any quantity but positions are not judged: a coarse encoder repeats itself honestly.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    positions = [x for name, x in recording.channels.items() if name in ("joint_position", "motor_position")]
    everything = np.hstack(list(recording.channels.values()))
    if not positions or everything.shape[1] == sum(x.shape[1] for x in positions) or len(everything) < 3:
        return np.zeros(len(everything), bool)
    same = np.concatenate([[False], np.all(np.diff(everything, axis=0) == 0, axis=1)])
    step = np.concatenate([[0.0], np.max(np.abs(np.diff(np.hstack(positions), axis=0)), axis=1)])
    repeats = np.zeros(len(same), bool)
    for start, stop in stretches(same):
        before, after = step[start - 1] if start > 1 else 0.0, step[stop] if stop < len(step) else 0.0
        moving = before > 0 and after > 0
        jumped = after > 0.3 * (stop - start + 1) * max(before, 1e-300)
        if moving and (stop - start <= STUCK or jumped):
            repeats[start:stop] = True
    return repeats


def sampling_instants(
    time: np.ndarray, positions: np.ndarray, agreement: float = 0.5
) -> tuple[np.ndarray, str, float] | None:
    """Estimate when rows were sampled from how all joints are displaced together, band by band from the highest down.

    Loggers are irregular from row to row: most of it is in the highest band, and no band holds much more than the one
    above it. Joints that merely move alike are displaced together too, but the slower the more.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Stamps as logged, increasing [s].
    positions : ndarray, shape (n, width)
        One side's positions, as logged.
    agreement : float
        Share of a joint's displacement that the other joints must predict (mean over the moving joints, each
        weighted by what it tells about the delay).

    Returns
    -------
    time : ndarray, shape (n,)
        Estimated instants [s].
    notice : str
        What was found.
    unsure : float
        By how much rows may still be off [s], as if evenly over all frequencies, if delays up to `MATTERS` could not be
        told from motion. The function returns None, in place of all three, where the joints do not agree.
    """
    if len(time) > 1 << 17:  # decline on a part of a long record before working on all of it
        middle = slice(len(time) // 2 - (1 << 15), len(time) // 2 + (1 << 15))
        if sampling_instants(time[middle], positions[middle], agreement) is None:
            return None
    step = float(np.median(np.diff(time)))
    instants, first, largest, every = np.array(time), None, np.inf, 0.0
    low, high = 0.2 / step, np.inf
    while low * (time[-1] - time[0]) > 20:
        shift, agreed, weight, size = _common_shift(instants, positions, step, low, high)
        irregular = size > LEAST * step if first is None else size < 2 * largest  # a delay that grows is the motion
        if agreed < agreement or not irregular:
            break
        if first is None:  # of delays that change from row to row, three fifths are in the highest band
            every = size / np.sqrt(0.6)
        first, largest = agreed if first is None else first, size
        instants = instants + shift
        for _ in range(3):  # what the flanks of the filters left over; with the weights that were agreed on
            instants = instants + _common_shift(instants, positions, step, low, high, weight, size)[0]
        low, high = low / 2, low
    if first is None:
        return None
    instants = np.maximum.accumulate(instants)
    off = np.std(instants - time)
    if off < 5e-3 * step:
        return None
    notice = f"rows were sampled {1e3 * off:.2g} ms (rms) off their stamps: all joints are displaced together"
    notice += f" (each predicted by the others, R2 {first:.2f}); stamps corrected by that"
    return instants, notice, every if min(high, 0.5 / step) > MATTERS else 0.0


def _common_shift(
    time: np.ndarray,
    x: np.ndarray,
    step: float,
    low: float,
    high: float,
    weight: np.ndarray | None = None,
    size: float = np.inf,
) -> tuple[np.ndarray, float, np.ndarray, float]:
    """Give the delay of each row that explains the displacements between `low` and `high` [Hz].

    Returns it with the agreement between joints, the joints' weights, and the size that delays have while the joints
    are quick; given weights and size, only the delay is computed. Rows that hardly move tell none larger than that.
    """
    kept = _leave_out_ties(time, np.ones(len(time), bool))
    grid, on_grid = resample_uniform(time[kept], x[kept], 1 / step)
    smooth = lowpass(on_grid, 1 / step, low)
    velocity = differentiate(smooth, 1 / step)
    rows = time
    if np.isfinite(high):
        displacement, time = lowpass(on_grid, 1 / step, high) - smooth, grid
    else:
        inside = np.clip(time, grid[0], grid[-1])
        both = CubicSpline(grid, np.hstack([smooth, velocity]))(inside)
        displacement, velocity = x - both[:, : x.shape[1]], both[:, x.shape[1] :]
    trusted = (time > time[0] + 1 / low) & (time < time[-1] - 1 / low)
    for k in np.flatnonzero(np.diff(rows) > max(5 * step, 0.25 / low)):
        trusted &= (time < rows[k] - 1 / low) | (time > rows[k + 1] + 1 / low)
    if trusted.sum() < 32:
        return np.zeros(len(rows)), -np.inf, np.ones(x.shape[1]), step

    def delay(weight: np.ndarray, size: float) -> np.ndarray:
        shift = _weighted(velocity, displacement, weight, min(size, step))
        return np.interp(rows, time, _bounded(shift, trusted, step))

    if weight is not None:
        return delay(weight, size), np.inf, weight, size
    rest, span = displacement, np.ptp(x, axis=0)
    found = np.ones(x.shape[1])
    moves = trusted[:, None] & (np.abs(velocity) > SLOW * np.sqrt(np.mean(velocity[trusted] ** 2, axis=0)))
    for _ in range(4):
        scatter = [1.48 * np.median(np.abs(r[m])) if m.any() else 0.0 for r, m in zip(rest.T, moves.T, strict=True)]
        scatter = np.array(scatter) + 1e-9 * span
        found = np.where(span > 0, 1 / np.where(span > 0, scatter, 1.0) ** 2, 0.0)  # a locked joint tells nothing
        rest = displacement - velocity * _weighted(velocity, displacement, found, step)[:, None]
    power = np.mean(displacement[trusted] ** 2, axis=0)
    speed = np.mean(velocity[trusted] ** 2, axis=0)
    moving = (speed * step**2 > 0.25 * power) & (power > 0)
    scores = np.zeros(x.shape[1])
    for j in np.flatnonzero(moving):
        others = np.where(np.arange(x.shape[1]) == j, 0.0, found)
        error = displacement[:, j] - velocity[:, j] * _weighted(velocity, displacement, others, step)
        scores[j] = max(1 - np.mean(error[trusted] ** 2) / power[j], -1.0)
    told = found * speed * moving
    agreed = float(scores @ told / told.sum()) if moving.sum() >= 2 else -np.inf
    worth = np.where(trusted, velocity**2 @ found, 0.0)
    quick = worth >= worth[trusted].mean()
    shift = _bounded(_weighted(velocity, displacement, found, step), trusted & quick, step)
    size = max(float(np.sqrt(np.mean(shift[quick & trusted] ** 2))), 1e-9 * step)
    agreed = agreed if not np.isfinite(high) or EVEN * size < np.median(np.abs(shift[quick & trusted])) else -np.inf
    return delay(found, size), agreed, found, size


def _bounded(shift: np.ndarray, trusted: np.ndarray, step: float) -> np.ndarray:
    return np.where(trusted, np.clip(shift, -2 * step, 2 * step), 0.0)


def _weighted(velocity: np.ndarray, displacement: np.ndarray, weight: np.ndarray, size: float) -> np.ndarray:
    """Fit displacement = velocity * shift per row, where shifts are of some size."""
    return (weight * velocity * displacement).sum(axis=1) / ((weight * velocity**2).sum(axis=1) + 1 / size**2)


def _leave_out_ties(time: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """Of the rows kept, leave out those sampled within a tenth of a step after the one before."""
    rows = np.flatnonzero(keep)
    steps = np.diff(np.maximum.accumulate(time[rows]))
    kept = np.zeros(len(time), bool)
    kept[rows[np.concatenate([[True], steps > 0.1 * np.median(steps)])]] = True
    return kept


def _share(mask: np.ndarray) -> str:
    return f"{100 * mask.mean():.2g} %" if mask.sum() > 20 else str(mask.sum())
