r"""Base parameters: the combinations of inertial parameters that motor torques can tell, their names, and the rest.

The columns of :math:`E^T Y` are taken from the base outwards. A column that depends on those taken is grouped into
them: :math:`\pi_{base} = G\,\pi_{std}` with :math:`Y_m = Y_m[:, \mathrm{columns}]\,G`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .errors import ShapeError
from .geometry import Vector, frozen_array
from .model import CableModel
from .regressor import Triangle, blocks, motor_regressor


@dataclass(frozen=True)
class BaseParameters:
    r"""A basis of what the torques of a robot depend on.

    Attributes
    ----------
    names : tuple of str, length p
        Readable combinations such as ``"Izz_1 + m_2*l_1^2"`` or ``"Izz_1 + 0.36*m_2"``.
    matrix : ndarray, shape (p, 10 n_joints)
        G of :math:`\pi_{base} = G\,\pi_{std}`.
    columns : ndarray of int, shape (p,)
        Standard columns that stand for them: :math:`Y_{base} = Y[\ldots, \mathrm{columns}]`.
    links : tuple of tuple of int
        Per base parameter the links it is made of, counted from 1 (rows of E).
    unidentifiable : tuple of str
        Standard parameters that no motor torque depends on.
    absorbed : tuple of str
        Standard parameters that are seen only within a combination led by another.
    standard_names : tuple of str
        Names of the columns of `matrix`.
    smallest_kept, largest_dropped : float
        Independent share of the weakest base column, and of the strongest grouped one, in a column of norm 1: the gap
        between them is how clear the rank is.
    """

    names: tuple[str, ...]
    matrix: Vector
    columns: np.ndarray
    links: tuple[tuple[int, ...], ...]
    unidentifiable: tuple[str, ...]
    absorbed: tuple[str, ...]
    standard_names: tuple[str, ...]
    smallest_kept: float
    largest_dropped: float

    @property
    def rank(self) -> int:
        """Number of base parameters."""
        return len(self.names)

    @property
    def empty(self) -> BaseParameters:
        """The same of a robot of which nothing is asked."""
        none = np.zeros(0, dtype=int)
        return replace(self, names=(), matrix=self.matrix[none], columns=none, links=())

    def values(self, pi_std: Vector) -> Vector:
        """Give the base parameters of standard parameters, shape (..., 10 n_joints)."""
        return np.asarray(pi_std) @ self.matrix.T

    def regressor(self, model: CableModel, q: Vector, v: Vector, a: Vector) -> Vector:
        """Compute the motor regressor of the base parameters, shape (n_samples, n_motors, p)."""
        return motor_regressor(model, q, v, a)[..., self.columns]


def massive_columns(model: CableModel, share: float = 1e-6) -> np.ndarray:
    """Give the standard parameters of links that have a mass; links without are frames, and stay so.

    Parameters
    ----------
    model : CableModel
    share : float
        Of the robot's mass, below which a link is a frame.

    Returns
    -------
    ndarray of int
        All columns if no link has a mass.
    """
    mass = model.standard_parameters[0::10]
    heavy = np.flatnonzero(mass > share * mass.sum()) if mass.sum() > 0 else np.arange(model.n_joints)
    return (10 * heavy[:, None] + np.arange(10)).ravel()


def present_columns(model: CableModel, base: BaseParameters) -> np.ndarray:
    """Tell which base parameter can reach which motor, shape (n_motors, p) of bool."""
    Y = np.abs(base.regressor(model, *random_states(model, 20))).max(axis=0)
    return Y > 1e-12 * Y.max(initial=1e-300)


def base_parameters(
    model: CableModel,
    *,
    columns: Sequence[int] | np.ndarray | None = None,
    trajectory: tuple[Vector, Vector, Vector] | None = None,
    samples: int | None = None,
    tolerance: float = 1e-8,
    seed: int = 0,
) -> BaseParameters:
    """Find the base parameters of a robot from its motor-side regressor, numerically.

    Parameters
    ----------
    model : CableModel
    columns : sequence of int, optional
        Standard parameters to consider, default all; the others are taken as known. Leaving out every ``my_i`` imposes
        centres of mass on the links' x axes.
    trajectory : (q, v, a), each of shape (n_samples, n_joints), optional
        Decide on this motion, so that what it does not excite (a locked joint) is grouped or named as unidentifiable;
        default random states of the motors.
    samples : int, optional
        Number of random states; default 60 and 40 for each joint.
    tolerance : float
        Share of a column, scaled to norm 1, that must be independent of the columns taken before it.
    seed : int
        Of the random states.

    Returns
    -------
    BaseParameters

    Raises
    ------
    ShapeError
        If `columns` or `trajectory` do not fit the model.
    """
    q, v, a = trajectory or random_states(model, samples or 60 + 40 * model.n_joints, seed)
    triangle = Triangle.empty(10 * model.n_joints)
    for part in blocks(len(q), 1024):
        Y = motor_regressor(model, q[part], v[part], a[part])
        triangle = triangle.add(Y.reshape(-1, Y.shape[-1]))
    return group(model, triangle, columns=columns, tolerance=tolerance)


def updated_model(model: CableModel, base: BaseParameters, change: Vector, sizes: Vector | None = None) -> CableModel:
    """Give the model whose base parameters differ by `change` from those of `model`, the rest as near as can be.

    Near in units of the standard parameters, or of `sizes` if given. What stands behind the base parameters in a fit, a
    payload's, is left out. A link's mass alone, of which no torque tells, may become negative.
    """
    size = np.ones(base.matrix.shape[1]) if sizes is None else sizes
    step = size * (np.linalg.pinv(base.matrix * size) @ change[: len(base.columns)])
    return model.with_standard_parameters(model.standard_parameters + step)


def random_states(model: CableModel, samples: int, seed: int = 0) -> tuple[Vector, Vector, Vector]:
    """Draw joint positions, velocities and accelerations that the motors can reach, each (samples, n_joints)."""
    rng = np.random.default_rng(seed)
    E = model.joint_from_motor
    scale = 1.0 / np.abs(E).max(axis=0)
    q_m, v_m, a_m = scale * rng.uniform(-np.pi, np.pi, (3, samples, model.n_motors))
    return q_m @ E.T + model.offset, v_m @ E.T, a_m @ E.T


def group(
    model: CableModel,
    triangle: Triangle,
    *,
    columns: Sequence[int] | np.ndarray | None = None,
    tolerance: float = 1e-8,
) -> BaseParameters:
    """Find base parameters from the triangle of a regressor's rows (see `base_parameters`).

    Parameters
    ----------
    model : CableModel
    triangle : Triangle
        Of rows of the motor regressor, width 10 n_joints.
    columns, tolerance
        As for `base_parameters`.
    """
    width = 10 * model.n_joints
    allowed = np.arange(width) if columns is None else np.asarray(columns, dtype=int)
    if triangle.width != width or (len(allowed) and (allowed.min() < 0 or allowed.max() >= width)):
        raise ShapeError(f"columns 0 to {width - 1} of a triangle of width {width} were expected")
    norms = np.linalg.norm(triangle.R, axis=0)
    seen = [int(k) for k in allowed if norms[k] > tolerance * 1e-4 * norms.max(initial=0.0)]
    kept, shares = _independent(triangle.R / np.where(norms > 0, norms, 1.0), seen, tolerance)
    dropped = [k for k in seen if k not in kept]
    matrix = np.zeros((len(kept), width))
    if kept:
        R = triangle.R
        grouped = np.linalg.lstsq(R[:, kept] / norms[kept], R[:, seen] / norms[seen], rcond=None)[0]
        matrix[:, seen] = grouped / norms[kept][:, None] * norms[seen]
        matrix[:, kept] = np.eye(len(kept))
        for k in dropped:
            matrix[:, k] = _round(matrix[:, k], norms[kept] / norms[k])
    names = model.parameter_names
    return BaseParameters(
        names=tuple(_combination(model, row, k) for row, k in zip(matrix, kept, strict=True)),
        matrix=frozen_array(matrix),
        columns=np.array(kept, dtype=int),
        links=tuple(tuple(sorted({int(k) // 10 + 1 for k in np.flatnonzero(row)})) for row in matrix),
        unidentifiable=tuple(names[k] for k in allowed if k not in seen),
        absorbed=tuple(names[k] for k in dropped),
        standard_names=names,
        smallest_kept=min((shares[k] for k in kept), default=1.0),
        largest_dropped=max((shares[k] for k in dropped), default=0.0),
    )


def _independent(unit: Vector, seen: Sequence[int], tolerance: float) -> tuple[list[int], dict[int, float]]:
    """Keep columns that are no combination of those kept, link by link from the base outwards.

    Within a link the first column that is nearly as independent as any other is taken, which keeps names in their usual
    order and the factors of combinations small.
    """
    rest, kept, shares = unit.copy(), [], {}
    for link in sorted({k // 10 for k in seen}):
        left = [k for k in seen if k // 10 == link]
        while left:
            norms = np.linalg.norm(rest[:, left], axis=0)
            if norms.max() <= tolerance:
                shares |= dict(zip(left, map(float, norms), strict=True))
                break
            place = int(np.argmax(norms > 0.1 * norms.max()))
            k = left.pop(place)
            kept.append(k)
            shares[k] = float(norms[place])
            direction = rest[:, k] / norms[place]
            for _ in range(2):
                rest -= np.outer(direction, direction @ rest)
    return sorted(kept), shares


def _round(coefficients: Vector, scale: Vector) -> Vector:
    """Clear the rounding error of coefficients: zeros are zero, and twelve digits are kept."""
    rounded = np.where(np.abs(coefficients * scale) < 1e-9, 0.0, coefficients)
    return np.array([float(f"{value:.12g}") for value in rounded])


def _combination(model: CableModel, row: Vector, lead: int) -> str:
    """Name a base parameter, the leading standard parameter first."""
    text = model.parameter_names[lead]
    for k in np.flatnonzero(row):
        if k != lead:
            sign, factor = ("-", -row[k]) if row[k] < 0 else ("+", row[k])
            text += f" {sign} {_term(model, factor, model.parameter_names[k], lead // 10)}"
    return text


def _term(model: CableModel, factor: float, name: str, link: int) -> str:
    """Write factor*name, the factor as a power of the link's length where it is one."""
    if abs(factor - 1) < 1e-9:
        return name
    links = model.manipulator.links
    length = links[link].length if links else 0.0
    if length:
        for symbol, value in ((f"l_{link + 1}", length), (f"l_{link + 1}^2", length**2)):
            for times in (1, 2):
                if abs(factor - times * value) < 1e-9 * value:
                    return f"{'2*' if times == 2 else ''}{name}*{symbol}"
    return f"{factor:.4g}*{name}"


def paper_parameters(model: CableModel) -> tuple[BaseParameters, Vector]:
    r"""Give the paper's parameters of a planar two-link arm as functions of its base parameters, eqs (57), (58).

    The paper sets :math:`c_y = 0`, which leaves rank 4 of 6; its six numbers repeat :math:`l_1 l_2 m_2`
    (:math:`P_{2,1} = P_{2,2}`) and tie it to :math:`l_1 P_{3,2}`, since both are :math:`m_2 c_{x,2}`.

    Returns
    -------
    base : BaseParameters
        With the centres of mass on the links' x axes.
    matrix : ndarray, shape (6, 4)
        Of ``P_11, P_21, P_31, P_12, P_22, P_32`` per base parameter.

    Raises
    ------
    ShapeError
        If the robot is not a planar arm of two links.
    """
    links = model.manipulator.links
    if len(links) != 2 or not model.planar:
        raise ShapeError("eqs (57), (58) are for a planar arm of two links")
    names = model.parameter_names
    base = base_parameters(model, columns=[k for k, name in enumerate(names) if not name.startswith("my_")])
    place = {names[column]: k for k, column in enumerate(base.columns)}
    matrix = np.zeros((6, base.rank))
    twice_l_1 = 2 * links[0].length
    for row, lead, factor in (
        (0, "Izz_1", 1.0),
        (1, "mx_2", twice_l_1),
        (2, "mx_1", 1.0),
        (3, "Izz_2", 1.0),
        (4, "mx_2", twice_l_1),
        (5, "mx_2", 2.0),
    ):
        matrix[row, place[lead]] = factor
    return base, frozen_array(matrix)
