"""Reading and writing of recording files, format by format, and the words for damaged ones."""

from __future__ import annotations

import gzip
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from cdm_pin.errors import RecordingError
from cdm_pin.recording import Recording, load_recording, save_recording

FORMATS = (".csv", ".csv.gz", ".parquet", ".npz", ".mat", ".npz.gz", ".mat.gz")


def make_recording(n: int = 50, seed: int = 0) -> Recording:
    rng = np.random.default_rng(seed)
    channels = {"joint_position": rng.normal(size=(n, 3)), "motor_torque": 1e-7 * rng.normal(size=(n, 2))}
    return Recording(np.cumsum(rng.uniform(1e-3, 2e-3, n)), channels, label="slow", pretension=80.0, payload=0.105)


def write(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def refused(path: Path, *words: str) -> None:
    """Check that loading fails in one line that names the file and holds all words."""
    with pytest.raises(RecordingError) as caught:
        load_recording(path)
    message = str(caught.value)
    assert path.name in message and "\n" not in message
    for word in words:
        assert word in message, message


@pytest.mark.parametrize("suffix", FORMATS)
def test_round_trip_is_exact(tmp_path, suffix):
    """What is saved comes back bit for bit, in every format; the facts too, where the format has a place for them."""
    recording = make_recording()
    save_recording(recording, tmp_path / f"a{suffix}")
    back = load_recording(tmp_path / f"a{suffix}")
    assert np.array_equal(back.time, recording.time)
    assert list(back.channels) == list(recording.channels)
    for name, x in recording.channels.items():
        assert np.array_equal(back.channels[name], x)
    if ".csv" not in suffix:
        assert (back.label, back.pretension, back.payload) == ("slow", 80.0, 0.105)
    assert not list(tmp_path.glob(".*"))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=20))
def test_csv_keeps_every_float(tmp_path_factory, values):
    """Any finite double survives CSV, subnormal or huge."""
    path = tmp_path_factory.mktemp("csv") / "a.csv"
    save_recording(Recording(np.arange(len(values)), {"joint_torque": np.array(values)[:, None]}), path)
    assert np.array_equal(load_recording(path).channels["joint_torque"][:, 0], values)


@pytest.mark.parametrize(
    "text",
    [
        "time,joint_position_1\n0,1.5\n1,2.5\n",
        "time,joint_position_1\r\n0,1.5\r\n1,2.5\r\n",
        "time,joint_position_1\r0,1.5\r1,2.5",
        "\ufefftime;joint_position_1\n0;1.5\n1;2.5\n",
        "time;joint_position_1\n0,0;1,5\n1,0;2,5\n",
        "time\tjoint_position_1\n0\t1.5\n1\t2.5\n\n\n",
        "  time   joint_position_1\n 0   1.5\n 1\t2.5 \n",
        '# made by a robot\n"time","joint_position_1"\n0, 1.5\n# pause, here\n1 ,2.5\n',
        "time,comment,joint_position_1,\n0,started,1.5,\n1,nan,2.5,\n",
    ],
)
def test_dialects_of_text_read_alike(tmp_path, text):
    """Line ends, byte-order mark, delimiters, decimal commas, comments, text in other columns: the same numbers."""
    recording = load_recording(write(tmp_path / "a.csv", text))
    assert np.array_equal(recording.time, [0, 1])
    assert np.array_equal(recording.channels["joint_position"][:, 0], [1.5, 2.5])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ("is empty",)),
        (" \n\n", ("is empty",)),
        ("# only this\n", ("only comments",)),
        ("time,joint_position_1\n", ("no rows",)),
        ("0,1\n1,2\n", ("header was expected", "line 1")),
        ("time,joint_position_1\n0,1\n1,nan\n", ("row 2 (line 3)", "joint_position_1", "nan")),
        ("time,joint_position_1\n\n0,1\n# x\n1,-inf\n", ("row 2 (line 5)", "joint_position_1", "inf")),
        ("time,joint_position_1\n0,1\n1,abc\n", ("row 2 (line 3)", "joint_position_1", "'abc'")),
        ("time,joint_position_1\n0,1\n1,\n", ("row 2 (line 3)", "joint_position_1", "empty cell")),
        ("time,joint_position_1\n0,1\n1\n", ("row 2 (line 3)", "1 cells", "2 columns")),
        ("time,joint_position_1\n0,1\n1,1_0\n", ("row 2 (line 3)", "'1_0'")),
        ("time,joint_position_1\n0,1\n2,1\n1,1\n", ("row 3 (line 4)", "backwards", "column time")),
        ("time,joint_position_1,joint_position_1\n0,1,1\n", ("twice", "joint_position_1")),
        ("time,time,joint_position_1\n0,1,1\n", ("twice", "column time")),
        ("t,joint_position_1\n0,1\n", ("'time' is missing", "found t")),
        ("time,q1\n0,1\n", ("none of the known quantities", "found q1")),
        ("time,joint_position_1,joint_position_3\n0,1,1\n", ("joint_position_2 is missing",)),
        ("time,joint_position_1,joint_torque_1,joint_torque_2\n0,1,1,1\n", ("joint_position has 1", "joint_torque")),
        ("time,joint_posiiton_1\n0,1\n", ("'joint_posiiton_1'", "did you mean 'joint_position_1'")),
        (b"\xff\xfet\x00i\x00m\x00e\x00", ("not UTF-8",)),
    ],
)
def test_bad_text_is_named(tmp_path, text, words):
    """Each fault in a text file is told with file, row, line and column."""
    refused(write(tmp_path / "run.csv", text), *words)


@pytest.mark.parametrize("suffix", [".csv.gz", ".parquet", ".npz", ".mat", ".mat.gz"])
def test_truncated_files_are_named(tmp_path, suffix):
    """A file cut short anywhere is refused in one line, never read in part."""
    path = tmp_path / f"a{suffix}"
    save_recording(make_recording(), path)
    data = path.read_bytes()
    for share in (0.3, 0.9, 0.999):
        path.write_bytes(data[: int(share * len(data))])
        refused(path, "truncated" if suffix != ".csv.gz" else "truncated gzip")


def test_other_bad_files_are_named(tmp_path):
    """No file, a folder, an unknown suffix, a false .gz, damaged gzip, wrong content: each in words."""
    refused(tmp_path / "missing.csv", "no such file")
    (tmp_path / "folder.csv").mkdir()
    refused(tmp_path / "folder.csv", "folder")
    refused(write(tmp_path / "a.xlsx", "x"), "'.xlsx'", ".parquet")
    refused(write(tmp_path / "a.csv.gz", "time,joint_position_1\n0,1\n"), "not gzip")
    damaged = bytearray(gzip.compress(b"time,joint_position_1\n" + b"0,1\n" * 100))
    damaged[20] ^= 0xFF
    refused(write(tmp_path / "b.csv.gz", bytes(damaged)), "gzip")
    refused(write(tmp_path / "a.parquet", "time,joint_position_1\n0,1\n"), "Parquet")
    refused(write(tmp_path / "a.bag", "nonsense"), "bag")
    with pytest.raises(RecordingError, match=r"cannot write suffix '\.bag'"):
        save_recording(make_recording(), tmp_path / "out.bag")


def test_pickles_are_refused(tmp_path):
    """An npz that would run code when read is refused, and says why."""
    np.savez(tmp_path / "a.npz", time=np.arange(3.0), joint_position=np.array([None, 1, 2]))
    refused(tmp_path / "a.npz", "pickled", "refused")


def test_matrices_and_matlab_vectors(tmp_path):
    """Arrays (n, w) under the quantity's name, and MATLAB's one-column matrices, are both understood."""
    t, q = np.arange(5.0), np.arange(10.0).reshape(5, 2)
    scipy.io.savemat(tmp_path / "a.mat", {"time": t[None, :], "joint_position": q, "motor_torque_1": t[:, None]})
    recording = load_recording(tmp_path / "a.mat")
    assert np.array_equal(recording.channels["joint_position"], q)
    assert np.array_equal(recording.channels["motor_torque"], t[:, None])
    np.savez(tmp_path / "b.npz", time=t, joint_position=q[:4])
    refused(tmp_path / "b.npz", "joint_position_1 has 4 rows", "time has 5")


def test_matlab_7_3(tmp_path, monkeypatch):
    """MATLAB 7.3 files are read where h5py is there; where it is not, the message says what to do."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file["time"] = np.arange(5.0)[None, :]
        file["joint_position"] = np.arange(10.0).reshape(5, 2).T
    assert np.array_equal(load_recording(tmp_path / "a.mat").channels["joint_position"][4], [8, 9])
    monkeypatch.setitem(sys.modules, "h5py", None)
    refused(tmp_path / "a.mat", "MATLAB 7.3", "'-v7'", "h5py")


JOINT_STATE = "sensor_msgs/msg/JointState"


def write_bag(path: Path, positions: np.ndarray, efforts: np.ndarray, names=("b", "a"), stamps=None, topics=("/j",)):
    """Write JointState messages 5 ms apart, names alternating in order, as the kind of bag the suffix says."""
    ros1 = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    types = store.types
    plugin = StoragePlugin.SQLITE3 if path.suffix == ".db3" else StoragePlugin.MCAP
    folder = path if ros1 else path.with_suffix("")
    with Writer1(path) if ros1 else Writer2(folder, version=8, storage_plugin=plugin) as writer:
        for topic in topics:
            connection = writer.add_connection(topic, JOINT_STATE, typestore=store)
            for k, (q, tau) in enumerate(zip(positions, efforts, strict=True)):
                stamp = 1_700_000_000_000_000_000 + k * 5_000_000 if stamps is None else stamps[k]
                time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
                extra = {"seq": k} if ros1 else {}
                header = types["std_msgs/msg/Header"](stamp=time, frame_id="", **extra)
                turn = 1 if k % 2 == 0 else -1
                message = types[JOINT_STATE](
                    header, list(names)[::turn], q[::turn].copy(), np.array([]), tau[::turn].copy()
                )
                data = store.serialize_ros1 if ros1 else store.serialize_cdr
                writer.write(connection, 1000 + k, data(message, JOINT_STATE))
    return path if ros1 else next(folder.glob(f"*{path.suffix}"))


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
def test_bags(tmp_path, suffix):
    """JointState of ROS 1, MCAP and sqlite: exact values, by name whatever the order in each message."""
    rng = np.random.default_rng(1)
    q, tau = rng.normal(size=(20, 2)), rng.normal(size=(20, 2))
    path = write_bag(tmp_path / f"run{suffix}", q, tau)
    for place in {path, path.parent if suffix != ".bag" else path}:
        recording = load_recording(place)
        assert np.array_equal(recording.channels["joint_position"], q)
        assert np.array_equal(recording.channels["joint_torque"], tau)
        assert np.allclose(recording.time, 0.005 * np.arange(20), rtol=0, atol=1e-12)
        assert any("joints 1 to 2 are b, a" in notice for notice in recording.notices)
    by_model = load_recording(path, SimpleNamespace(joints=("a", "b"), motors=("a", "b")))
    assert np.array_equal(by_model.channels["joint_position"], q[:, ::-1])
    split = load_recording(path, SimpleNamespace(joints=("a",), motors=("b",)))
    assert np.array_equal(split.channels["motor_torque"], tau[:, :1])
    yaml = write(tmp_path / "r.yaml", f"file: {path.relative_to(tmp_path)}\njoints: [b]\nmotors: [a]\ntopic: /j\n")
    assert np.array_equal(load_recording(yaml).channels["motor_position"], q[:, 1:])
    columns = "{motor_torque_1: {from: a.effort, scale: 2}, joint_position_1: b.position}"
    yaml = write(tmp_path / "m.yaml", f"file: {path.relative_to(tmp_path)}\ncolumns: {columns}\n")
    assert np.array_equal(load_recording(yaml).channels["motor_torque"], 2 * tau[:, 1:])
    data = path.read_bytes()
    refused(write(tmp_path / f"cut{suffix}", data[: int(0.6 * len(data))]), "bag", "truncated")
    zipped = write(tmp_path / f"z{suffix}.gz", gzip.compress(data))
    assert np.array_equal(load_recording(zipped).channels["joint_position"], q)


def test_bad_bags_are_named(tmp_path):
    """Several topics, unknown names, stamps that run backwards, no messages: each in words."""
    q = np.zeros((3, 2))
    two = write_bag(tmp_path / "two.bag", q, q, topics=("/j", "/k"))
    refused(two, "/j, /k", "topic")
    yaml = write(tmp_path / "t.yaml", "file: two.bag\ntopic: /l\n")
    with pytest.raises(RecordingError, match=r"two\.bag: has no JointState on topic '/l'"):
        load_recording(yaml)
    yaml = write(tmp_path / "n.yaml", "file: two.bag\ntopic: /j\njoints: [aa]\n")
    with pytest.raises(RecordingError, match=r"two\.bag: no joint 'aa' in the messages .*did you mean 'a'"):
        load_recording(yaml)
    back = write_bag(tmp_path / "back.bag", q, q, stamps=[10**9, 3 * 10**9, 2 * 10**9])
    refused(back, "message 3", "backwards")
    refused(write_bag(tmp_path / "none.bag", q[:0], q[:0]), "no sensor_msgs")
    robot = SimpleNamespace(joints=("x", "y", "z"), motors=("x", "y", "z"))
    with pytest.raises(RecordingError, match=r"records 2 joint\(s\), the robot has 3"):
        load_recording(write_bag(tmp_path / "one.bag", q, q), robot)
