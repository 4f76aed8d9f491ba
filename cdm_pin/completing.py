"""The completed model as a file says it: valid links and the effects that were found."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from .candidates import Candidate
from .consistency import links_from_parameters, nearest_standard
from .fit import Fit
from .friction_effects import STOPS
from .geometry import Manipulator, Vector
from .model import CableModel
from .search import Search
from .verdict import Verdict


def stated_laws(verdict: Verdict) -> tuple[dict[str, Any], ...]:
    """Say what the completed model of a verdict has as model files do."""
    return tuple(
        record
        for j, values in verdict.written.items()
        for record in law_records(verdict.model, verdict.fit.effects[j], values, verdict.fit.beta[j])
    )


def law_records(
    model: CableModel, candidate: Candidate, values: dict[str, dict[str, Any]], beta: Vector
) -> list[dict[str, Any]]:
    """Say an effect as model files do; a hysteresis of several elements is one entry for each.

    A stiffening spring was fitted as a polynomial: the constant that its law does not have is one of the motors.
    """
    if candidate.effect.name == "hysteresis" and candidate.detail:
        out = []
        for limit, share, form in zip(beta, (1.0, *STOPS), (candidate.shape[1], *[0.5] * len(STOPS)), strict=False):
            distance = share * candidate.shape[0]
            own = {"stiffness": limit / distance, "limit": limit, "form": form}
            if limit > 0:
                own = {name: round(float(x), 10) for name, x in own.items()}
                out.append({"effect": "hysteresis", "location": candidate.location, "parameters": own})
        return out
    bounds = {p.name: (p.lower, p.upper) for p in candidate.effect.parameters}
    parameters = {
        name: round(float(np.clip(v["value"], *bounds.get(name, (-np.inf, np.inf)))), 10) for name, v in values.items()
    }
    if candidate.effect.nuisance_shape:
        parameters["width"] = round(float(candidate.shape[0]), 10)
    own = {"effect": candidate.effect.name, "location": candidate.location, "parameters": parameters}
    if "cubic" not in parameters:
        return [own]
    constant = beta[1] - candidate.effect.coefficients(parameters)[0][1]
    offsets = [
        {
            "effect": "torque_offset",
            "location": {"kind": "motor", "index": i + 1},
            "parameters": {"offset": round(float(-w * constant), 10)},
        }
        for i, w in enumerate(candidate.place.weights(model))
        if w
    ]
    return [own, *offsets]


def completed_manipulator(
    model: CableModel, search: Search, fit: Fit, effects: tuple[dict[str, Any], ...], covariance: Vector
) -> Manipulator:
    """Give the manipulator with physically valid links that reproduce the base parameters, and with effects."""
    base = search.base
    values = base.values(search.problem.model.standard_parameters) + fit.base[: len(base.columns)]
    std = np.sqrt(np.diag(covariance)[: len(values)])
    records = tuple(
        {"name": name, "value": float(value), "std": float(s)}
        for name, value, s in zip(base.names, values, std, strict=True)
    )
    manipulator = replace(model.manipulator, effects=model.manipulator.effects + effects, base_parameters=records)
    standard = nearest_standard(base.matrix, values, model.standard_parameters)
    if standard is None or not manipulator.links:
        return manipulator
    return replace(manipulator, links=links_from_parameters(manipulator.links, standard.parameters))
