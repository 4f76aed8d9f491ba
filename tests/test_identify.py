"""Recordings in, parameters out: recovery, honest uncertainty, what cannot be known, files that others read."""

import json
import sys

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from arms import ROOT, relative, states
from chains import logged, spatial_arm

from cdm_pin.cli import main
from cdm_pin.consistency import consistency_margin
from cdm_pin.errors import InputError, RecordingError
from cdm_pin.identified import content, identified_manipulator, save_identification
from cdm_pin.identify import identify
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.model import build_model, load_model
from cdm_pin.recording import Recording, save_recording
from cdm_pin.robots import robot_urdf
from cdm_pin.workers import processes

CDM2 = load_model(ROOT / "urdf" / "cdm2.yaml")
TRUTH = np.array([1.2, 0.0, 0.6, 0.3, 0.0, 0.12])
FRICTION = ("viscous_friction", "coulomb_friction")


def ur5():
    """Give a UR5 whose wrist is locked, by its URDF."""
    joints = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
    content = {"urdf": str(robot_urdf("ur5_robot"))}
    content["transmission"] = {"joints": joints, "joint_from_motor": np.eye(3).tolist()}
    return build_model(parse_manipulator(content))


@pytest.mark.parametrize("model", [CDM2, spatial_arm(3, 1)], ids=["cdm2", "spatial3"])
def test_noise_free_recordings_give_the_truth(model):
    """Through filter, differentiation and decimation: a few millionths of the largest parameter."""
    result = identify(model, [logged(model, s, noise=0.0, encoder=0.0, rate=200) for s in (1, 2)])
    truth = result.structural.values(model.standard_parameters)
    assert result.rank == result.structural.rank == len(truth)
    assert relative(result.fit.values, truth) < 3e-6


def test_every_kind_of_recording_gives_the_same_parameters():
    """Joint or motor positions, both, joint torque alone: the truth within five standard deviations."""
    for channels in (
        ("joint_position", "motor_torque"),
        ("motor_position", "motor_torque"),
        ("joint_position", "motor_position", "motor_torque", "joint_torque"),
        ("joint_position", "joint_torque"),
    ):
        result = identify(CDM2, [logged(CDM2, 3, channels=channels)])
        assert np.all(np.abs(result.fit.values - TRUTH) < 5 * result.std), channels
        assert np.all(result.std < 0.03)
        checked = any("E' joint_torque differs" in text for text in result.train.visits[0].notices)
        assert checked == ({"joint_torque", "motor_torque"} <= set(channels))


@pytest.mark.parametrize(("phi", "friction"), [(0.0, False), (0.9, True)])
def test_stated_90_percent_intervals_cover_85_to_95_percent(phi, friction):
    """Torque noise that is white, or correlated over tenths of a second with friction fitted too."""
    hits, sizes = [], [0.3, 0.3, 0.2, 0.2] if friction else []
    truth = np.concatenate([TRUTH, sizes])
    for seed in range(40):
        run = logged(CDM2, seed, phi=phi, viscous=0.3 * friction, coulomb=0.2 * friction)
        result = identify(CDM2, [run], effects=FRICTION if friction else ())
        hits.append(np.abs(result.fit.values - truth) < 1.645 * result.std)
    assert 0.85 < np.mean(hits) < 0.95


def test_intervals_hold_the_truth_of_arms_that_another_program_simulates():
    """A part of the study in docs/interval_coverage.md: drifting coloured noise, coarse encoders, friction."""
    sys.path.insert(0, str(ROOT / "scripts"))
    import interval_coverage

    case = interval_coverage.CASES[-1]
    z = np.concatenate([interval_coverage.deviations(seed, case, duration=20.0, n_links=2) for seed in range(5)])
    assert len(z) > 30 and np.mean(np.abs(z) < interval_coverage.QUANTILE) > 0.75


def test_effects_by_name_and_place():
    """Friction at motors or joints; what was not asked for is hinted at; unknown or nonlinear ones are refused."""
    runs = [logged(CDM2, s, viscous=0.3, coulomb=0.2) for s in (1, 2)]
    assert any(hint.startswith("viscous_friction would take") for hint in identify(CDM2, runs).hints)
    result = identify(CDM2, runs, effects=[*FRICTION, "torque_offset"])
    names = [term.name for term in result.terms]
    assert names[:2] == ["viscous_friction motor 1", "viscous_friction motor 2"] and not result.hints
    np.testing.assert_allclose(result.fit.values[6:10], [0.3, 0.3, 0.2, 0.2], atol=0.02)
    placed = identify(CDM2, runs, effects=["viscous_friction:joint2"])
    assert [term.name for term in placed.terms] == ["viscous_friction joint 2"]
    with pytest.raises(InputError, match="did you mean 'viscous_friction'"):
        identify(CDM2, runs, effects=["viscus_friction"])
    with pytest.raises(InputError, match="not linear"):
        identify(CDM2, runs, effects=["stribeck_friction"])
    with pytest.raises(InputError, match="nowhere on this robot"):
        identify(CDM2, runs, effects=["viscous_friction:joint7"])


def test_a_rotor_cannot_be_told_from_its_link():
    """On the paper's arm motors turn with the links' absolute angles: the rotor is refused by name, not split."""
    result = identify(CDM2, [logged(CDM2, 1)], effects=["rotor_inertia"])
    assert not result.terms
    reasons = dict(result.not_identifiable)
    assert "Izz_2" in reasons["rotor_inertia motor 2"]


@pytest.mark.parametrize(
    ("kind", "run"),
    [
        ("locked", {"locked": (0,)}),
        ("all locked", {"locked": (0, 1)}),
        ("short", {"duration": 0.5}),
        ("very short", {"duration": 0.03}),
        ("hardly moving", {"amplitude": 2e-5}),
    ],
)
def test_little_data_gives_no_numbers(kind, run, tmp_path):
    """A locked joint, a short record, no excitation: named, without values; the model file is still valid."""
    result = identify(CDM2, [logged(CDM2, 4, **run)])
    missing = {name for name, _ in result.not_identifiable}
    assert "Izz_1 + m_2*l_1^2" in missing and all(reason for _, reason in result.not_identifiable)
    data = content(result)
    assert not missing & {p["name"] for p in data["base_parameters"]}
    assert ("Izz_2" in missing) == (kind != "locked")
    save_identification(result, tmp_path, tmp_path)
    model = load_model(tmp_path / "model.yaml")
    assert consistency_margin(model.standard_parameters).min() > 0
    assert relative(model.standard_parameters, CDM2.standard_parameters) < 0.5


def test_a_locked_joint_still_tells_the_rest():
    """What a locked joint leaves is found as accurately as before."""
    result = identify(CDM2, [logged(CDM2, 4, locked=(0,))])
    found = dict(zip(result.base.names, result.fit.values, strict=True))
    assert found["Izz_2"] == pytest.approx(0.12, abs=0.01) and found["mx_2"] == pytest.approx(0.3, abs=0.002)


def test_robust_fit_ignores_outliers():
    """Bursts in the torque log shift the weighted fit, not the robust one."""
    run = logged(CDM2, 5, noise=0.02, phi=0.0)
    torque = run.channels["motor_torque"].copy()
    for start in range(200, 2800, 400):
        torque[start : start + 40, 1] += 3.0
    bad = Recording(run.time, {**run.channels, "motor_torque": torque})
    weighted, robust = (identify(CDM2, [bad], estimator=e) for e in ("weighted", "robust"))
    errors = [np.abs(r.fit.values - TRUTH).max() for r in (weighted, robust)]
    assert errors[1] < 0.3 * errors[0]


def test_consistent_fit_is_physical_where_the_free_one_is_not():
    """Noisy data: every link has a body, friction does not push, the holdout does not suffer."""
    run = logged(CDM2, 6, duration=20.0, noise=2.0)
    free = identify(CDM2, [run], holdout=[logged(CDM2, 7)], effects=FRICTION)
    bound = identify(CDM2, [run], holdout=[logged(CDM2, 7)], effects=FRICTION, estimator="consistent")
    assert np.all(bound.fit.values[6:] >= -1e-9) and not np.all(free.fit.values[6:] >= 0)
    assert consistency_margin(bound.standard.parameters).min() > 0
    np.testing.assert_allclose(bound.base.values(bound.standard.parameters), bound.fit.values[:6], atol=1e-12)
    assert np.all(bound.errors(bound.holdout)["rmse"] < 1.05 * free.errors(free.holdout)["rmse"])


def test_an_identification_proves_itself():
    """Residual, rank and condition number are recomputed from what it holds."""
    result = identify(CDM2, [logged(CDM2, 8)], holdout=[logged(CDM2, 9)])
    np.testing.assert_allclose(result.residual, result.fit.noise, rtol=1e-6)
    np.testing.assert_allclose(result.errors(result.train)["rmse"], result.residual, rtol=1e-9)
    assert result.rank == 6 and 1 < result.condition_number < 20
    held = result.errors(result.holdout)
    assert np.all(held["rmse"] < 2 * result.residual) and np.all(held["relative"] < 0.1)


def test_samples_where_the_mechanism_ends_are_left_out():
    """Past the wrap, or with a slack cable, the model does not hold: such samples are counted, not fitted."""
    t, run = 30.0, logged(CDM2, 10)
    q = run.channels["joint_position"].copy()
    swing = 2.4 * np.sin(2 * np.pi * np.arange(len(q)) / 100 / t)
    wide = Recording(run.time, {**run.channels, "joint_position": np.column_stack([q[:, 0], swing])})
    left_out = identify(CDM2, [wide]).train.visits[0].left_out
    assert any("joint 2 past the wrap" in reason and count > 100 for reason, count in left_out.items())
    slack = Recording(run.time, run.channels, pretension=40.0)
    left_out = identify(CDM2, [slack]).train.visits[0].left_out
    assert any("cable 1 slack" in reason for reason in left_out)


@pytest.mark.parametrize("estimator", ["weighted", "consistent"])
def test_model_file_and_urdf_reproduce_the_identified_torques(estimator, tmp_path):
    """model.yaml and the URDF, read by Pinocchio, yourdfpy and MuJoCo, have the identified base parameters."""
    for model in (CDM2, ur5()):
        result = identify(model, [logged(model, s, viscous=0.2) for s in (1, 2)], effects=FRICTION, estimator=estimator)
        save_identification(result, tmp_path, tmp_path)
        loaded = load_model(tmp_path / "model.yaml")
        wanted = result.fit.values[: result.base.rank]
        if result.standard.exact:
            assert relative(result.base.values(loaded.standard_parameters), wanted) < 1e-8
        assert consistency_margin(loaded.standard_parameters).min() > 0
        assert {e["effect"] for e in loaded.manipulator.effects} == set(FRICTION)
        text = (tmp_path / "identified.urdf").read_text()
        raw = pin.buildModelFromXML(text)
        raw.gravity = model.pin_model.gravity
        q, v, a = states(model, 5, 0)
        for row in range(5):
            tau = pin.rnea(raw, raw.createData(), *(_in_order(raw, model, x[row]) for x in (q, v, a)))
            expected = result.identified_model.pin_model
            again = pin.rnea(expected, expected.createData(), *(_in_order(expected, model, x[row]) for x in (q, v, a)))
            np.testing.assert_allclose(
                _in_order(raw, model, tau, back=True), _in_order(expected, model, again, back=True)
            )
        assert set(yourdfpy.URDF.load(str(tmp_path / "identified.urdf")).actuated_joint_names) == set(model.joints)
        assert mujoco.MjModel.from_xml_string(text).nv == model.n_joints


def _in_order(pin_model, model, x, back=False):
    """Rows of E to Pinocchio's order, or back."""
    index = [pin_model.joints[pin_model.getJointId(name)].idx_v for name in model.joints]
    if back:
        return x[index]
    out = np.zeros(len(x))
    out[index] = x
    return out


def test_an_identified_model_can_be_identified_again():
    """Its effects count as known: what is left to find is the rigid body."""
    runs = [logged(CDM2, s, viscous=0.3, coulomb=0.2) for s in (1, 2)]
    first = identify(CDM2, runs, effects=FRICTION)
    second = identify(build_model(identified_manipulator(first)), runs)
    np.testing.assert_allclose(second.fit.values, first.fit.values[:6], atol=2e-3)
    assert np.all(second.residual < 1.1 * first.residual)


@pytest.fixture
def folder(tmp_path):
    """Write recordings of the paper's arm as files."""
    for seed in range(3):
        save_recording(logged(CDM2, seed), tmp_path / f"run{seed}.csv")
    return tmp_path


def run_cli(folder, *arguments):
    """Exit status of an identification of the paper's arm."""
    return main(["identify", str(ROOT / "urdf" / "cdm2.yaml"), "-o", str(folder / "out"), *map(str, arguments)])


def test_console(folder, capsys):
    """Files, table, and the same JSON printed and written."""
    runs = [folder / "run0.csv", folder / "run1.csv"]
    assert run_cli(folder, *runs, "--holdout", folder / "run2.csv", "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    written = json.loads((folder / "out" / "identification.json").read_text())
    assert printed == written and written["schema"] == "cdm_pin.identification/1"
    assert [p["name"] for p in written["base_parameters"]][2] == "Izz_1 + m_2*l_1^2"
    assert len(written["fit"]["holdout"]["rmse"]) == 2
    assert run_cli(folder, *runs) == 0
    assert "Identified parameters" in capsys.readouterr().out


def spoil(folder, change):
    """Write run0 with one quantity changed."""
    run = logged(CDM2, 0)
    channels = {name: x.copy() for name, x in run.channels.items()}
    change(channels)
    save_recording(Recording(run.time, channels), folder / "bad.csv")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c["motor_torque"].__imul__(-1.0), "column motor_torque_1: is opposite"),
        (lambda c: c["motor_torque"][:, 1].__imul__(-1.0), "column motor_torque_2: is opposite"),
        (lambda c: c["joint_position"].__imul__(57.3), "degrees in place of radians"),
        (lambda c: c.pop("motor_torque"), "identify needs motor_torque_i or joint_torque_i"),
    ],
    ids=["sign", "one sign", "degrees", "no torque"],
)
def test_bad_recordings_are_named(change, words, folder, capsys):
    """One line with file and column, exit status 2, no output; or the recording is skipped by name."""
    spoil(folder, change)
    assert run_cli(folder, folder / "bad.csv") == 2
    line = capsys.readouterr().err.strip()
    assert "bad.csv" in line and words in line and "\n" not in line
    assert not (folder / "out").exists()
    assert run_cli(folder, folder / "bad.csv", folder / "run1.csv", "--skip-bad", "--json") == 0
    assert words in json.loads(capsys.readouterr().out)["skipped"][0]["reason"]


def test_a_holdout_of_another_robot_is_named(folder):
    """Other joints, or the same number of joints and quite other torques."""
    save_recording(logged(spatial_arm(3, 0), 0), folder / "three.csv")
    with pytest.raises(RecordingError, match=r"three.csv.*another robot"):
        identify(CDM2, [folder / "run0.csv"], holdout=[folder / "three.csv"])
    save_recording(logged(spatial_arm(2, 5), 0), folder / "other.csv")
    with pytest.raises(RecordingError, match=r"other.csv"):
        identify(CDM2, [folder / "run0.csv"], holdout=[folder / "other.csv"])


def test_processes_change_nothing(folder):
    """The values of a run over processes are those of a run in this one."""
    runs = [folder / f"run{k}.csv" for k in range(3)]
    with processes(2) as workers:
        spread = identify(CDM2, runs, workers=workers)
    np.testing.assert_allclose(spread.fit.values, identify(CDM2, runs).fit.values, rtol=1e-9, atol=1e-12)
