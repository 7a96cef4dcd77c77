"""The functions of a `Domain` that improvement needs: scenarios, where to search, and learning."""

from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

import torch
from torch import Generator, Tensor

from cgtorch.ground.environment import Dataset, Environment, ScenarioBatch

S = TypeVar("S", bound=ScenarioBatch)
"""The scenarios of a world."""

Models: TypeAlias = Any
"""Γ and C with their data. Improvement passes them on without looking at them. For a `Domain` they
are `cgtorch.domains.Knowledge`, or None without models."""

Imagine: TypeAlias = Callable[[Models, S, Tensor, int, Generator, torch.device | str], Environment]
"""Makes the environment of an evolution, from Γ and C or from the world itself. The arguments are
models, scenarios, their first percepts (B, D), the number of replicas of each, a generator and a
device. Scenario i gets the indices i · replicas … i · replicas + replicas - 1. Replicas may differ
by possible errors of Γ, drawn from the generator, or by noise."""

Learn: TypeAlias = Callable[[Models, Dataset, Generator], Models]
"""Maps models, new experience in the world, and a generator to models that have learned from it."""

Grouping: TypeAlias = Callable[[Tensor, Tensor, int, Generator], Tensor]
"""Maps first percepts (B, D), (B,) bool which scenarios are missed, a size, and a generator to the
indices (n,) of missed scenarios on which a specialist is evolved."""

Draw: TypeAlias = Callable[[int, Generator], S]
"""Draws a number of fresh scenarios of the stage's kind."""
