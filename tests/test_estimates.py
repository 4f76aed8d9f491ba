"""The output side from the input side."""

import numpy as np
import pytest
from test_effects import make_motion

from cdm_pin.cli import main
from cdm_pin.completed import added_torque
from cdm_pin.dynamics import motor_torques
from cdm_pin.estimates import estimated_output
from cdm_pin.manipulator import save_manipulator, with_effects
from cdm_pin.model import build_model, load_model
from cdm_pin.recording import Recording, load_recording, save_recording


@pytest.fixture(scope="module")
def elastic():
    """Give an arm with a soft second cable and friction, and what its input side shows."""
    arm = load_model("urdf/cdm2.yaml")
    effects = (
        {"effect": "cable_elasticity", "location": {"kind": "cable", "index": 2}, "parameters": {"stiffness": 150.0}},
        {"effect": "viscous_friction", "location": {"kind": "joint", "index": 2}, "parameters": {"viscous": 0.4}},
    )
    model = build_model(with_effects(arm.manipulator, effects))
    motion = make_motion(model)
    rubs = 0.4 * motion.v[:, 1] * model.joint_from_motor[1, 1] / model.arm_scale[1]  # the cable drags the joint along
    stretch = np.column_stack([np.zeros(motion.n), (motion.cable_torque[:, 1] + rubs) / 150.0])
    tau_m = motor_torques(model, motion.q, motion.v, motion.a) + added_torque(motion)
    channels = {"motor_position": motion.q_m + stretch / motion.model.arm_scale, "motor_torque": tau_m}
    return model, motion, Recording(motion.time, channels)


def test_joints_come_back(elastic):
    """Joint positions come back to first order in the stretch, far closer than through a stiff cable."""
    model, motion, recording = elastic
    q = estimated_output(model, recording)["joint_position"]
    stiff = model.joint_position(recording.channels["motor_position"])
    inner = slice(200, -200)
    better = np.std((q - motion.q)[inner], axis=0)
    assert np.all(better < 0.35 * np.std((stiff - motion.q)[inner], axis=0).max())


def test_joint_torques_come_back(elastic):
    """Joint torques are the motors' less what friction takes."""
    model, motion, recording = elastic
    tau = estimated_output(model, recording)["joint_torque"]
    assert np.abs(tau - motion.tau)[200:-200].max() < 0.1 * np.abs(motion.tau).max()


def test_the_command_writes_a_recording(elastic, tmp_path):
    """`cdm-pin estimate` writes joints, torques and tensions; without motor positions it says so, status 2."""
    model, motion, recording = elastic
    save_manipulator(model.manipulator, tmp_path / "model.yaml")
    save_recording(recording, tmp_path / "run.csv")
    out = tmp_path / "out.csv"
    assert main(["estimate", str(tmp_path / "model.yaml"), str(tmp_path / "run.csv"), "-o", str(out)]) == 0
    channels = load_recording(out).channels
    assert set(channels) == {"joint_position", "joint_torque", "cable_tension_upper", "cable_tension_lower"}
    save_recording(Recording(motion.time, {"joint_position": motion.q}), tmp_path / "joints.csv")
    assert main(["estimate", str(tmp_path / "model.yaml"), str(tmp_path / "joints.csv"), "-o", str(out)]) == 2
