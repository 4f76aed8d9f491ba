"""Pure pieces of signal treatment: uniform grid, zero-phase filter, derivative, cut-off, noise floor, quantisation."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import correlate1d
from scipy.signal import butter, sosfiltfilt, stft, welch
from scipy.special import binom

POINTS = 9
"""Samples of which a derivative is taken."""
BARELY_WRITTEN = 0.05
"""Share of a step below which the last digit that is written does not hide it."""


def _stencils(points: int) -> np.ndarray:
    """Give what each sample weighs in the derivative, at each of them, of the polynomial through them all.

    Per step between samples, shape (points, points); barycentric formula, whose weights are binomial coefficients.
    """
    k = np.arange(points)
    weight = (-1.0) ** k * binom(points - 1, k)
    apart = k[:, None] - k + np.eye(points)
    stencils = weight / weight[:, None] / apart
    stencils[k, k] = 0.0
    stencils[k, k] = -stencils.sum(axis=1)
    return stencils


_STENCILS = _stencils(POINTS)


def resample_uniform(time: np.ndarray, x: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    r"""Carry samples over to a uniform grid, by a cubic spline; stretches without samples by a monotone one.

    The spline's error is :math:`O((\omega h)^4)` and does not depend on the filter that follows. A cubic spline swings
    where many samples are missing, so within 5 steps of a gap of more than 8 steps the monotone spline is used.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Strictly increasing stamps [s].
    x : ndarray, shape (n,) or (n, width)
    rate : float
        Of the grid [Hz], which starts at ``time[0]``.

    Returns
    -------
    grid : ndarray, shape (m,)
        Seconds.
    values : ndarray, shape (m,) or (m, width)
    """
    steps = max(int(np.floor((time[-1] - time[0]) * rate * (1 + 1e-12) + 1e-6)), 0)
    grid = time[0] + np.arange(steps + 1) / rate
    if len(time) < 4:
        flat = x.reshape(len(x), -1)
        values = np.column_stack([np.interp(grid, time, column) for column in flat.T])
        return grid, values.reshape(len(grid), *x.shape[1:])
    if len(grid) == len(time) and np.max(np.abs(grid - time)) < 1e-6 / rate:
        return grid, np.array(x, float)
    values = CubicSpline(time, x - x[0])(grid) + x[0]  # so that what rests does so to the last digit
    step = np.diff(time)
    typical = np.median(step)
    gaps = step > 8 * typical
    if gaps.any():
        near = np.zeros(len(grid), bool)
        for start, stop in zip(time[:-1][gaps], time[1:][gaps], strict=True):
            near |= (grid > start - 5 * typical) & (grid < stop + 5 * typical)
        with np.errstate(over="ignore"):  # a slope of next to nothing over which it divides is none
            values[near] = PchipInterpolator(time, x)(grid[near])
    return grid, values


def stretches(mask: np.ndarray) -> list[tuple[int, int]]:
    """List where a mask is true: (start, stop) of each stretch."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def lowpass(x: np.ndarray, rate: float, cutoff: float, order: int = 4) -> np.ndarray:
    """Filter forwards and backwards with a Butterworth low-pass: zero phase, gain 1/2 (-6 dB) at the cut-off.

    Ends are continued by odd reflection for longer than the filter rings, so a straight line stays one to its end; a
    cut-off at or above half the rate returns the samples as they are.

    Parameters
    ----------
    x : ndarray, shape (n,) or (n, width)
    rate : float
        Samples per second.
    cutoff : float
        Hz, of each of the two passes.
    order : int
        Of each pass.

    Returns
    -------
    ndarray
        Same shape as `x`.
    """
    if cutoff >= 0.5 * rate or len(x) < 4:
        return np.array(x, float)
    padding = min(len(x) - 1, int(np.ceil(2 * order * rate / cutoff)))
    sos = butter(order, cutoff / (0.5 * rate), output="sos")
    return sosfiltfilt(sos, x - x[0], axis=0, padlen=padding) + x[0]


def differentiate(x: np.ndarray, rate: float) -> np.ndarray:
    r"""Differentiate once, by the central difference of 8th order (9 points; one-sided at the ends).

    The relative error at frequency f is :math:`(2\pi f/rate)^8/630`: 3e-5 at a tenth of the rate. Filter first.

    Parameters
    ----------
    x : ndarray, shape (n,) or (n, width)
    rate : float
        Samples per second.

    Returns
    -------
    ndarray
        Same shape, per second; zeros for a single sample.
    """
    if len(x) < 2:
        return np.zeros_like(x, float)
    if len(x) < POINTS:
        return np.asarray(np.gradient(x, 1 / rate, axis=0, edge_order=2 if len(x) > 2 else 1))
    x, side, weights = np.asarray(x - x[0], float), POINTS // 2, _STENCILS * rate
    out = correlate1d(x, weights[side], axis=0)
    out[:side] = np.tensordot(weights[:side], x[:POINTS], 1)
    out[-side:] = np.tensordot(weights[-side:], x[-POINTS:], 1)
    return out


def window_length(n: int, most: float) -> int:
    """Give the longest segments, of so many samples at most, that reach to the end of `n` where they overlap by half.

    A spectrum of segments leaves out what does not fill one, and a motion may be quick at its end alone.
    """
    return int(n / (0.5 + 0.5 * max(np.ceil(2.0 * n / most - 1.0), 1.0)))


def spectrum(x: np.ndarray, rate: float, longest: int = 1 << 14) -> tuple[np.ndarray, np.ndarray]:
    r"""Give the power spectral density of a motion, whose lines are 1e10 times its noise.

    It is that of the second differences, under a Blackman-Harris window, divided by their gain
    :math:`(2\,rate\,\sin(\omega/2\,rate))^4`: so the noise is not buried under what strong slow lines leak.

    Parameters
    ----------
    x : ndarray, shape (n, width)
    rate : float
        Hz.
    longest : int
        Samples of a segment at most; segments overlap by half.

    Returns
    -------
    frequency : ndarray, shape (m,)
        Hz, above 0 and up to half the rate.
    density : ndarray, shape (m, width)
        Unit of x squared per Hz, one-sided.
    """
    curvature = np.diff(x, 2, axis=0)
    length = window_length(len(curvature), longest)
    frequency, density = welch(curvature, rate, window="blackmanharris", nperseg=length, axis=0)
    return frequency[1:], density[1:] / (2 * np.sin(np.pi * frequency[1:, None] / rate)) ** 4


def noise_density(frequency: np.ndarray, density: np.ndarray) -> np.ndarray:
    """Read the white-noise floor off the quiet upper part of spectra.

    The floor is the lowest of the medians over four bands between 0.3 and 0.74 of the highest frequency, so that a
    resonance or a controller's ripple in one of them does not count as noise; above that, resampling leaves little.

    Returns
    -------
    ndarray, shape (width,)
        Unit squared per Hz, one-sided.
    """
    top = frequency[-1]
    bands = [(frequency > lo * top) & (frequency <= (lo + 0.14) * top) for lo in (0.3, 0.4, 0.5, 0.6)]
    floors = [np.median(density[band], axis=0) for band in bands if band.any()]
    return np.min(floors, axis=0) / np.log(2) if floors else np.zeros(density.shape[1])


def _rounded_density(
    frequency: np.ndarray, density: np.ndarray, x: np.ndarray, rate: float, steps: np.ndarray | None
) -> np.ndarray:
    """Read the floor off spectra, never below what rounding to the steps makes, step / sqrt(12) over the full band."""
    steps = quantisation_steps(x) if steps is None else steps
    return np.maximum(noise_density(frequency, density), rounding_std(steps, rate) ** 2 / (0.5 * rate))


def choose_cutoff(
    x: np.ndarray, rate: float, derivative: int = 2, order: int = 4, steps: np.ndarray | None = None
) -> float:
    r"""Choose the low-pass cut-off for positions from where their spectra sink into their noise.

    With density P, noise N and the gain H of `lowpass` at a cut-off, the error of the derivative of order d is

    .. math:: J_j = \int \omega^{2d} \left[ (P_j - N_j) (1 - H)^2 + N_j H^2 \right] df.

    The sum over positions of J, each in units of its own least, is least near where the spectra meet their noise; the
    cut-off is the highest that comes within a tenth of that. Errors of 1e-5 of a derivative count as none.

    Parameters
    ----------
    x : ndarray, shape (n, width)
        Positions on a uniform grid.
    rate : float
        Hz.
    derivative : int
        The derivative whose error is to be least: 2, accelerations.
    order : int
        Of each of the two passes.
    steps : ndarray, shape (width,), optional
        In which they were logged; default those of `x`. What rounds to them is noise even where it repeats exactly.

    Returns
    -------
    float
        Hz, at most 0.4 of the rate; that much where nothing moves or there is no noise.
    """
    highest = 0.4 * rate
    if len(x) < 32:
        return highest
    frequency, density = spectrum(x, rate)
    noise = _rounded_density(frequency, density, x, rate, steps)
    moving = moves(x, rate)
    if not moving.any():
        return highest
    weight = (2 * np.pi * frequency[:, None]) ** (2 * derivative)
    density, noise = density[:, moving], noise[moving]
    rises = frequency[:, None] <= _meeting(x[:, moving], rate, noise)
    signal, noise = weight * np.where(rises, density - noise, 0.0), weight * noise
    candidates = np.geomspace(min(4 * rate / len(x), highest), highest, 80)
    errors, kept = np.empty((2, len(candidates), moving.sum()))
    for k, cutoff in enumerate(candidates):
        gain = 1 / (1 + (frequency[:, None] / cutoff) ** (2 * order))
        errors[k] = np.sum(signal * (1 - gain) ** 2 + noise * gain**2, axis=0)
        kept[k] = np.sum(signal * gain**2, axis=0)
    best = np.argmin(errors, axis=0)[None]
    negligible = 1e-10 * np.abs(np.take_along_axis(kept, best, axis=0)) + 1e-300
    least = np.maximum(np.take_along_axis(errors, best, axis=0), negligible)
    total = np.sum(np.maximum(errors / least, 1.0), axis=1)
    return float(candidates[np.flatnonzero(total <= 1.1 * total.min())[-1]])


def _meeting(x: np.ndarray, rate: float, noise: np.ndarray) -> np.ndarray:
    """Give where spectra meet their noise: the first frequency above the peak with mere noise up to an octave on.

    Returns
    -------
    ndarray, shape (width,)
        Hz.
    """
    frequency, density = spectrum(x, rate, max(len(x) // 8, 32))
    peak = np.argmax(frequency[:, None] ** 2 * density, axis=0)
    below = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(density, axis=0)])
    start = np.arange(len(frequency))
    stop = np.minimum(2 * start + 3, len(frequency))
    octave = (below[stop] - below[start]) / (stop - start)[:, None]
    quiet = (octave < 1.5 * noise) & (start[:, None] > peak)
    return np.where(quiet.any(axis=0), frequency[np.argmax(quiet, axis=0)], frequency[-1])


def torque_bandwidth(positions: np.ndarray, torque: np.ndarray, rate: float, longest: int = 1 << 17) -> float | None:
    r"""Find the frequency up to which torques follow the motion.

    With the multiple coherence :math:`\gamma_j^2` between torque j and the accelerations and directions of motion of
    all joints, the motion explains more of the torque's power than it leaves where :math:`\gamma_j^2 > 1/2`. Each
    torque's limit is the first frequency from which on this fails over a third of an octave. The limit of all is never
    below 3 times the frequency under which lies 99 % of the velocities' power: friction has overtones.

    Parameters
    ----------
    positions : ndarray, shape (n, width)
        On a uniform grid.
    torque : ndarray, shape (n, width_2)
    rate : float
        Hz.
    longest : int
        Samples looked at, from the middle of the record.

    Returns
    -------
    float or None
        Of the torques that follow at all, a third have a lower limit [Hz]; None where the record is too short, or the
        torques are noiseless: then nothing is gained by a limit.
    """
    middle = slice(max(len(positions) - longest, 0) // 2, (len(positions) + longest) // 2)
    positions, torque = positions[middle], torque[middle]
    moving = positions[:, moves(positions, rate)]
    noisy = _white_std(torque, rate) > 1e-3 * torque.std(axis=0)
    inputs = 2 * moving.shape[1]
    segment = int(min(2 * rate, len(positions) / (1.5 * max(inputs, 1))))
    if not inputs or not noisy.any() or segment < 16:
        return None
    v = differentiate(lowpass(moving, rate, 0.2 * rate), rate)
    direction = np.tanh(v / (0.05 * v.std(axis=0)))
    cut = {"nperseg": segment, "noverlap": segment // 2, "boundary": None, "padded": False, "axis": 0}
    frequency, _, spectra = stft(np.hstack([differentiate(v, rate), direction]), rate, **cut)
    _, _, out = stft(torque[:, noisy] - torque[:, noisy].mean(axis=0), rate, **cut)
    gain = np.zeros((len(frequency), noisy.sum()))
    for k in range(1, len(frequency)):
        A, b = spectra[k].T, out[k].T
        rest = b - A @ np.linalg.lstsq(A, b, rcond=1e-6)[0]
        power = np.sum(np.abs(b) ** 2, axis=0)
        gain[k] = 1 - 2 * np.sum(np.abs(rest) ** 2, axis=0) / power * len(A) / (len(A) - inputs)
    limits = [_first_failure(frequency, column) for column in gain.T]
    following = [limit for limit in limits if limit > 0]
    lower = float(np.quantile(following, 1 / 3, method="lower")) if following else 0.0
    return max(lower, 3 * _motion_bandwidth(moving, rate)) if following else None


def _motion_bandwidth(x: np.ndarray, rate: float, share: float = 0.99) -> float:
    """Give the frequency [Hz] under which lies this share of a velocity's power: the least over the columns."""
    frequency, density = spectrum(x, rate)
    speed = np.cumsum(frequency[:, None] ** 2 * density * (frequency[:, None] < 0.1 * rate), axis=0)
    return float(np.min(frequency[np.argmax(speed > share * speed[-1], axis=0)]))


def _first_failure(frequency: np.ndarray, gain: np.ndarray) -> float:
    """Give the first frequency, after the first good one, from which `gain` is negative over a third of an octave."""
    good = np.flatnonzero(gain > 0)
    for k in range(good[0] if len(good) else len(gain), len(gain)):
        if np.mean(gain[k : k + max(3, k // 4)]) < 0:
            return float(frequency[k])
    return float(frequency[-1]) if len(good) else 0.0


def moves(x: np.ndarray, rate: float) -> np.ndarray:
    """Tell which positions move: by more than their noise and more than a hundredth of what the largest does.

    Returns
    -------
    ndarray of bool, shape (width,)
    """
    if len(x) < 16:
        return np.ptp(x, axis=0) > 0
    span = np.ptp(x, axis=0)
    return (span > 10 * _white_std(x, rate)) & (span > 0.01 * span.max())


def velocity_cutoff(x: np.ndarray, rate: float, noise: float = 0.01, steps: np.ndarray | None = None) -> float:
    """Choose the widest low-pass that keeps the noise of velocities below a share `noise` of their rms.

    Parameters
    ----------
    x : ndarray, shape (n, width)
        Positions on a uniform grid.
    rate : float
        Hz.
    steps : ndarray, shape (width,), optional
        In which they were logged; default those of `x`.

    Returns
    -------
    float
        Hz, at most 0.4 of the rate; the median over the positions that move.
    """
    if len(x) < 32:
        return 0.4 * rate
    frequency, density = spectrum(x, rate)
    floor = _rounded_density(frequency, density, x, rate, steps)
    speed = (2 * np.pi * frequency[:, None]) ** 2 * np.maximum(density - floor, 0)
    power = np.asarray(np.trapezoid(speed, frequency, axis=0))
    moving = moves(x, rate)
    if not moving.any():
        return 0.4 * rate
    limits = np.cbrt(3 * noise**2 * power[moving] / ((2 * np.pi) ** 2 * np.maximum(floor[moving], 1e-300)))
    return float(min(np.median(limits), 0.4 * rate))


def noise_floor(x: np.ndarray, rate: float, cutoff: float | None = None, steps: np.ndarray | None = None) -> np.ndarray:
    """Estimate the standard deviation of each column's noise without a model, from its quiet upper spectrum.

    Parameters
    ----------
    x : ndarray, shape (n, width)
        As logged, on a uniform grid.
    rate : float
        Hz.
    cutoff : float, optional
        Count only the noise below this frequency [Hz]; default all of it.
    steps : ndarray, shape (width,), optional
        In which the columns were logged; default those of `x`, which has none where it was interpolated.

    Returns
    -------
    ndarray, shape (width,)
        Never below what the quantisation step alone makes, step / sqrt(12) over the full band.
    """
    if len(x) < 16:
        return np.zeros(x.shape[1])
    steps = quantisation_steps(x) if steps is None else steps
    return np.maximum(band_share(rate, cutoff) * _white_std(x, rate), rounding_std(steps, rate, cutoff))


def rounding_std(steps: np.ndarray, rate: float, cutoff: float | None = None) -> np.ndarray:
    """Give the standard deviation of what rounding to steps makes below a frequency, step / sqrt(12) in all."""
    return band_share(rate, cutoff) * steps / np.sqrt(12)


def band_share(rate: float, cutoff: float | None = None) -> float:
    """Give the share of white noise (of its standard deviation) that lies below a frequency; default all of it."""
    return 1.0 if cutoff is None else float(np.sqrt(min(cutoff / (0.5 * rate), 1.0)))


def quantisation_steps(x: np.ndarray) -> np.ndarray:
    """Give the `quantisation_step` of every column, shape (width,)."""
    return np.array([quantisation_step(column) for column in x.T])


def _white_std(x: np.ndarray, rate: float) -> np.ndarray:
    if len(x) < 16:
        return np.zeros(x.shape[1])
    return np.sqrt(noise_density(*spectrum(x, rate)) * 0.5 * rate)


def quantisation_step(x: np.ndarray, tolerance: float = 1e-3) -> float:
    """Find the step of which all values of a column are multiples, up to an offset; 0 if there is none.

    Parameters
    ----------
    x : ndarray, shape (n,)
        As logged (an interpolated column has no step).
    tolerance : float
        How far from a multiple a difference may be, in steps.

    Returns
    -------
    float
        In the unit of x: an encoder's 2*pi / 2**bits, a converter's least torque.
    """
    levels = np.unique(x)
    if len(levels) < 3:
        return 0.0
    differences = np.diff(levels)
    resolution = 64 * np.finfo(float).eps * max(np.abs(levels).max(), 1e-300)
    differences = differences[differences > resolution]
    if len(differences) < 2:
        return 0.0
    step = float(np.min(differences))
    if step < 1e3 * resolution:
        return 0.0
    near = differences[differences < 50 * step]
    step = float(np.sum(near) / np.sum(np.round(near / step)))
    off = np.abs(differences / step - np.round(differences / step))
    written = _last_digit(levels) / step
    written = 1.01 * written if written < BARELY_WRITTEN else 0.0  # two numbers were rounded by half a digit each
    return step if np.mean(off < max(tolerance, resolution / step, written)) > 0.99 else 0.0


def _last_digit(x: np.ndarray) -> float:
    """Give the last digit that numbers were written with; zero where they have as many as a double.

    As many digits after the point in each, or as many from the first one, of which those of the largest count.
    """
    most = np.abs(x).max()
    first = np.floor(np.log10(np.maximum(np.abs(x), 1e-300)))
    for digits in range(13):
        if np.all(np.abs(x - np.round(x, digits)) < 1e-9 * 10.0**-digits + 1e-15 * np.abs(x)):
            return 10.0**-digits
        unit = 10.0 ** (first - digits)
        if np.all(np.abs(x / unit - np.round(x / unit)) < 1e-6):
            return float(10.0 ** (np.floor(np.log10(most)) - digits))
    return 0.0
