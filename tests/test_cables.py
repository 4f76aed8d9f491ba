"""The cable layer: three routes to the motor torque, contacts, hinges, wrap, slack; MuJoCo's tendons as judge."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from arms import ROOT, paper_radii, planar_arm, planar_arms, relative, states
from hypothesis import given, settings
from hypothesis import strategies as st
from tendons import tendon_arm

from cdm_pin.cables import cable_forces, cable_state, hinge_reaction, joint_rotations, wrap_angles
from cdm_pin.dynamics import inverse_dynamics, joint_wrenches, mass_matrix
from cdm_pin.errors import GeometryError
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.model import build_model, load_model
from cdm_pin.printed import printed_cable_torque
from cdm_pin.recursion import newton_euler
from cdm_pin.transmission import cable_travel

PAPER = load_model(ROOT / "urdf" / "cdm2.yaml")
PLANAR3 = load_model(ROOT / "urdf" / "planar3.yaml")
SPATIAL7 = load_model(ROOT / "urdf" / "spatial7.yaml")


@given(planar_arms, st.integers(0, 10**6), st.floats(0.0, 1000.0))
@settings(max_examples=60, deadline=None)
def test_route_1_equals_route_2(model, seed, pretension):
    """RNEA with E and the recursion over pulleys agree on motor torques, tensions and hinges.

    1 to 8 links, radii per joint, 0 to 1000 N of pretension.
    """
    q, v, a = states(model, 4, seed)
    tau = inverse_dynamics(model, q, v, a)
    route_2 = newton_euler(model, q, v, a, pretension)
    assert relative(route_2.motor_torque, model.motor_torque(tau)) < 1e-10
    forces = cable_forces(model, q, v, a, pretension)
    assert relative(route_2.tension, forces.state.tension) < 1e-10
    assert relative(route_2.cable_torque, forces.state.cable_torque) < 1e-10
    assert relative(route_2.hinge, forces.hinge) < 1e-10
    assert relative(hinge_reaction(model, q, v, a, pretension), forces.hinge) == 0.0


@given(st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_route_3_equals_route_1_for_two_links(seed):
    """The equations as printed are right for one and two links."""
    for n in (1, 2):
        model = planar_arm(n, seed, one_radius=True)
        q, v, a = states(model, 4, seed)
        expected = cable_state(model, q, inverse_dynamics(model, q, v, a)).cable_torque
        assert relative(printed_cable_torque(model, q, v, a), expected) < 1e-11


def test_route_3_is_wrong_for_three_links():
    r"""The printed equations miss n_1 of three links, by a closed form; n_2 and n_3 are right.

    The excess is l_1 n_3 / r_j (sin g + 2 sin(t_2 + g) + sin(t_2 - t_3 + g)).
    """
    model = planar_arm(3, 5, one_radius=True)
    q, v, a = states(model, 50, 5)
    true = cable_state(model, q, inverse_dynamics(model, q, v, a)).cable_torque
    found = printed_cable_torque(model, q, v, a)
    np.testing.assert_allclose(found[:, 1:], true[:, 1:], atol=1e-11)
    g, r_j = model.manipulator.pulleys.wrap_half_angle[0], model.manipulator.pulleys.joint_pulley_radius[0]
    t_2, t_3 = q[:, 1], q[:, 2]
    excess = np.sin(g) + 2 * np.sin(t_2 + g) + np.sin(t_2 - t_3 + g)
    excess *= model.manipulator.links[0].length * true[:, 2] / r_j
    np.testing.assert_allclose(found[:, 0] - true[:, 0], excess, atol=1e-10)
    assert np.mean(np.abs(excess)) > 0.5 * np.mean(np.abs(true[:, 0]))


def test_which_power_goes_missing():
    """True motor torques have the joints' power; as printed it is off by the excess times the speed of link 1."""
    model = planar_arm(3, 5, one_radius=True)
    p = model.manipulator.pulleys
    q, v, a = states(model, 50, 5)
    tau = inverse_dynamics(model, q, v, a)
    v_m = v @ model.motor_from_joint.T
    np.testing.assert_allclose(np.sum(model.motor_torque(tau) * v_m, axis=1), np.sum(tau * v, axis=1), rtol=1e-9)
    printed = printed_cable_torque(model, q, v, a)
    missing = np.sum(printed * p.motor_pulley_radius / p.joint_pulley_radius * v_m, axis=1) - np.sum(tau * v, axis=1)
    excess = printed[:, 0] - cable_state(model, q, tau).cable_torque[:, 0]
    np.testing.assert_allclose(missing, excess * v[:, 0], atol=1e-8)


def test_route_3_refuses_what_the_paper_does_not_cover():
    """Radii that differ, spatial arms."""
    for model in (planar_arm(3, 1), SPATIAL7):
        with pytest.raises(GeometryError, match="planar arms with one joint pulley radius"):
            printed_cable_torque(model, *states(model, 1, 0))


@pytest.mark.parametrize(
    "model", [PAPER, PLANAR3, planar_arm(2, 21), planar_arm(3, 22)], ids=["cdm2", "planar3", "random2", "random3"]
)
def test_mujoco_tendons_accelerate_as_commanded(model):
    """Tensions from our motor torques, pulled by MuJoCo's tendons, give the accelerations they were computed for."""
    plant = tendon_arm(model.manipulator)
    data = mujoco.MjData(plant)
    limit = 0.9 * 2 * model.manipulator.pulleys.wrap_half_angle
    q, v, a = states(model, 200, 7)
    q = q / 1.5 * limit
    tau = inverse_dynamics(model, q, v, a)
    tension = cable_state(model, q, tau, 500.0).tension
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.ctrl[:] = q[k], v[k], tension[k].ravel()
        mujoco.mj_forward(plant, data)
        np.testing.assert_allclose(data.qacc, a[k], atol=1e-8 * np.abs(a[k]).max())


@pytest.mark.parametrize("model", [PAPER, PLANAR3], ids=["cdm2", "planar3"])
def test_mujoco_tendons_have_our_moment_arms(model):
    """MuJoCo's wrapped tendons shorten by r_j per radian (upper side) up to the mechanism's limit."""
    plant = tendon_arm(model.manipulator)
    data = mujoco.MjData(plant)
    travel = cable_travel(model.manipulator.pulleys)
    for sign in (-0.999, 0.0, 0.999):
        for joint in range(model.n_joints):
            data.qpos[:] = sign * 2 * model.manipulator.pulleys.wrap_half_angle
            data.qvel[:] = np.eye(model.n_joints)[joint]
            mujoco.mj_forward(plant, data)
            np.testing.assert_allclose(data.ten_velocity[0::2], -travel[:, joint], atol=1e-12)
            np.testing.assert_allclose(data.ten_velocity[1::2], travel[:, joint], atol=1e-12)


@given(planar_arms, st.integers(0, 10**6))
@settings(max_examples=20, deadline=None)
def test_pretension_loads_bearings_and_never_motors(model, seed):
    """From 50 to 500 N the motor torque stays; every bearing of a cable's guide carries ten times the pull's share."""
    q, v, a = states(model, 3, seed)
    low, high = (newton_euler(model, q, v, a, pretension) for pretension in (50.0, 500.0))
    np.testing.assert_allclose(low.motor_torque, high.motor_torque, atol=1e-9 * np.abs(low.motor_torque).max())
    zero = np.zeros_like(q)
    loads = [cable_forces(model, q, v, a, pretension, zero).bearing_load() for pretension in (50.0, 500.0)]
    for key in loads[0]:
        np.testing.assert_allclose(loads[1][key], 10 * loads[0][key], rtol=1e-9)


def test_a_guide_pulley_carries_twice_the_tension_times_the_half_sine():
    """A strand that turns by theta_g0 over a frictionless pulley loads its bearing by 2 T sin(theta_g0 / 2)."""
    q = np.zeros((1, 2))
    forces = cable_forces(PAPER, q, q, q, 80.0, tau=q)
    theta = PAPER.manipulator.pulleys.wrap_half_angle[0]
    loads = forces.bearing_load()
    assert loads["near_guide", 2, 1, "upper"][0] == pytest.approx(160 * np.sin(theta / 2))
    assert loads["far_guide", 1, 1, "lower"][0] == pytest.approx(160 * np.sin(theta / 2))
    assert loads["joint_guide", 2, 1, "both"][0] == pytest.approx(0.0, abs=1e-12)  # straight: the sides cancel
    assert loads["drive", 1, 1, "both"][0] == pytest.approx(160 * np.cos(theta))


def test_contacts_of_the_papers_arm():
    """Four far guides and one joint guide at the base, four near ones and a drive on link 1, a drive on link 2."""
    q = np.zeros((1, 2))
    forces = cable_forces(PAPER, q, q, q)
    count = {}
    for contact in forces.contacts:
        count[contact.kind, contact.link] = count.get((contact.kind, contact.link), 0) + 1
    assert count == {
        ("far_guide", 0): 4,
        ("joint_guide", 0): 2,
        ("drive", 1): 2,
        ("near_guide", 1): 2,
        ("far_guide", 1): 2,
        ("drive", 2): 2,
    }
    at = {(c.kind, c.cable, c.side, c.link): k for k, c in enumerate(forces.contacts)}
    np.testing.assert_allclose(forces.point[0, at["near_guide", 2, "lower", 1]], [0.124, -0.022, 0])  # A
    np.testing.assert_allclose(forces.point[0, at["far_guide", 2, "upper", 1]], [0.476, 0.022, 0])  # D
    np.testing.assert_allclose(forces.point[0, at["far_guide", 1, "upper", 0]], [-0.124, 0.022, 0])
    theta = PAPER.manipulator.pulleys.wrap_half_angle[0]
    V = 0.1 * np.array([-np.sin(theta), np.cos(theta), 0])
    np.testing.assert_allclose(forces.point[0, at["drive", 2, "upper", 2]], V, atol=1e-15)
    wrap = forces.wrap[0]
    assert wrap[at["drive", 1, "upper", 1]] == pytest.approx(np.pi / 2 + theta)  # eq. (19)
    assert wrap[at["near_guide", 2, "upper", 1]] == pytest.approx(theta)
    assert wrap[at["joint_guide", 2, "upper", 0]] == pytest.approx(2 * theta)


@given(planar_arms, st.integers(0, 10**6))
@settings(max_examples=20, deadline=None)
def test_newtons_third_law(model, seed):
    """All contact forces of one cable side, in one frame, add up to the pull of the strand from the winch."""
    q, v, a = states(model, 2, seed)
    forces = cable_forces(model, q, v, a)
    turned = joint_rotations(model, q)
    world = [np.broadcast_to(np.eye(3), (len(q), 3, 3))]
    for i in range(model.n_joints):
        world.append(world[-1] @ turned[:, i])
    for cable in range(model.n_joints):
        for k, side in enumerate(("upper", "lower")):
            total = np.zeros((len(q), 3))
            for c, contact in enumerate(forces.contacts):
                if contact.cable == cable + 1 and contact.side == side:
                    total += np.einsum("sij,sj->si", world[contact.link], forces.force[:, c])
            expected = forces.state.tension[:, cable, k, None] * [-1.0, 0.0, 0.0]
            np.testing.assert_allclose(total, expected, atol=1e-9 * np.abs(forces.state.tension).max())


def test_hinge_without_cables_is_the_joint_force():
    """With slack-free zero tension nothing but the hinge carries the links: RNEA's joint force."""
    model = planar_arm(4, 2)
    q, v, a = states(model, 5, 2)
    found = hinge_reaction(model, q, v, a, 0.0, tau=np.zeros_like(q))
    np.testing.assert_allclose(found, joint_wrenches(model, q, v, a)[..., :3], atol=1e-11)


def test_tensions_drive_the_link():
    """n_i = r_j (tau_2 - tau_1), eq. (17), about a mean of the pretension; n_i is the change of tau along the arm."""
    q, v, a = states(PAPER, 10, 3)
    tau = inverse_dynamics(PAPER, q, v, a)
    state = cable_state(PAPER, q, tau)
    np.testing.assert_allclose(state.cable_torque, tau - np.pad(tau[:, 1:], ((0, 0), (0, 1))), atol=1e-12)
    np.testing.assert_allclose(0.1 * (state.tension[..., 0] - state.tension[..., 1]), state.cable_torque, atol=1e-12)
    np.testing.assert_allclose(state.tension.mean(axis=-1), 80.0)


def test_slack_keeps_its_sign_and_is_said():
    """A side that would have to push is negative, flagged, left out of `valid` and described in one sentence."""
    q = np.zeros((3, 2))
    tau = np.array([[0.0, 0.0], [0.0, 17.0], [0.0, -30.0]])
    state = cable_state(PAPER, q, tau)
    np.testing.assert_allclose(state.tension[1], [[80 - 85, 80 + 85], [80 + 85, 80 - 85]])
    np.testing.assert_array_equal(state.slack[1], [[True, False], [False, True]])
    np.testing.assert_array_equal(state.valid, [True, False, False])
    assert state.warnings()[0] == (
        "cable 1, upper side: would go slack in 1 of 3 samples (down to -5 N); 5 N more pretension would keep it tight"
    )
    assert cable_state(PAPER, q, tau, pretension=151.0).valid.all()


def test_past_wrap_is_said():
    """Past 124.55 deg a cable has left its joint pulley: flagged, with the joint named."""
    q = np.radians([[0.0, 124.5], [-124.6, 0.0]])
    state = cable_state(PAPER, q, np.zeros_like(q))
    np.testing.assert_array_equal(state.past_wrap, [[False, False], [True, False]])
    assert state.warnings() == (
        "joint 1: past its wrap limit in 1 of 2 samples, where a cable leaves its joint pulley",
    )
    np.testing.assert_allclose(np.degrees(wrap_angles(PAPER, q)[0, 1]), [0.054, 249.054], atol=1e-3)


def test_unknown_pretension_is_never_slack():
    """Without a pretension the tensions are changes about an unknown mean."""
    content = {"gravity": [0, 0, 0], "links": [{"length": 0.6, "mass": 1, "inertia": [1, 1, 1]}]}
    content["pulleys"] = {key: 0.1 for key in ("joint_pulley_radius", "motor_pulley_radius")}
    content["pulleys"] |= {"link_pulley_radius": 0.02, "link_pulley_offset": 0.022, "link_pulley_distance": 0.124}
    model = build_model(parse_manipulator(content))
    assert cable_state(model, [[0.0]], [[50.0]]).valid.all()
    assert not cable_state(model, [[0.0]], [[50.0]], pretension=0.0).valid.any()


def test_a_spatial_arm_has_contacts_where_axes_are_parallel():
    """Links 2, 3 and 6 of the spatial arm carry guides, hinges 3, 4 and 7 are known; elsewhere the layer says no."""
    q, v, a = states(SPATIAL7, 3, 0)
    forces = cable_forces(SPATIAL7, q, v, a)
    assert {c.link for c in forces.contacts if c.kind == "near_guide"} == {2, 3, 6}
    assert {c.link for c in forces.contacts if c.kind == "far_guide"} == {0, 2, 3, 6}
    known = np.isfinite(forces.hinge).all(axis=(0, 2))
    np.testing.assert_array_equal(known, [False, False, True, False, False, False, True])
    with pytest.raises(GeometryError, match="does not apply to link 1: its two joint axes are not parallel"):
        hinge_reaction(SPATIAL7, q, v, a)
    with pytest.raises(GeometryError, match="does not apply to link 1"):
        newton_euler(SPATIAL7, q, v, a)
    tau_m = SPATIAL7.motor_torque(inverse_dynamics(SPATIAL7, q, v, a))
    pull = forces.state.tension[..., 0] - forces.state.tension[..., 1]
    np.testing.assert_allclose(pull * SPATIAL7.manipulator.pulleys.motor_pulley_radius, tau_m, atol=1e-9)


def test_a_tilted_arm_is_planar_to_its_cables():
    """An arm rolled about x, with a frame turned, carries the same hinge forces: the layer has no favourite plane."""
    flat = planar_arm(3, 8)
    roll, yaw = 0.7, 0.4
    c, s = np.cos(roll), np.sin(roll)
    R = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    links = list(flat.manipulator.links)
    links[0] = replace(links[0], origin_rpy=np.array([roll, 0, 0]))
    turn = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    second = links[1]
    links[1] = replace(  # the same link, in a frame turned by yaw
        second,
        center_of_mass=turn @ second.center_of_mass,
        inertia=turn @ second.inertia @ turn.T,
    )
    links[2] = replace(links[2], origin_xyz=turn @ links[2].origin_xyz, origin_rpy=np.array([0, 0, -yaw]))
    tilted = build_model(replace(flat.manipulator, links=tuple(links), gravity=R @ flat.manipulator.gravity))
    q, v, a = states(flat, 4, 8)
    expected = hinge_reaction(flat, q, v, a)
    turned_q = q + np.array([0.0, yaw, 0.0])
    found = hinge_reaction(tilted, turned_q, v, a)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), np.linalg.norm(expected, axis=-1), rtol=1e-9)
    np.testing.assert_allclose(wrap_angles(tilted, turned_q), wrap_angles(flat, q), atol=1e-9)


def test_a_robot_without_pulleys_has_no_cable_layer(tmp_path):
    """For a robot given by a URDF the layer says that it does not apply."""
    path = tmp_path / "robot.urdf"
    path.write_text((ROOT / "urdf" / "cdm2.urdf").read_text())
    model = build_model(parse_manipulator({"urdf": str(path)}))
    q = np.zeros((1, 2))
    for call in (
        lambda: cable_forces(model, q, q, q),
        lambda: hinge_reaction(model, q, q, q),
        lambda: wrap_angles(model, q),
        lambda: newton_euler(model, q, q, q),
    ):
        with pytest.raises(GeometryError, match="does not apply: the robot is given by a URDF"):
            call()


@given(planar_arms, st.integers(0, 10**6))
@settings(max_examples=20, deadline=None)
def test_power_balance_closes(model, seed):
    """What the cables pull in at the winches is the change of the links' energy: T' dl/dt = d(kinetic)/dt - gravity."""
    q, v, a = states(model, 1, seed)
    tension = cable_state(model, q, inverse_dynamics(model, q, v, a)).tension[0]
    travel = cable_travel(model.manipulator.pulleys)
    length_rate = np.stack([-travel @ v[0], travel @ v[0]], axis=1)
    power_in = -np.sum(tension * length_rate)
    h = 1e-6

    def kinetic(t):
        q_t, v_t = q + t * v + 0.5 * t * t * a, v + t * a
        return 0.5 * v_t[0] @ mass_matrix(model, q_t)[0] @ v_t[0]

    zero = np.zeros_like(q)
    weight = inverse_dynamics(model, q, zero, zero)[0] @ v[0]
    rate = (kinetic(h) - kinetic(-h)) / (2 * h) + weight
    assert power_in == pytest.approx(rate, rel=1e-5, abs=1e-4 * np.abs(tension).max())


def test_numbers_of_the_documentation():
    """docs/cables.md tabulates n_i and power of routes 1 and 3 at one state; its numbers are these."""
    text = (ROOT / "docs" / "cables.md").read_text().replace("**", "")
    link = {"length": 0.6, "mass": 1.0, "center_of_mass": [0.3, 0, 0], "inertia": [0.003, 0.03, 0.03]}
    for n in (2, 3, 4):
        links = [link | {"name": f"link_{i + 1}"} for i in range(n)]
        model = build_model(parse_manipulator({"gravity": [0, -9.8, 0], "links": links, "pulleys": paper_radii}))
        signs = np.array([[1.0, -1.0, 1.0, -1.0]])[:, :n]
        q, v, a = np.array([[0.3, -0.4, 0.5, -0.6]])[:, :n], 0.5 * signs, signs
        tau = inverse_dynamics(model, q, v, a)
        true, printed = cable_state(model, q, tau).cable_torque[0], printed_cable_torque(model, q, v, a)[0]
        row = [n, *(", ".join(f"{x:.3f}" for x in values) for values in (true, printed))]
        row += [f"{np.sum(tau * v):.3f}", f"{printed @ np.cumsum(v[0]):.3f}"]
        assert f"| {' | '.join(map(str, row))} |" in text
