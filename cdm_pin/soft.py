"""Which cable is soft, where only motors are measured: every cable at many frequencies of resonance, then the best."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from .candidates import Candidate
from .effects import CATALOGUE
from .fit import Fit
from .geometry import Vector
from .motion import Motion
from .problem import Problem
from .search import Search
from .swing import FARTHEST, slopes_along

RATIO = 1.35
"""Between frequencies of resonance that are tried."""
DAMPING = 0.05
"""Damping ratio to start from."""
ENOUGH = 20.0
"""What is looked at for the first comparison [s]."""
CHANCE = 12.0
"""What two steps have to explain of noise as large as the whole error, as a sum of squares in its units."""
SLOWEST, FASTEST = np.array([0.6, 0.2]), np.array([1.7, 5.0])
"""By which factor coefficients may change in one step."""
GAPS = (0.002, 0.004, 0.008, 0.016, 0.032)
"""Halves of a play that are tried where nothing tells of one [rad]."""
CONTACTS = (12.0, 40.0)
"""Frequencies with which links swing on the contact at the ends of a play [Hz]."""


def softest(
    search: Search, beside: Sequence[Candidate] = (), rounds: int = 10, best: int = 4
) -> tuple[Search, list[Candidate]] | None:
    """Find the soft cable on which the links swing, and give the search about that motion.

    Parameters
    ----------
    search : Search
        About the model file: what is identified on a motion that is not the links' own says little of their masses.
    beside : sequence of Candidate
        Other effects that are in the model.
    rounds : int
        Of Gauss-Newton's method.
    best : int
        Starts that are pursued.

    Returns
    -------
    search : Search
        About the motion of links that swing.
    effects : list of Candidate
        The soft cable, then the others. None where no cable lets links swing.
    """
    law = CATALOGUE["cable_elasticity"]
    cables = [Candidate(law, place) for place in law.places(search.problem.model)]
    return _best(
        search, [(c, beta) for c in cables for beta in _starts(search.problem, c.place.index[0])], beside, rounds, best
    )


def looser(
    search: Search, plays: Sequence[tuple[Candidate, Vector]], beside: Sequence[Candidate] = (), rounds: int = 10
) -> tuple[Search, list[Candidate]] | None:
    """Find the cable with play within which the links move freely, and give the search about that motion.

    As `softest`, from plays that were found so far with their coefficients, or where there are none from any.
    """
    problem, starts = search.problem, []
    law = CATALOGUE["backlash"]
    known = [(c, (0.7 * beta[0], beta[0], 1.4 * beta[0])) for c, beta in plays if beta[0] > 0.0]
    every = [Candidate(law, place, law.grid(problem.motions, place)[0]) for place in law.places(problem.model)]
    for play, gaps in known or [(c, GAPS) for c in every if search.is_crossed(c)]:
        mass = _inertia(problem.motions[0], play.place.index[0])
        for frequency in CONTACTS if mass > 0.0 else ():
            shape = (play.shape[0], mass * (2.0 * np.pi * frequency) ** 2)
            starts += [(replace(play, shape=shape, detail=0.0), np.array([gap])) for gap in gaps]
    return _best(search, starts, beside, rounds)


def _best(
    search: Search,
    starts: Sequence[tuple[Candidate, Vector]],
    beside: Sequence[Candidate],
    rounds: int,
    best: int = 4,
) -> tuple[Search, list[Candidate]] | None:
    """Pursue what leaves least after two steps, first on a part of a recording; give the search about the best.

    Where that is no less than chance makes of what rigid cables leave, none is pursued.
    """
    short = Search(_shortened(search.problem), search.base, search.settings, search.held)
    rigid, first = short.fit(beside, short.plain), [_pursued(short, c, beta, beside, 2)[1] for c, beta in starts]
    explained = 1.0 - np.array(first, dtype=float) / max(rigid.deviance, 1e-300)
    order = [k for k in np.argsort(-explained, kind="stable") if explained[k] * rigid.n_rows > CHANCE]
    likely = [starts[k] for k in order[:best]]
    kept = _finite(_pursued(short, c, beta, beside, rounds) for c, beta in likely)
    others = [there for there in kept[1:] if not _alike(there, kept[0])]
    ready = _finite(_pursued(search, *there.swung[0], beside, rounds) for there in [*kept[:1], *others[:1]])
    return (ready[0], [candidate for candidate, _ in ready[0].swung]) if ready else None


def _finite(found: Iterable[tuple[Search, float]]) -> list[Search]:
    """Sort searches by what they leave; without those whose links would swing too far."""
    return [there for there, left in sorted(found, key=lambda item: item[1]) if np.isfinite(left)]


def _alike(a: Search, b: Search) -> bool:
    """Whether two searches are about the same soft cable, as stiff."""
    (one, x), (other, y) = a.swung[0], b.swung[0]
    return one.key == other.key and abs(x[0] - y[0]) < 0.05 * abs(y[0])


def _starts(problem: Problem, cable: int) -> list[Vector]:
    """List coefficients of a cable at resonances between where it would stretch too far and far above the band."""
    motion = problem.motions[0]
    load = max(float(np.quantile(np.abs(m.cable_torque[:, cable]), 0.99)) for m in problem.motions)
    mass = _inertia(motion, cable)
    if not (mass > 0.0 and load > 0.0):
        return []
    least = max(load / FARTHEST, mass * (2 * np.pi) ** 2)
    count = 1 + int(max(np.log(2.0 * problem.band.cutoff * 2 * np.pi / np.sqrt(least / mass)), 0.0) / np.log(RATIO))
    out = []
    for stiffness in least * RATIO ** (2 * np.arange(count)):
        damping = 2.0 * DAMPING * np.sqrt(mass * stiffness)
        out.append(np.array([1.0 / stiffness, damping / stiffness**2]))
    return out


@np.errstate(over="ignore", invalid="ignore")  # a start may swing ever further
def _pursued(
    search: Search, candidate: Candidate, beta: Vector, beside: Sequence[Candidate], rounds: int
) -> tuple[Search, float]:
    """Fit a soft cable about the motion that it makes, again and again, in steps that keep its resonance in sight.

    The second value is the squared error about the motion as it stands, scaled per channel.
    """
    scale, best, effects = search.plain, (search, np.inf), [candidate, *beside]
    change = np.zeros(len(search.base.columns))
    coefficients = [beta, *search.fit(beside, scale).beta]
    for _ in range(rounds):
        search = search.at(change, list(zip(effects, coefficients, strict=True)))
        if not search.problem.swings:
            break
        fit = search.fit(effects, scale)
        left = _left(search, fit, beta)
        if left < best[1]:
            best = search, left
        step = np.clip(fit.beta[0], beta * SLOWEST[: len(beta)], beta * FASTEST[: len(beta)])
        if np.all(np.abs(step - beta) < 1e-3 * np.abs(beta)):
            break
        change, beta, coefficients = fit.base[: len(change)], step, [step, *fit.beta[1:]]
    return best


def _left(search: Search, fit: Fit, beta: Vector) -> float:
    """Give the squared error where the soft cable keeps the coefficients that the motion was made with."""
    others = search.without(fit, 0)
    known = beta @ search.white(fit.whitener, search.columns(fit.effects[0]))
    rest = others.residual - others.rest(known[None])[0]
    return float(rest @ rest)


def _shortened(problem: Problem) -> Problem:
    """Give the problem of the first part of the longest stretch without gaps alone."""
    stretches = [max(own, key=lambda s: s[1] - s[0], default=(0, 0)) for own in problem.segments]
    longest = int(np.argmax([stop - start for start, stop in stretches]))
    run, (start, stop), step = problem.runs[longest], stretches[longest], problem.band.step
    margin = len(problem.band.taps) // 2
    first = max(start * step - margin, 0)
    part = slice(first, min(first + int(ENOUGH * run.motion.rate), stop * step + margin))
    signals = replace(run.signals, time=run.signals.time[part], valid=run.signals.valid[part])
    short = replace(run, signals=signals, motion=run.motion.part(part), data=run.data[:, part])
    return replace(problem, runs=(short,))


def _inertia(motion: Motion, cable: int) -> float:
    """Inertia of the links that a cable feels, in the middle of a motion's [kg m^2]."""
    slopes = slopes_along(motion.part(slice(None, None, 50)), motion.model.joints_per_travel(cable))
    return float(np.median(-slopes[2, :, cable])) / motion.model.arm_scale[cable]
