"""What keeps a diagnosis from claiming too much: bursts of noise, coarse encoders, recordings that it has not seen."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from trials import loaded_trial, search_of

from cdm_pin import (
    asked,
    confirming,
    content,
    drifting,
    findings,
    judging,
    leftover,
    plainness,
    pruning,
    resolved,
    robust,
    sensor_noise,
    significance,
    unexplained,
)
from cdm_pin.bank import all_candidates
from cdm_pin.base import base_parameters, massive_columns
from cdm_pin.cable_effects import most_turns
from cdm_pin.candidates import Candidate, at_known_place
from cdm_pin.diagnose import diagnose
from cdm_pin.doubts import instants, offsets, sides, stretches, unsure_stretches
from cdm_pin.dynamics import inverse_dynamics
from cdm_pin.effects import CATALOGUE
from cdm_pin.explanation import Found, _nearly_brakes, explained, unsound
from cdm_pin.findings import absorbed, is_above_steps, is_known, is_plainer, sizes_in_errors, with_law_errors
from cdm_pin.friction_effects import dahl, dragged
from cdm_pin.likelihood import confined, likelihood_ratio
from cdm_pin.masses import likely_masses
from cdm_pin.model import load_model
from cdm_pin.patches import PATCHES
from cdm_pin.places import all_motor_places, guide_places, joint_places, pair_places
from cdm_pin.plainness import drives
from cdm_pin.polishing import is_provisional
from cdm_pin.problem import Problem, make_problem
from cdm_pin.recording import Recording
from cdm_pin.resolved import is_resolved
from cdm_pin.robust import around, bursts, robust_score
from cdm_pin.scores import Score, scored
from cdm_pin.search import Search
from cdm_pin.sensor_noise import SensorNoise, motion_limit
from cdm_pin.settings import Settings
from cdm_pin.shapes import _white_slopes, loosened, yielding
from cdm_pin.signals import prepare
from cdm_pin.signals_filters import lowpass, window_length
from cdm_pin.spectra import Spectrum, spectrum
from cdm_pin.unexplained import _is_one, is_far, ringing_torque, wandering_travel
from cdm_pin.wording import clause


def test_bursts_count_where_the_effect_acts():
    """Even noise counts once; ten times as large where alone the effect acts, a hundred times; and in runs."""
    rng, n = np.random.default_rng(0), 6000
    noise, steady = rng.normal(size=n), rng.normal(size=n)
    assert bursts(steady, noise) < 1.1
    short = steady * (np.arange(n) < n // 10)
    assert 30 < bursts(short, noise * np.where(np.arange(n) < n // 10, 10.0, 1.0)) < 200
    assert bursts(short, noise * np.where(np.arange(n) < n // 10, 1.0, 10.0)) < 1.2
    assert bursts(steady, 0.5 * noise) == 0.0
    alike = np.repeat(rng.normal(size=n // 24), 24)
    assert bursts(np.ones(n), alike) > 10


def test_noise_that_is_small_for_as_long_as_a_push_lasts_is_judged_by_what_is_around():
    """A minute of noise three times as large in the middle, but not in the two seconds of a push, by chance."""
    noise, own = np.random.default_rng(0).standard_normal(600), np.zeros(600)
    noise[250:350] *= 3.0
    own[290:310] = 1.0
    noise[290:310] *= 0.3
    assert bursts(own, noise) < 1.5 < 3.0 < bursts(around(own, 20), noise)


def test_an_offset_below_half_a_step_is_no_evidence(tmp_path):
    """What an encoder's zero may be off by lowers the statistic of a constant, not that of friction."""
    model, runs, _, _ = loaded_trial(tmp_path, 2, n_links=2, effects=0, positions="joint", bits=14, duration=30.0)
    problem = make_problem(model, runs)
    search = Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())
    fit = search.fit([])
    (first, *_) = all_candidates(problem, ["encoder_offset"])
    step = problem.sensors.joint_steps[0]
    assert step == pytest.approx(2 * np.pi / 2**14, rel=1e-6)
    column = fit.rest(search.white(fit.whitener, search.columns(first)))
    assert offsets(search, fit)[0] == pytest.approx(0.5 * step * column[0])
    hidden = fit.residual + 0.4 * step * column[0]
    shifted = type(fit)(**{**fit.__dict__, "residual": hidden})
    assert robust_score(search, shifted, first).statistic < 1.0 + search.score(fit, first).statistic


@pytest.mark.parametrize("share", [0.1, 0.2, 0.35])
def test_noise_smooths_the_stairs_of_a_torque(share):
    """A sweep over many steps, rounded a thousand times with other noise, is off by no more than that on average."""
    model, rng, step = load_model("urdf/cdm2.yaml"), np.random.default_rng(0), 0.5
    t = np.arange(6000) / 200.0
    torque = np.stack([9.0 * np.sin(0.7 * t), 7.0 * np.cos(0.5 * t)], axis=1)
    noise = share * step * rng.normal(size=(1000, len(t)))
    off = np.mean(np.round((torque[:, 0] + noise) / step) * step - torque[:, 0] - noise, axis=0)
    logged = np.round((torque + share * step * rng.normal(size=torque.shape)) / step) * step
    signals = SimpleNamespace(logged={"motor_torque": logged}, rate=200.0, steps={"motor_torque": np.full(2, step)})
    stairs = SensorNoise(model, (signals,), None).torque_stairs
    assert 0.5 * stairs[0] < np.sqrt(2.0) * np.std(off) < 1.1 * stairs[0]


@pytest.mark.slow
def test_laws_that_hold_elsewhere_stand_for_a_correction(tmp_path):
    """A function of a joint's speed is a little likelier than bearing friction and drag where these were learned."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 102735320660512, effects=2, at_least=50.0, bits=14)
    content = diagnose(model, runs, unseen).content
    assert content["verdict"] == "missing_physics"
    assert {f["effect"] for f in content["findings"]} == {"quadratic_drag", "load_dependent_friction"}


@pytest.mark.parametrize(("line", "low", "high"), [(0.0, 0.2, 2.0), (2e-3, 5.9, 6.5)])
def test_accelerations_are_heard_up_to_where_the_motion_ends(line, low, high):
    """A slow motion under encoder noise ends early; a vibration at 6 Hz that stands out is part of it."""
    model = load_model("urdf/planar3.yaml")
    rng, t = np.random.default_rng(0), np.arange(6000) / 100
    q = 0.6 * np.sin(2 * np.pi * np.array([0.2, 0.13, 0.27]) * t[:, None] + 1.0)
    q = q + line * np.sin(2 * np.pi * 6.0 * t)[:, None] + 1e-4 * rng.normal(size=q.shape)
    signals = prepare(Recording(t, {"joint_position": q, "motor_torque": rng.normal(size=q.shape)}), model)
    assert low < motion_limit(model, signals, 9.0) < high


def test_what_is_quick_at_the_end_alone_is_heard():
    """A slow motion of 40 s that vibrates at 6 Hz in its last 6 s: segments of a spectrum reach to the end."""
    model = load_model("urdf/planar3.yaml")
    rng, t = np.random.default_rng(0), np.arange(4000) / 100
    q = 0.6 * np.sin(2 * np.pi * np.array([0.2, 0.13, 0.27]) * t[:, None] + 1.0)
    q = q + 4e-3 * (np.clip(t - 34.0, 0.0, 1.0) * np.sin(2 * np.pi * 6.0 * t))[:, None]
    q = q + 1e-4 * rng.normal(size=q.shape)
    signals = prepare(Recording(t, {"joint_position": q, "motor_torque": rng.normal(size=q.shape)}), model)
    assert 5.9 < motion_limit(model, signals, 9.0) < 7.5


@pytest.mark.parametrize(("n", "most"), [(16000, 6400), (100, 6400), (6400, 6400), (6401, 6400), (24000, 16384)])
def test_segments_reach_to_the_end(n, most):
    size = window_length(n, most)
    step = size - size // 2
    assert size <= most and n - (size + (n - size) // step * step) < 2 * n / size


def test_friction_of_a_contact_takes_no_place_that_it_cannot_have():
    """What two motors share along a cable over a guide is the cable's: dry friction is its friction there."""
    model = load_model("urdf/planar3.yaml")
    guide = guide_places(model)[0]
    own = np.array(guide.weights(model))
    (i, k) = np.flatnonzero(own)[:2]
    pair = next(p for p in pair_places(model) if set(p.index) == {i, k})
    for name, law in (("coulomb_friction", "cable_friction"), ("hysteresis", "hysteresis")):
        shape = (0.05,) if name == "coulomb_friction" else (0.05, 0.0)
        moved = at_known_place(Candidate(CATALOGUE[name], pair, (*shape, own[i] / own[k])), model)
        assert (moved.name, moved.place.location["kind"]) == (law, "cable")
        assert moved.place in moved.effect.places(model)


def test_what_only_unseen_recordings_show_is_said(tmp_path):
    """A bump that the training never reaches: nothing is named, nor is the model called complete."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 945, out_of_catalogue=True)
    content = diagnose(model, runs, unseen).content
    assert content["verdict"] == "unexplained" and not content["findings"]
    assert content["unexplained"]["location"] == {"kind": "joint", "index": 3}
    assert "in unseen recordings alone" in content["unexplained"]["region"]


@pytest.mark.slow
def test_unseen_recordings_second_what_errors_of_laws_could_explain(tmp_path):
    """Base tilt beside far larger friction and a spring: the training alone would not claim it."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 948, effects=3)
    found = {f["effect"] for f in diagnose(model, runs, unseen).content["findings"]}
    assert found == {"capstan_friction", "joint_spring", "base_tilt"}


def test_gains_do_not_live_on_the_torque_of_what_they_replace(tmp_path):
    """A spring and a wrong gain: two gains on the torque of a spring that is gone fit nothing."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 44563109840545, effects=3, at_least=50.0, bits=17)
    content = diagnose(model, runs, unseen).content
    assert content["findings"][0]["effect"] == "joint_spring"
    assert np.max(np.divide(*[content["fit"]["holdout"][k] for k in ("rmse_augmented", "noise_floor")])) < 3.0


@pytest.mark.slow
def test_no_constant_is_an_error_of_a_law(tmp_path):
    """Friction that differs by a third either way, in slow noise: the sign alone leaves a constant that noise hides."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 198739516215584, effects=2, at_least=50.0, bits=14)
    content = diagnose(model, runs, unseen).content
    assert content["verdict"] == "missing_physics"
    assert {f["effect"] for f in content["findings"]} == {"asymmetric_friction", "encoder_offset"}


@pytest.mark.slow
def test_shapes_that_only_unseen_recordings_tell_well_are_no_fault(tmp_path):
    """A peak of friction at speeds that the training hardly has."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 264741712892203, effects=1, at_least=50.0, bits=14)
    content = diagnose(model, runs, unseen).content
    assert content["verdict"] == "missing_physics"
    assert [f["effect"] for f in content["findings"]] == ["stribeck_friction"]


@pytest.mark.slow
def test_a_refinement_that_masses_hide_is_listed(tmp_path):
    """Unequal friction whose difference the masses take up: equal friction is named, the other beside it."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 171121126677185, effects=1, at_least=50.0, bits=17)
    (finding,) = diagnose(model, runs, unseen).content["findings"]
    assert {"effect": "asymmetric_friction", "location": {"kind": "joint", "index": 3}} in [
        {k: x[k] for k in ("effect", "location")} for x in [finding, *finding["indistinguishable_from"]]
    ]


@pytest.mark.slow
def test_a_weak_push_does_not_pass_for_slow_noise(tmp_path):
    """Noise estimated with the push in it looks slow; the likelihood of both tells that noise would do so always."""
    model, runs, unseen, truth = loaded_trial(
        tmp_path, 17, effects=["external_torque"], visibility=13.0, n_links=2, noise="white"
    )
    problem = make_problem(model, runs)
    search = Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())
    start, end = truth["effects"][0]["parameters"]["time"]
    place = joint_places(model)[1]
    push, other = (
        Candidate(CATALOGUE["external_torque"], place, (start + shift, end + shift, 0.0)) for shift in (0.0, 12.0)
    )
    whitener, ratio = likelihood_ratio(search, [], push)
    assert ratio > 1.5 * search.score(search.fit([]), push).statistic
    assert search.score(search.fit([], whitener), push).statistic > ratio > 60.0
    assert likelihood_ratio(search, [], other)[1] < 15.0
    (finding,) = diagnose(model, runs, unseen).content["findings"]
    assert (finding["effect"], finding["location"]["index"]) == ("external_torque", 2)


def test_viscous_friction_of_a_slow_motion_does_not_pass_for_slow_noise():
    """A whole recording as slow as noise may be: the model with the friction is fitted in noise that is not slow."""
    model = load_model("urdf/planar3.yaml")
    rng, n, rate = np.random.default_rng(3), 3000, 25.0
    t = np.arange(n) / rate
    waves = 2 * np.pi * np.array([0.011, 0.023, 0.037])
    phase, size = rng.uniform(0, 6, (3, 3)), rng.uniform(0.2, 0.5, (3, 3))
    q, v, a = (
        np.einsum("jk,tjk->tj", size * waves**k, np.sin(waves * t[:, None, None] + phase + k * np.pi / 2))
        for k in range(3)
    )
    friction = np.array([0.0, 30.0, 0.0]) * v
    torque = model.motor_torque(inverse_dynamics(model, q, v, a) + friction)
    channels = {"joint_position": q, "motor_torque": torque + 0.005 * rng.standard_normal(torque.shape)}
    search = Search(
        make_problem(model, [Recording(t, channels)]),
        base_parameters(model, columns=massive_columns(model)),
        Settings(),
    )
    law = Candidate(CATALOGUE["viscous_friction"], joint_places(model)[1])
    whitener, ratio = likelihood_ratio(search, [], law)
    assert ratio > 100.0
    assert search.score(search.fit([], whitener), law).beta[0] == pytest.approx(30.0, rel=0.02)


@pytest.mark.parametrize(
    ("speed", "size", "place", "held"),
    [(0.0, 0.5, 0, True), (0.0, 1.5, 0, False), (1.0, 0.5, 0, False), (0.0, 0.5, 1, False)],
)
def test_friction_may_hold_a_push_at_standstill(speed, size, place, held):
    """A push that dry friction of its own joint could bring where it rests is none; a larger one, or in motion, is."""
    model = load_model("urdf/planar3.yaml")
    time = np.linspace(0.0, 10.0, 1000)
    v = np.where((time > 4) & (time < 6), speed, 1.0)[:, None] * np.ones(3)
    q = np.cumsum(v, axis=0) * (time[1] - time[0])
    speeds = {"v": v, "joint_speeds": v, "v_m": v, "velocity_noise": np.full(3, 1e-4)}
    known = {"q": q, "q_m": q, "position_error": lambda A, B: 0.0, "rate": 100.0}
    motion = SimpleNamespace(model=model, index=0, time=time, swing=None, **known, **speeds)
    search = SimpleNamespace(problem=SimpleNamespace(model=model, motions=[motion]))
    places = joint_places(model)
    fit = SimpleNamespace(
        effects=[Candidate(CATALOGUE["coulomb_friction"], places[place], (0.01,))], beta=[np.array([1.0])]
    )
    push = Candidate(CATALOGUE["external_torque"], places[0], (4.2, 5.8, 0.0))
    assert resolved._is_held(search, push, size, fit) is held


@pytest.mark.parametrize("stands", [True, False])
def test_a_push_has_to_stand_beside_what_is_left(monkeypatch, stands):
    """What was significant beside a finding that was withdrawn may be none alone; other laws are judged elsewhere."""
    places = joint_places(load_model("urdf/planar3.yaml"))
    effects = [
        Candidate(CATALOGUE["external_torque"], places[0], (1.0, 2.0, 0.0)),
        Candidate(CATALOGUE["viscous_friction"], places[1]),
    ]
    search = SimpleNamespace(without=lambda fit, j: None, score=lambda fit, candidate: None)
    found = [SimpleNamespace(candidate=c) for c in effects]
    explanation = SimpleNamespace(search=search, found=found, fit=None, bank=None)
    monkeypatch.setattr(pruning, "holds", lambda *_: stands)
    monkeypatch.setattr(pruning, "explained", lambda search, bank, kept: kept)
    assert pruning.still_standing(explanation) == (explanation if stands else effects[1:])


def test_what_a_base_parameter_may_as_well_be_starts_at_its_own_link():
    """A rotor, a payload on its own link, one at the end, and only then what wrong sensors would do."""
    names = [("torque_gain_error", 1), ("payload", 4), ("payload", 2), ("payload", 3), ("rotor_inertia", 2)]
    effects = [{"effect": name, "location": {"index": i}} for name, i in names]
    ranked = sorted(effects, key=lambda e: content._likeness(e, links=(2, 3, 4), last=4))
    assert [(e["effect"], e["location"]["index"]) for e in ranked] == [names[k] for k in (2, 4, 1, 3, 0)]


@pytest.mark.parametrize("shows", [True, False])
def test_unseen_recordings_do_not_speak_against_what_they_cannot_show(tmp_path, monkeypatch, shows):
    """A play of a twentieth of a degree beside drifting torques; unseen recordings confirm it where they could."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 40, effects=["backlash"], positions="both", n_links=2)
    if not shows:  # with the play they are no likelier
        for module in (confirming, content):
            monkeypatch.setattr(module, "change_unseen", lambda judge, explanation, j: 0.0)
        monkeypatch.setattr(confirming, "deviance_unseen", lambda judge, fit: float(len(fit.effects)))
    (finding,) = diagnose(model, runs, unseen).content["findings"]
    assert finding["effect"] == "backlash"
    assert finding.get("unconfirmed", False) != shows
    assert ("(unconfirmed)" in clause(finding)) != shows


def test_static_friction_of_many_times_the_sliding_one_is_no_law():
    place = joint_places(load_model("urdf/cdm2.yaml"))[0]
    candidate = Candidate(CATALOGUE["stribeck_friction"], place, (0.01, 0.1))
    for peak, fits in ((0.5, True), (3.0, True), (9.0, False)):
        assert candidate.is_plausible(np.array([1.0, peak])) == fits


@pytest.mark.parametrize(
    ("width", "peak", "fits"), [(0.2, 0.0, False), (0.2, 0.1, True), (0.4, 0.1, False), (0.4, 0.2, True)]
)
def test_a_peak_has_to_rise_above_sliding(width, peak, fits):
    """Where the sign is blurred over much of a peak, a small one does not show."""
    place = joint_places(load_model("urdf/cdm2.yaml"))[0]
    candidate = Candidate(CATALOGUE["stribeck_friction"], place, (width * 0.1, 0.1))
    assert candidate.is_plausible(np.array([1.0, peak])) == fits


def test_a_motor_that_hardly_turns_with_a_joint_is_not_coupled():
    law = CATALOGUE["transmission_coupling"]
    place = law.places(load_model("urdf/cdm2.yaml"))[0]
    for ratio, fits in ((0.4, True), (-0.4, True), (-0.009, False)):
        candidate = Candidate(law, place, (0.01, ratio))
        assert candidate.is_plausible(np.array([7.0, 0.0, 0.0])) == fits


def test_a_peak_that_its_own_sign_undoes_is_none():
    """What the sign of a velocity leaves open may blur Stribeck's peak, not drive at standstill or take it away."""
    place = joint_places(load_model("urdf/cdm2.yaml"))[0]
    candidate = Candidate(CATALOGUE["stribeck_friction"], place, (0.005, 0.05), 0.01)
    for open_part, fits in (((0.0, 0.0), True), ((0.2, -0.2), True), ((-17.0, -25.0), False)):
        beta = np.array([1.0, 0.5, *open_part])
        assert candidate.is_plausible(beta) == fits, open_part


@pytest.mark.parametrize("name", ["asymmetric_friction", "position_dependent_friction"])
def test_friction_that_drives_is_none(name):
    """One that brakes one way and drives the other, or drives at some angle, is not what it is called."""
    place = joint_places(load_model("urdf/cdm2.yaml"))[0]
    candidate = Candidate(CATALOGUE[name], place, (0.01, 0.1)[: 1 + (name == "position_dependent_friction")])
    for other, fits in ((0.5, True), (1.4, False), (-1.4, False)):
        beta = np.array([1.0, other, 0.0][: len(candidate.effect.signs)])
        assert candidate.is_plausible(beta) == fits


def test_a_peak_beside_other_friction_refines_nothing():
    """At a place where dry friction has a law already, unequal or drifting friction may have its share, a peak not."""
    place = joint_places(load_model("urdf/cdm2.yaml"))[1]
    dry = Candidate(CATALOGUE["load_dependent_friction"], place, (0.01,))
    for name, shape, own, fits in (
        ("asymmetric_friction", (0.01,), 0.0, True),
        ("stribeck_friction", (0.01, 0.1), 0.0, False),
        ("stribeck_friction", (0.01, 0.1), 0.2, True),
    ):
        assert Candidate(CATALOGUE[name], place, shape).is_plausible(np.array([own, 0.2]), [dry]) == fits


def test_a_spring_that_stiffens_may_have_any_slope_at_zero():
    """Where the zero of the angle lies says nothing about a polynomial; a spring of one stiffness pulls back."""
    place = joint_places(load_model("urdf/cdm2.yaml"))[0]
    gram = np.diag([1.0, 1.0, 1.0, 1.0])
    for shape, k, known in ((0.0, 2, False), (1.0, 4, True)):
        own = Candidate(CATALOGUE["joint_spring"], place, (shape,))
        told = scored(gram[:k, :k], np.array([-0.2, 5.0, 0.0, 9.0])[:k], np.ones(k), np.ones(k), own.signs)
        assert np.isfinite(told.statistic) == known


@pytest.mark.parametrize(
    ("limits", "fits"), [((1, 0, 0, 2, 0), True), ((0, 0, 1, 0, 0), True), ((0, 0, 1, 2.5, 6), False)]
)
def test_a_hysteresis_yields(limits, fits):
    """Elements that hardly give way within its own distance make a spring, whatever they would do beyond."""
    place = joint_places(load_model("urdf/cdm2.yaml"))[0]
    candidate = Candidate(CATALOGUE["hysteresis"], place, (2.0, 0.0), 1.0)
    assert candidate.is_plausible(np.array(limits, float)) == fits


@pytest.mark.parametrize(("extra", "fits"), [(0.8, True), (-0.9, True), (-1.4, False)])
def test_friction_that_drifts_brakes_from_the_start(extra, fits):
    """It may have been next to nothing at first, but did not drive."""
    place = joint_places(load_model("urdf/cdm2.yaml"))[0]
    candidate = Candidate(CATALOGUE["friction_drift"], place, (0.01, 20.0))
    assert candidate.is_plausible(np.array([1.0, extra])) == fits


@pytest.mark.parametrize("slope", [3.0, -0.5, -3.0])
def test_a_spring_pulls_back(tmp_path, slope):
    """One that stiffens does so on the whole, however it may be about its middle; what pushes on surely is none."""
    model, runs, _, _ = loaded_trial(tmp_path, 2, n_links=2, effects=0, positions="joint", duration=10.0)
    problem = make_problem(model, runs)
    place = joint_places(model)[0]
    spring = Candidate(CATALOGUE["joint_spring"], place, (1.0,))
    weights = spring.least(problem.motions)
    q = problem.motions[0].q[:, 0]
    low, high = np.percentile(q, [2.5, 97.5])
    assert weights @ np.array([0.0, 5.0, 0.0, 1.0]) == pytest.approx(high**2 + high * low + low**2)
    beta = np.array([slope, 0.0, 0.0, 0.0])
    both = SimpleNamespace(base=np.zeros(1), beta=(beta,), covariance=np.diag([9.0, *np.full(4, 0.25)]))
    stub = SimpleNamespace(problem=problem, fit=lambda effects, whitener: both)
    without = SimpleNamespace(effects=(), whitener=None)
    assert drives(stub, without, spring) == (slope < -1.5)
    assert not drives(stub, without, Candidate(CATALOGUE["torque_offset"], place))


def test_a_constant_that_nothing_tells_leaves_friction_asymmetric_or_not():
    """Beside drifting zeros the constant of asymmetric friction may come out as anything; it may be none as well."""
    place = joint_places(load_model("urdf/cdm2.yaml"))[0]
    law = Candidate(CATALOGUE["asymmetric_friction"], place, (0.01,))
    columns = np.array([[3.0, 0.0, 0.0], [0.0, 1e-3, 0.0]])
    fit = SimpleNamespace(effects=(), rest=lambda W: W, residual=np.array([6.0, 0.5, 0.0]))
    wild = Score(36.25, 2, np.array([2.0, 500.0]), 1.0, 3.0)
    own = confined(fit, law, columns, wild)
    assert own.statistic == pytest.approx(36.0, abs=0.1) and abs(own.beta[1]) <= own.beta[0]
    tame = replace(wild, beta=np.array([2.0, 1.0]))
    assert confined(fit, law, columns, tame) is tame
    backwards = SimpleNamespace(**vars(fit) | {"residual": -fit.residual})
    assert confined(backwards, law, columns, wild).statistic == -np.inf


def test_shapes_give_way_to_what_is_scored_beside_them(tmp_path):
    """Dry friction whose sign is too wide takes up a part of what a second law explains; given way, it does not."""
    model, runs, _, _ = loaded_trial(tmp_path, 7, n_links=2, effects=["coulomb_friction"], at_least=50.0, duration=20.0)
    problem = make_problem(model, runs)
    search = Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())
    friction, *_ = all_candidates(problem, ["coulomb_friction"])
    fit = search.fit([replace(friction, shape=(3.0 * friction.shape[0],))])
    loose = loosened(search, fit)
    slopes = _white_slopes(search, fit)
    assert loose.Q.shape[1] == fit.Q.shape[1] + 1 == len(slopes) + fit.Q.shape[1]
    np.testing.assert_allclose(loose.Q.T @ loose.Q, np.eye(loose.Q.shape[1]), atol=1e-8)
    np.testing.assert_allclose(loose.rest(slopes), 0.0, atol=1e-6 * np.linalg.norm(slopes))
    assert np.linalg.norm(loose.residual) <= np.linalg.norm(fit.residual)
    assert loosened(search, search.fit([])).Q.shape[1] == 0


@pytest.mark.parametrize(
    ("follows", "exact", "provisional"), [(True, False, True), (True, True, False), (False, False, False)]
)
def test_columns_about_other_effects_are_provisional(follows, exact, provisional):
    """Where effects changed, first-order columns that depend on them are not yet what they will be."""
    old, new = (
        SimpleNamespace(key="old"),
        SimpleNamespace(key="new", effect=SimpleNamespace(follows=follows, exact=exact)),
    )
    assert is_provisional([old], [new]) == provisional
    assert not is_provisional([new], [new])


def test_no_law_stands_for_what_was_withdrawn_and_explains_more(monkeypatch):
    """A law that a withdrawn one explains away is let in only if it explains as much; one elsewhere is.

    Nothing that was withdrawn comes back by itself.
    """
    worth = {"withdrawn": 20.0, "weaker": 10.0, "equal": 19.0, "elsewhere": 8.0}

    def gain(search, fit, candidate, score):
        return worth[candidate] if candidate == "elsewhere" or "withdrawn" not in fit else 0.0

    monkeypatch.setattr(asked, "gain", gain)
    monkeypatch.setattr(asked, "refine", lambda search, fit, c: (c, None))
    monkeypatch.setattr(asked, "passes", lambda search, candidate, score, weight, fit: True)

    class Effects(list):
        whitener = None

    search = SimpleNamespace(
        settings=Settings(),
        fit=lambda effects, whitener=None: Effects(effects),
        score=lambda fit, c: None,
    )
    for names, expected in (
        (["weaker", "equal"], "equal"),
        (["weaker"], None),
        (["weaker", "elsewhere"], "elsewhere"),
        (["withdrawn"], None),
    ):
        laws = [(Law(name), None, 0.1) for name in names]
        monkeypatch.setattr(asked, "leading", lambda search, fit, bank, most, taken, laws=laws: laws)
        assert asked.next_law(search, None, [], [Law("withdrawn")]) == expected


def test_what_a_law_leaves_open_is_no_part_of_it():
    place = joint_places(load_model("urdf/cdm2.yaml"))[0]
    dry = Candidate(CATALOGUE["coulomb_friction"], place, (0.01,))
    assert replace(dry, detail=0.02, creeps=True).bare == dry
    stops = Candidate(CATALOGUE["hysteresis"], place, (0.1, 0.0), 1.0)
    assert stops.bare is stops  # its elements are physics


def test_a_sign_that_coarse_encoders_blur_makes_no_peak(tmp_path):
    """Dry friction: with a peak, two hundredths of it are said better."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 9011, effects=["coulomb_friction"], bits=14)
    (finding,) = diagnose(model, runs, unseen).content["findings"]
    assert (finding["effect"], finding["location"]) == ("coulomb_friction", {"kind": "joint", "index": 2})


def test_what_the_findings_take_up_is_not_called_absorbed_by_masses(tmp_path):
    """Drifting friction takes the place of dry friction there; masses cannot be it."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 3, effects=["friction_drift"], n_links=2, noise="white")
    told = diagnose(model, runs, unseen)
    assert [f["effect"] for f in told.content["findings"]] == ["friction_drift"]
    assert not {e["effect"] for e in absorbed(told.explanation.search, told.explanation)} & {"coulomb_friction"}
    rows = [row for row in told.content["sensitivity"] if row["effect"] == "coulomb_friction"]
    hidden = [row for row in rows if row["visible_fraction"] < 0.01]
    assert hidden and not any(row["absorbed_by"] for row in hidden)


@pytest.mark.slow
def test_no_law_that_needs_absurd_masses(tmp_path):
    """A spring that warms up: one of fifty times its strength, which a heavy link cancels, is no explanation."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 49994007219907, effects=1, out_of_catalogue=True, bits=14)
    content = diagnose(model, runs, unseen).content
    assert content["verdict"] == "unexplained" and content["findings"] == []
    assert content["unexplained"]["location"] == {"kind": "joint", "index": 1}


@pytest.mark.slow
def test_masses_a_little_off_stretch_cables(tmp_path):
    """The travel of a soft cable shows the error of the masses; no eccentric pulley is found in it."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 254637549274179, effects=1)
    findings = diagnose(model, runs, unseen).content["findings"]
    assert [(f["effect"], f["location"]["index"]) for f in findings] == [("cable_elasticity", 1)]


def test_masses_stretch_cables_by_their_torque(tmp_path):
    """What a parameter of the rigid body does to the travel of a soft cable is the change of the elastic column."""
    model, runs, _, _ = loaded_trial(tmp_path, 5, effects=["cable_elasticity"], positions="both", n_links=2)
    problem = make_problem(model, runs)
    search = Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())
    (soft, *_) = all_candidates(problem, ["cable_elasticity"])
    fit = search.fit([soft])
    fit = replace(fit, beta=(np.array([fit.beta[0][0], 0.0]),))  # no damper
    (rows,) = stretches(search, fit)
    for k in range(len(search.base.columns)):
        there = search.at(np.eye(len(search.base.columns))[k], [(soft, fit.beta[0])])
        change = np.tensordot(fit.beta[0], there.columns(soft)[0] - search.columns(soft)[0], 1)
        inside = slice(*problem.segments[0][0])
        mine, other = rows[k][2:, inside], change[2:, inside]
        assert np.allclose(mine, other, atol=1e-2 * np.abs(other).max() + 1e-12)
    left = unsure_stretches(search, search.fit([soft]))
    assert left.shape[1] == fit.n_rows and np.isfinite(left).all()


def test_no_law_takes_the_place_of_two(monkeypatch):
    """One that is as good as either of two, and simpler, stands once."""
    places = joint_places(load_model("urdf/cdm2.yaml"))
    spring, tilt = (Candidate(CATALOGUE[name], places[1]) for name in ("joint_spring", "encoder_offset"))
    simple = Candidate(CATALOGUE["viscous_friction"], places[1])
    search = SimpleNamespace(
        settings=Settings(),
        problem=SimpleNamespace(model=None),
        size=lambda c: 1 + (c is not simple),
        noise=lambda a: None,
        without=lambda fit, j: SimpleNamespace(effects=()),
        score=lambda without, candidate: score,
    )
    score = Score(100.0, 1, np.ones(1), 1.0, 1.0)
    found = [Found(c, score, 50.0, -50.0, lambda: ((simple, 0.0),)) for c in (spring, tilt)]

    def explained(search, bank, accepted):
        return SimpleNamespace(search=search, found=[Found(c, own[c is simple], 50.0, -50.0) for c in accepted])

    own = [score, score]
    monkeypatch.setattr("cdm_pin.explanation.explained", explained)
    monkeypatch.setattr("cdm_pin.explanation.tuned", lambda search, a, noise: a)
    explanation = SimpleNamespace(
        search=search, found=found, fit=None, bank=SimpleNamespace(laws=SimpleNamespace(candidates=()))
    )
    monkeypatch.setattr(plainness, "evidence", lambda search, without, candidate, size: 0.0)
    assert [f.candidate for f in plainness.simplest(explanation).found] == [simple, tilt]
    own[True] = replace(score, statistic=-np.inf)  # beside the other, it is no such law any more
    assert plainness.simplest(explanation) is explanation
    own[True] = score
    monkeypatch.setattr(plainness, "evidence", lambda search, without, candidate, size: -9.0 * (candidate is simple))
    assert plainness.simplest(explanation) is explanation


class Law(str):
    """A law that is its own key."""

    key = property(str)


@pytest.mark.parametrize("kept_out", [[], [Law("kept out")], [Law("as wrong")]])
def test_what_failed_only_beside_another_stays(monkeypatch, kept_out):
    """Without the first that is withdrawn the unseen recordings are likeliest; the second then helps.

    So may a law that the withdrawn one kept out; one that does not help is not asked for again.
    """
    worth = {"wrong": -5.0, "right": -1.0, "sound": 9.0, "kept out": 5.0, "as wrong": -5.0}
    search = SimpleNamespace(
        settings=Settings(), most=6, without=lambda fit, j: -worth[fit[j]], renewed=lambda bank: bank
    )
    helps = {"wrong": False, "as wrong": False, "sound": True, "kept out": True}

    def explanation(names):
        found = tuple(SimpleNamespace(candidate=Law(name)) for name in names)
        return SimpleNamespace(search=search, found=found, fit=list(names), bank=None)

    def next_law(search, bank, effects, but):
        assert "wrong" in but
        return next((law for law in kept_out if law not in effects and law not in but), None)

    replaced = {
        "helps": lambda judge, e, j: helps.get(e.fit[j], "wrong" not in e.fit),
        "_reconsidered": lambda judge, e: e,
        "patch": lambda search, bank, effects: None,
        "deviance_unseen": lambda judge, fit: -fit,
        "next_law": next_law,
        "settled": lambda search, effects: (search, effects),
        "explained": lambda search, bank, effects: explanation(effects),
        "judge_of": lambda seen, e: seen,
        "_tied": lambda judge, e: judge,
        "_restricted": lambda e, kept: explanation([f.candidate for f in kept]),
    }
    for name, value in replaced.items():
        monkeypatch.setattr(judging, name, value)
    left = judging._judged(SimpleNamespace(problem=None), explanation(["right", "wrong", "sound"]))
    assert [f.candidate for f in left.found] == ["right", "sound", *(law for law in kept_out if helps[law])]


@pytest.mark.parametrize("unseen", [10.0, 990.0])
def test_the_unseen_recordings_choose_between_laws(monkeypatch, unseen):
    """Play that is never crossed in the training is an offset there; where it is crossed unseen, it is play."""
    model = load_model("urdf/cdm2.yaml")
    offset, play = (
        Candidate(effect, effect.places(model)[1], shape)
        for effect, shape in ((CATALOGUE["encoder_offset"], ()), (CATALOGUE["backlash"], (0.1,)))
    )
    search = SimpleNamespace(
        problem=SimpleNamespace(torque=True), size=lambda c: 1 + len(c.shape), fit=lambda effects, whitener: effects
    )
    judge = SimpleNamespace(body=lambda whitener: SimpleNamespace(data=np.zeros(100)))
    monkeypatch.setattr(judging, "deviance_unseen", lambda judge, effects: unseen if play in effects else 1000.0)
    monkeypatch.setattr(judging, "explained", lambda search, bank, effects: effects)
    found = Found(offset, Score(500.0, 1, np.ones(1), 1.0, 1.0), 240.0, -200.0, lambda: ((play, -0.1),))
    given = SimpleNamespace(search=search, found=(found,), fit=SimpleNamespace(whitener=None), bank=None)
    chosen = judging._reconsidered(judge, given)
    assert chosen == [play] if unseen < 100.0 else chosen is given


@pytest.mark.parametrize(("named", "difference"), [(True, -9.0), (True, -60.0), (False, -9.0)])
def test_the_unseen_recordings_may_choose_a_finer_law(monkeypatch, named, difference):
    """An eccentric pulley has a phase more than a torque's offset: both recordings together have to ask for it.

    In the place of what has no name comes nothing finer.
    """
    model = load_model("urdf/cdm2.yaml")
    offset, pulley = (
        Candidate(e, e.places(model)[0]) for e in map(CATALOGUE.get, ("torque_offset", "pulley_eccentricity"))
    )
    offset = offset if named else replace(offset, effect=PATCHES["unnamed_time"])
    search = SimpleNamespace(
        problem=SimpleNamespace(torque=True), size=lambda c: 1 + (c is pulley), fit=lambda effects, whitener: effects
    )
    judge = SimpleNamespace(body=lambda whitener: SimpleNamespace(data=np.zeros(1000)))
    monkeypatch.setattr(judging, "deviance_unseen", lambda judge, effects: 950.0 if pulley in effects else 1000.0)
    monkeypatch.setattr(judging, "explained", lambda search, bank, effects: effects)
    monkeypatch.setattr(judging, "ONCE", ())
    found = Found(offset, Score(500.0, 1, np.ones(1), 1.0, 1.0), 240.0, -200.0, lambda: ((pulley, difference),))
    given = SimpleNamespace(search=search, found=(found,), fit=SimpleNamespace(whitener=None), bank=None)
    chosen = judging._reconsidered(judge, given)
    assert chosen == [pulley] if named and difference > -15.0 else chosen is given


def test_a_law_as_simple_as_another_is_no_refinement_of_it():
    places = joint_places(load_model("urdf/cdm2.yaml"))
    dry, loaded = (
        Candidate(CATALOGUE[f"{kind}_friction"], places[1], (0.01,)) for kind in ("coulomb", "load_dependent")
    )
    assert not is_plainer(SimpleNamespace(size=lambda c: 1), SimpleNamespace(), dry, loaded)


def test_what_swings_above_the_band_is_no_wander(monkeypatch):
    """It leaks into the band; where nothing swings, a wander is one, and where nothing wanders, nothing is asked."""
    told = {"wandering_torque": "wanders", "swinging_torque": "swings"}
    for name in told:
        monkeypatch.setattr(unexplained, name, lambda *_, name=name: told[name])
    assert unexplained.moving_torque(None, None) == "swings"
    told["swinging_torque"] = None
    assert unexplained.moving_torque(None, None) == "wanders"
    told |= {"wandering_torque": None, "swinging_torque": "swings"}
    assert unexplained.moving_torque(None, None) is None


@pytest.mark.slow
def test_masses_do_not_hide_a_swing_above_the_band(tmp_path):
    """A torque swings at 4.9 Hz, above the frequencies of the motion, and moves its joint."""
    settings = {"out_of_catalogue": True, "at_least": 50.0, "bits": 14}
    model, runs, unseen, _ = loaded_trial(tmp_path, 266510283360675, **settings)
    content = diagnose(model, runs, unseen).content
    assert content["verdict"] == "unexplained" and not content["findings"]
    assert content["unexplained"]["location"] == {"kind": "joint", "index": 3}
    assert "swings with time at 4.86 Hz" in content["unexplained"]["region"]


def test_a_narrow_peak_of_static_friction_is_hardly_known():
    """Where the sign of the velocity is as smooth as the peak is wide, the peak may be any size."""
    place = joint_places(load_model("urdf/cdm2.yaml"))[0]
    search = SimpleNamespace(problem=SimpleNamespace(kinematic=False, motions=[SimpleNamespace(swing=None)]))
    values = {name: {"value": 1.0, "std": 1e-6} for name in ("coulomb", "stribeck", "stribeck_velocity")}
    for width, least, most in ((0.001, 0.0019, 0.003), (0.1, 0.9, 1.1)):
        fit = SimpleNamespace(
            effects=[Candidate(CATALOGUE["stribeck_friction"], place, (width, 0.1))], beta=[np.ones(2)]
        )
        told = with_law_errors(search, fit, 0, np.eye(2), np.arange(2), values)
        assert least < told["stribeck"]["std"] < most
        assert told["coulomb"]["std"] < 0.003


@pytest.mark.slow
@pytest.mark.parametrize("effect, seed", [("stribeck_friction", 8404), ("coulomb_friction", 8402)])
def test_a_blurred_sign_does_not_rise_above_its_friction(tmp_path, effect, seed):
    """A peak that dry friction's free sign could take up is Stribeck's, with its size; dry friction has none."""
    model, runs, unseen, truth = loaded_trial(tmp_path, seed, effects=[effect])
    (finding,) = diagnose(model, runs, unseen).content["findings"]
    assert finding["effect"] == effect
    if effect == "stribeck_friction":
        own, true = finding["parameters"], truth["effects"][0]["parameters"]
        assert all(own[name]["value"] == pytest.approx(true[name], rel=0.05) for name in true)


@pytest.mark.parametrize(
    ("left", "smooth", "far"),
    [(0.5, 0.1, True), (0.5, 0.4, False), (0.04, 0.01, False)],  # structure; none; below what sensors bring
)
def test_structure_far_above_the_sensors_noise_is_far(monkeypatch, left, smooth, far):
    """What smooth functions of the state take out of a residual counts only far above the sensors' noise."""
    problem = SimpleNamespace(
        torque=True, segments=[[(0, 9)]], sensed=np.array([0.01]), model=SimpleNamespace(n_motors=1)
    )

    def left_over(search, effects, smooth):
        return None, SimpleNamespace(rms=np.array([smooth_rms if smooth else left]))

    smooth_rms = smooth
    monkeypatch.setattr(unexplained, "left_over", left_over)
    assert is_far(SimpleNamespace(problem=problem), SimpleNamespace(effects=())) == far


@pytest.mark.parametrize(("spread", "known"), [(0.1, True), (3.0, False)])
def test_a_coupling_has_a_ratio(spread, known):
    """What turns with a joint at any ratio turns with another as well, however sure its inertia is."""
    values = {"ratio": {"value": 1.0, "std": spread}, "inertia": {"value": 1e-3, "std": 1e-4}}
    coupling = SimpleNamespace(effect=SimpleNamespace(name="transmission_coupling", signs=(1,)))
    assert is_known(values, coupling, np.array([1e-3]), np.array([[1e-8]])) == known


@pytest.mark.parametrize(("stiffness", "known"), [(1.0, False), (5.0, True)])
def test_a_spring_has_a_stiffness(stiffness, known):
    """A constant torque, however sure, is no spring."""
    values = {"stiffness": {"value": stiffness, "std": 1.0}, "rest": {"value": -2.0, "std": 2.0}}
    spring = SimpleNamespace(effect=SimpleNamespace(name="joint_spring", signs=(1, 0)))
    assert is_known(values, spring, np.array([stiffness, 3.0]), np.diag([1.0, 1e-4])) == known


@pytest.mark.parametrize(
    ("level", "fall", "likeness", "known"),
    [(1.0, 1.0, 0.0, False), (1.0, 1.0, -0.999, True), (9.0, 1.0, 0.0, False), (9.0, 9.0, 0.0, True)],
)
def test_a_friction_that_falls_is_known_by_its_fall(level, fall, likeness, known):
    """Where it falls for as long as the recording lasts, what it falls to and what it falls by are only one number.

    One whose level is known and its fall is not may be any friction.
    """
    values = {"friction": {"value": level, "std": 1.0}, "extra": {"value": fall, "std": 1.0}}
    drift = SimpleNamespace(effect=SimpleNamespace(name="friction_drift", signs=(1, 1)))
    covariance = np.array([[1.0, likeness, 0.0], [likeness, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert is_known(values, drift, np.array([level, fall, 0.5]), covariance) == known


@pytest.mark.parametrize(("alone", "kept"), [(-1.0, 2), (1.0, 1)])
def test_a_coupling_takes_in_the_friction_of_its_motors(monkeypatch, alone, kept):
    """Estimated beside a friction at another ratio of the same two motors a coupling stays at a wrong one."""
    pair = SimpleNamespace(effect=CATALOGUE["coulomb_friction"], place=SimpleNamespace(is_pair=True))
    coupling = SimpleNamespace(effect=CATALOGUE["transmission_coupling"], place=SimpleNamespace(is_pair=False))
    search = SimpleNamespace(size=lambda c: 1 if c is pair else 2, renewed=lambda bank: bank)
    monkeypatch.setattr(pruning, "settled", lambda search, laws, rounds: (search, laws))
    monkeypatch.setattr(pruning, "likelihood", lambda search, laws: 0.0 if len(laws) == 2 else alone)
    monkeypatch.setattr(pruning, "explained", lambda search, bank, laws: listed(laws))

    def listed(laws):
        return SimpleNamespace(search=search, found=[SimpleNamespace(candidate=c) for c in laws], bank=search)

    found = pruning.coupled(listed([pair, coupling])).found
    assert len(found) == kept and (kept == 2 or found[0].candidate is coupling)


def test_friction_of_one_axis_is_no_coupling(tmp_path):
    """A coupling says as much at a ratio near none, with fewer laws; what turns with another joint stays one."""
    settings = {"effects": 0, "positions": "motor", "n_links": 2, "noise": "white", "bits": 17, "duration": 20.0}
    model, (recording,), _, _ = loaded_trial(tmp_path, 3, **settings)
    rate = 1.0 / np.median(np.diff(recording.time))
    speed = np.gradient(lowpass(recording.channels["motor_position"], rate, 12.0), 1.0 / rate, axis=0)
    joint = speed @ model.joint_from_motor[0]
    for ratio in (0.0, 0.4):
        turns = speed[:, 1] + ratio * joint
        rub = 0.3 * np.tanh(turns / 0.02) + 0.2 * turns
        torque = recording.channels["motor_torque"] + rub[:, None] * np.array([0.0, 1.0])
        search = search_of(model, replace(recording, channels=recording.channels | {"motor_torque": torque}))
        coupling = next(
            Candidate(c.effect, c.place, (0.02, ratio + 0.01, 1.0))
            for c in all_candidates(search.problem, ["transmission_coupling"])
            if c.location == {"kind": "motor", "index": 2, "joint": 1} and c.shape[2]
        )
        names = ["transmission_coupling", "viscous_friction", "coulomb_friction", "time_delay"]
        bank = search.bank(all_candidates(search.problem, names))
        laws = pruning.uncoupled(explained(search, bank, [coupling])).found
        said = {(f.candidate.effect.name, f.candidate.location["index"]) for f in laws}
        plain = {("viscous_friction", 2), ("coulomb_friction", 2)}
        assert said == (plain if not ratio else {("transmission_coupling", 2)})


@pytest.mark.parametrize(("damping", "gives"), [(0.0, True), (0.02, True), (3.0, False), (-3.0, False)])
def test_a_cable_gives_as_a_spring_first(tmp_path, damping, gives):
    """Compliance of a cable is told where two encoders part; what follows the torque's rate alone is none."""
    model, runs, _, _ = loaded_trial(tmp_path, 5, effects=["cable_elasticity"], positions="both", n_links=2)
    problem = make_problem(model, runs)
    search = Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())
    (soft, *_) = all_candidates(problem, ["cable_elasticity"])
    assert is_resolved(search, soft, 0.01 * np.array([1.0, damping]), search.fit([])) == gives
    assert not is_resolved(search, soft, 1.0 * np.array([1.0, damping]), search.fit([]))  # by a radian and more


@pytest.mark.parametrize(("offset", "told"), [(1e-5, False), (5e-5, True), (-5e-5, True)])
def test_an_offset_of_an_encoder_is_in_the_plain_mean(monkeypatch, offset, told):
    """A thousandth of the mean of a travel counts: what else is left of it would look like a large offset."""
    column, sure = np.concatenate([np.ones((1, 2, 50)), 1e-3 * np.ones((1, 2, 50))], axis=1), np.full(2, 1e-3)
    wander = np.zeros((4, 50))
    wander[2] = 1e-6 * np.cos(np.arange(50) * np.pi / 5)
    monkeypatch.setattr(resolved, "errors", lambda *_: [offset * column[0] + wander])
    problem = SimpleNamespace(
        model=SimpleNamespace(n_motors=2),
        torque=True,
        runs=[SimpleNamespace(sure=sure)],
        segments=[[(0, 50)]],
        steps_at=lambda joint: 5e-5,
    )
    search = SimpleNamespace(problem=problem, columns=lambda candidate: [column])
    fit = SimpleNamespace(base=None, effects=(), beta=())
    law = Candidate(CATALOGUE["encoder_offset"], CATALOGUE["encoder_offset"].places(load_model("urdf/cdm2.yaml"))[0])
    assert resolved._is_in_means(search, law, fit) == told


@pytest.mark.parametrize(("offset", "outdoes"), [(2e-5, False), (1e-3, True), (-1e-3, False)])
def test_an_offset_between_encoders_is_not_an_error_of_a_soft_cable(monkeypatch, offset, outdoes):
    """A cable that gives by 2 mrad on the whole and is right to 1 % leaves 0.02 mrad in the mean, whatever varies.

    The mean has to show that offset itself, with its sign.
    """
    sure = np.full(1, 1e-3)
    column = np.stack([np.ones((1, 50)), 1e-3 * np.ones((1, 50))], axis=1)
    gives = np.stack([np.zeros((1, 50)), 2e-6 + 1e-3 * np.sin(np.arange(50) * np.pi / 5)[None]], axis=1)
    problem = SimpleNamespace(
        model=SimpleNamespace(n_motors=1),
        torque=True,
        kinematic=True,
        runs=[SimpleNamespace(sure=sure)],
        segments=[[(0, 50)]],
        motions=[None],
    )
    cable = SimpleNamespace(law_error=lambda motion: 0.01)
    search = SimpleNamespace(problem=problem, columns=lambda candidate: [gives if candidate is cable else column])
    fit = SimpleNamespace(base=None, effects=(cable,), beta=(np.ones(1),))
    monkeypatch.setattr(resolved, "errors", lambda *_: [abs(offset) * column[0]])
    law = Candidate(CATALOGUE["encoder_offset"], CATALOGUE["encoder_offset"].places(load_model("urdf/cdm2.yaml"))[0])
    assert resolved.outdoes_in_means(search, law, np.array([offset]), fit) == outdoes


def swept(model, seed, noise=0.0, excess=None):
    """Log half a minute of a motion of an arm: torques with noise, and what may be too much; noisy joint positions."""
    rng, t = np.random.default_rng(seed), np.arange(6000) / 200
    n, w = model.n_motors, 2 * np.pi * np.array([0.13, 0.31, 0.57])[:, None, None]
    b, phase = rng.uniform(0.1, 0.3, (3, 1, n)), rng.uniform(0, 6.28, (3, 1, n))
    wave = w * t[None, :, None] + phase
    q, v, a = (f.sum(axis=0) for f in (b * np.sin(wave), b * w * np.cos(wave), -b * w**2 * np.sin(wave)))
    E = model.joint_from_motor
    q, v, a = q @ E.T + model.offset, v @ E.T, a @ E.T
    tau = model.motor_torque(inverse_dynamics(model, q, v, a))
    tau = tau + (0.0 if excess is None else excess(tau)) + 0.003 * rng.normal(size=tau.shape)
    q = q + noise * rng.normal(size=q.shape)
    return Recording(t, {"joint_position": q, "motor_torque": tau}, label=f"run {seed}")


def test_joints_that_move_together_by_noisy_encoders_show_no_rotor():
    """The links' accelerations are those of single encoders, the rotors' those of all: the torque tells them apart."""
    model = load_model("urdf/real/psm3.yaml")
    search = search_of(model, swept(model, 0, noise=3e-3))
    fit = search.fit([])
    rotors = all_candidates(search.problem, ["rotor_inertia"])
    plain = max(search.score(fit, c).statistic for c in rotors)
    assert plain > 10.0
    assert max(robust_score(search, fit, c).statistic for c in rotors) < 0.3 * plain
    cdm2 = load_model("urdf/cdm2.yaml")
    assert not len(sides(search_of(cdm2, swept(cdm2, 0)), fit))


def test_bursts_that_pass_for_noise_are_told():
    """An amplifier that gives no more than so much, while its command is logged, is off for short times alone."""
    model, told = load_model("urdf/cdm2.yaml"), []
    for over in (0.0, 10.0):

        def excess(tau, over=over):
            most = np.quantile(np.abs(tau[:, 0]), 0.985)
            return np.column_stack([over * np.sign(tau[:, 0]) * np.maximum(np.abs(tau[:, 0]) - most, 0), 0 * tau[:, 0]])

        train, judge = (search_of(model, swept(model, seed, noise=1e-6, excess=excess)) for seed in (1, 2))
        told.append(unexplained.bursting_torque(train, judge, train.fit([])))
    assert told[0] is None
    assert told[1]["location"] == {"kind": "motor", "index": 1}


@pytest.mark.parametrize(("arm", "most"), [("cdm2", 6), ("spatial7", 14)])
def test_two_effects_may_be_at_each_motor(arm, most):
    model = load_model(f"urdf/{arm}.yaml")
    assert search_of(model, swept(model, 0)).most == most


@pytest.mark.parametrize(
    ("depth", "std", "brakes"),
    [(0.9, 0.01, True), (1.05, 0.1, True), (1.05, 0.01, False), (-1.05, 0.1, True)],
)
def test_friction_may_vary_by_all_of_itself_within_its_error(depth, std, brakes):
    """Where the estimate would drive by less than its error, nobody knows that it does."""
    law = SimpleNamespace(effect=CATALOGUE["position_dependent_friction"])
    fit = SimpleNamespace(
        base=np.zeros(2), beta=[np.ones(1), np.array([1.0, depth, 0.0])], covariance=std**2 * np.eye(6)
    )
    found = [
        SimpleNamespace(candidate=SimpleNamespace(effect=CATALOGUE["viscous_friction"])),
        SimpleNamespace(candidate=law),
    ]
    explanation = SimpleNamespace(fit=fit, found=found)
    assert _nearly_brakes(explanation, 1) is brakes
    assert not _nearly_brakes(explanation, 0)


def test_a_gain_is_as_large_as_it_differs_from_one():
    values = {"gain": {"value": 1.06, "std": 0.02}, "phase": {"value": 9.0, "std": 0.1}}
    assert sizes_in_errors(values) == {"gain": pytest.approx(3.0)}


def test_what_instants_are_unsure_by_is_no_friction(tmp_path):
    """Torque that is read a twentieth of a sample late looks like friction; no delay takes room from a delay."""
    model, runs, _, _ = loaded_trial(
        tmp_path, 262701276713102, effects=["time_delay"], visibility=11.84, bits=17, duration=30.0
    )
    search = Search(make_problem(model, runs), base_parameters(model, columns=massive_columns(model)), Settings())
    fit = search.fit([])
    laws = all_candidates(search.problem, ["viscous_friction", "time_delay"])
    best = {name: max((c for c in laws if c.name == name), key=lambda c: search.score(fit, c).statistic)
            for name in ("viscous_friction", "time_delay")}  # fmt: skip
    share = {
        name: robust_score(search, fit, law).statistic / search.score(fit, law).statistic for name, law in best.items()
    }
    assert share["viscous_friction"] < 0.7 < 0.9 < share["time_delay"]
    assert not len(instants(search, search.fit([best["time_delay"]])))


@pytest.mark.parametrize(
    ("due", "gain", "named", "asked"),
    [
        (8.0, 30.0, True, 0.0),  # chance may take all of it
        (8.0, 10.0, True, 3.0),  # which counts only for what the training is sure of
        (8.0, 10.0, False, 0.8),
        (1000.0, 30.0, True, 100.0),
    ],
)
def test_the_unseen_recordings_are_asked_for_what_chance_leaves_of_what_is_due(due, gain, named, asked):
    assert confirming.asked_of(due, gain, named) == pytest.approx(asked)


@pytest.mark.parametrize(
    ("left", "loud"),
    [
        ([9.0, 3.0], True),  # three times the error on its motor, hardly any of the whole
        ([9.0, 1.2], False),
        ([90.0, 1.2], False),  # on another's
    ],
)
def test_a_finding_is_loud_where_it_takes_most_of_the_error(monkeypatch, left, loud):
    model = load_model("urdf/cdm2.yaml")
    place = next(p for p in CATALOGUE["coulomb_friction"].places(model) if p.location == {"kind": "motor", "index": 2})
    candidate = Candidate(CATALOGUE["coulomb_friction"], place, (0.1,))
    fits = {name: SimpleNamespace(base=name, effects=(), beta=()) for name in ("with", "without")}
    monkeypatch.setattr(confirming, "still_errors", lambda judge, fit: fit.base)
    monkeypatch.setattr(confirming, "rms", lambda judge, name: np.array({"with": [8.9, 1.0], "without": left}[name]))
    judge = SimpleNamespace(problem=SimpleNamespace(model=model))
    explanation = SimpleNamespace(
        fit=fits["with"],
        found=[SimpleNamespace(candidate=candidate)],
        search=SimpleNamespace(without=lambda fit, j: fits["without"]),
    )
    assert confirming.is_loud_there(judge, explanation, 0) == loud


def test_a_motor_may_turn_with_a_joint_as_much_as_with_any_of_its_own():
    """A ratio is one of the motor's angle over the joint's, which pulleys and gears scale."""
    model = load_model("urdf/cdm2.yaml")
    law = CATALOGUE["transmission_coupling"]
    motion = SimpleNamespace(model=SimpleNamespace(motor_from_joint=np.array([[20.0, 0.0], [20.0, -30.0]])))
    assert [most_turns([motion], place) for place in law.places(model)] == [{0: 20.0, 1: 30.0}[p.index[0]]
                                                                       for p in law.places(model)]  # fmt: skip


def test_a_law_that_would_drive_is_unsound():
    """Friction that starts by driving is none, however much it explains; nor is what has no admissible coefficients."""
    law = CATALOGUE["friction_drift"]
    candidate = Candidate(law, law.places(load_model("urdf/cdm2.yaml"))[0], (0.01, 5.0))

    def told(beta, statistic=100.0, k=2):
        found = SimpleNamespace(candidate=candidate, score=Score(statistic, k, np.array(beta), 1.0, 1.0))
        explanation = SimpleNamespace(found=(found,))
        assert not unsound(explanation, explanation)  # what stood there before
        return unsound(explanation, SimpleNamespace(found=()))

    assert not told([1.0, 0.5])
    assert not told([1.0, -0.5])
    assert told([1.0, -1.5]) == {candidate.key}
    assert told([1.0, 0.5], -np.inf) == {candidate.key}
    assert not told([0.0, 0.0], -np.inf, 0)  # superfluous


@pytest.mark.parametrize(("delay", "resolved"), [(6e-5, False), (5e-4, True)])
def test_a_delay_of_a_small_part_of_a_sample_is_none(tmp_path, delay, resolved):
    """What instant a sample of 5 ms stands for is not known to a hundredth of that."""
    model, runs, _, _ = loaded_trial(tmp_path, 5, n_links=2, effects=0, positions="joint", duration=30.0)
    search = Search(make_problem(model, runs), base_parameters(model, columns=massive_columns(model)), Settings())
    (law, *_) = all_candidates(search.problem, ["time_delay"])
    assert is_resolved(search, law, np.array([delay]), search.fit([])) == resolved


@pytest.mark.parametrize(("hop", "moves"), [(0.0, False), (0.02, True)])
def test_a_cable_that_hops_into_another_groove_is_no_noise(monkeypatch, hop, moves):
    """An autoregression takes steps of a travel for noise; two encoders have none that stays."""
    model, rng = load_model("urdf/cdm2.yaml"), np.random.default_rng(0)
    rest = 5e-5 * rng.normal(size=(4, 1200))
    rest[3, 480:800] += hop
    segments = [[(0, 1200)]]
    noise = spectrum([rest], [np.zeros((0, 4, 1200))], segments)
    problem = SimpleNamespace(
        model=model,
        torque=True,
        kinematic=True,
        segments=segments,
        steps_at=lambda joint: 1e-4,
        n_channels=4,
        band=SimpleNamespace(reduced_rate=20.0, step=10),
        runs=[SimpleNamespace(motion=SimpleNamespace(time=np.arange(12000) / 200))],
    )
    monkeypatch.setattr(unexplained, "left_over", lambda search, effects, smooth=True: ([rest], noise))
    told = wandering_travel(SimpleNamespace(problem=problem), SimpleNamespace(effects=(), beta=()))
    assert (told is not None) == moves
    if told:
        assert told["location"] == {"kind": "cable", "index": 2} and "24.0, 40.0 s" in told["region"]


def test_encoders_on_both_sides_may_be_off_alike(tmp_path):
    """Both may round down: that turns links, and no travel between them tells."""
    model, runs, _, _ = loaded_trial(tmp_path, 5, effects=["cable_elasticity"], positions="both", n_links=2)
    search = Search(make_problem(model, runs), base_parameters(model, columns=massive_columns(model)), Settings())
    fit = search.fit([])
    rows = offsets(search, fit)
    torque = fit.n_rows // 2
    assert len(rows) == 2 and np.linalg.norm(rows[:, :torque]) > 100 * np.linalg.norm(rows[:, torque:])


@pytest.mark.parametrize(("size", "worse"), [(0.5, False), (9.0, False), (11.0, True)])
def test_what_makes_the_plain_error_larger_explains_nothing(monkeypatch, size, worse):
    """Nothing is found that makes the error ten times larger, whatever it does where the noise is said to be small."""
    monkeypatch.setattr(drifting, "foretold", lambda search, fit: [np.full((2, 50), fit.base)])
    monkeypatch.setattr(significance, "rms", lambda search, left: np.sqrt(np.mean(left[0] ** 2, axis=1)))
    without, both = (SimpleNamespace(base=x, effects=(), beta=(), whitener=None) for x in (1.0, size))
    search = SimpleNamespace(fit=lambda effects, whitener: both, drift=None)
    assert significance._worsens(search, without, None) == worse


@pytest.mark.parametrize(("effect", "name"), [("encoder_offset", "offset"), ("backlash", "half_gap")])
@pytest.mark.parametrize("jitter", [0.0, 1.0])
@pytest.mark.parametrize(
    ("sides", "size", "told"),
    [(2, 2e-4, True), (2, 0.9e-4, False), (2, -2e-4, True), (1, 0.9e-4, True), (1, 0.4e-4, False)],
)
def test_what_rounding_makes_is_not_told(effect, name, jitter, sides, size, told):
    """Encoders of 0.1 mrad, on one side or both: half a step of each is no offset, nor on one side a play.

    Where the steps are seen, what jitter of the clock adds to the noise of positions changes nothing.
    """
    own = ("motor_position", "joint_position")[:sides]
    noise = dict.fromkeys(own, np.full(2, 1e-4 / np.sqrt(12.0) + jitter))
    steps = dict.fromkeys(own, np.full(2, 1e-4 if jitter else 0.0))
    run = SimpleNamespace(signals=SimpleNamespace(noise=noise, steps=steps))
    model = load_model("urdf/cdm2.yaml")
    problem = Problem(model, (run,), None, True, sides == 2, None)
    place = CATALOGUE[effect].places(model)[0]
    law = Candidate(CATALOGUE[effect], place, (0.1,) if effect == "backlash" else ())
    known = is_above_steps(SimpleNamespace(problem=problem), law, {name: {"value": size, "std": 1e-6}})
    assert known == (told or (effect == "backlash" and sides == 2))  # it follows the load, as no rounding does


@pytest.mark.parametrize("lag", [0.0, 0.45])
def test_encoders_that_lag_are_no_cable(tmp_path, lag):
    """What encoders of joints are behind by, less than half a step, turns with their velocity."""
    model, *parts, _ = loaded_trial(tmp_path, 0, n_links=2, effects=0, positions="both", bits=17, duration=40.0)
    step, rng = 2 * np.pi / 2**17, np.random.default_rng(0)

    def read_again(recording):
        q = recording.channels["joint_position"]
        error = rng.uniform(-0.5, 0.5, q.shape) - lag * np.sign(np.gradient(q, axis=0))
        return replace(recording, channels=recording.channels | {"joint_position": np.round(q / step + error) * step})

    found = diagnose(model, *([read_again(r) for r in recordings] for recordings in parts))
    assert found.content["verdict"] == "consistent"


def test_a_play_of_less_than_a_step_follows_the_load(tmp_path):
    """Rounding hides no play that encoders on both sides show over many steps."""
    options = {"n_links": 2, "effects": ["backlash"], "visibility": 20.0, "positions": "both", "bits": 17}
    model, runs, unseen, truth = loaded_trial(tmp_path, 2, **options)
    (told,) = diagnose(model, runs, unseen).content["findings"]
    (true,) = truth["effects"]
    assert (told["effect"], told["location"]) == ("backlash", true["location"])
    assert told["parameters"]["half_gap"]["value"] < 0.5 * 2 * np.pi / 2**17


def test_encoder_noise_at_rest_wears_no_memory():
    """Friction remembers at standstill from where the motion came, though the encoder flickers; it follows motion."""
    rng = np.random.default_rng(0)
    moving = np.linspace(0.0, 0.1, 500)
    x = np.r_[moving, 0.1 + 2e-5 * rng.uniform(-1.0, 1.0, 5000)]
    assert dahl(dragged(x, 2e-5), 2e-4)[-1] > 0.8 > 0.2 > dahl(x, 2e-4)[-1]
    assert np.abs(dragged(moving, 2e-5) - moving).max() < 2.1e-5


def test_a_coordinate_is_as_unsure_as_the_encoders_that_say_it(tmp_path):
    """What motors that follow from the joints have in common cancels; the filter takes of noise what it can."""
    model, runs, _, _ = loaded_trial(tmp_path, 2, n_links=2, effects=0, positions="joint", bits=14, duration=30.0)
    motion = make_problem(model, runs).motions[0]
    joints, motors = motion.position_errors
    step = 2 * np.pi / 2**14
    assert np.all((joints > 0.01 * step) & (joints < step / np.sqrt(12.0))) and not motors.any()
    back = model.joint_from_motor[1]  # the second joint, as its motors say it
    assert motion.position_error(np.zeros(2), back) == pytest.approx(joints[1])
    both = replace(motion, position_errors=(joints, joints))
    assert both.position_error(np.zeros(2), back) == pytest.approx(np.abs(back) @ joints)
    assert replace(motion, position_errors=None).position_error(np.ones(2), back) == 0.0


@pytest.mark.parametrize("best", [1 / 16, 1.0, 4.0])
def test_the_distance_within_which_friction_gives_is_found(best):
    """Of the multiples that are looked at, that with the least deviance; what gives nothing stays as it is."""
    place = joint_places(load_model("urdf/planar3.yaml"))[0]
    rubs = Candidate(CATALOGUE["coulomb_friction"], place, (0.01,), detail=0.01, gives=1.0)

    def fit(effects, whitener):
        return SimpleNamespace(deviance=100.0 * abs(np.log(effects[0].gives / best)))

    found = yielding(SimpleNamespace(fit=fit), [rubs, replace(rubs, gives=0.0)], None)
    assert [c.gives for c in found] == [best, 0.0]


@pytest.mark.parametrize(("std", "share"), [(1e-6, 1.0), (1e6, 0.0)])
def test_masses_that_no_torque_tells_stay_as_the_file_has_them(std, share):
    """A base parameter that is known moves the masses that load the bearings; one that is not does not."""
    model = load_model("urdf/planar3.yaml")
    base = base_parameters(model, columns=massive_columns(model))
    p = len(base.columns)
    sensors = SimpleNamespace(model=model)
    search = SimpleNamespace(problem=SimpleNamespace(model=model, sensors=sensors), base=base)
    change = 0.05 * base.values(model.standard_parameters)
    change[0] += 0.0 if share else 500.0
    covariance = np.diag([std**2, *np.full(p - 1, 1e-12)])
    likely = likely_masses(search, SimpleNamespace(base=change, covariance=covariance))
    moved = base.values(likely.standard_parameters) - base.values(model.standard_parameters)
    assert moved[1:] == pytest.approx(change[1:], rel=0.02, abs=1e-6)
    assert np.abs(likely.standard_parameters - model.standard_parameters).max() < 1.0
    assert moved[0] == pytest.approx(change[0], rel=0.02) or not share


@pytest.mark.slow
def test_dry_friction_that_is_sure_is_no_unequal_friction(tmp_path):
    """A more general law is no alternative where what it has beyond the one that was found is no more than a trifle."""
    model, runs, unseen, _ = loaded_trial(
        tmp_path, 17, effects=["coulomb_friction"], visibility=3000.0, n_links=2, noise="white"
    )
    (finding,) = diagnose(model, runs, unseen).content["findings"]
    others = {x["effect"] for x in finding["indistinguishable_from"]}
    assert finding["effect"] == "coulomb_friction"
    assert not others & {"asymmetric_friction", "stribeck_friction", "friction_drift", "position_dependent_friction"}


@pytest.mark.parametrize(
    ("height", "sensed", "rings"), [(1.0, 0.1, False), (100.0, 0.1, True), (20.0, 0.5, False), (20.0, 0.05, True)]
)
def test_a_residual_that_rings_is_no_noise(monkeypatch, height, sensed, rings):
    """Sensors have more noise at no frequency than at lower ones, but for what encoders make of accelerations.

    Of what is far above the noise of the sensors less is enough.
    """
    model, rng = load_model("urdf/cdm2.yaml"), np.random.default_rng(0)
    power = np.ones((2, 20))
    power[1, 8:11] *= height
    noise = Spectrum(np.linspace(0.0, 0.5, 20), power, np.full((2, 20), 50.0), np.full(20, 0.05))
    problem = SimpleNamespace(
        model=model,
        torque=True,
        segments=[[(0, 400)]],
        sensed=np.full(2, sensed),
        n_channels=2,
        band=SimpleNamespace(reduced_rate=20.0),
    )
    search = SimpleNamespace(problem=problem, settings=Settings(), loads=np.ones(2))
    rest = [np.outer([0.0, 1.0], rng.normal(size=400))]
    monkeypatch.setattr(unexplained, "left_over", lambda search, effects, smooth=True: (rest, noise))
    told = ringing_torque(search, SimpleNamespace(effects=(), beta=()))
    assert (told is not None) == rings
    if told:
        assert told["location"] == {"kind": "motor", "index": 2} and "Hz" in told["region"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "effect", "visibility", "bits", "beside"),
    [
        (217520819009564, "stribeck_friction", 23.57, 17, "coulomb_friction"),
        (87894727631294, "coulomb_friction", 27.8, 14, "coulomb_friction"),
    ],
)
def test_weak_friction_pays_for_no_freedom(tmp_path, seed, effect, visibility, bits, beside):
    """A peak that the data do not exclude stands beside dry friction; a coarse encoder makes no stiff hysteresis."""
    model, runs, unseen, _ = loaded_trial(tmp_path, seed, effects=[effect], visibility=visibility, bits=bits)
    (finding,) = diagnose(model, runs, unseen).content["findings"]
    assert finding["effect"] == beside
    assert effect in [finding["effect"], *(law["effect"] for law in finding["indistinguishable_from"])]


@pytest.mark.parametrize(("across", "known"), [(0.0, False), (0.9, True)])
def test_a_fall_is_known_at_its_time_constant(across, known):
    """A fall of friction is there where it is sure at the time constant that suits best, if for no other."""
    values = {"friction": {"value": 9.0, "std": 1.0}, "extra": {"value": 0.3, "std": 0.15}}
    drift = SimpleNamespace(effect=SimpleNamespace(name="friction_drift", signs=(1, 1)))
    covariance = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, across], [0.0, across, 1.0]])
    assert is_known(values, drift, np.array([9.0, 2.0, 0.5])[:2], covariance) == known


@pytest.mark.parametrize(("unseen", "shift", "chance"), [(1.0, 5.0, 2.0), (100.0, 10.0 / 101.0, 4.0 / 101.0)])
def test_recordings_that_hardly_tell_a_parameter_move_it_little(monkeypatch, unseen, shift, chance):
    """As much information on either side: their difference. Hardly any in the unseen: next to nothing."""
    step, spread = np.array([5.0, 0.0]), np.diag([unseen, 0.0])  # the second is a drift of the training's own
    monkeypatch.setattr(findings, "unseen_step", lambda judge, fit: (step, spread))
    far, near = findings.unseen_shift(None, SimpleNamespace(effects=(), beta=()), np.eye(2), ())
    assert far == pytest.approx([shift, 0.0])
    assert np.diag(near) == pytest.approx([chance, 0.0])


@pytest.mark.parametrize(("off", "rounded"), [(0.9, True), (1.1, False)])
def test_a_reading_is_off_by_more_than_encoders_round(off, rounded):
    """Two encoders of a step each differ by up to one step at rest, by something that depends on where that is."""
    half = {side: np.array([0.5]) for side in ("joint_position", "motor_position")}
    model = SimpleNamespace(n_motors=1, arm_scale=np.ones(1), motor_from_joint=np.eye(1))
    problem = SimpleNamespace(model=model, torque=True, half_steps=half)
    columns = [np.stack([np.zeros(50), np.sin(np.linspace(0.0, 6.0, 50))])[None]]
    search = SimpleNamespace(problem=problem, columns=lambda reading: columns)
    assert resolved._is_rounded(search, None, np.array([off])) == rounded


def test_encoders_at_rest_are_off_by_the_same_for_long():
    """What rounding leaves is a constant for as long as a joint rests, within half a step, and nothing in passing."""
    x = np.concatenate([np.zeros(500), np.linspace(0.0, 1.0, 400), np.ones(500)])
    step = 0.01
    readings = np.round(x / step) * step
    off = sensor_noise._at_rest(readings, step, np.random.default_rng(0))
    assert np.ptp(off[:490]) == 0.0 and np.ptp(off[910:]) == 0.0
    assert off[100] != off[-100] and np.all(np.abs(off) <= 0.5 * step)
    assert not off[600:800].any()
    assert not sensor_noise._at_rest(readings, 0.0, np.random.default_rng(0)).any()


def test_what_rests_may_leave_is_no_evidence():
    """The variance along an effect is that of the draws where it is surely more than that of the noise."""
    rng = np.random.default_rng(0)
    own = rng.normal(size=300)
    unit = own / np.linalg.norm(own)
    loud, quiet = (scale * rng.normal(size=(32, 1)) * unit for scale in (5.0, 0.5))
    assert robust.at_rest(own, loud) == pytest.approx(25.0, rel=0.5)
    assert robust.at_rest(own, quiet) == 0.0
    assert robust.at_rest(own, np.zeros((0, 300))) == 0.0


@pytest.mark.slow
def test_friction_that_may_as_well_grow_with_load_is_said_before_what_only_adds_to_it(tmp_path):
    """A load that hardly changes: dry friction, listed first beside it the one that grows with load.

    Friction that differs in its two directions, or that drifts, has dry friction in it and something more.
    """
    model, runs, unseen, truth = loaded_trial(tmp_path, 185226015953688, effects=1, bits=14, at_least=50.0)
    (effect,) = truth["effects"]
    (finding,) = diagnose(model, runs, unseen).content["findings"]
    assert (effect["effect"], finding["effect"]) == ("load_dependent_friction", "coulomb_friction")
    assert finding["indistinguishable_from"][0] == {k: effect[k] for k in ("effect", "location")}


@pytest.mark.slow
def test_dry_friction_does_not_stand_beside_what_refines_it(tmp_path):
    """Friction a fifth higher one way is one finding, though dry friction alone would do for all but errors of laws."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 258913684971707, effects=1, bits=14, at_least=50.0)
    (finding,) = diagnose(model, runs, unseen).content["findings"]
    assert (finding["effect"], finding["location"]) == ("asymmetric_friction", {"kind": "joint", "index": 2})


@pytest.mark.slow
def test_no_experiment_is_asked_for_to_part_what_turns_alike(tmp_path):
    """Stick-slip friction of joint 1, which motor 1 alone drives: no motion parts the two; there is none to record."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 172570246813453, effects=1, bits=17, at_least=50.0)
    content = diagnose(model, runs, unseen).content
    (finding,) = content["findings"]
    assert (finding["effect"], finding["location"]) == ("stribeck_friction", {"kind": "joint", "index": 1})
    assert {"effect": "stribeck_friction", "location": {"kind": "motor", "index": 1}} in finding[
        "indistinguishable_from"
    ]
    assert content["next_experiment"] is None


def test_unequal_friction_whose_inequalities_cancel_but_on_one_motor_is_an_offset_there():
    """Two axes that rub unequally and motor 2 off by a constant need as many numbers less as there are axes."""
    model = load_model("urdf/planar3.yaml")
    places = [*joint_places(model)[:2], all_motor_places(model)[1]]
    first, second = (Candidate(CATALOGUE["asymmetric_friction"], place, (0.05,)) for place in places[:2])
    drag = Candidate(CATALOGUE["viscous_friction"], places[0])
    offsets = [Candidate(CATALOGUE["torque_offset"], place) for place in all_motor_places(model)]
    bank = SimpleNamespace(laws=SimpleNamespace(candidates=[drag, *offsets]))
    trials = plainness._evened([first, drag, second], SimpleNamespace(bank=bank), 2)
    assert [trial[-1] for trial in trials] == offsets
    assert all(
        [c.name for c in trial[:3]] == ["coulomb_friction", "viscous_friction", "coulomb_friction"] for trial in trials
    )
    assert plainness._evened([first, drag], SimpleNamespace(bank=bank), 2) == []
    assert plainness._evened([first, first.dry, second], SimpleNamespace(bank=bank), 2) == []


def test_friction_that_drives_one_way_is_no_friction():
    """What is lost both ways less a constant that is more than that is dry friction and a torque offset."""
    law = Candidate(CATALOGUE["asymmetric_friction"], joint_places(load_model("urdf/cdm2.yaml"))[0], (0.05,))
    brakes, drives = (SimpleNamespace(effects=[law], beta=[np.array(beta)]) for beta in ([0.25, 0.2], [0.2, 0.25]))
    assert plainness.is_sound(brakes) and not plainness.is_sound(drives)
    offset = Candidate(CATALOGUE["torque_offset"], all_motor_places(load_model("urdf/cdm2.yaml"))[0])
    bank = SimpleNamespace(laws=SimpleNamespace(candidates=[offset]))
    assert plainness._evened([law], SimpleNamespace(bank=bank), 1) == [[law.dry, offset]]


def test_laws_that_are_alike_one_by_one_may_not_be_together(monkeypatch):
    """Each of two laws has a simpler one in its place; both of these together explain nothing, so one stands."""
    places = joint_places(load_model("urdf/cdm2.yaml"))
    old = [Candidate(CATALOGUE["joint_spring"], place) for place in places]
    new = [Candidate(CATALOGUE["viscous_friction"], place) for place in places]
    found = [SimpleNamespace(candidate=c, score=SimpleNamespace(statistic=100.0)) for c in old]

    def explained(explanation, effects):
        return SimpleNamespace(search=search, found=[SimpleNamespace(candidate=c) for c in effects])

    search = SimpleNamespace(settings=Settings())
    explanation = SimpleNamespace(search=search, found=found)
    monkeypatch.setattr(plainness, "_named_at", lambda explanation, j, taken: new[j])
    monkeypatch.setattr(plainness, "estimated", explained)
    monkeypatch.setattr(plainness, "unsound", lambda after, before: frozenset())
    worth = {(False, False): 100.0, (True, True): 0.0, (True, False): 99.0, (False, True): 0.0}
    monkeypatch.setattr(plainness, "likelihood", lambda search, effects: worth[tuple(c in new for c in effects)])
    assert [f.candidate for f in plainness.simplest(explanation).found] == [new[0], old[1]]
    worth[True, True] = 99.0
    assert [f.candidate for f in plainness.simplest(explanation).found] == new


@pytest.mark.parametrize(
    ("amplitude", "one"),
    [
        ([0.0, 3.0j, 0.0], True),  # motor 2 alone
        ([-2.0 * np.exp(1.0j), 2.0 * np.exp(1.0j), 0.1j], True),  # joint 2, in its two cables
        ([3.0 + 0.2j, 2.0, -2.5], True),  # a base that shakes
        ([3.0, 3.0 * np.exp(1.2j), 3.0 * np.exp(2.5j)], False),  # each sensor has its own phase
    ],
)
def test_a_hum_of_sensors_has_no_phase_in_common(amplitude, one):
    model = load_model("urdf/planar3.yaml")
    assert _is_one(np.array(amplitude, complex), model, np.ones(3)) == one
    assert (
        _is_one(np.array([1e-3, 1.0, 10.0]) * amplitude, model, np.array([1e-3, 1.0, 10.0])) == one or amplitude[0] < 0
    )


def test_a_short_recording_has_the_noise_that_its_rigid_body_leaves(monkeypatch):
    """Where smooth functions leave no freedom, they are left out; else the noise beside them counts."""
    few, many = (Spectrum(np.array([0.25]), np.ones((2, 1)), np.full((2, 1), n), np.ones(1)) for n in (1e-9, 50.0))
    search = SimpleNamespace(problem=SimpleNamespace(segments=[]))
    monkeypatch.setattr(leftover, "plain_rest", lambda search, effects, further: (further, further))
    monkeypatch.setattr(leftover, "quiet_segments", lambda residuals, segments: segments)
    monkeypatch.setattr(leftover, "spectrum", lambda residuals, basis, segments: many if residuals is None else few)
    assert leftover._left_over(search, (), [np.ones(3)]) == (None, many)
    monkeypatch.setattr(leftover, "spectrum", lambda residuals, basis, segments: many)
    assert leftover._left_over(search, (), "smooth") == ("smooth", many)
