"""Random choices of the operators on structure, drawn before the operators run.

What they choose from is not known yet, so these are numbers in [0, 1), as many whatever happens.
"""

from dataclasses import dataclass
from typing import TypeAlias

from torch import Generator, Tensor

from cgtorch.evolution.sampling import words, words_for

Pairing: TypeAlias = tuple[Tensor, Tensor, int, int]
"""`chosen` and `size` of `Pairs`, how many pairs are crossed, and `width`."""


@dataclass(frozen=True)
class Pairs:
    """How Q pairs are crossed.

    Attributes:
        parents: (2 Q,) long, the first of all pairs and then the second.
        chosen: (Q,) long, row of `draws`, or -1 for pairs that are only copied.
        size: (Q,) long, how many nodes are swapped.
        draws: (C, W) random words for numbers in `pair_parts(width, O)`.
        width: nodes of the largest parent.
    """

    parents: Tensor
    chosen: Tensor
    size: Tensor
    draws: Tensor
    width: int


@dataclass(frozen=True)
class Choices:
    """How P graphs are mutated.

    Attributes:
        strategy: (P, S) float32 rates.
        draws: (P, W) random words for numbers in `parts(width, O)`.
        width: at least nodes of the largest graph and one more, or N if that is less.
    """

    strategy: Tensor
    draws: Tensor
    width: int


def pair_parts(width: int, outcomes: int) -> list[int]:
    """Of either parent where its group begins and the order of nodes, of either child its heads."""
    return [1, 1, width, width, width * outcomes, width * outcomes]


def parts(width: int, outcomes: int) -> list[int]:
    """To add, to delete, to move the start; to replace, to change, and heads of all edges."""
    return [3 + outcomes, 3, 2, width, width, width * outcomes]


def choices_for(
    strategy: Tensor, nodes: int, shape: tuple[int, ...], generator: Generator
) -> Choices:
    """Choices for individuals of a strategy (P, S) whose graphs have at most so many nodes.

    Args:
        strategy: (P, S).
        nodes: at most.
        shape: (N, O) of their edges.
        generator: of all choices.
    """
    width = min(nodes + 1, shape[0])
    draws = words((len(strategy), words_for(sum(parts(width, shape[1])))), generator)
    return Choices(strategy.float(), draws, width)
