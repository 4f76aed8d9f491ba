"""Scores of hand-made diagnoses are what a reader would give."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from cdm_pin.scoring import describe, same, score, sliding_weights


def place(kind, index=None, **more):
    return {"kind": kind} | ({"index": index} if index is not None else {}) | more


def truth(*effects, n=3, positions="joint"):
    listed = [
        {"effect": name, "location": where, "parameters": {}, "in_catalogue": name != "torque_bump"}
        for name, where in effects
    ]
    return {"schema": "cdm_pin.truth/1", "n_links": n, "effects": listed, "sensors": {"positions": positions}}


def diagnosis(*findings, verdict="missing_physics", rivals=(), unexplained=None, rigid=()):
    listed = [
        {
            "effect": name,
            "location": where,
            "parameters": {},
            "indistinguishable_from": [{"effect": e, "location": w} for e, w in rivals],
        }
        for name, where in findings
    ]
    changed = [{"links": [2], "indistinguishable_from": [{"effect": e, "location": w} for e, w in rigid]}]
    return {
        "verdict": verdict,
        "findings": listed,
        "rigid_body": {"changed": changed},
        "unexplained": unexplained,
        "fit": {"holdout": {"rmse_augmented": [0.022, 0.022], "noise_floor": [0.02, 0.02]}},
    }


COULOMB_2 = ("coulomb_friction", place("joint", 2))


def test_the_right_name_at_the_right_place_scores():
    """One effect named and placed is all right; a wrong place, a wrong verdict or an extra finding is not."""
    result = score(truth(COULOMB_2), diagnosis(COULOMB_2))
    assert (result.meetings, result.first_right, result.all_right) == (("exact",), True, True)
    assert result.holdout_over_floor == pytest.approx(1.1)
    wrong = score(truth(COULOMB_2), diagnosis(("coulomb_friction", place("joint", 3))))
    assert (wrong.meetings, wrong.first_right, wrong.false_findings) == (
        ("missed",),
        False,
        ("coulomb_friction at joint 3",),
    )
    extra = score(truth(COULOMB_2), diagnosis(COULOMB_2, ("torque_ripple", place("motor", 1))))
    assert extra.first_right and not extra.all_right
    assert not score(truth(COULOMB_2), diagnosis(COULOMB_2, verdict="unexplained")).all_right
    late = score(truth(COULOMB_2), diagnosis(("torque_ripple", place("motor", 1)), COULOMB_2))
    assert late.meetings == ("exact",) and not late.first_right


def test_silence_is_scored():
    """A clean trial wants no finding and `consistent`; silence about an effect is a miss, not a false finding."""
    assert score(truth(), diagnosis(verdict="consistent")).all_right
    assert score(truth(), diagnosis(verdict="consistent")).first_right
    alarm = score(truth(), diagnosis(COULOMB_2))
    assert not alarm.first_right and not alarm.all_right and len(alarm.false_findings) == 1
    silent = score(truth(COULOMB_2), diagnosis(verdict="consistent"))
    assert silent.meetings == ("missed",) and not silent.false_findings and not silent.first_right


def test_a_class_counts_with_three_others_at_most():
    """The true effect among the first three rivals counts; as the fourth it does not."""
    rivals = [("viscous_friction", place("joint", k)) for k in (1, 2, 3)]
    named = ("hysteresis", place("joint", 2))
    assert score(truth(COULOMB_2), diagnosis(named, rivals=[*rivals[:2], COULOMB_2])).meetings == ("class",)
    assert score(truth(COULOMB_2), diagnosis(named, rivals=[*rivals, COULOMB_2])).meetings == ("missed",)


def test_a_coupled_motor_is_friction_of_a_combination():
    """A motor that turns with a joint, by friction alone, is friction of v_i + ratio v_k, whatever it is called."""
    coupling = ("transmission_coupling", place("motor", 3, joint=2))
    rubbing = ("coulomb_friction", place("combination", weights=[-0.25, 0.25, 1.0]))
    true, told = truth(rubbing), diagnosis(coupling, ("coulomb_friction", place("motor", 3)))
    true["pulley_ratio"] = 0.5
    told["findings"][0]["parameters"] = {"ratio": {"value": 0.5, "std": 0.01}}
    assert score(true, told).all_right
    told["findings"][0]["parameters"]["ratio"]["value"] = -0.5
    assert score(true, told).meetings == ("missed",)
    reverse = truth(coupling)
    reverse["pulley_ratio"] = 0.5
    reverse["effects"][0] |= {"parameters": {"ratio": 0.5, "coulomb": 0.3, "inertia": 0.0}, "visibility": 90.0}
    assert score(reverse, diagnosis(rubbing)).all_right
    assert score(reverse, diagnosis(coupling, ("coulomb_friction", place("motor", 3)))).all_right
    assert not score(reverse, diagnosis(coupling, ("coulomb_friction", place("motor", 2)))).all_right
    reverse["effects"][0]["parameters"]["inertia"] = 0.01
    assert not score(reverse, diagnosis(rubbing)).all_right


def test_a_class_has_to_be_one():
    """Where an oracle is asked, a claimed class counts only if the finding could look like the effect."""
    named, rivals = ("hysteresis", place("joint", 2)), [COULOMB_2]
    for correlation, meeting in ((0.97, "class"), (0.9, "missed")):
        told = diagnosis(named, rivals=rivals)
        assert score(truth(COULOMB_2), told, lambda k, finding, r=correlation: r).meetings == (meeting,)
    twin = ("coulomb_friction", place("motor", 1))
    dry = truth(("coulomb_friction", place("joint", 1)))
    assert score(dry, diagnosis(twin), lambda k, finding: 0.0).meetings == ("class",)


def test_a_class_that_is_none_does_not_hide_one_that_is():
    """Of two findings that both claim the effect as a rival, the one that could look like it counts."""
    first, second = ("hysteresis", place("joint", 2)), ("stribeck_friction", place("joint", 2))
    told = diagnosis(first, second, rivals=[COULOMB_2])
    result = score(truth(COULOMB_2), told, lambda k, finding: 0.99 if finding["effect"] == second[0] else 0.1)
    assert result.meetings == ("class",) and result.false_findings == ("hysteresis at joint 2",)


IDENTITIES = [
    (("coulomb_friction", place("joint", 1)), ("coulomb_friction", place("motor", 1)), "joint", True),
    (("cable_friction", place("cable", 3, link=2)), ("coulomb_friction", place("joint", 3)), "joint", True),
    (("cable_friction", place("cable", 3, link=1)), ("coulomb_friction", place("joint", 3)), "joint", False),
    (("cable_friction", place("cable", 3, link=0)), ("coulomb_friction", place("motor", 3)), "joint", True),
    (("capstan_friction", place("cable", 3, link=1)), ("cable_friction", place("cable", 3, link=1)), "joint", True),
    (
        ("coulomb_friction", place("combination", weights=[0.0, -0.52, 0.51])),
        ("coulomb_friction", place("joint", 3)),
        "joint",
        True,
    ),
    (("base_tilt", place("base")), ("encoder_offset", place("joint", 1)), "joint", True),
    (("base_tilt", place("base")), ("encoder_offset", place("joint", 1)), "both", False),
    (("base_tilt", place("base")), ("encoder_offset", place("joint", 2)), "joint", False),
    (("coulomb_friction", place("joint", 2)), ("viscous_friction", place("joint", 2)), "joint", False),
    (("transmission_ratio_error", place("cable", 2, joint=2)), ("transmission_ratio_error", place("joint", 2)), "both",
     True),
]  # fmt: skip


@pytest.mark.parametrize("one, other, positions, expected", IDENTITIES)
def test_identities_of_the_arm(one, other, positions, expected):
    """Pairs that nothing can tell apart are the same, both ways round; others are not."""
    a, b = ({"effect": e, "location": w} for e, w in (one, other))
    assert same(a, b, 3, positions) is expected
    assert same(b, a, 3, positions) is expected
    assert (score(truth(one, positions=positions), diagnosis(other)).meetings == ("class",)) is expected


def test_gain_of_either_motor_on_two_links():
    """With two motors a gain on one is the inverse gain on the other; with three it is not."""
    one, other = (("torque_gain_error", place("motor", k)) for k in (1, 2))
    assert score(truth(one, n=2), diagnosis(other)).all_right
    assert not score(truth(one, n=3), diagnosis(other)).all_right


def test_asymmetry_may_be_split():
    """Asymmetric friction of a motor is Coulomb friction and an offset there, and the reverse."""
    asymmetric, dry, constant = (
        (name, place("motor", 2)) for name in ("asymmetric_friction", "coulomb_friction", "torque_offset")
    )
    assert score(truth(asymmetric), diagnosis(dry, constant)).all_right
    assert not score(truth(asymmetric), diagnosis(dry)).all_right
    assert score(truth(dry, constant), diagnosis(asymmetric)).all_right


def test_a_refined_law_has_the_dry_friction_of_its_place():
    """Dry friction beside Stribeck's on the same axis is one law with more of it; alone, a peak is none of it."""
    dry, peak = ("coulomb_friction", place("motor", 1)), ("stribeck_friction", place("joint", 1))
    assert score(truth(dry, peak), diagnosis(peak)).meetings == ("class", "exact")
    assert not score(truth(dry), diagnosis(peak)).all_right
    assert not score(truth(("coulomb_friction", place("motor", 2)), peak), diagnosis(peak)).all_right


def test_rigid_body_effects_stand_under_rigid_body():
    """A rotor, a payload, the last encoder's offset are met under rigid_body and leave the verdict consistent."""
    rotor = ("rotor_inertia", place("motor", 2))
    assert score(truth(rotor), diagnosis(verdict="consistent", rigid=[rotor])).all_right
    silent = score(truth(rotor), diagnosis(verdict="consistent"))
    assert silent.meetings == ("missed",) and not silent.first_right
    last = ("encoder_offset", place("joint", 3))
    assert score(truth(last), diagnosis(verdict="consistent", rigid=[last])).all_right
    assert not score(truth(last, positions="both"), diagnosis(verdict="consistent", rigid=[last])).all_right
    assert score(truth(last, positions="both"), diagnosis(last)).all_right


def test_effects_of_no_catalogue():
    """`unexplained` at the right joint scores; a name beside it, another joint or another verdict does not."""
    bump = ("torque_bump", place("joint", 2, other=3))
    for index, right in ((2, True), (3, True), (1, False)):
        told = diagnosis(verdict="unexplained", unexplained={"location": place("joint", index)})
        assert score(truth(bump), told).unexplained_right is right
        assert score(truth(bump), told).all_right is right
    beside = diagnosis(COULOMB_2, verdict="unexplained", unexplained={"location": place("joint", 2)})
    assert score(truth(bump), beside).false_findings
    assert score(truth(bump), diagnosis(COULOMB_2)).unexplained_right is False
    assert score(truth(COULOMB_2), diagnosis(COULOMB_2)).unexplained_right is None


@pytest.mark.parametrize(("alike", "right"), [(0.9999, True), (0.999, False)])
def test_what_no_data_tell_from_a_law_may_have_its_name(alike, right):
    """At a visibility of 100 the two likenesses leave 1.4, which nobody sees, and 4.5."""
    concealed = truth(("torque_bump", place("joint", 2)))
    concealed["effects"][0]["visibility"] = 100.0
    result = score(concealed, diagnosis(COULOMB_2), lambda k, finding: alike)
    assert (result.all_right, result.unexplained_right, not result.false_findings) == (right, right, right)
    assert not score(concealed, diagnosis(COULOMB_2, verdict="unexplained"), lambda k, finding: 0.999).all_right


def test_parameters_against_their_intervals():
    """True values inside and outside the stated 95 % interval are told; phases count modulo a turn."""
    true, told = truth(COULOMB_2), diagnosis(COULOMB_2)
    true["effects"][0]["parameters"] = {"coulomb": 0.30, "phase": 3.1, "time": [1.0, 2.0]}
    told["findings"][0]["parameters"] = {
        "coulomb": {"value": 0.31, "std": 0.004, "unit": "N m"},
        "phase": {"value": -3.1, "std": 0.1, "unit": "rad"},
    }
    before = copy.deepcopy((true, told))
    coulomb, phase = score(true, told).parameters
    assert not coulomb.inside and coulomb.z == pytest.approx(2.5)
    assert phase.inside and phase.z == pytest.approx((2 * np.pi - 6.2) / 0.1)
    assert (true, told) == before
    assert score(true, told).as_dict()["parameters"][0]["inside"] is False


def test_sliding_weights_are_normalised():
    """Scale and sign of a combination do not matter; places that do not slide have none."""
    np.testing.assert_allclose(sliding_weights(place("combination", weights=[0.0, -2.0, 1.0]), 3), [0, 1, -0.5])
    np.testing.assert_allclose(sliding_weights(place("joint", 2), 3), [1, -1, 0])
    assert sliding_weights(place("base"), 3) is None


def test_places_are_said_in_words():
    """A place of two parts says how they belong together."""
    assert describe(place("motor", 2)) == "motor 2" and describe({"kind": "base"}) == "base"
    assert describe(place("motor", 2, joint=1)) == "motor 2 with joint 1"
    assert describe(place("cable", 2, joint=1)) == "cable 2 at joint 1"
    assert describe(place("cable", 3, link=1)) == "cable 3 on link 1"
    assert describe(place("joint", 1, other=3)) == "joint 1 with joint 3"
