"""The candidates that lead beside a fit, and the best of them once their shapes are estimated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .bank import Bank
from .candidates import Candidate, at_known_place
from .fit import Fit, moved_masses, own_covariance
from .friction_effects import DRAG_RATIO
from .geometry import Vector
from .likelihood import gain
from .scores import Score
from .search import Search, rms, score_beside
from .shapes import refine

UNLIKELIER = "transmission_ratio_error"
"""Less likely than what is as simple and explains as much: radii of pulleys are known better than gains of torques."""
POSTURE = ("encoder_offset", "base_tilt")
"""What moves links to where no encoder says they are, at rest already."""
STRONG = 400.0
"""Statistic from which on friction shows how its sign passes through zero."""


def leading(
    search: Search,
    fit: Fit,
    bank: Bank,
    most: int,
    taken: Sequence[Candidate] = (),
    named: bool | None = True,
    instead: Sequence[Candidate] = (),
):
    """Best shape of each effect and place, the likeliest first: (candidate, score, weight).

    Of those that would stand `instead` of effects whose torque they contain, none: it would come back by the back door.
    Nor a play that never changes sides: it is an offset, as which it is named, unless it stands instead of several of
    which no encoders on both sides tell each.
    """
    loads = any(c.loads for c in instead)
    several = len(instead) > 1 and not search.problem.kinematic and all(c.effect.name in POSTURE for c in instead)
    best: dict[tuple[str, str], tuple[float, int, Score]] = {}
    pool = [p for p, own in ((bank.laws, True), (bank.corrections, False)) if named in (own, None)]
    candidates = [c for part in pool for c in part.candidates]
    weight = [w for part in pool for w in part.weight]
    scores = [score for part in pool for score in search.score_all(fit, part)]
    for i, (candidate, score) in enumerate(zip(candidates, scores, strict=True)):
        if score.visible < search.settings.visible or any(candidate.clashes(other) for other in taken):
            continue
        if loads and candidate.effect.follows:
            continue
        if candidate.effect.name == "backlash" and not (several or search.is_crossed(candidate)):
            continue
        value = gain(search, fit, candidate, score)
        if np.isfinite(value) and (candidate.key not in best or value > best[candidate.key][0]):
            best[candidate.key] = (value, i, score)
    order = sorted(best.values(), key=lambda item: (-_rough(item[0]), item[1]))[:most]
    return [(candidates[i], score, weight[i]) for _, i, score in order]


def best_of(search: Search, fit: Fit, candidates: Sequence[Candidate]):
    """Pick the best of some candidates, shapes estimated: the simplest of those that the laws' accuracy cannot tell.

    The width of the smooth sign is estimated once, for the leader; rivals at the same place start from it.
    """
    if not candidates:
        return None
    first = refine(search, fit, candidates[0])
    if first[1].statistic > STRONG:
        candidates = [c.detailed(search.problem.motions) for c in (first[0], *candidates[1:])]
        first = _braking(search, fit, *refine(search, fit, candidates[0]))
    pool = [first]
    rest = [same_width(c, first[0]) for c in candidates[1:]]
    scored = [(gain(search, fit, c, s), n, c, s) for n, c in enumerate(rest) for s in [search.score(fit, c)]]
    best = gain(search, fit, *first)
    for n, (value, _, c, s) in enumerate(sorted(scored, key=lambda item: -item[0])):
        fine = c.effect.reach < 0.1  # its grid is coarse beside its peak
        if (n < 4 and value > best - max(40.0, 0.15 * abs(best))) or (fine and value > 0.3 * best):
            pool.append(_braking(search, fit, *refine(search, fit, c)) if c.shape else (c, s))
    pool = [(c, s) for c, s in pool if gain(search, fit, c, s) > 0 and c.is_plausible(s.beta, fit.effects)]
    pool = [(c, s) for c, s in pool if not hides_in_masses(search, fit, c)]
    if not pool:
        return None
    top = max(pool, key=lambda item: gain(search, fit, *item))
    error = search.settings.law_error if top[0].named else search.settings.patch_law_error
    slack = 0.5 * error**2 * top[1].statistic
    near = [item for item in pool if gain(search, fit, *item) >= gain(search, fit, *top) - slack]

    def order(item: tuple[Candidate, Score]) -> tuple[int, bool, float]:
        return item[1].k + item[0].extra, item[0].effect.name == UNLIKELIER, -_rough(gain(search, fit, *item))

    best = min(near, key=order)
    known = at_known_place(best[0], search.problem.model)
    if known is best[0] or any(known.key == c.key for c in fit.effects):
        return best
    return known, search.score(fit, known)


def _braking(search: Search, fit: Fit, candidate: Candidate, score: Score) -> tuple[Candidate, Score]:
    """Let friction that would drive if it gave before it slides give nothing."""
    if not candidate.gives or candidate.is_plausible(score.beta, fit.effects):
        return candidate, score
    return refine(search, fit, replace(candidate, gives=0.0))


def hides_in_masses(search: Search, fit: Fit, candidate: Candidate, most: float = 2.0) -> bool:
    """Whether an effect needs masses that are much further from the file's than those without it.

    Their torque is then some times all that is measured: what masses cancel to nearly all of it may be any multiple of
    what is seen.
    """
    if not candidate.named or not search.problem.torque:
        return False
    p, problem = len(search.base.columns), search.problem
    file = search.base.values(problem.sensors.model.standard_parameters)
    without = search.base.values(problem.model.standard_parameters) - file + fit.base[:p]
    fit = fit if fit.weights is not None else search.fit(fit.effects, fit.whitener)
    W = search.white(fit.whitener, search.columns(candidate))
    changed = without + (moved_masses(fit, W) @ score_beside(fit, W, candidate.signs).beta)[:p]
    loads = search.loads[: problem.model.n_motors]

    def torque(change: Vector) -> Vector:
        return rms(search, [np.tensordot(change, rigid[:p], 1) for rigid in search.rigid])[: len(loads)]

    return bool(np.any(torque(changed) > most * np.maximum(loads, torque(without))))


def same_width(candidate: Candidate, other: Candidate) -> Candidate:
    """Give a candidate the width of the smooth sign of another at its place, and the distance within which it gives."""
    same = bool(other.place.A) and (candidate.place.A, candidate.place.B) == (other.place.A, other.place.B)
    if same and candidate.gives and other.gives:
        candidate = replace(candidate, gives=other.gives)
    if same and candidate.effect.nuisance_shape == 1 == other.effect.nuisance_shape:
        return replace(candidate, shape=(other.shape[0], *candidate.shape[1:]))
    return candidate


def same_form(candidate: Candidate, other: Candidate) -> Candidate:
    """Let friction that drifts take the drag of its place with it where another one, which it is set against, does."""
    if candidate.effect.name == other.effect.name == "friction_drift":
        return replace(candidate, shape=(*candidate.shape[:DRAG_RATIO], *other.shape[DRAG_RATIO:]))
    return candidate


def _rough(x: float) -> float:
    """Round to six digits, so that what differs by rounding alone stands in a fixed order."""
    return float(f"{x:.6g}")


def drives(search: Search, fit: Fit, candidate: Candidate) -> bool:
    """Whether an effect beside a fit does what it hardly can, as a spring that pushes on, by three standard errors."""
    if candidate.effect.least is None:
        return False
    weights = candidate.least(search.problem.motions)
    both = search.fit([*fit.effects, candidate], fit.whitener)
    k = len(weights)
    spread = own_covariance(both, len(fit.effects))[:k, :k]
    return bool(weights @ both.beta[-1][:k] < -3.0 * np.sqrt(max(weights @ spread @ weights, 0.0)))
