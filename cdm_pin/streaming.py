"""Identification from samples in memory or from any stream of them: no filter, no file, constant memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from .base import BaseParameters, base_parameters, present_columns
from .estimators import Fit, Moments, weighted
from .geometry import Vector
from .model import CableModel
from .regressor import BLOCK, blocks, motor_regressor

Samples = tuple[Vector, Vector, Vector, Vector]


def identify_samples(
    model: CableModel,
    parts: Iterable[Samples],
    base: BaseParameters | None = None,
    estimator: Callable[[Moments], Fit] = weighted,
) -> tuple[BaseParameters, Fit]:
    """Fit base parameters to samples.

    Parameters
    ----------
    model : CableModel
    parts : iterable of (q, v, a, tau_m)
        Joint positions, velocities, accelerations (n, n_joints) and motor torques (n, n_motors), in parts of any size;
        none of them is kept.
    base : BaseParameters, optional
        Default: all that the robot's torques can tell.
    estimator : callable
        Of `cdm_pin.estimators`: `weighted` with the noise covariance over motors, or `ordinary`.

    Returns
    -------
    base : BaseParameters
    fit : Fit
        Its covariance holds for noise that is white in time.

    Raises
    ------
    ShapeError
        If a part does not fit the model.
    """
    base = base or base_parameters(model)
    moments = Moments.empty(base.names, present_columns(model, base))
    motor, parameter = np.nonzero(moments.present)
    picked = motor * base.matrix.shape[1] + base.columns[parameter]
    triangle = moments.triangle
    for q, v, a, tau_m in parts:
        for part in blocks(len(q), BLOCK):
            Y = motor_regressor(model, q[part], v[part], a[part])
            triangle = triangle.add(np.hstack([Y.reshape(len(Y), -1)[:, picked], tau_m[part]]))
    return base, estimator(replace(moments, triangle=triangle))
