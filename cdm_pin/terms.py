"""Which effects are fitted beside the rigid body, and where: from names to columns of one plan for all recordings."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .accelerations import Acceleration
from .base import BaseParameters, present_columns
from .effect import Effect, Place
from .effects import CATALOGUE
from .errors import InputError, nearest
from .model import CableModel
from .places import all_motor_places, joint_places

BASELINE = ("viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")
LINEAR = (*BASELINE, "quadratic_drag", "joint_spring", "cable_friction", "torque_ripple")
STATED = {"torque_ripple": "cycles"}  # what makes an effect linear once it is given


@dataclass(frozen=True)
class Term:
    """One coefficient of an effect at a place.

    Attributes
    ----------
    effect : str
        Of the catalogue.
    place : Place
    number : int
        Which of the effect's columns.
    shape : tuple of float
        What the effect is not linear in, as stated.
    """

    effect: str
    place: Place
    number: int = 0
    shape: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        """For people: ``"viscous_friction motor 2"``."""
        where = self.place.location
        words = [str(where[key]) for key in ("kind", "index") if key in where]
        words += [f"{key} {value}" for key, value in where.items() if key not in ("kind", "index", "weights")]
        words += [f"{STATED[self.effect]} {value:g}" for value in self.shape]
        words += [f"{value:+.4g} motor {i}" for i, value in enumerate(where.get("weights", ()), 1) if value]
        return " ".join([self.effect, *words]) + (f" ({self.number + 1})" if self.number else "")

    @property
    def nonnegative(self) -> bool:
        """Whether physics forbids a negative coefficient."""
        signs = CATALOGUE[self.effect].signs
        return bool(signs[self.number]) if self.number < len(signs) else False


def parse_effects(model: CableModel, wanted: Sequence[str]) -> tuple[Term, ...]:
    """Find effects by name, each optionally with its place.

    A place is a kind, with or without a number (``coulomb_friction:joint2``), the name of a joint or of a motor
    (``joint_spring:roll_joint``), or for parts that rub on each other a sum or difference of such
    (``coulomb_friction:finger_2_joint-finger_1_joint``). What an effect is not linear in is stated last:
    ``torque_ripple:motor5:cycles=1`` (per radian).

    Parameters
    ----------
    model : CableModel
    wanted : sequence of str
        Effects of the catalogue that are linear in their parameters; friction sits at the motors unless told otherwise.

    Raises
    ------
    InputError
        If a name or place is unknown, or the effect is not linear in its parameters.
    """
    terms: list[Term] = []
    for text in wanted:
        name, where, *stated = (part.strip() for part in [*text.split(":"), ""])
        if name not in CATALOGUE:
            hint = nearest(name, CATALOGUE) or f"; every robot's: {', '.join(BASELINE)}"
            raise InputError(f"unknown effect {name!r}{hint}", place="--effects")
        if name not in LINEAR:
            message = f"{name} is not linear in its parameters: cdm-pin diagnose fits it; here: {', '.join(LINEAR)}"
            raise InputError(message, place="--effects")
        if "=" in where:
            where, stated = "", [where, *stated]
        shape = _shape(text, name, [part for part in stated if part])
        for place in _places(model, f"{name}:{where}" if where else name, where):
            terms += [Term(name, place, k, shape) for k in range(len(CATALOGUE[name].signs))]
    return tuple(terms)


def _shape(text: str, name: str, stated: Sequence[str]) -> tuple[float, ...]:
    """Read what an effect is not linear in: ``cycles=1``."""
    key = STATED.get(name, "")
    values = [part.partition("=")[2] for part in stated if part.partition("=")[0].strip() == key]
    try:
        shape = tuple(float(value) for value in values)
    except ValueError:
        shape = ()
    if len(shape) != len(stated) or len(shape) > 1 or not np.all(np.isfinite(shape)):
        expected = f"{name}:PLACE:{key}=NUMBER" if key else f"{name}:PLACE"
        raise InputError(f"{text!r}: {expected} was expected", place="--effects")
    if key and not any(shape):
        raise InputError(f"{text!r}: it is linear once its {key} are given: {name}:motor1:{key}=1", place="--effects")
    return shape


def _places(model: CableModel, text: str, where: str) -> list[Place]:
    name, where = text.partition(":")[0], where.strip()
    own = CATALOGUE[name].places(model)
    kind = where.rstrip("0123456789").strip()
    index = where[len(kind) :].strip()
    if "friction" in name or name == "rotor_inertia":
        own = {"": all_motor_places, "motor": all_motor_places}.get(kind, CATALOGUE[name].places)(model)
        own = joint_places(model) if kind == "joint" and "friction" in name else own
    places = [place for place in own if not kind or place.location["kind"] == kind]
    if index:
        places = [place for place in places if str(place.location.get("index")) == index]
    places = places or _named_place(model, CATALOGUE[name], where)
    if not places:
        known = sorted({" ".join(str(p.location[k]) for k in ("kind", "index") if k in p.location) for p in own})
        raise InputError(f"{text!r} is nowhere on this robot; {name} can be at {', '.join(known)}", place="--effects")
    return places


def _named_place(model: CableModel, effect: Effect, where: str) -> list[Place]:
    """Find a joint or motor by its name, or a coordinate that sums or subtracts some."""
    own = _location(model, where)
    if own is not None:
        places = [place for place in effect.places(model) if own == place.location or own in place.aliases]
        anywhere = "friction" in effect.name or effect.name == "joint_spring"
        return places or [p for p in all_motor_places(model) if own == p.location and anywhere]
    parts = [part for part in re.split(r"([+-])", where.replace(" ", "")) if part]
    if "friction" not in effect.name or len(parts) < 3:
        return []
    weights, sign = np.zeros(model.n_motors), 1.0
    for part in parts:
        found = _location(model, part)
        if part in "+-":
            sign = -1.0 if part == "-" else 1.0
        elif found is None:
            return []
        else:
            rows = model.joint_from_motor if found["kind"] == "joint" else np.eye(model.n_motors)
            weights += sign * rows[found["index"] - 1]
    location = {"kind": "combination", "weights": [float(x) for x in weights]}
    return [Place(location, (0.0,) * model.n_joints, tuple(location["weights"]))] if weights.any() else []


def _location(model: CableModel, name: str) -> dict[str, Any] | None:
    """Find a joint or motor by its name, or by kind and number."""
    for kind, known in (("joint", model.joints), ("motor", model.motors)):
        if name in known:
            return {"kind": kind, "index": known.index(name) + 1}
        number = name.removeprefix(kind)
        if name.startswith(kind) and number.isdigit() and 1 <= int(number) <= len(known):
            return {"kind": kind, "index": int(number)}
    return None


@dataclass(frozen=True)
class Plan:
    """What to reduce every recording to; the same for all, and small enough to send to another process.

    Attributes
    ----------
    model : CableModel
        With the nominal parameters.
    base : BaseParameters
    terms : tuple of Term
        Asked for, then spare.
    n_wanted : int
        How many terms are asked for.
    cutoff : float or None
        Of the common filter [Hz]; None chooses it from each recording.
    accelerations : tuple of Acceleration or None
        How each motor's acceleration is made; None chooses from each recording.
    shapes : tuple or None
        What each term is not linear in (the width of the smooth sign); None chooses from each recording.
    """

    model: CableModel
    base: BaseParameters
    terms: tuple[Term, ...]
    n_wanted: int
    cutoff: float | None = None
    accelerations: tuple[Acceleration, ...] | None = None
    shapes: tuple[tuple[float, ...], ...] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Of all columns."""
        return (*self.base.names, *(term.name for term in self.terms))

    @property
    def present(self) -> np.ndarray:
        """Which column can reach which motor, shape (n_motors, n_columns)."""
        where = [np.abs(term.place.weights(self.model)) > 1e-12 for term in self.terms]
        return np.column_stack([present_columns(self.model, self.base), *where])


def make_plan(
    model: CableModel, base: BaseParameters, effects: Sequence[str | Term] = (), cutoff: float | None = None
) -> Plan:
    """Collect the effects asked for and the spare ones."""
    wanted: list[Term] = []
    for effect in effects:
        wanted += [effect] if isinstance(effect, Term) else parse_effects(model, [effect])
    asked = {term.effect for term in wanted}
    spare = parse_effects(model, [name for name in BASELINE if name not in asked])
    terms = tuple({term.name: term for term in [*wanted, *spare]}.values())
    return Plan(model, base, terms, len({term.name for term in wanted}), cutoff)
