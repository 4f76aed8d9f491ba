"""The sentence of a verdict: what a mechanic reads, for every verdict and every effect of the catalogue."""

import copy

import pytest
import view_cases

from cdm_pin.effects import CATALOGUE
from cdm_pin.wording import candidate, clause, number, place, quantity, sentence, with_error

JOINT1, JOINT2, MOTOR1 = ({"kind": k, "index": i} for k, i in (("joint", 1), ("joint", 2), ("motor", 1)))


@pytest.fixture
def found():
    return copy.deepcopy(view_cases.diagnosis())


def test_missing_physics_says_what_how_large_and_what_it_improves(found):
    """One finding: place, size with error and unit, fall of the error on the unseen run, and that it is all."""
    assert sentence(found) == (
        "Joint 2 loses 0.310 ± 0.012 N m to dry friction when it reverses; with it, torque error of motor 1 on the "
        "unseen run falls from 0.31 to 0.02 N m, the noise floor; nothing else is missing above the sensitivities "
        "listed."
    )


def test_floor_not_reached_is_said(found):
    """Where the error stays above the floor, the floor is given instead of being claimed."""
    found["fit"]["holdout"]["rmse_augmented"] = [0.05] * 3
    assert "to 0.05 N m, where the noise floor is 0.02;" in sentence(found)


def test_without_holdout_the_findings_are_unconfirmed(found):
    """Judged on the recordings fitted to, each finding says so and no unseen run is mentioned."""
    found["fit"]["holdout"] = None
    found["findings"][0]["unconfirmed"] = True
    text = sentence(found)
    assert "(unconfirmed)" in text and "on the same recordings falls" in text and "unseen" not in text


@pytest.mark.parametrize(("torque", "said"), [(0.05, False), (0.0205, True), (0.019, True)])
def test_a_travel_is_told_where_no_torque_falls(found, torque, said):
    """What encoders on both sides of a cable show may leave no trace in the torques."""
    found["fit"]["holdout"]["rmse_rigid"] = [torque] * 3
    travel = {"rmse_rigid": [0.0152, 2e-5, 2e-5], "rmse_augmented": [2.7e-5, 2e-5, 2e-5], "noise_floor": [2.7e-5] * 3}
    found["fit"]["holdout"]["travel"] = travel | {"unit": "rad"}
    text = sentence(found)
    told = "travel between motor 1 and its joints on the unseen run falls from 0.0152 to 2.7e-05 rad, the noise floor"
    assert (told in text) == said and ("torque error" in text) != said


def test_several_findings_are_counted(found):
    """Two findings are announced as two things, each with its clause."""
    delay = {"delay": {"value": 0.012, "std": 0.0003, "unit": "s"}}
    found["findings"].append({"effect": "time_delay", "location": {"kind": "system"}, "parameters": delay})
    found["findings"][0]["indistinguishable_from"] = [{"effect": "torque_offset", "location": MOTOR1}]
    text = sentence(found)
    assert text.startswith("Two things are missing: joint 2 loses")
    assert "cannot tell dry friction of joint 2 from a torque offset of motor 1" in text
    assert "the torque of the whole robot is logged 12.0 ± 0.3 ms late; with them, torque error" in text


def test_doubt_names_the_rivals_and_the_next_experiment(found):
    """What cannot be told apart is named, with the recording that would decide."""
    found["findings"][0]["indistinguishable_from"] = [{"effect": "torque_offset", "location": MOTOR1}]
    text = sentence(found)
    assert "these data cannot tell this from a torque offset of motor 1; record the trajectory" in text
    assert text.endswith("next.csv with pretension 80 -> 120 N (97 % sure to decide) to find out.")


def test_consistent_names_the_floor_and_the_changed_masses(found):
    """Nothing missing: the error reached, and the links whose masses differ, with the class they stand in."""
    found.update(verdict="consistent", findings=[], next_experiment=None)
    found["fit"]["holdout"]["rmse_rigid"] = [0.02, 0.021, 0.02]
    text = sentence(found)
    assert text.startswith("Nothing is missing above the sensitivities listed")
    assert "down to the noise floor (0.021 N m on the unseen run)" in text
    assert (
        "the masses or inertias of link 2 differ from the file, which may as well be rotor inertia of motor 2" in text
    )


def test_consistent_says_where_the_floor_is_not_reached(found):
    """An error above the noise floor is not called the noise floor."""
    found.update(verdict="consistent", findings=[], next_experiment=None)
    found["fit"]["holdout"] |= {"rmse_rigid": [0.02, 0.05, 0.02], "noise_floor": [0.02, 0.02, 0.02]}
    assert "explain the torques, to 0.05 N m on the unseen run, where the noise floor is 0.02;" in sentence(found)


def test_unexplained_says_where_and_names_no_known_effect(found):
    """A remainder is placed and sized; the sentence claims no effect of the catalogue."""
    found.update(verdict="unexplained", findings=[], next_experiment=None)
    found["unexplained"] = {"location": JOINT1, "region": "around 0.2 rad", "rms": 0.1, "nearest": []}
    assert sentence(found) == (
        "Something that none of the known effects explains happens on joint 1 around 0.2 rad, 0.1 N m rms."
    )
    found["unexplained"]["region"] = "a torque that depends on the speed of joint 1"
    assert "happens on joint 1: a torque that depends on the speed of joint 1, 0.1 N m rms" in sentence(found)


def test_of_many_findings_the_strongest_are_said(found):
    """Four findings and four doubts at most, those without an unseen run last; the others are counted."""
    first = found["findings"][0] | {"indistinguishable_from": [{"effect": "torque_offset", "location": MOTOR1}]}
    found["findings"] = [first | {"location": {"kind": "joint", "index": i + 1}} for i in range(7)]
    found["findings"][0] |= {"unconfirmed": True}
    text = sentence(found)
    assert text.startswith("7 things are missing: joint 2 loses")
    assert text.count(" loses ") == 4 and "joint 5 loses" in text and "joint 1 loses" not in text
    assert "3 more of less weight, listed below; with them, torque error" in text
    assert "7 of them these data cannot tell from others, listed with each" in text
    found.update(verdict="unexplained", unexplained={"location": JOINT1, "region": "", "rms": 0.1, "unit": "N"})
    text = sentence(found)
    assert "0.1 N rms; sure beside it: joint 2 loses" in text and "; with all that was fitted, torque error" in text


def test_places_have_the_names_of_the_file(found):
    """A name that says more than the number stands behind it."""
    found["names"] = {"joint": ["joint_1", "wrist_pitch"], "motor": []}
    assert sentence(found).startswith("Joint 2 (wrist pitch) loses")
    found["names"]["joint"][1] = "joint_2"
    assert sentence(found).startswith("Joint 2 loses")


def test_a_ripple_along_a_slide_counts_by_the_metre():
    """Cycles are turns of the phase per radian, or per metre."""
    cycles = {"value": 62.831853, "std": 0.1, "unit": "1/m"}
    parameters = {"amplitude": {"value": 0.2, "std": 0.01, "unit": "N"}, "cycles": cycles}
    ripple = {"effect": "torque_ripple", "location": MOTOR1, "parameters": parameters}
    assert clause(ripple) == "motor 1 ripples by 0.200 ± 0.010 N, 10.000 ± 0.016 times a metre"


def test_insufficient_data_asks_for_a_recording(found):
    """A class that cannot be resolved is named with the trajectory that would resolve it."""
    tilt = {"effect": "base_tilt", "location": {"kind": "base"}, "parameters": {}}
    tilt["indistinguishable_from"] = [{"effect": "encoder_offset", "location": JOINT1}]
    found.update(verdict="insufficient_data", findings=[tilt], next_experiment={"file": "next.csv"})
    assert sentence(found) == (
        "These data cannot tell base tilt from an encoder offset of joint 1; "
        "record the trajectory next.csv to find out."
    )


def test_insufficient_data_gives_its_reason():
    """With nothing to name the reason is given."""
    text = sentence({"verdict": "insufficient_data", "reason": "the arm hardly moves"})
    assert text == "These data are too few to decide (the arm hardly moves)."


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_has_words_for_all_its_parameters(name):
    """Every effect of the catalogue has its own name and a clause that its parameters fill."""
    effect = CATALOGUE[name]
    parameters = {p.name: {"value": 0.1234, "std": 0.003, "unit": p.unit} for p in effect.parameters}
    text = clause({"effect": effect.name, "location": JOINT1, "parameters": parameters})
    assert "{" not in text and "[" not in text and "joint 1" in text and "shows" not in text
    assert "0.12" in text or "12" in text
    assert "_" not in candidate({"effect": effect.name, "location": JOINT1})


def test_unknown_effects_and_missing_parameters_still_read():
    """An effect beyond the catalogue, or one without its parameters, is said plainly."""
    odd = {"effect": "sticky_tape", "location": JOINT2, "parameters": {"grip": {"value": 2.0, "std": 0.5, "unit": "N"}}}
    assert clause(odd) == "joint 2 shows sticky tape (grip 2.0 ± 0.5 N)"
    assert clause({"effect": "payload", "location": {"kind": "link", "index": 3}}) == "link 3 shows a payload"


@pytest.mark.parametrize(
    ("location", "words"),
    [
        ({"kind": "motor", "index": 1, "joint": 2}, "motor 1 and joint 2"),
        (JOINT2, "joint 2"),
        ({"kind": "cable", "index": 3, "link": 1}, "cable 3 at link 1"),
        ({"kind": "cable", "index": 2, "joint": 1}, "cable 2 at joint 1"),
        ({"kind": "base"}, "the base"),
        ({"kind": "system"}, "the whole robot"),
        ({"kind": "combination", "weights": [1.0, 0.0, -1.0]}, "the contact between motors 1 and 3"),
    ],
)
def test_places_in_words(location, words):
    """Every kind of location is said in words."""
    assert place(location) == words


@pytest.mark.parametrize(
    ("value", "std", "words"),
    [
        (0.3127, 0.0123, "0.313 ± 0.012"),
        (0.3127, 0.0052, "0.313 ± 0.005"),
        (812.3, 31.0, "812 ± 31"),
        (1.5, 0.0, "1.5"),
        (2.0, float("nan"), "2"),
        (3.2e-9, 1e-10, "3.2e-09 ± 1e-10"),
    ],
)
def test_values_have_the_digits_their_error_allows(value, std, words):
    """A value is rounded where its standard error is."""
    assert with_error(value, std) == words


def test_numbers_and_quantities():
    """Numbers avoid exponents where people do; angles are given in degrees too; units stand behind."""
    assert number(0.0201) == "0.0201" and number(12345.6) == "12346" and number(None) == "unknown"
    assert quantity({"value": 0.0349, "std": 0.001, "unit": "rad"}) == "0.0349 ± 0.0010 rad (2 deg)"
    assert quantity({"value": 4.0, "std": 0.5, "unit": "1"}) == "4.0 ± 0.5"


_UNSURE = (
    "joint 2 is pulled by a spring towards 0.300 ± 0.010 rad (17 deg), of a stiffness that is hardly known, {} N m/rad"
)


@pytest.mark.parametrize(
    ("stiffness", "rest", "cubic", "said"),
    [
        ((2.0, 0.1), (0.3, 0.01), (0.0, 0.1), "joint 2 is pulled by a spring of 2.00 ± 0.10 N m/rad towards 0.300"),
        ((2.0, 0.1), (4.0, 5.0), (0.0, 0.1), "joint 2 is pulled by a spring of 2.00 ± 0.10 N m/rad"),
        ((-0.017, 0.002), (1.26, 0.02), (0.1, 0.2), "joint 2 is pushed away from 1.26 ± 0.02 rad (72 deg) by"),
        ((-0.1, 0.4), (0.3, 0.01), (0.0, 0.1), _UNSURE.format("-0.1 ± 0.4")),
        ((0.1, 0.4), (0.3, 0.01), (-0.7, 0.02), _UNSURE.format("0.1 ± 0.4")),
        ((0.1, 0.4), (0.3, 0.01), (0.7, 0.02), "joint 2 is pulled by a spring that stiffens, 0.70 ± 0.02 N m/rad^3"),
    ],
)
def test_a_spring_is_said_as_far_as_it_is_known(stiffness, rest, cubic, said):
    """No rest that is not known, no pull that pushes, no stiffness where all is in the cubic part."""
    units = {"stiffness": "N m/rad", "rest": "rad", "cubic": "N m/rad^3"}
    values = {"stiffness": stiffness, "rest": rest, "cubic": cubic}
    parameters = {k: {"value": v, "std": s, "unit": units[k]} for k, (v, s) in values.items()}
    text = clause({"effect": "joint_spring", "location": {"kind": "joint", "index": 2}, "parameters": parameters})
    assert text.startswith(said)
    assert ("towards" in said) <= ("towards" in text)
    assert rest[1] < 0.3 or "towards" not in text
