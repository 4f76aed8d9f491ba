"""The shapes of effects, estimated: widths, angles, times, on which their columns do not depend linearly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from .candidates import Candidate
from .fit import Fit, least_squares
from .friction_effects import GIVES
from .geometry import Vector
from .pushes import LIKELY, edged
from .scores import Score
from .search import Search
from .sensor_effects import DELAYS
from .whitening import Whitener

SHORTEST = 1e-4  # [s] of delays


def refine(
    search: Search, fit: Fit, candidate: Candidate, rounds: int = 2, plausibly: bool = False
) -> tuple[Candidate, Score]:
    """Estimate the shape of a candidate: one nonlinear parameter after the other, to the best score.

    Or the best that is plausible, where any is: over less than a cycle of friction that varies with position the
    best may not brake, and many others explain as much.

    Where the shape is the coefficient, as of a delay, it is made to be: a small share of a long delay would be a
    low-pass, which noisy accelerations ask for. Of a push that is evident, all pairs of edges are compared first.
    """
    if not candidate.effect.counts:
        for _ in range(3 * rounds):
            delay = float(np.clip(search.score(fit, candidate).beta[0], SHORTEST, DELAYS[1]))
            search.forget(candidate)
            candidate = replace(candidate, shape=(delay, *candidate.shape[1:]))
        return candidate, search.score(fit, candidate)
    bounds = candidate.bounds(search.problem.motions)
    best, score, reach = candidate, search.score(fit, candidate), candidate.effect.reach
    if candidate.effect.name == "external_torque" and score.statistic > LIKELY:
        edges, apart = edged(search, fit, candidate)
        there = search.score(fit, edges)
        if there.statistic > score.statistic:
            best, score, reach = edges, there, 1.5 * apart / (bounds[0][1] - bounds[0][0])
    for _ in range(rounds if len(bounds) > 1 else 1):
        for i in range(min(len(bounds), len(candidate.shape))):
            best, score = _refine_one(search, fit, best, score, i, bounds[i], plausibly, reach)
    return best, score


def _refine_one(
    search: Search,
    fit: Fit,
    start: Candidate,
    score: Score,
    i: int,
    bounds: tuple[float, float],
    plausibly: bool,
    reach: float,
):
    logarithmic = bounds[0] > 0
    found: list[tuple[bool, float, Candidate, Score]] = []

    def keep(trial: Candidate, s: Score) -> bool:
        plausible = not plausibly or trial.is_plausible(s.beta, fit.effects)
        found.append((plausible, s.statistic, trial, s))
        return plausible and bool(np.isfinite(s.statistic))

    keep(start, score)

    def loss(x: float) -> float:
        value = float(np.exp(x)) if logarithmic else float(x)
        shape = (*start.shape[:i], value, *start.shape[i + 1 :])
        trial = replace(start, shape=shape)
        s = search.score(fit, trial)
        search.forget(trial)
        return -s.statistic if keep(trial, s) else 0.0

    low, high = (np.log(bounds[0]), np.log(bounds[1])) if logarithmic else bounds
    here = min(max(np.log(start.shape[i]) if logarithmic else start.shape[i], low), high)
    reach = reach * (high - low)
    if high > low:
        minimize_scalar(
            loss,
            bounds=(max(low, here - reach), min(high, here + reach)),
            method="bounded",
            options={"maxiter": 9, "xatol": 3e-3 * reach},
        )
    return max(found, key=lambda item: item[:2])[2:]


def tuned(search: Search, effects: Sequence[Candidate], whitener: Whitener, rounds: int = 3) -> list[Candidate]:
    """Estimate the shapes of all effects together (Gauss-Newton on what the coefficients leave over)."""
    effects = list(effects)
    for _ in range(rounds):
        fit = search.fit(effects, whitener)
        centred = [c.centred(beta) for c, beta in zip(effects, fit.beta, strict=True)]
        if centred != effects:
            effects = centred
            fit = search.fit(effects, whitener)
        W = _white_slopes(search, fit)
        if not len(W):
            break
        size, W = np.linalg.norm(W, axis=1), fit.rest(W)
        own = np.linalg.norm(W, axis=1)
        scale = np.where(own > 1e-3 * size, own, np.inf)
        step = np.linalg.lstsq((W / scale[:, None]).T, fit.residual, rcond=1e-3)[0] / scale
        for share in (1.0, 0.3):
            trial = _moved(search, effects, share * step)
            better = search.fit(trial, whitener)
            if better.deviance < fit.deviance:
                break
        else:
            break
        effects = trial
        if fit.deviance - better.deviance < 0.1:
            break
    return effects


def restarted(search: Search, effects: Sequence[Candidate], whitener: Whitener, least: float = 10.0) -> list[Candidate]:
    """Estimate the torques within which plays are crossed from each that is screened; the best stand.

    From one that is far off, all that makes it better may lie behind what makes it worse.
    """
    best = list(effects)
    for j, candidate in enumerate(effects):
        if candidate.effect.name != "backlash" or candidate.rattles:
            continue
        for shape in candidate.effect.grid(search.problem.motions, candidate.place):
            trial = tuned(search, [*best[:j], replace(candidate, shape=shape), *best[j + 1 :]], whitener)
            if search.fit(trial, whitener).deviance < search.fit(best, whitener).deviance - least:
                best = trial
    return best


def _moved(search: Search, effects: Sequence[Candidate], step: Vector) -> list[Candidate]:
    """Move the free elements of all shapes, no further than their bounds and their reach."""
    out, first = [], 0
    for candidate in effects:
        shape = list(candidate.shape)
        for i, (low, high) in enumerate(candidate.bounds(search.problem.motions)[: len(shape)]):
            reach = candidate.effect.reach * (abs(shape[i]) if low > 0 else high - low)
            moved = shape[i] + float(np.clip(step[first], -reach, reach))
            shape[i] = min(max(moved, min(low, shape[i])), max(high, shape[i]))
            first += 1
        out.append(replace(candidate, shape=tuple(shape)))
    return out


def yielding(search: Search, effects: Sequence[Candidate], whitener: Whitener, least: float = 6.0) -> list[Candidate]:
    """Take of distances within which dry friction gives before it slides those that suit the data, one by one."""
    effects = list(effects)
    best = search.fit(effects, whitener).deviance if any(c.gives for c in effects) else 0.0
    for j, candidate in enumerate(effects):
        for factor in (0.25, 4.0):
            trial = effects
            while candidate.gives and GIVES[0] <= factor * trial[j].gives <= GIVES[1]:
                trial = [*trial[:j], replace(trial[j], gives=factor * trial[j].gives), *trial[j + 1 :]]
                own = search.fit(trial, whitener).deviance
                if own > best - least:
                    break
                best, effects = own, trial
    return effects


def loosened(search: Search, fit: Fit) -> Fit:
    """Give a fit in which the shapes of its effects give way, to first order, to what is scored beside it.

    Estimated without that, they may have taken much of it up.
    """
    W = _white_slopes(search, fit)
    basis = least_squares(fit.rest(W), fit.residual, np.linalg.norm(W, axis=1))[1]
    residual = fit.residual - basis @ (basis.T @ fit.residual)
    return replace(fit, Q=np.concatenate([fit.Q, basis], axis=1), weights=None, residual=residual)


def _white_slopes(search: Search, fit: Fit) -> Vector:
    """Differentiate a fit by the free elements of its effects' shapes, whitened, shape (n_elements, n_rows)."""
    slopes = [shape_slopes(search, c, b) for c, b in zip(fit.effects, fit.beta, strict=True)]
    flat = [s for own in slopes for s in own]
    if not flat:
        return np.zeros((0, fit.n_rows))
    banks = [np.concatenate([s[r] for s in flat]) for r in range(len(search.rigid))]
    return search.white(fit.whitener, banks)


def shape_slopes(search: Search, candidate: Candidate, beta: Vector) -> list[list[Vector]]:
    """Differentiate X(shape) beta by each free element of the shape: one list of runs per element, in the band."""
    slopes = []
    free = len(candidate.bounds(search.problem.motions))
    for i, value in enumerate(candidate.shape[:free]):
        h = 1e-3 * abs(value) or 1e-3
        sides = []
        for step in (h, -h):
            shape = (*candidate.shape[:i], value + step, *candidate.shape[i + 1 :])
            columns = search.in_band(replace(candidate, shape=shape).columns)
            sides.append([np.tensordot(beta, c, 1) for c in columns])
        slopes.append([(a - b)[None] / (2 * h) for a, b in zip(*sides, strict=True)])
    return slopes
