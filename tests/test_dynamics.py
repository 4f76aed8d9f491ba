"""Dynamics in both coordinates: the paper's equations, Pinocchio, laws of mechanics, batch against single."""

import numpy as np
import pinocchio as pin
import pytest
from arms import ROOT, planar_arm, planar_arms, relative, states
from hypothesis import given, settings
from hypothesis import strategies as st

from cdm_pin.dynamics import (
    coriolis_matrix,
    forward_dynamics,
    gravity_torques,
    inverse_dynamics,
    joint_torque_regressor,
    joint_wrenches,
    mass_matrix,
    motor_torques,
)
from cdm_pin.errors import ShapeError
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.model import build_model, load_model
from cdm_pin.robots import robot_urdf

PAPER = load_model(ROOT / "urdf" / "cdm2.yaml")
SPATIAL7 = load_model(ROOT / "urdf" / "spatial7.yaml")
COUPLED = build_model(
    parse_manipulator(
        {
            "urdf": str(robot_urdf("ur5_robot")),
            "transmission": {
                "joints": ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"],
                "joint_from_motor": [[1.0, 0.0], [-0.5, 1.0], [0.5, -1.0]],
            },
            "motors": [{"rotor_inertia": 0.3}, {"rotor_inertia": 0.2}],
        }
    )
)
MODELS = {"cdm2": PAPER, "planar5": planar_arm(5, 1), "spatial7": SPATIAL7, "coupled": COUPLED}
every_model = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


def test_eqs_53_and_54():
    """Motor torques of the general code, fitted with the terms of eqs (53), (54): each coefficient to 1e-12."""
    q, v, a = states(PAPER, 60, 0)
    (t1, t2), (w1, w2), (a1, a2) = q.T, v.T, a.T
    terms = {
        "a1": a1,
        "a2": a2,
        "c2 a1": np.cos(t2) * a1,
        "c2 a2": np.cos(t2) * a2,
        "s2 w1^2": np.sin(t2) * w1**2,
        "s2 w2^2": np.sin(t2) * w2**2,
        "s2 w1 w2": np.sin(t2) * w1 * w2,
        "c1": np.cos(t1),
        "c12": np.cos(t1 + t2),
        "w1": w1,
        "w2": w2,
        "1": np.ones_like(t1),
    }
    A = np.column_stack(list(terms.values()))
    found = np.linalg.lstsq(A, motor_torques(PAPER, q, v, a), rcond=None)[0]
    expected = {
        "a1": (0.6, 0.12),
        "a2": (0.0, 0.12),
        "c2 a1": (0.18, 0.18),
        "c2 a2": (0.18, 0.0),
        "s2 w1^2": (-0.18, 0.18),
        "s2 w2^2": (-0.18, 0.0),
        "s2 w1 w2": (-0.36, 0.0),
        "c1": (11.76, 0.0),
        "c12": (0.0, 2.94),
    }
    for row, name in zip(found, terms, strict=True):
        np.testing.assert_allclose(row, expected.get(name, (0.0, 0.0)), atol=1e-12, err_msg=name)


def test_matrices_of_the_papers_arm():
    """M, C, G of eq. (42) in motor torques per joint motion are those of eqs (53), (54), entry by entry."""
    q, v, _ = states(PAPER, 20, 1)
    E, c2, s2 = PAPER.joint_from_motor, np.cos(q[:, 1]), np.sin(q[:, 1])
    M = np.stack([0.6 + 0.18 * c2, 0.18 * c2, 0.12 + 0.18 * c2, 0.12 + 0 * c2], axis=1).reshape(-1, 2, 2)
    np.testing.assert_allclose(E.T @ mass_matrix(PAPER, q), M, atol=1e-12)
    Cv = np.stack(
        [-0.18 * s2 * (v[:, 0] ** 2 + v[:, 1] ** 2) - 0.36 * s2 * v[:, 0] * v[:, 1], 0.18 * s2 * v[:, 0] ** 2]
    )
    np.testing.assert_allclose(np.einsum("sij,sj->is", E.T @ coriolis_matrix(PAPER, q, v), v), Cv, atol=1e-11)
    G = np.stack([11.76 * np.cos(q[:, 0]), 2.94 * np.cos(q.sum(axis=1))])
    np.testing.assert_allclose(gravity_torques(PAPER, q, coordinates="motor").T, G, atol=1e-12)


@every_model
def test_against_pinocchio(model):
    """Torques, M, C, G and joint forces equal Pinocchio's, sample by sample, for rows of E in any order."""
    q, v, a = states(model, 6, 2)
    index, data, ids = model.velocity_index, model.pin_model.createData(), model.joint_ids
    M, C, G = mass_matrix(model, q), coriolis_matrix(model, q, v), gravity_torques(model, q)
    tau, wrench, Y = (
        inverse_dynamics(model, q, v, a),
        joint_wrenches(model, q, v, a),
        joint_torque_regressor(model, q, v, a),
    )
    for k, configuration in enumerate(model.configuration(q)):
        full_v, full_a = np.zeros((2, model.pin_model.nv))
        full_v[index], full_a[index] = v[k], a[k]
        expected = pin.rnea(model.pin_model, data, configuration, full_v, full_a)[index]
        assert relative(tau[k], expected) < 1e-12
        for row, i in enumerate(ids):
            np.testing.assert_allclose(wrench[k, row], data.f[i].vector, atol=1e-10 * np.abs(wrench[k]).max())
        pin_Y = pin.computeJointTorqueRegressor(model.pin_model, data, configuration, full_v, full_a)
        columns = np.concatenate([np.arange(10 * (i - 1), 10 * i) for i in ids])
        assert relative(Y[k], pin_Y[np.ix_(index, columns)]) < 1e-12
        pin_M = pin.crba(model.pin_model, data, configuration)
        assert relative(M[k], np.triu(pin_M)[np.ix_(index, index)] + np.triu(pin_M, 1).T[np.ix_(index, index)]) < 1e-12
        pin_C = pin.computeCoriolisMatrix(model.pin_model, data, configuration, full_v)
        assert relative(C[k], pin_C[np.ix_(index, index)]) < 1e-11
        gravity = pin.computeGeneralizedGravity(model.pin_model, data, configuration)[index]
        np.testing.assert_allclose(G[k], gravity, atol=1e-11)


@every_model
@pytest.mark.parametrize("rotors", [None, True, False])
@pytest.mark.parametrize("coordinates", ["joint", "motor"])
def test_inverse_then_forward_is_the_identity(model, coordinates, rotors):
    """Accelerations to torques and back, in both coordinates, with and without rotors, rectangular E included."""
    q, v, a = states(model, 10, 3)
    if coordinates == "motor":
        a_m = np.random.default_rng(0).normal(size=(10, model.n_motors))
        a = a_m @ model.joint_from_motor.T
    tau = inverse_dynamics(model, q, v, a, coordinates=coordinates, rotors=rotors)
    found = forward_dynamics(model, q, v, tau, coordinates=coordinates, rotors=rotors)
    expected = a_m if coordinates == "motor" else a
    assert relative(found, expected) < 1e-9


@every_model
@pytest.mark.parametrize("coordinates", ["joint", "motor"])
def test_the_equation_of_motion_adds_up(model, coordinates):
    """M a + C v + G are the torques, in both coordinates: eq. (42)."""
    rng = np.random.default_rng(4)
    n, E = (
        (model.n_joints, np.eye(model.n_joints)) if coordinates == "joint" else (model.n_motors, model.joint_from_motor)
    )
    x, u, w = rng.normal(size=(3, 5, n))
    q, v, a = x @ E.T, u @ E.T, w @ E.T
    parts = np.einsum("sij,sj->si", mass_matrix(model, q, coordinates=coordinates), w)
    parts += np.einsum("sij,sj->si", coriolis_matrix(model, q, v, coordinates=coordinates), u)
    parts += gravity_torques(model, q, coordinates=coordinates)
    assert relative(parts, inverse_dynamics(model, q, v, a, coordinates=coordinates)) < 1e-11


@given(planar_arms, st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_mass_matrix_is_symmetric_positive_definite(model, seed):
    """And stays so with the rotors added; in motor coordinates it is E' M E + J."""
    q, *_ = states(model, 3, seed)
    M, E, J = mass_matrix(model, q), model.joint_from_motor, np.diag(model.rotor_inertia)
    assert np.linalg.eigvalsh(M).min() > 0
    np.testing.assert_array_equal(M, np.swapaxes(M, 1, 2))
    M_m = mass_matrix(model, q, coordinates="motor")
    np.testing.assert_allclose(M_m, E.T @ M @ E + J, rtol=1e-9, atol=1e-12)
    with_rotors = mass_matrix(model, q, rotors=True)
    np.testing.assert_allclose(E.T @ with_rotors @ E, M_m, rtol=1e-9, atol=1e-12)


@every_model
def test_coriolis_matrix_keeps_energy(model):
    """dM/dt - 2 C is skew-symmetric (Christoffel symbols), so that C does no work of its own."""
    q, v, _ = states(model, 4, 5)
    h = 1e-6
    rate = (mass_matrix(model, q + h * v) - mass_matrix(model, q - h * v)) / (2 * h)
    S = rate - 2 * coriolis_matrix(model, q, v)
    np.testing.assert_allclose(S, -np.swapaxes(S, 1, 2), atol=1e-7 * np.abs(rate).max())


def test_rotors_feel_the_motors_own_acceleration():
    """A measured acceleration of the motors drives the rotors; the rigid body keeps to the joints'."""
    model = planar_arm(3, 6)
    q, v, a = states(model, 4, 6)
    rigid = model.motor_torque(inverse_dynamics(model, q, v, a))
    a_m = np.ones((4, 3))
    np.testing.assert_allclose(motor_torques(model, q, v, a, a_m), rigid + model.rotor_inertia, rtol=1e-12)
    np.testing.assert_allclose(
        motor_torques(model, q, v, a), inverse_dynamics(model, q, v, a, coordinates="motor"), rtol=1e-9
    )


def test_batch_is_sample_by_sample():
    """A whole trajectory gives bit for bit what its samples give one at a time, 1-d input included."""
    q, v, a = states(SPATIAL7, 50, 7)
    whole = inverse_dynamics(SPATIAL7, q, v, a)
    for k in range(50):
        np.testing.assert_array_equal(whole[k], inverse_dynamics(SPATIAL7, q[k], v[k], a[k])[0])
    assert inverse_dynamics(SPATIAL7, q[:0], v[:0], a[:0]).shape == (0, 7)


def test_input_arrays_are_left_alone():
    """Read-only input is accepted and nothing is written into it."""
    q, v, a = states(SPATIAL7, 5, 8)
    copies = [x.copy() for x in (q, v, a)]
    for x in (q, v, a):
        x.setflags(write=False)
    inverse_dynamics(SPATIAL7, q, v, a)
    for x, copy in zip((q, v, a), copies, strict=True):
        np.testing.assert_array_equal(x, copy)
    assert not q.flags.writeable


def test_two_facts_about_pinocchio():
    """`rnea` adds armature times acceleration while the regressor does not, and ignores damping and friction."""
    model = PAPER.pin_model.copy()
    q, v, a = np.array([0.3, -0.2]), np.array([1.0, 2.0]), np.array([3.0, -1.0])
    plain = pin.rnea(model, model.createData(), q, v, a)
    model.armature[:] = 0.5
    model.damping[:] = 7.0
    model.friction[:] = 7.0
    data = model.createData()
    np.testing.assert_allclose(pin.rnea(model, data, q, v, a), plain + 0.5 * a)
    pi_std = np.concatenate([inertia.toDynamicParameters() for inertia in model.inertias.tolist()[1:]])
    np.testing.assert_allclose(pin.computeJointTorqueRegressor(model, data, q, v, a) @ pi_std, plain)


def test_wrong_arguments_are_named():
    """A torque of the wrong width, coordinates that do not exist."""
    q = np.zeros((2, 3))
    with pytest.raises(ShapeError, match=r"tau has shape \(2, 3\), \(2, 2\) was expected"):
        forward_dynamics(COUPLED, q, q, q, coordinates="motor")
    with pytest.raises(ValueError, match="'joint' or 'motor', found 'cable'"):
        mass_matrix(COUPLED, q, coordinates="cable")
