"""The action interface: what a node of a computational graph does (section IV-A)."""

import itertools
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import torch
from torch import Generator, Tensor, nn

from cgtorch.environment import Environment, Lanes, seeds_of
from cgtorch.ground import counter_rng as chance
from cgtorch.ground.errors import ActionError


class Action(nn.Module, ABC):
    """A batched routine with named outcomes and real-valued parameters.

    Subclasses set the attributes and implement `forward`. An action is shared by every node
    that uses it: what differs from node to node are the parameters, which evolution owns.

    Attributes:
        outcomes: names of the outcomes, in the order of their indices.
        terminal: outcomes that end the computation, and whether the skill then succeeded.
        num_parameters: how many real parameters each node of this action carries.
        message_size: length of the message it reads or writes, 0 for none.
        memory_size: numbers of the common memory that it uses; they are zero when a skill begins.
        memory_part: name of the part of the memory that these are. Actions that give the same name
            share it; without a name the part is the action's own.
        native_kind: name of the compiled counterpart, as native/engine/lanes.h lists it, for
            just this class; "" if there is none.
        plain_module: name of the module that has the same class in plain Python, for exported
            state machines; "" if there is none.
        plain_arguments: what that class is made with besides its parameters and sizes.
        first_step: by how much a search that tunes parameters changes those of its nodes at first
            (`cgtorch.evolution.lineages`); those of new nodes have a deviation of 1.
        deterministic: whether equal lanes and parameters always give equal results; one that draws
            random numbers says False.
    """

    outcomes: tuple[str, ...] = ("success",)
    terminal: Mapping[str, bool] = {}
    num_parameters: int = 0
    message_size: int = 0
    memory_size: int = 0
    memory_part: str = ""
    native_kind: ClassVar[str] = ""
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
            lanes: the n lanes that are at a node of this action; of their memory (n, C) it is the
                action's part.
            parameters: (n, num_parameters) the parameters of those nodes.
            environment: where the skill runs; `step` moves, `observe` perceives, `success` tests.

        Returns:
            The lanes afterwards and the (n,) long index of each lane's outcome. Rows must not
            influence one another.
        """

    def initial_parameters(self, n: int, generator: Generator) -> Tensor:
        """(n, num_parameters) parameters of new nodes, standard normal unless overridden."""
        return torch.randn(n, self.num_parameters, generator=generator)

    def uniform(self, lanes: Lanes, environment: Environment, size: int) -> tuple[Lanes, Tensor]:
        """Random numbers, for an action that is stochastic (`cgtorch.ground.counter_rng`).

        They depend on the seed of a lane's scenario, the name of the action's class, and how often
        the lane has drawn with it, which the last number of the action's memory counts. So they
        belong to the scenario, as the noise of the world does, and what a skill has solved it
        solves again. All seeds come from the generator that the scenarios were drawn with.

        Returned are the n lanes, which have drawn once more, and (n, size) numbers in [0, 1).
        ActionError if the action does not say that it is stochastic, or has no memory.
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
        """Standard normal numbers (n, size); the rest as for `uniform`."""
        lanes, drawn = self.uniform(lanes, environment, 2 * size)
        return lanes, chance.normal(drawn)


def memory_parts(actions: Sequence[Action]) -> tuple[tuple[slice, ...], int]:
    """Where the part of each action, given once, in a lane's common memory lies, and its length."""
    owner = [action.memory_part or id(action) for action in actions]
    sizes: dict[str | int, int] = {}
    for who, action in zip(owner, actions, strict=True):
        sizes[who] = max(sizes.get(who, 0), action.memory_size)
    ends = dict(zip(sizes, itertools.accumulate(sizes.values()), strict=True))
    parts = tuple(slice(ends[who] - sizes[who], ends[who]) for who in owner)
    return parts, sum(sizes.values())
