"""What the models promise of a skill, to be held against what the world says."""

import torch
from torch import Generator, Tensor

from cgtorch.graphs import Skill
from cgtorch.improvement.knowledge import Knowledge, imagine
from cgtorch.simulation import rollout

REPLICAS = 8


def promised(
    skill: Skill,
    knowledge: Knowledge,
    percepts: Tensor,
    footprint: Tensor,
    generator: Generator,
    replicas: int = REPLICAS,
) -> Tensor:
    """Where a skill succeeds in the models under each of several draws of Γ's errors.

    Args:
        skill: what is run.
        knowledge: the models.
        percepts: (B, D) first percepts.
        footprint: (4,) of the base (m).
        generator: of the errors, others than those that the skill was evolved under.
        replicas: how often each scenario is run.

    Returns:
        (B,) bool.
    """
    environment = imagine(knowledge, percepts, footprint, replicas, generator)
    with torch.no_grad():
        runs = rollout(
            skill.graph, skill.actions, environment, max_transitions=skill.max_transitions
        )
    return runs.succeeded.view(len(percepts), replicas).all(1)
