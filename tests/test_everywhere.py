"""Where nearly every axis rubs: the band, the start, and what the unseen recording withdraws."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from trials import search_of

from cdm_pin import rubbing as friction_first
from cdm_pin.band import make_band
from cdm_pin.bank import all_candidates
from cdm_pin.candidates import Candidate
from cdm_pin.completed import added_torque
from cdm_pin.completing import law_records
from cdm_pin.dynamics import motor_torques
from cdm_pin.effects import CATALOGUE
from cdm_pin.everywhere import confirmed, kinds_first, rubs_everywhere
from cdm_pin.findings import parameters
from cdm_pin.model import load_model
from cdm_pin.problem import make_problem
from cdm_pin.recording import Recording
from cdm_pin.search import Search
from cdm_pin.settings import Settings

ROOT = Path(__file__).resolve().parent.parent
RATE, SECONDS = 200.0, 24.0
FRICTION = ((0.3, 0.2, 0.1), (0.4, 0.3, -0.2), (1.5, 0.8, 0.3))


@pytest.fixture(scope="module")
def model():
    return load_model(ROOT / "urdf" / "real" / "psm3.yaml")


def run(model, seed, friction=FRICTION, shaking=0.0):
    """Simulate a motion of the first three joints: viscous, dry and constant torque per motor; encoders may shake."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, SECONDS, 1 / RATE)
    reach, w = np.array([0.6, 0.5, 0.05]), 2 * np.pi * np.array([0.1, 0.23, 0.41, 0.67])
    x, v, a = (np.zeros((len(t), 3)) for _ in range(3))
    for k in range(3):
        for f in w:
            p, b = rng.uniform(0, 2 * np.pi), reach[k] * rng.uniform(0.3, 1.0) / len(w)
            x[:, k] += b * np.sin(f * t + p)
            v[:, k] += b * f * np.cos(f * t + p)
            a[:, k] -= b * f**2 * np.sin(f * t + p)
    x[:, 2] += 0.12
    E = model.joint_from_motor
    tau = motor_torques(model, x @ E.T + model.offset, v @ E.T, a @ E.T)
    for k, (viscous, dry, constant) in enumerate(friction):
        tau[:, k] += viscous * v[:, k] + dry * np.sign(v[:, k]) + constant
    tau += 0.01 * rng.normal(size=tau.shape)
    x = x + 1e-6 * rng.normal(size=x.shape) + shaking * reach * np.sin(2 * np.pi * 9.0 * t)[:, None]
    return Recording(t, {"motor_position": x, "motor_torque": tau}, label=f"run {seed}")


def test_the_band_ends_where_torques_do_not_follow_accelerations(model):
    wide = make_problem(model, [run(model, 0)]).band.cutoff
    narrow = make_problem(model, [run(model, 0, shaking=2e-3)]).band.cutoff
    assert narrow < 9.0 < wide


@pytest.mark.parametrize(("cutoff", "slow"), [(5.6, np.inf), (7.0, 6.1)])
def test_accelerations_are_cut_inside_the_band_or_not_at_all(model, monkeypatch, cutoff, slow):
    """A low-pass of accelerations that ends just above the band would take a part of it that torques still have."""
    monkeypatch.setattr("cdm_pin.problem._heard", lambda *_: 6.1)
    monkeypatch.setattr("cdm_pin.problem.inertia_cutoff", lambda *_: cutoff)
    assert make_problem(model, [run(model, 0)]).band.slow == slow


def test_friction_everywhere_is_seen_and_sized(model):
    search = search_of(model, run(model, 1), make_band(RATE, 8.0))
    assert rubs_everywhere(search, search.bank(all_candidates(search.problem)), [])
    effects = kinds_first(search)
    fit = search.fit(effects)
    found = {(c.effect.name, c.location["index"]): float(b[0]) for c, b in zip(effects, fit.beta, strict=True)}
    for joint, (viscous, dry, _) in zip((1, 2, 7), FRICTION, strict=True):
        assert found["viscous_friction", joint] == pytest.approx(viscous, rel=0.1)
        assert found["coulomb_friction", joint] == pytest.approx(dry, rel=0.1)


def test_friction_at_one_axis_is_not_everywhere(model):
    search = search_of(model, run(model, 2, ((0.3, 0.2, 0.1), (0, 0, 0), (0, 0, 0))), make_band(RATE, 8.0))
    assert not rubs_everywhere(search, search.bank(all_candidates(search.problem)), [])


@pytest.mark.parametrize(("late", "found"), [((5, 5, 5), [0.025]), ((0, 0, 0), []), ((0, 5, 0), [])])
def test_a_delay_of_the_logger_is_told_from_friction(model, late, found):
    """It is evident where it explains most of what friction leaves, and no motor asks for another one of its own."""
    recording = run(model, 4)
    torque = recording.channels["motor_torque"]
    delayed = np.column_stack([np.roll(torque[:, k], steps) for k, steps in enumerate(late)])[5:]
    kept = {"motor_position": recording.channels["motor_position"][5:], "motor_torque": delayed}
    search = search_of(model, replace(recording, time=recording.time[5:], channels=kept), make_band(RATE, 8.0))
    loggers = friction_first.evident_delay(search, frozenset())[1]
    assert [c.location for c in loggers] == [{"kind": "system"}] * len(found)
    assert [c.shape[0] for c in loggers] == pytest.approx(found, abs=1e-3)
    assert not friction_first.evident_delay(search, frozenset(c.key for c in loggers))[1]


@pytest.mark.parametrize("axes", [3, 2, 1])
def test_the_search_starts_from_friction_of_most_axes(model, axes):
    """Friction at one axis alone is no start: two laws explain all of it."""
    friction = [(viscous, dry, 0.0) if k < axes else (0.0, 0.0, 0.0) for k, (viscous, dry, _) in enumerate(FRICTION)]
    search = search_of(model, run(model, 3, friction), make_band(RATE, 8.0))
    start = friction_first.rubbing(search, search.bank(all_candidates(search.problem)))
    laws = {(c.effect.name, c.location["index"]) for c in start}
    names = ("viscous_friction", "coulomb_friction")
    assert laws == ({(name, joint) for name in names for joint in (1, 2, 7)[:axes]} if axes > 1 else set())


@pytest.mark.parametrize(("law", "everywhere"), [(100.0, True), (2900.0, True), (3100.0, False)])
def test_one_law_that_explains_as_much_is_not_friction_everywhere(monkeypatch, law, everywhere):
    """Friction at three axes explains 3000 in all; a delay that explains as much beside what was found is likelier."""
    search, bank, _ = rubbing(monkeypatch, np.eye(3), law)
    assert rubs_everywhere(search, bank, []) == everywhere


@pytest.mark.parametrize(("found", "everywhere"), [(0, True), (1, True), (2, False)])
def test_friction_at_every_motor_is_everywhere(monkeypatch, found, everywhere):
    """Three of five axes rub, as many as there are motors; with two of them found, the third is one more effect."""
    axes = np.concatenate([np.eye(3), [[1.0, 1.0, 0.0], [0.0, 1.0, 1.0]]])
    search, bank, rubs = rubbing(monkeypatch, axes, 100.0)
    assert rubs_everywhere(search, bank, rubs[:found]) == everywhere


@pytest.mark.parametrize(("each", "everywhere"), [(1500.0, True), (500.0, False)])
def test_what_leaves_far_more_than_friction_at_every_motor_is_no_start(monkeypatch, each, everywhere):
    """Four of seven axes rub and three were found: one more effect, unless it is most of what they leave."""
    axes = np.concatenate([np.eye(4), [[1.0, 1, 0, 0], [0, 1, 1, 0], [0, 0, 1, 1]]])
    search, bank, rubs = rubbing(monkeypatch, axes, 100.0, n=4, each=each)
    assert rubs_everywhere(search, bank, rubs[:3]) == everywhere


def rubbing(monkeypatch, axes, law, n=3, each=1000.0):
    """Give stubs of a search in which friction along the first few of some axes explains as much each."""
    places = [
        SimpleNamespace(
            location={"kind": "motor", "index": k}, A=(k,), B=(), is_pair=False, weights=lambda model, w=w: w
        )
        for k, w in enumerate(axes)
    ]
    rubs = [Candidate(CATALOGUE["viscous_friction"], place) for place in places]
    laws = SimpleNamespace(candidates=[Candidate(CATALOGUE["time_delay"], SimpleNamespace(A=()))])
    bank = SimpleNamespace(corrections="corrections", laws=laws)

    def fit(effects, noise):
        there = {c.place.location["index"] for c in effects} & set(range(n))
        return SimpleNamespace(deviance=1000.0 + each * (n - len(there)), n_judged=900)

    search = SimpleNamespace(
        problem=SimpleNamespace(torque=True, model=SimpleNamespace(n_motors=n)),
        fit=fit,
        score_all=lambda fit, part: [SimpleNamespace(statistic=law if part is laws else 500.0)],
    )
    monkeypatch.setattr("cdm_pin.everywhere.clear_noise", lambda search, effects: None)
    monkeypatch.setattr("cdm_pin.everywhere.axis_places", lambda model: places)
    monkeypatch.setattr("cdm_pin.everywhere.at_all_axes", lambda search, names: rubs)
    return search, bank, rubs


def test_what_harms_on_the_unseen_recording_is_withdrawn(model):
    """Friction that the unseen recording has too stays; dry friction that only the first one has goes."""
    band = make_band(RATE, 8.0)
    search = search_of(model, run(model, 3), band)
    other = (*FRICTION[:2], (FRICTION[2][0], 0.0, FRICTION[2][2]))
    judge = Search(make_problem(model, [run(model, 4, other)], band), search.base, Settings(), search.held)
    names = ("viscous_friction", "coulomb_friction", "torque_offset")
    effects = [c for c in search.common if c.effect.name in names]
    kept = {(c.key[0], c.location["index"]) for c in confirmed(search, judge, effects, np.ones(3))}
    assert {("coulomb_friction", 1), ("coulomb_friction", 2)} <= kept
    assert ("coulomb_friction", 7) not in kept


@pytest.mark.parametrize(
    "name, place, shape, detail, beta",
    [
        ("hysteresis", 0, (0.02, 0.0), 1.0, (0.3, 0.0, 0.2, 0.1, 0.0)),
        ("hysteresis", 0, (0.02, 0.75), 1.0, (0.3, 0.0, 0.2, 0.1, 0.0)),
        ("hysteresis", -1, (0.4, 0.0), 0.0, (0.3,)),
        ("joint_spring", 1, (1.0,), 0.0, (1.2, 0.7, -0.3, 0.4)),
    ],
)
def test_a_fitted_law_is_written_whole(model, name, place, shape, detail, beta):
    """All elements of a hysteresis, of angle or of tension, and the constant that no spring's law has."""
    problem = make_problem(model, [run(model, 5)])
    candidate = Candidate(CATALOGUE[name], CATALOGUE[name].places(model)[place], shape, detail)
    beta = np.array(beta)
    effects = tuple(law_records(model, candidate, parameters(candidate, beta, np.eye(len(beta))), beta))
    assert len(effects) == np.count_nonzero(beta) if name == "hysteresis" else len(effects) > 1
    assert candidate.remembers_tension == (place == -1)
    motion = problem.motions[0]
    along = candidate.columns(motion).along
    assert along is not None
    series, weights = along
    written = motion.with_model(replace(model, manipulator=replace(model.manipulator, effects=effects)))
    np.testing.assert_allclose(added_torque(written), (beta @ series)[:, None] * weights, atol=1e-6)
