"""Search problems: placements of the paper's table, met in the models of a finished run."""

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Generator

from cgtorch.graphs import ActionSet
from cgtorch.ground.environment import Environment
from cgtorch.improvement.trial import first_percepts
from cgtorch.runs.storage import load_knowledge
from cgtorch.runs.stored_run import read_run
from cgtorch.tabletop.domain import ACTIONS, SPECIALISTS


@dataclass(frozen=True)
class Problem:
    """What one graph shall solve.

    Attributes:
        networks: what nodes can be, and which of the placements a graph is for.
        placement: where the objects stand.
        drawn: how many placements are drawn.
        group: how many of them the graph is for.
        replicas: how often each is met, with different errors of Γ.
        cap: transitions after which a search is stopped.
    """

    networks: str
    placement: str
    drawn: int
    group: int
    replicas: int
    cap: int


PROBLEMS = {
    "broad": Problem("edge", "perimeter", 150, 16, 2, 2_500_000),
    "local": Problem("percept", "perimeter", 150, 12, 2, 2_500_000),
    "far": Problem("percept", "far", 30, 30, 1, 3_000_000),
    "perimeter": Problem("percept", "perimeter", 40, 40, 1, 2_000_000),
}
"""A specialist's group for networks in the edge's frame and for those of the paper; and for the
latter a whole edge, and the paper's forty placements."""


def pose(problem: Problem, run_folder: Path, seed: int) -> tuple[Environment, ActionSet]:
    """The problem of a seed in the models that a run began with, and what nodes can be."""
    run = read_run(run_folder)
    domain = run.domain
    knowledge = load_knowledge(run_folder / "start", run.models.unfitted())
    generator = Generator().manual_seed(1_000_003 * (seed + 1))
    world = domain.world(domain.draw(problem.placement, problem.drawn, generator))
    percepts = first_percepts(world)
    everyone = torch.ones(problem.drawn, dtype=torch.bool)
    group_of = SPECIALISTS[problem.networks].group_of
    rows = group_of(percepts, everyone, problem.group, generator)
    models = run.models.imagine(knowledge, percepts[rows], problem.replicas, generator)
    return models, ACTIONS[problem.networks](world.percept_size)
