"""Γ and C as an environment: the place where skills are evolved (section V)."""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

from torch import Tensor

from cgtorch.environment import Lanes

Gamma: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""Percepts (n, D) and controls (n, U) to the next percepts (n, D)."""

Classifier: TypeAlias = Callable[[Tensor], Tensor]
"""Percepts (n, D) to the probability of success (n,)."""

Blocked: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""Percepts (n, D) and controls (n, U) to (n,) bool, whether the control cannot be done."""


class ModelEnvironment:
    """An `Environment` that consists of percepts only; nothing in it touches the world.

    A lane has no state beside its percept. Perceiving again changes nothing, since Γ predicts
    what would be perceived.
    """

    control_size = 3

    def __init__(self, percepts: Tensor, gamma: Gamma, classifier: Classifier, blocked: Blocked):
        """Set up the models on the first percepts (B, D) of B scenarios."""
        self.percepts = percepts
        self.gamma, self.classifier, self.blocked = gamma, classifier, blocked

    @property
    def num_scenarios(self) -> int:
        """B."""
        return len(self.percepts)

    @property
    def percept_size(self) -> int:
        """D."""
        return self.percepts.shape[1]

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        percept = self.percepts[scenario]
        return percept.new_zeros(len(percept), 0), percept

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """The percepts that Γ predicts; where the control is blocked they stay as they are.

        A control that is not finite, such as that of a lane without a message, is always blocked.
        """
        free = ~self.blocked(lanes.percept, control) & control.isfinite().all(1)
        rows = free.nonzero()[:, 0]
        percept = lanes.percept.clone()
        percept[rows] = self.gamma(lanes.percept[rows], control[rows])
        return replace(lanes, percept=percept), free

    def observe(self, lanes: Lanes) -> Lanes:
        """See `Environment.observe`."""
        return lanes

    def success(self, lanes: Lanes) -> Tensor:
        """C(p), the probability that the task succeeds from here."""
        return self.classifier(lanes.percept)
