"""Minimisers over a box that see many candidates at once: the paper's artificial bee colony, and a better one.

Both take ``evaluate(X)``, X of shape (m, d), giving m values, and keep the best they have seen when interrupted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .errors import InputError
from .geometry import Vector

Evaluate = Callable[[Vector], Vector]
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Minimum:
    """What an optimiser found.

    Attributes
    ----------
    x : ndarray, shape (d,)
        The best candidate.
    value : float
    history : ndarray, shape (cycles,)
        Best value so far after each cycle (Figure 10).
    evaluations : int
    interrupted : bool
        Whether it was stopped from the keyboard before its end.
    """

    x: Vector
    value: float
    history: Vector
    evaluations: int
    interrupted: bool = False


class Tracker:
    """Counts evaluations, keeps the best candidate and the history of its value.

    Parameters
    ----------
    evaluate : callable
    progress : callable or None
    cycles : int
        How many there will be.
    """

    def __init__(self, evaluate: Evaluate, progress: Progress | None, cycles: int):
        self.evaluate, self.progress, self.cycles = evaluate, progress, cycles
        self.x, self.value, self.evaluations = np.zeros(0), np.inf, 0
        self.history: list[float] = []
        self.interrupted = False

    def __call__(self, X: Vector) -> Vector:
        """Judge candidates; what is not a number counts as the worst."""
        values = np.asarray(self.evaluate(X), float)
        values = np.where(np.isfinite(values), values, 1e300)
        self.evaluations += len(X)
        best = int(values.argmin())
        if values[best] < self.value or not len(self.x):
            self.x, self.value = X[best].copy(), float(values[best])
        return values

    @property
    def done(self) -> bool:
        """Whether the cycles are used up, or the search was interrupted."""
        return self.interrupted or len(self.history) >= self.cycles

    def end_cycle(self) -> None:
        """Note the best value so far."""
        self.history.append(self.value)
        done = len(self.history)
        if self.progress and done % max(1, self.cycles // 200) == 0:
            self.progress(f"optimising, best so far {self.value:.5g}", done / self.cycles)

    def minimum(self) -> Minimum:
        """Give the result; raises KeyboardInterrupt if nothing was judged before the interruption."""
        if not len(self.x):
            raise KeyboardInterrupt
        return Minimum(self.x, self.value, np.array(self.history), self.evaluations, self.interrupted)


def bee_colony(
    evaluate: Evaluate,
    lower: Vector,
    upper: Vector,
    *,
    cycles: int = 2000,
    population: int = 20,
    limit: int | None = None,
    seed: int = 0,
    start: Vector | None = None,
    progress: Progress | None = None,
) -> Minimum:
    r"""Search as an artificial bee colony does (Figure 6, Table 2), all bees of a kind at once.

    Half the bees are employed, one per food source; each tries a neighbour of its source,
    :math:`x_j + \varphi (x_j - x_{kj})` in one coordinate j, with another source k and :math:`\varphi` in (-1, 1).
    The other half, the onlookers, do the same at sources chosen in proportion to their fitness 1/(1 + objective). The
    better of source and neighbour stays. A source that was not improved in `limit` trials is given up and a scout draws
    a new one.

    Parameters
    ----------
    evaluate : callable
        From candidates, shape (m, d), to m values.
    lower, upper : ndarray, shape (d,)
        The box.
    cycles : int
        Employed, onlooker and scout phases.
    population : int
        Bees, twice the number of food sources.
    limit : int, optional
        Trials before a source is given up; default its usual value, sources times dimensions.
    seed : int
    start : ndarray, shape (d,), optional
        One of the first sources.
    progress : callable, optional
    """
    sources = population // 2
    if sources < 2:
        raise InputError(f"a colony of at least 4 bees was expected, found {population}")
    rng = np.random.default_rng(seed)
    d = len(lower)
    limit = sources * d if limit is None else limit
    tracker = Tracker(evaluate, progress, cycles)
    try:
        X = rng.uniform(lower, upper, (sources, d))
        if start is not None:
            X[0] = np.clip(start, lower, upper)
        values, trials = tracker(X), np.zeros(sources, int)
        for _ in range(cycles):
            for onlookers in (False, True):
                chosen = rng.choice(sources, sources, p=_shares(values)) if onlookers else np.arange(sources)
                neighbours = _neighbours(rng, X, chosen, lower, upper)
                _keep_better(X, values, trials, chosen, neighbours, tracker(neighbours))
            tired = int(trials.argmax())
            if trials[tired] > limit:
                X[tired], trials[tired] = rng.uniform(lower, upper), 0
                values[tired] = tracker(X[tired : tired + 1])[0]
            tracker.end_cycle()
    except KeyboardInterrupt:
        tracker.interrupted = True
    return tracker.minimum()


def _shares(values: Vector) -> Vector:
    """Fitness 1/(1 + objective), as shares; of a negative objective 1 + |objective|."""
    fitness = np.where(values >= 0, 1.0 / (1.0 + np.abs(values)), 1.0 + np.abs(values))
    return fitness / fitness.sum()


def _neighbours(rng: np.random.Generator, X: Vector, chosen: np.ndarray, lower: Vector, upper: Vector) -> Vector:
    n = len(chosen)
    other = (chosen + rng.integers(1, len(X), n)) % len(X)
    j = rng.integers(0, X.shape[1], n)
    result = X[chosen].copy()
    result[np.arange(n), j] += rng.uniform(-1, 1, n) * (X[chosen, j] - X[other, j])
    return np.clip(result, lower, upper)


def _keep_better(X: Vector, values: Vector, trials: np.ndarray, chosen, neighbours: Vector, found: Vector) -> None:
    """Greedy selection, in the order of the bees; writes into the colony's arrays."""
    for i, x, value in zip(chosen, neighbours, found, strict=True):
        if value < values[i]:
            X[i], values[i], trials[i] = x, value, 0
        else:
            trials[i] += 1


def covariance_adaptation(
    evaluate: Evaluate,
    lower: Vector,
    upper: Vector,
    *,
    cycles: int = 2000,
    population: int | None = None,
    seed: int = 0,
    start: Vector | None = None,
    progress: Progress | None = None,
) -> Minimum:
    """Search by adapting a normal distribution's covariance (CMA-ES [1]_), restarted when it has contracted.

    Parameters
    ----------
    evaluate, lower, upper
        As for `bee_colony`.
    cycles : int
        Generations in all, over the restarts.
    population : int, optional
        Candidates per generation; default 20, or 4 + 3 ln(d) twice over if that is more.
    seed : int
    start : ndarray, shape (d,), optional
        Mean of the first distribution.
    progress : callable, optional

    References
    ----------
    .. [1] N. Hansen, "The CMA evolution strategy: a tutorial", arXiv:1604.00772, 2016.
    """
    population = max(20, 2 * (4 + int(3 * np.log(len(lower))))) if population is None else population
    if population < 4:
        raise InputError(f"a population of at least 4 was expected, found {population}")
    rng = np.random.default_rng(seed)
    tracker = Tracker(evaluate, progress, cycles)
    try:
        while not tracker.done:
            _descend(tracker, rng, lower, upper, population, start)
            start = None
    except KeyboardInterrupt:
        tracker.interrupted = True
    return tracker.minimum()


def _descend(tracker: Tracker, rng, lower: Vector, upper: Vector, size: int, start: Vector | None) -> None:
    """Run one distribution until it has contracted, has stopped improving, or the cycles are used up."""
    d, span = len(lower), upper - lower
    weights = np.log((size + 1) / 2) - np.log(np.arange(1, size // 2 + 1))
    weights /= weights.sum()
    mass = 1.0 / (weights**2).sum()
    c_path, c_sigma = (4 + mass / d) / (d + 4 + 2 * mass / d), (mass + 2) / (d + mass + 5)
    c_one = 2 / ((d + 1.3) ** 2 + mass)
    c_rank = min(1 - c_one, 2 * (mass - 2 + 1 / mass) / ((d + 2) ** 2 + mass))
    damping = 1 + 2 * max(0.0, np.sqrt((mass - 1) / (d + 1)) - 1) + c_sigma
    expected = np.sqrt(d) * (1 - 1 / (4 * d) + 1 / (21 * d**2))
    mean = rng.uniform(0.25, 0.75, d) if start is None else np.clip((start - lower) / span, 0, 1)
    sigma, C, path, path_sigma = 0.15, np.eye(d), np.zeros(d), np.zeros(d)
    first = len(tracker.history)
    recent: list[float] = []
    while not tracker.done:
        eigenvalues, B = np.linalg.eigh(C)
        D = np.sqrt(np.maximum(eigenvalues, 1e-20))
        u = np.clip(mean + sigma * (rng.standard_normal((size, d)) * D) @ B.T, 0.0, 1.0)
        steps = (u - mean) / sigma
        values = tracker(lower + span * u)
        order = values.argsort()[: len(weights)]
        step = weights @ steps[order]
        mean = mean + sigma * step
        path_sigma = (1 - c_sigma) * path_sigma + np.sqrt(c_sigma * (2 - c_sigma) * mass) * (B @ ((B.T @ step) / D))
        length = np.linalg.norm(path_sigma)
        age = len(tracker.history) - first + 1
        steady = length / np.sqrt(1 - (1 - c_sigma) ** (2 * age)) < (1.4 + 2 / (d + 1)) * expected
        path = (1 - c_path) * path + steady * np.sqrt(c_path * (2 - c_path) * mass) * step
        C = (1 - c_one - c_rank) * C + c_one * np.outer(path, path) + c_rank * (steps[order].T * weights) @ steps[order]
        sigma *= np.exp(min(1.0, c_sigma / damping * (length / expected - 1)))
        tracker.end_cycle()
        recent.append(float(values[order[0]]))
        patience = 50 + 10 * d
        stalled = age > 2 * patience and min(recent[-patience:]) > (1 - 1e-6) * min(recent[:-patience])
        if sigma * D.max() < 1e-10 or stalled:
            return
