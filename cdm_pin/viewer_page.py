"""The viewer's page: meshcat's own drawing library with a panel for news and a bar to play, pause and seek.

Live it listens to a server on the same address (`live_page`); saved it carries its frames within (`saved_page`). Either
way it asks nothing of any other address.
"""

from __future__ import annotations

import base64
import importlib.util
import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

LIVE = """
let latest = null, socket = null, taken = 0;
function send(message) { if (socket && socket.readyState === 1) socket.send(JSON.stringify(message)); }
function turn() {
  if (!latest || !nodes) return;
  const data = latest; latest = null;
  showTime(new Float32Array(data, 4, 1)[0]);
  showFrame(new Float32Array(data, 8));
  send({ack: taken});
  taken = 0;
}
function connect() {
  socket = new WebSocket((location.protocol === "https:" ? "wss://" : "ws://") + location.host + "/stream");
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { byId("lost").textContent = ""; taken = 0; };
  socket.onclose = () => { byId("lost").textContent = "no connection"; setTimeout(connect, 1000); };
  socket.onmessage = event => {
    if (typeof event.data === "string") {
      const m = JSON.parse(event.data);
      if (m.layout) { setDuration(m.duration); setLayout(m.layout); setCamera(m.camera); }
      if (m.state) { setPlaying(m.state.playing); byId("speed").value = m.state.speed; }
      if (m.news) showNews(m.news);
    } else if (new Uint8Array(event.data)[0] === 1) { latest = event.data; taken++; ask(); }
    else viewer.handle_command_bytearray(new Uint8Array(event.data, 4));
  };
}
byId("play").onclick = () => send({playing: !playing});
byId("speed").onchange = () => send({speed: +byId("speed").value});
byId("seek").oninput = () => { dragging = true; send({seek: +byId("seek").value}); };
byId("seek").onchange = () => { dragging = false; };
connect();
"""

SAVED = """
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
const saved = JSON.parse(byId("saved").textContent);
for (const command of saved.commands) viewer.handle_command_bytearray(bytes(command));
const low = new Float32Array(bytes(saved.low).buffer), span = new Float32Array(bytes(saved.span).buffer);
const codes = new Uint16Array(bytes(saved.codes).buffer), width = low.length;
const frames = new Float32Array(saved.count * width);
for (let k = 0, c = 0; k < saved.count; k++)
  for (let i = 0; i < width; i++) frames[k * width + i] = low[i] + (span[i] ? codes[c++] / 65535 * span[i] : 0);
let now = 0, before = null, shown = -1;
function turn(stamp) {
  ask();
  if (playing && before !== null) now += (stamp - before) / 1000 * +byId("speed").value;
  before = stamp;
  if (now > duration) now = 0;
  const k = Math.min(Math.round(now * saved.rate), saved.count - 1);
  if (k !== shown) { showFrame(frames.subarray(k * width, (k + 1) * width)); shown = k; showTime(now); }
}
setDuration((saved.count - 1) / saved.rate); setLayout(saved.layout); setCamera(saved.camera); showNews(saved.news);
byId("play").onclick = () => setPlaying(!playing);
byId("seek").oninput = () => { now = +byId("seek").value; };
ask();
"""


def library_path() -> Path:
    """Find meshcat's drawing library (without importing meshcat)."""
    spec = importlib.util.find_spec("meshcat")
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).parent / "viewer" / "dist" / "main.min.js"


def live_page(title: str) -> str:
    """Give the page that listens to `cdm_pin.viewer_server`."""
    return _page(title, '<script src="/main.min.js"></script>', LIVE)


def saved_page(
    title: str,
    commands: Sequence[bytes],
    layout: dict[str, Any],
    camera: dict[str, Any],
    frames: np.ndarray,
    rate: float,
    news: Mapping[str, Any],
) -> str:
    """Give a page that plays from disk.

    Parameters
    ----------
    title : str
    commands : sequence of bytes
        What is drawn once, see `scene_meshcat`.
    layout, camera : dict
        See `scene_meshcat.layout`, `show.camera`.
    frames : ndarray of float32, shape (n, m)
        See `scene_meshcat.pack_frames`; kept to 1/65535 of each column's range.
    rate : float
        Frames per second [Hz].
    news : mapping
        What the panel shows.
    """
    low, span = frames.min(axis=0), np.ptp(frames, axis=0)
    moves = span > 0
    codes = np.round((frames[:, moves] - low[moves]) / span[moves] * 65535)
    content = {
        "commands": [base64.b64encode(command).decode() for command in commands],
        "layout": layout,
        "camera": camera,
        "low": _text(low, "<f4"),
        "span": _text(span, "<f4"),
        "codes": _text(codes, "<u2"),
        "count": len(frames),
        "rate": rate,
        "news": {"title": title, **news},
    }
    held = json.dumps(content).replace("<", "\\u003c")
    library = f"<script>{library_path().read_text(encoding='utf-8')}</script>"
    data = f'<script id="saved" type="application/json">{held}</script>'
    return _page(title, library + data, SAVED)


def _text(array: np.ndarray, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(array, dtype=kind).tobytes()).decode()


def _page(title: str, library: str, script: str) -> str:
    page = (Path(__file__).parent / "viewer.html").read_text(encoding="utf-8")
    return page.replace("{{title}}", escape(title)).replace("{{library}}", library).replace("{{script}}", script)
