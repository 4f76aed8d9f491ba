"""What commands say on the terminal: tables, JSON, notices, and a progress bar for what takes long.

Results go to standard output, notices and progress to standard error. ``--quiet`` silences all but errors and
``--json``; ``NO_COLOR`` and output that is no terminal are respected.
"""

from __future__ import annotations

import argparse
import json
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

ProgressCallback = Callable[..., None]
"""``progress(step, fraction, **news)``: computations may add news that the viewer draws and the terminal ignores."""


def output(*, stderr: bool = False) -> Console:
    """Make a console that prints text as it is: no markup, no highlighting, no emoji."""
    return Console(stderr=stderr, markup=False, highlight=False, emoji=False)


def emit(args: argparse.Namespace, data: Any, *renderables: RenderableType) -> None:
    """Print the result of a command: `data` as JSON with ``--json``, else `renderables`, else (``--quiet``) nothing.

    Parameters
    ----------
    args : argparse.Namespace
        With `quiet` and `json`, as `cdm_pin.cli` parses them.
    data : any
        What a program reads; numpy arrays and non-finite numbers are converted (see `plain`).
    *renderables : str, Table, Text
        What a person reads.
    """
    if getattr(args, "json", False):
        print(json.dumps(plain(data), indent=2, ensure_ascii=False))
    elif not getattr(args, "quiet", False):
        console = output()
        for renderable in renderables:
            console.print(renderable)


def notice(args: argparse.Namespace, text: str) -> None:
    """Say something in passing, on standard error (not with ``--quiet``)."""
    if not getattr(args, "quiet", False):
        output(stderr=True).print(Text(text, style="yellow"))


def table(title: str, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> Table:
    """Make a table; columns whose cells are all numbers are aligned to the right.

    Parameters
    ----------
    title : str
    header : sequence of str
    rows : iterable of sequences
        Cells: str, numbers (shown with 4 significant digits), None (shown as a dash) or rich renderables.
    """
    cells = [list(row) for row in rows]
    result = Table(title=title, title_justify="left", title_style="bold", header_style="bold")
    for k, name in enumerate(header):
        numeric = bool(cells) and all(_is_number(row[k]) for row in cells)
        result.add_column(name, justify="right" if numeric else "left", overflow="fold")
    for row in cells:
        result.add_row(*(_cell(value) for value in row))
    return result


@contextmanager
def progress_bar(args: argparse.Namespace, *, delay: float = 0.7) -> Iterator[ProgressCallback]:
    """Give a callback ``progress(step, fraction)`` that drives a bar on standard error.

    Parameters
    ----------
    args : argparse.Namespace
        No bar is shown with `quiet` or `json`, or if standard error is no terminal.
    delay : float
        The bar appears only after this long [s], so that short work prints nothing.

    Yields
    ------
    callable
        Takes the step's name, the fraction of it that is done (0 to 1) and, as keywords, news that it ignores; may be
        called from any thread.

    Examples
    --------
    >>> with progress_bar(args) as progress:          # doctest: +SKIP
    ...     identify(model, signals, progress=progress)
    """
    console = output(stderr=True)
    if getattr(args, "quiet", False) or getattr(args, "json", False) or not console.is_terminal:
        yield lambda step, fraction, **news: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    bar = Progress(*columns, console=console, transient=True)
    task = bar.add_task("", total=1.0)
    timer = threading.Timer(delay, bar.start)
    timer.daemon = True
    timer.start()
    try:
        yield lambda step, fraction, **news: bar.update(task, description=step, completed=min(max(fraction, 0.0), 1.0))
    finally:
        timer.cancel()
        timer.join()
        bar.stop()


def plain(data: Any) -> Any:
    """Turn arrays, numpy numbers, paths and tuples into what strict JSON can hold; NaN and infinity become null."""
    if isinstance(data, dict):
        return {str(key): plain(value) for key, value in data.items()}
    if isinstance(data, np.ndarray):
        return plain(data.tolist())
    if isinstance(data, (list, tuple, set, frozenset)):
        return [plain(value) for value in data]
    if isinstance(data, (bool, np.bool_)):
        return bool(data)
    if isinstance(data, (int, np.integer)):
        return int(data)
    if isinstance(data, (float, np.floating)):
        return float(data) if np.isfinite(data) else None
    return data if data is None or isinstance(data, str) else str(data)


def _is_number(value: Any) -> bool:
    return value is None or (isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool))


def _cell(value: Any) -> RenderableType:
    if value is None:
        return "-"
    if isinstance(value, (float, np.floating)):
        return f"{value:.4g}"
    return str(value) if isinstance(value, (int, np.integer)) else value
