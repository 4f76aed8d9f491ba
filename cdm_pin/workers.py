"""Do one thing to each of many recordings, on any executor, and give the results in the order of the recordings.

A process that dies takes the work it held with it; that work is done again, and a recording that kills its process
twice with nothing else running is named. Bad recordings stop everything, unless they are to be skipped.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

from .errors import CdmError, InputError, RecordingError


@dataclass(frozen=True)
class Skipped:
    """A recording that was left out, and why."""

    name: str
    reason: str


class InProcess(Executor):
    """Executor that runs each call at once, in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        """Run the call and give its finished future."""
        future: Future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as exc:
            future.set_exception(exc)
        return future


class Workers:
    """An executor that is made when first needed, kept from one task to the next, and made anew when it breaks.

    Parameters
    ----------
    make : callable
        Gives an executor.
    end : callable
        Lets go of it, and of what it has not begun.
    """

    def __init__(self, make: Callable[[], Executor] = InProcess, end: Callable[[Executor], None] | None = None):
        self.make = make
        self._end = end or (lambda executor: executor.shutdown(wait=False, cancel_futures=True))
        self._executor: Executor | None = None

    @property
    def in_process(self) -> bool:
        """Whether work is done in this process."""
        return self.make is InProcess

    @property
    def executor(self) -> Executor:
        """The executor, made now if there is none."""
        if self._executor is None:
            self._executor = self.make()
        return self._executor

    def close(self) -> None:
        """Let go of the executor, and of what it has not begun."""
        if self._executor is not None:
            self._end(self._executor)
        self._executor = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class _Processes(ProcessPoolExecutor):
    """Processes that never see an interrupt, not even while they start: who started them is interrupted."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        """Start processes (a part of submitting) with the signal blocked, which they inherit."""
        if not hasattr(signal, "pthread_sigmask"):
            return super().submit(fn, *args, **kwargs)
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            return super().submit(fn, *args, **kwargs)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def processes(count: int) -> Workers:
    """Give `count` fresh processes, one thread of linear algebra each."""
    return Workers(lambda: _Processes(count, mp_context=get_context("spawn"), initializer=_begin_process))


def cluster(address: str) -> Workers:
    """Give the workers of an existing Dask scheduler.

    Raises
    ------
    InputError
        If the optional packages are missing or the scheduler does not answer.
    """
    try:
        from distributed import Client  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise InputError("a cluster needs the optional packages: pip install 'cdm-pin[cluster]'") from None
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError) as exc:
        raise InputError(f"no Dask scheduler answers ({exc})", source=address) from None

    def end(executor: Executor) -> None:
        executor.shutdown(wait=False)
        client.close()

    return Workers(client.get_executor, end)


def run_all(
    function: Callable[[Any], Any],
    items: Sequence[Any],
    workers: Workers,
    *,
    names: Sequence[str] | None = None,
    skip_bad: bool = False,
    window: int = 16,
    progress: Callable[[float], None] | None = None,
) -> Iterator[Any]:
    """Apply `function` to each item and yield results in the order of the items.

    Parameters
    ----------
    function : callable
        Of one item; must be picklable for other processes.
    items : sequence
    workers : Workers
    names : sequence of str, optional
        Of the items, for messages.
    skip_bad : bool
        Yield `Skipped` for an item that raises a `CdmError` or kills its process, instead of raising.
    window : int
        Items under way at once: results are kept only for these.
    progress : callable, optional
        Takes the fraction done.

    Raises
    ------
    CdmError
        Of the first item (in order) that has one, or a `RecordingError` naming an item that killed its process twice.
    """
    crew = _Crew(function, items, workers, names or [str(item) for item in items], window)
    try:
        for k in range(len(items)):
            try:
                result = crew.result(k)
            except CdmError as exc:
                if not skip_bad:
                    raise
                result = Skipped(crew.names[k], str(exc))
            if progress is not None:
                progress((k + 1) / len(items))
            yield result
    finally:
        crew.cancel()


class _Crew:
    """Keeps a window of items under way and starts again what a broken executor lost."""

    def __init__(
        self,
        function: Callable[[Any], Any],
        items: Sequence[Any],
        workers: Workers,
        names: Sequence[str],
        window: int,
    ):
        self.function, self.items, self.workers, self.names = function, items, workers, names
        self.window = 1 if workers.in_process else window
        self.futures: dict[int, Future] = {}
        self.deaths: dict[int, int] = {}

    def result(self, k: int) -> Any:
        """Wait for item `k`, keeping the window full; what was under way in a crash is done again alone."""
        while True:
            alone = self.deaths.get(k, 0) > 0
            try:
                for j in range(k, k + 1 if alone else min(k + self.window, len(self.items))):
                    if j not in self.futures and (j == k or not self.deaths.get(j)):
                        self.futures[j] = self.workers.executor.submit(self.function, self.items[j])
                result = self.futures[k].result()
                del self.futures[k]
                return result
            except BrokenExecutor:
                self._restart(k, alone)
            except CancelledError:
                raise CdmError(f"the cluster was lost while it worked on {self.names[k]}") from None
            except _lost_worker_errors():
                raise RecordingError("killed every worker that took it", source=self.names[k]) from None

    def cancel(self) -> None:
        """Give up what has not begun."""
        for future in self.futures.values():
            future.cancel()

    def _restart(self, k: int, alone: bool) -> None:
        lost = [j for j, f in self.futures.items() if not f.done() or isinstance(f.exception(), BrokenExecutor)]
        for j in lost:
            del self.futures[j]
            self.deaths[j] = max(self.deaths.get(j, 0), 1)
        self.workers.close()
        if alone:
            self.deaths[k] += 1
            if self.deaths[k] > 2:
                raise RecordingError("killed the process that worked on it, twice", source=self.names[k])


def _lost_worker_errors() -> tuple[type[Exception], ...]:
    """Errors by which a cluster says that it gave up on an item."""
    try:
        from distributed import KilledWorker  # pyright: ignore[reportMissingImports]
    except ImportError:
        return ()
    return (KilledWorker,)


def _begin_process() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that started this one is interrupted, and ends it
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
