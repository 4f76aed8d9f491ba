"""How informative a motion is: condition numbers, D-optimality, predicted standard errors; lower is better.

An objective takes m candidate motions at once, ``q, v, a`` of shape (m, n_samples, n_joints), and gives m numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from .base import BaseParameters, base_parameters, group, random_states
from .errors import InputError, nearest
from .geometry import Vector
from .model import CableModel
from .regressor import Triangle, motor_regressor

Objective = Callable[[Vector, Vector, Vector], Vector]
ObjectiveName = Literal["condition", "scaled_condition", "d_optimal", "relative_error"]

FLOOR = 0.1
"""A parameter below this share of its natural magnitude is judged against that share: zero has no relative error."""


def each(score: Callable[[Vector, Vector, Vector], float]) -> Objective:
    """Make an objective of a function of one motion, ``q, v, a`` of shape (n_samples, n_joints)."""
    return lambda q, v, a: np.array([float(score(*one)) for one in zip(q, v, a, strict=True)])


def make_objective(
    name: str,
    model: CableModel,
    *,
    base: BaseParameters | None = None,
    noise: Sequence[float] | Vector | float = 1.0,
) -> Objective:
    """Build one of the objectives for a robot.

    ``condition``: largest condition number among the motors' own coefficient matrices of eq. (43), as in the paper.
    ``scaled_condition``: condition number of all rows together, columns scaled to norm 1.
    ``d_optimal``: geometric mean of the relative standard errors, det(covariance)^(1/2p).
    ``relative_error``: the largest relative standard error. Both for one sample with the stated torque noise.

    Parameters
    ----------
    name : str
    model : CableModel
        Its inertial parameters are what relative errors refer to.
    base : BaseParameters, optional
    noise : float or sequence of length n_motors
        Standard deviation of the torque noise [N m].

    Raises
    ------
    InputError
        If there is no objective of that name.
    """
    if name not in get_args(ObjectiveName):
        known = get_args(ObjectiveName)
        hint = nearest(str(name), known) or f"; known: {', '.join(known)}"
        raise InputError(f"unknown objective {name!r}{hint}")
    base = base or base_parameters(model)
    if name == "condition":
        return Largest(_ConditionParts(model, _own_columns(model, base)))
    information = Information(model, base, noise)
    if name == "scaled_condition":
        return lambda q, v, a: condition_number(information(q, v, a), scaled=True)
    if name == "d_optimal":
        return lambda q, v, a: _geometric_mean(information(q, v, a))
    return Largest(lambda q, v, a: _relative(information(q, v, a)))


@dataclass(frozen=True)
class Largest:
    """An objective that is the largest of several smooth numbers; optimisers use its parts.

    Attributes
    ----------
    parts : callable
        From m motions to (m, r) numbers.
    """

    parts: Objective

    def __call__(self, q: Vector, v: Vector, a: Vector) -> Vector:
        """Judge m motions, each array of shape (m, n_samples, n_joints)."""
        return self.parts(q, v, a).max(axis=1)


def parts_of(objective: Objective) -> Objective:
    """Give the numbers, shape (m, r), whose largest is the objective; just itself if it does not say."""
    return getattr(objective, "parts", None) or (lambda q, v, a: np.asarray(objective(q, v, a))[:, None])


@dataclass(frozen=True)
class Information:
    """Fisher information about relative base parameters, per sample.

    Attributes
    ----------
    model : CableModel
    base : BaseParameters
    noise : float or sequence of length n_motors
        Standard deviation of the torque noise [N m].
    """

    model: CableModel
    base: BaseParameters
    noise: Sequence[float] | Vector | float = 1.0

    def __call__(self, q: Vector, v: Vector, a: Vector) -> Vector:
        """Compute it for m motions of shape (m, n_samples, n_joints): (m, p, p)."""
        m, n_samples, n = q.shape
        weight = 1.0 / np.broadcast_to(np.asarray(self.noise, float), (self.model.n_motors,))
        scale = reference_magnitudes(self.model, self.base)
        Y = motor_regressor(self.model, *(x.reshape(-1, n) for x in (q, v, a)))[..., self.base.columns]
        if (weight != 1.0).any():
            Y *= weight[:, None]
        rows = Y.reshape(m, n_samples * self.model.n_motors, -1)
        return (np.swapaxes(rows, 1, 2) @ rows) * (scale[:, None] * scale / n_samples)


def motor_rows(model: CableModel, columns: np.ndarray, q: Vector, v: Vector, a: Vector) -> Vector:
    """Compute regressors of m motions, motor by motor, shape (m, n_motors, n_samples, n_columns)."""
    m, n_samples, n = q.shape
    Y = motor_regressor(model, *(x.reshape(-1, n) for x in (q, v, a)))[..., columns]
    return np.swapaxes(Y.reshape(m, n_samples, model.n_motors, -1), 1, 2)


def reference_magnitudes(model: CableModel, base: BaseParameters) -> Vector:
    """Give what a relative error of each base parameter refers to, shape (p,).

    Its nominal value, or `FLOOR` times what a body of that mass and size would contribute, whichever is more; of bodies
    without mass the largest that the robot has.
    """
    pi = model.standard_parameters.reshape(-1, 10)
    mass = pi[:, :1]
    radius = np.sqrt((pi[:, [4, 6, 9]].sum(axis=1, keepdims=True)) / (2 * np.maximum(mass, 1e-12)))
    natural = mass * np.hstack([radius**0, *[radius] * 3, *[radius**2] * 6])
    values = np.abs(base.values(model.standard_parameters))
    reference = np.maximum(values, FLOOR * np.abs(base.matrix) @ natural.ravel())
    return np.where(reference > 0, reference, reference.max(initial=0.0) or 1.0)


def condition_number(gram: Vector, *, scaled: bool = False) -> Vector:
    """Compute condition numbers of matrices W from W'W, shape (..., p, p); infinite where a column is dependent."""
    if scaled:
        norm = np.sqrt(np.maximum(np.einsum("...ii->...i", gram), 1e-300))
        gram = gram / norm[..., None] / norm[..., None, :]
    values = np.linalg.eigvalsh(gram)
    with np.errstate(divide="ignore"):
        return np.sqrt(values[..., -1] / np.maximum(values[..., 0], 0.0))


@dataclass(frozen=True)
class _ConditionParts:
    """Condition number of each motor's own matrix."""

    model: CableModel
    columns: tuple[np.ndarray, ...]

    def __call__(self, q: Vector, v: Vector, a: Vector) -> Vector:
        every = np.unique(np.concatenate(self.columns))
        Y = motor_rows(self.model, every, q, v, a)
        numbers = []
        for motor, columns in enumerate(self.columns):
            W = Y[:, motor][..., np.searchsorted(every, columns)]
            numbers.append(condition_number(np.swapaxes(W, 1, 2) @ W))
        return np.stack(numbers, axis=1)


def _own_columns(model: CableModel, base: BaseParameters) -> tuple[np.ndarray, ...]:
    """Pick for each motor alone the columns that are independent, the set of eq. (43)."""
    Y = motor_regressor(model, *random_states(model, 60 + 40 * model.n_joints))
    triangles = [Triangle.empty(Y.shape[-1]).add(np.ascontiguousarray(Y[:, j])) for j in range(model.n_motors)]
    return tuple(group(model, triangle, columns=sorted(base.columns)).columns for triangle in triangles)


def _relative(information: Vector) -> Vector:
    return np.sqrt(np.einsum("mii->mi", _inverse(information)))


def _geometric_mean(information: Vector) -> Vector:
    sign, logdet = np.linalg.slogdet(information)
    value = np.exp(-0.5 * logdet / information.shape[-1])
    return np.where(sign > 0, value, np.inf)


def _inverse(information: Vector) -> Vector:
    """Invert; where that fails the diagonal is infinite."""
    norm = np.sqrt(np.maximum(np.einsum("mii->mi", information), 1e-300))
    values, vectors = np.linalg.eigh(information / norm[:, :, None] / norm[:, None])
    sound = values[:, 0] > 1e-14 * values[:, -1]
    safe = np.where(sound[:, None], values, 1.0)
    vectors = vectors / norm[:, :, None]
    inverse = (vectors / safe[:, None]) @ np.swapaxes(vectors, 1, 2)
    return np.where(sound[:, None, None], inverse, np.inf)


@dataclass(frozen=True)
class PredictedError:
    """What an experiment will leave unknown of one base parameter.

    Attributes
    ----------
    name : str
    value : float
        Nominal, in SI units.
    std : float
        Predicted standard error, in the same unit; infinite if the motion does not show it.
    relative : float
        `std` over the reference magnitude (see `reference_magnitudes`).
    """

    name: str
    value: float
    std: float
    relative: float


def predicted_errors(
    model: CableModel,
    q: Vector,
    v: Vector,
    a: Vector,
    *,
    noise: Sequence[float] | Vector | float,
    base: BaseParameters | None = None,
) -> tuple[PredictedError, ...]:
    """Predict the standard error of every base parameter from the samples of an experiment.

    Parameters
    ----------
    model : CableModel
    q, v, a : ndarray, shape (n_samples, n_joints)
        All samples that will be used.
    noise : float or sequence of length n_motors
        Standard deviation of the torque noise, independent from sample to sample [N m].
    base : BaseParameters, optional
        Default those of the robot, whatever the motion shows.
    """
    base = base or base_parameters(model)
    information = Information(model, base, noise)(*(np.asarray(x)[None] for x in (q, v, a))) * len(q)
    relative = _relative(information)[0]
    values, scale = base.values(model.standard_parameters), reference_magnitudes(model, base)
    return tuple(
        PredictedError(name, float(value), float(r * s), float(r))
        for name, value, r, s in zip(base.names, values, relative, scale, strict=True)
    )
