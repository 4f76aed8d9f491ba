"""A recording run again from its torques: the model that made it follows it, friction and memory included."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from test_simulation import ARM

from cdm_pin.errors import ShapeError
from cdm_pin.model import load_model
from cdm_pin.problem import make_problem
from cdm_pin.recording import Recording
from cdm_pin.replay import replay, run_windows, simulated_position
from cdm_pin.simulation import simulate_recording

DRY = {"effect": "coulomb_friction", "location": {"kind": "joint", "index": 2}, "parameters": {"coulomb": 0.5}}
EFFECTS = {
    "dry friction": [DRY],
    "Stribeck, at a motor": [
        {
            "effect": "stribeck_friction",
            "location": {"kind": "motor", "index": 2},
            "parameters": {"coulomb": 0.3, "stribeck": 0.2, "stribeck_velocity": 0.3},
        }
    ],
    "hysteresis": [
        {
            "effect": "hysteresis",
            "location": {"kind": "joint", "index": 2},
            "parameters": {"limit": 0.5, "stiffness": 8.0},
        }
    ],
    "a spring, a rotor and drag": [
        {
            "effect": "joint_spring",
            "location": {"kind": "joint", "index": 2},
            "parameters": {"stiffness": 1.5, "rest": 0.2},
        },
        {"effect": "rotor_inertia", "location": {"kind": "motor", "index": 2}, "parameters": {"inertia": 0.05}},
        {"effect": "quadratic_drag", "location": {"kind": "joint", "index": 1}, "parameters": {"coefficient": 0.2}},
    ],
    "friction that depends on place, and what the logger does": [
        {
            "effect": "position_dependent_friction",
            "location": {"kind": "joint", "index": 2},
            "parameters": {"coulomb": 0.4, "depth": 0.7, "cycles": 2.0, "phase": 0.3},
        },
        {"effect": "torque_gain_error", "location": {"kind": "motor", "index": 1}, "parameters": {"gain": 1.1}},
        {"effect": "torque_offset", "location": {"kind": "motor", "index": 2}, "parameters": {"offset": 0.3}},
    ],
}


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    """Give the arm with effects, by way of a file."""

    def make(effects):
        path = tmp_path_factory.mktemp("arm") / "model.yaml"
        path.write_text(yaml.safe_dump(ARM | {"pretension": 200.0} | ({"effects": effects} if effects else {})))
        return load_model(path)

    return make


def trajectory(seconds: float = 8.0) -> Recording:
    t = np.arange(0.0, seconds, 0.01)
    q = np.column_stack([0.5 * np.sin(2 * t) + 0.2 * np.sin(3.1 * t), 0.6 * np.sin(2.7 * t)])
    return Recording(t, {"joint_position": q})


@pytest.mark.parametrize("name", EFFECTS)
def test_the_model_that_made_a_recording_follows_it(load, name):
    """Against MuJoCo: the completed model stays within 3 % of the distance that the rigid one runs up in a second."""
    plain, whole = load([]), load(EFFECTS[name])
    run = make_problem(plain, [simulate_recording(whole, trajectory()).recording]).runs[0]
    torque = run.signals.logged["motor_torque"]
    result = simulated_position([replay(plain, whole, run.motion, torque, run.signals.valid)])
    assert result["horizon"] == 1.0 and result["windows"] >= 6 and not result["along_record"]
    rigid, completed = np.array(result["rmse_rigid"]), np.array(result["rmse_augmented"])
    assert (rigid > 0.05).all()
    assert (completed < 0.03 * rigid).all()


def test_dry_friction_sticks(load):
    """A horizontal arm pushed by less than its friction stays where it is, to the last digit; by more it moves."""
    model = load([DRY | {"parameters": {"coulomb": 0.5}}])
    level = model.pin_model.copy()
    level.gravity.linear = np.zeros(3)
    model = replace(model, pin_model=level)
    still = trajectory(3.0)
    n = still.n_samples
    signals = make_problem(model, [replace(still, channels=still.channels | {"motor_torque": np.zeros((n, 2))})])
    motion = signals.runs[0].motion
    zero = np.zeros_like(motion.q)
    motion = replace(motion, q=zero, v=zero, a=zero, q_m=zero, v_m=zero, a_m=zero)
    push = np.zeros((motion.n, 2))
    for torque, moves in ((0.4, False), (0.6, True)):
        # the same at both motors' expense: tau = E^-T tau_m puts it on joint 2 alone
        push[:] = model.motor_torque(np.array([[0.0, torque]]))
        q = run_windows(model, motion, push, np.array([0]), 100)
        assert (np.abs(q[..., 1]).max() > 0.1) == moves
        if not moves:
            assert np.abs(q[..., 1]).max() < 1e-9


def test_elastic_cables_are_said_to_be_taken_along_the_record(load):
    """What cannot be run forward is named, and gaps in a recording hold no windows."""
    soft = {"effect": "cable_elasticity", "location": {"kind": "cable", "index": 2}, "parameters": {"stiffness": 150.0}}
    plain, whole = load([]), load([soft])
    run = make_problem(plain, [simulate_recording(plain, trajectory(5.0)).recording]).runs[0]
    torque, valid = run.signals.logged["motor_torque"], run.signals.valid.copy()
    valid[300] = False
    result = replay(plain, whole, run.motion, torque, valid)
    assert [entry["effect"] for entry in result.along_record] == ["cable_elasticity"]
    assert not np.any((result.start <= run.motion.time[300]) & (result.start + 1.0 >= run.motion.time[300]))
    assert replay(plain, whole, run.motion, torque, np.zeros_like(valid)) is None
    with pytest.raises(ShapeError, match="torque has shape"):
        replay(plain, whole, run.motion, torque[:-1], valid)
