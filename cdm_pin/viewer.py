"""The live viewer: starts its server as a process of its own, and passes it what a computation reports.

The computation never waits for it: messages go through a thread, the newest wins, and a browser may come late, leave or
never come. The server ends with this process, however that ends.
"""

from __future__ import annotations

import argparse
import errno
import queue
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from .console import ProgressCallback, notice, progress_bar
from .errors import InputError
from .model import CableModel
from .recording import Recording, load_recording
from .show import Show, show_recording
from .stream import write_message
from .wording import candidate, place, sentence, with_error

PORT = 7000
PAUSE = 0.4  # between news to the server [s]; those that come faster overtake each other


class Viewer:
    """A server that replays a motion to browsers.

    Parameters
    ----------
    show : Show
    host : str
        Address to listen on; loopback unless told otherwise.
    port : int, optional
        Default the first free one from 7000 on.

    Raises
    ------
    InputError
        If the port is in use or the address is not one of this machine.
    """

    def __init__(self, show: Show, *, host: str = "127.0.0.1", port: int | None = None):
        with listen(host, port) as listener:
            self.url = f"http://{host}:{listener.getsockname()[1]}/"
            handle = listener.fileno()
            self.process = subprocess.Popen(
                [sys.executable, "-m", "cdm_pin.viewer_server", str(handle), host],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=(handle,),
                start_new_session=True,
            )
        self._messages: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._messages.put(show)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._write, daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the server runs."""
        return self.process.poll() is None

    def tell(self, **news: Any) -> None:
        """Pass news on, as the page takes them; returns at once."""
        self._messages.put(news)

    def ask(self, news: Callable[[], dict[str, Any]]) -> None:
        """Have news collected and passed on a little later, by a thread of the viewer; returns at once."""
        self._messages.put(news)

    def close(self) -> None:
        """End the server; never waits longer than three seconds."""
        self._closing.set()
        self._messages.put(None)
        self._thread.join(timeout=1.0)
        try:
            self.process.wait(timeout=2.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _write(self) -> None:
        pipe = self.process.stdin
        assert pipe is not None
        with suppress(OSError, ValueError):
            while (message := self._messages.get()) is not None:
                if callable(message):
                    self._closing.wait(PAUSE)
                    message = message()
                write_message(pipe, message)
        with suppress(OSError):
            pipe.close()


class Listener:
    """A progress callback that tells a viewer: ``listener(step, fraction, **news)``.

    News that the viewer draws: `parameters`, a list of (name, value, standard error); `residual`, rms per motor;
    `suspects` and `accepted`, lists of ``{effect, location}`` or of locations. With `at`, a time of the recording,
    they are shown when the replay gets there; else at once. Others are ignored.
    """

    wants_news = True

    def __init__(self, viewer: Viewer, also: ProgressCallback | None = None):
        self.viewer, self.also = viewer, also
        self._lock = threading.Lock()
        self._news: dict[str, Any] = {}
        self._history: list[Mapping[str, Any]] = []
        self._first: dict[str, tuple[float, float]] = {}

    def __call__(self, step: str, fraction: float, **news: Any) -> None:
        """Take what a computation reports and come back at once; put into words it is later, by the viewer's thread."""
        if self.also is not None:
            self.also(step, fraction, **news)
        for name, value, std in news.get("parameters", ()):
            if name not in self._first:
                self._first[name] = (value, max(2 * 1.96 * std, 1e-12))
        with self._lock:
            waiting = bool(self._news)
            self._news.update({"step": step, "fraction": fraction})
            if "at" in news:
                self._history.append(news)
            else:
                self._news.update(news)
        if not waiting:
            self.viewer.ask(self._told)

    def _told(self) -> dict[str, Any]:
        """Put into words what came since the last time."""
        with self._lock:
            news, self._news = self._news, {}
            history, self._history = self._history, []
        past = [(float(entry["at"]), self._drawn(entry)) for entry in history]
        head = {"step": news["step"], "fraction": float(news["fraction"]), "history": past}
        return {**head, **self._drawn(news)}

    def _drawn(self, news: Mapping[str, Any]) -> dict[str, Any]:
        told: dict[str, Any] = {}
        if "parameters" in news:
            told["parameters"] = [self._row(*parameter) for parameter in news["parameters"][:30]]
        if "residual" in news:
            told["residual"] = [float(value) for value in news["residual"]]
        for key in ("suspects", "accepted"):
            if key in news:
                told[f"{key}_at"] = [dict(entry.get("location", entry)) for entry in news[key]]
                told[key] = [candidate(entry) if "effect" in entry else place(entry) for entry in news[key]]
        return told

    def _row(self, name: str, value: float, std: float) -> tuple[str, str, float, float]:
        """Name, value in words, and where its 95 % interval lies within twice the first one seen (0 to 1)."""
        centre, half = self._first[name]
        low, high = ((value + sign * 1.96 * std - centre) / (2 * half) + 0.5 for sign in (-1, 1))
        return name, with_error(value, std), min(max(low, 0.0), 1.0), min(max(high, 0.0), 1.0)


def add_view_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``--view`` and where to serve it."""
    group = parser.add_argument_group("viewer")
    group.add_argument("--view", action="store_true", help="replay the recording in the browser while computing")
    add_server_arguments(group)


def add_server_arguments(group: Any) -> None:
    """Add where to serve."""
    group.add_argument("--host", default="127.0.0.1", help="address to serve the viewer on (default: %(default)s)")
    group.add_argument("--port", type=int, help=f"port of the viewer (default: the first free one from {PORT})")


class Watching:
    """What `watch` gives: a progress callback for the computation, and the viewer if there is one."""

    def __init__(self, args: argparse.Namespace, viewer: Viewer | None):
        self.args, self.viewer = args, viewer

    @contextmanager
    def progress(self) -> Iterator[ProgressCallback]:
        """Give the callback of a computation: the bar on the terminal, and with ``--view`` the browser."""
        with progress_bar(self.args) as bar:
            yield bar if self.viewer is None else Listener(self.viewer, bar)

    def tell(self, diagnosis: Mapping[str, Any]) -> None:
        """Show a verdict."""
        if self.viewer is not None:
            self.viewer.tell(**link(diagnosis), step="", fraction=1.0)


@contextmanager
def watch(
    args: argparse.Namespace, model: CableModel, recordings: Sequence[Recording | str | Path]
) -> Iterator[Watching]:
    """Serve the viewer around a command's work, if ``--view`` was given.

    On a terminal it stays after the work, until Ctrl-C, so that one can look; else it ends with the work.

    Parameters
    ----------
    args : argparse.Namespace
        As `add_view_arguments` and `cdm_pin.cli` parse them.
    model : CableModel
    recordings : sequence of Recording or path
        The first one is replayed.

    Examples
    --------
    >>> with watch(args, model, recordings) as watching:     # doctest: +SKIP
    ...     with watching.progress() as progress:
    ...         result = identify(model, recordings, progress=progress)
    ...     emit(args, ...)
    """
    if not getattr(args, "view", False):
        yield Watching(args, None)
        return
    with progress_bar(args) as bar:
        bar("preparing the viewer", 0.0)
        first = recordings[0]
        show = show_recording(model, first if isinstance(first, Recording) else load_recording(first, model))
    with Viewer(show, host=args.host, port=args.port) as viewer:
        notice(args, f"watch at {viewer.url}")
        yield Watching(args, viewer)
        if sys.stdin is not None and sys.stdin.isatty():
            notice(args, f"still at {viewer.url}; Ctrl-C ends it")
            with suppress(KeyboardInterrupt):
                while viewer.alive:
                    time.sleep(0.1)


def listen(host: str, port: int | None) -> socket.socket:
    """Open a listening socket.

    Raises
    ------
    InputError
        If it cannot be had.
    """
    tried = [port] if port is not None else [*range(PORT, PORT + 20), 0]
    for number in tried:
        if not 0 <= number < 65536:
            raise InputError(f"is no port; 0 to 65535 was expected, found {number}", place="--port")
        listener = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, number))
            listener.listen(16)
            return listener
        except OSError as exc:
            listener.close()
            if exc.errno in (errno.EADDRINUSE, errno.EACCES):
                if port is None:
                    continue
                why = "is in use by another program" if exc.errno == errno.EADDRINUSE else "needs more rights"
                raise InputError(f"port {number} {why}; choose another one", place="--port") from None
            raise InputError(f"cannot listen on {host!r} ({exc.strerror or exc})", place="--host") from None
    raise InputError("no free port was found", place="--port")


def link(diagnosis: Mapping[str, Any]) -> dict[str, Any]:
    """Turn a diagnosis into news: its verdict, what was found and where, and the error that is left."""
    findings = diagnosis.get("findings") or []
    rest = diagnosis.get("unexplained") or {}
    news: dict[str, Any] = {
        "lines": [sentence(diagnosis)],
        "accepted": [candidate(finding) for finding in findings],
        "accepted_at": [dict(finding.get("location") or {}) for finding in findings],
        "suspects": [f"unexplained, {place(rest['location'])}"] if rest.get("location") else [],
        "suspects_at": [dict(rest["location"])] if rest.get("location") else [],
    }
    fit = diagnosis.get("fit") or {}
    left = (fit.get("holdout") or fit.get("train") or {}).get("rmse_augmented")
    return {**news, "residual": [float(value) for value in left]} if left and None not in left else news
