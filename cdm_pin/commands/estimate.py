"""``cdm-pin estimate MODEL RECORDING -o FILE``: the output side of the transmission from its input side."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..console import emit, table
from ..estimates import estimated_output
from ..model import load_model
from ..recording import Recording, load_recording, save_recording
from ..torques import rms


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("model", metavar="MODEL", help="manipulator.yaml or model.yaml")
    parser.add_argument("recording", metavar="RECORDING", help="recording with motor positions (and motor torques)")
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help="recording to write")


def run(args: argparse.Namespace) -> int:
    """Run the command."""
    model = load_model(args.model)
    recording = load_recording(args.recording, model)
    channels = estimated_output(model, recording)
    save_recording(Recording(recording.time, channels, source=Path(args.output)), args.output)
    compared = [
        [name, i + 1, error]
        for name, x in channels.items()
        if name in recording.channels
        for i, error in enumerate(rms(x - recording.channels[name]))
    ]
    shown = [table("Against what was logged", ["quantity", "number", "difference, rms"], compared)] if compared else []
    emit(
        args, {"file": args.output, "difference": compared}, *shown, f"wrote {args.output}, {len(recording.time)} rows"
    )
    return 0
