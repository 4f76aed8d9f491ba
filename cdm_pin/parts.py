"""Where no recording is unseen, contiguous parts of those at hand judge each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .drifting import still_errors
from .fit import Fit
from .geometry import Vector
from .recent import kept
from .search import Search, rms
from .unseen import deviance_unseen

MANY = 4
"""Parts of a single recording."""


@dataclass(frozen=True)
class Part:
    """A stretch of the recordings as if it had not been seen.

    Attributes
    ----------
    own, others : Search
        On the rows of the part, and on those of all others.
    """

    own: Search
    others: Search


@kept
def parts_of(search: Search) -> list[Part]:
    """Divide recordings into contiguous parts: each is one, a single one is divided into as many equal ones.

    None where fewer than two of them have rows that count.
    """
    runs = search.problem.runs
    turns = [np.full(run.motion.n, i) for i, run in enumerate(runs)]
    if len(runs) == 1:
        turns = [_quarters(run.signals.valid) for run in runs]
    masks = [[turn == k for turn in turns] for k in range(max(len(runs), MANY))]
    parts = [Part(_seeing(search, own), _seeing(search, [~mask for mask in own])) for own in masks]
    parts = [part for part in parts if any(part.own.problem.segments) and any(part.others.problem.segments)]
    return parts if len(parts) > 1 else []


def _quarters(valid: np.ndarray) -> np.ndarray:
    """Say in which of so many parts with equally many valid samples each sample is, 0 to MANY - 1, shape (n,)."""
    return np.minimum(MANY * np.cumsum(valid) // max(int(valid.sum()), 1), MANY - 1)


def _seeing(search: Search, masks: Sequence[np.ndarray]) -> Search:
    pairs = zip(search.problem.runs, masks, strict=True)
    runs = [replace(run, signals=replace(run.signals, valid=run.signals.valid & mask)) for run, mask in pairs]
    return search.seeing(replace(search.problem, runs=tuple(runs)))


def deviance_apart(parts: Sequence[Part], fit: Fit) -> float:
    """Twice the negative logarithm of how likely all parts are, each after the fit to the others; up to a constant."""
    return sum(deviance_unseen(part.own, part.others.fit(fit.effects, fit.whitener)) for part in parts)


def reduction_apart(parts: Sequence[Part], fit: Fit, without: Fit) -> float | None:
    """Say by which share the error of each part falls after the fit to the others, if that has all of its effects.

    Channels count in units of what is left then; None without parts.
    """
    if not parts:
        return None
    after, before = (_squares(parts, f) for f in (fit, without))
    return 1.0 - float(1.0 / np.sqrt(np.mean(before / np.maximum(after, 1e-24))))


def _squares(parts: Sequence[Part], fit: Fit) -> Vector:
    """Squared errors of all parts after the fit to the others, per channel."""
    lengths = [sum(stop - start for run in part.own.problem.segments for start, stop in run) for part in parts]
    fits = [part.others.fit(fit.effects, fit.whitener) for part in parts]
    squares = [rms(part.own, still_errors(part.own, f)) ** 2 for part, f in zip(parts, fits, strict=True)]
    return np.average(squares, axis=0, weights=lengths)
