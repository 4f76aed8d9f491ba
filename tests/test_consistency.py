"""Physically valid parameters: what a body can have, the nearest ones, and fits that respect it."""

import numpy as np
import pytest
from arms import ROOT, planar_arm, relative
from chains import spatial_arm

from cdm_pin.base import base_parameters
from cdm_pin.consistency import (
    consistency_margin,
    consistent_standard,
    link_parameters,
    nearest_standard,
    pseudo_inertia,
)
from cdm_pin.model import load_model

CDM2 = load_model(ROOT / "urdf" / "cdm2.yaml")


def disturbed(pi_std: np.ndarray, seed: int, size: float) -> np.ndarray:
    """Other physical parameters: every link's mass distribution deformed."""
    rng = np.random.default_rng(seed)
    out = []
    for pi in pi_std.reshape(-1, 10):
        root = np.linalg.cholesky(pseudo_inertia(pi)) @ (np.eye(4) + size * rng.normal(size=(4, 4)))
        out.append(link_parameters(root @ root.T))
    return np.concatenate(out)


def test_pseudo_inertia_of_point_masses():
    """J is the sum of m [p; 1][p; 1]' over the points of a body, and its inverse map gives I about the origin."""
    rng = np.random.default_rng(0)
    m, p = rng.uniform(0.1, 1, 6), rng.normal(size=(6, 3))
    J = sum(mass * np.outer([*x, 1], [*x, 1]) for mass, x in zip(m, p, strict=True))
    pi = link_parameters(J)
    inertia = sum(mass * (x @ x * np.eye(3) - np.outer(x, x)) for mass, x in zip(m, p, strict=True))
    np.testing.assert_allclose(pi[[4, 5, 6, 7, 8, 9]], inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]])
    np.testing.assert_allclose(pseudo_inertia(pi), J)


def test_margin_is_negative_exactly_where_no_body_exists():
    """A broken triangle inequality and a centre of mass outside its own spread are both seen."""
    good = link_parameters(np.diag([0.01, 0.02, 0.03, 2.0]))
    assert consistency_margin(good)[0] > 0
    triangle, outside = good.copy(), good.copy()
    triangle[9] = 0.2
    outside[1] = 1.0
    assert consistency_margin(np.concatenate([triangle, outside])).max() < 0


@pytest.mark.parametrize("model", [CDM2, planar_arm(4, 1), spatial_arm(7, 2)], ids=["cdm2", "planar4", "spatial7"])
def test_nearest_parameters_reproduce_the_base_parameters(model):
    """Of another physical robot's base parameters: all of them to 1e-9, every link physical."""
    base = base_parameters(model)
    wanted = base.values(disturbed(model.standard_parameters, 3, 0.15))
    found = nearest_standard(base.matrix, wanted, model.standard_parameters)
    assert found is not None and found.exact
    assert relative(base.values(found.parameters), wanted) < 1e-9
    assert consistency_margin(found.parameters).min() > 0


def test_the_nearest_to_the_prior_is_the_prior():
    """Unchanged base parameters change nothing."""
    base = base_parameters(CDM2)
    found = nearest_standard(base.matrix, base.values(CDM2.standard_parameters), CDM2.standard_parameters)
    assert found is not None and found.distance < 1e-6


def test_impossible_base_parameters_are_refused_and_approached():
    """A negative inertia has no body; the fit gives the nearest consistent one, on the boundary."""
    base = base_parameters(CDM2)
    wanted = base.values(CDM2.standard_parameters)
    wanted[5] = -0.01  # Izz_2
    assert nearest_standard(base.matrix, wanted, CDM2.standard_parameters) is None
    found = consistent_standard(base.matrix, wanted, 1e6 * np.eye(6), CDM2.standard_parameters)
    assert not found.exact and consistency_margin(found.parameters).min() > 0
    assert base.values(found.parameters)[5] > 0


def test_data_and_prior_share_by_their_weights():
    """No information keeps the prior, much information takes the fit; friction does not become negative."""
    base = base_parameters(CDM2)
    prior = CDM2.standard_parameters
    values = np.concatenate([1.2 * base.values(prior), [-0.3, 0.4]])
    none = consistent_standard(base.matrix, values, 1e-9 * np.eye(8), prior, nonnegative=np.array([True, True]))
    np.testing.assert_allclose(base.values(none.parameters), base.values(prior), atol=1e-5)
    much = consistent_standard(base.matrix, values, 1e6 * np.eye(8), prior, nonnegative=np.array([True, True]))
    np.testing.assert_allclose(base.values(much.parameters), values[:6], atol=1e-4)
    np.testing.assert_allclose(much.free, [0.0, 0.4], atol=1e-4)


def test_a_massless_prior_gets_a_body():
    """Frames without mass, as URDFs have, end with a small body and still give the base parameters."""
    prior = np.array(CDM2.standard_parameters)
    prior[:10] = 0.0
    base = base_parameters(CDM2)
    wanted = base.values(CDM2.standard_parameters)
    found = nearest_standard(base.matrix, wanted, prior)
    assert found is not None and consistency_margin(found.parameters).min() > 0
    assert relative(base.values(found.parameters), wanted) < 1e-9
