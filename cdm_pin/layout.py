"""recording.yaml: where the columns of a recording stand in somebody else's files, and in which units.

Keys: `file` or `files` (name: .npy file), `header`, `comment`, `delimiter`, `rate` [Hz] where no time is logged,
`label`, `pretension` [N], `payload` [kg], and `columns`, which maps a column of ours to `{from, scale, offset}`: a name
or 1-based number in the file, multiplied by `scale`, plus `offset`. A whole quantity may be mapped at once:
`joint_position: {from: [1, 2, 3]}`, with one scale and offset or one per column. For bags and MCAP: `topic`, and
`joints` and `motors`, the JointState names of joints 1, 2, ... and motors 1, 2, ... (see `cdm_pin.formats_ros`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .columns import QUANTITIES, is_known_column
from .errors import RecordingError, nearest
from .files import check_keys, read_yaml
from .formats import FACTS, Pick, Table, TextLayout, bare_suffix, read_bytes, read_table, table_of_arrays
from .formats_ros import is_bag, read_bag

KEYS = ("file", "files", "header", "comment", "delimiter", "rate", *FACTS, "columns", "topic", "joints", "motors")


@dataclass(frozen=True)
class Source:
    """Where one column comes from: value = scale * (column of the file) + offset; the column by name or by number."""

    column: str
    scale: float = 1.0
    offset: float = 0.0
    number: int | None = None

    def resolve(self, names: Sequence[str], yaml: Path | None) -> Source:
        """Turn a 1-based column number into the column's name.

        Raises
        ------
        RecordingError
            If the file has no such column.
        """
        if self.number is None:
            if self.column not in names:
                message = f"the file has no column {self.column!r}{nearest(self.column, names)}"
                raise RecordingError(message, source=yaml, place="columns")
            return self
        if not 1 <= self.number <= len(names):
            message = f"the file has {len(names)} columns, not {self.number}"
            raise RecordingError(message, source=yaml, place="columns")
        return Source(names[self.number - 1], self.scale, self.offset)

    def apply(self, x: np.ndarray) -> np.ndarray:
        """Give the column in our unit; untouched, to the bit, where no scale or offset is stated."""
        return x if (self.scale, self.offset) == (1.0, 0.0) else self.scale * x + self.offset


@dataclass(frozen=True)
class Layout:
    """A recording.yaml read; of a plain file, all defaults."""

    file: Path
    source: Path | None = None
    files: dict[str, Path] = field(default_factory=dict)
    text: TextLayout = field(default_factory=TextLayout)
    rate: float | None = None
    facts: dict[str, Any] = field(default_factory=dict)
    columns: dict[str, Source] = field(default_factory=dict)
    topic: str | None = None
    joints: tuple[str, ...] = ()
    motors: tuple[str, ...] = ()

    def read(self, pick: Pick, model: Any = None) -> Table:
        """Read the picked columns of the file or files; a model's names tell joints from motors in ROS messages.

        Raises
        ------
        RecordingError
            If they cannot be read.
        """
        if self.files:
            return table_of_arrays({name: _read_npy(path) for name, path in self.files.items()}, self.file, pick)
        if is_bag(self.file):
            return read_bag(self.file, pick, self, model, self.topic, mapped=bool(self.columns))
        return read_table(self.file, pick, self.text)


def read_layout(path: Path) -> Layout:
    """Read a recording.yaml; paths in it are relative to it.

    Raises
    ------
    RecordingError
        On an unknown key or column, or a value of the wrong kind.
    """
    content = read_yaml(path, RecordingError)
    check_keys(content, KEYS, source=path, error=RecordingError)
    if ("file" in content) == ("files" in content):
        raise RecordingError("one of `file` and `files` was expected", source=path)
    check = _Checker(path)
    files = content.get("files", {})
    check(isinstance(files, Mapping), "files", files, "a mapping of names to .npy files")
    facts = {name: content[name] for name in FACTS if name in content}
    for name in ("pretension", "payload"):
        if name in facts:
            facts[name] = check.number(facts[name], name)
    facts |= {"label": str(facts["label"])} if "label" in facts else {}
    rate = check.number(content["rate"], "rate") if "rate" in content else None
    check(rate is None or rate > 0, "rate", rate, "a positive rate in Hz")
    header = content.get("header", True)
    check(isinstance(header, bool), "header", header, "true or false")
    text = TextLayout(header, str(content.get("comment", "#")), content.get("delimiter"))
    check(text.delimiter is None or len(str(text.delimiter)) == 1, "delimiter", text.delimiter, "one character")
    return Layout(
        file=path.parent / str(content["file"]) if "file" in content else path,
        source=path,
        files={str(name): path.parent / str(file) for name, file in files.items()},
        text=text,
        rate=rate,
        facts=facts,
        columns=_read_columns(content.get("columns", {}), check),
        topic=content.get("topic"),
        joints=check.names(content.get("joints", ()), "joints"),
        motors=check.names(content.get("motors", ()), "motors"),
    )


def names_in_file(names: Sequence[str], limit: int = 12) -> str:
    """List names for a message, cut short where they are many."""
    return ", ".join(names[:limit]) + (f" and {len(names) - limit} more" if len(names) > limit else "")


@dataclass(frozen=True)
class _Checker:
    source: Path

    def __call__(self, good: bool, place: str, found: Any, expected: str) -> None:
        if not good:
            raise RecordingError(f"{found!r} where {expected} was expected", source=self.source, place=place)

    def number(self, value: Any, place: str) -> float:
        good = isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))
        self(good, place, value, "a number")
        return float(value)

    def names(self, value: Any, place: str) -> tuple[str, ...]:
        self(isinstance(value, list | tuple), place, value, "a list of names")
        return tuple(str(name) for name in value)


def _read_columns(content: Any, check: _Checker) -> dict[str, Source]:
    check(isinstance(content, Mapping), "columns", content, "a mapping of columns")
    columns: dict[str, Source] = {}
    for target, entry in content.items():
        place = f"columns.{target}"
        if not (is_known_column(str(target)) or target in QUANTITIES):
            hint = nearest(str(target), ["time", *QUANTITIES, *(f"{q}_1" for q in QUANTITIES)])
            raise RecordingError(f"unknown column {target!r}{hint}", source=check.source, place="columns")
        entry = entry if isinstance(entry, Mapping) else {"from": entry}
        check_keys(entry, ("from", "scale", "offset"), source=check.source, place=place, error=RecordingError)
        origin = entry.get("from", target)
        if target not in QUANTITIES:
            columns[target] = _read_source(origin, entry.get("scale", 1.0), entry.get("offset", 0.0), place, check)
            continue
        check(isinstance(origin, list), place, origin, "from: a list of columns (for a whole quantity)")
        each = {key: entry.get(key, default) for key, default in (("scale", 1.0), ("offset", 0.0))}
        for key, value in each.items():
            each[key] = value if isinstance(value, list) else [value] * len(origin)
            check(len(each[key]) == len(origin), f"{place}.{key}", value, f"a number or {len(origin)} of them")
        for i, (column, scale, offset) in enumerate(zip(origin, each["scale"], each["offset"], strict=True), 1):
            columns[f"{target}_{i}"] = _read_source(column, scale, offset, place, check)
    return columns


def _read_source(column: Any, scale: Any, offset: Any, place: str, check: _Checker) -> Source:
    good = isinstance(column, str | int) and not isinstance(column, bool)
    check(good, f"{place}.from", column, "a column's name or 1-based number")
    scale, offset = check.number(scale, f"{place}.scale"), check.number(offset, f"{place}.offset")
    return Source(str(column), scale, offset, number=column if isinstance(column, int) else None)


def _read_npy(path: Path) -> np.ndarray:
    import io

    if bare_suffix(path) != ".npy":
        raise RecordingError("an .npy file was expected under `files`", source=path)
    try:
        return np.load(io.BytesIO(read_bytes(path)), allow_pickle=False)
    except (ValueError, EOFError) as exc:
        if "pickle" in str(exc).lower():
            raise RecordingError("holds pickled objects: refused; save plain arrays", source=path) from None
        raise RecordingError(f"is not a whole npy file; truncated? ({exc})", source=path) from None
