"""Axes that rest among moving ones: friction takes up whatever it must there, so that their torques are not judged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cdm_pin.bank import all_candidates
from cdm_pin.base import base_parameters, massive_columns
from cdm_pin.diagnose import diagnose
from cdm_pin.dynamics import motor_torques
from cdm_pin.leftover import holding_axes
from cdm_pin.likelihood import likelihood
from cdm_pin.model import load_model
from cdm_pin.places import axis_places, guide_places
from cdm_pin.problem import make_problem
from cdm_pin.recording import Recording
from cdm_pin.resolved import _is_judged
from cdm_pin.search import Search, rms
from cdm_pin.settings import Settings
from cdm_pin.standstill import rests, standing_places
from cdm_pin.sticking import sticking
from cdm_pin.whitening import Stretches, Whitener, counts, fit_whitener, foreseen, log_likelihood, quiet_segments

ARM = Path(__file__).resolve().parent.parent / "urdf" / "cdm2.yaml"
RATE, NOISE = 100.0, 0.02


def steps(t, targets, period, shift):
    """Go from target to target by minimum jerk in half of each period; rest in the other half."""
    n, phase = np.divmod(t + shift, period)
    x = np.clip(phase / (0.5 * period), 0.0, 1.0)
    rise = 10 * x**3 - 15 * x**4 + 6 * x**5
    way = np.asarray(targets)[n.astype(int) % len(targets)]
    return way + (np.asarray(targets)[(n.astype(int) + 1) % len(targets)] - way) * rise


def rates(q):
    v = np.gradient(q, 1.0 / RATE, axis=0)
    return v, np.gradient(v, 1.0 / RATE, axis=0)


def point_to_point(model, seed, coulomb=0.0, duration=60.0, brake=1.0):
    """Record a two-link arm that moves one joint after the other; at rest friction holds anything it can."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 1.0 / RATE)
    targets = rng.uniform(-1.0, 1.0, (2, 60))
    q = np.stack([steps(t, targets[0], 3.1, 0.0), steps(t, targets[1], 2.3, 0.7)], axis=1)
    v, a = rates(q)
    torque = motor_torques(model, q, v, a)
    held = brake * np.repeat(rng.uniform(-1.0, 1.0, (int(duration), 2)), int(RATE), axis=0)[: len(t)]
    friction = coulomb * np.where(np.abs(v) > 1e-3, np.sign(v), held)
    torque = torque + friction @ model.joint_from_motor + NOISE * rng.standard_normal(q.shape)
    return Recording(t, {"joint_position": q, "motor_torque": torque}, label=f"made {seed}")


def searched(model, *runs):
    problem = make_problem(model, runs)
    return Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())


def test_what_turns_is_not_at_rest_and_what_is_held_is():
    t = np.arange(0.0, 40.0, 1.0 / RATE)
    valid = np.ones(len(t), bool)
    assert not rests(np.sin(0.8 * t), valid, RATE, 0.0).any()
    moving = steps(t, [0.0, 1.0], 4.0, 0.0)
    assert np.mean(rests(moving, valid, RATE, 0.0)) == pytest.approx(0.5, abs=0.1)
    assert not rests(np.zeros(len(t)), valid, RATE, 0.0).any()  # what never moves has no motion to rest from
    coarse = np.round(moving / 1e-3) * 1e-3
    assert np.mean(rests(coarse, valid, RATE, 3e-4)) == pytest.approx(0.5, abs=0.15)


@pytest.mark.slow
def test_friction_is_measured_where_it_slides():
    """Friction that holds anything at rest has the size that it has in motion, and nothing stands beside it."""
    model = load_model(ARM)
    runs = [point_to_point(model, seed, 0.4) for seed in (1, 2)]
    content = diagnose(model, runs[:1], runs[1:]).content
    assert content["verdict"] == "missing_physics" and content["unexplained"] is None
    found = {(f["effect"], f["location"]["index"]): f["parameters"]["coulomb"] for f in content["findings"]}
    assert set(found) == {("coulomb_friction", 1), ("coulomb_friction", 2)}
    assert all(x["value"] == pytest.approx(0.4, abs=max(3 * x["std"], 0.02)) for x in found.values())
    (recording,) = content["data"]["recordings"]
    assert any("not judged while axes rest" in notice for notice in recording["notices"])


def test_rest_is_judged_where_nothing_rubs():
    model = load_model(ARM)
    clean, stuck = (searched(model, point_to_point(model, 3, coulomb)) for coulomb in (0.0, 0.4))
    assert clean.problem.partly and not holding_axes(clean)
    assert holding_axes(stuck)
    throughout = clean.problem.judged_without(frozenset())
    assert not throughout.partly and not throughout.resting


@pytest.mark.parametrize("joint", [0, 1])
def test_only_the_axis_that_holds_is_passed_over(joint):
    """Motors that a joint without friction loads are judged while it rests."""
    model = load_model(ARM)
    searches = searched(model, point_to_point(model, 9, 0.4 * np.eye(2)[joint]))
    (axis,) = holding_axes(searches)
    assert axis_places(model)[axis].location == {"kind": "joint", "index": joint + 1}
    part, whole = (searches.problem.judged_without(axes).runs[0].judged for axes in ({axis}, searches.problem.resting))
    assert part.sum() > 1.2 * whole.sum()


def held_between(model, weights, brake=1.0, locks=False):
    """Record three links; friction between motors 1 and 3 holds anything while their contact rests.

    It rests where they do, as one link moves after the other, or, if it `locks`, now and then while all move.
    """
    rng, t = np.random.default_rng(1), np.arange(0.0, 60.0, 1.0 / RATE)
    moves = zip(rng.uniform(-1.0, 1.0, (3, 60)), (3.1, 2.3, 2.7), strict=True)
    q = np.stack([steps(t, y, period, 0.4 * k) for k, (y, period) in enumerate(moves)], axis=1)
    along = model.motor_from_joint.T @ weights
    if locks:
        slip, q[:, :2] = 0.5 * q[:, 2], 0.8 * np.sin(t[:, None] * [1.1, 1.7])
        q[:, 2] = (slip - q[:, :2] @ along[:2]) / along[2]
    v, a = rates(q)
    slip = v @ along
    held = brake * np.repeat(rng.uniform(-1.0, 1.0, 60), int(RATE))
    friction = 0.5 * np.where(np.abs(slip) > 1e-3, np.sign(slip), held)[:, None] * weights
    torque = motor_torques(model, q, v, a) + friction + NOISE * rng.standard_normal(q.shape)
    return Recording(t, {"joint_position": q, "motor_torque": torque})


@pytest.mark.parametrize("ratio", [None, -0.7])
def test_what_holds_a_cable_or_two_motors_is_passed_over(ratio):
    """Friction of cable 3 on the guides of link 1, or between motors 1 and 3 at a ratio that nobody knows."""
    model = load_model(ARM.parent / "planar3.yaml")
    guide = next(place for place in guide_places(model) if place.index == (2, 1))
    weights = guide.weights(model) if ratio is None else np.array([ratio, 0.0, 1.0])
    holding = holding_axes(searched(model, held_between(model, weights)))
    kind, places = "cable" if ratio is None else "combination", [standing_places(model)[k] for k in holding]
    (place,) = (place for place in places if place.location["kind"] == kind)
    assert np.flatnonzero(place.weights(model)).tolist() == [0, 2]


@pytest.mark.slow
def test_a_cable_that_locks_harder_than_it_rubs_is_told():
    """On its guides it holds two motors together while they move; dry friction has no name there."""
    model = load_model(ARM.parent / "planar3.yaml")
    guide = guide_places(model)[0]
    content = diagnose(model, [held_between(model, guide.weights(model), brake=4.0, locks=True)]).content
    assert content["verdict"] == "unexplained" and not content["findings"]
    assert content["unexplained"]["location"] == guide.location
    assert "while it rests" in content["unexplained"]["region"]


def test_unseen_recordings_are_judged_as_those_learned_from():
    """An axis that rests now and then on one recording is not judged at rest on the others, however seldom."""
    model = load_model(ARM)
    often, seldom = point_to_point(model, 4), point_to_point(model, 5)
    t = seldom.time
    q = seldom.channels["joint_position"] + np.where(np.abs(t - 30.0) > 0.4, 0.05 * np.sin(9.0 * t), 0.0)[:, None]
    moving = replace(seldom, channels=seldom.channels | {"joint_position": q})
    problem = make_problem(model, [often])
    assert problem.resting
    alone = make_problem(model, [moving], problem.band)
    beside = make_problem(model, [moving], problem.band, 1, problem.resting)
    assert not alone.partly and beside.partly


def test_samples_that_are_not_judged_change_nothing():
    """Whatever torques are while they are not judged, noise, likelihood, fit and errors stay as they are."""
    model = load_model(ARM)
    record = point_to_point(model, 6)
    there = searched(model, record)
    dead = ~there.problem.runs[0].judged
    assert 0.2 < dead.mean() < 0.8
    for run in (other := searched(model, record)).problem.data:
        run[0, : model.n_motors][dead] += 5.0
    whitener = there.noise([])
    np.testing.assert_allclose(other.noise([]).coefficients, whitener.coefficients, atol=1e-5)
    assert likelihood(other, []) == pytest.approx(likelihood(there, []), rel=1e-6)
    fits = [search.fit([], whitener) for search in (there, other)]
    np.testing.assert_allclose(fits[1].residual, fits[0].residual, atol=1e-9)
    assert fits[0].n_judged < fits[0].n_rows
    assert fits[0].deviance == pytest.approx(fits[0].n_judged, rel=0.15)
    size = rms(there, [np.ones((there.problem.n_channels, data.shape[2])) for data in there.problem.data])
    np.testing.assert_allclose(size, 1.0)


@pytest.mark.parametrize("coloured", [False, True])
def test_noise_is_known_from_what_is_judged(coloured):
    """Half of the samples are not judged: the noise of the others comes out as it is, and white."""
    rng = np.random.default_rng(7)
    e = rng.standard_normal((2, 6000))
    if coloured:
        for t in range(1, 6000):
            e[:, t] += 0.8 * e[:, t - 1]
    live = np.repeat(np.arange(200) % 2 == 0, 30)[None] | np.zeros((2, 1), bool)
    run = Stretches([(0, 6000)], live)
    blank = e * live
    whitener = fit_whitener([blank], [run], 8)
    assert 1.0 / np.diag(whitener.mix) == pytest.approx([1.0, 1.0], rel=0.06)
    white = whitener(blank[None], run).reshape(2, -1)
    judged = foreseen(live)[:, whitener.order :]
    assert not white[~judged].any()
    assert np.std(white[judged]) == pytest.approx(1.0, rel=0.03)
    assert counts(run, 2).tolist() == [3000, 3000]
    assert quiet_segments([blank], [run])[0] == [(0, 6000)]
    whole = fit_whitener([e], [[(0, 6000)]], 8)
    half, full = log_likelihood(whitener, [run]), log_likelihood(whole, [[(0, 6000)]])
    assert half == pytest.approx(0.5 * full, abs=0.05 * 6000)


def test_all_samples_judged_are_as_if_nothing_were_said():
    rng = np.random.default_rng(8)
    e, run = rng.standard_normal((2, 500)), [(0, 500)]
    same = Stretches(run, np.ones((2, 500), bool))
    plain, said = Whitener.white(np.ones(2), 1), fit_whitener([e], [same], 4)
    np.testing.assert_allclose(plain(e[None], same), plain(e[None], run))
    np.testing.assert_allclose(said.coefficients, fit_whitener([e], [run], 4).coefficients)


def test_what_an_axis_holds_at_rest_beyond_its_friction_is_told():
    """A brake that holds five times the friction of motion is no dry friction; friction that holds its own is."""
    model = load_model(ARM)
    for brake, told in ((1.0, False), (5.0, True)):
        search = searched(model, point_to_point(model, 9, 0.4, brake=brake))
        laws = [c for c in search.common if c.effect.name == "coulomb_friction"]
        unexplained = sticking(search, search.fit(laws))
        assert (unexplained is not None) == told
        if unexplained is not None:
            assert unexplained["location"]["kind"] == "joint" and "while it rests" in unexplained["region"]


def test_a_push_is_judged_by_what_motors_do_while_it_lasts():
    """One that begins and ends while an axis is held has only its edges beside that, and tells no size."""
    model = load_model(ARM)
    search = searched(model, point_to_point(model, 9, 0.4))
    push = next(c for c in all_candidates(search.problem, ["external_torque"]) if c.location["index"] == 2)
    time = search.problem.motions[0].time[:: search.problem.band.step]
    held = ~search.problem.runs[0].judged.any(axis=0)
    edges = np.flatnonzero(np.diff(np.r_[False, held, False].astype(int))).reshape(-1, 2)
    first, last = max(edges, key=lambda x: x[1] - x[0])
    middle = 0.5 * (time[first] + time[last - 1])
    for half, seen in ((0.2, False), (6.0, True)):
        assert _is_judged(search, replace(push, shape=(middle - half, middle + half, 0.0))) is seen
