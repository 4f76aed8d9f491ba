"""Pulley geometry: the physical root of eq. (1), the mechanism's limit, points and routing."""

import numpy as np
import pytest
from arms import paper_radii
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import brentq

from cdm_pin.errors import GeometryError
from cdm_pin.geometry import Pulleys, tangent_residual, wrap_half_angle
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.model import build_model
from cdm_pin.routing import joint_limits, link_points, rotation_from_rpy, route

TABLE_1 = {"r_j": 0.1, "r_g": 0.02, "d_g0": 0.022, "d_j0": 0.124}

radii = st.tuples(st.floats(0.01, 0.15), st.floats(0.004, 0.03), st.floats(0.0, 0.02), st.floats(0.03, 0.3))


def roots(r_j, r_g, d_g0, d_j0):
    """All roots theta_j0 of eq. (1) in (0, 90 deg), by a scan."""
    grid = np.radians(np.linspace(0.01, 89.9, 4000))
    values = [tangent_residual(x, r_j, r_g, d_g0, d_j0) for x in grid]
    at = np.flatnonzero(np.diff(np.sign(values)))
    return [brentq(tangent_residual, grid[k], grid[k + 1], (r_j, r_g, d_g0, d_j0), xtol=1e-15) for k in at]


def test_table_1():
    """Table 1 gives theta_j0 = 27.7230 deg; eq. (1) has a second root at 40.50 deg, which no cable follows."""
    theta_j0 = 90.0 - np.degrees(wrap_half_angle(**TABLE_1))
    assert theta_j0 == pytest.approx(27.7230, abs=5e-5)
    np.testing.assert_allclose(np.degrees(roots(**TABLE_1)), [27.7230, 40.5015], atol=1e-4)


def test_the_smallest_root_is_not_the_physical_one():
    """Where the smaller root of eq. (1) is 46.95 deg the cable follows 57.35 deg."""
    geometry = {"r_j": 0.05, "r_g": 0.01, "d_g0": 0.02, "d_j0": 0.08}
    assert np.degrees(min(roots(**geometry))) == pytest.approx(46.95, abs=5e-3)
    assert 90 - np.degrees(wrap_half_angle(**geometry)) == pytest.approx(57.35, abs=5e-3)


@given(radii)
def test_physical_root_satisfies_eq_1_and_is_the_inner_tangent(numbers):
    """The closed form solves eq. (1), and its line touches both pulleys from opposite sides."""
    r_j, r_g, gap, d_j0 = numbers
    d_g0 = r_g + gap
    try:
        theta = wrap_half_angle(r_j, r_g, d_g0, d_j0)
    except GeometryError:
        assume(False)
    assert abs(tangent_residual(np.pi / 2 - theta, r_j, r_g, d_g0, d_j0)) < 1e-9 * (1 + 1 / np.sin(theta) ** 2)
    normal = np.array([np.sin(theta), np.cos(theta)])  # of the upper strand, away from the joint
    assert normal @ [d_j0, d_g0] == pytest.approx(r_j + r_g, abs=1e-12)


def test_mechanism_limit():
    """A joint may turn 124.55 deg to either side: past it, the cable has left the joint pulley."""
    manipulator = parse_manipulator(
        {"gravity": [0, 0, 0], "links": [{"length": 0.6, "mass": 1, "inertia": [1, 1, 1]}], "pulleys": paper_radii}
    )
    np.testing.assert_allclose(
        np.degrees(joint_limits(manipulator.links, manipulator.pulleys)), [[-124.554, 124.554]], atol=1e-3
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"r_j": 0.2}, "eq. \\(1\\) has no root: .* overlap"),
        ({"d_g0": 0.13}, "cable cannot reach"),
        ({"d_g0": 0.121, "d_j0": 0.02, "r_j": 0.1, "r_g": 0.001}, "cable cannot reach"),
    ],
)
def test_impossible_pulleys(change, words):
    """Pulleys that overlap, or that no inner tangent joins, are refused in words."""
    with pytest.raises(GeometryError, match=words):
        wrap_half_angle(**(TABLE_1 | change))


def test_points_of_a_link():
    """Eqs (26)-(31): guide pulleys mirrored about the link and its middle; V and U on the next joint's pulley."""
    pulleys = Pulleys(np.array([0.1, 0.08]), np.array([0.1, 0.1]), 0.02, 0.022, 0.124)
    p = link_points(pulleys, 1, 0.6)
    np.testing.assert_allclose(p["B"], [0.124, 0.022, 0])
    np.testing.assert_allclose(p["C"] + p["A"], [0.6, -0.044, 0])
    for letter, sign in (("V", 1), ("U", -1)):
        assert np.linalg.norm(p[letter] - [0.6, 0, 0]) == pytest.approx(0.08)
        guide = p["D" if sign > 0 else "C"]
        theta = wrap_half_angle(0.08, 0.02, 0.022, 0.124)
        strand = p[letter] - (guide + 0.02 * np.array([np.sin(theta), -sign * np.cos(theta), 0]))
        np.testing.assert_allclose(
            strand / np.linalg.norm(strand), [np.cos(theta), sign * np.sin(theta), 0], atol=1e-12
        )


def chain(*links):
    base = {"length": 0.5, "mass": 1.0, "inertia": [1, 1, 1]}
    content = {"gravity": [0, 0, 0], "links": [base | link for link in links], "pulleys": paper_radii}
    for i, link in enumerate(content["links"]):
        link.setdefault("name", f"link_{i + 1}")
    return parse_manipulator(content)


def test_routing_of_the_papers_arm_is_the_identity():
    """Axes along z, links along x: cable frames are link frames and no joint is bent at zero."""
    routing = route(chain({}, {}, {}).links)
    for frame in routing.frames:
        np.testing.assert_array_equal(frame, np.eye(3))
    np.testing.assert_array_equal(routing.bend, 0.0)
    np.testing.assert_array_equal(routing.length, [0, 0.5, 0.5, 0])


def test_routing_of_a_cranked_arm():
    """A link that leaves its frame's x axis at 30 deg bends its joints by that much at zero; the limits follow."""
    a = np.radians(30)
    arm = chain({}, {"origin": {"xyz": [0.5 * np.cos(a), 0.5 * np.sin(a), 0.0]}})
    routing = route(arm.links)
    np.testing.assert_allclose(routing.bend, [a, -a], atol=1e-12)
    lower, upper = joint_limits(arm.links, arm.pulleys).T
    np.testing.assert_allclose(np.degrees(upper), [124.554 - 30, 124.554 + 30], atol=1e-3)
    np.testing.assert_allclose(np.degrees(lower), [-124.554 - 30, -124.554 + 30], atol=1e-3)


@pytest.mark.parametrize(
    "child",
    [
        {"axis": [1, 0, 0], "origin": {"xyz": [0.5, 0, 0]}},
        {"axis": [0, 0, -1], "origin": {"xyz": [0.5, 0, 0]}},
        {"origin": {"xyz": [0.5, 0, 0.1]}},
        {"origin": {"xyz": [0.5, 0, 0], "rpy": [0.3, 0, 0]}},
        {"origin": {"xyz": [0, 0, 0]}},
    ],
)
def test_no_plane_no_cables(child):
    """Neighbouring axes that are skew, opposed, offset along themselves or the same: no cable layer on that link."""
    arm = chain({}, child)
    routing = route(arm.links)
    assert routing.frames[1] is None
    assert not build_model(arm).planar
    with pytest.raises(GeometryError, match="does not apply to link 1"):
        routing.run(1)


def test_rotation_from_rpy():
    """Roll, pitch, yaw about fixed axes: Rz Ry Rx, as Pinocchio has it."""
    import pinocchio as pin

    rpy = np.array([0.3, -0.7, 1.9])
    np.testing.assert_allclose(rotation_from_rpy(rpy), pin.rpy.rpyToMatrix(*rpy), atol=1e-15)
