"""Errors of `cdm-pin identify` on recordings of real robots, with effects by name, in the band of a publication."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cdm_pin.identify import Identification, identify
from cdm_pin.model import CableModel
from cdm_pin.observation import observe, rows
from cdm_pin.recording import Recording

BASELINE = ("viscous_friction", "coulomb_friction", "torque_offset")
STEP = "`cdm-pin identify`"
FINGERS = ("finger_1_joint", "finger_2_joint", "finger_2_joint-finger_1_joint")
PSM = (
    *BASELINE,
    *(f"{effect}:{place}" for effect in BASELINE[:2] for place in FINGERS),
    *(f"rotor_inertia:{motor}" for motor in ("roll", "disc_5", "disc_6", "disc_7")),
    "joint_spring:roll_joint",
)
RUBBING = ("shoulder_yaw", "arm", "forearm", "parallel_crank", "platform", "wrist_5", "wrist_6", "wrist_7")
MTM = (
    "torque_offset",
    *(f"{effect}:{name}_joint" for effect in BASELINE[:2] for name in RUBBING),
    "rotor_inertia:motor4",
    *(f"torque_ripple:motor4:cycles={cycles}" for cycles in (0.5, 1)),
    *(f"torque_ripple:motor5:cycles={cycles}" for cycles in (1, 2)),
)


def errors(
    model: CableModel,
    train: Sequence[Recording],
    test: Recording,
    effects: Sequence[str] = BASELINE,
    *,
    cutoff: float | None = None,
    window: slice | None = None,
) -> tuple[float, ...]:
    """Identify from some recordings and judge on another.

    Parameters
    ----------
    model : CableModel
    train : sequence of Recording
    test : Recording
        One that was fitted, or another.
    effects : sequence of str
        As on the command line.
    cutoff : float, optional
        Of the common filter [Hz]; default chosen from the data.
    window : slice, optional
        Rows of `test` that are judged; default all that count.

    Returns
    -------
    tuple of float, length n_motors
        Norm of the error over the norm of the torque, per motor.
    """
    result = identify(model, train, holdout=[test], effects=effects, cutoff=cutoff)
    time, measured, predicted = series(result, test)
    if window is not None:
        ends = test.time[window][[0, -1]]
        judged = (time >= ends[0]) & (time <= ends[1])
        measured, predicted = measured[judged], predicted[judged]
    return tuple(np.linalg.norm(measured - predicted, axis=0) / np.linalg.norm(measured, axis=0))


def series(result: Identification, recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Give time (n,), measured and predicted motor torques (n, n_motors) of a hold-out, through the common filter."""
    assert result.holdout is not None
    plan = replace(result.plan, accelerations=result.holdout.visits[0].accelerations)
    observation = observe(plan, recording)
    steps = np.concatenate([np.arange(start, stop) for start, stop in observation.segments])
    found = [(y, X @ result.prediction) for _, X, y in rows(plan, observation, resting=True)]
    measured, predicted = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return observation.signals.time[steps * observation.band.step], measured, predicted


def halves(recording: Recording, share: float) -> tuple[Recording, Recording]:
    """Cut a recording in two."""
    cut = int(share * recording.n_samples)
    parts = []
    for part in (slice(0, cut), slice(cut, None)):
        channels = {name: x[part] for name, x in recording.channels.items()}
        parts.append(replace(recording, time=recording.time[part], channels=channels))
    return parts[0], parts[1]
