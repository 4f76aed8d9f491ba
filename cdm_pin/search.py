"""The search's workbench: fits and scores on one problem, about one model; what was computed is kept between steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from .bank import Bank, WhiteBank, all_candidates, make_bank, whitened
from .base import BaseParameters, updated_model
from .candidates import Candidate, Identity
from .drift import Drift
from .effect import Columns
from .fit import Body, Estimate, Fit, fitted, least_squares, left_open, where_in
from .geometry import Vector
from .model import CableModel
from .motion import Motion
from .problem import Problem
from .recent import Recent, lasting
from .scores import Score, scored
from .settings import Settings
from .whitening import Segments, Whitener, blanked, counts, fit_quiet, live_in

_LARGE = 1e9  # bytes of whitened banks that are kept


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

    Attributes
    ----------
    lasting : dict
        Results that hold about other models of the same recordings as well, by the function that made them.
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
        self._noise: dict[Any, Whitener] = {}
        self._bodies: Recent = Recent(4)
        self._fits: Recent = Recent(24)
        self._banks: Recent = Recent(4)
        self._scores: Recent = Recent(8)
        self._kept: dict[str, Recent] = {}
        self.lasting: dict[str, Any] = {}

    @property
    def most(self) -> int:
        """Effects at most: each motor's axis may rub in two ways."""
        return max(self.settings.most, 2 * self.problem.model.n_motors)

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
        search.lasting, search._banks = dict(self.lasting), self._banks
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

    def judge(self, problem: Problem) -> Search:
        """Give a search on recordings that this one has not seen, with the same columns; their zeros are not known."""
        judge = Search(problem, self.base, self.settings, self.held)
        if self.drift is not None:
            shape = len(self.drift.columns[0]), problem.n_channels
            none = [np.zeros((*shape, data.shape[2])) for data in problem.data]
            judge.drift = replace(self.drift, columns=none)
        return judge

    def seeing(self, problem: Problem) -> Search:
        """Give the same search on other rows of the same recordings."""
        search = Search(problem, self.base, self.settings, self.held, self.drift)
        search._cache = self._cache
        search.__dict__ |= {"rigid": self.rigid, "nominal": self.nominal}
        return search

    def drifting(self, drift: Drift) -> Search:
        """Give the same search with what zeros of sensors do beside the rigid body."""
        search = Search(self.problem, self.base, self.settings, self.held, drift)
        search._cache, search.lasting, search._banks = self._cache, dict(self.lasting), self._banks
        if "nominal" in self.__dict__:
            search.__dict__["nominal"] = self.nominal
        return search

    def recent(self, name: str, most: int = 8) -> Recent:
        """Give the last few results that a function of this name has kept with the search."""
        return self._kept.setdefault(name, Recent(most))

    def columns(self, candidate: Candidate) -> list[Vector]:
        """Columns of a candidate in the band, per run; kept for the next time."""
        key = candidate.identity
        if key not in self._cache:
            self._cache[key] = self.in_band(candidate.columns)
        return self._cache[key]

    def in_band(self, columns: Callable[[Motion], Columns]) -> list[Vector]:
        """Compute columns from the motions, in the band, per run."""
        return [lines.dense() for lines in self.problem.reduce(columns)]

    def forget(self, candidate: Candidate) -> None:
        """Keep the columns of a candidate no longer, such as one of many shapes that are tried."""
        self._cache.pop(candidate.identity, None)

    def is_crossed(self, play: Candidate) -> bool:
        """Whether the play of a cable is crossed on any recording, as far as motors alone tell."""
        return any(motion.changes_sides(play.place.index[0]) for motion in self.problem.motions)

    def size(self, *candidates: Candidate) -> int:
        """Count the parameters of candidates: coefficients and what of their shapes is estimated."""
        return sum(len(self.columns(c)[0]) + c.extra for c in candidates)

    def white(self, whitener: Whitener, banks: Sequence[Vector], segments: Sequence[Segments] | None = None) -> Vector:
        """Whiten columns of all runs, shape (n_columns, n_rows)."""
        segments = self.problem.segments if segments is None else segments
        parts = [whitener(bank, run, r) for r, (bank, run) in enumerate(zip(banks, segments, strict=True))]
        return np.concatenate(parts, axis=1)

    @property
    @lasting
    def common(self) -> tuple[Candidate, ...]:
        """Effects that most machines have, there to keep what is not yet explained out of the noise."""
        names = ("viscous_friction", "coulomb_friction", "torque_offset", "joint_spring")
        candidates = [
            c for c in all_candidates(self.problem, names) if c.effect.name != "joint_spring" or not c.shape[0]
        ]
        return tuple(candidates)

    @property
    @lasting
    def loads(self) -> Vector:
        """Root mean square of the data, per channel."""
        return rms(self, [x[0] for x in self.problem.data])

    @property
    @lasting
    def plain(self) -> Whitener:
        """Scale the channels only."""
        channels = range(self.problem.n_channels)
        level = np.array([_level(self.nominal, self.problem.segments, c) for c in channels])
        return Whitener.white(level, len(self.problem.runs))

    def noise(self, effects: Sequence[Candidate], rounds: int = 3) -> Whitener:
        """Estimate the noise as what rigid body and effects leave over."""
        key = key_of(effects)
        if key not in self._noise:
            own = [self.columns(c) for c in effects]
            banks = [
                np.concatenate([self.rigid[r], states, *[columns[r] for columns in own], self.nominal[r][None]])
                for r, states in enumerate(self.problem.states)
            ]
            whitener, quiet, blocks = self.plain, self.problem.segments, self.problem.blocks
            for _ in range(rounds):
                W = self.white(whitener, banks, quiet)
                theta = least_squares(W[:-1], W[-1])[0]
                residuals = [
                    blanked(bank[-1] - np.tensordot(theta, bank[:-1], 1), run)
                    for bank, run in zip(banks, self.problem.segments, strict=True)
                ]
                whitener, quiet = fit_quiet(residuals, self.problem.segments, self.settings.order, blocks)
            self._noise[key] = whitener
        return self._noise[key]

    def body(self, whitener: Whitener) -> Body:
        """Whiten data and rigid body."""
        known = self._bodies.get(whitener)
        if known is not None:
            return known
        parts = zip(self.rigid, self.problem.states, self.nominal, strict=True)
        W = self.white(whitener, [np.concatenate([rigid, states, nominal[None]]) for rigid, states, nominal in parts])
        _, Q, inverse = least_squares(W[:-1], W[-1])
        residual = W[-1] - Q @ (Q.T @ W[-1])
        return self._bodies.keep(Body(Q, inverse[: self.n_rigid], W[-1], residual), whitener)

    def fit(self, effects: Sequence[Candidate], whitener: Whitener | None = None) -> Fit:
        """Fit rigid body and effects; estimate the noise anew unless a whitener is given."""
        if whitener is None:
            whitener = self.noise(effects)
        order = tuple(c.identity for c in effects)
        known = self._fits.get(whitener, order)
        return known if known is not None else self._fits.keep(self._fit(effects, whitener), whitener, order)

    def _fit(self, effects: Sequence[Candidate], whitener: Whitener) -> Fit:
        own = [self.white(whitener, self.columns(c)) for c in effects]
        return fitted(self.problem, whitener, effects, self.body(whitener), own)

    def without(self, fit: Fit, *left_out: int) -> Fit:
        """Fit again, in the same noise, without the effects of these numbers."""
        return self.fit([c for i, c in enumerate(fit.effects) if i not in left_out], fit.whitener)

    def bank(self, candidates: Sequence[Candidate]) -> Bank:
        """Compute the columns of many candidates."""
        return make_bank(self.problem, candidates)

    def renewed(self, bank: Bank) -> Bank:
        """Compute those columns of a bank anew that depend on the torques of the body and of other effects."""
        return bank.renewed(self.problem)

    def score_all(self, fit: Fit, bank: Bank) -> list[Score]:
        """Score every candidate of a bank against a fit."""
        if not bank.candidates:
            return []
        known = self._scores.get(fit, bank)
        if known is not None:
            return known
        return self._scores.keep(self._white_bank(fit.body, fit.whitener, bank).scores(fit, bank), fit, bank)

    def meet(self, fits: Sequence[Fit], bank: Bank) -> None:
        """Prepare to score every candidate of a bank against some fits in one noise."""
        if fits and bank.candidates:
            self._white_bank(fits[0].body, fits[0].whitener, bank).meet(fits)

    def _white_bank(self, body: Body, whitener: Whitener, bank: Bank) -> WhiteBank:
        known = self._banks.get(whitener, bank, body)
        if known is not None:
            return known
        size = bank.slices[-1].stop * len(body.data)
        self._banks.shrink(lambda kept: 8 * (size + sum(white.W.size for white in kept)) <= _LARGE)
        return self._banks.keep(whitened(bank, whitener, self.problem.segments, body), whitener, bank, body)

    def score(self, fit: Fit, candidate: Candidate) -> Score:
        """Score one candidate."""
        return score_beside(fit, self.white(fit.whitener, self.columns(candidate)), candidate.signs)


def score_beside(fit: Fit, W: Vector, signs: Sequence[int]) -> Score:
    """Score whitened columns, shape (k, n_rows), beside a fit."""
    inside = np.concatenate([W @ fit.body.Q, W @ fit.Q], axis=1)
    gram = W @ W.T
    full, gram = np.diag(gram), gram - inside @ inside.T
    return scored(gram, W @ fit.residual, full, np.maximum(np.diag(gram), 0.0), signs)


def errors(search: Search, base: Vector, effects: Sequence[Candidate], beta: Sequence[Vector]) -> list[Vector]:
    """Subtract what a fitted model predicts from the data, in the band, per run (n_channels, n_reduced).

    Zero where channels are not judged.
    """
    raw = raw_errors(search, base, effects, beta)
    return [blanked(e, run) for e, run in zip(raw, search.problem.segments, strict=True)]


def foretold(search: Search, fit: Fit) -> list[Vector]:
    """Give the `errors` of a fit, on unseen recordings those of its laws alone where these are less.

    What a law leaves open about the sign of a velocity is told by passages through zero and standstills, which others
    may hold little of.
    """
    own = errors(search, fit.base, fit.effects, fit.beta)
    if search.problem is fit.problem:
        return own
    where = where_in(fit)
    doubts = [k for at, left in zip(where, left_open(fit), strict=True) for k in at[left]]
    if not doubts:
        return own
    values = Estimate.of(fit).without(np.array(doubts)).values
    bare = errors(search, values[: len(fit.base)], fit.effects, [values[at] for at in where])
    level = np.maximum(search.loads, 1e-12)
    return min(own, bare, key=lambda left: float(np.sum((rms(search, left) / level) ** 2)))


def raw_errors(search: Search, base: Vector, effects: Sequence[Candidate], beta: Sequence[Vector]) -> list[Vector]:
    """Give the same `errors` where channels are not judged as well."""
    own = [search.columns(c) for c in effects]
    out = []
    for r, (rigid, nominal) in enumerate(zip(search.rigid, search.nominal, strict=True)):
        e = nominal - np.tensordot(base, rigid, 1)
        for columns, b in zip(own, beta, strict=True):
            e = e - np.tensordot(b, columns[r], 1)
        out.append(e)
    return out


def brought(search: Search, candidate: Candidate, beta: Vector) -> list[Vector]:
    """Give what an effect of some size brings in the band, per run, shape (n_channels, n_reduced).

    Of its columns as many count as there are coefficients.
    """
    return [np.tensordot(beta, columns[: len(beta)], 1) for columns in search.columns(candidate)]


def rms(search: Search, errors: Sequence[Vector]) -> Vector:
    """Root mean square per channel over the samples that are judged."""
    parts, n = [], np.zeros(0)
    for e, run in zip(errors, search.problem.segments, strict=True):
        live = live_in(run)
        own = list(run) if live is None or len(live) != len(e) else run
        parts += [blanked(e, own)[:, a:b] for a, b in run]
        n = counts(own, len(e)) + (n if len(n) else 0)
    return np.sqrt(np.sum(np.concatenate(parts, axis=1) ** 2, axis=1) / np.maximum(n, 1)) if parts else np.array([])


def _level(data: Sequence[Vector], segments: Sequence[Any], channel: int) -> float:
    values = [x[channel, a:b] for x, run in zip(data, segments, strict=True) for a, b in run]
    return float(np.std(np.concatenate(values))) + 1e-12 if values else 1.0


def key_of(effects: Sequence[Candidate]) -> frozenset[Identity]:
    """Say which effects these are, whatever their order."""
    return frozenset(c.identity for c in effects)
