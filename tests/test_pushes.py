"""Pushes whose edges alone tell them, and torques that are, or are not, the law that they look like."""

from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from trials import search_of, two_tones

from cdm_pin import verdict
from cdm_pin.candidates import Candidate
from cdm_pin.diagnose import diagnose
from cdm_pin.dynamics import motor_torques
from cdm_pin.effects import CATALOGUE
from cdm_pin.model import load_model
from cdm_pin.problem import make_problem
from cdm_pin.pushes import edged
from cdm_pin.recording import Recording

ARM = load_model(Path(__file__).resolve().parent.parent / "urdf" / "planar3.yaml")
T = np.arange(0, 60, 0.005)


def recording(seed, on_joints=None, crosstalk=0.0, walk=0.0, on_motors=None, arm=ARM):
    """One minute of three links: white noise of 0.01 N m, slow noise at motor 1, motor 3 sees some of motor 1."""
    rng = np.random.default_rng(seed)
    w, phase = np.array([1.1, 1.7, 2.3]), rng.uniform(0, 6, (2, 3))
    q, v, a = two_tones(T, w, phase)
    torque = motor_torques(arm, q, v, a)
    if on_motors is not None:
        torque += on_motors(torque, v @ arm.motor_from_joint.T, a @ arm.motor_from_joint.T)
    if on_joints is not None:
        torque += arm.motor_torque(on_joints(q, v))
    torque[:, 2] += crosstalk * torque[:, 0]
    torque[:, 0] += walk * np.cumsum(rng.standard_normal(len(T))) / np.sqrt(len(T))
    torque += 0.01 * rng.standard_normal(q.shape)
    return Recording(T, {"joint_position": q, "motor_torque": torque}, label=f"made{seed}")


def push(size, start, end):
    """Torque on joint 2 for some time."""
    return lambda q, v: np.where((start <= T) & (end > T), -size, 0.0)[:, None] * np.array([0.0, 1.0, 0.0])


def test_the_best_edges_are_the_best_of_all():
    """Against windows tried one by one, with columns of their own."""
    search = search_of(ARM, recording(0, push(0.8, 20.3, 29.1)))
    fit = search.fit([])
    law = CATALOGUE["external_torque"]
    start = Candidate(law, law.places(ARM)[1], (27.0, 30.0, 0.0))
    best, apart = edged(search, fit, start)
    score = search.score(fit, best).statistic
    assert best.shape[:2] == pytest.approx((20.3, 29.1), abs=2 * apart)
    grid = product(np.arange(19.0, 22.0, 0.25), np.arange(28.0, 31.0, 0.25))
    tried = [search.score(fit, replace(start, shape=(a, b, 0.0))).statistic for a, b in grid]
    assert score > 0.99 * max(tried)


@pytest.mark.slow
def test_a_long_push_beside_a_zero_that_walks_is_one_push():
    """Neither a drift nor slow noise, as which all but its edges could pass."""
    runs = [recording(1, push(0.8, 20.3, 29.1), walk=0.02), recording(2, walk=0.02)]
    content = diagnose(ARM, runs[:1], runs[1:]).content
    (finding,) = content["findings"]
    assert (finding["effect"], finding["location"]) == ("external_torque", {"kind": "joint", "index": 2})
    assert finding["time"] == pytest.approx([20.3, 29.1], abs=0.3)


@pytest.mark.slow
def test_a_torque_that_follows_another_motors_gets_no_name():
    runs = [recording(seed, crosstalk=0.04) for seed in (3, 4)]
    content = diagnose(ARM, runs[:1], runs[1:]).content
    assert content["verdict"] == "unexplained" and not content["findings"]
    assert content["unexplained"]["location"]["index"] == 3
    assert "follows that of another motor" in content["unexplained"]["region"]


@pytest.mark.parametrize(
    ("sign", "verdict"), [(-1.0, "unexplained"), pytest.param(1.0, "missing_physics", marks=pytest.mark.slow)]
)
def test_what_drives_a_joint_away_is_no_spring(sign, verdict):
    """It pulls as a spring that stiffens, but to where its joint is not; one that does the opposite is a spring."""

    def pull(q, v):
        return sign * (0.9 * q[:, 1:2] - 0.2 * q[:, 1:2] ** 3) * np.array([0.0, 1.0, 0.0])

    runs = [recording(seed, pull) for seed in (8, 9)]
    content = diagnose(ARM, runs[:1], runs[1:]).content
    assert content["verdict"] == verdict
    if sign < 0:
        assert not content["findings"] and content["unexplained"]["location"] == {"kind": "joint", "index": 2}
        assert "drives joint 2 away" in content["unexplained"]["region"]
    else:
        assert [(f["effect"], f["location"]["index"]) for f in content["findings"]] == [("joint_spring", 2)]


@pytest.mark.parametrize("with_rotor", [pytest.param(0.0, marks=pytest.mark.slow), 1.0])
def test_friction_by_torque_counts_the_rotors_where_that_loads_it(with_rotor):
    """A motor's bearing carries what its cable pulls, a gear within it the rotor's torque beside."""
    arm = replace(ARM, rotor_inertia=10.0 * ARM.rotor_inertia)

    def on_motors(torque, v_m, a_m):
        carried = torque - (1.0 - with_rotor) * arm.rotor_inertia * a_m
        return 0.1 * np.abs(carried) * np.tanh(v_m / 0.02) * np.array([0.0, 0.0, 1.0])

    runs = [recording(seed, on_motors=on_motors, arm=arm) for seed in (12, 13)]
    (finding,) = diagnose(arm, runs[:1], runs[1:]).content["findings"]
    assert (finding["effect"], finding["location"]) == ("torque_dependent_friction", {"kind": "motor", "index": 3})
    parameters = finding["parameters"]
    assert parameters["with_rotor"]["value"] == with_rotor
    assert abs(parameters["coefficient"]["value"] - 0.1) < 3 * parameters["coefficient"]["std"] + 1e-3


@pytest.mark.parametrize(
    ("there", "verdict"), [pytest.param(1.0, "missing_physics", marks=pytest.mark.slow), (1.3, "unexplained")]
)
def test_a_law_that_is_another_one_in_unseen_recordings_has_no_name(there, verdict):
    """A drag of joint 2 that grows by a third from one recording to the next is no constant of it, however it fits."""
    sizes = (0.4, 0.4 * there)
    runs = [
        recording(seed, lambda q, v, size=size: size * v[:, 1:2] * np.array([0.0, 1.0, 0.0]))
        for seed, size in zip((10, 11), sizes, strict=True)
    ]
    content = diagnose(ARM, runs[:1], runs[1:]).content
    assert content["verdict"] == verdict
    if there > 1.0:
        assert not content["findings"] and content["unexplained"]["location"] == {"kind": "joint", "index": 2}
        assert (
            content["unexplained"]["region"] == "its law has another size in the unseen recordings than in the others"
        )
        assert content["unexplained"]["nearest"][0]["effect"] == "viscous_friction"
    else:
        assert [(f["effect"], f["location"]["index"]) for f in content["findings"]] == [("viscous_friction", 2)]


@pytest.mark.slow
def test_what_motors_err_by_alike_is_no_noise():
    """Dry friction of joint 2 that swells and fades, otherwise in every recording: no law, but no sensor's noise."""

    def rubbing(phase):
        return lambda q, v: (
            (0.8 * (1 + 0.95 * np.sin(2 * np.pi * T / 5.3 + phase)) * np.tanh(v[:, 1] / 0.01))[:, None]
            * np.array([0.0, 1.0, 0.0])
        )

    runs = [recording(5, rubbing(0.0)), recording(6, rubbing(2.0))]
    content = diagnose(ARM, runs[:1], runs[1:]).content
    assert content["verdict"] == "unexplained" and not content["findings"]
    assert content["unexplained"]["location"] == {"kind": "joint", "index": 2}


def test_a_motion_that_gets_quicker_keeps_its_accelerations_behind_coarse_encoders():
    """A chirp that ends at 1.3 Hz, of which most is slower, read in steps of 1.5 mrad."""
    rng, step = np.random.default_rng(7), 2 * np.pi / 4096
    first, last, end = np.array([0.05, 0.07, 0.04]), np.array([1.2, 1.0, 1.3]), T[-1]
    rise = np.log(last / first)
    share = np.exp(rise * T[:, None] / end)
    phase, speed = 2 * np.pi * first * end / rise * (share - 1.0), 2 * np.pi * first * share
    q = 0.45 * share**-0.75 * np.sin(phase)
    v = 0.45 * share**-0.75 * (speed * np.cos(phase) - 0.75 * rise / end * np.sin(phase))
    a = np.gradient(v, T, axis=0)
    torque = motor_torques(ARM, q, v, a) + 0.03 * rng.standard_normal(q.shape)
    rounded = Recording(T, {"joint_position": np.round(q / step) * step, "motor_torque": torque})
    assert make_problem(ARM, [rounded]).band.slow > last.max()


@pytest.mark.parametrize(
    ("pushes", "back"),
    [
        ([(1, 2.3), (1, 2.4)], [0, 1]),
        ([(1, 2.3), (1, -2.4)], []),
        ([(1, 2.3), (2, 2.4)], []),
        ([(1, 2.3), (1, 1.2), (2, 2.3), (2, 2.2)], [2, 3]),
    ],
)
def test_a_push_that_comes_back_is_none(monkeypatch, pushes, back):
    """Who pushes twice does not push twice as much; a torque that is cut off where a motor has no more does."""
    push = SimpleNamespace(name="external_torque")
    effects = [SimpleNamespace(effect=push, location={"kind": "joint", "index": joint}) for joint, _ in pushes]
    stated = {j: {"torque": {"value": torque}} for j, (_, torque) in enumerate(pushes)}
    monkeypatch.setattr(verdict, "_of_another_law", lambda verdict, which, words: which)
    assert verdict._recurring(SimpleNamespace(fit=SimpleNamespace(effects=effects), stated=stated)) == back
