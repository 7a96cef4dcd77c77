"""Robust success: success under all of several sampled errors of the models."""

from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch.domains.domain import Domain
from cgtorch.domains.knowledge import Knowledge
from cgtorch.graphs import Skill
from cgtorch.simulation import rollout

REPLICAS = 8


def robust_success(
    domain: Domain[Any],
    skill: Skill,
    knowledge: Knowledge,
    percepts: Tensor,
    generator: Generator,
    replicas: int = REPLICAS,
) -> Tensor:
    """(B,) bool, whether a skill succeeds from percepts (B, D) under all of several new errors."""
    environment = domain.imagine(knowledge, percepts, replicas, generator)
    with torch.no_grad():
        runs = rollout(
            skill.graph, skill.actions, environment, max_transitions=skill.max_transitions
        )
    return runs.succeeded.view(len(percepts), replicas).all(1)
