"""Reversals: an axis that stops before it turns back is held; friction goes from one side to the other meanwhile."""

from __future__ import annotations

import numpy as np
import pytest

from cdm_pin.reversing import reversing, stops

RATE, STEP = 200.0, 2 * np.pi / 2**14


def turning(stop: float, acceleration: float = 2.0, back: bool = True):
    """Give a position that is braked to a standstill at 1 s, stands for a time, and turns back or goes on."""
    t = np.arange(0.0, 2.0 + stop, 1.0 / RATE)
    before, after = np.minimum(t - 1.0, 0.0), np.maximum(t - 1.0 - stop, 0.0)
    x = -0.5 * acceleration * (before**2 + (1 if back else -1) * after**2)
    v = -acceleration * (before + (1 if back else -1) * after)
    return t, x, v


@pytest.mark.parametrize("stop", [0.1, 0.2, 0.28])
@pytest.mark.parametrize("seed", range(3))
def test_a_stop_is_found_with_its_ends(stop, seed):
    """As an encoder of 14 bits with noise tells it, to a hundredth of a second or two."""
    x = turning(stop)[1]
    seen = x + STEP / np.sqrt(12.0) * np.random.default_rng(seed).normal(size=len(x))
    (found,) = stops(seen, STEP / np.sqrt(12.0), RATE)
    assert np.array([found.begin, found.end]) / RATE == pytest.approx([1.0, 1.0 + stop], abs=0.03)
    assert found.way == 1.0


@pytest.mark.parametrize("acceleration", [0.2, 2.0, 20.0])
def test_passing_through_zero_is_no_stop(acceleration):
    """A position that turns at once is a parabola; its sign of velocity is that of the velocity."""
    _, x, v = turning(0.0, acceleration)
    assert not stops(x, STEP / np.sqrt(12.0), RATE)
    assert np.array_equal(reversing(x, v, 0.01, STEP / np.sqrt(12.0), RATE), np.tanh(v / 0.01))


def test_who_goes_on_does_not_turn():
    """A stop between two motions of one direction leaves the sign as it is."""
    _, x, v = turning(0.2, back=False)
    assert not stops(x, 1e-4, RATE)
    assert np.array_equal(reversing(x, v, 0.01, 1e-4, RATE), np.tanh(v / 0.01))


def test_a_rest_is_no_stop():
    """What stands for longer is not driven; nobody knows how friction goes from one side to the other."""
    _, x, v = turning(0.5)
    assert not stops(x, 1e-4, RATE)
    assert np.array_equal(reversing(x, v, 0.01, 1e-4, RATE), np.tanh(v / 0.01))


def test_friction_goes_over_evenly():
    """From one to minus one between the ends of the stop; the sign elsewhere, as it was."""
    t, x, v = turning(0.25)
    sign = reversing(x, v, 0.01, 1e-5, RATE)
    held = (t > 1.0) & (t < 1.25)
    assert sign[held] == pytest.approx(1.0 - 2.0 * (t[held] - 1.0) / 0.25, abs=0.05)
    assert np.all(sign[t < 0.95] == np.tanh(v / 0.01)[t < 0.95]) and np.all(sign[t > 1.3] == np.tanh(v / 0.01)[t > 1.3])


def test_nothing_that_does_not_move_stops():
    """A position that never changes has no stops, and neither has a recording of three samples."""
    assert stops(np.zeros(100), 0.0, RATE) == [] and stops(np.zeros(100), 1e-4, RATE) == []
    assert stops(np.array([0.0, 1.0, 0.0]), 1e-4, RATE) == []
