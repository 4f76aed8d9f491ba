"""Where every body of a robot stands, over whole trajectories, from plain arrays."""

from __future__ import annotations

import numpy as np

from .model import Chain


def body_poses(chain: Chain, q: np.ndarray) -> np.ndarray:
    """Place every body in the base frame.

    Parameters
    ----------
    chain : Chain
    q : ndarray, shape (n_samples, n_joints)
        Rows of E in their order [rad or m].

    Returns
    -------
    ndarray, shape (n_samples, n_joints, 4, 4)
        Homogeneous transforms from body to base [m].
    """
    q = np.asarray(q, float)
    poses = np.zeros((len(q), len(chain.parent), 4, 4))
    poses[..., 3, 3] = 1.0
    for k in chain.order:
        local = poses[:, k]
        local[:, :3, 3] = chain.translation[k]
        if chain.prismatic[k]:
            local[:, :3, :3] = chain.rotation[k]
            local[:, :3, 3] += q[:, k, None] * (chain.rotation[k] @ chain.axis[k])
        else:
            local[:, :3, :3] = chain.rotation[k] @ turn(chain.axis[k], q[:, k])
        if chain.parent[k] >= 0:
            poses[:, k] = poses[:, chain.parent[k]] @ local
    return poses


def turn(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Give rotations about a unit axis by each angle [rad], shape (n, 3, 3) (Rodrigues' formula)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.asarray(angle, float)[:, None, None]
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)
