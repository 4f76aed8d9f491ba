"""Which nonlinear parameters of effects are screened first, and between which bounds they are estimated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .effect import Place, Shape
from .geometry import Vector
from .motion import Motion


def speed_scale(motions: Sequence[Motion], place: Place) -> float:
    """Root mean square speed along the place's coordinate."""
    return float(np.sqrt(np.mean(np.concatenate([place.along(m.v, m.v_m) ** 2 for m in motions])))) or 1.0


def reach(motions: Sequence[Motion], place: Place) -> float:
    """Range of positions along the place's coordinate."""
    s = np.concatenate([place.along(m.q, m.q_m) for m in motions])
    return float(np.ptp(s)) or 1.0


def sign_width(motions: Sequence[Motion], place: Place) -> float:
    """Width of the smooth sign of velocity to start from: the speed's own uncertainty, at least 2 % of its scale."""
    noise = max(float(np.abs(place.weights(m.model)) @ m.velocity_noise) for m in motions)
    return max(2 * noise, 0.02 * speed_scale(motions, place))


def narrowest_peak(motions: Sequence[Motion], place: Place) -> float:
    """Width of the narrowest peak of friction that the sign of velocity, as far as it is known, does not hide."""
    return max(0.03 * speed_scale(motions, place), 2.5 * sign_width(motions, place))


def peak_widths(motions: Sequence[Motion], place: Place) -> Vector:
    """Screen velocities of a peak of friction, none narrower than can be told."""
    return np.maximum(speed_scale(motions, place) * np.array([0.08, 0.2, 0.5]), narrowest_peak(motions, place))


def width_grid(motions: Sequence[Motion], place: Place) -> list[Shape]:
    """Screen the one width of the sign to start from."""
    return [(sign_width(motions, place),)]


def width_bounds(motions: Sequence[Motion], place: Place) -> list[tuple[float, float]]:
    """Bound the width of the sign about that."""
    w = sign_width(motions, place)
    return [(0.1 * w, 8 * w)]


def grid_of(*values: Callable[[Sequence[Motion], Place], Any]):
    """Combine what is screened of each element of a shape."""

    def grid(motions: Sequence[Motion], place: Place) -> list[Shape]:
        shapes: list[Shape] = [()]
        for value in values:
            shapes = [(*shape, float(x)) for shape in shapes for x in value(motions, place)]
        return shapes

    return grid


def one_width(motions: Sequence[Motion], place: Place) -> list[float]:
    """Give the one width of the sign to start from."""
    return [sign_width(motions, place)]


def bounds_of(*pairs: Callable[[Sequence[Motion], Place], tuple[float, float]]):
    """Bound the sign's width, then further elements of a shape."""
    return lambda motions, place: width_bounds(motions, place) + [pair(motions, place) for pair in pairs]


def greatest_load(motions: Sequence[Motion], place: Place) -> float:
    """Give the torque at its link that a cable hardly ever exceeds [N m]."""
    load = np.concatenate([m.cable_torque[:, place.index[0]] for m in motions])
    return float(np.quantile(np.abs(load), 0.99))
