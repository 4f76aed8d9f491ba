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
from .effects import CATALOGUE, Candidate
from .geometry import Vector
from .model import CableModel
from .patches import PATCHES, TONE
from .problem import Problem
from .whitening import Segments, Whitener, fit_whitener, log_p, quiet_segments


@dataclass(frozen=True)
class Settings:
    """How the search decides.

    Attributes
    ----------
    alarm : float
        Family-wise probability of naming anything on data where nothing is missing.
    visible : float
        Least share of an effect that the rigid body leaves over for it to be tested.
    model_error : float
        Relative error of the laws that are already in the model: a further effect has to be larger than this share of
        what they explain.
    law_error : float
        Relative accuracy of one law: rivals that differ by less are told apart by simplicity alone.
    patch_error, patch_law_error : float
        The same two for corrections that have no name.
    same : float
        Canonical correlation above which two effects are one class.
    close : float
        Difference of log-likelihood below which a rival stands beside an effect.
    order : int
        Of the autoregressive noise.
    much : float
        Ratio of what is left over without and with smooth functions of the state, above which these are taken out of
        the noise before effects are compared.
    most : int
        Effects at most.
    at_once : int
        Effects that are added before a correction without a name is weighed against them.
    """

    alarm: float = 2e-3
    visible: float = 0.004
    model_error: float = 0.03
    law_error: float = 0.006
    patch_error: float = 0.1
    patch_law_error: float = 0.05
    same: float = 0.95
    close: float = 3.0
    order: int = 24
    much: float = 1.25
    most: int = 6
    at_once: int = 2


@dataclass(frozen=True)
class Bank:
    """Columns of many candidates in the band.

    Attributes
    ----------
    candidates : tuple of Candidate
    slices : tuple of slice
        Where each one's columns are.
    columns : list of ndarray, shape (n_columns, n_channels, n_reduced)
        One per run.
    weight : ndarray, shape (n_candidates,)
        Share of the alarm that each candidate may spend; sums to one.
    """

    candidates: tuple[Candidate, ...]
    slices: tuple[slice, ...]
    columns: list[Vector]
    weight: Vector


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
class Fit:
    """Rigid body and effects fitted to whitened data.

    Attributes
    ----------
    problem : Problem
    whitener : Whitener
    effects : tuple of Candidate
    Q : ndarray, shape (n_rows, rank)
        Orthonormal basis of all columns in the fit.
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


class Search:
    """Fits and scores on one problem; keeps the banks of columns between steps.

    Parameters
    ----------
    problem : Problem
    base : BaseParameters
    settings : Settings
    """

    def __init__(self, problem: Problem, base: BaseParameters, settings: Settings):
        self.problem, self.base, self.settings = problem, base, settings
        self._cache: dict[Any, list[Vector]] = {}
        self._clear: dict[Any, Whitener] = {}
        self._white: tuple[Any, Any, Vector] | None = None

    @cached_property
    def nominal(self) -> list[Vector]:
        """Data less the torque of the nominal model."""
        pi = self.problem.model.standard_parameters
        return [
            d[0] - np.tensordot(pi, Y, 1) - r[0]
            for d, Y, r in zip(self.problem.data, self.problem.rigid, self.problem.rotors, strict=True)
        ]

    @cached_property
    def rigid(self) -> list[Vector]:
        """Base columns of the regressor, per run."""
        return [Y[self.base.columns] for Y in self.problem.rigid]

    def columns(self, candidate: Candidate) -> list[Vector]:
        """Columns of a candidate in the band, per run; kept for the next time."""
        key = (candidate.key, candidate.shape)
        if key not in self._cache:
            self._cache[key] = self.problem.reduce(candidate.columns)
        return self._cache[key]

    def white(self, whitener: Whitener, banks: Sequence[Vector], segments: Sequence[Segments] | None = None) -> Vector:
        """Whiten columns of all runs, shape (n_columns, n_rows)."""
        segments = self.problem.segments if segments is None else segments
        parts = [whitener(bank, run, r) for r, (bank, run) in enumerate(zip(banks, segments, strict=True))]
        return np.concatenate(parts, axis=1)

    @cached_property
    def common(self) -> tuple[Candidate, ...]:
        """Effects that most machines have, there to keep what is not yet explained out of the noise."""
        names = ("viscous_friction", "coulomb_friction", "torque_offset", "joint_spring")
        candidates = [
            c for c in all_candidates(self.problem, names) if c.effect.name != "joint_spring" or not c.shape[0]
        ]
        return tuple(candidates)

    @cached_property
    def plain(self) -> Whitener:
        """Scale the channels only."""
        n = self.problem.n_channels
        level = np.array([_level(self.nominal, self.problem.segments, c) for c in range(n)])
        return Whitener(np.zeros((n, 1)), np.diag(1 / level), np.ones(len(self.problem.runs)))

    def fit(self, effects: Sequence[Candidate], whitener: Whitener | None = None, rounds: int = 3) -> Fit:
        """Fit rigid body and effects; estimate the noise anew unless a whitener is given."""
        own = [self.columns(c) for c in effects]
        banks = [
            np.concatenate([self.rigid[r], *[columns[r] for columns in own], self.nominal[r][None]])
            for r in range(len(self.rigid))
        ]
        estimate = whitener is None
        if whitener is None:
            whitener = self.plain
        quiet = self.problem.segments
        for _ in range(rounds if estimate else 0):
            theta = self._solve(self.white(whitener, banks, quiet))[0]
            residuals = [bank[-1] - np.tensordot(theta, bank[:-1], 1) for bank in banks]
            quiet = quiet_segments(residuals, self.problem.segments)
            whitener = fit_whitener(residuals, quiet, self.settings.order)
        theta, Q, residual, covariance = self._solve(self.white(whitener, banks))
        p = len(self.base.columns)
        sizes = np.cumsum([p, *[columns[0].shape[0] for columns in own]])
        beta = tuple(theta[a:b] for a, b in itertools.pairwise(sizes))
        return Fit(self.problem, whitener, tuple(effects), Q, residual, theta[:p], beta, covariance)

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
        candidates = [*self.common, *all_candidates(self.problem, names), *tones(self)]
        parts = [self.columns(c) for c in candidates]
        return [np.concatenate([columns[r] for columns in parts]) for r in range(len(self.rigid))]

    def left_over(self, effects: Sequence[Candidate], smooth: bool = True) -> list[Vector]:
        """Residuals of a plain fit of rigid body and effects, with the smooth columns or without, per run.

        They are scaled up for the number of columns, shape (n_channels, n_reduced).
        """
        own = [self.columns(c) for c in effects]
        banks = []
        for r in range(len(self.rigid)):
            parts = [self.rigid[r], *[columns[r] for columns in own], *([self.smooth[r]] if smooth else [])]
            banks.append(np.concatenate([*parts, self.nominal[r][None]]))
        W = self.white(self.plain, banks)
        A, b = W[:-1], W[-1]
        scale = np.linalg.norm(A, axis=1)
        scale[scale == 0] = 1.0
        A = A / scale[:, None]
        values, vectors = np.linalg.eigh(A @ A.T)
        keep = values > 1e-9 * values[-1]
        theta = vectors[:, keep] @ ((vectors[:, keep].T @ (A @ b)) / values[keep]) / scale
        inflation = np.sqrt(len(b) / max(len(b) - int(keep.sum()), 1))
        return [(bank[-1] - np.tensordot(theta, bank[:-1], 1)) * inflation for bank in banks]

    def clear(self, effects: Sequence[Candidate]) -> Whitener:
        """Estimate the noise with smooth functions of the state taken out beside `effects`.

        Only where much is left unexplained; a little does no harm to the estimate, and the smooth functions would.
        """
        key = tuple((c.key, c.shape) for c in effects)
        if key not in self._clear:
            rest, rough = self.left_over(effects), self.left_over(effects, smooth=False)
            ratio = max(
                _level(rough, self.problem.segments, c) / _level(rest, self.problem.segments, c)
                for c in range(self.problem.n_channels)
            )
            if ratio > self.settings.much:
                quiet = quiet_segments(rest, self.problem.segments)
                self._clear[key] = fit_whitener(rest, quiet, self.settings.order)
            else:
                self._clear[key] = self.fit(effects).whitener
        return self._clear[key]

    @staticmethod
    def _solve(W: Vector) -> tuple[Vector, Vector, Vector, Vector]:
        A, b = W[:-1].T, W[-1]
        scale = np.linalg.norm(A, axis=0)
        scale[scale == 0] = 1.0
        U, s, Vt = np.linalg.svd(A / scale, full_matrices=False)
        keep = s > 1e-6 * s[0] if len(s) else s > 0
        U, s, Vt = U[:, keep], s[keep], Vt[keep]
        c = U.T @ b
        theta = (Vt.T @ (c / s)) / scale
        inverse = (Vt.T / s) / scale[:, None]
        return theta, U, b - U @ c, inverse @ inverse.T

    def bank(self, candidates: Sequence[Candidate]) -> Bank:
        """Compute the columns of many candidates."""
        slices, parts, start = [], [], 0
        for candidate in candidates:
            columns = self.columns(candidate)
            k = columns[0].shape[0]
            slices.append(slice(start, start + k))
            start += k
            parts.append(columns)
        runs = [np.concatenate([columns[r] for columns in parts]) for r in range(len(self.problem.runs))]
        shapes = Counter(c.key for c in candidates)
        weight = np.array([1 / (len(shapes) * shapes[c.key]) for c in candidates])
        return Bank(tuple(candidates), tuple(slices), runs, weight)

    def _bank_white(self, whitener: Whitener, bank: Bank) -> Vector:
        if len(bank.candidates) < 10:
            return self.white(whitener, bank.columns)
        if self._white is None or self._white[0] is not whitener or self._white[1] is not bank:
            self._white = (whitener, bank, self.white(whitener, bank.columns))
        return self._white[2]

    def score_all(self, fit: Fit, bank: Bank) -> list[Score]:
        """Score every candidate of a bank against a fit."""
        if not bank.candidates:
            return []
        W = self._bank_white(fit.whitener, bank)
        perp = W - (W @ fit.Q) @ fit.Q.T
        c = perp @ fit.residual
        full, left = np.einsum("ij,ij->i", W, W), np.einsum("ij,ij->i", perp, perp)
        return [
            _score(perp[s], c[s], full[s], left[s], candidate.effect.signs)
            for candidate, s in zip(bank.candidates, bank.slices, strict=True)
        ]

    def score(self, fit: Fit, candidate: Candidate) -> Score:
        """Score one candidate."""
        return self.score_all(fit, self.bank([candidate]))[0]

    def refine(self, fit: Fit, candidate: Candidate, rounds: int = 2) -> tuple[Candidate, Score]:
        """Estimate the shape of a candidate: one nonlinear parameter after the other, to the best score."""
        bounds = candidate.effect.bounds(self.problem.motions, candidate.place)
        best, score = candidate, self.score(fit, candidate)
        for _ in range(rounds if len(bounds) > 1 else 1):
            for i in range(min(len(bounds), len(candidate.shape))):
                best, score = self._refine_one(fit, best, score, i, bounds[i])
        return best, score

    def _refine_one(self, fit: Fit, start: Candidate, score: Score, i: int, bounds: tuple[float, float]):
        logarithmic = bounds[0] > 0
        found = [(score.statistic, start, score)]

        def loss(x: float) -> float:
            value = float(np.exp(x)) if logarithmic else float(x)
            shape = (*start.shape[:i], value, *start.shape[i + 1 :])
            trial = replace(start, shape=shape)
            s = self.score(fit, trial)
            self._cache.pop((trial.key, trial.shape), None)
            found.append((s.statistic, trial, s))
            return -s.statistic if np.isfinite(s.statistic) else 0.0

        low, high = (np.log(bounds[0]), np.log(bounds[1])) if logarithmic else bounds
        here = np.log(start.shape[i]) if logarithmic else start.shape[i]
        reach = start.effect.reach * (high - low)
        if high > low:
            minimize_scalar(
                loss,
                bounds=(max(low, here - reach), min(high, here + reach)),
                method="bounded",
                options={"maxiter": 9, "xatol": 3e-3 * reach},
            )
        best = max(found, key=lambda item: item[0])
        return best[1], best[2]


def _level(data: Sequence[Vector], segments: Sequence[Any], channel: int) -> float:
    values = [x[channel, a:b] for x, run in zip(data, segments, strict=True) for a, b in run]
    return float(np.std(np.concatenate(values))) + 1e-12 if values else 1.0


def _score(perp: Vector, c: Vector, full: Vector, left: Vector, signs: Sequence[int]) -> Score:
    if len(c) == 1 and left[0] > 1e-6 * full[0] > 0.0:
        beta = c / left
        good = not (signs and signs[0] and beta[0] < 0)
        statistic = float(c[0] * beta[0]) if good else -np.inf
        return Score(
            statistic, 1, beta if good else 0 * beta, float(np.sqrt(left[0] / full[0])), float(np.sqrt(left[0]))
        )
    visible = float(np.sqrt(np.max(left / np.maximum(full, 1e-300)))) if len(full) else 0.0
    keep = left > 1e-6 * full
    nothing = Score(-np.inf, int(keep.sum()), np.zeros(len(c)), visible, 0.0)
    if not keep.any():
        return nothing
    scale = np.sqrt(np.where(keep, left, 1.0))
    gram = (perp @ perp.T) / scale[:, None] / scale
    values, vectors = np.linalg.eigh(gram[np.ix_(keep, keep)])
    good = values > 1e-7 * values[-1]
    u = vectors[:, good].T @ (c / scale)[keep]
    beta = np.zeros(len(c))
    beta[keep] = vectors[:, good] @ (u / values[good])
    beta /= scale
    wrong = [i for i, (s, b) in enumerate(zip(signs, beta, strict=False)) if s and b < 0]
    if wrong:
        return _without(perp, c, full, left, signs, min(wrong, key=lambda i: beta[i] * scale[i]), nothing)
    return Score(float(np.sum(u**2 / values[good])), int(good.sum()), beta, visible, float(np.sqrt(left[0])))


def _without(
    perp: Vector, c: Vector, full: Vector, left: Vector, signs: Sequence[int], i: int, nothing: Score
) -> Score:
    """Score again with the coefficient of the wrong sign at its bound, zero (active set)."""
    if len(c) == 1 or i == 0:
        return nothing
    rest = [j for j in range(len(c)) if j != i]
    score = _score(perp[rest], c[rest], full[rest], left[rest], [signs[j] for j in rest if j < len(signs)])
    return replace(score, beta=np.insert(score.beta, i, 0.0)) if np.isfinite(score.statistic) else nothing


def all_candidates(problem: Problem, names: Sequence[str] | None = None) -> list[Candidate]:
    """Every effect at every place with every shape of its coarse grid."""
    out = []
    for effect in [*CATALOGUE.values(), *PATCHES.values()]:
        if names is not None and effect.name not in names:
            continue
        for place in effect.places(problem.model):
            out += [Candidate(effect, place, shape) for shape in effect.grid(problem.motions, place)]
    return out


def tones(search: Search, most: int = 3, least: float = 60.0) -> list[Candidate]:
    """Give candidates for disturbances with a frequency of their own: peaks in the spectrum of a plain fit's residual.

    Parameters
    ----------
    search : Search
    most : int
        Frequencies at most.
    least : float
        Height of a peak over the median around it, in power; noise alone reaches some 15.
    """
    problem = search.problem
    rate = problem.band.rate / problem.band.step
    peaks: dict[float, float] = {}
    for e, run in zip(search.left_over([], smooth=False), problem.segments, strict=True):
        start, stop = max(run, key=lambda s: s[1] - s[0], default=(0, 0))
        n = stop - start
        if n < 256:
            continue
        frequency = np.fft.rfftfreq(2 * n, 1 / rate)
        for x in e[:, start:stop]:
            power = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(n), 2 * n)) ** 2
            local = np.array([np.median(power[max(0, k - 60) : k + 61]) for k in range(0, len(power), 20)])
            ratio = power / np.maximum(np.repeat(local, 20)[: len(power)], 1e-300)
            ratio[frequency < 0.3] = 0.0
            ratio[frequency > 0.9 * problem.band.cutoff] = 0.0
            for _ in range(most):
                k = int(np.argmax(ratio))
                if ratio[k] < least:
                    break
                peaks[_exact_tone(x - x.mean(), rate, float(frequency[k]), 0.5 * rate / n)] = float(ratio[k])
                ratio[max(0, k - 6) : k + 7] = 0.0
    best: list[float] = []
    for f in sorted(peaks, key=lambda f: -peaks[f]):
        if len(best) < most and all(abs(f - other) > 0.02 for other in best):
            best.append(f)
    return [Candidate(TONE, place, (f,)) for f in best for place in TONE.places(problem.model)]


def _exact_tone(x: Vector, rate: float, frequency: float, reach: float) -> float:
    t, window = np.arange(len(x)) / rate, np.hanning(len(x))
    power = minimize_scalar(
        lambda f: -abs(np.sum(window * x * np.exp(-2j * np.pi * f * t))),
        bounds=(frequency - reach, frequency + reach),
        method="bounded",
        options={"xatol": 1e-5},
    )
    return float(power.x)


def updated_model(model: CableModel, base: BaseParameters, change: Vector) -> CableModel:
    """Give the model whose base parameters differ by `change` from those of `model`, the rest as near as can be."""
    heavy = massive_columns(model)
    step = np.zeros(base.matrix.shape[1])
    step[heavy] = np.linalg.pinv(base.matrix[:, heavy]) @ change
    return model.with_standard_parameters(model.standard_parameters + step)


ProgressCallback = Callable[[str, float], None]


def family_wise(score: Score, candidate: Candidate, weight: float) -> float:
    """Natural log of the family-wise p-value of a candidate (Bonferroni, weighted)."""
    if not np.isfinite(score.statistic):
        return 0.0
    one_sided = np.log(0.5) if score.k == 1 and any(candidate.effect.signs) else 0.0
    return log_p(score.statistic, score.k) + one_sided - float(np.log(weight))
