"""Excitation trajectories: Fourier series within a robot's limits, chosen to be informative, at rest at both ends.

Eqs (45)-(49): `plan` chooses the series, `at_rest` adds run-in and run-out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from .errors import InputError
from .fourier import FourierSeries, PeriodGrid
from .geometry import Vector, frozen_array
from .limits import InfeasibleLimits, Limits, default_limits, worst_usage
from .model import CableModel
from .objectives import Objective, ObjectiveName, make_objective, parts_of
from .optimisers import Progress, bee_colony, covariance_adaptation
from .search_space import SearchSpace
from .sequential import sequential_programs

Optimiser = Literal["bees", "adaptation", "sequential"]


@dataclass(frozen=True)
class Design:
    """A planned series, and how it was found.

    Attributes
    ----------
    series : FourierSeries
        Touches the limits, never breaks them.
    value : float
        Of the objective, on one period of `series`.
    history : ndarray, shape (cycles,)
        Best value so far during the search (Figure 10).
    evaluations : int
        Candidates judged.
    interrupted : bool
        Whether the search was stopped from the keyboard; `series` is then the best so far.
    """

    series: FourierSeries
    value: float
    history: Vector
    evaluations: int
    interrupted: bool


def plan(
    model: CableModel,
    limits: Limits | None = None,
    objective: ObjectiveName | Objective = "d_optimal",
    *,
    harmonics: int = 5,
    zero_start: bool = False,
    duration: float = 60.0,
    frequency: tuple[float, float] | None = None,
    amplitude: float = 1.0,
    handling: Literal["scaling", "penalty"] = "scaling",
    optimiser: Optimiser = "sequential",
    cycles: int | None = None,
    samples: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Design:
    """Choose a Fourier series within the limits that minimises an objective.

    Parameters
    ----------
    model : CableModel
    limits : Limits, optional
        Default `default_limits`.
    objective : str or callable
        A name (see `make_objective`), or a function from m candidate motions ``q, v, a``, each of shape
        (m, n_samples, n_joints) and one period long, to m numbers, lower is better; `cdm_pin.objectives.each` makes one
        of a function of a single motion.
    harmonics : int
        Free harmonics per joint; eq. (47) appends one more where `zero_start` is set.
    zero_start : bool
        Impose eq. (47): start at zero, no constant. Otherwise the centre of the motion is free too.
    duration : float
        Of the experiment [s]; where `frequency` is not given the base period lies between a tenth of it and all of it.
    frequency : pair of float, optional
        Lowest and highest base frequency [rad/s], eq. (48).
    amplitude : float
        Bound of the coefficients, a_max and b_max of eqs (48), (49) [rad].
    handling : str
        ``"scaling"`` stretches or shrinks each candidate to the edge of the limits. ``"penalty"`` adds a constant for
        any violation, as printed (with the bees or the adaptation); it seldom meets a candidate within tight limits.
    optimiser : str
        ``"sequential"`` (`sequential_programs`, the best), ``"bees"`` (`bee_colony`, the paper's) or ``"adaptation"``
        (`covariance_adaptation`, for objectives that are not smooth).
    cycles : int, optional
        Of the optimiser; default its own.
    samples : int, optional
        Per period, where candidates are judged; default 16 per harmonic and at least 96.
    seed : int
    progress : callable, optional
        Called with what is being done and the fraction done. A KeyboardInterrupt ends the search and keeps the best.

    Returns
    -------
    Design

    Raises
    ------
    InputError
        If the limits leave no motion, there is no harmonic, or a name is unknown.
    """
    limits = limits or default_limits(model)
    _check_sizes(harmonics, duration, cycles)
    frequency = frequency or (2 * np.pi / duration, 20 * np.pi / duration)
    if not 0 < frequency[0] < frequency[1] < np.inf:
        raise InputError(f"base frequencies 0 < lowest < highest were expected, found {frequency}")
    total = harmonics + bool(zero_start)
    grid = PeriodGrid(samples or max(96, 16 * total), total)
    space = SearchSpace(model, limits, harmonics, zero_start, frequency, amplitude, grid)
    space.check()
    score = make_objective(objective, model) if isinstance(objective, str) else objective
    given: dict[str, Any] = {"seed": seed, "progress": progress} | ({} if cycles is None else {"cycles": cycles})
    if optimiser == "sequential":
        parts = parts_of(score)
        found = sequential_programs(space, lambda X: parts(*space.motion(X)), **given)
    elif optimiser in ("bees", "adaptation"):
        evaluate = space.scaled(score) if handling == "scaling" else space.penalised(score)
        method = bee_colony if optimiser == "bees" else covariance_adaptation
        found = method(evaluate, *space.box, **given)
    else:
        raise InputError(f"unknown optimiser {optimiser!r}; known: {', '.join(get_args(Optimiser))}")
    series = space.series(found.x)
    motion = series(series.period * np.arange(grid.samples) / grid.samples)
    value = float(np.asarray(score(*(x[None] for x in motion)))[0])
    if not np.isfinite(value):
        message = "infeasible limits: no motion within them is informative enough for the objective to judge it"
        raise InfeasibleLimits(message)
    return Design(series, value, found.history, found.evaluations, found.interrupted)


def _check_sizes(harmonics: int, duration: float, cycles: int | None) -> None:
    if harmonics < 1:
        raise InputError(f"a series of at least 1 harmonic was expected, found {harmonics}")
    if not 0 < duration < np.inf:
        raise InputError(f"a duration above 0 s was expected, found {duration:g}")
    if cycles is not None and cycles < 1:
        raise InputError(f"at least 1 cycle was expected, found {cycles}")


@dataclass(frozen=True)
class Blend:
    """A quintic between rest and a moving state: the run-in, or backwards in time the run-out.

    Attributes
    ----------
    duration : float
        [s].
    start : ndarray, shape (n_joints,)
        Position at rest.
    coefficients : ndarray, shape (3, n_joints)
        Of powers 3, 4, 5 of the share of time gone.
    """

    duration: float
    start: Vector
    coefficients: Vector

    @classmethod
    def between(cls, duration: float, start: Vector, q: Vector, v: Vector, a: Vector) -> Blend:
        """Make the blend that leaves rest at `start` and arrives with position, velocity and acceleration q, v, a."""
        end = np.stack([q - start, duration * v, duration**2 * a])
        powers = np.array([[1.0, 1.0, 1.0], [3.0, 4.0, 5.0], [6.0, 12.0, 20.0]])
        return cls(duration, start, frozen_array(np.linalg.solve(powers, end)))

    def __call__(self, time: Vector) -> tuple[Vector, Vector, Vector]:
        """Evaluate positions, velocities, accelerations at times since leaving rest [s]."""
        s = np.asarray(time, float)[:, None] / self.duration
        c3, c4, c5 = self.coefficients
        q = self.start + s**3 * (c3 + s * (c4 + s * c5))
        v = s**2 * (3 * c3 + s * (4 * c4 + s * 5 * c5)) / self.duration
        a = s * (6 * c3 + s * (12 * c4 + s * 20 * c5)) / self.duration**2
        return q, v, a


@dataclass(frozen=True)
class Excitation:
    """A whole experiment: run-in from rest, the series, run-out to rest.

    Attributes
    ----------
    series : FourierSeries
        Its time zero is the end of the run-in.
    run_in, run_out : Blend
        The run-out runs backwards.
    duration : float
        Of all of it [s].
    """

    series: FourierSeries
    run_in: Blend
    run_out: Blend
    duration: float

    def __call__(self, time: Vector) -> tuple[Vector, Vector, Vector]:
        """Evaluate q, v, a, each of shape (n_samples, n_joints), at times from 0 to `duration`."""
        time = np.atleast_1d(np.asarray(time, float))
        q, v, a = self.series(time - self.run_in.duration)
        early, late = time < self.run_in.duration, time > self.duration - self.run_out.duration
        for part, blend, at, sign in (
            (early, self.run_in, time, 1.0),
            (late, self.run_out, self.duration - time, -1.0),
        ):
            q[part], v[part], a[part] = blend(np.clip(at[part], 0.0, None))
            v[part] *= sign
        return q, v, a

    def sample(self, rate: float) -> tuple[Vector, Vector, Vector, Vector]:
        """Give time, q, v, a on a uniform grid of `rate` samples a second, both ends included where they fall on it."""
        time = np.arange(int(np.floor(self.duration * rate + 1e-9)) + 1) / rate
        return time, *self(time)


def at_rest(
    model: CableModel, limits: Limits, series: FourierSeries, duration: float, *, home: Vector | None = None
) -> Excitation:
    """Add a run-in and a run-out, within the limits, so that a series starts and ends at rest.

    The arm starts and ends at `home` if some blend allows it, else as near as it can. Where none fits the phase of the
    series is moved, then its amplitude reduced a little.

    Parameters
    ----------
    model : CableModel
    limits : Limits
    series : FourierSeries
    duration : float
        Of the whole experiment [s].
    home : ndarray, shape (n_joints,), optional
        Where the arm rests before and after; default the centre of the series.

    Raises
    ------
    InputError
        If the duration is too short, or no run-in is found.
    """
    home = np.array(series.center if home is None else home, float)
    shortest = np.inf
    for amplitude in (1.0, 0.99, 0.97, 0.9):
        for phase in np.arange(8) / 8:
            shifted = series.scaled(amplitude).delayed(phase * series.period)
            run_in = _blend(model, limits, home, shifted, lambda _: 0.0, 1.0, duration / 4)
            if run_in is None:
                continue
            moving = duration - run_in.duration
            run_out = _blend(model, limits, home, shifted, lambda blend, end=moving: end - blend, -1.0, duration / 4)
            if run_out is None:
                continue
            if run_out.duration < moving:
                return Excitation(shifted, run_in, run_out, duration)
            shortest = min(shortest, run_in.duration + run_out.duration)
    if np.isfinite(shortest):
        raise InputError(f"a duration of {duration:g} s is too short: run-in and run-out take {shortest:.3g} s")
    raise InfeasibleLimits(
        "infeasible limits: no run-in within the limits was found; relax them or move the centre of the motion"
    )


def _blend(model, limits, home: Vector, series: FourierSeries, when, direction: float, longest: float) -> Blend | None:
    """Find the blend from rest, nearest to home and shortest, into the series at ``when(duration)``, within limits."""
    for share in (0.0, 0.5, 1.0):
        for duration in np.geomspace(0.02 * longest, longest, 24):
            q, v, a = (x[0] for x in series(np.array([when(duration)])))
            v = direction * v
            gentle = q - duration * v / 2 + duration**2 * a / 12
            blend = Blend.between(duration, home + share * (gentle - home), q, v, a)
            if all(
                worst_usage(model, limits, *blend(np.linspace(0.0, duration, samples)))[0] <= 1.0
                for samples in (200, 5000)
            ):
                return blend
    return None
