"""Units where coordinates slide instead of turning: N for N m, m for rad."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from .model import CableModel


def unit_at(model: CableModel, location: Mapping[str, Any], unit: str, name: str = "") -> str:
    """Give the unit of a parameter at its place.

    Parameters
    ----------
    model : CableModel
    location : mapping
        Where it sits, as in a diagnosis.
    unit : str
        At a coordinate that turns.
    name : str
        Of the parameter; a phase is an angle everywhere.

    Returns
    -------
    str
        The same unit, or that at a coordinate that slides: ``"N m s/rad"`` becomes ``"N s/m"``.
    """
    if name == "phase" or not _slides(model, location):
        return unit
    if name == "coefficient" and unit == "m":  # torque per load: force per load
        return "1"
    return unit.replace("N m", "N").replace("kg m^2", "kg").replace("rad", "m")


def motor_units(model: CableModel, torque: bool) -> tuple[str, ...]:
    """Give the unit of each motor's torque, or of its position."""
    turning, sliding = ("N m", "N") if torque else ("rad", "m")
    return tuple(sliding if linear else turning for linear in model.linear_motors)


def joint_units(model: CableModel) -> tuple[str, ...]:
    """Give the unit of each joint's position."""
    return tuple("m" if slides else "rad" for slides in model.chain.prismatic)


def _slides(model: CableModel, location: Mapping[str, Any]) -> bool:
    kind, index = location.get("kind"), int(location.get("index") or 0) - 1
    if kind == "joint":
        return bool(model.chain.prismatic[index])
    if kind in ("motor", "cable"):
        return bool(model.linear_motors[index])
    if kind == "combination" and "weights" in location:
        own = [bool(slides) for w, slides in zip(location["weights"], model.linear_motors, strict=True) if w]
        return bool(own) and all(own)
    return False


def either(units: Iterable[str]) -> str:
    """Name units that stand in one table: ``"N m or N"``."""
    return " or ".join(dict.fromkeys(map(str, units)))
