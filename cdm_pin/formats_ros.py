"""JointState messages out of ROS 1 bags, ROS 2 bags (sqlite or MCAP) and single MCAP or db3 files.

Every joint `name` of the messages gives columns `name.position`, `name.velocity`, `name.effort`, as far as the messages
fill them; time is the header's stamp, counted from the first one. Names that are known to be joints or motors become
our columns `joint_position_i`, `joint_velocity_i`, `joint_torque_i`, or `motor_...`. Known are, in this order:

1. the lists `joints` and `motors` of a recording.yaml;
2. the names of the model's joints, and of its motors where they differ from those, if all of them are in the messages;
3. otherwise the message's own names, in its own order, as joints 1, 2, ...
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from .errors import RecordingError, nearest
from .formats import Pick, Table, bare_suffix, read_bytes

JOINT_STATE = "sensor_msgs/msg/JointState"
BAG_SUFFIXES = (".bag", ".mcap", ".db3")
FIELDS = {"position": "position", "velocity": "velocity", "effort": "torque"}


class Names(Protocol):
    """What tells joints from motors: a layout or a model."""

    @property
    def joints(self) -> Sequence[str]:
        """Names of the rows of E."""
        ...

    @property
    def motors(self) -> Sequence[str]:
        """Names of the columns of E."""
        ...


def is_bag(path: Path) -> bool:
    """Tell whether a path is a ROS bag: a folder, or by its suffix."""
    return path.is_dir() or bare_suffix(path) in BAG_SUFFIXES


def read_bag(path: Path, pick: Pick, layout: Names, model: Names | None, topic: str | None, mapped: bool) -> Table:
    """Read the JointState messages of a bag.

    Parameters
    ----------
    path : Path
        A .bag, .mcap or .db3 file (or one of these with .gz), or the folder of a ROS 2 bag.
    pick : callable
        Chooses the columns.
    layout : object with `joints` and `motors`
        Names given by a recording.yaml; may be empty.
    model : object with `joints` and `motors`, optional
        Where the layout gives none.
    topic : str or None
        The topic to read; may be None if there is only one with JointState.
    mapped : bool
        Whether a recording.yaml maps the columns itself: they then keep the messages' names.

    Raises
    ------
    RecordingError
        If it is not a whole bag, has no or several such topics, or its messages disagree in their names or lengths.
    """
    if path.is_dir() and not (path / "metadata.yaml").exists():
        raise RecordingError("is a folder without metadata.yaml: neither a recording nor a ROS 2 bag", source=path)
    with tempfile.TemporaryDirectory() as folder:
        file = path
        if not path.is_dir():
            data = read_bytes(path)
            if path.suffix.lower() == ".gz":
                file = Path(folder) / path.with_suffix("").name
                file.write_bytes(data)
        try:
            times, messages = _read_messages(file, path, topic)
        except RecordingError:
            raise
        except Exception as exc:  # the reader meets damaged bytes with whatever its parsers raise
            detail = str(exc).splitlines()[0] if str(exc) else type(exc).__name__
            raise RecordingError(f"is not a whole ROS bag; truncated? ({detail})", source=path) from None
    if not messages:
        raise RecordingError(f"holds no {JOINT_STATE} messages", source=path)
    return _table(times, messages, path, pick, *((layout, model) if not mapped else (None, None)))


def _read_messages(file: Path, path: Path, topic: str | None) -> tuple[list[tuple[int, int]], list[Any]]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    times, messages = [], []
    with AnyReader([file], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        connections = [c for c in reader.connections if c.msgtype == JOINT_STATE]
        topics = sorted({c.topic for c in connections})
        if topic is None and len(topics) > 1:
            message = f"has JointState on {', '.join(topics)}: name one as `topic` in a recording.yaml"
            raise RecordingError(message, source=path)
        if topic is not None and topic not in topics:
            found = f"; JointState is on {', '.join(topics)}" if topics else ""
            raise RecordingError(f"has no JointState on topic {topic!r}{found}", source=path)
        connections = [c for c in connections if topic in (None, c.topic)]
        for connection, received, raw in reader.messages(connections) if connections else ():
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            times.append((int(stamp.sec) * 10**9 + int(stamp.nanosec), int(received)))
            messages.append(message)
    return times, messages


def _table(
    times: list[tuple[int, int]], messages: list[Any], path: Path, pick: Pick, layout: Names | None, model: Names | None
) -> Table:
    names = list(messages[0].name)
    columns: dict[str, np.ndarray] = {}
    notices = []
    order = [_order(list(m.name), names, k, path) for k, m in enumerate(messages)]
    for message_field in FIELDS:
        rows = [getattr(m, message_field) for m in messages]
        filled = [len(row) > 0 for row in rows]
        if not any(filled):
            continue
        bad = next((k for k, row in enumerate(rows) if len(row) != len(messages[k].name)), None)
        if bad is not None:
            found = f"{len(rows[bad])} values of {message_field} for {len(messages[bad].name)} names"
            raise RecordingError(f"{found}; all messages must agree", source=path, place=f"message {bad + 1}")
        values = np.array([np.asarray(row, float)[o] for row, o in zip(rows, order, strict=True)])
        if np.isnan(values).all():
            notices.append(f"{message_field} is NaN in all messages: left out")
            continue
        columns |= {f"{name}.{message_field}": values[:, j] for j, name in enumerate(names)}
    columns = _renamed(columns, names, layout, model, path, notices)
    stamps = np.array(times, dtype=np.int64)
    stamped = bool(np.any(stamps[:, 0]))
    if not stamped:
        notices.append("the headers carry no stamps: times of receipt taken")
    clock = stamps[:, 0 if stamped else 1]
    if clock[0] != 0:
        notices.append(f"time counts from the first stamp, {clock[0] // 10**9}.{clock[0] % 10**9:09d} s")
    columns = {"time": (clock - clock[0]) / 1e9, **columns}
    picked = pick(list(columns))
    return Table({n: columns[n] for n in picked}, place=lambda row: f"message {row + 1}", notices=tuple(notices))


def _order(found: list[str], names: list[str], k: int, path: Path) -> list[int]:
    if len(set(found)) != len(found) or set(found) != set(names):
        message = f"names {', '.join(found)}, the first message has {', '.join(names)}"
        raise RecordingError(message, source=path, place=f"message {k + 1}")
    return [found.index(name) for name in names]


def _renamed(
    columns: dict[str, np.ndarray],
    names: list[str],
    layout: Names | None,
    model: Names | None,
    path: Path,
    notices: list[str],
) -> dict[str, np.ndarray]:
    if layout is None:
        return columns
    joints, motors = list(layout.joints), list(layout.motors)
    for name in (*joints, *motors):
        if name not in names:
            message = f"no joint {name!r} in the messages (they name {', '.join(names)}){nearest(name, names)}"
            raise RecordingError(message, source=path)
    if not joints and not motors and model is not None:
        joints = list(model.joints) if set(model.joints) <= set(names) else []
        others = set(model.motors) <= set(names) - set(joints)
        motors = list(model.motors) if others else []
    if not joints and not motors:
        joints = names
        notices.append(f"joints 1 to {len(names)} are {', '.join(names)}, in the messages' order")
    targets = {name: f"joint_{{}}_{i}" for i, name in enumerate(joints, 1)}
    targets |= {name: f"motor_{{}}_{i}" for i, name in enumerate(motors, 1)}
    renamed = {}
    for key, x in columns.items():
        name, _, message_field = key.rpartition(".")
        renamed[targets[name].format(FIELDS[message_field]) if name in targets else key] = x
    return renamed
