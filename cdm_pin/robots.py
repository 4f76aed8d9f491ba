"""The robot descriptions of the example-robot-data package, found by path (its wheel has no Python loader)."""

from __future__ import annotations

import sys
from pathlib import Path

from .errors import InputError, nearest

_FOLDER = Path("share", "example-robot-data", "robots")


def robot_folder() -> Path:
    """Give the folder that holds one folder per robot.

    Raises
    ------
    InputError
        If the package is not installed.
    """
    for entry in sys.path:
        for prefix in (Path(entry) / "cmeel.prefix", *Path(entry).parents):
            if (prefix / _FOLDER).is_dir():
                return prefix / _FOLDER
    raise InputError("the package example-robot-data is not installed (pip install example-robot-data)")


def robot_urdfs() -> dict[str, Path]:
    """Give every URDF of the package by its file name without suffix (``ur5_robot``, ``panda``, ...), sorted."""
    return {path.stem: path for path in sorted(robot_folder().rglob("*.urdf"), key=lambda path: path.stem)}


def robot_urdf(name: str) -> Path:
    """Give one URDF by name.

    Raises
    ------
    InputError
        If there is none of that name; the nearest one is named.
    """
    urdfs = robot_urdfs()
    if name not in urdfs:
        raise InputError(f"no robot {name!r} in example-robot-data{nearest(name, urdfs)}")
    return urdfs[name]
