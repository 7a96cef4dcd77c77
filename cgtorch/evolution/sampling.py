"""Choices for a whole population at once, as functions of uniform numbers drawn before."""

import torch
from torch import Tensor


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
    at = pick(draw.flatten(1), mask.sum(1)[:, None])
    return order.gather(1, at).view(draw.shape)
