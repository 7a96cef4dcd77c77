"""Rollouts that the ranks share, where an environment takes long (`Bounded`)."""

from typing import Any

import torch
from torch import Tensor

from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground import distributed as ranks
from cgtorch.ground.environment import Bounded, Environment
from cgtorch.simulation.rollout import MAX_TRANSITIONS, rollout
from cgtorch.simulation.torch_engine import Rollouts


def shared_rollout(
    graphs: Graphs,
    actions: ActionSet,
    environment: Environment,
    *,
    max_transitions: int = MAX_TRANSITIONS,
) -> Rollouts:
    """`rollout` of P graphs on all B scenarios, with the same result on all ranks.

    All ranks must call this with the same arguments. In an environment that is `Bounded`, each runs
    a share of the graphs, or of the scenarios if these are more; in others each runs everything.
    """
    sizes = len(graphs), environment.num_scenarios
    if ranks.count() == 1 or not isinstance(environment, Bounded):
        return rollout(graphs, actions, environment, max_transitions=max_transitions)
    dim = int(sizes[1] > sizes[0])
    mine, scenarios = ranks.share(sizes[dim]), torch.arange(sizes[1])
    if dim:
        scenarios = scenarios[mine]
    else:
        graphs = graphs[mine]
    how: dict[str, Any] = {"scenarios": scenarios, "max_transitions": max_transitions}
    part = rollout(graphs, actions, environment, **how)
    whole: dict[str, Any] = {"executed": ranks.all_reduce(part.executed)}
    for name, column in vars(part).items():
        if isinstance(column, Tensor):
            gathered = ranks.all_gather(column.transpose(0, dim), sizes[dim])
            whole[name] = gathered.transpose(0, dim).contiguous()
    return Rollouts(**whole)
