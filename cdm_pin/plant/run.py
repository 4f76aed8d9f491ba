"""One run of an arm with its faults: which pass, how fine, and whether it diverged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import SimulationError
from .absolute import Reference, Servo, closed_loop, compliant_loop, motor_torques, prescribed
from .compile import compile_laws
from .faults import Fault
from .laws import DRY, WIDTH, Laws
from .paths import Cables, ideal_cables, stretched
from .planar import Arm, lumped, mass_and_bias
from .sensing import Motion

FINE_STEP = 5e-4  # [s] of the grid on which motions are known
LEAD = 2.0  # [s] that a loop has run before it is logged, so that nothing of how it starts is left


def altered(arm: Arm, faults: Sequence[Fault]) -> tuple[Arm, Cables]:
    """Build the faults that change the body, the base or the cables into the arm."""
    n = arm.length.size
    mass, cx, cy, inertia, rotor = (x.copy() for x in (arm.mass, arm.cx, arm.cy, arm.inertia, arm.rotor))
    gravity, cables = arm.gravity, ideal_cables(n)
    for f in faults:
        i, p = f.location.get("index", 1) - 1, f.parameters
        if f.effect == "payload":  # a point mass at the link's end
            total, d = mass[i] + p["mass"], np.array([arm.length[i] - cx[i], -cy[i]])
            inertia[i] += mass[i] * p["mass"] / total * (d @ d)
            cx[i], cy[i] = np.array([cx[i], cy[i]]) + p["mass"] / total * d
            mass[i] = total
        elif f.effect == "rotor_inertia":
            rotor[i] += p["inertia"]
        elif f.effect == "base_tilt":
            c, s = np.cos(p["angle"]), np.sin(p["angle"])
            gravity = np.array([c * gravity[0] + s * gravity[1], -s * gravity[0] + c * gravity[1]])
        elif f.effect == "transmission_ratio_error":
            cables.ratio_error[i, f.location["joint"] - 1] += p["relative_error"]
        elif f.effect == "pulley_eccentricity":
            cables.eccentricity[i], cables.phase[i] = p["relative_eccentricity"], p["phase"]
        elif f.effect == "transmission_coupling":
            cables.rotor_coupling[i, f.location["joint"] - 1] = p["ratio"]
            rotor[i] += p["inertia"]
        elif f.effect == "backlash":
            cables.half_gap[i] = p["half_gap"]
        elif f.effect == "cable_elasticity":
            cables.stiffness[i], cables.damping[i] = p["stiffness"], p["damping"]
        elif f.effect == "cable_slack":
            cables.slack[i], cables.stiffness[i], cables.damping[i] = p["torque"], p["stiffness"], p["damping"]
    return arm._replace(mass=mass, cx=cx, cy=cy, inertia=inertia, rotor=rotor, gravity=gravity), cables


MOST_SUBSTEPS = 2  # where only dry friction asks for more
_SWINGS = 3.0  # steps that are asked for where something swings whose states move on between them
STIFF = 16  # where elastic cables ask for more, they are at rest with the load they carry


def _integrable(arm: Arm, laws: Laws, cables: Cables, phi: np.ndarray) -> tuple[Laws, int]:
    """Choose Runge-Kutta steps per fine step; where dry friction alone would ask for more, its sign is widened."""
    n = phi.shape[1]
    D, sx, sy = lumped(arm)
    elastic = np.isfinite(cables.stiffness)
    D = D + np.where(elastic, 0.0, arm.rotor / arm.ratio**2)
    M, h = np.empty((n, n)), np.empty(n)
    to_joint = np.eye(n) - np.eye(n, k=-1)  # theta = to_joint phi
    parameters, stiffest = laws.parameters.copy(), 0.0
    most = MOST_SUBSTEPS * 1.2 / FINE_STEP
    for row in phi[:: max(1, len(phi) // 40)]:
        mass_and_bias(row, 0 * row, arm.length, D, sx, sy, arm.gravity, M, h)
        inverse = np.linalg.inv(M)
        for kind, A, B, p in zip(laws.kind, laws.A, laws.B, parameters, strict=True):
            if kind in DRY:  # the slope of a smooth sign over the inertia that feels it
                g = A @ to_joint + np.where(elastic, 0.0, B / arm.ratio)
                mobility = g @ inverse @ g + (elastic * B**2 / np.maximum(arm.rotor, 1e-9)).sum()
            if kind in DRY and p[WIDTH] < 0:  # a bristle and that inertia swing
                stiffest = max(stiffest, _SWINGS * np.sqrt(DRY[kind](p) * mobility / -p[WIDTH]))
            elif kind in DRY:
                p[WIDTH] = max(p[WIDTH], DRY[kind](p) * mobility / most)
                stiffest = max(stiffest, DRY[kind](p) / p[WIDTH] * mobility)
        for i in np.flatnonzero(elastic):
            lightest = 4.0 * inverse.max() + arm.ratio**2 / arm.rotor[i]
            stiffest = max(stiffest, np.sqrt(cables.stiffness[i] * lightest), cables.damping[i] * lightest)
    return laws._replace(parameters=parameters), max(1, int(min(np.ceil(stiffest * FINE_STEP / 1.2), STIFF + 1)))


def simulate_run(
    arm: Arm, faults: Sequence[Fault], model: Arm, servo: Servo | None, reference: Reference, duration: float
) -> Motion:
    """Simulate one run on the fine grid: `servo` None holds the reference exactly.

    With rigid cables the torque is always that of the exact laws along the motion that the loop made, whatever the
    loop was integrated with. Cables too stiff to integrate follow the motion of rigid ones, stretched by their load.

    Raises
    ------
    SimulationError
        If the closed loop diverges.
    """
    true, cables = altered(arm, faults)
    laws = compile_laws(faults, true.ratio, true.length.size)
    N, lead = round((duration + 0.1) / FINE_STEP) + 1, round(LEAD / FINE_STEP)
    phi, w, a = prescribed(reference, FINE_STEP, N)
    elastic = np.isfinite(cables.stiffness)
    if servo is not None:
        eased, steps = _integrable(true, laws, cables, phi)
        if elastic.any() and steps <= STIFF:
            run = compliant_loop(true, eased, cables, model, servo, reference, FINE_STEP, steps, N, lead)
            return _checked(Motion(*run, FINE_STEP))
        if elastic.any():
            eased, steps = _integrable(true, laws, ideal_cables(len(elastic)), phi)
        if steps > STIFF and (laws.parameters[:, WIDTH] < 0).any():
            raise SimulationError("friction sticks too hard to be integrated")
        phi, w, a = closed_loop(true, eased, model, servo, reference, FINE_STEP, min(steps, STIFF), N, lead)
    tau_m, q_m, C = motor_torques(true, laws, cables, phi, w, a, FINE_STEP)
    q_m[:, elastic] += stretched(cables, C, FINE_STEP)[:, elastic] / true.ratio
    return _checked(Motion(phi, w, a, tau_m, q_m, C, FINE_STEP))


def _checked(motion: Motion) -> Motion:
    if not (np.isfinite(motion.tau_m).all() and np.abs(motion.phi).max() < 50.0 and np.abs(motion.w).max() < 1e3):
        raise SimulationError("the closed loop diverges: lower its gains or its step")
    return motion
