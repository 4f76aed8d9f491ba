"""Motion and torque on both sides of the transmission, from what was logged on one of them."""

from __future__ import annotations

from collections.abc import Mapping

from .geometry import Vector
from .model import CableModel


def both_positions(model: CableModel, logged: Mapping[str, Vector]) -> tuple[Vector, Vector]:
    """Give joint and motor positions as logged; the side that was not logged follows by E."""
    if "joint_position" in logged:
        q = logged["joint_position"]
        return q, logged.get("motor_position", model.motor_position(q))
    return model.joint_position(logged["motor_position"]), logged["motor_position"]


def measured_torques(model: CableModel, logged: Mapping[str, Vector]) -> Vector:
    """Give the motor torques as logged, or as they follow from the joint torques by E."""
    return logged["motor_torque"] if "motor_torque" in logged else model.motor_torque(logged["joint_torque"])
