"""Planning ways around obstacles between two postures, by two random trees that grow together.

Kuffner & LaValle, "RRT-Connect: an efficient approach to single-query path planning" (2000).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TypeAlias

import torch
from torch import Tensor

from cgtorch.ground.counter_rng import uniform_from, words
from cgtorch.native import constants, function, structure, threads
from cgtorch.native.interface import agree
from cgtorch.tabletop.kinematics.arm import ArmModel
from cgtorch.tabletop.kinematics.clear_ways import Places, ways_clear, ways_task
from cgtorch.tabletop.kinematics.scene import Scene

ROUNDS = 100
STEP = 0.7
"""The length of a tree's step, by all joints together, rad or m."""
NODES, VIAS = 512, 16
"""The largest number of postures in a tree, and of waypoints on a way, including its ends."""

_Clear: TypeAlias = Callable[[Tensor, Tensor], bool]


def ways_planned(
    arm: ArmModel, scene: Scene, places: Places, kind: Tensor, ends: Tensor, key: Tensor
) -> tuple[Tensor, Tensor]:
    """Ways (B, VIAS, n) between postures, and their numbers of waypoints (B,), 0 if none is found.

    Args:
        arm: The arm.
        scene: Its scene.
        places: (B,) the parts of the scene that differ by row.
        kind: (B,) long, the kinds of ways, such as `scene.REACH`.
        ends: (B, 2, n) where each way begins and ends, rad or m.
        key: (B,) long, of the random numbers of each row.
    """
    ends, places = ends.double(), places.to(ends.double())
    low, high = _bounds(arm, ends)
    task = ways_task(arm, scene, places, kind, ends)
    found = ends.new_zeros(len(ends), VIAS, ends.shape[2])
    count = torch.zeros(len(ends), dtype=torch.long)
    if task is None:
        for i in range(len(ends)):
            clear = partial(_clear, arm, scene, places[torch.tensor([i])], kind[i : i + 1])
            way = planned_in_torch(clear, ends[i], low[i], high[i], key[i])
            count[i] = len(way)
            found[i, : len(way)] = torch.stack(way) if way else 0.0
        return found, count
    agree(constants("plan_limits", torch.float64), {"MOST_NODES": NODES, "MOST_VIAS": VIAS})
    plans = structure("Plans", torch.float64)(
        ways=task, lower=low, upper=high, key=key, found=found, count=count, rounds=ROUNDS,
        step=STEP,
    )  # fmt: skip
    if function("ways_planned", torch.float64)(plans, max(1, min(threads(), len(ends)))):
        raise MemoryError("no memory to plan ways of arms; give the process more")
    return found, count


def _clear(arm: ArmModel, scene: Scene, places: Places, kind: Tensor, a: Tensor, b: Tensor) -> bool:
    """Whether the straight way between postures (n,) is clear, for one row."""
    return bool(ways_clear(arm, scene, places, kind, torch.stack([a, b])[None])[0])


def _bounds(arm: ArmModel, ends: Tensor) -> tuple[Tensor, Tensor]:
    """(B, n) bounds of random postures: limits, or half a turn beyond both ends."""
    low, high = arm.lower.to(ends).expand_as(ends[:, 0]), arm.upper.to(ends).expand_as(ends[:, 0])
    turns = arm.continuous.to(ends.device)
    low = torch.where(turns, ends.amin(1) - math.pi, low)
    return low.contiguous(), torch.where(turns, ends.amax(1) + math.pi, high).contiguous()


@dataclass
class _Tree:
    """Postures, and the index of each one's parent."""

    q: list[Tensor]
    parent: list[int] = field(default_factory=lambda: [-1])

    def nearest(self, goal: Tensor) -> int:
        return int((torch.stack(self.q) - goal).square().sum(1).argmin())

    def grown(self, clear: _Clear, node: int, goal: Tensor) -> int:
        """One step from a node towards a posture: the new node, or -1 if the way is not clear."""
        here = self.q[node]
        share = STEP / float((goal - here).norm())
        there = here + share * (goal - here) if share < 1 else goal
        if len(self.q) == NODES or not clear(here, there):
            return -1
        self.q.append(there)
        self.parent.append(node)
        return len(self.q) - 1

    def connected(self, clear: _Clear, goal: Tensor) -> int:
        """Steps towards a posture as long as the way is clear: the node there, or -1."""
        node = self.nearest(goal)
        while node >= 0 and float((self.q[node] - goal).norm()) > 0:
            node = self.grown(clear, node, goal)
        return node

    def up(self, node: int) -> list[Tensor]:
        """Postures from a node to the root."""
        way = []
        while node >= 0:
            way.append(self.q[node])
            node = self.parent[node]
        return way


def planned_in_torch(
    clear: _Clear, ends: Tensor, low: Tensor, high: Tensor, key: Tensor
) -> list[Tensor]:
    """The same for one row, posture by posture: (n,) each; empty if no way is found."""
    trees = _Tree([ends[0]]), _Tree([ends[1]])
    joint = torch.arange(ends.shape[1])
    for number in range(ROUNDS):
        one = number % 2
        draw = uniform_from(words(key, number * ends.shape[1] + joint)).to(ends)
        goal = low + draw * (high - low)
        here = trees[one].grown(clear, trees[one].nearest(goal), goal)
        if here < 0:
            continue
        there = trees[1 - one].connected(clear, trees[one].q[here])
        if there >= 0:
            nodes = (there, here) if one else (here, there)
            return _shortened(clear, trees[0].up(nodes[0])[::-1] + trees[1].up(nodes[1])[1:])
    return []


def _shortened(clear: _Clear, way: list[Tensor]) -> list[Tensor]:
    """A way without superfluous postures; empty if it still has too many."""
    at, kept = 0, way[:1]
    while at < len(way) - 1:
        later = range(len(way) - 1, at + 1, -1)
        at = next((i for i in later if clear(way[at], way[i])), at + 1)
        kept.append(way[at])
    return kept if len(kept) <= VIAS else []
