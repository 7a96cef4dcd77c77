"""What improvement asks of a `Domain`: scenarios, where to search, and how models learn."""

from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

import torch
from torch import Generator, Tensor

from cgtorch.environment import Dataset, Environment, ScenarioBatch

S = TypeVar("S", bound=ScenarioBatch)
"""The scenarios of a world."""

Models: TypeAlias = Any
"""Γ and C with whatever they have been learned from: improvement hands them on and looks at nothing
in them. Those of a `Domain` are `cgtorch.domains.Knowledge`, or None where there are none."""

Imagine: TypeAlias = Callable[[Models, S, Tensor, int, Generator, torch.device | str], Environment]
"""Makes the environment that skills are evolved in, of Γ and C, or the world itself: from models,
scenarios, their first percepts (B, D), the number of replicas of each, a generator and a device.
Scenario i has the indices i · replicas … i · replicas + replicas - 1; they may differ by what Γ can
have got wrong, drawn from the generator, or by noise."""

Learn: TypeAlias = Callable[[Models, Dataset, Generator], Models]
"""From models, what was experienced in the world, and a generator to models that know it, too."""

Grouping: TypeAlias = Callable[[Tensor, Tensor, int, Generator], Tensor]
"""First percepts (B, D), (B,) bool what is missed, a size, and a generator to the indices (n,) of
a group of missed scenarios that a specialist is evolved on."""

Draw: TypeAlias = Callable[[Generator], S]
"""Draws fresh scenarios of the kind a stage is about."""
