"""Read and write manipulator.yaml and model.yaml."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from .errors import GeometryError, ManipulatorError
from .files import check_keys, read_yaml, write_text
from .geometry import Link, Manipulator, Motor, Pulleys, Transmission, Vector, frozen_array
from .routing import route

_COMMON = ("name", "gravity", "motors", "effects", "base_parameters")
_LINK_KEYS = ("name", "length", "mass", "center_of_mass", "inertia", "origin", "axis")
_PULLEY_KEYS = (
    "joint_pulley_radius",
    "motor_pulley_radius",
    "link_pulley_radius",
    "link_pulley_offset",
    "link_pulley_distance",
)
_MOTOR_KEYS = ("rotor_inertia", "torque_limit", "velocity_limit")


def load_manipulator(path: str | os.PathLike[str]) -> Manipulator:
    """Read a manipulator file or a model file and check that it can describe a robot.

    Parameters
    ----------
    path : path-like
        A YAML file; either `links` and `pulleys`, or `urdf` with an optional `transmission`.

    Returns
    -------
    Manipulator

    Raises
    ------
    ManipulatorError, GeometryError
        Naming file and key, on anything that is unknown, missing, or physically impossible.
    """
    content = read_yaml(path, ManipulatorError)
    try:
        return parse_manipulator(content, Path(path))
    except (ManipulatorError, GeometryError) as exc:
        raise type(exc)(exc.message, source=path, place=exc.place) from None


def parse_manipulator(content: Mapping[str, Any], source: Path | None = None) -> Manipulator:
    """Make a `Manipulator` of the content of its file (see `load_manipulator`)."""
    own = ("urdf", "transmission") if "urdf" in content else ("links", "pulleys", "pretension")
    check_keys(content, _COMMON + own, error=ManipulatorError)
    common: dict[str, Any] = {
        "name": str(content.get("name", source.stem if source else "manipulator")),
        "motors": _motors(content.get("motors")),
        "effects": tuple(_records(content, "effects", ("effect", "location", "parameters"))),
        "base_parameters": tuple(_records(content, "base_parameters", ("name", "value", "std"))),
        "source": source,
    }
    if "urdf" in content:
        if not isinstance(content["urdf"], str):
            raise ManipulatorError(f"a path was expected, found {content['urdf']!r}", place="urdf")
        folder = source.parent if source else Path()
        gravity = _vector(content.get("gravity", [0.0, 0.0, -9.81]), 3, "gravity")
        return Manipulator(
            gravity=gravity, urdf=folder / content["urdf"], transmission=_transmission(content), **common
        )
    check_keys(content, _COMMON + own, required=("gravity", "links", "pulleys"), error=ManipulatorError)
    links = _links(content["links"])
    pulleys = _pulleys(content["pulleys"], len(links))
    if common["motors"] and len(common["motors"]) != len(links):
        raise ManipulatorError(f"{len(links)} motors were expected, found {len(common['motors'])}", place="motors")
    _check_reach(links, pulleys)
    return Manipulator(
        gravity=_vector(content["gravity"], 3, "gravity"),
        links=links,
        pulleys=pulleys,
        pretension=_number(content["pretension"], "pretension", at_least=0.0) if "pretension" in content else None,
        **common,
    )


def manipulator_content(manipulator: Manipulator, folder: Path | None = None) -> dict[str, Any]:
    """Give the file content of `manipulator`, the inverse of `parse_manipulator`.

    Parameters
    ----------
    manipulator : Manipulator
    folder : Path, optional
        Where the file will stand; the URDF's path is written relative to it.
    """
    m = manipulator
    content: dict[str, Any] = {"name": m.name, "gravity": m.gravity.tolist()}
    if m.urdf is not None:
        content["urdf"] = os.path.relpath(m.urdf, folder) if folder else str(m.urdf)
        if m.transmission is not None:
            content["transmission"] = {
                "joints": list(m.transmission.joints),
                "motors": list(m.transmission.motors),
                "joint_from_motor": m.transmission.joint_from_motor.tolist(),
                "offset": m.transmission.offset.tolist(),
            }
    else:
        content["links"] = [_link_content(link, i, m.links) for i, link in enumerate(m.links)]
        assert m.pulleys is not None
        content["pulleys"] = {
            key: value.tolist() if isinstance(value := getattr(m.pulleys, key), np.ndarray) else value
            for key in _PULLEY_KEYS
        }
        if m.pretension is not None:
            content["pretension"] = m.pretension
    if m.motors:
        content["motors"] = [
            {key: value for key in _MOTOR_KEYS if (value := getattr(motor, key)) is not None} for motor in m.motors
        ]
    if m.effects:
        content["effects"] = list(m.effects)
    if m.base_parameters:
        content["base_parameters"] = list(m.base_parameters)
    return content


def save_manipulator(manipulator: Manipulator, path: str | os.PathLike[str], folder: Path | None = None) -> None:
    """Write `manipulator` as YAML, whole or not at all.

    Parameters
    ----------
    manipulator : Manipulator
    path : path-like
    folder : Path, optional
        Where the file will finally stand, if not where it is written.
    """
    content = manipulator_content(manipulator, folder or Path(path).parent)
    write_text(path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110))


def with_effects(manipulator: Manipulator, effects: tuple[dict[str, Any], ...]) -> Manipulator:
    """Give the same manipulator with these effects."""
    return replace(manipulator, effects=effects)


def _link_content(link: Link, i: int, links: tuple[Link, ...]) -> dict[str, Any]:
    inertia = link.inertia
    full = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    content: dict[str, Any] = {
        "name": link.name,
        **({"length": link.length} if link.length else {}),
        "mass": link.mass,
        "center_of_mass": link.center_of_mass.tolist(),
        "inertia": [float(value) for value in (full if any(full[3:]) else full[:3])],
    }
    default = [links[i - 1].length if i else 0.0, 0.0, 0.0]
    stated = i > 0 and not links[i - 1].length
    if stated or not np.array_equal(link.origin_xyz, default) or link.origin_rpy.any():
        content["origin"] = {"xyz": link.origin_xyz.tolist(), "rpy": link.origin_rpy.tolist()}
    if not np.array_equal(link.axis, [0.0, 0.0, 1.0]):
        content["axis"] = link.axis.tolist()
    return content


def _links(items: Any) -> tuple[Link, ...]:
    if not isinstance(items, list) or not items:
        raise ManipulatorError(f"a list of links was expected, found {items!r}", place="links")
    links: list[Link] = []
    for i, item in enumerate(items):
        place = f"links[{i + 1}]"
        check_keys(item, _LINK_KEYS, required=("mass", "inertia"), place=place, error=ManipulatorError)
        if "length" not in item and "origin" not in (items[i + 1] if i + 1 < len(items) else {"origin": 0}):
            raise ManipulatorError("key 'length' is missing", place=place)
        length = _number(item["length"], f"{place}.length", above=0.0) if "length" in item else 0.0
        origin = item.get("origin", {})
        check_keys(origin, ("xyz", "rpy"), place=f"{place}.origin", error=ManipulatorError)
        default_xyz = [links[-1].length if links else 0.0, 0.0, 0.0]
        axis = _vector(item.get("axis", [0.0, 0.0, 1.0]), 3, f"{place}.axis")
        if np.linalg.norm(axis) < 1e-9:
            raise ManipulatorError("a joint axis cannot be zero", place=f"{place}.axis")
        links.append(
            Link(
                name=str(item.get("name", f"link_{i + 1}")),
                length=length,
                mass=_number(item["mass"], f"{place}.mass", above=0.0),
                center_of_mass=_vector(
                    item.get("center_of_mass", [length / 2, 0.0, 0.0]), 3, f"{place}.center_of_mass"
                ),
                inertia=_inertia(item["inertia"], f"{place}.inertia"),
                axis=frozen_array(axis / np.linalg.norm(axis)),
                origin_xyz=_vector(origin.get("xyz", default_xyz), 3, f"{place}.origin.xyz"),
                origin_rpy=_vector(origin.get("rpy", [0.0, 0.0, 0.0]), 3, f"{place}.origin.rpy"),
            )
        )
    names = [link.name for link in links]
    for name in names:
        if names.count(name) > 1:
            raise ManipulatorError(f"two links are called {name!r}", place="links")
    return tuple(links)


def _inertia(values: Any, place: str) -> Vector:
    if not isinstance(values, list) or len(values) not in (3, 6):
        raise ManipulatorError(f"3 or 6 numbers were expected, found {values!r}", place=place)
    xx, yy, zz, xy, xz, yz = [_number(value, place) for value in values] + [0.0] * (6 - len(values))
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] <= 0.0:
        raise ManipulatorError(f"not positive definite: principal moments {_text(moments)} kg m^2", place=place)
    if moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
        raise ManipulatorError(
            f"breaks the triangle inequality: principal moments {_text(moments)} kg m^2, "
            "none may exceed the sum of the other two",
            place=place,
        )
    return frozen_array(inertia)


def _text(values: Vector) -> str:
    return ", ".join(f"{value:.4g}" for value in values)


def _pulleys(content: Any, n: int) -> Pulleys:
    check_keys(content, _PULLEY_KEYS, required=_PULLEY_KEYS, place="pulleys", error=ManipulatorError)
    radii: dict[str, Any] = {}
    for key, owner in (("joint_pulley_radius", "joint"), ("motor_pulley_radius", "motor")):
        value = content[key]
        if isinstance(value, list) and len(value) != n:
            raise ManipulatorError(
                f"a number or one per {owner} ({n}) was expected, found {len(value)}", place=f"pulleys.{key}"
            )
        values = value if isinstance(value, list) else [value] * n
        radii[key] = frozen_array([_number(v, f"pulleys.{key}", above=0.0) for v in values])
    lengths: dict[str, Any] = {key: _number(content[key], f"pulleys.{key}", above=0.0) for key in _PULLEY_KEYS[2:]}
    pulleys = Pulleys(**radii, **lengths)
    try:
        _ = pulleys.wrap_half_angle
    except GeometryError as exc:
        raise GeometryError(exc.message, place="pulleys") from None
    return pulleys


def _check_reach(links: tuple[Link, ...], pulleys: Pulleys) -> None:
    routing = route(links)
    for i, link in enumerate(links[:-1], start=1):
        if routing.frames[i] is not None and pulleys.link_pulley_distance > routing.length[i]:
            raise GeometryError(
                f"{pulleys.link_pulley_distance:g} m is longer than link {link.name!r} "
                f"({routing.length[i]:g} m): its link guide pulleys would lie beyond the next joint",
                place=f"pulleys.link_pulley_distance, links[{i}].length",
            )


def _motors(items: Any) -> tuple[Motor, ...]:
    if items is None:
        return ()
    if not isinstance(items, list):
        raise ManipulatorError(f"a list of motors was expected, found {items!r}", place="motors")
    motors = []
    for i, item in enumerate(items):
        place = f"motors[{i + 1}]"
        check_keys(item, _MOTOR_KEYS, place=place, error=ManipulatorError)
        values = {
            key: _number(value, f"{place}.{key}", **({"at_least": 0.0} if key == "rotor_inertia" else {"above": 0.0}))
            for key, value in item.items()
        }
        motors.append(Motor(**values))
    return tuple(motors)


def _transmission(content: Mapping[str, Any]) -> Transmission | None:
    if "transmission" not in content:
        return None
    item = content["transmission"]
    place = "transmission"
    check_keys(
        item,
        ("joints", "motors", "joint_from_motor", "offset"),
        required=("joints", "joint_from_motor"),
        place=place,
        error=ManipulatorError,
    )
    joints = _names(item["joints"], f"{place}.joints")
    rows = item["joint_from_motor"]
    if not isinstance(rows, list) or len(rows) != len(joints):
        found = len(rows) if isinstance(rows, list) else repr(rows)
        raise ManipulatorError(
            f"one row per joint ({len(joints)}) was expected, found {found}", place=f"{place}.joint_from_motor"
        )
    width = len(rows[0]) if isinstance(rows[0], list) else 0
    motors = _names(item.get("motors", [f"motor_{j + 1}" for j in range(width)]), f"{place}.motors")
    matrix = [_vector(row, len(motors), f"{place}.joint_from_motor[{i + 1}]") for i, row in enumerate(rows)]
    E = frozen_array(matrix)
    singular = np.linalg.svd(E, compute_uv=False)
    if E.shape[1] > E.shape[0] or singular[-1] < 1e-9 * singular[0]:
        raise ManipulatorError(
            f"singular: {E.shape[1]} motors move only {int(np.sum(singular > 1e-9 * singular[0]))} "
            "independent combinations of joints; the columns must be independent",
            place=f"{place}.joint_from_motor",
        )
    offset = _vector(item.get("offset", [0.0] * len(joints)), len(joints), f"{place}.offset")
    return Transmission(joints, motors, E, offset)


def _records(content: Mapping[str, Any], key: str, fields: tuple[str, ...]) -> list[dict[str, Any]]:
    items = content.get(key, [])
    if not isinstance(items, list):
        raise ManipulatorError(f"a list was expected, found {items!r}", place=key)
    for i, item in enumerate(items):
        check_keys(item, fields, required=fields[:2], place=f"{key}[{i + 1}]", error=ManipulatorError)
    return [dict(item) for item in items]


def _names(values: Any, place: str) -> tuple[str, ...]:
    if not isinstance(values, list) or not values or not all(isinstance(v, str) for v in values):
        raise ManipulatorError(f"a list of names was expected, found {values!r}", place=place)
    for value in values:
        if values.count(value) > 1:
            raise ManipulatorError(f"{value!r} is named twice", place=place)
    return tuple(values)


def _number(value: Any, place: str, *, above: float | None = None, at_least: float | None = None) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise ManipulatorError(f"a number was expected, found {value!r}", place=place)
    if above is not None and value <= above:
        raise ManipulatorError(f"must be above {above:g}, found {value:g}", place=place)
    if at_least is not None and value < at_least:
        raise ManipulatorError(f"must be at least {at_least:g}, found {value:g}", place=place)
    return float(value)


def _vector(values: Any, size: int, place: str) -> Vector:
    if not isinstance(values, list) or len(values) != size:
        found = f"{len(values)}" if isinstance(values, list) else repr(values)
        raise ManipulatorError(f"{size} numbers were expected, found {found}", place=place)
    return frozen_array([_number(value, f"{place}[{k + 1}]") for k, value in enumerate(values)])
