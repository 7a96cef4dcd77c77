"""What is told of models that were fitted: in words, as numbers, and as curves."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from cgtorch.svm import LearningCurve


@dataclass(frozen=True)
class ModelSummary:
    """What watchers are told of Γ and C.

    Attributes:
        text: one line for a display.
        scalars: numbers by their tag in TensorBoard.
        curves: learning curves by the name of the model.
        reliability: mean probability, frequency of success and rows of bins of C's probability.
        first: whether these are the first models of a run.
    """

    text: str
    scalars: Mapping[str, float] = field(default_factory=dict)
    curves: Mapping[str, LearningCurve | None] = field(default_factory=dict)
    reliability: tuple[tuple[float, float, int], ...] = ()
    first: bool = False
