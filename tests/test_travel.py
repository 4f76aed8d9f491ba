"""Travel between motors and joints: which laws of a cable it has, and which parameters these may have."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from trials import search_of, two_tones

from cdm_pin.bank import all_candidates
from cdm_pin.diagnose import diagnose
from cdm_pin.dynamics import motor_torques
from cdm_pin.endogenous import follows_noise, without_followers
from cdm_pin.explanation import explained
from cdm_pin.model import load_model
from cdm_pin.recording import Recording


def behind(seed, travel, duration=40.0):
    """Record two links and their motors, of which the second is ahead by a function of its torque [rad]."""
    model = load_model("urdf/cdm2.yaml")
    t = np.arange(0.0, duration, 0.005)
    rng = np.random.default_rng(seed)
    w, phase = np.array([1.3, 1.9]), rng.uniform(0, 6, (2, 2))
    q, v, a = two_tones(t, w, phase)
    torque, ahead = motor_torques(model, q, v, a), np.zeros_like(q)
    ahead[:, 1] = travel(torque[:, 1] / torque[:, 1].std()) / model.arm_scale[1]
    noise = [x * rng.standard_normal(q.shape) for x in (1e-5, 1e-5, 0.003 * torque.std(axis=0))]
    channels = [q, model.motor_position(q) + ahead, torque]
    names = ("joint_position", "motor_position", "motor_torque")
    return model, Recording(t, {k: x + e for k, x, e in zip(names, channels, noise, strict=True)}, label=f"made {seed}")


def test_a_law_with_parameters_that_none_has_is_another():
    """A cable that hardens: soft about zero, it looks like play, and like a spring that gives before it is pulled."""
    (model, run), (_, unseen) = (behind(k, lambda x: 0.02 * np.cbrt(x)) for k in (1, 2))
    content = diagnose(model, [run], [unseen]).content
    assert content["verdict"] == "unexplained" and not content["findings"]
    assert content["unexplained"]["location"]["index"] == 2


@pytest.mark.parametrize("gap", [0.0, 0.01])
def test_a_play_does_not_follow_the_noise_of_the_torque_that_tells_it(gap):
    """Motors alone, and a torque that is three times its noise: the sides that it tells are partly the noise's."""
    model, run = behind(1, lambda x: gap * np.tanh(x / 0.05))
    rng, torque = np.random.default_rng(3), run.channels["motor_torque"]
    slow = lfilter([0.2], [1.0, -0.8], rng.standard_normal((len(torque) + 200, 2)), axis=0)[200:]
    noisy = torque + torque.std(axis=0) * np.array([0.003, 1.0]) * slow
    run = Recording(run.time, {"motor_position": run.channels["motor_position"], "motor_torque": noisy}, label="noisy")
    search = search_of(model, run)
    fit = search.fit([])
    plays = [c for c in all_candidates(search.problem, ["backlash"]) if c.place.index == (1,)]
    play = max(plays, key=lambda c: search.score(fit, c).statistic)
    score = search.score(fit, play)
    assert follows_noise(search, fit, play, score) == (gap == 0.0)
    explanation = explained(search, search.bank(plays), [play])
    assert len(without_followers(explanation).found) == (gap > 0.0)


def test_how_hard_the_ends_of_play_are_is_no_soft_cable():
    """The contact gives a fortieth of the play: the model holds it, the list of what is missing does not."""
    (model, run), (_, unseen) = (behind(k, lambda x: 0.02 * np.tanh(x / 0.01) + 5e-4 * x) for k in (1, 2))
    result = diagnose(model, [run], [unseen])
    (finding,) = result.content["findings"]
    assert finding["effect"] == "backlash"
    assert finding["parameters"]["half_gap"]["value"] == pytest.approx(0.02, rel=0.1)
    assert {e["effect"] for e in result.manipulator.effects} == {"backlash", "cable_elasticity"}
