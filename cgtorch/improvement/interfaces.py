"""What improvement asks of a domain: scenarios, where to search, and how models learn.

With a world that holds given scenarios and the actions of its skills that is all of it. A `Domain`
(`cgtorch.domains`) gives all of these.
"""

from collections.abc import Callable
from typing import Any, Protocol, TypeAlias, TypeVar

import torch
from torch import Generator, Tensor

from cgtorch.environment import Dataset, Environment, ScenarioBatch

S = TypeVar("S", bound=ScenarioBatch)
"""The scenarios of a world."""

S_contra = TypeVar("S_contra", bound=ScenarioBatch, contravariant=True)

Models: TypeAlias = Any
"""Γ and C with whatever they have been learned from: improvement hands them on and looks at nothing
in them. Those of a `Domain` are `cgtorch.domains.Knowledge`, or None where there are none."""


class Imagine(Protocol[S_contra]):
    """Makes the environment that skills are evolved in: of Γ and C, or the world itself."""

    def __call__(
        self,
        models: Models,
        scenarios: S_contra,
        percepts: Tensor,
        replicas: int,
        generator: Generator,
        device: torch.device | str,
        /,
    ) -> Environment:
        """The environment of scenarios with first percepts (B, D), each `replicas` times.

        Scenario i has the indices i · replicas … i · replicas + replicas - 1; they may differ by
        what Γ can have got wrong, drawn from the generator, or by noise. The environment runs on
        `device`.
        """
        ...


Learn: TypeAlias = Callable[[Models, Dataset, Generator], Models]
"""From models, what was experienced in the world, and a generator to models that know it, too."""
