"""The viewer's server, a process of its own: it replays a motion to any number of browsers, and none is needed.

It is started by `cdm_pin.viewer`, gets a listening socket, and reads pickled messages from standard input: first the
`Show`, then news. When standard input ends, so does it. Browsers confirm each frame they have drawn, so one that is
slow, hidden or gone costs nothing; one that does not even answer is dropped.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import tornado.httpserver
import tornado.web
import tornado.websocket

from . import scene_meshcat
from .show import Show, camera, frame_at
from .stream import read_message
from .viewer_page import library_path, live_page

RATE = 30.0  # frames per second
CATCH_UP = 0.1  # ticks that came late are made up for as long as this [s]
AHEAD = 15  # frames that are placed at once, which costs little more than one
MOST = 500  # news with a time that are kept
IN_FLIGHT = 2  # frames that a browser may have without having drawn them


class Ahead:
    """Frames placed ahead of the clock, from `start` every `step` seconds of the replay, as long as `cause` holds."""

    def __init__(self, start: float = 0.0, step: float = 0.0, cause: Any = None, frames: Sequence[bytes] = ()):
        self.start, self.step, self.cause, self.frames = start, step, cause, frames

    def frame(self, now: float, step: float, cause: Any) -> bytes | None:
        """Give the frame nearest to a time; None if it is not among these, or they were placed for something else."""
        if (step, cause) != (self.step, self.cause):
            return None
        if step == 0.0:
            return self.frames[0] if now == self.start else None
        k = round((now - self.start) / step)
        return self.frames[k] if 0 <= k < len(self.frames) else None


class Player:
    """The clock of the replay and everything the browsers are sent."""

    def __init__(self, show: Show):
        self.show, self.news = show, dict(show.news)
        self.browsers: set[Stream] = set()
        self.history: list[tuple[float, dict[str, Any]]] = []
        self.shown: dict[str, Any] = self.news
        self.playing, self.speed, self.now, self.last = True, 1.0, 0.0, time.monotonic()
        self.ahead = Ahead()
        drawn = (command for scene in show.scenes for command in scene_meshcat.scene_commands(scene))
        self.commands = [*scene_meshcat.stage_commands(), *drawn]
        self.setup = {
            "layout": scene_meshcat.layout(show.scenes),
            "camera": camera(show.scenes, show.q),
            "duration": show.duration,
        }

    def frame(self) -> bytes:
        """Pack the present frame, with its kind (1) and its time in front; the same bytes while nothing changes."""
        step = self.speed / RATE if self.playing and self.show.duration > 0 else 0.0
        cause = [self.shown.get(key) for key in ("residual", "suspects_at", "accepted_at")]
        data = self.ahead.frame(self.now, step, cause)
        if data is None:
            times = self.now + step * np.arange(AHEAD if step else 1)
            times = times % self.show.duration if step else times
            packed = scene_meshcat.pack_frames(frame_at(self.show, times, self.shown)).astype("<f4")
            frames = [struct.pack("<If", 1, t) + row.tobytes() for t, row in zip(times, packed, strict=True)]
            self.ahead, data = Ahead(self.now, step, cause, frames), frames[0]
        return data

    def tick(self) -> None:
        """Advance the clock and serve every browser that has drawn what it got and shows something else than now."""
        now = time.monotonic()
        if self.playing and self.show.duration > 0:
            self.now = (self.now + (now - self.last) * self.speed) % self.show.duration
        self.last = now
        self.look_up()
        ready = [browser for browser in self.browsers if browser.in_flight < IN_FLIGHT]
        if ready:
            data = self.frame()
            for browser in ready:
                if data is not browser.last:
                    browser.last = data
                    browser.in_flight += 1
                    browser.post(data)

    def told(self, news: dict[str, Any]) -> None:
        """Take news from the computation; those with a time wait until the replay gets there."""
        self.history = sorted([*self.history, *news.pop("history", ())], key=lambda entry: entry[0])[-MOST:]
        self.news.update(news)
        self.look_up(anew=True)

    def look_up(self, anew: bool = False) -> None:
        """Show the latest news of the present time of the replay."""
        past = [entry for time, entry in self.history if time <= self.now]
        shown = {**self.news, **(past[-1] if past else {})}
        if anew or shown != self.shown:
            self.shown = shown
            self.tell({"news": shown})

    def asked(self, message: dict[str, Any]) -> None:
        """Obey a browser: play, pause, seek, change speed."""
        self.playing = bool(message.get("playing", self.playing))
        self.speed = float(np.clip(float(message.get("speed", self.speed)), 0.01, 1000.0))
        self.now = float(np.clip(float(message.get("seek", self.now)), 0.0, self.show.duration))
        self.tell({"state": self.state})

    @property
    def state(self) -> dict[str, Any]:
        """Whether it plays, and how fast."""
        return {"playing": self.playing, "speed": self.speed}

    def tell(self, message: dict[str, Any]) -> None:
        """Send a message to every browser."""
        text = json.dumps(message)
        for browser in list(self.browsers):
            browser.post(text)


class Stream(tornado.websocket.WebSocketHandler):
    """One browser."""

    def initialize(self, player: Player) -> None:
        """Set what tornado hands over."""
        self.player, self.in_flight = player, 0
        self.last: bytes | None = None

    def open(self, *args: str, **kwargs: str) -> None:
        """Send a browser the whole scene; it may come at any time."""
        self.set_nodelay(True)
        for command in self.player.commands:
            self.post(struct.pack("<I", 0) + command)
        self.post(json.dumps({**self.player.setup, "state": self.player.state, "news": self.player.shown}))
        self.player.browsers.add(self)

    def on_message(self, message: str | bytes) -> None:
        """Take a confirmation or a wish; anything else is ignored."""
        try:
            content = json.loads(message)
            if "ack" in content:
                self.in_flight = max(0, self.in_flight - int(content["ack"]))
            else:
                self.player.asked(content)
        except (ValueError, TypeError, AttributeError):
            return

    def on_close(self) -> None:
        """Forget a browser that left."""
        self.player.browsers.discard(self)

    def post(self, data: str | bytes) -> None:
        """Send, unless the browser has just left."""
        try:
            self.write_message(data, binary=isinstance(data, bytes)).add_done_callback(lambda done: done.exception())  # pyright: ignore
        except tornado.websocket.WebSocketClosedError:
            self.player.browsers.discard(self)


class Page(tornado.web.RequestHandler):
    """Text that is served as it is."""

    def initialize(self, text: str, kind: str) -> None:
        """Set what tornado hands over."""
        self.text, self.kind = text, kind

    def get(self) -> None:
        """Serve it."""
        self.set_header("Content-Type", f"{self.kind}; charset=utf-8")
        self.write(self.text)


def application(player: Player, host: str) -> tornado.web.Application:
    """Make the web application: the page, meshcat's library, the stream.

    On loopback it answers only to the names of loopback, so that no page of another site can reach it by renaming.
    """
    library = library_path().read_text(encoding="utf-8")
    own = r"(127\.0\.0\.1|localhost|\[?::1\]?)" if host in ("127.0.0.1", "localhost", "::1") else ".*"
    app = tornado.web.Application(websocket_ping_interval=15, websocket_ping_timeout=15)
    app.add_handlers(
        own,
        [
            ("/", Page, {"text": live_page(player.show.title), "kind": "text/html"}),
            ("/main.min.js", Page, {"text": library, "kind": "text/javascript"}),
            ("/stream", Stream, {"player": player}),
        ],
    )
    return app


async def serve(
    listener: socket.socket, host: str, show: Show, listen: Callable[[Callable[[Any], None]], None]
) -> None:
    """Serve until the messages end.

    Parameters
    ----------
    listener : socket
        Bound and listening.
    host : str
        The address it was asked to listen on.
    show : Show
    listen : callable
        Called in a thread with a function that takes each message, and None at the end.
    """
    player, ended, loop = Player(show), asyncio.Event(), asyncio.get_running_loop()

    def take(message: Any) -> None:
        loop.call_soon_threadsafe(ended.set if message is None else lambda: player.told(message))

    server = tornado.httpserver.HTTPServer(application(player, host))
    server.add_socket(listener)
    threading.Thread(target=listen, args=(take,), daemon=True).start()
    due = time.monotonic()
    while not ended.is_set():
        player.tick()
        due = max(due + 1 / RATE, time.monotonic() - CATCH_UP)
        await asyncio.sleep(max(due - time.monotonic(), 0.0))
    server.stop()


def main() -> None:
    """Run as ``python -m cdm_pin.viewer_server FD HOST`` under `cdm_pin.viewer`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(5)  # the computation comes first
    listener = socket.socket(fileno=int(sys.argv[1]))
    listener.setblocking(False)
    show = read_message(sys.stdin.buffer)
    if show is None:
        return

    def listen(take: Callable[[Any], None]) -> None:
        while True:
            message = read_message(sys.stdin.buffer)
            take(message)
            if message is None:
                return

    asyncio.run(serve(listener, sys.argv[2], show, listen))


if __name__ == "__main__":
    main()
