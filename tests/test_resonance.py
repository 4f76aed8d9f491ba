"""Torques that answer the motion like something on an axis that swings."""

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lsim
from trials import search_of

from cdm_pin.diagnose import diagnose
from cdm_pin.dynamics import motor_torques
from cdm_pin.model import load_model
from cdm_pin.recording import Recording
from cdm_pin.resonance import resonance, swing
from cdm_pin.spectra import Spectrum, steepness, wandering
from cdm_pin.unexplained import STEEP

ARM = load_model(Path(__file__).resolve().parent.parent / "urdf" / "planar3.yaml")


def swung(t, u, frequency, damping):
    """Solve x'' + 2 d w x' + w^2 x = -u for u linear between samples; shape (2, n): w^2 x and w x'."""
    w = 2.0 * np.pi * frequency
    system = ([[0.0, 1.0], [-(w**2), -2.0 * damping * w]], [[0.0], [-1.0]], [[w**2, 0.0], [0.0, w]], [[0.0], [0.0]])
    return lsim(system, u, t)[1].T


def test_the_swing_is_that_of_its_equation():
    t = np.arange(0.0, 20.0, 0.01)
    u = np.sin(2.0 * np.pi * 0.7 * t) + 0.5 * np.sin(2.0 * np.pi * 2.9 * t)
    for frequency, damping in ((2.8, 0.03), (0.6, 0.3), (6.0, 0.1)):
        own, known = swing(u, 100.0, frequency, damping), swung(t, u, frequency, damping)
        assert np.abs(own - known).max() < 1e-6 * np.abs(known).max()


def recording(seed, share):
    """One minute through random points; something hangs on link 2 that brings a share of the torque of motor 2."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 60.0, 0.005)
    knots = np.arange(0.0, 61.0, 0.6)
    way = CubicSpline(knots, rng.uniform(-0.4, 0.4, (len(knots), 3)))
    q, v, a = (way(t, k) for k in range(3))
    torque = motor_torques(ARM, q, v, a)
    x = swung(t, a[:, 0] + a[:, 1], 1.9, 0.05)[0]
    torque[:, 1] += share * torque[:, 1].std() * x / x.std()
    torque += 0.01 * torque.std(axis=0) * rng.standard_normal(q.shape)
    return Recording(t, {"joint_position": q, "motor_torque": torque}, label=f"made{seed}")


@pytest.mark.parametrize("count", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_a_mass_on_a_spring_is_heard_with_its_frequency(count):
    """Its torque is no function of the state, and an autoregression takes it for coloured noise."""
    runs = [recording(seed, 0.1) for seed in range(count)]
    content = diagnose(ARM, runs[:1], runs[1:]).content
    assert content["verdict"] == "unexplained" and not content["findings"]
    assert content["unexplained"]["location"] == {"kind": "motor", "index": 2}
    assert "swings at 1.9" in content["unexplained"]["region"]


def test_most_of_an_error_is_asked_of_what_swings_and_of_nothing_else():
    """Also where nothing of it is in the model yet; noise alone is no swing."""
    search, still = (search_of(ARM, recording(0, share)) for share in (0.1, 0.0))
    law, torque = resonance([search], search.fit([]), np.zeros(3))
    assert law.location == {"kind": "motor", "index": 2}
    assert law.shape[0] == pytest.approx(1.9, rel=0.02)
    assert 0.02 < torque < 0.2
    assert resonance([search], search.fit([]), np.full(3, 1.0)) is None
    assert resonance([still], still.fit([]), np.zeros(3)) is None


@pytest.mark.parametrize(("correlation", "steep"), [(0.97, False), (1.0, True)])
def test_noise_that_forgets_within_a_second_is_not_steep(correlation, steep):
    """Both have far more slow power than usual; the slow power of a walk goes on rising."""
    f = (np.arange(40) + 0.5) * 0.4 / 200.0  # cycles per sample of 200 Hz, up to 16 Hz
    power = 1.0 / np.abs(1.0 - correlation * np.exp(-2j * np.pi * f)) ** 2
    noise = Spectrum(f, power[None] / power[-1], np.full((1, 40), 24.0), np.full(40, 1.0 / 40.0))
    assert wandering(noise)[0] > 50.0
    assert (steepness(noise)[0] > STEEP) == steep
