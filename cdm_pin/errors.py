"""What can go wrong, by kind; the command line turns each into one line and exit status 2."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from os import PathLike


class CdmError(Exception):
    """Base of every error a user of the package can meet."""


class InputError(CdmError, ValueError):
    """An input that cannot be read or that contradicts itself.

    Parameters
    ----------
    message : str
        What was found and what was expected.
    source : path-like, optional
        The file that is at fault.
    place : str, optional
        Where in it: ``"row 12, column joint_position_1"``, ``"links[2].mass"``.
    """

    def __init__(self, message: str, *, source: str | PathLike[str] | None = None, place: str | None = None):
        self.message, self.source, self.place = message, source, place
        super().__init__(": ".join([str(part) for part in (source, place) if part] + [message]))

    def __reduce__(self):
        return _rebuild, (type(self), self.message, self.source, self.place)


def _rebuild(kind, message, source, place):
    return kind(message, source=source, place=place)


class GeometryError(InputError):
    """Pulley geometry that no cable can follow."""


class ManipulatorError(InputError):
    """A manipulator file that cannot describe a robot."""


class RecordingError(InputError):
    """A recording that cannot be read or that contradicts the robot."""


class ShapeError(CdmError, ValueError):
    """Arrays whose shapes do not fit each other or the model."""


class SimulationError(CdmError):
    """A simulation that diverged."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Say which known name comes nearest to `name`, as a sentence end (empty if none is near).

    Returns
    -------
    str
        ``"; did you mean 'mass'?"`` or ``""``.
    """
    match = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"; did you mean {match[0]!r}?" if match else ""
