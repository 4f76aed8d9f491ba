"""The command line: files in, files out, and for bad input one line, status 2 and nothing written."""

import json
import subprocess
import sys

import numpy as np
import pytest
import yaml
from arms import ROOT, planar_content, relative, states

from cdm_pin.cli import COMMANDS, main
from cdm_pin.dynamics import motor_torques
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.model import build_model, load_model
from cdm_pin.recording import Recording, load_recording, save_recording
from cdm_pin.torques import recorded_torques

PAPER_FILE = ROOT / "urdf" / "cdm2.yaml"
PAPER = load_model(PAPER_FILE)


@pytest.fixture
def swing(tmp_path):
    """Record positions of the paper's joints at 100 Hz; give the exact motion behind it as well."""
    t = np.arange(400) / 100
    w = np.array([2.0, 3.0])
    q = 0.4 * np.sin(w * t[:, None])
    v, a = 0.4 * w * np.cos(w * t[:, None]), -0.4 * w * w * np.sin(w * t[:, None])
    path = tmp_path / "swing.csv"
    save_recording(Recording(t, {"joint_position": q}), path)
    return path, t, q, v, a


def listed(folder):
    return sorted(path.relative_to(folder) for path in folder.rglob("*"))


def test_urdf(tmp_path, capsys):
    """`cdm-pin urdf` writes the committed file."""
    out = tmp_path / "arm.urdf"
    assert main(["urdf", str(PAPER_FILE), "-o", str(out)]) == 0
    assert out.read_text() == (ROOT / "urdf" / "cdm2.urdf").read_text()
    printed = capsys.readouterr()
    assert "124.6" in printed.out and printed.err == ""


def test_urdf_says_the_same_as_json(tmp_path, capsys):
    """With --json a program reads limits and how well the file reads back."""
    assert main(["urdf", str(PAPER_FILE), "-o", str(tmp_path / "a.urdf"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert [joint["joint"] for joint in said["joints"]] == ["joint_1", "joint_2"]
    assert np.degrees(said["joints"][1]["upper"]) == pytest.approx(124.554, abs=1e-3)
    assert max(said["read_back"].values()) < 1e-9


def test_torque_of_positions_alone(swing, tmp_path, capsys):
    """One row per input row, no trimming; differentiated positions give the torques of the exact motion."""
    path, t, q, v, a = swing
    out = tmp_path / "out.csv"
    assert main(["torque", str(PAPER_FILE), str(path), "-o", str(out)]) == 0
    assert out.read_text().splitlines()[0] == "time,motor_torque_1,motor_torque_2"
    found = load_recording(out, PAPER)
    np.testing.assert_array_equal(found.time, t)
    assert list(found.channels) == ["motor_torque"]
    assert relative(found.channels["motor_torque"], motor_torques(PAPER, q, v, a)) < 1e-5
    assert capsys.readouterr().err == ""


def test_torque_takes_rates_as_given(swing, tmp_path):
    """Velocities and accelerations in the file are used as they are."""
    _, t, q, v, a = swing
    path, out = tmp_path / "full.csv", tmp_path / "out.csv"
    channels = {"joint_position": q, "joint_velocity": v, "joint_acceleration": a}
    save_recording(Recording(t, channels), path)
    assert main(["torque", str(PAPER_FILE), str(path), "-o", str(out), "--quiet"]) == 0
    np.testing.assert_array_equal(load_recording(out).channels["motor_torque"], motor_torques(PAPER, q, v, a))


def test_torque_from_motor_positions(swing, tmp_path):
    """Only motor positions: the joints follow by E, rotors included."""
    _, t, q, v, a = swing
    model = build_model(parse_manipulator(planar_content(2, 9)))
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(planar_content(2, 9)))
    B = model.motor_from_joint.T
    channels = {"motor_position": q @ B, "motor_velocity": v @ B, "motor_acceleration": a @ B}
    path, out = tmp_path / "motor.npz", tmp_path / "out.parquet"
    save_recording(Recording(t, channels), path)
    assert main(["torque", str(tmp_path / "arm.yaml"), str(path), "-o", str(out), "--quiet"]) == 0
    assert relative(load_recording(out).channels["motor_torque"], motor_torques(model, q, v, a)) < 1e-10


def test_both_positions_each_drive_their_own(swing):
    """The joint side moves the links, the motor side the rotors."""
    _, t, q, v, a = swing
    model = build_model(parse_manipulator(planar_content(2, 9)))
    channels = {"joint_position": q, "joint_velocity": v, "joint_acceleration": a}
    a_m = np.ones_like(a)
    channels |= {"motor_position": q, "motor_velocity": v, "motor_acceleration": a_m}
    result = recorded_torques(model, Recording(t, channels))
    np.testing.assert_allclose(result.tau_m, motor_torques(model, q, v, a, a_m), rtol=1e-12)


def test_torque_warns_of_slack_and_wrap(tmp_path, capsys):
    """A side that would go slack and a joint past its wrap are said on standard error; the file is still written."""
    q, v, a = states(PAPER, 50, 0)
    q[0, 0] = 2.3
    path, out = tmp_path / "wild.csv", tmp_path / "out.csv"
    channels = {"joint_position": q, "joint_velocity": v, "joint_acceleration": a}
    save_recording(Recording(np.arange(50) / 100, channels), path)
    assert main(["torque", str(PAPER_FILE), str(path), "-o", str(out)]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "joint 1: past its wrap limit in 1 of 50 samples" in said
    assert "side: would go slack" in said
    assert out.exists()
    assert main(["torque", str(PAPER_FILE), str(path), "-o", str(out), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_torque_compares_with_recorded_torques(swing, tmp_path, capsys):
    """Where the recording has motor torques the difference is shown."""
    _, t, q, v, a = swing
    path = tmp_path / "full.csv"
    tau_m = motor_torques(PAPER, q, v, a)
    channels = {"joint_position": q, "joint_velocity": v, "joint_acceleration": a, "motor_torque": tau_m + 0.5}
    save_recording(Recording(t, channels), path)
    assert main(["torque", str(PAPER_FILE), str(path), "-o", str(tmp_path / "out.csv"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert [motor["difference_rms"] for motor in said["motors"]] == pytest.approx([0.5, 0.5])


ARM = yaml.safe_load(PAPER_FILE.read_text())


def arm(**changes):
    """Write the paper's file with some entries of `links[0]` (l_) or the pulleys (p_) changed."""
    content = yaml.safe_load(yaml.safe_dump(ARM))
    for key, value in changes.items():
        place = content["links"][0] if key.startswith("l_") else content["pulleys"]
        place[key[2:]] = value
    return yaml.safe_dump(content)


ROBOT = "urdf: robot.urdf\ntransmission: {joints: [joint_1, joint_2], joint_from_motor: %s}\n"


def recording(names):
    """Write three rows of zeros under these columns."""
    rows = [",".join(["time", *names])] + [",".join([t] + ["0"] * len(names)) for t in ("0", "0.01", "0.02")]
    return "\n".join(rows) + "\n"


GOOD = recording(["joint_position_1", "joint_position_2"])

BAD_FILES = {
    "no root of eq. (1)": (arm(p_joint_pulley_radius=0.2), "eq. (1) has no root"),
    "cable cannot reach": (arm(p_link_pulley_offset=0.13), "the cable cannot reach"),
    "d_j0 past the link": (arm(p_link_pulley_distance=0.61), "longer than link 'link_1'"),
    "negative mass": (arm(l_mass=-1.0), "links[1].mass: must be above 0"),
    "zero mass": (arm(l_mass=0.0), "links[1].mass: must be above 0"),
    "zero radius": (arm(p_motor_pulley_radius=0.0), "pulleys.motor_pulley_radius: must be above 0"),
    "negative radius": (arm(p_link_pulley_radius=-0.02), "pulleys.link_pulley_radius: must be above 0"),
    "zero length": (arm(l_length=0.0), "links[1].length: must be above 0"),
    "negative length": (arm(l_length=-0.6), "links[1].length: must be above 0"),
    "triangle inequality": (arm(l_inertia=[0.01, 0.02, 0.06]), "breaks the triangle inequality"),
    "unknown key": (arm(l_lenght=0.6), "unknown key 'lenght'; did you mean 'length'?"),
    "duplicate key": (arm() + "name: twice\n", "key 'name' is given twice"),
    "no YAML": ("links: [", "is not valid YAML"),
    "singular E": (ROBOT % "[[1, 1], [1, 1]]", "singular"),
    "unreadable URDF": (ROBOT % "[[1, 0], [0, 1]]", "column 21: is not XML"),
}


@pytest.mark.parametrize("command", ["urdf", "torque"])
@pytest.mark.parametrize(("text", "words"), BAD_FILES.values(), ids=BAD_FILES)
def test_bad_manipulators(tmp_path, capfd, command, text, words):
    """Each defect of a manipulator file: one line that names the file, status 2, nothing written."""
    if command == "urdf" and text == BAD_FILES["unreadable URDF"][0]:
        words = "is given by a URDF already"
    (tmp_path / "robot.yaml").write_text(text)
    (tmp_path / "robot.urdf").write_text("<robot name='broken'>")
    (tmp_path / "recording.csv").write_text(GOOD)
    before = listed(tmp_path)
    arguments = [str(tmp_path / "robot.yaml")] + [str(tmp_path / "recording.csv")] * (command == "torque")
    assert main([command, *arguments, "-o", str(tmp_path / "out.csv")]) == 2
    said = capfd.readouterr()
    lines = said.err.splitlines()
    assert said.out == "" and len(lines) == 1
    assert lines[0].startswith(f"cdm-pin: {tmp_path}/robot.") and words in lines[0]
    assert listed(tmp_path) == before


BAD_RECORDINGS = {
    "too few columns": (recording(["joint_position_1"]), "the robot has 2"),
    "too many columns": (recording([f"joint_position_{i}" for i in (1, 2, 3)]), "the robot has 2"),
    "misspelt column": (recording(["joint_position_1", "joint_positon_2"]), "did you mean 'joint_position_2'?"),
    "no position": (recording(["motor_torque_1", "motor_torque_2"]), "holds no joint_position and no motor_position"),
    "ragged row": (GOOD + "0.03,0\n", "recording.csv"),
}


@pytest.mark.parametrize(("text", "words"), BAD_RECORDINGS.values(), ids=BAD_RECORDINGS)
def test_bad_recordings(tmp_path, capfd, text, words):
    """Recordings that do not fit the robot: one line that names the file, status 2, nothing written."""
    (tmp_path / "recording.csv").write_text(text)
    before = listed(tmp_path)
    assert main(["torque", str(PAPER_FILE), str(tmp_path / "recording.csv"), "-o", str(tmp_path / "out.csv")]) == 2
    said = capfd.readouterr()
    assert said.out == "" and len(said.err.splitlines()) == 1
    assert "recording.csv" in said.err and words in said.err
    assert listed(tmp_path) == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["urdf", "missing.yaml", "-o", "x.urdf"], "missing.yaml: no such file"),
        (["urdf", str(PAPER_FILE), "-o", "no/such/folder/x.urdf"], "the folder of this output file does not exist"),
        (["urdf", str(PAPER_FILE)], "required: -o/--output"),
        (["torque", str(PAPER_FILE), "x.csv", "-o", "y.csv", "--cutoff", "-1"], "--cutoff: must be above 0 Hz"),
        (["tork"], "invalid choice: 'tork'"),
    ],
)
def test_bad_arguments(tmp_path, monkeypatch, capsys, arguments, words):
    """Wrong arguments are one line and status 2 as well."""
    monkeypatch.chdir(tmp_path)
    try:
        status = main(arguments)
    except SystemExit as exc:
        status = exc.code
    said = capsys.readouterr()
    assert status == 2
    assert words in said.err and len(said.err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_help_names_every_command(capsys):
    """`cdm-pin` alone and `--help` list the commands; the version is printed."""
    assert main([]) == 0
    said = capsys.readouterr().out
    assert all(command in said for command in COMMANDS)
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip()


def test_an_internal_error_is_one_line(tmp_path, monkeypatch, capsys):
    """No traceback reaches a user unless asked for; the status is 1."""
    monkeypatch.setattr("cdm_pin.commands.urdf.generate_urdf", lambda manipulator: 1 / 0)
    arguments = ["urdf", str(PAPER_FILE), "-o", str(tmp_path / "x.urdf")]
    assert main(arguments) == 1
    said = capsys.readouterr().err
    assert said.splitlines() == ["cdm-pin: internal error: ZeroDivisionError: division by zero (--debug shows where)"]
    with pytest.raises(ZeroDivisionError):
        main([*arguments, "--debug"])


def test_generate_urdf_script(tmp_path):
    """scripts/generate_urdf.py writes the URDF beside each file given."""
    file = tmp_path / "arm.yaml"
    file.write_text(PAPER_FILE.read_text())
    script = [sys.executable, str(ROOT / "scripts" / "generate_urdf.py"), str(file)]
    subprocess.run(script, check=True, capture_output=True)
    assert (tmp_path / "arm.urdf").read_text() == (ROOT / "urdf" / "cdm2.urdf").read_text()


def test_torques_of_a_real_recording(data_dir, tmp_path):
    """A recording of a real cable-driven arm, described by a recording.yaml, gives one row of torques per row."""
    content = {"file": str(data_dir / "wam_2dof_noohian" / "state_4_gravity_4.csv.gz"), "columns": {}}
    for i, joint in ((1, 2), (2, 4)):
        content["columns"] |= {
            f"joint_position_{i}": {"from": f"q{joint}"},
            f"joint_velocity_{i}": {"from": f"dq{joint}"},
        }
    content["columns"]["time"] = {"from": "t_s"}
    (tmp_path / "recording.yaml").write_text(yaml.safe_dump(content))
    recording = load_recording(tmp_path / "recording.yaml", PAPER)
    assert recording.n_samples == 2501
    out = tmp_path / "out.csv"
    assert main(["torque", str(PAPER_FILE), str(tmp_path / "recording.yaml"), "-o", str(out), "--quiet"]) == 0
    found = load_recording(out, PAPER)
    np.testing.assert_array_equal(found.time, recording.time)
    assert np.isfinite(found.channels["motor_torque"]).all()
