"""The spectrum of noise under a fit with many columns, and the whitener that follows from it.

A fit takes a share h(f) of the noise with it at each frequency, most of it at low ones where the columns are; power
over 1 - h(f) is free of that bias, and tells how many degrees of freedom are left to know it by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.optimize import minimize_scalar
from scipy.stats import f as f_distribution

from .geometry import Vector
from .whitening import Lines, Segments, Whitener, counts, live_in, rms_judged, with_bounds


@dataclass(frozen=True)
class Spectrum:
    """Power of noise per channel and band of frequencies.

    Attributes
    ----------
    centres : ndarray, shape (n_bands,)
        In cycles per sample.
    power : ndarray, shape (n_channels, n_bands)
        Variance that white noise of this power would have.
    dof : ndarray, shape (n_channels, n_bands)
        Degrees of freedom it is known by.
    share : ndarray, shape (n_bands,)
        Of all frequencies; sums to one.
    """

    centres: Vector
    power: Vector
    dof: Vector
    share: Vector

    @property
    def rms(self) -> Vector:
        """Standard deviation of the noise, shape (n_channels,)."""
        return np.sqrt(self.power @ self.share)


def spectrum(
    residuals: Sequence[Vector], basis: Sequence[Vector], segments: Sequence[Segments], least: float = 24.0
) -> Spectrum:
    """Estimate the spectrum of noise from the residuals of a least-squares fit.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (n_channels, n_samples)
        One per run.
    basis : sequence of ndarray, shape (rank, n_channels, n_samples)
        Orthonormal basis, over all runs, of what was fitted.
    segments : sequence of Segments
    least : float
        Degrees of freedom that a band should keep.
    """
    n_channels = residuals[0].shape[0]
    longest = max((b - a for run in segments for a, b in run), default=0)
    fine = np.linspace(0.0, 0.5, int(np.clip(longest // 24, 8, 96)) + 1)
    power, room, weight = (np.zeros((n_channels, len(fine) - 1)) for _ in range(3))
    for e, q, run in zip(residuals, basis, segments, strict=True):
        for a, b in run:
            if b - a < 64:
                continue
            window = np.hanning(b - a)
            band = np.clip(np.digitize(np.fft.rfftfreq(b - a), fine) - 1, 0, len(fine) - 2)
            live = live_in(run)
            for c in range(n_channels):
                total = np.sum(window**2 if live is None else window[live[c, a:b]] ** 2)
                taken = np.zeros(len(band))
                for k in range(0, len(q), 128):
                    taken += np.sum(np.abs(np.fft.rfft(q[k : k + 128, c, a:b] * window)) ** 2, axis=0)
                np.add.at(power[c], band, np.abs(np.fft.rfft(e[c, a:b] * window)) ** 2)
                np.add.at(room[c], band, np.maximum(total - taken, 0.0))
                np.add.at(weight[c], band, total)
    dof = room / np.maximum(weight, 1e-300) * _counts(fine, segments, n_channels)
    joined = _joined(dof, least)
    share = np.array([np.sum(weight[0, s]) for s in joined])
    return Spectrum(
        np.array([0.5 * (fine[s.start] + fine[s.stop]) for s in joined]),
        np.array(
            [[np.sum(p[s]) / max(np.sum(r[s]), 1e-300) for s in joined] for p, r in zip(power, room, strict=True)]
        ),
        np.array([[np.sum(d[s]) for s in joined] for d in dof]),
        share / max(float(share.sum()), 1e-300),
    )


def _counts(edges: Vector, segments: Sequence[Segments], n_channels: int) -> Vector:
    """Real degrees of freedom per channel and band of all segments, under a Hann window."""
    long = [with_bounds([(a, b) for a, b in run if b - a >= 64], run) for run in segments]
    samples = np.sum([counts(run, n_channels) for run in long], axis=0)
    return np.diff(edges) * 2 * samples[:, None] * 0.5


def _joined(dof: Vector, least: float) -> list[slice]:
    """Join neighbouring bands until every channel keeps enough degrees of freedom, from high frequencies down."""
    out, stop = [], dof.shape[1]
    for start in range(dof.shape[1] - 1, -1, -1):
        if np.all(dof[:, start:stop].sum(axis=1) >= least):
            out.append(slice(start, stop))
            stop = start
    if stop > 0:
        last = out.pop() if out else slice(0, dof.shape[1])
        out.append(slice(0, last.stop))
    return out[::-1]


def stands_out(rough: Spectrum, rest: Spectrum, alarm: float = 1e-4) -> bool:
    """Whether a residual has more power in some band than the noise that further columns leave over."""
    power = np.array([np.interp(rest.centres, rough.centres, p) for p in rough.power])
    dof = np.array([np.interp(rest.centres, rough.centres, d) for d in rough.dof])
    limit = f_distribution.isf(alarm / power.size, np.maximum(dof, 1.0), np.maximum(rest.dof, 1.0))
    return bool(np.any(power > limit * rest.power))


def wandering(noise: Spectrum) -> Vector:
    """Power of the slowest band over that of the usual one, shape (n_channels,)."""
    return noise.power[:, 0] / np.maximum(np.median(noise.power, axis=1), 1e-300)


def rises(power: Vector) -> Vector:
    """Give how much more power there is at each frequency than at a lower one, shape (n_channels, n_frequencies)."""
    return power / np.maximum(np.minimum.accumulate(power, axis=1), 1e-300)


def steepness(noise: Spectrum, near: tuple[float, float] = (4.0, 10.0)) -> Vector:
    """Power of the slowest band over that at `near` times its frequency, shape (n_channels,).

    An autoregression that forgets within a second is level there, however much slow power it has; a walk is not.
    """
    times = noise.centres / max(float(noise.centres[0]), 1e-300)
    beside = noise.power[:, (times >= near[0]) & (times <= near[1])]
    return noise.power[:, 0] / np.maximum(np.median(beside, axis=1), 1e-300) if beside.size else wandering(noise)


def whitener_of(
    noise: Spectrum,
    residuals: Sequence[Vector],
    segments: Sequence[Segments],
    order: int,
    blocks: Sequence[slice],
) -> Whitener:
    """Make the whitener of a spectrum; how channels and runs relate is taken from the residuals.

    Parameters
    ----------
    noise : Spectrum
    residuals : sequence of ndarray, shape (n_channels, n_samples)
    segments : sequence of Segments
    order : int
        Of the autoregression.
    blocks : sequence of slice
        Groups of channels whose noises have nothing in common.
    """
    n_channels = len(noise.power)
    grid = np.linspace(0.0, 0.5, 513)
    coefficients, level = np.zeros((n_channels, order)), np.ones(n_channels)
    for c in range(n_channels):
        density = np.exp(np.interp(grid, noise.centres, np.log(np.maximum(noise.power[c], 1e-300))))
        r = np.fft.irfft(density)[: order + 1]
        r[0] *= 1 + 1e-9
        coefficients[c] = solve_toeplitz(r[:order], r[1 : order + 1])
        level[c] = np.sqrt(max(r[0] - coefficients[c] @ r[1 : order + 1], 1e-300))
    own = Whitener(coefficients, np.diag(1 / level), np.ones(len(residuals)))
    white = []
    for r, (e, run) in enumerate(zip(residuals, segments, strict=True)):
        lines = Lines(np.asarray(e), np.eye(n_channels), np.arange(n_channels), n_channels)
        rows = own.lines([lines], [run], r)
        long = [b - a - order for a, b in run if b - a > 2 * order]
        starts = n_channels * np.cumsum([0, *long])
        parts = [np.zeros((n_channels, 0))]
        for s, n in zip(starts, long, strict=False):
            parts.append(np.array([rows[c, s + c * n : s + (c + 1) * n] for c in range(n_channels)]))
        white.append(np.concatenate(parts, axis=1))
    pooled = np.concatenate(white, axis=1)
    mix = np.zeros((n_channels, n_channels))
    for block in blocks:
        size = np.linalg.norm(pooled[block], axis=1, keepdims=True) + 1e-300
        correlation = (pooled[block] / size) @ (pooled[block] / size).T
        root = np.linalg.cholesky(correlation + 1e-9 * np.eye(len(size)))
        mix[block, block] = np.linalg.inv(root) / level[block]
    whole, *own = (rms_judged(w) for w in (pooled, *white))
    scale = np.array([x / whole if w.size else 1.0 for w, x in zip(white, own, strict=True)])
    return Whitener(coefficients, mix, np.maximum(scale, 1e-3))


def tone_peaks(x: Vector, rate: float, low: float, high: float, most: int, least: float) -> dict[float, float]:
    """Find lines in a spectrum: their frequencies [Hz], and their power over the median around them.

    Parameters
    ----------
    x : ndarray, shape (n,)
    rate, low, high : float
        Of sampling, and the range that is searched [Hz].
    most : int
        Lines at most.
    least : float
        Power over the median around, at least.
    """
    x, n = x - x.mean(), len(x)
    frequency = np.fft.rfftfreq(2 * n, 1 / rate)
    power = np.abs(np.fft.rfft(x * np.hanning(n), 2 * n)) ** 2
    local = np.array([np.median(power[max(0, k - 60) : k + 61]) for k in range(0, len(power), 20)])
    ratio = power / np.maximum(np.repeat(local, 20)[: len(power)], 1e-300)
    ratio[(frequency < low) | (frequency > high)] = 0.0
    peaks = {}
    for _ in range(most):
        k = int(np.argmax(ratio))
        if ratio[k] < least:
            break
        peaks[_exact_tone(x, rate, float(frequency[k]), 0.5 * rate / n)] = float(ratio[k])
        ratio[max(0, k - 6) : k + 7] = 0.0
    return peaks


def _exact_tone(x: Vector, rate: float, frequency: float, reach: float) -> float:
    t, window = np.arange(len(x)) / rate, np.hanning(len(x))
    power = minimize_scalar(
        lambda f: -abs(np.sum(window * x * np.exp(-2j * np.pi * f * t))),
        bounds=(frequency - reach, frequency + reach),
        method="bounded",
        options={"xatol": 1e-5},
    )
    return float(np.asarray(power.x))
