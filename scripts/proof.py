#!/usr/bin/env python3
"""The proof: blind trials by the thousand, scored, beside baselines, written up in docs/proof.md.

Every trial conceals something in an independent simulator, hands the diagnosis the recordings and a manipulator file
with wrong masses, and scores what it says. Trials are independent and each leaves one row in trials.csv; a run that is
stopped goes on where it was, and any beginning of it is spread over all studies.

    scripts/proof.py --hours 6 --jobs 2                           # what docs/proof.md is made by
    scripts/proof.py --trials 200 --seeds development -o /tmp/p   # while working on the diagnosis: seeds of that word
    scripts/proof.py --only ladder two --hours 1                  # some studies alone
    scripts/proof.py --report                                     # tables, figures and page again from the rows
    scripts/proof.py --show plain/7                               # the command that makes this trial again

Seeds follow from the hash of the commit that is checked out when a study begins, kept in docs/proof/seeds.txt; to begin
a new study, remove the folder. The sparse-regression baseline needs pysindy in a Python of its own (``python3 -m venv
DIR; DIR/bin/pip install pysindy``, then ``--pysindy DIR/bin/python``); it is left out without.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import itertools
import multiprocessing as mp
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from proof_studies import STUDIES, Task, tasks, trial
from proof_trial import FIELDS
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from cdm_pin.console import output
from cdm_pin.files import write_text

ROOT = Path(__file__).resolve().parent.parent
_DEATHS = 5  # in a row, of processes, that are no longer the diagnosis's fault
_GRACE = 240.0  # [s] that drawing and scoring may take beside the diagnosis


def read_rows(path: Path) -> list[dict[str, str]]:
    """Read trials.csv; a last line that was cut short is left out."""
    if not path.exists():
        return []
    with open(path, newline="", encoding="utf-8") as file:
        return [row for row in csv.DictReader(file) if None not in row.values() and None not in row]


def append_row(path: Path, row: dict[str, Any]) -> None:
    """Add a row to trials.csv."""
    new = not path.exists() or path.stat().st_size == 0
    if not new and not path.read_bytes().endswith(b"\n"):
        with open(path, "a", encoding="utf-8") as file:
            file.write("\n")
    with open(path, "a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(row), lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerow(row)


def _work(connection: Connection) -> None:
    """Run the tasks that come through `connection`; send their rows back."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import proof_trial

    with contextlib.suppress(EOFError, BrokenPipeError):  # whoever gives tasks has ended
        while True:
            task = connection.recv()
            try:
                row = proof_trial.run(task)
            except Exception as exc:  # of the plant or the scorer: a failure that stays in the study, and is seen
                row = proof_trial.blank(task, f"harness {type(exc).__name__}: {exc}"[:120])
            connection.send(row)


@dataclass
class _Worker:
    """A process, our end of its pipe, and what it is doing since when."""

    process: Any
    connection: Connection
    task: Task | None = None
    since: float = 0.0

    def give(self, task: Task) -> None:
        self.task, self.since = task, time.monotonic()
        self.connection.send(task)

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.connection.close()


def _start() -> _Worker:
    ours, theirs = mp.Pipe()
    process = mp.get_context("spawn").Process(target=_work, args=(theirs,), daemon=True)
    process.start()
    theirs.close()
    return _Worker(process, ours)


def run_tasks(todo: Iterator[Task], jobs: int, limit: float, until: float) -> Iterator[dict[str, Any]]:
    """Run tasks in `jobs` processes and yield their rows as they come.

    A process that dies, or is busy for longer than `limit` [s], is replaced and its trial counted as a failure. After
    `until` (of the monotonic clock) nothing new is begun.
    """
    import proof_trial

    workers: list[_Worker] = []
    try:
        for task in itertools.islice(todo, jobs):
            workers.append(_start())
            workers[-1].give(task)
        while any(w.task for w in workers):
            busy = [w for w in workers if w.task]
            ready = wait([w.connection for w in busy], timeout=5.0)
            for worker in busy:
                assert worker.task
                row, late = None, time.monotonic() - worker.since > limit
                if worker.connection in ready:
                    try:
                        row = worker.connection.recv()
                    except (EOFError, OSError):
                        row = proof_trial.blank(worker.task, "the process died")
                elif late:
                    row = proof_trial.blank(worker.task, f"more than {limit:g} s")
                if row is None:
                    continue
                yield row
                if row["failure"] in ("the process died", f"more than {limit:g} s"):
                    worker.end()
                    workers[workers.index(worker)] = worker = _start()
                worker.task = None
                following = next(todo, None) if time.monotonic() < until else None
                if following is not None:
                    worker.give(following)
    finally:
        for worker in workers:
            worker.end()


def _commit() -> str:
    return subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()


def _seeds(args: argparse.Namespace, folder: Path) -> str:
    """Settle the word that seeds follow from: that of the rows there are, or the one asked for, or this commit."""
    path = folder / "seeds.txt"
    before = path.read_text(encoding="utf-8").strip() if path.exists() else None
    word = args.seeds or before or _commit()
    if before and word != before:
        raise SystemExit(f"proof: {folder} holds trials of the seeds {before!r}; give another folder with -o")
    return word


def study(args: argparse.Namespace, folder: Path) -> None:
    """Run trials until the budget is spent, with a bar."""
    word, path = _seeds(args, folder), folder / "trials.csv"
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "seeds.txt", word + "\n")
    rows = read_rows(path)
    if rows and set(rows[0]) != set(FIELDS):
        raise SystemExit(f"proof: {path} has other columns than trials have now; give another folder with -o")
    done = {(row["study"], int(row["index"])) for row in rows}
    options = {"timeout": args.timeout, "pysindy": args.pysindy, "baselines": not args.no_baselines}
    everything = tasks(word, tuple(args.only), **options)
    goal = args.trials or sum(STUDIES[name].most for name in args.only or STUDIES)
    everything = itertools.islice(everything, goal)
    todo = (task for task in everything if (task.study, task.index) not in done)
    begun = time.monotonic()
    until = begun + 3600.0 * args.hours if args.hours else float("inf")
    console = output(stderr=True)
    console.print(f"Seeds follow from {word}; {len(done)} trials are there already.")
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
               TimeRemainingColumn())  # fmt: skip
    with Progress(*columns, console=console, disable=args.quiet or not console.is_terminal) as progress:
        bar = progress.add_task("trials", total=goal, completed=len(done))
        deaths = 0
        for count, row in enumerate(run_tasks(todo, args.jobs, args.timeout + _GRACE, until), start=1):
            deaths = deaths + 1 if row["failure"] == "the process died" else 0
            if deaths == _DEATHS:
                raise SystemExit(f"proof: {_DEATHS} processes in a row died; the rows before them are kept")
            append_row(path, row)
            if args.hours:  # what the pace so far makes of them
                pace = count / (time.monotonic() - begun)
                progress.update(bar, total=min(goal, len(done) + max(count, round(3600.0 * args.hours * pace))))
            progress.update(bar, advance=1, description=f"{row['study']} {row['index']}")


def main(argv: list[str] | None = None) -> int:
    """Parse arguments, run trials, write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, help="begin no trial after this time")
    parser.add_argument("--trials", type=int, help="how many trials there shall be (default: all)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--seeds", metavar="WORD", help="what seeds follow from (default: the current commit's hash)")
    parser.add_argument("--only", nargs="+", choices=tuple(STUDIES), default=[], metavar="STUDY", help="these alone")
    parser.add_argument("--timeout", type=float, default=300.0, help="of one diagnosis [s]")
    parser.add_argument("--pysindy", metavar="PYTHON", help="an interpreter that has pysindy")
    parser.add_argument("--no-baselines", action="store_true", help="leave all baselines out")
    parser.add_argument("--report", action="store_true", help="run nothing, write the page from the rows")
    parser.add_argument("--show", metavar="STUDY/NUMBER", help="print the command that makes this trial again")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.add_argument("-o", "--output", type=Path, help="folder of rows, tables and figures (default: docs/proof)")
    args = parser.parse_args(argv)
    if args.pysindy and subprocess.run([args.pysindy, "-c", "import pysindy"], capture_output=True).returncode:
        parser.error(f"--pysindy {args.pysindy}: this Python does not have pysindy")
    folder = args.output or ROOT / "docs" / "proof"
    if args.show:
        name, _, index = args.show.partition("/")
        if name not in STUDIES or not index.isdigit():
            parser.error(f"--show {args.show}: expected a study ({', '.join(STUDIES)}) and a number, as in plain/7")
        print(trial(_seeds(args, folder), name, int(index)).command)
        return 0
    if not args.report:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)
        try:
            study(args, folder)
        except KeyboardInterrupt:
            print("proof: interrupted; the rows so far are kept", file=sys.stderr)
    from proof_report import write_report

    rows = read_rows(folder / "trials.csv")
    if not rows:
        raise SystemExit(f"proof: {folder} holds no trials")
    page = folder.with_suffix(".md") if args.output is None else folder / "proof.md"
    write_report(rows, folder, page)
    output().print(page.read_text(encoding="utf-8").split("\n## ")[0] if args.quiet else f"Written: {page}")
    return 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(main())
