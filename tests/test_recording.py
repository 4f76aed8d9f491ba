"""The Recording itself, the names of columns, and recording.yaml."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cdm_pin.columns import misspelt
from cdm_pin.errors import RecordingError, ShapeError
from cdm_pin.recording import Recording, check_widths, load_recording


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_recording_is_frozen_and_checked():
    """What the robot logged cannot be changed in place, and the caller's arrays are not touched or shared."""
    time, q = np.arange(4.0), np.zeros((4, 2))
    recording = Recording(time, {"joint_position": q})
    q[0, 0] = 1.0
    assert recording.channels["joint_position"][0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        recording.time[0] = 1.0
    assert (recording.n_samples, recording.width("joint"), recording.width("motor")) == (4, 2, None)
    with pytest.raises(ShapeError, match=r"joint_position has shape \(4,\)"):
        Recording(time, {"joint_position": q[:, 0]})
    with pytest.raises(ShapeError, match="widths disagree: joint_position has 2, joint_torque has 1"):
        Recording(time, {"joint_position": q, "joint_torque": q[:, :1]})
    with pytest.raises(ShapeError, match="unknown quantity 'q'"):
        Recording(time, {"q": q})


def test_widths_are_held_against_a_model():
    """A recording of another robot is refused in one line that says what was expected."""
    recording = Recording(np.arange(4.0), {"joint_position": np.zeros((4, 2)), "motor_torque": np.zeros((4, 3))})
    check_widths(recording, SimpleNamespace(joints=("a", "b"), motors=("a", "b", "c")))
    with pytest.raises(RecordingError, match=r"records 3 motor\(s\), the robot has 2: .*another robot"):
        check_widths(recording, SimpleNamespace(joints=("a", "b"), motors=("a", "b")))


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("joint_posiiton_1", "joint_position_1"),
        ("Joint_Position_2", "joint_position_2"),
        ("joint_position3", "joint_position_3"),
        ("joint position 1", "joint_position_1"),
        ("jointVelocity_1", "joint_velocity_1"),
        ("joint_position_0", "joint_position_1"),
        ("joint_position_01", "joint_position_1"),
        ("joint_position[1]", "joint_position_1"),
        ("joint_velocity", "joint_velocity_1"),
        ("joint_velocities_2", "joint_velocity_2"),
        ("motor_torqe_4", "motor_torque_4"),
        ("joint_pos_1", "joint_position_1"),
        ("cable_tension_uper_1", "cable_tension_upper_1"),
        ("tiem", "time"),
        ("Time", "time"),
        ("t", None),
        ("timestamp", None),
        ("q1", None),
        ("motor_current_1", None),
        ("motor_position_desired_1", None),
        ("joint_position_measured_1", None),
        ("joint_temperature_1", None),
        ("joint_torque_filtered_1", None),
        ("gravity1", None),
    ],
)
def test_misspellings(name, meant):
    """Slips of the pen and abbreviations are recognised; names of other things are not."""
    assert misspelt(name) == meant


def test_other_columns_are_noticed(tmp_path):
    """Columns that are none of ours are left out with a notice, once, by name."""
    recording = load_recording(write(tmp_path / "a.csv", "time,mode,joint_position_1,temperature\n0,x,1,2\n"))
    assert recording.notices == ("columns not used: mode, temperature",)
    assert recording.source == tmp_path / "a.csv" and recording.name == "a.csv"


def test_recording_yaml_maps_columns(tmp_path):
    """Columns by number or name, scale, offset, rate, label, pretension, payload; no header, other comment sign."""
    write(tmp_path / "x.txt", "% head\n1, 10, 5\n2, 20, 6\n")
    text = """
    file: x.txt
    header: false
    comment: "%"
    rate: 200.0
    label: slow
    pretension: 80.0
    payload: 0.105
    columns:
      motor_torque_1: {from: 2, scale: 0.35, offset: 1.0}
      joint_position: {from: [1, 3], scale: [1.0, -1.0]}
    """
    recording = load_recording(write(tmp_path / "r.yaml", text))
    assert np.array_equal(recording.time, [0, 0.005])
    assert np.allclose(recording.channels["motor_torque"], [[4.5], [8.0]])
    assert np.array_equal(recording.channels["joint_position"], [[1, -5], [2, -6]])
    assert (recording.label, recording.pretension, recording.payload) == ("slow", 80.0, 0.105)
    assert recording.source == tmp_path / "x.txt"


def test_recording_yaml_joins_npy_files(tmp_path):
    """`files` names .npy files; a matrix gives numbered columns, which may be mapped on."""
    np.save(tmp_path / "t.npy", np.arange(3.0))
    np.save(tmp_path / "d.npy", np.arange(6.0).reshape(3, 2))
    np.save(tmp_path / "bad.npy", np.array([None, 1, 2]))
    columns = "columns: {motor_position_1: {from: q_2}}"
    yaml = write(tmp_path / "r.yaml", f"files: {{time: t.npy, joint_position: d.npy, q: d.npy}}\n{columns}\n")
    recording = load_recording(yaml)
    assert np.array_equal(recording.channels["joint_position"], [[0, 1], [2, 3], [4, 5]])
    assert np.array_equal(recording.channels["motor_position"][:, 0], [1, 3, 5])
    assert recording.notices == ("columns not used: q_1",)
    with pytest.raises(RecordingError, match=r"bad\.npy: holds pickled objects: refused"):
        load_recording(write(tmp_path / "p.yaml", "files: {time: t.npy, joint_position_1: bad.npy}\n"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fil: a.csv", "unknown key 'fil'; did you mean 'file'"),
        ("label: x", "one of `file` and `files`"),
        ("file: a.csv\nfiles: {t: t.npy}", "one of `file` and `files`"),
        ("file: a.csv\nrate: -1", "rate: -1.0 where a positive rate"),
        ("file: a.csv\npayload: heavy", "payload: 'heavy' where a number"),
        ("file: a.csv\nheader: maybe", "header: 'maybe' where true or false"),
        ("file: a.csv\ncolumns: {joint_torq_1: {from: x}}", "unknown column 'joint_torq_1'; did you mean"),
        ("file: a.csv\ncolumns: {joint_torque_1: {form: x}}", "unknown key 'form'; did you mean 'from'"),
        ("file: a.csv\ncolumns: {joint_torque_1: {from: 9}}", "the file has 3 columns, not 9"),
        ("file: a.csv\ncolumns: {joint_torque_1: {from: tua}}", "no column 'tua'; did you mean 'tau'"),
        ("file: a.csv\ncolumns: {joint_torque_1: {from: tau, scale: x}}", "scale: 'x' where a number"),
        ("file: a.csv\ncolumns: {joint_torque: {from: tau}}", "a list of columns"),
        ("file: a.csv\ncolumns: {joint_torque: {from: [tau], scale: [1, 2]}}", "or 1 of them"),
        ("file: b.csv", "b.csv: no such file"),
    ],
)
def test_bad_recording_yaml_is_named(tmp_path, text, message):
    """Each fault in a recording.yaml is told in one line with the file and the key."""
    write(tmp_path / "a.csv", "time,tau,joint_position_1\n0,1,2\n")
    with pytest.raises(RecordingError) as caught:
        load_recording(write(tmp_path / "r.yaml", text))
    assert message in str(caught.value) and "\n" not in str(caught.value)
    assert str(tmp_path) in str(caught.value)


def test_real_files_load_by_yaml(tmp_path, data_dir):
    """The public recordings load as published through a recording.yaml each: text with % lines, headerless, npy."""
    psm = f"file: {data_dir}/dvrk_psm_wpi/one_results.csv.gz\nheader: false\nrate: 200\ncolumns:\n"
    for k, quantity in enumerate(("motor_position", "motor_velocity", "motor_torque")):
        psm += f"  {quantity}: {{from: {list(range(7 * k + 1, 7 * k + 8))}}}\n"
    recording = load_recording(write(tmp_path / "psm.yaml", psm))
    assert recording.channels["motor_torque"].shape == (5999, 7)
    tool = f"file: {data_dir}/davinci_tool_mrd/Tool_4_Maryland_L_2/00.TXT.gz\nheader: false\ncomment: '%'\ncolumns:\n"
    tool += "  time: 1\n  motor_position_1: {from: 2, scale: 7.66990393942e-4}\n  motor_torque_1: {from: 3}\n"
    assert load_recording(write(tmp_path / "tool.yaml", tool)).n_samples > 10_000
    wrist = ", ".join(
        f"{name}: {data_dir}/dvrk_wrist_hysteresis_berkeley/random_{file}_raw.npy"
        for name, file in (("time", "t_stamp"), ("joint_position", "q_act"), ("joint_position_desired", "q_des"))
    )
    assert load_recording(write(tmp_path / "wrist.yaml", f"files: {{{wrist}}}")).n_samples == 5600
