"""A domain that gives rewards: who walks loses by how far from the middle of a path he is."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import networkx as nx
import torch
from support import seeded
from torch import Generator, Tensor

from cgtorch import Domain, Field, Pictures, ScenarioBatch, World
from cgtorch.graphs import ActionSet, BranchingNN, ContinuousNN, Graphs, Step, Test, from_networkx
from cgtorch.graphs.view import View
from cgtorch.ground.environment import Lanes

END = 3.0  # m from the middle, where one falls
NEAR = 0.5  # m from the middle, where one should be at the end
PLACE, AGE, LENGTH, GAINED = range(4)


@dataclass(frozen=True)
class Walks(ScenarioBatch):
    """Where walks begin, and how many steps they have."""

    place: Tensor
    length: Tensor


def walks(count: int, generator: Generator, longest: int = 12) -> Walks:
    """Random walks of at least one step."""
    place = 4 * torch.rand(count, generator=generator) - 2
    return Walks(place, torch.randint(1, longest + 1, (count,), generator=generator).float())


class Path(World):
    """The path, as one that gives no rewards and has no end."""

    control_size = 1

    def first_state(self, scenario: Tensor) -> Tensor:
        place, length = self.scenarios.place[scenario], self.scenarios.length[scenario]
        return torch.stack([place, torch.zeros_like(place), length, torch.zeros_like(place)], 1)

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        place = state[:, PLACE] + control[:, 0].clamp(-1, 1)
        gained = state[:, GAINED] - place.abs()
        return torch.stack([place, state[:, AGE] + 1, state[:, LENGTH], gained], 1)

    def succeeded(self, state: Tensor) -> Tensor:
        return state[:, PLACE].abs() < NEAR

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        return state[:, : AGE + 1]


def is_over(state: Tensor) -> Tensor:
    """(n,) bool, whether walks in states (n, 4) have come to their end."""
    return (state[:, AGE] >= state[:, LENGTH]) | (state[:, PLACE].abs() > END)


class RewardedPath(Path):
    """The path with its rewards; a walk ends in time, or by a fall."""

    def over(self, lanes: Lanes) -> Tensor:
        return is_over(lanes.state)

    def returns(self, lanes: Lanes) -> Tensor:
        return lanes.state[:, GAINED]


class TinyPath(RewardedPath):
    """A path with rewards in a tiny unit."""

    unit = 2.0**-40

    def returns(self, lanes: Lanes) -> Tensor:
        return self.unit * super().returns(lanes)


class CountedPath(RewardedPath):
    """A path that counts the lanes that begin."""

    begun = 0

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        self.begun += len(scenario)
        return super().start(scenario)


class FewPaths(CountedPath):
    """One on which few lanes run at once."""

    most_lanes = 8


def walking_actions() -> ActionSet:
    """A network that aims, a step, a branch, and a test that ends a skill before the walk's end."""
    return ActionSet(
        ("Aim", "Step", "Branch", "Test"),
        (ContinuousNN(2, outputs=1), Step(1), BranchingNN(2), Test()),
    )


def path(seed: int, count: int, longest: int = 12) -> RewardedPath:
    return RewardedPath(walks(count, seeded(seed), longest))


def chain(
    actions: ActionSet,
    *names: str,
    speed: float = 0.0,
    edges: Mapping[tuple[int, str], int] | None = None,
) -> Graphs:
    """A graph of these nodes; outcomes lead to the next unless `edges` says; "Aim" sends speed."""
    view: View = nx.MultiDiGraph(start=0)
    for i, name in enumerate(names):
        count = actions.actions[actions.index(name)].num_parameters
        last = [speed] if name == "Aim" else [0.0] * min(1, count)
        view.add_node(i, action=name, parameters=[*[0.0] * (count - len(last)), *last])
    for i, name in enumerate(names):
        action = actions.actions[actions.index(name)]
        for outcome in action.outcomes:
            if outcome not in action.terminal:
                head = (edges or {}).get((i, outcome), (i + 1) % len(names))
                view.add_edge(i, head, outcome=outcome)
    return from_networkx(view, actions)


class Walking(Domain[Walks]):
    """Walks in a world that is searched itself; nobody has published anything of them."""

    percept = (Field("place", "m"), Field("age"))
    control = (Field("step", "m", -1, 1),)
    models = None
    target_return = -1.0

    def draw(self, kind: str, count: int, generator: Generator) -> Walks:
        return walks(count, generator, longest=5)

    def world(self, scenarios: Walks) -> RewardedPath:
        return RewardedPath(scenarios)


class ShortPictures(Pictures[Any]):
    """A drawing of a stage."""

    def stage(self, name: str) -> str:
        return '<svg class="stage-drawing" role="img" aria-label="short"><path d="M0 0"/></svg>'


class StagedWalking(Walking):
    """The same in a stage of its own, which has a drawing and no tests."""

    kinds = ("any", "short")
    stages: Mapping[str, str] = {"first": "short"}
    pictures = ShortPictures

    def draw(self, kind: str, count: int, generator: Generator) -> Walks:
        return walks(count, generator, longest=2 if kind == "short" else 5)
