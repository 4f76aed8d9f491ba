"""The MuJoCo and Pinocchio plants carry the paper's mechanics, faults and sensors."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from cdm_pin.errors import InputError, SimulationError
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.plant.arms import draw_arm, manipulator_file
from cdm_pin.plant.catalogue import draw_fault
from cdm_pin.plant.faults import Fault
from cdm_pin.plant.mjcf import Strands, compile_arm
from cdm_pin.plant.mujoco_plant import MujocoPlant
from cdm_pin.plant.pinocchio_plant import PinocchioPlant
from cdm_pin.plant.sensing import Noise, Sensors
from cdm_pin.plant.simulate import control_instants, measured, pid_of_bandwidth, simulate


def make_arm(n, seed=0, rotors=True):
    arm, _ = draw_arm(np.random.default_rng(seed), n, rotors=rotors)
    content = manipulator_file(arm) | {"gravity": [1.0, -9.7, 0.0]}
    return parse_manipulator(content)


def pinocchio_model(manipulator):
    model = pin.Model()
    model.gravity.linear = manipulator.gravity
    parent = 0
    for link in manipulator.links:
        place = pin.SE3(np.eye(3), link.origin_xyz)
        parent = model.addJoint(parent, pin.JointModelRZ(), place, link.name)
        model.appendBodyToJoint(parent, pin.Inertia(link.mass, link.center_of_mass, link.inertia), pin.SE3.Identity())
    return model


def joint_from_motor(manipulator):
    n = len(manipulator.links)
    ratio = manipulator.pulleys.motor_pulley_radius[0] / manipulator.pulleys.joint_pulley_radius[0]
    return ratio * (np.eye(n) - np.eye(n, k=-1))


def other_plant(manipulator, faults=(), step=5e-4):
    n = len(manipulator.links)
    rotor = np.array([motor.rotor_inertia for motor in manipulator.motors] or np.zeros(n))
    how = {"rotor_inertia": rotor, "faults": faults, "step": step}
    model = pinocchio_model(manipulator)
    return PinocchioPlant(manipulator, model, range(1, n + 1), joint_from_motor(manipulator), **how)


def wave(time, n):
    w, size = 2.0 + 0.7 * np.arange(n), 0.5 - 0.1 * np.arange(n)
    return size * np.sin(np.outer(time, w)), size * w * np.cos(np.outer(time, w))


def run(plant, manipulator, duration=1.0, **settings):
    time = control_instants(plant, duration)
    q, v = wave(time, plant.n_joints)
    pid = pid_of_bandwidth(np.full(plant.n_motors, 0.1), bandwidth=3.0, **settings)
    return simulate(plant, time, q, v, pid, motor_from_joint=np.linalg.inv(joint_from_motor(manipulator)))


@pytest.mark.parametrize("n", [2, 3])
def test_tensions_of_the_transmission_give_the_commanded_accelerations(n):
    """Strand tensions T0 +- C/2r with C_i = tau_i - tau_(i+1) accelerate MuJoCo's tendon arm as Pinocchio says."""
    manipulator = make_arm(n, seed=n, rotors=False)
    model, reference = compile_arm(manipulator), pinocchio_model(manipulator)
    data, other, rng = mujoco.MjData(model), reference.createData(), np.random.default_rng(0)
    reach = 2.0 * manipulator.pulleys.wrap_half_angle - 0.02
    for _ in range(200):
        q, v, a = rng.uniform(-reach, reach), rng.normal(size=n), rng.normal(size=n)
        tau = pin.rnea(reference, other, q, v, a)
        half = 0.5 * (tau - np.append(tau[1:], 0.0)) / manipulator.pulleys.joint_pulley_radius
        data.qpos[:], data.qvel[:] = q, v
        data.ctrl[:] = -(manipulator.pretension + np.column_stack([half, -half])).ravel()
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qacc, a, atol=1e-8)


def test_two_plants_agree():
    """MuJoCo's tendons and Pinocchio's forward dynamics move alike under one controller, rotors included."""
    manipulator = make_arm(3)
    plants = MujocoPlant(manipulator, step=1e-4), other_plant(manipulator, step=1e-4)
    one, two = (run(plant, manipulator, 0.5) for plant in plants)
    np.testing.assert_allclose(one.q, two.q, atol=1e-4)
    np.testing.assert_allclose(one.q_m, two.q_m, atol=1e-4)
    np.testing.assert_allclose(one.q, one.q_m @ joint_from_motor(manipulator).T, atol=1e-12)


def test_pinocchio_plant_is_aba_without_rotors():
    """With as many joints as motors and no rotors the motors' acceleration is Pinocchio's aba through the map."""
    manipulator, rng = make_arm(3, rotors=False), np.random.default_rng(1)
    plant, model, E = other_plant(manipulator), pinocchio_model(manipulator), joint_from_motor(manipulator)
    for _ in range(20):
        q_m, v_m, tau_m, f = rng.normal(size=(4, 3))
        a = pin.aba(model, model.createData(), E @ q_m, E @ v_m, np.linalg.solve(E.T, tau_m) - f)
        np.testing.assert_allclose(E @ plant.acceleration(q_m, v_m, tau_m, f), a, rtol=1e-9)


def test_tensions_carry_the_links():
    """The tension difference at the drive pulley is the joint torques' difference; stiff cables add nothing."""
    manipulator = make_arm(2)
    rigid = run(MujocoPlant(manipulator), manipulator)
    stiff = run(MujocoPlant(manipulator, strands=Strands(2e7, 5e3), step=1e-4), manipulator)
    np.testing.assert_allclose(stiff.q[::5][: len(rigid.q)], rigid.q, atol=2.5e-3)
    model = pinocchio_model(manipulator)
    data = model.createData()
    v, a = (np.gradient(x, rigid.step, axis=0) for x in (rigid.q, np.gradient(rigid.q, rigid.step, axis=0)))
    for k in range(200, len(rigid.q) - 200, 100):
        tau = pin.rnea(model, data, rigid.q[k], v[k], a[k])
        pulled = (rigid.tension[k, 0] - rigid.tension[k, 1]) * manipulator.pulleys.joint_pulley_radius
        np.testing.assert_allclose(pulled, tau - np.append(tau[1:], 0.0), atol=0.03)
    np.testing.assert_allclose(rigid.tension.sum(axis=1), 2.0 * manipulator.pretension, rtol=1e-9)


def test_low_pretension_goes_slack():
    """An elastic strand never pushes: with little pretension one side hangs and its tension is nil."""
    slack = make_arm(2)
    slack = type(slack)(**(vars(slack) | {"pretension": 1.0}))
    tension = run(MujocoPlant(slack, strands=Strands(5e4, 0.0), step=2.5e-4), slack).tension
    assert tension.min() == 0.0 and tension.max() > 10.0


FAULTS = [
    Fault("viscous_friction", {"kind": "joint", "index": 2}, {"viscous": 0.2}, ()),
    Fault("viscous_friction", {"kind": "motor", "index": 1}, {"viscous": 0.1}, ()),
    Fault("joint_spring", {"kind": "joint", "index": 1}, {"stiffness": 2.0, "rest": 0.2}, ()),
    Fault("rotor_inertia", {"kind": "motor", "index": 2}, {"inertia": 0.02}, ()),
    Fault("payload", {"kind": "link", "index": 2}, {"mass": 0.4}, ()),
    Fault("base_tilt", {"kind": "base"}, {"angle": 0.2}, ()),
    Fault("torque_ripple", {"kind": "motor", "index": 1}, {"amplitude": 0.2, "cycles": 5.0, "phase": 0.3}, ()),
    Fault("cable_friction", {"kind": "cable", "index": 2, "link": 0}, {"coulomb": 0.2}, (), width=0.1),
    Fault("capstan_friction", {"kind": "cable", "index": 2, "link": 0}, {"mu": 0.03}, (), width=0.1),
    Fault("hysteresis", {"kind": "joint", "index": 2}, {"stiffness": 4.0, "limit": 0.2}, (), "dahl"),
]


@pytest.mark.parametrize("fault", FAULTS, ids=[f.effect + "-" + f.location["kind"] for f in FAULTS])
def test_a_fault_is_the_same_on_both_plants(fault):
    """What MuJoCo carries itself, or has applied, moves the arm as the same law does on Pinocchio."""
    manipulator = make_arm(2)
    how = {"step": 1e-4}
    clean = run(MujocoPlant(manipulator, **how), manipulator, 0.5)
    one = run(MujocoPlant(manipulator, faults=[fault], **how), manipulator, 0.5)
    two = run(other_plant(manipulator, [fault], **how), manipulator, 0.5)
    changed = np.abs(one.tau_m - clean.tau_m).max()
    assert changed > 0.01
    np.testing.assert_allclose(one.tau_m[20:], two.tau_m[20:], atol=0.05 * changed + 2e-3)


def test_dry_friction_of_mujoco_holds_and_drags():
    """MuJoCo's own dry friction at a joint costs its level in torque while sliding."""
    manipulator = make_arm(2)
    fault = Fault("coulomb_friction", {"kind": "motor", "index": 2}, {"coulomb": 0.3}, ())
    result = run(MujocoPlant(manipulator, faults=[fault]), manipulator, 2.0)
    v, a = (np.gradient(x, result.step, axis=0) for x in (result.q, np.gradient(result.q, result.step, axis=0)))
    model, E = pinocchio_model(manipulator), joint_from_motor(manipulator)
    data, rotor = model.createData(), np.array([motor.rotor_inertia for motor in manipulator.motors])
    v_m = v @ np.linalg.inv(E).T
    sliding = np.flatnonzero(np.abs(v_m[:, 1]) > 0.3)[200:-200:50]
    for k in sliding:
        rigid = E.T @ pin.rnea(model, data, result.q[k], v[k], a[k]) + rotor * (np.linalg.inv(E) @ a[k])
        np.testing.assert_allclose(result.tau_m[k, 1] - rigid[1], 0.3 * np.sign(v_m[k, 1]), atol=0.03)


def test_ratio_error_and_elasticity_show_between_the_encoders():
    """A wrong pulley turns the motor more per joint angle; an elastic cable stretches by torque over stiffness."""
    manipulator = make_arm(2)
    wrong = Fault("transmission_ratio_error", {"kind": "cable", "index": 2, "joint": 1}, {"relative_error": 0.05}, ())
    result = run(MujocoPlant(manipulator, faults=[wrong]), manipulator)
    nominal = result.q @ np.linalg.inv(joint_from_motor(manipulator)).T
    extra = (result.q_m - nominal) * manipulator.pulleys.motor_pulley_radius / manipulator.pulleys.joint_pulley_radius
    np.testing.assert_allclose(extra[:, 1], 0.05 * result.q[:, 0], atol=1e-9)
    np.testing.assert_allclose(extra[:, 0], 0.0, atol=1e-9)
    soft = Fault("cable_elasticity", {"kind": "cable", "index": 2}, {"stiffness": 80.0, "damping": 0.2}, ())
    result = run(MujocoPlant(manipulator, faults=[soft], step=2.5e-4), manipulator, 2.0)
    nominal = result.q @ np.linalg.inv(joint_from_motor(manipulator)).T
    stretch = (result.q_m - nominal) * manipulator.pulleys.motor_pulley_radius / manipulator.pulleys.joint_pulley_radius
    torque = (result.tension[:, 0] - result.tension[:, 1])[:, 1] * manipulator.pulleys.joint_pulley_radius[1]
    assert np.polyfit(stretch[1000:, 1], torque[1000:], 1)[0] == pytest.approx(80.0, rel=0.02)
    np.testing.assert_allclose(stretch[:, 0], 0.0, atol=1e-9)


def test_broken_runs_are_said():
    """An unstable gain and a joint turned beyond its pulleys end the simulation with a reason."""
    manipulator = make_arm(2)
    plant = MujocoPlant(manipulator)
    time = control_instants(plant, 1.0)
    q, v = wave(time, 2)
    how = {"motor_from_joint": np.linalg.inv(joint_from_motor(manipulator))}
    with pytest.raises(SimulationError, match="bandwidth"):
        simulate(plant, time, q, v, pid_of_bandwidth(np.full(2, 1.0), bandwidth=300.0), **how)
    far = 4.0 * time[:, None] * np.array([0.0, 1.0])
    with pytest.raises(SimulationError, match="joint 2 leaves its pulleys"):
        simulate(plant, time, far, np.tile([0.0, 4.0], (len(time), 1)), pid_of_bandwidth(np.full(2, 0.3)), **how)


def test_what_a_plant_cannot_be_is_said():
    """Robots without pulleys, elastic cables without rotors, and laws that no plant carries are refused by name."""
    arm = make_arm(2, rotors=False)
    with pytest.raises(InputError, match="rotor inertia above zero"):
        MujocoPlant(arm, strands=Strands(1e5))
    backlash = Fault("backlash", {"kind": "cable", "index": 1}, {"half_gap": 0.01}, ())
    for make in (lambda: MujocoPlant(arm, faults=[backlash]), lambda: other_plant(arm, [backlash])):
        with pytest.raises(InputError, match="cannot simulate backlash"):
            make()
    spatial = parse_manipulator(
        manipulator_file(draw_arm(np.random.default_rng(0), 2, rotors=False)[0])
        | {"links": [{"length": 0.3, "mass": 1.0, "inertia": [0.1] * 3, "axis": [0, 1, 0]}]}
    )
    with pytest.raises(InputError, match="planar arms"):
        MujocoPlant(spatial)


def test_sensors_round_delay_and_add_noise():
    """Logged positions are multiples of the encoder's step; gain, offset and delay act on torques alone."""
    manipulator = make_arm(2)
    result = run(MujocoPlant(manipulator), manipulator, 2.0)
    exact = measured(result, Sensors("both", 0, 200.0, 0.0))
    np.testing.assert_allclose(exact["joint_position"], result.q[::10][: len(exact["time"])], atol=1e-12)
    rough = measured(result, Sensors("both", 12, 200.0, 0.0), Noise(np.full(2, 0.01)), seed=1)
    tick = 2.0 * np.pi / 2**12
    np.testing.assert_allclose(rough["joint_position"] / tick, np.round(rough["joint_position"] / tick), atol=1e-9)
    assert (rough["motor_torque"] - exact["motor_torque"]).std() == pytest.approx(0.01, rel=0.1)
    faults = [
        Fault("time_delay", {"kind": "system"}, {"delay": 0.02}, ()),
        Fault("torque_gain_error", {"kind": "motor", "index": 1}, {"gain": 1.1}, ()),
        Fault("torque_offset", {"kind": "motor", "index": 2}, {"offset": 0.4}, ()),
    ]
    late = measured(result, Sensors("joint", 0, 200.0, 0.0), faults=faults)
    np.testing.assert_allclose(late["motor_torque"][4:, 0], 1.1 * exact["motor_torque"][:-4, 0], atol=1e-9)
    np.testing.assert_allclose(late["motor_torque"][4:, 1], exact["motor_torque"][:-4, 1] + 0.4, atol=1e-9)
    np.testing.assert_array_equal(late["joint_position"], exact["joint_position"])
    assert "motor_position" not in late


def test_no_law_is_drawn_that_mujoco_cannot_carry():
    """Of the laws of hysteresis none that remembers the tension of a cable."""
    rng = np.random.default_rng(0)
    forms = {
        tension: {draw_fault("hysteresis", rng, 3, 1.0, tension).form for _ in range(60)} for tension in (False, True)
    }
    assert forms[True] - forms[False] == {"tension"}
