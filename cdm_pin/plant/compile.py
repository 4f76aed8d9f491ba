"""From named faults to the arrays of laws that the passes evaluate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from . import laws as law
from .faults import Fault

_KINDS = {
    "viscous_friction": (law.VISCOUS, ("viscous",)),
    "coulomb_friction": (law.COULOMB, ("coulomb",)),
    "cable_friction": (law.COULOMB, ("coulomb",)),
    "stribeck_friction": (law.STRIBECK, ("coulomb", "stribeck", "stribeck_velocity")),
    "asymmetric_friction": (law.ASYMMETRIC, ("coulomb_positive", "coulomb_negative")),
    "quadratic_drag": (law.QUADRATIC, ("coefficient",)),
    "load_dependent_friction": (law.LOAD, ("coefficient",)),
    "torque_dependent_friction": (law.TORQUE, ("coefficient",)),
    "position_dependent_friction": (law.POSITION, ("coulomb", "depth", "cycles", "phase")),
    "capstan_friction": (law.CAPSTAN, ("mu",)),
    "transmission_coupling": (law.COULOMB, ("coulomb",)),
    "friction_drift": (law.DRIFT, ("friction", "extra", "time_constant")),
    "joint_spring": (law.SPRING, ("stiffness", "rest", "cubic")),
    "torque_ripple": (law.RIPPLE, ("amplitude", "cycles", "phase")),
    "torque_bump": (law.BUMP, ("amplitude", "angle", "width")),
    "friction_by_other_angle": (law.CROSS_ANGLE, ("amplitude", "angle", "width")),
    "cubic_drag": (law.CUBIC, ("amplitude",)),
    "sinusoid_in_time": (law.SINUSOID, ("amplitude", "frequency", "phase")),
    "rub_in_window": (law.RUB, ("amplitude", "low", "high")),
    "gain_falls_with_speed": (law.SPEED_GAIN, ("amplitude",)),
    "magnet_detent": (law.DETENT, ("amplitude", "cycles", "phase")),
    "cross_spring": (law.CROSS_SPRING, ("amplitude", "rest", "cubic")),
    "friction_wears_off_after_reversal": (law.BREAK_IN, ("amplitude", "time_constant")),
    "random_walk": (law.RANDOM_WALK, ("amplitude", "seed")),
    "amplifier_dead_band": (law.DEAD_BAND, ("amplitude", "width")),
    "friction_switches_on": (law.SWITCH_ON, ("amplitude", "time")),
    "braked_by_other_speed": (law.CROSS_SPEED, ("amplitude",)),
    "damaged_tooth": (law.TOOTH, ("amplitude", "cycles", "phase")),
    "warming_spring": (law.WARMING_SPRING, ("amplitude", "rest", "rate")),
    "gain_falls_as_motor_warms": (law.THERMAL_GAIN, ("amplitude", "time_constant")),
}
_HYSTERESIS = {
    "dahl": (law.DAHL, ("stiffness", "limit")),
    "lugre": (law.LUGRE, ("stiffness", "limit", "damping", "stribeck", "stribeck_velocity")),
    "bouc_wen": (law.BOUC_WEN, ("stiffness", "limit")),
    "maxwell_slip": (law.MAXWELL, ("stiffness", "limit")),
    "tension": (law.TENSION, ("stiffness", "limit")),
}


def _coordinate(fault: Fault, ratio: float, joints: int, motors: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    place = fault.location
    A, B, A2 = np.zeros(joints), np.zeros(motors), np.zeros(joints)
    i = place.get("index", 1) - 1
    if place["kind"] == "joint":
        A[i] = 1.0
    elif place["kind"] == "motor":
        B[i] = 1.0
        if fault.effect == "transmission_coupling":
            A[place["joint"] - 1] = fault.parameters["ratio"]
    elif place["kind"] == "combination":
        B[:] = place["weights"]
    elif place["kind"] == "cable":
        B[i] = ratio
        A[: place.get("link", 0)] = -1.0
    if "link" in place and fault.effect == "capstan_friction":
        A2[place["link"]] = 1.0  # the joint whose angle sets the wrap
    if "other" in place:
        A2[place["other"] - 1] = 1.0
    if fault.effect == "cross_spring":
        A[place["other"] - 1] = -1.0
    return A, B, A2


def compile_laws(faults: Sequence[Fault], ratio: float, joints: int, motors: int | None = None) -> law.Laws:
    """Put the faults that are laws along a coordinate into the arrays that the passes evaluate; others are skipped.

    Parameters
    ----------
    faults : sequence of Fault
    ratio : float
        r_m / r_j.
    joints, motors : int
        How many of each; as many motors as joints by default.
    """
    motors = joints if motors is None else motors
    rows = []
    for fault in faults:
        p = np.zeros(law.N_PARAMETERS)
        if fault.effect == "hysteresis":
            kind, names = _HYSTERESIS[fault.form]
        elif fault.effect == "external_torque":
            kind, names = law.EXTERNAL, ("torque",)
            p[1:3] = fault.parameters.get("time") or (fault.parameters["start"], fault.parameters["end"])
        elif fault.effect in _KINDS:
            kind, names = _KINDS[fault.effect]
        else:
            continue
        for j, name in enumerate(names):
            p[j] = fault.parameters.get(name, 0.0)
        A, B, A2 = _coordinate(fault, ratio, joints, motors)
        p[law.WIDTH] = fault.width if fault.location["kind"] in ("joint", "cable") else fault.width / ratio
        place = fault.location
        cable = place["index"] - 1 if place["kind"] == "cable" else -1
        rows.append((kind, A, B, A2, p, cable))
    if not rows:
        A, B, A2 = np.zeros((0, joints)), np.zeros((0, motors)), np.zeros((0, joints))
        return law.Laws(np.zeros(0, int), A, B, A2, np.zeros((0, law.N_PARAMETERS)), np.zeros(0, int))
    return law.Laws(*(np.array(column) for column in zip(*rows, strict=True)))
