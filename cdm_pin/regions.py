"""In which states, and when, an effect shows: where the part of it that no rigid body imitates has its energy."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from .candidates import Candidate
from .fit import Fit
from .geometry import Vector
from .motion import Motion
from .search import Search, brought
from .units import unit_at
from .whitening import inside

BINS = 8  # of angle and of time
CLEAR = 1.8  # times the energy per second that a region has to have over the mean


def visible_energy(search: Search, fit: Fit, j: int) -> list[Vector]:
    """Square the torque (or travel) of effect `j` that the rigid body leaves over, in units of the noise.

    Returns
    -------
    list of ndarray, shape (n_reduced,)
        Sum over the channels, one per run.
    """
    own = brought(search, fit.effects[j], fit.beta[j])
    level = 1.0 / np.maximum(np.abs(np.diag(fit.whitener.mix)), 1e-300)
    A = np.concatenate([(rigid / level[:, None]).reshape(len(rigid), -1) for rigid in search.rigid], axis=1)
    b = np.concatenate([(x / level[:, None]).ravel() for x in own])
    scale = np.linalg.norm(A, axis=1)
    A = A[scale > 0] / scale[scale > 0, None]
    rest = b - A.T @ np.linalg.lstsq(A @ A.T, A @ b, rcond=1e-10)[0] if len(A) else b
    out, first = [], 0
    for x in own:
        part = rest[first : first + x.size].reshape(x.shape)
        out.append(np.sum(part**2, axis=0))
        first += x.size
    return out


def region(search: Search, fit: Fit, j: int) -> str:
    """Say in words where effect `j` shows most, against how long the robot was there.

    Parameters
    ----------
    search : Search
    fit : Fit
    j : int

    Returns
    -------
    str
        ``"around reversals of joint 2"``, or ``"throughout"`` where no region stands out.
    """
    candidate, energies = fit.effects[j], visible_energy(search, fit, j)
    best: tuple[float, str] = (CLEAR, "throughout")
    masks: dict[str, list[tuple[float, float, float, float]]] = {}
    for motion, energy, segments in zip(search.problem.motions, energies, search.problem.segments, strict=True):
        known = inside(segments, len(energy))
        for words, mask in _regions(candidate, motion, search.problem.band.step, len(energy)):
            here = mask & known
            sums = (float(energy[here].sum()), float(energy[known].sum()), float(here.sum()), float(known.sum()))
            masks.setdefault(words, []).append(sums)
    for words, parts in masks.items():
        part, whole, time, all_time = np.sum(parts, axis=0)
        if whole > 0 and time > 0 and (part / whole) / (time / all_time) > best[0]:
            best = (part / whole) / (time / all_time), words
    return best[1]


def _regions(candidate: Candidate, motion: Motion, step: int, n: int) -> Iterable[tuple[str, np.ndarray]]:
    """Name subsets of the samples, by the coordinate that the effect acts along."""
    coordinate = _coordinate(candidate, motion)
    if coordinate is None:
        return
    x, v, words = coordinate[0][::step][:n], coordinate[1][::step][:n], coordinate[2]
    usual = float(np.sqrt(np.mean(v**2))) or 1.0
    unit = unit_at(motion.model, candidate.location, "rad")
    yield f"around reversals of {words}", np.abs(v) < 0.25 * usual
    yield f"at high speed of {words}", np.abs(v) > 1.3 * usual
    yield f"while {words} moves forwards", v > 0.1 * usual
    yield f"while {words} moves backwards", v < -0.1 * usual
    edges = np.linspace(float(x.min()), float(x.max()) + 1e-12, BINS + 1)
    for low, high in itertools.pairwise(edges):
        yield f"around {words} at {0.5 * (low + high):.2g} {unit}", (x >= low) & (x < high)


def _coordinate(candidate: Candidate, motion: Motion) -> tuple[Vector, Vector, str] | None:
    """Give position, velocity and name of what an effect acts along, or of the joint or motor it is said of."""
    place = candidate.place
    if candidate.remembers_tension:
        return None
    if any(place.A) or any(place.B):
        location = candidate.location
        words = f"{location['kind']} {location['index']}" if "index" in location else "the contact"
        return place.along(motion.q, motion.q_m), place.along(motion.v, motion.v_m), words
    index = place.location.get("joint", place.location.get("index"))
    if index is None or index > motion.q.shape[1]:
        return None
    return motion.q[:, index - 1], motion.v[:, index - 1], f"joint {index}"


def change_time(candidate: Candidate, beta: Vector, motion: Motion) -> list[float] | None:
    """Say when a correction that is a function of time changes most: [start, end] in seconds, None for others."""
    if candidate.effect.name not in ("unnamed_time", "unnamed_wear", "unnamed_gain_drift"):
        return None
    low, high = candidate.shape[2:4]
    knots = np.linspace(low, high, len(beta))
    jump = int(np.argmax(np.abs(np.diff(beta))))
    return [float(knots[jump]), float(min(knots[jump + 1], motion.time[-1]))]
