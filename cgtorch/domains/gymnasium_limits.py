"""Bounds of the numbers of observations, and which numbers of actions count only by comparison."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cgtorch.domains.gymnasium_spaces import FAR, Percepts, parts_of

SLACK = 1e-3  # what numbers may be beyond their bounds by rounding, as a share of the range


def bounds_of_percepts(percepts: Percepts) -> tuple[Tensor, Tensor]:
    """The smallest and the largest possible numbers (D,) of observations, infinite if not known."""
    from gymnasium.spaces import Box, flatdim

    low, high = list[NDArray[Any]](), list[NDArray[Any]]()
    for part in percepts.parts:
        space = part.space
        if isinstance(space, Box):
            # In float64, as floats of half the usual size have no FAR.
            below, above = (end.ravel().astype(np.float64) for end in (space.low, space.high))
            low.append(np.where(below > -FAR, below, -np.inf))
            high.append(np.where(above < FAR, above, np.inf))
        else:  # choices and bits
            low.append(np.zeros(flatdim(space)))
            high.append(np.ones(flatdim(space)))
    ends = (torch.from_numpy(np.concatenate(each)) for each in (low, high))
    least, most = (each if percepts.columns is None else each[percepts.columns] for each in ends)
    return least, most


def beyond(low: Tensor, high: Tensor, least: Tensor, most: Tensor) -> tuple[Tensor, Tensor]:
    """(D,) bool each, whether the least and the most that was seen are clearly beyond bounds."""
    width = high - low
    slack = SLACK * torch.where(width.isfinite(), width, 1.0)
    return least < low - slack, most > high + slack


@dataclass(frozen=True)
class Effects:
    """Which of the U numbers of a control count only by comparison.

    Attributes:
        choices: The first number of each choice, and the one after its last; the largest counts.
        bits: Numbers of which only the sign counts.
    """

    choices: tuple[tuple[int, int], ...]
    bits: tuple[int, ...]

    @classmethod
    def of(cls, space: Any) -> "Effects":
        """Those of an action space that `controls_of` supports."""
        from gymnasium.spaces import Discrete, MultiBinary, MultiDiscrete

        choices, bits, begin = list[tuple[int, int]](), list[int](), 0
        for part in parts_of(space, "action"):
            own = part.space
            if isinstance(own, Discrete | MultiDiscrete):
                for count in [own.n] if isinstance(own, Discrete) else own.nvec.ravel():
                    choices.append((begin, begin + int(count)))
                    begin += int(count)
            elif isinstance(own, MultiBinary):
                size = int(np.prod(own.shape))
                bits += range(begin, begin + size)
                begin += size
            else:
                begin += int((own.low < own.high).sum())
        return cls(tuple(choices), tuple(bits))

    def applied(self, control: Tensor) -> Tensor:
        """Controls (n, U) with 1 for what is chosen, else 0, and other numbers as they are."""
        control = control.clone()
        for begin, end in self.choices:
            chosen = control[:, begin:end].argmax(1)
            control[:, begin:end] = torch.nn.functional.one_hot(chosen, end - begin).to(control)
        for bit in self.bits:
            control[:, bit] = (control[:, bit] > 0).to(control)
        return control
