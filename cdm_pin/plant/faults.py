"""A fault of an arm, and the small vocabulary in which tables say how faults are drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

Place = dict[str, Any]
PlaceDraw = Callable[[np.random.Generator, int], Place]
ValueDraw = Callable[[np.random.Generator, float, Mapping[str, Any]], Any]  # of rng, tenth of the scale, drawn so far


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong.

    Parameters
    ----------
    effect : str
        Its name.
    location : dict
        Where, in the words of the diagnosis format.
    parameters : dict
        Its parameters in SI units.
    amplitudes : tuple of str
        The parameters that scale with its size.
    form : str
        Which of several laws of that name.
    width : float
        Width of the smooth sign of velocity [rad/s at the joint]; negative where it sticks, by how much [rad] it bends.
    in_catalogue : bool
        Whether a diagnosis can know its name.
    """

    effect: str
    location: Place
    parameters: dict[str, Any]
    amplitudes: tuple[str, ...]
    form: str = ""
    width: float = 0.02
    in_catalogue: bool = True

    def scaled(self, factor: float) -> Fault:
        """Make it `factor` times as large; a gain counts as its distance from one, a stiff cable as its compliance."""
        parameters = dict(self.parameters)
        for name in self.amplitudes:
            if name == "gain":
                parameters[name] = 1.0 + factor * (parameters[name] - 1.0)
            elif self.effect in ("cable_elasticity", "cable_slack"):
                parameters[name] /= factor
            else:
                parameters[name] *= factor
        return replace(self, parameters=parameters)


@dataclass(frozen=True)
class Entry:
    """How one effect is drawn.

    Parameters
    ----------
    place, values : callable, dict of callables
        Draws of its location and, in this order, of its parameters.
    amplitudes : tuple of str
        The parameters that scale with its size.
    sensors : tuple of str
        The positions ("joint", "motor", "both") whose logging can show it.
    compliant : bool
        Whether it needs the pass with elastic cables.
    form : str
        Which law of that name.
    """

    place: PlaceDraw
    values: dict[str, ValueDraw]
    amplitudes: tuple[str, ...]
    sensors: tuple[str, ...] = ("both", "joint", "motor")
    compliant: bool = False
    form: str = ""

    def draw(self, name: str, rng: np.random.Generator, n: int, scale: float, *, in_catalogue: bool) -> Fault:
        """Draw the fault `name` for an arm of `n` links whose largest static torque is `scale` [N m]."""
        values: dict[str, Any] = {}
        for key, value in self.values.items():
            values[key] = value(rng, 0.1 * scale, values)
        return Fault(name, self.place(rng, n), values, self.amplitudes, self.form, in_catalogue=in_catalogue)


def number(low: float, high: float) -> ValueDraw:
    """Draw a number between two bounds."""
    return lambda rng, unit, drawn: float(rng.uniform(low, high))


def signed(low: float, high: float) -> ValueDraw:
    """Draw a number between two bounds, of either sign."""
    return lambda rng, unit, drawn: float(rng.choice([-1.0, 1.0]) * rng.uniform(low, high))


def whole(low: int, high: int) -> ValueDraw:
    """Draw a whole number, `high` excluded."""
    return lambda rng, unit, drawn: float(rng.integers(low, high))


def phase() -> ValueDraw:
    """Draw a phase [rad]."""
    return number(-np.pi, np.pi)


def load(low: float, high: float, share: float = 1.0) -> ValueDraw:
    """Draw a torque (or torque per something), the bounds being those of an arm of 10 N m; a `share` of draws only."""
    return lambda rng, unit, drawn: float(unit * rng.uniform(low, high) * (rng.random() < share))


def signed_load(low: float, high: float) -> ValueDraw:
    """Draw a torque of either sign, the bounds being those of an arm of 10 N m."""
    return lambda rng, unit, drawn: float(rng.choice([-1.0, 1.0]) * unit * rng.uniform(low, high))


def log_load(low: float, high: float) -> ValueDraw:
    """Draw a torque evenly on a logarithmic scale."""
    return lambda rng, unit, drawn: float(unit * np.exp(rng.uniform(np.log(low), np.log(high))))


def times(other: str, low: float, high: float, share: float = 1.0) -> ValueDraw:
    """Draw a multiple of a parameter drawn before; zero except in a `share` of the draws."""
    return lambda rng, unit, drawn: float(drawn[other] * rng.uniform(low, high) * (rng.random() < share))


def over(other: str, low: float, high: float) -> ValueDraw:
    """Divide a parameter drawn before by a number."""
    return lambda rng, unit, drawn: float(drawn[other] / rng.uniform(low, high))


def apart(other: str, low: float, high: float) -> ValueDraw:
    """Multiply or divide a parameter drawn before by a number."""
    return lambda rng, unit, drawn: float(drawn[other] * rng.uniform(low, high) ** rng.choice([-1.0, 1.0]))


def plus(other: str, low: float, high: float) -> ValueDraw:
    """Add a number to a parameter drawn before."""
    return lambda rng, unit, drawn: float(drawn[other] + rng.uniform(low, high))


def interval(first: float, last: float, shortest: float, longest: float) -> ValueDraw:
    """Draw a pair of times [s]."""

    def draw(rng, unit, drawn):
        start = float(rng.uniform(first, last))
        return [start, start + float(rng.uniform(shortest, longest))]

    return draw


def joint(rng: np.random.Generator, n: int) -> Place:
    """Draw any joint."""
    return {"kind": "joint", "index": int(rng.integers(n)) + 1}


def motor(rng: np.random.Generator, n: int) -> Place:
    """Draw any motor."""
    return {"kind": "motor", "index": int(rng.integers(n)) + 1}


def link(rng: np.random.Generator, n: int) -> Place:
    """Draw any link."""
    return {"kind": "link", "index": int(rng.integers(n)) + 1}


def cable(rng: np.random.Generator, n: int) -> Place:
    """Draw any motor's cable pair."""
    return {"kind": "cable", "index": int(rng.integers(n)) + 1}


def base(rng: np.random.Generator, n: int) -> Place:
    """Place it on the base."""
    return {"kind": "base"}


def side(rng: np.random.Generator, n: int) -> Place:
    """Draw a joint or a motor."""
    return (joint if rng.random() < 0.6 else motor)(rng, n)


def slides(rng: np.random.Generator, n: int) -> Place:
    """Draw a joint, a motor, or two motors' parts that rub on each other."""
    if n == 1 or rng.random() > 0.15:
        return side(rng, n)
    i, j = rng.choice(n, 2, replace=False)
    weights = [0.0] * n
    weights[i], weights[j] = 1.0, round(float(rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.0)), 3)
    return {"kind": "combination", "weights": weights}


def guide(rng: np.random.Generator, n: int) -> Place:
    """Draw a cable on guides of a link nearer the base than its own (link 0 is the base)."""
    i = int(rng.integers(n))
    return {"kind": "cable", "index": i + 1, "link": int(rng.integers(i + 1))}


def crossing(rng: np.random.Generator, n: int) -> Place:
    """Draw a cable on the joint pulley that link k carries at its far end, where it goes on to a further link."""
    i = int(rng.integers(1, n))
    return {"kind": "cable", "index": i + 1, "link": int(rng.integers(i))}


def map_entry(rng: np.random.Generator, n: int) -> Place:
    """Draw a joint on some cable's way."""
    i = int(rng.integers(n))
    return {"kind": "cable", "index": i + 1, "joint": int(rng.integers(i + 1)) + 1}


def motor_and_joint(rng: np.random.Generator, n: int) -> Place:
    """Draw a motor and a joint that is not its own."""
    i, k = rng.choice(n, 2, replace=False)
    return {"kind": "motor", "index": int(i) + 1, "joint": int(k) + 1}


def joint_and_other(rng: np.random.Generator, n: int) -> Place:
    """Draw a joint and another one."""
    i, k = rng.choice(n, 2, replace=False)
    return {"kind": "joint", "index": int(i) + 1, "other": int(k) + 1}


def system_or_motor(rng: np.random.Generator, n: int) -> Place:
    """Take all motors alike, or one."""
    return {"kind": "system"} if rng.random() < 0.6 else motor(rng, n)
