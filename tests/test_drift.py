"""Drifting zeros of torque sensors: seen where they are, beside slow effects, and not taken for what is none."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from cdm_pin.base import base_parameters, massive_columns
from cdm_pin.candidates import Candidate
from cdm_pin.diagnose import diagnose
from cdm_pin.drift import Drift, drift_columns, drifting_channels, faint, slow_shapes, without_drift
from cdm_pin.drifting import all_drifting, is_swamped, own_drifts, still, with_drift
from cdm_pin.dynamics import inverse_dynamics
from cdm_pin.effects import CATALOGUE
from cdm_pin.gather import gather
from cdm_pin.masses import about
from cdm_pin.model import load_model
from cdm_pin.problem import make_problem
from cdm_pin.recording import Recording
from cdm_pin.resolved import _drifted
from cdm_pin.search import Search
from cdm_pin.settings import Settings
from cdm_pin.walking import slowness, walking_noise
from cdm_pin.wording import candidate, clause

ARM = Path(__file__).resolve().parent.parent / "urdf" / "cdm2.yaml"
W = np.array([1.1, 1.7])
T = np.arange(0, 60, 0.005)


def recording(seed, drift=0.0, coulomb=0.0, correlation=0.7, push=0.0, quick=0.0, at=(20.0,), walk=0.0):
    """One minute of the paper's arm: autoregressive noise of 0.02 N m, slow waves, a walk; joint 2 rubs, is pushed."""
    model, rng = load_model(ARM), np.random.default_rng(seed)
    phase = rng.uniform(0, 6, (3, 2))
    angles = [k * W * T[:, None] + p for k, p in zip((1, 2.3), phase, strict=False)]
    q = 0.6 * sum(np.sin(x) for x in angles)
    v = 0.6 * sum(k * W * np.cos(x) for k, x in zip((1, 2.3), angles, strict=True))
    a = -0.6 * sum((k * W) ** 2 * np.sin(x) for k, x in zip((1, 2.3), angles, strict=True))
    tau = inverse_dynamics(model, q, v, a) + coulomb * np.tanh(v / 0.01) * np.array([0.0, 1.0])
    for start in at:
        tau[(start < T) & (start + 4.0 > T), 1] -= push
    white = 0.02 * np.sqrt(1 - correlation**2) * rng.standard_normal(q.shape)
    noise = lfilter([1.0], [1.0, -correlation], white, axis=0)
    slow = drift * np.sin(2 * np.pi * 0.019 * T[:, None] + phase[2])
    slow += quick * np.sin(2 * np.pi * 0.043 * T[:, None] - phase[2])
    slow += walk * np.cumsum(rng.standard_normal(q.shape), axis=0) / np.sqrt(len(T)) if walk else 0.0
    torque = model.motor_torque(tau) + noise + slow
    return Recording(T, {"joint_position": q, "motor_torque": torque}, label=f"made{seed}")


def search_of(record):
    model = load_model(ARM)
    search = Search(make_problem(model, [record]), base_parameters(model, columns=massive_columns(model)), Settings())
    return about(search, search.fit([]))


def test_a_drift_is_seen_and_noise_is_not():
    """Slow waves as large as the noise stand out; coloured noise alone does not, nor does friction."""
    assert with_drift(search_of(recording(0, drift=0.02))).drift is not None
    for seed in range(1, 5):
        assert with_drift(search_of(recording(seed))).drift is None
    assert with_drift(search_of(recording(5, coulomb=0.1))).drift is None


@pytest.mark.slow
def test_a_large_wander_is_no_drift():
    """What dwarfs the noise is a fault, and said to be one."""
    runs = [recording(seed, drift=0.5) for seed in (10, 11)]
    content = diagnose(load_model(ARM), runs[:1], runs[1:]).content
    assert content["verdict"] == "unexplained"
    assert not content["findings"]


def test_a_drift_is_as_quick_as_the_data_show():
    """Where the next quicker wave stands out, too, it is taken; white noise has none."""
    rng, t = np.random.default_rng(3), np.arange(1200) / 20.0
    noise = 0.02 * rng.standard_normal((1, 1200))
    slow, quick = (0.03 * np.sin(2 * np.pi * t / period)[None] for period in (70.0, 22.0))
    none = np.zeros((0, 1, 1200))

    def seen(x, quicker):
        return drifting_channels([x], [none], [[(0, 1200)]], 20.0, 1, quicker) == [0]

    assert [seen(noise + slow, k) for k in (0, 1, 2)] == [True, False, False]
    assert [seen(noise + slow + quick, k) for k in (0, 1, 2)] == [True, True, False]


@pytest.mark.parametrize("seed", [50, 52, 54])
def test_zeros_that_walk_are_nothing_that_is_missing(seed):
    """A walk as large as the noise of single samples is neither a wander nor something that changes with time."""
    runs = [recording(s, walk=0.04, correlation=0.0) for s in (seed, seed + 1)]
    assert diagnose(load_model(ARM), runs[:1], runs[1:]).content["verdict"] == "consistent"


def test_noise_that_walks_has_a_unit_root_and_other_noise_has_none():
    """A filter with a unit root gives a constant no weight; white and autoregressive noise get none."""
    walks = search_of(recording(60, walk=0.08))
    noise = walking_noise(walks, walks.fit([]))
    assert noise is not None
    assert noise.coefficients.sum(axis=1)[:2] == pytest.approx(1.0)
    for correlation in (0.0, 0.7, 0.95):
        steady = search_of(recording(61, correlation=correlation))
        assert walking_noise(steady, steady.fit([])) is None


def test_slowness_is_one_for_white_noise_and_large_for_a_walk():
    rng = np.random.default_rng(0)
    white = rng.standard_normal((2, 4000))
    both = [np.stack([white[0], np.cumsum(white[1])])]
    flat, slow = slowness(both, [[(0, 1900), (2000, 4000)]])
    assert flat == pytest.approx(1.0, abs=0.3)
    assert slow > 100.0


@pytest.mark.slow
@pytest.mark.parametrize("learned", [1, 2])
def test_zeros_that_differ_between_recordings_are_nothing_that_is_missing(learned):
    """A constant of its own on each recording is no law, and no push for as long as it lasts, learned from or not."""
    model = load_model(ARM)
    runs = []
    for seed, shift in ((3, 0.02), (4, -0.02)):
        run = recording(seed)
        torque = run.channels["motor_torque"] + np.array([0.0, shift])
        runs.append(replace(run, channels=run.channels | {"motor_torque": torque}))
    search = Search(make_problem(model, runs), base_parameters(model, columns=massive_columns(model)), Settings())
    zeros = all_drifting(search)
    assert zeros.drift.channels == (0, 1) and search.drift is None
    fits = [s.fit([]) for s in (search, zeros)]
    assert fits[1].deviance < fits[0].deviance and not is_swamped(zeros, fits[1])
    content = diagnose(model, runs[:learned], runs[learned:]).content
    assert content["verdict"] == "consistent" and not content["findings"]


def test_a_drift_may_be_large_beside_the_band_but_not_beside_single_samples():
    assert faint(np.array([1.0, 1.0]), np.array([0.0, 4.0])) == pytest.approx([36.0, 144.0])


def test_drift_columns_belong_to_one_channel_and_one_run():
    first, second = drift_columns([400, 300], 10.0, 3, [0, 2], 1.5)
    shapes = [len(slow_shapes(n, 10.0, 1.5)) for n in (400, 300)]
    assert len(first) == len(second) == 2 * sum(shapes)
    assert not (first.any(axis=(1, 2)) & second.any(axis=(1, 2))).any()
    assert not first[:, 1].any()
    assert np.all(np.count_nonzero(np.concatenate([first.any(axis=2), second.any(axis=2)]), axis=1) <= 1)


def test_a_drift_is_taken_out_whole_and_quick_errors_stay():
    t = np.arange(3000) / 50.0
    shapes = slow_shapes(3000, 50.0, 1.5)
    quick = 0.1 * np.sin(2 * np.pi * 0.5 * t)
    rest = without_drift((quick + 0.3 * shapes[1] - 0.2 * shapes[4])[None], [(100, 1500), (1600, 2900)], shapes)
    assert np.std(rest[0] - quick) < 0.01


@pytest.mark.parametrize("coulomb", [0.0, 0.004])
def test_small_friction_is_found_beside_a_drift(coulomb):
    """A drift as large as the noise neither hides friction of a fifth of it nor makes any."""
    runs = [recording(seed, drift=0.02, coulomb=coulomb) for seed in (10, 11)]
    content = diagnose(load_model(ARM), runs[:1], runs[1:]).content
    named = [(f["effect"], f["location"]["index"]) for f in content["findings"]]
    if not coulomb:
        assert content["verdict"] == "consistent"
        return
    assert len(named) == 1
    assert "friction" in named[0][0]
    assert named[0][1] == 2


@pytest.mark.slow
def test_where_zeros_walk_friction_may_differ_in_its_two_directions():
    """The constant by which it would is not told from the walk, so it is named beside dry friction."""
    runs = [recording(seed, walk=0.05, coulomb=0.06, correlation=0.0) for seed in (70, 71)]
    (finding,) = diagnose(load_model(ARM), runs[:1], runs[1:]).content["findings"]
    names = {finding["effect"], *(other["effect"] for other in finding["indistinguishable_from"])}
    assert {"coulomb_friction", "asymmetric_friction"} <= names


@pytest.mark.slow
def test_a_push_is_no_quick_drift():
    """A push of some seconds, beside a drift, is not taken for a zero that moves more quickly."""
    runs = [recording(20, drift=0.02, push=0.15), recording(21, drift=0.02)]
    content = diagnose(load_model(ARM), runs[:1], runs[1:]).content
    (finding,) = content["findings"]
    assert (finding["effect"], finding["location"]["index"]) == ("external_torque", 2)
    assert finding["time"] == pytest.approx([20.0, 24.0], abs=0.3)
    assert finding["parameters"]["torque"]["value"] == pytest.approx(0.15, abs=0.02)


def test_a_quick_drift_is_no_push():
    """Zeros that move more quickly than usual are not taken for pushes."""
    runs = [recording(seed, drift=0.02, quick=0.015) for seed in (40, 41)]
    assert with_drift(search_of(runs[0])).drift.quicker
    assert diagnose(load_model(ARM), runs[:1], runs[1:]).content["verdict"] == "consistent"


@pytest.mark.slow
def test_pushes_at_two_times_and_on_two_recordings_are_all_told():
    """The same joint is pushed twice in one recording, and at one of these times in another; each push is one."""
    runs = [recording(60, push=0.3, at=(20.0, 45.0)), recording(61, push=0.3), recording(62)]
    content = diagnose(load_model(ARM), runs[:2], runs[2:]).content
    assert {f["effect"] for f in content["findings"]} == {"external_torque"}
    told = sorted((f["recording"], round(f["time"][0])) for f in content["findings"])
    assert told == [("made60", 20), ("made60", 45), ("made61", 20)]
    assert "of made61" in " ".join(clause(f) for f in content["findings"])
    assert len({candidate(f) for f in content["findings"]}) == 3
    unseen = content["fit"]["holdout"]  # where nobody pushed
    assert max(unseen["rmse_augmented"]) < 0.02 < min(unseen["rmse_rigid"])
    assert all(f["evidence"]["holdout_rmse_reduction"] > -0.02 for f in content["findings"])
    assert not any(f["indistinguishable_from"] for f in content["findings"])


def test_encoders_do_not_drift():
    """Beside drifting zeros of torques, a constant travel between the encoders of unseen recordings stays visible."""
    model, record = load_model(ARM), recording(70)
    both = Recording(
        T, dict(record.channels) | {"motor_position": model.motor_position(record.channels["joint_position"])}
    )
    search = Search(make_problem(model, [both]), base_parameters(model, columns=massive_columns(model)), Settings())
    m, n = model.n_motors, search.problem.data[0].shape[2]
    search.drift = Drift([np.zeros((0, 2 * m, n))], (0, 1))
    (columns,) = own_drifts(search)
    shares = []
    for channel in range(2 * m):
        own = columns[:, channel]
        own = own[np.any(own, axis=1)].T
        level = np.ones(n)
        shares.append(np.linalg.norm(level - own @ np.linalg.lstsq(own, level, rcond=None)[0]) / np.sqrt(n))
    assert max(shares[:m]) < 0.02
    assert min(shares[m:]) > 0.25  # as where nothing drifts
    error = np.ones((2 * m, n))
    (left,) = still(search, [error])
    assert np.array_equal(left[m:], error[m:])
    assert np.abs(left[:m]).mean() < 0.2


def test_a_push_that_comes_again_in_the_unseen_recording_is_a_push():
    """The unseen recording is judged without it, and says so."""
    runs = [recording(60, push=1.0), recording(62, push=1.0, at=(35.0,))]
    diagnosis = diagnose(load_model(ARM), runs[:1], runs[1:])
    content = diagnosis.content
    (finding,) = [f for f in content["findings"] if f["effect"] == "external_torque"]
    assert content["verdict"] == "missing_physics" and finding["location"] == {"kind": "joint", "index": 2}
    (notice,) = [text for text in content["data"]["unseen"][0]["notices"] if "pushes on joint 2" in text]
    start, end = (float(x) for x in notice.split(" s ")[0].split(" to "))
    assert 34.0 < start < 35.0 and 39.0 <= end < 40.0
    assert not any("pushes" in text for text in content["data"]["recordings"][0]["notices"])
    assert f"unseen recording: {notice}" in gather(diagnosis).notices


def test_pushes_that_follow_each_other_closely_are_one():
    """What is left beside a push that swells and fades is no other push."""
    law = CATALOGUE["external_torque"]
    first, other = law.places(load_model(ARM))
    push = Candidate(law, first, (20.0, 24.0, 0.0))
    for shape, clashes in (((24.0, 25.0, 0.0), True), ((24.5, 27.0, 0.0), True), ((26.0, 27.0, 0.0), False)):
        assert push.clashes(replace(push, shape=shape)) == clashes
        assert replace(push, shape=shape).clashes(push) == clashes
    assert not push.clashes(replace(push, shape=(20.0, 24.0, 1.0)))
    assert not push.clashes(replace(push, place=other))
    dry = Candidate(CATALOGUE["coulomb_friction"], first, (0.01,))
    assert dry.clashes(replace(dry, shape=(0.1,)))


@pytest.mark.parametrize(("moved", "due"), [((0, 1), [0.3, 0.2, 0.2]), ((1,), [0.0, 0.2, 0.0])])
def test_zeros_of_a_kind_drift_alike(moved, due):
    """A zero that was not seen to drift may, by the least of the others, if most of these did."""
    waves = np.zeros((3, 3, 100))
    for channel in moved:
        waves[channel, channel] = np.tile([1.0, -1.0], 50)
    rigid = [np.concatenate([np.ones((1, 3, 100)), waves])]
    problem = SimpleNamespace(segments=[[(0, 100)]], model=SimpleNamespace(n_motors=3))
    search = SimpleNamespace(n_bodies=1, rigid=rigid, problem=problem)
    assert _drifted(search, SimpleNamespace(base=np.array([5.0, 0.3, 0.2, 0.1]))) == pytest.approx(due)
