"""What the figures of a report are drawn from: plain arrays, every part optional."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class RunEvidence:
    """One recording: what was measured and what the models say.

    Attributes
    ----------
    label : str
    time : ndarray, shape (n,)
        [s].
    measured, rigid, augmented : ndarray, shape (n, n_motors)
        Motor torques: recorded, of the re-identified rigid body, of the completed model, all in the same band. For a
        kinematic diagnosis the motor positions instead.
    q, v : ndarray, shape (n, n_joints), optional
        Joint positions and velocities [rad or m, s].
    valid : ndarray of bool, shape (n,), optional
        Samples that were judged; all by default.
    holdout : bool
        Whether the models were judged on this recording rather than fitted to it.
    units : tuple of str
        Of `measured`, `rigid` and `augmented`, per motor; one if it is the same for all.
    joint_units : tuple of str
        Of `q`, per joint; one if it is the same for all.
    """

    label: str
    time: np.ndarray
    measured: np.ndarray
    rigid: np.ndarray
    augmented: np.ndarray
    q: np.ndarray | None = None
    v: np.ndarray | None = None
    valid: np.ndarray | None = None
    holdout: bool = False
    units: tuple[str, ...] = ("N m",)
    joint_units: tuple[str, ...] = ("rad",)

    def unit(self, motor: int) -> str:
        """Give the unit of one motor."""
        return self.units[motor % len(self.units)]

    def joint_unit(self, joint: int) -> str:
        """Give the unit of one joint's position."""
        return self.joint_units[joint % len(self.joint_units)]


@dataclass(frozen=True)
class LawCurve:
    """A fitted law over the data it was fitted to.

    Attributes
    ----------
    x, y_points : ndarray, shape (n,)
        Where the law lives (velocity for friction, angle for a spring, torque for elasticity) and what the data show
        there once everything else of the model is taken away.
    y_fit : ndarray, shape (n,)
        The law at the same samples; drawn in time order when `loop`, else in order of `x`.
    x_label, y_label : str
        With units.
    loop : bool
        Whether the law has memory (hysteresis, backlash), so that its curve is a loop.
    """

    x: np.ndarray
    x_label: str
    y_points: np.ndarray
    y_fit: np.ndarray
    y_label: str = "torque [N m]"
    loop: bool = False


@dataclass(frozen=True)
class Rival:
    """A candidate that was weighed against a finding.

    Attributes
    ----------
    effect : str
    location : mapping
    delta_bic : float
        Of the whole model with it instead of the finding, relative to no effect; larger is better [1].
    reason : str
        Why it lost, in words.
    """

    effect: str
    location: Mapping[str, Any]
    delta_bic: float
    reason: str = ""


@dataclass(frozen=True)
class SimulatedMotion:
    """Joint positions over one stretch, both simulations started from the recorded state.

    Attributes
    ----------
    time : ndarray, shape (n,)
        [s].
    recorded, rigid, augmented : ndarray, shape (n, n_joints)
        [rad or m].
    label : str
    units : tuple of str
        Of each joint; one if it is the same for all.
    """

    time: np.ndarray
    recorded: np.ndarray
    rigid: np.ndarray
    augmented: np.ndarray
    label: str = ""
    units: tuple[str, ...] = ("rad",)


@dataclass(frozen=True)
class Evidence:
    """Everything a report can draw; leave out what there is not.

    Attributes
    ----------
    runs : tuple of RunEvidence
    noise_floor : ndarray, shape (n_motors,), optional
        [N m or N].
    laws : tuple of (LawCurve or None)
        One per finding, in the order of the findings.
    rivals : tuple of tuple of Rival
        One tuple per finding.
    unexplained : LawCurve, optional
        The shape of what no known effect explains.
    simulated : tuple of SimulatedMotion
    notices : tuple of str
        What was found in the recordings and done about it.
    animation : str, optional
        Name of the file, beside the report, that plays the recorded and the simulated motions.
    """

    runs: tuple[RunEvidence, ...] = ()
    noise_floor: np.ndarray | None = None
    laws: tuple[LawCurve | None, ...] = ()
    rivals: tuple[tuple[Rival, ...], ...] = ()
    unexplained: LawCurve | None = None
    simulated: tuple[SimulatedMotion, ...] = ()
    notices: tuple[str, ...] = ()
    animation: str | None = None
