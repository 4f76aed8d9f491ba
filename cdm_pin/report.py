"""Write report.html: one file that tells what a diagnosis found, in words and figures, without script or network."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from . import report_figures as figures
from .effects import CATALOGUE
from .files import write_text
from .model import CableModel
from .report_evidence import Evidence, LawCurve, Rival, RunEvidence, SimulatedMotion
from .report_page import PAGE, cards, figure, key, paragraph, table
from .report_robot import robot_picture
from .svg import BLACK, BLUE, VERMILLION
from .units import either, joint_units
from .wording import (
    candidate,
    changed_masses,
    effect_name,
    next_experiment,
    number,
    place,
    quantity,
    sentence,
    unconfirmed,
    with_error,
)

__all__ = ["Evidence", "LawCurve", "Rival", "RunEvidence", "SimulatedMotion", "report_html", "write_report"]

MODELS_KEY = key([("measured", BLACK, ""), ("rigid body", VERMILLION, "6 3"), ("completed model", BLUE, "")])
VERDICTS = {
    "consistent": ("✓", "Consistent", "good"),
    "missing_physics": ("!", "Missing physics found", "found"),
    "unexplained": ("?", "Something unexplained", "open"),
    "insufficient_data": ("…", "Not enough data", "open"),
}


def write_report(
    path: str | os.PathLike[str], diagnosis: Mapping[str, Any], evidence: Evidence | None, model: CableModel
) -> None:
    """Write the report of a diagnosis, whole or not at all.

    Parameters
    ----------
    path : path-like
        The HTML file to write.
    diagnosis : mapping
        The content of diagnosis.json.
    evidence : Evidence or None
        What the figures are drawn from.
    model : CableModel
        The robot.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    write_text(path, report_html(diagnosis, evidence, model))


def report_html(diagnosis: Mapping[str, Any], evidence: Evidence | None, model: CableModel) -> str:
    """Give the report as text; see `write_report`."""
    evidence = evidence or Evidence()
    verdict = str(diagnosis.get("verdict"))
    sign, word, tone = VERDICTS.get(verdict, ("", verdict, "open"))
    sections = [
        ("where", "Where", _where(diagnosis, evidence, model)),
        ("what", "What", _what(diagnosis, evidence)),
        ("size", "How large", _how_large(diagnosis, evidence)),
        ("better", "How much better", _how_much_better(diagnosis, evidence, model)),
        ("seen", "What would have been seen", _seen(diagnosis)),
        ("next", "What to record next", _next(diagnosis)),
        ("data", "About the data", _data(evidence)),
    ]
    sections = [(name, title, body) for name, title, body in sections if body]
    return PAGE.format(
        title=escape(model.manipulator.name),
        sign=sign,
        word=escape(word),
        tone=tone,
        sentence=escape(sentence(diagnosis)).replace(" N m", "&nbsp;N&nbsp;m"),
        contents="".join(f'<a href="#{name}">{title}</a>' for name, title, _ in sections),
        sections="".join(f'<section id="{name}"><h2>{title}</h2>{body}</section>' for name, title, body in sections),
    )


def _where(diagnosis: Mapping[str, Any], evidence: Evidence, model: CableModel) -> str:
    marked = [dict(finding) for finding in diagnosis.get("findings") or []]
    if diagnosis.get("unexplained"):
        marked.append({"effect": "unexplained", **diagnosis["unexplained"]})
    places = [entry.get("location") or {} for entry in marked]
    caption = "; ".join(f"{k}: {_named(entry)}" for k, entry in enumerate(marked, 1)) or "No place stands out"
    html = figure(robot_picture(model, places), f"Circles: joints; squares: motors. {caption}")
    units = evidence.runs[0].units if evidence.runs else ("N m",)
    rows = figures.rows(model.joint_from_motor, evidence.noise_floor, units)
    if evidence.runs:
        words = "Size of the error over time, before and after. A fault at a joint lights that joint alone among the "
        html += "<h3>When</h3>" + paragraph(
            words + "joints; a fault at a motor lights that motor alone among the motors."
        )
    for run in _chosen_runs(evidence):
        html += cards(figures.time_maps(run, rows))
    *maps, scale = figures.state_maps(evidence.runs, rows) or [("", "")]
    if maps:
        words = "Mean error of the rigid body at each joint and motor, against position and velocity of each joint. "
        words += "White: none; blue: measured less than the model; brown: measured more. Grey: no data."
        html += "<h3>In which state</h3>" + paragraph(words) + scale[1] + cards(maps)
    return html


def _named(entry: Mapping[str, Any]) -> str:
    region = f", {entry['region']}" if entry.get("region") else ""
    if entry.get("effect") == "unexplained":
        return f"unexplained, {place(entry.get('location') or {})}{region}"
    return candidate(entry) + region


def _chosen_runs(evidence: Evidence, count: int = 2) -> list[RunEvidence]:
    """Take the unseen runs first."""
    return sorted(evidence.runs, key=lambda run: not run.holdout)[:count]


def _what(diagnosis: Mapping[str, Any], evidence: Evidence) -> str:
    findings = diagnosis.get("findings") or []
    if not findings:
        return ""
    rows = []
    for k, finding in enumerate(findings, 1):
        proof = finding.get("evidence") or {}
        reduction, parts = proof.get("holdout_rmse_reduction"), proof.get("parts_rmse_reduction")
        others = ", ".join(candidate(other) for other in finding.get("indistinguishable_from") or [])
        rows.append([
            str(k),
            candidate(finding) + (" (unconfirmed)" if unconfirmed(finding) else ""),
            number(proof.get("delta_bic")),
            _chance(proof.get("log10_p")),
            _share(reduction) if parts is None else f"{_share(parts)} (parts)",
            others or "nothing else",
        ])  # fmt: skip
    judged_apart = any((f.get("evidence") or {}).get("parts_rmse_reduction") is not None for f in findings)
    header = ["", "Finding", "BIC gain", "Chance", "Error removed on unseen data", "Cannot be told from"]
    html = table(header, rows) + paragraph(
        "BIC gain: how much better the recordings are described, after paying for each parameter. "
        "Chance: how likely noise alone would look like this."
        + (" Parts: no recording is unseen, so each part is judged by a fit to all others." if judged_apart else "")
    )
    return html + "".join(_rivals(k, findings, evidence) for k in range(len(findings)))


def _share(value: Any) -> str:
    return f"{100 * value:.0f} %" if isinstance(value, (int, float)) else "-"


def _chance(log10_p: Any) -> str:
    if not isinstance(log10_p, (int, float)):
        return "-"
    return f"10^{log10_p:.0f}" if log10_p > -300 else "below 10^-300"


def _rivals(k: int, findings: Sequence[Mapping[str, Any]], evidence: Evidence) -> str:
    rivals = evidence.rivals[k] if k < len(evidence.rivals) else ()
    if not rivals:
        return ""
    best = (findings[k].get("evidence") or {}).get("delta_bic") or 0.0
    rows = [[candidate(vars(rival)), number(round(best - rival.delta_bic, 2)), rival.reason] for rival in rivals]
    return f"<h3>Rivals of {escape(candidate(findings[k]))}</h3>" + table(["Rival", "BIC behind", "Why it lost"], rows)


def _how_large(diagnosis: Mapping[str, Any], evidence: Evidence) -> str:
    html = ""
    for k, finding in enumerate(diagnosis.get("findings") or []):
        rows = [
            [name.replace("_", " "), quantity(parameter), _interval(parameter)]
            for name, parameter in (finding.get("parameters") or {}).items()
        ]
        html += f"<h3>{k + 1}. {escape(candidate(finding)).capitalize()}</h3>"
        html += table(["Parameter", "Value ± standard error", "95 % interval"], rows)
        curve = evidence.laws[k] if k < len(evidence.laws) else None
        if curve is not None:
            html += figure(figures.law(curve, f"fitted law of {candidate(finding)}"), "Dots: data; line: fitted law.")
    if evidence.unexplained is not None:
        picture = figures.law(evidence.unexplained, "shape of what is not explained")
        html += "<h3>Not explained</h3>" + figure(picture, "Dots: data; line: smooth, unnamed correction.")
    changed = (diagnosis.get("rigid_body") or {}).get("changed") or []
    if changed:
        html += "<h3>Rigid body</h3>" + paragraph(changed_masses(diagnosis).capitalize() + ".") + _changes(changed)
    return html


def _interval(parameter: Any) -> str:
    value, std = (parameter.get("value"), parameter.get("std")) if isinstance(parameter, Mapping) else (None, None)
    if not isinstance(value, (int, float)) or not isinstance(std, (int, float)):
        return "-"
    low, high = (with_error(value + sign * 1.96 * std, std).split(" ± ")[0] for sign in (-1, 1))
    return f"{low} to {high}"


def _changes(changed: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for change in changed:
        others = ", ".join(candidate(other) for other in change.get("indistinguishable_from") or [])
        value = with_error(change.get("value", float("nan")), change.get("std"))
        rows.append([str(change.get("base_parameter")), number(change.get("nominal")), value, others or "nothing else"])
    return table(["Base parameter", "In the file", "Found", "Cannot be told from"], rows)


def _how_much_better(diagnosis: Mapping[str, Any], evidence: Evidence, model: CableModel) -> str:
    fit = diagnosis.get("fit") or {}
    unit = either(np.atleast_1d(fit.get("unit") or (evidence.runs[0].units if evidence.runs else "N m")))
    html = ""
    for part, title in (("holdout", "On unseen recordings"), ("train", "On the recordings fitted to")):
        own = fit.get(part) or {}
        rows = _fit_rows(own, "motor")
        if rows:
            words = f"Error [{unit}], rms. Upper bar: rigid body; lower bar: completed model; dashed: noise floor."
            html += f"<h3>{title}</h3>" + figure(figures.error_bars(rows, unit), words)
        if travel := own.get("travel"):
            between, apart = _fit_rows(travel, "motor"), either(np.atleast_1d(travel["unit"]))
            words = f"Unexplained travel between motors and their joints [{apart}], rms."
            html += figure(figures.error_bars(between, apart), words)
    runs = _chosen_runs(evidence, 1)
    if runs:
        html += _closest_look(runs[0], fit, evidence)
    simulated = fit.get("simulated_position")
    if simulated:
        horizon = f" over {number(simulated['horizon'])} s" if simulated.get("horizon") else ""
        position = either(joint_units(model))
        rows = [[name, number(r), number(a)] for name, r, a, _ in _fit_rows(simulated, "joint")]
        header = [f"Position error [{position}]", "Rigid", "Completed"]
        html += f"<h3>Simulated motion{horizon}</h3>" + table(header, rows)
        words = "Both models start in the recorded state, anew for each stretch, and are driven by the recorded torque "
        words += "alone; the error is rms over all stretches."
        held = ", ".join(candidate(entry) for entry in simulated.get("along_record") or [])
        html += paragraph(words + (f" Not run forward but taken along the record: {held}." if held else ""))
    for motion in evidence.simulated[:2]:
        html += MODELS_KEY.replace("measured", "recorded") + cards(figures.simulated_motion(motion))
    if evidence.animation:
        link = f'<a href="{escape(evidence.animation)}">{escape(evidence.animation)}</a>'
        html += f"<p>Watch recorded and simulated motion side by side: {link} (in this folder).</p>"
    return html


def _fit_rows(fit: Mapping[str, Any], kind: str) -> list[tuple[str, float, float, float | None]]:
    rigid, augmented = fit.get("rmse_rigid") or [], fit.get("rmse_augmented") or []
    floor = fit.get("noise_floor") or [None] * len(rigid)
    rows = zip(rigid, augmented, floor, strict=False)
    return [(f"{kind} {i}", r, a, f) for i, (r, a, f) in enumerate(rows, 1) if None not in (r, a)]


def _closest_look(run: RunEvidence, fit: Mapping[str, Any], evidence: Evidence) -> str:
    """Show the motor that gains most, in the stretch that shows it most, and its spectra."""
    before, after = (np.nan_to_num(np.sqrt(np.nanmean(r**2, axis=0))) for r in figures.residuals(run))
    motor = int(np.argmax(before - after))
    floor = float(evidence.noise_floor[motor]) if evidence.noise_floor is not None else None
    html = f"<h3>Motor {motor + 1}, {escape(run.label)}</h3>" + MODELS_KEY
    html += cards(figures.worst_stretch(run, motor, floor))
    spectra = figures.spectrum(run, motor, floor)
    words = "Error over frequency; dotted: white noise at the floor."
    return html + (figure(spectra, words) if spectra else "")


def _seen(diagnosis: Mapping[str, Any]) -> str:
    effects: dict[str, list[Mapping[str, Any]]] = {}
    for entry in diagnosis.get("sensitivity") or []:
        effects.setdefault(str(entry.get("effect")), []).append(entry)
    if not effects:
        return ""
    rows = []
    for effect in sorted(effects, key=_bare_name):
        seen = [entry for entry in effects[effect] if entry.get("amplitude") is not None]
        unseen = [place(entry.get("location") or {}) for entry in effects[effect] if entry.get("amplitude") is None]
        absorbed = {_absorber(other) for entry in effects[effect] for other in entry.get("absorbed_by") or []}
        shown = "; ".join(_smallest(entry) for entry in seen)
        rows.append([_bare_name(effect), shown or "-", ", ".join(unseen) or "-", ", ".join(sorted(absorbed)) or "-"])
    words = (
        "The smallest size of each effect that these recordings would have shown at each place (9 times in 10, with 1 "
        "false alarm in 100 diagnoses). Where the masses of the links can imitate part of an effect, the part that "
        "remains visible is given."
    )
    return paragraph(words) + table(["Effect", "Smallest visible", "Not visible at", "Absorbed by"], rows, small=True)


def _bare_name(effect: str) -> str:
    return effect_name(effect).removeprefix("an ").removeprefix("a ")


def _smallest(entry: Mapping[str, Any]) -> str:
    unit, visible = entry.get("unit") or "", entry.get("visible_fraction")
    size = f"{number(float(format(entry['amplitude'], '.2g')))} {unit if unit != '1' else ''}".strip()
    part = f" ({100 * visible:.0f} % visible)" if isinstance(visible, (int, float)) and visible < 0.5 else ""
    return f"{place(entry.get('location') or {})}: {size}{part}"


def _absorber(other: Any) -> str:
    return candidate(other) if isinstance(other, Mapping) else str(other)


def _next(diagnosis: Mapping[str, Any]) -> str:
    text = next_experiment(diagnosis)
    findings = diagnosis.get("findings") or []
    if text:
        return paragraph(text[0].upper() + text[1:] + ".") + _telling_apart(findings)
    return _telling_apart(findings) + (
        paragraph("A second recording, of another motion, would confirm the findings.")
        if any(unconfirmed(f) for f in findings)
        else ""
    )


def _telling_apart(findings: Sequence[Mapping[str, Any]]) -> str:
    """List what would separate findings from other effects; what reveals an effect does not tell where it sits."""
    rows = []
    for finding in findings:
        for other in finding.get("indistinguishable_from") or []:
            effect = CATALOGUE.get(str(other.get("effect")))
            if effect is not None and effect.revealed_by and effect.name != finding["effect"]:
                rows.append([candidate(finding), candidate(other), effect.revealed_by])
    return table(["To tell", "from", "record"], rows) if rows else ""


def _data(evidence: Evidence) -> str:
    rows = [
        [
            run.label,
            "judged on" if run.holdout else "fitted to",
            f"{run.time[-1] - run.time[0]:.1f} s",
            str(len(run.time)),
        ]
        for run in evidence.runs
    ]
    html = table(["Recording", "Use", "Length", "Samples"], rows) if rows else ""
    return html + "".join(paragraph(text) for text in evidence.notices)
