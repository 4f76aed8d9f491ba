"""Sticking: what axes hold while they rest, against what they lose to friction in motion."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.ndimage import minimum_filter1d

from .candidates import Candidate
from .effect import Place
from .fit import Fit
from .geometry import Vector
from .places import axis_places, parallel
from .problem import Run
from .search import Search, raw_errors, rms
from .standstill import REACH, standing
from .unexplained import something

HARDER, CLEAR = 1.3, 2.0
"""How many times its friction in motion, and how many times the noise beside that, dry friction holds at most."""
LESS, FEW = 0.95, 30
"""Share of the samples at rest in which it holds less than what counts, and how many of these there have to be."""


def sticking(search: Search, fit: Fit) -> dict[str, Any] | None:
    """Say which axis that rubs holds more while it rests than in motion, as dry friction cannot; None if none does.

    Only samples count at which no other axis rests: what two hold together is not told apart.
    """
    if not search.problem.partly:
        return None
    model, noise = search.problem.model, rms(search, raw_errors(search, fit.base, fit.effects, fit.beta))
    places = axis_places(model)
    worst: tuple[float, dict[str, Any] | None] = (1.0, None)
    for k in sorted(search.problem.resting):
        weights = places[k].weights(model)
        laws = [j for j, c in enumerate(fit.effects) if _rubs_along(c, weights, search)]
        if not laws:
            continue
        held = np.concatenate([_held(search, fit, laws, k, r) for r in range(len(search.problem.runs))])
        if len(held) < FEW:
            continue
        unit = weights / np.linalg.norm(weights)
        least = HARDER * sum(_level(search, fit, j, unit) for j in laws)
        least += CLEAR * float(np.linalg.norm(unit * noise[: model.n_motors]))
        most = float(np.quantile(np.abs(held), LESS))
        if most > worst[0] * least:
            place = places[k].location
            words = f"{place['kind']} {place['index']} holds more while it rests than it loses to friction in motion"
            size = float(np.sqrt(np.mean(held**2)))
            near = [{"effect": fit.effects[j].name, "location": fit.effects[j].location} for j in laws]
            worst = most / least, something(place["kind"], place["index"], words, size, nearest=near[:3])
    return worst[1]


def _rubs_along(candidate: Candidate, weights: Vector, search: Search) -> bool:
    """Whether a law is friction along a coordinate."""
    rubs = candidate.effect.name.endswith("_friction") or candidate.effect.name in ("hysteresis", "friction_drift")
    return rubs and bool(candidate.place.A) and parallel(candidate.place.weights(search.problem.model), weights)


def _level(search: Search, fit: Fit, j: int, unit: Vector) -> float:
    """Give the most that law `j` of a fit takes along a direction of motors, at standstill with its peak."""
    k = len(fit.effects[j].effect.signs)  # without what details the sign of a velocity
    columns = search.columns(fit.effects[j])
    torques = [unit @ np.tensordot(fit.beta[j][:k], x[:k], 1)[: len(unit)] for x in columns]
    most = max(float(np.abs(x).max(initial=0.0)) for x in torques)
    peaks = fit.effects[j].effect.name == "stribeck_friction" and fit.beta[j][0] > 0.0
    return most * (1.0 + max(float(fit.beta[j][1] / fit.beta[j][0]), 0.0)) if peaks else most


def _held(search: Search, fit: Fit, laws: list[int], axis: int, r: int) -> Vector:
    """Give what an axis holds, along its direction of motors, while it alone rests on run `r`, shape (n,)."""
    problem, run = search.problem, search.problem.runs[r]
    unit = axis_places(problem.model)[axis].weights(problem.model)
    unit = unit / np.linalg.norm(unit)
    error = raw_errors(search, fit.base, fit.effects, fit.beta)[r]
    for j in laws:
        error = error + np.tensordot(fit.beta[j], search.columns(fit.effects[j])[r], 1)
    alone = _alone_at_rest(search, run, axis)
    inside = np.zeros(len(alone), bool)
    for a, b in problem.segments[r]:
        inside[a:b] = True
    return (unit @ error[: len(unit)])[alone & inside]


def _alone_at_rest(search: Search, run: Run, axis: int) -> np.ndarray:
    """Tell in which samples of the band an axis rests, and none that turns otherwise does, shape (n_reduced,)."""
    band, model = search.problem.band, search.problem.model
    places: list[Place] = axis_places(model)
    own, others = np.zeros(len(run.motion.time), bool), np.zeros(len(run.motion.time), bool)
    for k, _, still in standing(run.motion, run.signals.valid, band.rate):
        if parallel(places[k].weights(model), places[axis].weights(model)):
            own |= still
        elif np.any((places[k].weights(model) != 0.0) & (places[axis].weights(model) != 0.0)):
            others |= still
    reach = 2 * round(REACH * band.rate / band.cutoff) + 1
    return (minimum_filter1d(own, reach) & ~others)[:: band.step]
