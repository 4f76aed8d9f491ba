"""The search's parts: spectra free of what a fit takes, motors that rub, travel alone, what to record next."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from arms import planar_content
from scipy.spatial.transform import Rotation
from trials import loaded_trial, search_of

from cdm_pin.band import make_band
from cdm_pin.bank import all_candidates
from cdm_pin.base import base_parameters, massive_columns, updated_model
from cdm_pin.candidates import Candidate
from cdm_pin.diagnose import diagnose
from cdm_pin.drifting import own_drifts
from cdm_pin.dynamics import inverse_dynamics
from cdm_pin.effects import CATALOGUE
from cdm_pin.explanation import explained
from cdm_pin.findings import between_errors_of_laws, parameters, unseen_step, with_scatter
from cdm_pin.leftover import left_over, tones
from cdm_pin.likelihood import even_noise, freed
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.masses import about
from cdm_pin.model import build_model, load_model
from cdm_pin.next_experiment import plan_next
from cdm_pin.patches import PATCHES
from cdm_pin.places import joint_places, pair_places
from cdm_pin.plainness import peakless
from cdm_pin.plant.draw import draw
from cdm_pin.problem import _thinned, make_problem
from cdm_pin.recording import Recording, load_recording
from cdm_pin.resolved import is_resolved
from cdm_pin.scores import Score
from cdm_pin.search import Search, errors, rms
from cdm_pin.settings import Settings
from cdm_pin.settling import settled
from cdm_pin.shapes import refine
from cdm_pin.signals_filters import differentiate, lowpass
from cdm_pin.spectra import spectrum, stands_out, whitener_of
from cdm_pin.urdf import generate_urdf
from cdm_pin.whitening import Lines, Whitener

CAPSTAN = {"n_links": 2, "positions": "joint", "bits": 17, "noise": "white", "motion": "prescribed", "duration": 30.0}


def test_a_spectrum_is_not_lowered_by_what_a_fit_takes():
    """White noise under a fit of 60 slow columns: the spectrum stays flat, the residual's own power does not."""
    rng = np.random.default_rng(0)
    n = 2000
    t = np.linspace(0, 1, n)
    slow = np.linalg.qr(np.stack([np.cos(np.pi * k * t) for k in range(60)], axis=1))[0].T
    e = 0.3 * rng.normal(size=n)
    rest = e - slow.T @ (slow @ e)
    found = spectrum([rest[None]], [slow[:, None]], [[(0, n)]])
    assert found.power[0, 0] == pytest.approx(0.09, rel=0.5)
    assert found.rms == pytest.approx([0.3], rel=0.05)
    plain = spectrum([rest[None]], [np.zeros((0, 1, n))], [[(0, n)]])
    assert plain.power[0, 0] < 0.6 * found.power[0, 0]


def test_what_stands_out_of_the_noise_is_seen_and_noise_is_not():
    rng = np.random.default_rng(1)
    n, nothing = 3000, [np.zeros((0, 1, 3000))]
    e = rng.normal(size=(1, n))
    slow = e + np.sin(np.arange(n) / 40)
    noise = spectrum([e], nothing, [[(0, n)]])
    assert stands_out(spectrum([slow], nothing, [[(0, n)]]), noise)
    assert not stands_out(spectrum([rng.normal(size=(1, n))], nothing, [[(0, n)]]), noise)


def test_a_whitener_of_a_spectrum_whitens():
    """AR(1) noise of two channels that share a part: white, of unit variance and uncorrelated afterwards."""
    rng = np.random.default_rng(2)
    n = 6000
    w = np.linalg.cholesky([[1.0, 0.6], [0.6, 1.0]]) @ rng.normal(size=(2, n))
    e = np.zeros_like(w)
    for k in range(1, n):
        e[:, k] = 0.8 * e[:, k - 1] + w[:, k]
    segments = [[(0, n)]]
    noise = spectrum([e], [np.zeros((0, 2, n))], segments)
    whitener = whitener_of(noise, [e], segments, 24, [slice(0, 2)])
    white = whitener(e[None], segments[0])[0].reshape(2, -1)
    assert np.allclose(white @ white.T / white.shape[1], np.eye(2), atol=0.08)
    assert abs(np.mean(white[:, 1:] * white[:, :-1])) < 0.05


def test_lines_whiten_as_their_columns_do():
    """Series with weights give the same rows as the columns that they add up to."""
    rng = np.random.default_rng(3)
    bank = rng.normal(size=(4, 3, 200))
    bank[1, 0] = 0.0
    lines = Lines.of(bank)
    assert np.allclose(lines.dense(), bank)
    joined = Lines.join([lines, Lines(rng.normal(size=(1, 200)), np.array([[0.0, 2.0, -1.0]]), np.array([0]), 1)])
    mix = np.tril(rng.normal(size=(3, 3)))
    whitener = Whitener(rng.normal(size=(3, 5)) * 0.1, mix, np.ones(1))
    segments = [(0, 90), (100, 200)]
    assert np.allclose(whitener.lines([joined], [segments]), whitener(joined.dense(), segments))


def test_a_tilted_base_reveals_first_moments():
    """About a vertical axis they are felt only where the base is tilted: then they need not be the file's any more."""
    content = planar_content(2, 3) | {"gravity": [0.0, 0.0, -9.81]}
    model = build_model(parse_manipulator(content))
    first, mass = (model.parameter_names.index(name) for name in ("mx_1", "m_2"))
    wrong = model.standard_parameters.copy()
    wrong[mass] *= 1.1
    tilted, down = model.with_standard_parameters(wrong), Rotation.from_rotvec([0.05, -0.03, 0.0]).inv()
    tilted.pin_model.gravity.linear = down.apply(np.array(model.chain.gravity))
    t, rng = np.arange(0.0, 20.0, 0.005), np.random.default_rng(0)
    w = 2 * np.pi * np.array([0.31, 0.47])
    q, v, a = (np.sin(w * t[:, None]), w * np.cos(w * t[:, None]), -(w**2) * np.sin(w * t[:, None]))
    torque = inverse_dynamics(tilted, q, v, a) @ model.joint_from_motor + 1e-3 * rng.normal(size=q.shape)
    record = Recording(t, {"joint_position": q, "motor_torque": torque})
    search = Search(make_problem(model, [record]), base_parameters(model), Settings())
    felt = np.zeros(20)  # by joint 1: its own first moment and the mass of link 2 at its end
    felt[[first, mass]] = 1.0, content["links"][0]["length"]
    file, true = felt @ model.standard_parameters, felt @ wrong
    without = about(search, search.fit([]))
    there, _ = settled(search, all_candidates(search.problem, ["base_tilt"]))
    assert abs(felt @ without.problem.model.standard_parameters - true) > 0.5 * abs(true - file)
    assert felt @ there.problem.model.standard_parameters == pytest.approx(true, abs=0.2 * abs(true - file))


@pytest.mark.slow
def test_hysteresis_between_two_motors_parts_is_found_with_its_ratio(tmp_path):
    """Parts of motors 1 and 2 rub at a ratio of speeds that is no joint's and no cable's."""
    for seed in range(40):
        trial = draw(seed, effects=["hysteresis"], **(CAPSTAN | {"positions": "motor"}))
        truth = trial.truth["effects"][0]
        if truth["location"]["kind"] == "combination":
            break
    model, runs, unseen, _ = loaded_trial(tmp_path, seed, effects=["hysteresis"], **(CAPSTAN | {"positions": "motor"}))
    (finding,) = diagnose(model, runs, unseen).content["findings"]
    assert finding["effect"] == "hysteresis"
    found, true = (np.array(x["location"]["weights"]) for x in (finding, truth))
    assert np.allclose(found / np.abs(found).max(), true / np.abs(true).max(), atol=0.03) or np.allclose(
        -found / np.abs(found).max(), true / np.abs(true).max(), atol=0.03
    )


def test_two_positions_without_torque_make_a_kinematic_diagnosis(tmp_path):
    """The ratio error is found in travel alone, to four digits, and the errors are angles."""
    model, runs, unseen, truth = loaded_trial(
        tmp_path, 1, effects=["transmission_ratio_error"], positions="both", duration=30.0, n_links=2
    )
    runs, unseen = (
        [replace(r, channels={k: v for k, v in r.channels.items() if "torque" not in k}) for r in group]
        for group in (runs, unseen)
    )
    content = diagnose(model, runs, unseen).content
    (finding,) = content["findings"]
    assert finding["effect"] == "transmission_ratio_error"
    value = finding["parameters"]["relative_error"]["value"]
    assert value == pytest.approx(truth["effects"][0]["parameters"]["relative_error"], rel=0.01)
    assert content["fit"]["unit"] == "rad"


def test_weak_friction_of_one_motor_is_not_called_that_of_two(tmp_path):
    """A ratio of speeds that noise makes a little likelier than none is none: the place is the motor."""
    settings = {"visibility": 10.39, "bits": 14, "effects": ["capstan_friction"], "duration": 60.0}
    model, runs, unseen, _ = loaded_trial(tmp_path, 92625798427696, **settings)
    (finding,) = diagnose(model, runs, unseen).content["findings"]
    assert (finding["effect"], finding["location"]) == ("coulomb_friction", {"kind": "motor", "index": 2})


def _wrist(seed: int, lost: float, coupling: float) -> Recording:
    """Motors at rest at way points and where a camera sees their joints: cable 6 slips, joint 6 moves joint 5."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 600.0, 0.4)
    way = [np.sin(w * t + 1.3 * k) + 0.4 * np.sin(2.7 * w * t) for k, w in enumerate(np.linspace(0.1, 0.25, 6))]
    q_m = np.stack(way, axis=1) * [1.0, 0.5, 0.05, 1.0, 1.0, 1.0] + [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]
    q = q_m.copy()
    for k in range(1, len(t)):  # a joint stays where it is until its cable has taken up what was lost
        q[k, 5] = np.clip(q[k - 1, 5], q_m[k, 5] - lost, q_m[k, 5] + lost)
    q[:, 4] -= coupling * q[:, 5]
    noise = np.array([1e-3, 1e-3, 3e-4, 0.01, 0.01, 0.01])
    return Recording(t, {"motor_position": q_m, "joint_position": q + noise * rng.normal(size=q.shape)})


@pytest.mark.parametrize(
    ("lost", "coupling", "expected"),
    [
        (0.1, 0.0, {("lost_motion", 6): ("half_gap", 0.1)}),
        (0.0, 0.2, {("transmission_ratio_error", 5): ("relative_error", 0.2)}),
        (0.0, 0.0, {}),
    ],
)
def test_where_a_wrist_stands_tells_of_lost_motion_and_of_coupling(lost, coupling, expected):
    """Positions alone, of a robot by its E: what the camera's noise shares with the joints is no ratio error."""
    model = load_model(Path(__file__).parents[1] / "urdf" / "real" / "psm_serial.yaml")
    found = diagnose(model, [_wrist(0, lost, coupling)], [_wrist(1, lost, coupling)]).content["findings"]
    assert {(f["effect"], f["location"]["index"]) for f in found} == set(expected)
    for finding, (name, value) in zip(found, expected.values(), strict=True):
        assert finding["parameters"][name]["value"] == pytest.approx(value, rel=0.05)


def test_a_coupling_that_the_map_lacks_is_named_beside_torques(tmp_path):
    """A robot by its E, in which motor 3 does not know that it also runs with joint 2."""
    settings = {"effects": 0, "positions": "both", "n_links": 3, "noise": "white", "bits": 17, "duration": 30.0}
    model, runs, unseen, _ = loaded_trial(tmp_path, 3, **settings)
    lacking = model.motor_from_joint * (1.0 - np.outer([0, 0, 1], [0, 1, 0]))
    (tmp_path / "arm.urdf").write_text(generate_urdf(model.manipulator))
    content = {
        "name": "arm",
        "urdf": "arm.urdf",
        "gravity": [float(x) for x in model.chain.gravity],
        "transmission": {
            "joints": list(model.joints),
            "motors": list(model.motors),
            "joint_from_motor": np.linalg.inv(lacking).tolist(),
            "offset": model.offset.tolist(),
        },
    }
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(content))
    robot = load_model(tmp_path / "robot.yaml")
    (finding,) = diagnose(robot, runs, unseen).content["findings"]
    assert (finding["effect"], finding["location"]) == (
        "transmission_ratio_error",
        {"kind": "cable", "index": 3, "joint": 2},
    )
    missing = model.motor_from_joint[2, 1] / np.abs(model.motor_from_joint[2]).max()
    assert finding["parameters"]["relative_error"]["value"] == pytest.approx(missing, rel=0.01)


def test_a_motor_that_turns_with_a_joint_that_its_cable_does_not_pass_is_coupled_to_it(tmp_path):
    """An arm of cables with encoders on both sides; the motor's torque is felt at that joint, too."""
    settings = {"effects": 0, "positions": "both", "n_links": 3, "noise": "white", "bits": 17, "duration": 30.0}
    model, runs, unseen, _ = loaded_trial(tmp_path, 3, **settings)
    ratio, own = 0.06, model.motor_from_joint
    coupled = own + ratio * np.outer([1, 0, 0], [0, 1, 0])

    def turned(recording: Recording) -> Recording:
        q, tau = recording.channels["joint_position"], recording.channels["motor_torque"]
        channels = {
            "motor_position": recording.channels["motor_position"] + q @ (coupled - own).T,
            "motor_torque": tau @ own @ np.linalg.inv(coupled),
        }
        return replace(recording, channels=recording.channels | channels)

    content = diagnose(model, [turned(r) for r in runs], [turned(r) for r in unseen]).content
    (finding,) = content["findings"]
    assert (finding["effect"], finding["location"]) == (
        "transmission_coupling",
        {"kind": "motor", "index": 1, "joint": 2},
    )
    assert finding["parameters"]["ratio"]["value"] == pytest.approx(ratio, rel=0.01)


def _rubbed(recording: Recording, model, joint: int, coulomb: float, distance: float) -> Recording:
    """Add dry friction of a joint that gives, as a stuck contact does, over a distance before it slides."""
    rate = 1.0 / np.median(np.diff(recording.time))
    q, state = lowpass(recording.channels["joint_position"], rate, 12.0)[:, joint - 1], 0.0
    rub = np.zeros(len(q))
    for k, dq in enumerate(np.diff(q), start=1):
        state += (np.sign(dq) - state) * -np.expm1(-abs(dq) / distance)
        rub[k] = coulomb * state
    torque = recording.channels["motor_torque"] + rub[:, None] * model.joint_from_motor[joint - 1]
    return replace(recording, channels=recording.channels | {"motor_torque": torque})


@pytest.mark.parametrize("distance", [2e-4, 6e-4])
def test_dry_friction_that_gives_before_it_slides_is_one_finding(tmp_path, distance):
    """Stiction's presliding is part of dry friction: no hysteresis beside it, nothing unexplained."""
    settings = {"effects": 0, "positions": "joint", "n_links": 2, "noise": "white", "bits": 17, "duration": 30.0}
    model, runs, unseen, _ = loaded_trial(tmp_path, 11, **settings)
    rubbed = [[_rubbed(r, model, 2, 0.4, distance) for r in own] for own in (runs, unseen)]
    content = diagnose(model, *rubbed).content
    assert content["verdict"] == "missing_physics"
    (finding,) = content["findings"]
    assert (finding["effect"], finding["location"]) == ("coulomb_friction", {"kind": "joint", "index": 2})
    assert finding["parameters"]["coulomb"]["value"] == pytest.approx(0.4, rel=0.01)


@pytest.mark.slow
def test_a_stated_payload_is_no_discovery(tmp_path):
    """Recordings with and without a stated payload of half a link's mass: nothing is missing."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 5, effects=0, n_recordings=2, **CAPSTAN)
    mass = 0.5 * model.manipulator.links[-1].mass
    heavy = np.zeros(10 * model.n_joints)
    reach = 0.7 * model.manipulator.links[-1].length
    heavy[-10:] = mass * np.array([1.0, reach, 0, 0, 0, 0, reach**2, 0, 0, reach**2])
    loaded = model.with_standard_parameters(model.standard_parameters + heavy)
    t, raw = runs[1].time, runs[1].channels["joint_position"]
    rate = 1 / np.median(np.diff(t))
    smooth = lowpass(raw, rate, 8.0)
    v = differentiate(smooth, rate)
    a = differentiate(v, rate)
    added = (inverse_dynamics(loaded, smooth, v, a) - inverse_dynamics(model, smooth, v, a)) @ model.joint_from_motor
    with_load = runs[1].channels | {"motor_torque": runs[1].channels["motor_torque"] + added}
    carried = replace(runs[1], channels=with_load, payload=float(mass))
    told = diagnose(model, [replace(runs[0], payload=0.0), carried], unseen).content
    assert told["verdict"] == "consistent"
    untold = diagnose(model, [runs[0], replace(carried, payload=None)], unseen).content
    assert untold["fit"]["train"]["rmse_augmented"] > told["fit"]["train"]["rmse_augmented"]


def test_the_next_experiment_changes_the_pretension_where_that_tells_rivals_apart(tmp_path):
    """Dry friction at one pretension: capstan friction stands beside it, and half as much again tells them apart."""
    model, runs, unseen, _ = loaded_trial(tmp_path, 7, effects=["coulomb_friction"], **CAPSTAN)
    result = diagnose(model, runs, unseen)
    explanation, search = result.explanation, result.search
    own = explanation.found[0].candidate
    weights = own.place.weights(model)
    places = CATALOGUE["capstan_friction"].places(model)
    place = max(places, key=lambda p: abs(p.weights(model) @ weights) / np.linalg.norm(p.weights(model)))
    rival = Candidate(CATALOGUE["capstan_friction"], place, own.shape[:1])
    plan = plan_next(search, explanation, [(0, rival)], draws=3, duration=15.0)
    assert plan is not None
    assert "pretension" in plan.change
    assert plan.power > 0.9
    assert np.allclose(plan.motion.v[[0, -1]], 0.0, atol=1e-3)


def test_pairs_of_motors_are_named_once():
    model = load_model("urdf/planar3.yaml")
    places = [tuple(p.index) for p in pair_places(model)]
    assert len(set(places)) == len(places) == model.n_motors * (model.n_motors - 1) // 2


def test_what_clocks_and_derivatives_leave_is_no_effect(tmp_path):
    """An effect of a ten-thousandth of the torque passes no test, however quiet the sensors; a hundredth may."""
    model, runs, _, _ = loaded_trial(tmp_path, 3, effects=0, **CAPSTAN)
    problem = make_problem(model, runs)
    search = Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())
    (friction, *_) = all_candidates(problem, ["coulomb_friction"])
    for share, due in ((1e-2, True), (1e-4, False)):
        size = np.max(rms(search, [c[0] for c in search.columns(friction)]) / search.loads)
        assert is_resolved(search, friction, np.array([share / size]), search.fit([])) is due
    push = next(c for c in all_candidates(problem, ["external_torque"]))
    blow = replace(push, shape=(5.0, 5.0 + 0.5 / problem.band.cutoff, 0))
    assert not is_resolved(search, blow, np.array([100.0]), search.fit([]))


@pytest.mark.parametrize(("share", "due"), [(0.5, True), (-0.5, False), (-2.0, True)])
def test_what_noise_does_to_the_arm_is_no_friction(tmp_path, share, due):
    """A nameless friction that drives is the motion that noise makes, unless it is larger than that."""
    model, runs, _, _ = loaded_trial(tmp_path, 3, effects=0, **CAPSTAN)
    problem = make_problem(model, runs)
    search = Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())
    fit = search.fit([])
    (rub, *_) = all_candidates(problem, ["unnamed_reversal"])
    noise = rms(search, errors(search, fit.base, [], []))[0]
    size = share * noise / rms(search, [c[0] for c in search.columns(rub)])[0]
    assert is_resolved(search, rub, np.array([size, 0.0, 0.0, 0.0, 0.0]), fit) is due


def coarse_recording(model, step=2 * np.pi / 2**12, duration=60.0, offset=0.0):
    """Slow sines with a joint at rest, both encoders rounding down."""
    rng, t = np.random.default_rng(0), np.arange(int(100 * duration)) / 100
    w, phase = 2 * np.pi * np.array([0.03, 0.0, 0.045]), np.array([0.3, 1.0, 2.0])
    wave = w * t[:, None] + phase
    q, v, a = 0.8 * np.sin(wave), 0.8 * w * np.cos(wave), -0.8 * w**2 * np.sin(wave)
    torque = model.motor_torque(inverse_dynamics(model, q, v, a))
    torque += 3e-4 * np.std(torque) * rng.normal(size=torque.shape)
    sides = {"joint_position": q + offset, "motor_position": model.motor_position(q)}
    return Recording(t, {"motor_torque": torque} | {name: step * np.floor(x / step) for name, x in sides.items()})


def test_accelerations_of_slow_motions_are_slow():
    """Encoders too coarse for accelerations in the band: those that the torque does not hold are left out."""
    model = load_model("urdf/planar3.yaml")
    problem = make_problem(model, [coarse_recording(model)])
    assert problem.band.slow < problem.band.cutoff
    assert np.max(np.abs(problem.motions[0].a)) < 1.0


def test_columns_that_hang_on_torques_are_taken_about_what_was_found():
    """About other masses those of a gain are the other masses' torque; those of friction stay what they were."""
    model = load_model("urdf/planar3.yaml")
    t = np.arange(800) / 50.0
    q = 0.4 * np.sin(np.outer(t, [1.0, 1.6, 2.3]))
    v, a = (np.gradient(q, t, axis=0), np.gradient(np.gradient(q, t, axis=0), t, axis=0))
    torque = model.motor_torque(inverse_dynamics(model, q, v, a))
    noise = 0.01 * np.random.default_rng(0).standard_normal(torque.shape)
    heavier = Recording(t, {"joint_position": q, "motor_torque": 1.3 * torque + noise})
    search = Search(make_problem(model, [heavier]), base_parameters(model, columns=massive_columns(model)), Settings())
    gain, friction = (
        Candidate(CATALOGUE[name], CATALOGUE[name].places(model)[0]).detailed(search.problem.motions)
        for name in ("torque_gain_error", "viscous_friction")
    )
    before = [search.columns(c)[0] for c in (gain, friction)]
    there = about(search, search.fit([]))
    np.testing.assert_allclose(there.columns(gain)[0], 1.3 * before[0], atol=0.03 * np.abs(before[0]).max())
    assert there.columns(friction)[0] is before[1]


def test_rounding_names_nothing():
    """Encoders that round down and a joint at rest make no finding, no huge inertia; an offset of many steps shows."""
    model = load_model("urdf/planar3.yaml")
    problem = make_problem(model, [coarse_recording(model)])
    search = Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())
    assert np.abs(search.fit([]).base).max() < 1e3
    said = []
    for offset in (0.0, np.array([0.02, 0.0, 0.0])):
        found = diagnose(model, [coarse_recording(model, offset=offset)]).content["findings"]
        said.append([(f["effect"], f["location"].get("index")) for f in found][:1])
    assert said == [[], [("encoder_offset", 1)]]


def test_a_delay_is_what_its_column_was_made_for(tmp_path):
    """A small share of the column of a long delay would be a low-pass: the column is that of the delay itself."""
    model, runs, _, truth = loaded_trial(tmp_path, 3, **CAPSTAN | {"effects": ["time_delay"], "visibility": 30.0})
    problem = make_problem(model, runs)
    search = Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())
    here = truth["effects"][0]["location"]
    delay = next(c for c in all_candidates(problem, ["time_delay"]) if c.location == here)
    found, score = refine(search, search.fit([]), delay)
    assert found.shape[0] == pytest.approx(score.beta[0], rel=0.02)
    assert score.beta[0] == pytest.approx(truth["effects"][0]["parameters"]["delay"], rel=0.3)


@pytest.mark.slow
def test_a_small_finding_cannot_exclude_its_refinements(tmp_path):
    """Friction of a few newton millimetres may as well depend on direction or load; a large one may not."""
    listed = []
    for visibility in (8.0, 300.0):
        options = CAPSTAN | {"effects": ["coulomb_friction"], "visibility": visibility}
        model, runs, unseen, _ = loaded_trial(tmp_path / f"{visibility:g}", 5, **options)
        (finding,) = diagnose(model, runs, unseen).content["findings"]
        listed.append({e["effect"] for e in finding["indistinguishable_from"]})
    assert listed[0] & {"asymmetric_friction", "stribeck_friction", "friction_drift", "load_dependent_friction"}
    assert not listed[1] & {"asymmetric_friction", "stribeck_friction", "friction_drift"}


def test_a_stated_payload_is_in_the_motion(tmp_path):
    """What loads the cables in a recording is with the mass that was held; the other recording's is without."""
    trial = draw(5, n_links=2, effects=0, n_recordings=2, conditions=("payload",), duration=12.0)
    paths = trial.write(tmp_path)
    model = load_model(paths["manipulator"])
    problem = make_problem(model, [load_recording(path, model) for path in paths["recordings"]])
    search = Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())
    for there in (problem, about(search, search.fit([])).problem):
        masses = [run.motion.model.standard_parameters[-10] for run in there.runs]
        held = [run.payload for run in there.runs]
        assert sorted(held)[0] == 0.0 < sorted(held)[1]
        np.testing.assert_allclose(np.subtract(masses, there.model.standard_parameters[-10]), held, atol=1e-9)


@pytest.mark.slow
def test_springs_pull_on_links_that_swing(tmp_path):
    """Where links hang on a soft cable a known spring moves them too; one that does not stiffen is said not to."""
    model, runs, unseen, truth = loaded_trial(
        tmp_path, 3, n_links=2, effects=["cable_elasticity", "joint_spring"], positions="motor", noise="white",
        duration=40.0,
    )  # fmt: skip
    found = {f["effect"]: f["parameters"] for f in diagnose(model, runs, unseen).content["findings"]}
    true = {e["effect"]: e["parameters"] for e in truth["effects"]}
    assert set(found) == set(true)
    for effect, name, share in (
        ("cable_elasticity", "stiffness", 0.01),
        ("joint_spring", "stiffness", 0.01),
        ("joint_spring", "rest", 0.03),
    ):
        assert found[effect][name]["value"] == pytest.approx(true[effect][name], rel=share)
    assert "cubic" not in found["joint_spring"]


@pytest.mark.slow
def test_friction_and_a_constant_on_one_motor_are_not_unequal_friction_and_one_on_another():
    """On the paper's arm both say the same torque; the one with fewer numbers is named."""
    model, t = load_model("urdf/cdm2.yaml"), np.arange(0, 40, 0.005)

    def recording(seed):
        rng = np.random.default_rng(seed)
        angle = np.array([1.1, 1.7]) * t[:, None] + rng.uniform(0, 6, 2)
        q = 0.6 * (np.sin(angle) + np.sin(2.3 * angle))
        v, a = (differentiate(x, 200.0) for x in (q, differentiate(q, 200.0)))
        tau = inverse_dynamics(model, q, v, a) + 0.4 * np.tanh(v / 0.01) * [0.0, 1.0]
        torque = model.motor_torque(tau) + [0.0, 0.3] + 0.02 * rng.normal(size=q.shape)
        return Recording(t, {"joint_position": q, "motor_torque": torque}, label=str(seed))

    found = diagnose(model, [recording(1)], [recording(2)]).content["findings"]
    assert {(f["effect"], f["location"]["kind"], f["location"]["index"]) for f in found} == {
        ("coulomb_friction", "joint", 2),
        ("torque_offset", "motor", 2),
    }


@pytest.mark.parametrize("moved", [0.0, 2.5])
def test_a_line_of_the_motion_is_no_disturbance(monkeypatch, moved):
    """Half a per cent of what the motion asks for at a frequency is left by masses; alone it is a disturbance."""
    t, rng = np.arange(1200) / 20.0, np.random.default_rng(0)
    line = np.sin(2 * np.pi * 0.94 * t)
    rest = 0.01 * np.stack([line, 0 * t]) + 1e-3 * rng.normal(size=(2, 1200))
    problem = SimpleNamespace(
        model=load_model("urdf/cdm2.yaml"),
        band=SimpleNamespace(reduced_rate=20.0, cutoff=5.0),
        segments=[[(0, 1200)]],
        data=[(moved * np.stack([line, line]) + rest)[None]],
    )
    monkeypatch.setattr("cdm_pin.leftover.left_over", lambda search, effects, smooth: ([rest], None))
    found = tones(SimpleNamespace(problem=problem))
    assert [round(c.shape[0], 2) for c in found] == [0.94] * len(found)
    assert bool(found) != bool(moved)


def test_friction_of_a_joint_behind_a_wrong_cable_map_is_estimated_exactly(tmp_path):
    """Only motors are logged: the joint turns, and reverses, when the map's error and the motors say, not the file."""
    model, runs, _, truth = loaded_trial(
        tmp_path, 900002, effects=["transmission_ratio_error", "asymmetric_friction"], positions="motor", duration=40.0
    )
    (wrong, rub), names = truth["effects"], ("transmission_ratio_error", "asymmetric_friction")
    places = [
        next(p for p in CATALOGUE[name].places(model) if p.location == effect["location"])
        for name, effect in zip(names, truth["effects"], strict=True)
    ]
    problem = make_problem(model, runs)
    effects = [Candidate(CATALOGUE[names[0]], places[0]), Candidate(CATALOGUE[names[1]], places[1], (0.026,))]
    search = Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())
    whitener = even_noise(search, effects)
    for _ in range(6):
        fit = search.fit(effects, whitener)
        search = about(search, fit)
    (ratio,), (dry, unequal) = fit.beta
    assert ratio == pytest.approx(wrong["parameters"]["relative_error"], rel=0.03)
    sizes = rub["parameters"]["coulomb_positive"], rub["parameters"]["coulomb_negative"]
    assert [dry + unequal, dry - unequal] == pytest.approx(sizes, rel=0.02)
    assert problem.posture == ((), ()) != search.problem.posture


def test_friction_behind_a_late_logger_comes_to_rest(tmp_path):
    """Dry friction logged 26 ms late: columns about the delay as estimated leave nothing but noise."""
    draws = {"n_links": 3, "positions": "joint", "bits": 17, "noise": "white", "jitter": 0.0, "n_holdout": 0}
    model, runs, _, truth = loaded_trial(tmp_path, 7047, effects=["coulomb_friction", "time_delay"], **draws)
    problem = make_problem(model, runs)
    search = Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())
    search = about(search, search.fit([]))
    sat = [effect["location"] for effect in truth["effects"]]
    effects = [
        next(c for c in all_candidates(problem, [name]) if c.location == place).detailed(problem.motions)
        for name, place in zip(("coulomb_friction", "time_delay"), sat, strict=True)
    ]
    there, effects = settled(search, effects, rounds=4)
    left, noise = (left_over(there, effects, smooth=smooth)[1].rms for smooth in (False, True))
    assert np.all(left < 1.1 * noise)
    delay = truth["effects"][1]["parameters"]["delay"]
    assert there.fit(effects).beta[1][0] == pytest.approx(delay, rel=0.01)
    assert effects[1].shape[0] == pytest.approx(delay, rel=0.01)


@pytest.mark.parametrize(("peak", "statistic"), [(0.0, 90.0), (0.1, 20.0)])
def test_a_score_counts_what_a_sign_held_at_zero_gains_once_it_is_free(peak, statistic):
    law = SimpleNamespace(signs=(1, 1))
    fit = SimpleNamespace(effects=(law,), beta=(np.array([0.2, peak]),), whitener=None, deviance=100.0)
    search = SimpleNamespace(fit=lambda effects, whitener: SimpleNamespace(deviance=10.0))
    assert freed(search, fit, law, Score(20.0, 1, np.array([1.0]), 1.0, 1.0)).statistic == statistic


def test_a_model_changes_as_asked_for_also_where_a_mass_became_negative():
    """Of a mass alone no torque tells: a fit may make it negative, and the next has to find its link all the same."""
    model, rng = load_model("urdf/planar3.yaml"), np.random.default_rng(0)
    base = base_parameters(model, columns=massive_columns(model))
    start = base.values(model.standard_parameters)
    for change in (-3.0 * start, 0.1 * rng.normal(size=len(start))):
        model, start = updated_model(model, base, change), start + change
        assert base.values(model.standard_parameters) == pytest.approx(start, abs=1e-9)
    assert model.standard_parameters[0::10].min() < 0.0


def quick_recording(rate: float, *, disc: float = 0.0, peak: float = 0.0, level: float = 0.3, seed: int = 0):
    """Record 30 s of the planar arm of two links at some rate: dry friction on joint 2, encoders on both sides.

    That of motor 2 may sit on a disc that is eccentric by so much [rad], and friction be larger by a peak at low speed.
    """
    model, rng = load_model("urdf/cdm2.yaml"), np.random.default_rng(seed)
    t = np.arange(0.0, 30.0, 1.0 / rate)
    w = 2 * np.pi * 0.15 * np.arange(1, 6)
    a, b = np.random.default_rng(7).normal(size=(2, 2, 5)) * 0.35 / np.arange(1, 6)
    s, c = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
    q, v, acceleration = s @ a.T + c @ b.T, (c * w) @ a.T - (s * w) @ b.T, -(s * w**2) @ a.T - (c * w**2) @ b.T
    tau = inverse_dynamics(model, q, v, acceleration)
    tau[:, 1] += (level + peak * np.exp(-((v[:, 1] / 0.2) ** 2))) * np.tanh(v[:, 1] / 0.01)
    q_m, step = model.motor_position(q), 2 * np.pi / 2**17
    q_m[:, 1] += disc * np.sin(q_m[:, 1] + 0.4)
    noise = 0.02 * np.sqrt(rate / 200.0)  # of one density, whatever the rate
    torque = tau @ model.joint_from_motor + noise * rng.normal(size=q.shape)
    positions = {"joint_position": np.round(q / step) * step, "motor_position": np.round(q_m / step) * step}
    return model, Recording(t, positions | {"motor_torque": torque})


def test_a_recording_at_a_higher_rate_says_the_same():
    """A thousand samples per second are thinned before anything is fitted, to what two hundred would have said."""
    found = {}
    for rate in (200.0, 1000.0):
        model, record = quick_recording(rate)
        result = diagnose(model, [record])
        assert result.search is not None
        assert result.search.problem.band.rate == pytest.approx(200.0)
        (found[rate],) = result.content["findings"]
        assert (found[rate]["effect"], found[rate]["location"]) == ("coulomb_friction", {"kind": "joint", "index": 2})
    values, errors_ = zip(
        *((f["parameters"]["coulomb"][k] for k in ("value", "std")) for f in found.values()), strict=True
    )
    assert values == pytest.approx([0.3, 0.3], abs=0.006)
    assert errors_[1] == pytest.approx(errors_[0], rel=0.35)


def test_errors_of_a_law_may_hide_which_of_two_others_is_there():
    """In proportion to what the law explains; without it there is nothing to be wrong."""
    bounds = {}
    for level in (0.3, 1.2):
        search = search_of(*quick_recording(200.0, level=level))
        friction = {(c.effect.name, c.location["kind"], c.location.get("index")): c for c in search.common}
        dry, *others = (friction[name, "joint", 2] for name in ("coulomb_friction", "viscous_friction", "joint_spring"))
        assert between_errors_of_laws(search, search.fit([]), *others) == 0.0
        bounds[level] = between_errors_of_laws(search, search.fit([dry]), *others)
    assert bounds[0.3] > 0.0
    assert bounds[1.2] == pytest.approx(4.0 * bounds[0.3], rel=0.5)


@pytest.mark.parametrize("rate", [200.0, 500.0])
def test_what_is_taken_from_means_of_travels_is_taken_at_the_rate_of_columns(rate):
    """What winds up moves the mean of a travel by more than rounding may: data and columns lose the same of it.

    Were it taken at another rate, a fraction of a per cent of the mean would stay in one of them, as an offset.
    """
    model, record = quick_recording(rate)
    q, motor = (record.channels[name] for name in ("joint_position", "motor_position"))
    longer = 0.02 * q[:, 0] + 0.01 * record.time / record.time[-1]
    wound = record.channels | {"motor_position": motor + np.outer(longer, [1.0, 0.0])}
    (run,) = make_problem(model, [Recording(record.time, wound)], make_band(rate, 2.7)).runs
    travel = (wound["motor_position"] - model.motor_position(q)) * model.arm_scale
    mean = run.shares @ travel[:: round(rate / run.signals.rate)]
    assert (run.data[-model.n_motors :] @ run.shares)[0] == pytest.approx(run.sure[0] * mean[0], rel=1e-4)


@pytest.mark.parametrize(("rate", "most"), [(400.0, 1.17), (500.0, 1.17), (1003.86, 1.06), (2000.0, 1.06)])
@pytest.mark.parametrize("cutoff", [3.0, 5.3, 12.87, 20.0])
def test_a_thinned_band_keeps_its_rate(rate, most, cutoff):
    """As nearly as the ways to thin allow, of which a low rate has but one."""
    band = make_band(rate, cutoff)
    thin = _thinned(band)
    assert 190.0 < thin.rate < 400.0
    assert 1.0 - 1e-9 <= thin.reduced_rate / band.reduced_rate < most


@pytest.mark.parametrize(("peak", "due"), [(0.0, "coulomb_friction"), (0.15, "stribeck_friction")])
def test_friction_without_a_peak_is_dry(peak, due):
    model, record = quick_recording(200.0, peak=peak)
    search, _ = _rest(make_problem(model, [record]))
    bank = search.bank(all_candidates(search.problem, ["coulomb_friction", "stribeck_friction"]))
    law = Candidate(CATALOGUE["stribeck_friction"], joint_places(model)[1], (0.01, 0.2))
    found = peakless(explained(search, bank, [law]))
    assert [f.candidate.effect.name for f in found.found] == [due]


def test_unseen_recordings_at_another_rate_keep_the_band():
    model, record = quick_recording(200.0)
    problem = make_problem(model, [record])
    for rate, least in ((100.0, 100.0), (1000.0, 200.0)):
        unseen = make_problem(model, [quick_recording(rate)[1]], problem.band)
        assert least - 1.0 < unseen.band.rate < 2.0 * least
        assert unseen.band.cutoff == problem.band.cutoff
        torques = [rms(*_rest(p))[:2] for p in (unseen, problem)]
        assert torques[0] == pytest.approx(torques[1], rel=0.1)


def _rest(problem):
    """Give a search of a problem and what the rigid body leaves there."""
    search = Search(problem, base_parameters(problem.model, columns=massive_columns(problem.model)), Settings())
    fit = search.fit([])
    return search, errors(search, fit.base, [], [])


@pytest.mark.slow
def test_an_eccentric_encoder_disc_has_no_name_in_the_catalogue():
    """What one encoder reads off by a sine of its own angle is no error of the cable map, small as it is."""
    model, record = quick_recording(200.0, disc=0.006)
    content = diagnose(model, [record]).content
    assert content["verdict"] == "unexplained"
    assert content["unexplained"]["location"] == {"kind": "motor", "index": 2}
    assert "encoder" in content["unexplained"]["region"]
    (friction,) = content["findings"]  # which shows in torques, not in readings
    assert (friction["effect"], friction["location"]) == ("coulomb_friction", {"kind": "joint", "index": 2})


def test_a_misread_joint_moves_torques_as_its_readings_do():
    """Columns of an eccentric disc on a joint are what such readings make of travel and torque, to first order."""
    model, record = quick_recording(200.0)
    (motion,) = make_problem(model, [record]).motions
    place = next(p for p in PATCHES["unnamed_reading"].places(model) if p.location == {"kind": "joint", "index": 1})
    columns = PATCHES["unnamed_reading"].columns(motion, place, ())
    beta, q = 1e-5 * np.array([0.6, -0.8]), motion.q[:, 0]
    off = beta[0] * np.sin(q) + beta[1] * np.cos(q)
    slope, bend = beta[0] * np.cos(q) - beta[1] * np.sin(q), -off
    read = [motion.q.copy(), motion.v.copy(), motion.a.copy()]  # what it moves by is what it reads less the error
    read[0][:, 0] -= off
    read[1][:, 0] -= slope * motion.v[:, 0]
    read[2][:, 0] -= slope * motion.a[:, 0] + bend * motion.v[:, 0] ** 2
    due = (
        inverse_dynamics(model, *read) - inverse_dynamics(model, motion.q, motion.v, motion.a)
    ) @ model.joint_from_motor
    assert columns.torque is not None and columns.kinematic is not None
    assert columns.torque @ beta == pytest.approx(due, abs=1e-3 * np.abs(due).max())
    travel = -off[:, None] * model.arm_scale * model.motor_from_joint[:, 0]
    assert columns.kinematic @ beta == pytest.approx(travel, abs=1e-12)


@pytest.mark.parametrize(("larger", "widened"), [(1.0, False), (1.1, True)])
def test_errors_hold_what_recordings_say_apart(larger, widened):
    """Friction a tenth larger in the unseen recording: by so much its coefficient is not known, and no less."""
    model, record = quick_recording(200.0)
    search, _ = _rest(make_problem(model, [record]))
    other = quick_recording(200.0, seed=1, level=0.3 * larger)[1]
    law = Candidate(CATALOGUE["coulomb_friction"], joint_places(model)[1], (0.01,))
    fit = search.fit([law], search.noise([law]))
    judge = search.judge(make_problem(model, [other], search.problem.band))
    (step, spread), p = unseen_step(judge, fit), search.n_rigid
    assert step[p] == pytest.approx(0.3 * (larger - 1.0), abs=0.003)
    own, spread = fit.covariance[p:, p:], spread[p:, p:]
    values = parameters(law, fit.beta[0], own)
    after = with_scatter(law, fit.beta[0], step[p:], own + spread, values)["coulomb"]["std"]
    assert after == pytest.approx(
        np.hypot(values["coulomb"]["std"], 0.03) if widened else values["coulomb"]["std"], rel=0.15
    )


def test_columns_are_computed_anew_only_where_torques_changed(tmp_path):
    """A bank serves as long as the cables carry what they did; where effects load them otherwise it is renewed."""
    model, runs, _, _ = loaded_trial(tmp_path, 4242, effects=["coulomb_friction"], **CAPSTAN)
    problem = make_problem(model, runs)
    search = Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())
    bank = search.bank(all_candidates(problem, ["capstan_friction", "viscous_friction"]))
    change = np.zeros(len(search.base.columns))
    assert search.renewed(bank) is search.at(change, []).renewed(bank) is bank
    rub = next(c for c in all_candidates(problem, ["coulomb_friction"]) if c.location == {"kind": "joint", "index": 2})
    loaded = search.at(change, [(rub, np.array([0.5]))])
    fresh = loaded.renewed(bank)
    assert fresh is not bank
    assert loaded.renewed(fresh) is fresh
    slightly = search.at(change, [(rub, np.array([0.5001]))])
    assert slightly.renewed(fresh) is fresh
    assert not np.allclose(bank.lines[0].dense(), fresh.lines[0].dense(), rtol=0.01)


def test_zeros_of_encoders_do_not_drift_on_unseen_recordings(tmp_path):
    """Encoders on both sides of a joint that are 0.03 degrees apart: the unseen recording confirms what it shows."""
    seen = {"positions": "both", "bits": 17, "noise": "coloured", "n_links": 3, "duration": 30.0, "visibility": 20.0}
    model, runs, unseen, truth = loaded_trial(tmp_path, 32, effects=["encoder_offset"], **seen)
    problem = make_problem(model, unseen)
    search = Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())
    m = model.n_motors
    assert all(drifts[:, :m].any() and not drifts[:, m:].any() for drifts in own_drifts(search))
    found = diagnose(model, runs, unseen).content["findings"]
    (fault,) = truth["effects"]
    assert [(f["effect"], f["location"]) for f in found] == [(fault["effect"], fault["location"])]
    size = found[0]["parameters"]["offset"]
    assert abs(size["value"] - fault["parameters"]["offset"]) < 4 * size["std"]
