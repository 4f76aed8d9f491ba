"""Generated URDFs: committed bytes, read back by three independent readers, limits, visuals, transmissions."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from arms import FILES, ROOT, planar_arm, states
from yourdfpy import URDF

from cdm_pin.dynamics import inverse_dynamics
from cdm_pin.errors import ManipulatorError
from cdm_pin.manipulator import load_manipulator
from cdm_pin.model import build_model
from cdm_pin.routing import joint_limits
from cdm_pin.transmission import joint_from_motor, motor_from_joint
from cdm_pin.urdf import generate_urdf, parse_robot, read_transmissions, read_urdf
from cdm_pin.urdf_check import urdf_deviation

NAMES = [path.stem for path in FILES]


@pytest.fixture(params=FILES, ids=NAMES)
def manipulator(request):
    return load_manipulator(request.param)


def test_the_committed_files_are_what_the_generator_writes():
    """Same geometry, same bytes: urdf/*.urdf are up to date (scripts/generate_urdf.py writes them)."""
    assert {"cdm2", "planar3", "spatial7"} <= set(NAMES)
    for path in FILES:
        assert path.with_suffix(".urdf").read_text() == generate_urdf(load_manipulator(path)), path


def test_read_back(manipulator):
    """Pinocchio and yourdfpy read what the manipulator says, and the transmissions give its map."""
    deviation = urdf_deviation(generate_urdf(manipulator), manipulator)
    assert set(deviation) == {"pinocchio", "yourdfpy", "transmissions"}
    assert max(deviation.values()) < 1e-11


def test_read_back_notices_a_difference(manipulator):
    """One changed number is seen by both readers."""
    text = generate_urdf(manipulator).replace(f'mass value="{manipulator.links[0].mass!r}"', 'mass value="7.5"')
    deviation = urdf_deviation(text, manipulator)
    assert deviation["pinocchio"] == deviation["yourdfpy"] == pytest.approx(7.5 - manipulator.links[0].mass)


def test_visuals_weigh_nothing(manipulator):
    """The base's pulleys and motors change no inertial parameter: every body is its link."""
    model = build_model(manipulator)
    for i, link in enumerate(manipulator.links):
        expected = pin.Inertia(link.mass, link.center_of_mass, link.inertia).toDynamicParameters()
        np.testing.assert_allclose(model.standard_parameters[10 * i : 10 * i + 10], expected, atol=1e-12)


def test_mujoco_loads_the_urdf_and_moves_alike(manipulator):
    """MuJoCo compiles the URDF and its inverse dynamics equal ours."""
    compiled = mujoco.MjModel.from_xml_string(generate_urdf(manipulator))
    compiled.opt.gravity[:] = manipulator.gravity
    data = mujoco.MjData(compiled)
    model = build_model(manipulator)
    np.testing.assert_allclose(compiled.jnt_range, joint_limits(manipulator.links, manipulator.pulleys), atol=1e-9)
    compiled.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    q, v, a = states(model, 5, 0)
    for k, tau in enumerate(inverse_dynamics(model, q, v, a)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(compiled, data)
        np.testing.assert_allclose(data.qfrc_inverse, tau, atol=1e-9)


def test_what_one_sees():
    """The paper's arm shows two motors and winches, a drive pulley per link, joint and link guide pulleys, plates."""
    robot = URDF.load(ROOT / "urdf" / "cdm2.urdf", build_scene_graph=False, load_meshes=False).robot
    seen = {link.name: [visual.name for visual in link.visuals] for link in robot.links}
    assert {"motor_1", "motor_2", "winch_1", "winch_2", "joint_guide_1_2"} <= set(seen["base"])
    guides = {f"guide_{end}_{side}_2" for end in ("near", "far") for side in ("lower", "upper")}
    assert guides | {"drive_pulley_1", "plate_front", "plate_back"} <= set(seen["link_1"])
    assert "drive_pulley_2" in seen["link_2"] and not any("guide" in name for name in seen["link_2"])
    for link in robot.links:
        for visual in link.visuals:
            if "guide_far" in visual.name:
                assert visual.geometry.cylinder.radius == 0.02
            if "drive" in visual.name:
                assert visual.geometry.cylinder.radius == 0.1


def test_pulleys_of_a_spatial_arm_turn_about_their_joint():
    """Every drive pulley's axis is its joint's axis; guide pulleys are drawn only where axes are parallel."""
    path = ROOT / "urdf" / "spatial7.urdf"
    robot = URDF.load(path, build_scene_graph=False, load_meshes=False).robot
    axes = {joint.child: joint.axis for joint in robot.joints}
    for link in robot.links:
        for visual in link.visuals:
            if "drive" in visual.name:
                np.testing.assert_allclose(visual.origin[:3, 2], axes[link.name], atol=1e-9)
    guided = {link.name for link in robot.links if any("guide_near" in visual.name for visual in link.visuals)}
    assert guided == {"shoulder_pitch", "elbow", "wrist_pitch"}


def test_transmissions_hold_the_motor_map():
    """q_m = map @ q as read from the file is the inverse of E, radii that differ included."""
    model = planar_arm(5, 3)
    found = read_transmissions(parse_robot(generate_urdf(model.manipulator)), model.joints)
    np.testing.assert_allclose(found @ model.joint_from_motor, np.eye(5), atol=1e-10)
    np.testing.assert_allclose(found, motor_from_joint(model.manipulator.pulleys), atol=1e-11)


def test_motor_limits_become_joint_limits():
    """Effort and velocity limits are what all motors together can do at a joint."""
    manipulator = load_manipulator(ROOT / "urdf" / "planar3.yaml")
    model = pin.buildModelFromXML(generate_urdf(manipulator))
    E = joint_from_motor(manipulator.pulleys)
    torque = np.array([motor.torque_limit for motor in manipulator.motors])
    speed = np.array([motor.velocity_limit for motor in manipulator.motors])
    np.testing.assert_allclose(model.upperEffortLimit, np.linalg.inv(E).T @ torque, atol=1e-9)
    np.testing.assert_allclose(model.velocityLimit, np.abs(E) @ speed, atol=1e-9)


BODY = '<inertial><mass value="{mass}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
JOINT = '<joint name="j" type="{type}"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>{limit}</joint>'
LIMIT = '<limit effort="1" velocity="1"/>'
KILOGRAM = BODY.format(mass=1)


def robot_text(body=KILOGRAM, type="revolute", limit=LIMIT):
    return f'<robot name="r"><link name="a"/><link name="b">{body}</link>{JOINT.format(type=type, limit=limit)}</robot>'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("<robot", "is not XML"),
        ("<sdf/>", "root is <sdf>"),
        ('<robot name="r"/>', "No link elements"),
        (robot_text(limit=""), "does not specify limits"),
        (robot_text(type="revolut"), "no known type"),
        (robot_text(type="floating"), "floating joint cannot be driven"),
        (robot_text(body=BODY.format(mass=-1)), "negative mass"),
        (robot_text(body=BODY.format(mass="heavy")), "unreadable body"),
        (robot_text(body='<inertial><mass value="1"/></inertial>'), "unreadable body"),
    ],
)
def test_unreadable_urdf(tmp_path, capfd, text, words):
    """Each defect is one sentence that names the file; the XML parser's own messages stay off the terminal."""
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    with pytest.raises(ManipulatorError, match=words) as caught:
        read_urdf(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_no_link_may_be_called_base():
    """The fixed link's name is taken."""
    manipulator = load_manipulator(ROOT / "urdf" / "cdm2.yaml")
    object.__setattr__(manipulator.links[1], "name", "base")
    with pytest.raises(ManipulatorError, match="called 'base'"):
        generate_urdf(manipulator)
