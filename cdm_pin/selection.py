"""Fits and scores: columns of effects orthogonal to the rigid body, in whitened residuals."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from .base import BaseParameters, massive_columns
from .completed import effect_candidates
from .drift import LONG, LOUD, QUICKER, Drift, drift_columns, drifting_channels, slow_shapes, without_drift
from .dynamics import inverse_dynamics
from .effects import CATALOGUE, GIVES, RATIOS, Candidate, Columns, Identity
from .geometry import Vector
from .model import CableModel
from .motion import Motion
from .patches import PATCHES, TONE
from .problem import Problem, rounding_errors
from .spectra import Spectrum, spectrum, stands_out, tone_peaks, whitener_of
from .whitening import Lines, Segments, Whitener, fit_quiet, fit_whitener, log_likelihood, log_p, quiet_segments

SHORTEST = 1e-4  # [s] of delays
_LARGE = 2e9  # bytes of whitened banks that are kept


@dataclass(frozen=True)
class Settings:
    """How the search decides.

    Attributes
    ----------
    alarm : float
        Family-wise probability of naming anything on data where nothing is missing.
    visible : float
        Least share of an effect that the rigid body leaves over for it to be tested.
    law_error : float
        Relative accuracy of one law: rivals that differ by less are told apart by simplicity alone.
    torque_error : float
        Relative accuracy of the rigid body's torque, with clocks, derivatives and filters as they are.
    patch_error : float
        How many times the errors of the laws in the model a correction without a name has to be.
    patch_law_error : float
        Relative accuracy of a law beside corrections without a name.
    same : float
        Canonical correlation above which two effects are one class.
    close : float
        Difference of log-likelihood below which a rival stands beside an effect.
    order : int
        Of the autoregressive noise.
    most : int
        Effects at most, where there are not so many motors that two for each are more (`Search.most`).
    at_once : int
        Effects that are added before a correction without a name is weighed against them.
    """

    alarm: float = 2e-3
    visible: float = 0.004
    law_error: float = 0.006
    torque_error: float = 1.5e-4
    patch_error: float = 3.3
    patch_law_error: float = 0.05
    same: float = 0.95
    close: float = 3.0
    order: int = 24
    most: int = 6
    at_once: int = 2

    def within(self, statistic: float, error: float | None = None, least: float | None = None) -> float:
        """Say by how much log-likelihood a rival may be worse to stand beside an effect of this statistic."""
        error = self.law_error if error is None else error
        return max(self.close if least is None else least, 0.5 * error**2 * statistic)


UNSURE_MASS = 0.2
"""Share of themselves by which masses, first moments and inertias of the file may be wrong."""
PUNCTUAL = 0.05
"""Share of the time between two samples by which it is not sure what instant one stands for."""
MOST_TIMES = 20
"""How often what the file's parameters may be wrong by is doubled."""
COMPLIANT = ("cable_elasticity", "cable_slack")
"""Effects whose first coefficient is how much a cable gives per torque."""


@dataclass(frozen=True)
class Bank:
    """Columns of many candidates in the band.

    Attributes
    ----------
    candidates : tuple of Candidate
    slices : tuple of slice
        Where each one's columns are.
    lines : list of Lines
        One per run.
    weight : ndarray, shape (n_candidates,)
        Share of the alarm that each candidate may spend; sums to one.
    problem : Problem
        The recordings, about the model and the effects, that they were computed from.
    """

    candidates: tuple[Candidate, ...]
    slices: tuple[slice, ...]
    lines: list[Lines]
    weight: Vector
    problem: Problem

    @cached_property
    def laws(self) -> Bank:
        """The candidates that have a name."""
        return self._part([i for i, c in enumerate(self.candidates) if c.named])

    @cached_property
    def corrections(self) -> Bank:
        """The candidates without a name, which take more columns than the others."""
        return self._part([i for i, c in enumerate(self.candidates) if not c.named])

    def _part(self, own: Sequence[int]) -> Bank:
        slices = [self.slices[i] for i in own]
        first = np.cumsum([0, *[s.stop - s.start for s in slices]])
        return Bank(
            tuple(self.candidates[i] for i in own),
            tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(first)),
            [lines.part(slices) for lines in self.lines] if own else [],
            self.weight[list(own)],
            self.problem,
        )


@dataclass(frozen=True)
class Score:
    """What a candidate would add to a fit.

    Attributes
    ----------
    statistic : float
        Twice the gain of log-likelihood; -inf where the signs are not admissible.
    k : int
        Number of columns that are independent of the fit.
    beta : ndarray
        Coefficients.
    visible : float
        Share of the columns that the fit leaves over.
    norm : float
        Norm of the (first) whitened column that is left over, per unit coefficient.
    """

    statistic: float
    k: int
    beta: Vector
    visible: float
    norm: float


@dataclass(frozen=True)
class Body:
    """The rigid body in whitened data.

    Attributes
    ----------
    Q : ndarray, shape (n_rows, rank)
        Orthonormal basis of its columns.
    inverse : ndarray, shape (n_parameters, rank)
        Base parameters per coordinate in that basis.
    data, residual : ndarray, shape (n_rows,)
        What is measured, and what is left of it.
    """

    Q: Vector
    inverse: Vector
    data: Vector
    residual: Vector


@dataclass(frozen=True)
class Fit:
    """Rigid body and effects fitted to whitened data.

    Attributes
    ----------
    problem : Problem
    whitener : Whitener
    effects : tuple of Candidate
    body : Body
    Q : ndarray, shape (n_rows, rank)
        Orthonormal basis of the effects' columns as far as the rigid body leaves them over.
    residual : ndarray, shape (n_rows,)
        Whitened.
    base : ndarray
        Base parameters, differences from the model's.
    beta : tuple of ndarray
        Coefficients of each effect.
    covariance : ndarray
        Of base parameters and all coefficients, in that order.
    """

    problem: Problem
    whitener: Whitener
    effects: tuple[Candidate, ...]
    body: Body
    Q: Vector
    residual: Vector
    base: Vector
    beta: tuple[Vector, ...]
    covariance: Vector

    @property
    def n_rows(self) -> int:
        """Whitened samples of all channels."""
        return len(self.residual)

    @property
    def deviance(self) -> float:
        """Residual sum of squares in whitened units."""
        return float(self.residual @ self.residual)

    def rest(self, W: Vector) -> Vector:
        """Take from whitened columns what the fit spans, shape (n_columns, n_rows)."""
        W = W - (W @ self.body.Q) @ self.body.Q.T
        return W - (W @ self.Q) @ self.Q.T


@dataclass(frozen=True)
class WhiteBank:
    """A bank in one noise: whitened columns, their inner products, and these beside the rigid body.

    Attributes
    ----------
    W : ndarray, shape (n_columns, n_rows)
    full, left : ndarray, shape (n_columns,)
    wide : list of (ndarray of int, shape (n,), ndarray of int, shape (n, k), ndarray, shape (n, k, k))
        Candidates with k columns, two or more; their columns; the inner products of these.
    """

    W: Vector
    full: Vector
    left: Vector
    wide: list[tuple[np.ndarray, np.ndarray, Vector]]


class Search:
    """Fits and scores on one problem; keeps what was computed between steps.

    Parameters
    ----------
    problem : Problem
    base : BaseParameters
    settings : Settings
    held : bool, optional
        Whether the stated payloads have columns of their own; if not given, where they differ.
    drift : Drift, optional
        What the zeros of sensors do; its columns stand behind those of the rigid body.
    """

    def __init__(
        self,
        problem: Problem,
        base: BaseParameters,
        settings: Settings,
        held: bool | None = None,
        drift: Drift | None = None,
    ):
        self.problem, self.base, self.settings = problem, base, settings
        self.drift = drift
        self.held = len({run.payload for run in problem.runs}) > 1 if held is None else held
        self._cache: dict[Identity, list[Vector]] = {}
        self._clear: dict[Any, Whitener] = {}
        self._noise: dict[Any, Whitener] = {}
        self._bodies: Recent = Recent(4)
        self._fits: Recent = Recent(24)
        self._banks: Recent = Recent(4)
        self._scores: Recent = Recent(8)
        self._sizes: Recent = Recent(8)
        self._rests: Recent = Recent(8)
        self._offsets: Recent = Recent(8)
        self._drifts: Recent = Recent(8)
        self._lags: Recent = Recent(8)
        self._instants: Recent = Recent(8)
        self._sides: Recent = Recent(8)
        self._stretched: Recent = Recent(8)

    @property
    def most(self) -> int:
        """Effects at most: each motor's axis may rub in two ways."""
        return max(self.settings.most, 2 * self.problem.model.n_motors)

    def about(self, fit: Fit) -> Search:
        """Give the same search about a fit: its inertial parameters, and the torques that its effects bring."""
        effects = list(zip(fit.effects, fit.beta, strict=True))
        change = fit.base[: len(self.base.columns)]
        return self.at(change, effects, self.revealed(fit), self._likely_masses(fit))

    def _likely_masses(self, fit: Fit) -> CableModel:
        """Give the model with the masses that a fit makes likely, for what no torque of a motor tells of them.

        Each standard parameter may be wrong by about all of itself, or by as many times that as the change is beyond
        it: what the data do not tell stays as the file has it.
        """
        file, p = self.problem.sensors.model, len(self.base.columns)
        heavy = massive_columns(file)
        known = self.base.values(self.problem.model.standard_parameters) - self.base.values(file.standard_parameters)
        own = self.base.matrix[:, heavy] * _sizes(file)[heavy]
        before, errors = own @ own.T, fit.covariance[:p, :p]
        size = np.sqrt(np.diag(before) + np.diag(errors))
        if not before.any() or not size.all():
            return file
        change = (known + fit.base[:p]) / size
        before, errors = before / size / size[:, None], errors / size / size[:, None]
        for _ in range(MOST_TIMES):
            told = np.linalg.lstsq(before + errors, change, rcond=1e-12)[0]
            if change @ told <= p:
                break
            before = 4.0 * before
        return updated_model(file, self.base, size * (before @ told), _sizes(file))

    def at(
        self,
        change: Vector,
        effects: Sequence[tuple[Candidate, Vector]],
        model: CableModel | None = None,
        bearings: CableModel | None = None,
    ) -> Search:
        """Give the same search with the base parameters changed, and effects with coefficients in the motions.

        A `model` says all of its parameters by itself; `bearings` has the masses that load the hinges.
        """
        effects = [(c, c.admissible(beta)) for c, beta in effects]
        if model is None:
            model = updated_model(self.problem.model, self.base, change)
        else:
            change = self.base.matrix @ (model.standard_parameters - self.problem.model.standard_parameters)
        problem = self.problem.with_model(model, bearings or self.problem.bearings).with_loads(effects)
        search = Search(problem, self.base, self.settings, self.held, self.drift)
        for name in ("common", "plain", "loads", "smooth", "unshared"):
            if name in self.__dict__:
                search.__dict__[name] = self.__dict__[name]
        if problem.swings or self.problem.swings:
            return search
        if "rigid" in self.__dict__:
            search.__dict__["rigid"] = self.rigid
        search.__dict__["nominal"] = [
            nominal - np.tensordot(change, rigid[: len(change)], 1)
            for nominal, rigid in zip(self.nominal, self.rigid, strict=True)
        ]
        if not (problem.shifted or self.problem.shifted):
            search._cache = {key: value for key, value in self._cache.items() if not key.hangs_on_torques}
        return search

    @property
    def swung(self) -> list[tuple[Candidate, Vector]]:
        """Effects with coefficients about which the links swing; none where all cables are rigid."""
        return list(self.problem.loads) if self.problem.swings else []

    @cached_property
    def stiff(self) -> Search:
        """The same search as if no cable were soft; itself where none is."""
        return self.at(np.zeros(len(self.base.columns)), []) if self.problem.swings else self

    def renewed(self, bank: Bank) -> Bank:
        """Compute those columns of a bank anew that depend on the torques of the body and of other effects."""
        if self.problem.posture != bank.problem.posture:
            return self.bank(bank.candidates)
        if self.problem.is_loaded_like(bank.problem):
            return bank
        follows = [i for i, c in enumerate(bank.candidates) if c.hangs_on_torques]
        new = self.bank([bank.candidates[i] for i in follows])
        target = np.concatenate([np.arange(bank.slices[i].start, bank.slices[i].stop) for i in follows] or [[]])
        lines = []
        for old, fresh in zip(bank.lines, new.lines, strict=True):
            keep = ~np.isin(old.owner, target)
            lines.append(
                Lines(
                    np.concatenate([old.series[keep], fresh.series]),
                    np.concatenate([old.weights[keep], fresh.weights]),
                    np.concatenate([old.owner[keep], target.astype(int)[fresh.owner]]),
                    old.n_columns,
                )
            )
        return replace(bank, lines=lines, problem=self.problem)

    @cached_property
    def nominal(self) -> list[Vector]:
        """Data less the torque of the nominal model."""
        problem, pi = self.problem, self.problem.model.standard_parameters
        parts = zip(problem.data, problem.rigid, problem.rotors, problem.payloads, strict=True)
        if problem.swings:
            return [d[0] - known - r[0] for known, (d, _, r, _) in zip(problem.known, parts, strict=True)]
        return [d[0] - np.tensordot(pi + payload, Y, 1) - r[0] for d, Y, r, payload in parts]

    @cached_property
    def rigid(self) -> list[Vector]:
        """Base columns of the regressor, per run, then those of the last link's payload, then those of drifts."""
        parts = [[Y[self.base.columns] for Y in self.problem.rigid]]
        if self.held:
            parts.append([run.payload * Y[-10:] for run, Y in zip(self.problem.runs, self.problem.rigid, strict=True)])
        if self.drift is not None:
            parts.append(self.drift.columns)
        return [np.concatenate(own) for own in zip(*parts, strict=True)]

    @property
    def n_rigid(self) -> int:
        """Number of columns of the rigid body, its payload and drifts."""
        return len(self.rigid[0])

    @property
    def n_bodies(self) -> int:
        """Number of columns of the rigid body and its payload."""
        return self.n_rigid - (len(self.drift.columns[0]) if self.drift else 0)

    def with_drift(self, effects: Sequence[Candidate] = (), most: int = QUICKER) -> Search:
        """Give the same search with the slow shapes of sensors' zeros beside the rigid body, where the data show them.

        Judged in what effects and smooth functions of the state leave over, by the frequencies next to theirs; at most
        so many waves are quicker than usual.
        """
        problem, rate = self.problem, self.problem.band.reduced_rate
        if not problem.torque or not any(problem.segments):
            return self
        rest, basis = self._rest(effects, self.smooth)
        seen = rest, basis, problem.segments, rate, problem.model.n_motors
        channels = drifting_channels(*seen)
        if not channels:
            return self
        quicker = 0
        while quicker < most and set(channels) & set(drifting_channels(*seen, quicker + 1)):
            quicker += 1
        drift = Drift(self._waves(channels, LONG, quicker), tuple(channels), quicker)
        search = Search(problem, self.base, self.settings, self.held, drift)
        search._cache = self._cache
        for name in ("common", "plain", "loads", "smooth", "unshared", "nominal"):
            if name in self.__dict__:
                search.__dict__[name] = self.__dict__[name]
        return search

    def drifts_like(self, other: Search) -> bool:
        """Whether the zeros of the same motors drift as quickly in another search, or none in either."""
        own, theirs = ((d.channels, d.quicker) if d is not None else None for d in (self.drift, other.drift))
        return own == theirs

    def is_swamped(self, fit: Fit) -> bool:
        """Whether the drift in a fit is so much larger than what is left that it is no drift of a sensor.

        The drift is that beside laws alone: corrections without a name wander themselves.
        """
        if self.drift is None:
            return False
        own = self.fit([c for c in fit.effects if c.named], fit.whitener).base[self.n_bodies : self.n_rigid]
        drift = [np.tensordot(own, columns, 1) for columns in self.drift.columns]
        rest = still_errors(self, fit)
        return bool(np.any(rms(self, drift) > LOUD * rms(self, rest)))

    def judge(self, problem: Problem) -> Search:
        """Give a search on recordings that this one has not seen, with the same columns; their zeros are not known."""
        judge = Search(problem, self.base, self.settings, self.held)
        if self.drift is not None:
            shape = len(self.drift.columns[0]), problem.n_channels
            none = [np.zeros((*shape, data.shape[2])) for data in problem.data]
            judge.drift = replace(self.drift, columns=none)
        return judge

    def columns(self, candidate: Candidate) -> list[Vector]:
        """Columns of a candidate in the band, per run; kept for the next time."""
        key = candidate.identity
        if key not in self._cache:
            self._cache[key] = [lines.dense() for lines in self.problem.reduce(candidate.columns)]
        return self._cache[key]

    def is_crossed(self, play: Candidate) -> bool:
        """Whether the play of a cable is crossed on any recording, as far as motors alone tell."""
        return any(motion.changes_sides(play.place.index[0]) for motion in self.problem.motions)

    def size(self, *candidates: Candidate) -> int:
        """Count the parameters of candidates: coefficients and what of their shapes is estimated."""
        return sum(len(self.columns(c)[0]) + c.extra for c in candidates)

    def slopes(self, candidate: Candidate, beta: Vector) -> list[list[Vector]]:
        """Differentiate X(shape) beta by each free element of the shape: one list of runs per element, in the band."""
        slopes = []
        free = len(candidate.bounds(self.problem.motions))
        for i, value in enumerate(candidate.shape[:free]):
            h = 1e-3 * abs(value) or 1e-3
            sides = []
            for step in (h, -h):
                shape = (*candidate.shape[:i], value + step, *candidate.shape[i + 1 :])
                columns = self.problem.reduce(replace(candidate, shape=shape).columns)
                sides.append([np.tensordot(beta, c.dense(), 1) for c in columns])
            slopes.append([(a - b)[None] / (2 * h) for a, b in zip(*sides, strict=True)])
        return slopes

    def tuned(self, effects: Sequence[Candidate], whitener: Whitener, rounds: int = 3) -> list[Candidate]:
        """Estimate the shapes of all effects together (Gauss-Newton on what the coefficients leave over)."""
        effects = list(effects)
        for _ in range(rounds):
            fit = self.fit(effects, whitener)
            centred = [c.centred(beta) for c, beta in zip(effects, fit.beta, strict=True)]
            if centred != effects:
                effects = centred
                fit = self.fit(effects, whitener)
            W = self._white_slopes(fit)
            if not len(W):
                break
            size, W = np.linalg.norm(W, axis=1), fit.rest(W)
            own = np.linalg.norm(W, axis=1)
            scale = np.where(own > 1e-3 * size, own, np.inf)
            step = np.linalg.lstsq((W / scale[:, None]).T, fit.residual, rcond=1e-3)[0] / scale
            for share in (1.0, 0.3):
                trial = self._moved(effects, share * step)
                better = self.fit(trial, whitener)
                if better.deviance < fit.deviance:
                    break
            else:
                break
            effects = trial
            if fit.deviance - better.deviance < 0.1:
                break
        return effects

    def yielding(self, effects: Sequence[Candidate], whitener: Whitener, least: float = 6.0) -> list[Candidate]:
        """Take of distances within which dry friction gives before it slides those that suit the data, one by one."""
        effects = list(effects)
        best = self.fit(effects, whitener).deviance if any(c.gives for c in effects) else 0.0
        for j, candidate in enumerate(effects):
            for factor in (0.25, 4.0):
                trial = effects
                while candidate.gives and GIVES[0] <= factor * trial[j].gives <= GIVES[1]:
                    trial = [*trial[:j], replace(trial[j], gives=factor * trial[j].gives), *trial[j + 1 :]]
                    own = self.fit(trial, whitener).deviance
                    if own > best - least:
                        break
                    best, effects = own, trial
        return effects

    def _white_slopes(self, fit: Fit) -> Vector:
        """Differentiate a fit by the free elements of its effects' shapes, whitened, shape (n_elements, n_rows)."""
        slopes = [self.slopes(c, b) for c, b in zip(fit.effects, fit.beta, strict=True)]
        flat = [s for own in slopes for s in own]
        if not flat:
            return np.zeros((0, fit.n_rows))
        banks = [np.concatenate([s[r] for s in flat]) for r in range(len(self.rigid))]
        return self.white(fit.whitener, banks)

    def loosened(self, fit: Fit) -> Fit:
        """Give a fit in which the shapes of its effects give way, to first order, to what is scored beside it.

        Estimated without that, they may have taken much of it up.
        """
        W = self._white_slopes(fit)
        basis = _least_squares(fit.rest(W), fit.residual, np.linalg.norm(W, axis=1))[1]
        residual = fit.residual - basis @ (basis.T @ fit.residual)
        return replace(fit, Q=np.concatenate([fit.Q, basis], axis=1), residual=residual)

    def _moved(self, effects: Sequence[Candidate], step: Vector) -> list[Candidate]:
        """Move the free elements of all shapes, no further than their bounds and their reach."""
        out, first = [], 0
        for candidate in effects:
            shape = list(candidate.shape)
            for i, (low, high) in enumerate(candidate.bounds(self.problem.motions)[: len(shape)]):
                reach = candidate.effect.reach * (abs(shape[i]) if low > 0 else high - low)
                moved = shape[i] + float(np.clip(step[first], -reach, reach))
                shape[i] = min(max(moved, min(low, shape[i])), max(high, shape[i]))
                first += 1
            out.append(replace(candidate, shape=tuple(shape)))
        return out

    def white(self, whitener: Whitener, banks: Sequence[Vector], segments: Sequence[Segments] | None = None) -> Vector:
        """Whiten columns of all runs, shape (n_columns, n_rows)."""
        segments = self.problem.segments if segments is None else segments
        parts = [whitener(bank, run, r) for r, (bank, run) in enumerate(zip(banks, segments, strict=True))]
        return np.concatenate(parts, axis=1)

    @cached_property
    def sensed(self) -> Whitener:
        """White noise as large as what the sensors bring by themselves."""
        return Whitener.white(self.problem.sensed, len(self.problem.runs))

    @cached_property
    def common(self) -> tuple[Candidate, ...]:
        """Effects that most machines have, there to keep what is not yet explained out of the noise."""
        names = ("viscous_friction", "coulomb_friction", "torque_offset", "joint_spring")
        candidates = [
            c for c in all_candidates(self.problem, names) if c.effect.name != "joint_spring" or not c.shape[0]
        ]
        return tuple(candidates)

    @cached_property
    def loads(self) -> Vector:
        """Root mean square of the data, per channel."""
        return rms(self, [x[0] for x in self.problem.data])

    @cached_property
    def plain(self) -> Whitener:
        """Scale the channels only."""
        channels = range(self.problem.n_channels)
        level = np.array([_level(self.nominal, self.problem.segments, c) for c in channels])
        return Whitener.white(level, len(self.problem.runs))

    def noise(self, effects: Sequence[Candidate], rounds: int = 3) -> Whitener:
        """Estimate the noise as what rigid body and effects leave over."""
        key = _key(effects)
        if key not in self._noise:
            own = [self.columns(c) for c in effects]
            banks = [
                np.concatenate([self.rigid[r], states, *[columns[r] for columns in own], self.nominal[r][None]])
                for r, states in enumerate(self.problem.states)
            ]
            whitener, quiet, blocks = self.plain, self.problem.segments, self.problem.blocks
            for _ in range(rounds):
                W = self.white(whitener, banks, quiet)
                theta = _least_squares(W[:-1], W[-1])[0]
                residuals = [bank[-1] - np.tensordot(theta, bank[:-1], 1) for bank in banks]
                whitener, quiet = fit_quiet(residuals, self.problem.segments, self.settings.order, blocks)
            self._noise[key] = whitener
        return self._noise[key]

    def even(self, effects: Sequence[Candidate]) -> Whitener:
        """White noise as large as what rigid body and effects leave over."""
        level = np.maximum(rms(self, self._errors(effects, self.plain)), 1e-12)
        return Whitener.white(level, len(self.problem.runs))

    def likelihood_ratio(
        self, effects: Sequence[Candidate], candidate: Candidate, least: float = 0.0
    ) -> tuple[Whitener, float]:
        """Set a model with a candidate against the model without it, each in the noise that suits it best.

        A slow effect looks like slow noise as long as it is not in the model; what tells them apart is that noise
        would do the same all the time.

        Parameters
        ----------
        effects : sequence of Candidate
            In either model.
        candidate : Candidate
        least : float
            A ratio below this need not be exact.

        Returns
        -------
        whitener : Whitener
            The noise where the candidate is in the model.
        ratio : float
            Twice the log-likelihood gained.
        """
        whole, shared = [*effects, candidate], self.noise(effects)
        residuals = self._errors(whole, shared)
        quiet = quiet_segments(residuals, self.problem.segments)

        def noise(residuals: Sequence[Vector]) -> tuple[Whitener, float]:
            whitener = fit_whitener(residuals, quiet, self.settings.order, self.problem.blocks)
            return whitener, log_likelihood(whitener, quiet)

        own, with_it = noise(residuals)
        without = noise(self._errors(effects, shared))[1]
        fitted = noise(self._errors(whole, self.noise(whole)))  # in slow noise, a slow effect may not have been
        if fitted[1] > with_it:
            own, with_it = fitted
        if 2.0 * (with_it - without) > least - 5.0:
            own, with_it = noise(self._errors(whole, own))
            without = max(without, noise(self._errors(effects, own))[1])
        return own, 2.0 * (with_it - without)

    def _errors(self, effects: Sequence[Candidate], whitener: Whitener) -> list[Vector]:
        """Take rigid body and effects, fitted in a given noise, from the data."""
        fit = self.fit(effects, whitener)
        return errors(self, fit.base, fit.effects, fit.beta)

    def body(self, whitener: Whitener) -> Body:
        """Whiten data and rigid body."""
        known = self._bodies.get(whitener)
        if known is not None:
            return known
        parts = zip(self.rigid, self.problem.states, self.nominal, strict=True)
        W = self.white(whitener, [np.concatenate([rigid, states, nominal[None]]) for rigid, states, nominal in parts])
        _, Q, inverse = _least_squares(W[:-1], W[-1])
        residual = W[-1] - Q @ (Q.T @ W[-1])
        return self._bodies.keep(Body(Q, inverse[: self.n_rigid], W[-1], residual), whitener)

    def fit(self, effects: Sequence[Candidate], whitener: Whitener | None = None) -> Fit:
        """Fit rigid body and effects; estimate the noise anew unless a whitener is given."""
        if whitener is None:
            whitener = self.noise(effects)
        order = tuple(c.identity for c in effects)
        known = self._fits.get(whitener, order)
        return known if known is not None else self._fits.keep(self._fit(effects, whitener), whitener, order)

    def without(self, fit: Fit, *left_out: int) -> Fit:
        """Fit again, in the same noise, without the effects of these numbers."""
        return self.fit([c for i, c in enumerate(fit.effects) if i not in left_out], fit.whitener)

    def _fit(self, effects: Sequence[Candidate], whitener: Whitener) -> Fit:
        body = self.body(whitener)
        own = [self.white(whitener, self.columns(c)) for c in effects]
        X = np.concatenate([np.zeros((0, len(body.data))), *own])
        inside = X @ body.Q
        free, size = X - inside @ body.Q.T, np.linalg.norm(X, axis=1)
        signs = np.array([s for c, x in zip(effects, own, strict=True) for s in _minor_signs(c, len(x))])
        if len(free) > 40:
            free[_at_bound(free, body.residual, size, signs)] = 0.0
        theta, Q, inverse = _least_squares(free, body.residual, size)
        while len(signs) and np.any((signs > 0) & (theta < 0)):  # held at their bound, zero
            free[np.argmin(np.where(signs > 0, theta * size, np.inf))] = 0.0
            theta, Q, inverse = _least_squares(free, body.residual, size)
        carried = -body.inverse @ inside.T  # base parameters per coefficient
        base = body.inverse @ (body.Q.T @ body.data) + carried @ theta
        p, k = len(base), len(theta)
        covariance = np.zeros((p + k, p + k))
        covariance[p:, p:] = inverse @ inverse.T
        covariance[:p, p:] = carried @ covariance[p:, p:]
        covariance[p:, :p] = covariance[:p, p:].T
        covariance[:p, :p] = body.inverse @ body.inverse.T + covariance[:p, p:] @ carried.T
        sizes = np.cumsum([0, *[len(x) for x in own]])
        beta = tuple(theta[a:b] for a, b in itertools.pairwise(sizes))
        residual = body.residual - Q @ (Q.T @ body.residual)
        return Fit(self.problem, whitener, tuple(effects), body, Q, residual, base, beta, covariance)

    @cached_property
    def smooth(self) -> list[Vector]:
        """Columns of common effects and of smooth functions of position, speed and direction, per run."""
        names = ("unnamed_position", "unnamed_rub", "unnamed_velocity")
        if self.problem.kinematic:
            names += (
                "cable_elasticity",
                "backlash",
                "transmission_ratio_error",
                "pulley_eccentricity",
                "encoder_offset",
            )
        candidates = [*self.common, *all_candidates(self.problem, names), *tones(self, [c for c, _ in self.swung])]
        parts = [self.columns(c) for c in candidates]
        own = self.unshared
        return [np.concatenate([own[r], *[columns[r] for columns in parts]]) for r in range(len(self.rigid))]

    @cached_property
    def drifts(self) -> list[Vector]:
        """Columns of what the zeros of torques do on recordings that are judged: for every motor and run alone.

        Something of a constant stays visible beside them, unless they were seen to drift; those of encoders do not.
        """
        channels = range(self.problem.model.n_motors * self.problem.torque)
        return self._waves(channels, 1.0) if self.drift is None else self._waves(channels, LONG, self.drift.quicker)

    def _waves(self, channels: Sequence[int], stretch: float, quicker: int = 0) -> list[Vector]:
        """Give slow shapes of their own to some channels of every run (`drift_columns`)."""
        lengths = [data.shape[2] for data in self.problem.data]
        rate, n = self.problem.band.reduced_rate, self.problem.n_channels
        return drift_columns(lengths, rate, n, channels, stretch, quicker)

    def still(self, errors: Sequence[Vector]) -> list[Vector]:
        """Take slow shapes out of torque errors where zeros were seen to drift, per run (n_channels, n_reduced)."""
        if self.drift is None:
            return list(errors)
        rate, m = self.problem.band.reduced_rate, self.problem.model.n_motors
        out = []
        for e, run in zip(errors, self.problem.segments, strict=True):
            shapes = slow_shapes(e.shape[1], rate, LONG, self.drift.quicker)
            out.append(np.concatenate([without_drift(e[:m], run, shapes), e[m:]]))
        return out

    @cached_property
    def unshared(self) -> list[Vector]:
        """Columns of the rigid body with parameters of their own for every motor, and their rates of change, per run.

        Wrong gains, ratios, angles and delays part the motors' parameters from each other.
        """
        m = self.problem.model.n_motors
        if not self.problem.torque:
            return [np.zeros((0, *rigid.shape[1:])) for rigid in self.rigid]
        out = []
        bodies = [rigid[: self.n_bodies] for rigid in self.rigid]
        there = np.any([rigid.any(axis=2) for rigid in bodies], axis=0)
        for rigid in bodies:
            parts = []
            for i in range(m):
                own = np.zeros_like(rigid[there[:, i]])
                own[:, i] = rigid[there[:, i], i]
                parts += [own, np.gradient(own, axis=2)] if m < 5 else [own]
            out.append(np.concatenate(parts))
        return out

    def left_over(self, effects: Sequence[Candidate], smooth: bool = True) -> tuple[list[Vector], Spectrum]:
        """Take a plain fit of rigid body and effects, with the smooth columns or without, from the data.

        Returns
        -------
        residuals : list of ndarray, shape (n_channels, n_reduced)
            One per run.
        noise : Spectrum
            Of what is left, free of what the columns took with them.
        """
        known = self._rests.get(_key(effects), smooth)
        if known is not None:
            return known
        return self._rests.keep(self._left_over(effects, self.smooth if smooth else None), _key(effects), smooth)

    def loosely_left_over(self, fit: Fit) -> Vector:
        """Give the rms of what a plain fit leaves over if the shapes of its effects give way, too, to first order."""
        slopes = [slope for c, b in zip(fit.effects, fit.beta, strict=True) for slope in self.slopes(c, b)]
        if not slopes:
            return self.left_over(fit.effects, smooth=False)[1].rms
        return self._left_over(fit.effects, [np.concatenate(own) for own in zip(*slopes, strict=True)])[1].rms

    def _left_over(
        self, effects: Sequence[Candidate], further: Sequence[Vector] | None
    ) -> tuple[list[Vector], Spectrum]:
        residuals, basis = self._rest(effects, further)
        return residuals, spectrum(residuals, basis, quiet_segments(residuals, self.problem.segments))

    def _rest(
        self, effects: Sequence[Candidate], further: Sequence[Vector] | None
    ) -> tuple[list[Vector], list[Vector]]:
        """Give what a plain fit leaves over, and an orthonormal basis of its columns, per run."""
        own = [self.columns(c) for c in effects]
        banks = []
        for r, states in enumerate(self.problem.states):
            parts = [self.rigid[r], states, *[columns[r] for columns in own]]
            if further is not None:
                parts.append(further[r])
            banks.append(np.concatenate([*parts, self.nominal[r][None]]))
        ends = [bank.shape[2] for bank in banks]
        for r, run in enumerate(self.problem.segments):  # there are many columns: no more copies than one at a time
            banks[r] = inside_of(banks[r], run)
        shapes = [bank.shape[1:] for bank in banks]
        W = np.concatenate([b.reshape(len(b), -1) for b in banks], axis=1)
        level = np.concatenate([np.repeat(1 / np.diag(self.plain.mix), n) for _, n in shapes])
        del banks
        W /= level
        b, scale = W[-1].copy(), np.linalg.norm(W[:-1], axis=1)
        A = W[:-1][scale > 0]
        del W
        A /= scale[scale > 0, None]
        values, vectors = np.linalg.eigh(A @ A.T)
        keep = values > 1e-9 * np.max(values, initial=0.0)
        Q = (vectors[:, keep] / np.sqrt(values[keep])).T @ A
        del A
        rest = (b - Q.T @ (Q @ b)) * level
        residuals, basis, first = [], [], 0
        for shape, run, n in zip(shapes, self.problem.segments, ends, strict=True):
            size = shape[0] * shape[1]
            residuals.append(_outside(rest[None, first : first + size].reshape(1, *shape), run, n)[0])
            basis.append(_outside(Q[:, first : first + size].reshape(len(Q), *shape), run, n))
            first += size
        return residuals, basis

    def follows_state(self, fit: Fit, alarm: float = 1e-6) -> bool:
        """Whether smooth functions of the state explain more of what a fit leaves over than slow noise would."""
        W = self.white(fit.whitener, self.smooth)
        size = np.linalg.norm(W, axis=1)
        free = fit.rest(W[size > 0] / size[size > 0, None])
        values, vectors = np.linalg.eigh(free @ free.T)
        keep = values > 1e-6
        drop = float(np.sum((vectors[:, keep].T @ (free @ fit.residual)) ** 2 / values[keep]))
        return log_p(drop, int(keep.sum())) < np.log(alarm)

    def clear(self, effects: Sequence[Candidate]) -> Whitener:
        """Estimate the noise with smooth functions of the state taken out beside `effects`, if these leave any over."""
        key = _key(effects)
        if key not in self._clear:
            rest, noise = self.left_over(effects)
            rough = self.left_over(effects, smooth=False)[1]
            if stands_out(rough, noise):
                quiet = quiet_segments(rest, self.problem.segments)
                self._clear[key] = whitener_of(noise, rest, quiet, self.settings.order, self.problem.blocks)
            else:
                self._clear[key] = self.noise(effects)
        return self._clear[key]

    def errors_of_laws(self, fit: Fit) -> Vector:
        """Add up the magnitudes of the errors that the laws in a fit may have, whitened.

        Those that the model states already count as one, the root of the sum of their squares.

        Returns
        -------
        ndarray, shape (n_rows,)
        """
        known = self._sizes.get(fit)
        if known is None:
            known = np.zeros(fit.n_rows)
            for candidate, beta in zip(fit.effects, fit.beta, strict=True):
                known = known + self._error_of(candidate, beta, fit)
            stated = [self._error_of(c, beta, fit) ** 2 for c, beta in effect_candidates(self.problem.model)]
            known = self._sizes.keep(known + np.sqrt(np.sum(stated, axis=0)), fit)
        return known

    def _error_of(self, candidate: Candidate, beta: Vector, fit: Fit) -> Vector:
        parts = [np.tensordot(beta, columns[: len(beta)], 1)[None] for columns in self.columns(candidate)]
        if candidate.effect.exact_travel and self.problem.torque:
            for part in parts:
                part[:, self.problem.model.n_motors :] = 0.0
        known = candidate.law_error(self.problem.motions[0]) * np.abs(self.white(fit.whitener, parts)[0])
        if candidate.has_doubts:
            doubts = self.problem.reduce(lambda motion: candidate.doubts(motion, beta))
            known = known + np.abs(self.white(fit.whitener, [d.dense() for d in doubts])).sum(axis=0)
        if candidate.effect.leaves_open is not None:
            further = self.problem.reduce(lambda motion: candidate.left_open(motion, beta))
            known = known + np.abs(self.white(fit.whitener, [x.dense() for x in further])).sum(axis=0)
        if candidate.effect.reveals is not None:
            _, beside, A, _ = self._hidden(fit)
            open_still = np.linalg.solve(np.linalg.cholesky(A @ A.T + np.eye(len(A))), beside)
            known = known + np.linalg.norm(open_still, axis=0)
        return known

    def revealed(self, fit: Fit) -> CableModel | None:
        """Give the model as a fit's effects reveal it, also in what hides without them; None where none does.

        Its parameters are as near the file's as the data let them be, in units of how far those may be wrong. Without
        masses in the file nothing is known of that.
        """
        model, file = self.problem.model, self.problem.sensors.model.standard_parameters
        if not file.any() or not self.problem.torque or all(c.effect.reveals is None for c in fit.effects):
            return None
        before, _, A, Q = self._hidden(fit)
        change = (model.standard_parameters - file) / np.where(before > 0, before, np.inf)
        y = fit.body.data - Q @ (Q.T @ fit.body.data) + A.T @ change
        return model.with_standard_parameters(file + before * np.linalg.solve(A @ A.T + np.eye(len(A)), A @ y))

    def _hidden(self, fit: Fit) -> tuple[Vector, Vector, Vector, Vector]:
        """Give how far each standard parameter may be from the file's, and what torque that brings, whitened.

        Masses may be wrong by a share of themselves, first moments and inertias along any axis by that share of their
        norm.

        Returns
        -------
        before : ndarray, shape (10 n_joints,)
        beside : ndarray, shape (10 n_joints, n_rows)
            Torque that it brings beside the effects of the fit only.
        A : ndarray, shape (10 n_joints, n_rows)
            All of its torque, as far as the other columns leave it.
        Q : ndarray, shape (n_rows, rank)
            Orthonormal basis of the other columns.
        """
        values, p = self.problem.sensors.model.standard_parameters.reshape(-1, 10), len(self.base.columns)
        parts = [np.linalg.norm(values[:, a:b], axis=1) for a, b in ((0, 1), (1, 4), (4, 10))]
        before = UNSURE_MASS * np.repeat(np.stack(parts, axis=1), (1, 3, 6), axis=1).ravel()
        banks = [np.zeros((len(before), *rigid.shape[1:])) for rigid in self.rigid]
        for candidate, beta in zip(fit.effects, fit.beta, strict=True):
            if candidate.effect.reveals is not None:
                columns = self.problem.reduce(
                    lambda motion, c=candidate, b=beta: c.revealed(motion, np.diag(before), b)
                )
                banks = [bank + x.dense() for bank, x in zip(banks, columns, strict=True)]
        beside, W = self.white(fit.whitener, banks), self.white(fit.whitener, self.rigid)
        others = np.concatenate([W[p:], *[self.white(fit.whitener, self.columns(c)) for c in fit.effects]])
        Q = _least_squares(others, fit.body.data)[1]
        A = beside + before[:, None] * (self.base.matrix.T @ W[:p])
        return before, beside, A - (A @ Q) @ Q.T, Q

    def offsets(self, fit: Fit) -> Vector:
        """Give what constant errors of the encoders may bring, whitened, as far as a fit leaves it.

        Each is as large as half a step of the encoder, at the joint. Where both sides have encoders, these may be off
        alike, as where both round down, which is in the torques alone; the travel between them counts for as much
        already (`Run.without_mean`).

        Returns
        -------
        ndarray, shape (n, n_rows)
        """
        known = self._offsets.get(fit)
        if known is None:
            steps, m = self.problem.sensors.joint_steps, self.problem.model.n_motors * self.problem.torque
            held = {c.location["index"] for c in fit.effects if c.effect.name == "encoder_offset"}
            places = [c for c in all_candidates(self.problem, ("encoder_offset",)) if c.location["index"] not in held]
            rows = [np.zeros((0, fit.n_rows))]
            for c in places:
                torque = [x * (np.arange(x.shape[1]) < m)[:, None] for x in self.columns(c)]
                rows.append(0.5 * steps[c.place.index[0]] * self.white(fit.whitener, torque))
            known = self._offsets.keep(fit.rest(np.concatenate(rows)), fit)
        return known

    def lags(self, fit: Fit) -> Vector:
        """Give what encoders on both sides bring that lag behind where they turn, whitened, as far as a fit leaves it.

        Each by half a step, after the sign of its own velocity: what turns a magnet or slips on a shaft may do so.

        Returns
        -------
        ndarray, shape (n, n_rows)
        """
        known = self._lags.get(fit)
        if known is None:
            model, errors = self.problem.model, [rounding_errors(run.signals) for run in self.problem.runs]
            most = {side: np.sqrt(3.0) * np.max([own[side] for own in errors], axis=0) for side in errors[0]}

            def columns(motion: Motion) -> Columns:
                joints = model.motor_from_joint * (most["joint_position"] * np.sign(motion.v))[:, None, :]
                motors = np.eye(model.n_motors) * (most["motor_position"] * np.sign(motion.v_m))[:, None, :]
                return Columns(kinematic=model.arm_scale[:, None] * np.concatenate([-joints, motors], axis=2))

            rows = self.white(fit.whitener, [lines.dense() for lines in self.problem.reduce(columns)])
            known = self._lags.keep(fit.rest(rows), fit)
        return known

    def instants(self, fit: Fit) -> Vector:
        """Give what torques bring that were read not quite when positions were, whitened, as far as a fit leaves it.

        Returns
        -------
        ndarray, shape (n, n_rows)
            None beside a delay.
        """
        known = self._instants.get(fit)
        if known is None:
            told = not self.problem.torque or any(c.effect.name == "time_delay" for c in fit.effects)
            delays = [c for c in all_candidates(self.problem, () if told else ("time_delay",)) if not c.place.index]
            share = PUNCTUAL / self.problem.motions[0].rate
            rows = [share * self.white(fit.whitener, self.columns(c)) for c in delays]
            known = self._instants.keep(fit.rest(np.concatenate([np.zeros((0, fit.n_rows)), *rows])), fit)
        return known

    def sides(self, fit: Fit) -> Vector:
        """Give what the rigid body takes more where joints accelerate as one motor says and not as each one's encoder.

        Of more joints than motors some move together. Links turn with their own encoders, rotors with what all of these
        make of their motor: where one is finer than the others, inertia seems to be on the other side.

        Returns
        -------
        ndarray, shape (n, n_rows)
            One per joint, whitened, as far as the fit leaves it over; none where no joints move together.
        """
        problem, model = self.problem, self.problem.model
        if not (problem.torque and problem.motions[0].joints_measured and model.n_joints > model.n_motors):
            return np.zeros((0, fit.n_rows))
        known = self._sides.get(fit)
        if known is None:

            def columns(motion: Motion) -> Columns:
                apart = motion.a_m @ model.joint_from_motor.T - motion.a
                own = inverse_dynamics(motion.model, motion.q, motion.v, motion.a)
                each = [motion.a + apart * axis for axis in np.eye(model.n_joints)]
                more = [inverse_dynamics(motion.model, motion.q, motion.v, a) - own for a in each]
                return Columns(np.stack([model.motor_torque(x) for x in more], axis=-1))

            rows = self.white(fit.whitener, [lines.dense() for lines in problem.reduce(columns)])
            known = self._sides.keep(fit.rest(rows), fit)
        return known

    def stretches(self, fit: Fit) -> list[Vector]:
        """Give by how much each parameter of the rigid body stretches the soft cables of a fit, in the travel.

        Where the links swing on a cable, that is in the columns of the rigid body itself.

        Returns
        -------
        list of ndarray, shape (n_rigid, n_channels, n_reduced)
            One per run.
        """
        problem, m = self.problem, self.problem.model.n_motors
        out = [np.zeros_like(rigid) for rigid in self.rigid]
        for candidate, beta in zip(fit.effects, fit.beta, strict=True):
            if not self._is_seen_to_stretch(candidate):
                continue
            i = candidate.place.index[0]
            for rows, rigid, run, inside in zip(out, self.rigid, problem.runs, problem.segments, strict=True):
                own = beta[0] / problem.model.arm_scale[i] * rigid[: self.n_bodies, i]
                if run.sure is not None and inside:  # as far as the mean of a travel counts
                    own = own - (1.0 - run.sure[i]) * inside_of(own, inside).mean(axis=1, keepdims=True)
                rows[: self.n_bodies, m + i] += own
        return out

    def unsure_stretches(self, fit: Fit) -> Vector:
        """Give what masses that are as unsure as they are may stretch the soft cables of a fit, whitened.

        Returns
        -------
        ndarray, shape (n, n_rows)
            As far as the fit leaves it over.
        """
        if not any(self._is_seen_to_stretch(c) for c in fit.effects):
            return np.zeros((0, fit.n_rows))
        known = self._stretched.get(fit)
        if known is None:
            p = self.n_bodies
            values, vectors = np.linalg.eigh(fit.covariance[:p, :p])
            W = self.white(fit.whitener, [rows[:p] for rows in self.stretches(fit)])
            known = self._stretched.keep(fit.rest((vectors * np.sqrt(np.maximum(values, 0.0))).T @ W), fit)
        return known

    def _is_seen_to_stretch(self, candidate: Candidate) -> bool:
        """Whether an effect is a soft cable whose travel is measured, and the torque that stretches it."""
        return self.problem.torque and self.problem.kinematic and candidate.effect.name in COMPLIANT

    def quicker_drifts(self, fit: Fit) -> Vector:
        """Give waves a little quicker than zeros were seen to move, whitened, as far as a fit leaves them over.

        Each is given as much room as all noise.

        Returns
        -------
        ndarray, shape (n, n_rows)
        """
        if self.drift is None:
            return np.zeros((0, fit.n_rows))
        known = self._drifts.get(fit)
        if known is None:
            waves = self._waves(self.drift.channels, LONG, self.drift.quicker + QUICKER)
            left = fit.rest(self.white(fit.whitener, waves))
            values, vectors = np.linalg.eigh(left @ left.T)
            seen = values > 1e-9 * np.max(values, initial=0.0)
            rows = (vectors[:, seen] / np.sqrt(values[seen])).T @ left
            known = self._drifts.keep(np.sqrt(fit.n_rows) * rows, fit)
        return known

    def bank(self, candidates: Sequence[Candidate]) -> Bank:
        """Compute the columns of many candidates."""
        parts = [self.problem.reduce(candidate.columns) for candidate in candidates]
        first = np.cumsum([0, *[part[0].n_columns for part in parts]])
        runs = [Lines.join([part[r] for part in parts]) for r in range(len(self.problem.runs))] if parts else []
        shapes = Counter(c.key for c in candidates)
        weight = np.array([1 / (len(shapes) * shapes[c.key]) for c in candidates])
        slices = tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(first))
        return Bank(tuple(candidates), slices, runs, weight, self.problem)

    def _white_bank(self, body: Body, whitener: Whitener, bank: Bank) -> WhiteBank:
        known = self._banks.get(whitener, bank)
        if known is not None:
            return known
        size = bank.slices[-1].stop * len(body.data)
        if 8 * (size + sum(kept.W.size for kept in self._banks.values())) > _LARGE:
            self._banks.clear()
        W = whitener.lines(bank.lines, self.problem.segments)
        full = np.einsum("ij,ij->i", W, W)
        inside = W @ body.Q
        left = full - np.einsum("ij,ij->i", inside, inside)
        sizes = np.array([s.stop - s.start for s in bank.slices], dtype=int)
        wide = []
        for k in sorted(set(sizes[sizes > 1])):
            own = np.flatnonzero(sizes == k)
            rows = np.array([np.arange(bank.slices[i].start, bank.slices[i].stop) for i in own])
            grams = np.array([W[r] @ W[r].T - inside[r] @ inside[r].T for r in rows])
            wide.append((own, rows, grams))
        return self._banks.keep(WhiteBank(W, full, left, wide), whitener, bank)

    def score_all(self, fit: Fit, bank: Bank) -> list[Score]:
        """Score every candidate of a bank against a fit."""
        if not bank.candidates:
            return []
        known = self._scores.get(fit, bank)
        return known if known is not None else self._scores.keep(self._score_all(fit, bank), fit, bank)

    def _score_all(self, fit: Fit, bank: Bank) -> list[Score]:
        white = self._white_bank(fit.body, fit.whitener, bank)
        inside, c = white.W @ fit.Q, white.W @ fit.residual
        left = np.maximum(white.left - np.einsum("ij,ij->i", inside, inside), 0.0)
        single = _score_single(c, white.full, left)
        signs = [candidate.signs for candidate in bank.candidates]
        out = [_single(single, s.start, own) for s, own in zip(bank.slices, signs, strict=True)]
        for own, rows, grams in white.wide:
            grams = grams - np.einsum("nir,njr->nij", inside[rows], inside[rows])
            scores = _score_wide(grams, c[rows], white.full[rows], left[rows], [signs[i] for i in own])
            for i, score in zip(own, scores, strict=True):
                out[i] = score
        return out

    def score(self, fit: Fit, candidate: Candidate) -> Score:
        """Score one candidate."""
        W = self.white(fit.whitener, self.columns(candidate))
        rest = fit.rest(W)
        gram = rest @ rest.T
        return scored(gram, rest @ fit.residual, np.einsum("ij,ij->i", W, W), np.diag(gram), candidate.signs)

    def refine(
        self, fit: Fit, candidate: Candidate, rounds: int = 2, plausibly: bool = False
    ) -> tuple[Candidate, Score]:
        """Estimate the shape of a candidate: one nonlinear parameter after the other, to the best score.

        Or the best that is plausible, where any is: over less than a cycle of friction that varies with position the
        best may not brake, and many others explain as much.

        Where the shape is the coefficient, as of a delay, it is made to be: a small share of a long delay would be a
        low-pass, which noisy accelerations ask for.
        """
        if not candidate.effect.counts:
            for _ in range(3 * rounds):
                delay = max(float(self.score(fit, candidate).beta[0]), SHORTEST)
                self._cache.pop(candidate.identity, None)
                candidate = replace(candidate, shape=(delay, *candidate.shape[1:]))
            return candidate, self.score(fit, candidate)
        bounds = candidate.bounds(self.problem.motions)
        best, score = candidate, self.score(fit, candidate)
        for _ in range(rounds if len(bounds) > 1 else 1):
            for i in range(min(len(bounds), len(candidate.shape))):
                best, score = self._refine_one(fit, best, score, i, bounds[i], plausibly)
        return best, score

    def _refine_one(
        self, fit: Fit, start: Candidate, score: Score, i: int, bounds: tuple[float, float], plausibly: bool
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
            s = self.score(fit, trial)
            self._cache.pop(trial.identity, None)
            return -s.statistic if keep(trial, s) else 0.0

        low, high = (np.log(bounds[0]), np.log(bounds[1])) if logarithmic else bounds
        here = min(max(np.log(start.shape[i]) if logarithmic else start.shape[i], low), high)
        reach = start.effect.reach * (high - low)
        if high > low:
            minimize_scalar(
                loss,
                bounds=(max(low, here - reach), min(high, here + reach)),
                method="bounded",
                options={"maxiter": 9, "xatol": 3e-3 * reach},
            )
        return max(found, key=lambda item: item[:2])[2:]


def errors(search: Search, base: Vector, effects: Sequence[Candidate], beta: Sequence[Vector]) -> list[Vector]:
    """Subtract what a fitted model predicts from the data, in the band, per run (n_channels, n_reduced)."""
    own = [search.columns(c) for c in effects]
    out = []
    for r, (rigid, nominal) in enumerate(zip(search.rigid, search.nominal, strict=True)):
        e = nominal - np.tensordot(base, rigid, 1)
        for columns, b in zip(own, beta, strict=True):
            e = e - np.tensordot(b, columns[r], 1)
        out.append(e)
    return out


def own_covariance(fit: Fit, j: int) -> Vector:
    """Give the covariance of the coefficients of effect `j` of a fit."""
    start = len(fit.base) + sum(len(beta) for beta in fit.beta[:j])
    own = slice(start, start + len(fit.beta[j]))
    return fit.covariance[own, own]


def still_errors(search: Search, fit: Fit) -> list[Vector]:
    """Compute what a fit leaves of a search's recordings, drifts aside."""
    return search.still(errors(search, fit.base, fit.effects, fit.beta))


def rms(search: Search, errors: Sequence[Vector]) -> Vector:
    """Root mean square per channel over the samples that are judged."""
    parts = [e[:, a:b] for e, run in zip(errors, search.problem.segments, strict=True) for a, b in run]
    return np.sqrt(np.mean(np.concatenate(parts, axis=1) ** 2, axis=1)) if parts else np.array([])


def _level(data: Sequence[Vector], segments: Sequence[Any], channel: int) -> float:
    values = [x[channel, a:b] for x, run in zip(data, segments, strict=True) for a, b in run]
    return float(np.std(np.concatenate(values))) + 1e-12 if values else 1.0


def _minor_signs(candidate: Candidate, k: int) -> list[int]:
    """Signs of those coefficients that may be zero; where only the first has one, it decides on the effect itself."""
    signs = candidate.signs
    return [*(signs if any(signs[1:]) else [0, *signs[1:]]), *[0] * k][:k]


def inside_of(bank: Vector, run: Segments) -> Vector:
    """Join the samples of segments, (..., n) -> (..., fewer)."""
    return np.concatenate([bank[..., a:b] for a, b in run] or [bank[..., :0]], axis=-1)


def _outside(rows: Vector, run: Segments, n: int) -> Vector:
    """Put samples of segments back where they were, zeros elsewhere."""
    out, first = np.zeros((*rows.shape[:-1], n)), 0
    for a, b in run:
        out[..., a:b] = rows[..., first : first + b - a]
        first += b - a
    return out


def _key(effects: Sequence[Candidate]) -> frozenset[Any]:
    return frozenset(c.identity for c in effects)


def _least_squares(A: Vector, b: Vector, size: Vector | None = None) -> tuple[Vector, Vector, Vector]:
    """Solve A' x = b for the rows of A; give x, an orthonormal basis of the rows, and x per coordinate in it.

    `size` is what the rows are measured by where their own norm would not tell noise from nothing; by default that is
    the largest of all, beside which a rounding error is nothing.
    """
    own = np.linalg.norm(A, axis=1)
    least = 1e-12 * np.max(own, initial=0.0) if size is None else 1e-7 * size
    scale = np.where(own > least, own, np.inf)
    if not len(A) or not np.isfinite(scale).any():
        return np.zeros(len(A)), np.zeros((len(b), 0)), np.zeros((len(A), 0))
    U, s, Vt = np.linalg.svd((A / scale[:, None]).T, full_matrices=False)
    keep = s > 1e-6 * s[0]
    U, inverse = U[:, keep], (Vt[keep].T / s[keep]) / scale[:, None]
    return inverse @ (U.T @ b), U, inverse


def _at_bound(A: Vector, b: Vector, size: Vector, signs: np.ndarray) -> np.ndarray:
    """Find the coefficients that signs hold at zero, from inner products: for many columns."""
    scale = np.where(np.linalg.norm(A, axis=1) > 1e-7 * size, np.maximum(size, 1e-300), np.inf)
    gram, c = (A / scale[:, None]) @ (A / scale[:, None]).T, (A / scale[:, None]) @ b
    held = np.zeros(len(A), bool)
    while True:
        live = np.flatnonzero(~held)
        theta = np.zeros(len(A))
        theta[live] = np.linalg.lstsq(gram[np.ix_(live, live)], c[live], rcond=1e-10)[0]
        wrong = (signs > 0) & (theta < 0)
        if not wrong.any():
            return held
        held[np.argmin(np.where(wrong, theta, np.inf))] = True


def _score_single(c: Vector, full: Vector, left: Vector) -> tuple[Vector, Vector, Vector, Vector]:
    """Score each column alone: statistic, coefficient, visible share, norm."""
    there = (left > 1e-6 * full) & (full > 0.0)
    safe = np.where(there, left, 1.0)
    visible = np.sqrt(np.maximum(left, 0.0) / np.maximum(full, 1e-300))
    return np.where(there, c * c / safe, -np.inf), np.where(there, c / safe, 0.0), visible, np.sqrt(there * safe)


def _single(parts: tuple[Vector, ...], i: int, signs: Sequence[int]) -> Score:
    """Give the score of one column, none where its sign is not admissible."""
    statistic, beta, visible, norm = (float(x[i]) for x in parts)
    if np.isfinite(statistic) and signs and signs[0] and beta < 0:
        statistic, beta = -np.inf, 0.0
    return Score(statistic, int(norm > 0), np.array([beta]), visible, norm)


def _score_wide(grams: Vector, c: Vector, full: Vector, left: Vector, signs: Sequence[Sequence[int]]) -> list[Score]:
    """Score many candidates of k columns each as `_score` does one, shapes (n, k, k), (n, k), (n, k), (n, k)."""
    whole = np.all(left > 1e-6 * full, axis=1)
    scale = np.sqrt(np.where(whole[:, None], left, 1.0))
    values, vectors = np.linalg.eigh(grams / scale[:, :, None] / scale[:, None])
    good = values > 1e-7 * values[:, -1:]
    u = np.einsum("nij,ni->nj", vectors, c / scale)
    part = np.where(good, u / np.where(good, values, 1.0), 0.0)
    beta = np.einsum("nij,nj->ni", vectors, part) / scale
    statistic = np.sum(u * part, axis=1)
    visible = np.sqrt(np.max(left / np.maximum(full, 1e-300), axis=1))
    out = []
    for i, own in enumerate(signs):
        if not whole[i] or any(s and b < 0 for s, b in zip(own, beta[i], strict=False)):
            out.append(scored(grams[i], c[i], full[i], left[i], own))
        else:
            norm = float(np.sqrt(left[i, 0]))
            out.append(Score(float(statistic[i]), int(good[i].sum()), beta[i], float(visible[i]), norm))
    return out


def scored(gram: Vector, c: Vector, full: Vector, left: Vector, signs: Sequence[int]) -> Score:
    """Score columns from their inner products beside a fit, and with its residual."""
    if len(c) == 1:
        return _single(_score_single(c, full, left), 0, signs)
    visible = float(np.sqrt(np.max(left / np.maximum(full, 1e-300)))) if len(full) else 0.0
    keep = left > 1e-6 * full
    nothing = Score(-np.inf, int(keep.sum()), np.zeros(len(c)), visible, 0.0)
    if not keep.any():
        return nothing
    scale = np.sqrt(np.where(keep, left, 1.0))
    values, vectors = np.linalg.eigh((gram / scale[:, None] / scale)[np.ix_(keep, keep)])
    good = values > 1e-7 * values[-1]
    u = vectors[:, good].T @ (c / scale)[keep]
    beta = np.zeros(len(c))
    beta[keep] = vectors[:, good] @ (u / values[good])
    beta /= scale
    wrong = [i for i, (s, b) in enumerate(zip(signs, beta, strict=False)) if s and b < 0]
    if wrong:
        return _without(gram, c, full, left, signs, min(wrong, key=lambda i: beta[i] * scale[i]), nothing)
    return Score(float(np.sum(u**2 / values[good])), int(good.sum()), beta, visible, float(np.sqrt(left[0])))


def _without(
    gram: Vector, c: Vector, full: Vector, left: Vector, signs: Sequence[int], i: int, nothing: Score
) -> Score:
    """Score again with the coefficient of the wrong sign at its bound, zero (active set)."""
    if len(c) == 1 or (i == 0 and not any(signs[1:])):
        return nothing
    rest = [j for j in range(len(c)) if j != i]
    signs = [signs[j] for j in rest if j < len(signs)]
    score = scored(gram[np.ix_(rest, rest)], c[rest], full[rest], left[rest], signs)
    return replace(score, beta=np.insert(score.beta, i, 0.0)) if np.isfinite(score.statistic) else nothing


class Recent:
    """A few results, each kept for the very objects it was computed from; the oldest goes first."""

    def __init__(self, most: int):
        self.most = most
        self._known: dict[Any, tuple[tuple[Any, ...], Any]] = {}

    def get(self, *owners: Any) -> Any:
        """Give what was kept for these objects, or None."""
        found = self._known.get(self._name(owners))
        return found[1] if found is not None else None

    def keep(self, value: Any, *owners: Any) -> Any:
        """Keep a result and give it back."""
        self._known[self._name(owners)] = (owners, value)
        while len(self._known) > self.most:
            self._known.pop(next(iter(self._known)))
        return value

    def values(self) -> list[Any]:
        """Give all that is kept."""
        return [value for _, value in self._known.values()]

    def clear(self) -> None:
        """Forget all."""
        self._known.clear()

    @staticmethod
    def _name(owners: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(x if isinstance(x, tuple | frozenset | bool) else id(x) for x in owners)


def all_candidates(problem: Problem, names: Sequence[str] | None = None) -> list[Candidate]:
    """Every effect at every place with every shape of its coarse grid."""
    out = []
    for effect in [*CATALOGUE.values(), *PATCHES.values()]:
        if names is not None and effect.name not in names:
            continue
        for place in effect.places(problem.model):
            ratios = [(r,) for r in RATIOS] if place.is_pair else [()]
            shapes = effect.grid(problem.motions, place)
            out += [Candidate(effect, place, (*shape, *ratio)) for shape in shapes for ratio in ratios]
    return out


OWN = 0.02
"""Share of the torque at a frequency that a disturbance there makes at least."""


def tones(search: Search, effects: Sequence[Candidate] = (), most: int = 3, least: float = 60.0) -> list[Candidate]:
    """Give candidates for disturbances with a frequency of their own: peaks in the spectrum of a plain fit's residual.

    Where the motion has a line, a little of it is left by masses and accelerations that are a little off.

    Parameters
    ----------
    search : Search
    effects : sequence of Candidate
        Beside the rigid body.
    most : int
        Frequencies at most.
    least : float
        Height of a peak over the median around it, in power; noise alone reaches some 15.
    """
    problem = search.problem
    rate = problem.band.reduced_rate
    peaks: dict[float, float] = {}
    rest = search.left_over(effects, smooth=False)[0]
    for e, data, run in zip(rest, problem.data, problem.segments, strict=True):
        start, stop = max(run, key=lambda s: s[1] - s[0], default=(0, 0))
        n = stop - start
        if n < 256:
            continue
        for x, y in zip(e[:, start:stop], data[0, :, start:stop], strict=True):
            for f, height in tone_peaks(x, rate, 0.3, 0.9 * problem.band.cutoff, most, least).items():
                turn = np.hanning(n) * np.exp(-2j * np.pi * f / rate * np.arange(n))
                if np.abs(x @ turn) > OWN * np.abs((y - y.mean()) @ turn):
                    peaks[f] = height
    best: list[float] = []
    for f in sorted(peaks, key=lambda f: -peaks[f]):
        if len(best) < most and all(abs(f - other) > 0.02 for other in best):
            best.append(f)
    return [Candidate(TONE, place, (f,)) for f in best for place in TONE.places(problem.model)]


def updated_model(model: CableModel, base: BaseParameters, change: Vector, sizes: Vector | None = None) -> CableModel:
    """Give the model whose base parameters differ by `change` from those of `model`, the rest as near as can be.

    Near in units of the standard parameters, or of `sizes` if given. What stands behind the base parameters in a fit, a
    payload's, is left out. A link's mass alone, of which no torque tells, may become negative.
    """
    size = np.ones(base.matrix.shape[1]) if sizes is None else sizes
    step = size * (np.linalg.pinv(base.matrix * size) @ change[: len(base.columns)])
    return model.with_standard_parameters(model.standard_parameters + step)


def _sizes(model: CableModel) -> Vector:
    """Give each standard parameter's size: a link's mass, times its radius about its joint once or twice."""
    links = model.standard_parameters.reshape(-1, 10)
    mass = np.maximum(np.abs(links[:, 0]), 1e-9)
    spread = 0.5 * np.abs(links[:, [4, 6, 9]].sum(axis=1)) / mass
    radius = np.sqrt(np.maximum(spread, 1e-4 * spread.max(initial=0.0)))
    if not radius.any():
        radius[:] = 1.0
    return (mass[:, None] * np.column_stack([np.ones_like(radius), *[radius] * 3, *[radius**2] * 6])).ravel()


ProgressCallback = Callable[[str, float], None]


def family_wise(score: Score, candidate: Candidate, weight: float) -> float:
    """Natural log of the family-wise p-value of a candidate (Bonferroni, weighted)."""
    if not np.isfinite(score.statistic):
        return 0.0
    one_sided = np.log(0.5) if score.k == 1 and any(candidate.signs) else 0.0
    return log_p(score.statistic, score.k) + one_sided - float(np.log(weight))
