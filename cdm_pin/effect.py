"""What an effect is: where it sits, the columns it adds to the inverse dynamics, and their physical parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .geometry import Vector
from .model import CableModel
from .motion import Motion

Shape = tuple[float, ...]


@dataclass(frozen=True)
class Columns:
    """Columns of one effect, per unit of each coefficient.

    Attributes
    ----------
    torque : ndarray, shape (n, n_motors, k) or None
        Added to the motor torques.
    along : (ndarray, shape (k, n); ndarray, shape (n_motors,)) or None
        Instead of `torque` where all motors see the same series, each with its weight.
    kinematic : ndarray, shape (n, n_motors, k) or None
        Added to x_i = (r_m/r_j) q_m,i - sum of the joints before and at i, where both sides are measured.
    """

    torque: Vector | None = None
    kinematic: Vector | None = None
    along: tuple[Vector, Vector] | None = None


@dataclass(frozen=True)
class Place:
    """Where an effect sits: the coordinate s = A q + B q_m it acts along, and what this place is called.

    Attributes
    ----------
    location : dict
        In the words of the diagnosis format.
    A, B : tuple of float
        Weights over joints and motors; a torque f along s adds A f to the joints and B f to the motors.
    index : tuple of int
        Zero-based numbers that the effect's functions need.
    aliases : tuple of dict
        Other locations that are the same coordinate on this robot.
    """

    location: dict[str, Any]
    A: Shape = ()
    B: Shape = ()
    index: tuple[int, ...] = ()
    aliases: tuple[dict[str, Any], ...] = ()

    @property
    def is_pair(self) -> bool:
        """Whether it stands for two motors at a ratio of speeds that is still to be told (`pair_places`)."""
        return self.location.get("kind") == "combination" and "weights" not in self.location

    def along(self, joints: Vector, motors: Vector) -> Vector:
        """Give A x + B x_m along a motion, shape (n,)."""
        return joints @ np.array(self.A) + motors @ np.array(self.B)

    def weights(self, model: CableModel) -> Vector:
        """Give w of tau_m = w f(w' v_m), shape (n_motors,)."""
        return model.joint_from_motor.T @ np.array(self.A) + np.array(self.B)


@dataclass(frozen=True)
class Parameter:
    """A physical parameter: name, unit, admissible range.

    Attributes
    ----------
    error, error_unseen : float
        Share of itself that it may be wrong by because its law is: with the cable's travel measured, and without.
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf
    error: float = 0.0
    error_unseen: float = 0.0


def unbounded(motions: Sequence[Motion], place: Place) -> list[tuple[float, float]]:
    """Give no bounds: nothing of the shape is estimated."""
    return []


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue.

    Attributes
    ----------
    name : str
    parameters : tuple of Parameter
    places : callable
        Model -> places.
    columns : callable
        Motion, place, shape -> `Columns`.
    grid : callable
        Motions, place -> coarse list of shapes to screen.
    bounds : callable
        Motions, place -> (lower, upper) per element of the shape, for its estimation.
    signs : tuple of int
        Per coefficient +1 (never negative) or 0 (free).
    physical : callable
        Coefficients, shape -> parameter values.
    exact : bool
        Whether the columns are exact or to first order in the effect.
    detail : callable, optional
        Motion, place, shape, scale -> series that no law fixes: how a sign of velocity passes through zero (what
        encoder steps, filters and standstill make of it), or how the elements of a hysteresis are spread.
    follows : bool
        Whether the columns depend on the torques that other effects bring.
    weighs : bool
        Whether the columns depend on the robot's inertial parameters.
    moves : callable, optional
        Motion, place, coefficients, shape -> the motion about which first-order columns are exact for these.
    carried : bool
        Whether the drive carries the effect's torque; what the logger adds it does not.
    errors : callable
        Place, shape -> further shares of themselves that parameters may be wrong by, besides `Parameter.error`.
    error : float
        Share of itself that the law may be wrong by; what else is found at the same time has to be larger. How a sign
        of velocity passes through zero is counted apart (`Candidate.doubts`).
    signed : callable
        Shape -> whether the signs hold; by default always.
    plausible : callable
        Coefficients, shape, scale of the detail -> whether they are such as the law may have.
    brakes : int
        How many leading coefficients make friction that brakes both ways and everywhere: the first is no less than the
        norm of the others, as what drives is none. Zero for other laws.
    least : callable, optional
        Motions, place, shape -> weights of the coefficients with which their sum is not negative, as far as is sure.
    leaves_open : callable, optional
        Motion, place, shape, coefficients -> what else it may bring, from torques of which its law may or may not
        speak.
    centre : callable, optional
        Coefficients -> the shape about which columns to first order are exact for them.
    reveals : callable, optional
        Motion, changes of the standard parameters, coefficients -> what these bring beside it and not without it.
    exact_travel : bool
        Whether the kinematic column is exact where the torque's is not.
    confounded : tuple of str
        Effects it is easily taken for.
    revealed_by : str
        The experiment that shows it.
    reference : str
    """

    name: str
    parameters: tuple[Parameter, ...]
    places: Callable[[CableModel], list[Place]]
    columns: Callable[[Motion, Place, Shape], Columns]
    physical: Callable[[Vector, Shape], dict[str, float]]
    grid: Callable[[Sequence[Motion], Place], list[Shape]] = lambda motions, place: [()]
    bounds: Callable[[Sequence[Motion], Place], list[tuple[float, float]]] = unbounded
    signs: tuple[int, ...] = (0,)
    exact: bool = True
    exact_travel: bool = False
    follows: bool = False
    weighs: bool = False
    moves: Callable[[Motion, Place, Vector, Shape], Motion] | None = None
    carried: bool = True
    errors: Callable[[Place, Shape], dict[str, float]] = lambda place, shape: {}
    error: float = 0.01
    signed: Callable[[Shape], bool] = lambda shape: True
    plausible: Callable[[Vector, Shape, float], bool] = lambda beta, shape, detail: True
    brakes: int = 0
    least: Callable[[Sequence[Motion], Place, Shape], Vector] | None = None
    leaves_open: Callable[[Motion, Place, Shape, Vector], Columns] | None = None
    centre: Callable[[Vector], Shape] | None = None
    reveals: Callable[[Motion, Vector, Vector], Columns] | None = None
    detail: Callable[[Motion, Place, Shape, float], list[Vector]] | None = None
    confounded: tuple[str, ...] = ()
    revealed_by: str = ""
    reference: str = ""
    nuisance_shape: int = field(default=0)  # leading elements of the shape that are smoothing, not physics
    counts: bool = True  # whether its shape counts as parameters beside its coefficients
    sized_by: str = ""  # the parameter that its first coefficient is, if not the first one
    reach: float = 0.35  # share of the (logarithmic) range of a shape that one estimate may move through
    inverse: Callable[[dict[str, float]], tuple[list[float], list[float]]] | None = None  # of `physical`

    @property
    def size(self) -> Parameter:
        """What its first coefficient is; of a gain what it is off by, of a stiffness its inverse, of slack neither."""
        return {p.name: p for p in self.parameters}[self.sized_by or self.parameters[0].name]

    def coefficients(self, parameters: dict[str, float]) -> tuple[Vector, Shape]:
        """Turn physical parameters (and the `width` of a smooth sign, in rad/s or N m) into coefficients and shape."""
        if self.inverse is None:
            beta, shape = [float(parameters.get(p.name, 0.0)) for p in self.parameters], []
        else:
            beta, shape = self.inverse(parameters)
        width = [float(parameters.get("width", 0.01))] * self.nuisance_shape
        return np.array(beta), (*width, *map(float, shape))


def acting(motion: Motion, place: Place, *series: Vector) -> Columns:
    """Columns of torques f along the place's coordinate."""
    return Columns(along=(np.stack(series), place.weights(motion.model)))


def speed_along(motion: Motion, place: Place) -> Vector:
    """Give the speed by all that is known; of smooth laws, what known shifts change is in `Motion.drag_change`."""
    return place.along(motion.joint_speeds, motion.v_m)


def position_along(motion: Motion, place: Place) -> Vector:
    """Give the position along the place's coordinate, shape (n,)."""
    return place.along(motion.q, motion.q_m)


def stacked_columns(parts: Sequence[Columns]) -> Columns:
    """Put columns of several parts beside each other."""

    def join(pieces: list[Vector | None]) -> Vector | None:
        known = [piece for piece in pieces if piece is not None]
        if not known:
            return None
        zero = np.zeros_like(known[0])
        return np.concatenate([zero if piece is None else piece for piece in pieces], axis=-1)

    return Columns(join([p.torque for p in parts]), join([p.kinematic for p in parts]))


def by_name(*names: str):
    """Name the coefficients, in their order."""
    return lambda beta, shape: dict(zip(names, map(float, beta), strict=False))


def choice_physical(choice: str):
    """Tell the coefficient, and which of two laws it is of: the second element of the shape, called so."""
    return lambda beta, shape: {"coefficient": float(beta[0]), choice: shape[1] if len(shape) > 1 else 0.0}


def choice_inverse(choice: str):
    """Invert `choice_physical`."""
    return lambda p: ([p["coefficient"]], [p.get(choice, 0.0)])


def sinusoid_physical(amplitude: str):
    """Tell amplitude, cycles and phase of a wave, whose amplitude is called so."""

    def physical(beta: Vector, shape: Shape) -> dict[str, float]:
        named = {amplitude: float(np.hypot(beta[0], beta[1]))}
        if shape:
            named["cycles"] = shape[0]
        return named | {"phase": float(np.arctan2(beta[1], beta[0]))}

    return physical


def sinusoid_inverse(p: dict[str, float], amplitude: str) -> list[float]:
    """Give sine and cosine part of a wave from its parameters."""
    return [p[amplitude] * np.cos(p.get("phase", 0.0)), p[amplitude] * np.sin(p.get("phase", 0.0))]
