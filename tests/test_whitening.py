"""Whitening, its care about what is not noise, and tails that do not underflow."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

from cdm_pin.whitening import Lines, fit_quiet, fit_whitener, log_likelihood, log_p, quiet_segments


def coloured(rng, n, channels=2):
    e = rng.normal(size=(channels, n))
    e[1] = 0.6 * e[0] + 0.8 * e[1]
    return lfilter([1.0], [1.0, -1.2, 0.5], e, axis=1) * np.array([[0.1], [3.0]])[:channels]


def test_whitened_noise_is_white():
    """Autoregressive noise correlated over channels becomes unit white noise."""
    rng = np.random.default_rng(0)
    x = coloured(rng, 6000)
    segments = [[(0, 3000), (3100, 6000)]]
    white = fit_whitener([x], segments, 12)(x[None], segments[0])[0]
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.03)
    rows = fit_whitener([x], segments, 12)(x[None], [(0, 3000)]).reshape(2, -1)
    assert abs(np.corrcoef(rows)[0, 1]) < 0.05
    for row in rows:
        assert abs(np.corrcoef(row[1:], row[:-1])[0, 1]) < 0.05


def test_the_likelihood_is_that_of_gaussian_innovations():
    """Differences between two sets of residuals are those of the normal densities of what each leaves white."""
    rng, segments = np.random.default_rng(4), [[(0, 3000)], [(0, 2000)]]
    values, expected = [], []
    for factor in (1.0, 1.7):
        runs = [coloured(rng, 3000), factor * coloured(rng, 2000)]
        whitener = fit_whitener(runs, segments, 8)
        values.append(log_likelihood(whitener, segments))
        total = 0.0
        for r, x in enumerate(runs):
            rows = whitener((x - x.mean(axis=1, keepdims=True))[None], segments[r], r)[0]
            n = rows.size // 2
            root = whitener.mix / whitener.scale[r]
            total += n * np.log(np.abs(np.linalg.det(root))) - 0.5 * float(rows @ rows)
        expected.append(total)
    assert values[0] - values[1] == pytest.approx(expected[0] - expected[1], rel=2e-3)


def test_a_constant_is_not_noise():
    """An offset that is still unexplained leaves the whitener as it is without it."""
    rng = np.random.default_rng(1)
    x, segments = coloured(rng, 4000), [[(0, 4000)]]
    a = fit_whitener([x], segments, 8).coefficients
    b = fit_whitener([x + 50.0], segments, 8).coefficients
    assert np.allclose(a, b)


def test_quiet_segments_leave_a_push_out():
    """A push that stands out is cut from the segments; nothing is cut from plain noise."""
    rng = np.random.default_rng(2)
    x, segments = rng.normal(size=(2, 3000)), [[(0, 3000)]]
    assert quiet_segments([x], segments) == [[(0, 3000)]]
    x[0, 1000:1200] += 30.0
    (quiet,) = quiet_segments([x], segments)
    assert all(not (a < 1190 and b > 1010) for a, b in quiet)
    assert sum(b - a for a, b in quiet) > 2600


def test_tails_do_not_underflow():
    """The logarithm of the tail is scipy's where that is finite, and falls on where it is not."""
    for k in (1, 2, 5):
        assert log_p(40.0, k) == pytest.approx(chi2.logsf(40.0, k))
        far = [log_p(x, k) for x in (2e3, 1e4, 1e6)]
        assert far == sorted(far, reverse=True)
        assert np.isfinite(far).all()
        assert log_p(2e3, k) == pytest.approx(-1e3, rel=0.02)


def test_lines_are_taken_in_any_order():
    bank = np.random.default_rng(4).normal(size=(5, 2, 8))
    bank[[1, 4], 0] = 0.0
    part = Lines.of(bank).part([slice(3, 5), slice(0, 1)])
    np.testing.assert_array_equal(part.dense(), bank[[3, 4, 0]])


def test_bursts_of_one_kind_of_channel_leave_the_others_alone():
    """Rounding at rest stands out in the travel; the noise of torques is estimated from all samples all the same."""
    rng = np.random.default_rng(3)
    x, segments, blocks = rng.standard_normal((2, 400)), [[(0, 400)]], [slice(0, 1), slice(1, 2)]
    x[1, 100:200] *= 30.0
    both, quiet = fit_quiet([x], segments, 4, blocks)
    assert quiet == segments
    alone = fit_whitener([x[:1]], segments, 4)
    assert np.array_equal(both.coefficients[:1], alone.coefficients)
    assert both.mix[0, 0] == alone.mix[0, 0] and both.mix[1, 0] == 0.0
    assert both.mix[1, 1] == pytest.approx(1.0, rel=0.15)  # as if there were no burst


def test_white_noise_beside_another_is_that_of_the_sum():
    """An autoregression with white noise added is whitened as one that was fitted to the sum of both."""
    rng = np.random.default_rng(5)
    n, level = 100_000, np.array([2.0, 1.0])
    steps = rng.normal(size=(2, n))
    slow = lfilter([1.0], [1.0, -0.95], steps[0]), lfilter([1.0], [1.0, -0.5], steps[1] + 0.5 * steps[0])
    own = fit_whitener([np.array(slow)], [[(0, n)]], 12)
    both = own.with_white(level)
    fitted = fit_whitener([np.array(slow) + level[:, None] * rng.normal(size=(2, n))], [[(0, n)]], 12)
    np.testing.assert_allclose(both.coefficients, fitted.coefficients, atol=0.02)
    np.testing.assert_allclose(both.mix, fitted.mix, atol=0.02)
    np.testing.assert_allclose(own.with_white(np.zeros(2)).coefficients, own.coefficients, atol=0.02)
