"""What to record next: the motion, and the pretension, that tell two rivals apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from scipy.stats import norm

from .candidates import Candidate
from .explanation import Explanation
from .geometry import Vector
from .motion import Motion
from .problem import Problem, Run
from .search import Search

TENSER = 1.5
"""How many times the pretension is tried as well."""
WORTH = 1.1
"""How many times the margin another pretension has to bring."""


@dataclass(frozen=True)
class Experiment:
    """A motion to record next.

    Attributes
    ----------
    motion : Motion
    change : str
        What else to change, in words.
    power : float
        Probability that the recording tells the rivals apart, by three units of log-likelihood.
    rivals : tuple of Candidate
        What it tells apart.
    """

    motion: Motion
    change: str
    power: float
    rivals: tuple[Candidate, Candidate]

    @property
    def channels(self) -> dict[str, Vector]:
        """The motion as a recording has it."""
        m = self.motion
        return {"joint_position": m.q, "joint_velocity": m.v, "joint_acceleration": m.a}


def plan_next(
    search: Search,
    explanation: Explanation,
    rivals: Sequence[tuple[int, Candidate]],
    draws: int = 8,
    duration: float = 40.0,
    least: float = 0.75,
    enough: float = 0.999,
) -> Experiment | None:
    """Find the motion that best separates findings from their rivals, within the range and speed that were recorded.

    Random Fourier series, slow and fast, of all joints and of one at a time, the best slow and the best fast one with
    more pretension, too; each is judged by what the rival and the rigid body leave of the finding there.

    Parameters
    ----------
    search : Search
    explanation : Explanation
    rivals : sequence of (int, Candidate)
        Findings by their number, each with what it cannot be told from.
    draws : int
        Motions, one at least.
    duration : float
        [s].
    least : float
        Power below which no experiment is proposed.
    enough : float
        Power beyond which no further one is drawn.
    """
    if not rivals:
        return None
    rng = np.random.default_rng(0)
    tried: list[tuple[float, Experiment]] = []

    def judged(motion: Motion, change: str = "") -> tuple[float, Experiment]:
        margin, pair = separation(search, explanation, rivals, motion)
        return margin, Experiment(motion, change, float(norm.cdf(margin)), pair)

    for draw in range(draws):
        tried.append(judged(random_motion(search.problem, rng, duration, slow=bool(draw % 2), alone=draw % 4 == 3)))
        if tried[-1][1].power > enough:
            break
    margin_of = itemgetter(0)
    most, best = max(tried, key=margin_of)
    kinds = [max(own, key=margin_of)[1].motion for own in (tried[::2], tried[1::2]) if own]
    tense = [judged(*changed) for motion in kinds if search.problem.torque and (changed := _tenser(motion))]
    if tense:
        margin, other = max(tense, key=margin_of)
        best = other if margin > max(WORTH * most, most + 0.1) else best
    return best if best.power >= least else None


def _tenser(motion: Motion) -> tuple[Motion, str] | None:
    """Give a motion with more pretension, and say so; None where there is none."""
    if not motion.pretension:
        return None
    changed = replace(motion, pretension=TENSER * motion.pretension)
    return changed, f"pretension {motion.pretension:.4g} -> {changed.pretension:.4g} N"


def separation(
    search: Search, explanation: Explanation, rivals: Sequence[tuple[int, Candidate]], motion: Motion
) -> tuple[float, tuple[Candidate, Candidate]]:
    """Say how far a motion tells the pair apart that it tells apart worst, in standard deviations.

    The log-likelihood of the true one has to lead by three, and by more than the accuracy of the laws.
    """
    problem = search.problem
    signals = SimpleNamespace(valid=np.ones(motion.n, bool), recording=SimpleNamespace(payload=None))
    run = Run(cast(Any, signals), motion, np.zeros((problem.n_channels, motion.n)))
    both = replace(problem, runs=(problem.runs[0], run))  # what is there and what would come, together
    both.__dict__["rigid"] = [problem.rigid[0], *replace(problem, runs=(run,)).rigid]  # what is there is known
    there = search.judge(both)
    fit = explanation.fit
    whitener = replace(fit.whitener, scale=np.ones(2))
    worst, pair = np.inf, (rivals[0][1], rivals[0][1])
    for j, rival in rivals:
        own = fit.effects[j]
        others = [c for i, c in enumerate(fit.effects) if i != j]
        without = there.fit([*others, rival], whitener)
        whole = fit.beta[j] @ there.white(whitener, there.columns(own))
        size, most = (float(np.sum(f.rest(whole[None]) ** 2)) for f in (without, there.fit(others, whitener)))
        lead = max(search.settings.close, 0.5 * search.settings.law_error**2 * most)
        margin = (0.5 * size - lead) / np.sqrt(size) if size > 1e-9 else -np.inf
        if margin < worst:
            worst, pair = margin, (own, rival)
    return worst, pair


def random_motion(problem: Problem, rng: np.random.Generator, duration: float, slow: bool, alone: bool) -> Motion:
    """Draw a motion that starts and ends at rest within the recorded range, speed and acceleration of each joint."""
    first = problem.runs[0].motion
    rate, model = problem.band.rate, problem.model
    t = np.arange(int(duration * rate) + 1) / rate
    q = np.concatenate([m.q for m in problem.motions])
    low, high = np.quantile(q, 0.001, axis=0), np.quantile(q, 0.999, axis=0)
    speed, strength = (
        np.quantile(np.abs(np.concatenate([getattr(m, name) for m in problem.motions])), 0.995, axis=0)
        for name in ("v", "a")
    )
    base = 2 * np.pi / (0.5 * duration if slow else 0.25 * duration)
    ramp = np.clip(np.minimum(t, duration - t) / 2.0, 0.0, 1.0)
    window = ramp**3 * (10 - 15 * ramp + 6 * ramp**2)
    out = np.zeros((len(t), model.n_joints))
    for j in range(model.n_joints):
        k = np.arange(1, 6)
        a, b = rng.normal(size=(2, 5)) / k
        shape = window * (np.sin(np.outer(t, k) * base) @ a + np.cos(np.outer(t, k) * base) @ b)
        limits = [0.48 * (high[j] - low[j]) / np.abs(shape).max()]
        for order, most in ((1, speed[j]), (2, strength[j])):
            limits.append(float(most) / max(float(np.abs(_derivative(shape, rate, order)).max()), 1e-12))
        out[:, j] = 0.5 * (low[j] + high[j]) + min(limits) * shape
    if alone:
        part = np.minimum((t / duration * model.n_joints).astype(int), model.n_joints - 1)
        for j in range(model.n_joints):
            mask = _smooth((part == j).astype(float), rate)
            out[:, j] = 0.5 * (low[j] + high[j]) + mask * (out[:, j] - 0.5 * (low[j] + high[j]))
    v, a = _derivative(out, rate, 1), _derivative(out, rate, 2)
    m = model.motor_from_joint.T
    return Motion(
        model=first.model, time=t, q=out, v=v, a=a, q_m=model.motor_position(out), v_m=v @ m, a_m=a @ m, index=-1,
        joints_measured=first.joints_measured, motors_measured=first.motors_measured, offset=first.offset,
        tilt=first.tilt, velocity_noise=first.velocity_noise, pretension=first.pretension,
        inertia_noise=first.inertia_noise, torque_measured=first.torque_measured,
    )  # fmt: skip


def _derivative(x: Vector, rate: float, order: int) -> Vector:
    for _ in range(order):
        x = np.gradient(x, 1 / rate, axis=0)
    return x


def _smooth(x: Vector, rate: float) -> Vector:
    kernel = np.hanning(max(int(rate), 3))
    return np.asarray(np.convolve(x, kernel / kernel.sum(), mode="same"), float)
