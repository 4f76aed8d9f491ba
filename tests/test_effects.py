"""The catalogue: parameters there and back, places, columns, and the completed model run forward."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from arms import planar_content
from scipy.linalg import null_space

from cdm_pin.base import base_parameters
from cdm_pin.cable_effects import _entry
from cdm_pin.candidates import Candidate, loaded, torque_of
from cdm_pin.completed import added_torque, effect_candidates, find_place
from cdm_pin.dynamics import joint_wrenches
from cdm_pin.effects import CATALOGUE, DRAGS
from cdm_pin.errors import ManipulatorError
from cdm_pin.friction_effects import creeping, dahl, maxwell
from cdm_pin.manipulator import parse_manipulator, with_effects
from cdm_pin.model import build_model, load_model
from cdm_pin.motion import Motion
from cdm_pin.places import kinds_of
from cdm_pin.sensor_effects import delayed
from cdm_pin.signals_filters import differentiate

PARAMETERS = {
    "viscous_friction": {"viscous": 0.2},
    "coulomb_friction": {"coulomb": 0.3},
    "stribeck_friction": {"coulomb": 0.3, "stribeck": 0.1, "stribeck_velocity": 0.2},
    "asymmetric_friction": {"coulomb_positive": 0.3, "coulomb_negative": 0.2},
    "quadratic_drag": {"coefficient": 0.1},
    "load_dependent_friction": {"coefficient": 0.001},
    "torque_dependent_friction": {"coefficient": 0.05},
    "position_dependent_friction": {"coulomb": 0.3, "depth": 0.5, "cycles": 2.0, "phase": 0.4},
    "cable_friction": {"coulomb": 0.3},
    "capstan_friction": {"mu": 0.02},
    "hysteresis": {"stiffness": 20.0, "limit": 0.4, "form": 0.0},
    "friction_drift": {"friction": 0.3, "extra": 0.8, "time_constant": 5.0},
    "joint_spring": {"stiffness": 2.0, "rest": 0.3, "cubic": 0.7},
    "cable_elasticity": {"stiffness": 120.0, "damping": 0.5},
    "backlash": {"half_gap": 0.01},
    "lost_motion": {"half_gap": 0.01, "distance": 0.2},
    "cable_slack": {"torque": 1.5, "stiffness": 120.0},
    "transmission_ratio_error": {"relative_error": 0.04},
    "transmission_coupling": {"ratio": 0.4, "inertia": 0.01, "viscous": 0.02, "coulomb": 0.1},
    "pulley_eccentricity": {"relative_eccentricity": 0.03, "phase": 0.5},
    "torque_ripple": {"amplitude": 0.2, "cycles": 9.0, "phase": 0.7},
    "rotor_inertia": {"inertia": 0.02},
    "torque_gain_error": {"gain": 1.08},
    "torque_offset": {"offset": -0.2},
    "encoder_offset": {"offset": 0.05},
    "base_tilt": {"angle": 0.06},
    "time_delay": {"delay": 0.012},
    "external_torque": {"torque": 0.4, "start": 2.0, "end": 4.0, "recording": 1.0},
}


def make_motion(model, duration=8.0, rate=200.0, **options):
    """Swing all joints with two sines each."""
    t = np.arange(int(duration * rate)) / rate
    n = model.n_joints
    phase = np.arange(n)
    q = np.zeros((len(t), n))
    v, a = q.copy(), q.copy()
    for size, w in ((0.4, 1.7), (0.25, 3.1)):
        x = w * t[:, None] * (1 + 0.13 * phase) + phase
        k = w * (1 + 0.13 * phase)
        q += size * np.sin(x)
        v += size * k * np.cos(x)
        a -= size * k**2 * np.sin(x)
    B = model.motor_from_joint.T
    return Motion(
        model=model,
        time=t,
        q=q,
        v=v,
        a=a,
        q_m=model.motor_position(q),
        v_m=v @ B,
        a_m=a @ B,
        velocity_noise=np.zeros(model.n_motors),
        pretension=80.0,
        **{"joints_measured": True, "motors_measured": False, **options},
    )


@pytest.fixture(scope="module")
def arm():
    return load_model("urdf/planar3.yaml")


def test_errors_of_a_map_are_relative_to_its_entries():
    """Those of a robot with gears; a coupling that the map lacks is relative to the motor's own joint."""
    model = build_model(parse_manipulator(planar_content(2, 3)))
    geared = SimpleNamespace(
        manipulator=SimpleNamespace(links=()), motor_from_joint=np.array([[50.0, 0.0], [-20.0, 80.0]])
    )
    assert [_entry(geared, i, k) for i, k in ((0, 0), (0, 1), (1, 0), (1, 1))] == [50.0, 50.0, -20.0, 80.0]
    assert _entry(model, 1, 0) == 1.0


def test_every_effect_has_an_example():
    """The table of this test names the whole catalogue, but for the payload, which is rigid-body inertia."""
    assert set(PARAMETERS) == set(CATALOGUE)


@pytest.mark.parametrize("name", PARAMETERS)
def test_parameters_there_and_back(name):
    """Coefficients and shape of physical parameters give the same physical parameters again."""
    effect = CATALOGUE[name]
    beta, shape = effect.coefficients(PARAMETERS[name])
    back = effect.physical(beta, shape)
    for key, value in PARAMETERS[name].items():
        assert back[key] == pytest.approx(value, rel=1e-9), key


@pytest.mark.parametrize("name", PARAMETERS)
@pytest.mark.parametrize("sides", [(True, False), (False, True), (True, True)])
def test_columns_are_finite_everywhere(arm, name, sides):
    """Each effect gives finite columns at each of its places, for each shape of its grid, whatever was measured."""
    motion = make_motion(arm, joints_measured=sides[0], motors_measured=sides[1])
    for place in CATALOGUE[name].places(arm):
        for shape in CATALOGUE[name].grid([motion], place)[:3]:
            columns = CATALOGUE[name].columns(motion, place, shape)
            for values in (columns.torque, columns.kinematic, *(columns.along or ())):
                assert values is None or np.isfinite(values).all()


def test_dry_friction_takes_power(arm):
    """Friction laws never give power: the torque they add times the motors' speed is never negative."""
    motion = make_motion(arm)
    for name in ("viscous_friction", "coulomb_friction", "stribeck_friction", "quadratic_drag", "cable_friction"):
        effect = CATALOGUE[name]
        for place in effect.places(arm):
            series, w = effect.columns(motion, place, effect.coefficients(PARAMETERS[name])[1]).along
            power = (effect.coefficients(PARAMETERS[name])[0] @ series) * (motion.v_m @ w)
            assert power.min() > -1e-12, (name, place.location)


def test_joint_friction_enters_by_virtual_work(arm):
    """A torque f at joint i asks E' e_i f of the motors: +f on its own cable and -f on the one before."""
    motion = make_motion(arm)
    model = build_model(
        with_effects(
            arm.manipulator,
            (
                {
                    "effect": "viscous_friction",
                    "location": {"kind": "joint", "index": 2},
                    "parameters": {"viscous": 2.0},
                },
            ),
        )
    )
    added = added_torque(motion.with_model(model))
    expected = 2.0 * motion.v[:, [1]] * arm.joint_from_motor[1]
    assert np.allclose(added, expected, atol=1e-12)
    assert added[:, 0] == pytest.approx(-added[:, 1])


def test_a_bearing_may_carry_the_links_alone(arm):
    """Cables that pull on a hinge make most of its load; without them it is what the links ask for, and far less."""
    motion, effect = make_motion(arm), CATALOGUE["load_dependent_friction"]
    place = effect.places(arm)[-1]
    shapes = effect.grid([motion], place)
    assert [shape[1] for shape in shapes] == [0.0, 1.0]
    all_of_it, links = (np.abs(effect.columns(motion, place, shape).along[0][0]) for shape in shapes)
    moving = np.abs(motion.v[:, place.index[0]]) > 0.3
    force = np.linalg.norm(joint_wrenches(arm, motion.q, motion.v, motion.a)[:, place.index[0], :3], axis=1)
    assert np.allclose(links[moving], force[moving], rtol=0.02)
    assert all_of_it[moving].mean() > 2.0 * links[moving].mean()


def test_a_coupling_may_be_felt_by_the_motor_alone(arm):
    """The friction is the same function of the same speed; only the other motors do not feel it."""
    motion, effect = make_motion(arm), CATALOGUE["transmission_coupling"]
    place = next(p for p in effect.places(arm) if p.index == (1, 0))
    (both, w), (alone, own) = (effect.columns(motion, place, (0.01, 0.4, flag)).along for flag in (0.0, 1.0))
    assert np.allclose(both[1:], alone[1:]) and not alone[0].any()
    assert np.array_equal(own, np.eye(arm.n_motors)[1]) and np.allclose(w - own, 0.4 * arm.joint_from_motor[0])


def test_exact_effects_of_the_rigid_body(arm):
    """First-order columns of encoder offset and tilt agree with finite changes of the model's torque."""
    motion = make_motion(arm)
    for name, small in (("encoder_offset", 1e-4), ("base_tilt", 1e-4)):
        effect = CATALOGUE[name]
        place = effect.places(arm)[0]
        column = effect.columns(motion, place, ()).torque[..., 0]
        if name == "encoder_offset":
            q = motion.q.copy()
            q[:, 0] -= small
            moved = replace(motion, q=q).tau_m
        else:
            model = arm.pin_model.copy()
            c, s = np.cos(small), np.sin(small)
            g = arm.chain.gravity
            model.gravity.linear = np.array([c * g[0] + s * g[1], -s * g[0] + c * g[1], g[2]])
            moved = motion.with_model(replace(arm, pin_model=model)).tau_m
        assert np.allclose((moved - motion.tau_m) / small, column, atol=2e-3 * np.abs(column).max())


@pytest.mark.parametrize("name", [name for name, effect in CATALOGUE.items() if effect.carried])
@pytest.mark.parametrize("sides", [(True, False), (False, True), (True, True)])
def test_a_logger_multiplies_and_delays_what_all_effects_bring(arm, name, sides):
    """Beside any other effect, a gain and a delay give the delayed product of the gain and of all that there is."""
    motion = make_motion(arm, joints_measured=sides[0], motors_measured=sides[1])
    beta, shape = CATALOGUE[name].coefficients(PARAMETERS[name])
    own = (Candidate(CATALOGUE[name], CATALOGUE[name].places(arm)[0], shape), beta)
    gain, delay = 1.25, 0.05

    def logged(*effects):
        about = loaded(motion, effects)
        rotors = motion.a_m * arm.rotor_inertia
        return motion.tau_m + rotors + sum(torque_of(c.raw_columns(about), b, rotors.shape) for c, b in effects)

    def logger(effect, **parameters):
        beta, shape = CATALOGUE[effect].coefficients(parameters)
        place = CATALOGUE[effect].places(arm)[0]
        return Candidate(CATALOGUE[effect], place, shape), beta

    expected = logged(own) * [gain, 1.0, 1.0]
    late = (logger("torque_gain_error", gain=gain), logger("time_delay", delay=delay))
    assert np.allclose(logged(own, late[0]), expected, atol=1e-9)
    assert np.allclose(logged(own, *late), delayed(expected, motion.rate, delay), atol=1e-9)


@pytest.mark.parametrize("sides", [(True, True), (False, True)], ids=["joints", "motors"])
def test_a_wrong_cable_map_is_exact_about_itself(arm, sides):
    """Once its size is known, a ratio error's torque is that of the cables that run so, not its first order.

    Where the joints are measured, the rotor that turns with the cable is part of it.
    """
    size, i, k = 0.08, 1, 1
    arm = replace(arm, rotor_inertia=np.full(arm.n_motors, 1e-2))
    motion = make_motion(arm, joints_measured=sides[0], motors_measured=sides[1])
    effect = CATALOGUE["transmission_ratio_error"]
    place = find_place(arm, effect, {"kind": "cable", "index": i + 1, "joint": k + 1})
    candidate = Candidate(effect, place)
    about = loaded(motion, [(candidate, np.array([size]))])
    found = motion.tau_m + size * candidate.columns(about).torque[..., 0]
    path = arm.arm_scale[:, None] * arm.motor_from_joint
    path[i, k] += size
    if sides[0]:
        tau = motion.tau
    else:
        turn = np.linalg.solve(path, np.diag(arm.arm_scale) @ arm.motor_from_joint).T
        tau = replace(motion, q=motion.q @ turn, v=motion.v @ turn, a=motion.a @ turn).tau
    exact = arm.arm_scale * np.linalg.solve(path.T, tau.T).T
    if sides[0]:
        exact[:, i] += arm.rotor_inertia[i] * size * motion.a[:, k] / arm.arm_scale[i]
    change = np.abs(exact - motion.tau_m).max()
    assert np.abs(found - exact).max() < (1e-3 if sides[0] else 1e-2) * change


def test_an_eccentric_pulley_turns_with_the_true_angle(arm):
    """An offset of the joint's encoder does not turn the pulley."""
    motion = make_motion(arm, motors_measured=True)
    encoder, pulley = CATALOGUE["encoder_offset"], CATALOGUE["pulley_eccentricity"]
    offset = Candidate(encoder, encoder.places(arm)[1])
    about = loaded(motion, [(offset, np.array([0.05]))])
    travel = pulley.columns(about, pulley.places(arm)[1], ()).kinematic[:, 1]
    q = motion.q[:, 1] - 0.05
    assert np.allclose(travel, np.stack([np.sin(q), np.cos(q) - 1.0], axis=1))


def test_a_slack_cable_gives_twice_and_turns_its_rotor(arm):
    """Where one strand hangs, a damper takes twice the travel; the rotor's acceleration has that of the travel."""
    arm = replace(arm, rotor_inertia=np.full(arm.n_motors, 1e-3))
    motion = make_motion(arm, motors_measured=True)
    effect = CATALOGUE["cable_slack"]
    load = motion.cable_torque[:, 0]
    limit = float(np.median(np.abs(load)))
    columns = effect.columns(motion, effect.places(arm)[0], (limit,))
    travel, damper = columns.kinematic[:, 0].T
    hangs = np.abs(load) > 1.05 * limit
    speed = np.gradient(travel, 1 / motion.rate)
    inside = slice(40, -40)
    assert np.allclose(
        damper[inside][hangs[inside]], -2 * speed[inside][hangs[inside]], atol=0.02 * np.abs(speed).max()
    )
    assert np.abs(columns.torque[:, 0, 0]).max() > 0.0


def test_torque_changes_along_any_direction_alike(arm):
    """The derivatives by all coordinates together give what a difference along the change gives."""
    motion = make_motion(arm)
    d = np.stack([np.sin(0.7 * motion.time), np.cos(0.4 * motion.time)], axis=1)[:, : arm.n_joints]
    d = np.pad(d, ((0, 0), (0, arm.n_joints - d.shape[1])))
    rates = np.gradient(d, motion.time, axis=0), np.zeros_like(d)
    whole, alone = motion.torque_change(d, rates), motion.torque_along(d, rates)
    assert whole == pytest.approx(alone, abs=1e-6 * np.abs(alone).max())


def test_a_level_arm_can_tilt_about_x_and_y(arm):
    """An arm that moves in a level plane leans ahead and sideways; one in a vertical plane only turns in it."""
    level = build_model(replace(arm.manipulator, gravity=np.array([0.0, 0.0, -9.81])))
    (place,) = CATALOGUE["base_tilt"].places(level)
    for model, count in ((arm, 1), (level, 2)):
        motion = make_motion(model)
        columns = CATALOGUE["base_tilt"].columns(motion, place, ())
        assert columns.torque.shape[-1] == count
        assert np.all(np.abs(columns.torque).max(axis=(0, 1)) > 1e-3)


def test_hysteresis_forgets_and_saturates():
    """Both laws with memory stay within one, reach it far from a reversal, and do not depend on the speed."""
    x = np.concatenate([np.linspace(0, 1, 400), np.linspace(1, -1, 800), np.linspace(-1, 0, 400)])
    for z in (dahl(x, 0.05), maxwell(x, 0.05, 2.0)):
        assert np.abs(z).max() <= 1 + 1e-12
        assert z[399] == pytest.approx(1.0, abs=1e-3)
        assert z[1199] == pytest.approx(-1.0, abs=1e-3)
    slow = dahl(np.repeat(x, 3), 0.05)[2::3]
    assert np.allclose(slow, dahl(x, 0.05), atol=1e-12)


@pytest.mark.parametrize("delay", [0.05, 0.0073, -0.0131, 0.0])
def test_delay_shifts(delay):
    """A delay moves a sine along the time axis, by whole samples or not."""
    t = np.arange(2000) / 200.0
    for frequency, error in ((0.7, 1e-12), (20.0, 1e-8), (50.0, 1e-3)):
        x, late = (np.sin(2 * np.pi * frequency * (t - d))[:, None] for d in (0.0, delay))
        np.testing.assert_allclose(delayed(x, 200.0, delay)[20:-20], late[20:-20], atol=error)


def test_delay_keeps_wrong_ends_at_the_ends():
    """A first sample that is far off, as derivatives are, does not ring through the recording."""
    t = np.arange(2000) / 100.0
    x = np.sin(2 * np.pi * 0.7 * t)[:, None]
    x[0] += 100.0
    late = np.sin(2 * np.pi * 0.7 * (t - 0.0073))[:, None]
    np.testing.assert_allclose(delayed(x, 100.0, 0.0073)[10:-10], late[10:-10], atol=1e-12)


def test_friction_of_what_creeps_comes_before_and_after_standstills():
    """Its sign is that of the motion beside the standstill; a reversal without one has none."""
    t = np.arange(4000) / 200.0
    halts = np.where(np.abs(np.sin(0.5 * t)) > 0.5, np.sign(np.sin(0.5 * t)), 0.0)
    series = creeping(halts, 0.01, 200.0)
    edges = np.flatnonzero(np.diff(halts))
    assert np.all(series[halts != 0.0] == pytest.approx(0.0, abs=1e-12))
    for k in edges:  # the sample before or after the edge that is at rest
        rest, moves = (k, k + 1) if halts[k] == 0.0 else (k + 1, k)
        assert series[rest] == pytest.approx(halts[moves])
    assert np.mean(np.abs(series)) == pytest.approx(4 * len(edges) / len(t), rel=0.1)
    for frequency, width in ((0.1, 0.05), (0.1, 0.1), (0.02, 0.05), (1.0, 0.2)):  # none of them halts
        swing = np.sin(2 * np.pi * frequency * t)
        assert np.mean(np.abs(creeping(swing, width, 200.0))) < 0.005


def test_only_where_there_are_pauses_does_anything_creep(arm):
    """Dry friction leaves one column more open on a motion that halts than on one that does not."""
    motion, effect = make_motion(arm), CATALOGUE["coulomb_friction"]
    place = effect.places(arm)[0]
    still = (motion.time % 2.0 < 1.0)[:, None]
    halting = replace(motion, v=motion.v * still, v_m=motion.v_m * still)
    bare = Candidate(effect, place, (0.01,))
    for m, columns in ((motion, 5), (halting, 6)):
        law = bare.detailed([m])
        assert law.creeps == (columns == 6)
        assert law.columns(m).along[0].shape[0] == columns
    assert bare.detailed([halting]).identity != replace(bare.detailed([halting]), creeps=False).identity


def test_places_by_name_and_alias():
    """Places are found by their own name and by another name for the same coordinate."""
    arm = load_model("urdf/cdm2.yaml")
    coulomb = CATALOGUE["coulomb_friction"]
    joint = find_place(arm, coulomb, {"kind": "joint", "index": 1})
    motor = find_place(arm, coulomb, {"kind": "motor", "index": 1})
    assert np.allclose(joint.weights(arm), motor.weights(arm))
    assert motor.location == {"kind": "motor", "index": 1}
    with pytest.raises(ManipulatorError, match="cannot sit at"):
        find_place(arm, coulomb, {"kind": "joint", "index": 9})


@pytest.mark.parametrize(
    ("record", "words"),
    [
        ({"effect": "coulomb_fricton", "location": {"kind": "joint", "index": 1}}, "did you mean 'coulomb_friction'"),
        (
            {"effect": "coulomb_friction", "location": {"kind": "joint", "index": 1}, "parameters": {"colomb": 1.0}},
            "did you mean 'coulomb'",
        ),
        (
            {"effect": "cable_elasticity", "location": {"kind": "cable", "index": 1}, "parameters": {}},
            "needs the parameters stiffness",
        ),
    ],
)
def test_wrong_effects_are_refused(arm, record, words):
    """A misspelt effect or parameter is an error that names the nearest known one."""
    with pytest.raises(ManipulatorError, match=words):
        effect_candidates(build_model(with_effects(arm.manipulator, (record,))))


def test_what_sits_at_joints_and_motors_is_of_both_where_these_are_one():
    """With a motor for each joint no motor is a place of its own, but friction may be said of it; a spring may not."""
    model = SimpleNamespace(
        n_joints=2,
        n_motors=2,
        joint_from_motor=np.diag([0.3, 0.2]),
        manipulator=SimpleNamespace(links=(), pulleys=None),
    )
    kinds = {name: kinds_of(CATALOGUE[name].places, model) for name in ("coulomb_friction", "joint_spring")}
    assert "motor" not in {place.location["kind"] for place in CATALOGUE["coulomb_friction"].places(model)}
    assert kinds["coulomb_friction"] >= {"joint", "motor"}
    assert kinds["joint_spring"] == {"joint"}


def test_bearings_that_turn_alike_but_carry_different_torques_are_two_places():
    """Motor 1 of the paper's arm turns with joint 1, but rubs by the torque of its own cable only."""
    arm = load_model("urdf/cdm2.yaml")
    places = {str(place.location): place for place in CATALOGUE["torque_dependent_friction"].places(arm)}
    joint, motor = (places[str({"kind": kind, "index": 1})] for kind in ("joint", "motor"))
    assert {"kind": "motor", "index": 1} not in joint.aliases
    assert {"kind": "motor", "index": 1} in CATALOGUE["coulomb_friction"].places(arm)[0].aliases
    motion, effect = make_motion(arm), CATALOGUE["torque_dependent_friction"]
    own, other = (effect.columns(motion, place, (0.01,)).along[0] for place in (motor, joint))
    assert np.allclose(own, np.abs(motion.tau_m[:, 0]) * np.tanh(motion.v[:, 0] / 0.01))
    assert np.allclose(other, np.abs(motion.tau[:, 0]) * np.tanh(motion.v[:, 0] / 0.01))
    assert not np.allclose(own, other, rtol=0.02)


def test_nothing_is_derived_from_noise(arm):
    """Of the cables' torque that stays which stands clear of the encoders' noise."""
    motion = make_motion(arm, inertia_noise=np.full(arm.n_motors, 2e-5))
    noise = 1e-5 * np.random.default_rng(0).standard_normal(motion.a.shape)
    shaken = replace(motion, a=motion.a + np.gradient(np.gradient(noise, motion.time, axis=0), motion.time, axis=0))
    error, shake = (x - motion.cable_torque for x in (shaken.clear_torque, shaken.cable_torque))
    inside = slice(100, -100)
    assert np.all(np.std(error[inside], axis=0) < 0.1 * np.std(shake[inside], axis=0))
    assert np.all(np.std(error[inside], axis=0) < 0.01 * np.std(motion.cable_torque, axis=0))


def test_no_delay_follows_from_noise(arm):
    """The noise that positions bring into the model's torque, and with it into the residual, looks like no delay."""
    motion = make_motion(arm, inertia_noise=np.full(arm.n_motors, 2e-5))
    noise = 1e-5 * np.random.default_rng(0).standard_normal(motion.a.shape)
    shaken = replace(motion, a=motion.a + np.gradient(np.gradient(noise, motion.time, axis=0), motion.time, axis=0))
    residual = (motion.logged_torque - shaken.logged_torque)[50:-50, 0]
    place = next(p for p in CATALOGUE["time_delay"].places(arm) if p.location == {"kind": "motor", "index": 1})
    late = CATALOGUE["time_delay"].columns(shaken, place, (0.01,)).torque[50:-50, 0, 0]
    true = CATALOGUE["time_delay"].columns(motion, place, (0.01,)).torque[50:-50, 0, 0]
    smoothed, exact = (
        (delayed(m.logged_torque, m.rate, 0.01) - m.logged_torque)[50:-50, 0] / 0.01 for m in (shaken, motion)
    )
    assert abs(residual @ late) < 0.1 * abs(residual @ smoothed)
    assert late @ exact == pytest.approx(late @ late, rel=5e-3)  # nor does noise make one look shorter
    inside = slice(150, -150)  # what is known ends a second after the recording begins, and before it ends
    np.testing.assert_allclose(true[inside], exact[inside], atol=1e-2 * np.abs(exact).max())


def test_ends_of_a_recording_are_no_motion(arm):
    """Accelerations are wild in the first and last samples; they do not let the noise pass for a torque."""
    motion = make_motion(arm, inertia_noise=np.full(arm.n_motors, 2e-5))
    noise = 1e-5 * np.random.default_rng(0).standard_normal(motion.a.shape)
    a = motion.a + np.gradient(np.gradient(noise, motion.time, axis=0), motion.time, axis=0)
    wild = a.copy()
    wild[:4] += 30.0
    wild[-4:] -= 30.0
    error = replace(motion, a=wild).clear_torque - motion.clear_torque
    shake = replace(motion, a=a).cable_torque - motion.cable_torque
    quick, all_of_it = (np.diff(x[200:-200], 2, axis=0).std(axis=0) for x in (error, shake))
    assert np.all(quick < 0.01 * all_of_it)


def test_friction_by_torque_may_follow_other_torques():
    """What the rotor takes, as the shape says; what springs bring is among what the law leaves open."""
    arm = load_model("urdf/cdm2.yaml")
    effect = CATALOGUE["torque_dependent_friction"]
    motion = make_motion(replace(arm, rotor_inertia=np.full(2, 0.05)))
    motor = next(p for p in effect.places(arm) if p.location == {"kind": "motor", "index": 2})
    assert [shape[1] for shape in effect.grid([motion], motor)] == [0.0, 1.0]
    assert [shape[1] for shape in effect.grid([make_motion(replace(arm, rotor_inertia=np.zeros(2)))], motor)] == [0.0]
    sign = np.tanh(motion.v_m[:, 1] / 0.01)
    for rotor in (0.0, 1.0):
        carried = motion.tau_m[:, 1] + rotor * 0.05 * motion.a_m[:, 1]
        assert np.allclose(effect.columns(motion, motor, (0.01, rotor)).along[0][0], np.abs(carried) * sign)
        assert np.allclose(effect.leaves_open(motion, motor, (0.01, rotor), np.array([0.1])).along[0], 0.0)
    spring = replace(motion, extra_joint=0.3 * motion.q)
    joint = next(p for p in effect.places(arm) if p.location == {"kind": "joint", "index": 2})
    for place, torque, more, v in (
        (joint, motion.tau[:, 1], 0.3 * motion.q[:, 1], motion.v[:, 1]),
        (motor, motion.tau_m[:, 1], (0.3 * motion.q @ arm.joint_from_motor)[:, 1], motion.v_m[:, 1]),
    ):
        change = np.abs(torque + more) - np.abs(torque)
        series = effect.leaves_open(spring, place, (0.01, 0.0), np.array([0.1])).along[0]
        assert np.allclose(series[0], 0.1 * change * np.tanh(v / 0.01))


def test_what_every_law_leaves_open_is_known_at_every_place():
    """Also on a robot with more joints than motors."""
    model = load_model("urdf/real/psm.yaml")
    assert model.n_joints > model.n_motors
    motion = make_motion(model)
    for effect in CATALOGUE.values():
        for place in effect.places(model) if effect.leaves_open is not None else ():
            beta, shape = np.full(len(effect.signs), 0.1), effect.grid([motion], place)[0]
            columns = effect.leaves_open(motion, place, shape, beta)
            assert columns.along is not None or columns.torque is not None


def test_a_tilt_shows_what_a_level_base_hides():
    """About a vertical axis a first moment is felt only under a tilt; its torque is among what may be wrong then."""
    model = build_model(parse_manipulator(planar_content(2, 3) | {"gravity": [0.0, 0.0, -9.81]}))
    motion, tilt = make_motion(model), np.array([0.05, -0.03])
    place = CATALOGUE["base_tilt"].places(model)[0]
    base, change = base_parameters(model), np.zeros((20, 1))
    k = base.standard_names.index("mx_1")
    assert k not in base.columns
    change[k] = 0.3
    wrong, file = (
        CATALOGUE["base_tilt"].columns(replace(motion, model=m), place, ()).torque @ tilt
        for m in (model.with_standard_parameters(model.standard_parameters + change[:, 0]), model)
    )
    assert np.abs(wrong - file).max() > 1e-3
    columns = CATALOGUE["base_tilt"].reveals(motion, change, tilt).torque
    assert np.abs(columns[..., 0] - (wrong - file)).max() < 1e-9
    level = build_model(parse_manipulator(planar_content(2, 3)))
    hidden = null_space(base_parameters(level).matrix)
    columns = CATALOGUE["base_tilt"].reveals(make_motion(level), hidden, np.array([0.05])).torque
    assert np.abs(columns).max() < 1e-9


@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_every_search_starts_inside_its_bounds(noise):
    """Also where the sign of a velocity is hardly known."""
    model = load_model("urdf/cdm2.yaml")
    motion = replace(make_motion(model), velocity_noise=np.full(2, noise))
    for effect in CATALOGUE.values():
        for place in effect.places(model):
            bounds = Candidate(effect, place).bounds([motion])
            for shape in effect.grid([motion], place):
                assert all(low <= x <= high for x, (low, high) in zip(shape, bounds, strict=False)), effect.name


@pytest.mark.parametrize("name", sorted(set(CATALOGUE) - {"cable_elasticity", "cable_slack", "torque_gain_error"}))
def test_sensitivities_name_the_parameter_that_is_given(name):
    """The first coefficient alone is the parameter that stands beside the amplitude."""
    effect = CATALOGUE[name]
    beta, shape = effect.coefficients(PARAMETERS[name])
    beta = np.where(np.arange(max(len(beta), len(effect.signs), 1)) == 0, 0.7, 0.0)
    if name in ("torque_ripple", "pulley_eccentricity"):
        beta[1:] = 0.0
    assert effect.physical(beta, shape)[effect.size.name] == pytest.approx(0.7)


def test_a_wrong_map_feels_the_springs():
    """Where links stand elsewhere than the motors say, a known spring pulls otherwise, too."""
    model = build_model(parse_manipulator(planar_content(2, 3)))
    motion = make_motion(model)
    spring = Candidate(CATALOGUE["joint_spring"], CATALOGUE["joint_spring"].places(model)[1], (1.0,))
    beta = np.array([2.0, 0.3, -0.4, 0.7])
    d = 0.02 * np.sin(motion.q)
    f = [spring.columns(replace(motion, q=motion.q + k * d)).along for k in (1e-3, -1e-3)]
    due = (beta @ f[0][0] - beta @ f[1][0])[:, None] * f[0][1] / 2e-3
    more = loaded(motion, [(spring, beta)]).torque_change(d) - motion.torque_change(d)
    np.testing.assert_allclose(more, due, atol=1e-6)
    assert np.ptp(due) > 0.01


@pytest.mark.parametrize("name", DRAGS)
def test_behind_a_wrong_map_drag_is_that_of_the_true_speed(name):
    """The column of the map's error has the rest of it: together they are the law at the speed that the joint has."""
    model = build_model(parse_manipulator(planar_content(2, 3)))
    motion = make_motion(model, joints_measured=False, motors_measured=True)
    place = next(p for p in CATALOGUE[name].places(model) if p.location == {"kind": "joint", "index": 2})
    drag, b = Candidate(CATALOGUE[name], place), np.array([0.8])
    wrong = CATALOGUE["transmission_ratio_error"]
    ratio = Candidate(wrong, next(p for p in wrong.places(model) if p.index == (1, 0)))
    r = np.array([0.04])
    with_it, without = (loaded(motion, [(ratio, r), *own]) for own in ([(drag, b)], []))
    extra = replace(with_it, drags=())
    change = ((ratio.raw_columns(with_it).torque - ratio.raw_columns(extra).torque) @ r).reshape(motion.n, -1)
    series, weights = drag.raw_columns(with_it).along
    total = (b @ series)[:, None] * weights + change
    v = motion.v[:, 1] + differentiate(without.shift[:, 1], motion.rate)
    law = v if name == "viscous_friction" else v * np.abs(v)
    steady = (np.sign(v) == np.sign(motion.v[:, 1])) & (np.abs(v) > 0.1)
    np.testing.assert_allclose(total[steady], (b[0] * law)[steady, None] * weights, atol=1e-3)
    assert np.abs(change[steady]).max() > 0.01


def test_behind_a_soft_cable_a_motor_drags_at_its_own_speed():
    """Where the joints alone are measured: the law at that speed, of which the cable's column has what it gives."""
    model = build_model(parse_manipulator(planar_content(2, 3)))
    motion = make_motion(model, joints_measured=True, motors_measured=False)
    law = CATALOGUE["viscous_friction"]
    place = next(p for p in law.places(model) if p.location == {"kind": "combination", "index": 1, "other": 2})
    drag, b = Candidate(law, place, (0.8,)), np.array([0.6])
    soft = Candidate(CATALOGUE["cable_elasticity"], CATALOGUE["cable_elasticity"].places(model)[0])
    c = np.array([1e-2, 1e-5])
    effects = [(drag, b), (soft, c)]
    with_it = loaded(loaded(motion, effects), effects)
    np.testing.assert_allclose(with_it.motor_speeds, motion.v_m, atol=1e-9)
    turns = differentiate(with_it.stretch, motion.rate)
    np.testing.assert_allclose(with_it.v_m, motion.v_m + turns, atol=1e-9)
    assert np.abs(turns[:, 0]).max() > 0.05 and not turns[:, 1].any()
    gives = soft.raw_columns(with_it).torque - soft.raw_columns(replace(with_it, motor_drags=())).torque
    series, weights = drag.raw_columns(with_it).along
    total = (b @ series)[:, None] * weights + gives @ c
    np.testing.assert_allclose(total, 0.6 * np.outer(with_it.v_m @ weights, weights), atol=1e-6)
    assert loaded(with_it, []).stretch is None
    np.testing.assert_allclose(loaded(with_it, []).v_m, motion.v_m, atol=1e-9)
