"""scripts/blind_trial.py: the diagnosing side sees no truth, the seal holds, and a plain fault is found."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from cdm_pin.errors import InputError

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("blind_trial", ROOT / "scripts" / "blind_trial.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["blind_trial"] = module
    spec.loader.exec_module(module)
    return module


def test_a_plain_fault_is_found_blind(script, tmp_path, capsys):
    """Three processes: dry friction concealed by the plant is named and placed from the published files alone."""
    settings = {"effects": ["coulomb_friction"], "n_links": 2, "positions": "joint", "duration": 25.0, "bits": 17}
    result = script.trial(tmp_path, 4, settings)
    assert result.first_right and result.meetings[0] in ("exact", "class")
    published = sorted(path.name for path in (tmp_path / "published").iterdir())
    assert published == ["holdout_1.csv", "manipulator.yaml", "run_1.csv", "truth.sha256"]
    assert json.loads((tmp_path / "score.json").read_text())["first_right"]


def test_what_is_published_tells_nothing(script, tmp_path):
    """Files are whole and plain, masses are wrong by up to 10 %, and the same seed has another hash each time."""
    settings = {"effects": 1, "n_links": 3, "duration": 3.0, "motion": "prescribed"}
    hashes, truths = [], []
    for name in ("one", "two"):
        script.conceal(tmp_path / name, 7, settings)
        hashes.append((tmp_path / name / "published" / "truth.sha256").read_text())
        truths.append(script.open_seal(tmp_path / name)["truth"])
    assert hashes[0] != hashes[1] and truths[0] == truths[1]
    content = yaml.safe_load((tmp_path / "one" / "published" / "manipulator.yaml").read_text())
    told, true = (np.array([link["mass"] for link in links]) for links in (content["links"], truths[0]["links"]))
    assert (0 < np.abs(told / true - 1)).all() and (np.abs(told / true - 1) < 0.6).all()
    assert truths[0]["effects"][0]["effect"] not in (tmp_path / "one" / "published" / "manipulator.yaml").read_text()


def test_a_broken_seal_is_said(script, tmp_path):
    """A truth changed after its hash was published is refused."""
    script.conceal(tmp_path, 7, {"effects": 1, "n_links": 2, "duration": 3.0, "motion": "prescribed"})
    sealed = tmp_path / "sealed" / "truth.json"
    sealed.write_text(sealed.read_text().replace('"seed": 7', '"seed": 8'))
    with pytest.raises(InputError, match="not what was sealed"):
        script.open_seal(tmp_path)


def test_seeds_come_from_commits(script):
    """A commit hash fixes its seeds, each another."""
    seeds = [script.seed_from_commit("635ddbe", k) for k in range(5)]
    assert len(set(seeds)) == 5 and seeds[0] == script.seed_from_commit("635ddbe")
