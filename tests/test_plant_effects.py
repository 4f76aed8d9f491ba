"""What the plant injects is what the catalogue says, place by place: formulas written anew, against the simulation."""

from __future__ import annotations

import numpy as np
import pytest

from cdm_pin.errors import SimulationError
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.plant.absolute import prescribed
from cdm_pin.plant.arms import draw_arm, draw_reference, draw_servo, manipulator_file
from cdm_pin.plant.catalogue import CATALOGUE
from cdm_pin.plant.draw import draw
from cdm_pin.plant.faults import Fault
from cdm_pin.plant.paths import ideal_cables, stretch_torque
from cdm_pin.plant.planar import hinge_reactions
from cdm_pin.plant.run import FINE_STEP, simulate_run
from cdm_pin.plant.sensing import encoder_offsets, torque_as_logged

N, WIDTH = 3, 0.02


class Scene:
    """One arm on one motion; joint and motor states by the paper's map, joint torques by summing the clean cables'."""

    def __init__(self):
        rng = np.random.default_rng(8)
        self.arm, _ = draw_arm(rng, N, rotors=False)
        self.reference = draw_reference(rng, N)
        self.clean = self.run()
        self.t = np.arange(len(self.clean.phi)) * FINE_STEP
        to_joint = np.eye(N) - np.eye(N, k=-1)
        self.theta, self.rate, self.acc = (x @ to_joint.T for x in (self.clean.phi, self.clean.w, self.clean.a))
        self.E = self.arm.ratio * to_joint
        inverse = np.linalg.inv(self.E).T
        self.q_m, self.v_m, self.a_m = (x @ inverse for x in (self.theta, self.rate, self.acc))
        self.tau = np.linalg.solve(self.E.T, self.clean.tau_m.T).T

    def run(self, *faults):
        return simulate_run(self.arm, faults, self.arm, None, self.reference, 4.0)


@pytest.fixture(scope="module")
def scene():
    return Scene()


def sign(v):
    return np.tanh(v / WIDTH)


LEVEL = {"coulomb": 0.3}
STRIBECK = {"coulomb": 0.3, "stribeck": 0.2, "stribeck_velocity": 0.2}
UNEVEN = {"coulomb_positive": 0.4, "coulomb_negative": 0.2}
POSITION = {"coulomb": 0.3, "depth": 0.8, "cycles": 2.0, "phase": 0.5}
DRIFT = {"friction": 0.3, "extra": 1.2, "time_constant": 3.0}
LAWS = {  # f at the place, of time, position, velocity and torque there
    "viscous_friction": ({"viscous": 0.2}, lambda t, q, v, tau: 0.2 * v),
    "coulomb_friction": (LEVEL, lambda t, q, v, tau: 0.3 * sign(v)),
    "stribeck_friction": (STRIBECK, lambda t, q, v, tau: (0.3 + 0.2 * np.exp(-((v / 0.2) ** 2))) * sign(v)),
    "asymmetric_friction": (UNEVEN, lambda t, q, v, tau: np.where(v > 0, 0.4, -0.2)),
    "torque_dependent_friction": ({"coefficient": 0.1}, lambda t, q, v, tau: 0.1 * np.abs(tau) * sign(v)),
    "position_dependent_friction": (
        POSITION,
        lambda t, q, v, tau: 0.3 * (1 + 0.8 * np.sin(2 * q + 0.5)) * sign(v),
    ),
    "friction_drift": (DRIFT, lambda t, q, v, tau: 0.3 * (1 + 1.2 * np.exp(-t / 3.0)) * sign(v)),
}
AT_JOINTS = {
    "quadratic_drag": ({"coefficient": 0.2}, lambda t, q, v, tau: 0.2 * v * np.abs(v)),
    "joint_spring": (
        {"stiffness": 1.5, "rest": 0.2, "cubic": 0.7},
        lambda t, q, v, tau: 1.5 * (q - 0.2) + 0.7 * (q - 0.2) ** 3,
    ),
    "external_torque": (
        {"torque": 0.6, "time": [1.0, 2.5]},
        lambda t, q, v, tau: np.where((t > 1.0) & (t < 2.5), -0.6, 0.0),
    ),
}
AT_MOTORS = {
    "torque_ripple": (
        {"amplitude": 0.3, "cycles": 7.0, "phase": 0.4},
        lambda t, q, v, tau: 0.3 * np.sin(7 * q + 0.4),
    )
}


def added(scene, fault):
    """Give what a fault adds to the motors' torque (N, n)."""
    return scene.run(fault).tau_m - scene.clean.tau_m


def clear_of_steps(*v):
    """Leave out samples around reversals, where the smooth sign has a width of its own."""
    return np.all([np.abs(x) > 4 * WIDTH for x in v], axis=0)


@pytest.mark.parametrize("name", [*LAWS, *AT_JOINTS])
@pytest.mark.parametrize("i", [1, 2, 3])
def test_joint_effects_enter_on_their_own_cable_and_reversed_on_the_one_before(scene, name, i):
    """An effect f at joint i adds E^T f: +f r_m/r_j on motor i, the same reversed on motor i-1, none elsewhere."""
    parameters, law = (LAWS | AT_JOINTS)[name]
    q, v, tau = scene.theta[:, i - 1], scene.rate[:, i - 1], scene.tau[:, i - 1]
    f = law(scene.t, q, v, tau)
    change = added(scene, Fault(name, {"kind": "joint", "index": i}, parameters, (), width=WIDTH))
    expected = np.zeros_like(change)
    expected[:, i - 1] = scene.arm.ratio * f
    if i > 1:
        expected[:, i - 2] = -scene.arm.ratio * f
    where = clear_of_steps(v) & (np.abs(scene.t - 1.0) > 0.02) & (np.abs(scene.t - 2.5) > 0.02)
    tolerance = 0.02 if name == "torque_dependent_friction" else 2e-3  # there it loads itself
    np.testing.assert_allclose(change[where], expected[where], atol=tolerance * np.abs(f).max())


@pytest.mark.parametrize("name", [*LAWS, *AT_MOTORS])
@pytest.mark.parametrize("i", [1, 3])
def test_motor_effects_enter_at_one_motor(scene, name, i):
    """An effect f at motor i adds f there, of that motor's own angle, speed and torque, and nothing elsewhere."""
    parameters, law = (LAWS | AT_MOTORS)[name]
    q, v, tau = (x[:, i - 1] for x in (scene.q_m, scene.v_m, scene.clean.tau_m))
    fault = Fault(name, {"kind": "motor", "index": i}, parameters, (), width=WIDTH * scene.arm.ratio)
    f = law(scene.t, q, v, tau)
    expected = np.zeros_like(scene.clean.tau_m)
    expected[:, i - 1] = f
    where = clear_of_steps(v)
    np.testing.assert_allclose(added(scene, fault)[where], expected[where], atol=2e-3 * np.abs(f).max())


def test_cables_rub_on_guides_of_a_link(scene):
    """Cable 3 on guides of link 1 slides with (r_m/r_j) q_m3 - theta_1; its friction acts on both."""
    v = scene.arm.ratio * scene.v_m[:, 2] - scene.rate[:, 0]
    fault = Fault("cable_friction", {"kind": "cable", "index": 3, "link": 1}, LEVEL, (), width=WIDTH)
    f, change = 0.3 * sign(v), added(scene, fault)
    expected = np.column_stack([-scene.arm.ratio * f, 0 * f, scene.arm.ratio * f])
    np.testing.assert_allclose(change, expected, atol=1e-9)
    np.testing.assert_allclose((change * scene.v_m).sum(axis=1), f * v, atol=1e-9)


def test_combinations_conserve_power(scene):
    """Parts that rub on each other: tau_m = w f(w' v_m)."""
    w = np.array([0.0, 1.0, -0.6])
    fault = Fault("viscous_friction", {"kind": "combination", "weights": w.tolist()}, {"viscous": 0.2}, ())
    np.testing.assert_allclose(added(scene, fault), np.outer(0.2 * scene.v_m @ w, w), atol=1e-9)


def test_bearing_friction_grows_with_the_hinge_force(scene):
    """F is the coefficient times the force the hinge carries, pretension included."""
    force = np.empty((len(scene.t), N))
    for k in range(len(scene.t)):
        hinge_reactions(
            scene.arm, *(x[k] for x in (scene.clean.phi, scene.clean.w, scene.clean.a, scene.clean.C)), force[k]
        )
    fault = Fault("load_dependent_friction", {"kind": "joint", "index": 2}, {"coefficient": 1e-3}, (), width=WIDTH)
    f = 1e-3 * force[:, 1] * sign(scene.rate[:, 1])
    change = added(scene, fault)
    np.testing.assert_allclose(change[:, 1], scene.arm.ratio * f, atol=0.02 * np.abs(f).max())
    np.testing.assert_allclose(change[:, 0], -change[:, 1], atol=1e-9)
    np.testing.assert_allclose(change[:, 2], 0.0, atol=1e-9)


def test_a_coupled_motor_turns_with_another_joint(scene):
    """Friction and rotor act on v_i + ratio v_k: at motor i itself, and ratio times as much at joint k."""
    parameters = {"ratio": 0.5, "coulomb": 0.3, "inertia": 0.02}
    fault = Fault("transmission_coupling", {"kind": "motor", "index": 3, "joint": 1}, parameters, (), width=WIDTH)
    change = added(scene, fault)
    v, a = scene.v_m[:, 2] + 0.5 * scene.rate[:, 0], scene.a_m[:, 2] + 0.5 * scene.acc[:, 0]
    f = 0.3 * np.tanh(v / (WIDTH / scene.arm.ratio)) + 0.02 * a
    expected = np.column_stack([scene.arm.ratio * 0.5 * f, 0 * f, f])
    np.testing.assert_allclose(change, expected, atol=2e-3 * np.abs(f).max())


def test_rotor_tilt_and_payload(scene):
    """A rotor adds J a_m; a base tilted by +angle about z is gravity turned back; a payload hangs at its link's end."""
    rotor = added(scene, Fault("rotor_inertia", {"kind": "motor", "index": 2}, {"inertia": 0.03}, ()))
    np.testing.assert_allclose(rotor, np.outer(0.03 * scene.a_m[:, 1], [0, 1, 0]), atol=1e-9)
    tilt = scene.run(Fault("base_tilt", {"kind": "base"}, {"angle": 0.1}, ()))
    x, y = scene.arm.gravity
    turned = np.array([np.cos(0.1) * x + np.sin(0.1) * y, np.cos(0.1) * y - np.sin(0.1) * x])
    other = scene.arm._replace(gravity=turned)
    np.testing.assert_allclose(tilt.tau_m, simulate_run(other, [], other, None, scene.reference, 4.0).tau_m, atol=1e-9)
    still = scene.reference._replace(sine=0 * scene.reference.sine, cosine=0 * scene.reference.cosine)
    at_rest = [
        simulate_run(scene.arm, faults, scene.arm, None, still, 0.1).tau_m[5]
        for faults in ([], [Fault("payload", {"kind": "link", "index": 3}, {"mass": 0.5}, ())])
    ]
    phi = np.cumsum(scene.reference.centre)
    lever = scene.arm.length * (np.cos(phi) * scene.arm.gravity[1] - np.sin(phi) * scene.arm.gravity[0])
    np.testing.assert_allclose(at_rest[1] - at_rest[0], -0.5 * scene.arm.ratio * lever, atol=1e-9)


def test_path_errors_show_between_the_encoders_and_do_no_work(scene):
    """The motor angle is that of the table, and the torque is what virtual work asks for."""
    ratio = Fault("transmission_ratio_error", {"kind": "cable", "index": 3, "joint": 2}, {"relative_error": 0.05}, ())
    round_off = Fault(
        "pulley_eccentricity", {"kind": "joint", "index": 2}, {"relative_eccentricity": 0.04, "phase": 0.7}, ()
    )
    extra = (0.05 * scene.theta[:, 1], 0.04 * (np.sin(scene.theta[:, 1] + 0.7) - np.sin(0.7)))
    for fault, i, beyond in zip((ratio, round_off), (2, 1), extra, strict=True):
        run = scene.run(fault)
        expected = scene.q_m * scene.arm.ratio
        expected[:, i] += beyond
        np.testing.assert_allclose(run.q_m * scene.arm.ratio, expected, atol=1e-12)
        speed = np.gradient(run.q_m, FINE_STEP, axis=0)
        power = (scene.clean.tau_m * scene.v_m).sum(axis=1)
        np.testing.assert_allclose((run.tau_m * speed).sum(axis=1)[2:-2], power[2:-2], atol=2e-4 * np.abs(power).max())


def test_backlash_rests_on_the_side_that_pulls(scene):
    """The motor is half a gap ahead where the cable pulls forwards, half a gap behind where it pulls back."""
    run = scene.run(Fault("backlash", {"kind": "cable", "index": 2}, {"half_gap": 0.01}, ()))
    lost = (run.q_m - scene.q_m) * scene.arm.ratio
    pulling = np.abs(scene.clean.C[:, 1]) > 0.1
    np.testing.assert_allclose(lost[pulling, 1], 0.01 * np.sign(scene.clean.C[pulling, 1]), atol=1e-5)
    np.testing.assert_allclose(lost[:, [0, 2]], 0.0, atol=1e-12)


def test_a_slack_strand_halves_the_stiffness():
    """Torque grows with K up to the torque at which one side hangs, with K/2 beyond; damping adds to it."""
    cables = ideal_cables(1)._replace(stiffness=np.array([100.0]), slack=np.array([2.0]), damping=np.array([0.5]))
    torque = [
        stretch_torque(cables, 0, x, dx) for x, dx in ((0.01, 0.0), (0.02, 0.0), (0.04, 0.0), (-0.04, 0.0), (0.01, 2.0))
    ]
    np.testing.assert_allclose(torque, [1.0, 2.0, 3.0, -3.0, 2.0])


def test_elastic_cables_stretch_by_their_torque():
    """Between motor and links lies C = K x + D dx/dt of the cable that stretches; the others stay the map's."""
    rng = np.random.default_rng(2)
    arm, scale = draw_arm(rng, 2, rotors=True)
    servo = draw_servo(rng, arm, scale)
    soft = Fault("cable_elasticity", {"kind": "cable", "index": 2}, {"stiffness": 120.0, "damping": 0.3}, ())
    run = simulate_run(arm, [soft], arm, servo, draw_reference(rng, 2), 3.0)
    x = run.q_m * arm.ratio - run.phi
    rate = np.gradient(x, run.step, axis=0)
    np.testing.assert_allclose((120.0 * x + 0.3 * rate)[10:-10, 1], run.C[10:-10, 1], atol=1e-2 * scale)
    np.testing.assert_allclose(x[:, 0], 0.0, atol=1e-12)


def test_cables_too_stiff_to_integrate_are_stretched_by_their_load():
    """The motion is that of rigid cables, the motor ahead by C / K."""
    rng = np.random.default_rng(2)
    arm, scale = draw_arm(rng, 2, rotors=True)
    servo, reference = draw_servo(rng, arm, scale), draw_reference(rng, 2)
    stiff = Fault("cable_elasticity", {"kind": "cable", "index": 2}, {"stiffness": 1e6, "damping": 3e3}, ())
    run, rigid = (simulate_run(arm, faults, arm, servo, reference, 3.0) for faults in ([stiff], []))
    np.testing.assert_allclose(run.phi, rigid.phi, atol=1e-9)
    np.testing.assert_allclose((run.q_m - rigid.q_m) * arm.ratio, rigid.C / np.array([np.inf, 1e6]), atol=2e-6)


@pytest.mark.parametrize("stiffness", [np.inf, 100.0])
def test_a_loop_that_diverges_says_so(stiffness):
    """What such a loop did not reach is not taken for a motion."""
    rng = np.random.default_rng(2)
    arm, scale = draw_arm(rng, 2, rotors=True)
    servo = draw_servo(rng, arm, scale)
    wild = servo._replace(damping=-50.0 * servo.damping)
    soft = Fault("cable_elasticity", {"kind": "cable", "index": 2}, {"stiffness": stiffness, "damping": 0.3}, ())
    with pytest.raises(SimulationError, match="diverges"):
        simulate_run(arm, [soft], arm, wild, draw_reference(rng, 2), 3.0)


def test_what_is_logged(scene):
    """Delay, gain and offset change the logged torque in that order of the table; encoders show true plus offset."""
    faults = [
        Fault("time_delay", {"kind": "system"}, {"delay": 0.02}, ()),
        Fault("torque_gain_error", {"kind": "motor", "index": 2}, {"gain": 1.1}, ()),
        Fault("torque_offset", {"kind": "motor", "index": 2}, {"offset": 0.3}, ()),
    ]
    t = scene.t[100::10]
    logged = torque_as_logged(faults, scene.clean.tau_m, FINE_STEP, t)
    late = scene.clean.tau_m[60::10][: len(t)]
    np.testing.assert_allclose(logged[:-4], (late * [1.0, 1.1, 1.0] + [0.0, 0.3, 0.0])[:-4], atol=1e-6)
    offset = encoder_offsets([Fault("encoder_offset", {"kind": "joint", "index": 2}, {"offset": 0.1}, ())], N)
    np.testing.assert_array_equal(offset, [0.0, 0.1, 0.0])


def test_every_drawn_arm_loads():
    """The manipulator file of any draw of 2 to 6 links is accepted by the reader that a user's file meets."""
    for n in range(2, 7):
        for seed in range(60):
            rng = np.random.default_rng(seed)
            arm, _ = draw_arm(rng, n, rotors=seed % 2 == 0)
            assert len(parse_manipulator(manipulator_file(arm, rng)).links) == n


def test_draws_vary(tmp_path):
    """Left open, a draw takes all sorts of sensors, noise, servo and arm; recordings may have their own conditions."""
    truths = [draw(seed, effects=0, duration=1.0, n_holdout=0).truth for seed in range(60)]
    assert {truth["n_links"] for truth in truths} == {2, 3, 4, 5, 6}
    assert {truth["sensors"]["positions"] for truth in truths} == {"joint", "motor", "both"}
    assert {truth["sensors"]["bits"] for truth in truths} == {14, 17}
    assert {truth["noise"]["correlation"] > 0 for truth in truths} == {True, False}
    assert {truth["motion"] for truth in truths} == {"loop", "prescribed"}
    how = {"n_links": 2, "duration": 2.0, "n_recordings": 2, "conditions": ("pretension", "payload")}
    trial = draw(3, effects=["load_dependent_friction"], positions="joint", **how)
    assert not trial.conditions[0] and trial.conditions[1].keys() == {"pretension", "payload"}
    paths = trial.write(tmp_path)
    assert [path.name for path in paths["recordings"]] == ["run_1.csv", "run_2.yaml"]
    alone = draw(3, effects=["load_dependent_friction"], positions="joint", **(how | {"conditions": ()}))
    assert not any(alone.conditions)


def test_an_arm_that_no_servo_moves_is_drawn_anew(monkeypatch):
    """Slower at first, then another arm from the same seed; where none moves, what was wrong at first is said."""
    tried, moves_at = [], 5

    def attempt(seed, rng, slower, **settings):
        tried.append((rng.random(), slower))
        if len(tried) < moves_at:
            raise SimulationError(f"attempt {len(tried)} diverges")
        return "moves"

    monkeypatch.setattr("cdm_pin.plant.draw._draw", attempt)
    assert draw(7) == "moves"
    assert [slower for _, slower in tried] == [1.0, 0.75, 0.55, 0.4, 1.0]
    assert tried[0][0] == tried[3][0] == np.random.default_rng(7).random() != tried[4][0]
    tried, moves_at = [], 99
    with pytest.raises(SimulationError, match="attempt 1 diverges"):
        draw(7)


def test_effects_are_as_visible_as_asked_for():
    """Every effect of a draw reaches the visibility asked for, unless it lies in the span of the masses."""
    for seed in range(6):
        truth = draw(seed, n_links=2, effects=1, at_least=50.0, duration=10.0, n_holdout=0, motion="prescribed").truth
        (effect,) = truth["effects"]
        hidden = ("rotor_inertia", "payload", "encoder_offset")
        assert effect["visibility"] >= 50.0 or effect["effect"] in hidden
    assert set(LAWS) | set(AT_JOINTS) | set(AT_MOTORS) <= set(CATALOGUE)


def test_prescribed_motion_is_the_reference(scene):
    """A perfect servo's motion is the reference itself."""
    phi, _, _ = prescribed(scene.reference, FINE_STEP, len(scene.t))
    np.testing.assert_array_equal(phi, scene.clean.phi)
