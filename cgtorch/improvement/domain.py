"""What improvement asks of a domain: scenarios, models to search in, and how these learn.

With a world that holds given scenarios and the actions of its skills that is all of it; the table
is one such domain (`cgtorch.improvement.knowledge`), docs/own-world.md makes another.
"""

from collections.abc import Callable
from typing import Any, Protocol, TypeAlias, TypeVar

import torch
from torch import Generator, Tensor

from cgtorch.data import Dataset
from cgtorch.environment import Environment, ScenarioBatch

S = TypeVar("S", bound=ScenarioBatch)
"""The scenarios of a world."""

Models: TypeAlias = Any
"""Γ and C with whatever they have been learned from: improvement hands them on and looks at nothing
in them. Those of the tabletop are `cgtorch.improvement.knowledge.Knowledge`."""


class Imagine(Protocol):
    """Makes of Γ and C the environment that skills are evolved in."""

    def __call__(
        self,
        models: Models,
        percepts: Tensor,
        replicas: int,
        generator: Generator,
        device: torch.device | str,
        /,
    ) -> Environment:
        """The models on the first percepts (B, D), each `replicas` times.

        Scenario i has the indices i · replicas … i · replicas + replicas - 1; they may differ by
        what Γ can have got wrong, drawn from the generator. The environment runs on `device`.
        """
        ...


Learn: TypeAlias = Callable[[Models, Dataset, Generator], Models]
"""From models, what was experienced in the world, and a generator to models that know it, too."""
