"""An arm of three links that loses torque to dry friction at joint 2: what the tests of report and viewer draw."""

import numpy as np

from cdm_pin.dynamics import inverse_dynamics
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.model import CableModel, build_model
from cdm_pin.recording import Recording
from cdm_pin.report import Evidence, LawCurve, Rival, RunEvidence, SimulatedMotion

COULOMB, FLOOR = 0.31, 0.02  # N m


def arm(n: int = 3, name: str = "arm of three links") -> CableModel:
    link = {"length": 0.6, "mass": 2.0, "center_of_mass": [0.3, 0.0, 0.0], "inertia": [0.01, 0.06, 0.06]}
    content = {
        "name": name,
        "gravity": [0.0, -9.8, 0.0],
        "links": [{"name": f"link_{i + 1}", **link} for i in range(n)],
        "pulleys": {
            "joint_pulley_radius": 0.1,
            "motor_pulley_radius": 0.1,
            "link_pulley_radius": 0.02,
            "link_pulley_offset": 0.022,
            "link_pulley_distance": 0.124,
        },
        "pretension": 200.0,
    }
    return build_model(parse_manipulator(content))


def motion(n: int = 3, seconds: float = 20.0, rate: float = 100.0):
    t = np.arange(0, seconds, 1 / rate)
    w = 0.8 * (1 + 0.37 * np.arange(n))
    q = 0.5 * np.sin(w * t[:, None] + np.arange(n))
    v = 0.5 * w * np.cos(w * t[:, None] + np.arange(n))
    return t, q, v, -w * w * q


def run(model: CableModel, label: str, *, holdout: bool, seed: int) -> RunEvidence:
    t, q, v, a = motion(model.n_joints)
    rigid = inverse_dynamics(model, q, v, a)
    friction = np.zeros_like(rigid)
    friction[:, 1] = COULOMB * np.tanh(v[:, 1] / 0.01)
    rng = np.random.default_rng(seed)
    full = model.motor_torque(rigid + friction)
    noise = FLOOR * rng.standard_normal(full.shape)
    return RunEvidence(label, t, full + noise, model.motor_torque(rigid), full, q, v, holdout=holdout)


def recording(model: CableModel) -> Recording:
    r = run(model, "run1", holdout=False, seed=1)
    return Recording(r.time, {"joint_position": r.q, "motor_torque": r.measured}, label="run1")


def diagnosis() -> dict:
    joint2, motor1 = {"kind": "joint", "index": 2}, {"kind": "motor", "index": 1}
    fit = {"rmse_rigid": [0.31, 0.31, 0.02], "rmse_augmented": [0.02, 0.02, 0.02], "noise_floor": [0.02, 0.02, 0.02]}
    return {
        "schema": "cdm_pin.diagnosis/1",
        "verdict": "missing_physics",
        "rigid_body": {
            "changed": [
                {
                    "base_parameter": "Izz_2 + m_2*lx^2",
                    "links": [2],
                    "nominal": 0.12,
                    "value": 0.15,
                    "std": 0.002,
                    "indistinguishable_from": [{"effect": "rotor_inertia", "location": {"kind": "motor", "index": 2}}],
                }
            ]
        },
        "findings": [
            {
                "effect": "coulomb_friction",
                "location": joint2,
                "parameters": {"coulomb": {"value": 0.31, "std": 0.012, "unit": "N m"}},
                "evidence": {"delta_bic": 812.0, "log10_p": -30.0, "holdout_rmse_reduction": 0.93},
                "indistinguishable_from": [],
                "time": None,
                "region": "around reversals of joint 2",
            }
        ],
        "fit": {
            "train": fit,
            "holdout": fit,
            "simulated_position": {"rmse_rigid": [0.01] * 3, "rmse_augmented": [0.001] * 3, "horizon": 1.0},
        },
        "sensitivity": [
            {"effect": "coulomb_friction", "location": motor1, "amplitude": 0.01, "visible_fraction": 0.8,
             "absorbed_by": []},
            {"effect": "rotor_inertia", "location": motor1, "amplitude": None, "visible_fraction": 0.01,
             "absorbed_by": ["Izz_1"]},
        ],
        "unexplained": None,
        "next_experiment": {"file": "next.csv", "change": "pretension 80 -> 120 N", "power": 0.97},
    }  # fmt: skip


def evidence(model: CableModel) -> Evidence:
    runs = (run(model, "run1", holdout=False, seed=1), run(model, "run3", holdout=True, seed=2))
    v = runs[1].v[:, 1]
    fit = COULOMB * np.tanh(v / 0.01)
    law = LawCurve(v, "velocity of joint 2 [rad/s]", fit + runs[1].measured[:, 1] - runs[1].augmented[:, 1], fit)
    t, q, _, _ = motion(seconds=1.0)
    drift = 0.05 * t[:, None] ** 2 * np.ones(3)
    return Evidence(
        runs=runs,
        noise_floor=np.full(3, FLOOR),
        laws=(law,),
        rivals=((Rival("hysteresis", {"kind": "joint", "index": 2}, 640.0, "two more numbers, no better fit"),),),
        simulated=(SimulatedMotion(t, q, q + drift, q + 0.02 * drift, "first second"),),
        notices=("run1: 3 repeated samples were dropped",),
    )
