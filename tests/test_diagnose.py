"""Diagnosis end to end: the right name at the right place, nothing where nothing is, no name where there is none."""

import json

import numpy as np
import pytest
from trials import rubbed, with_torque, written_trial

from cdm_pin.band import make_band
from cdm_pin.cli import main
from cdm_pin.diagnose import diagnose, distinct
from cdm_pin.gather import gather
from cdm_pin.leftover import left_over
from cdm_pin.manipulator import save_manipulator
from cdm_pin.model import load_model
from cdm_pin.recording import Recording
from cdm_pin.scoring import score
from cdm_pin.search import rms

KEYS = {
    "schema",
    "verdict",
    "rigid_body",
    "findings",
    "fit",
    "sensitivity",
    "unexplained",
    "next_experiment",
}


def blind(folder, seed, effects, **options):
    """Draw a trial on the independent plant and load what a user would have."""
    return written_trial(folder, seed, effects=effects, n_links=2, duration=40.0, **options)


def strange(folder, seed, name, bits):
    """Draw an effect of no catalogue, of that name, and diagnose it: the truth about it, and what is said."""
    options = {"effects": 1, "at_least": 50.0, "out_of_catalogue": True}
    model, runs, unseen, truth, _ = written_trial(folder, seed, bits=bits, **options)
    (effect,) = truth["effects"]
    assert effect["effect"] == name
    return effect, diagnose(model, runs, unseen).content


def names(finding):
    """Every name and place that a finding stands for."""
    return [(f["effect"], f["location"]) for f in [finding, *finding["indistinguishable_from"]]]


@pytest.fixture(scope="module")
def dry(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dry")
    return blind(folder, 3, ["coulomb_friction"], positions="joint", bits=17, noise="white")


@pytest.fixture(scope="module")
def dry_diagnosis(dry):
    model, runs, unseen, _, _ = dry
    return diagnose(model, runs, unseen)


def test_dry_friction_is_named_sized_and_judged(dry, dry_diagnosis):
    """One dry friction: found alone, at its place, within four standard errors; the unseen run falls to its floor."""
    content = dry_diagnosis.content
    truth = dry[3]["effects"][0]
    assert set(content) >= KEYS
    assert content["verdict"] == "missing_physics"
    (finding,) = content["findings"]
    assert (truth["effect"], truth["location"]) in names(finding)
    assert finding["evidence"]["holdout_rmse_reduction"] > 0.3
    value = finding["parameters"]["coulomb"]
    assert abs(value["value"] - truth["parameters"]["coulomb"]) < max(4 * value["std"], 0.02 * value["value"])
    unseen = content["fit"]["holdout"]
    assert max(np.array(unseen["rmse_augmented"]) / np.array(unseen["noise_floor"])) < 1.5
    assert content["sensitivity"]


def test_order_and_copies_do_not_matter(dry, dry_diagnosis):
    """A copy of a recording is not new evidence, whatever its place in the list."""
    model, runs, unseen, _, _ = dry
    assert len(distinct([*runs, *runs, *unseen])) == len(runs) + len(unseen)
    again = diagnose(model, [*runs, *runs], unseen).content
    assert again["findings"] == dry_diagnosis.content["findings"]


@pytest.mark.parametrize(
    "effect, seed",
    [("coulomb_friction", 3), ("joint_spring", 8500), pytest.param("hysteresis", 8502, marks=pytest.mark.slow)],
)
def test_the_completed_model_is_complete(tmp_path, effect, seed):
    """Run forward from model.yaml it leaves what the fit left, in torques and in travel: nothing more is missing.

    The hysteresis is one that remembers its cable's torque.
    """
    effects = [effect, "encoder_offset"]
    model, runs, unseen, _, _ = written_trial(
        tmp_path, seed, effects=effects, positions="both", n_links=2, at_least=50.0, bits=17, noise="white"
    )
    first = diagnose(model, runs, unseen)
    assert {f["effect"] for f in first.content["findings"]} == set(effects)
    memory = {f.get("memory", "cable tension") for f in first.content["findings"]}
    assert memory == {"cable tension"}
    save_manipulator(first.manipulator, tmp_path / "model.yaml")
    again = diagnose(load_model(tmp_path / "model.yaml"), runs, unseen)
    assert again.content["verdict"] == "consistent"
    left, fitted = (
        rms(again.search, again.search.nominal),
        left_over(first.search, first.explanation.fit.effects)[1].rms,
    )
    assert np.all(left < 1.5 * fitted)


def test_wrong_masses_alone_are_consistent(tmp_path):
    """Where only the masses in the file are wrong nothing is missing; what differs from the file is listed."""
    model, runs, unseen, _, _ = blind(tmp_path, 11, 0, positions="joint", bits=17, noise="white")
    content = diagnose(model, runs, unseen).content
    assert content["verdict"] == "consistent"
    assert content["findings"] == []
    assert content["rigid_body"]["changed"]
    assert all(row["amplitude"] is None or row["amplitude"] > 0 for row in content["sensitivity"])


def test_unknown_physics_gets_no_name(tmp_path):
    """A torque at one angle, which no entry of the catalogue is, is placed but not named."""
    model, runs, unseen, truth, _ = blind(tmp_path, 5, ["torque_bump"], positions="joint", bits=17, noise="white")
    content = diagnose(model, runs, unseen).content
    assert content["verdict"] == "unexplained"
    assert content["findings"] == []
    joint = truth["effects"][0]["location"]["index"]
    place = content["unexplained"]["location"]
    assert place["index"] == joint or place["kind"] != "joint"


@pytest.mark.slow
def test_what_takes_little_of_a_motor_whose_error_no_sensor_has_gets_no_name(tmp_path):
    """An amplifier with a dead band: offset and gain of that motor describe some of it, and have no name there."""
    effect, content = strange(tmp_path, 155547814008474, "amplifier_dead_band", bits=14)
    assert content["verdict"] == "unexplained"
    assert content["findings"] == []
    assert content["unexplained"]["location"] == effect["location"]


def test_a_line_above_the_band_is_said_and_placed(tmp_path):
    """A torque on joint 2 at 6.3 Hz, above the band, where nothing else is missing: `unexplained`, at that joint."""
    model, runs, unseen, _, _ = blind(tmp_path, 11, 0, positions="joint", bits=14, noise="white")
    swung = []
    for run in (*runs, *unseen):
        swing = 0.3 * np.sin(2 * np.pi * 6.3 * run.time)[:, None] * model.joint_from_motor[1]
        swung.append(with_torque(run, run.channels["motor_torque"] + swing))
    content = diagnose(model, swung[:-1], swung[-1:]).content
    assert content["data"]["band"][1] < 6.0
    assert content["verdict"] == "unexplained"
    assert content["unexplained"]["location"] == {"kind": "joint", "index": 2}
    assert "6.3 Hz" in content["unexplained"]["region"]


@pytest.mark.parametrize("joint", [1, 2])
def test_drag_that_drifts_with_dry_friction_is_one_effect(tmp_path, joint):
    """Dry friction and drag of a joint that both start 90 % higher: one friction that drifts, its drag with it.

    Motor 1 alone drives joint 1: it is the same for any motion, and no experiment is asked for to tell the two apart.
    """
    model, runs, unseen, _, _ = blind(tmp_path, 11, 0, positions="joint", bits=17, noise="white")

    def warming(t, v):
        return (0.2 * np.tanh(v / 0.02) + 0.3 * v) * (1.0 + 0.9 * np.exp(-t / 8.0))

    warmed = [rubbed(model, run, joint, warming) for run in (*runs, *unseen)]
    content = diagnose(model, warmed[:-1], warmed[-1:]).content
    (finding,) = content["findings"]
    assert (finding["effect"], finding["location"]) == ("friction_drift", {"kind": "joint", "index": joint})
    same = [{"effect": "friction_drift", "location": {"kind": "motor", "index": 1}}] if joint == 1 else []
    assert finding["indistinguishable_from"] == same
    assert content["next_experiment"] is None
    for name, true in {"friction": 0.2, "extra": 0.9, "time_constant": 8.0, "viscous": 0.3}.items():
        assert finding["parameters"][name]["value"] == pytest.approx(true, rel=0.15)


def test_little_data_is_not_bad_input(dry):
    """Half a second, or a robot at rest, is answered with `insufficient_data`."""
    model, runs, _, _, _ = dry
    run = runs[0]
    short = Recording(run.time[:100], {name: x[:100] for name, x in run.channels.items()})
    assert diagnose(model, [short]).content["verdict"] == "insufficient_data"
    still = Recording(run.time, {name: 0 * x + x[:1] for name, x in run.channels.items()})
    assert diagnose(model, [still]).content["verdict"] == "insufficient_data"


def test_the_command_writes_all_it_promises(dry, tmp_path, capsys):
    """`cdm-pin diagnose` writes diagnosis, report and model; without a hold-out findings are unconfirmed."""
    files = dry[4]
    out = tmp_path / "out"
    status = main(["diagnose", str(files["manipulator"]), str(files["recordings"][0]), "-o", str(out)])
    assert status == 0
    content = json.loads((out / "diagnosis.json").read_text())
    assert content["findings"][0]["unconfirmed"]
    assert content["fit"]["holdout"] is None
    assert "<html" in (out / "report.html").read_text()
    assert load_model(out / "model.yaml").manipulator.effects
    assert "dry friction" in capsys.readouterr().out


def test_bad_input_is_one_line(dry, tmp_path, capsys):
    """A recording of another robot is refused in one line with status 2 and nothing is written."""
    files = dry[4]
    wrong = tmp_path / "wrong.csv"
    wrong.write_text("time,joint_position_1,motor_torque_1\n" + "\n".join(f"{k / 100},0,0" for k in range(300)))
    out = tmp_path / "out"
    assert main(["diagnose", str(files["manipulator"]), str(wrong), "-o", str(out)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not out.exists()


def test_the_band_passes_slow_motion_unchanged():
    """The common filter keeps what is below its cut-off, without phase, at every kept sample."""
    band = make_band(200.0, 8.0)
    t = np.arange(4000) / 200.0
    x = np.sin(2 * np.pi * 1.3 * t)
    y = band.reduce(x[None])[0]
    ((start, stop),) = band.segments(np.ones(4000, bool))
    assert np.allclose(y[start:stop], x[:: band.step][start:stop], atol=5e-3)
    assert band.reduce(np.sin(2 * np.pi * 40.0 * t)[None])[0, start:stop].std() < 5e-3


@pytest.mark.slow
def test_joint_encoders_alone_show_an_elastic_cable(tmp_path):
    """The rotor turns by the cable's stretch more than the joint says: its torque names the cable and sizes it."""
    model, runs, unseen, truth, _ = blind(tmp_path, 3, ["cable_elasticity"], positions="joint", bits=17, noise="white")
    content = diagnose(model, runs, unseen).content
    (finding,), (effect,) = content["findings"], truth["effects"]
    assert (finding["effect"], finding["location"]) == (effect["effect"], effect["location"])
    i = effect["location"]["index"] - 1
    stated = model.rotor_inertia[i] / truth["rotor_inertia"][i]  # the torque tells inertia over stiffness
    assert finding["parameters"]["stiffness"]["value"] == pytest.approx(
        stated * effect["parameters"]["stiffness"], rel=0.1
    )


def test_a_strand_that_always_hangs_is_slack(tmp_path):
    """A cable whose load never falls to where its other strand pulls too is told from one of half the stiffness.

    That shows between the encoders: in the sizes of that travel and as a curve over the cable's torque.
    """
    model, runs, unseen, truth, _ = blind(
        tmp_path, 20, ["cable_slack"], positions="both", bits=17, noise="white", size="quarter"
    )
    diagnosis = diagnose(model, runs, unseen)
    (finding,), (effect,) = diagnosis.content["findings"], truth["effects"]
    assert (finding["effect"], finding["location"]) == (effect["effect"], effect["location"])
    assert finding["parameters"]["torque"]["value"] == pytest.approx(effect["parameters"]["torque"], rel=0.05)
    travel = diagnosis.content["fit"]["holdout"]["travel"]
    i = effect["location"]["index"] - 1
    assert travel["rmse_augmented"][i] < 0.1 * travel["rmse_rigid"][i] and travel["unit"] == "rad"
    (curve,) = gather(diagnosis).laws
    assert "torque of the cable" in curve.x_label
    assert np.std(curve.y_points - curve.y_fit) < 0.1 * np.std(curve.y_points)
    assert np.corrcoef(curve.x, curve.y_fit)[0, 1] > 0.9


def test_what_encoders_do_not_see_is_drawn_as_torque(tmp_path):
    """A wrong gain hangs on the torque as a soft cable does, but moves nothing between the encoders."""
    model, runs, unseen, _, _ = written_trial(
        tmp_path, 3, effects=["torque_gain_error"], positions="both", n_links=2, at_least=50.0, bits=17, noise="white"
    )
    (curve,) = gather(diagnose(model, runs, unseen)).laws
    assert curve.y_label.startswith("torque") and curve.y_fit.any()


@pytest.mark.slow
def test_a_strong_push_beside_friction_by_torque_is_named(tmp_path):
    """The friction alone may be wrong by as much as the push, but not in the shape of one that leaves only noise."""
    model, runs, unseen, truth, _ = written_trial(tmp_path, 77307004668733, effects=2, at_least=50.0, bits=17)
    content = diagnose(model, runs, unseen).content
    assert content["verdict"] == "missing_physics"
    found = {(f["effect"], str(f["location"])) for f in content["findings"]}
    assert found == {(e["effect"], str(e["location"])) for e in truth["effects"]}


@pytest.mark.parametrize(
    ("seed", "effect", "visibility"),
    [
        (152971890073249, "load_dependent_friction", 21.83),  # drifts so that it would drive, once all is estimated
        pytest.param(
            2435691590527, "friction_drift", 16.26, marks=pytest.mark.slow
        ),  # falls, though by what is not known to three errors
    ],
)
def test_dry_friction_stands_for_a_law_that_is_not_told_from_it(tmp_path, seed, effect, visibility):
    model, runs, unseen, _, _ = written_trial(tmp_path, seed, effects=[effect], visibility=visibility, bits=14)
    (finding,) = diagnose(model, runs, unseen).content["findings"]
    assert finding["effect"] == "coulomb_friction"
    assert effect in [r["effect"] for r in finding["indistinguishable_from"]]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "bits"),
    [
        (202895779544438, 14),  # a ratio of two motors that takes up most of what a gain is off by
        (229026444396308, 17),  # ripple of a motor that turns by a wrong map, seen by encoders of the joints alone
        (1625527913126, 17),  # a delay that looks like friction at every axis
    ],
)
def test_three_effects_are_told_apart(tmp_path, seed, bits):
    model, runs, unseen, truth, _ = written_trial(tmp_path, seed, effects=3, at_least=50.0, bits=bits)
    result = score(truth, diagnose(model, runs, unseen).content)
    assert result.all_right, (result.meetings, result.false_findings)


def remembering(t, v, size, grows=0.4, fades=1.5):
    """Give a friction that grows after each reversal and then fades, as no law of the catalogue does."""
    way = np.where(v < 0.0, -1.0, 1.0)
    turns = np.r_[0, np.flatnonzero(np.diff(way)) + 1]
    since = t - t[turns[np.searchsorted(turns, np.arange(len(t)), side="right") - 1]]
    return size * way * (1.0 - np.exp(-since / grows)) * (0.3 + 0.7 * np.exp(-since / fades))


def test_one_unknown_law_is_not_made_of_several_known_ones(tmp_path):
    """Dry friction, hysteresis and a coupling together imitate it; one correction without a name is likelier."""
    options = {"effects": 0, "n_links": 2, "positions": "joint", "bits": 17, "noise": "white", "motion": "prescribed"}
    model, runs, unseen, _, _ = written_trial(tmp_path, 17, **options)
    size = 0.3 * np.std(runs[0].channels["motor_torque"][:, 1])
    logs = [[rubbed(model, r, 2, lambda t, v: remembering(t, v, size)) for r in kind] for kind in (runs, unseen)]
    content = diagnose(model, *logs).content
    assert content["verdict"] == "unexplained"
    assert content["findings"] == []
    assert content["unexplained"]["location"] == {"kind": "joint", "index": 2}


@pytest.mark.slow
def test_a_torque_of_its_own_frequency_is_heard_in_half_a_minute(tmp_path):
    """In the narrow band of coarse encoders that is some 240 samples."""
    options = {"effects": 0, "positions": "motor", "bits": 14, "noise": "white", "motion": "prescribed"}
    model, runs, unseen, _, _ = written_trial(tmp_path, 5, n_links=3, duration=30.0, **options)

    def humming(run):
        torque = run.channels["motor_torque"].copy()
        torque[:, 2] += 0.3 * torque[:, 2].std() * np.sin(2 * np.pi * 1.37 * run.time)
        return with_torque(run, torque)

    content = diagnose(model, [humming(run) for run in runs], [humming(run) for run in unseen]).content
    assert content["verdict"] == "unexplained"
    assert content["unexplained"]["location"] == {"kind": "motor", "index": 3}
    assert "frequency of its own" in content["unexplained"]["region"]


@pytest.mark.slow
def test_no_offset_is_named_beside_a_play_that_is_hardly_crossed(tmp_path):
    """The cable visits the other side for moments that do not show the whole way: the gap says how unsure it is."""
    model, runs, unseen, truth, _ = written_trial(tmp_path, 190917076025529, bits=17, at_least=50.0)
    content = diagnose(model, runs, unseen).content
    (effect,), (finding,) = truth["effects"], content["findings"]
    assert finding["effect"] == effect["effect"] == "backlash"
    gap = finding["parameters"]["half_gap"]
    assert abs(gap["value"] - effect["parameters"]["half_gap"]) < 2.0 * gap["std"]


def test_sensitivities_are_no_finer_than_encoders_round(tmp_path):
    """An eccentric pulley that moves encoders by less than a share of their steps is not named, nor said to be seen."""
    options = {"effects": 0, "n_links": 2, "positions": "both", "noise": "white", "motion": "prescribed"}
    model, runs, _, _, _ = written_trial(tmp_path, 3, bits=14, **options)
    rows = diagnose(model, runs).content["sensitivity"]
    turns = [row for row in rows if row["effect"] == "pulley_eccentricity"]
    travel = np.ptp(runs[0].channels["joint_position"], axis=0).max()
    step = 2.0 * np.pi / 2**14
    assert turns
    assert all(row["amplitude"] is None or row["amplitude"] * travel > 0.03 * step for row in turns)


def test_a_motor_ripples_a_whole_number_of_times_a_turn(tmp_path):
    """The data hardly speak against it, and other recordings turn the motor further."""
    model, runs, unseen, truth, _ = blind(tmp_path, 9, ["torque_ripple"], size="quarter", bits=14, noise="white")
    (effect,), (finding,) = truth["effects"], diagnose(model, runs, unseen).content["findings"]
    assert finding["effect"] == "torque_ripple"
    assert finding["parameters"]["cycles"]["value"] == effect["parameters"]["cycles"]


@pytest.mark.slow
def test_what_acts_on_a_motor_whose_error_stays_huge_is_not_sure(tmp_path):
    """A spring between two joints, of no catalogue: most of it is like one at joint 1, and far too much is left."""
    _, content = strange(tmp_path, 130362614262690, "cross_spring", bits=17)
    assert content["verdict"] == "unexplained"
    assert content["findings"] == []


@pytest.mark.parametrize(("lag", "said"), [(6e-4, []), (4e-3, ["time_delay"])])
def test_what_every_drive_is_late_by_is_no_fault(tmp_path, lag, said):
    """A filter of 0.6 ms before the torque is logged, as quiet sensors show it, and one of 4 ms."""
    options = {"positions": "joint", "bits": 20, "noise": "white", "motion": "prescribed"}
    model, runs, unseen, _, _ = blind(tmp_path, 4, 0, **options)

    def late(run):
        torque = [np.interp(run.time - lag, run.time, x) for x in run.channels["motor_torque"].T]
        return with_torque(run, np.transpose(torque))

    content = diagnose(model, [late(run) for run in runs], [late(run) for run in unseen]).content
    assert [finding["effect"] for finding in content["findings"]] == said
    assert content["verdict"] == ("missing_physics" if said else "consistent")


@pytest.mark.slow
def test_what_positions_are_too_coarse_to_tell_is_no_line_of_its_own(tmp_path):
    """A servo's ripple moves the arm by a hundredth of an encoder's step: the torque is all that shows it."""
    model, runs, unseen, _, _ = written_trial(tmp_path, 143572560067792, effects=0, bits=14)
    assert diagnose(model, runs, unseen).content["verdict"] == "consistent"
