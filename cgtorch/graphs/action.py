"""The action interface: what a node of a computational graph does (section IV-A)."""

import itertools
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import torch
from torch import Generator, Tensor, nn

from cgtorch.ground import counter_rng as chance
from cgtorch.ground.environment import Environment, Lanes, seeds_of
from cgtorch.ground.errors import ActionError


class Action(nn.Module, ABC):
    """A batched routine with named outcomes and real-valued parameters.

    Subclasses set the attributes and implement `forward`. All nodes of an action share the action
    itself. They differ in their parameters, which are stored in the graph and evolve.

    Attributes:
        outcomes: The names of the outcomes, in the order of their indices.
        terminal: The outcomes that end the computation, and whether the skill then succeeded.
        num_parameters: Number of real parameters of each node.
        message_size: Length of the message that it reads or writes, 0 for none.
        memory_size: Number of values in the lane's memory that it uses; they are zero when a skill
            begins.
        memory_part: The name of its part of the memory. Actions with the same name share the part;
            without a name, the part is the action's own.
        native_kind: The name of its compiled counterpart in native/engine/program.h, for exactly
            this class; "" if there is none.
        request: What it asks of a robot, for exactly this class: "control" for the message as a
            control, "perceive", or "test" for whether the task has succeeded; "" for nothing.
        plain_module: The module with the same class in plain Python, for exported state machines;
            "" if there is none.
        plain_arguments: Arguments of that class besides its parameters and sizes.
        first_step: The initial standard deviation of its parameters when a search tunes them
            (`cgtorch.evolution.lineages`). Those of new nodes have a standard deviation of 1.
        deterministic: Whether equal lanes and parameters always give equal results. Set it to False
            for an action that draws random numbers.
    """

    outcomes: tuple[str, ...] = ("success",)
    terminal: Mapping[str, bool] = {}
    num_parameters: int = 0
    message_size: int = 0
    memory_size: int = 0
    memory_part: str = ""
    native_kind: ClassVar[str] = ""
    request: ClassVar[str] = ""
    plain_module: ClassVar[str] = ""
    plain_arguments: Mapping[str, object] = {}
    first_step: float = 1.0
    deterministic: bool = True

    @abstractmethod
    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """Run the action on n lanes.

        Args:
            lanes: The n lanes at nodes of this action. Their memory (n, C) is the action's part of
                it.
            parameters: (n, num_parameters) the parameters of those nodes.
            environment: Where the skill runs; `step` moves, `observe` perceives, `success` tests.

        Returns:
            The lanes afterwards, and the (n,) long index of each lane's outcome. Rows must not
                influence one another.
        """

    def initial_parameters(self, n: int, generator: Generator) -> Tensor:
        """(n, num_parameters) parameters of new nodes, standard normal unless overridden."""
        return torch.randn(n, self.num_parameters, generator=generator)

    def uniform(self, lanes: Lanes, environment: Environment, size: int) -> tuple[Lanes, Tensor]:
        """Random numbers for a stochastic action (`cgtorch.ground.counter_rng`).

        They depend on the seed of the lane's scenario, the name of the action's class, and how
        often the lane has drawn with it, which the last number of the action's memory counts. So a
        skill that solved a scenario solves it again.

        Returned are the n lanes with the count increased, and (n, size) numbers in [0, 1).
        ActionError if the action is deterministic or has no memory.
        """
        if self.deterministic or not self.memory_size:
            raise ActionError(
                f"{type(self).__name__} draws random numbers; give it deterministic = False and a "
                "memory_size of at least 1, of which the last number counts the draws"
            )
        memory = lanes.memory.clone()
        count = memory[:, -1].long()
        memory[:, -1] += 1
        seeds = seeds_of(environment, lanes.scenario)
        drawn = chance.uniform(seeds, type(self).__qualname__, count, size)
        return replace(lanes, memory=memory), drawn.to(memory)

    def normal(self, lanes: Lanes, environment: Environment, size: int) -> tuple[Lanes, Tensor]:
        """Standard normal numbers (n, size); otherwise like `uniform`."""
        lanes, drawn = self.uniform(lanes, environment, 2 * size)
        return lanes, chance.normal(drawn)


def own(action: Action, name: str) -> str:
    """A class attribute such as `request`, for exactly the action's class; "" from a base class."""
    return str(vars(type(action)).get(name, ""))


def memory_parts(actions: Sequence[Action]) -> tuple[tuple[slice, ...], int]:
    """The slice of the common memory of each distinct action, and the memory's length."""
    owner = [action.memory_part or id(action) for action in actions]
    sizes: dict[str | int, int] = {}
    for who, action in zip(owner, actions, strict=True):
        sizes[who] = max(sizes.get(who, 0), action.memory_size)
    ends = dict(zip(sizes, itertools.accumulate(sizes.values()), strict=True))
    parts = tuple(slice(ends[who] - sizes[who], ends[who]) for who in owner)
    return parts, sum(sizes.values())
