"""Units at coordinates that slide: the insertion axis of a patient-side manipulator."""

from dataclasses import replace

import pytest

from cdm_pin.model import load_model
from cdm_pin.units import either, motor_units, unit_at


@pytest.fixture(scope="module")
def psm():
    return load_model("urdf/real/psm3.yaml")


def at(kind, index):
    return {"kind": kind, "index": index}


@pytest.mark.parametrize(
    ("unit", "slides"),
    [
        ("N m", "N"),
        ("N m/rad", "N/m"),
        ("N m s/rad", "N s/m"),
        ("N m/rad^3", "N/m^3"),
        ("rad", "m"),
        ("1/rad", "1/m"),
        ("kg m^2", "kg"),
        ("1", "1"),
        ("s", "s"),
    ],
)
def test_what_slides_has_forces_and_metres(psm, unit, slides):
    """Joint 7 and motor 3 slide, joint 1 and motor 1 turn."""
    assert unit_at(psm, at("joint", 7), unit) == unit_at(psm, at("motor", 3), unit) == slides
    assert unit_at(psm, at("joint", 1), unit) == unit_at(psm, at("motor", 1), unit) == unit
    assert unit_at(psm, {"kind": "system"}, unit) == unit_at(psm, {"kind": "base"}, unit) == unit


def test_a_spool_turns():
    """A motor that winds up a cable of a slide moves no joint that turns, and turns itself."""
    psm = load_model("urdf/real/psm3.yaml")
    E = psm.joint_from_motor.copy()
    E[:, 2] *= 0.02
    assert list(replace(psm, joint_from_motor=E).linear_motors) == [False] * 3


def test_an_angle_stays_one(psm):
    """The phase of a periodic law is an angle wherever it sits."""
    assert unit_at(psm, at("motor", 3), "rad", "phase") == "rad"


def test_parts_that_rub_on_each_other_slide_if_all_motors_do(psm):
    """A contact between a motor that slides and one that turns has no unit of its own; that of motors stays."""
    alone, mixed = ({"kind": "combination", "weights": w} for w in ([0.0, 0.0, 1.0], [1.0, 0.0, -0.4]))
    assert unit_at(psm, alone, "N m") == "N"
    assert unit_at(psm, mixed, "N m") == "N m"
    assert unit_at(psm, {"kind": "combination", "index": 1, "other": 2}, "N m") == "N m"


def test_each_motor_has_its_unit(psm):
    """Torques of the first two, a force of the third; positions likewise."""
    assert motor_units(psm, torque=True) == ("N m", "N m", "N")
    assert motor_units(psm, torque=False) == ("rad", "rad", "m")
    assert either(motor_units(psm, torque=True)) == "N m or N"
