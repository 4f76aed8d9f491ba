"""What an identification writes: identification.json, model.yaml and the URDF of the identified robot."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from .consistency import about_center, links_from_parameters
from .console import plain
from .effects import CATALOGUE
from .estimators import per_joint
from .files import read_text, write_text
from .geometry import Manipulator, Vector
from .identify import Identification
from .manipulator import save_manipulator
from .model import CableModel
from .survey import Visit
from .units import unit_at
from .urdf import generate_urdf

SCHEMA = "cdm_pin.identification/1"
URDF, MODEL, RESULT = "identified.urdf", "model.yaml", "identification.json"
Z90 = 1.6448536269514722  # a value is within this many standard deviations with 90 % probability


def save_identification(result: Identification, folder: Path, final: Path) -> dict[str, Any]:
    """Write identification.json, model.yaml and identified.urdf into `folder`.

    Parameters
    ----------
    result : Identification
    folder : Path
    final : Path
        Where the folder will stand in the end.

    Returns
    -------
    dict
        What identification.json says.
    """
    manipulator = identified_manipulator(result)
    write_text(folder / URDF, identified_urdf(result.model, result.standard.parameters, manipulator))
    if manipulator.urdf is not None:
        manipulator = replace(manipulator, urdf=final / URDF)
    save_manipulator(manipulator, folder / MODEL, final)
    data = plain(content(result))
    write_text(folder / RESULT, json.dumps(data, indent=2, ensure_ascii=False) + "\n")
    return data


def content(result: Identification) -> dict[str, Any]:
    """Give what identification.json says."""
    nominal = result.base.values(result.model.standard_parameters)
    skipped = result.train.skipped + (result.holdout.skipped if result.holdout else ())
    base = result.base.rank
    parameters = [
        {
            "name": name,
            "value": value,
            "std": std,
            "interval_90": [value - Z90 * std, value + Z90 * std],
            "links": list(links),
            "nominal": before,
        }
        for name, value, std, links, before, ok in zip(
            result.base.names, result.fit.values, result.std, result.base.links, nominal, result.reliable, strict=False
        )
        if ok
    ]
    return {
        "schema": SCHEMA,
        "robot": result.model.manipulator.name,
        "estimator": result.estimator,
        "base_parameters": parameters,
        "effects": effect_records(result),
        "not_identifiable": [{"name": name, "reason": reason} for name, reason in result.not_identifiable],
        "never_identifiable": list(result.structural.unidentifiable),
        "absorbed": list(result.base.absorbed),
        "rank": result.rank,
        "structural_rank": result.structural.rank,
        "condition_number": result.condition_number if base else None,
        "samples": result.moments.n_samples,
        "noise_covariance": result.fit.noise_covariance,
        "fit": {"train": result.errors(result.train), "holdout": result.errors(result.holdout) or None},
        "per_joint": _per_joint(result),
        "physical": {
            "links": physical_note(result),
            "fit": {
                "train": result.errors(result.train, physical=True),
                "holdout": result.errors(result.holdout, physical=True) or None,
            },
            "exact": result.standard.exact,
            "distance_from_nominal": result.standard.distance,
            "parameters": dict(zip(result.model.parameter_names, result.standard.parameters, strict=True)),
        },
        "recordings": [_visit(result, visit) for visit in result.train.visits],
        "holdout": [_visit(result, visit) for visit in result.holdout.visits] if result.holdout else [],
        "skipped": [{"file": item.name, "reason": item.reason} for item in skipped],
        "hints": list(result.hints),
    }


def physical_note(result: Identification) -> str:
    """Say how the links of the model file relate to the identified base parameters."""
    if result.standard.exact:
        return "reproduce the base parameters"
    effects = zip(result.terms, result.fit.values[result.base.rank :], strict=True)
    if result.reliable.all() and any(term.nonnegative and value < 0 for term, value in effects):
        return "are the nearest with friction and rotor inertia not below zero"
    if result.reliable.all():
        return "no body of positive density has these base parameters: the nearest consistent ones are written"
    return "follow what is identifiable; the rest stays with the manipulator file"


def identified_manipulator(result: Identification) -> Manipulator:
    """Give the manipulator with physically valid links, the identified effects and base parameters."""
    records = []
    values = result.fit.values if result.standard.exact else result.base.values(result.standard.parameters)
    for name, value, std, ok in zip(result.base.names, values, result.std, result.reliable, strict=False):
        if ok:
            records.append({"name": name, "value": float(value), "std": float(std)})
    effects = plain(effect_records(result, values=result.physical_effects))
    manipulator = replace(
        result.model.manipulator,
        effects=(*result.model.manipulator.effects, *effects),
        base_parameters=tuple(records),
    )
    if not manipulator.links:
        return manipulator
    return replace(manipulator, links=links_from_parameters(manipulator.links, result.standard.parameters))


def effect_records(result: Identification, *, values: Vector | None = None) -> list[dict[str, Any]]:
    """Give the identified effects as ``{effect, location, parameters}``.

    Parameters
    ----------
    result : Identification
    values : ndarray, shape (n_terms,), optional
        Coefficients for a model file: every effect, parameters as numbers. Default: those that were fitted and mean
        something, parameters with units and standard deviations.
    """
    base = result.base.rank
    groups: dict[tuple[str, ...], list[int]] = {}
    for k, term in enumerate(result.terms):
        groups.setdefault((term.effect, str(term.place.location), str(term.shape)), []).append(k)
    records = []
    for members in groups.values():
        term = result.terms[members[0]]
        effect = CATALOGUE[term.effect]
        shape = result.train.visits[0].shapes[result.plan.terms.index(term)]
        fitted = [base + k for k in members]
        spread = np.eye(len(effect.signs))[:, [result.terms[k].number for k in members]]

        def physical(beta: Vector, effect=effect, spread=spread, shape=shape) -> dict[str, float]:
            return effect.physical(spread @ beta, shape)  # a coefficient that cannot be told from others is zero

        if values is not None:
            parameters: dict[str, Any] = physical(values[members])
            parameters |= {"width": shape[0]} if effect.nuisance_shape else {}
        elif result.reliable[fitted].all():
            found = physical(result.fit.values[fitted])
            std = _deviations(physical, result.fit.values[fitted], result.covariance[np.ix_(fitted, fitted)])
            where = term.place.location
            units = {p.name: unit_at(result.plan.model, where, p.unit, p.name) for p in effect.parameters}
            parameters = {n: {"value": v, "std": std.get(n), "unit": units[n]} for n, v in found.items()}
        else:
            continue
        records.append({"effect": effect.name, "location": term.place.location, "parameters": parameters})
    return records


def _deviations(physical: Callable[[Vector], dict[str, float]], values: Vector, covariance: Vector) -> dict[str, float]:
    """Give standard deviations of physical parameters, to first order; none of those that were stated."""
    steps = 1e-6 * np.maximum(np.abs(values), np.sqrt(np.maximum(np.diag(covariance), 0.0))) + 1e-300
    J = []
    for step in np.diag(steps):
        up, down = physical(values + step), physical(values - step)
        J.append([(up[name] - down[name]) / (2 * step.sum()) for name in up])
    variance = np.einsum("kp,kl,lp->p", J, covariance, J)
    found = zip(physical(values), np.any(J, axis=0), np.sqrt(np.maximum(variance, 0.0)), strict=True)
    return {name: float(std) for name, fitted, std in found if fitted}


def _per_joint(result: Identification) -> list[dict[str, Any]]:
    """Each motor by itself with the pseudo-inverse, eq. (44)."""
    if not result.base.rank:
        return []
    rows = []
    for motor, fit in zip(result.model.motors, per_joint(result.moments), strict=True):
        values = [{"name": name, "value": value} for name, value in zip(fit.names, fit.values, strict=True)]
        rows.append({"motor": motor, "parameters": values, "condition_number": fit.condition_number})
    return rows


def _visit(result: Identification, visit: Visit) -> dict[str, Any]:
    return {
        "file": str(visit.source) if visit.source else None,
        "name": visit.name,
        "samples": visit.n_samples,
        "used": visit.n_used,
        "duration": visit.duration,
        "rate": visit.rate,
        "cutoff": visit.cutoff,
        "accelerations": [
            {"motor": motor, "from": way.source, "cutoff": float(way.cutoff) if np.isfinite(way.cutoff) else None}
            for motor, way in zip(result.model.motors, visit.accelerations, strict=True)
        ],
        "sign_widths": {
            term.name: shape[0]
            for term, shape in zip(result.plan.terms, visit.shapes, strict=True)
            if term in result.terms and CATALOGUE[term.effect].nuisance_shape
        },
        "left_out": visit.left_out,
        "notices": list(visit.notices),
        "errors": result.errors(visit) or None,
    }


def identified_urdf(model: CableModel, pi_std: Vector, manipulator: Manipulator) -> str:
    """Write the URDF of the identified robot.

    Of a robot that is given by a URDF the inertias are replaced: each moving link has that of all that is rigidly
    attached to it, joints that the transmission leaves out are fixed, and meshes, whose files may be elsewhere, are
    left out.
    """
    if manipulator.urdf is None:
        return generate_urdf(manipulator)
    robot = ElementTree.fromstring(read_text(manipulator.urdf))
    moving = dict(zip(model.joints, np.reshape(pi_std, (-1, 10)), strict=True))
    bodies: dict[str, Vector] = {}
    for joint in robot.findall("joint"):
        child = joint.find("child")
        assert child is not None
        if joint.get("name", "") in moving:
            bodies[child.get("link", "")] = moving[joint.get("name", "")]
        elif joint.get("type") != "fixed":
            joint.set("type", "fixed")
            _remove(joint, ("limit", "axis", "dynamics"))
        _remove(joint, ("mimic",))
    for link in robot.findall("link"):
        _remove(link, ("inertial",))
        for tag in ("visual", "collision"):
            for element in [e for e in link.findall(tag) if e.find(".//mesh") is not None]:
                link.remove(element)
        if link.get("name", "") in bodies:
            link.insert(0, _inertial(bodies[link.get("name", "")]))
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _remove(element: ElementTree.Element, tags: Sequence[str]) -> None:
    for tag in tags:
        for child in element.findall(tag):
            element.remove(child)


def _inertial(pi: Vector) -> ElementTree.Element:
    """Write a body; a frame without mass gets one that no torque feels, as MuJoCo demands."""
    mass, center, inertia = about_center(pi) if pi[0] > 0 else (1e-9, np.zeros(3), 1e-12 * np.eye(3))
    element = ElementTree.Element("inertial")
    xyz = " ".join(repr(float(value)) for value in center)
    ElementTree.SubElement(element, "origin", xyz=xyz, rpy="0 0 0")
    ElementTree.SubElement(element, "mass", value=repr(mass))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    values = {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz}
    ElementTree.SubElement(element, "inertia", {name: repr(float(value)) for name, value in values.items()})
    return element
