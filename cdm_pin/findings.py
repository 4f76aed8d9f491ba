"""From a search's result to findings: parameters with intervals, rivals, identities, hold-out, sensitivities."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from itertools import zip_longest
from typing import Any

import numpy as np
from scipy.optimize import brentq

from .candidates import SWUNG, Candidate, coupled_alike, shares_motor, twins
from .doubts import error_of, errors_of_laws
from .drifting import own_drifts
from .effect import Columns, Effect
from .effects import CATALOGUE, MAPS
from .explanation import Explanation, Found
from .fit import Fit, own_covariance
from .friction_effects import peaks_by_its_sign
from .geometry import Vector
from .leaders import POSTURE
from .likelihood import evidence, likeliest
from .model import CableModel
from .motion import Motion
from .parts import Part, parts_of
from .patches import MISREAD
from .places import kinds_of, parallel
from .recent import kept
from .search import Search, brought, rms
from .shapes import refine, shape_slopes
from .significance import is_loud
from .units import unit_at
from .unseen import beside, loosened, stacked
from .whitening import log_p

Location = dict[str, Any]

EVIDENT_PEAK = 3.0
"""Errors of a peak of friction near standstill, up to which it is none."""


@kept
def _all_columns(search: Search, fit: Fit) -> tuple[list[Vector], list[list[list[Vector]]]]:
    """Give the columns of base parameters, coefficients and shapes per run; the derivatives by the shapes, too."""
    own = [search.columns(c) for c in fit.effects]
    slopes = [shape_slopes(search, c, b) for c, b in zip(fit.effects, fit.beta, strict=True)]
    banks = []
    for r in range(len(search.rigid)):
        parts = [search.rigid[r]]
        for columns, slope in zip(own, slopes, strict=True):
            parts += [columns[r], *[s[r] for s in slope]]
        banks.append(np.concatenate(parts))
    return banks, slopes


def joint_covariance(search: Search, fit: Fit) -> tuple[Vector, tuple[np.ndarray, ...]]:
    """Covariance of base parameters, coefficients and shapes together (Gauss-Newton).

    Returns
    -------
    covariance : ndarray
    where : tuple of ndarray of int
        Where each effect's coefficients and then its shape stand.
    """
    banks, slopes = _all_columns(search, fit)
    covariance = _covariance(search.white(fit.whitener, banks))
    start, where = search.n_rigid, []
    for slope, b in zip(slopes, fit.beta, strict=True):
        where.append(np.arange(start, start + len(b) + len(slope)))
        start += len(b) + len(slope)
    return covariance, tuple(where)


def _covariance(W: Vector) -> Vector:
    """Covariance of coefficients of whitened rows, shape (k, n)."""
    scale = np.linalg.norm(W, axis=1)
    scale[scale == 0] = np.inf
    information = (W / scale[:, None]) @ (W / scale[:, None]).T
    return np.linalg.pinv(information, rcond=1e-9, hermitian=True) / scale[:, None] / scale


def unseen_step(judge: Search, fit: Fit, seen: Search | None = None) -> tuple[Vector, Vector]:
    """Give by how much unseen recordings alone would change all parameters of a fit, and with what covariance.

    One Gauss-Newton step, beside drifting zeros; parameters stand as in `joint_covariance`. If they are rows of
    recordings that a search has `seen`, its columns are theirs.
    """
    banks = _all_columns(seen or judge, fit)[0]
    W, drifts, rest = (judge.white(fit.whitener, x) for x in (banks, own_drifts(judge), stacked(judge, fit)))
    W, rest = beside(drifts, W, rest[0])
    covariance = _covariance(W)
    return covariance @ (W @ rest), covariance


def unseen_shift(judge: Search, fit: Fit, covariance: Vector, where: Sequence[np.ndarray]) -> tuple[Vector, Vector]:
    """Give by how far apart unseen and training recordings see all parameters, and with what covariance by chance.

    That is twice what the unseen ones would change beside the training ones: the difference of the two where either
    tells as much, and less where unseen recordings alone hardly tell a parameter. What laws leave open is `loosened`.

    Parameters
    ----------
    judge : Search
    fit : Fit
    covariance, where : ndarray, sequence of ndarray of int
        Of all parameters by the training recordings, and where each effect's stand (`joint_covariance`).
    """
    covariance = loosened(fit, covariance, where)
    step, unseen = unseen_step(judge, fit)
    there = np.flatnonzero(np.diag(unseen) > 0.0)
    block = np.ix_(there, there)
    scale = np.sqrt(np.diag(covariance)[there] + np.diag(unseen)[there])
    both = (covariance + unseen)[block] / scale / scale[:, None]
    share = (covariance[block] / scale) @ np.linalg.pinv(both, rcond=1e-12, hermitian=True) / scale
    shift, chance = np.zeros_like(step), np.zeros_like(covariance)
    shift[there] = 2.0 * share @ step[there]
    chance[block] = 4.0 * share @ covariance[block]
    return shift, chance


def shifts_apart(search: Search, fit: Fit) -> list[tuple[Part, Vector, Vector]]:
    """Give by how far from all others each part of the recordings sees all parameters, and with what covariance."""
    out = []
    for part in parts_of(search):
        (own, chance), (rest, other) = (unseen_step(rows, fit, search) for rows in (part.own, part.others))
        out.append((part, own - rest, chance + other))
    return out


def with_scatter(
    candidate: Candidate, beta: Vector, step: Vector, covariance: Vector, values: dict[str, dict[str, Any]]
) -> dict[str, dict[str, Any]]:
    """Widen standard errors by how far apart training and unseen recordings see a parameter, beyond chance.

    Parameters
    ----------
    candidate : Candidate
    beta : ndarray, shape (k,)
    step : ndarray, shape (k + m,)
        By how much unseen recordings would change coefficients and the first m elements of the shape.
    covariance : ndarray, shape (k + m, k + m)
        Of that.
    values : dict
        Parameters as estimated.
    """
    out = {}
    for name, (far, near) in _shifts(candidate, beta, step, covariance).items():
        v = values[name]
        more = np.sqrt(far**2 - near**2) if far > SCATTER * near else 0.0
        out[name] = v | {"std": float(np.hypot(v["std"], more))}
    return out


def stribeck_of(fit: Fit) -> list[int]:
    """List the effects of a fit that are friction which peaks near standstill."""
    return [j for j, c in enumerate(fit.effects) if c.effect.name == "stribeck_friction"]


def unsure_peaks(search: Search, judge: Search, fit: Fit, least: float = EVIDENT_PEAK) -> list[int]:
    """List where friction peaks near standstill by no more than so many errors, training and unseen ones together."""
    peaks = stribeck_of(fit)
    if not peaks or not any(judge.problem.segments):
        return []
    covariance, where = joint_covariance(search, fit)
    step, chance = unseen_shift(judge, fit, covariance, where)
    unsure = []
    for j in peaks:
        own, candidate, beta = where[j], fit.effects[j], fit.beta[j]
        values = parameters(candidate, beta, covariance[np.ix_(own, own)])
        peak = with_scatter(candidate, beta, step[own], chance[np.ix_(own, own)], values)["stribeck"]
        if peak["value"] < least * peak["std"]:
            unsure.append(j)
    return unsure


def is_another_there(
    search: Search,
    judge: Search,
    fit: Fit,
    j: int,
    step: Vector,
    covariance: Vector,
    values: dict[str, dict[str, Any]],
) -> bool:
    """Whether unseen recordings tell another size of effect `j` than the training, far beyond chance.

    What a law is off by does not make it a good part larger; where that depends on the recording it is another law. One
    of its parameters may be far off where that changes little of its torque, such as the damping of a stiff cable.
    Its shape may be hard to tell in either: both are asked for the sizes that they see with the one of the unseen. What
    rubs and often stands still has no size that can be told so.

    Parameters
    ----------
    search, judge : Search
    fit : Fit
    j : int
    step, covariance, values
        As `with_scatter` takes them.
    """
    candidate, far = fit.effects[j], []
    shifts = _shifts(candidate, fit.beta[j], step, covariance)
    for name, size in _sizes({name: v["value"] for name, v in values.items()}).items():
        apart, chance = shifts[name]
        if min(abs(size), apart) > CERTAIN * chance > 0.0 and apart > UNLIKE * abs(size):
            far.append(name)
    if not far or max(held(there, candidate) for there in (search, judge)) > HELD:
        return False
    law, beta = candidate, (fit.beta[j], fit.beta[j] + step[: len(fit.beta[j])])
    if candidate.extra:
        others = [there.without(fit, j) for there in (search, judge)]
        law = refine(judge, others[1], candidate)[0]
        beta = [there.score(beside, law).beta for there, beside in zip((search, judge), others, strict=True)]
    W = judge.white(fit.whitener, judge.columns(law))
    return bool(np.linalg.norm((beta[1] - beta[0]) @ W) > UNLIKE * np.linalg.norm(beta[0] @ W))


def held(search: Search, candidate: Candidate) -> float:
    """Give the share of the time in which what rubs stands still while the rest may move: friction is then anything."""
    if not candidate.effect.name.endswith("_friction"):
        return 0.0
    own, speeds = candidate.place.weights(search.problem.model) != 0.0, []
    for run in search.problem.runs:
        speed = candidate.place.along(run.motion.joint_speeds, run.motion.v_m)
        if run.judged is not None:
            speed = speed[np.repeat(run.judged[own].any(axis=0), search.problem.band.step)[: len(speed)]]
        speeds.append(speed)
    v = np.abs(np.concatenate(speeds))
    return float(np.mean(v < STILL * np.sqrt(np.mean(v**2))))


def _shifts(candidate: Candidate, beta: Vector, step: Vector, covariance: Vector) -> dict[str, tuple[float, float]]:
    """Give by how much a step moves each parameter, and by how much chance does, whose covariance of steps is given."""
    apart, chance = (parameters(candidate, beta, x) for x in (np.outer(step, step), covariance))
    return {name: (v["std"], chance[name]["std"]) for name, v in apart.items()}


def _sizes(values: dict[str, float]) -> dict[str, float]:
    """Give the parameters that say how large an effect is, a gain by what it is off one."""
    return {name: value - (name == "gain") for name, value in values.items() if name not in SHAPES}


def stiffening(search: Search, fit: Fit, j: int, covariance: Vector) -> Vector:
    """Covariance of all parameters that a cubic term of spring `j`, taken to be linear, would bring.

    It may be as large as the linear term at the end of the range, less as far as the data see it.
    """
    W = search.white(fit.whitener, _all_columns(search, fit)[0])
    candidate, beta = fit.effects[j], fit.beta[j]
    rest = beta[1] / beta[0]

    def cubic(motion: Motion) -> Columns:
        s = candidate.place.along(motion.q, motion.q_m) - rest
        return Columns(along=(s[None] ** 3, candidate.place.weights(motion.model)))

    far = max(float(np.abs(candidate.place.along(m.q, m.q_m) - rest).max()) for m in search.problem.motions)
    w = search.white(fit.whitener, search.in_band(cubic))[0]
    change = covariance @ (W @ w)
    unseen = w - change @ W
    return np.outer(change, change) / (unseen @ unseen + (far**2 / beta[0]) ** 2)


def with_law_errors(
    search: Search, fit: Fit, j: int, covariance: Vector, index: np.ndarray, values: dict[str, dict[str, Any]]
) -> dict[str, dict[str, Any]]:
    """Add to the standard errors of effect `j` by how much parameters may be wrong because their laws are.

    Clocks, derivatives and filters leave no parameter better known than a share of itself.

    Parameters
    ----------
    search : Search
    fit : Fit
    j : int
    covariance : ndarray
        Of all parameters (`joint_covariance`).
    index : ndarray of int
        Where those of the effect stand.
    values : dict
        Parameters as estimated.
    """
    candidate = fit.effects[j]
    if candidate.effect.name == "joint_spring" and len(fit.beta[j]) == 2:
        whole = covariance + stiffening(search, fit, j, covariance)
        values = parameters(candidate, fit.beta[j], whole[np.ix_(index, index)])
    seen = search.problem.kinematic
    more = candidate.effect.errors(candidate.place, candidate.shape)
    shares = {
        p.name: max(p.error if seen else p.error_unseen, LEAST) + more.get(p.name, 0.0)
        for p in candidate.effect.parameters
    }
    if candidate.is_swinging(search.problem.motions[0]):
        shares["stiffness"] = SWUNG
    shares |= dict.fromkeys(("phase", "start", "end"), 0.0)  # these count from an origin of no meaning
    return {
        name: v | {"std": float(np.hypot(v["std"], shares.get(name, 0.0) * v["value"]))} for name, v in values.items()
    }


def parameters(candidate: Candidate, beta: Vector, covariance: Vector) -> dict[str, dict[str, Any]]:
    """Physical parameters with standard errors (delta method).

    What a cable gives lags by its damping over its stiffness, and so does any chain of measurement.

    Parameters
    ----------
    candidate : Candidate
    beta : ndarray, shape (k,)
    covariance : ndarray, shape (k + m, k + m)
        Of coefficients and the first m elements of the shape; the others are given.
    """
    x = np.concatenate([beta, candidate.shape])
    k, m = len(beta), len(covariance)

    def physical(x: Vector) -> dict[str, float]:
        return candidate.effect.physical(x[:k], tuple(x[k:]))

    values = physical(x)
    slopes = {name: np.zeros(m) for name in values}
    for i in range(m):
        h = 1e-5 * max(abs(x[i]), np.sqrt(max(covariance[i, i], 0.0)), 1e-9)
        up, down = x.copy(), x.copy()
        up[i] += h
        down[i] -= h
        high, low = physical(up), physical(down)
        for name in values:
            difference = high[name] - low[name]
            if name == "phase":
                difference = (difference + np.pi) % (2 * np.pi) - np.pi
            slopes[name][i] = difference / (2 * h)
    units = {p.name: p.unit for p in candidate.effect.parameters}
    if candidate.remembers_tension:
        units["stiffness"] = "1"  # N m per N m
    out = {}
    for name, value in values.items():
        g = np.nan_to_num(slopes[name])
        std = float(np.sqrt(max(g @ covariance @ g, 0.0)))
        out[name] = {"value": float(value), "std": std, "unit": units.get(name, "1")}
    if {"damping", "stiffness"} <= out.keys() and np.isfinite(values["stiffness"]):  # what is late looks like it
        out["damping"]["std"] = float(np.hypot(out["damping"]["std"], PROMPT * values["stiffness"]))
    return out


STILL_DRY = ("coulomb_friction", "cable_friction", "capstan_friction")
"""What is the same dry friction, on this arm and at one pretension."""
EQUAL = 0.9999
"""Canonical correlation of dry friction with what is dry friction on these data."""
ROUNDED = ("encoder_offset", "backlash")
"""What encoders that round may look like."""
STILL, HELD = 0.02, 0.1
"""Share of its rms below which a speed is none, and of the time from which on standstill spoils a size of friction."""
PROMPT = 1.0e-3
"""Delay [s] that any chain of measurement has."""
BEYOND, BRIEF = 0.9, 0.05
"""Share of a play's half from which on a cable lies on a side of it, and of the time for which it does in passing."""
ROUNDS = 0.03
"""Share of a step (rms) that rounding may bring where encoders move through many of them."""
LISTED = 5.0
"""Difference of log-likelihood below which a rival is listed: noise spectra are estimates, small sums lean on them."""
DOUBTED = 0.25
"""Share of an effect's statistic by which a rival may be less likely, up to which errors of other laws may hide it."""
ALIKE = 0.7
"""Cosine of what two effects explain from which on they explain the same error."""
OF_STIFFNESS = ("cable_elasticity", "cable_slack")
"""Effects whose amplitude is what a soft cable holds, not how much it gives."""
HIDDEN = 0.3
"""Share that is left over of an effect of which it is said what takes the rest."""
TRIFLE = 0.05
"""Share of a law's torque by which a more general law has to differ to be another one."""
LARGE = 0.25
"""Share of a law's torque below which the data must hold a more general law to, for it to be left out."""
UNSEEN = 4.0
"""Whitened sum of squares of a difference that no data show."""
LEAST = 0.002
"""Relative accuracy beyond which no parameter is known."""
NEARLY = 0.9
"""Cosine of the motors' torques from which on two places are not told apart beside what has no name."""
FALL = 0.75
"""Weight of coefficients, in their errors, at the time constant or period that suits best: there is a choice."""
SCATTER = 2.0
"""Standard errors by which training and unseen recordings differ by chance."""
OUTWEIGHS = 10.0
"""How many times what has no name a finding has to explain to stand on its own beside it, wherever it is."""
CERTAIN, UNLIKE = 6.0, 0.15
"""Standard errors, and share of itself, by which no parameter of a law that holds in all recordings differs in some."""
REFINED = {
    "stribeck_friction": "stribeck",
    "position_dependent_friction": "depth",
    "friction_drift": "extra",
}
"""By which parameter a law is more than dry friction."""
SHAPES = (
    "phase",
    "cycles",
    "form",
    "links_only",
    "with_rotor",
    "motor_only",
    "ratio",
    "stribeck_velocity",
    "time_constant",
    "rest",
    "start",
    "end",
    "recording",
)
"""Parameters that say what an effect looks like, not how large it is."""


def unsized(explanation: Explanation) -> list[int]:
    """List the findings with a name of which no parameter that says how large they are is known (`is_known`).

    Nor is one that is no such law as it was found, or a loud one whose parameters no such law has.
    """
    fit, out = explanation.fit, []
    covariance, where = joint_covariance(explanation.search, fit)
    for j, found in enumerate(explanation.found):
        candidate, spread = found.candidate, covariance[np.ix_(where[j], where[j])]
        values = parameters(candidate, fit.beta[j], spread)
        sized = is_known(values, candidate, fit.beta[j], spread) and is_lawful(fit, j)
        if candidate.named and (is_odd(found, values) or not sized):
            out.append(j)
    return out


def is_odd(found: Found, values: dict[str, dict[str, Any]]) -> bool:
    """Whether a finding is loud and has parameters that no such law has."""
    return is_loud(found.score) and not is_admissible(found.candidate.effect, values)


def is_lawful(fit: Fit, j: int) -> bool:
    """Whether effect `j` of a fit is no peak of friction at standstill on next to none while it slides."""
    candidate = fit.effects[j]
    return candidate.effect.name != "stribeck_friction" or candidate.is_plausible(fit.beta[j])


def is_known(
    values: dict[str, dict[str, Any]], candidate: Candidate, beta: Vector, covariance: Vector, least: float = 3.0
) -> bool:
    """Whether any parameter that says how large an effect is, or any coefficient, differs from zero (a gain from one).

    Two effects at one place may share a level that neither has alone; what tells them apart is known all the same. The
    coefficients of a spring that stiffens are those of a polynomial, which are known together where none is alone; so
    are the two of a friction that falls as slowly as a recording lasts. Of one whose level is known that has to be by
    which it falls, if only at the time constant that suits it best, and of one that varies with position that is enough
    by which it varies, at the period that suits it best; a coupling has to have a ratio that is known.
    """
    ratio = values.get("ratio") if candidate.effect.name == "transmission_coupling" else None
    if ratio is not None and abs(ratio["value"]) <= least * ratio["std"]:  # with which joint, then?
        return False
    sizes, k = sizes_in_errors(values), len(beta)
    std = np.sqrt(np.maximum(np.diag(covariance)[:k], 1e-300))
    z = beta / std
    own, n = z[: len(candidate.effect.signs)], 0  # without what details the sign of a velocity; as many known together
    if candidate.effect.name == "joint_spring":
        own, n = (own, k) if k > 2 else (z[:1], 0)  # a constant torque is none
    if candidate.effect.name == "friction_drift":
        n, sizes = 0 if abs(z[0]) > least else len(own), {"extra": sizes["extra"]}
        own = own[1:] if n else np.r_[own[1:], np.sqrt(_at_best(beta, covariance, [1]))]
    if max([*sizes.values(), *np.abs(own)], default=0.0) > least:
        return True
    if candidate.effect.name == "position_dependent_friction":
        return log_p(_at_best(beta, covariance, [1, 2]), 2) < log_p(least**2, 1)
    together = np.linalg.pinv(covariance[:n, :n] / std[:n, None] / std[:n], rcond=1e-9, hermitian=True)
    return n > 0 and bool(log_p(float(z[:n] @ together @ z[:n]), n) < log_p(least**2, 1))


def _at_best(beta: Vector, covariance: Vector, which: Sequence[int]) -> float:
    """Give the statistic of some coefficients where the shape is what suits best, less for having been chosen."""
    k = len(beta)
    across = covariance[:k, k:]
    given = covariance[:k, :k] - across @ np.linalg.pinv(covariance[k:, k:], hermitian=True) @ across.T
    own = beta[which]
    return FALL**2 * float(own @ np.linalg.pinv(given[np.ix_(which, which)], hermitian=True) @ own)


def sizes_in_errors(values: dict[str, dict[str, Any]]) -> dict[str, float]:
    """Give the parameters that say how large an effect is (a gain from one) in units of their standard errors."""
    sizes = _sizes({name: v["value"] for name, v in values.items()})
    return {name: abs(size) / max(values[name]["std"], 1e-300) for name, size in sizes.items()}


def most_sure(name: str, values: dict[str, dict[str, Any]]) -> float:
    """Give the size of an effect that is known best, in its errors; of what refines dry friction that which does so."""
    sizes = sizes_in_errors(values)
    return sizes[REFINED[name]] if name in REFINED else max(sizes.values(), default=np.inf)


def is_above_steps(search: Search, candidate: Candidate, values: dict[str, dict[str, Any]]) -> bool:
    """Whether an encoder's offset, or a play, is more than the encoders that were logged have, as they round.

    Encoders on both sides of a play show less: it follows the load, no rounding does (`doubts.lags`). A wrong map moves
    them through many steps, which round to either side; but not alike, where a motion is over again.
    """
    if candidate.effect.name in MAPS and search.problem.kinematic:
        beta = candidate.effect.coefficients({name: v["value"] for name, v in values.items()})[0]
        return largest_travel(search, candidate, beta) > ROUNDS * search.problem.steps_at(candidate.place.index[-1])
    if not _looks_rounded(search, candidate):
        return True
    size = values[candidate.effect.size.name]
    return abs(size["value"]) > 0.5 * search.problem.steps_at(candidate.place.index[0]) + 3 * size["std"]


def largest_travel(search: Search, candidate: Candidate, beta: Vector) -> float:
    """Give the largest travel between encoders (rms) that the first coefficients of an effect make."""
    travel = brought(search, candidate, beta)
    return float(rms(search, travel)[-search.problem.model.n_motors :].max())


def _looks_rounded(search: Search, candidate: Candidate) -> bool:
    """Whether encoders that round may look like an effect of this kind."""
    name = candidate.effect.name
    return name in ROUNDED and not (name == "backlash" and search.problem.kinematic)


def confused_plays(search: Search, explanation: Explanation) -> dict[int, int]:
    """Give the encoders' offsets that may be part of a play of the same cable, by their number, with that of the play.

    The two are told apart by how far the cable goes on either side, and brief visits to one do not show the whole way.
    """
    plays = {c.place.index[0]: k for k, c in enumerate(explanation.fit.effects) if c.effect.name == "backlash"}
    out = {}
    for j, own in enumerate(explanation.fit.effects):
        i = own.place.index[-1] if own.place.index else -1
        if own.effect.name == "encoder_offset" and search.problem.kinematic and i in plays:
            width = explanation.fit.effects[plays[i]].shape[0]
            sides = np.concatenate([np.tanh(motion.cable_torque[:, i] / width) for motion in search.problem.motions])
            if min(np.mean(sides > BEYOND), np.mean(sides < -BEYOND)) < BRIEF:
                out[j] = plays[i]
    return out


def is_late(candidate: Candidate, values: dict[str, dict[str, Any]]) -> bool:
    """Whether a delay is more than the filters of drives and sensors have, which are no fault; of others, always."""
    return candidate.effect.name != "time_delay" or abs(values["delay"]["value"]) > PROMPT


def is_admissible(effect: Effect, values: dict[str, dict[str, Any]]) -> bool:
    """Whether no parameter lies outside its physical range by more than three standard errors, and none is infinite."""
    for parameter in effect.parameters:
        if parameter.name not in values:
            continue
        value, std = values[parameter.name]["value"], values[parameter.name]["std"]
        if not np.isfinite(value) or value < parameter.lower - 3 * std or value > parameter.upper + 3 * std:
            return False
    return True


def canonical_correlation(search: Search, without: Fit, a: Candidate, b: Candidate) -> float:
    """Smallest canonical correlation of two effects, as far as a fit leaves them over (0 if their sizes differ)."""
    bases = []
    for candidate in (a, b):
        W = search.white(without.whitener, search.columns(candidate))
        perp = without.rest(W).T
        norms = np.linalg.norm(perp, axis=0)
        if not norms.any():
            return 0.0
        U, s, _ = np.linalg.svd(perp / np.where(norms > 0, norms, 1.0), full_matrices=False)
        bases.append(U[:, s > 1e-4 * s[0]])
    if bases[0].shape[1] != bases[1].shape[1]:
        return 0.0
    return float(np.linalg.svd(bases[0].T @ bases[1], compute_uv=False)[-1])


def same_elsewhere(search: Search, explanation: Explanation, j: int) -> list[Location]:
    """List where finding `j` is the same for any motion: at what turns alike, unless an error of its map is found."""
    own, model = explanation.found[j].candidate, search.problem.model
    if any(_parts(c) and shares_motor(own, c, model) for c in explanation.fit.effects):
        return []
    return [dict(twin.location) for twin in twins(own, model)]


def _parts(candidate: Candidate) -> bool:
    """Whether a joint and its motor do not turn at one ratio where this is found."""
    stretches = candidate.effect.moves is not None and candidate.location["kind"] == "cable"
    return stretches or candidate.effect.name in MAPS


def indistinguishable(search: Search, explanation: Explanation, j: int) -> list[dict[str, Any]]:
    """List what the data cannot tell from finding `j`: at most three others, the likeliest first."""
    found = explanation.found[j]
    effect, settings = found.candidate.effect, search.settings
    others = [f.candidate for i, f in enumerate(explanation.found) if i != j]
    without = search.fit(others, explanation.fit.whitener)
    out: list[dict[str, Any]] = []

    def add(effect: str, place: Location) -> None:
        entry = {"effect": effect, "location": dict(place)}
        if len(out) < 3 and entry not in out:
            out.append(entry)

    kinds = kinds_of(effect.places, search.problem.model)
    for twin in same_elsewhere(search, explanation, j):
        add(effect.name, twin)
    close = settings.within(found.score.statistic, least=LISTED)
    off = 0.5 * effect.error**2 * found.score.statistic  # what its own law may be wrong by
    rubs = effect.name == "coulomb_friction"
    alike: list[Candidate] = []
    further: list[Candidate] = []
    elsewhere: list[Candidate] = []
    bare = refine(search, without, found.candidate.bare)[0] if found.candidate.detail else found.candidate
    for rival, difference in _leaning(search, without, found):
        own = found.candidate if rival.detail else bare
        trifle = difference < max(close, off) and is_plainer(search, without, own, rival)
        within = difference > -close and not trifle
        if not (within or trifle) and -difference < DOUBTED * found.score.statistic:
            within = -difference < between_errors_of_laws(search, without, own, rival)
        if not within and difference <= -0.1 * found.gain - 30:
            continue
        asked = rubs or not within
        likeness = canonical_correlation(search, without, own, rival) if asked else 0.0
        if within or likeness > settings.same:
            same = rubs and (likeness > EQUAL or (1.0 - likeness**2) * found.score.statistic < UNSEEN)
            if same and rival.effect.name in STILL_DRY:
                elsewhere.append(rival)
            else:
                (alike if likeness > settings.same else further).append(rival)
    by_turns = [rival for pair in zip_longest(alike, further) for rival in pair if rival is not None]
    for rival in (*by_turns, *elsewhere):
        add(rival.name, rival.location)
    for play in _uncrossed(search, explanation, without, found) if effect.name in POSTURE else ():
        add(play.effect.name, play.location)
    for alias in found.candidate.place.aliases:
        if alias["kind"] == "cable" and effect.name == "coulomb_friction":
            add("cable_friction", alias)
        elif alias["kind"] in kinds - {"cable"}:
            add(effect.name, alias)
    for other in coupled_alike(search.problem.model, found.candidate):
        add("transmission_coupling", other)
    return out


def between_errors_of_laws(search: Search, without: Fit, own: Candidate, rival: Candidate) -> float:
    """Bound by how much log-likelihood errors of laws may set one effect before another in its place.

    Those of the laws in a fit, and of a rival of fewer coefficients, may take any sign at any sample, as in
    `from_errors_of_laws`, where what the two explain differs. Two that explain unlike parts of an error are no rivals,
    however much either explains.
    """
    betas = [search.score(without, c).beta for c in (own, rival)]
    rows = [search.white(without.whitener, search.columns(c)) for c in (own, rival)]
    a, b = (beta @ without.rest(W) for beta, W in zip(betas, rows, strict=True))
    if a @ b < ALIKE * np.linalg.norm(a) * np.linalg.norm(b):
        return 0.0
    errors = errors_of_laws(search, without)
    if search.size(rival) < search.size(own):
        errors = errors + error_of(search, rival, betas[1], without)
    return float(np.abs(a - b) @ errors)


def is_plainer(search: Search, without: Fit, own: Candidate, rival: Candidate) -> bool:
    """Whether an effect is a rival's special case, and what the rival has beyond it can be no more than a trifle.

    As a friction whose two directions differ by a per cent is dry friction; it has more coefficients, therefore.
    """
    if own.location != rival.location or search.size(rival) <= search.size(own):
        return False
    scores = [search.score(without, candidate) for candidate in (own, rival)]
    if rival.effect.name == "stribeck_friction" and peaks_by_its_sign(scores[0].beta, own.shape, own.detail):
        return False
    ours, theirs = (search.white(without.whitener, search.columns(candidate)) for candidate in (own, rival))
    torque = scores[0].beta @ ours
    size = float(np.linalg.norm(torque))
    if np.linalg.norm(torque - _spanned(theirs, torque[None])[0]) > TRIFLE * size:
        return False
    _, scale, beyond = np.linalg.svd(theirs - _spanned(ours, theirs), full_matrices=False)
    beyond = beyond[scale > 1e-3 * np.linalg.norm(theirs)]
    left = without.rest(beyond)
    seen = np.linalg.svd(left - _spanned(without.rest(ours), left), compute_uv=False).min(initial=1.0)
    most = np.sqrt(max(scores[1].statistic - scores[0].statistic, 0.0)) + 2.0
    return bool(most < TRIFLE * size * seen) and not _may_be_large(search, without, own, rival)


def _may_be_large(search: Search, without: Fit, own: Candidate, rival: Candidate) -> bool:
    """Whether what a rival has beyond its special case may be a large share of its torque, unseen in slow noise.

    As is a constant by which friction differs in its two directions, where zeros walk.
    """
    fit = search.fit([*without.effects, rival], without.whitener)
    ours, theirs = (np.concatenate([x.reshape(len(x), -1) for x in search.columns(c)], axis=1) for c in (own, rival))
    beyond = theirs - _spanned(ours, theirs)
    beta, spread = fit.beta[-1], beyond.T @ own_covariance(fit, len(fit.effects) - 1)
    most = np.abs(beta @ beyond) + 2.0 * np.sqrt(np.maximum(np.sum(spread.T * beyond, axis=0), 0.0))
    return bool(np.linalg.norm(most) > LARGE * np.linalg.norm(beta @ theirs))


def _spanned(rows: Vector, others: Vector) -> Vector:
    """Give the part of other rows that some rows span, shape (n_others, n)."""
    scale = np.linalg.norm(rows, axis=1)
    rows = rows[scale > 0] / scale[scale > 0, None]
    return np.linalg.lstsq(rows.T, others.T, rcond=1e-9)[0].T @ rows


def _uncrossed(search: Search, explanation: Explanation, without: Fit, found: Found) -> list[Candidate]:
    """List the plays of cables that never change sides on these recordings and do what a finding does."""
    own = without.rest(found.score.beta @ search.white(without.whitener, search.columns(found.candidate)))
    out: dict[tuple[str, str], Candidate] = {}
    for play in explanation.bank.laws.candidates:
        if play.effect.name == "backlash" and not search.is_crossed(play):
            gap = without.rest(search.white(without.whitener, [c[:1] for c in search.columns(play)]))[0]
            if own @ gap > search.settings.same * np.linalg.norm(own) * np.linalg.norm(gap) > 0.0:
                out[play.key] = play
    return list(out.values())


def _leaning(search: Search, without: Fit, found: Found) -> list[tuple[Candidate, float]]:
    """List the named rivals with how much likelier than the finding they are, in log-likelihood; the likeliest first.

    The likeliest place of every effect comes before the second one of any.
    """
    own = likeliest(search, without, found.candidate)[0]
    torque = search.score(without, own).beta @ search.white(without.whitener, search.columns(own))
    size = float(torque @ torque)
    known = evidence(search, without, own, size)
    rivals = [c for c, _ in found.rivals if c.named]
    differences = [evidence(search, without, c, size) - known for c in rivals]
    turn = Counter[str]()
    order = []
    for difference, i in sorted((-d, i) for i, d in enumerate(differences)):
        turn[rivals[i].effect.name] += 1
        order.append((turn[rivals[i].effect.name], difference, i))
    return [(rivals[i], -difference) for _, difference, i in sorted(order)]


@lru_cache(maxsize=4096)
def threshold(alarm: float, weight: float, k: int) -> float:
    """Chi-squared statistic that a candidate must exceed at a family-wise alarm probability."""
    target = np.log(alarm) + np.log(weight) + (np.log(2.0) if k == 1 else 0.0)
    root = brentq(lambda x: log_p(x, k) - target, 1e-6, 500.0)
    return float(np.asarray(root))


def sensitivities(search: Search, explanation: Explanation) -> list[dict[str, Any]]:
    """For every effect and place, the smallest amplitude that these data would have shown.

    90 % power at the family-wise alarm probability of the search, and no less than what encoders that round make of
    nothing. Where an effect may take several shapes (order of a ripple, time of a push), half of them would have been
    seen at this amplitude. `visible_fraction` is the share of the effect that the rigid body and the findings leave
    over, `absorbed_by` the parameters that take the rest where it is small.
    """
    rows: dict[tuple[str, str], list[dict[str, Any]]] = {}
    bank = explanation.bank.laws
    accepted = {f.candidate.key for f in explanation.found}
    for candidate, score, weight in zip(bank.candidates, explanation.scores, bank.weight, strict=True):
        known_otherwise = candidate.name != candidate.effect.name  # a coupling has rows of its own
        if candidate.key in accepted or known_otherwise:
            continue
        k = max(score.k, 1)
        z = np.sqrt(threshold(search.settings.alarm, weight, k)) + 1.2816
        beta = max(z / score.norm, _rounded(search, candidate)) if score.norm > 0 else np.inf
        visible, first = score.visible if np.isfinite(score.visible) else 0.0, candidate.effect.size
        row = {
            "effect": candidate.effect.name,
            "location": candidate.location,
            "amplitude": _amplitude(candidate, beta) if visible > search.settings.visible else None,
            "parameter": first.name,
            "unit": unit_at(search.problem.model, candidate.location, first.unit, first.name),
            "visible_fraction": round(float(visible), 4),
            "absorbed_by": [],
        }
        if visible <= HIDDEN and candidate.key not in rows:
            row["absorbed_by"] = _absorbing(search, explanation.fit, candidate, HIDDEN)
        rows.setdefault(candidate.key, []).append(row)
    out = []
    for shapes in rows.values():
        by_size = sorted((row for row in shapes if row["amplitude"]), key=lambda row: row["amplitude"]) or shapes
        middle = by_size[0 if by_size[0]["effect"] in OF_STIFFNESS else (len(by_size) - 1) // 2]
        out.append(middle | {"absorbed_by": shapes[0]["absorbed_by"]})
    return out


def _rounded(search: Search, candidate: Candidate) -> float:
    """Give the coefficient up to which encoders that round (`is_above_steps`), or filters, may make an effect."""
    name, problem = candidate.effect.name, search.problem
    if name == "time_delay":
        return PROMPT
    if name in MAPS and problem.kinematic:
        travel = largest_travel(search, candidate, np.ones(1))
        return ROUNDS * problem.steps_at(candidate.place.index[-1]) / max(travel, 1e-300)
    return 0.5 * problem.steps_at(candidate.place.index[0]) if _looks_rounded(search, candidate) else 0.0


def _amplitude(candidate: Candidate, beta: float) -> float | None:
    if not np.isfinite(beta):
        return None
    if candidate.effect.name == "cable_elasticity":
        return 1.0 / beta
    if candidate.effect.name == "cable_slack":
        return candidate.shape[0]
    return float(beta)


def _absorbing(search: Search, fit: Fit, candidate: Candidate, most: float) -> list[str]:
    """Name the base parameters that take up an effect; none if, without the findings, they leave more than a share."""
    names = search.base.names
    p = len(names)
    columns = [np.concatenate([r[:p], c[:1]]) for r, c in zip(search.rigid, search.columns(candidate), strict=True)]
    W = search.white(fit.whitener, columns)
    A, b = W[:-1].T, W[-1]
    scale = np.linalg.norm(A, axis=0)
    A = A / np.where(scale > 0, scale, 1.0)
    theta, size = np.linalg.lstsq(A, b, rcond=1e-8)[0], float(np.linalg.norm(b))
    if np.linalg.norm(b - A @ theta) > most * size:
        return []
    share = np.abs(theta) / (size or 1.0)
    return [names[i] for i in np.argsort(-share)[:3] if share[i] > 0.1]


def refit_gain(found: Found) -> float:
    """Difference of BIC in favour of a finding."""
    return 2 * found.gain


def absorbed(search: Search, explanation: Explanation, least: float = 0.02) -> list[dict[str, Any]]:
    """List the effects that the rigid body takes up (almost) whole, with the base parameters that take them up."""
    out, seen = [], set()
    for candidate, score in zip(explanation.bank.laws.candidates, explanation.scores, strict=True):
        if candidate.key in seen or score.visible >= least:
            continue
        seen.add(candidate.key)
        names = _absorbing(search, explanation.fit, candidate, least)
        if names:
            out.append({"effect": candidate.effect.name, "location": candidate.location, "parameters": names})
    return out


def outweighs(model: CableModel, found: Found, motor: int, excess: float) -> bool:
    """Whether a finding stands on its own beside an error of one motor that nothing describes.

    It does elsewhere; there its statistic has to be many times what is left, the whitened sum of squares `excess`, and
    no correction without a name be likelier in its place.
    """
    place = found.candidate.place
    if len(place.A + place.B) > 0 and abs(place.weights(model)[motor - 1]) < 1e-9:
        return True
    return found.score.statistic > OUTWEIGHS * excess and not is_outdone(found, 0.0, 0.0)


def is_sure(model: CableModel, found: Found, patches: Sequence[Found]) -> bool:
    """Whether a finding stands on its own beside corrections without a name: elsewhere, and not small beside them.

    What encoders misread is seen between them, friction in torques; what a cable does is elsewhere if its motor is.
    """
    if found.candidate.effect.name.endswith("_friction"):
        patches = [patch for patch in patches if patch.candidate.effect.name != MISREAD]
    own = found.candidate.place
    for patch in patches:
        other = patch.candidate.place
        if not other.A or not (own.A or own.index) or shares_motor(found.candidate, patch.candidate, model):
            return False
        if own.A and parallel(own.weights(model), other.weights(model), NEARLY):
            return False  # joint 1 and motor 1 of the paper's arm, or a motor that does most of what a joint does
        if found.score.statistic < 0.2 * patch.score.statistic:
            return False
    return found.candidate.effect.name in CATALOGUE


def is_outdone(found: Found, share: float = 0.1, least: float = 15.0) -> bool:
    """Whether a correction without a name explains clearly more in its place, so that its name is not sure.

    By at least so much log-likelihood beyond a share of what it gains.
    """
    margin = share * found.gain + least
    return any(not rival.named and difference > margin for rival, difference in found.rivals)
