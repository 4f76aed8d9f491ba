"""Fits from moments alone: against plain linear algebra, and their uncertainties against simulation."""

import numpy as np
import pytest
from scipy.signal import lfilter

from cdm_pin import estimators
from cdm_pin.errors import ShapeError
from cdm_pin.estimators import Colour, Moments

NAMES = ("a", "b", "c", "d")
PRESENT = np.array([[True, True, True, True], [False, False, True, True]])
TRUTH = np.array([1.0, -2.0, 0.5, 3.0])


def samples(n: int, seed: int, noise: np.ndarray | None = None):
    """X of two motors, the second without parameters a and b, and y = X TRUTH + noise."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, 2, 4)) * PRESENT
    return X, X @ TRUTH + (rng.normal(size=(n, 2)) @ noise.T if noise is not None else 0.0)


def moments_of(X, y, cuts=(0,)):
    """Moments gathered in pieces."""
    parts = [
        Moments.empty(NAMES, PRESENT).add(x, t)
        for x, t in zip(np.split(X, cuts[1:]), np.split(y, cuts[1:]), strict=True)
    ]
    for part in parts[1:]:
        parts[0] = parts[0].merge(part)
    return parts[0]


def test_fits_are_those_of_the_full_matrices():
    """Ordinary, weighted and per-motor fits equal numpy's on the stacked matrix; pieces make no difference."""
    noise = np.array([[0.1, 0.0], [0.3, 0.05]])
    X, y = samples(500, 0, noise)
    moments = moments_of(X, y, (0, 3, 170))
    stacked = np.linalg.lstsq(X.reshape(-1, 4), y.ravel(), rcond=None)[0]
    np.testing.assert_allclose(estimators.ordinary(moments).values, stacked, rtol=1e-11)
    fit = estimators.weighted(moments)
    white = np.linalg.inv(np.linalg.cholesky(fit.noise_covariance))
    A, b = np.einsum("ij,njp->nip", white, X).reshape(-1, 4), (y @ white.T).ravel()
    np.testing.assert_allclose(fit.values, np.linalg.lstsq(A, b, rcond=None)[0], rtol=1e-6)
    residual = y - X @ fit.values
    np.testing.assert_allclose(fit.noise_covariance, residual.T @ residual / 500, rtol=1e-8)
    first, second = estimators.per_joint(moments)
    np.testing.assert_allclose(first.values, np.linalg.pinv(X[:, 0]) @ y[:, 0], rtol=1e-10)
    np.testing.assert_allclose(second.values, np.linalg.pinv(X[:, 1, 2:]) @ y[:, 1], rtol=1e-10)
    assert second.names == ("c", "d")


def test_the_weights_buy_accuracy():
    """With noise shared by the motors the weighted fit is several times better than the ordinary one."""
    noise = np.array([[1.0, 0.0], [0.97, 0.05]])
    errors = []
    for seed in range(40):
        moments = moments_of(*samples(200, seed, noise))
        errors.append([f(moments).values - TRUTH for f in (estimators.ordinary, estimators.weighted)])
    plain, weighted = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(weighted < 0.5 * plain)


def test_noise_free_torques_are_solved_exactly():
    """No noise, no division by it."""
    fit = estimators.weighted(moments_of(*samples(50, 1)))
    np.testing.assert_allclose(fit.values, TRUTH, rtol=1e-12)


def test_selecting_columns_is_fitting_without_them():
    """Moments of a part of the columns, in another order, are those of that part."""
    X, y = samples(100, 2, 0.1 * np.eye(2))
    part = moments_of(X, y).select([3, 0])
    assert part.names == ("d", "a") and part.present.tolist() == [[True, True], [True, False]]
    expected = np.linalg.lstsq(X[:, :, [3, 0]].reshape(-1, 2), y.ravel(), rcond=None)[0]
    np.testing.assert_allclose(estimators.ordinary(part).values, expected, rtol=1e-10)


def test_shapes_are_checked():
    """Rows of another robot are refused."""
    with pytest.raises(ShapeError, match=r"X has shape \(5, 3, 4\)"):
        Moments.empty(NAMES, PRESENT).add(np.zeros((5, 3, 4)), np.zeros((5, 3)))


def test_burg_finds_a_process():
    """Coefficients of an autoregression from two pieces of it, and a stable filter."""
    rng = np.random.default_rng(0)
    x = lfilter([0.5], [1.0, -1.6, 0.8], rng.normal(size=20000))
    a, scale = estimators.autoregression([x[:8000], x[8000:]], 20)
    np.testing.assert_allclose(a[:2], [1.6, -0.8], atol=0.05)
    assert scale == pytest.approx(0.5, rel=0.03)
    assert np.all(np.abs(np.roots([1.0, *-a])) < 1)


def test_colour_is_the_covariance_of_the_noise():
    """Filtering the columns gives X' Omega X of an autoregressive noise, in pieces or at once."""
    rng = np.random.default_rng(1)
    n, phi, scale = 3000, 0.7, 0.3
    X = np.column_stack([np.sin(np.arange(n) / 40), rng.normal(size=n)])
    lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    expected = X.T @ (scale**2 / (1 - phi**2) * phi**lag) @ X
    colour = Colour(np.array([phi]), scale, 2)
    for part in np.split(X, [10, 1000]):
        colour.add(part)
    np.testing.assert_allclose(np.diag(colour.total), np.diag(expected), rtol=0.02)
    whole = Colour(np.array([phi]), scale, 2)
    whole.add(X)
    np.testing.assert_allclose(colour.total, whole.total)


def test_noise_in_the_columns_is_undone():
    """Errors in variables: plain least squares shrinks, the corrected values do not; their share of noise is told."""
    rng = np.random.default_rng(3)
    X = rng.normal(size=(200_000, 3)) @ np.array([[1.0, 0.4, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.3]])
    sigma, truth = np.array([0.3, 0.1, 0.3]), np.array([1.0, -2.0, 0.5])
    noisy = X + sigma * rng.normal(size=X.shape)
    information = noisy.T @ noisy
    plain = np.linalg.solve(information, noisy.T @ X @ truth)
    correction, share = estimators.attenuation(information, len(X) * np.diag(sigma**2))
    assert np.abs(plain - truth).max() > 0.1
    np.testing.assert_allclose(correction @ plain, truth, atol=0.01)
    assert share[2] == pytest.approx(0.5, abs=0.01) and share[1] < 0.05
