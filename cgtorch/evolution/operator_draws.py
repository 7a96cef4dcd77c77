"""Random choices of the operators on structure, as what their numbers follow from.

What they choose from is not known before, so each number has a place of its own, whatever happens.
"""

from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from cgtorch.evolution.sampling import key, keys, words


@dataclass(frozen=True)
class Pairs:
    """How Q pairs are crossed.

    Attributes:
        parents: (2 Q,) long, the first of all pairs and then the second.
        strategy: (2 Q, S) float32 rates of the parents.
        key: of all pairs' numbers, whose places are `pair_parts(width, O)`.
        width: nodes of the largest parent.
    """

    parents: Tensor
    strategy: Tensor
    key: int
    width: int

    def __len__(self) -> int:
        """Q."""
        return len(self.parents) // 2


@dataclass(frozen=True)
class Choices:
    """How P graphs are mutated.

    Attributes:
        strategy: (P, S) float32 rates.
        key: of all graphs' numbers, whose places are `parts(width, O)`.
        width: at least nodes of the largest graph and one more, or as many as there may be.
    """

    strategy: Tensor
    key: int
    width: int


def pair_parts(width: int, outcomes: int) -> list[int]:
    """Numbers of a pair.

    Whether it is crossed and how many nodes are swapped, of either parent where its group begins
    and the order of nodes, of either child its heads.
    """
    return [1, 1, 1, 1, width, width, width * outcomes, width * outcomes]


def parts(width: int, outcomes: int) -> list[int]:
    """Numbers of a graph.

    To add, to delete, to move the start; to replace, to change, and heads of all edges.
    """
    return [3 + outcomes, 3, 2, width, width, width * outcomes]


def numbers(key_of_all: int, count: int, sizes: list[int]) -> tuple[Tensor, ...]:
    """Words (count, size) of so many individuals for parts of such sizes."""
    places = torch.arange(sum(sizes))
    return words(keys(key_of_all, count)[:, None], places).split(sizes, 1)


def choices_for(strategy: Tensor, nodes: int, capacity: int, generator: Generator) -> Choices:
    """Choices for individuals of a strategy (P, S) whose graphs have at most so many nodes.

    Args:
        strategy: (P, S).
        nodes: at most.
        capacity: that a graph may have in the end.
        generator: of all choices.
    """
    return Choices(strategy.float(), key(generator), min(nodes + 1, capacity))
