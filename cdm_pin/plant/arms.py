"""Draws of arms, trajectories and servos; an arm as the content of manipulator.yaml."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..geometry import Link, Manipulator, Motor, Pulleys, frozen_array
from .absolute import Reference, Servo
from .planar import Arm, lumped


def draw_arm(rng: np.random.Generator, n_links: int, *, rotors: bool) -> tuple[Arm, float]:
    """Draw a planar arm whose largest static torque ("scale", also returned [N m]) is 6-15 N m."""
    n = n_links
    length = rng.uniform(0.25, 0.5, n) * np.linspace(1.0, 0.75, n)
    mass = rng.uniform(0.7, 1.4, n) * np.linspace(2.0, 0.8, n)
    cx, cy = length * rng.uniform(0.35, 0.65, n), length * rng.uniform(-0.06, 0.06, n)
    inertia = mass * length**2 / 12.0 * rng.uniform(0.8, 1.6, n)
    angle = -np.pi / 2 if rng.random() < 0.6 else rng.uniform(-np.pi, np.pi)
    gravity = 9.81 * np.array([np.cos(angle), np.sin(angle)])
    beyond = np.append(np.cumsum(mass[::-1])[::-1][1:], 0.0)
    scale = rng.uniform(6.0, 15.0)
    factor = scale / (9.81 * np.sum(mass * cx + beyond * length))
    mass, inertia = mass * factor, inertia * factor
    largest = _REACH * float(length.min())  # else the guide pulleys at a link's two ends would pass each other
    radius, ratio = rng.uniform(0.04, min(0.1, largest)), rng.choice([1.0, rng.uniform(0.3, 1.0)])
    guide, offset, distance = _pulleys(radius)
    cable_angle = np.arcsin((radius + guide) / np.hypot(offset, distance)) - np.arctan2(offset, distance)
    rotor = rng.uniform(0.03, 0.12, n) * scale * 0.02 * ratio**2 if rotors else np.zeros(n)
    pretension = scale / (2.0 * radius) * rng.uniform(1.6, 3.0)
    return Arm(length, mass, cx, cy, inertia, gravity, rotor, ratio, radius, cable_angle, round(pretension, 1)), scale


_REACH = 0.4  # of the shortest link, the largest joint pulley's radius; `_pulleys` puts the guides 1.24 radii away


def _pulleys(radius: float) -> tuple[float, float, float]:
    """Guide pulley radius, offset and distance of an arm shaped as the paper's."""
    return 0.2 * radius, 0.22 * radius, 1.24 * radius


def manipulator_file(
    arm: Arm, rng: np.random.Generator | None = None, spread: float = 0.1, name: str = "arm"
) -> dict[str, Any]:
    """Write an arm as manipulator.yaml content; with `rng`, every inertial value is wrong by up to `spread`."""

    def wrong(x: float) -> float:
        return float(f"{x * (1.0 + (rng.uniform(-spread, spread) if rng is not None else 0.0)):.10g}")

    guide, offset, distance = _pulleys(arm.joint_pulley_radius)
    links = []
    for i, l in enumerate(arm.length):
        zz = wrong(arm.inertia[i])
        links.append(
            {
                "name": f"link_{i + 1}",
                "length": float(l),
                "mass": wrong(arm.mass[i]),
                "center_of_mass": [wrong(arm.cx[i]), wrong(arm.cy[i]), 0.0],
                "inertia": [0.1 * zz, zz, zz],
            }
        )
    content = {
        "name": name,
        "gravity": [float(arm.gravity[0]), float(arm.gravity[1]), 0.0],
        "links": links,
        "pulleys": {
            "joint_pulley_radius": float(arm.joint_pulley_radius),
            "motor_pulley_radius": float(arm.joint_pulley_radius * arm.ratio),
            "link_pulley_radius": float(guide),
            "link_pulley_offset": float(offset),
            "link_pulley_distance": float(distance),
        },
        "pretension": float(arm.pretension),
    }
    if arm.rotor.any():
        content["motors"] = [{"rotor_inertia": wrong(J)} for J in arm.rotor]
    return content


def draw_reference(rng: np.random.Generator, n: int, *, speed: float = 1.0, limit: float = 1.6) -> Reference:
    """Draw a Fourier series of 5-8 harmonics on a base of 0.08-0.16 Hz, kept inside `limit` [rad] of straight."""
    K = int(rng.integers(5, 9))
    taper = 1.0 / np.arange(1, K + 1) ** rng.uniform(0.3, 1.0)
    sine, cosine = rng.normal(size=(n, K)) * taper, rng.normal(size=(n, K)) * taper
    x = np.linspace(0.0, 2.0 * np.pi, 400)[:, None] * np.arange(1, K + 1)
    swing = np.abs(np.sin(x) @ sine.T + np.cos(x) @ cosine.T).max(axis=0)
    size = rng.uniform(0.6, 1.2, n) / swing
    centre = rng.uniform(-1.0, 1.0, n) * (limit - size * swing) * 0.8
    omega = 2.0 * np.pi * rng.uniform(0.08, 0.16) * speed
    return Reference(centre, sine * size[:, None], cosine * size[:, None], omega)


def draw_moves(
    rng: np.random.Generator, n: int, duration: float, *, speed: float = 1.0, limit: float = 1.6
) -> Reference:
    """Draw moves from point to point inside `limit` [rad] of straight, of some joints each time, with rests between."""
    now, centre, rows = float(rng.uniform(0.2, 1.0)), rng.uniform(-0.5, 0.5, n) * limit, []
    at, fast, longest = centre.copy(), speed * rng.uniform(0.8, 2.0), rng.uniform(0.5, 3.0)
    while now < duration:
        moving = np.flatnonzero(rng.random(n) < rng.uniform(0.3, 1.0))
        far = rng.uniform(-limit, limit, len(moving)) - at[moving]
        takes = np.maximum(1.875 * np.abs(far) / (fast * rng.uniform(0.5, 1.0, len(moving))), 0.4)
        rows += [(float(i), now, t, x) for i, t, x in zip(moving, takes, far, strict=True)]
        at[moving] += far
        now += float(takes.max(initial=0.0) + rng.uniform(0.2, longest))
    still = np.zeros((n, 1))
    return Reference(centre, still, still.copy(), 1.0, np.array(rows).reshape(-1, 4))


def draw_servo(rng: np.random.Generator, model: Arm, scale: float) -> Servo:
    """Bandwidth 2-5 Hz and damping 0.7 on the nominal inertia, any share of feed-forward, a little ripple."""
    D = lumped(model)[0] + model.rotor / model.ratio**2
    omega = 2.0 * np.pi * rng.uniform(2.0, 5.0)
    n = D.size
    share = D / D.sum()
    ripple = np.column_stack(
        [scale * 0.02 * share * rng.random(), 2 * np.pi * rng.uniform(3, 9, n), rng.uniform(-np.pi, np.pi, n)]
    )
    return Servo(D * omega**2, 1.4 * D * omega, rng.uniform(0.5, 1.0), ripple)


def arm_from_file(content: dict[str, Any], arm: Arm) -> Arm:
    """Read the wrong arm back, as the servo knows it."""
    links = content["links"]
    centre = np.array([link["center_of_mass"] for link in links])
    return arm._replace(
        mass=np.array([link["mass"] for link in links]),
        cx=centre[:, 0].copy(),
        cy=centre[:, 1].copy(),
        inertia=np.array([link["inertia"][2] for link in links]),
        rotor=np.array([m["rotor_inertia"] for m in content.get("motors", [])] or np.zeros(len(links))),
    )


def to_manipulator(arm: Arm, name: str = "arm") -> Manipulator:
    """Give an arm as the manipulator it is, for the MuJoCo plant."""
    n = arm.length.size
    guide, offset, distance = _pulleys(arm.joint_pulley_radius)
    r_j = frozen_array(np.full(n, arm.joint_pulley_radius))
    links = tuple(
        Link(
            name=f"link_{i + 1}",
            length=float(arm.length[i]),
            mass=float(arm.mass[i]),
            center_of_mass=frozen_array([arm.cx[i], arm.cy[i], 0.0]),
            inertia=frozen_array(arm.inertia[i] * np.diag([0.1, 1.0, 1.0])),
            axis=frozen_array([0.0, 0.0, 1.0]),
            origin_xyz=frozen_array([arm.length[i - 1] if i else 0.0, 0.0, 0.0]),
            origin_rpy=frozen_array(np.zeros(3)),
        )
        for i in range(n)
    )
    return Manipulator(
        name=name,
        gravity=frozen_array([*arm.gravity, 0.0]),
        links=links,
        pulleys=Pulleys(r_j, frozen_array(r_j * arm.ratio), guide, offset, distance),
        pretension=arm.pretension,
        motors=tuple(Motor(float(J)) for J in arm.rotor),
    )
