"""Settling: the columns of effects about the completed model and the shapes of all, estimated in turn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .candidates import Candidate
from .fit import Fit
from .masses import about
from .search import Search
from .shapes import restarted, tuned, yielding
from .whitening import Whitener

SETTLING = 12
"""Rounds in which columns that follow the torques of others come to rest; delayed friction takes the most."""


def settled(search: Search, accepted: list[Candidate], rounds: int = 2) -> tuple[Search, list[Candidate]]:
    """Take the columns of what was found about the completed model, and estimate all shapes together.

    Where columns depend on what is estimated, that takes as many rounds as it changes by more than its errors.
    """
    search = tied(search, accepted)
    if accepted:
        search, accepted = in_turn(search, accepted, rounds=rounds)
        for _ in range(SETTLING if any(c.effect.follows and not c.effect.exact for c in accepted) else 0):
            before = search.fit(accepted)
            search, accepted = in_turn(search, accepted, rounds=1)
            if not _has_moved(before, search.fit(accepted)):
                break
        accepted = restarted(search, accepted, search.noise(accepted))
        accepted = yielding(search, accepted, search.noise(accepted))
    if accepted or search.problem.loads:  # what was withdrawn brings no torque
        search = about(search, search.fit(accepted))
    return search, accepted


def in_turn(
    search: Search, effects: list[Candidate], whitener: Whitener | None = None, rounds: int = 2
) -> tuple[Search, list[Candidate]]:
    """Move the search about the completed model and estimate all shapes, in turn; in one noise or in what is left."""
    for _ in range(rounds):
        search = about(search, search.fit(effects, whitener))
        effects = tuned(search, effects, whitener or search.noise(effects))
    return search, effects


def _has_moved(before: Fit, after: Fit, least: float = 0.3) -> bool:
    """Whether any coefficient of a fit differs from that of another one by more than a share of its error."""
    step = np.concatenate(after.beta) - np.concatenate(before.beta)
    std = np.sqrt(np.diag(after.covariance)[-len(step) :])
    return bool(np.any(np.abs(step) > least * np.maximum(std, 1e-300)))


def tied(search: Search, accepted: Sequence[Candidate]) -> Search:
    """Give the search with all cables rigid if the soft one, on which the links swing, is not among some effects."""
    if any(c.is_swinging(search.problem.motions[0]) for c in accepted):
        return search
    return search.stiff
