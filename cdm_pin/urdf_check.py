"""A generated URDF read back with two independent readers and held against the manipulator it was made from."""

from __future__ import annotations

import io
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from .errors import ManipulatorError
from .geometry import Link, Manipulator, Vector
from .routing import joint_limits, rotation_from_rpy
from .transmission import motor_from_joint
from .urdf import parse_robot, read_transmissions


def urdf_deviation(text: str, manipulator: Manipulator) -> dict[str, float]:
    """Read a URDF back and give the largest difference to the manipulator it was made from, per reader.

    Compared are masses, centres of mass, inertias, joint frames, axes, limits, and the motor/joint map.

    Parameters
    ----------
    text : str
        As `cdm_pin.urdf.generate_urdf` writes it.
    manipulator : Manipulator

    Returns
    -------
    dict of str to float
        ``{"pinocchio": ..., "yourdfpy": ..., "transmissions": ...}``, in SI units.

    Raises
    ------
    ManipulatorError
        If links or joints are not even the same.
    """
    assert manipulator.pulleys is not None
    n = len(manipulator.links)
    joints = tuple(f"joint_{i + 1}" for i in range(n))
    limits = joint_limits(manipulator.links, manipulator.pulleys)
    expected = np.array([[*_link_numbers(link), *limits[i]] for i, link in enumerate(manipulator.links)])
    result = {}
    for reader, found in (("pinocchio", _with_pinocchio(text)), ("yourdfpy", _with_yourdfpy(text))):
        names, numbers = zip(*found, strict=True)
        if names != joints:
            raise ManipulatorError(f"{reader} finds joints {', '.join(names)}; expected {', '.join(joints)}")
        result[reader] = float(np.max(np.abs(np.array(numbers) - expected)))
    E = read_transmissions(parse_robot(text), joints)
    result["transmissions"] = float(np.max(np.abs(E - motor_from_joint(manipulator.pulleys))))
    return result


def _link_numbers(link: Link) -> Vector:
    rotation = rotation_from_rpy(link.origin_rpy)
    return _row(link.mass, link.center_of_mass, link.inertia, link.origin_xyz, rotation, link.axis)


def _with_pinocchio(text: str) -> Iterator[tuple[str, Vector]]:
    model = pin.buildModelFromXML(text)
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for i, name in enumerate(model.names[1:], start=1):
        body, frame, joint = model.inertias[i], model.jointPlacements[i], model.joints[i]
        axis = np.reshape(pin.getJointJacobian(model, data, i, pin.LOCAL), (6, -1))[3:, joint.idx_v]
        limits = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        yield name, _row(body.mass, body.lever, body.inertia, frame.translation, frame.rotation, axis, limits)


def _with_yourdfpy(text: str) -> Iterator[tuple[str, Vector]]:
    from yourdfpy import URDF  # slow to import

    robot = URDF.load(io.BytesIO(text.encode()), build_scene_graph=False, load_meshes=False).robot
    bodies = {link.name: link.inertial for link in robot.links}
    for joint in robot.joints:
        body, frame, limit = bodies[joint.child], joint.origin, joint.limit
        assert body is not None and body.origin is not None and frame is not None and limit is not None
        limits = limit.lower, limit.upper
        centre = body.origin[:3, 3]
        yield joint.name, _row(body.mass, centre, body.inertia, frame[:3, 3], frame[:3, :3], joint.axis, limits)


def _row(*pieces) -> Vector:
    return np.concatenate([np.ravel(piece) for piece in pieces])
