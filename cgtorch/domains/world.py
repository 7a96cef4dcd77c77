"""A base class for your own worlds, with what most worlds share."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor

from cgtorch.ground.environment import Lanes, ScenarioBatch
from cgtorch.ground.errors import WorldError


class World(ABC):
    """An `Environment` whose state determines the percept and whether the task has succeeded.

    All methods get n lanes at once and must treat each by itself. Everything that a world
    remembers of an episode belongs in the state. Noise must follow from the scenario and the
    state alone.

    States, controls and percepts are copied on their way in and out, so a method may change what
    it gets and return what it keeps. WorldError if a percept is not finite, or a state or percept
    has another shape than before.

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
        return math.prod(self.start(torch.empty(0, dtype=torch.long))[1].shape[1:])

    @property
    @abstractmethod
    def control_size(self) -> int:
        """U; it can be a class attribute."""

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        state = self.first_state(scenario).clone()
        return state, self._shown(self.perceived(state.clone(), scenario).float(), scenario)

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """See `Environment.step`; a control that is not finite changes nothing."""
        state, scenario = lanes.state.clone(), lanes.scenario
        if control.is_cpu and math.isfinite(control.sum()):  # all are, and nothing has to be mended
            after = self.next_state(state, control.clone(), scenario).to(lanes.state)
            percept = self.perceived(after.clone(), scenario).to(lanes.percept)
            done = torch.ones(len(control), dtype=torch.bool)
        else:
            done = control.isfinite().all(1)
            after = self.next_state(state, control.nan_to_num(), scenario)
            after = torch.where(done[:, None], after.to(lanes.state), lanes.state)
            percept = self.perceived(after.clone(), scenario).to(lanes.percept)
            percept = torch.where(done[:, None], percept, lanes.percept)
        for name, new, old in (("state", after, lanes.state), ("percept", percept, lanes.percept)):
            if new.shape != old.shape:
                raise WorldError(
                    f"{type(self).__name__}: a {name} of shape {tuple(old.shape)} became "
                    f"{tuple(new.shape)} in a step; return as many numbers as before"
                )
        return lanes.moved(after.clone(), self._shown(percept, scenario, lanes.step)), done

    def _shown(self, percept: Tensor, scenario: Tensor, step: Tensor | None = None) -> Tensor:
        """A copy of percepts (n, D) that are finite; WorldError if one is not."""
        if percept.is_cpu and not math.isfinite(percept.sum()):
            for row, number in (~percept.isfinite()).nonzero()[:1].tolist():
                after = "at its start" if step is None else f"in step {int(step[row])}"
                about = vars(self.scenarios[scenario[row : row + 1]]).items()
                values = ", ".join(f"{name}={value[0].tolist()}" for name, value in about)
                raise WorldError(
                    f"{type(self).__name__} showed number {number + 1} of its percept as "
                    f"{float(percept[row, number])} {after}; show finite numbers. Its scenario "
                    f"{int(scenario[row])} has {values:.200}"
                )
        return percept.clone()

    def observe(self, lanes: Lanes) -> Lanes:
        """See `Environment.observe`: looking again shows the same."""
        return lanes

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """See `Environment.success`."""
        return lanes, self.succeeded(lanes.state.clone()).to(lanes.percept)
