"""What identification does to motions before it fits them: accelerations, signs of friction, motors at rest, places."""

from __future__ import annotations

import signal

import numpy as np
import pytest
from arms import ROOT, relative
from chains import fourier, logged, spatial_arm

from cdm_pin import signals_checks
from cdm_pin.accelerations import Acceleration, choose_accelerations
from cdm_pin.dynamics import motor_torques
from cdm_pin.errors import InputError, RecordingError
from cdm_pin.estimators import inverse
from cdm_pin.identified import content, identified_manipulator
from cdm_pin.identify import identify
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.model import build_model, load_model
from cdm_pin.recording import Recording
from cdm_pin.robots import robot_urdf
from cdm_pin.sign_widths import choose_factors
from cdm_pin.signals import check, prepare
from cdm_pin.signals_clock import sampling_instants
from cdm_pin.terms import parse_effects
from cdm_pin.workers import processes

CDM2 = load_model(ROOT / "urdf" / "cdm2.yaml")
PSM = load_model(ROOT / "urdf" / "real" / "psm.yaml")
OFFSETS = ("viscous_friction", "coulomb_friction", "torque_offset")


def ur5():
    """Give the first three joints of a UR5."""
    joints = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
    transmission = {"joints": joints, "joint_from_motor": np.eye(3).tolist()}
    return build_model(parse_manipulator({"urdf": str(robot_urdf("ur5_robot")), "transmission": transmission}))


# --- accelerations ----------------------------------------------------------------------------------------------------


def candidate_rows(noise):
    """Give a motor's torque that follows a slow acceleration; faster candidates carry noise of their own."""
    rng = np.random.default_rng(0)
    slow = np.sin(np.arange(400) / 9)[:, None, None]
    y = 2.0 * slow[..., 0] + 0.05 * rng.normal(size=(400, 1))
    columns = {c: slow + noise / c.cutoff**0 * rng.normal(size=slow.shape) * (c.cutoff > 3) for c in CANDIDATES}
    return lambda choice: (columns[choice], y)


CANDIDATES = [
    Acceleration(),
    Acceleration("position", 10.0),
    Acceleration("position", 3.0),
    Acceleration("velocity", 3),
]


@pytest.mark.parametrize(("noise", "expected"), [(0.5, CANDIDATES[2]), (0.0, CANDIDATES[0])])
def test_the_widest_band_that_explains_the_torque_is_taken(noise, expected):
    """Noise in fast accelerations narrows the band, to the first of equals; without any the motion is left alone."""
    assert choose_accelerations(CANDIDATES, candidate_rows(noise), np.ones((1, 1), bool)) == (expected,)


def test_few_rows_choose_nothing():
    """Fewer rows than a fit can be judged by leave the motion as it is."""
    rows = lambda choice: (np.ones((3, 1, 1)), np.ones((3, 1)))  # noqa: E731
    assert choose_accelerations(CANDIDATES, rows, np.ones((1, 1), bool)) == (CANDIDATES[0],)


def test_vibration_that_the_torque_does_not_hold_is_left_out():
    """A motor encoder that sees its cables vibrate: the band stops below, and the values are near the truth again."""
    run = logged(CDM2, 1, noise=0.02, phi=0.0)
    shake = 3e-3 * np.sin(2 * np.pi * 2.5 * run.time)[:, None] * [1.0, -1.0]
    shaken = Recording(run.time, {**run.channels, "joint_position": run.channels["joint_position"] + shake})
    result = identify(CDM2, [shaken], cutoff=4.0)
    assert all(choice.cutoff < 2.5 for choice in result.train.visits[0].accelerations)
    assert any("accelerations as far as the torques show them" in text for text in result.train.visits[0].notices)
    truth = CDM2.standard_parameters @ result.base.matrix.T
    assert relative(result.fit.values, truth) < 0.05
    clean = identify(CDM2, [run], cutoff=4.0)
    assert all(np.isinf(choice.cutoff) for choice in clean.train.visits[0].accelerations)


# --- friction ---------------------------------------------------------------------------------------------------------


def test_the_width_of_a_sign_is_found_between_the_steps():
    """Friction that turns over 0.05 rad/s, tried from 0.01 on: the factor is 5."""
    v = np.sin(np.arange(2000) / 31)[:, None]
    y = 0.3 * np.tanh(v / 0.05) + 1e-3 * np.random.default_rng(0).normal(size=v.shape)
    signs = lambda factor: np.tanh(v / (0.01 * factor))[..., None]  # noqa: E731
    factor = choose_factors(signs(1.0), y, signs, [0], np.ones((1, 1), bool))
    assert factor[0] == pytest.approx(5.0, rel=0.15)
    sharp = 0.3 * np.sign(v) + 1e-3 * np.random.default_rng(0).normal(size=v.shape)
    assert choose_factors(signs(1.0), sharp, signs, [0], np.ones((1, 1), bool))[0] == 1.0


def test_blunt_friction_keeps_its_size():
    """Coulomb friction that turns over a tenth of the speed is not taken for viscous friction."""
    run = logged(CDM2, 3, noise=0.005, phi=0.0)
    v_m = fourier(2, 30.0, 100.0, 3)[2] @ CDM2.motor_from_joint.T
    rubbed = run.channels["motor_torque"] + 0.2 * np.tanh(v_m / 0.05)
    result = identify(CDM2, [Recording(run.time, {**run.channels, "motor_torque": rubbed})], effects=OFFSETS[:2])
    np.testing.assert_allclose(result.fit.values[6:], [0, 0, 0.2, 0.2], atol=0.01)


def test_places_by_name_and_between_parts():
    """Joints and motors by their names, sums and differences of them, each a term of its own name."""
    places = ["finger_1_joint", "finger_2_joint-finger_1_joint", "disc_7+disc_6", "roll"]
    terms = parse_effects(PSM, [f"coulomb_friction:{place}" for place in places])
    assert len({term.name for term in terms}) == 4
    fingers = PSM.joint_from_motor[[PSM.joints.index(f"finger_{k}_joint") for k in (1, 2)]]
    weights = [term.place.weights(PSM) for term in terms]
    np.testing.assert_allclose(weights[:2], [fingers[0], fingers[1] - fingers[0]])
    np.testing.assert_allclose(weights[2:], [[0, 0, 0, 0, 0, 1, 1], [0, 0, 0, 1, 0, 0, 0]])
    for bad in ("finger_1_joint-finger_9_joint", "finger_1_joint-finger_1_joint", "nowhere"):
        with pytest.raises(InputError, match="nowhere on this robot"):
            parse_effects(PSM, [f"coulomb_friction:{bad}"])


def test_harmonics_of_an_angle_are_found_and_kept():
    """A torque that depends on a motor's angle, its order stated: amplitude, phase, and the same in the model file."""
    run = logged(CDM2, 2, noise=0.01)
    q_m = CDM2.motor_position(run.channels["joint_position"])
    torque = run.channels["motor_torque"] + np.outer(0.4 * np.sin(2.0 * q_m[:, 1] + 0.5), [0.0, 1.0])
    run = Recording(run.time, {**run.channels, "motor_torque": torque})
    result = identify(CDM2, [run], effects=["torque_ripple:motor2:cycles=2"])
    (found,) = content(result)["effects"]
    amplitude, phase = found["parameters"]["amplitude"], found["parameters"]["phase"]
    assert abs(amplitude["value"] - 0.4) < 4 * amplitude["std"] < 0.05
    assert abs(phase["value"] - 0.5) < 4 * phase["std"] < 0.1
    assert found["parameters"]["cycles"]["std"] is None
    again = identify(build_model(identified_manipulator(result)), [run])
    assert np.all(again.residual < 1.1 * result.residual)
    for text in ("torque_ripple:motor2", "torque_ripple:motor2:cycles=x", "viscous_friction:motor2:cycles=1"):
        with pytest.raises(InputError, match="--effects"):
            parse_effects(CDM2, [text])


def test_a_spring_beside_an_offset():
    """Where a spring rests cannot be told from an offset: the stiffness is found, and the file can be written."""
    run = logged(CDM2, 2, noise=0.01)
    torque = run.channels["motor_torque"] + 1.5 * CDM2.motor_position(run.channels["joint_position"]) * [0.0, 1.0]
    run = Recording(run.time, {**run.channels, "motor_torque": torque})
    result = identify(CDM2, [run], effects=["torque_offset", "joint_spring:motor2"])
    records = {record["effect"]: record["parameters"] for record in content(result)["effects"]}
    assert records["joint_spring"]["stiffness"]["value"] == pytest.approx(1.5, abs=0.02)
    written = {effect["effect"] for effect in identified_manipulator(result).effects}
    assert written == {"torque_offset", "joint_spring"}


# --- what rests -------------------------------------------------------------------------------------------------------


def test_torque_of_a_motor_at_rest_is_not_fitted():
    """Friction holds any torque where a motor rests: a wild one there changes nothing, and it is said."""
    model = ur5()
    run = logged(model, 4, locked=(2,))
    stuck = run.channels["motor_torque"].copy()
    stuck[:, 2] += 5.0 + np.sin(run.time)
    wild = Recording(run.time, {**run.channels, "motor_torque": stuck})
    first, second = (identify(model, [r], effects=OFFSETS) for r in (run, wild))
    np.testing.assert_allclose(first.fit.values, second.fit.values, rtol=1e-9)
    assert any("rests: friction can hold any torque" in text for text in second.train.visits[0].notices)
    assert "torque_offset motor 3" in dict(second.not_identifiable)


def test_parameters_of_very_different_units_keep_their_errors():
    """An information matrix whose diagonal spans 24 decades is inverted as well as one of ones."""
    H = np.array([[2.0, 0.5, 0.1], [0.5, 1.0, 0.2], [0.1, 0.2, 3.0]])
    scale = np.array([1.0, 1e-6, 1e6])
    found = inverse(H * np.outer(scale, scale)) * np.outer(scale, scale)
    np.testing.assert_allclose(found, np.linalg.inv(H), rtol=1e-9, atol=1e-12)
    zero = np.zeros((2, 2))
    zero[0, 0] = 4.0
    np.testing.assert_allclose(inverse(zero), [[0.25, 0.0], [0.0, 0.0]])


def test_negative_rotors_are_told():
    """A value that physics forbids is said to be one, and the model file has none below zero."""
    model = ur5()
    t, q, v, a = fourier(3, 30.0, 100.0, 6)
    noise = 1e-3 * np.random.default_rng(0).normal(size=q.shape)
    tau = motor_torques(model, q, v, a) - 5.0 * a * [0, 0, 1] + noise
    run = Recording(t, {"joint_position": q, "motor_torque": tau})
    result = identify(model, [run], effects=["viscous_friction", "rotor_inertia"])
    assert any(hint.startswith("rotor_inertia motor 3 came out negative") for hint in result.hints)
    assert all(value >= -1e-9 for value in result.physical_effects)


# --- notices ----------------------------------------------------------------------------------------------------------


def test_joints_that_move_alike_are_no_bad_clock():
    """Joints in proportion are displaced together at every frequency; only a row's own irregularity is a clock's."""
    t = np.arange(12000) / 200
    wave = sum(np.sin(2 * np.pi * 0.17 * k * t + k) / k for k in range(1, 7))
    wave = wave * (1 - np.exp(-((t / 2.0) ** 2)))
    assert sampling_instants(t, np.outer(wave, [1.0, 0.5, -0.3])) is None


def test_rows_of_a_robot_that_creeps_to_rest_tell_no_delay():
    """Stamps rounded to 1 ms are told while joints move; where they settle the slower the displacement, none is."""
    t, rng = np.arange(9000) / 400, np.random.default_rng(3)
    targets = np.repeat(rng.uniform(-1.0, 1.0, (10, 2)), 900, axis=0)
    q, v = np.zeros((2, 9000, 2))
    for k in range(1, 9000):  # to each target in a second, then the rest of the way with a rattle that dies out
        v[k] = v[k - 1] + (36.0 * (targets[k] - q[k - 1]) - 12.0 * v[k - 1]) / 400
        q[k] = q[k - 1] + v[k] / 400
    rattle = 2e-4 * np.exp(-3.0 * (t % 2.25)) * np.sin(2 * np.pi * 90.0 * t)
    q = 5e-5 * np.round((q + rattle[:, None] * [1.0, -0.4]) / 5e-5)
    stamps = np.round(t, 3) + 1e-9 * np.arange(9000)
    found = sampling_instants(stamps, q)
    instants = stamps if found is None else found[0]
    quick = np.abs(v).max(axis=1) > 0.3 * np.abs(v).max()
    assert np.std((instants - t)[quick]) < 0.3 * np.std((stamps - t)[quick])
    assert np.std(instants - t) < 1.5 * np.std(stamps - t)


def test_a_torque_that_the_robot_needs_is_not_called_wrong(monkeypatch):
    """Where a rough fit speaks against a sign, the robot's own masses decide; without them the fit does."""
    monkeypatch.setattr(signals_checks, "_t_values", lambda *_: np.array([-20.0, -20.0]))
    for model in (CDM2, spatial_arm(4, 1)):
        run = logged(model, 1, noise=0.0, encoder=0.0)
        channels = ("joint_position", "motor_position", "motor_torque")
        run = Recording(run.time, {**run.channels, "motor_position": model.motor_position(run.channels[channels[0]])})
        turned = Recording(run.time, {**run.channels, "motor_torque": -run.channels["motor_torque"]})
        kinds = [[c.kind for c in check(prepare(r, m), m)] for r, m in ((run, model), (turned, model), (run, None))]
        assert [found.count("torque_sign") for found in kinds] == [0, model.n_motors, model.n_motors]


def test_a_locked_joint_warns_of_nothing():
    """A column that never changes is no joint to tell delays by: no division by its spread."""
    t = np.arange(4000) / 200
    q = np.column_stack([np.sin(3 * t), 0.0 * t, np.cos(2 * t)])
    with np.errstate(all="raise", under="ignore"):
        assert sampling_instants(t, q) is None


def test_a_holdout_of_another_robot_is_told_though_some_values_are_vague():
    """Also where not every value is sure: no prediction is better than none on most motors."""
    model = ur5()
    runs = [logged(model, s, duration=20.0, noise=0.5) for s in (1, 2)]
    other = spatial_arm(3, 2)
    with pytest.raises(RecordingError, match="another robot"):
        identify(model, runs[:1], holdout=[logged(other, 3)], effects=OFFSETS)
    assert identify(model, runs[:1], holdout=runs[1:], effects=OFFSETS).holdout is not None


def test_processes_do_not_see_interrupts():
    """A process is started with interrupts blocked; the one that starts it is as before."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    with processes(1) as workers:
        assert signal.SIGINT in workers.executor.submit(signal.pthread_sigmask, signal.SIG_BLOCK, []).result()
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == before
