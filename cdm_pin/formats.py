"""Tables of named columns in and out of files: CSV and other text, Parquet, npz, MATLAB; gz-compressed or not."""

from __future__ import annotations

import csv
import gzip
import io
import re
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from .errors import RecordingError
from .files import whole_file

TEXT_SUFFIXES = ("", ".csv", ".txt", ".tsv", ".dat", ".log", ".asc")
FACTS = ("label", "pretension", "payload")

Pick = Callable[[Sequence[str]], Sequence[str]]
"""Given the names a file has, the names to read: columns that nobody wants may hold anything."""


@dataclass(frozen=True)
class Table:
    """Columns as a file holds them.

    Attributes
    ----------
    columns : dict of str to ndarray, shape (n,)
        The picked columns, as float64; cells may still be NaN or infinite.
    facts : dict
        `label`, `pretension`, `payload` where the file states them.
    place : callable
        From a row counted from 0 to words that lead a person to it.
    notices : tuple of str
        What a reader should be told about how it was read.
    """

    columns: dict[str, np.ndarray]
    facts: dict[str, Any] = field(default_factory=dict)
    place: Callable[[int], str] = lambda row: f"row {row + 1}"
    notices: tuple[str, ...] = ()


@dataclass(frozen=True)
class TextLayout:
    """How a text file is laid out: header line or not, comment sign, delimiter (None: found from the first line)."""

    header: bool = True
    comment: str = "#"
    delimiter: str | None = None


def read_table(path: Path, pick: Pick, layout: TextLayout | None = None) -> Table:
    """Read the picked columns of a file, by its suffix (``.gz`` is looked through).

    Raises
    ------
    RecordingError
        If the file is missing, empty, truncated, of an unknown format, or a picked cell is not a number.
    """
    suffix = bare_suffix(path)
    if suffix in TEXT_SUFFIXES:
        return read_text_table(read_bytes(path), path, pick, layout or TextLayout())
    readers = {".parquet": _read_parquet, ".pq": _read_parquet, ".npz": _read_npz, ".mat": _read_mat}
    if suffix not in readers:
        known = ", ".join([s for s in TEXT_SUFFIXES if s] + [*readers, ".bag", ".mcap", ".db3", ".yaml"])
        raise RecordingError(f"suffix {suffix!r} names no known recording format; known: {known}", source=path)
    return readers[suffix](read_bytes(path), path, pick)


def write_table(columns: Mapping[str, np.ndarray], path: Path, facts: Mapping[str, Any] | None = None) -> None:
    """Write columns of equal length whole or not at all, by suffix: .csv, .parquet, .npz, .mat, each also with .gz.

    Values come back bit for bit. `facts` are kept by all formats but CSV, which has no place for them.

    Raises
    ------
    RecordingError
        If the suffix names no format that can be written.
    """
    writers = {".csv": _csv_bytes, ".parquet": _parquet_bytes, ".npz": _npz_bytes, ".mat": _mat_bytes}
    suffix = bare_suffix(path)
    if suffix not in writers:
        raise RecordingError(f"cannot write suffix {suffix!r}; known: {', '.join(writers)}", source=path)
    data = writers[suffix]({name: np.ascontiguousarray(x) for name, x in columns.items()}, dict(facts or {}))
    with whole_file(path) as temporary:
        temporary.write_bytes(gzip.compress(data, 6, mtime=0) if path.suffix.lower() == ".gz" else data)


def bare_suffix(path: Path) -> str:
    """Give the lower-case suffix of a path without its ``.gz``."""
    return (path.with_suffix("") if path.suffix.lower() == ".gz" else path).suffix.lower()


def read_bytes(path: Path) -> bytes:
    """Read a file whole, through gzip if it is compressed.

    Raises
    ------
    RecordingError
        If it does not exist, is empty, or its compressed data are cut short or damaged.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise RecordingError("no such file", source=path) from None
    except IsADirectoryError:
        raise RecordingError("is a folder, a recording file was expected", source=path) from None
    except OSError as exc:
        raise RecordingError(f"cannot be read ({exc.strerror})", source=path) from None
    if data[:2] == b"\x1f\x8b":
        try:
            data = gzip.decompress(data)
        except EOFError:
            raise RecordingError("is a truncated gzip file: it ends before its end marker", source=path) from None
        except (OSError, zlib.error) as exc:
            raise RecordingError(f"is a damaged gzip file ({exc})", source=path) from None
    elif path.suffix.lower() == ".gz" and data:
        raise RecordingError("is named .gz but is not gzip-compressed", source=path)
    if not data[:4096].strip() and not data.strip():
        raise RecordingError("is empty", source=path)
    return data


# --- text -------------------------------------------------------------------------------------------------------------


def read_text_table(data: bytes, source: Path, pick: Pick, layout: TextLayout) -> Table:
    """Read delimited text: a strict columnar parser, and a slow scan that names the cell only if that fails.

    LF, CRLF, CR, a UTF-8 byte-order mark, comment lines, and semicolons with decimal commas are understood.

    Raises
    ------
    RecordingError
        On text that is not a table of numbers in the picked columns, with line and column.
    """
    text = _Text.parse(data, source, layout)
    picked = [text.names.index(name) for name in pick(text.names)]
    repeated = [name for name, count in Counter(text.names).items() if count > 1]
    for j in picked:
        if text.names[j] in repeated:
            raise RecordingError("this column is given twice", source=source, place=f"column {text.names[j]}")
    keys = [f"c{j}" for j in range(len(text.names))]
    try:
        table = pa.csv.read_csv(
            pa.BufferReader(text.body),
            read_options=pa.csv.ReadOptions(column_names=keys, block_size=1 << 24),
            parse_options=pa.csv.ParseOptions(delimiter=text.delimiter),
            convert_options=pa.csv.ConvertOptions(
                column_types={keys[j]: pa.float64() for j in picked},
                include_columns=[keys[j] for j in picked],
                null_values=[],
                decimal_point=text.decimal_point,
            ),
        )
    except pa.ArrowInvalid as exc:
        text.raise_first_bad_cell(picked)
        raise RecordingError(f"is not a table of numbers ({exc})", source=source) from None
    columns = {text.names[j]: table.column(keys[j]).to_numpy() for j in picked}
    return Table(columns, place=text.place)


@dataclass(frozen=True)
class _Text:
    """Delimited text taken apart: names, and a body of rows only."""

    source: Path
    names: list[str]
    body: bytes | memoryview
    first_line: int
    delimiter: str
    decimal_point: str
    raw_body: bytes | memoryview
    comment: bytes

    @classmethod
    def parse(cls, data: bytes, source: Path, layout: TextLayout) -> _Text:
        if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\0" in data[:4096]:
            raise RecordingError("is not UTF-8 text", source=source)
        if b"\n" not in data and b"\r" in data:
            data = data.replace(b"\r", b"\n")
        comment = layout.comment.encode()
        start, number, line = _first_row(data, 3 if data[:3] == b"\xef\xbb\xbf" else 0, 1, comment)
        if line is None:
            raise RecordingError("holds only comments and empty lines", source=source)
        delimiter = layout.delimiter or _find_delimiter(line)
        cells = _split(line, delimiter)
        if layout.header:
            _refuse_numbers_as_header(cells, source, number)
            start, number = start + len(line) + 1, number + 1
            names = cells
        else:
            names = [str(j + 1) for j in range(len(cells))]
        body = raw = memoryview(data)[start:]
        has_comments = bool(comment) and data.find(b"\n" + comment, max(start - 1, 0)) >= 0
        if has_comments:
            body = b"\n".join(r for r in bytes(raw).split(b"\n") if not r.startswith(comment))
        if delimiter == " ":
            body = re.sub(rb"[ \t]+", b" ", re.sub(rb"(?m)^[ \t]+|[ \t\r]+$", b"", bytes(body)))
        _, _, row = _first_row(data, start, number, comment)
        if row is None:
            raise RecordingError("has a header but no rows of data", source=source)
        decimal_comma = delimiter not in (",", " ") and b"," in row and b"." not in row
        return cls(source, names, body, number, delimiter, "," if decimal_comma else ".", raw, comment)

    def rows(self) -> Iterator[tuple[int, str]]:
        """Yield the line number and the text of every data row."""
        for k, line in enumerate(bytes(self.raw_body).split(b"\n")):
            if line.strip() and not (self.comment and line.startswith(self.comment)):
                yield self.first_line + k, line.decode("utf-8", errors="replace").rstrip("\r")

    def place(self, row: int) -> str:
        """Say where a data row is, counting data rows and lines of the file from 1."""
        line = next(number for k, (number, _) in enumerate(self.rows()) if k == row)
        return f"row {row + 1} (line {line})"

    def raise_first_bad_cell(self, picked: Sequence[int]) -> None:
        """Raise on the first row that has too few or many cells, or a picked cell that is no number."""
        for k, (number, line) in enumerate(self.rows()):
            cells = _split(line.encode(), self.delimiter)
            place = f"row {k + 1} (line {number})"
            if len(cells) != len(self.names):
                message = f"has {len(cells)} cells, {len(self.names)} columns were expected"
                raise RecordingError(message, source=self.source, place=place)
            for j in picked:
                if not _is_number(cells[j].replace(self.decimal_point, ".")):
                    found = repr(cells[j]) if cells[j] else "an empty cell"
                    place = f"{place}, column {self.names[j]}"
                    raise RecordingError(f"{found} where a number was expected", source=self.source, place=place)


def _first_row(data: bytes, start: int, number: int, comment: bytes) -> tuple[int, int, bytes | None]:
    """Find the first line from `start` that is neither empty nor a comment: its offset, its number, its bytes."""
    while start < len(data):
        end = data.find(b"\n", start)
        line = data[start : end if end >= 0 else len(data)]
        if line.strip() and not (comment and line.startswith(comment)):
            return start, number, line
        start, number = start + len(line) + 1, number + 1
    return start, number, None


def _find_delimiter(line: bytes) -> str:
    for delimiter in (";", "\t", ","):
        if delimiter.encode() in line:
            return delimiter
    return " " if b" " in line.strip() else ","


def _split(line: bytes, delimiter: str) -> list[str]:
    text = line.decode("utf-8", errors="replace").rstrip("\r\n")
    if delimiter == " ":
        return text.split()
    return [cell.strip() for cell in next(csv.reader([text], delimiter=delimiter))]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell


def _refuse_numbers_as_header(cells: Sequence[str], source: Path, number: int) -> None:
    if all(_is_number(cell) for cell in cells if cell):
        message = "holds numbers where a header was expected; describe a file without header in a recording.yaml"
        raise RecordingError(f"{message} (header: false)", source=source, place=f"line {number}")


# --- binary -----------------------------------------------------------------------------------------------------------


def _read_parquet(data: bytes, source: Path, pick: Pick) -> Table:
    try:
        file = pa.parquet.ParquetFile(pa.BufferReader(data))
        names = file.schema_arrow.names
        picked = list(pick(names))
        for name in picked:
            if names.count(name) > 1:
                raise RecordingError("this column is given twice", source=source, place=f"column {name}")
        table = file.read(columns=picked)
    except (pa.ArrowException, OSError) as exc:
        detail = str(exc).split(". ")[0]
        raise RecordingError(f"is not a whole Parquet file; truncated? ({detail})", source=source) from None
    columns = {}
    for name in picked:
        column = table.column(name)
        if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
            message = f"holds {column.type}, numbers were expected"
            raise RecordingError(message, source=source, place=f"column {name}")
        columns[name] = column.cast(pa.float64(), safe=False).to_numpy()
    stated = {key.decode(): value.decode() for key, value in (file.schema_arrow.metadata or {}).items()}
    return Table(columns, facts=_facts(stated, source))


def _read_npz(data: bytes, source: Path, pick: Pick) -> Table:
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            if not hasattr(archive, "files"):
                raise RecordingError("is a single array, an archive of named arrays was expected", source=source)
            return table_of_arrays({name: archive[name] for name in archive.files}, source, pick)
    except ValueError as exc:
        if isinstance(exc, RecordingError):
            raise
        message = "holds pickled objects, which can run code when read: refused; save plain arrays of numbers"
        if "pickle" not in str(exc).lower():
            message = f"is not an npz archive of numbers ({exc})"
        raise RecordingError(message, source=source) from None
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, KeyError) as exc:
        raise RecordingError(f"is not a whole npz archive; truncated? ({exc})", source=source) from None


def _read_mat(data: bytes, source: Path, pick: Pick) -> Table:
    import scipy.io

    if data[512:520] == b"\x89HDF\r\n\x1a\n" or data[:8] == b"\x89HDF\r\n\x1a\n":
        return table_of_arrays(_hdf5_arrays(data, source), source, pick)
    try:
        content = scipy.io.loadmat(io.BytesIO(data), squeeze_me=False, struct_as_record=True)
    except Exception as exc:  # the parser raises anything from ValueError to MemoryError on damaged bytes
        raise RecordingError(f"is not a whole MATLAB file; truncated? ({exc})", source=source) from None
    return table_of_arrays({k: v for k, v in content.items() if not k.startswith("__")}, source, pick)


def _hdf5_arrays(data: bytes, source: Path) -> dict[str, np.ndarray]:
    """Read the top-level numeric arrays of a MATLAB 7.3 file, which stores them transposed."""
    try:
        import h5py
    except ImportError:
        message = "is a MATLAB 7.3 file; save it with '-v7', or install h5py"
        raise RecordingError(message, source=source) from None
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            return {str(k): np.asarray(v).T for k, v in file.items() if isinstance(v, h5py.Dataset)}
    except OSError as exc:
        raise RecordingError(f"is not a whole MATLAB 7.3 file; truncated? ({exc})", source=source) from None


def table_of_arrays(arrays: Mapping[str, np.ndarray], source: Path, pick: Pick) -> Table:
    """Make a table of named arrays: (n,) is the column of that name, (n, w) the columns name_1 .. name_w.

    Raises
    ------
    RecordingError
        If a picked array is not numeric.
    """
    facts = {name: arrays[name] for name in FACTS if name in arrays}
    columns: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        array = np.asarray(array)
        if name in FACTS or array.ndim == 0 or array.ndim > 2:
            continue
        if array.ndim == 2 and 1 in array.shape and (name == "time" or re.search(r"_\d+$", name)):
            array = array.ravel()  # MATLAB has no vectors, only matrices of one row or column
        if array.ndim == 1:
            columns[name] = array
        else:
            columns |= {f"{name}_{j}": column for j, column in enumerate(array.T, 1)}
    picked = {name: columns[name] for name in pick(list(columns))}
    for name, array in picked.items():
        if array.dtype.kind not in "fiub":
            raise RecordingError(f"holds {array.dtype}, numbers were expected", source=source, place=f"array {name}")
    return Table({name: np.asarray(x, float) for name, x in picked.items()}, facts=_facts(facts, source))


def _facts(stated: Mapping[str, Any], source: Path) -> dict[str, Any]:
    """Read label, pretension [N] and payload [kg] from a file's own statements."""
    facts: dict[str, Any] = {}
    for name in FACTS:
        if name not in stated:
            continue
        value = np.asarray(stated[name]).ravel()
        try:
            facts[name] = str(value[0]) if name == "label" else float(value[0])
        except (ValueError, IndexError, TypeError):
            raise RecordingError(f"{value} where one value was expected", source=source, place=name) from None
    return facts


def _csv_bytes(columns: dict[str, np.ndarray], facts: dict[str, Any]) -> bytes:
    sink = io.BytesIO()
    sink.write((",".join(columns) + "\n").encode())
    options = pa.csv.WriteOptions(include_header=False, batch_size=1 << 14)
    pa.csv.write_csv(pa.table(columns), sink, options)
    return sink.getvalue()


def _parquet_bytes(columns: dict[str, np.ndarray], facts: dict[str, Any]) -> bytes:
    sink = io.BytesIO()
    table = pa.table(columns).replace_schema_metadata({k: str(v) for k, v in facts.items()})
    pa.parquet.write_table(table, sink)
    return sink.getvalue()


def _npz_bytes(columns: dict[str, np.ndarray], facts: dict[str, Any]) -> bytes:
    sink = io.BytesIO()
    arrays: dict[str, Any] = {**columns, **facts}
    np.savez_compressed(sink, **arrays)
    return sink.getvalue()


def _mat_bytes(columns: dict[str, np.ndarray], facts: dict[str, Any]) -> bytes:
    import scipy.io

    sink = io.BytesIO()
    scipy.io.savemat(sink, {**columns, **facts}, oned_as="column", do_compression=True)
    return sink.getvalue()
