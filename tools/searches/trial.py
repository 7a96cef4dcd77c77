"""One search on one problem, measured."""

import time
from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

from torch import Generator

from cgtorch.evolution import Generation
from cgtorch.graphs import ActionSet
from cgtorch.ground.environment import Environment

Search: TypeAlias = Callable[[Environment, ActionSet, Generator], Iterator[Generation]]
"""Generations without end, from the models on a problem's scenarios and what nodes can be."""


def tried(
    search: Search, environment: Environment, actions: ActionSet, cap: int, seed: int
) -> dict[str, Any]:
    """What a search took and reached until the best solves all, or the cap is met, as JSON values.

    `steps` are [transitions, CPU seconds, share solved, fitness, nodes] wherever the best got
    better. The clock is that of the process, so that other work beside it counts little.
    """
    began, transitions, generations = time.process_time(), 0, 0
    steps: list[tuple[int, float, float, float, int]] = []
    for generation in search(environment, actions, Generator().manual_seed(seed)):
        transitions += generation.transitions
        generations += 1
        share = float(generation.succeeded.float().mean())
        fitness = generation.best
        if not steps or (share, fitness) > steps[-1][2:4]:
            nodes = int(generation.champion.graphs.num_nodes[0])
            steps.append((transitions, time.process_time() - began, share, fitness, nodes))
        if share == 1 or transitions >= cap:
            break
    _, _, share, fitness, nodes = steps[-1]
    return {
        "solved": share == 1,
        "share": share,
        "fitness": fitness,
        "nodes": nodes,
        "transitions": transitions,
        "generations": generations,
        "seconds": time.process_time() - began,
        "steps": [list(step) for step in steps],
    }
