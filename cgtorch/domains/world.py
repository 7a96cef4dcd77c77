"""A base class for your own worlds, with what most worlds share."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor

from cgtorch.ground.environment import Lanes, ScenarioBatch


class World(ABC):
    """An `Environment` whose state determines the percept and whether the task has succeeded.

    All methods get n lanes at once and must treat each by itself. Everything that a world
    remembers of an episode belongs in the state. Noise must follow from the scenario and the
    state alone.

    Attributes:
        scenarios: The B scenarios.
        percept_size: D, the length of a percept.
        control_size: U, the length of a control.
    """

    made_of: ClassVar[Mapping[str, str]] = {
        "start": "start (first_state, perceived)",
        "step": "step (next_state, perceived)",
        "success": "success (succeeded)",
    }
    """The names in errors of methods that are made of other methods."""

    def __init__(self, scenarios: ScenarioBatch) -> None:
        """The world of B scenarios."""
        self.scenarios: Any = scenarios

    @abstractmethod
    def first_state(self, scenario: Tensor) -> Tensor:
        """Initial states (n, S) of the scenarios with these indices (n,)."""

    @abstractmethod
    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        """States (n, S) after controls (n, U), which are finite.

        Clamp a control to the bounds of its field, as Γ does.
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
        """U; it can be a class attribute."""

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        state = self.first_state(scenario)
        return state, self.perceived(state, scenario).float()

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """See `Environment.step`; a control that is not finite changes nothing."""
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
        """See `Environment.observe`: looking again shows the same."""
        return lanes

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """See `Environment.success`."""
        return lanes, self.succeeded(lanes.state).to(lanes.percept)
