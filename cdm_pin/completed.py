"""The completed model run forward: what the effects of a model file add to the motors' torques."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from .candidates import Candidate, loaded, torque_of
from .effect import Effect, Place
from .effects import CATALOGUE
from .errors import ManipulatorError, nearest
from .geometry import Vector
from .model import CableModel
from .motion import Motion
from .places import all_motor_places, rub_places


def effect_candidates(model: CableModel) -> list[tuple[Candidate, Vector]]:
    """Turn the effects of a model file into candidates with coefficients.

    Parameters
    ----------
    model : CableModel

    Returns
    -------
    list of (Candidate, ndarray)

    Raises
    ------
    ManipulatorError
        If an effect, a place or a parameter is unknown, naming the nearest known one.
    """
    out = []
    for k, record in enumerate(model.manipulator.effects):
        place = f"effects[{k + 1}]"
        try:
            out.append(_candidate(model, record, place))
        except ManipulatorError as exc:
            raise ManipulatorError(exc.message, source=model.manipulator.source, place=exc.place or place) from None
    return out


def _candidate(model: CableModel, record: Mapping[str, Any], place: str) -> tuple[Candidate, Vector]:
    name = str(record["effect"])
    if name not in CATALOGUE:
        hint = nearest(name, CATALOGUE) or f"; known: {', '.join(CATALOGUE)}"
        raise ManipulatorError(f"unknown effect {name!r}{hint}", place=f"{place}.effect")
    effect = CATALOGUE[name]
    where = find_place(model, effect, record["location"], f"{place}.location")
    parameters = _numbers(effect, record.get("parameters") or {}, f"{place}.parameters")
    try:
        beta, shape = effect.coefficients(parameters)
    except (KeyError, ZeroDivisionError) as exc:
        known = ", ".join(p.name for p in effect.parameters)
        raise ManipulatorError(f"{name} needs the parameters {known}", place=f"{place}.parameters") from exc
    return Candidate(effect, where, shape), beta


def find_place(model: CableModel, effect: Effect, location: Any, where: str = "location") -> Place:
    """Find the place of an effect that a location names, by its own name or by an alias.

    Raises
    ------
    ManipulatorError
        If the effect cannot sit there on this robot.
    """
    places = effect.places(model)
    for place in places:
        if place.location == location:
            return place
    for place in [*places, *(rub_places(model) if effect.name == "cable_friction" else ())]:
        if location in place.aliases:
            return replace(place, location=dict(location))
    if {place.location["kind"] for place in places} >= {"joint"} and any(any(place.A) for place in places):
        for place in all_motor_places(model):  # also those that another place stands for, up to a factor
            if place.location == location:
                return place
    if isinstance(location, Mapping) and location.get("kind") == "combination":
        weights = [float(x) for x in location.get("weights", ())]
        if len(weights) != model.n_motors:
            raise ManipulatorError(f"{model.n_motors} weights were expected, found {len(weights)}", place=where)
        return Place(dict(location), (0.0,) * model.n_joints, tuple(weights))
    known = "; ".join(str(place.location) for place in places)
    raise ManipulatorError(f"{effect.name} cannot sit at {location}; it can at {known}", place=where)


def _numbers(effect: Effect, parameters: Mapping[str, Any], place: str) -> dict[str, float]:
    known = [p.name for p in effect.parameters] + ["width", "recording"]
    out = {}
    for name, value in parameters.items():
        if name not in known:
            raise ManipulatorError(f"unknown parameter {name!r}{nearest(name, known)}", place=place)
        if isinstance(value, Mapping):
            value = value.get("value")
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise ManipulatorError(f"a number was expected, found {value!r}", place=f"{place}.{name}")
        out[name] = float(value)
    return out


def added_torque(motion: Motion) -> Vector:
    """Compute what the effects of the motion's model add to the motors' torques, shape (n, n_motors) [N m]."""
    return added(motion)[0]


def added(motion: Motion) -> tuple[Vector, Vector]:
    """Compute what the effects of the motion's model add to the motors' torques and to the cables' travel.

    Effects that change where the joints stand (ratio errors, elasticity) enter to first order, as in their columns;
    on a soft cable behind measured motors the links swing.

    Parameters
    ----------
    motion : Motion

    Returns
    -------
    torque : ndarray, shape (n, n_motors)
        [N m].
    travel : ndarray, shape (n, n_motors)
        Of the motors beyond what the joints' positions say, at the joints' scale [rad].
    """
    torque, travel = np.zeros((2, motion.n, motion.model.n_motors))
    effects = effect_candidates(motion.model)
    still, motion = motion, loaded(motion, effects)
    if motion.swing is not None:
        torque += motion.tau_m - still.tau_m
    for candidate, beta in effects:
        columns = candidate.raw_columns(motion)
        torque += torque_of(columns, beta, torque.shape)
        if columns.kinematic is not None:
            k = min(len(beta), columns.kinematic.shape[2])
            travel += columns.kinematic[..., :k] @ beta[:k]
    return torque, travel
