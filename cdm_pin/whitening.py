"""Whitening of residuals: an autoregressive model per channel and a covariance over channels, from the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from scipy.linalg import block_diag, solve_toeplitz
from scipy.special import gammaln
from scipy.stats import chi2

from .geometry import Vector
from .signals_filters import stretches

Segments = Sequence[tuple[int, int]]

SPECTRUM = 8192
"""Points of a spectrum that is added to another."""


class Stretches(list[tuple[int, int]]):
    """Stretches (start, stop) without gaps of one run, of which each channel is judged by some samples alone.

    Parameters
    ----------
    bounds : sequence of (int, int)
    live : ndarray of bool, shape (n_channels, n_samples)
        Which samples count.
    """

    def __init__(self, bounds: Segments, live: np.ndarray):
        super().__init__(bounds)
        self.live = live


def live_in(run: Segments, channels: slice = slice(None)) -> np.ndarray | None:
    """Tell by which samples of a run some channels are judged, shape (n_channels, n_samples); None if by all."""
    return run.live[channels] if isinstance(run, Stretches) else None


def with_bounds(bounds: Segments, like: Segments) -> Segments:
    """Give other stretches of a run, of which the same samples count."""
    return Stretches(bounds, like.live) if isinstance(like, Stretches) else bounds


def of_channels(run: Segments, channels: slice) -> Segments:
    """Give the stretches of a run as some channels are judged by them."""
    return Stretches(run, run.live[channels]) if isinstance(run, Stretches) else run


def blanked(series: Vector, run: Segments) -> Vector:
    """Put zeros where channels are not judged, (..., n_channels, n_samples)."""
    live = live_in(run)
    return series if live is None else series * live


def rms_judged(series: Vector, axis: int | None = None) -> Vector:
    """Root mean square, along an axis or of all, of what is judged: the rest is zero."""
    return np.sqrt(np.sum(series**2, axis=axis) / np.maximum(np.count_nonzero(series, axis=axis), 1))


def foreseen(live: np.ndarray) -> np.ndarray:
    """Tell which samples, (..., n), are judged and whose past is: all but the first behind one that is not judged."""
    return live & np.concatenate([live[..., :1], live[..., :-1]], axis=-1)


def counts(run: Segments, n_channels: int, lost: int = 0) -> np.ndarray:
    """Count the samples of stretches that each channel is judged by; those foreseen if the first few are lost."""
    live, kept = live_in(run), [(a + lost, b) for a, b in run]
    if live is None:
        return np.full(n_channels, sum(b - a for a, b in kept))
    return np.array([sum(int(row[a:b].sum()) for a, b in kept) for row in (foreseen(live) if lost else live)])


@dataclass(frozen=True)
class Lines:
    """Columns as sums of series, each seen by the channels with weights of its own.

    Attributes
    ----------
    series : ndarray, shape (m, n_samples)
    weights : ndarray, shape (m, n_channels)
    owner : ndarray of int, shape (m,)
        Which column each series belongs to.
    n_columns : int
    """

    series: Vector
    weights: Vector
    owner: np.ndarray
    n_columns: int

    @classmethod
    def of(cls, bank: Vector) -> Lines:
        """Take columns apart, shape (n_columns, n_channels, n_samples)."""
        live = np.argwhere(bank.any(axis=2))
        return cls(bank[live[:, 0], live[:, 1]], np.eye(bank.shape[1])[live[:, 1]], live[:, 0], len(bank))

    @classmethod
    def join(cls, parts: Sequence[Lines]) -> Lines:
        """Put the columns of several behind each other."""
        first = np.cumsum([0, *[part.n_columns for part in parts]])
        return cls(
            np.concatenate([part.series for part in parts]),
            np.concatenate([part.weights for part in parts]),
            np.concatenate([part.owner + k for part, k in zip(parts, first, strict=False)]),
            int(first[-1]),
        )

    def part(self, columns: Sequence[slice]) -> Lines:
        """Give some of the columns, in this order."""
        target = np.full(self.n_columns, -1)
        which = np.concatenate([np.arange(s.start, s.stop) for s in columns])
        target[which] = np.arange(len(which))
        own = target[self.owner] >= 0
        return Lines(self.series[own], self.weights[own], target[self.owner[own]], len(which))

    def dense(self) -> Vector:
        """Add the series up, shape (n_columns, n_channels, n_samples)."""
        out = np.zeros((self.n_columns, self.weights.shape[1], self.series.shape[1]))
        for i, w, x in zip(self.owner, self.weights, self.series, strict=True):
            out[i, w != 0] += w[w != 0, None] * x
        return out


@dataclass(frozen=True)
class Whitener:
    """Prediction-error filter of each channel, then the inverse root of the innovations' covariance.

    Attributes
    ----------
    coefficients : ndarray, shape (n_channels, order)
        e_t - sum_k c_k e_{t-k} is white.
    mix : ndarray, shape (n_channels, n_channels)
        Lower triangular; unit covariance after it.
    scale : ndarray, shape (n_runs,)
        Standard deviation of each run relative to the pool.
    """

    coefficients: Vector
    mix: Vector
    scale: Vector

    @classmethod
    def white(cls, level: Vector, n_runs: int) -> Whitener:
        """White noise of a standard deviation per channel, shape (n_channels,), in channels that share none of it."""
        return cls(np.zeros((len(level), 1)), np.diag(1.0 / level), np.ones(n_runs))

    def with_white(self, level: Vector) -> Whitener:
        """Give the whitener of the same noise with white noise of its own in each channel beside it.

        The spectra add up; the autoregression has the autocovariances of the sum (Yule-Walker).

        Parameters
        ----------
        level : ndarray, shape (n_channels,)
            Standard deviation of the white noise.
        """
        root = np.linalg.inv(self.mix)
        covariance = root @ root.T
        coefficients = np.empty_like(self.coefficients)
        for c, (own, white) in enumerate(zip(self.coefficients, level, strict=True)):
            spectrum = covariance[c, c] / np.abs(np.fft.rfft([1.0, *-own], SPECTRUM)) ** 2 + white**2
            lags = np.fft.irfft(spectrum)[: len(own) + 1]
            coefficients[c] = solve_toeplitz(lags[:-1], lags[1:])
            covariance[c, c] = lags[0] - coefficients[c] @ lags[1:]
        return Whitener(coefficients, np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), float), self.scale)

    @property
    def order(self) -> int:
        """Samples that are lost at the start of every segment."""
        return self.coefficients.shape[1]

    def __call__(self, bank: Vector, segments: Segments, run: int = 0) -> Vector:
        """Whiten columns of one run.

        Parameters
        ----------
        bank : ndarray, shape (n_columns, n_channels, n_samples)
        segments : sequence of (start, stop)
            Stretches without gaps.
        run : int
            Which run it is.

        Returns
        -------
        ndarray, shape (n_columns, n_rows)
        """
        return self.lines([Lines.of(bank)], [segments], run)

    def lines(self, runs: Sequence[Lines], segments: Sequence[Segments], first: int = 0) -> Vector:
        """Whiten columns that are sums of weighted series, of runs from the `first` on, shape (n_columns, n_rows)."""
        long = [[(start, stop) for start, stop in run if stop - start > 2 * self.order] for run in segments]
        rows = [len(self.coefficients) * sum(stop - start - self.order for start, stop in run) for run in long]
        out, row = np.zeros((runs[0].n_columns, sum(rows))), 0
        for r, (lines, own, n) in enumerate(zip(runs, long, rows, strict=True), start=first):
            if n and len(lines.series):
                bounds = np.array(own, dtype=np.int64)
                mix, live = self.mix / self.scale[r], live_in(segments[r - first])
                counted = np.ones((0, 0), np.bool_) if live is None else np.ascontiguousarray(live)
                _whiten(lines.series, lines.weights, lines.owner, bounds, self.coefficients, mix, out, row, counted)
            row += n
        return out


@numba.njit(cache=True, fastmath=True, nogil=True)
def _innovations(coefficients, x, y):
    """Filter a series; four coefficients at a time, so that `y` is written a quarter as often."""
    order = len(coefficients)
    n = len(x) - order
    for t in range(n):
        y[t] = x[t + order]
    k = 0
    while k + 4 <= order:
        c0, c1, c2, c3 = coefficients[k], coefficients[k + 1], coefficients[k + 2], coefficients[k + 3]
        for t in range(n):
            u = t + k
            y[t] -= c0 * x[u] + c1 * x[u + 1] + c2 * x[u + 2] + c3 * x[u + 3]
        k += 4
    while k < order:
        c = coefficients[k]
        for t in range(n):
            y[t] -= c * x[t + k]
        k += 1


@numba.njit(cache=True, nogil=True)
def _hold(x, live, y):
    """Put the last value before them in the place of samples that are not live, or the first one behind them."""
    last = 0.0
    for t in range(len(x)):
        if live[t]:
            last = x[t]
            break
    for t in range(len(x)):
        if live[t]:
            last = x[t]
        y[t] = last


@numba.njit(cache=True, fastmath=True, nogil=True)
def _whiten(series, weights, owner, bounds, coefficients, mix, out, first_row, live):
    """Filter every series by 1 - sum_k c_k z^-k of each channel that sees it, mix the channels, add to its column.

    What is whitened stands in rows from `first_row` on. Those of samples by which a channel is not judged are zero, and
    of the first behind such, whose past is not known; further behind them the last value before them is their past.
    """
    n_channels, order = coefficients.shape
    reversed_ = np.ascontiguousarray(coefficients[:, ::-1])
    y, counted = np.empty(series.shape[1]), np.empty(series.shape[1])
    for m in range(len(series)):
        x, column = series[m], out[owner[m]]
        row = first_row
        for s in range(len(bounds)):
            first, n = bounds[s, 0], bounds[s, 1] - bounds[s, 0] - order
            for c in range(n_channels):
                if weights[m, c] == 0.0:
                    continue
                if len(live):
                    own = slice(first, first + n + order)
                    _hold(x[own], live[c, own], counted[own])
                    _innovations(reversed_[c], counted[own], y)
                    for t in range(first + order, first + order + n):
                        y[t - first - order] *= live[c, t] and live[c, t - 1]
                else:
                    _innovations(reversed_[c], x[first : first + n + order], y)
                for r in range(c, n_channels):
                    g = mix[r, c] * weights[m, c]
                    if g != 0.0:
                        target = column[row + r * n : row + (r + 1) * n]
                        for t in range(n):
                            target[t] += g * y[t]
            row += n_channels * n


def fit_whitener(
    residuals: Sequence[Vector], segments: Sequence[Segments], order: int, blocks: Sequence[slice] | None = None
) -> Whitener:
    """Fit a whitener to residuals by least squares over all segments.

    Means are taken out first: a constant that is still unexplained is not noise.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (n_channels, n_samples)
        One per run.
    segments : sequence of Segments
    order : int
        Of the autoregression.
    blocks : sequence of slice, optional
        Groups of channels whose noises have nothing in common; all one group if not given.
    """
    coefficients, innovations = autoregressions(residuals, segments, order)
    return whitener_from(coefficients, innovations, blocks)


def autoregressions(
    residuals: Sequence[Vector], segments: Sequence[Segments], order: int
) -> tuple[Vector, list[list[Vector]]]:
    """Fit an autoregression to each channel, as `fit_whitener` does.

    Returns
    -------
    coefficients : ndarray, shape (n_channels, order)
    innovations : list of list of ndarray
        Per run those of each channel; zero where it is not judged.
    """
    n_channels = residuals[0].shape[0]
    longest = max((stop - start for run in segments for start, stop in run), default=0)
    order = max(1, min(order, longest // 6))
    coefficients = np.zeros((n_channels, order))
    innovations: list[list[Vector]] = [[] for _ in residuals]
    for c in range(n_channels):
        lags, targets, owner = [], [], []
        for r, (e, run) in enumerate(zip(residuals, segments, strict=True)):
            live = live_in(run)
            own = None if live is None else live[c]
            inside = [e[c, a:b] if own is None else e[c, a:b][own[a:b]] for a, b in run]
            mean = np.mean(np.concatenate(inside)) if sum(map(len, inside)) else 0.0
            for start, stop in run:
                x = e[c, start:stop] - mean
                if len(x) <= 2 * order:
                    continue
                if own is not None:
                    there = x.copy()
                    _hold(there, own[start:stop], x)
                windows = np.lib.stride_tricks.sliding_window_view(x, order + 1)
                past, target = windows[:, :order][:, ::-1], windows[:, order]
                if own is not None:
                    known = foreseen(own)[start + order : stop]
                    past, target = past * known[:, None], target * known
                lags.append(past)
                targets.append(target)
                owner.append(np.full(len(windows), r))
        if not targets:
            continue
        A, b = np.concatenate(lags), np.concatenate(targets)
        gram = A.T @ A
        gram[np.diag_indices(order)] += 1e-10 * np.trace(gram) / order + 1e-300
        coefficients[c] = np.linalg.solve(gram, A.T @ b)
        e, who = b - A @ coefficients[c], np.concatenate(owner)
        for r in range(len(residuals)):
            innovations[r].append(e[who == r])
    return coefficients, innovations


def whitener_from(
    coefficients: Vector, innovations: Sequence[Sequence[Vector]], blocks: Sequence[slice] | None = None
) -> Whitener:
    """Make the whitener of autoregressions and what they leave of each run (`autoregressions`)."""
    n_channels = len(coefficients)
    runs = [_aligned(run) for run in innovations if len(run) == n_channels and len(run[0])]
    if not runs:
        return Whitener(coefficients, np.eye(n_channels), np.ones(len(innovations)))
    pooled = np.concatenate(runs, axis=1)
    mix = np.zeros((n_channels, n_channels))
    for block in blocks or [slice(0, n_channels)]:
        count = np.sqrt(np.maximum(np.count_nonzero(pooled[block], axis=1), 1))
        covariance = pooled[block] @ pooled[block].T / np.outer(count, count)
        floor = 1e-12 * np.trace(covariance) / n_channels + 1e-300
        mix[block, block] = np.linalg.inv(np.linalg.cholesky(covariance + floor * np.eye(len(covariance))))
    scale = np.ones(len(innovations))
    if len(runs) == len(innovations):
        scale = np.array([np.sqrt(np.sum((mix @ run) ** 2) / max(np.count_nonzero(run), 1)) for run in runs])
    return Whitener(coefficients, mix, np.maximum(scale, 1e-6))


def fit_quiet(
    residuals: Sequence[Vector], segments: Sequence[Segments], order: int, blocks: Sequence[slice]
) -> tuple[Whitener, list[Segments]]:
    """Fit a whitener to each group of channels by itself: to the first where it does not stand out (`quiet_segments`).

    To the others, where nothing does. Rounding comes in bursts where motion rests and starts, which is no reason to
    know less of the noise of torques, but one to know all channels of travel from the same samples. The second value
    is where the first group does not stand out.
    """
    first = quiet_segments([e[blocks[0]] for e in residuals], [of_channels(run, blocks[0]) for run in segments])
    first = [with_bounds(own, run) for own, run in zip(first, segments, strict=True)]
    rest = quiet_segments(residuals, segments) if len(blocks) > 1 else first
    quiet = [first, *[rest] * (len(blocks) - 1)]
    parts = [
        fit_whitener([e[b] for e in residuals], [of_channels(run, b) for run in own], order)
        for b, own in zip(blocks, quiet, strict=True)
    ]
    if len(parts) == 1:
        return parts[0], first
    longest = max(part.order for part in parts)
    coefficients = np.concatenate([np.pad(p.coefficients, ((0, 0), (0, longest - p.order))) for p in parts])
    scale = np.sqrt(np.average([p.scale**2 for p in parts], axis=0, weights=[len(p.mix) for p in parts]))
    return Whitener(coefficients, np.asarray(block_diag(*(p.mix for p in parts))), scale), first


def log_likelihood(whitener: Whitener, segments: Sequence[Segments]) -> float:
    """Give the log-likelihood of the residuals that a whitener was fitted to, up to a constant.

    It depends on the innovations' covariance alone, as for any autoregression at its least squares.
    """
    order, m = whitener.order, len(whitener.mix)
    long = [with_bounds([(a, b) for a, b in run if b - a > 2 * order], run) for run in segments]
    n = np.array([counts(run, m, order) for run in long]).reshape(len(long), m)
    return float(n.sum(axis=0) @ np.log(np.diag(whitener.mix)) - n.sum(axis=1) @ np.log(whitener.scale))


def _aligned(channels: Sequence[Vector]) -> Vector:
    n = min(len(x) for x in channels)
    return np.array([x[:n] for x in channels])


def inside(run: Segments, n: int) -> np.ndarray:
    """Tell which of `n` samples are in segments, shape (n,)."""
    out = np.zeros(n, bool)
    for a, b in run:
        out[a:b] = True
    return out


def inside_of(bank: Vector, run: Segments) -> Vector:
    """Join the samples of segments, (..., n) -> (..., fewer)."""
    return np.concatenate([bank[..., a:b] for a, b in run] or [bank[..., :0]], axis=-1)


def put_back(rows: Vector, run: Segments, n: int) -> Vector:
    """Put samples of segments back where they were, zeros elsewhere."""
    out, first = np.zeros((*rows.shape[:-1], n)), 0
    for a, b in run:
        out[..., a:b] = rows[..., first : first + b - a]
        first += b - a
    return out


def quiet_segments(
    residuals: Sequence[Vector], segments: Sequence[Segments], length: int = 16, limit: float = 4.0
) -> list[Segments]:
    """Cut out of the segments what stands out by more than `limit` times the usual root mean square.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (n_channels, n_samples)
    segments : sequence of Segments
    length : int
        Of the blocks that are compared, in samples.
    limit : float

    Returns
    -------
    list of Segments
        The same where more than three tenths stand out, or less than that is left: then it is no exception.
    """
    out = []
    for e, run in zip(residuals, segments, strict=True):
        known = inside(run, e.shape[1])
        loud, live = np.zeros(e.shape[1], bool), live_in(run)
        for c, x in enumerate(e):
            own = known if live is None else known & live[c]
            centred, box = np.where(own, x - np.mean(x[own]) if own.any() else x, 0.0), np.ones(length) / length
            power = np.convolve(centred**2, box, mode="same")
            if live is not None:
                power = power / np.maximum(np.convolve(own, box, mode="same"), 1.0 / length)
            loud |= (power > limit**2 * np.median(power[own] if own.any() else power)) & own
        if loud.sum() > 0.3 * known.sum():
            out.append(run)
            continue
        kept = [(a, b) for a, b in stretches(known & ~loud) if b - a > 60]
        out.append(with_bounds(kept, run) if sum(b - a for a, b in kept) > 0.3 * known.sum() else run)
    return out


def log_p(statistic: float, k: int) -> float:
    """Give ln P(chi2_k > statistic), where scipy underflows too."""
    value = float(chi2.logsf(statistic, k))
    if np.isfinite(value):
        return value
    half = 0.5 * statistic
    return float(-half + (0.5 * k - 1) * np.log(half) - gammaln(0.5 * k))
