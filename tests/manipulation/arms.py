"""Small domains of arms, which several tests use."""

from functools import cache

import torch

from cgtorch.graphs import Graphs
from cgtorch.manipulation.domain import Fetch, Manipulation, MetaWorld
from cgtorch.manipulation.settings import FetchSettings, ManipulationSettings
from cgtorch.manipulation.world import Starts


@cache
def meta_world(name: str = "push-v3", horizon: int = 200, task_id: str = "given") -> MetaWorld:
    """A domain of Meta-World; its environments are made once."""
    settings = ManipulationSettings(environment=name, horizon=horizon, task_id=task_id)
    return MetaWorld(settings)


@cache
def fetch(name: str = "FetchPush-v4") -> Fetch:
    """A domain of Gymnasium-Robotics."""
    return Fetch(FetchSettings(environment=name))


def starts(domain: Manipulation, *seeds: int, task: int = 0) -> Starts:
    """Starts of a task with these seeds."""
    return Starts(torch.full((len(seeds),), task), torch.tensor(seeds))


def chain(domain: Manipulation, *steps: tuple[str, tuple[float, ...]]) -> Graphs:
    """A graph that executes actions with parameters one after the other, in a circle."""
    actions = domain.actions()
    n, width = len(steps), actions.parameter_capacity
    action = torch.tensor([[actions.names.index(name) for name, _ in steps]])
    edges = torch.full((1, n, actions.outcome_capacity), -1)
    edges[0, :, 0] = (torch.arange(n) + 1) % n
    parameters = torch.zeros(1, n, width)
    for i, (_, values) in enumerate(steps):
        parameters[0, i, : len(values)] = torch.tensor(values)
    return Graphs(action, edges, parameters, torch.zeros(1, dtype=torch.long))
