"""Visits to recordings: once for their moments, once more for the colour of their noise.

A visit is a function of one picklable task, so that any executor can make it (`cdm_pin.workers`). In this process a few
recordings are kept ready for the next visit; elsewhere they are read again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from . import estimators
from .accelerations import Acceleration
from .base import random_states
from .errors import InputError, RecordingError
from .estimators import Colour, Fit, Moments
from .geometry import Vector
from .observation import BLOCK, Observation, cleaned_torque, observe, rows
from .recording import Recording, load_recording
from .regressor import motor_regressor
from .signals_filters import noise_floor
from .support import supported
from .terms import Plan
from .workers import Skipped, Workers, run_all

Progress = Callable[..., None]  # (step, fraction, **news); news only for callbacks with a true `wants_news`
Tell = Callable[[Moments, float, float], None]
NEWS = 60  # reports along the first recording, to callbacks that want them
MANY = 200  # recordings; of more, moments are kept only for all of them together
Source = Recording | str | Path
Task = tuple[Plan, Source, dict | None]  # what to do, with which recording, and where to keep it ready


@dataclass(frozen=True)
class Visit:
    """What a first visit to a recording gives.

    Attributes
    ----------
    name : str
    source : Path or None
    moments, noise : Moments
        Of all columns of the plan, and of what the positions' noise adds to them; empty once they are gathered from
        very many recordings.
    torques : Moments
        The same as `moments`, with the equations of motors at rest, which are predicted but not fitted.
    n_used : int
        Samples in them, after decimation.
    independent : float
        Values that the motion gives per motor: twice the columns' mean frequency times the time used, and one.
    n_samples, duration, rate, cutoff
        Of the recording; [s], [Hz], [Hz].
    noise_floor : ndarray, shape (n_motors,)
        Noise of the torques within the filter's band, judged without a model [N m].
    shapes : tuple
        Of each of the plan's terms: the width of the smooth sign.
    notices : tuple of str
    left_out : dict of str to int
        Samples not used, by reason.
    accelerations : tuple of Acceleration, length n_motors
    """

    name: str
    source: Path | None
    moments: Moments
    noise: Moments
    torques: Moments
    n_used: int
    independent: float
    n_samples: int
    duration: float
    rate: float
    cutoff: float
    noise_floor: Vector
    shapes: tuple[tuple[float, ...], ...]
    notices: tuple[str, ...]
    left_out: dict[str, int]
    accelerations: tuple[Acceleration, ...]


@dataclass(frozen=True)
class Gathered:
    """Recordings taken together.

    Attributes
    ----------
    visits : tuple of Visit
    moments, noise, torques : Moments
        Of all of them.
    independent : float
        Sum of theirs.
    noise_floor : ndarray, shape (n_motors,)
        Root mean square over the samples [N m].
    skipped : tuple of Skipped
        Recordings that were left out.
    """

    visits: tuple[Visit, ...]
    moments: Moments
    noise: Moments
    torques: Moments
    independent: float
    noise_floor: Vector
    skipped: tuple[Skipped, ...] = ()


def gather(plan: Plan, results: Iterable[Visit | Skipped], keep: bool = True) -> Gathered:
    """Fold visits together in the order they come; with `keep` each one's own moments are kept too.

    Raises
    ------
    InputError
        If all were skipped.
    """
    empty = Moments.empty(plan.names, plan.present)
    moments, noise, torques, floor = empty, empty, empty, np.zeros(plan.model.n_motors)
    visits: list[Visit] = []
    skipped: list[Skipped] = []
    for result in results:
        if isinstance(result, Skipped):
            skipped.append(result)
            continue
        moments, noise = moments.merge(result.moments), noise.merge(result.noise)
        torques = torques.merge(result.torques)
        floor = floor + result.n_used * result.noise_floor**2
        visits.append(replace(result, moments=empty, noise=empty, torques=result.torques if keep else empty))
    if not visits:
        raise InputError(f"no recording is left: {skipped[0].name}: {skipped[0].reason}")
    independent = sum(visit.independent for visit in visits)
    floor = np.sqrt(floor / max(moments.n_samples, 1))
    return Gathered(tuple(visits), moments, noise, torques, independent, floor, tuple(skipped))


class Survey:
    """Sends visits to the executor; in this process it keeps a few recordings ready for the next visit."""

    def __init__(self, plan: Plan, workers: Workers, skip_bad: bool, progress: Progress | None):
        self.plan, self.workers, self.skip_bad = plan, workers, skip_bad
        self.progress: Progress = progress or (lambda step, fraction: None)
        self.tasks: list[Task] = []
        self.freedom = 1, 0.0  # samples, independent values

    def visit(self, sources: Sequence[Source], step: str) -> Gathered:
        """Visit recordings for their moments; those visited first are the ones of all later visits."""
        kept = {} if self.workers.in_process and len(sources) <= 8 else None
        tasks = [(self.plan, source, kept) for source in sources]
        visit = self._told_visit(tasks[0], step) if self._listened else reduce_recording
        results = self._run(visit, tasks, sources, step, skip_bad=self.skip_bad)
        good: list[Task] = []
        gathered = gather(self.plan, _noting(tasks, results, good), len(tasks) <= MANY)
        if not self.tasks:
            self.tasks = good
            self.plan = _settled(self.plan, gathered.visits)  # what the training chose, for a hold-out
            self.freedom = max(gathered.moments.n_samples, 1), gathered.independent
        return gathered

    @property
    def _listened(self) -> bool:
        """Whether the callback wants estimates while they form."""
        return self.workers.in_process and not self.tasks and getattr(self.progress, "wants_news", False)

    def _told_visit(self, first: tuple, step: str) -> Callable[[tuple], Visit]:
        """Give a visit that reports estimates, block by block, while it goes through the first recording."""

        def tell(moments: Moments, time: float, fraction: float) -> None:
            _, columns, _ = supported(self.plan, moments)
            if columns:
                fit = estimators.weighted(moments.select(columns))
                std = np.sqrt(np.diag(fit.white_covariance))
                found = list(zip(fit.names, fit.values, std, strict=True))
                self.progress(step, fraction, at=time, parameters=found, residual=fit.noise)

        return lambda task: reduce_recording(task, tell if task is first else None)

    def covariance(self, fit: Fit, columns: Sequence[int], *, robust: bool) -> Vector:
        """Visit the recordings again for the covariance of a fit's values."""
        if not columns:
            return np.zeros((0, 0))
        tasks = [(task, fit, tuple(columns), self.freedom, robust) for task in self.tasks]
        middle = reduce(np.add, self._run(colour_recording, tasks, self._sources, "standard errors"))
        return estimators.sandwich(fit.information, middle)

    def robust(self, fit: Fit, columns: Sequence[int], rounds: int = 20) -> tuple[Fit, Moments]:
        """Fit and pull outliers in turn until neither changes."""
        moments = Moments.empty(fit.names, self.plan.present[:, list(columns)])
        for _ in range(rounds):
            values = _spread(self.plan, columns, fit.values)
            parts = self._run(clean_recording, [(t, values) for t in self.tasks], self._sources, "pulling outliers")
            moments = reduce(Moments.merge, parts).select(columns)
            previous, fit = fit, estimators.weighted(moments)
            if np.all(np.abs(fit.values - previous.values) <= 1e-2 * np.sqrt(np.diag(fit.white_covariance))):
                break
        return fit, moments

    @property
    def _sources(self) -> list[Source]:
        return [task[1] for task in self.tasks]

    def _run(self, function, tasks, sources, step: str, skip_bad: bool = False) -> Iterator[Any]:
        names = [str(s) if isinstance(s, str | Path) else s.name for s in sources]
        progress = self.progress
        return run_all(
            function, tasks, self.workers, names=names, skip_bad=skip_bad, progress=lambda x: progress(step, x)
        )


def _settled(plan: Plan, visits: Sequence[Visit]) -> Plan:
    """Settle what recordings chose on the middle one of their choices, per motor and per term."""
    middle = len(visits) // 2
    ways = zip(*(visit.accelerations for visit in visits), strict=True)
    accelerations = tuple(sorted(choices, key=lambda choice: choice.cutoff)[middle] for choices in ways)
    shapes = tuple(sorted(choices)[middle] for choices in zip(*(visit.shapes for visit in visits), strict=True))
    return replace(plan, accelerations=accelerations, shapes=shapes)


def _noting(tasks: Sequence[Task], results: Iterable[Any], good: list[Task]) -> Iterator[Any]:
    """Pass results on, and note the tasks of those that are visits."""
    for task, result in zip(tasks, results, strict=True):
        if isinstance(result, Visit):
            good.append((replace(task[0], accelerations=result.accelerations, shapes=result.shapes), *task[1:]))
        yield result


def reduce_recording(task: Task, tell: Tell | None = None) -> Visit:
    """Visit a recording for its moments.

    Parameters
    ----------
    task : tuple
    tell : callable, optional
        Takes the moments so far, up to which time they reach [s], and the fraction that is done, block by block.

    Raises
    ------
    RecordingError
        If it cannot be read, contradicts the robot, or logs a torque with the wrong sign.
    """
    plan, source, _ = task
    observation = _observed(task)
    moments = Moments.empty(plan.names, plan.present)
    time, total = observation.motion.time, max(observation.n_samples, 1)
    pace = _Pace(plan.base.rank)
    for number, X, y in rows(plan, observation, block=len(time) // NEWS if tell else BLOCK):
        moments = moments.add(X, y)
        pace.add(number, X)
        if tell is not None:
            share = moments.n_samples / total
            tell(moments, float(time[int(share * (len(time) - 1))]), share)
    noise, torques = Moments.empty(plan.names, plan.present), moments
    for _, X, y in rows(plan, observation, noise=True):
        noise = noise.add(X, 0.0 * y)
    if observation.resting.any():
        torques = Moments.empty(plan.names, plan.present)
        for _, X, y in rows(plan, observation, resting=True):
            torques = torques.add(X, y)
    signals = observation.signals
    recording = signals.recording
    _check_sign(plan, moments, recording)
    raw = signals.logged["motor_torque"] if "motor_torque" in signals.logged else observation.torque
    return Visit(
        recording.name,
        recording.source if not isinstance(source, str | Path) else Path(source),
        moments,
        noise,
        torques,
        moments.n_samples,
        pace.independent(observation),
        recording.n_samples,
        float(recording.time[-1] - recording.time[0]),
        signals.rate,
        observation.band.cutoff,
        noise_floor(raw, signals.rate, observation.band.cutoff),
        observation.shapes,
        observation.notices,
        observation.left_out,
        observation.accelerations,
    )


def colour_recording(
    task: tuple[Task, Fit, tuple[int, ...], tuple[int, float], bool],
) -> Vector:
    """Visit a recording for the middle of the sandwich: the variance of the fit's equations, shape (p, p).

    The residual, whitened over motors, is fitted by an autoregression per component; the columns, whitened alike, are
    coloured by it.
    """
    (plan, source, kept), fit, columns, (total, independent), robust = task
    observation = _observed((plan, source, kept))
    torque = cleaned_torque(plan, observation, _spread(plan, columns, fit.values)) if robust else None
    white = fit.whitener
    parts: dict[int, list[Vector]] = {}
    for number, X, y in rows(plan, observation, torque):
        parts.setdefault(number, []).append((y - X[..., columns] @ fit.values) @ white.T)
    segments = [np.concatenate(parts[number]) for number in sorted(parts)]
    p, n = len(columns), sum(map(len, segments))
    if not p or n < 8:
        return np.zeros((p, p))
    colours, share = [], p / plan.model.n_motors
    for i in range(plan.model.n_motors):
        series = [u[:, i] for u in segments]
        coefficients, scale = estimators.autoregression(series, min(60, n // 8))
        covariance = estimators.autocovariance(series, min(60, n // 8))
        raised = estimators.lost_freedom(covariance, n, share * n / total, independent * n / total)
        colours.append(Colour(coefficients, scale * np.sqrt(raised), p))
    previous = None
    for number, X, _ in rows(plan, observation):
        mixed = np.einsum("ij,njp->nip", white, X[..., columns])
        for i, colour in enumerate(colours):
            if number != previous:
                colour.restart()
            colour.add(mixed[:, i])
        previous = number
    return np.sum([colour.total for colour in colours], axis=0)


def clean_recording(task: tuple[Task, Vector]) -> Moments:
    """Visit a recording for its moments with outlying torques pulled towards a fit."""
    (plan, source, kept), values = task
    observation = _observed((plan, source, kept))
    moments = Moments.empty(plan.names, plan.present)
    for _, X, y in rows(plan, observation, cleaned_torque(plan, observation, values)):
        moments = moments.add(X, y)
    return moments


class _Pace:
    """How fast the columns of the rigid body change: sums of squares of values and of steps."""

    def __init__(self, rank: int):
        self.values, self.steps = np.zeros(rank), np.zeros(rank)
        self.previous: tuple[int, Vector] | None = None

    def add(self, segment: int, X: Vector) -> None:
        """Fold in the next rows of a segment."""
        rigid = X[..., : len(self.values)]
        self.values += np.sum(rigid**2, axis=(0, 1))
        if self.previous is not None and self.previous[0] == segment:
            rigid = np.concatenate([self.previous[1], rigid])
        self.steps += np.sum(np.diff(rigid, axis=0) ** 2, axis=(0, 1))
        self.previous = segment, rigid[-1:]

    def independent(self, observation: Observation) -> float:
        """Twice the mean frequency times the time used, and one; 0 without rows."""
        if self.previous is None or not self.values.any():
            return 0.0
        seen = self.values > 0
        turns = np.sqrt(np.mean(self.steps[seen] / self.values[seen])) / (2 * np.pi)  # per decimated sample
        return float(2 * turns * observation.n_samples + 1)


def _spread(plan: Plan, columns: Sequence[int], values: Vector) -> Vector:
    """Coefficients of all columns of the plan, those not fitted zero."""
    full = np.zeros(len(plan.names))
    full[list(columns)] = values
    return full


def _observed(task: Task) -> Observation:
    plan, source, kept = task
    key = id(source) if isinstance(source, Recording) else str(source)
    if kept is not None and key in kept:
        return kept[key]
    recording = source if isinstance(source, Recording) else load_recording(source, plan.model)
    observation = observe(plan, recording)
    if kept is not None:
        kept[key] = observation
    return observation


def _check_sign(plan: Plan, moments: Moments, recording: Recording) -> None:
    """Refuse a torque that accelerates its own motor backwards, or that is the nominal one with its sign changed."""
    if not moments.n_samples:
        return
    X, y = moments.equations()
    p = plan.base.rank
    nominal = X[..., :p] @ plan.base.values(plan.model.standard_parameters)
    cosine = np.sum(nominal * y, axis=0) / np.maximum(
        np.linalg.norm(nominal, axis=0) * np.linalg.norm(y, axis=0), 1e-300
    )
    names = [name for name in moments.names if not name.startswith("rotor_inertia")]
    fits = estimators.per_joint(moments.select([moments.names.index(name) for name in names]))
    for i, fit in enumerate(fits):
        inertia = _own_inertia(plan, i)
        row = np.array([inertia[names.index(name)] if names.index(name) < p else 0.0 for name in fit.names])
        value = float(row @ fit.values)
        std = float(np.sqrt(max(row @ fit.white_covariance @ row, 0.0)))
        if cosine[i] < -0.9 or (cosine[i] < 0 and value < -12 * std and value < 0):
            side = "motor" if "motor_torque" in recording.channels else "joint"
            raise RecordingError(
                "is opposite to what the motion needs (negative inertia or gravity): is its sign wrong?",
                source=recording.source,
                place=f"column {side}_torque_{i + 1}",
            )


def _own_inertia(plan: Plan, motor: int) -> Vector:
    """Average of E' M E [i, i] over random postures, as weights of the base parameters, shape (p,)."""
    model = plan.model
    q, _, _ = random_states(model, 20)
    a = np.tile(model.joint_from_motor[:, motor], (len(q), 1))
    Y = motor_regressor(model, q, 0 * q, a) - motor_regressor(model, q, 0 * q, 0 * q)
    return Y[:, motor][:, plan.base.columns].mean(axis=0)
