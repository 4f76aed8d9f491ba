"""How the search for missing physics decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """How the search decides.

    Attributes
    ----------
    alarm : float
        Family-wise probability of naming anything on data where nothing is missing.
    visible : float
        Least share of an effect that the rigid body leaves over for it to be tested.
    law_error : float
        Relative accuracy of one law: rivals that differ by less are told apart by simplicity alone.
    torque_error : float
        Relative accuracy of the rigid body's torque, with clocks, derivatives and filters as they are.
    patch_error : float
        How many times the errors of the laws in the model a correction without a name has to be.
    patch_law_error : float
        Relative accuracy of a law beside corrections without a name.
    same : float
        Canonical correlation above which two effects are one class.
    close : float
        Difference of log-likelihood below which a rival stands beside an effect.
    order : int
        Of the autoregressive noise.
    most : int
        Effects at most, where there are not so many motors that two for each are more (`Search.most`).
    at_once : int
        Effects that are added before a correction without a name is weighed against them.
    """

    alarm: float = 2e-3
    visible: float = 0.004
    law_error: float = 0.006
    torque_error: float = 1.0e-4
    patch_error: float = 3.3
    patch_law_error: float = 0.05
    same: float = 0.95
    close: float = 3.0
    order: int = 24
    most: int = 6
    at_once: int = 2

    def within(self, statistic: float, error: float | None = None, least: float | None = None) -> float:
        """Say by how much log-likelihood a rival may be worse to stand beside an effect of this statistic."""
        error = self.law_error if error is None else error
        return max(self.close if least is None else least, 0.5 * error**2 * statistic)
