"""Manipulator files: what is read is what is written back, and what is wrong is named with file and key."""

import copy

import numpy as np
import pytest
import yaml
from arms import FILES, ROOT, planar_content
from hypothesis import given, settings
from hypothesis import strategies as st

from cdm_pin.errors import GeometryError, ManipulatorError
from cdm_pin.files import _StrictLoader
from cdm_pin.manipulator import load_manipulator, manipulator_content, parse_manipulator, save_manipulator

PAPER = yaml.safe_load((ROOT / "urdf" / "cdm2.yaml").read_text())
URDF = {
    "urdf": "robot.urdf",
    "transmission": {"joints": ["a", "b"], "motors": ["m", "n"], "joint_from_motor": [[1.0, 0.0], [-1.0, 1.0]]},
}


def changed(content, path, value):
    """Give a deep copy with the entry at `path` set, or removed if `value` is None."""
    content = copy.deepcopy(content)
    *parents, last = path
    place = content
    for key in parents:
        place = place[key]
    if value is None:
        del place[last]
    else:
        place[last] = value
    return content


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_round_trip_of_the_committed_files(path, tmp_path):
    """Written and read again, a manipulator is the same to the last bit."""
    manipulator = load_manipulator(path)
    save_manipulator(manipulator, tmp_path / "again.yaml")
    again = load_manipulator(tmp_path / "again.yaml")
    assert manipulator_content(again) == manipulator_content(manipulator)
    for one, other in zip(manipulator.links, again.links, strict=True):
        np.testing.assert_array_equal(one.inertia, other.inertia)
        np.testing.assert_array_equal(one.origin_xyz, other.origin_xyz)


@given(st.integers(1, 8), st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_round_trip_of_random_arms(n, seed):
    """Content to manipulator to content is the identity."""
    content = planar_content(n, seed)
    again = manipulator_content(parse_manipulator(content))
    again["motors"] = [{"rotor_inertia": motor["rotor_inertia"]} for motor in again["motors"]]
    assert again == content


def test_the_papers_arm():
    """Table 1 as it stands in urdf/cdm2.yaml."""
    arm = load_manipulator(ROOT / "urdf" / "cdm2.yaml")
    assert [link.length for link in arm.links] == [0.6, 0.6]
    assert [link.mass for link in arm.links] == [2.0, 1.0]
    np.testing.assert_array_equal(arm.links[1].inertia, np.diag([0.003, 0.03, 0.03]))
    np.testing.assert_array_equal(arm.pulleys.joint_pulley_radius, [0.1, 0.1])
    assert arm.pretension == 80.0


def test_inertia_of_six_numbers_is_xx_yy_zz_xy_xz_yz():
    """The order of the file differs from the order of the standard parameters."""
    content = changed(PAPER, ("links", 0, "inertia"), [0.5, 0.6, 0.7, 0.01, 0.02, 0.03])
    expected = [[0.5, 0.01, 0.02], [0.01, 0.6, 0.03], [0.02, 0.03, 0.7]]
    np.testing.assert_array_equal(parse_manipulator(content).links[0].inertia, expected)


def test_without_a_pretension_it_is_unknown():
    """Not the same as zero: nothing can be said of slack."""
    assert parse_manipulator(changed(PAPER, ("pretension",), None)).pretension is None


def test_arrays_are_frozen():
    """What travels cannot be written into."""
    arm = parse_manipulator(PAPER)
    for array in (arm.gravity, arm.links[0].inertia, arm.pulleys.joint_pulley_radius, arm.pulleys.wrap_half_angle):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


BAD = [
    (("links", 0, "mass"), -2.0, "links[1].mass: must be above 0, found -2"),
    (("links", 1, "mass"), 0, "links[2].mass: must be above 0, found 0"),
    (("links", 0, "mass"), "2 kg", "links[1].mass: a number was expected, found '2 kg'"),
    (("links", 0, "mass"), float("nan"), "links[1].mass: a number was expected"),
    (("links", 0, "mass"), True, "links[1].mass: a number was expected"),
    (("links", 0, "mass"), None, "links[1]: key 'mass' is missing"),
    (("links", 0, "length"), 0.0, "links[1].length: must be above 0"),
    (("links", 0, "length"), None, "links[1]: key 'length' is missing"),
    (("links", 0, "inertia"), [0.01, 0.02, 0.06], "links[1].inertia: breaks the triangle inequality"),
    (("links", 0, "inertia"), [0.01, 0.06, -0.06], "links[1].inertia: not positive definite"),
    (("links", 0, "inertia"), [0.01, 0.06], "links[1].inertia: 3 or 6 numbers were expected"),
    (("links", 0, "center_of_mass"), [0.3], "links[1].center_of_mass: 3 numbers were expected, found 1"),
    (("links", 0, "axis"), [0, 0, 0], "links[1].axis: a joint axis cannot be zero"),
    (("links", 1, "name"), "link_1", "links: two links are called 'link_1'"),
    (("links", 0, "lenght"), 0.6, "links[1]: unknown key 'lenght'; did you mean 'length'?"),
    (("links",), [], "links: a list of links was expected"),
    (("pulleys", "joint_pulley_radius"), 0.0, "pulleys.joint_pulley_radius: must be above 0"),
    (("pulleys", "joint_pulley_radius"), [0.1], "pulleys.joint_pulley_radius: a number or one per joint (2)"),
    (("pulleys", "joint_pulley_radius"), 0.2, "pulleys: eq. (1) has no root"),
    (("pulleys", "link_pulley_offset"), 0.13, "pulleys: the cable cannot reach"),
    (
        ("pulleys", "link_pulley_distance"),
        0.61,
        "pulleys.link_pulley_distance, links[1].length: 0.61 m is longer",
    ),
    (("pulleys", "motor_radius"), 0.1, "pulleys: unknown key 'motor_radius'; did you mean 'motor_pulley_radius'?"),
    (("pretension",), -1.0, "pretension: must be at least 0"),
    (("gravity",), [0, -9.8], "gravity: 3 numbers were expected, found 2"),
    (("gravitty",), [0, -9.8, 0], "unknown key 'gravitty'; did you mean 'gravity'?"),
    (("motors",), [{"rotor_inertia": 0.1}], "motors: 2 motors were expected, found 1"),
    (("motors",), [{"rotor_inertia": -0.1}, {}], "motors[1].rotor_inertia: must be at least 0"),
    (("effects",), [{"effect": "payload"}], "effects[1]: key 'location' is missing"),
]


@pytest.mark.parametrize(("path", "value", "words"), BAD, ids=[words for *_, words in BAD])
def test_what_is_wrong_is_named(tmp_path, path, value, words):
    """One line with file, key, what was found and what was expected."""
    file = tmp_path / "arm.yaml"
    file.write_text(yaml.safe_dump(changed(PAPER, path, value)))
    with pytest.raises((ManipulatorError, GeometryError)) as caught:
        load_manipulator(file)
    assert str(caught.value).startswith(f"{file}: {words}")
    assert "\n" not in str(caught.value)


BAD_TRANSMISSION = [
    ("joint_from_motor", [[1.0, 1.0], [2.0, 2.0]], "joint_from_motor: singular: 2 motors move only 1"),
    ("joint_from_motor", [[1.0, 0.0]], "joint_from_motor: one row per joint (2) was expected, found 1"),
    ("joint_from_motor", [[1.0, 0.0], [1.0]], "joint_from_motor[2]: 2 numbers were expected, found 1"),
    ("joints", ["a", "a"], "joints: 'a' is named twice"),
    ("offset", [0.1], "offset: 2 numbers were expected, found 1"),
    ("joint", ["a"], "unknown key 'joint'; did you mean 'joints'?"),
]


@pytest.mark.parametrize(("key", "value", "words"), BAD_TRANSMISSION, ids=[words for *_, words in BAD_TRANSMISSION])
def test_what_is_wrong_with_a_transmission_is_named(key, value, words):
    """E must be of full column rank and fit the names given."""
    with pytest.raises(ManipulatorError) as caught:
        parse_manipulator(changed(URDF, ("transmission", key), value))
    assert str(caught.value).startswith("transmission" + (": " if words.startswith("unknown") else ".") + words)


def test_more_motors_than_joints_is_singular():
    """Columns that cannot be independent are refused."""
    content = changed(URDF, ("transmission", "joint_from_motor"), [[1.0, 0.0, 1.0], [0.0, 1.0, 1.0]])
    content["transmission"]["motors"] = ["m", "n", "o"]
    with pytest.raises(ManipulatorError, match="singular"):
        parse_manipulator(content)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("links: [\n", "is not valid YAML"),
        ("- 1\n", "a mapping of keys was expected"),
        ("name: a\nname: b\n", "line 2: key 'name' is given twice"),
        ("links:\n  - {mass: 1, mass: 2}\n", "line 2: key 'mass' is given twice"),
        ("", "is empty"),
        ("name: \xff\xfe".encode("latin-1"), "not UTF-8"),
    ],
)
def test_unreadable_files(tmp_path, text, words):
    """Broken YAML, a key given twice, no text: one line each."""
    file = tmp_path / "arm.yaml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ManipulatorError, match=words):
        load_manipulator(file)


def test_missing_file(tmp_path):
    """A file that is not there is named."""
    with pytest.raises(ManipulatorError, match=r"arm\.yaml: no such file"):
        load_manipulator(tmp_path / "arm.yaml")


def test_exponents_without_a_dot_are_numbers():
    """`1e-3` is a number here, though YAML 1.1 reads it as text."""
    text = (ROOT / "urdf" / "cdm2.yaml").read_text().replace("[0.01, 0.06, 0.06]", "[1e-2, 6e-2, 6E-2]")
    content = yaml.load(text, Loader=_StrictLoader)
    np.testing.assert_array_equal(parse_manipulator(content).links[0].inertia, np.diag([0.01, 0.06, 0.06]))


def test_urdf_path_is_relative_to_the_file(tmp_path):
    """`urdf: path` counts from the folder of the YAML file, when read and when written elsewhere."""
    file = tmp_path / "a" / "robot.yaml"
    file.parent.mkdir()
    file.write_text(yaml.safe_dump(URDF))
    arm = load_manipulator(file)
    assert arm.urdf == tmp_path / "a" / "robot.urdf"
    assert manipulator_content(arm, tmp_path / "b")["urdf"] == "../a/robot.urdf"
    np.testing.assert_array_equal(arm.gravity, [0, 0, -9.81])
