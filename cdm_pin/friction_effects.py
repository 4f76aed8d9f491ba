"""Friction: its columns, what its sign of velocity leaves open, and its parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

from .effect import Columns, Place, Shape, acting, position_along, speed_along
from .effect_shapes import greatest_load, reach, sign_width
from .geometry import Vector
from .motion import Motion
from .places import is_whole_cable
from .reversing import reversing


class Presliding(float):
    """Distance within which dry friction gives before it slides, in the place of the width of a sign [rad]."""


class Sliding(float):
    """Width of a sign [rad/s] whose coordinate is taken to slide throughout, also where it stops."""


PRESLIDING = (0.02, 0.1)
"""Distances within which dry friction may give before it slides, over the width of its sign [s]."""
GIVES = (1 / 64, 4.0)
"""Least and largest multiple of these distances."""


def _sign(motion: Motion, place: Place, shape: Shape) -> Vector:
    if isinstance(shape[0], Sliding):
        return np.tanh(speed_along(motion, place) / shape[0])
    x, error = position_along(motion, place), motion.position_error(np.array(place.A), np.array(place.B))
    if isinstance(shape[0], Presliding):
        return dahl(dragged(x, error), shape[0])
    return reversing(x, speed_along(motion, place), shape[0], error, motion.rate)


def sign_transitions(motion: Motion, place: Place, shape: Shape, scale: float) -> list[Vector]:
    """Give how the sign of the coordinate's speed may pass through zero (`transitions`)."""
    return transitions(speed_along(motion, place), scale)


CREEP = 0.02
"""Time [s] for which a position may creep within a step of its encoder before and after a standstill."""
RESTS = 0.2
"""Share of the sign's width below which a velocity is that of a rest; one that passes through zero is there briefly."""
PAUSES = 0.01
"""Share of the time just before and after standstills from which on these count."""


def creeping(v: Vector, scale: float, rate: float) -> Vector:
    """Give the sign of velocity that comes before a standstill or after it, for a short time.

    Friction is there while positions creep within a step of their encoder, which shows them at rest. Where the velocity
    passes slowly through zero, or to the other side, it is zero.
    """
    sign, n = np.tanh(v / scale), max(round(CREEP * rate), 1)
    around = np.pad(sign, n, mode="edge")
    series = (1.0 - np.abs(sign)) * (around[: len(v)] + around[2 * n :])
    edges = np.diff(np.r_[False, np.abs(v) < scale, False].astype(int))
    for a, b in zip(np.flatnonzero(edges > 0), np.flatnonzero(edges < 0), strict=True):
        if b - a < 2 * n or np.mean(np.abs(v[a:b]) < RESTS * scale) < 0.5:
            series[a:b] = 0.0
    return np.where(np.abs(v) < scale, series, 0.0)


def transitions(v: Vector, scale: float) -> list[Vector]:
    """Give how a sign of velocity may pass through zero beside the smooth one, on a scale of velocity."""
    signs = [np.tanh(v / (f * scale)) for f in (0.35, 0.9, 2.0)]
    return [signs[0] - signs[1], signs[1] - signs[2]]


PEAK = 4.0
"""How many times sliding friction breaking away may take at most; what peaks higher is the velocity's noise."""
RISEN, UNDONE = 0.05, 0.5
"""Shares by which Stribeck's friction, with all that its sign leaves open, has to rise above that of sliding, and by
which it may drive at standstill."""


def extremes(beta: Vector, shape: Shape, detail: float) -> tuple[float, float]:
    """Give the least and the most that dry or Stribeck's friction takes over sliding, with what is left open."""
    width, *peak = shape
    v = np.linspace(0.0, max([4.0 * detail, *(3.0 * x for x in peak)]), 200)
    series = [np.tanh(v / width)]
    if peak:
        series.append(series[0] * np.exp(-((v / max(peak[0], 1e-12)) ** 2)))
    if detail:
        series += transitions(v, detail)
    law = beta[: len(series)] @ series / max(beta[0], 1e-300)
    return float(law.min()), float(law.max())


def peaks_by_its_sign(beta: Vector, shape: Shape, detail: float, most: float = 0.2) -> bool:
    """Whether what dry friction leaves open about its sign rises far above it, as no blurred or smooth sign does."""
    return bool(detail) and extremes(beta, shape, detail)[1] >= 1.0 + most


def has_peak(beta: Vector, shape: Shape, detail: float) -> bool:
    """Whether friction rises towards standstill, and no more than it may."""
    least, peak = extremes(beta, shape, detail)
    return bool(least > -UNDONE and peak > 1.0 + RISEN and beta[1] <= PEAK * beta[0])


def brakes_at_start(beta: Vector, shape: Shape, detail: float) -> bool:
    """Whether friction that drifts brakes from the start on."""
    return bool(beta[0] + beta[1] >= 0.0)


STOPS = (0.3, 0.8, 2.0, 5.0)
"""Distances of the further elements of a hysteresis, over its own."""
YIELDING = 0.25
"""Least share of its elements' limits in those that have given way within a hysteresis's own distance."""


def further_stops(motion: Motion, place: Place, shape: Shape, scale: float) -> list[Vector]:
    """Give the further elements of a hysteresis, each of a distance of its own (`STOPS`)."""
    x = remembered(motion, place)
    return [maxwell(x, f * scale * shape[0], 1.0) for f in STOPS]


def yields_early(beta: Vector, shape: Shape, detail: float) -> bool:
    """Whether a good part of a hysteresis yields within its own distance; what only gives way later is a spring."""
    early = beta[0] + sum(b for b, share in zip(beta[1:], STOPS, strict=False) if share < 1.0)
    return bool(early >= YIELDING * beta.sum())


def remembered(motion: Motion, place: Place) -> Vector:
    """Give what a hysteresis remembers: the position of its coordinate [rad], or the torque of its cable [N m]."""
    if is_whole_cable(place.location):
        return motion.clear_torque[:, place.index[0]]
    return position_along(motion, place)


def viscous_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Column of drag: the speed s' of the place's coordinate."""
    return acting(motion, place, place.along(motion.v, motion.motor_speeds))


def coulomb_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Column of dry friction: the smooth sign of s'."""
    return acting(motion, place, _sign(motion, place, shape))


def stribeck_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Columns of dry friction and of a peak at standstill: sign(s'), sign(s') exp(-(s'/v_s)^2)."""
    s = _sign(motion, place, shape)
    return acting(motion, place, s, s * np.exp(-((speed_along(motion, place) / shape[1]) ** 2)))


def asymmetric_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Columns of the mean of dry friction in both directions and of half their difference: sign(s'), 1."""
    s = _sign(motion, place, shape)
    return acting(motion, place, s, np.ones(motion.n))


def drag_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Column of quadratic drag: s' |s'|."""
    v = place.along(motion.v, motion.motor_speeds)
    return acting(motion, place, v * np.abs(v))


def load_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Column of friction of a loaded bearing: the hinge's force, or the links' share of it, times sign(s')."""
    force = motion.link_force if shape[1:] == (1.0,) else motion.hinge_force
    return acting(motion, place, force[:, place.index[0]] * _sign(motion, place, shape))


def load_grid(motions: Sequence[Motion], place: Place) -> list[Shape]:
    """Screen a hinge on which the cables pull, and one on which the links alone do."""
    both = motions[0].hinge_force is not motions[0].link_force
    return [(sign_width(motions, place), only) for only in ((0.0, 1.0) if both else (0.0,))]


def torque_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Column of friction by torque: its magnitude times sign(s')."""
    return acting(motion, place, np.abs(_carried(motion, place, shape)) * _sign(motion, place, shape))


def _carried(motion: Motion, place: Place, shape: Shape) -> Vector:
    """Give the torque that loads what rubs, shape (n,): of links, and with `shape[1]` of the motor's rotor, too."""
    i = place.index[0]
    if any(place.A):
        return motion.tau[:, i]
    return motion.tau_m[:, i] + (shape[1:] == (1.0,)) * motion.a_m[:, i] * motion.model.rotor_inertia[i]


def torque_grid(motions: Sequence[Motion], place: Place) -> list[Shape]:
    """Screen what carries the torque of the links, and of a motor what carries its rotor's beside."""
    turns = not any(place.A) and motions[0].model.rotor_inertia[place.index[0]] > 0.0
    return [(sign_width(motions, place), rotor) for rotor in ((0.0, 1.0) if turns else (0.0,))]


def other_torques_columns(motion: Motion, place: Place, shape: Shape, beta: Vector) -> Columns:
    """Give what friction by torque brings if it follows that of other effects, too.

    Where its own torque is in the motion, that counts with these.
    """
    own, i = _carried(motion, place, shape), place.index[0]
    if any(place.A):
        other = own if motion.extra_joint is None else own + motion.extra_joint[:, i]
    else:
        other = own + motion.driven_torque[:, i] - motion.tau_m[:, i]
    return acting(motion, place, (np.abs(other) - np.abs(own)) * beta[0] * _sign(motion, place, shape))


def position_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Columns of dry friction that varies with position: sign(s') times 1, sin(n s) and cos(n s)."""
    s, x = _sign(motion, place, shape), shape[1] * position_along(motion, place)
    return acting(motion, place, s, s * np.sin(x), s * np.cos(x))


def capstan_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Column of a cable that slides over a pulley: both strands' tension times wrap, times sign(s')."""
    i, k = place.index
    pulleys = motion.model.manipulator.pulleys
    assert pulleys is not None
    r = pulleys.joint_pulley_radius[i]
    wrap = 2 * pulleys.wrap_half_angle[k]
    load = motion.cable_torque[:, i]
    pull = motion.pretension or 0.0
    f = 2 * r * pull * wrap - load * motion.q[:, k]  # at the pulley of joint i
    if not any(place.A):  # felt by the motor alone, over its own pulley
        f = f * motion.model.arm_scale[i]
    return acting(motion, place, f * _sign(motion, place, shape))


@numba.njit(cache=True)
def dahl(x: Vector, distance: float) -> Vector:
    """Integrate dz/dx = (1 - z sign(dx)) / distance: friction over its limit, with memory of where it turned."""
    z = np.zeros(len(x))
    for k in range(1, len(x)):
        dx = x[k] - x[k - 1]
        s = 1.0 if dx > 0 else -1.0
        z[k] = s + (z[k - 1] - s) * np.exp(-abs(dx) / distance)
    return z


@numba.njit(cache=True)
def dragged(x: Vector, band: float) -> Vector:
    """Follow a position that moves by more than a band, to either side; what stays within it is taken for rest.

    Without it the errors of an encoder at standstill, to and fro, would wear a memory of where the motion came from.
    """
    out, here = np.empty(len(x)), x[0]
    for k in range(len(x)):
        here = min(max(here, x[k] - band), x[k] + band)
        out[k] = here
    return out


@numba.njit(cache=True)
def maxwell(x: Vector, distance: float, spread: float) -> Vector:
    """Sum four elastic-sliding elements that let go between distance/spread and distance*spread, over their limit."""
    total = np.zeros(len(x))
    for e in range(4):
        d = distance * spread ** ((e - 1.5) / 1.5)
        z = 0.0
        for k in range(1, len(x)):
            z = min(1.0, max(-1.0, z + (x[k] - x[k - 1]) / d))
            total[k] += 0.25 * z
    return total


def hysteresis_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Column of a hysteresis over its limit, as Dahl's law or as elements that let go (`form`)."""
    x = remembered(motion, place)
    z = dahl(x, shape[0]) if shape[1] < 0.5 else maxwell(x, shape[0], 1.0 + 4.0 * (shape[1] - 0.5))
    return acting(motion, place, z)


def hysteresis_grid(motions: Sequence[Motion], place: Place) -> list[Shape]:
    """Screen a few distances of either form."""
    if is_whole_cable(place.location):
        return [(f * (greatest_load(motions, place) or 1.0), 0.0) for f in (0.1, 0.4)]
    r = reach(motions, place)
    if place.is_pair:
        return [(0.02 * r, 0.0), (0.1 * r, 0.0)]
    return [(f * r, form) for f in (0.01, 0.03, 0.1, 0.3) for form in (0.0, 0.75)]


def hysteresis_bounds(motions: Sequence[Motion], place: Place) -> list[tuple[float, float]]:
    """Bound the distance by the range of what is remembered."""
    if is_whole_cable(place.location):
        most = greatest_load(motions, place) or 1.0
        return [(0.03 * most, 3.0 * most), (0.0, 1.0)]
    r = reach(motions, place)
    return [(0.003 * r, 1.0 * r), (0.0, 1.0)]


DRAG_RATIO = 2
"""Where friction that drifts has its drag over its dry friction [s/rad] in its shape, if there is any."""


def warming_columns(motion: Motion, place: Place, shape: Shape) -> Columns:
    """Columns of friction f and of its excess while cold: f, f exp(-t/T), f = sign(s') + D s' where drag drifts too."""
    s = _sign(motion, place, shape)
    if len(shape) > DRAG_RATIO:
        s = s + shape[DRAG_RATIO] * place.along(motion.v, motion.motor_speeds)
    return acting(motion, place, s, s * np.exp(-motion.time / shape[1]))


def asymmetric_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    """Tell the levels of both directions from their mean and half their difference."""
    return {"coulomb_positive": float(beta[0] + beta[1]), "coulomb_negative": float(beta[0] - beta[1])}


def asymmetric_inverse(p: dict[str, float]) -> tuple[list[float], list[float]]:
    """Invert `asymmetric_physical`."""
    forwards, backwards = p["coulomb_positive"], p["coulomb_negative"]
    return [0.5 * (forwards + backwards), 0.5 * (forwards - backwards)], []


def peak_errors(place: Place, shape: Shape) -> dict[str, float]:
    """Take a peak that is as narrow as the velocity's sign is smooth for no more than known to be there."""
    width, velocity = shape
    return {"stribeck": (width / velocity) ** 2, "stribeck_velocity": 0.2 * (width / velocity) ** 2}


def memory_errors(place: Place, shape: Shape) -> dict[str, float]:
    """Take a torque for less well known than an angle."""
    return {"limit": 0.022} if is_whole_cable(place.location) else {}


def stribeck_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    """Tell the level, the peak and its velocity."""
    return {"coulomb": float(beta[0]), "stribeck": float(beta[1]), "stribeck_velocity": shape[1]}


def position_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    """Tell level, depth, cycles and phase of friction along a position."""
    depth = float(np.hypot(beta[1], beta[2]))
    return {
        "coulomb": float(beta[0]),
        "depth": depth / float(beta[0]) if beta[0] else 0.0,
        "cycles": shape[1],
        "phase": float(np.arctan2(beta[2], beta[1])),
    }


def hysteresis_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    """Tell stiffness at a reversal, limit and form."""
    stops = zip(beta[1:], STOPS, strict=False)
    stiffness = beta[0] + sum(b / f for b, f in stops)
    return {"stiffness": float(stiffness) / shape[0], "limit": float(np.sum(beta)), "form": shape[1]}


def warming_physical(beta: Vector, shape: Shape) -> dict[str, float]:
    """Tell the level once warm, the share more while cold, and how long that takes; and of drag that does the same."""
    drag = {"viscous": float(beta[0]) * shape[DRAG_RATIO]} if len(shape) > DRAG_RATIO else {}
    return {
        "friction": float(beta[0]),
        "extra": float(beta[1] / beta[0]) if beta[0] else 0.0,
        "time_constant": shape[1],
        **drag,
    }


def warming_inverse(p: dict[str, float]) -> tuple[list[float], list[float]]:
    """Invert `warming_physical`."""
    drag = [p["viscous"] / p["friction"]] if p.get("viscous") and p["friction"] else []
    return [p["friction"], p["friction"] * p["extra"]], [p["time_constant"], *drag]


def position_inverse(p: dict[str, float]) -> tuple[list[float], list[float]]:
    """Invert `position_physical`."""
    depth, phase = p["coulomb"] * p.get("depth", 0.0), p.get("phase", 0.0)
    return [p["coulomb"], depth * np.cos(phase), depth * np.sin(phase)], [p.get("cycles", 1.0)]
