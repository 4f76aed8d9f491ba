"""Base parameters: rank by theory, the same torque from fewer numbers, readable names, the paper's own set."""

import numpy as np
import pytest
from arms import ROOT, planar_arm, relative, states
from chains import spatial_arm

from cdm_pin import paper
from cdm_pin.base import base_parameters, paper_parameters, random_states
from cdm_pin.dynamics import inverse_dynamics
from cdm_pin.errors import ShapeError
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.model import build_model, load_model
from cdm_pin.regressor import motor_regressor
from cdm_pin.robots import robot_urdf

CDM2 = load_model(ROOT / "urdf" / "cdm2.yaml")


def from_urdf(name: str, joints: list[str] | None = None, **keys):
    """Model of one of the example robots."""
    content = {"urdf": str(robot_urdf(name)), **keys}
    if joints is not None:
        content["transmission"] = {"joints": joints, "joint_from_motor": np.eye(len(joints)).tolist()}
    return build_model(parse_manipulator(content))


@pytest.mark.parametrize("n", range(1, 8))
def test_rank_of_arms_in_space(n):
    """Axes and gravity in general position: 7 per link, 4 fewer for the first, whose joint does not move."""
    base = base_parameters(spatial_arm(n, n))
    assert base.rank == 7 * n - 4
    assert base.largest_dropped < 1e-11 < 1e-5 < base.smallest_kept


@pytest.mark.parametrize("n", range(1, 8))
def test_rank_of_planar_arms(n):
    """Parallel axes across gravity: three per link; along gravity the first link shows its inertia alone."""
    model = planar_arm(n, n)
    assert base_parameters(model).rank == 3 * n
    upright = model.pin_model.copy()
    upright.gravity.linear = np.array([0.0, 0.0, -9.81])
    from dataclasses import replace

    assert base_parameters(replace(model, pin_model=upright)).rank == 3 * n - 2


def test_rank_of_known_robots():
    """UR10 and Panda stand upright: 7 n - 6."""
    assert base_parameters(from_urdf("ur10_robot")).rank == 36
    assert base_parameters(from_urdf("panda", [f"panda_joint{i}" for i in range(1, 8)])).rank == 43


@pytest.mark.parametrize(
    "model",
    [CDM2, planar_arm(5, 1), spatial_arm(4, 2), spatial_arm(7, 7)],
    ids=lambda m: f"{m.manipulator.name}{m.n_joints}",
)
def test_base_parameters_give_the_same_torque(model):
    """Y_base G pi = Y pi on states that took no part in finding G, for any pi."""
    base = base_parameters(model)
    q, v, a = states(model, 50, 5)
    pi = np.random.default_rng(0).normal(size=10 * model.n_joints)
    expected = motor_regressor(model, q, v, a) @ pi
    assert relative(base.regressor(model, q, v, a) @ base.values(pi), expected) < 1e-9


@pytest.mark.parametrize("n", range(1, 8))
def test_noise_free_base_parameters_are_found_to_1e_8(n):
    """Arms of 1 to 7 links, planar and in space, from motor torques without noise."""
    for model in (planar_arm(n, 10 + n), spatial_arm(n, 20 + n)):
        base = base_parameters(model)
        q, v, a = states(model, 60 * n, n)
        tau_m = model.motor_torque(inverse_dynamics(model, q, v, a))
        Y = base.regressor(model, q, v, a).reshape(-1, base.rank)
        found = np.linalg.lstsq(Y, tau_m.ravel(), rcond=None)[0]
        assert relative(found, base.values(model.standard_parameters)) < 1e-8


def test_names_and_links_of_the_papers_arm():
    """Combinations read as in a text book, with the link's length by name."""
    base = base_parameters(CDM2)
    assert base.names == ("mx_1 + m_2*l_1", "my_1", "Izz_1 + m_2*l_1^2", "mx_2", "my_2", "Izz_2")
    assert base.links == ((1, 2), (1,), (1, 2), (2,), (2,), (2,))
    assert base.absorbed == ("m_2",)
    assert {"m_1", "mz_1", "Ixx_1", "Iyz_2"} <= set(base.unidentifiable)


def test_names_without_symbols_carry_numbers():
    """Of a URDF robot the factors are numbers."""
    names = base_parameters(from_urdf("ur10_robot")).names
    assert "my_5 + my_6" in names and "Iyy_4 + Iyy_5 + 0.01339*m_6" in names


def test_the_papers_set():
    """Rank 4 once the centres of mass lie on the links; eqs (57), (58) are that set with one entry three times."""
    base, matrix = paper_parameters(CDM2)
    assert base.rank == 4 and np.linalg.matrix_rank(matrix) == 4
    P = matrix @ base.values(CDM2.standard_parameters)
    np.testing.assert_allclose(P, paper.NOMINAL, rtol=1e-12)
    assert P[1] == P[4] == pytest.approx(CDM2.manipulator.links[0].length * P[5])
    q, v, a = random_states(CDM2, 30, 1)
    first, second = paper.coefficient_matrices(q, v, a)
    torque = base.regressor(CDM2, q, v, a) @ base.values(CDM2.standard_parameters)
    np.testing.assert_allclose(torque, np.column_stack([first @ P[:3], second @ P[3:]]), rtol=1e-12, atol=1e-11)
    with pytest.raises(ShapeError, match="two links"):
        paper_parameters(planar_arm(3, 0))


def test_a_locked_joint_groups_what_it_hides():
    """With joint 1 at rest its link shows one number, its weight; what is left still gives the torque."""
    q, v, a = random_states(CDM2, 60, 3)
    q[:, 0], v[:, 0], a[:, 0] = 0.7, 0.0, 0.0
    base = base_parameters(CDM2, trajectory=(q, v, a))
    assert base.names == ("mx_1 - 0.8423*my_1 + m_2*l_1", "mx_2", "my_2", "Izz_2")
    assert "Izz_1" in base.unidentifiable and "my_1" in base.absorbed
    expected = motor_regressor(CDM2, q, v, a) @ CDM2.standard_parameters
    assert relative(base.regressor(CDM2, q, v, a) @ base.values(CDM2.standard_parameters), expected) < 1e-9


def test_more_joints_than_motors():
    """Coupled joints of a parallelogram show fewer combinations than free ones; grouping holds along their motion."""
    joints = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
    content = {"urdf": str(robot_urdf("ur5_robot"))}
    content["transmission"] = {"joints": joints, "joint_from_motor": [[1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]}
    model = build_model(parse_manipulator(content))
    base = base_parameters(model)
    free = base_parameters(from_urdf("ur5_robot", joints))
    assert base.rank < free.rank
    q, v, a = random_states(model, 40, 9)
    expected = motor_regressor(model, q, v, a) @ model.standard_parameters
    assert relative(base.regressor(model, q, v, a) @ base.values(model.standard_parameters), expected) < 1e-9


def test_columns_out_of_range():
    """Columns that do not exist are refused."""
    with pytest.raises(ShapeError, match="columns 0 to 19"):
        base_parameters(CDM2, columns=[0, 20])
