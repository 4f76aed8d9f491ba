"""The masses that a fit makes likely, or that its effects reveal, and the search about the model that has them."""

from __future__ import annotations

import numpy as np

from .base import massive_columns, updated_model
from .fit import Fit, least_squares
from .geometry import Vector
from .model import CableModel
from .search import Search

UNSURE_MASS = 0.2
"""Share of themselves by which masses, first moments and inertias of the file may be wrong."""
MOST_TIMES = 20
"""How often what the file's parameters may be wrong by is doubled."""


def about(search: Search, fit: Fit) -> Search:
    """Give the same search about a fit: its inertial parameters, and the torques that its effects bring."""
    effects = list(zip(fit.effects, fit.beta, strict=True))
    change = fit.base[: len(search.base.columns)]
    return search.at(change, effects, revealed(search, fit), likely_masses(search, fit))


def likely_masses(search: Search, fit: Fit) -> CableModel:
    """Give the model with the masses that a fit makes likely, for what no torque of a motor tells of them.

    Each standard parameter may be wrong by about all of itself, or by as many times that as the change is beyond
    it: what the data do not tell stays as the file has it.
    """
    file, p = search.problem.sensors.model, len(search.base.columns)
    heavy = massive_columns(file)
    known = search.base.values(search.problem.model.standard_parameters) - search.base.values(file.standard_parameters)
    own = search.base.matrix[:, heavy] * _sizes(file)[heavy]
    before, errors = own @ own.T, fit.covariance[:p, :p]
    size = np.sqrt(np.diag(before) + np.diag(errors))
    if not before.any() or not size.all():
        return file
    change = (known + fit.base[:p]) / size
    before, errors = before / size / size[:, None], errors / size / size[:, None]
    for _ in range(MOST_TIMES):
        told = np.linalg.lstsq(before + errors, change, rcond=1e-12)[0]
        if change @ told <= p:
            break
        before = 4.0 * before
    return updated_model(file, search.base, size * (before @ told), _sizes(file))


def revealed(search: Search, fit: Fit) -> CableModel | None:
    """Give the model as a fit's effects reveal it, also in what hides without them; None where none does.

    Its parameters are as near the file's as the data let them be, in units of how far those may be wrong. Without
    masses in the file nothing is known of that.
    """
    model, file = search.problem.model, search.problem.sensors.model.standard_parameters
    if not file.any() or not search.problem.torque or all(c.effect.reveals is None for c in fit.effects):
        return None
    before, _, A, Q = hidden(search, fit)
    change = (model.standard_parameters - file) / np.where(before > 0, before, np.inf)
    y = fit.body.data - Q @ (Q.T @ fit.body.data) + A.T @ change
    return model.with_standard_parameters(file + before * np.linalg.solve(A @ A.T + np.eye(len(A)), A @ y))


def hidden(search: Search, fit: Fit) -> tuple[Vector, Vector, Vector, Vector]:
    """Give how far each standard parameter may be from the file's, and what torque that brings, whitened.

    Masses may be wrong by a share of themselves, first moments and inertias along any axis by that share of their
    norm.

    Returns
    -------
    before : ndarray, shape (10 n_joints,)
    beside : ndarray, shape (10 n_joints, n_rows)
        Torque that it brings beside the effects of the fit only.
    A : ndarray, shape (10 n_joints, n_rows)
        All of its torque, as far as the other columns leave it.
    Q : ndarray, shape (n_rows, rank)
        Orthonormal basis of the other columns.
    """
    values, p = search.problem.sensors.model.standard_parameters.reshape(-1, 10), len(search.base.columns)
    parts = [np.linalg.norm(values[:, a:b], axis=1) for a, b in ((0, 1), (1, 4), (4, 10))]
    before = UNSURE_MASS * np.repeat(np.stack(parts, axis=1), (1, 3, 6), axis=1).ravel()
    banks = [np.zeros((len(before), *rigid.shape[1:])) for rigid in search.rigid]
    for candidate, beta in zip(fit.effects, fit.beta, strict=True):
        if candidate.effect.reveals is not None:
            columns = search.in_band(lambda motion, c=candidate, b=beta: c.revealed(motion, np.diag(before), b))
            banks = [bank + x for bank, x in zip(banks, columns, strict=True)]
    beside, W = search.white(fit.whitener, banks), search.white(fit.whitener, search.rigid)
    others = np.concatenate([W[p:], *[search.white(fit.whitener, search.columns(c)) for c in fit.effects]])
    Q = least_squares(others, fit.body.data)[1]
    A = beside + before[:, None] * (search.base.matrix.T @ W[:p])
    return before, beside, A - (A @ Q) @ Q.T, Q


def _sizes(model: CableModel) -> Vector:
    """Give each standard parameter's size: a link's mass, times its radius about its joint once or twice."""
    links = model.standard_parameters.reshape(-1, 10)
    mass = np.maximum(np.abs(links[:, 0]), 1e-9)
    spread = 0.5 * np.abs(links[:, [4, 6, 9]].sum(axis=1)) / mass
    radius = np.sqrt(np.maximum(spread, 1e-4 * spread.max(initial=0.0)))
    if not radius.any():
        radius[:] = 1.0
    return (mass[:, None] * np.column_stack([np.ones_like(radius), *[radius] * 3, *[radius**2] * 6])).ravel()
