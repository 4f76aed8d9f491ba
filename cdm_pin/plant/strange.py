"""Laws that stand in no catalogue: a diagnosis should say that something is there, where, and that it has no name."""

from __future__ import annotations

from .faults import (
    Entry,
    joint,
    joint_and_other,
    load,
    motor,
    number,
    phase,
    plus,
    signed,
    signed_load,
    times,
    whole,
)

_SIZE = ("amplitude",)
STRANGE: dict[str, Entry] = {
    "torque_bump": Entry(
        joint, {"amplitude": signed_load(0.4, 1.0), "angle": number(-0.4, 0.4), "width": number(0.05, 0.15)}, _SIZE
    ),
    "friction_by_other_angle": Entry(
        joint_and_other, {"amplitude": load(0.4, 1.0), "angle": number(-0.2, 0.2), "width": number(0.05, 0.2)}, _SIZE
    ),
    "cubic_drag": Entry(joint, {"amplitude": load(0.1, 0.4)}, _SIZE),
    "sinusoid_in_time": Entry(
        joint, {"amplitude": load(0.2, 0.6), "frequency": number(1.7, 6.0), "phase": phase()}, _SIZE
    ),
    "rub_in_window": Entry(
        joint, {"amplitude": load(0.3, 0.8), "low": number(-0.5, 0.2), "high": plus("low", 0.15, 0.4)}, _SIZE
    ),
    "gain_falls_with_speed": Entry(motor, {"amplitude": signed(0.03, 0.1)}, _SIZE),
    "magnet_detent": Entry(joint, {"amplitude": load(0.4, 1.0), "cycles": whole(3, 9), "phase": phase()}, _SIZE),
    "cross_spring": Entry(
        joint_and_other,
        {"amplitude": load(0.5, 2.0), "rest": number(-0.3, 0.3), "cubic": times("amplitude", 0.5, 1.5)},
        ("amplitude", "cubic"),
    ),
    "friction_wears_off_after_reversal": Entry(
        joint, {"amplitude": load(0.4, 1.0), "time_constant": number(0.08, 0.3)}, _SIZE
    ),
    "random_walk": Entry(joint, {"amplitude": load(0.3, 0.8), "seed": number(0.0, 100.0)}, _SIZE),
    "amplifier_dead_band": Entry(motor, {"amplitude": load(0.2, 0.5), "width": load(0.03, 0.08)}, _SIZE),
    "friction_switches_on": Entry(joint, {"amplitude": load(0.3, 0.8), "time": number(15.0, 45.0)}, _SIZE),
    "braked_by_other_speed": Entry(joint_and_other, {"amplitude": load(0.4, 1.2)}, _SIZE),
    "damaged_tooth": Entry(motor, {"amplitude": load(0.5, 1.2), "cycles": whole(2, 5), "phase": phase()}, _SIZE),
    "warming_spring": Entry(
        joint, {"amplitude": load(0.5, 2.0), "rest": number(-0.3, 0.3), "rate": number(0.01, 0.03)}, _SIZE
    ),
    "gain_falls_as_motor_warms": Entry(
        motor, {"amplitude": signed(0.04, 0.12), "time_constant": number(10.0, 25.0)}, _SIZE
    ),
}
