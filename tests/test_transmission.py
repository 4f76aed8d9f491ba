"""The motor/joint map: eqs (6), (16), radii that differ, moment arms as derivatives of cable length."""

import numpy as np
import pytest
from arms import planar_arm, planar_arms, states
from hypothesis import given, settings

from cdm_pin.geometry import Pulleys
from cdm_pin.transmission import cable_travel, joint_from_motor, motor_from_joint


def pulleys(r_j, r_m):
    return Pulleys(np.asarray(r_j, float), np.asarray(r_m, float), 0.02, 0.022, 0.124)


def test_eq_6():
    """theta_i = (r_m / r_j) (q_i - q_{i-1}): a bidiagonal E."""
    E = joint_from_motor(pulleys([0.1] * 3, [0.05] * 3))
    np.testing.assert_allclose(E, 0.5 * np.array([[1, 0, 0], [-1, 1, 0], [0, -1, 1]]))


def test_each_motor_turns_with_the_absolute_angle_of_its_link():
    """Eq. (6) summed up: with one radius q_i = (r_j / r_m) (theta_1 + ... + theta_i)."""
    theta = np.array([0.3, -0.5, 1.1])
    q_m = motor_from_joint(pulleys([0.1] * 3, [0.05] * 3)) @ theta
    np.testing.assert_allclose(q_m, 2.0 * np.cumsum(theta))


@given(planar_arms)
@settings(max_examples=40, deadline=None)
def test_virtual_work(model):
    """tau_m,i = r_m,i (tau_i / r_j,i - tau_{i+1} / r_j,i+1), and tau_m' v_m = tau' v: the transmission keeps power."""
    p, n = model.manipulator.pulleys, model.n_joints
    tau, v_m, _ = np.random.default_rng(0).normal(size=(3, n))
    force = np.append(tau / p.joint_pulley_radius, 0.0)
    tau_m = model.motor_torque(tau)
    np.testing.assert_allclose(tau_m, p.motor_pulley_radius * (force[:-1] - force[1:]), rtol=1e-12, atol=1e-12)
    assert tau_m @ v_m == pytest.approx(tau @ (model.joint_from_motor @ v_m), rel=1e-10)
    np.testing.assert_allclose(model.joint_from_motor @ motor_from_joint(p), np.eye(n), atol=1e-10)


def side_length(model, theta, cable, sign):
    """Length of one side of a cable from the base to the driven link: strands and arcs from the pulleys' places."""
    p, links = model.manipulator.pulleys, model.manipulator.links
    d, r_g = np.array([p.link_pulley_distance, sign * p.link_pulley_offset]), p.link_pulley_radius
    length, angle, centre = 0.0, 0.0, np.zeros(2)
    for k in range(cable + 1):
        r_j = p.joint_pulley_radius[k]
        before = centre + rotate(angle, [-d[0], d[1]])
        angle += theta[k]
        after = centre + rotate(angle, d)
        length += inner_tangent(before, centre, r_g, r_j) + inner_tangent(centre, after, r_j, r_g)
        # the strands cross the lines of centres at arcsin((r_j + r_g) / distance) on either side
        crossing = 2 * np.arcsin((r_j + r_g) / np.linalg.norm(d))
        length += r_j * (crossing - sign * turned(centre - before, after - centre))
        if k < cable:
            centre = centre + rotate(angle, [links[k].length, 0.0])
            far = centre + rotate(angle, [-d[0], d[1]])
            length += np.linalg.norm(far - after)
    return length


def rotate(angle, x):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * x[0] - s * x[1], s * x[0] + c * x[1]])


def turned(x, y):
    return np.arctan2(x[0] * y[1] - x[1] * y[0], x @ y)


def inner_tangent(a, b, r_a, r_b):
    return np.sqrt(np.sum((b - a) ** 2) - (r_a + r_b) ** 2)


@pytest.mark.parametrize("n", [1, 2, 4, 7])
def test_moment_arms_are_derivatives_of_cable_length(n):
    """The upper side shortens and the lower lengthens by r_j per radian of every joint the cable passes."""
    model = planar_arm(n, 11)
    q = 0.3 * states(model, 3, 0)[0]
    travel, h = cable_travel(model.manipulator.pulleys), 1e-6
    for theta in q:
        for cable in range(n):
            for sign in (1, -1):
                ends = [[side_length(model, theta + s * h * e, cable, sign) for e in np.eye(n)] for s in (1, -1)]
                np.testing.assert_allclose((np.subtract(*ends)) / (2 * h), -sign * travel[cable], atol=1e-8)
