"""The one filter of both sides of the equation: a zero-phase low-pass and decimation."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import firwin, kaiserord, upfirdn

from .geometry import Vector

RING = 1.5
"""Periods for which a low-pass rings beside an edge."""
ONE_SIDED = 8
"""Samples beside an edge whose second derivatives are one-sided."""


@dataclass(frozen=True)
class Band:
    """Zero-phase low-pass and decimation.

    Attributes
    ----------
    rate : float
        Of what comes in [Hz].
    cutoff : float
        [Hz].
    step : int
        Every which sample is kept.
    taps : ndarray, shape (2 half + 1,)
        Symmetric kernel; half is a multiple of `step`.
    slow : float
        Accelerations are those of the motion below this frequency [Hz].
    """

    rate: float
    cutoff: float
    step: int
    taps: Vector
    slow: float = np.inf

    @property
    def reduced_rate(self) -> float:
        """Samples per second that are kept [Hz]."""
        return self.rate / self.step

    def reduce(self, x: Vector) -> Vector:
        """Filter and decimate along the last axis, (..., n) -> (..., ceil(n / step)); `segments` cuts the ends."""
        half, step, n = len(self.taps) // 2, self.step, x.shape[-1]
        kept = -(-n // step)
        if step < 4:  # blocks of few samples are no quicker
            y = upfirdn(self.taps, x, 1, step, axis=-1)
            return y[..., half // step : half // step + kept]
        many = 2 * half // step + 1  # blocks of samples that the kernel covers, one of them by its last tap alone
        padded = np.zeros((*x.shape[:-1], (kept + many - 1) * step))
        padded[..., half : half + n] = x
        taps = np.zeros((many, step))
        taps.flat[: len(self.taps)] = self.taps
        parts = padded.reshape(*x.shape[:-1], kept + many - 1, step) @ taps.T
        y = parts[..., :kept, 0].copy()
        for k in range(1, many):
            y += parts[..., k : k + kept, k]
        return y

    def segments(self, valid: np.ndarray) -> list[tuple[int, int]]:
        """Stretches of decimated samples whose whole kernel lies on valid samples, where filters have rung out.

        Those of positions do beside every edge, and derivatives are one-sided there.
        """
        half = len(self.taps) // 2
        wide = half + ONE_SIDED + round(RING * self.rate / min(self.slow, light(self.cutoff, self.rate)))
        bad = np.concatenate([[True], ~valid, [True]])
        edges = np.flatnonzero(bad)
        stretches = []
        for left, right in itertools.pairwise(edges):
            start = -(-(left + wide) // self.step)  # valid samples are left .. right - 2
            stop = (right - 2 - wide) // self.step + 1
            if stop - start > 8:
                stretches.append((start, stop))
        return stretches

    def shares(self, n: int, segments: Sequence[tuple[int, int]]) -> Vector:
        """Tell what each of `n` samples counts for in the mean over stretches of decimated samples, shape (n,)."""
        kept = np.zeros(n)
        for start, stop in segments:
            kept[start * self.step : (stop - 1) * self.step + 1 : self.step] = 1.0
        spread = np.convolve(kept, self.taps)[len(self.taps) // 2 :][:n]
        return spread / spread.sum() if segments else np.full(n, 1.0 / n)


def light(cutoff: float, rate: float) -> float:
    """Give the cut-off [Hz] of the light low-pass of positions that columns in a band are computed from."""
    return min(4.0 * cutoff, 0.45 * rate)


def make_band(rate: float, cutoff: float, step: int | None = None) -> Band:
    """Design the common filter: flat to `cutoff`, decimated so that little lies above it, or by a given `step`."""
    step = step or max(1, int(rate / (2.6 * cutoff)))
    if step == 1 and cutoff >= 0.38 * rate:
        return Band(rate, 0.5 * rate, 1, np.ones(1))
    nyquist = 0.5 * rate / step
    width = max(2 * (nyquist - cutoff), 0.3 * cutoff)
    length, beta = kaiserord(50.0, min(width / (0.5 * rate), 0.99))
    half = -(-(length // 2) // step) * step
    corner = min(cutoff + 0.5 * width, 0.49 * rate)
    ideal = firwin(2 * half + 1, corner, window="boxcar", fs=rate, scale=False)
    taps = np.asarray(ideal, float) * np.kaiser(2 * half + 1, float(beta))
    return Band(rate, cutoff, step, taps / taps.sum())
