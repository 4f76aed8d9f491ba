"""From a diagnosis to what its report draws."""

from __future__ import annotations

import numpy as np

from .candidates import Candidate
from .diagnose import Diagnosis
from .doubts import COMPLIANT
from .explanation import Explanation, Found
from .fit import Fit
from .friction_effects import remembered
from .geometry import Vector
from .replay import Replay
from .report_evidence import Evidence, LawCurve, Rival, RunEvidence, SimulatedMotion
from .search import Search, raw_errors
from .units import joint_units, motor_units, unit_at
from .whitening import inside, live_in


def gather(diagnosis: Diagnosis) -> Evidence:
    """Collect the arrays behind a diagnosis; empty where the data were insufficient."""
    explanation, search = diagnosis.explanation, diagnosis.search
    if explanation is None or search is None:
        return Evidence()
    rigid = search.stiff.fit([])
    runs = _runs(search, rigid, explanation.fit, False)
    if diagnosis.holdout is not None:
        runs += _runs(diagnosis.holdout, rigid, explanation.fit, True)
    named = [explanation.found[j] for j in diagnosis.listed]
    patches = [f for f in explanation.found if not f.candidate.named]
    return Evidence(
        runs=tuple(runs),
        noise_floor=np.array(diagnosis.content["fit"]["train"]["noise_floor"]),
        laws=tuple(_law(search, explanation, f) for f in named),
        rivals=tuple(_rivals(f) for f in named),
        unexplained=_law(search, explanation, patches[0]) if patches else None,
        simulated=tuple(_simulated(replay, joint_units(search.problem.model)) for replay in diagnosis.replays[:1]),
        notices=(*_notices(search), *(f"unseen recording: {text}" for text in _notices(diagnosis.holdout))),
    )


def _notices(search: Search | None) -> list[str]:
    return [] if search is None else [text for run in search.problem.runs for text in run.notices]


def _simulated(replay: Replay, units: tuple[str, ...], most: int = 5) -> SimulatedMotion:
    """Draw the first windows, with gaps where the simulations start anew."""
    time, *motions = replay.stretch(most)
    anew = np.arange(1, round((time[-1] + replay.time[1]) / replay.horizon)) * (len(replay.time) - 1)
    parts = (np.insert(x, anew, np.nan, axis=0) for x in motions)
    return SimulatedMotion(np.insert(time, anew, time[anew]), *parts, label=replay.label, units=units)


def _runs(search: Search, rigid: Fit, fit: Fit, holdout: bool) -> list[RunEvidence]:
    problem = search.problem
    m, step = problem.model.n_motors, problem.band.step
    before = raw_errors(search.stiff, rigid.base, (), ())
    after = raw_errors(search, fit.base, fit.effects, fit.beta)
    out = []
    for r, run in enumerate(problem.runs):
        data = problem.data[r][0][:m]
        n = data.shape[1]
        out.append(
            RunEvidence(
                label=run.name,
                time=run.motion.time[::step][:n],
                measured=data.T,
                rigid=(data - before[r][:m]).T,
                augmented=(data - after[r][:m]).T,
                q=run.motion.q[::step][:n],
                v=run.motion.v[::step][:n],
                valid=inside(problem.segments[r], n),
                holdout=holdout,
                units=motor_units(problem.model, problem.torque),
                joint_units=joint_units(problem.model),
            )
        )
    return out


def _law(search: Search, explanation: Explanation, found: Found) -> LawCurve | None:
    """Draw a law along its own coordinate: torque of the law, and what is left to it when all else is taken away."""
    candidate, fit, problem = found.candidate, explanation.fit, search.problem
    j = next(i for i, f in enumerate(explanation.found) if f is found)
    law = np.tensordot(fit.beta[j], search.columns(candidate)[0], 1)
    rest = law + raw_errors(search, fit.base, fit.effects, fit.beta)[0]
    m, step = problem.model.n_motors, problem.band.step
    between = slice(m * problem.torque, None)
    if problem.kinematic and candidate.effect.follows and law[between].any():
        return _travel(search, candidate, law[between], rest[between])
    if not candidate.place.A or not problem.torque:
        return None
    w, law, rest = candidate.place.weights(problem.model), law[:m], rest[:m]
    share = w / (w @ w)
    n = law.shape[1]
    by_position = any(word in candidate.effect.name for word in ("spring", "position", "ripple", "hysteresis"))
    motion = problem.motions[0]
    x = candidate.place.along(motion.q, motion.q_m) if by_position else candidate.place.along(motion.v, motion.v_m)
    angle, torque = (unit_at(problem.model, candidate.location, unit) for unit in ("rad", "N m"))
    label = f"position [{angle}]" if by_position else f"speed [{angle}/s]"
    if candidate.remembers_tension:
        x, label = remembered(motion, candidate.place), f"torque of the cable [{torque}]"
    run = problem.segments[0]
    keep, live = np.arange(*run[0]), live_in(run, slice(m))
    if live is not None:
        keep = keep[live[share != 0.0][:, keep].all(axis=0)]
    return LawCurve(
        x=x[::step][:n][keep],
        x_label=label,
        y_points=(share @ rest)[keep],
        y_fit=(share @ law)[keep],
        y_label=f"torque [{torque}]",
        loop=candidate.effect.name == "hysteresis",
    )


def _travel(search: Search, candidate: Candidate, law: Vector, rest: Vector) -> LawCurve:
    """Draw what a law makes of the travel between a motor and its joints, and what is left to it.

    A cable gives by what it carries; a wrong map goes with the joint that it is wrong about.
    """
    problem, motion, i, k = (
        search.problem,
        search.problem.motions[0],
        candidate.place.index[0],
        candidate.place.index[-1],
    )
    torque, angle = (motor_units(problem.model, felt)[i] for felt in (True, False))
    if candidate.effect.name in (*COMPLIANT, "backlash"):
        x, label = motion.cable_torque[:, i], f"torque of the cable [{torque}]"
    else:
        x, label = motion.q[:, k], f"position of joint {k + 1} [{joint_units(problem.model)[k]}]"
    keep = slice(*problem.segments[0][0])
    return LawCurve(
        x=x[:: problem.band.step][: law.shape[1]][keep],
        x_label=label,
        y_points=rest[i, keep],
        y_fit=law[i, keep],
        y_label=f"travel of motor {i + 1} from its joints [{angle}]",
    )


def _rivals(found: Found) -> tuple[Rival, ...]:
    return tuple(
        Rival(
            rival.effect.name,
            rival.location,
            2 * (found.gain + difference),
            "as good" if difference > -3 else "explains less",
        )
        for rival, difference in found.rivals[:5]
        if rival.named
    )
