"""Messages from the viewer's owner to its server: pickled, each with its length in front."""

from __future__ import annotations

import pickle
import struct
from typing import Any, BinaryIO, cast


def write_message(stream: Any, message: Any) -> None:
    """Write one message."""
    data = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    stream.write(struct.pack("<Q", len(data)) + data)
    stream.flush()


def read_message(stream: BinaryIO) -> Any:
    """Read one message; None at the end of the stream."""
    head = stream.read(8)
    if len(head) < 8:
        return None
    data = stream.read(cast(int, struct.unpack("<Q", head)[0]))
    try:
        return pickle.loads(data)
    except (EOFError, pickle.UnpicklingError):
        return None
