"""Periodic trajectories: find the period, average periods, and read the noise off what differs between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.interpolate import CubicSpline
from scipy.stats import chi2


@dataclass(frozen=True)
class Periods:
    """Signals averaged over periods.

    Attributes
    ----------
    time : ndarray, shape (m,)
        One period [s], from 0.
    period : float
        [s].
    channels : dict of str to ndarray, shape (m, width)
        Mean over the periods that are valid at each phase.
    count : ndarray of int, shape (m,)
        Periods behind each mean; 0 where there is none (the mean is NaN there).
    covariance : dict of str to ndarray, shape (width, width)
        Between periods, of one sample (that of the mean is smaller by the count), pooled over phases.
    deviation : dict of str to ndarray, shape (width,)
        Its standard deviation as the median phase has it: blind to stretches where the motion did not repeat.
    """

    time: np.ndarray
    period: float
    channels: dict[str, np.ndarray]
    count: np.ndarray
    covariance: dict[str, np.ndarray]
    deviation: dict[str, np.ndarray]


def estimate_period(x: np.ndarray, rate: float, tolerance: float = 0.01) -> float | None:
    r"""Find the period after which all columns repeat, or None.

    The mismatch at lag T, :math:`\langle (x(t+T) - x(t))^2 \rangle / 2\sigma^2`, averaged over moving columns, is 0 for
    a periodic motion and 1 for one that forgets. The smallest lag is taken whose mismatch is below `tolerance` and
    within a factor of 3 of the least one; a parabola gives the fraction of a sample.

    Parameters
    ----------
    x : ndarray, shape (n, width)
        Filtered positions on a uniform grid.
    rate : float
        Hz.
    tolerance : float
        Largest mismatch, a ratio of variances.

    Returns
    -------
    float or None
        Seconds; at least 1.3 periods must have been recorded.
    """
    x = x[:, np.ptp(x, axis=0) > 1e-9 * (1 + np.abs(x).max(axis=0))]
    longest = int(len(x) / 1.3)
    if x.shape[1] == 0 or longest < 16:
        return None
    mismatch = _mismatch((x - x.mean(axis=0)) / x.std(axis=0), longest)
    risen = np.flatnonzero(mismatch > 0.3)
    if not len(risen):
        return None
    inner = np.arange(max(risen[0], 1), longest - 1)
    dips = inner[(mismatch[inner] <= mismatch[inner - 1]) & (mismatch[inner] < mismatch[inner + 1])]
    left, middle, right = mismatch[dips - 1], mismatch[dips], mismatch[dips + 1]
    bend = np.maximum(left - 2 * middle + right, 1e-300)
    lags, bottoms = dips + 0.5 * (left - right) / bend, np.maximum(middle - (left - right) ** 2 / (8 * bend), 0.0)
    lags, bottoms = lags[bottoms < tolerance], bottoms[bottoms < tolerance]
    return float(lags[bottoms <= 3 * bottoms.min() + 1e-9][0]) / rate if len(lags) else None


def _mismatch(x: np.ndarray, longest: int) -> np.ndarray:
    """Mean squared difference over lags 0 .. longest - 1, over twice the variance, by one transform per column."""
    n = len(x)
    size = next_fast_len(2 * n)
    product = np.asarray(irfft(np.sum(np.abs(np.asarray(rfft(x, size, axis=0))) ** 2, axis=1), size))[:longest]
    power = np.concatenate([[0.0], np.cumsum(np.sum(x**2, axis=1))])
    lags = np.arange(longest)
    both = power[n - lags] + power[n] - power[lags]
    return np.maximum(both - 2 * product, 0.0) / (2 * (n - lags) * x.shape[1])


def average_channels(
    time: np.ndarray, channels: dict[str, np.ndarray], valid: np.ndarray, period: float, rate: float
) -> Periods:
    """Cut uniform signals into periods, lay them over each other by a cubic spline, and average.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Uniform [s].
    channels : dict of str to ndarray, shape (n, width)
    valid : ndarray of bool, shape (n,)
        Samples that may be used.
    period, rate : float
        [s], [Hz]; the period need not be a whole number of samples.
    """
    m = max(round(period * rate), 1)
    phase = np.arange(m) * period / m
    turns = int(np.ceil((time[-1] - time[0]) / period))
    when = time[0] + phase + period * np.arange(turns)[:, None]
    near = np.clip(np.round((when - time[0]) * rate).astype(int), 0, len(time) - 1)
    used = (when <= time[-1]) & valid[near]
    count = used.sum(axis=0)
    freedom = max(np.sum(np.maximum(count - 1, 0)), 1)
    usual = max(int(np.median(count)) - 1, 1)
    phases = np.flatnonzero(count == usual + 1)
    mean, covariance, deviation = {}, {}, {}
    for name, x in channels.items():
        laid = np.where(used[..., None], CubicSpline(time, x)(np.minimum(when, time[-1])), 0.0)
        with np.errstate(invalid="ignore"):
            mean[name] = laid.sum(axis=0) / count[:, None]
        rest = np.where(used[..., None], laid - np.nan_to_num(mean[name]), 0.0)
        variance = np.sum(rest[:, phases] ** 2, axis=0) / usual
        median = np.median(variance, axis=0) if len(phases) else np.zeros(x.shape[1])
        deviation[name] = np.sqrt(median * usual / chi2.ppf(0.5, usual))
        rest = rest.reshape(-1, x.shape[1])
        covariance[name] = rest.T @ rest / freedom
    return Periods(phase, period, mean, count, covariance, deviation)
