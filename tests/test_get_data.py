"""scripts/get_data.py: whole and checked files, joins, recording.yaml beside them, and clear words when offline."""

from __future__ import annotations

import gzip
import hashlib
import importlib.util
import io
import json
import sys
import urllib.error
from pathlib import Path

import numpy as np
import pytest

from cdm_pin.errors import InputError
from cdm_pin.recording import load_recording

ROOT = Path(__file__).resolve().parent.parent


def _script():
    spec = importlib.util.spec_from_file_location("get_data", ROOT / "scripts" / "get_data.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["get_data"] = module
    spec.loader.exec_module(module)
    return module


get_data = _script()


def _item(content: bytes, folder="dvrk_mtm_wpi", file="one_results.csv.gz", paths=("a/one.csv",), join=""):
    digest = hashlib.sha256(content).hexdigest()
    return get_data.Item(folder, file, "owner/name", "c" * 40, paths, join, len(content), digest, {"rate": 200.0})


def _log(n=50, seed=0) -> bytes:
    rows = np.random.default_rng(seed).normal(size=(n, 21))
    return ("\n".join(",".join(f"{x:.9g}" for x in row) for row in rows) + "\n").encode()


def test_table_names_every_file_once_with_its_checksum():
    """The table's rows are complete: repository, commit, paths, size, checksum; no file twice."""
    items = get_data.read_items()
    assert len({(item.folder, item.file) for item in items}) == len(items) > 60
    for item in items:
        assert len(item.commit) == 40 and len(item.sha256) == 64 and item.size > 0 and item.paths
        assert bool(item.join) == (len(item.paths) > 1)
        assert (ROOT / "urdf" / "real" / "recordings" / f"{item.folder}.yaml").is_file()


def test_downloaded_file_is_kept_compressed_and_its_mapping_reads_it(tmp_path, monkeypatch):
    """A download lands whole under its checksum, is not fetched again, and its recording.yaml loads all channels."""
    content = _log()
    item = _item(content)
    asked = []

    def urlopen(url, timeout):
        asked.append(url)
        return io.BytesIO(content)

    monkeypatch.setattr(get_data.urllib.request, "urlopen", urlopen)
    assert get_data.obtain(item, tmp_path, get_data.from_network) == "fetched"
    assert get_data.obtain(item, tmp_path, get_data.from_network) == "kept"
    assert asked == [f"https://raw.githubusercontent.com/owner/name/{'c' * 40}/a/one.csv"]
    kept = tmp_path / "dvrk_mtm_wpi" / "one_results.csv.gz"
    assert gzip.decompress(kept.read_bytes()) == content
    recording = load_recording(get_data.write_layout(item, tmp_path))
    assert {name: x.shape for name, x in recording.channels.items()} == {
        "motor_position": (50, 7),
        "motor_velocity": (50, 7),
        "motor_torque": (50, 7),
    }
    assert recording.time[1] == pytest.approx(1 / 200) and recording.label == "one_results"


def test_wrong_content_is_refused_and_leaves_nothing(tmp_path):
    """A file with another checksum is named with what was found and expected; nothing is written."""
    item = _item(_log())
    with pytest.raises(InputError, match=r"is not the published file: 5 bytes, sha256 .* were expected"):
        get_data.obtain(item, tmp_path, lambda item, path: b"other")
    assert not list(tmp_path.rglob("*.gz"))


@pytest.mark.parametrize("name", ["one_results.csv.gz", "one_results.csv"])
def test_folder_serves_kept_files_plain_or_compressed(tmp_path, name):
    """--from takes DATA_SET/FILE with or without .gz, whatever level it was compressed with."""
    content = _log()
    source = tmp_path / "source" / "dvrk_mtm_wpi" / name
    source.parent.mkdir(parents=True)
    source.write_bytes(gzip.compress(content, 1) if name.endswith("gz") else content)
    item = _item(content)
    fetch = get_data.from_folder(tmp_path / "source")
    assert get_data.obtain(item, tmp_path / "out", fetch, tmp_path / "source") == "copied"


def test_folder_serves_clones_of_the_repositories(tmp_path):
    """--from also finds a repository's own path in a clone; a missing one is named both ways."""
    content = _log()
    item = _item(content)
    clone = tmp_path / "name" / "a"
    clone.mkdir(parents=True)
    (clone / "one.csv").write_bytes(content)
    assert get_data.obtain(item, tmp_path / "out", get_data.from_folder(tmp_path), tmp_path) == "fetched"
    with pytest.raises(InputError, match=r"has neither dvrk_mtm_wpi/one_results\.csv\.gz nor name/a/one\.csv"):
        get_data.obtain(item, tmp_path / "out2", get_data.from_folder(tmp_path / "name"), tmp_path / "name")


def test_number_columns_are_joined_sample_by_sample():
    """One number a line: time, then seven a sample for positions, velocities and torques, become a table."""
    time = "0\n0.00174391\n"
    values = ["\n".join(str(x) for x in np.arange(14) * scale) for scale in (1, 10, 100)]
    item = _item(b"", paths=("t", "q", "dq", "tau"), join="columns")
    table = get_data.joined(item, [part.encode() for part in (time, *values)]).decode().splitlines()
    assert table[0].split(",") == ["t_s", *(f"{s}{j}" for s in ("q", "dq", "tau") for j in range(1, 8))]
    rows = np.array([line.split(",") for line in table[1:]], float)
    np.testing.assert_allclose(rows[:, 0], [0, 0.00174391])
    np.testing.assert_allclose(rows[1, 1:], np.concatenate([np.arange(7, 14) * s for s in (1, 10, 100)]))


def test_json_states_are_joined_with_gravity_by_index():
    """Two lists of samples become one table with time from zero."""
    state = [{"time": 5.0 + 0.004 * k, "position": [k], "velocity": [2 * k], "effort": [3 * k]} for k in range(3)]
    gravity = [{"gravity": [4 * k]} for k in range(3)]
    item = _item(b"", paths=("s", "g"), join="json")
    table = get_data.joined(item, [json.dumps(part).encode() for part in (state, gravity)]).decode()
    assert table == "t_s,q1,dq1,tau1,gravity1\n0,0,0,0,0\n0.004,1,2,3,4\n0.008,2,4,6,8\n"


def test_offline_is_one_line_and_status_2(tmp_path, monkeypatch, capsys):
    """Without network the script says which address failed and what to do instead."""

    def urlopen(url, timeout):
        raise urllib.error.URLError("no route to host")

    monkeypatch.setattr(get_data.urllib.request, "urlopen", urlopen)
    assert get_data.main(["dvrk_mtm_wpi", "-o", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "cannot be downloaded (no route to host)" in error and "--from" in error
    assert get_data.main(["dvrk_mtm_wpy"]) == 2
    assert "did you mean 'dvrk_mtm_wpi'" in capsys.readouterr().err
    assert get_data.main(["--from", str(tmp_path / "missing")]) == 2


def test_the_public_recordings_pass_their_checksums(tmp_path, data_dir):
    """The recordings in the data folder are those of the table, joined ones too, and their mappings read them."""
    assert get_data.main(["--from", str(data_dir), "-o", str(tmp_path), "franka_panda_gaz", "wam_2dof_noohian"]) == 0
    recording = load_recording(tmp_path / "wam_2dof_noohian" / "state_4_gravity_4.yaml")
    assert recording.width("joint") == 7 and recording.n_samples == 2501
