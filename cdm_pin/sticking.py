"""Sticking: what axes hold while they rest, against what they lose to friction in motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.ndimage import minimum_filter1d

from .fit import Fit
from .geometry import Vector
from .places import parallel, rub_places
from .problem import Problem
from .search import Search, brought, raw_errors, rms
from .standstill import Still, reach
from .unexplained import something
from .whitening import inside
from .wording import place

HARDER, PEAKED, CLEAR = 1.3, 1.1, 2.0
"""How many times its friction in motion, that with its peak where it has one, and how many times the noise beside that,
dry friction holds at most."""
LESS, FEW = 0.95, 30
"""Share of the samples at rest in which it holds less than what counts, and how many of these there have to be."""


def sticking(search: Search, fit: Fit) -> dict[str, Any] | None:
    """Say which axis that rubs holds more while it rests than in motion, as dry friction cannot; None if none does.

    Only samples count at which no other axis rests: what two hold together is not told apart.
    """
    if not search.problem.partly:
        return None
    model, errors = search.problem.model, raw_errors(search, fit.base, fit.effects, fit.beta)
    noise, places = rms(search, errors)[: model.n_motors], rub_places(model)
    worst: tuple[float, dict[str, Any] | None] = (1.0, None)
    for k in range(len(places)):
        weights = places[k].weights(model)
        laws = [j for j, c in enumerate(fit.effects) if c.rubs and parallel(c.place.weights(model), weights)]
        if not laws:
            continue
        unit, held = weights / np.linalg.norm(weights), []
        for r, (error, segments) in enumerate(zip(errors, search.problem.segments, strict=True)):
            law = sum(np.tensordot(fit.beta[j], search.columns(fit.effects[j])[r], 1) for j in laws)
            alone = _alone_at_rest(search.problem, search.problem.still[r], k)
            held.append((unit @ (error + law)[: len(unit)])[alone & inside(segments, len(alone))])
        force = np.abs(np.concatenate(held))
        if len(force) < FEW:
            continue
        least = sum(_most_held(search, fit, j, unit) for j in laws) + CLEAR * float(np.linalg.norm(unit * noise))
        most = float(np.quantile(force, LESS))
        if most > worst[0] * least:
            location = places[k].location
            words = f"{place(location)} holds more while it rests than it loses to friction in motion"
            size = float(np.sqrt(np.mean(force**2)))
            near = [{"effect": fit.effects[j].name, "location": fit.effects[j].location} for j in laws]
            held_there = something(location["kind"], location["index"], words, size, nearest=near[:3])
            worst = most / least, held_there | {"location": location}
    return worst[1]


def _most_held(search: Search, fit: Fit, j: int, unit: Vector) -> float:
    """Give the most that law `j` of a fit may hold along a direction of motors."""
    peaks = fit.effects[j].effect.name == "stribeck_friction" and fit.beta[j][0] > 0.0
    k = 1 if peaks else len(fit.effects[j].effect.signs)  # without what details the sign of a velocity
    torques = [unit @ x[: len(unit)] for x in brought(search, fit.effects[j], fit.beta[j][:k])]
    most = max(float(np.abs(x).max(initial=0.0)) for x in torques)
    return PEAKED * most * (1.0 + max(float(fit.beta[j][1] / fit.beta[j][0]), 0.0)) if peaks else HARDER * most


def _alone_at_rest(problem: Problem, still: Sequence[Still], axis: int) -> np.ndarray:
    """Tell in which samples of the band an axis rests, and none that turns otherwise does, shape (n_reduced,).

    Of the axes that share a motor with it; `still` tells when each one rests.
    """
    weights = [place.weights(problem.model) for place in rub_places(problem.model)]
    own, others = np.zeros((2, len(still[axis].when)), bool)
    for w, rests in zip(weights, still, strict=False):
        if parallel(w, weights[axis]):
            own |= rests.when
        elif np.any((w != 0.0) & (weights[axis] != 0.0)):
            others |= rests.when
    return (minimum_filter1d(own, reach(problem.band)) & ~others)[:: problem.band.step]
