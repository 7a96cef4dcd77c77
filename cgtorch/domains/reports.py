"""The reports of the fits of Γ and C."""

from dataclasses import dataclass
from typing import Any, TypeAlias

from cgtorch.svm import Choice, LearningCurve

Reliability: TypeAlias = tuple[tuple[float, float, int], ...]
"""For each bin of probability: the mean probability, the frequency of success, and the number of
rows."""


@dataclass(frozen=True)
class TransitionReport:
    """The report of the fit of a transition model.

    Attributes:
        rows: Number of transitions given; the machine learned from the informative ones.
        coordinates: Names of the D numbers of a percept, which have the `units`.
        error: Cross-validated mean absolute error of each number, in its unit.
        baseline_error: The same for a model without a machine.
        choice: Hyper-parameters (C, gamma, epsilon, score) of each output, None if it is not used.
        gap: Duality gap of each output's dual problem.
        centres: Number of centres.
        grid_cost: Costs in the grid, beside the widths of kernels (gamma) and tubes (epsilon).
        grid_scores: Mean negative absolute error by gamma, epsilon, C and output.
        learning_curve: The same score by the number of transitions.
    """

    rows: int
    informative: int
    coordinates: tuple[str, ...]
    units: tuple[str, ...]
    error: tuple[float, ...]
    baseline_error: tuple[float, ...]
    choice: tuple[Choice | None, ...]
    gap: tuple[float, ...]
    centres: int
    grid_cost: tuple[float, ...]
    grid_gamma: tuple[float, ...]
    grid_epsilon: tuple[float, ...]
    grid_scores: list[Any]
    learning_curve: LearningCurve | None = None


@dataclass(frozen=True)
class SuccessReport:
    """The report of the fit of a success classifier.

    Attributes:
        rows: Number of labelled percepts.
        positive: Share of them that succeed.
        balanced_accuracy: Cross-validated on all rows, with the chosen hyper-parameters.
        brier: Mean squared difference of cross-validated probability and label.
        calibration_error: Mean gap between probability and frequency over 10 equal bins, weighted
            by their rows.
        reliability: Mean probability, frequency and rows of each bin that is not empty.
        choice: Hyper-parameters.
        gap: Duality gap.
        centres: Number of centres.
        grid_cost: Costs in the grid, beside kernel widths (gamma).
        grid_scores: Mean balanced accuracy by gamma and C.
        learning_curve: Balanced accuracy with the chosen hyper-parameters, by number of rows.
    """

    rows: int
    positive: float
    balanced_accuracy: float
    brier: float
    calibration_error: float
    reliability: Reliability
    choice: Choice
    gap: float
    centres: int
    grid_cost: tuple[float, ...]
    grid_gamma: tuple[float, ...]
    grid_scores: list[Any]
    learning_curve: LearningCurve
