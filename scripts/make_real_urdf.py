"""Write URDF and manipulator file of every real robot from its table of frames in urdf/real/kinematics.

Usage: python scripts/make_real_urdf.py [TABLE ...] [-o FOLDER]

A table lists frames in modified Denavit-Hartenberg parameters (Craig): the frame is reached from its parent's by a turn
`alpha` about x, a shift `a` along x, a turn `theta` about z and a shift `d` along z (degrees and metres, default 0). A
frame turns about its z axis with `motors`, or slides along it with `slides`: weights of the motors in its joint
position, one row of E. A frame with neither is fixed. Without `mass` it is massless; `gyration` is a body's radius of
gyration, the same in all directions. The same table gives the same bytes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import yaml

from cdm_pin.errors import CdmError, InputError
from cdm_pin.files import check_keys, read_yaml, write_text

FOLDER = Path(__file__).resolve().parent.parent / "urdf" / "real"
TABLE_KEYS = ("name", "gravity", "motors", "frames")
FRAME_KEYS = ("name", "joint", "parent", "a", "alpha", "d", "theta", "motors", "slides", "limits")
BODY_KEYS = ("mass", "center_of_mass", "gyration")


def frame_pose(frame: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Give a frame's pose in its parent's: translation [m] and roll, pitch, yaw [rad], each shape (3,)."""
    alpha, theta = np.deg2rad(frame.get("alpha", 0.0)), np.deg2rad(frame.get("theta", 0.0))
    ca, sa, ct, st = _clean(np.array([np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)]))
    R = np.array([[ct, -st, 0.0], [ca * st, ca * ct, -sa], [sa * st, sa * ct, ca]])
    translation = np.array([frame.get("a", 0.0), 0.0, 0.0]) + frame.get("d", 0.0) * R[:, 2]
    return _clean(translation), roll_pitch_yaw(R)


def roll_pitch_yaw(R: np.ndarray) -> np.ndarray:
    """Give the angles of R = Rz(yaw) Ry(pitch) Rx(roll), shape (3,) [rad]; yaw is 0 where pitch is +-90 degrees."""
    if abs(R[2, 0]) > 1 - 1e-12:
        pitch = -np.sign(R[2, 0]) * np.pi / 2
        return np.array([np.arctan2(-R[2, 0] * R[0, 1], R[1, 1]), pitch, 0.0])
    roll, yaw = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(R[1, 0], R[0, 0])
    return np.array([roll, np.arcsin(-R[2, 0]), yaw])


def urdf_text(table: Mapping[str, Any]) -> str:
    """Write the URDF of a table of frames."""
    lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(table['name'])}>", '  <link name="base"/>']
    for frame in table["frames"]:
        lines += _link(frame) + _joint(frame)
    return "\n".join([*lines, "</robot>", ""])


def manipulator_content(table: Mapping[str, Any]) -> dict[str, Any]:
    """Give the manipulator file of a table of frames: one row of E per frame that moves."""
    moving = [frame for frame in table["frames"] if _weights(frame)]
    transmission = {
        "joints": [joint_name(frame) for frame in moving],
        "motors": list(table["motors"]),
        "joint_from_motor": [[float(_weights(frame).get(m, 0.0)) for m in table["motors"]] for frame in moving],
    }
    return {
        "name": table["name"],
        "gravity": [float(g) for g in table["gravity"]],
        "urdf": f"{table['name']}.urdf",
        "transmission": transmission,
    }


def joint_name(frame: Mapping[str, Any]) -> str:
    """Name the joint that carries a frame."""
    return frame.get("joint", f"{frame['name']}_joint")


def read_table(path: Path) -> dict[str, Any]:
    """Read a table of frames and check its words.

    Raises
    ------
    InputError
        On an unknown or missing key, parent or motor.
    """
    table = read_yaml(path)
    check_keys(table, TABLE_KEYS, required=TABLE_KEYS, source=path)
    known = {"base"}
    for i, frame in enumerate(table["frames"], 1):
        place = f"frames[{i}]"
        check_keys(frame, FRAME_KEYS + BODY_KEYS, required=("name",), source=path, place=place)
        if frame.get("parent", "base") not in known:
            raise InputError(f"{frame['parent']!r} is no frame above this one", source=path, place=f"{place}.parent")
        for motor in _weights(frame):
            if motor not in table["motors"]:
                raise InputError(f"unknown motor {motor!r}", source=path, place=place)
        if any(key in frame for key in BODY_KEYS):
            check_keys(frame, FRAME_KEYS + BODY_KEYS, required=BODY_KEYS, source=path, place=place)
        known.add(frame["name"])
    return table


def write_robot(path: Path, folder: Path) -> tuple[Path, Path]:
    """Write URDF and manipulator file of one table; give their paths."""
    table = read_table(path)
    urdf, manipulator = folder / f"{table['name']}.urdf", folder / f"{table['name']}.yaml"
    write_text(urdf, urdf_text(table))
    comment = f"# Written by scripts/make_real_urdf.py from kinematics/{path.name}, where the sources are named.\n"
    content = yaml.safe_dump(manipulator_content(table), sort_keys=False, default_flow_style=None, width=110)
    write_text(manipulator, comment + content)
    return urdf, manipulator


def _link(frame: Mapping[str, Any]) -> list[str]:
    name = quoteattr(frame["name"])
    if "mass" not in frame:
        return [f"  <link name={name}/>"]
    mass, moment = float(frame["mass"]), float(frame["mass"]) * float(frame["gyration"]) ** 2
    moment = float(f"{moment:.6g}")
    return [
        f"  <link name={name}>",
        "    <inertial>",
        f'      <origin xyz="{_numbers(frame["center_of_mass"])}" rpy="0 0 0"/>',
        f'      <mass value="{mass!r}"/>',
        f'      <inertia ixx="{moment!r}" ixy="0" ixz="0" iyy="{moment!r}" iyz="0" izz="{moment!r}"/>',
        "    </inertial>",
        "  </link>",
    ]


def _joint(frame: Mapping[str, Any]) -> list[str]:
    kind = "prismatic" if "slides" in frame else "revolute" if "motors" in frame else "fixed"
    xyz, rpy = frame_pose(frame)
    lines = [
        f"  <joint name={quoteattr(joint_name(frame))} type={quoteattr(kind)}>",
        f"    <parent link={quoteattr(frame.get('parent', 'base'))}/>",
        f"    <child link={quoteattr(frame['name'])}/>",
        f'    <origin xyz="{_numbers(xyz)}" rpy="{_numbers(rpy)}"/>',
    ]
    if kind != "fixed":
        lower, upper = frame.get("limits", [-100.0, 100.0])
        limits = f'lower="{float(lower)!r}" upper="{float(upper)!r}" effort="1000" velocity="100"'
        lines += ['    <axis xyz="0 0 1"/>', f"    <limit {limits}/>"]
    return [*lines, "  </joint>"]


def _weights(frame: Mapping[str, Any]) -> dict[str, float]:
    return frame.get("motors") or frame.get("slides") or {}


def _numbers(values) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)


def _clean(x: np.ndarray) -> np.ndarray:
    """Round off what is left of cosines of right angles, so that the same table gives the same bytes anywhere."""
    return np.round(x, 14) + 0.0


def main(arguments: list[str] | None = None) -> int:
    """Write all robots, or those whose tables are given."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tables", nargs="*", type=Path, help="tables of frames; default all of urdf/real/kinematics")
    parser.add_argument("-o", "--output", type=Path, default=FOLDER, help="folder to write to; default urdf/real")
    options = parser.parse_args(arguments)
    try:
        for path in options.tables or sorted((FOLDER / "kinematics").glob("*.yaml")):
            for written in write_robot(path, options.output):
                print(written)
    except CdmError as exc:
        print(f"make_real_urdf: {exc}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
