r"""MuJoCo models of planar cable-driven arms: both strands of every cable as tendons over the joint pulleys.

Strand "upper" (+y) of cable `i` runs from the base over the upper side of the pulleys of joints 1..i and ends on link
`i`. A link guide pulley is replaced by the point where the strand meets it, which the link carries along: exact, since
the strand between that pulley and the joint pulley keeps its place in the link while the joint pulley is wrapped.

- *Rigid* cables: the motor is not a body; it pulls the two strands with :math:`T_0 \pm u/2r_m`. Its rotor and friction
  sit on a third tendon, a fixed one, whose length is the motor's angle.
- *Elastic* cables: the winch is a slider (displacement :math:`r_m q_m`, mass :math:`J/r_m^2`) to which the two strands
  are tied from opposite ends; strands are one-sided springs and may hang slack.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np

from ..errors import InputError
from ..geometry import Manipulator, Pulleys, wrap_half_angle
from .faults import Fault

_NEAR = 0.02  # of the pulley's radius
_WINCH, _TURN = -3.0, -6.0  # x [m] of a winch at rest and of the point behind it where the lower strand turns
_IN_MODEL = ("rotor_inertia", "payload", "base_tilt", "transmission_ratio_error", "cable_elasticity")


@dataclass(frozen=True)
class Strands:
    """Elasticity of each strand of a cable: stiffness [N/m] and damping [N s/m]; infinite stiffness is rigid."""

    stiffness: float = np.inf
    damping: float = 0.0

    @property
    def elastic(self) -> bool:
        """Whether the strands stretch."""
        return bool(np.isfinite(self.stiffness))


def in_model(fault: Fault) -> bool:
    """Tell whether MuJoCo itself carries a fault; other laws have to be applied at every step."""
    if fault.effect in ("viscous_friction", "coulomb_friction"):
        return fault.location["kind"] in ("joint", "motor")
    if fault.effect == "joint_spring":
        return not fault.parameters.get("cubic")
    return fault.effect in _IN_MODEL


def planar_pulleys(manipulator: Manipulator) -> Pulleys:
    """Give the pulleys of a planar arm.

    Raises
    ------
    InputError
        If the robot is not an arm of links that turn about z, each following the other along x.
    """
    source = manipulator.source
    if not manipulator.links or manipulator.pulleys is None:
        raise InputError(
            "the mujoco plant needs links and pulleys; this robot runs on the pinocchio plant", source=source
        )
    for k, link in enumerate(manipulator.links):
        before = manipulator.links[k - 1].length if k else 0.0
        straight = np.allclose(link.origin_xyz, [before, 0.0, 0.0]) and np.allclose(link.origin_rpy, 0.0)
        if not (straight and np.allclose(link.axis, [0.0, 0.0, 1.0])):
            message = "the mujoco plant is for planar arms; a spatial chain runs on the pinocchio plant"
            raise InputError(message, place=f"links[{k + 1}]", source=source)
    return manipulator.pulleys


def rotor_inertia(manipulator: Manipulator, faults: Sequence[Fault] = ()) -> np.ndarray:
    """Give the rotor inertia of every motor [kg m^2], faults included."""
    rotor = np.array([motor.rotor_inertia for motor in manipulator.motors] or np.zeros(len(manipulator.links)))
    for fault in faults:
        if fault.effect == "rotor_inertia":
            rotor[fault.location["index"] - 1] += fault.parameters["inertia"]
    return rotor


def cable_strands(manipulator: Manipulator, strands: Strands, faults: Sequence[Fault]) -> tuple[Strands, ...]:
    """Give the strands of every cable; elasticity K about the joint pulley is 2 k r_j^2."""
    cables = [strands] * len(manipulator.links)
    for fault in faults:
        if fault.effect == "cable_elasticity":
            i = fault.location["index"] - 1
            per_strand = 2.0 * planar_pulleys(manipulator).joint_pulley_radius[i] ** 2
            stiffness, damping = fault.parameters["stiffness"], fault.parameters.get("damping", 0.0)
            cables[i] = Strands(stiffness / per_strand, damping / per_strand)
    return tuple(cables)


def compile_arm(
    manipulator: Manipulator,
    *,
    strands: Strands | None = None,
    faults: Sequence[Fault] = (),
    timestep: float = 5e-4,
) -> mujoco.MjModel:
    """Compile a planar arm with its cables; elastic strands carry the pretension at joint position zero.

    Parameters
    ----------
    manipulator : Manipulator
        A planar arm with pulleys.
    strands : Strands, optional
        Elasticity of all cables; rigid by default.
    faults : sequence of Fault
        Those that `in_model` accepts become part of the model.
    timestep : float
        [s].

    Raises
    ------
    InputError
        If the manipulator is not a planar arm with pulleys, or the motor of an elastic cable has no rotor inertia.
    """
    cables = cable_strands(manipulator, strands or Strands(), faults)
    writer = _Writer(
        manipulator, planar_pulleys(manipulator), cables, tuple(f for f in faults if in_model(f)), timestep
    )
    model = mujoco.MjModel.from_xml_string(writer.write(None))
    if not any(cable.elastic for cable in cables):
        return model
    stretch = np.repeat([(manipulator.pretension or 0.0) / cable.stiffness for cable in cables], 2)
    return mujoco.MjModel.from_xml_string(writer.write(model.tendon_length0[: 2 * len(cables)] - stretch))


def _tag(element: str, /, *inside: str, **attributes: Any) -> str:
    """Write an XML element; numbers to full precision."""
    said = "".join(
        f" {key}={quoteattr(value if isinstance(value, str) else _numbers(value))}" for key, value in attributes.items()
    )
    return f"<{element}{said}>{''.join(inside)}</{element}>\n"


def _numbers(values: Any) -> str:
    return " ".join(repr(float(v)) for v in np.atleast_1d(values))


def _pair(name: str, x: float, y: float) -> str:
    """Write the sites of the upper and the lower strand."""
    return "".join(_tag("site", name=f"{name}_{side}", pos=[x, s * y, 0]) for side, s in (("upper", 1), ("lower", -1)))


class _Crossing:
    """Where a cable touches its pulleys at a joint, in the driven link: along it, and across it [m].

    The link before sees the mirror image.
    """

    def __init__(self, pulleys: Pulleys, r: float):
        r_g, d_g0, d_j0 = pulleys.link_pulley_radius, pulleys.link_pulley_offset, pulleys.link_pulley_distance
        angle = wrap_half_angle(r, r_g, d_g0, d_j0)
        c, s = np.cos(angle), np.sin(angle)
        self.r = r
        self.touch = d_j0 - r_g * s, d_g0 - r_g * c
        """Where the strand from the joint pulley meets the link guide pulley."""
        self.lift = r * s + _NEAR * r * c, r * c - _NEAR * r * s
        """Where the strand lies just before the joint pulley: so near, the pulley's two possible wraps always differ
        enough for MuJoCo to choose by the side site, past half a turn as well."""
        direction = np.pi - angle - np.arccos(r / np.hypot(*self.touch))
        self.side = 4.0 * r * np.cos(direction), 4.0 * r * np.sin(direction)
        r"""The side site. MuJoCo takes the wrap whose mean tangent point lies nearer to it. With the strand lifting off
        at :math:`\pi/2 + \theta_{g0}` of the previous link and :math:`\beta` between its end and its tangent point on
        the driven link, the wanted wrap wins at every joint angle within :math:`\pm 2\theta_{g0}` if the side site's
        direction lies within :math:`\beta/2` of :math:`\pi - \theta_{g0} - \beta`."""


@dataclass(frozen=True)
class _Writer:
    manipulator: Manipulator
    pulleys: Pulleys
    cables: tuple[Strands, ...]
    faults: tuple[Fault, ...]
    timestep: float

    def write(self, slack_length: np.ndarray | None) -> str:
        n, soft = len(self.cables), {"solreffriction": [0.002, 1], "solimpfriction": [0.99, 0.99, 1]}
        base = [*self._before(0, 0.0), *(self._winch(i) for i in range(n) if self.cables[i].elastic)]
        tendons = [self._strand(i, upper, slack_length) for i in range(n) for upper in (True, False)]
        tendons += [self._motor(i) for i in range(n) if not self.cables[i].elastic]
        none = _tag("flag", contact="disable")
        how = {"timestep": self.timestep, "gravity": self._gravity(), "integrator": "implicitfast"}
        return _tag(
            "mujoco",
            _tag("compiler", angle="radian", inertiafromgeom="false", autolimits="true"),
            _tag("option", none, **how),
            _tag("default", _tag("geom", contype="0", conaffinity="0"), _tag("joint", **soft), _tag("tendon", **soft)),
            _tag("worldbody", *base, self._link(0)),
            _tag("tendon", *tendons),
            _tag("actuator", *(actuator for i in range(n) for actuator in self._actuators(i))),
            model=self.manipulator.name,
        )

    def _gravity(self) -> np.ndarray:
        angle = sum(f.parameters["angle"] for f in self.faults if f.effect == "base_tilt")
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ self.manipulator.gravity

    def _at(self, kind: str, i: int) -> list[Fault]:
        return [f for f in self.faults if f.location.get("kind") == kind and f.location.get("index") == i + 1]

    def _losses(self, kind: str, i: int) -> tuple[float, float]:
        """Sum the viscous [N m s/rad] and dry [N m] friction at a joint or motor."""
        here = self._at(kind, i)
        viscous = sum(f.parameters["viscous"] for f in here if f.effect == "viscous_friction")
        return viscous, sum(f.parameters["coulomb"] for f in here if f.effect == "coulomb_friction")

    def _rotor(self, i: int) -> float:
        """Rotor inertia as a mass on the cable [kg]."""
        inertia = rotor_inertia(self.manipulator, self.faults)[i]
        if self.cables[i].elastic and not inertia > 0.0:
            message = "the motor of an elastic cable needs a rotor inertia above zero"
            raise InputError(message, place=f"motors[{i + 1}].rotor_inertia", source=self.manipulator.source)
        return inertia / self.pulleys.motor_pulley_radius[i] ** 2

    def _winch(self, i: int) -> str:
        """Write a slider that shortens the upper strand as the motor turns forward."""
        r, (viscous, dry) = self.pulleys.motor_pulley_radius[i], self._losses("motor", i)
        y = self._crossing(0, i).touch[1]
        return _tag(
            "body",
            _tag("inertial", pos=[0, 0, 0], mass=self._rotor(i), diaginertia=[1, 1, 1]),
            _tag(
                "joint",
                name=f"motor_{i + 1}",
                type="slide",
                axis=[-1, 0, 0],
                damping=viscous / r**2,
                frictionloss=dry / r,
            ),
            _pair(f"winch_{i + 1}", 0.0, y),
            name=f"winch_{i + 1}",
            pos=[_WINCH, 0, 0],
            gravcomp=1,  # a rotor is balanced
        ) + _tag("site", name=f"turn_{i + 1}", pos=[_TURN, -y, 0])

    def _link(self, k: int) -> str:
        link, n = self.manipulator.links[k], len(self.cables)
        (viscous, dry), I = self._losses("joint", k), link.inertia
        springs = [f.parameters for f in self._at("joint", k) if f.effect == "joint_spring"]
        stiffness = sum(p["stiffness"] for p in springs)
        rest = sum(p["stiffness"] * p["rest"] for p in springs) / stiffness if stiffness else 0.0
        six = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
        hinge = {"damping": viscous, "frictionloss": dry, "stiffness": stiffness, "springref": rest}
        parts = [
            _tag("inertial", pos=link.center_of_mass, mass=link.mass, fullinertia=six),
            _tag("joint", name=f"joint_{k + 1}", type="hinge", axis=[0, 0, 1], **hinge),
        ]
        for i in range(k, n):  # cable i + 1 passes joint k + 1
            crossing, name = self._crossing(k, i), f"{k + 1}_{i + 1}"
            parts += [_pair(f"side_{name}", *crossing.side), _pair(f"near_{name}", *crossing.touch)]
            parts.append(_tag("geom", name=f"pulley_{name}", type="cylinder", size=[crossing.r, 0.005], mass=0))
        for m, f in enumerate(f for f in self._at("link", k) if f.effect == "payload"):
            centre = f.parameters.get("center_of_mass", [link.length, 0.0, 0.0])
            point = _tag("inertial", pos=centre, mass=f.parameters["mass"], diaginertia=[1e-12] * 3)
            parts.append(_tag("body", point, name=f"payload_{k + 1}_{m}"))
        if k + 1 < n:
            parts += [*self._before(k + 1, link.length), self._link(k + 1)]
        return _tag("body", *parts, name=link.name, pos=link.origin_xyz)

    def _before(self, k: int, x: float) -> list[str]:
        """Write where the cables pass on the link before joint `k`, which stands at `x` along it."""
        sites = []
        for i in range(k, len(self.cables)):
            for name, (dx, y) in (("far", self._crossing(k, i).touch), ("lift", self._crossing(k, i).lift)):
                sites.append(_pair(f"{name}_{k + 1}_{i + 1}", x - dx, y))
        return sites

    def _crossing(self, k: int, i: int) -> _Crossing:
        return _Crossing(self.pulleys, self.pulleys.joint_pulley_radius[k] * (1.0 + self._ratio_error(i, k)))

    def _ratio_error(self, i: int, k: int) -> float:
        here = [f for f in self._at("cable", i) if f.effect == "transmission_ratio_error"]
        return sum(f.parameters["relative_error"] for f in here if f.location.get("joint", i + 1) == k + 1)

    def _strand(self, i: int, upper: bool, slack_length: np.ndarray | None) -> str:
        side, cable = "upper" if upper else "lower", self.cables[i]
        path = [_tag("site", site=f"winch_{i + 1}_{side}")] if cable.elastic else []
        if cable.elastic and not upper:
            path.append(_tag("site", site=f"turn_{i + 1}"))
        for name in (f"{k + 1}_{i + 1}" for k in range(i + 1)):
            path += [_tag("site", site=f"{place}_{name}_{side}") for place in ("far", "lift")]
            path.append(_tag("geom", geom=f"pulley_{name}", sidesite=f"side_{name}_{side}"))
            path.append(_tag("site", site=f"near_{name}_{side}"))
        spring = {}
        if cable.elastic:
            longest = 0.0 if slack_length is None else slack_length[2 * i + (not upper)]
            spring = {"stiffness": cable.stiffness, "damping": cable.damping, "springlength": [0.0, longest]}
        return _tag("spatial", *path, name=f"cable_{i + 1}_{side}", **spring)

    def _motor(self, i: int) -> str:
        """Write the tendon whose length is the angle of a motor with rigid cables."""
        r, (viscous, dry) = self.pulleys.motor_pulley_radius[i], self._losses("motor", i)
        arms = [self.pulleys.joint_pulley_radius[k] * (1.0 + self._ratio_error(i, k)) / r for k in range(i + 1)]
        joints = [_tag("joint", joint=f"joint_{k + 1}", coef=arm) for k, arm in enumerate(arms)]
        armature = self._rotor(i) * r**2
        return _tag("fixed", *joints, name=f"motor_{i + 1}", armature=armature, damping=viscous, frictionloss=dry)

    def _actuators(self, i: int) -> list[str]:
        if self.cables[i].elastic:
            return [_tag("motor", name=f"motor_{i + 1}", joint=f"motor_{i + 1}")]
        return [
            _tag("motor", tendon=f"cable_{i + 1}_{side}", name=f"cable_{i + 1}_{side}") for side in ("upper", "lower")
        ]
