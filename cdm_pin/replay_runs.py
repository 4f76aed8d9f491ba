"""The runs of a diagnosis replayed with the rigid and with the completed model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .base import updated_model
from .consistency import consistent_standard
from .dynamics import mass_matrix
from .errors import CdmError
from .fit import Fit
from .geometry import Manipulator
from .measured import measured_torques
from .model import CableModel, build_model
from .motion import Motion
from .replay import MOST, Replay
from .replay import replay as run_again
from .search import Search

LEAST = 0.1  # inertia along any coordinate, as a share of the file's, below which a fit counts as no body's
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
    plain = _moving(search, rigid, completed)
    whole = replace(_moving(search, fit, completed), manipulator=completed)
    most = max(3, MOST // len(judged.problem.runs))
    found = [
        run_again(
            run.carrying(plain),
            run.carrying(whole),
            _where_links_are(run.motion),
            measured_torques(plain, run.signals.logged),
            run.signals.valid,
            horizon=horizon,
            most=most,
            label=run.name,
        )
        for run in judged.problem.runs
    ]
    return tuple(each for each in found if each is not None)


def _where_links_are(motion: Motion) -> Motion:
    """Take links that swing on a soft cable as if their joints had been measured."""
    return motion if motion.swing is None else replace(motion, swing=None, felt=None, joints_measured=True)


def _moving(search: Search, fit: Fit, completed: Manipulator) -> CableModel:
    """Give the fitted model, or where data left it an inertia that no body has, the nearest one that can move."""
    start, base = search.problem.model, search.base
    model = updated_model(start, base, fit.base)
    prior = build_model(completed)
    poses = np.concatenate([motion.q[:: max(1, motion.n // 50)] for motion in search.problem.motions])
    least = [np.linalg.eigvalsh(mass_matrix(each, poses, coordinates="motor")).min() for each in (model, prior)]
    if least[0] > LEAST * least[1]:
        return model
    p = len(base.columns)
    values = base.values(start.standard_parameters) + fit.base[:p]
    information = np.asarray(np.linalg.pinv(fit.covariance[:p, :p], rcond=1e-12, hermitian=True), np.float64)
    try:
        near = consistent_standard(base.matrix, values, information, prior.standard_parameters)
    except (CdmError, np.linalg.LinAlgError):
        return model
    return model.with_standard_parameters(near.parameters)
