"""Recordings in, identified parameters with their uncertainty out.

Each recording is visited once for its moments, which is all that the fits need, and once more for the colour of its
noise, which is what the standard errors need. Visits run on any executor (`cdm_pin.workers`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from . import estimators
from .base import BaseParameters, base_parameters, massive_columns
from .consistency import Standard, consistent_standard, nearest_standard
from .errors import InputError, RecordingError
from .estimators import Fit, Moments
from .geometry import Vector, frozen_array
from .model import CableModel
from .support import reliable_values, supported, unattenuated, unit_columns
from .survey import Gathered, Progress, Source, Survey, Visit
from .terms import Plan, Term, make_plan
from .workers import Workers

Estimator = Literal["weighted", "ordinary", "robust", "consistent"]


INDEFINITE = 1e-9
"""Most that an eigenvalue of a correlation may be below zero, as computed."""


@dataclass(frozen=True)
class Identification:
    """Identified parameters, and what they rest on.

    Attributes
    ----------
    model : CableModel
        The robot with its nominal parameters.
    estimator : str
    structural : BaseParameters
        What motor torques of this robot can depend on.
    base : BaseParameters
        What these recordings excite: the structural ones, or regrouped where a joint does not move.
    terms : tuple of Term
        Effects in the fit.
    fit : Fit
        Values of `base` and `terms`.
    covariance : ndarray, shape (p, p)
        Of the values; holds for noise that is correlated in time and between motors.
    reliable : ndarray of bool, shape (p,)
        Whether a value means something: its uncertainty is smaller than what the links could have.
    not_identifiable : tuple of (name, reason)
    standard : Standard
        Physically valid parameters of all links.
    moments : Moments
        Of the columns of the fit, all recordings.
    plan : Plan
    train : Gathered
        The recordings fitted.
    holdout : Gathered or None
        The others.
    hints : tuple of str
        What effects that were not asked for would explain.
    """

    model: CableModel
    estimator: str
    structural: BaseParameters
    base: BaseParameters
    terms: tuple[Term, ...]
    fit: Fit
    covariance: Vector
    reliable: np.ndarray
    not_identifiable: tuple[tuple[str, str], ...]
    standard: Standard
    moments: Moments
    plan: Plan
    train: Gathered
    holdout: Gathered | None = None
    hints: tuple[str, ...] = field(default=())

    @cached_property
    def std(self) -> Vector:
        """Standard deviation of each value, shape (p,)."""
        return frozen_array(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def rank(self) -> int:
        """Rank of the rigid body's columns of the observation matrix, recomputed."""
        X = self.moments.equations()[0][..., : self.base.rank]
        return int(np.linalg.matrix_rank(unit_columns(X.reshape(-1, X.shape[2])), tol=1e-9)) if X.size else 0

    @property
    def condition_number(self) -> float:
        """Condition number of the observation matrix, columns scaled to norm 1, recomputed."""
        return estimators.ordinary(self.moments).condition_number

    @property
    def residual(self) -> Vector:
        """Root mean square residual per motor, recomputed from the moments, shape (n_motors,) [N m]."""
        return np.sqrt(estimators.mean_square(self.moments, self.fit.values))

    @cached_property
    def prediction(self) -> Vector:
        """Coefficients of all columns of the plan, with which torques are predicted."""
        if self.base.rank < self.structural.rank:
            return self.physical_prediction
        return self._coefficients(self.fit.values[: self.base.rank], self.fit.values[self.base.rank :])

    @cached_property
    def physical_prediction(self) -> Vector:
        """Coefficients of all columns of the plan that the physically valid links and their effects amount to."""
        return self._coefficients(self.structural.values(self.standard.parameters), self.physical_effects)

    @property
    def physical_effects(self) -> Vector:
        """Coefficients of the effects beside the physically valid links, shape (n_terms,)."""
        return self.standard.free if len(self.standard.free) else self.fit.values[self.base.rank :]

    def _coefficients(self, rigid: Vector, effects: Vector) -> Vector:
        full = np.zeros(len(self.plan.names))
        full[: self.structural.rank] = rigid
        for term, value in zip(self.terms, effects, strict=True):
            full[self.structural.rank + self.plan.terms.index(term)] = value
        return full

    @property
    def identified_model(self) -> CableModel:
        """The robot with its identified, physically valid parameters."""
        return self.model.with_standard_parameters(self.standard.parameters)

    def errors(self, part: Gathered | Visit | None, *, physical: bool = False) -> dict[str, Vector]:
        """Say how well torque is predicted on recordings, by the fitted values or by the physically valid model.

        Returns
        -------
        dict
            Per motor ``rmse`` of the error, of the ``torque`` itself, the ``noise_floor`` [N m], and ``relative``, the
            norm of the error over the norm of the torque. Empty if there is no sample.
        """
        if part is None or not part.torques.n_samples:
            return {}
        beta = self.physical_prediction if physical else self.prediction
        rmse = np.sqrt(estimators.mean_square(part.torques, beta))
        torque = np.sqrt(estimators.mean_square(part.torques, 0.0 * beta))
        relative = rmse / np.maximum(torque, 1e-300)
        return {"rmse": rmse, "torque": torque, "noise_floor": part.noise_floor, "relative": relative}


def identify(
    model: CableModel,
    recordings: Sequence[Source],
    *,
    holdout: Sequence[Source] = (),
    effects: Sequence[str | Term] = (),
    estimator: Estimator = "weighted",
    cutoff: float | None = None,
    prior_weight: float = 1.0,
    tolerance: float = 1e-7,
    workers: Workers | None = None,
    skip_bad: bool = False,
    progress: Progress | None = None,
) -> Identification:
    """Identify base parameters and effects from recordings of motion and torque.

    Parameters
    ----------
    model : CableModel
        Nominal parameters; they are the prior of what the recordings do not tell.
    recordings : sequence of Recording or path
    holdout : sequence of Recording or path
        Not fitted; torque is predicted on them.
    effects : sequence of str or Term
        Fitted beside the rigid body, see `cdm_pin.terms.parse_effects`.
    estimator : {"weighted", "ordinary", "robust", "consistent"}
        Least squares weighted with the noise covariance over motors; all motors alike; weighted, with outlying torques
        pulled in; weighted and physically consistent, drawn to the nominal values.
    cutoff : float, optional
        Of the common filter [Hz]; default chosen from each recording.
    prior_weight : float
        Of the nominal values in physically consistent fits; 1 says that they are good to their own size.
    tolerance : float
        Share of a column that must be independent for it to count as excited.
    workers : Workers, optional
        Who visits the recordings, see `cdm_pin.workers`; default this process.
    skip_bad : bool
        Leave out recordings that cannot be read.
    progress : callable, optional
        Takes the step's name and the fraction of it that is done. If it has a true attribute `wants_news`, it also
        gets the estimates while they form: `at`, the time of the first recording up to which they reach [s],
        `parameters`, a list of (name, value, standard error under white noise), and `residual`, rms per motor.

    Raises
    ------
    InputError
        If an effect or the estimator is unknown, or there is no recording.
    RecordingError
        If a recording cannot be read or contradicts the robot.
    """
    if estimator not in get_args(Estimator):
        raise InputError(f"unknown estimator {estimator!r}; known: {', '.join(get_args(Estimator))}")
    if not recordings:
        raise InputError("no recording was given")
    structural = base_parameters(model, columns=massive_columns(model))
    plan = make_plan(model, structural, effects, cutoff)
    survey = Survey(plan, workers or Workers(), skip_bad, progress)
    train = survey.visit(recordings, "reading")
    base, columns, missing = supported(plan, train.moments, tolerance, train.independent)
    chosen = train.moments.select(columns)
    fit = estimators.weighted(chosen) if estimator != "ordinary" else estimators.ordinary(chosen)
    if estimator == "robust":
        fit, chosen = survey.robust(fit, columns)
    covariance = survey.covariance(fit, columns, robust=estimator == "robust")
    fit, covariance, share = unattenuated(fit, covariance, train.noise.select(columns))
    reliable, vague = reliable_values(model, base, fit, covariance, chosen, share)
    terms = tuple(plan.terms[k - structural.rank] for k in columns[base.rank :])
    standard, fit = _standard(model, base, terms, fit, covariance, reliable, estimator, prior_weight)
    result = Identification(
        model=model,
        estimator=estimator,
        structural=structural,
        base=base,
        terms=terms,
        fit=fit,
        covariance=covariance,
        reliable=reliable,
        not_identifiable=(*missing, *vague),
        standard=standard,
        moments=chosen,
        plan=plan,
        train=train,
        holdout=survey.visit(holdout, "holdout") if holdout else None,
        hints=(*_hints(plan, train.moments, columns), *_negative(terms, fit, covariance)),
    )
    _check_holdout(result)
    return result


def _standard(
    model: CableModel,
    base: BaseParameters,
    terms: Sequence[Term],
    fit: Fit,
    covariance: Vector,
    reliable: np.ndarray,
    estimator: str,
    prior_weight: float,
) -> tuple[Standard, Fit]:
    """Find physically valid links; the consistent estimator takes its values from them."""
    massive = massive_columns(model)
    signs = np.array([term.nonnegative for term in terms], dtype=bool)
    possible = np.all(fit.values[base.rank :][signs] >= 0)
    prior, matrix = model.standard_parameters[massive], base.matrix[:, massive]
    if estimator != "consistent" and reliable.all() and possible:
        exact = nearest_standard(matrix, fit.values[: base.rank], prior)
        if exact is not None:
            return _placed(model, massive, exact), fit
    std = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    correlation = covariance / np.outer(std, std)
    if np.linalg.eigvalsh(correlation)[0] > -INDEFINITE:
        information = np.linalg.pinv(correlation, rcond=1e-10, hermitian=True) / np.outer(std, std)
    else:  # parameters that hardly differ: the corrections of their errors have left no covariance to invert
        information = fit.information * min(1.0, float(np.median(np.diag(fit.white_covariance) / std**2)))
    standard = consistent_standard(matrix, fit.values, information, prior, nonnegative=signs, prior_weight=prior_weight)
    standard = _placed(model, massive, standard)
    if estimator == "consistent":
        values = np.concatenate([base.values(standard.parameters), standard.free])
        return replace(standard, exact=True), replace(fit, values=frozen_array(values))
    return standard, fit


def _placed(model: CableModel, columns: np.ndarray, standard: Standard) -> Standard:
    """Put the parameters of some links among those of all, the others zero."""
    parameters = np.zeros(10 * model.n_joints)
    parameters[columns] = standard.parameters
    return replace(standard, parameters=frozen_array(parameters))


def _hints(plan: Plan, moments: Moments, columns: Sequence[int], least: float = 0.05) -> tuple[str, ...]:
    """Say what the baseline effects that were not asked for would explain."""
    if not columns:
        return ()
    fit = estimators.ordinary(moments.select(columns))
    before = fit.noise_covariance
    hints = []
    first = plan.base.rank + plan.n_wanted
    for name in dict.fromkeys(term.effect for term in plan.terms[plan.n_wanted :]):
        spare = [first + k for k, term in enumerate(plan.terms[plan.n_wanted :]) if term.effect == name]
        after = estimators.ordinary(moments.select([*columns, *spare])).noise_covariance
        gain = 1 - np.sqrt(np.diag(after) / np.maximum(np.diag(before), 1e-300))
        if np.max(gain) > least and np.sqrt(np.diag(before)[np.argmax(gain)]) > 1e-6:
            i = int(np.argmax(gain))
            share = f"{100 * gain[i]:.0f} % off the residual of motor {i + 1}"
            hints.append(f"{name} would take {share} (--effects {name})")
    return tuple(hints)


def _negative(terms: Sequence[Term], fit: Fit, covariance: Vector, limit: float = 2.0) -> tuple[str, ...]:
    """Say which coefficients came out negative by more than their errors though physics forbids it."""
    first = len(fit.values) - len(terms)
    found = []
    for k, term in enumerate(terms, first):
        std = float(np.sqrt(max(covariance[k, k], 0.0)))
        if term.nonnegative and fit.values[k] < -limit * std:
            found.append(
                f"{term.name} came out negative ({fit.values[k]:.2g}, std {std:.2g}): something else acts there "
                "(friction with memory looks like that); model.yaml has none below zero"
            )
    return tuple(found)


def _check_holdout(result: Identification) -> None:
    """Refuse a hold-out on most of whose motors any prediction is worse than none, if the training was fitted well."""
    train = result.errors(result.train)
    if not train or np.max(train["relative"], where=train["torque"] > 0, initial=0.0) > 0.5:
        return
    for visit in result.holdout.visits if result.holdout else ():
        held = [result.errors(visit, physical=physical) for physical in (False, True)]
        if held[0] and min(float(np.median(errors["relative"])) for errors in held) > 1:
            raise RecordingError(
                f"its torques are not this robot's: predicted with errors of {_percent(held[0]['relative'])} on its "
                "motors; is it a recording of another robot, or in other units?",
                source=visit.source,
            )


def _percent(shares: Vector) -> str:
    return ", ".join(f"{100 * share:.0f}" for share in shares) + " %"
