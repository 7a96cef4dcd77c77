"""The action interface: what a node of a computational graph does (section IV-A)."""

from abc import ABC, abstractmethod
from collections.abc import Mapping

import torch
from torch import Generator, Tensor, nn

from cgtorch.environment import Environment, Lanes


class Action(nn.Module, ABC):
    """A batched routine with named outcomes and real-valued parameters.

    Subclasses set the attributes and implement `forward`. An action is shared by every node
    that uses it: what differs from node to node are the parameters, which evolution owns.

    Attributes:
        outcomes: names of the outcomes, in the order of their indices.
        terminal: outcomes that end the computation, and whether the skill then succeeded.
        num_parameters: how many real parameters each node of this action carries.
        message_size: length of the message it reads or writes, 0 for none.
        memory_size: how much of the common memory it uses, from its beginning.
        deterministic: whether equal lanes and parameters always give equal results.
    """

    outcomes: tuple[str, ...] = ("success",)
    terminal: Mapping[str, bool] = {}
    num_parameters: int = 0
    message_size: int = 0
    memory_size: int = 0
    deterministic: bool = True

    @abstractmethod
    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """Run the action on n lanes.

        Args:
            lanes: the n lanes that are at a node of this action.
            parameters: (n, num_parameters) the parameters of those nodes.
            environment: where the skill runs; `step` moves, `observe` perceives, `success` tests.

        Returns:
            The lanes afterwards and the (n,) long index of each lane's outcome. Rows must not
            influence one another.
        """

    def initial_parameters(self, n: int, generator: Generator) -> Tensor:
        """(n, num_parameters) parameters of new nodes, standard normal unless overridden."""
        return torch.randn(n, self.num_parameters, generator=generator)
