"""What a plain fit leaves over: its spectrum, its tones, and the noise clear of smooth functions of the state."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from .bank import all_candidates
from .candidates import Candidate
from .fit import Fit, least_squares
from .geometry import Vector
from .patches import TONE
from .recent import kept, lasting
from .search import Search, key_of
from .shapes import shape_slopes
from .spectra import Spectrum, spectrum, stands_out, tone_peaks, whitener_of
from .standstill import standing_places
from .whitening import Whitener, blanked, inside_of, log_p, put_back, quiet_segments

SHORT = 128
"""Samples of a stretch from which on lines are looked for in its spectrum."""
AT_REST, FEW = 1.5, 10
"""How many times their error in motion motors err along an axis at rest, from which on it holds; of so many samples."""
MORE = 1.2
"""How many times the squared error along the axis that errs most at rest two motors have there that hold each other."""
SUPPORT = 12.0
"""Degrees of freedom by which noise beside smooth functions is known at least; with fewer they are left out."""
OWN = 0.02
"""Share of the torque at a frequency that a disturbance there makes at least."""


def left_over(search: Search, effects: Sequence[Candidate], smooth: bool = True) -> tuple[list[Vector], Spectrum]:
    """Take a plain fit of rigid body and effects, with the smooth columns or without, from the data.

    Returns
    -------
    residuals : list of ndarray, shape (n_channels, n_reduced)
        One per run.
    noise : Spectrum
        Of what is left, free of what the columns took with them.
    """
    key, recent = key_of(effects), search.recent("left_over")
    known = recent.get(key, smooth)
    if known is not None:
        return known
    return recent.keep(_left_over(search, effects, smooth_columns(search) if smooth else None), key, smooth)


@kept
def loosely_left_over(search: Search, fit: Fit) -> Vector:
    """Give the rms of what a plain fit leaves over if the shapes of its effects give way, too, to first order."""
    slopes = [slope for c, b in zip(fit.effects, fit.beta, strict=True) for slope in shape_slopes(search, c, b)]
    if not slopes:
        return left_over(search, fit.effects, smooth=False)[1].rms
    return _left_over(search, fit.effects, [np.concatenate(own) for own in zip(*slopes, strict=True)])[1].rms


def _left_over(
    search: Search, effects: Sequence[Candidate], further: Sequence[Vector] | None
) -> tuple[list[Vector], Spectrum]:
    residuals, basis = plain_rest(search, effects, further)
    noise = spectrum(residuals, basis, quiet_segments(residuals, search.problem.segments))
    if further is not None and noise.dof.sum(axis=1).min() < SUPPORT:
        return _left_over(search, effects, None)
    return residuals, noise


def plain_rest(
    search: Search, effects: Sequence[Candidate], further: Sequence[Vector] | None
) -> tuple[list[Vector], list[Vector]]:
    """Give what a plain fit leaves over, and an orthonormal basis of its columns, per run."""
    own = [search.columns(c) for c in effects]
    banks = []
    for r, states in enumerate(search.problem.states):
        parts = [search.rigid[r], states, *[columns[r] for columns in own]]
        if further is not None:
            parts.append(further[r])
        banks.append(np.concatenate([*parts, search.nominal[r][None]]))
    ends = [bank.shape[2] for bank in banks]
    for r, run in enumerate(search.problem.segments):  # there are many columns: no more copies than one at a time
        banks[r] = inside_of(blanked(banks[r], run), run)
    shapes = [bank.shape[1:] for bank in banks]
    W = np.concatenate([b.reshape(len(b), -1) for b in banks], axis=1)
    level = np.concatenate([np.repeat(1 / np.diag(search.plain.mix), n) for _, n in shapes])
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
    for shape, run, n in zip(shapes, search.problem.segments, ends, strict=True):
        size = shape[0] * shape[1]
        residuals.append(put_back(rest[None, first : first + size].reshape(1, *shape), run, n)[0])
        basis.append(put_back(Q[:, first : first + size].reshape(len(Q), *shape), run, n))
        first += size
    return residuals, basis


def holding_axes(search: Search) -> frozenset[int]:
    """Tell which coordinates that rest now and then err far more while they do, as where friction holds what is left.

    Motors err by what rigid body and what most machines have leave over, in units of their error where nothing rests
    that they feel. What errs most along itself at rest comes first, two motors along the direction in which they do if
    that is clearly more; the fit of what is judged then shows the next. Where nothing rubs, none does, and all samples
    tell.
    """
    problem, m, runs = search.problem, search.problem.model.n_motors, search.problem.segments
    common = [search.columns(c) for c in search.common]
    banks = [
        np.concatenate([y[None], Y, *own]) for y, Y, *own in zip(search.nominal, search.rigid, *common, strict=True)
    ]
    y, *W = np.concatenate([inside_of(bank[:, :m], run) for bank, run in zip(banks, runs, strict=True)], axis=2)
    columns = np.array(W)

    def judged_but(axes: frozenset[int]) -> np.ndarray:
        there = problem.judged_without(axes)
        live = [
            np.ones((m, data.shape[2]), bool) if run.judged is None else run.judged
            for data, run in zip(problem.data, there.runs, strict=True)
        ]
        return np.concatenate([inside_of(x, run) for x, run in zip(live, runs, strict=True)], axis=1)

    def errors_and_freedom(live: np.ndarray, size: Vector) -> tuple[Vector, Vector]:
        weight = live / size[:, None]
        theta, U, _ = least_squares((columns * weight).reshape(len(columns), -1), (y * weight).reshape(-1))
        taken = np.sum(U.reshape(m, -1, U.shape[1]) ** 2, axis=(1, 2))
        return y - np.tensordot(theta, columns, 1), np.maximum(live.sum(axis=1) - taken, 1.0)

    moving = judged_but(problem.resting)
    e, freedom = errors_and_freedom(moving, 1.0 / np.diag(search.plain.mix)[:m])
    size = np.sqrt(np.sum((e * moving) ** 2, axis=1) / freedom)
    resting = {k: ~judged_but(frozenset({k})).all(axis=0) for k in problem.resting}
    places = standing_places(problem.model)
    along = {k: places[k].weights(problem.model) / size for k in problem.resting}
    pairs = frozenset(k for k in problem.resting if places[k].is_pair)

    def at_rest(k: int, live: np.ndarray) -> np.ndarray:
        return np.logical_and(resting[k], live[along[k] != 0.0].all(axis=0))

    def power_of(k: int, z: Vector, there: np.ndarray) -> float:
        felt = along[k] != 0.0
        mean = z[felt][:, there] @ z[felt][:, there].T / there.sum()
        unit = along[k][felt] / np.linalg.norm(along[k])
        return float(np.linalg.eigvalsh(mean)[-1] if k in pairs else unit @ mean @ unit)

    def worst(among: Iterable[int], z: Vector, live: np.ndarray) -> tuple[float, int]:
        rests = ((k, at_rest(k, live)) for k in among)
        return max([(0.0, -1), *((power_of(k, z, there), k) for k, there in rests if there.sum() >= FEW)])

    holding: frozenset[int] = frozenset()
    while True:
        live = judged_but(holding)
        z = errors_and_freedom(live, size)[0] / size[:, None]
        power, k = worst(problem.resting - pairs - holding, z, live)
        both, pair = worst(pairs - holding, z, live)
        if both > MORE * power and (k < 0 or both > MORE * power_of(k, z, at_rest(pair, live))):
            power, k = both, pair
        if power < AT_REST**2:
            return holding
        holding |= {k}


def clear_noise(search: Search, effects: Sequence[Candidate]) -> Whitener:
    """Estimate the noise with smooth functions of the state taken out beside `effects`, if these leave any over."""
    key, recent = key_of(effects), search.recent("clear_noise", 256)
    known = recent.get(key)
    if known is None:
        rest, noise = left_over(search, effects)
        rough = left_over(search, effects, smooth=False)[1]
        if stands_out(rough, noise):
            quiet = quiet_segments(rest, search.problem.segments)
            known = whitener_of(noise, rest, quiet, search.settings.order, search.problem.blocks)
        else:
            known = search.noise(effects)
        recent.keep(known, key)
    return known


def follows_state(search: Search, fit: Fit, alarm: float = 1e-6) -> bool:
    """Whether smooth functions of the state explain more of what a fit leaves over than slow noise would."""
    W = search.white(fit.whitener, smooth_columns(search))
    size = np.linalg.norm(W, axis=1)
    free = fit.rest(W[size > 0] / size[size > 0, None])
    values, vectors = np.linalg.eigh(free @ free.T)
    keep = values > 1e-6
    drop = float(np.sum((vectors[:, keep].T @ (free @ fit.residual)) ** 2 / values[keep]))
    return log_p(drop, int(keep.sum())) < np.log(alarm)


@lasting
def smooth_columns(search: Search) -> list[Vector]:
    """Columns of common effects and of smooth functions of position, speed and direction, per run."""
    names = ("unnamed_position", "unnamed_rub", "unnamed_velocity")
    if search.problem.kinematic:
        names += (
            "cable_elasticity",
            "backlash",
            "transmission_ratio_error",
            "pulley_eccentricity",
            "encoder_offset",
        )
    candidates = [*search.common, *all_candidates(search.problem, names), *tones(search, [c for c, _ in search.swung])]
    parts = [search.columns(c) for c in candidates]
    own = _unshared(search)
    return [np.concatenate([own[r], *[columns[r] for columns in parts]]) for r in range(len(search.rigid))]


def _unshared(search: Search) -> list[Vector]:
    """Columns of the rigid body with parameters of their own for every motor, and their rates of change, per run.

    Wrong gains, ratios, angles and delays part the motors' parameters from each other.
    """
    m = search.problem.model.n_motors
    if not search.problem.torque:
        return [np.zeros((0, *rigid.shape[1:])) for rigid in search.rigid]
    out = []
    bodies = [rigid[: search.n_bodies] for rigid in search.rigid]
    there = np.any([rigid.any(axis=2) for rigid in bodies], axis=0)
    for rigid in bodies:
        parts = []
        for i in range(m):
            own = np.zeros_like(rigid[there[:, i]])
            own[:, i] = rigid[there[:, i], i]
            parts += [own, np.gradient(own, axis=2)] if m < 5 else [own]
        out.append(np.concatenate(parts))
    return out


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
    rest = left_over(search, effects, smooth=False)[0]
    for e, data, run in zip(rest, problem.data, problem.segments, strict=True):
        start, stop = max(run, key=lambda s: s[1] - s[0], default=(0, 0))
        n = stop - start
        if n < SHORT:
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
    return tones_at(search, best)


def tones_at(search: Search, frequencies: Sequence[float]) -> list[Candidate]:
    """Give candidates for disturbances at every place with given frequencies of their own [Hz]."""
    return [Candidate(TONE, place, (f,)) for f in frequencies for place in TONE.places(search.problem.model)]
