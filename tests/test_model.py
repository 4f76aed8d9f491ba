"""One model class for every robot: order of joints, offsets, inertial parameters, rectangular couplings."""

import numpy as np
import pinocchio as pin
import pytest
import yaml
from arms import FILES, ROOT, planar_arm, relative, states

from cdm_pin.dynamics import inverse_dynamics, joint_torque_regressor, motor_torques
from cdm_pin.errors import InputError, ManipulatorError, ShapeError
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.model import build_model, load_model
from cdm_pin.robots import robot_urdf, robot_urdfs

ARMS = (
    "TwoDofs",
    "double_pendulum",
    "double_pendulum_continuous",
    "double_pendulum_simple",
    "finger_edu",
    "kinova",
    "panda",
    "so100",
    "so101",
    "talos_left_arm",
    "ur3_gripper",
    "ur3_joint_limited_robot",
    "ur3_robot",
    "ur5_gripper",
    "ur5_joint_limited_robot",
    "ur5_robot",
    "ur10_joint_limited_robot",
    "ur10_robot",
    "xarm7",
    "z1",
)


def load_arm(name, transmission=None):
    content = {"urdf": str(robot_urdf(name))}
    return build_model(parse_manipulator(content | ({"transmission": transmission} if transmission else {})))


def pin_rnea(model, q, v, a):
    """Pinocchio's own joint torques, in the order of the rows of E."""
    data, index = model.pin_model.createData(), model.velocity_index
    tau = np.empty_like(q)
    for k, configuration in enumerate(model.configuration(q)):
        full_v, full_a = np.zeros((2, model.pin_model.nv))
        full_v[index], full_a[index] = v[k], a[k]
        tau[k] = pin.rnea(model.pin_model, data, configuration, full_v, full_a)[index]
    return tau


@pytest.mark.parametrize("name", ARMS)
def test_fixed_base_arms_equal_pinocchio(name):
    """Every fixed-base arm of example-robot-data, E = I, continuous joints included: our torques are pin.rnea's."""
    model = load_arm(name)
    np.testing.assert_array_equal(model.joint_from_motor, np.eye(model.n_joints))
    q, v, a = states(model, 4, 0)
    expected = pin_rnea(model, q, v, a)
    tau = inverse_dynamics(model, q, v, a)
    assert relative(tau, expected) < 1e-12
    assert relative(motor_torques(model, q, v, a), expected) < 1e-12
    Y = joint_torque_regressor(model, q, v, a)
    assert relative(Y @ model.standard_parameters, expected) < 1e-11


def test_some_of_them_have_more_configuration_than_velocity():
    """Continuous joints are cosine and sine to Pinocchio; the mapping is in one place."""
    models = [load_arm(name) for name in ("kinova", "double_pendulum_continuous")]
    assert all(model.pin_model.nq > model.pin_model.nv for model in models)


def test_rows_follow_the_file_not_pinocchio(tmp_path):
    """Pinocchio sorts joints by name; rows of E do as the URDF or the transmission says."""
    text = """<robot name="r"><link name="base"/>
      <link name="z"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
        <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <link name="a"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
        <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="zeta" type="revolute"><parent link="base"/><child link="z"/><axis xyz="0 1 0"/>
        <limit effort="1" velocity="1"/></joint>
      <joint name="alpha" type="prismatic"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
        <limit effort="1" velocity="1"/></joint></robot>"""
    (tmp_path / "r.urdf").write_text(text)
    model = build_model(parse_manipulator({"urdf": str(tmp_path / "r.urdf")}))
    assert model.joints == ("zeta", "alpha")
    assert list(model.pin_model.names[1:]) == ["alpha", "zeta"]
    tau = inverse_dynamics(model, np.zeros((1, 2)), np.zeros((1, 2)), np.array([[0.0, 1.0]]))
    np.testing.assert_allclose(tau, [[-0.1 * 9.81, 2 * (9.81 + 1.0)]])
    np.testing.assert_array_equal(model.standard_parameters[[0, 10]], [1.0, 2.0])
    assert model.parameter_names[10] == "m_2"


PARALLELOGRAM = {
    "joints": ["joint2", "joint3", "joint4", "joint6"],
    "motors": ["lift", "swing"],
    "joint_from_motor": [[1.0, 0.0], [-1.0, 0.5], [0.0, 1.0], [0.7, -0.3]],
    "offset": [0.1, -0.2, 0.3, 0.0],
}


def test_a_rectangular_coupling_equals_virtual_work():
    """Four joints moved by two motors: tau_m is the derivative of the work along the motors' directions."""
    model = load_arm("xarm7", PARALLELOGRAM)
    assert (model.n_joints, model.n_motors) == (4, 2)
    rng = np.random.default_rng(0)
    q_m = rng.uniform(-1, 1, 2)
    q = model.joint_position(q_m)[None]
    np.testing.assert_allclose(q[0], PARALLELOGRAM["joint_from_motor"] @ q_m + PARALLELOGRAM["offset"])
    zero = np.zeros_like(q)

    def energy(q_m):
        data = model.pin_model.createData()
        return pin.computePotentialEnergy(model.pin_model, data, model.configuration(model.joint_position(q_m))[0])

    h = 1e-6
    slope = [(energy(q_m + h * e) - energy(q_m - h * e)) / (2 * h) for e in np.eye(2)]
    np.testing.assert_allclose(motor_torques(model, q, zero, zero)[0], slope, atol=1e-7)


def test_a_rectangular_coupling_in_motion_obeys_lagrange():
    """d/dt dL/dv_m - dL/dq_m of the coupled robot, by differences, is tau_m at a random state."""
    model = load_arm("xarm7", PARALLELOGRAM)
    rng = np.random.default_rng(1)
    q_m, v_m, a_m = rng.uniform(-1, 1, (3, 2))
    E, data = model.joint_from_motor, model.pin_model.createData()

    def lagrangian(q_m, v_m):
        q = model.configuration(model.joint_position(q_m))[0]
        v = np.zeros(model.pin_model.nv)
        v[model.velocity_index] = E @ v_m
        kinetic = pin.computeKineticEnergy(model.pin_model, data, q, v)
        return kinetic - pin.computePotentialEnergy(model.pin_model, data, q)

    h = 1e-4

    def momentum(t):
        q, v = q_m + t * v_m + 0.5 * t * t * a_m, v_m + t * a_m
        return np.array([(lagrangian(q, v + h * e) - lagrangian(q, v - h * e)) / (2 * h) for e in np.eye(2)])

    force = np.array([(lagrangian(q_m + h * e, v_m) - lagrangian(q_m - h * e, v_m)) / (2 * h) for e in np.eye(2)])
    expected = (momentum(h) - momentum(-h)) / (2 * h) - force
    q, v, a = model.joint_position(q_m)[None], (E @ v_m)[None], (E @ a_m)[None]
    np.testing.assert_allclose(motor_torques(model, q, v, a)[0], expected, atol=1e-5)


def test_unnamed_joints_are_locked_at_zero():
    """Joints that no row names keep their neutral position; their bodies' mass is carried on."""
    model = load_arm("xarm7", PARALLELOGRAM)
    full = load_arm("xarm7")
    q, v, a = states(model, 3, 5)
    rows = [full.joints.index(name) for name in model.joints]
    q_full, v_full, a_full = np.zeros((3, 3, full.n_joints))
    q_full[:, rows], v_full[:, rows], a_full[:, rows] = q, v, a
    expected = inverse_dynamics(full, q_full, v_full, a_full)[:, rows]
    np.testing.assert_allclose(inverse_dynamics(model, q, v, a), expected, atol=1e-10)


def test_mimic_tags_are_ignored():
    """talos_left_arm has mimic joints; each is a joint of its own here, as Pinocchio's regressor needs it."""
    path = robot_urdf("talos_left_arm")
    assert "mimic" in path.read_text()
    assert load_arm("talos_left_arm").n_joints == 7


def test_motor_and_joint_positions_are_inverse():
    """Q = E q_m + offset and back, least squares for a rectangular E."""
    for model in (planar_arm(5, 0), load_arm("xarm7", PARALLELOGRAM)):
        q_m = np.random.default_rng(0).normal(size=(6, model.n_motors))
        np.testing.assert_allclose(model.motor_position(model.joint_position(q_m)), q_m, atol=1e-9)


def test_other_inertial_parameters():
    """`with_standard_parameters` changes the dynamics linearly and leaves the first model alone."""
    model = planar_arm(3, 4)
    q, v, a = states(model, 3, 4)
    before = inverse_dynamics(model, q, v, a)
    heavier = model.with_standard_parameters(1.5 * model.standard_parameters)
    np.testing.assert_allclose(inverse_dynamics(heavier, q, v, a), 1.5 * before, rtol=1e-10, atol=1e-10)
    np.testing.assert_array_equal(inverse_dynamics(model, q, v, a), before)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_committed_urdf_is_the_same_robot(path, tmp_path):
    """The generated URDF with E written out as a transmission gives the same motor torques as the manipulator file."""
    model = load_model(path)
    transmission = {
        "joints": list(model.joints),
        "motors": list(model.motors),
        "joint_from_motor": model.joint_from_motor.tolist(),
    }
    content = {"urdf": str(path.with_suffix(".urdf")), "gravity": model.manipulator.gravity.tolist()}
    content |= {"transmission": transmission, "motors": [{"rotor_inertia": float(x)} for x in model.rotor_inertia]}
    file = tmp_path / "robot.yaml"
    file.write_text(yaml.safe_dump(content))
    other = load_model(file)
    q, v, a = states(model, 3, 0)
    assert relative(motor_torques(other, q, v, a), motor_torques(model, q, v, a)) < 1e-11


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"joints": ["joint_1", "jiont_2"], "joint_from_motor": [[1, 0], [0, 1]]}, "did you mean 'joint_2'"),
        ({"joints": ["joint_1", "elbow"], "joint_from_motor": [[1, 0], [0, 1]]}, "it has joint_1, joint_2"),
    ],
)
def test_a_joint_that_the_urdf_lacks_is_named(content, words):
    """Rows of E must name moving joints of the URDF; the nearest one is offered."""
    with pytest.raises(ManipulatorError, match=words):
        build_model(parse_manipulator({"urdf": str(ROOT / "urdf" / "cdm2.urdf"), "transmission": content}))


def test_a_robot_that_cannot_move_is_refused():
    """A quadrotor's frame has no joint to drive."""
    with pytest.raises(ManipulatorError, match="no joint that moves"):
        load_arm("iris_simple")


def test_a_description_that_pinocchio_refuses_is_one_line():
    """ur3.urdf of the package has no robot name: the parser's reason is passed on in one line."""
    with pytest.raises(ManipulatorError, match="No name given for the robot") as caught:
        load_arm("ur3")
    assert "\n" not in str(caught.value)


def test_robots_are_found_by_name():
    """The wheel has no loader: the list is of files, and a misspelt name gets the nearest."""
    assert len(robot_urdfs()) > 50
    with pytest.raises(InputError, match="did you mean 'xarm7'"):
        robot_urdf("xram7")


def test_wrong_shapes_are_named():
    """Arrays must have one column per joint."""
    model = planar_arm(3, 0)
    with pytest.raises(ShapeError, match=r"q has shape \(5, 2\), \(n_samples, 3\) was expected"):
        inverse_dynamics(model, np.zeros((5, 2)), np.zeros((5, 3)), np.zeros((5, 3)))
    with pytest.raises(ShapeError, match="5, 4, 5 samples"):
        inverse_dynamics(model, np.zeros((5, 3)), np.zeros((4, 3)), np.zeros((5, 3)))
