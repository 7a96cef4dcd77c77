"""What random episodes of a Gymnasium environment have shown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Look:
    """What one random episode has shown.

    Attributes:
        percepts: Its numbers (D,), the first ones before its first step.
        rewards: One for each step.
        infos: The names in its infos.
        told: For names that were looked for, whether the info of each step had a true value.
        over: Whether it ended.
        cut: Whether it ended because it had become too long.
    """

    percepts: Sequence[NDArray[Any]]
    rewards: Sequence[float]
    infos: frozenset[str]
    told: Mapping[str, Sequence[bool]]
    over: bool
    cut: bool


@dataclass(frozen=True)
class Explored:
    """What random episodes have shown.

    These are percepts (N, D), rewards (M,), the names in infos, whether any episode ended, whether
    any became too long, and what their infos told (`Look.told`).
    """

    percepts: NDArray[Any]
    rewards: NDArray[np.float64]
    infos: tuple[str, ...]
    ended: bool
    cut: bool
    told: tuple[Mapping[str, Sequence[bool]], ...]

    @classmethod
    def joined(cls, looks: Sequence[Look]) -> Self:
        """What all of them have shown."""
        return cls(
            np.stack([seen for look in looks for seen in look.percepts]),
            np.array([reward for look in looks for reward in look.rewards]),
            tuple(sorted(frozenset[str]().union(*(look.infos for look in looks)))),
            any(look.over for look in looks),
            any(look.cut for look in looks),
            tuple(look.told for look in looks),
        )

    def solved(self, name: str, at_last: bool) -> int:
        """In how many episodes a name told of success, at the last step or at any."""
        steps = (list(told[name]) for told in self.told)
        return sum(any(each[-1:] if at_last else each) for each in steps)

    def solved_at_once(self, name: str) -> int:
        """In how many episodes a name told of success at the first step."""
        return sum(any(told[name][:1]) for told in self.told)
