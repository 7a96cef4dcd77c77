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

Possible: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""Percepts (n, D) and controls (n, U) to (n,) bool, whether the control can be carried out."""


class ModelEnvironment:
    """An `Environment` that consists of percepts only; nothing in it touches the world.

    Perceiving again changes nothing, since Γ predicts what would be perceived. A lane's state
    (n, 1) counts its motions.
    """

    def __init__(
        self,
        percepts: Tensor,
        gamma: Gamma,
        classifier: Classifier,
        possible: Possible,
        control_size: int = 3,
        errors: Tensor | None = None,
    ):
        """Set up the models on the first percepts of B scenarios.

        Args:
            percepts: (B, D).
            gamma: the transition model Γ.
            classifier: the success classifier C.
            possible: whether a control can be carried out; where not, the percept stays.
            control_size: U.
            errors: (B, T, D) what to add to Γ's prediction at each motion of each scenario, so
                that a skill is judged under what Γ may have got wrong; used in turn.
        """
        self.percepts, self.gamma, self.classifier = percepts, gamma, classifier
        self.possible, self.control_size, self.errors = possible, control_size, errors

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
        return percept.new_zeros(len(percept), 1), percept

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """The percepts that Γ predicts; where the control is not possible they stay.

        A control that is not finite, such as that of a lane without a message, never is.
        """
        free = self.possible(lanes.percept, control) & control.isfinite().all(1)
        rows = free.nonzero()[:, 0]
        predicted = self.gamma(lanes.percept[rows], control[rows])
        if self.errors is not None:
            turn = lanes.state[rows, 0].long() % self.errors.shape[1]
            predicted = predicted + self.errors[lanes.scenario[rows], turn]
        percept, state = lanes.percept.clone(), lanes.state.clone()
        percept[rows] = predicted
        state[rows] += 1
        return replace(lanes, percept=percept, state=state), free

    def observe(self, lanes: Lanes) -> Lanes:
        """See `Environment.observe`."""
        return lanes

    def success(self, lanes: Lanes) -> Tensor:
        """C(p), the probability that the task succeeds from here."""
        return self.classifier(lanes.percept)
