"""Compliance that only motors see: the oscillator, what comes through it, play by leaps and by its free flight."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from trials import loaded_trial

from cdm_pin.candidates import Candidate, loaded, passed
from cdm_pin.confirming import helps
from cdm_pin.diagnose import diagnose
from cdm_pin.effects import CATALOGUE
from cdm_pin.leaders import POSTURE, leading
from cdm_pin.motion import Felt, crossing, leaping
from cdm_pin.problem import make_problem
from cdm_pin.swing import _rattle, oscillate, swung

SOFT, PLAY = CATALOGUE["cable_elasticity"], CATALOGUE["backlash"]


@pytest.fixture(scope="module")
def soft(tmp_path_factory):
    """Draw an arm of two links whose first cable is soft, seen by its motors: resonance at 2.4 Hz, in the band."""
    return loaded_trial(
        tmp_path_factory.mktemp("soft"),
        8706,
        effects=["cable_elasticity"],
        positions="motor",
        bits=17,
        at_least=50.0,
    )


@pytest.fixture(scope="module")
def motion(soft):
    model, runs, _, _ = soft
    return make_problem(model, runs).motions[0]


def hung(motion, stiffness=90.0, damping=0.3):
    """Give the motion on a soft first cable."""
    place = SOFT.places(motion.model)[0]
    beta = np.array([1.0 / stiffness, damping / stiffness**2])
    return loaded(motion, [(Candidate(SOFT, place), beta)]), Candidate(SOFT, place), beta


def without_free_swings(torque, swing, valid):
    """Take from torques, (n, n_motors), what first states could make of them."""
    A = swing.free[:, valid].reshape(len(swing.free), -1).T
    y = torque[valid].ravel()
    return y - A @ np.linalg.lstsq(A, y, rcond=None)[0]


def test_oscillator_follows_a_load_like_a_general_integrator():
    dt, t = 0.005, np.arange(0.0, 6.0, 0.005)
    mass, load = (lambda u: 0.3 + 0.1 * np.sin(u)), (lambda u: 3 + 2 * np.sin(5 * u) + np.cos(11 * u))
    x = oscillate(np.stack([np.full_like(t, 120.0), np.full_like(t, 0.4), mass(t)]), load(t), dt)
    known = solve_ivp(
        lambda u, y: [y[1], (load(u) - 0.4 * y[1] - 120.0 * y[0]) / mass(u)],
        (0.0, 6.0),
        [load(0.0) / 120.0, 0.0],
        t_eval=t,
        rtol=1e-9,
        atol=1e-12,
    ).y
    np.testing.assert_allclose(x[:2], known, atol=4e-4 * np.abs(known).max())
    np.testing.assert_allclose(mass(t) * x[2] + 0.4 * x[1] + 120.0 * x[0], load(t), atol=1e-9)


@pytest.mark.parametrize("damping", [1e-3, 12.0, 1e5])
def test_oscillator_takes_any_damping(damping):
    t = np.arange(0.0, 2.0, 0.005)
    x = oscillate(
        np.stack([np.full_like(t, 120.0), np.full_like(t, damping), np.full_like(t, 0.3)]), 1.2 + 0 * t, 0.005
    )
    np.testing.assert_allclose(x, np.outer([0.01, 0.0, 0.0], np.ones_like(t)), atol=1e-9)  # it rests


def test_links_hang_where_the_cable_carries_them(motion):
    moved, _, _ = hung(motion)
    x, valid = moved.swing.travel, motion.felt.valid
    carried = moved.tau_m[:, 0] / motion.model.arm_scale[0]
    left = (90.0 * x[0] + 0.3 * x[1] - carried)[valid]
    assert np.std(left) < 2e-3 * np.std(carried)
    b = -motion.model.joint_from_motor[:, 0] / motion.model.arm_scale[0]
    np.testing.assert_allclose(moved.q - motion.q, np.outer(x[0], b), atol=1e-12)
    assert loaded(moved, []).swing is None  # and come back when the cable is rigid again
    np.testing.assert_array_equal(loaded(moved, []).q, motion.q)


def test_what_loads_the_cable_comes_through_as_a_small_load_does(motion):
    moved, _, _ = hung(motion)
    push = np.outer(np.sin(9.0 * motion.time), [1.0, 0.4])  # near the resonance
    eps, valid, torques = 1e-3, motion.felt.valid, []
    for sign in (1.0, -1.0):
        there = swung(motion, 0, 90.0, 0.3, sign * eps * push)
        torques.append(there.tau_m + sign * eps * push)
    known = without_free_swings((torques[0] - torques[1]) / (2 * eps), moved.swing, valid)
    own = without_free_swings(passed(push[..., None], moved)[..., 0], moved.swing, valid)
    assert np.linalg.norm(own - known) < 0.01 * np.linalg.norm(known)
    still = without_free_swings(push, moved.swing, valid)
    assert np.linalg.norm(own - still) > 0.3 * np.linalg.norm(still)  # it swings


def test_columns_of_the_soft_cable_are_derivatives_of_what_its_motion_asks_for(motion):
    moved, candidate, beta = hung(motion)
    columns = candidate.columns(moved).torque
    valid = motion.felt.valid
    for k, step in enumerate(1e-3 * beta):
        torques = []
        for sign in (1.0, -1.0):
            changed = beta + sign * step * np.eye(2)[k]
            torques.append(loaded(motion, [(candidate, changed)]).tau_m)
        known = without_free_swings((torques[0] - torques[1]) / (2 * step), moved.swing, valid)
        own = without_free_swings(columns[..., k], moved.swing, valid)
        assert np.linalg.norm(own - known) < 0.02 * np.linalg.norm(known)


@pytest.mark.slow
def test_a_resonance_in_the_band_is_told_from_the_motors_alone(soft, monkeypatch):
    """It would not be if links that swing made the training no likelier, whatever they do on the unseen run."""
    model, runs, unseen, truth = soft
    result = diagnose(model, runs, unseen)
    content = result.content
    (finding,) = content["findings"]
    assert (finding["effect"], finding["location"]) == ("cable_elasticity", {"kind": "cable", "index": 1})
    known = truth["effects"][0]["parameters"]
    assert finding["parameters"]["stiffness"]["value"] == pytest.approx(known["stiffness"], rel=0.02)
    fit = content["fit"]["holdout"]
    assert np.all(np.array(fit["rmse_augmented"]) < 1.2 * np.array(fit["noise_floor"]))
    assert helps(result.holdout, result.explanation, 0)
    monkeypatch.setattr("cdm_pin.confirming.swing_gain", lambda *_: -1.0)
    assert not helps(result.holdout, result.explanation, 0)


def played(lag=0.0, gap=0.01, rate=200.0):
    """Let a motor leap through its play where the torque changes sign; the torque is late by `lag` [s]."""
    t = np.arange(0.0, 20.0, 1.0 / rate)
    torque = lambda u: 3.0 * np.sin(1.3 * u) + 1.5 * np.sin(2.9 * u + 0.4)  # noqa: E731
    side = np.tanh(torque(t) / 0.02)
    noise = 1e-5 * np.random.default_rng(3).standard_normal(len(t))
    return torque(t - lag), np.sin(0.9 * t) + gap * side + noise, side


@pytest.mark.parametrize("lag, rate", [(0.0, 200.0), (0.03, 200.0), (-0.05, 200.0), (0.03, 1000.0), (0.04, 50.0)])
def test_play_changes_sides_when_the_motor_leaps(lag, rate):
    torque, position, side = played(lag, rate=rate)
    inner = slice(int(rate / 2), -int(rate / 2))
    own = leaping(torque, position, 0.02, rate)
    assert np.sqrt(np.mean((own - side)[inner] ** 2)) < 0.03
    if lag:
        assert np.sqrt(np.mean((np.tanh(torque / 0.02) - side)[inner] ** 2)) > 0.2


def test_play_stays_with_the_torque_where_nothing_leaps():
    torque, position, side = played(0.0, gap=0.0)
    np.testing.assert_allclose(leaping(torque, position, 0.02, 200.0), side, atol=1e-12)


@pytest.mark.parametrize("off", [0.0, 0.8])
def test_leaps_of_a_motor_tell_what_a_torque_is_at_zero(off):
    """A torque whose zero is off says at other times that a play is crossed; where the motor leaps it says its zero."""
    torque, position, _ = played()
    valid = np.ones(len(torque), bool)
    felt = Felt((torque + off)[:, None], position[:, None], (8.0, 8.0), valid, 200.0)
    assert felt.zero(0, torque + off) == pytest.approx(off, abs=0.03)
    smooth = Felt(felt.torque, played(gap=0.0)[1][:, None], (8.0, 8.0), valid, 200.0)
    assert smooth.zero(0, torque + off) == 0.0


def test_a_contact_beyond_a_gap_is_integrated_like_by_a_general_integrator():
    t = np.arange(0.0, 6.0, 0.005)
    load = lambda u: 3.0 * np.sin(2.0 * u) + np.cos(5.0 * u)  # noqa: E731
    own = np.stack([np.full_like(t, 5.0), np.full_like(t, 0.2), np.full_like(t, 0.1)])
    x = _rattle(own, load(t), 600.0, 4.0, 0.02, 0.005, 12)

    def slope(u, y):
        beyond = np.sign(y[0]) * max(abs(y[0]) - 0.02, 0.0)
        contact = 600.0 * beyond + 4.0 * y[1] * (beyond != 0.0)
        return [y[1], (load(u) - 0.2 * y[1] - 5.0 * y[0] - contact) / 0.1]

    known = solve_ivp(slope, (0.0, 6.0), x[:2, 0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=1e-3).y
    np.testing.assert_allclose(x[0], known[0], atol=0.02 * np.abs(known[0]).max())


def test_column_of_a_play_is_about_the_derivative_of_what_its_motion_asks_for(motion):
    """About, as when it touches is known to a sample: enough to find the play step by step."""
    play, valid = Candidate(PLAY, PLAY.places(motion.model)[0], (0.05, 400.0)), motion.felt.valid
    moved = loaded(motion, [(play, np.array([0.01]))])
    assert moved.swing.half_gap == 0.01 and np.any(np.abs(moved.swing.travel[0]) < 0.01)
    both = [loaded(motion, [(play, np.array([0.01 + step]))]).tau_m for step in (1e-5, -1e-5)]
    known, own = (both[0] - both[1]) / 2e-5, play.columns(moved).torque[..., 0]
    assert np.linalg.norm((own - known)[valid]) < 0.3 * np.linalg.norm(known[valid])
    assert play.columns(motion).torque.shape[2] == own.ndim - 1  # one, too, where nothing is integrated


@pytest.mark.slow
def test_play_is_told_from_the_motors_alone(tmp_path):
    model, runs, unseen, truth = loaded_trial(
        tmp_path, 8704, effects=["backlash"], positions="motor", bits=17, at_least=50.0
    )
    content = diagnose(model, runs, unseen).content
    (finding,) = content["findings"]
    assert (finding["effect"], finding["location"]) == ("backlash", truth["effects"][0]["location"])
    gap = truth["effects"][0]["parameters"]["half_gap"]
    assert finding["parameters"]["half_gap"]["value"] == pytest.approx(gap, rel=0.05)
    fit = content["fit"]["holdout"]
    assert np.all(np.array(fit["rmse_augmented"]) < 1.2 * np.array(fit["noise_floor"]))


def test_play_that_is_never_crossed_is_an_offset(tmp_path):
    """Under a load of one sign a gap only shifts the joint, as a tilted base nearly does; it is not called play."""
    model, runs, unseen, truth = loaded_trial(tmp_path, 8809, effects=1, positions="motor", at_least=50.0)
    assert truth["effects"][0]["effect"] == "base_tilt"
    told = diagnose(model, runs, unseen)
    (finding,) = told.content["findings"]
    listed = [finding["effect"], *(rival["effect"] for rival in finding["indistinguishable_from"])]
    assert "base_tilt" in listed and finding["effect"] != "backlash"
    search, bank = told.explanation.search, told.explanation.bank
    offsets = [c for c in bank.laws.candidates if c.name in POSTURE][:2]
    assert not any(search.is_crossed(c) for c in bank.laws.candidates if c.name == "backlash")
    for instead, stands in ((offsets[:1], False), (offsets, True)):  # one play in the place of several offsets
        leaders = leading(search, search.fit([]), bank, 99, [], instead=instead)
        assert any(c.name == "backlash" for c, _, _ in leaders) == stands


def flights(rate=200.0, half=0.01, stiffness=1500.0):
    """Load of a cable, and the travel of its motor, whose links take 0.15 s from one side of a play to the other."""
    t = np.arange(0.0, 40.0, 1.0 / rate)
    load = np.sin(0.9 * t) + 0.3 * np.sin(2.3 * t)
    side = np.sign(load)
    for k in np.flatnonzero(np.diff(side)) + 1:
        way = np.linspace(0.0, 1.0, round(0.15 * rate)) ** 2
        side[k : k + len(way)] = side[k - 1] * (1.0 - 2.0 * way[: len(side) - k])
    return load, half * side + load / stiffness, side


def test_encoders_on_both_sides_say_when_a_play_is_crossed():
    load, travel, side = flights()
    noisy = travel + np.random.default_rng(3).normal(0.0, 1e-4, len(travel))
    own = crossing(load, noisy, 0.02, 1e-4, 200.0)
    assert np.abs(own - side).mean() < 0.01
    assert np.abs(np.sign(load) - side).mean() > 5 * np.abs(own - side).mean()


@pytest.mark.parametrize(
    "travel",
    [
        pytest.param(lambda load, t: 1e-4 * np.random.default_rng(4).normal(size=len(t)), id="noise"),
        pytest.param(lambda load, t: 0.02 * np.sin(1.7 * t), id="a wave of the cable map"),
        pytest.param(lambda load, t: -0.01 * np.sign(load), id="against the load"),
        pytest.param(lambda load, t: 0.01 * np.sign(load + 2.0), id="on one side"),
    ],
)
def test_what_is_no_play_is_not_read_as_one(travel):
    load = flights()[0]
    t = np.arange(len(load)) / 200.0
    assert crossing(load, travel(load, t), 0.02, 1e-4, 200.0) is None
