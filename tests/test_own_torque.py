"""Friction by torque that its own torque loads: c of all that the motor gives is more than c of what it carries."""

from types import SimpleNamespace

import numpy as np
import pytest
from arms import ROOT

from cdm_pin import verdict
from cdm_pin.effects import CATALOGUE
from cdm_pin.model import load_model

MODEL = load_model(ROOT / "urdf" / "planar3.yaml")


@pytest.mark.parametrize(
    ("gain", "motor", "listed"),
    [(1.0 / (1.0 - 0.2**2), 2, False), (1.06, 2, True), (0.958, 2, True), (1.0 / (1.0 - 0.2**2), 1, True)],
)
def test_the_second_order_of_friction_by_torque_is_no_gain(gain, motor, listed):
    """A gain of 1 / (1 - c^2) on its motor belongs to it, in the model and not in the list; any other is one."""
    law, scale = (CATALOGUE[name] for name in ("torque_dependent_friction", "torque_gain_error"))
    effects = [
        SimpleNamespace(
            effect=law, place=next(p for p in law.places(MODEL) if p.location == {"kind": "motor", "index": 2})
        ),
        SimpleNamespace(effect=scale, place=scale.places(MODEL)[motor - 1]),
    ]
    values = {
        0: {"coefficient": {"value": 0.2, "std": 0.001}},
        1: {"gain": {"value": gain, "std": 0.001}},
    }
    explanation = SimpleNamespace(fit=SimpleNamespace(effects=effects))
    told = verdict._own_torque(verdict.Verdict(MODEL, None, explanation, False, np.eye(2), (), values, values))
    assert list(told.stated) == ([0, 1] if listed else [0])
    assert list(told.unlisted.items()) == ([] if listed else [(1, 0)])


def test_that_gain_is_what_the_law_comes_to():
    """That tau = x + c |tau| s comes to x / (1 - c^2) + c |x| s / (1 - c^2)."""
    x, s, c = np.array([3.0, 3.0, -2.0, -2.0]), np.array([1.0, -1.0, 1.0, -1.0]), 0.2
    whole = x / (1.0 - c * s * np.sign(x))
    assert whole == pytest.approx(x + c * np.abs(whole) * s)
    assert whole == pytest.approx((x + c * np.abs(x) * s) / (1.0 - c**2))
