"""Strict YAML in, whole files out."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from .errors import InputError, nearest


class _StrictLoader(yaml.SafeLoader):
    """SafeLoader that refuses a key given twice."""


def _mapping(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Any, Any]:
    seen: set[Any] = set()
    for key_node, _ in node.value:
        key = loader.construct_object(key_node)
        if key in seen:
            raise InputError(f"key {key!r} is given twice", place=f"line {key_node.start_mark.line + 1}")
        seen.add(key)
    loader.flatten_mapping(node)
    return loader.construct_mapping(node, deep=True)


_StrictLoader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping)
# YAML 1.1 takes 1e-3 and 2.0e4 for text
_StrictLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$"), list("-+.0123456789")
)


def read_text(path: str | os.PathLike[str], error: type[InputError] = InputError) -> str:
    """Read a UTF-8 text file.

    Raises
    ------
    InputError
        If the file does not exist, is a folder, is not UTF-8 or is empty.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise error("no such file", source=path) from None
    except IsADirectoryError:
        raise error("is a folder, a file was expected", source=path) from None
    except UnicodeDecodeError:
        raise error("is not a text file (not UTF-8)", source=path) from None
    except OSError as exc:
        raise error(f"cannot be read ({exc.strerror})", source=path) from None
    if not text.strip():
        raise error("is empty", source=path)
    return text


def read_yaml(path: str | os.PathLike[str], error: type[InputError] = InputError) -> dict[str, Any]:
    """Read a YAML mapping; a key given twice is an error.

    Raises
    ------
    InputError
        If the file cannot be read, is not YAML, or is not a mapping.
    """
    try:
        content = yaml.load(read_text(path, error), Loader=_StrictLoader)
    except InputError as exc:
        raise error(exc.message, source=path, place=exc.place) from None
    except yaml.YAMLError as exc:
        mark = getattr(exc, "problem_mark", None)
        place = f"line {mark.line + 1}, column {mark.column + 1}" if mark else None
        raise error(f"is not valid YAML ({getattr(exc, 'problem', None) or exc})", source=path, place=place) from None
    if not isinstance(content, dict):
        raise error(f"a mapping of keys was expected, found {type(content).__name__}", source=path)
    return content


def check_keys(
    mapping: Mapping[str, Any],
    allowed: Iterable[str],
    *,
    required: Iterable[str] = (),
    source: str | os.PathLike[str] | None = None,
    place: str | None = None,
    error: type[InputError] = InputError,
) -> None:
    """Refuse keys that are not `allowed` (naming the nearest one that is) and demand the `required` ones.

    Raises
    ------
    InputError
        On the first unknown or missing key.
    """
    if not isinstance(mapping, Mapping):
        raise error(f"a mapping of keys was expected, found {mapping!r}", source=source, place=place)
    allowed = list(allowed)
    for key in mapping:
        if key not in allowed:
            hint = nearest(str(key), allowed) or f"; known keys: {', '.join(allowed)}"
            raise error(f"unknown key {key!r}{hint}", source=source, place=place)
    for key in required:
        if key not in mapping:
            raise error(f"key {key!r} is missing", source=source, place=place)


@contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path beside `path` that becomes `path` only if the block succeeds.

    Raises
    ------
    InputError
        If the folder does not exist or cannot be written.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError("is a folder, an output file was expected", source=path)
    if not path.parent.is_dir():
        raise InputError("the folder of this output file does not exist", source=path)
    try:
        # The suffixes are kept: writers choose their format (and compression) by them.
        handle, name = tempfile.mkstemp(prefix=".", suffix="".join(path.suffixes[-2:]) or ".tmp", dir=path.parent)
    except OSError as exc:
        raise InputError(f"cannot be written ({exc.strerror})", source=path) from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file whole or not at all."""
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@contextmanager
def whole_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary folder whose files are moved into `path` only if the block succeeds.

    Files of the same names in an existing `path` are replaced; others are left alone.

    Raises
    ------
    InputError
        If `path` is a file, or cannot be created.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise InputError("is a file, an output folder was expected", source=path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    except OSError as exc:
        raise InputError(f"cannot be created ({exc.strerror})", source=path) from None
    try:
        yield temporary
        path.mkdir(exist_ok=True)
        for item in sorted(temporary.rglob("*")):
            target = path / item.relative_to(temporary)
            if item.is_dir():
                target.mkdir(exist_ok=True)
            else:
                os.replace(item, target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
