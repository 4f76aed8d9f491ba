"""The regressor against torques and their differences; triangles against the matrices they stand for."""

import numpy as np
import pytest
from arms import ROOT, planar_arm, relative, states
from chains import spatial_arm

from cdm_pin.dynamics import inverse_dynamics
from cdm_pin.errors import ShapeError
from cdm_pin.model import load_model
from cdm_pin.regressor import Triangle, blocks, merge, motor_regressor

CDM2 = load_model(ROOT / "urdf" / "cdm2.yaml")
ARMS = [planar_arm(1, 1), CDM2, planar_arm(4, 2), spatial_arm(3, 3), spatial_arm(7, 4)]


@pytest.mark.parametrize("model", ARMS, ids=lambda m: f"{m.manipulator.name}{m.n_joints}")
def test_the_regressor_times_the_parameters_is_the_motor_torque(model):
    """Y pi = E' tau, to rounding."""
    q, v, a = states(model, 40, 0)
    expected = model.motor_torque(inverse_dynamics(model, q, v, a))
    assert relative(motor_regressor(model, q, v, a) @ model.standard_parameters, expected) < 1e-13


@pytest.mark.parametrize("model", ARMS[1:4], ids=lambda m: f"{m.manipulator.name}{m.n_joints}")
def test_the_regressor_is_the_difference_quotient_of_torque_in_each_parameter(model):
    """Torque is linear in the parameters, so a large step differentiates without error of truncation."""
    q, v, a = states(model, 8, 1)
    Y = motor_regressor(model, q, v, a)
    for k in range(10 * model.n_joints):
        step = np.zeros(10 * model.n_joints)
        step[k] = 0.5
        plus, minus = (
            model.motor_torque(inverse_dynamics(model.with_standard_parameters(pi), q, v, a))
            for pi in (model.standard_parameters + step, model.standard_parameters - step)
        )
        np.testing.assert_allclose(Y[..., k], plus - minus, atol=1e-12 * max(1.0, np.abs(plus).max()))


def test_a_triangle_holds_all_products_of_its_columns():
    """R'R = A'A for any cut into blocks, and the diagonal is not negative."""
    A = np.random.default_rng(2).normal(size=(1000, 7)) * np.logspace(0, -6, 7)
    whole = Triangle.empty(7).add(A)
    cut = Triangle.empty(7)
    for part in blocks(len(A), 64):
        cut = cut.add(A[part])
    assert whole.n_rows == cut.n_rows == 1000
    np.testing.assert_allclose(whole.gram, A.T @ A, rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(cut.R, whole.R, rtol=1e-9, atol=1e-12)
    assert np.all(np.diag(cut.R) >= 0)


def test_merging_is_stacking():
    """The triangle of several parts is that of all rows; columns can be picked and mixed afterwards."""
    A = np.random.default_rng(3).normal(size=(90, 5))
    parts = merge(Triangle.empty(5).add(A[part]) for part in (slice(0, 10), slice(10, 12), slice(12, 90)))
    mix = np.random.default_rng(4).normal(size=(5, 3))
    np.testing.assert_allclose(parts.gram, A.T @ A)
    np.testing.assert_allclose(parts.select([4, 0]).gram, A[:, [4, 0]].T @ A[:, [4, 0]])
    np.testing.assert_allclose(parts.transform(mix).gram, mix.T @ A.T @ A @ mix)


def test_a_triangle_refuses_rows_of_another_width():
    """The width is named."""
    with pytest.raises(ShapeError, match=r"\(n, 4\) was expected"):
        Triangle.empty(4).add(np.zeros((3, 5)))
