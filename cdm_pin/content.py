"""The diagnosis in the words of its format: what diagnosis.json says of findings, masses, errors and recordings."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from . import findings as fi
from .candidates import Candidate
from .confirming import BLIND, ONCE, change_unseen, in_noise, swing_gain
from .drifting import still
from .explanation import Explanation
from .fit import Fit
from .model import CableModel
from .next_experiment import Experiment
from .parts import parts_of, reduction_apart
from .problem import Problem
from .regions import region
from .search import Search, errors, foretold, rms
from .unexplained import noise_floor
from .units import motor_units, unit_at
from .verdict import Verdict

SCHEMA = "cdm_pin.diagnosis/1"


def insufficient_content(problem: Problem, reason: str) -> dict[str, Any]:
    """Say why recordings cannot support a diagnosis."""
    return {
        "schema": SCHEMA,
        "verdict": "insufficient_data",
        "reason": reason,
        "rigid_body": {"changed": []},
        "findings": [],
        "fit": {"train": None, "holdout": None, "simulated_position": None},
        "sensitivity": [],
        "unexplained": None,
        "next_experiment": None,
        "data": _data(problem),
    }


def content_of(verdict: Verdict, rigid: Fit) -> dict[str, Any]:
    """Say a verdict; what it takes to plan an experiment or to replay the recordings is added by who does that.

    Parameters
    ----------
    verdict : Verdict
    rigid : Fit
        Of the rigid body alone.
    """
    model, search, judge, fit = verdict.model, verdict.search, verdict.judge, verdict.fit
    unexplained = verdict.unexplained
    both = search.problem.torque and search.problem.kinematic  # what is of torques and travel at once has no unit
    if unexplained and "unit" not in unexplained and not both:
        own = "N m" if search.problem.torque else "rad"
        unexplained = unexplained | {"unit": unit_at(model, unexplained["location"], own)}
    return {
        "schema": SCHEMA,
        "verdict": verdict.said,
        "rigid_body": {"changed": changed_parameters(model, search, verdict.explanation)},
        "findings": [_finding(search, judge, verdict.explanation, j, v) for j, v in verdict.stated.items()],
        "fit": {
            "train": _fit_content(search, rigid, fit, search),
            "holdout": _fit_content(search, rigid, fit, judge) if judge is not None else None,
            "simulated_position": None,
            "unit": _together(motor_units(model, search.problem.torque)),
        },
        "sensitivity": fi.sensitivities(search, verdict.explanation),
        "unexplained": unexplained,
        "next_experiment": None,
        "data": _data(search.problem, judge.problem if judge is not None else None),
        "names": {"joint": list(model.joints), "motor": list(model.motors)},
    }


def experiment_content(experiment: Experiment | None) -> dict[str, Any] | None:
    """Say what to record next; None where nothing is to be told apart."""
    if experiment is None:
        return None
    return {
        "file": "next.csv",
        "change": experiment.change,
        "power": experiment.power,
        "separates": [{"effect": c.name, "location": c.location} for c in experiment.rivals],
    }


def unresolved(verdict: Verdict, findings: Sequence[dict[str, Any]]) -> list[tuple[int, Candidate]]:
    """List findings, by their number, with the rivals listed beside them that some motion may tell from them."""
    out = []
    for j, item in zip(verdict.stated, findings, strict=True):
        listed = [(e["effect"], e["location"]) for e in item["indistinguishable_from"]]
        one = [(item["effect"], twin) for twin in fi.same_elsewhere(verdict.search, verdict.explanation, j)]
        rivals = [(c, (c.name, c.location)) for c, _ in verdict.explanation.found[j].rivals]
        out += [(j, c) for c, key in rivals if key in listed and key not in one]
    return out[:2]


def _fit_content(search: Search, rigid: Fit, fit: Fit, judged: Search) -> dict[str, Any]:
    m = search.problem.model.n_motors
    rest = foretold(judged, fit)
    left = still(judged, rest)
    drift = [a - b for a, b in zip(rest, left, strict=True)]  # noise, too, where zeros were seen to drift
    sizes = {
        "rmse_rigid": rms(judged, errors(judged.stiff, rigid.base, (), ())),
        "rmse_augmented": rms(judged, rest),
        "noise_floor": np.hypot(noise_floor(judged, fit.effects), rms(judged, drift)),
    }
    content: dict[str, Any] = {name: values[:m].tolist() for name, values in sizes.items()}
    if search.problem.torque and search.problem.kinematic:
        units = _together(motor_units(search.problem.model, False))
        content["travel"] = {name: values[m:].tolist() for name, values in sizes.items()} | {"unit": units}
    return content


def _together(units: Sequence[str]) -> str | list[str]:
    return units[0] if len(set(units)) == 1 else list(units)


def _data(problem: Problem, seen: Problem | None = None) -> dict[str, Any]:
    return {
        "band": [0.0, problem.band.cutoff],
        "rate": problem.band.reduced_rate,
        "torque": problem.torque,
        "kinematic": problem.kinematic,
        "recordings": _recordings(problem),
        "unseen": _recordings(seen) if seen is not None else [],
    }


def _recordings(problem: Problem) -> list[dict[str, Any]]:
    return [{"name": run.name, "duration": float(run.motion.time[-1]), "notices": run.notices} for run in problem.runs]


def _finding(
    search: Search, judge: Search | None, explanation: Explanation, j: int, values: dict[str, Any]
) -> dict[str, Any]:
    found, fit = explanation.found[j], explanation.fit
    candidate, reduction, delta_bic = found.candidate, None, fi.refit_gain(found)
    without, there = search.without(fit, j), judge
    swinging = candidate.is_swinging(search.problem.motions[0])
    if swinging:  # its columns say nothing of a cable that is rigid
        without, there = search.stiff.fit(list(without.effects)), judge.stiff if judge is not None else None
        delta_bic = 2 * swing_gain(search, fit, without)
    elsewhere = None if swinging or judge is not None else reduction_apart(parts_of(search), fit, without)
    if judge is not None and there is not None:
        rests = [foretold(s, f) for s, f in ((judge, fit), (there, without))]
        level = np.maximum(rms(judge, rests[0]), 1e-12)
        after, before = (in_noise(judge, rest, level) for rest in rests)
        reduction = 1 - float(np.sqrt(after / before))
    time = [candidate.shape[0], candidate.shape[1]] if candidate.effect.name == "external_torque" else None
    item = {
        "effect": candidate.name,
        "location": candidate.location,
        "parameters": {
            name: v | {"unit": unit_at(search.problem.model, candidate.location, v["unit"], name)}
            for name, v in candidate.parameters_said(search.problem.model, values).items()
            if name not in ("start", "end", "recording")
        },
        "evidence": {
            "delta_bic": delta_bic,
            "log10_p": found.log_p / np.log(10),
            "holdout_rmse_reduction": reduction,
            "parts_rmse_reduction": elsewhere,
        },
        "indistinguishable_from": fi.indistinguishable(search, explanation, j),
        "time": time,
        "region": None if candidate.effect.name in ONCE else region(search, fit, j),
    }
    if time is not None and len(search.problem.runs) > 1:
        item["recording"] = search.problem.runs[int(candidate.shape[2])].name
    if candidate.effect.name == "hysteresis":
        item["memory"] = "cable tension" if candidate.remembers_tension else "angle"
    if judge is None or (candidate.effect.name not in ONCE and change_unseen(judge, explanation, j) < BLIND):
        item["unconfirmed"] = True
    return item


def changed_parameters(model: CableModel, search: Search, explanation: Explanation) -> list[dict[str, Any]]:
    """List the base parameters that differ from the file: by more than 4 standard errors and 1 % of themselves."""
    base, fit = search.base, explanation.fit
    p = len(base.columns)
    nominal = base.values(model.standard_parameters)
    value = base.values(search.problem.model.standard_parameters) + fit.base[:p]
    std = np.sqrt(np.diag(fit.covariance)[:p])
    alternatives = fi.absorbed(search, explanation) + _payloads(search)
    out = []
    for k in np.argsort(-np.abs(value - nominal) / np.maximum(std, 1e-12)):
        change = abs(value[k] - nominal[k])
        if change < 4 * std[k] or change < 0.01 * abs(nominal[k]):
            continue
        same = [
            {"effect": e["effect"], "location": e["location"]}
            for e in sorted(alternatives, key=partial(_likeness, links=base.links[k], last=model.n_joints))
            if base.names[k] in e["parameters"]
        ]
        out.append(
            {
                "base_parameter": base.names[k],
                "links": list(base.links[k]),
                "nominal": float(nominal[k]),
                "value": float(value[k]),
                "std": float(std[k]),
                "indistinguishable_from": same[:4],
            }
        )
    return out


def _likeness(effect: dict[str, Any], links: Sequence[int], last: int) -> int:
    """Rank what a base parameter of some links may as well be: what is nothing but inertia first, at its own link."""
    if effect["effect"] == "payload":
        return {links[0]: 0, last: 1}.get(effect["location"]["index"], 2)
    return 0 if effect["effect"] == "rotor_inertia" else 3


def _payloads(search: Search) -> list[dict[str, Any]]:
    """List a payload on each link with the base parameters that it would change."""
    base, out = search.base, []
    for link in range(search.problem.model.n_joints):
        moved = np.abs(base.matrix[:, 10 * link : 10 * link + 10]).sum(axis=1) > 1e-9
        names = [name for name, yes in zip(base.names, moved, strict=True) if yes]
        out.append({"effect": "payload", "location": {"kind": "link", "index": link + 1}, "parameters": names})
    return out[::-1]
