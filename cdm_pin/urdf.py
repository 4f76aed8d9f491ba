"""A URDF from a manipulator, and a URDF read: same geometry, same bytes.

Inputs are written exactly as given, computed numbers rounded to 12 decimals: every machine writes the same bytes.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from .errors import ManipulatorError
from .files import read_text
from .geometry import Link, Manipulator, Vector
from .routing import joint_limits
from .transmission import joint_from_motor, motor_from_joint
from .urdf_visuals import add_materials, add_visuals

BASE = "base"
UNLIMITED_EFFORT = 1000.0  # [N m], where motors state no torque limit: URDF demands a number
UNLIMITED_VELOCITY = 100.0  # [rad/s], likewise
MOVING = ("revolute", "continuous", "prismatic")


def generate_urdf(manipulator: Manipulator) -> str:
    """Write the URDF of a manipulator that is given by its links.

    Masses, full inertias, joint frames; joint limits from the mechanism (Figure 3) and from the motors; visuals of
    links, pulleys and motors; one transmission per cable. The base has visuals but no mass.

    Parameters
    ----------
    manipulator : Manipulator
        With `links` and `pulleys`.

    Returns
    -------
    str

    Raises
    ------
    ManipulatorError
        If the manipulator is itself given by a URDF, or a link is called like the base.
    """
    pulleys = manipulator.pulleys
    if not manipulator.links or pulleys is None:
        raise ManipulatorError("is given by a URDF already, links and pulleys were expected", source=manipulator.source)
    if any(link.name == BASE for link in manipulator.links):
        raise ManipulatorError(f"no link may be called {BASE!r}, the fixed link's name", source=manipulator.source)
    robot = Element("robot", name=manipulator.name)
    add_materials(robot, len(manipulator.links))
    elements = [SubElement(robot, "link", name=BASE)]
    elements += [_write_link(robot, link) for link in manipulator.links]
    add_visuals(elements, manipulator.links, pulleys)
    limits = np.column_stack([joint_limits(manipulator.links, pulleys), _motor_limits(manipulator)])
    for i, link in enumerate(manipulator.links):
        _write_joint(robot, f"joint_{i + 1}", manipulator.links[i - 1].name if i else BASE, link, limits[i])
    _write_transmissions(robot, motor_from_joint(pulleys))
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _write_link(robot: Element, link: Link) -> Element:
    element = SubElement(robot, "link", name=link.name)
    inertial = SubElement(element, "inertial")
    SubElement(inertial, "origin", xyz=_text(link.center_of_mass), rpy="0 0 0")
    SubElement(inertial, "mass", value=_text([link.mass]))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = link.inertia
    values = {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz}
    SubElement(inertial, "inertia", {name: _text([value]) for name, value in values.items()})
    return element


def _write_joint(robot: Element, name: str, parent: str, link: Link, limits: Vector) -> None:
    joint = SubElement(robot, "joint", name=name, type="revolute")
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=link.name)
    SubElement(joint, "origin", xyz=_text(link.origin_xyz), rpy=_text(link.origin_rpy))
    SubElement(joint, "axis", xyz=_text(link.axis))
    names = ("lower", "upper", "effort", "velocity")
    SubElement(joint, "limit", {key: _text([round(value, 12)]) for key, value in zip(names, limits, strict=True)})


def _write_transmissions(robot: Element, motor_from_joint: Vector) -> None:
    """Motor i turns by the sum of its joints' angles, each times its mechanicalReduction."""
    for i, row in enumerate(motor_from_joint):
        transmission = SubElement(robot, "transmission", name=f"cable_{i + 1}")
        SubElement(transmission, "type").text = "cdm_pin/CableTransmission"
        for k, ratio in enumerate(row):
            if ratio:
                joint = SubElement(transmission, "joint", name=f"joint_{k + 1}")
                SubElement(joint, "hardwareInterface").text = "hardware_interface/EffortJointInterface"
                SubElement(joint, "mechanicalReduction").text = _text([round(ratio, 12)])
        actuator = SubElement(transmission, "actuator", name=f"motor_{i + 1}")
        SubElement(actuator, "mechanicalReduction").text = "1.0"


def _motor_limits(manipulator: Manipulator) -> Vector:
    """Largest joint torque and velocity that the motors together can make, shape (n_joints, 2)."""
    assert manipulator.pulleys is not None
    n = len(manipulator.links)
    effort, velocity = np.full(n, UNLIMITED_EFFORT), np.full(n, UNLIMITED_VELOCITY)
    torques = [motor.torque_limit for motor in manipulator.motors]
    if torques and None not in torques:
        effort = np.abs(motor_from_joint(manipulator.pulleys).T) @ np.array(torques, dtype=float)
    speeds = [motor.velocity_limit for motor in manipulator.motors]
    if speeds and None not in speeds:
        velocity = np.abs(joint_from_motor(manipulator.pulleys)) @ np.array(speeds, dtype=float)
    return np.column_stack([effort, velocity])


def _text(values: Iterable[float]) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)


def read_urdf(path: str | os.PathLike[str]) -> pin.Model:
    """Read a URDF into a Pinocchio model; mimic tags are ignored.

    Raises
    ------
    ManipulatorError
        If the file is not the description of a robot on a fixed base, or gives a body a negative mass.
    """
    text = read_text(path, ManipulatorError)
    robot = parse_robot(text, path)
    for joint in robot.findall("joint"):
        if joint.get("type") in ("floating", "planar"):
            raise ManipulatorError(
                f"a {joint.get('type')} joint cannot be driven by motors; robots on a fixed base were expected",
                source=path,
                place=f"joint {joint.get('name')}",
            )
    return _pinocchio_model(text, path)


def moving_joints(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Names of the joints of a URDF that move, in document order."""
    robot = parse_robot(read_text(path, ManipulatorError), path)
    return tuple(joint.get("name", "") for joint in robot.findall("joint") if joint.get("type") in MOVING)


def parse_robot(text: str, source: str | os.PathLike[str] | None = None) -> Element:
    """Parse a URDF's XML.

    Raises
    ------
    ManipulatorError
        If it is not XML or its root is not a robot.
    """
    try:
        robot = ElementTree.fromstring(text)
    except ElementTree.ParseError as exc:
        line, column = exc.position
        raise ManipulatorError("is not XML", source=source, place=f"line {line}, column {column}") from None
    if robot.tag != "robot":
        raise ManipulatorError(f"is not a robot description (its root is <{robot.tag}>)", source=source)
    return robot


def _pinocchio_model(text: str, path: str | os.PathLike[str]) -> pin.Model:
    with _native_errors() as errors:
        try:
            model = pin.buildModelFromXML(text)
        except (ValueError, RuntimeError) as exc:
            reason = next(iter(errors()), None) or (str(exc).strip().splitlines() or ["Pinocchio refuses it"])[0]
            raise ManipulatorError(f"is not a robot description ({reason})", source=path) from None
        for reason in errors():
            if "nertia" in reason:  # otherwise the body would silently weigh nothing
                raise ManipulatorError(f"has an unreadable body ({reason})", source=path)
    for name, inertia in zip(model.names, model.inertias, strict=True):
        if inertia.mass < 0.0:
            raise ManipulatorError(
                f"the body moved by joint {name!r} has a negative mass ({inertia.mass:g} kg)", source=path
            )
    return model


@contextmanager
def _native_errors() -> Iterator:
    """Keep the URDF parser's own messages off the terminal; give a function that lists those so far."""
    sys.stderr.flush()
    keep = os.dup(2)
    with tempfile.TemporaryFile() as sink:

        def lines() -> list[str]:
            sink.seek(0)
            text = sink.read().decode(errors="replace").splitlines()
            return [line.removeprefix("Error:").strip() for line in text if line.startswith("Error:")]

        os.dup2(sink.fileno(), 2)
        try:
            yield lines
        finally:
            os.dup2(keep, 2)
            os.close(keep)


def read_transmissions(robot: Element, joints: tuple[str, ...]) -> Vector:
    """Read the motor/joint map that `generate_urdf` writes, shape (n_motors, n_joints): q_m = map @ q."""
    rows = []
    for transmission in robot.findall("transmission"):
        row = np.zeros(len(joints))
        for joint in transmission.findall("joint"):
            row[joints.index(joint.get("name", ""))] = float(joint.findtext("mechanicalReduction", "nan"))
        rows.append(row)
    return np.array(rows)
