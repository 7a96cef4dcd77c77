"""The common memory of a lane: which part of it is whose."""

import itertools
from collections.abc import Sequence

from cgtorch.actions.action import Action


def memory_parts(actions: Sequence[Action]) -> tuple[tuple[slice, ...], int]:
    """Where the part of each action, given once, in the common memory lies, and how long it is."""
    owner = [action.memory_part or id(action) for action in actions]
    sizes: dict[str | int, int] = {}
    for who, action in zip(owner, actions, strict=True):
        sizes[who] = max(sizes.get(who, 0), action.memory_size)
    ends = dict(zip(sizes, itertools.accumulate(sizes.values()), strict=True))
    parts = tuple(slice(ends[who] - sizes[who], ends[who]) for who in owner)
    return parts, sum(sizes.values())
