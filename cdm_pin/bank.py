"""Banks: the columns of many candidates, to be scored all at once."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from .candidates import Candidate, Identity
from .effects import CATALOGUE
from .fit import Body, Fit
from .geometry import Vector
from .patches import PATCHES
from .places import RATIOS
from .problem import Problem
from .scores import Score, score_single, score_wide, single
from .whitening import Lines, Segments, Whitener


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

    def renewed(self, problem: Problem) -> Bank:
        """Compute those columns anew that depend on the torques of the body and of other effects."""
        if problem.posture != self.problem.posture:
            return make_bank(problem, self.candidates)
        if problem.is_loaded_like(self.problem):
            return self
        follows = [i for i, c in enumerate(self.candidates) if c.hangs_on_torques]
        new = make_bank(problem, [self.candidates[i] for i in follows])
        target = np.concatenate([np.arange(self.slices[i].start, self.slices[i].stop) for i in follows] or [[]])
        lines = []
        for old, fresh in zip(self.lines, new.lines, strict=True):
            keep = ~np.isin(old.owner, target)
            lines.append(
                Lines(
                    np.concatenate([old.series[keep], fresh.series]),
                    np.concatenate([old.weights[keep], fresh.weights]),
                    np.concatenate([old.owner[keep], target.astype(int)[fresh.owner]]),
                    old.n_columns,
                )
            )
        return replace(self, lines=lines, problem=problem)


def make_bank(problem: Problem, candidates: Sequence[Candidate]) -> Bank:
    """Compute the columns of many candidates."""
    parts = [problem.reduce(candidate.columns) for candidate in candidates]
    first = np.cumsum([0, *[part[0].n_columns for part in parts]])
    runs = [Lines.join([part[r] for part in parts]) for r in range(len(problem.runs))] if parts else []
    shapes = Counter(c.key for c in candidates)
    weight = np.array([1 / (len(shapes) * shapes[c.key]) for c in candidates])
    slices = tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(first))
    return Bank(tuple(candidates), slices, runs, weight, problem)


@dataclass(frozen=True)
class WhiteBank:
    """A bank in one noise: whitened columns, their inner products, and these beside the rigid body.

    Attributes
    ----------
    W : ndarray, shape (n_columns, n_rows)
    full, left : ndarray, shape (n_columns,)
    wide : list of (ndarray of int, shape (n,), ndarray of int, shape (n, k), ndarray, shape (n, k, k))
        Candidates with k columns, two or more; their columns; the inner products of these.
    body : Body
    own : ndarray, shape (n_columns,)
        Inner products with what the rigid body leaves of the data.
    met : dict
        Inner products with the columns of effects that stood in a fit, shape (n_columns, k) each.
    """

    W: Vector
    full: Vector
    left: Vector
    wide: list[tuple[np.ndarray, np.ndarray, Vector]]
    body: Body
    own: Vector
    met: dict[Identity, Vector] = field(default_factory=dict)

    def scores(self, fit: Fit, bank: Bank) -> list[Score]:
        """Score every candidate against a fit in this noise."""
        inside, c = self._inside(fit)
        left = np.maximum(self.left - np.einsum("ij,ij->i", inside, inside), 0.0)
        alone = score_single(c, self.full, left)
        signs = [candidate.signs for candidate in bank.candidates]
        out = [single(alone, s.start, own) for s, own in zip(bank.slices, signs, strict=True)]
        for own, rows, grams in self.wide:
            grams = grams - np.einsum("nir,njr->nij", inside[rows], inside[rows])
            scores = score_wide(grams, c[rows], self.full[rows], left[rows], [signs[i] for i in own])
            for i, score in zip(own, scores, strict=True):
                out[i] = score
        return out

    def _inside(self, fit: Fit) -> tuple[Vector, Vector]:
        """Give the inner products with the basis of a fit's effects and with its residual.

        They follow from those with the effects' columns, of which each is computed once.
        """
        if fit.weights is None or fit.body is not self.body:
            return self.W @ fit.Q, self.W @ fit.residual
        self.meet([fit])
        parts = [np.zeros((len(self.W), 0)), *[self.met[candidate.identity] for candidate in fit.effects]]
        inside = np.concatenate(parts, axis=1) @ fit.weights
        return inside, self.own - inside @ (fit.Q.T @ self.body.residual)

    def meet(self, fits: Sequence[Fit]) -> None:
        """Compute the inner products with all effects of some fits that are not known yet, at once: that is quicker."""
        own = {c.identity: free for fit in fits for c, free in zip(fit.effects, fit.free, strict=True)}
        new = {identity: free for identity, free in own.items() if identity not in self.met}
        if new:
            ends = np.cumsum([len(free) for free in new.values()])[:-1]
            products = np.split(self.W @ np.concatenate([*new.values()]).T, ends, axis=1)
            self.met.update(zip(new, products, strict=True))


def whitened(bank: Bank, whitener: Whitener, segments: Sequence[Segments], body: Body) -> WhiteBank:
    """Whiten the columns of a bank, and take their inner products, also beside the rigid body."""
    W = whitener.lines(bank.lines, segments)
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
    return WhiteBank(W, full, left, wide, body, W @ body.residual)
