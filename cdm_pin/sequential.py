"""Sequential linear programs: the optimiser for excitations, whose limits are linear in the Fourier coefficients."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from scipy.optimize import linprog

from .geometry import Vector
from .optimisers import Minimum, Progress, Tracker, covariance_adaptation


class LinearlyLimited(Protocol):
    """A search space whose limits can be linearised; see `cdm_pin.search_space.SearchSpace`."""

    @property
    def box(self) -> tuple[Vector, Vector]:
        """Bounds of the candidates."""
        ...

    def rescaled(self, X: Vector) -> Vector:
        """Scale candidates to the edge of the limits."""
        ...

    def natural(self, x: Vector) -> Vector:
        """Give the size of each entry."""
        ...

    def linear_limits(self, x: Vector, steps: Vector) -> tuple[Vector, Vector]:
        """Linearise the limits."""
        ...


Parts = Callable[[Vector], Vector]
"""From candidates (m, d) to (m, r) numbers, the largest of which is to be made small."""


def sequential_programs(
    space: LinearlyLimited,
    parts: Parts,
    *,
    cycles: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Minimum:
    """Minimise the largest of some numbers within limits by linear programs in a trust region, from many starts.

    Each program minimises the largest linearised number subject to the linearised limits; its solution is scaled to the
    edge and kept if it is better, else the region shrinks. The first start comes from a short `covariance_adaptation`,
    the others are drawn, as many as the cycles allow.

    Parameters
    ----------
    space : LinearlyLimited
    parts : callable
    cycles : int, optional
        Programs in all; default 6000 over the dimension, between 60 and 250.
    seed : int
    progress : callable, optional
    """
    rng = np.random.default_rng(seed)
    lower, upper = space.box
    cycles = min(250, max(60, 6000 // len(lower))) if cycles is None else cycles
    tracker = Tracker(lambda X: parts(X).max(axis=1), progress, cycles)
    try:
        rough = covariance_adaptation(
            lambda X: tracker(space.rescaled(X)), lower, upper, cycles=20 + 4 * len(lower), seed=seed
        )
        tracker.interrupted = rough.interrupted
        x = rough.x
        while not tracker.done:
            _follow(space, parts, tracker, x)
            x = _draw(space, rng)
    except KeyboardInterrupt:
        tracker.interrupted = True
    return tracker.minimum()


def _draw(space: LinearlyLimited, rng: np.random.Generator) -> Vector:
    """Draw a start: slow or fast, and from all coefficients of their natural size to few that dominate."""
    lower, upper = space.box
    x = rng.uniform(lower, upper)
    if rng.random() < 0.5:
        x[0] = np.exp(rng.uniform(np.log(max(lower[0], upper[0] / 20)), np.log(upper[0])))
    spread = np.exp(rng.uniform(0.0, 2.0) * rng.standard_normal(len(x) - 1))
    x[1:] = np.clip(spread * rng.standard_normal(len(x) - 1) * space.natural(x)[1:], lower[1:], upper[1:])
    return x


def _follow(space: LinearlyLimited, parts: Parts, tracker: Tracker, x: Vector, radius: float = 0.3) -> None:
    """Descend from x until the trust region closes or the last ten programs gained next to nothing."""
    x = space.rescaled(x[None])[0]
    tracker(x[None])
    value = parts(x[None])[0]
    levels = [_level(value)]
    if not np.isfinite(levels).all():
        tracker.end_cycle()
        return
    while not tracker.done and radius > 1e-6:
        program, gain = _Program(space, parts, x, value), 0.0
        tracker.evaluations += len(x)
        while gain <= 0.0 and radius > 1e-6:
            step, expected = program.solve(radius)
            candidate = space.rescaled((x + step)[None])
            new = parts(candidate)[0]
            tracker(candidate)
            gain = levels[-1] - _level(new)
            radius = min(1.0, radius * (1.6 if gain > 0.5 * expected else 1.0 if gain > 0 else 0.4))
        tracker.end_cycle()
        if gain > 0:
            x, value = candidate[0], new
            levels.append(_level(value))
            if len(levels) > 10 and levels[-11] - levels[-1] < 1e-3:
                return


def _level(value: Vector) -> float:
    """Compare on a logarithmic scale where all numbers are positive."""
    return float(np.log(value.max())) if value.min() > 0 else float(value.max())


class _Program:
    """The linear program about one candidate; only the trust region changes between its solutions."""

    def __init__(self, space: LinearlyLimited, parts: Parts, x: Vector, value: Vector):
        lower, upper = space.box
        self.steps = space.natural(x)
        h = 1e-5
        moved = parts(x + h * np.diag(self.steps))
        slope = np.nan_to_num((moved - value) / h, nan=0.0, posinf=1e9, neginf=-1e9).T
        positive = value.min() > 0
        self.value, slope = (np.log(value), slope / value[:, None]) if positive else (value, slope)
        A, b = space.linear_limits(x, self.steps)
        self.A = np.vstack([np.hstack([A, np.zeros((len(A), 1))]), np.hstack([slope, -np.ones((len(slope), 1))])])
        self.b = np.concatenate([np.maximum(b, 0.0), -self.value])
        self.room = np.column_stack([lower - x, upper - x]) / self.steps[:, None]

    def solve(self, radius: float) -> tuple[Vector, float]:
        """Give the step and the improvement that it promises."""
        bounds = np.vstack([np.clip(self.room, -radius, radius), [-np.inf, np.inf]])
        cost = np.zeros(self.A.shape[1])
        cost[-1] = 1.0
        result = linprog(cost, A_ub=self.A, b_ub=self.b, bounds=bounds, method="highs")
        if result.x is None:
            return np.zeros(len(self.steps)), 0.0
        return self.steps * result.x[:-1], float(self.value.max() - result.x[-1])
