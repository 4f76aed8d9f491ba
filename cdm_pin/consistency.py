r"""Inertial parameters that a body of positive mass density can have.

A link's ten parameters are physical exactly if its pseudo-inertia matrix

.. math:: J = \begin{bmatrix} \tfrac12 \mathrm{tr}(I)\,1 - I & h \\ h^T & m \end{bmatrix} \succ 0, \quad h = m c,

is positive definite (Wensing, Kim, Slotine, IEEE RA-L 3(1), 2018). With :math:`J_0 = L L^T` of the manipulator file,
:math:`X = L^{-1} J L^{-T}` is the identity at the file's values, and :math:`\|X - 1\|` measures the distance from them
free of units and frames (Lee, Wensing, Park, IEEE T-RO 36(1), 2020). The programs below are posed in X.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import clarabel
import numpy as np
from scipy import sparse

from .errors import CdmError, ShapeError
from .geometry import Link, Vector, frozen_array

_UPPER = [(i, j) for j in range(4) for i in range(j + 1)]  # the solver's order of a symmetric 4 x 4 matrix
_ROOT2 = np.sqrt(2.0)


class SolverError(CdmError):
    """A convex program that the solver gave up on."""


@dataclass(frozen=True)
class Standard:
    """Physically valid standard parameters.

    Attributes
    ----------
    parameters : ndarray, shape (10 n_links,)
        Pinocchio's order per link.
    free : ndarray, shape (k,)
        The other parameters of the fit (effects).
    exact : bool
        Whether the wanted base parameters are reproduced; otherwise these are the nearest consistent ones.
    distance : float
        From the prior, ||X - 1|| over all links: 1 is a change of a link's inertia by its own size.
    """

    parameters: Vector
    free: Vector
    exact: bool
    distance: float


def pseudo_inertia(pi: Vector) -> Vector:
    """Build the pseudo-inertia matrix of one link, shape (4, 4), from its ten parameters."""
    m, hx, hy, hz, xx, xy, yy, xz, yz, zz = pi
    trace = 0.5 * (xx + yy + zz)
    return np.array(
        [
            [trace - xx, -xy, -xz, hx],
            [-xy, trace - yy, -yz, hy],
            [-xz, -yz, trace - zz, hz],
            [hx, hy, hz, m],
        ]
    )


def link_parameters(J: Vector) -> Vector:
    """Give the ten parameters of a pseudo-inertia matrix, the inverse of `pseudo_inertia`."""
    xx, yy, zz = J[1, 1] + J[2, 2], J[0, 0] + J[2, 2], J[0, 0] + J[1, 1]
    return np.array([J[3, 3], J[0, 3], J[1, 3], J[2, 3], xx, -J[0, 1], yy, -J[0, 2], -J[1, 2], zz])


def links_from_parameters(links: Sequence[Link], pi_std: Vector) -> tuple[Link, ...]:
    """Give links with other standard parameters, shape (10 n_links,)."""
    out = []
    for link, pi in zip(links, np.reshape(pi_std, (-1, 10)), strict=True):
        mass, center, inertia = about_center(pi)
        out.append(replace(link, mass=mass, center_of_mass=frozen_array(center), inertia=frozen_array(inertia)))
    return tuple(out)


def about_center(pi: Vector) -> tuple[float, Vector, Vector]:
    """Give mass, centre of mass and the inertia about it of standard parameters, shape (10,)."""
    m, hx, hy, hz, xx, xy, yy, xz, yz, zz = pi
    center = np.array([hx, hy, hz]) / m
    shift = m * (center @ center * np.eye(3) - np.outer(center, center))
    return float(m), center, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - shift


def consistency_margin(pi_std: Vector) -> Vector:
    """Smallest eigenvalue of each link's pseudo-inertia over its largest, shape (n_links,); positive if physical."""
    values = [np.linalg.eigvalsh(pseudo_inertia(pi)) for pi in np.reshape(pi_std, (-1, 10))]
    return np.array([float(v[0]) / max(abs(float(v[-1])), np.finfo(float).tiny) for v in values])


def nearest_standard(matrix: Vector, pi_base: Vector, prior: Vector, *, margin: float = 1e-4) -> Standard | None:
    r"""Find the physical parameters nearest to the prior that reproduce base parameters exactly.

    :math:`\min \|X - 1\|^2` subject to :math:`G\,\pi_{std} = \pi_{base}` and :math:`X \succeq \delta`.

    Parameters
    ----------
    matrix : ndarray, shape (p, 10 n_links)
        G.
    pi_base : ndarray, shape (p,)
    prior : ndarray, shape (10 n_links,)
        Of the manipulator file.
    margin : float
        delta, relative to the prior.

    Returns
    -------
    Standard or None
        None if no body has these base parameters.
    """
    chart = _Chart(prior)
    A, center = matrix @ chart.matrix, chart.center
    scale = np.linalg.norm(A, axis=1)
    A, b = A / scale[:, None], pi_base / scale
    solution = _solve(np.eye(chart.size), -center, chart, margin, equality=(A, b))
    if solution is None:
        return None
    x = solution + np.linalg.pinv(A) @ (b - A @ solution)
    if chart.smallest(x) < 0.1 * margin:
        return None
    return Standard(frozen_array(chart.matrix @ x), frozen_array([]), True, float(np.linalg.norm(x - center)))


def consistent_standard(
    matrix: Vector,
    values: Vector,
    information: Vector,
    prior: Vector,
    *,
    nonnegative: np.ndarray | None = None,
    prior_weight: float = 1.0,
    margin: float = 1e-4,
) -> Standard:
    r"""Fit physical parameters and effects to a linear fit, drawn to the prior where data say little.

    :math:`\min (\theta - \hat\theta)^T H (\theta - \hat\theta) + w \|X - 1\|^2`, where
    :math:`\theta = [G\,\pi_{std}; f]`, :math:`X \succeq \delta`, and :math:`f_k \ge 0` if stated.

    Parameters
    ----------
    matrix : ndarray, shape (p, 10 n_links)
        G.
    values : ndarray, shape (p + k,)
        Fitted base parameters, then the coefficients f of effects.
    information : ndarray, shape (p + k, p + k)
        H, the inverse covariance of `values`.
    prior : ndarray, shape (10 n_links,)
    nonnegative : ndarray of bool, shape (k,), optional
        Which coefficients cannot be negative (friction).
    prior_weight : float
        w; 1 says that the file's values are good to their own size.
    margin : float
        delta, relative to the prior.

    Raises
    ------
    ShapeError
        If the shapes do not fit.
    SolverError
        If the solver finds no solution.
    """
    chart = _Chart(prior)
    p, k = len(matrix), len(values) - len(matrix)
    if information.shape != (p + k, p + k):
        raise ShapeError(f"information has shape {information.shape}, ({p + k}, {p + k}) was expected")
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information)[p:], np.finfo(float).tiny))
    T = np.zeros((p + k, chart.size + k))
    T[:p, : chart.size] = matrix @ chart.matrix
    T[p:, chart.size :] = np.diag(scale)
    P = T.T @ information @ T
    q = -T.T @ (information @ values)
    P[: chart.size, : chart.size] += prior_weight * np.eye(chart.size)
    q[: chart.size] -= prior_weight * chart.center
    x = _solve(P, q, chart, margin, nonnegative=nonnegative)
    if x is None:
        raise SolverError("no physically consistent parameters were found: the solver did not converge")
    return Standard(
        frozen_array(chart.matrix @ x[: chart.size]),
        frozen_array(scale * x[chart.size :]),
        False,
        float(np.linalg.norm(x[: chart.size] - chart.center)),
    )


class _Chart:
    """Coordinates x of all links: X_i column by column, upper part, off-diagonals times sqrt(2)."""

    def __init__(self, prior: Vector):
        links = np.reshape(prior, (-1, 10))
        self.size = 10 * len(links)
        self.matrix = np.zeros((self.size, self.size))
        one = np.array([1.0 if i == j else 0.0 for i, j in _UPPER])
        self.center = np.tile(one, len(links))
        for i, pi in enumerate(links):
            part = slice(10 * i, 10 * i + 10)
            self.matrix[part, part] = _link_chart(_prior_root(pi, links))

    def smallest(self, x: Vector) -> float:
        """Smallest eigenvalue of any X."""
        return min(float(np.linalg.eigvalsh(_symmetric(part))[0]) for part in np.reshape(x, (-1, 10)))


def _symmetric(x: Vector) -> Vector:
    X = np.zeros((4, 4))
    for value, (i, j) in zip(x, _UPPER, strict=True):
        X[i, j] = X[j, i] = value if i == j else value / _ROOT2
    return X


def _link_chart(L: Vector) -> Vector:
    """Matrix of ten columns: the parameters of L X L' per coordinate of X."""
    columns = [link_parameters(L @ _symmetric(unit) @ L.T) for unit in np.eye(10)]
    return np.array(columns).T


def _prior_root(pi: Vector, links: Vector) -> Vector:
    """Cholesky factor of a link's pseudo-inertia; a massless or unphysical one is given a small body of its own."""
    J = pseudo_inertia(pi)
    values = np.linalg.eigvalsh(J)
    if values[0] > 1e-9 * values[-1] > 0:
        return np.asarray(np.linalg.cholesky(J), dtype=float)
    mass = max(pi[0], 1e-2 * float(np.mean(links[:, 0])), 1e-3)
    size = max(0.05**2 * mass, 1e-3 * float(np.trace(J[:3, :3])))
    h = J[:3, 3] if pi[0] > 0 else np.zeros(3)
    J = np.block([[np.outer(h, h) / mass + size * np.eye(3), h[:, None]], [h[None], np.array([[mass]])]])
    return np.asarray(np.linalg.cholesky(J), dtype=float)


def _solve(
    P: Vector,
    q: Vector,
    chart: _Chart,
    margin: float,
    *,
    equality: tuple[Vector, Vector] | None = None,
    nonnegative: np.ndarray | None = None,
) -> Vector | None:
    n, links = len(q), chart.size // 10
    rows, rhs, cones = [], [], []
    if equality is not None:
        rows.append(np.hstack([equality[0], np.zeros((len(equality[1]), n - chart.size))]))
        rhs.append(equality[1])
        cones.append(clarabel.ZeroConeT(len(equality[1])))
    signed = np.flatnonzero(nonnegative) if nonnegative is not None else np.array([], dtype=int)
    if len(signed):
        rows.append(-np.eye(n)[chart.size + signed])
        rhs.append(np.zeros(len(signed)))
        cones.append(clarabel.NonnegativeConeT(len(signed)))
    rows.append(-np.eye(chart.size, n))
    rhs.append(-margin * chart.center)
    cones += [clarabel.PSDTriangleConeT(4)] * links
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    weight = max(float(np.abs(P).max()), 1e-300)
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(P / weight)),
        q / weight,
        sparse.csc_matrix(np.vstack(rows)),
        np.concatenate(rhs),
        cones,
        settings,
    )
    solution = solver.solve()
    if solution.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        return None
    return np.array(solution.x)
