"""Units where coordinates slide instead of turning: N for N m, m for rad."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from .model import CableModel

TURNING = ("phase", "angle")
"""Parameters that are angles wherever they sit."""


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
    if name in TURNING or not _slides(model, location):
        return unit
    return unit.replace("N m", "N").replace("kg m^2", "kg").replace("rad", "m")


def motor_units(model: CableModel, torque: bool) -> tuple[str, ...]:
    """Give the unit of each motor's torque, or of its position."""
    turning, sliding = ("N m", "N") if torque else ("rad", "m")
    return tuple(sliding if linear else turning for linear in model.linear_motors)


def _slides(model: CableModel, location: Mapping[str, Any]) -> bool:
    kind, index = location.get("kind"), int(location.get("index") or 0) - 1
    if kind == "joint":
        return bool(model.chain.prismatic[index])
    if kind in ("motor", "cable"):
        return bool(model.linear_motors[index])
    if kind == "combination":
        own = [bool(slides) for w, slides in zip(location["weights"], model.linear_motors, strict=True) if w]
        return bool(own) and all(own)
    return False


def either(units: Iterable[str]) -> str:
    """Name units that stand in one table: ``"N m or N"``."""
    return " or ".join(dict.fromkeys(map(str, units)))
