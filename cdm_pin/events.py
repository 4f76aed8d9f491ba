"""What a search tells those who listen: who is under suspicion, who was accepted, and the error that is left."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from .candidates import Candidate
from .fit import Fit
from .geometry import Vector
from .search import Search, errors, rms

ProgressCallback = Callable[[str, float], None]

SUSPECTS = 6  # that are named at once


class Reporter:
    """Passes the steps of a search on as ``progress(step, fraction, **news)``.

    News (`suspects` and `accepted` as ``{effect, location}``, `residual` as rms per motor) are made only for callbacks
    with a true attribute `wants_news`, so that a search nobody watches pays nothing for it.

    Parameters
    ----------
    search : Search
    progress : callable, optional
    """

    def __init__(self, search: Search, progress: Callable[..., None] | None = None):
        self.search, self.progress = search, progress
        self._step, self._fraction = "", 0.0

    def __call__(self, step: str, fraction: float) -> None:
        """Name the step and the fraction done."""
        self._step, self._fraction = step, fraction
        if self.progress is not None:
            self.progress(step, fraction)

    def looked(self, fit: Fit, suspects: Sequence[Candidate] = ()) -> None:
        """Say what stands in the model now, and what comes into question next."""
        if self.progress is None:
            return
        self._fraction = min(self._fraction + 0.05, 0.95)
        if not getattr(self.progress, "wants_news", False):
            self.progress(self._step, self._fraction)
            return
        accepted = [entry(candidate) for candidate in fit.effects]
        asked = [e for e in map(entry, suspects[:SUSPECTS]) if e not in accepted]
        news: dict[str, Any] = {"suspects": asked, "accepted": accepted}
        if self.search.problem.torque:
            news["residual"] = _residual(self.search, fit)
        self.progress(self._step, self._fraction, **news)


def entry(candidate: Candidate) -> dict[str, Any]:
    """Give effect and location of a candidate as the diagnosis format has them; what has no name is its location."""
    location = candidate.location
    return {"effect": candidate.effect.name, "location": location} if candidate.named else location


def _residual(search: Search, fit: Fit) -> Vector:
    """Compute the error of a fit in the band, rms per motor, shape (n_motors,) [N m]."""
    return rms(search, errors(search, fit.base, fit.effects, fit.beta))[: search.problem.model.n_motors]
