"""Excitation: series, limits on fine grids, informative designs, rest at both ends, and the command."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
import yaml
from arms import ROOT, planar_arm
from hypothesis import given, settings
from hypothesis import strategies as st

from cdm_pin.base import base_parameters
from cdm_pin.cli import main
from cdm_pin.dynamics import inverse_dynamics, motor_torques
from cdm_pin.errors import InputError, ShapeError
from cdm_pin.excitation import Blend, Excitation, at_rest, plan
from cdm_pin.fourier import FourierSeries, PeriodGrid, fit_series
from cdm_pin.limits import (
    Limits,
    default_limits,
    load_limits,
    mechanism_limits,
    parse_limits,
    usage,
    worst_usage,
)
from cdm_pin.model import load_model
from cdm_pin.objectives import each, make_objective, predicted_errors, reference_magnitudes
from cdm_pin.paper import FREQUENCY, table_2
from cdm_pin.recording import load_recording

CDM2 = ROOT / "urdf" / "cdm2.yaml"


@cache
def cdm2():
    return load_model(CDM2)


def random_series(seed: int, n: int = 2, harmonics: int = 4) -> FourierSeries:
    rng = np.random.default_rng(seed)
    return FourierSeries(
        rng.uniform(0.1, 3.0), rng.normal(size=n), rng.normal(size=(n, harmonics)), rng.normal(size=(n, harmonics))
    )


# the series


def test_closed_series_starts_at_zero_eq_47():
    rng = np.random.default_rng(0)
    series = FourierSeries.closed(0.7, rng.normal(size=(2, 3)), rng.normal(size=(2, 3)))
    assert series.harmonics == 4
    np.testing.assert_allclose(series(0.0)[0], 0.0, atol=1e-15)
    np.testing.assert_allclose(series.cosine.sum(axis=1), 0.0, atol=1e-15)


def test_velocity_and_acceleration_are_derivatives():
    series, t, h = random_series(1), np.linspace(0, 9, 50), 1e-5
    q, v, a = series(t)
    np.testing.assert_allclose((series(t + h)[0] - series(t - h)[0]) / (2 * h), v, atol=1e-6)
    np.testing.assert_allclose((series(t + h)[1] - series(t - h)[1]) / (2 * h), a, atol=1e-5)
    np.testing.assert_allclose(series(t + series.period)[0], q, atol=1e-12)


def test_delayed_series_is_the_same_motion_later():
    series, t = random_series(2), np.linspace(0, 5, 30)
    for now, later in zip(series(t + 1.3), series.delayed(1.3)(t), strict=True):
        np.testing.assert_allclose(later, now, atol=1e-12)


def test_grid_evaluates_what_the_series_does():
    series, grid = random_series(3), PeriodGrid(50, 4)
    found = grid(np.array([series.frequency]), series.cosine[None], series.sine[None])
    expected = series(series.period * np.arange(50) / 50)
    for x, y, center in zip(found, expected, (series.center, 0, 0), strict=True):
        np.testing.assert_allclose(x[0].T + center, y, atol=1e-12)


@given(st.integers(0, 10**6), st.integers(1, 8), st.integers(1, 20))
@settings(max_examples=40, deadline=None)
def test_no_peak_hides_between_samples_beyond_the_bound(seed, harmonics, more):
    series, grid = random_series(seed, 1, harmonics), PeriodGrid(2 * harmonics + more, harmonics)
    coarse = np.abs(grid(np.ones(1), series.cosine[None], series.sine[None])[0]).max()
    fine = np.abs(PeriodGrid(2000, harmonics)(np.ones(1), series.cosine[None], series.sine[None])[0]).max()
    assert fine <= coarse * grid.overshoot * (1 + 1e-12)


def test_refit_recovers_coefficients_and_frequency_from_a_wrong_guess_eq_52():
    series, t = random_series(4), np.arange(0, 60, 0.01)
    series = FourierSeries(0.345, 0 * series.center, series.cosine, series.sine)
    rng = np.random.default_rng(0)
    found = fit_series(t, series(t)[0] + 1e-3 * rng.standard_normal((len(t), 2)), 4, 0.3465)
    assert found.frequency == pytest.approx(0.345, abs=1e-5)
    np.testing.assert_allclose(found.cosine, series.cosine, atol=5e-4)
    np.testing.assert_allclose(found.sine, series.sine, atol=5e-4)


def test_refit_with_a_constant():
    series, t = random_series(5), np.arange(0, 40, 0.02)
    found = fit_series(t, series(t)[0], 4, series.frequency * 1.001, constant=True)
    np.testing.assert_allclose(found.center, series.center, atol=1e-9)


def test_series_of_no_harmonics_or_wrong_shapes_is_refused():
    with pytest.raises(ShapeError, match="without harmonics"):
        FourierSeries(1.0, np.zeros(2), np.zeros((2, 0)), np.zeros((2, 0)))
    with pytest.raises(ShapeError, match="disagree"):
        FourierSeries(1.0, np.zeros(2), np.zeros((2, 3)), np.zeros((2, 2)))
    with pytest.raises(ShapeError, match="equal numbers"):
        fit_series(np.arange(10.0), np.zeros((9, 1)), 2, 1.0)


# limits


@cache
def planned(optimiser: str, zero_start: bool) -> FourierSeries:
    """Plan within Table 2's limits."""
    cycles = {"bees": 60, "adaptation": 40, "sequential": 10}[optimiser]
    design = plan(
        cdm2(),
        table_2(cdm2()),
        harmonics=3,
        zero_start=zero_start,
        frequency=(0.25, FREQUENCY[1]) if zero_start else None,
        duration=30.0,
        optimiser=optimiser,
        cycles=cycles,
    )
    return design.series


@cache
def designed(optimiser: str, zero_start: bool) -> Excitation:
    """Add a run-in and a run-out, for which the amplitude may have to be a little less."""
    return at_rest(cdm2(), table_2(cdm2()), planned(optimiser, zero_start), 30.0)


@pytest.mark.parametrize("zero_start", [False, True])
@pytest.mark.parametrize("optimiser", ["bees", "adaptation", "sequential"])
def test_limits_of_table_2_hold_on_a_fine_grid_and_are_touched(optimiser, zero_start):
    """On 10 kHz, run-in and run-out included; each joint of the series touches one of its limits."""
    model, limits, series = cdm2(), table_2(cdm2()), planned(optimiser, zero_start)
    _, q, v, a = designed(optimiser, zero_start).sample(10_000.0)
    shares = usage(model, limits, q, v, a)
    assert all((share <= 1.0).all() for share in shares.values()), shares
    shares = usage(model, limits, *series(np.arange(0.0, series.period, 1e-4)))
    assert all((share <= 1.0).all() for share in shares.values()), shares
    touched = np.maximum.reduce([shares[name] for name in ("position", "velocity", "acceleration")])
    assert (touched > 0.999).all() or shares["motor_torque"].max() > 0.99


@pytest.mark.parametrize("zero_start", [False, True])
def test_starts_and_ends_at_rest_without_a_jump(zero_start):
    excitation = designed("sequential", zero_start)
    t, q, v, a = excitation.sample(1000.0)
    assert t[-1] == pytest.approx(excitation.duration)
    for edge in (0, -1):
        np.testing.assert_allclose(v[edge], 0.0, atol=1e-12)
        np.testing.assert_allclose(a[edge], 0.0, atol=1e-12)
    assert np.abs(np.diff(a, axis=0)).max() < 1e-2 * np.abs(a).max()
    np.testing.assert_allclose(np.gradient(q, t, axis=0)[1:-1], v[1:-1], atol=1e-5)
    if zero_start:
        np.testing.assert_allclose(excitation.series(0.0)[0], 0.0, atol=1e-12)
        np.testing.assert_allclose(q[[0, -1]], 0.0, atol=1e-12)


def test_motor_limits_through_E_and_cable_tension_bind():
    """Motor 2 turns with the sum of both joints; the pretension leaves little room above gravity."""
    model = cdm2()
    base = {"joints": [{"position": [-1.0, 1.0], "velocity": 5.0, "acceleration": 20.0}] * 2}
    slow = parse_limits(base | {"motors": [{"velocity": 3.0}, {"velocity": 0.5}]}, model)
    tight = parse_limits(base | {"minimum_tension": 15.0}, model)
    for limits, name in ((slow, "motor_velocity"), (tight, "motor_torque")):
        found = plan(model, limits, "d_optimal", harmonics=2, duration=20.0, cycles=8)
        q, v, a = found.series(np.arange(0, found.series.period, 1e-3))
        shares = usage(model, limits, q, v, a)
        assert worst_usage(model, limits, q, v, a)[0] <= 1.0
        assert shares[name].max() > 0.98
    tau_m = motor_torques(model, q, v, a)
    lower = 80.0 - np.abs(tau_m) / (2 * 0.1)
    assert lower.min() >= 15.0  # the slacker side, eq. (17) with both sides pretensioned


def test_mechanism_limit_is_part_of_the_limits():
    """The cable leaves the joint pulley at 124.55 deg (Figure 3)."""
    limits = parse_limits({"joints": [{"position": [-3.0, 3.0]}] * 2}, cdm2())
    np.testing.assert_allclose(np.degrees(limits.position), [[-124.554, 124.554]] * 2, atol=1e-3)


def test_robot_with_more_joints_than_motors_keeps_its_coupling(tmp_path):
    """Joints that move together stay together, through run-in and run-out, within joint and motor limits."""
    links = "".join(
        f'<link name="l{i}"><inertial><origin xyz="0.2 0 0"/><mass value="1"/>'
        f'<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="j{i}" type="revolute"><parent link="{"b" if i == 1 else f"l{i - 1}"}"/><child link="l{i}"/>'
        f'<origin xyz="0.4 0 0"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="0" velocity="3"/></joint>'
        for i in (1, 2, 3)
    )
    (tmp_path / "arm.urdf").write_text(f'<robot name="r"><link name="b"/>{links}</robot>')
    E = [[1.0, 0.0], [-1.0, 1.0], [1.0, -1.0]]
    content = {
        "urdf": "arm.urdf",
        "gravity": [0.0, -9.81, 0.0],
        "transmission": {"joints": ["j1", "j2", "j3"], "joint_from_motor": E, "offset": [0.0, 0.3, -0.3]},
    }
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(content))
    model = load_model(tmp_path / "arm.yaml")
    limits = default_limits(model)
    found = plan(model, limits, "d_optimal", harmonics=2, duration=20.0, cycles=6)
    excitation = at_rest(model, limits, found.series, 30.0)
    _, q, v, a = excitation.sample(1000.0)
    np.testing.assert_allclose(q[:, 1] + q[:, 2], 0.0, atol=1e-12)
    share, what = worst_usage(model, limits, q, v, a)
    assert 0.99 < share <= 1.0, what


@pytest.mark.parametrize(
    ("content", "place", "words"),
    [
        ({"joints": [{"position": [0.5, -0.5]}] * 2}, r"joints\[1\].position", "lowest, highest"),
        ({"joints": [{"position": [2.5, 3.0]}] * 2}, r"joints\[1\].position", "mechanism"),
        ({"joints": [{"velocity": 0}] * 2}, r"joints\[1\].velocity", "above 0"),
        ({"joints": [{}, {"speed": 1.0}]}, r"joints\[2\]", "unknown key 'speed'"),
        ({"joints": [{}]}, "joints", "list of 2"),
        ({"joint": []}, "", "did you mean 'joints'"),
        ({"motors": [{"torque": "much"}] * 2}, r"motors\[1\].torque", "a number"),
        ({"minimum_tension": 90}, "pretension", "leaves nothing"),
    ],
)
def test_limits_that_contradict_themselves_are_named(tmp_path, content, place, words):
    path = tmp_path / "limits.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(InputError, match=f"(?s){place}.*{words}"):
        load_limits(path, cdm2())


def test_motion_that_no_objective_can_judge_is_refused():
    with pytest.raises(InputError, match="no motion within them is informative enough"):
        plan(cdm2(), table_2(cdm2()), each(lambda q, v, a: np.inf), optimiser="bees", cycles=2)


def test_infeasible_limits_say_why():
    model = cdm2()
    weak = parse_limits({"motors": [{"torque": 5.0}, {"torque": 5.0}]}, model)
    with pytest.raises(InputError, match=r"standing still .* 11.76 N m at motor 1, 5 N m"):
        plan(model, weak, zero_start=True, cycles=3)
    away = parse_limits({"joints": [{"position": [0.2, 0.5]}] * 2}, model)
    with pytest.raises(InputError, match="joint 1 would move about 0, outside"):
        plan(model, away, zero_start=True, cycles=3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"harmonics": 0}, "at least 1 harmonic"),
        ({"duration": 0.0}, "duration above 0"),
        ({"cycles": 0}, "at least 1 cycle"),
        ({"frequency": (2.0, 1.0)}, "lowest < highest"),
        ({"optimiser": "ants"}, "known: bees, adaptation, sequential"),
        ({"objective": "d_optimum"}, "did you mean 'd_optimal'"),
    ],
)
def test_settings_out_of_range_are_refused(change, words):
    with pytest.raises(InputError, match=words):
        plan(cdm2(), table_2(cdm2()), **({"objective": "condition"} | change))


def test_experiment_too_short_for_its_run_in_is_refused():
    with pytest.raises(InputError, match=r"too short|no run-in"):
        at_rest(cdm2(), table_2(cdm2()), designed("sequential", False).series, 0.5)


def test_blend_meets_both_ends():
    q, v, a = np.array([0.3]), np.array([-0.2]), np.array([0.5])
    blend = Blend.between(2.0, np.array([0.1]), q, v, a)
    for found, expected in zip(blend(np.array([0.0, 2.0])), ([0.1, 0.3], [0.0, -0.2], [0.0, 0.5]), strict=True):
        np.testing.assert_allclose(found[:, 0], expected, atol=1e-12)


# objectives


def test_predicted_errors_are_those_of_repeated_experiments():
    """Monte Carlo of least squares with white torque noise, for a random planar arm of three links."""
    model = planar_arm(3, 5)
    base = base_parameters(model)
    series = FourierSeries(2.0, np.zeros(3), *(0.2 * np.random.default_rng(1).normal(size=(2, 3, 3))))
    q, v, a = series(np.arange(0, series.period, 0.02))
    noise = np.array([0.3, 0.1, 0.2])
    W = base.regressor(model, q, v, a) / noise[:, None]
    clean = inverse_dynamics(model, q, v, a) @ model.joint_from_motor / noise
    rng = np.random.default_rng(0)
    trials = (clean.ravel()[:, None] + rng.standard_normal((clean.size, 400))).reshape(clean.size, 400)
    estimates = np.linalg.lstsq(W.reshape(clean.size, -1), trials, rcond=None)[0]
    errors = predicted_errors(model, q, v, a, noise=noise, base=base)
    np.testing.assert_allclose(estimates.mean(axis=1), [e.value for e in errors], atol=4 * max(e.std for e in errors))
    np.testing.assert_allclose(estimates.std(axis=1), [e.std for e in errors], rtol=0.15)


def test_objectives_are_what_their_names_say():
    model = cdm2()
    base = base_parameters(model)
    q, v, a = random_series(7)(np.linspace(0, 20, 300))
    motion = tuple(x[None] for x in (q, v, a))
    Y = base.regressor(model, q, v, a)
    W = Y.reshape(-1, base.rank)
    errors = predicted_errors(model, q, v, a, noise=1.0, base=base)
    relative = np.array([e.relative for e in errors]) * np.sqrt(len(q))
    assert make_objective("relative_error", model)(*motion)[0] == pytest.approx(relative.max())
    unit = W / np.linalg.norm(W, axis=0)
    assert make_objective("scaled_condition", model)(*motion)[0] == pytest.approx(np.linalg.cond(unit))
    scaled = W * reference_magnitudes(model, base) / np.sqrt(len(q))
    volume = np.linalg.det(scaled.T @ scaled) ** (-0.5 / base.rank)
    assert make_objective("d_optimal", model)(*motion)[0] == pytest.approx(volume)
    seen = [np.abs(Y[:, j]).max(axis=0) > 1e-12 for j in range(2)]
    worst = max(np.linalg.cond(Y[:, j][:, seen[j]]) for j in range(2))
    assert make_objective("condition", model)(*motion)[0] == pytest.approx(worst)


def test_motion_that_does_not_show_a_parameter_gives_it_no_finite_error():
    q = np.zeros((50, 2))
    assert all(e.std == np.inf for e in predicted_errors(cdm2(), q, q, q, noise=1.0))


@pytest.mark.parametrize("name", ["condition", "scaled_condition", "d_optimal", "relative_error"])
def test_planning_beats_random_motions_at_the_edge(name):
    model, limits = cdm2(), table_2(cdm2())
    score = make_objective(name, model)
    planned = plan(model, limits, name, harmonics=3, duration=60.0, cycles=12)
    drawn = plan(model, limits, name, harmonics=3, duration=60.0, optimiser="bees", cycles=1, seed=3)
    assert planned.value < 0.8 * drawn.history[0]
    q, v, a = planned.series(planned.series.period * np.arange(500) / 500)
    assert score(q[None], v[None], a[None])[0] == pytest.approx(planned.value, rel=1e-2)


@pytest.mark.parametrize("optimiser", ["adaptation", "sequential"])
def test_own_objective_of_a_single_motion(optimiser):
    """The mean square velocity of joint 2, made large: the limit of velocity says how large."""
    limits = table_2(cdm2())
    found = plan(
        cdm2(), limits, each(lambda q, v, a: -float(np.mean(v[:, 1] ** 2))), harmonics=2, duration=30.0,
        optimiser=optimiser, cycles=60,
    )  # fmt: skip
    best = -0.5 * limits.velocity[1] ** 2  # a sine at the limit
    assert found.value < 0.98 * best


def test_penalty_as_printed_meets_no_candidate_within_tight_limits():
    """Bounds of 1 rad and Table 2's limits of a few hundredths: every early candidate pays the constant."""
    model, limits = cdm2(), table_2(cdm2())
    given = {"harmonics": 3, "zero_start": True, "frequency": (0.1, FREQUENCY[1]), "optimiser": "bees", "cycles": 30}
    assert plan(model, limits, "condition", handling="penalty", **given).history[-1] > 1e6
    assert plan(model, limits, "condition", handling="scaling", **given).history[-1] < 1e6


@pytest.mark.parametrize("optimiser", ["bees", "adaptation", "sequential"])
def test_interrupted_plan_keeps_the_best_so_far_within_limits(optimiser):
    model, limits = cdm2(), table_2(cdm2())
    score, calls = make_objective("d_optimal", model), []

    def interrupted(q, v, a):
        calls.append(len(q))
        if len(calls) == 9:
            raise KeyboardInterrupt
        return score(q, v, a)

    found = plan(model, limits, interrupted, harmonics=2, optimiser=optimiser)
    assert found.interrupted and np.isfinite(found.value)
    q, v, a = found.series(np.arange(0, found.series.period, 0.01))
    assert worst_usage(model, limits, q, v, a)[0] <= 1.0


# the command


@pytest.fixture
def limits_file(tmp_path):
    path = tmp_path / "limits.yaml"
    joint = {"position": [-0.5, 0.5], "velocity": 0.5, "acceleration": 1.0}
    path.write_text(yaml.safe_dump({"joints": [joint] * 2, "minimum_tension": 5.0}))
    return path


def excite(*more):
    return main(["excite", str(CDM2), "--harmonics", "2", "--duration", "20", "--cycles", "5", *map(str, more)])


def test_command_writes_trajectory_and_design(tmp_path, limits_file, capsys):
    out, figure = tmp_path / "go.csv", tmp_path / "history.svg"
    assert excite("-o", out, "--limits", limits_file, "--figure", figure, "--torque-noise", "0.1", "--json") == 0
    recording = load_recording(out, cdm2())
    assert {"joint_position_desired", "joint_position", "joint_velocity", "joint_acceleration"} == set(
        recording.channels
    )
    assert recording.n_samples == 2001
    design = json.loads((tmp_path / "go.design.json").read_text())
    assert design == json.loads(capsys.readouterr().out)
    assert not design["interrupted"]
    names = base_parameters(cdm2()).names
    assert [entry["name"] for entry in design["base_parameters"]] == list(names)
    series = FourierSeries(*(np.array(design["series"][key]) for key in ("frequency", "center", "cosine", "sine")))
    middle = recording.time[1000] - design["run_in"]
    np.testing.assert_allclose(series(middle)[0][0], recording.channels["joint_position"][1000], atol=1e-12)
    assert max(max(x) for x in design["limit_usage"].values()) <= 1.0
    assert figure.read_text().startswith("<?xml")
    assert main(["torque", str(CDM2), str(out), "-o", str(tmp_path / "tau.csv")]) == 0


def test_command_same_seed_same_bytes(tmp_path, limits_file):
    for name in ("one", "two"):
        assert excite("-o", tmp_path / f"{name}.csv", "--limits", limits_file, "--quiet") == 0
    for suffix in (".csv", ".design.json"):
        assert (tmp_path / f"one{suffix}").read_bytes() == (tmp_path / f"two{suffix}").read_bytes()


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--harmonics", "0"], "at least 1 harmonic"),
        (["--torque-noise", "1", "2", "3"], "2 (one per motor)"),
        (["--rate", "0"], "rate above 0"),
        (["--frequency", "2", "1"], "lowest < highest"),
    ],
)
def test_command_bad_settings_are_one_line_and_leave_nothing(tmp_path, limits_file, capsys, more, words):
    folder = tmp_path / "out"
    folder.mkdir()
    assert excite("-o", folder / "go.csv", "--limits", limits_file, *more) == 2
    message = capsys.readouterr().err
    assert words in message and message.count("\n") == 1
    assert not list(folder.iterdir())


def test_command_infeasible_limits_name_the_file(tmp_path, capsys):
    path = tmp_path / "limits.yaml"
    path.write_text("joints: [{position: [2.5, 3]}, {}]\n")
    assert excite("-o", tmp_path / "go.csv", "--limits", path) == 2
    message = capsys.readouterr().err
    assert "limits.yaml" in message and "joints[1].position" in message
    assert excite("-o", tmp_path / "nowhere" / "go.csv") == 2
    assert "folder" in capsys.readouterr().err
    assert [entry.name for entry in tmp_path.iterdir()] == ["limits.yaml"]


def test_command_says_whose_limits_carry_too_little_and_refuses_a_negative_seed(tmp_path, capsys):
    """Torques that cannot hold the arm are said of the limits' file; a negative seed of the option."""
    path = tmp_path / "weak.yaml"
    path.write_text("motors: [{torque: 0.5}, {torque: 0.5}]\n")
    assert excite("-o", tmp_path / "go.csv", "--limits", path) == 2
    message = capsys.readouterr().err
    assert "weak.yaml: infeasible limits: standing still" in message and message.count("\n") == 1
    assert excite("-o", tmp_path / "go.csv", "--seed", "-1") == 2
    assert "--seed: a whole number from 0 on" in capsys.readouterr().err


def test_default_limits_stay_clear_of_the_mechanisms():
    """Without limits of one's own a tracking error of a degree does not take the cable off its pulley."""
    model = load_model(CDM2)
    own, used = mechanism_limits(model).position, default_limits(model).position
    assert (np.abs(own - used) > np.radians(3)).all() and (np.abs(used) < np.abs(own)).all()


def test_command_interrupted_writes_the_best_marks_it_and_exits_130(tmp_path, limits_file, monkeypatch, capsys):
    import cdm_pin.commands.excite as command

    make = make_objective

    def impatient(*args, **kwargs):
        score, calls = make(*args, **kwargs), []

        def objective(q, v, a):
            calls.append(1)
            if len(calls) == 10:
                raise KeyboardInterrupt
            return score(q, v, a)

        return objective

    monkeypatch.setattr(command, "make_objective", impatient)
    out = tmp_path / "go.csv"
    assert excite("-o", out, "--limits", limits_file) == 130
    assert "interrupted" in capsys.readouterr().err
    assert json.loads((tmp_path / "go.design.json").read_text())["interrupted"] is True
    recording = load_recording(out, cdm2())
    limits = load_limits(limits_file, cdm2())
    motion = (recording.channels[f"joint_{x}"] for x in ("position", "velocity", "acceleration"))
    assert worst_usage(cdm2(), limits, *motion)[0] <= 1.0


def test_limits_are_frozen():
    limits = table_2(cdm2())
    with pytest.raises(ValueError, match="read-only"):
        limits.velocity[0] = 9.0
    assert isinstance(limits.replace(velocity=[1.0, 1.0]), Limits)
