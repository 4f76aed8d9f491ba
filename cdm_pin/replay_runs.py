"""The runs of a diagnosis replayed with the rigid and with the completed model."""

from __future__ import annotations

from dataclasses import replace

from .geometry import Manipulator
from .problem import _torque
from .replay import MOST, Replay
from .replay import replay as run_again
from .selection import Fit, Search, updated_model

ONCE = ("external_torque",)
"""What happens at a time of one recording, and says nothing about another."""


def replay_runs(
    search: Search, judge: Search | None, rigid: Fit, fit: Fit, completed: Manipulator, *, horizon: float = 1.0
) -> tuple[Replay, ...]:
    """Replay the unseen recordings, or where there are none those that were fitted.

    Parameters
    ----------
    search, judge : Search
        Of the recordings fitted to, and of the unseen ones.
    rigid, fit : Fit
        Without effects and with them; their base parameters are the models'.
    completed : Manipulator
        With the effects that were found.
    horizon : float
        Length of a window [s].

    Returns
    -------
    tuple of Replay
        One per recording that has a valid window; empty without torques.
    """
    judged = judge or search
    if not judged.problem.torque:
        return ()
    if judge is not None:
        kept = tuple(effect for effect in completed.effects if effect["effect"] not in ONCE)
        completed = replace(completed, effects=kept)
    start = search.problem.model
    plain = updated_model(start, search.base, rigid.base)
    whole = replace(updated_model(start, search.base, fit.base), manipulator=completed)
    most = max(3, MOST // len(judged.problem.runs))
    found = [
        run_again(
            plain,
            whole,
            run.motion,
            _torque(plain, run.signals),
            run.signals.valid,
            horizon=horizon,
            most=most,
            label=run.name,
        )
        for run in judged.problem.runs
    ]
    return tuple(each for each in found if each is not None)
