"""What the robot logged, untouched: the `Recording`, read from and written to files.

Columns are `time` and `<quantity>_<i>` with `i` from 1 (see `QUANTITIES`), in SI units and radians. Other names, units
and layouts are described by a recording.yaml (`cdm_pin.layout`), which stands wherever a recording is expected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from .columns import CABLE_QUANTITIES, JOINT_QUANTITIES, MOTOR_QUANTITIES, QUANTITIES, is_known_column, misspelt
from .errors import RecordingError, ShapeError
from .formats import FACTS, Table, write_table
from .layout import Layout, Source, names_in_file, read_layout


class Robot(Protocol):
    """What a recording is checked against: any model that names its joints and motors."""

    @property
    def joints(self) -> Sequence[str]:
        """Rows of E."""
        ...

    @property
    def motors(self) -> Sequence[str]:
        """Columns of E."""
        ...

    @property
    def joint_from_motor(self) -> np.ndarray:
        """E, shape (n_joints, n_motors)."""
        ...

    @property
    def motor_from_joint(self) -> np.ndarray:
        """Its pseudo-inverse."""
        ...


@dataclass(frozen=True)
class Recording:
    """What the robot logged; arrays are read-only copies.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Seconds, strictly as logged: may jitter, repeat and have gaps; never runs backwards when read from a file.
    channels : dict of str to ndarray, shape (n, width)
        By quantity, see `QUANTITIES`: rad, rad/s, rad/s^2, N m (m and N for linear joints), N for cable tensions.
        Joint quantities have one column per row of E, motor and cable quantities one per column of E.
    label : str
        What the user calls this recording.
    source : Path or None
        The file it came from.
    pretension : float or None
        Cable pretension per side [N], where the recording states it.
    payload : float or None
        Mass held [kg], where the recording states it.
    notices : tuple of str
        What was noticed on reading, such as columns left out.

    Raises
    ------
    ShapeError
        If a quantity is unknown or widths or lengths disagree.
    """

    time: np.ndarray
    channels: dict[str, np.ndarray]
    label: str = ""
    source: Path | None = None
    pretension: float | None = None
    payload: float | None = None
    notices: tuple[str, ...] = field(default=())

    def __post_init__(self):
        object.__setattr__(self, "time", _frozen(self.time))
        object.__setattr__(self, "channels", {name: _frozen(x) for name, x in self.channels.items()})
        if self.time.ndim != 1:
            raise ShapeError(f"time has shape {self.time.shape}, (n,) was expected")
        for name, x in self.channels.items():
            if name not in QUANTITIES:
                raise ShapeError(f"unknown quantity {name!r}; known: {', '.join(QUANTITIES)}")
            if x.ndim != 2 or len(x) != len(self.time):
                raise ShapeError(f"{name} has shape {x.shape}, ({len(self.time)}, width) was expected")
        for side in (JOINT_QUANTITIES, (*MOTOR_QUANTITIES, *CABLE_QUANTITIES)):
            widths = {name: self.channels[name].shape[1] for name in side if name in self.channels}
            if len(set(widths.values())) > 1:
                raise ShapeError(f"widths disagree: {', '.join(f'{n} has {w}' for n, w in widths.items())}")

    @property
    def n_samples(self) -> int:
        """Number of rows."""
        return len(self.time)

    @property
    def name(self) -> str:
        """The label, else the file's name, for messages and tables."""
        return self.label or (self.source.name if self.source else "recording")

    def width(self, side: str) -> int | None:
        """Count the joints (`side` "joint") or motors ("motor") recorded; None if that side is absent."""
        quantities = JOINT_QUANTITIES if side == "joint" else (*MOTOR_QUANTITIES, *CABLE_QUANTITIES)
        return next((x.shape[1] for name, x in self.channels.items() if name in quantities), None)


def _frozen(x: Any) -> np.ndarray:
    array = np.asarray(x, float)
    if array.flags.writeable:
        array = array.copy()
        array.setflags(write=False)
    return array


def load_recording(path: str | PathLike[str], model: Robot | None = None) -> Recording:
    """Read a recording from CSV, Parquet, npz, MATLAB, a ROS bag or MCAP with JointState, or a recording.yaml.

    Parameters
    ----------
    path : path-like
        File, or folder of a ROS 2 bag.
    model : optional
        A model with `joints` and `motors`: widths are checked against it, and JointState names are matched to its
        (`cdm_pin.formats_ros` says how).

    Raises
    ------
    RecordingError
        If the file cannot be read or contradicts itself or the model; says where in it and what was expected.
    """
    path = Path(path)
    layout = read_layout(path) if path.suffix.lower() in (".yaml", ".yml") else Layout(file=path)
    plan = _Plan(layout)
    table = layout.read(plan.pick, model)
    recording = _assemble(table, plan, layout)
    if model is not None:
        check_widths(recording, model)
    return recording


def save_recording(recording: Recording, path: str | PathLike[str]) -> None:
    """Write a recording whole or not at all, by suffix: .csv, .parquet, .npz, .mat, each also with .gz.

    Values come back bit for bit. Label, pretension and payload are kept by all but CSV.

    Raises
    ------
    RecordingError
        If the suffix names no format that can be written.
    """
    columns = {"time": recording.time}
    for name, x in recording.channels.items():
        columns |= {f"{name}_{j + 1}": x[:, j] for j in range(x.shape[1])}
    stated = {name: getattr(recording, name) for name in FACTS}
    write_table(columns, Path(path), {name: value for name, value in stated.items() if value not in (None, "")})


def check_widths(recording: Recording, model: Robot) -> None:
    """Hold the numbers of joints and motors recorded against a model's.

    Raises
    ------
    RecordingError
        If they disagree.
    """
    for side, expected in (("joint", len(model.joints)), ("motor", len(model.motors))):
        found = recording.width(side)
        if found is not None and found != expected:
            message = f"records {found} {side}(s), the robot has {expected}: is it a recording of another robot?"
            raise RecordingError(message, source=recording.source)


class _Plan:
    """Which column of the file becomes which column of the recording; filled when the file's names are known."""

    def __init__(self, layout: Layout):
        self.layout = layout
        self.sources: dict[str, Source] = {}
        self.ignored: list[str] = []

    def pick(self, names: Sequence[str]) -> list[str]:
        """Choose the columns to read.

        Raises
        ------
        RecordingError
            If a mapped column is absent, or a column looks like a misspelling of a known one.
        """
        self.sources = {target: s.resolve(names, self.layout.source) for target, s in self.layout.columns.items()}
        used = {source.column for source in self.sources.values()}
        for name in names:
            if name in used or name in FACTS:
                continue
            if is_known_column(name):
                self.sources.setdefault(name, Source(name))
            elif meant := misspelt(name, names):
                message = f"unknown column {name!r}; did you mean {meant!r}?"
                raise RecordingError(message, source=self.layout.file)
            else:
                self.ignored.append(name)
        return list(dict.fromkeys(source.column for source in self.sources.values()))

    @property
    def notices(self) -> tuple[str, ...]:
        """Say which columns were left out."""
        return (f"columns not used: {names_in_file(self.ignored)}",) if self.ignored else ()


def _assemble(table: Table, plan: _Plan, layout: Layout) -> Recording:
    source = layout.file
    columns = {target: s.apply(table.columns[s.column]) for target, s in plan.sources.items()}
    lengths = {target: len(x) for target, x in columns.items()}
    if len(set(lengths.values())) > 1:
        shortest, longest = min(lengths, key=lengths.__getitem__), max(lengths, key=lengths.__getitem__)
        found = f"{shortest} has {lengths[shortest]} rows, {longest} has {lengths[longest]}"
        raise RecordingError(f"{found}: one length was expected", source=source)
    if not any(target != "time" for target in columns):
        found = f"; found {names_in_file(plan.ignored)}" if plan.ignored else ""
        message = f"holds none of the known quantities ({', '.join(QUANTITIES)}, each with _1, _2, ...){found}"
        raise RecordingError(message, source=source)
    if not max(lengths.values()):
        raise RecordingError("has no rows of data", source=source)
    _check_finite(columns, plan, table, source)
    time = _clock(columns, layout, plan, max(lengths.values()))
    _check_clock(time, table, source)
    facts = table.facts | layout.facts
    recording = {"source": source, "notices": (*table.notices, *plan.notices), **facts}
    try:
        return Recording(time, _quantities(columns, source), **recording)
    except ShapeError as exc:
        raise RecordingError(str(exc), source=source) from None


def _quantities(columns: Mapping[str, np.ndarray], source: Path | None) -> dict[str, np.ndarray]:
    """Gather name_1 .. name_w into (n, w) arrays; a quantity is given for all joints or for none."""
    channels = {}
    for quantity in QUANTITIES:
        indices = [int(n.rpartition("_")[2]) for n in columns if n.rpartition("_")[0] == quantity]
        for i in range(1, max(indices, default=0) + 1):
            if i not in indices:
                message = f"column {quantity}_{i} is missing beside {quantity}_{max(indices)}"
                raise RecordingError(f"{message}: a quantity is given for all or for none", source=source)
        if indices:
            channels[quantity] = np.column_stack([columns[f"{quantity}_{i}"] for i in range(1, max(indices) + 1)])
            channels[quantity].setflags(write=False)
    return channels


def _check_finite(columns: Mapping[str, np.ndarray], plan: _Plan, table: Table, source: Path | None) -> None:
    bad = {target: int(np.argmin(ok)) for target, x in columns.items() if not (ok := np.isfinite(x)).all()}
    if bad:
        target = min(bad, key=bad.__getitem__)
        place = f"{table.place(bad[target])}, column {plan.sources[target].column}"
        found = f"{table.columns[plan.sources[target].column][bad[target]]} where a finite number was expected"
        raise RecordingError(found, source=source, place=place)


def _clock(columns: Mapping[str, np.ndarray], layout: Layout, plan: _Plan, n: int) -> np.ndarray:
    if "time" in columns:
        return columns["time"]
    if layout.rate is not None:
        return np.arange(n) / layout.rate
    found = f"; found {names_in_file(plan.ignored)}" if plan.ignored else ""
    message = f"column 'time' is missing{found}; give it, or `rate` in a recording.yaml"
    raise RecordingError(message, source=layout.file)


def _check_clock(time: np.ndarray, table: Table, source: Path | None) -> None:
    back = np.flatnonzero(np.diff(time) < 0)
    if len(back):
        row = int(back[0]) + 1
        message = f"time runs backwards, from {time[row - 1]!s} to {time[row]!s} s"
        raise RecordingError(message, source=source, place=f"{table.place(row)}, column time")
