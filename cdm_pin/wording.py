"""What a diagnosis says, in words a mechanic understands; read from the content of diagnosis.json alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

Content = Mapping[str, Any]

EFFECT_NAMES = {
    "viscous_friction": "viscous friction",
    "coulomb_friction": "dry friction",
    "stribeck_friction": "stick-slip (Stribeck) friction",
    "asymmetric_friction": "direction-dependent friction",
    "quadratic_drag": "quadratic drag",
    "load_dependent_friction": "bearing friction that grows with load",
    "torque_dependent_friction": "friction that grows with torque",
    "position_dependent_friction": "friction that varies with position",
    "cable_friction": "cable friction",
    "capstan_friction": "capstan friction",
    "hysteresis": "hysteresis",
    "friction_drift": "friction that drifts while warming up",
    "joint_spring": "a joint spring",
    "cable_elasticity": "cable elasticity",
    "backlash": "backlash",
    "lost_motion": "lost motion",
    "cable_slack": "cable slack",
    "transmission_ratio_error": "a transmission ratio error",
    "transmission_coupling": "transmission coupling",
    "pulley_eccentricity": "pulley eccentricity",
    "torque_ripple": "torque ripple",
    "rotor_inertia": "rotor inertia",
    "torque_gain_error": "a torque gain error",
    "torque_offset": "a torque offset",
    "encoder_offset": "an encoder offset",
    "base_tilt": "base tilt",
    "payload": "a payload",
    "time_delay": "a time delay",
    "external_torque": "an external torque",
}

# What is said of an effect at {place}; {name} is a parameter with its error and unit, {name:%} in per cent,
# {name:ms} in milliseconds, {name:#} without unit. A part in [brackets] is left out where its parameters are missing.
_CLAUSES = {
    "viscous_friction": "{place} drags with a viscous friction of {viscous}",
    "coulomb_friction": "{place} loses {coulomb} to dry friction when it reverses",
    "stribeck_friction": "{place} sticks before it slides: {coulomb} of dry friction[ and {stribeck} more near "
    "standstill, fading above {stribeck_velocity}]",
    "asymmetric_friction": "{place} rubs unequally: {coulomb_positive} forwards, {coulomb_negative} backwards",
    "quadratic_drag": "{place} is held back by drag that grows with the square of its speed, {coefficient}",
    "load_dependent_friction": "{place} rubs more the more its bearing is loaded, {coefficient}",
    "torque_dependent_friction": "{place} rubs more the more torque it transmits, {coefficient}",
    "position_dependent_friction": "{place} rubs more at some positions than at others[, {coulomb} on average]",
    "cable_friction": "{place} rubs on its guides and loses {coulomb}",
    "capstan_friction": "{place} rubs around its pulleys with a friction coefficient of {mu}, more under more tension",
    "hysteresis": "{place} gives before it slips: hysteresis of {limit}[ behind a stiffness of {stiffness}]",
    "tension_hysteresis": "{place} holds on to the torque it carried: hysteresis of {limit}, memory in tension",
    "friction_drift": "{place} starts with {extra:%} more friction than it settles to[, with a time constant of "
    "{time_constant}][, its drag of {viscous} with it]",
    "joint_spring": "{place} is pulled by a spring of {stiffness}[ towards {rest}]",
    "spring_away": "{place} is pushed away[ from {rest}] by a spring of {stiffness}",
    "spring_unsure": "{place} is pulled by a spring[ towards {rest}], of a stiffness that is hardly known, {stiffness}",
    "spring_that_stiffens": "{place} is pulled by a spring that stiffens, {cubic}",
    "cable_elasticity": "{place} stretches, with a stiffness of {stiffness}[ and a damping of {damping}]",
    "backlash": "{place} has lost motion of {half_gap} to each side at every reversal",
    "lost_motion": "{place} leaves its joint {half_gap} behind at every reversal, within {distance} of its way",
    "cable_slack": "{place} goes slack on one side once its torque passes {torque}",
    "transmission_ratio_error": "{place} runs at a ratio that is off by {relative_error:%}",
    "transmission_coupling": "{place} turn together, at a ratio of {ratio}",
    "pulley_eccentricity": "{place} has a pulley that runs out of true by {relative_eccentricity:%} of its radius",
    "torque_ripple": "{place} ripples by {amplitude}[, {cycles:#} times a turn]",
    "rotor_inertia": "{place} carries a rotor inertia of {inertia} that the file lacks",
    "torque_gain_error": "{place} logs its torque with a gain of {gain} instead of 1",
    "torque_offset": "{place} logs its torque {offset} off",
    "encoder_offset": "{place} logs its position {offset} off",
    "base_tilt": "{place} is tilted by {angle}",
    "payload": "{place} carries {mass} that the file lacks",
    "time_delay": "the torque of {place} is logged {delay:ms} late",
    "external_torque": "something pushed on {place} with {torque}",
}

_MOST = 4  # findings whose sizes a sentence says, and doubts; what is more is counted
_ERRORS = {"N m": "torque", "N": "force"}
_REST_KNOWN = 0.3  # [rad or m]
_COUNTS = ("No", "One thing is", "Two things are", "Three things are", "Four things are", "Five things are")


def sentence(diagnosis: Content) -> str:
    """Say the verdict of a diagnosis in one sentence.

    Parameters
    ----------
    diagnosis : mapping
        The content of diagnosis.json.

    Returns
    -------
    str
        What is missing, where and how large, what it improves on the unseen run, what it cannot be told from and what
        to record next; one sentence that ends with a full stop.
    """
    build = _VERDICTS.get(str(diagnosis.get("verdict")), _insufficient)
    text = "; ".join(part for part in build(_with_names(diagnosis)) if part)
    return text[:1].upper() + text[1:] + "."


def _missing(diagnosis: Content) -> list[str]:
    findings = diagnosis.get("findings") or []
    clauses = _clauses(findings)
    if len(findings) > 1:
        count = _COUNTS[len(findings)] if len(findings) < len(_COUNTS) else f"{len(findings)} things are"
        clauses[0] = f"{count} missing: {clauses[0]}"
    doubts = [text for finding in findings if (text := doubt(finding, "this" if len(findings) == 1 else ""))]
    if len(doubts) > _MOST:
        doubts = [f"{len(doubts)} of them these data cannot tell from others, listed with each"]
    rest = "" if any(doubts) else "nothing else is missing above the sensitivities listed"
    return [*clauses, improvement(diagnosis), *doubts, _to_find_out(diagnosis) if any(doubts) else rest]


def _consistent(diagnosis: Content) -> list[str]:
    left = _error_left(diagnosis)
    return [
        f"nothing is missing above the sensitivities listed: rigid links and ideal cables explain the torques{left}",
        changed_masses(diagnosis),
        _to_find_out(diagnosis),
    ]


def _unexplained(diagnosis: Content) -> list[str]:
    rest = diagnosis.get("unexplained") or {}
    where = place(rest.get("location") or {"kind": "system"})
    unit = rest.get("unit") or _unit(diagnosis, 0)
    size = f", {number(rest['rms'])} {unit} rms" if rest.get("rms") else ""
    region = str(rest.get("region") or "")
    said = region.split(" ", 1)[0] in ("", "around", "at", "between", "in", "near", "while", "above", "below")
    region = f"{'' if said else ':'} {region}".rstrip()
    parts = [f"something that none of the known effects explains happens on {where}{region}{_when(rest)}{size}"]
    if rest.get("nearest"):
        parts.append(f"nearest to it, but not it: {_either([candidate(near) for near in rest['nearest']])}")
    findings = diagnosis.get("findings") or []
    if findings:
        parts += ["sure beside it: " + ", and ".join(_clauses(findings)), improvement(diagnosis, "all that was fitted")]
    return [*parts, _to_find_out(diagnosis)]


def _insufficient(diagnosis: Content) -> list[str]:
    rivals = next((f for f in diagnosis.get("findings") or [] if f.get("indistinguishable_from")), None)
    if rivals:
        others = _either([candidate(other) for other in rivals["indistinguishable_from"]])
        first = f"these data cannot tell {candidate(rivals)} from {others}"
    else:
        reason = diagnosis.get("reason")
        first = f"these data are too few to decide{f' ({reason})' if reason else ''}"
    return [first, _to_find_out(diagnosis)]


_VERDICTS: dict[str, Callable[[Content], list[str]]] = {
    "missing_physics": _missing,
    "consistent": _consistent,
    "unexplained": _unexplained,
    "insufficient_data": _insufficient,
}


def _clauses(findings: Sequence[Content]) -> list[str]:
    """Say the strongest findings, confirmed ones first, and how many there are beside them."""
    first = sorted(findings, key=unconfirmed) if len(findings) > _MOST else findings
    more = len(findings) - _MOST
    counted = [f"{more} more of less weight, listed below"] if more > 0 else []
    return [clause(finding) for finding in first[:_MOST]] + counted


def _with_names(diagnosis: Content) -> Content:
    """Give the places of findings the names that the robot's file has for them."""
    names, out = diagnosis.get("names") or {}, dict(diagnosis)

    def named(entry: Content) -> Content:
        location = dict(entry.get("location") or {})
        known = names.get(str(location.get("kind"))) or []
        index = location.get("index")
        return {**entry, "location": location | {"name": known[index - 1] if index and index <= len(known) else None}}

    out["findings"] = [named(finding) for finding in diagnosis.get("findings") or []]
    if diagnosis.get("unexplained"):
        out["unexplained"] = named(diagnosis["unexplained"])
    return out


def clause(finding: Content) -> str:
    """Say one finding: what happens, where, how large; without capital and full stop."""
    effect, parameters = str(finding.get("effect")), finding.get("parameters") or {}
    where = place(finding.get("location") or {})
    special, parameters = _special(finding, parameters)
    template = _CLAUSES.get(special or effect)
    text = _fill(template, where, parameters) if template else None
    if text is None:
        sizes = ", ".join(f"{name.replace('_', ' ')} {quantity(p)}" for name, p in parameters.items())
        text = f"{where} shows {effect_name(effect)}{f' ({sizes})' if sizes else ''}"
    return text + _when(finding) + (" (unconfirmed)" if unconfirmed(finding) else "")


def _special(finding: Content, parameters: Content) -> tuple[str, Content]:
    """Give the clause of a law that does not do what its name says at first, and the parameters to fill it with."""
    stiffness = parameters.get("stiffness")
    if finding.get("memory") == "cable tension":
        return "tension_hysteresis", parameters
    if finding.get("effect") != "joint_spring" or not isinstance(stiffness, Mapping):
        return "", parameters
    cubic = parameters.get("cubic")
    if not _is_known(stiffness):
        stiffens = isinstance(cubic, Mapping) and _is_known(cubic, "cubic") and cubic["value"] > 0.0
        return "spring_that_stiffens" if stiffens else "spring_unsure", parameters
    if stiffness["value"] < 0.0:
        return "spring_away", {**parameters, "stiffness": {**stiffness, "value": -stiffness["value"]}}
    return "", parameters


def _is_known(parameter: Any, name: str = "") -> bool:
    """Whether a parameter is twice its standard error; a rest, where it is known to a third of a radian or metre."""
    value = parameter.get("value") if isinstance(parameter, Mapping) else parameter
    std = parameter.get("std", 0.0) if isinstance(parameter, Mapping) else 0.0
    if not isinstance(value, int | float) or not isinstance(std, int | float):
        return isinstance(value, list)
    return std < (_REST_KNOWN if name == "rest" else 0.5 * abs(value)) or std == 0.0 != value


def _fill(template: str, where: str, parameters: Content) -> str | None:
    """Fill a clause; None if a parameter outside [brackets] is missing; inside, what is hardly known is left out."""
    parts = template.replace("]", "[").split("[")
    known = {name: parameter for name, parameter in parameters.items() if _is_known(parameter, name)}
    texts = [_fill_part(part, where, known if k % 2 else parameters) for k, part in enumerate(parts)]
    if any(text is None for text in texts[::2]):
        return None
    return "".join(text or "" for text in texts)


def _fill_part(part: str, where: str, parameters: Content) -> str | None:
    text = part.replace("{place}", where)
    for name, parameter in parameters.items():
        text = text.replace(f"{{{name}}}", quantity(parameter))
        text = text.replace(f"{{{name}:%}}", quantity(parameter, 100.0, "%"))
        text = text.replace(f"{{{name}:ms}}", quantity(parameter, 1000.0, "ms"))
        if isinstance(parameter, Mapping) and parameter.get("unit") == "1/m":
            per_metre = quantity(parameter, 0.5 / math.pi, "1")
            text = text.replace(f"{{{name}:#}} times a turn", f"{per_metre} times a metre")
        text = text.replace(f"{{{name}:#}}", quantity(parameter, 1.0, "1"))
    return None if "{" in text else text


def unconfirmed(finding: Content) -> bool:
    """Whether a finding was judged without an unseen recording that could show it."""
    return bool(finding.get("unconfirmed")) or finding.get("status") == "unconfirmed"


def doubt(finding: Content, it: str = "") -> str:
    """Say what a finding, or `it`, cannot be told from, or nothing."""
    others = [candidate(other) for other in finding.get("indistinguishable_from") or []]
    return f"these data cannot tell {it or candidate(finding)} from {_either(others)}" if others else ""


def improvement(diagnosis: Content, by: str = "") -> str:
    """Say how far the error falls, on the motor where it falls most, and where the floor is.

    That of torque; of the travel between motor and joint encoders where this falls and that of torque hardly does.
    """
    name, fit = _judged(diagnosis)
    torque, travel = _fall(fit), _fall(fit.get("travel") or {})
    own = travel if travel and not (torque and torque[1] > 1.1 * torque[2]) else torque
    if not own:
        return ""
    k, rigid, augmented, floor = own
    if own is travel:
        error, unit = f"unexplained travel between motor {k + 1} and its joints", _of_motor(fit["travel"]["unit"], k)
    else:
        of_motor, unit = f" of motor {k + 1}" if len(fit["rmse_rigid"]) > 1 else "", _unit(diagnosis, k)
        error = f"{_ERRORS.get(unit, 'position')} error{of_motor}"
    text = f"with {by or ('it' if len(diagnosis.get('findings') or []) < 2 else 'them')}, "
    text += f"{error} on the {name} falls from {number(rigid)} to {number(augmented)} {unit}"
    return text + _short_of([augmented], [floor], 0, reached=", the noise floor")


def _fall(fit: Content) -> tuple[int, float, float, float] | None:
    """Give where an error falls most: which one, its size before and after, and the floor; None if none falls."""
    rigid, augmented, floor = (fit.get(key) or [] for key in ("rmse_rigid", "rmse_augmented", "noise_floor"))
    if not rigid or len(augmented) != len(rigid):
        return None
    k = max(range(len(rigid)), key=lambda i: (rigid[i] or 0.0) - (augmented[i] or 0.0))
    before, after = rigid[k] or 0.0, augmented[k] or 0.0
    return (k, before, after, floor[k] if k < len(floor) else 0.0) if before > after else None


def changed_masses(diagnosis: Content) -> str:
    """Say which links differ from the file, or nothing."""
    changed = (diagnosis.get("rigid_body") or {}).get("changed") or []
    links = sorted({link for change in changed for link in change.get("links") or []})
    if not changed:
        return ""
    named = f" of link{'s' if len(links) > 1 else ''} {_listed([str(i) for i in links])}" if links else ""
    classes = {candidate(other) for change in changed for other in change.get("indistinguishable_from") or []}
    beside = f", which may as well be {_either(sorted(classes)[:3])}" if classes else ""
    return f"the masses or inertias{named} differ from the file{beside}"


def next_experiment(diagnosis: Content) -> str:
    """Say what to record next, or nothing."""
    plan = diagnosis.get("next_experiment") or {}
    steps = [f"the trajectory {plan['file']}"] if plan.get("file") else []
    steps += [str(plan["change"])] if plan.get("change") else []
    if not steps:
        return ""
    power = plan.get("power")
    return f"record {' with '.join(steps)}" + (f" ({100 * power:.0f} % sure to decide)" if power else "")


def _to_find_out(diagnosis: Content) -> str:
    text = next_experiment(diagnosis)
    return text and f"{text} to find out"


def effect_name(effect: str) -> str:
    """Give the plain name of an effect of the catalogue, or its own name in words."""
    return EFFECT_NAMES.get(effect, effect.replace("_", " "))


def candidate(entry: Content) -> str:
    """Name an effect and its place, and when it was: ``"dry friction of joint 2"``."""
    location = entry.get("location") or {}
    where = "" if location.get("kind") in (None, "base", "system") else f" of {place(location)}"
    return effect_name(str(entry.get("effect"))) + where + _when(entry)


def place(location: Content) -> str:
    """Name a place: ``"joint 2"``, ``"cable 3 at link 1"``, ``"motors 1 and 3 together"``."""
    kind = location.get("kind")
    if kind == "base":
        return "the base"
    if kind == "combination":
        weights: Sequence[float] = location.get("weights") or []
        motors = [str(i + 1) for i, weight in enumerate(weights) if abs(weight) > 1e-9]
        return f"the contact between motors {_listed(motors)}"
    if kind in (None, "system"):
        return "the whole robot"
    text = f"{kind} {location.get('index', '?')}"
    name = str(location.get("name") or "").replace("_", " ")
    text += f" ({name})" if name not in ("", text) else ""
    for other in ("link", "joint"):
        if other in location:
            text += f" {'and' if kind == 'motor' else 'at'} {other} {location[other]}"
    return text


def quantity(parameter: Any, factor: float = 1.0, unit: str | None = None) -> str:
    """Write a parameter with its standard error and unit: ``"0.310 ± 0.004 N m"``."""
    if not isinstance(parameter, Mapping):
        return number(parameter) if isinstance(parameter, (int, float)) else str(parameter)
    value, std = parameter.get("value"), parameter.get("std")
    unit = unit or parameter.get("unit") or ""
    if isinstance(value, (list, tuple)):
        text = "(" + ", ".join(number(x * factor) for x in value) + ")"
    elif not isinstance(value, (int, float)):
        text = "of unknown size"
    else:
        text = with_error(value * factor, None if not isinstance(std, (int, float)) else std * factor)
    degrees = f" ({number(math.degrees(value), 2)} deg)" if unit == "rad" and isinstance(value, (int, float)) else ""
    return " ".join(part for part in (text, unit if unit != "1" else "") if part) + degrees


def with_error(value: float, std: float | None) -> str:
    """Write a value and its standard error with as many digits as the error (one or two significant ones) allows."""
    if std is None or not math.isfinite(std) or std <= 0.0 or not math.isfinite(value):
        return number(value)
    digits = -math.floor(math.log10(std)) + (1 if std / 10 ** math.floor(math.log10(std)) < 2 else 0)
    if digits > 6 or max(abs(value), std) >= 1e5:
        return f"{value:.3g} ± {std:.1g}"
    return f"{value:.{max(digits, 0)}f} ± {std:.{max(digits, 0)}f}"


def number(value: Any, digits: int = 3) -> str:
    """Write a number with `digits` significant digits and no exponent where a person can do without."""
    if not isinstance(value, (int, float)) or not math.isfinite(value):
        return "unknown"
    value += 0.0  # zero has no sign
    if value == 0 or not 1e-4 <= abs(value) < 1e5:
        return f"{value:.{digits}g}"
    text = f"{value:.{max(digits - 1 - math.floor(math.log10(abs(value))), 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def _judged(diagnosis: Content) -> tuple[str, Content]:
    fit = diagnosis.get("fit") or {}
    return ("unseen run", fit["holdout"]) if fit.get("holdout") else ("same recordings", fit.get("train") or {})


def _error_left(diagnosis: Content) -> str:
    """Say how large the largest error of the fit that judges is, beside the noise floor."""
    name, fit = _judged(diagnosis)
    values, floor = (fit.get(key) or [] for key in ("rmse_rigid", "noise_floor"))
    known = [k for k, value in enumerate(values) if isinstance(value, (int, float))]
    if not known:
        return ""
    k = max(known, key=lambda k: values[k])
    size, unit = number(values[k]), _unit(diagnosis, k)
    short = _short_of(values, floor, k)
    if short:
        return f", to {size} {unit} on the {name}{short}"
    return f", down to the noise floor ({size} {unit} on the {name})"


def _short_of(values: Sequence[float], floor: Sequence[float], k: int, reached: str = "") -> str:
    """Say where the noise floor is if an error is above it; nothing where that is not known."""
    if not (k < len(floor) and floor[k]):
        return ""
    return reached if values[k] <= 1.15 * floor[k] else f", where the noise floor is {number(floor[k])}"


def _unit(diagnosis: Content, motor: int) -> str:
    return _of_motor((diagnosis.get("fit") or {}).get("unit", "N m"), motor)


def _of_motor(unit: str | Sequence[str], motor: int) -> str:
    return unit if isinstance(unit, str) else unit[motor]


def _when(entry: Content) -> str:
    time, recording = entry.get("time"), entry.get("recording")
    text = f" between {number(time[0], 4)} and {number(time[1], 4)} s" if time else ""
    return text + (f" of {recording}" if text and recording else "")


def _listed(words: Sequence[str], last: str = "and") -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}" if words else ""


def _either(words: Sequence[str]) -> str:
    return _listed(words, "or")
