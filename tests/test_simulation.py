"""A trajectory file becomes a simulated recording; what cannot be simulated is said in one line."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from cdm_pin.cli import main
from cdm_pin.dynamics import motor_torques
from cdm_pin.errors import InputError
from cdm_pin.model import load_model
from cdm_pin.recording import Recording, load_recording, save_recording
from cdm_pin.simulation import load_settings, simulate_recording

ARM = {
    "name": "cdm2",
    "gravity": [0.0, -9.8, 0.0],
    "links": [
        {"name": "one", "length": 0.6, "mass": 2.0, "center_of_mass": [0.3, 0.0, 0.0], "inertia": [0.01, 0.06, 0.06]},
        {"name": "two", "length": 0.6, "mass": 1.0, "center_of_mass": [0.3, 0.0, 0.0], "inertia": [0.01, 0.03, 0.03]},
    ],
    "pulleys": {
        "joint_pulley_radius": 0.1,
        "motor_pulley_radius": 0.1,
        "link_pulley_radius": 0.02,
        "link_pulley_offset": 0.022,
        "link_pulley_distance": 0.124,
    },
    "pretension": 120.0,
}


@pytest.fixture
def files(tmp_path):
    """Write an arm and a trajectory of joint positions at 100 Hz."""
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(ARM))
    t = np.arange(0.0, 2.0, 0.01)
    q = np.column_stack([0.5 * np.sin(2 * t), 0.7 * np.sin(3 * t)])
    save_recording(Recording(t, {"joint_position": q}), tmp_path / "wanted.csv")
    return tmp_path


@pytest.mark.parametrize("plant", ["mujoco", "pinocchio"])
def test_simulated_torques_are_the_models(files, plant):
    """With the model fed forward either plant tracks to 1 mrad, and logs the torques that the model asks for."""
    model = load_model(files / "arm.yaml")
    trajectory = load_recording(files / "wanted.csv", model)
    result = simulate_recording(model, trajectory, plant=plant)
    assert (result.tracking_error < 1e-3).all()
    log = result.recording.channels
    v, a = (
        np.gradient(x, 0.005, axis=0)
        for x in (log["joint_position"], np.gradient(log["joint_position"], 0.005, axis=0))
    )
    tau_m = motor_torques(model, log["joint_position"], v, a)
    np.testing.assert_allclose(log["motor_torque"][20:-20], tau_m[20:-20], atol=0.02)
    assert ("cable_tension_upper" in log) == (plant == "mujoco")


def test_effects_of_a_model_are_simulated(files):
    """An effect in the model file costs torque on the plant though the feed-forward knows nothing of it."""
    effect = {"effect": "viscous_friction", "location": {"kind": "motor", "index": 2}, "parameters": {"viscous": 0.3}}
    (files / "model.yaml").write_text(yaml.safe_dump(ARM | {"effects": [effect]}))
    plain, lossy = (load_model(files / name) for name in ("arm.yaml", "model.yaml"))
    trajectory = load_recording(files / "wanted.csv", plain)
    for plant in ("mujoco", "pinocchio"):
        one, two = (simulate_recording(model, trajectory, plant=plant).run for model in (plain, lossy))
        v_m = np.gradient(two.q_m, two.step, axis=0)
        np.testing.assert_allclose((two.tau_m - one.tau_m)[1000:, 1], 0.3 * v_m[1000:, 1], atol=0.12)


def test_command_line_and_its_refusals(files, capsys):
    """The command writes a recording; a diverging loop, a bad key and a file without positions end with status 2."""
    arm, wanted, out = (str(files / name) for name in ("arm.yaml", "wanted.csv", "out.csv"))
    assert main(["simulate", arm, wanted, "-o", out, "--quiet"]) == 0
    assert load_recording(out).channels["motor_torque"].shape[1] == 2
    settings = files / "controller.yaml"
    bad = str(files / "bad.csv")
    for text, words in (
        ("control: {bandwidth: 500.0}", "lower the controller's bandwidth"),
        ("control: {bandwith: 2.0}", "did you mean 'bandwidth'"),
        ("sensors: {positions: elbow}", "one of joint, motor, both"),
        ("plant: {cable_stiffness: 2.0e5}", "rotor inertia above zero"),
        ("control: {gains: {proportional: [1.0], integral: [1.0], derivative: [1.0]}}", "one per motor"),
    ):
        settings.write_text(text)
        assert main(["simulate", arm, wanted, "-o", bad, "--controller", str(settings)]) == 2
        error = capsys.readouterr().err
        assert words in error and error.count("\n") == 1
    save_recording(Recording(np.arange(9.0), {"motor_torque": np.zeros((9, 2))}), files / "torque.csv")
    assert main(["simulate", arm, str(files / "torque.csv"), "-o", bad]) == 2
    assert "holds no joint_position" in capsys.readouterr().err
    assert not (files / "bad.csv").exists()


def test_settings_are_read(files):
    """Sensors and controller come from the file: 12 bits, noise, joint side only, 100 Hz, the same for one seed."""
    text = (
        "sensors: {positions: joint, encoder_bits: 12, rate: 100.0, torque_noise: 0.05}\ncontrol: {feedforward: false}"
    )
    (files / "controller.yaml").write_text(text)
    settings, model = load_settings(files / "controller.yaml"), load_model(files / "arm.yaml")
    trajectory = load_recording(files / "wanted.csv", model)
    first, again, other = (simulate_recording(model, trajectory, settings, seed=seed).recording for seed in (1, 1, 2))
    assert "motor_position" not in first.channels
    tick = 2 * np.pi / 2**12
    ticks = first.channels["joint_position"] / tick
    np.testing.assert_allclose(ticks, np.round(ticks), atol=1e-9)
    np.testing.assert_allclose(np.diff(first.time), 0.01, atol=1e-12)
    np.testing.assert_array_equal(first.channels["motor_torque"], again.channels["motor_torque"])
    assert np.std(first.channels["motor_torque"] - other.channels["motor_torque"]) == pytest.approx(0.07, rel=0.2)
    with pytest.raises(InputError, match="true or false"):
        (files / "controller.yaml").write_text("control: {feedforward: 1}")
        load_settings(files / "controller.yaml")


@pytest.mark.parametrize(
    ("plant", "effect", "words"),
    [
        ("mujoco", "backlash", "effects[1]: the mujoco plant cannot carry backlash (it carries all effects but"),
        ("pinocchio", "cable_elasticity", "cannot carry cable_elasticity; the mujoco plant can"),
        ("mujoco", "hysteresis", "cannot carry hysteresis of tension (it carries"),
    ],
)
def test_effects_that_a_plant_lacks_are_named(files, capsys, plant, effect, words):
    """One line with file and place, nothing written."""
    fault = {"effect": effect, "location": {"kind": "cable", "index": 2}, "parameters": {"half_gap": 0.01}}
    if effect == "cable_elasticity":
        fault["parameters"] = {"stiffness": 150.0, "damping": 0.3}
    (files / "model.yaml").write_text(yaml.safe_dump(ARM | {"effects": [fault]}))
    given = ["simulate", str(files / "model.yaml"), str(files / "wanted.csv"), "-o", str(files / "x.csv")]
    assert main([*given, "--plant", plant]) == 2
    error = capsys.readouterr().err
    assert "model.yaml" in error and words in error and error.count("\n") == 1
    assert not (files / "x.csv").exists()
    assert main([*given, "--seed", "-1"]) == 2
