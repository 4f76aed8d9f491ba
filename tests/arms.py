"""Arms to test with: random planar ones of any length, and the committed manipulator files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from cdm_pin.geometry import wrap_half_angle
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.model import CableModel, build_model

ROOT = Path(__file__).resolve().parent.parent
FILES = sorted((ROOT / "urdf").glob("*.yaml"))

paper_radii = {
    "joint_pulley_radius": 0.1,
    "motor_pulley_radius": 0.1,
    "link_pulley_radius": 0.02,
    "link_pulley_offset": 0.022,
    "link_pulley_distance": 0.124,
}


def planar_content(n: int, seed: int, *, one_radius: bool = False) -> dict[str, Any]:
    """Content of a manipulator file of a random planar arm: full inertias, centres off the line, radii per joint."""
    rng = np.random.default_rng(seed)
    links = []
    for i in range(n):
        mass, length = rng.uniform(0.3, 4.0), rng.uniform(0.25, 0.9)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        box = np.array([length, 0.08, 0.05]) ** 2
        I = turn @ np.diag(mass * (box.sum() - box) / 12) @ turn.T
        links.append(
            {
                "name": f"link_{i + 1}",
                "length": length,
                "mass": mass,
                "center_of_mass": [length * rng.uniform(0.3, 0.7), *rng.uniform(-0.02, 0.02, 2)],
                "inertia": [I[k] for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))],
            }
        )
    while True:
        r_g, d_j = rng.uniform(0.005, 0.02), rng.uniform(0.06, 0.12)
        r_j = rng.uniform(0.02, 0.1, 1 if one_radius else n) * np.ones(n)
        d_g = r_g + rng.uniform(0.0, 0.01)
        try:
            for radius in r_j:
                wrap_half_angle(radius, r_g, d_g, d_j)
            break
        except ValueError:
            continue
    content = {
        "name": "arm",
        "gravity": [*rng.uniform(-10, 10, 2), 0.0],
        "links": links,
        "pulleys": {
            "joint_pulley_radius": r_j.tolist(),
            "motor_pulley_radius": rng.uniform(0.02, 0.1, n).tolist(),
            "link_pulley_radius": r_g,
            "link_pulley_offset": d_g,
            "link_pulley_distance": d_j,
        },
        "pretension": 100.0,
        "motors": [{"rotor_inertia": rng.uniform(0, 0.01)} for _ in range(n)],
    }
    return json.loads(json.dumps(content))  # plain numbers


def planar_arm(n: int, seed: int, *, one_radius: bool = False) -> CableModel:
    """Model of a random planar arm."""
    return build_model(parse_manipulator(planar_content(n, seed, one_radius=one_radius)))


def states(model: CableModel, n_samples: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random positions, velocities and accelerations."""
    rng = np.random.default_rng(seed)
    q, v, a = rng.uniform(-1, 1, (3, n_samples, model.n_joints)) * np.array([1.5, 4.0, 20.0])[:, None, None]
    return q, v, a


planar_arms = st.builds(planar_arm, st.integers(1, 8), st.integers(0, 10**6))


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference relative to the largest value."""
    return float(np.max(np.abs(found - expected)) / max(1e-12, np.max(np.abs(expected))))
