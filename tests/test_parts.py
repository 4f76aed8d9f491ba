"""Without unseen recordings, parts of those at hand judge each other."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from trials import rubbed, search_of, written_trial

from cdm_pin.diagnose import diagnose
from cdm_pin.findings import held
from cdm_pin.parts import parts_of


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    """Give a robot of which nothing is missing, and two of its recordings."""
    folder = tmp_path_factory.mktemp("clean")
    options = {"effects": 0, "n_links": 2, "duration": 40.0, "positions": "joint", "bits": 17, "noise": "white"}
    model, runs, unseen, _, _ = written_trial(folder, 11, **options)
    return model, [*runs, *unseen]


def test_one_recording_confirms_itself_part_by_part(clean):
    """A law that holds throughout is named, with the error that it takes from parts fitted without them."""
    model, runs = clean
    content = diagnose(model, [rubbed(model, runs[0], 2, lambda t, v: 0.4 * v)]).content
    (finding,) = content["findings"]
    assert (finding["effect"], finding["location"]) == ("viscous_friction", {"kind": "joint", "index": 2})
    assert finding["unconfirmed"]
    assert finding["evidence"]["holdout_rmse_reduction"] is None
    assert finding["evidence"]["parts_rmse_reduction"] > 0.3


def test_a_law_that_changes_from_one_recording_to_the_next_has_no_name(clean):
    """Drag of joint 2 that is 0.4 N m s/rad in one recording and 0.6 in the other; nor has anything on it."""
    model, runs = clean
    weak = rubbed(model, runs[0], 2, lambda t, v: 0.4 * v)
    strong = rubbed(model, runs[1], 2, lambda t, v: 0.6 * v)
    content = diagnose(model, [weak, strong]).content
    assert content["verdict"] == "unexplained"
    assert content["findings"] == []
    assert content["unexplained"]["location"] == {"kind": "joint", "index": 2}


def test_a_law_that_changes_while_it_is_recorded_has_no_name(clean):
    """Drag of joint 2 that grows by half in 40 s."""
    model, runs = clean
    content = diagnose(model, [rubbed(model, runs[0], 2, lambda t, v: (0.4 + 0.006 * t) * v)]).content
    assert content["verdict"] == "unexplained"
    assert content["findings"] == []
    assert content["unexplained"]["location"] == {"kind": "joint", "index": 2}
    assert content["unexplained"]["nearest"] == [
        {"effect": "viscous_friction", "location": {"kind": "joint", "index": 2}}
    ]


def test_parts_are_all_of_a_recording(clean):
    """Four parts of one recording, each with what the others leave, by stretches where filters have rung out."""
    model, runs = clean
    search = search_of(model, runs[0])
    parts = parts_of(search)
    assert len(parts) == 4
    ends = [part.own.problem.segments[0][0] for part in parts]
    assert all(a[1] < b[0] for a, b in pairwise(ends))
    assert ends[0][0] == search.problem.segments[0][0][0]
    assert ends[-1][1] == search.problem.segments[0][0][1]
    rows = sum(b - a for a, b in ends)
    assert all(sum(b - a for a, b in part.others.problem.segments[0]) < rows for part in parts)


@pytest.mark.parametrize(
    ("effect", "still", "share"),
    [("coulomb_friction", 40, 0.4), ("joint_spring", 40, 0.0), ("load_dependent_friction", 0, 0.0)],
)
def test_friction_may_be_anything_while_a_joint_stands_still(effect, still, share):
    """Of a hundred samples: what rubs is held in those at rest, what does not never is."""
    speeds = np.r_[np.zeros(still), np.ones(100 - still)][:, None]
    motion = SimpleNamespace(joint_speeds=speeds, v_m=speeds)
    place = SimpleNamespace(along=lambda joints, motors: joints[:, 0], weights=lambda model: np.array([1.0]))
    candidate = SimpleNamespace(effect=SimpleNamespace(name=effect), place=place)

    def problem(judged):
        runs = [SimpleNamespace(motion=motion, judged=judged)]
        return SimpleNamespace(problem=SimpleNamespace(runs=runs, model=None, band=SimpleNamespace(step=1)))

    assert held(problem(None), candidate) == pytest.approx(share)
    assert held(problem(speeds.T > 0.0), candidate) == 0.0  # what is not judged spoils nothing
