"""Models of real robots and the fits of their public recordings."""

from __future__ import annotations

import csv
import importlib.util
import os
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import lsq_linear

from cdm_pin.base import base_parameters
from cdm_pin.dynamics import inverse_dynamics
from cdm_pin.errors import InputError
from cdm_pin.model import load_model
from cdm_pin.recording import load_recording

ROOT = Path(__file__).resolve().parent.parent
REAL = ROOT / "urdf" / "real"
ROBOTS = ("davinci_tool", "mtm", "panda", "psm", "psm3", "psm_serial", "wam")


def _script(name: str):
    if name not in sys.modules:
        sys.path.insert(0, str(ROOT / "scripts"))
        spec = importlib.util.spec_from_file_location(name, ROOT / "scripts" / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


make_real_urdf, real_fit, real_tool = _script("make_real_urdf"), _script("real_fit"), _script("real_tool")
real_report, real_robots = _script("real_report"), _script("real_robots")


# --- models -----------------------------------------------------------------------------------------------------------


def test_tables_give_the_committed_files_byte_for_byte(tmp_path):
    """URDFs and manipulator files are what the tables of frames give, all of them and nothing else."""
    assert make_real_urdf.main(["-o", str(tmp_path)]) == 0
    written = sorted(path.name for path in tmp_path.iterdir())
    assert written == sorted(f"{name}.{suffix}" for name in ROBOTS for suffix in ("urdf", "yaml"))
    for name in written:
        assert (tmp_path / name).read_bytes() == (REAL / name).read_bytes(), name


def test_a_wrong_table_is_refused(tmp_path):
    """Unknown keys, parents and motors are named with the place they stand at."""
    table = tmp_path / "arm.yaml"
    for frame, words in (
        ("{name: a, motor: {m: 1}}", "unknown key 'motor'"),
        ("{name: a, parent: b}", "'b' is no frame above this one"),
        ("{name: a, motors: {n: 1}}", "unknown motor 'n'"),
        ("{name: a, mass: 1.0}", "key 'center_of_mass' is missing"),
    ):
        table.write_text(f"name: arm\ngravity: [0.0, 0.0, -9.81]\nmotors: [m]\nframes:\n  - {frame}\n")
        with pytest.raises(InputError, match=words):
            make_real_urdf.read_table(table)


@pytest.mark.parametrize("frame", [{"alpha": a, "theta": t} for a in (0, 90, -90, 30) for t in (0, 90, -90, 180, 50)])
def test_frames_are_modified_denavit_hartenberg(frame):
    """Pose = turn alpha about x, shift a along x, turn theta about z, shift d along z."""
    frame = frame | {"a": 0.3, "d": -0.2}
    x, z = (pin.utils.rotate(axis, np.deg2rad(frame[key])) for axis, key in (("x", "alpha"), ("z", "theta")))
    expected = pin.SE3(x, np.array([0.3, 0, 0])) * pin.SE3(z, np.array([0, 0, -0.2]))
    translation, rpy = make_real_urdf.frame_pose(frame)
    np.testing.assert_allclose(translation, expected.translation, atol=1e-14)
    np.testing.assert_allclose(pin.rpy.rpyToMatrix(*rpy), expected.rotation, atol=1e-14)


@pytest.mark.parametrize("name", ROBOTS)
def test_robots_load_and_have_base_parameters(name):
    """Every real robot builds, its motors are independent, and its base parameters are well separated."""
    model = load_model(REAL / f"{name}.yaml")
    assert np.linalg.matrix_rank(model.joint_from_motor) == model.n_motors
    base = base_parameters(model)
    assert base.rank > 0 and base.largest_dropped < 1e-10 < 1e-3 < base.smallest_kept


def _place(model, q, frame):
    data = model.pin_model.createData()
    pin.framesForwardKinematics(model.pin_model, data, model.configuration(q)[0])
    return data.oMf[model.pin_model.getFrameId(frame)].copy()


def test_psm_parallelogram_keeps_its_remote_centre():
    """The tool always points through one fixed point on the yaw axis, as in the serial chain of six joints."""
    psm, serial = load_model(REAL / "psm.yaml"), load_model(REAL / "psm_serial.yaml")
    centre = np.array([0, 0.516, 0])
    rng = np.random.default_rng(1)
    for q_m in rng.uniform([-1, -0.8, 0.05, -2, 0, 0, 0], [1, 0.8, 0.2, 2, 0, 0, 0], (10, 7)):
        tool = _place(psm, psm.joint_position(q_m)[None], "roll")
        other = _place(serial, serial.joint_position(q_m[:6])[None], "roll")
        np.testing.assert_allclose(tool.translation - centre, other.translation, atol=1e-12)
        np.testing.assert_allclose(tool.rotation[:, 2], other.rotation[:, 2], atol=1e-12)
        depth = q_m[2] - 0.4318 + 0.4162
        np.testing.assert_allclose(tool.translation, centre + depth * tool.rotation[:, 2], atol=1e-12)


def test_parallelograms_keep_their_sides_parallel():
    """Opposite sides turn alike: PSM's front and parallelogram bars, MTM's forearm and rod, whatever the motors do."""
    rng = np.random.default_rng(2)
    psm, mtm = load_model(REAL / "psm.yaml"), load_model(REAL / "mtm.yaml")
    for q_m in rng.uniform(-0.7, 0.7, (5, 7)):
        q = psm.joint_position(q_m)[None]
        front, bar = _place(psm, q, "pitch_front"), _place(psm, q, "parallelogram")
        np.testing.assert_allclose(front.rotation, bar.rotation, atol=1e-12)
        q = mtm.joint_position(q_m)[None]
        arm, rod = _place(mtm, q, "arm"), _place(mtm, q, "parallel_rod")
        np.testing.assert_allclose(arm.rotation[:, 2], rod.rotation[:, 2], atol=1e-12)
        assert abs(arm.rotation[:, 0] @ rod.rotation[:, 0]) == pytest.approx(1, abs=1e-12)


def test_panda_has_the_frames_of_example_robot_data():
    """Joint frames from the published table are those of the URDF that example-robot-data ships."""
    shared = Path(pin.__file__).parents[4] / "share" / "example-robot-data" / "robots" / "panda_description" / "urdf"
    reference = pin.buildModelFromUrdf(str(shared / "panda.urdf"))
    data = reference.createData()
    model = load_model(REAL / "panda.yaml")
    rng = np.random.default_rng(3)
    for q in rng.uniform(-1.5, 1.5, (5, 7)):
        pin.framesForwardKinematics(reference, data, np.concatenate([q, np.zeros(reference.nq - 7)]))
        for i in range(1, 8):
            expected = data.oMi[reference.getJointId(f"panda_joint{i}")]
            np.testing.assert_allclose(
                _place(model, q[None], f"panda_joint{i}").homogeneous, expected.homogeneous, atol=1e-9
            )


def test_wam_reaches_what_its_manual_says():
    """At zero the arm stands upright: 0.55 m, 0.3 m and 0.06 m above each other; the elbow is off by 45 mm."""
    model = load_model(REAL / "wam.yaml")
    upright = np.zeros((1, 7))
    np.testing.assert_allclose(_place(model, upright, "forearm").translation, [0.045, 0, 0.55], atol=1e-12)
    np.testing.assert_allclose(_place(model, upright, "palm").translation, [0, 0, 0.91], atol=1e-12)
    gravity = inverse_dynamics(model, upright, 0 * upright, 0 * upright)
    assert abs(gravity[0, 0]) < 1e-12 < abs(gravity[0, 1])


# --- fits -------------------------------------------------------------------------------------------------------------


def test_bounded_least_squares_agrees_with_an_independent_solver():
    """Elimination and NNLS give the minimiser that a bounded solver finds."""
    rng = np.random.default_rng(4)
    A, y = rng.normal(size=(40, 9)), rng.normal(size=40)
    nonnegative = np.arange(9) % 2 == 0
    x = real_fit.bounded(A.T @ A, A.T @ y, nonnegative)
    expected = lsq_linear(A, y, bounds=(np.where(nonnegative, 0, -np.inf), np.inf), tol=1e-12)
    np.testing.assert_allclose(x, expected.x, atol=1e-7)


def test_elements_slide_at_their_limit_and_cannot_make_energy():
    """A Maxwell-slip element follows, saturates at 1, ignores the rate, and never gives work back in a closed loop."""
    t = np.linspace(0, 1, 2001)
    x = np.sin(2 * np.pi * 3 * t)
    z = real_fit.stop(x, 0.2)
    assert np.abs(z).max() == 1.0 and z[0] == 0
    np.testing.assert_allclose(real_fit.stop(x[::2].copy(), 0.2), z[::2], atol=0.02)
    loop = slice(667, 2001)
    assert np.sum(z[loop] * np.gradient(x)[loop]) > 0


def test_play_keeps_its_value_inside_its_bounds():
    """The play moves only when a bound reaches it; a share of the width gives what lies between drive and load."""
    np.testing.assert_allclose(
        real_tool.play(np.array([0, 1, 2, 1, -2.0]), np.array([1, 2, 3, 2, -1.0]), 0.5), [0.5, 1, 2, 2, -1]
    )
    t = np.arange(0, 20, 0.01)
    drive = 0.05 + 0.06 * np.sin(t)
    run = real_tool.Stroke(t, 0.5 - 0.5 * np.sin(t), drive, t, t, t > 1)
    p = np.array([0.03, 1.4, 0.0, -0.03, 0.8, 0.0])
    half, full = np.ptp(real_tool.tension(run, p, 0.5)[500:]), np.ptp(real_tool.tension(run, p)[500:])
    assert full < half < np.ptp(real_tool.tension(run, p, 0.0)[500:])


def test_a_known_transmission_is_found_again():
    """From a simulated tool with a play and compliance, the fit recovers the play and predicts what it has not seen."""
    rng = np.random.default_rng(5)
    p = np.array([0.03, 1.4, -0.012, -0.058, 0.68, -0.01])
    t = np.arange(0, 20, 0.01)
    runs = {}
    for k, load in enumerate((0.03, 0.06, 0.09, 0.12)):
        q = np.deg2rad(30 + 30 * np.cos(2 * np.pi * 0.1 * t))
        x = load + 0.01 * np.sin(2 * np.pi * 0.1 * t)
        z, closing = (q - np.deg2rad(30)) / np.deg2rad(30), np.sin(2 * np.pi * 0.1 * t) > 0
        drive = np.where(closing, p[0] + p[1] * x + p[2] * z, p[3] + p[4] * x + p[5] * z)
        run = real_tool.Stroke(t, q, drive + 1e-4 * rng.normal(size=len(t)), t, x, t > 2)
        arrived = real_tool.tension(run, p)
        jaw = 1.2 - 0.9 * q - 0.4 * arrived - 0.3 * real_tool.tension(run, p, 0.5)
        runs[str(k)] = real_tool.Stroke(t, q, run.drive, jaw, arrived, t > 2)
    errors = real_tool.transfer(runs, ["0", "3"])
    assert max(angle for angle, _ in errors.values()) < 0.1
    assert max(torque for _, torque in errors.values()) < 1.0


def test_report_writes_tables_and_the_readmes_part(tmp_path):
    """Markdown, CSV and the README's marked part hold the same figures; a README without marks is left alone."""
    rows = (
        real_report.Row("arm", "a -> b", "published, full model", (0.2, 0.3)),
        real_report.Row("arm", "a -> b", "treated, all", (0.1, 0.25)),
        real_report.Row("arm", "a -> b", "+ hysteresis", (0.05, 0.125)),
    )
    chapter = real_report.Chapter("An arm", "Words.", ("m1", "m2"), rows)
    assert "| a -> b | + hysteresis | 0.05 | 0.125 |" in real_report.document([chapter])
    lines = list(csv.DictReader(real_report.csv_text([chapter]).splitlines()))
    assert len(lines) == 6 and lines[-1]["error"] == "0.125" and lines[2]["model"] == "treated; all"
    readme = tmp_path / "README.md"
    readme.write_text("before\n<!-- real robots -->\nold\n<!-- end -->\nafter\n")
    assert real_report.write_readme([chapter], readme)
    text = readme.read_text()
    assert "old" not in text and text.startswith("before") and text.endswith("after\n")
    assert "published" in text and "hysteresis" in text and "treated" not in text
    readme.write_text("nothing here\n")
    assert not real_report.write_readme([chapter], readme) and readme.read_text() == "nothing here\n"


def test_unknown_robots_and_missing_recordings_are_one_line(tmp_path, monkeypatch, capsys):
    """The script says what it knows and how to get the recordings."""
    assert real_robots.main(["psn"]) == 2
    assert "known: psm, mtm" in capsys.readouterr().err
    monkeypatch.setenv("CDM_PIN_DATA", str(tmp_path))
    assert real_robots.main(["psm"]) == 2
    assert "scripts/get_data.py" in capsys.readouterr().err


# --- public recordings ------------------------------------------------------------------------------------------------

PUBLISHED = {
    "psm": (0.093, 0.178, 0.191, 0.134, 0.239, 0.213, 0.264),
    "mtm": (0.077, 0.149, 0.170, 0.223, 0.280, 0.234, 0.340),
}


@pytest.fixture(scope="module")
def psm_rows(data_dir):
    """Give the rows of the patient-side manipulator, by (case, step)."""
    return {(row.case, row.step): np.array(row.errors) for row in real_robots.psm(data_dir).rows}


def test_psm_published_figures_are_reproduced(psm_rows):
    """With the published structure, filter, window and trimming every error is within 5 % of the published one."""
    found = psm_rows["one -> two", "published structure and treatment, reproduced"]
    np.testing.assert_allclose(found, PUBLISHED["psm"], rtol=0.05)


def test_psm_signal_treatment_alone_beats_the_published_figures(psm_rows):
    """Separate bands for accelerations and lightly filtered friction columns lower every error."""
    treated = psm_rows["one -> two", "published structure, signals treated"]
    assert np.all(treated < PUBLISHED["psm"]) and np.all(treated[:3] < 0.9 * np.array(PUBLISHED["psm"][:3]))


def test_psm_is_identified_below_the_published_figures(psm_rows):
    """`identify` gets the published structure by name and nothing else: below every figure in the band it chooses."""
    found = psm_rows["one -> two", "`cdm-pin identify`, published structure"]
    assert np.all(found < PUBLISHED["psm"])
    published_band = psm_rows["one -> two", "`cdm-pin identify`, published structure, published band"]
    assert np.all(published_band < 1.1 * np.array(PUBLISHED["psm"]))


def test_psm_named_physics_helps_whichever_trajectory_is_fitted(psm_rows):
    """Hysteresis lowers all of motors 1, 2, 5, 6, 7 both ways; the two effects on motor 2 lower motor 2 both ways."""
    for case in ("one -> two", "two -> one"):
        treated = psm_rows[case, "published structure, signals treated"]
        slip = psm_rows[case, "+ hysteresis at the fingers"]
        torque = psm_rows[case, "+ position-dependent torque, motor 2"]
        friction = psm_rows[case, "+ position-dependent friction, motor 2"]
        others = [0, 1, 4, 5, 6]
        assert np.all(slip[others] < treated[others])
        assert torque[1] < slip[1] and friction[1] < torque[1]
    final = psm_rows["one -> two", "+ position-dependent friction, motor 2"]
    assert np.all(final <= [0.045, 0.075, 0.15, 0.10, 0.10, 0.10, 0.16])


def test_tool_output_side_is_told_from_its_input_side(data_dir):
    """Jaw angle and output torque of files that were not fitted, all strokes, below the published errors."""
    rows = {row.case: row.errors for row in real_robots.tool(data_dir).rows}
    assert rows["L_4: 00, 04, 09 -> the other 7"] <= (0.31, 3.8)
    assert np.all(np.array(rows["L_4: 00, 04, 09 -> the other 7"]) < [0.31, 3.8])
    assert np.all(np.array(rows["L_2: 00, 21, 43 -> the other 17"]) < [0.28, 2.42])


def test_committed_figures_are_those_the_script_gives(psm_rows):
    """docs/real_robots.csv was written by the script as it stands."""
    with (ROOT / "docs" / "real_robots.csv").open() as handle:
        kept = [row for row in csv.DictReader(handle) if row["robot"] == "psm"]
    assert len(kept) == 7 * len(psm_rows)
    for row in kept:
        case = next(key for key in psm_rows if key[0] == row["case"] and key[1].replace(",", ";") == row["model"])
        assert float(row["error"]) == pytest.approx(psm_rows[case][int(row["column"][1:]) - 1], rel=0.02)


@pytest.mark.parametrize(
    ("layout", "robot"),
    [
        ("dvrk_psm_wpi", "psm"),
        ("dvrk_mtm_wpi", "mtm"),
        ("dvrk_psm_3dof_gondokaryono", "psm3"),
        ("franka_panda_gaz", "panda"),
        ("wam_2dof_noohian", "wam"),
        ("davinci_tool_mrd", "davinci_tool"),
        ("dvrk_wrist_hysteresis_berkeley", "psm_serial"),
    ],
)
def test_mappings_read_the_files_as_published(layout, robot, data_dir, tmp_path):
    """Each recording.yaml reads its file, from where get_data.py puts it, with the widths of its robot."""
    text = (REAL / "recordings" / f"{layout}.yaml").read_text()
    mapping = tmp_path / "a" / "b" / "c" / "recording.yaml"
    mapping.parent.mkdir(parents=True)
    mapping.write_text(text)
    (tmp_path / "data").symlink_to(os.path.abspath(data_dir))
    recording = load_recording(mapping, load_model(REAL / f"{robot}.yaml"))
    assert recording.n_samples > 1000
    assert {"motor_position", "joint_position"} & set(recording.channels)
