"""Choices for a whole population at once, as functions of uniform numbers drawn before.

Most numbers only say whether something rare happens, so three are drawn at the cost of one: a word
of 63 random bits is three numbers of 21 bits.
"""

import torch
from torch import Generator, Tensor

IN_A_WORD, BITS = 3, 21


def words(shape: tuple[int, ...], generator: Generator) -> Tensor:
    """(*shape) long, 63 random bits each."""
    return torch.empty(shape, dtype=torch.long).random_(generator=generator)


def words_for(numbers: int) -> int:
    """How many words hold so many numbers."""
    return -(-numbers // IN_A_WORD)


def uniform(words: Tensor, columns: int) -> Tensor:
    """(P, columns) float32 in [0, 1), the numbers that each row of words (P, W) begins with."""
    fields = words[..., None] >> torch.arange(IN_A_WORD) * BITS & 2**BITS - 1
    return fields.flatten(1)[:, :columns].float() * 2.0**-BITS


def pick(draw: Tensor, count: Tensor | int) -> Tensor:
    """⌊draw · count⌋ (long) of draws in [0, 1), one of 0 … count - 1; 0 where the count is 0.

    In float32 a draw close to 1 can round up to the count itself, which is taken as the last.
    """
    last = torch.as_tensor(count) - 1
    return (draw * count).long().minimum(last).clamp_min(0)


def nth_true(mask: Tensor, draw: Tensor) -> Tensor:
    """(P, *shape) long, for each draw (P, *shape) an index of a True of its row of `mask` (P, N).

    All are equally likely; 0 where there is none.
    """
    order = torch.argsort((~mask).long(), dim=1, stable=True)
    at = pick(draw.reshape(len(mask), -1), mask.sum(1)[:, None])
    return order.gather(1, at).view(draw.shape)
