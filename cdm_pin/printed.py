r"""The paper's cable equations exactly as printed: a documented reproduction, never the model.

For two links they agree with virtual work. For three and more they do not: eq. (21) has `cos(theta) + 1` and
`cos(theta) - 1` in each other's place and the sign of its second row turned, eq. (13) adds cable forces that the force
balance subtracts. docs/cables.md derives the correct set and tabulates the errata.
"""

from __future__ import annotations

import numpy as np

from .errors import GeometryError
from .geometry import Vector
from .model import CableModel
from .recursion import link_wrenches


def printed_cable_torque(model: CableModel, q: Vector, v: Vector, a: Vector) -> Vector:
    r"""Compute n_i by eqs (13), (34), (40), (41) as printed.

    .. math::
        f_i &= R f_{i+1} + \sum_{j > i} F_{cable}(j, i) + F_i \\
        n_i &= N_i + \sum_{j > i + 1} N_{cable}(j, i) + P_{C,i} \times F_i + P_{i+1} \times R f_{i+1}

    The motion follows the standard recursion: (7), (8) as printed index the joint one off and (8) has a velocity of the
    wrong joint.

    Parameters
    ----------
    model : CableModel
        A planar arm in the paper's frames, with one joint pulley radius.
    q, v, a : ndarray, shape (n_samples, n_joints)
        theta of the paper and its rates [rad, s].

    Returns
    -------
    ndarray, shape (n_samples, n_joints)
        [N m]; the motor torque of eq. (16) is r_m / r_j times it.

    Raises
    ------
    GeometryError
        If the arm is not the paper's kind.
    """
    pulleys = model.manipulator.pulleys
    if pulleys is None or not model.planar or np.ptp(pulleys.joint_pulley_radius) > 0 or model.routing.bend.any():
        raise GeometryError("the printed equations are for planar arms with one joint pulley radius")
    q, v, a = (model.joint_array(x, name) for x, name in ((q, "q"), (v, "v"), (a, "a")))
    n, r_j, theta_g = model.n_joints, pulleys.joint_pulley_radius[0], pulleys.wrap_half_angle[0]
    turned, F, N = link_wrenches(model, q, v, a)  # N: the paper's N_i + P_C x F_i
    torque = np.zeros((len(q), n))
    f = np.zeros((len(q), 3))  # R f_{i+1}
    for i in range(n - 1, -1, -1):
        length = model.chain.translation[i + 1] if i + 1 < n else np.zeros(3)
        torque[:, i] = N[:, i, 2] + np.cross(length, f)[:, 2]
        cables = np.zeros((len(q), 3))
        for j in range(i + 1, n):
            pull = torque[:, j] / r_j
            theta = q[:, i + 1]
            near = 2.0 if j == i + 1 else 1.0
            x = near * np.cos(theta_g) + np.cos(theta - theta_g)
            y = near * np.sin(theta_g) - np.sin(theta - theta_g)
            cables += pull[:, None] * np.stack([x, y, 0.0 * x], axis=1)  # (40)
            if j > i + 1:
                lever = np.cross(length, [np.cos(theta_g), np.sin(theta_g), 0.0])[2]
                torque[:, i] += pull * lever  # (41)
        f = np.einsum("sij,sj->si", turned[:, i], f + cables + F[:, i])
    return torque
