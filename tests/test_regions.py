"""Where in its state an effect is said to show."""

from pathlib import Path

import numpy as np
import pytest

from cdm_pin.bank import all_candidates
from cdm_pin.base import base_parameters, massive_columns
from cdm_pin.dynamics import inverse_dynamics
from cdm_pin.model import load_model
from cdm_pin.patches import PATCHES
from cdm_pin.problem import make_problem
from cdm_pin.recording import Recording
from cdm_pin.regions import change_time, region, visible_energy
from cdm_pin.search import Search
from cdm_pin.settings import Settings

ARM = Path(__file__).resolve().parent.parent / "urdf" / "cdm2.yaml"


@pytest.fixture(scope="module")
def search():
    """One minute of the paper's arm with a little noise."""
    model, rng = load_model(ARM), np.random.default_rng(0)
    t = np.arange(0, 60, 0.005)
    w = np.array([1.1, 1.7])
    q, v, a = 0.8 * np.sin(w * t[:, None]), 0.8 * w * np.cos(w * t[:, None]), -0.8 * w**2 * np.sin(w * t[:, None])
    torque = model.motor_torque(inverse_dynamics(model, q, v, a)) + 0.02 * rng.standard_normal(q.shape)
    problem = make_problem(model, [Recording(t, {"joint_position": q, "motor_torque": torque}, label="made")])
    return Search(problem, base_parameters(model, columns=massive_columns(model)), Settings())


def fitted(search, name, index):
    """Fit one effect at a joint."""
    (candidate, *_) = (c for c in all_candidates(search.problem, [name]) if c.location.get("index") == index)
    return search.fit([candidate], search.plain)


def test_drag_shows_at_high_speed(search):
    """What masses leave of quadratic drag is largest where the joint is fast, not where it turns."""
    assert region(search, fitted(search, "quadratic_drag", 2), 0) != "around reversals of joint 2"
    (energy,) = visible_energy(search, fitted(search, "quadratic_drag", 2), 0)
    speed = np.abs(search.problem.motions[0].v[:: search.problem.band.step, 1])[: len(energy)]
    assert energy[speed > np.quantile(speed, 0.8)].mean() > 2 * energy[speed < np.quantile(speed, 0.2)].mean()


def test_a_window_of_angles_is_named(search):
    """A rub near one end of a joint's range is said to be there."""
    fit = fitted(search, "unnamed_rub", 1)
    q = search.problem.motions[0].q[:, 0]
    beta = np.zeros(14)
    beta[-2:] = 1.0
    fit = type(fit)(**{**fit.__dict__, "beta": (beta,)})
    words = region(search, fit, 0)
    assert words.startswith("around joint 1 at ")
    assert float(words.split()[4]) > 0.6 * q.max()


def test_only_functions_of_time_have_a_time(search):
    """A change is dated where the function of time is steepest."""
    name = "unnamed_wear"
    candidate = fitted(search, name, 1).effects[0]
    assert candidate.effect is PATCHES[name]
    beta = np.r_[np.zeros(5), np.ones(5)]
    start, end = change_time(candidate, beta, search.problem.motions[0])
    assert start < 30.0 < end
    assert change_time(fitted(search, "viscous_friction", 1).effects[0], np.ones(1), search.problem.motions[0]) is None
