"""A cable arm as MuJoCo sees it: tendons wrapped over cylinders, with no line of ours in its mechanics."""

from __future__ import annotations

import mujoco
import numpy as np

from cdm_pin.geometry import Manipulator

FAR, NEAR = 0.97, 0.3  # where along a strand its fixed points sit, from link guide pulley to joint pulley
BEHIND = np.radians(105)  # of the side sites, from the link's x axis


def tendon_arm(manipulator: Manipulator) -> mujoco.MjModel:
    """Build the arm with two spatial tendons per cable, each with an actuator that pulls it; planar arms only.

    A link guide pulley is a fixed point on the strand between it and the joint pulley; a joint pulley is a cylinder
    that the tendon wraps. Actuators come as cable 1 upper, cable 1 lower, cable 2 upper, ...
    """
    n, p = len(manipulator.links), manipulator.pulleys
    bodies, tendons, actuators = _sites(p, 0, 0.0), "", ""
    for i, link in enumerate(manipulator.links):
        I = link.inertia
        full = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
        x = manipulator.links[i - 1].length if i else 0.0
        bodies += f"""<body pos="{x!r} 0 0"><joint name="joint_{i + 1}" axis="0 0 1"/>
            <inertial mass="{link.mass!r}" pos="{_text(link.center_of_mass)}" fullinertia="{_text(full)}"/>"""
        bodies += _sites(p, i + 1, link.length)
    for cable in range(1, n + 1):
        for side in ("upper", "lower"):
            name = f"cable_{cable}_{side}"
            path = "".join(
                f'<site site="far_{k - 1}_{side}"/><geom geom="pulley_{k}" sidesite="side_{k}_{side}"/>'
                f'<site site="near_{k}_{side}"/>'
                for k in range(1, cable + 1)
            )
            tendons += f'<spatial name="{name}">{path}</spatial>'
            actuators += f'<motor name="{name}" tendon="{name}" gear="-1"/>'
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><compiler angle="radian" autolimits="false"/><option gravity="{_text(manipulator.gravity)}"/>
        <worldbody>{bodies}{"</body>" * n}</worldbody><tendon>{tendons}</tendon><actuator>{actuators}</actuator>
        </mujoco>"""
    )


def _sites(p, link: int, length: float) -> str:
    """Write the fixed points of a link's guide pulleys, the wrapped pulley of the joint at its far end, side sites.

    A wrap may pass 180 deg, where MuJoCo's rule (the tangent points' mean nearest to the side site) needs help: the
    fixed point before the pulley sits further along its strand than the one behind, and the side site turns with the
    link behind. Neither changes the mechanics.
    """
    text, n = "", len(p.joint_pulley_radius)
    for side, sign in (("upper", 1), ("lower", -1)):
        if link > 0:
            theta, r = p.wrap_half_angle[link - 1], p.joint_pulley_radius[link - 1]
            guide = np.array([p.link_pulley_distance, p.link_pulley_offset])
            outward = np.array([np.sin(theta), np.cos(theta)])
            touch = (1 - NEAR) * (guide - p.link_pulley_radius * outward) + NEAR * r * outward
            text += f'<site name="near_{link}_{side}" pos="{_text([touch[0], sign * touch[1], 0])}"/>'
            aside = 1.5 * r * np.array([np.cos(BEHIND), sign * np.sin(BEHIND)])
            text += f'<site name="side_{link}_{side}" pos="{_text([*aside, 0])}"/>'
        if link < n:
            theta, r = p.wrap_half_angle[link], p.joint_pulley_radius[link]
            guide = np.array([-p.link_pulley_distance, p.link_pulley_offset])
            outward = np.array([-np.sin(theta), np.cos(theta)])
            touch = (1 - FAR) * (guide - p.link_pulley_radius * outward) + FAR * r * outward
            text += f'<site name="far_{link}_{side}" pos="{_text([length + touch[0], sign * touch[1], 0])}"/>'
    if link < n:
        size, centre = _text([p.joint_pulley_radius[link], 0.005]), _text([length, 0, 0])
        text += f'<geom name="pulley_{link + 1}" type="cylinder" size="{size}" pos="{centre}" '
        text += 'contype="0" conaffinity="0" mass="0"/>'
    return text


def _text(values) -> str:
    return " ".join(repr(float(value)) for value in values)
