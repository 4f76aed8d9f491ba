"""``cdm-pin view``: a robot, a recording, or a result in the browser."""

from __future__ import annotations

import argparse
import json
import time
import webbrowser
from pathlib import Path
from typing import Any

from ..console import emit, notice, progress_bar
from ..errors import InputError
from ..files import read_text
from ..model import load_model
from ..recording import load_recording


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    from ..viewer import add_server_arguments

    parser.add_argument("model", help="manipulator.yaml or model.yaml")
    parser.add_argument("recording", nargs="?", help="the motion to replay; without it the robot stands still")
    parser.add_argument("--diagnosis", metavar="FILE", help="diagnosis.json whose findings are to light up")
    parser.add_argument("--forces", action="store_true", help="draw the forces of cables on pulleys")
    parser.add_argument("--open", action="store_true", help="open the page in the browser of this machine")
    parser.add_argument("--for", dest="seconds", type=float, metavar="SECONDS", help="stop by itself after that long")
    parser.add_argument("-o", "--output", metavar="FILE", help="write a page that plays from disk, and serve nothing")
    add_server_arguments(parser.add_argument_group("viewer"))


def run(args: argparse.Namespace) -> int:
    """Run the command until it is interrupted."""
    from ..animation import write_animation
    from ..show import show_model, show_recording
    from ..viewer import Viewer, link

    if args.seconds is not None and not args.seconds > 0:
        raise InputError(f"a time above 0 s was expected, found {args.seconds:g}", place="--for")
    model = load_model(args.model)
    news = link(_diagnosis(args.diagnosis)) if args.diagnosis else {}
    with progress_bar(args) as progress:
        if args.recording is None:
            show = show_model(model, news)
        else:
            progress("reading the recording", 0.0)
            recording = load_recording(args.recording, model)
            progress("preparing the motion", 0.5)
            show = show_recording(model, recording, forces=args.forces, news=news)
    if args.output:
        write_animation(args.output, show)
        emit(args, {"written": args.output}, f"Written: {args.output}")
        return 0
    with Viewer(show, host=args.host, port=args.port) as viewer:
        emit(args, {"url": viewer.url}, f"Serving {show.title} at {viewer.url} (Ctrl-C ends it)")
        if args.open and not webbrowser.open(viewer.url):
            notice(args, f"no browser was found on this machine; open {viewer.url} in one")
        end = time.monotonic() + (args.seconds if args.seconds is not None else float("inf"))
        while viewer.alive and time.monotonic() < end:
            time.sleep(0.1)
        if not viewer.alive:
            raise RuntimeError("the viewer's server ended unexpectedly")
    return 0


def _diagnosis(path: str) -> dict[str, Any]:
    try:
        content = json.loads(read_text(path))
    except json.JSONDecodeError as exc:
        raise InputError("is not JSON", source=path, place=f"line {exc.lineno}, column {exc.colno}") from None
    if not isinstance(content, dict) or "verdict" not in content:
        raise InputError("is not a diagnosis (no key 'verdict')", source=Path(path))
    return content
