"""A base class for worlds of one's own, which says once what most worlds share."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor

from cgtorch.environment import Lanes, ScenarioBatch


class World(ABC):
    """An `Environment` whose state tells what is perceived and whether the task has succeeded.

    All methods get n lanes at once, of which each must be treated by itself. What a world needs to
    remember of an episode belongs into the state. Noise has to follow from the scenario and the
    state alone.

    Attributes:
        scenarios: the B scenarios.
        percept_size: D, numbers of a percept.
        control_size: U, numbers of a control.
    """

    made_of: ClassVar[Mapping[str, str]] = {
        "start": "start (first_state, perceived)",
        "step": "step (next_state, perceived)",
        "success": "success (succeeded)",
    }
    """What errors call the methods that are made of others."""

    def __init__(self, scenarios: ScenarioBatch) -> None:
        """The world of B scenarios."""
        self.scenarios: Any = scenarios

    @abstractmethod
    def first_state(self, scenario: Tensor) -> Tensor:
        """States (n, S) in which the scenarios with these indices (n,) begin."""

    @abstractmethod
    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        """States (n, S) after controls (n, U), which are finite.

        Where a control is beyond the bounds of its field, take the bound, as Γ does.
        """

    @abstractmethod
    def succeeded(self, state: Tensor) -> Tensor:
        """(n,) bool, whether the task has succeeded."""

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """Percepts (n, D) of states (n, S); the state itself by default."""
        return state

    @property
    def num_scenarios(self) -> int:
        """B."""
        return len(self.scenarios)

    @property
    def percept_size(self) -> int:
        """D."""
        return math.prod(self.start(torch.zeros(0, dtype=torch.long))[1].shape[1:])

    @property
    @abstractmethod
    def control_size(self) -> int:
        """U; a class attribute will do."""

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        state = self.first_state(scenario)
        return state, self.perceived(state, scenario).float()

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """See `Environment.step`; a control that is not finite is none, and nothing changes."""
        if control.is_cpu and math.isfinite(control.sum()):  # all are, and nothing has to be mended
            after = self.next_state(lanes.state, control, lanes.scenario).to(lanes.state)
            percept = self.perceived(after, lanes.scenario).to(lanes.percept)
            return lanes.moved(after, percept), torch.ones(len(control), dtype=torch.bool)
        done = control.isfinite().all(1)
        after = self.next_state(lanes.state, control.nan_to_num(), lanes.scenario)
        state = torch.where(done[:, None], after.to(lanes.state), lanes.state)
        percept = self.perceived(state, lanes.scenario).to(lanes.percept)
        percept = torch.where(done[:, None], percept, lanes.percept)
        return lanes.moved(state, percept), done

    def observe(self, lanes: Lanes) -> Lanes:
        """See `Environment.observe`: nothing new is seen by looking again."""
        return lanes

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """See `Environment.success`."""
        return lanes, self.succeeded(lanes.state).to(lanes.percept)
