"""Get the public recordings of real robots from their authors' repositories, or from a folder, checked by SHA-256.

Usage: python scripts/get_data.py [DATA_SET ...] [-o data] [--from FOLDER]

scripts/public_recordings.csv says where each file comes from: repository, commit, path, size, checksum. Files arrive
gz-compressed under DATA_SET/; some are joined of several, and then the checksum is that of the join. Beside each
recording a recording.yaml is written, made from urdf/real/recordings/DATA_SET.yaml, so that for instance

    cdm-pin identify urdf/real/psm.yaml data/dvrk_psm_wpi/one_results.yaml --holdout data/dvrk_psm_wpi/two_results.yaml

works. Files that are there and whole are kept. The recordings belong to their authors; see the notes in
urdf/real/recordings.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import hashlib
import json
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from cdm_pin.errors import CdmError, InputError, nearest
from cdm_pin.files import read_yaml, whole_file, write_text

ROOT = Path(__file__).resolve().parent.parent
TABLE = ROOT / "scripts" / "public_recordings.csv"
LAYOUTS = ROOT / "urdf" / "real" / "recordings"
URL = "https://raw.githubusercontent.com/{repository}/{commit}/{path}"

Fetch = Callable[["Item", str], bytes]


@dataclass(frozen=True)
class Item:
    """One file of the table.

    Attributes
    ----------
    folder, file : str
        Where it is kept: data set and name (``.gz``: kept compressed, checked uncompressed).
    repository, commit : str
    paths : tuple of str
        In the repository; several are joined.
    join : str
        How: ``""``, ``"columns"`` (one number a line) or ``"json"``.
    size : int
        Bytes, uncompressed.
    sha256 : str
        Of the uncompressed content.
    facts : dict
        ``rate`` [Hz] and ``payload`` [kg] for its recording.yaml.
    """

    folder: str
    file: str
    repository: str
    commit: str
    paths: tuple[str, ...]
    join: str
    size: int
    sha256: str
    facts: dict[str, float]


def read_items(path: Path = TABLE) -> tuple[Item, ...]:
    """Read the table of files."""
    with path.open(newline="", encoding="utf-8") as handle:
        return tuple(_item(row) for row in csv.DictReader(handle))


def _item(row: dict[str, str]) -> Item:
    facts = {key: float(row[key]) for key in ("rate", "payload") if row[key]}
    paths = tuple(row["paths"].split())
    where = (row["folder"], row["file"], row["repository"], row["commit"])
    return Item(*where, paths, row["join"], int(row["bytes"]), row["sha256"], facts)


def from_network(item: Item, path: str, timeout: float = 60.0) -> bytes:
    """Download one path of a repository at its commit.

    Raises
    ------
    InputError
        If it cannot be reached.
    """
    url = URL.format(repository=item.repository, commit=item.commit, path=urllib.request.quote(path))
    try:
        with urllib.request.urlopen(url, timeout=timeout) as answer:
            return answer.read()
    except (urllib.error.URLError, OSError) as exc:
        reason = getattr(exc, "reason", None) or exc
        message = f"cannot be downloaded ({reason}); without network take the files from a folder with --from"
        raise InputError(message, source=url) from None


def from_folder(folder: Path) -> Fetch:
    """Give a function that finds files in a folder: clones of the repositories, by owner/name or name."""

    def fetch(item: Item, path: str) -> bytes:
        places = [folder / item.repository / path, folder / item.repository.split("/")[1] / path]
        for place in places:
            if place.is_file():
                return place.read_bytes()
        message = f"has neither {item.folder}/{item.file} nor {item.repository.split('/')[1]}/{path}"
        raise InputError(message, source=folder)

    return fetch


def obtain(item: Item, output: Path, fetch: Fetch, local: Path | None = None) -> str:
    """Bring one file into `output`, whole and checked, unless it is there already.

    Returns
    -------
    str
        ``"kept"``, ``"copied"`` or ``"fetched"``.

    Raises
    ------
    InputError
        If it cannot be had, or is not the file that the table means.
    """
    target = output / item.folder / item.file
    if _content(target) is not None and _is_it(item, _content(target)):
        return "kept"
    content, how = (_content(local / item.folder / item.file) if local else None), "copied"
    if content is None:
        content, how = joined(item, [fetch(item, path) for path in item.paths]), "fetched"
    if not _is_it(item, content):
        found = f"{len(content)} bytes, sha256 {hashlib.sha256(content).hexdigest()[:12]}..."
        raise InputError(
            f"is not the published file: {found}; {item.size} bytes, sha256 {item.sha256[:12]}... were expected",
            source=f"{item.folder}/{item.file}",
        )
    target.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(target) as temporary:
        temporary.write_bytes(gzip.compress(content, 6, mtime=0) if target.suffix == ".gz" else content)
    return how


def _content(path: Path) -> bytes | None:
    """Read a file uncompressed, whether it is kept with ``.gz`` or without; None if there is none."""
    plain = path.with_suffix("") if path.suffix == ".gz" else path
    for candidate in (path, plain):
        if candidate.is_file():
            data = candidate.read_bytes()
            try:
                return gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data
            except (OSError, EOFError):
                return None
    return None


def _is_it(item: Item, content: bytes | None) -> bool:
    return content is not None and hashlib.sha256(content).hexdigest() == item.sha256


def joined(item: Item, parts: Sequence[bytes]) -> bytes:
    """Join the parts of a file into one."""
    if item.join == "columns":
        return _join_columns([part.decode() for part in parts])
    if item.join == "json":
        return _join_json(*(json.loads(part) for part in parts))
    return parts[0]


def _join_columns(parts: Sequence[str], joints: int = 7) -> bytes:
    """Join time (one number a line) with quantities (`joints` lines a sample), eight significant digits."""
    time, *quantities = ([float(line) for line in part.split()] for part in parts)
    names = ["t_s", *(f"{stem}{j + 1}" for stem in ("q", "dq", "tau") for j in range(joints))]
    rows = (
        [t, *(x for values in quantities for x in values[joints * k : joints * (k + 1)])] for k, t in enumerate(time)
    )
    return _csv(names, rows, "%.8g")


def _join_json(state: list[dict[str, Any]], gravity: list[dict[str, Any]]) -> bytes:
    """Join the logged states with the gravity torques by index, time from zero, nine significant digits."""
    width = range(1, len(state[0]["position"]) + 1)
    names = ["t_s", *(f"{stem}{j}" for stem in ("q", "dq", "tau", "gravity") for j in width)]
    rows = (
        [s["time"] - state[0]["time"], *s["position"], *s["velocity"], *s["effort"], *g["gravity"]]
        for s, g in zip(state, gravity, strict=False)
    )
    return _csv(names, rows, "%.9g")


def _csv(names: Sequence[str], rows: Iterable[Sequence[float]], number: str) -> bytes:
    lines = [",".join(names), *(",".join(number % x for x in row) for row in rows)]
    return ("\n".join(lines) + "\n").encode()


def write_layout(item: Item, output: Path) -> Path | None:
    """Write the recording.yaml of a file beside it; None for files that are no recordings of their own."""
    template = LAYOUTS / f"{item.folder}.yaml"
    stem = item.file.removesuffix(".gz").rsplit(".", 1)[0]
    if not template.is_file() or "command" in stem:
        return None
    content = read_yaml(template)
    target = output / item.folder / f"{stem}.yaml"
    if "files" in content:
        if "_q_act_" not in stem:
            return None
        stem = stem.partition("_q_act_")[0]
        target = output / item.folder / f"{stem}.yaml"
        content["files"] = {name: f"{stem}_{name}_raw.npy" for name in content["files"]}
    else:
        content["file"] = Path(item.file).name
    content |= item.facts | {"label": stem.replace("/", " ")}
    comment = "".join(line for line in template.read_text().splitlines(keepends=True) if line.startswith("#"))
    write_text(target, comment + yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110))
    return target


def main(arguments: Sequence[str] | None = None) -> int:
    """Get the data sets asked for, default all."""
    items = read_items()
    known = list(dict.fromkeys(item.folder for item in items))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], epilog=f"data sets: {', '.join(known)}")
    parser.add_argument("sets", nargs="*", metavar="DATA_SET", help="default: all")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "data", help="folder to write to; default ./data")
    parser.add_argument("--from", dest="source", type=Path, metavar="FOLDER", help="take the files from this folder")
    options = parser.parse_args(arguments)
    try:
        for name in options.sets:
            if name not in known:
                raise InputError(f"unknown data set {name!r}{nearest(name, known) or ''}; known: {', '.join(known)}")
        if options.source and not options.source.is_dir():
            raise InputError("no such folder", source=options.source)
        fetch = from_folder(options.source) if options.source else from_network
        for item in items:
            if not options.sets or item.folder in options.sets:
                how = obtain(item, options.output, fetch, options.source)
                write_layout(item, options.output)
                print(f"{how} {item.folder}/{item.file}", flush=True)
    except CdmError as exc:
        print(f"get_data: {exc}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
