r"""How sharply dry friction changes its sign: the width w of :math:`\tanh(v/w)`, told by the torques.

Too narrow a sign costs Coulomb friction a part of its size and gives viscous friction too much: at reversals the
friction of real cables and guides turns over a range of speeds. The width that leaves the least of the torque is
taken, between steps by a parabola, if it explains more than the narrow one by chance could.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from .accelerations import ROWS_PER_COLUMN, residual
from .geometry import Vector

FACTORS = 2.0 ** np.arange(8)  # on the narrowest width


def choose_factors(
    X: Vector, y: Vector, signs: Callable[[float], Vector], where: Sequence[int], present: np.ndarray
) -> Vector:
    """Choose by what factor each friction's sign is wider than the narrowest.

    Parameters
    ----------
    X : ndarray, shape (n, n_motors, n_columns)
    y : ndarray, shape (n, n_motors)
    signs : callable
        Gives the columns of dry friction with all widths times a factor, shape (n, n_motors, k).
    where : sequence of int, length k
        Their places among the columns of X.
    present : ndarray of bool, shape (n_motors, n_columns)
        Which columns reach which motor.

    Returns
    -------
    ndarray, shape (k,)
    """
    where = list(where)
    chosen = np.ones(len(where))
    if not where or len(y) < ROWS_PER_COLUMN * present.sum(axis=1).max():
        return chosen
    left = []
    for factor in FACTORS:
        X = X.copy()
        X[..., where] = signs(float(factor))
        left.append([residual(X[:, i, present[i]], y[:, i]) for i in range(len(present))])
    variance = np.maximum(np.array(left), 1e-9 * np.sqrt(np.mean(y**2, axis=0)) + 1e-150) ** 2
    variance = variance / variance.min(axis=0)
    enough = 2 * np.log(len(y)) / len(y)  # of a logarithm of the variance, for one parameter and correlated samples
    for k, column in enumerate(where):
        reached = variance[:, present[:, column]]
        best = int(np.argmin(np.sum(np.log(reached), axis=1)))
        if np.sum(np.log(reached[0] / reached[best])) > enough:
            chosen[k] = FACTORS[0] * 2.0 ** (best + _vertex(np.sum(reached, axis=1), best))
    return chosen


def _vertex(cost: Vector, best: int) -> float:
    """Give where a parabola through a least value and its neighbours is least, in steps from it."""
    if not 0 < best < len(cost) - 1:
        return 0.0
    before, here, after = cost[best - 1 : best + 2]
    return float(0.5 * (before - after) / (before - 2 * here + after))
