"""The plants share no code with the identifier and obey mechanics, laws and their own sensors."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import cdm_pin.plant
from cdm_pin.errors import InputError
from cdm_pin.plant import laws as law
from cdm_pin.plant.absolute import Reference, closed_loop, compliant_loop, motor_torques, prescribed
from cdm_pin.plant.arms import arm_from_file, draw_arm, draw_moves, draw_reference, draw_servo, manipulator_file
from cdm_pin.plant.catalogue import CATALOGUE, EVERYTHING, draw_fault
from cdm_pin.plant.compile import compile_laws
from cdm_pin.plant.draw import draw
from cdm_pin.plant.faults import Fault
from cdm_pin.plant.oracle import Oracle
from cdm_pin.plant.paths import ideal_cables, joints_from_motors
from cdm_pin.plant.planar import hinge_reactions, lumped, mass_and_bias, rigid_columns
from cdm_pin.plant.run import altered, simulate_run
from cdm_pin.plant.sensing import Noise, drift_basis, interpolate, noise_series, relative

STEP = 1e-3


def _imports(path: Path) -> set[str]:
    """Name the modules of this package that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            if node.level == 2:
                found |= {node.module} if node.module else {alias.name for alias in node.names}
            elif node.level == 0 and (node.module or "").split(".")[0] == "cdm_pin":
                found.add((node.module or "").removeprefix("cdm_pin."))
        elif isinstance(node, ast.Import):
            found |= {a.name.removeprefix("cdm_pin.") for a in node.names if a.name.startswith("cdm_pin")}
    return {name for name in found if not name.startswith("plant")}


def test_plants_import_nothing_of_the_identifier():
    """Nothing of the package but errors, files and geometry enters a plant: it cannot share a mistake."""
    folder = Path(cdm_pin.plant.__file__).parent
    for path in folder.glob("*.py"):
        assert _imports(path) <= {"errors", "files", "geometry"}, path.name


def _pinocchio(arm):
    model = pin.Model()
    model.gravity.linear = np.array([*arm.gravity, 0.0])
    parent, place = 0, pin.SE3.Identity()
    for i in range(arm.length.size):
        parent = model.addJoint(parent, pin.JointModelRZ(), place, f"joint_{i}")
        inertia = pin.Inertia(arm.mass[i], np.array([arm.cx[i], arm.cy[i], 0.0]), np.diag([0.1, 1, 1]) * arm.inertia[i])
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        place = pin.SE3(np.eye(3), np.array([arm.length[i], 0.0, 0.0]))
    return model


@pytest.mark.parametrize("n", [2, 3, 6])
def test_absolute_angle_dynamics_equal_recursive_ones(n):
    """The closed form in absolute angles gives Pinocchio's joint torques, and hinge forces where no cable pulls."""
    rng = np.random.default_rng(n)
    arm, _ = draw_arm(rng, n, rotors=False)
    model = _pinocchio(arm)
    data = model.createData()
    phi, w, a = rng.uniform(-3, 3, (20, n)), rng.normal(size=(20, n)), rng.normal(size=(20, n))
    no_laws = compile_laws([], arm.ratio, arm.length.size)
    tau_m, q_m, C = motor_torques(arm, no_laws, ideal_cables(n), phi, w, a, STEP)
    for k in range(20):
        tau = pin.rnea(model, data, *(relative(x[k : k + 1])[0] for x in (phi, w, a)))
        np.testing.assert_allclose(C[k], tau - np.append(tau[1:], 0.0), atol=1e-12)
        np.testing.assert_allclose(tau_m[k], arm.ratio * C[k], atol=1e-12)
        free = np.empty(n)
        hinge_reactions(arm._replace(pretension=0.0), phi[k], w[k], a[k], np.zeros(n), free)
        np.testing.assert_allclose(free, [np.linalg.norm(f.linear) for f in data.f.tolist()[1:]], atol=1e-11)
    np.testing.assert_allclose(q_m * arm.ratio, phi, atol=1e-13)
    D, sx, sy = lumped(arm)
    columns = rigid_columns(arm.length, arm.gravity, phi, w, a)
    np.testing.assert_allclose(columns @ np.concatenate([D, sx, sy]), C, atol=1e-12)


def test_loop_and_inverse_pass_agree():
    """The torque found along a closed-loop motion is the servo's own command, dry friction and hysteresis included."""
    rng = np.random.default_rng(3)
    arm, scale = draw_arm(rng, 3, rotors=True)
    faults = [
        Fault("coulomb_friction", {"kind": "joint", "index": 2}, {"coulomb": 0.3}, ()),
        Fault("hysteresis", {"kind": "motor", "index": 3}, {"stiffness": 8.0, "limit": 0.2}, (), "dahl"),
    ]
    model = arm_from_file(manipulator_file(arm, rng), arm)
    servo = draw_servo(rng, model, scale)._replace(feedforward=0.0)
    reference = draw_reference(rng, 3)
    laws = compile_laws(faults, arm.ratio, arm.length.size)
    phi, w, a = closed_loop(arm, laws, model, servo, reference, 5e-4, 4, 4000)
    tau_m, _, _ = motor_torques(arm, laws, ideal_cables(3), phi, w, a, 5e-4)
    t = np.arange(4000) * 5e-4
    wanted = prescribed(reference, 5e-4, 4000)
    ripple = servo.ripple[:, 0] * np.sin(servo.ripple[:, 1] * t[:, None] + servo.ripple[:, 2])
    command = arm.ratio * (servo.stiffness * (wanted[0] - phi) + servo.damping * (wanted[1] - w) + ripple)
    np.testing.assert_allclose(tau_m, command, atol=2e-3 * scale * arm.ratio)
    np.testing.assert_allclose(np.gradient(phi, 5e-4, axis=0)[1:-1], w[1:-1], atol=2e-4)


def test_stiff_cables_approach_rigid_ones():
    """With cables of 1e5 N m/rad the elastic plant moves as the rigid one does."""
    rng = np.random.default_rng(4)
    arm, scale = draw_arm(rng, 2, rotors=True)
    servo, reference, laws = (
        draw_servo(rng, arm, scale),
        draw_reference(rng, 2),
        compile_laws([], arm.ratio, arm.length.size),
    )
    rigid = closed_loop(arm, laws, arm, servo, reference, 5e-4, 1, 4000)
    cables = ideal_cables(2)._replace(stiffness=np.full(2, 1e5), damping=np.full(2, 20.0))
    phi, _, _, _, q_m, C = compliant_loop(arm, laws, cables, arm, servo, reference, 5e-4, 16, 4000)
    np.testing.assert_allclose(phi, rigid[0], atol=2e-4)
    tied = compliant_loop(
        arm, laws, cables._replace(stiffness=np.array([1e5, np.inf])), arm, servo, reference, 5e-4, 16, 4000
    )
    np.testing.assert_allclose(tied[0], rigid[0], atol=2e-4)
    np.testing.assert_allclose(tied[4][:, 1] * arm.ratio, tied[0][:, 1], atol=1e-12)
    np.testing.assert_allclose(q_m * arm.ratio - phi, C / 1e5, atol=3e-6)


_LOSSY = [name for name in CATALOGUE if "friction" in name or name in ("quadratic_drag", "hysteresis")]


@pytest.mark.parametrize("name", _LOSSY)
def test_friction_never_makes_energy(name):
    """Over a closed cycle of motion every friction law, at every place, takes power from the motors."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        n = 3
        arm, scale = draw_arm(rng, n, rotors=False)
        reference = draw_reference(rng, n)
        N = round(2 * np.pi / reference.omega / STEP) + 1
        phi, w, a = prescribed(reference, STEP, 2 * N)
        fault = draw_fault(name, rng, n, scale)
        tau_m, _, _ = motor_torques(
            arm, compile_laws([fault], arm.ratio, arm.length.size), ideal_cables(n), phi, w, a, STEP
        )
        power = (tau_m * w / arm.ratio).sum(axis=1)[N:]  # second cycle: memory has settled
        assert power.sum() * STEP > 0.0, (name, seed, fault.location)


def test_capstan_law_is_the_exact_exponential():
    """Added torque equals the sinh/cosh form of a pretensioned pair in full sliding."""
    mu, tau, A, B, T0, r = 0.1, 3.0, 1.7, 2.4, 90.0, 0.06
    for v in (1.0, -1.0):
        x, y = mu * A, mu * B
        expected = v * r * T0 * (np.sinh(x) + np.sinh(y)) + r * T0 * (np.cosh(x) - np.cosh(y))
        expected += 0.5 * tau * (np.cosh(x) + np.cosh(y) - 2.0) + 0.5 * v * tau * (np.sinh(x) - np.sinh(y))
        assert law.strand_torque(mu, tau, A, B, v, T0, r) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("kind, limit", [(law.DAHL, 1.0), (law.BOUC_WEN, 1.0), (law.MAXWELL, None)])
def test_hysteresis_saturates_and_starts_with_its_stiffness(kind, limit):
    """A hysteresis begins at `stiffness` per radian and ends at `limit`, the same at any speed."""
    p = np.array([20.0, 0.4, 0, 0, 0, 0, 0, 0.0])
    arm, _ = draw_arm(np.random.default_rng(0), 2, rotors=False)
    ends = []
    for speed in (0.1, 3.0):
        z = np.zeros(law.N_STATES)
        law.advance(kind, p, z, speed, 1e-4 / speed)
        start = law.force(kind, p, z, 0.0, 0.0, speed, 0.0, 0.0, 0.0, 0.0, arm)
        assert start == pytest.approx(20.0 * 1e-4, rel=0.01)
        for _ in range(200):
            law.advance(kind, p, z, speed, 0.005 / speed)
        ends.append(law.force(kind, p, z, 0.0, 0.0, speed, 0.0, 0.0, 0.0, 0.0, arm))
    np.testing.assert_allclose(ends, 0.4, rtol=1e-3)


def test_path_errors_are_undone():
    """Joint angles come back from motor angles through ratio errors and eccentric pulleys."""
    cables = ideal_cables(3)
    cables.ratio_error[2, 1], cables.eccentricity[1], cables.phase[1] = 0.05, 0.04, 0.7
    arm, _ = draw_arm(np.random.default_rng(1), 3, rotors=False)
    phi = np.random.default_rng(2).uniform(-1, 1, (50, 3))
    _, q_m, _ = motor_torques(arm, compile_laws([], arm.ratio, arm.length.size), cables, phi, 0 * phi, 0 * phi, STEP)
    np.testing.assert_allclose(joints_from_motors(cables, arm.ratio, q_m), relative(phi), atol=1e-12)


def test_noise_is_what_it_says():
    """AR(1) noise has the stated spread and correlation; interpolation by cubics is good to its order."""
    t = np.arange(40000) / 200.0
    e = noise_series(Noise(np.array([0.02, 0.05]), 0.7), t, np.random.default_rng(0))
    np.testing.assert_allclose(e.std(axis=0), [0.02, 0.05], rtol=0.05)
    np.testing.assert_allclose((e[1:] * e[:-1]).mean(axis=0) / e.var(axis=0), 0.7, atol=0.02)
    assert drift_basis(t).shape[0] == t.size
    grid = np.sin(6.0 * np.arange(2000) * STEP)[:, None]
    when = np.linspace(0.1, 1.9, 333)
    np.testing.assert_allclose(interpolate(grid, STEP, when)[:, 0], np.sin(6.0 * when), atol=1e-9)


def test_rigid_body_effects_are_invisible():
    """A payload, a rotor and the last joint's encoder offset (no motor encoder) lie in the span of the masses."""
    for name in ("payload", "rotor_inertia"):
        truth = draw(1, n_links=3, effects=[name], duration=5.0, motion="prescribed").truth
        assert truth["effects"][0]["visibility"] < 1e-3
    for seed in range(30):
        truth = draw(
            seed, n_links=2, effects=["encoder_offset"], positions="joint", duration=3.0, motion="prescribed"
        ).truth
        assert (truth["effects"][0]["visibility"] < 1e-3) == (truth["effects"][0]["location"]["index"] == 2)


@pytest.mark.parametrize("name", EVERYTHING)
def test_every_effect_can_be_drawn_and_leaves_a_trace(name):
    """Each effect, in the catalogue or not, runs, is finite, and (rigid-body effects apart) is visible."""
    how = {"motion": "prescribed", "noise": "white", "n_holdout": 0}
    trial = draw(5, n_links=2, effects=[name], duration=6.0, **how)
    assert all(np.isfinite(column).all() for column in trial.recordings[0].values())
    effect = trial.truth["effects"][-1]
    assert effect["effect"] == name
    hidden = (
        "payload",
        "rotor_inertia",
        "encoder_offset",
        "external_torque",
        "friction_switches_on",
    )  # masses, or not yet begun
    assert effect["visibility"] > 1.0 or name in hidden


def test_oracle_knows_what_looks_alike():
    """A fault is wholly like itself and like a law that contains it, and hardly like one of another state."""
    trial = draw(2, n_links=2, effects=["coulomb_friction"], positions="joint", duration=8.0, motion="prescribed")
    oracle, place = Oracle(trial.scene), trial.truth["effects"][0]["location"]
    for name in ("coulomb_friction", "asymmetric_friction"):
        assert oracle.likeness(0, {"effect": name, "location": place}) > 0.999
    assert oracle.likeness(0, {"effect": "torque_offset", "location": {"kind": "motor", "index": 1}}) < 0.5
    for name in ("transmission_ratio_error", "hysteresis"):  # at a place that a diagnosis may name, whatever its law
        for where in ({"kind": "joint", "index": 2}, {"kind": "cable", "index": 2, "joint": 1, "link": 1}):
            assert 0.0 <= oracle.likeness(0, {"effect": name, "location": where}) <= 1.0 + 1e-9
    visible = oracle.visibility(0)["visibility"]
    assert np.linalg.norm(oracle.signature(trial.scene.faults[0], [])) == pytest.approx(visible, rel=1e-6)
    twice = oracle.signature(trial.scene.faults[0].scaled(2.0), [])
    assert np.linalg.norm(twice) == pytest.approx(2.0 * visible, rel=1e-6)


def test_bounds_are_those_of_a_linear_fit():
    """Of a fault that is linear in its one parameter the Cramer-Rao bound is its size over its visibility."""
    trial = draw(2, n_links=2, effects=["coulomb_friction"], positions="joint", duration=8.0, motion="prescribed")
    (effect,), (bound,) = trial.truth["effects"], Oracle(trial.scene).bounds()
    assert bound["coulomb"] == pytest.approx(effect["parameters"]["coulomb"] / effect["visibility"], rel=1e-5)
    both = draw(2, n_links=2, effects=["stribeck_friction"], positions="joint", duration=8.0, motion="prescribed")
    known, free = effect["visibility"], Oracle(both.scene).bounds()[0]
    assert known > 0 and set(free) == {"coulomb", "stribeck", "stribeck_velocity"} and min(free.values()) > 0


def test_draw_is_reproducible_and_reaches_a_visibility(tmp_path):
    """The same seed gives the same bytes; a wanted visibility is met; files carry the agreed names."""
    first, second = (draw(11, n_links=2, effects=["coulomb_friction"], duration=5.0, visibility=8.0) for _ in range(2))
    assert first.truth == second.truth
    for name, column in first.recordings[0].items():
        np.testing.assert_array_equal(column, second.recordings[0][name])
    assert first.truth["effects"][0]["visibility"] == pytest.approx(8.0, rel=0.05)
    paths = first.write(tmp_path / "trial")
    assert paths["recordings"][0].read_text().startswith("time,")
    assert "truth" not in paths["manipulator"].read_text()


def test_draw_refuses_what_cannot_be():
    """An unknown effect and sensors that cannot show it are said."""
    with pytest.raises(InputError, match="did you mean 'backlash'"):
        draw(0, effects=["backlsh"])
    with pytest.raises(InputError, match="positions logged at: both"):
        draw(0, effects=["cable_slack"], positions="joint")


def test_faults_of_the_body_change_the_body():
    """Payload, tilt and rotor enter the arm itself; simulating a clean arm needs none of them."""
    arm, _ = draw_arm(np.random.default_rng(0), 2, rotors=False)
    heavy, _ = altered(arm, [Fault("payload", {"kind": "link", "index": 2}, {"mass": 0.5}, ("mass",))])
    assert heavy.mass[1] == pytest.approx(arm.mass[1] + 0.5)
    D, _, _ = lumped(heavy)
    assert D[1] == pytest.approx(lumped(arm)[0][1] + 0.5 * arm.length[1] ** 2)
    reference = Reference(np.zeros(2), np.full((2, 1), 0.3), np.zeros((2, 1)), 2.0)
    motion = simulate_run(arm, [], arm, None, reference, 1.0)
    M, h = np.empty((2, 2)), np.empty(2)
    mass_and_bias(motion.phi[7], motion.w[7], arm.length, *lumped(arm), arm.gravity, M, h)
    np.testing.assert_allclose(motion.C[7], M @ motion.a[7] + h, atol=1e-12)


def test_friction_sticks_between_moves():
    """A dry joint under a servo that moves from point to point slides at its friction and rests on less than that."""
    rng = np.random.default_rng(3)
    arm, scale = draw_arm(rng, 2, rotors=False)
    model = arm_from_file(manipulator_file(arm, rng), arm)
    dry = Fault("coulomb_friction", {"kind": "joint", "index": 2}, {"coulomb": 0.5}, ("coulomb",), width=-5e-5)
    motion = simulate_run(arm, [dry], model, draw_servo(rng, model, scale), draw_moves(rng, 2, 20.0), 20.0)
    bare, _, _ = motor_torques(
        arm, compile_laws([], arm.ratio, 2), ideal_cables(2), motion.phi, motion.w, motion.a, motion.step
    )
    friction = (motion.tau_m - bare)[:, 1] / arm.ratio
    rate = motion.w[:, 1] - motion.w[:, 0]
    slides, rests = np.abs(rate) > 0.05, np.abs(rate) < 1e-4
    assert np.abs(friction).max() <= 0.5 + 1e-9
    np.testing.assert_allclose(friction[slides], 0.5 * np.sign(rate[slides]), atol=1e-3)
    assert rests.mean() > 0.1
    assert np.mean(np.abs(friction[rests]) < 0.45) > 0.1
    with pytest.raises(InputError, match="MuJoCo"):
        draw(0, motion="moves", plant="mujoco")
