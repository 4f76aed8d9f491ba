"""Motions saved as one HTML file that plays from disk."""

from __future__ import annotations

import os

import numpy as np

from .errors import ShapeError
from .files import write_text
from .model import CableModel
from .scene_meshcat import layout, pack_frames, scene_commands, stage_commands
from .show import RATE, Show, camera, frame_at, show_ghosts
from .viewer_page import saved_page

MOST_FRAMES = 1200
SMOOTH = 10.0  # pictures a second below which a page says so [Hz]


def write_ghosts(
    path: str | os.PathLike[str],
    model: CableModel,
    time: np.ndarray,
    recorded: np.ndarray,
    rigid: np.ndarray,
    completed: np.ndarray,
    *,
    restart: float | None = None,
) -> None:
    """Save three ghosts: the recorded motion, and those simulated with the rigid and with the completed model.

    Parameters
    ----------
    path : path-like
        The HTML file to write.
    model : CableModel
    time : ndarray, shape (n,)
        [s].
    recorded, rigid, completed : ndarray, shape (n, n_joints)
        Joint positions, started together from the same state [rad or m]; a simulation that ended early may hold NaN,
        where its ghost stands still.
    restart : float, optional
        How often the simulations were started anew from the recorded state [s].

    Raises
    ------
    ShapeError
        If the shapes disagree.
    """
    motions = {"recorded": recorded, "rigid": rigid, "completed": completed}
    for name, motion in motions.items():
        if np.shape(motion) != (len(time), model.n_joints):
            raise ShapeError(f"{name} has shape {np.shape(motion)}, ({len(time)}, {model.n_joints}) was expected")
    start = "from the same state" if restart is None else f"anew from the recorded state every {restart:g} s"
    words = [
        f"Three motions, started together {start}:",
        "dark: as recorded; orange: simulated with the rigid model; blue: simulated with the completed model.",
    ]
    write_animation(path, show_ghosts(model, time, {k: _held(np.asarray(m, float)) for k, m in motions.items()}), words)


def write_animation(path: str | os.PathLike[str], show: Show, lines: tuple[str, ...] | list[str] = ()) -> None:
    """Save a show as one file that plays from disk, at most `MOST_FRAMES` frames of it, whole or not at all.

    Parameters
    ----------
    path : path-like
    show : Show
    lines : sequence of str
        Words for the panel.
    """
    count = int(min(MOST_FRAMES, show.duration * RATE + 1.5))
    times = np.linspace(0.0, show.duration, count) if count > 1 else np.zeros(1)
    rate = (count - 1) / show.duration if count > 1 else RATE
    frames = pack_frames(frame_at(show, times, show.news))
    commands = [*stage_commands(), *(command for scene in show.scenes for command in scene_commands(scene))]
    if rate < SMOOTH:
        lines = [*lines, f"A long motion: one picture every {1 / rate:.2g} s."]
    news = {**show.news, "lines": [*lines, *(show.news.get("lines") or [])]}
    page = saved_page(show.title, commands, layout(show.scenes), camera(show.scenes, show.q), frames, rate, news)
    write_text(path, page)


def _held(motion: np.ndarray) -> np.ndarray:
    """Hold the last finite value of each column."""
    out = motion.copy()
    for column in out.T:
        bad = ~np.isfinite(column)
        if bad.any():
            last = np.maximum.accumulate(np.where(bad, -1, np.arange(len(column))))
            column[:] = np.where(last >= 0, column[np.maximum(last, 0)], 0.0)
    return out
