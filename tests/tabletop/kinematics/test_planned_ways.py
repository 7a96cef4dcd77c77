"""Planned ways beside a plain planner that asks for one edge after the other."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from test_clear_ways import wall
from torch import Tensor

from cgtorch.ground.counter_rng import uniform_from, words
from cgtorch.tabletop.kinematics import clear_ways
from cgtorch.tabletop.kinematics.arm_way import row_keys
from cgtorch.tabletop.kinematics.clear_ways import ROUNDS, VIAS, ways_clear, ways_planned

Posture = list[float]
Clear = Callable[[Posture, Posture], bool]


def apart(a: Posture, b: Posture) -> float:
    return math.sqrt(sum((x - y) * (x - y) for x, y in zip(a, b, strict=True)))


class Tree:
    """Postures that grow from the first one, each with its parent."""

    def __init__(self, root: Posture, clear: Clear, step: float) -> None:
        self.q, self.parent, self.clear, self.step = [root], [-1], clear, step

    def nearest(self, goal: Posture) -> int:
        return min(range(len(self.q)), key=lambda i: (apart(self.q[i], goal), i))

    def grown(self, node: int, goal: Posture) -> int:
        """The new node one step towards a goal, or -1."""
        here, away = self.q[node], apart(self.q[node], goal)
        share = self.step / away if away else math.inf
        there = goal
        if share < 1:
            there = [a + share * (b - a) for a, b in zip(here, goal, strict=True)]
        if not self.clear(here, there):
            return -1
        self.q.append(there)
        self.parent.append(node)
        return len(self.q) - 1

    def connected(self, goal: Posture) -> int:
        node = self.nearest(goal)
        while node >= 0 and apart(self.q[node], goal) > 0:
            node = self.grown(node, goal)
        return node

    def way_to(self, node: int) -> list[Posture]:
        """From the root to a node."""
        way = []
        while node >= 0:
            way.append(self.q[node])
            node = self.parent[node]
        return way[::-1]


def shortened(way: list[Posture], clear: Clear) -> list[Posture]:
    kept, at = way[:1], 0
    while at < len(way) - 1:
        at = next(n for n in range(len(way) - 1, at, -1) if n == at + 1 or clear(way[at], way[n]))
        kept.append(way[at])
    return kept if len(kept) <= VIAS else []


def plan(ends: Tensor, goals: Tensor, clear: Clear, step: float) -> list[Posture]:
    trees = [Tree(end, clear, step) for end in ends.tolist()]
    for turn, goal in enumerate(goals.tolist()):
        tree, other = trees[turn % 2], trees[1 - turn % 2]
        here = tree.grown(tree.nearest(goal), goal)
        there = other.connected(tree.q[here]) if here >= 0 else -1
        if there >= 0:
            one, two = (here, there) if turn % 2 == 0 else (there, here)
            whole = trees[0].way_to(one) + trees[1].way_to(two)[::-1][1:]
            return shortened(whole, clear)
    return []


@pytest.mark.parametrize("step", [clear_ways.STEP, 0.25])
def test_ways_are_those_of_a_plain_planner(
    pr2: Any, random_joints: Any, step: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm, scene, *about = wall(pr2, random_joints, rows=200)
    places, kind, ends = (each[:4] for each in about)
    key = row_keys(ends[:, 0, :3], ends[:, 1, :6], 1)
    monkeypatch.setattr(clear_ways, "STEP", step)
    ways, count = ways_planned(arm, scene, places, kind, ends, key)
    joints = ends.shape[2]
    low = torch.where(arm.continuous, ends.amin(1) - math.pi, arm.lower)
    high = torch.where(arm.continuous, ends.amax(1) + math.pi, arm.upper)
    draw = uniform_from(words(key[:, None], torch.arange(ROUNDS * joints))).double()
    goals = low[:, None] + draw.view(-1, ROUNDS, joints) * (high - low)[:, None]
    for row in range(len(ends)):

        def clear(a: Posture, b: Posture, one: slice = slice(row, row + 1)) -> bool:
            way = torch.tensor([[a, b]], dtype=torch.float64)
            return bool(ways_clear(arm, scene, places[one], kind[one], way))

        wanted = plan(ends[row], goals[row], clear, step)
        assert int(count[row]) == len(wanted)
        assert ways[row, : len(wanted)].tolist() == wanted
    assert int(count.max()) > 2


def test_a_tree_that_is_full_grows_no_further(
    pr2: Any, random_joints: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With steps so short that there is no room for all on a way, which is not found then."""
    arm, scene, *about = wall(pr2, random_joints, rows=200)
    places, kind, ends = (each[:4] for each in about)
    key = row_keys(ends[:, 0, :3], ends[:, 1, :6], 1)
    found = []
    for step in (0.05, 0.001):
        monkeypatch.setattr(clear_ways, "STEP", step)
        _, count = ways_planned(arm, scene, places, kind, ends, key)
        found.append(int((count > 0).sum()))
    assert found[0] > found[1] == 0
