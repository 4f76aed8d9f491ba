"""Signals: each piece against what it must do, the faults of real loggers put into simulated logs, and real logs."""

from __future__ import annotations

import gzip
from types import SimpleNamespace

import numpy as np
import pytest

from cdm_pin.band import make_band
from cdm_pin.errors import RecordingError
from cdm_pin.recording import Recording
from cdm_pin.signals import (
    average_periods,
    check,
    choose_cutoff,
    differentiate,
    estimate_period,
    lowpass,
    motion_at_rows,
    noise_floor,
    prepare,
    quantisation_step,
    read_grid,
    resample_uniform,
    sampling_instants,
    standstill,
)

PERIOD = 4.0  # [s]
INERTIA, VISCOUS, COULOMB = np.array([0.5, 0.3, 0.1]), np.array([0.2, 0.1, 0.05]), np.array([0.4, 0.2, 0.1])


def motion(time, joints=3, seed=3, harmonics=5):
    """Give position, velocity, acceleration of a multi-sine of period 4 s, shape (n, joints) each."""
    rng = np.random.default_rng(seed)
    order = np.arange(1, harmonics + 1)
    a, b = rng.normal(size=(2, harmonics, joints)) / order[:, None]
    w = 2 * np.pi * order / PERIOD
    s, c = np.sin(np.outer(time, w)), np.cos(np.outer(time, w))
    return s @ a + c @ b, (c * w) @ a - (s * w) @ b, -(s * w**2) @ a - (c * w**2) @ b


def robot_log(duration=20.0, rate=500.0, noise=(1e-5, 2e-3), sampled=None, seed=0, **changes):
    """Log a robot of three separate joints with friction; `sampled` are the true instants behind the stamps."""
    rng = np.random.default_rng(seed)
    stamps = np.arange(int(duration * rate)) / rate
    q, v, a = motion(stamps if sampled is None else sampled)
    tau = INERTIA * a + VISCOUS * v + COULOMB * np.tanh(v / 0.02)
    channels = {
        "joint_position": q + noise[0] * rng.normal(size=q.shape),
        "joint_velocity": v + 10 * noise[0] * rng.normal(size=q.shape),
        "joint_torque": tau + noise[1] * rng.normal(size=q.shape),
    }
    channels |= {name: change(channels[name]) for name, change in changes.items()}
    return Recording(stamps, {name: x for name, x in channels.items() if x is not None})


def kinds(signals, model=None):
    return {(c.kind, c.channel) for c in check(signals, model)}


def test_differentiate_multisine():
    """The derivative is right to (w/rate)^8/630 inside, and exact to the end for polynomials to the 8th degree."""
    rate = 100.0
    t = np.arange(400) / rate
    for f in (1.0, 5.0, 10.0):
        w = 2 * np.pi * f
        error = differentiate(np.sin(w * t), rate) - w * np.cos(w * t)
        assert np.abs(error[4:-4]).max() < 1.1 * w * (w / rate) ** 8 / 630 + 1e-10
    x = np.linspace(-1, 1, 50)
    for degree in range(9):
        exact = degree * x ** max(degree - 1, 0)
        assert np.allclose(differentiate(x**degree, 1 / (x[1] - x[0])), exact, atol=1e-8)
    assert differentiate(np.ones((1, 2)), 1.0).shape == (1, 2)
    assert np.allclose(differentiate(np.arange(5.0), 10.0), 10)


def test_lowpass_has_zero_phase_and_safe_ends():
    """In band nothing changes, at the cut-off the gain is 1/2 without phase, and a ramp stays a ramp to its ends."""
    rate, t = 200.0, np.arange(4000) / 200
    inside = slice(400, -400)
    slow, edge = np.sin(2 * np.pi * 1.0 * t), np.sin(2 * np.pi * 10.0 * t)
    assert np.allclose(lowpass(slow, rate, 10.0)[inside], slow[inside], atol=1e-6)
    assert np.allclose(lowpass(edge, rate, 10.0)[inside], 0.5 * edge[inside], atol=1e-6)
    assert np.allclose(lowpass(3 + 2 * t, rate, 5.0, order=6), 3 + 2 * t, atol=1e-6)
    assert np.array_equal(lowpass(slow, rate, 100.0), slow)
    assert np.array_equal(lowpass(slow[:3], rate, 5.0), slow[:3])


def test_resampling_jittered_stamps():
    """On a grid a multi-sine comes back to 1e-6; in a long gap nothing swings; uniform samples stay as they are."""
    rng = np.random.default_rng(0)
    t = np.sort(np.arange(4000) / 200 + rng.uniform(-1e-3, 1e-3, 4000))
    grid, q = resample_uniform(t, motion(t)[0], 200.0)
    assert np.abs(q - motion(grid)[0])[5:-5].max() < 2e-6
    keep = (t < 5) | (t > 8)
    grid, q = resample_uniform(t[keep], motion(t[keep])[0], 200.0)
    hole = (grid > 5) & (grid < 8)
    ends = np.vstack([motion(t[t < 5])[0][-1], motion(t[t > 8])[0][0]])
    assert np.all(q[hole] <= ends.max(axis=0) + 1e-9) and np.all(q[hole] >= ends.min(axis=0) - 1e-9)
    uniform = np.arange(100) / 200
    assert np.array_equal(resample_uniform(uniform, np.sin(uniform), 200.0)[1], np.sin(uniform))


def test_next_to_nothing_beside_a_gap_is_resampled_in_silence(recwarn):
    """Velocities at rest may be too small to divide by."""
    time = np.r_[np.arange(50) * 0.01, 1.0 + np.arange(50) * 0.01]
    x = np.where(np.arange(100) % 7 == 3, 1e-310, 0.0) + 1e-312 * np.arange(100)
    values = resample_uniform(time, x, 100.0)[1]
    assert np.all(np.abs(values) < 1e-300)
    assert not recwarn.list


def test_steps_and_rest_outlive_jittered_stamps():
    """Samples carried to a grid are as coarse as the rows were; an encoder at rest is as coarse, and rests exactly."""
    rng = np.random.default_rng(0)
    t, step = np.arange(2000) / 100 + 2e-3 * rng.uniform(-1, 1, 2000), 2 * np.pi / 2**12
    q = np.stack([0.5 * np.sin(0.1 * t), np.full(2000, 0.4)], axis=1)
    signals = prepare(Recording(t, {"joint_position": step * np.floor(q / step)}))
    assert signals.steps["joint_position"] == pytest.approx([step, step], rel=1e-6)
    assert np.all(signals.noise["joint_position"] > 0.99 * step / np.sqrt(12))
    assert np.ptp(signals.channels["joint_position"][:, 1]) == 0.0
    assert not signals.channels["joint_acceleration"][:, 1].any()


@pytest.mark.parametrize("bits", [8, 12, 14, 17])
def test_quantisation_step(bits):
    """An encoder's step is found to 1e-6, with an offset; a continuous column has none."""
    q = motion(np.arange(0, 20, 2e-3))[0][:, 0]
    step = 2 * np.pi / 2**bits
    assert quantisation_step(step * np.round(q / step) + 0.123) == pytest.approx(step, rel=1e-6)
    assert quantisation_step(q) == 0.0
    assert quantisation_step(np.zeros(10)) == 0.0


def test_noise_floor_recovers_white_noise():
    """The floor of white noise on a motion is found to 15 %, in the full band and below a cut-off."""
    rng = np.random.default_rng(0)
    sigma = np.array([1e-5, 1e-3, 3e-2])
    x = motion(np.arange(0, 20, 2e-3))[0] + sigma * rng.normal(size=(10000, 3))
    assert np.allclose(noise_floor(x, 500.0), sigma, rtol=0.15)
    assert np.allclose(noise_floor(x, 500.0, 10.0), sigma * np.sqrt(10 / 250), rtol=0.15)


def test_cutoff_is_chosen_between_motion_and_noise():
    """The cut-off keeps accelerations to 0.1 %, lies lower the more noise there is, and is wide open without noise."""
    rng = np.random.default_rng(0)
    t = np.arange(0, 20, 2e-3)
    q, _, a = motion(t)
    cutoffs = []
    for sigma in (1e-6, 1e-5, 1e-4):
        noisy = q + sigma * rng.normal(size=q.shape)
        cutoffs.append(choose_cutoff(noisy, 500.0))
        smooth = lowpass(noisy, 500.0, cutoffs[-1])
        error = differentiate(differentiate(smooth, 500.0), 500.0) - a
        assert np.all(error[500:-500].std(axis=0) < 1e-3 * a.std(axis=0))
    assert choose_cutoff(q, 500.0) == 200.0
    assert cutoffs[0] >= cutoffs[1] >= cutoffs[2] > 1.25
    assert choose_cutoff(np.zeros((1000, 2)), 500.0) == 200.0
    assert choose_cutoff(q[:10], 500.0) == 200.0


def test_what_rounds_is_noise_even_where_it_repeats_exactly():
    """A simulated cycle whose encoder steps come again to the sample is not differentiated as if they were motion."""
    t = np.arange(0, 30, 2e-3)
    q = np.column_stack([np.sin(2 * np.pi * t / 6) + 0.3 * np.cos(4 * np.pi * t / 6), 0.7 * np.cos(2 * np.pi * t / 6)])
    step = 2 * np.pi / 2**13
    x = step * np.round(q / step)
    a, rounded = (
        differentiate(differentiate(y, 500.0), 500.0) for y in (q, lowpass(x, 500.0, choose_cutoff(x, 500.0)))
    )
    assert np.all((rounded - a)[500:-500].std(axis=0) < 0.02 * a.std(axis=0))
    assert choose_cutoff(x, 500.0, steps=np.zeros(2)) == 200.0
    shaken = x + 1e-9 * np.random.default_rng(0).normal(size=x.shape)  # no steps are seen any more
    assert choose_cutoff(shaken, 500.0, steps=np.full(2, step)) == pytest.approx(choose_cutoff(x, 500.0), rel=0.05)
    signals = prepare(Recording(t, {"joint_position": x}))
    assert signals.period == pytest.approx(6.0, abs=1e-3)
    assert np.all(signals.noise["joint_position"] >= 0.99 * step / np.sqrt(12))


def test_period_is_found_to_a_fraction_of_a_sample():
    """A period that is no whole number of samples is found to a hundredth of one; noise and drift have none."""
    rng = np.random.default_rng(0)
    rate = 123.4
    x = motion(np.arange(0, 18, 1 / rate))[0] + 1e-3 * rng.normal(size=(2222, 3))
    assert estimate_period(x, rate) == pytest.approx(PERIOD, abs=0.01 / rate)
    assert estimate_period(np.cumsum(rng.normal(size=(2000, 2)), axis=0), rate) is None
    assert estimate_period(motion(np.arange(0, 4.5, 1 / rate))[0], rate) is None
    assert estimate_period(np.zeros((100, 2)), rate) is None


def test_average_over_periods_and_covariance_between_them():
    """The mean has the noise over sqrt(count); the covariance between periods is the noise's, correlation and all."""
    rng = np.random.default_rng(0)
    log = robot_log(duration=42.0, rate=100.0, noise=(0.0, 0.0))
    mix = np.array([[1.0, 0, 0], [0.5, 1, 0], [0, 0, 2]])
    tau = log.channels["joint_torque"] + 0.05 * rng.normal(size=(4200, 3)) @ mix.T
    signals = prepare(Recording(log.time, {**log.channels, "joint_torque": tau}), cutoff=49.0)
    assert signals.period == pytest.approx(PERIOD, abs=1e-4)
    periods = average_periods(signals)
    passed = np.sum(lowpass(np.eye(1, 400, 200)[0], 100.0, signals.cutoff) ** 2)
    assert np.allclose(periods.covariance["joint_torque"], passed * 0.05**2 * mix @ mix.T, atol=0.1 * 0.05**2 * 4)
    assert np.allclose(signals.noise["joint_torque"], 0.05 * np.sqrt(np.diag(mix @ mix.T)), rtol=0.1)
    clean = average_periods(prepare(log, cutoff=49.0)).channels["joint_torque"]
    error = (periods.channels["joint_torque"] - clean).std(axis=0)
    assert np.all(error < 1.3 * 0.05 * np.sqrt(np.diag(mix @ mix.T) / 10))
    with pytest.raises(ValueError, match="does not repeat"):
        average_periods(prepare(robot_log(duration=4.0)))


def test_sampling_instants_are_told_by_the_joints():
    """Rows sampled off their stamps are put back: nine tenths of the error goes, and accelerations get better by it."""
    rng = np.random.default_rng(0)
    stamps = np.arange(10000) / 500
    late = rng.uniform(-0.5e-3, 0.5e-3, 10000)
    log = robot_log(sampled=stamps + late, noise=(1e-5, 2e-3))
    instants, notice, _ = sampling_instants(stamps, log.channels["joint_position"])
    inside = slice(200, -200)
    assert np.std((instants - stamps - late)[inside]) < 0.35 * late.std()
    assert "sampled 0.2" in notice or "sampled 0.3" in notice
    exact = motion(prepare(log, cutoff=10.0).time)[2]
    errors = []
    for repair in (True, False):
        signals = prepare(log, cutoff=10.0, repair_clock=repair)
        errors.append((signals.channels["joint_acceleration"] - exact)[signals.valid].std(axis=0))
    assert np.all(errors[0] < errors[1])
    assert np.array_equal(log.time, stamps)


@pytest.mark.parametrize("flaw", ["none", "white", "coarse", "one_joint", "vibration"])
def test_good_clocks_are_left_alone(flaw):
    """No noise, noise, coarse encoders, a single joint, or joints that vibrate do not pass for a bad clock."""
    rng = np.random.default_rng(0)
    t = np.arange(10000) / 500
    q = motion(t)[0]
    if flaw == "white":
        q = q + 1e-4 * rng.normal(size=q.shape)
    elif flaw == "coarse":
        q = 2e-3 * np.round(q / 2e-3)
    elif flaw == "one_joint":
        q = q[:, :1] + 1e-4 * rng.normal(size=(len(q), 1))
    elif flaw == "vibration":
        q = q + 1e-3 * np.sin(2 * np.pi * 80 * t)[:, None] + 1e-6 * rng.normal(size=q.shape)
    assert sampling_instants(t, q) is None


def test_one_filter_keeps_linear_relations():
    """Torque, velocity and acceleration stay related after preparation as they were: both sides see the same filter."""
    log = robot_log(noise=(0.0, 0.0))
    signals = prepare(log, cutoff=8.0)
    light = signals.light["joint_velocity"]
    friction = signals.filter(COULOMB * np.tanh(light / 0.02))
    model = INERTIA * signals.channels["joint_acceleration"] + VISCOUS * signals.channels["joint_velocity"] + friction
    rest = (signals.channels["joint_torque"] - model)[signals.valid]
    assert np.all(rest.std(axis=0) < 2e-3 * signals.channels["joint_torque"].std(axis=0))
    assert signals.light_cutoff > signals.cutoff == 8.0
    assert not signals.valid[0] and not signals.valid[-1] and signals.valid.mean() > 0.95


def test_derivatives_are_accurate_with_chosen_settings():
    """With everything left to the data, accelerations of a noisy log are right to 2 % inside."""
    signals = prepare(robot_log())
    _, v, a = motion(signals.time)
    for name, exact, bound in (("joint_velocity", v, 0.005), ("joint_acceleration", a, 0.02)):
        error = (signals.channels[name] - exact)[signals.valid]
        assert np.all(error.std(axis=0) < bound * exact.std(axis=0))


def test_repeats_and_gaps():
    """Rows that repeat themselves while moving are left out, gaps are not used, both are said, and the log stays."""
    log = robot_log()
    held = np.arange(10000)
    late = np.random.default_rng(0).choice(np.arange(10, 9990, 3), 800, replace=False)
    held[late] -= 1
    rows = np.concatenate([np.arange(3000), np.arange(3400, 10000)])
    channels = {name: x[held][rows] for name, x in log.channels.items()}
    recording = Recording(log.time[rows], channels)
    signals = prepare(recording, repair_clock=False)
    text = " ".join(signals.notices)
    assert "% of the rows repeat the row before them" in text and "1 gap(s), the longest 0.802 s" in text
    assert not signals.valid[(signals.time > 6.0) & (signals.time < 6.8)].any()
    assert signals.valid[(signals.time > 8.0) & (signals.time < 15.0)].all()
    error = (signals.channels["joint_position"] - motion(signals.time)[0])[signals.valid]
    assert np.abs(error).max() < 2e-3
    assert len(recording.time) == 9600
    twice = Recording(np.repeat(log.time, 2), {name: np.repeat(x, 2, axis=0) for name, x in log.channels.items()})
    signals = prepare(twice)
    assert signals.rate == pytest.approx(500.0) and any("repeat the stamp" in n for n in signals.notices)


def test_wrong_nominal_rate_is_corrected():
    """A log counted at twice its rate is recognised by its velocities; one with real stamps is only reported."""
    log = robot_log(rate=200.0)
    wrong = Recording(log.time / 2, log.channels)
    signals = prepare(wrong)
    assert signals.rate == pytest.approx(200.0)
    assert any("a second of this log lasts 2 s" in n for n in signals.notices)
    assert np.allclose(signals.channels["joint_velocity"].std(axis=0), motion(log.time)[1].std(axis=0), rtol=0.01)
    jitter = np.random.default_rng(0).uniform(-1e-4, 1e-4, len(log.time))
    stamped = prepare(Recording(log.time / 2 + jitter, log.channels), repair_clock=True)
    assert stamped.rate == pytest.approx(400.0, rel=1e-3)
    assert any("is 0.50 of the differentiated position" in n for n in stamped.notices)


def test_filtered_velocities_tell_no_wrong_rate():
    """A logger's own low-pass makes velocities smaller and late, the quicker the more; the clock is right."""
    log = robot_log(rate=100.0)
    v, late = np.array(log.channels["joint_velocity"]), 0.95
    for k in range(1, len(v)):
        v[k] = late * v[k - 1] + (1.0 - late) * v[k]
    signals = prepare(Recording(log.time, dict(log.channels) | {"joint_velocity": v}))
    assert signals.rate == pytest.approx(100.0)
    assert any("lags it by" in n for n in signals.notices)


def test_instants_that_motion_hides_stay_unsure():
    """Where joints that move in jerks hide slow delays, these count as noise of positions; else nothing does."""
    rng = np.random.default_rng(1)
    t = np.arange(6000) / 200
    late = 3e-4 * rng.normal(size=6000)

    def q(t, jerky):
        smooth = np.stack([np.sin(2.0 * t), 0.8 * np.cos(1.7 * t), 0.7 * np.sin(1.3 * t + 1.0)], axis=1)
        shaken = np.stack([np.sin(2 * np.pi * (11.0 + k) * t) * np.sin(0.9 * t + k) for k in range(3)], axis=1)
        return smooth + 2e-3 * jerky * shaken

    plain, jerky = (sampling_instants(t, q(t + late, flag)) for flag in (0.0, 1.0))
    assert plain[2] == 0.0
    assert jerky[2] == pytest.approx(late.std(), rel=0.3)


@pytest.mark.parametrize(("name", "other"), [("joint_position", "degrees"), ("joint_velocity", "radians")])
def test_degrees_in_place_of_radians(name, other):
    """Degrees in positions or in velocities alone are an error that names the column."""
    with pytest.raises(RecordingError, match=rf"column joint_velocity_1: is [0-9.]+ times .*{other}"):
        prepare(robot_log(**{name: np.rad2deg}))


def test_degrees_are_seen_through_the_transmission():
    """Joint angles in degrees beside motor angles in radians are an error; a wrong sign or ratio is a notice."""
    model = SimpleNamespace(joints="abc", motors="abc", joint_from_motor=np.eye(3), motor_from_joint=np.eye(3))
    log = robot_log(joint_velocity=lambda v: None)
    motors = log.channels["joint_position"]
    both = {"motor_position": motors, "joint_position": motors * [1, -1, 1.5]}
    found = kinds(prepare(Recording(log.time, both), model), model)
    assert ("transmission", "joint_position_2") in found and ("transmission", "joint_position_3") in found
    with pytest.raises(RecordingError, match=r"joint_position_1: is 57\.3 times"):
        prepare(Recording(log.time, {**both, "joint_position": np.rad2deg(motors)}), model)


def test_faults_are_named_and_good_logs_are_silent():
    """Lagging velocity, wrong torque sign, saturation, standstill, a locked joint: each named; a good log has none."""
    assert not kinds(prepare(robot_log()))
    lag = kinds(prepare(robot_log(joint_velocity=lambda v: np.roll(v, 5, axis=0))))
    assert lag == {("velocity", f"joint_velocity_{i}") for i in (1, 2, 3)}
    sign = kinds(prepare(robot_log(joint_torque=lambda tau: tau * [1, -1, 1])))
    assert sign == {("torque_sign", "joint_torque_2")}
    limit = 0.6 * np.abs(robot_log().channels["joint_torque"]).max(axis=0)
    clipped = kinds(prepare(robot_log(joint_torque=lambda tau: np.clip(tau, -limit, limit))))
    assert clipped == {("saturation", f"joint_torque_{i}") for i in (1, 2, 3)}
    fixed = np.array([1.0, 1.0, 0.0])
    still = robot_log(joint_position=lambda q: q * fixed + 0.3, joint_velocity=lambda v: v * fixed)
    assert kinds(prepare(still)) == {("locked", "joint_position_3")}
    pause = np.concatenate([np.arange(0, 10, 2e-3), np.full(2500, 10.0), np.arange(10, 15, 2e-3)])
    signals = prepare(robot_log(sampled=pause, duration=20.0, noise=(0.0, 1e-3)))
    assert standstill(signals).mean() == pytest.approx(0.25, abs=0.02)
    assert ("standstill", "") in kinds(signals)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 10, 40])
def test_little_data_is_not_an_error(n):
    """A record of any length can be prepared; a short one says so."""
    log = robot_log()
    signals = prepare(Recording(log.time[:n], {name: x[:n] for name, x in log.channels.items()}))
    assert signals.channels["joint_acceleration"].shape == (n, 3)
    assert np.all(np.isfinite(signals.channels["joint_acceleration"]))
    assert (n >= 32) or any("too few" in notice for notice in signals.notices)


def test_motion_at_rows():
    """What is logged is given as logged, the rest by differentiation, at every row and at its own stamp."""
    rng = np.random.default_rng(0)
    t = np.linspace(0, 10, 5000) + rng.uniform(-3e-4, 3e-4, 5000)
    q, v, a = motion(t)
    found = motion_at_rows(Recording(t, {"joint_position": q}), "joint")
    assert found["position"].shape == found["acceleration"].shape == (5000, 3)
    assert np.abs(found["velocity"] - v)[20:-20].max() < 1e-4
    assert np.abs(found["acceleration"] - a)[20:-20].max() < 3e-2
    given = motion_at_rows(Recording(t, {"joint_position": q, "joint_velocity": v + 1}), "joint")
    assert np.array_equal(given["velocity"], v + 1)
    uniform = np.arange(1000) / 500
    found = motion_at_rows(Recording(uniform, {"joint_position": motion(uniform)[0]}), "joint")
    assert np.abs(found["acceleration"] - motion(uniform)[2]).max() < 1e-5


def test_lower_rate_and_filter_settings():
    """A lower grid rate keeps the signals, and limits the cut-off to 0.4 of it."""
    signals = prepare(robot_log(), rate=50.0, cutoff=30.0)
    assert (signals.rate, signals.cutoff) == (50.0, 20.0)
    assert np.diff(signals.time) == pytest.approx(0.02)
    error = (signals.channels["joint_position"] - motion(signals.time)[0])[signals.valid]
    assert np.abs(error).max() < 1e-4


def real(data_dir, name, rate, joints=7, header=0):
    """Load a public file of q, dq, tau columns, with or without time."""
    with gzip.open(data_dir / name, "rt") as file:
        x = np.loadtxt(file, delimiter=",", skiprows=header)
    time, x = (x[:, 0], x[:, 1:]) if rate is None else (np.arange(len(x)) / rate, x)
    quantities = ("joint_position", "joint_velocity", "joint_torque")
    return Recording(time, {name: x[:, k * joints : (k + 1) * joints] for k, name in enumerate(quantities)})


def test_real_psm_half_rate(data_dir):
    """The half-speed PSM log is recognised as one of 100 Hz, its period found, its clock jitter told by the joints."""
    signals = prepare(real(data_dir, "dvrk_psm_wpi/one_0.5_scale_105_grams_parallel.csv.gz", 200.0))
    assert signals.rate == pytest.approx(100.0)
    assert signals.period * signals.rate == pytest.approx(1296, abs=0.5)
    assert any("all joints are displaced together" in n for n in signals.notices)
    full = prepare(real(data_dir, "dvrk_psm_wpi/one_results.csv.gz", 200.0))
    assert full.rate == pytest.approx(200.0) and full.period * 200 == pytest.approx(1296, abs=0.5)
    assert not any(c.kind == "torque_sign" for c in check(full))


def test_real_mtm_repeats_and_lagging_velocities(data_dir):
    """The MTM log repeats an eighth of its rows, and its velocities 5 to 7 do not follow the positions; 1 to 3 do."""
    signals = prepare(real(data_dir, "dvrk_mtm_wpi/one_results.csv.gz", 200.0))
    assert any(n.startswith("13 % of the rows repeat the row before them") for n in signals.notices)
    assert signals.period * signals.rate == pytest.approx(2333, abs=0.5)
    velocities = {c.channel for c in check(signals) if c.kind == "velocity"}
    assert {f"joint_velocity_{i}" for i in (5, 6, 7)} <= velocities
    assert not {f"joint_velocity_{i}" for i in (1, 2, 3)} & velocities


def test_real_franka_clock(data_dir):
    """The Franka's stamps are 0.3 ms off; put right, positions differentiate to its velocities far better."""
    log = real(data_dir, "franka_panda_gaz/trajectory_1.csv.gz", None, header=1)
    errors = []
    for repair in (True, False):
        signals = prepare(log, cutoff=20.0, repair_clock=repair)
        v = differentiate(lowpass(signals.logged["joint_position"], signals.rate, 20.0), signals.rate)
        w = lowpass(signals.logged["joint_velocity"], signals.rate, 20.0)
        high = (v - w) - lowpass(v - w, signals.rate, 6.0)
        errors.append(high[signals.valid].std(axis=0))
    assert np.all(errors[0] < 0.75 * errors[1])
    assert not any(c.kind == "torque_sign" for c in check(signals))


def test_real_torque_signs(data_dir):
    """On real arms, right signs pass and turned ones are found on every moving joint of the PSM and the MTM."""
    for name in ("dvrk_psm_wpi/two_results.csv.gz", "dvrk_mtm_wpi/one_results.csv.gz"):
        log = real(data_dir, name, 200.0)
        turned = Recording(log.time, {**log.channels, "joint_torque": -log.channels["joint_torque"]})
        assert not [c for c in check(prepare(log)) if c.kind == "torque_sign"]
        assert len([c for c in check(prepare(turned)) if c.kind == "torque_sign"]) == 7


def test_shares_of_samples_give_the_mean_over_decimated_stretches():
    """What the samples count for, as said, is what filter and decimation make of them."""
    band, x = make_band(200.0, 8.0), np.random.default_rng(0).standard_normal(3000)
    segments = band.segments(np.arange(3000) != 1200)
    kept = np.concatenate([band.reduce(x)[a:b] for a, b in segments])
    assert len(segments) == 2 and band.shares(3000, segments) @ x == pytest.approx(kept.mean(), rel=1e-9)
    assert band.shares(10, []) @ np.ones(10) == pytest.approx(1.0)


def test_a_grid_serves_for_every_cut_off():
    """What is read once and prepared with a cut-off is what would be prepared from the recording itself."""
    rng = np.random.default_rng(5)
    t = np.arange(4000) / 200 + rng.uniform(-2e-4, 2e-4, 4000)
    q, v, _ = motion(t)
    recording = Recording(t, {"joint_position": q + 1e-4 * rng.standard_normal(q.shape), "joint_velocity": v})
    grid = read_grid(recording)
    for options in ({}, {"cutoff": 7.0}, {"cutoff": 7.0, "rate": grid.rate}, {"rate": 100.0}):
        own, again = prepare(recording, **options), prepare(recording, grid=grid, **options)
        assert own.notices == again.notices
        for group in ("channels", "light", "logged", "noise", "floor"):
            one, two = getattr(own, group), getattr(again, group)
            assert one.keys() == two.keys()
            assert all(np.array_equal(one[name], two[name]) for name in one)


@pytest.mark.parametrize("n", [9, 12, 400])
def test_a_derivative_is_exact_for_polynomials_of_eighth_degree(n):
    x = np.linspace(-1.0, 1.0, n)
    powers = np.arange(1, 9)
    found = differentiate(np.sum(x[:, None] ** powers / powers, axis=1), (n - 1) / 2)
    assert np.allclose(found, np.sum(x[:, None] ** (powers - 1), axis=1), rtol=0, atol=1e-10 * n)


@pytest.mark.parametrize("digits", [6, 7, 12])
def test_steps_are_seen_behind_rounded_digits(digits):
    """An encoder of 14 bits, logged with a few digits after the point: multiples of its step but for the last digit."""
    step = 2 * np.pi / 2**14
    x = np.round(np.round(np.sin(np.linspace(0.0, 20.0, 4000)) / step) * step, digits)
    found = quantisation_step(x)
    assert found == pytest.approx(step, rel=1e-3)
    written = np.array([float(f"{v:.{digits}g}") for v in x])
    assert quantisation_step(written) == pytest.approx(step, rel=1e-3)
