"""Trials of the plant, written to files and read again as a user would."""

import numpy as np
from scipy.signal import savgol_filter

from cdm_pin.base import base_parameters, massive_columns
from cdm_pin.model import load_model
from cdm_pin.plant.draw import draw
from cdm_pin.problem import make_problem
from cdm_pin.recording import Recording, load_recording
from cdm_pin.search import Search
from cdm_pin.settings import Settings


def written_trial(folder, seed, **options):
    """Draw a trial, write it and load what a user would have: model, recordings, unseen ones; with truth and files."""
    trial = draw(seed, **options)
    files = trial.write(folder)
    model = load_model(files["manipulator"])
    runs, unseen = ([load_recording(path, model) for path in files[k]] for k in ("recordings", "holdout"))
    return model, runs, unseen, trial.truth, files


def loaded_trial(folder, seed, **options):
    return written_trial(folder, seed, **options)[:4]


def rubbed(model, run, joint, friction):
    """Add to the torques of a recording friction of a joint, a function of time and velocity."""
    v = np.gradient(savgol_filter(run.channels["joint_position"][:, joint - 1], 31, 3), run.time)
    torque = friction(run.time - run.time[0], v)[:, None] * model.joint_from_motor[joint - 1]
    return with_torque(run, run.channels["motor_torque"] + torque)


def with_torque(run, torque):
    """Give a recording with other torques of its motors."""
    return Recording(run.time, run.channels | {"motor_torque": torque}, label=run.label)


def two_tones(t, w, phase):
    """Move each joint at a frequency of its own [rad/s] and at 2.3 times that; give positions, rates, accelerations."""
    angles = [k * w * t[:, None] + p for k, p in zip((1, 2.3), phase, strict=True)]
    q = 0.5 * sum(np.sin(x) for x in angles)
    v = 0.5 * sum(k * w * np.cos(x) for k, x in zip((1, 2.3), angles, strict=True))
    a = -0.5 * sum((k * w) ** 2 * np.sin(x) for k, x in zip((1, 2.3), angles, strict=True))
    return q, v, a


def search_of(model, recording, band=None):
    """Give the search on one recording."""
    base = base_parameters(model, columns=massive_columns(model))
    return Search(make_problem(model, [recording], band), base, Settings())
