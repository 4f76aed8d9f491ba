"""What can be wrong with a cable-driven arm, by its agreed name, and how large a mechanic would call it a fault."""

from __future__ import annotations

import numpy as np

from .faults import (
    Entry,
    Fault,
    apart,
    base,
    cable,
    crossing,
    guide,
    interval,
    joint,
    link,
    load,
    log_load,
    map_entry,
    motor,
    motor_and_joint,
    number,
    over,
    phase,
    side,
    signed,
    signed_load,
    slides,
    system_or_motor,
    times,
    whole,
)
from .strange import STRANGE

DRY = load(0.15, 0.6)  # [N m] on an arm of 10 N m
_ELASTIC = {"stiffness": log_load(60.0, 300.0), "damping": times("stiffness", 0.0015, 0.004)}
_SOFT = {"stiffness": over("limit", 0.02, 0.12)}  # limit first: it is what the draw fixes

CATALOGUE: dict[str, Entry] = {
    "viscous_friction": Entry(slides, {"viscous": load(0.1, 0.5)}, ("viscous",)),
    "coulomb_friction": Entry(slides, {"coulomb": DRY}, ("coulomb",)),
    "stribeck_friction": Entry(
        side,
        {"coulomb": DRY, "stribeck": times("coulomb", 0.6, 1.5), "stribeck_velocity": number(0.1, 0.35)},
        ("coulomb", "stribeck"),
    ),
    "asymmetric_friction": Entry(
        side,
        {"coulomb_positive": DRY, "coulomb_negative": apart("coulomb_positive", 0.35, 0.75)},
        ("coulomb_positive", "coulomb_negative"),
    ),
    "quadratic_drag": Entry(joint, {"coefficient": load(0.1, 0.4)}, ("coefficient",)),
    "load_dependent_friction": Entry(  # some 400 N on a hinge, pretension included
        joint, {"coefficient": load(0.15 / 400, 0.6 / 400)}, ("coefficient",)
    ),
    "torque_dependent_friction": Entry(side, {"coefficient": number(0.05, 0.2)}, ("coefficient",)),
    "position_dependent_friction": Entry(
        side, {"coulomb": DRY, "depth": number(0.5, 0.95), "cycles": number(1.0, 3.0), "phase": phase()}, ("coulomb",)
    ),
    "cable_friction": Entry(guide, {"coulomb": DRY}, ("coulomb",)),
    "capstan_friction": Entry(crossing, {"mu": number(0.005, 0.03)}, ("mu",)),
    "hysteresis": Entry(slides, {"limit": DRY, **_SOFT}, ("stiffness", "limit"), form="dahl"),
    "friction_drift": Entry(
        side, {"friction": DRY, "extra": number(0.6, 1.5), "time_constant": number(8.0, 25.0)}, ("friction",)
    ),
    "joint_spring": Entry(
        joint,
        {"stiffness": load(0.5, 2.0), "rest": number(-0.4, 0.4), "cubic": times("stiffness", 0.5, 1.5, share=0.4)},
        ("stiffness", "cubic"),
    ),
    "cable_elasticity": Entry(cable, _ELASTIC, ("stiffness", "damping"), compliant=True),
    "backlash": Entry(cable, {"half_gap": number(0.004, 0.02)}, ("half_gap",), ("both", "motor")),
    "cable_slack": Entry(
        cable,
        {"torque": number(0.3, 0.6), **_ELASTIC},  # a share of what the cable carries, until the arm is known
        ("stiffness", "damping"),
        ("both",),
        compliant=True,
    ),
    "transmission_ratio_error": Entry(map_entry, {"relative_error": signed(0.02, 0.07)}, ("relative_error",)),
    "transmission_coupling": Entry(
        motor_and_joint,
        {"ratio": signed(0.3, 0.9), "coulomb": DRY, "inertia": load(0.005, 0.02, share=0.5)},
        ("coulomb", "inertia"),
        ("joint",),
    ),
    "pulley_eccentricity": Entry(
        joint, {"relative_eccentricity": number(0.02, 0.06), "phase": phase()}, ("relative_eccentricity",)
    ),
    "torque_ripple": Entry(
        motor, {"amplitude": load(0.1, 0.4), "cycles": whole(4, 25), "phase": phase()}, ("amplitude",)
    ),
    "rotor_inertia": Entry(motor, {"inertia": load(0.005, 0.02)}, ("inertia",)),
    "torque_gain_error": Entry(
        motor, {"gain": lambda rng, unit, drawn: 1.0 + signed(0.05, 0.15)(rng, unit, drawn)}, ("gain",)
    ),
    "torque_offset": Entry(motor, {"offset": signed_load(0.15, 0.6)}, ("offset",)),
    "encoder_offset": Entry(joint, {"offset": signed(0.03, 0.12)}, ("offset",), ("both", "joint")),
    "base_tilt": Entry(base, {"angle": signed(0.03, 0.12)}, ("angle",)),
    "payload": Entry(link, {"mass": load(0.2, 0.8)}, ("mass",)),
    "time_delay": Entry(system_or_motor, {"delay": number(0.01, 0.03)}, ("delay",)),
    "external_torque": Entry(
        joint, {"torque": signed_load(0.3, 1.2), "time": interval(8.0, 45.0, 1.0, 5.0)}, ("torque",)
    ),
}

FORMS: dict[str, list[Entry]] = {  # other laws of the same name
    "hysteresis": [
        Entry(slides, {"limit": DRY, **_SOFT}, ("stiffness", "limit"), form="bouc_wen"),
        Entry(slides, {"limit": DRY, **_SOFT}, ("stiffness", "limit"), form="maxwell_slip"),
        Entry(
            slides,
            {"limit": DRY, **_SOFT, "damping": times("limit", 0.02, 0.08), "stribeck": number(0.0, 0.5),
             "stribeck_velocity": number(0.1, 0.3)},
            ("stiffness", "limit", "damping"),
            form="lugre",
        ),
        Entry(cable, {"limit": DRY, **_SOFT}, ("stiffness", "limit"), form="dahl"),
        Entry(cable, {"limit": DRY, "stiffness": number(0.3, 1.0)}, ("limit",), form="tension"),  # N m per N m
    ]
}  # fmt: skip

EVERYTHING = CATALOGUE | STRANGE


def draw_fault(name: str, rng: np.random.Generator, n: int, scale: float, tension: bool = True) -> Fault:
    """Draw the fault `name`; of several laws of that name, one, with memory of a cable's tension if that is allowed."""
    entries = [EVERYTHING[name], *FORMS.get(name, [])]
    entries = [entry for entry in entries if tension or entry.form != "tension"]
    entry = entries[int(rng.integers(len(entries)))]
    return entry.draw(name, rng, n, scale, in_catalogue=name in CATALOGUE)
