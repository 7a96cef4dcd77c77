"""Steps of Gymnasium environments under a skill, beside a bare loop with the same actions."""

from functools import partial
from typing import Any

import torch
from torch import Generator, Tensor

import cgtorch
from benchmarks.measure import CPU, Comparison, Effort, Line, difference, in_turns, run_threads
from cgtorch.domains.gymnasium_episodes import MOST
from cgtorch.graphs import ActionSet, Graphs

ENVIRONMENTS = {"LunarLander-v3": 1000, "Hopper-v5": 1000}
"""Environments with the most steps of an episode; none of them steps many episodes in one call."""


def gymnasium_steps(effort: Effort) -> Line:
    """What is copied, checked and recorded of each step, and the rollout around it."""
    with run_threads(1):
        parts = tuple(_of(name, most, effort) for name, most in ENVIRONMENTS.items())
    return Line(
        name="gymnasium_steps",
        compared="steps of an environment under a linear policy, one thread / the same actions in "
        "a bare loop",
        unit="of the loop's speed",
        target=0.5,
        clock="CPU",
        threads=1,
        parts=parts,
    )


def _of(name: str, most: int, effort: Effort) -> Comparison:
    domain = cgtorch.make(f"gymnasium:{name}")
    scenarios = domain.draw(domain.kinds[0], MOST, Generator().manual_seed(0))
    world, actions = domain.world(scenarios), domain.actions()
    graph = linear_policy(actions)

    def ours() -> Tensor:
        runs = cgtorch.rollout(graph, actions, world, max_transitions=3 * most)
        assert runs.returns is not None  # noqa: S101  the domain has rewards
        return runs.returns[0]

    found = ours()
    played = [world._episodes._played[i] for i in range(MOST)]
    given = [(each.seed, [action for action, _ in each.actions]) for each in played]
    bare = partial(alone, played[0].environment, given)
    gap = difference(found, bare(), 1e-6)
    steps = sum(len(each) for _, each in given)
    ours_time, other = in_turns((ours, bare), effort.repeats, CPU)
    return Comparison(
        label=f"{name}, {steps} steps",
        ours=ours_time,
        other=other,
        ratio=other.median / ours_time.median,
        difference=gap,
        sizes={"steps": steps, "episodes": MOST},
        note=f"{steps / ours_time.median:.3g} steps/s, bare {steps / other.median:.3g}",
    )


def linear_policy(actions: ActionSet) -> Graphs:
    """A linear policy with weights of zero that acts again after each step."""
    place = {name: index for index, name in enumerate(actions.names)}
    size = max(action.num_parameters for action in actions.actions)
    outcomes = max(len(action.outcomes) for action in actions.actions)
    edges = torch.zeros(1, 2, outcomes, dtype=torch.long)
    edges[0, 0] = 1
    return Graphs(
        action=torch.tensor([[place["Linear"], place["Step"]]]),
        edges=edges,
        parameters=torch.zeros(1, 2, size),
        start=torch.zeros(1, dtype=torch.long),
    )


def alone(environment: Any, given: list[tuple[int, list[Any]]]) -> Tensor:
    """The returns of episodes whose actions are known, by nothing but the environment."""
    returns = []
    for seed, actions in given:
        environment.reset(seed=seed)
        returns.append(float(sum(environment.step(action)[1] for action in actions)))
    return torch.tensor(returns, dtype=torch.float64)
