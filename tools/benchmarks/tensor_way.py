"""Rollouts in the usual tensor style: all actions for all lanes at each step, `torch.where`.

This is what a function of one lane becomes under vmap: a branch computes both of its sides, and no
lane can leave before the last one. The models, networks and numbers are the library's own, so only
the batching is compared. Γ and C see all lanes in one call per step.
"""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.graphs import NO_NODE, ActionSet, BranchingNN, ContinuousNN, Graphs
from cgtorch.graphs.networks import one_hidden_layer
from cgtorch.ground.environment import Lanes, start_lanes
from cgtorch.simulation import ModelEnvironment, Rollouts

NAMES = ("MoveBase", "Detect", "Grasp", "ContinuousNN", "BranchingNN")
MOVE, DETECT, GRASP, CONTINUOUS, BRANCHING = range(len(NAMES))


def tensor_rollout(
    graphs: Graphs, actions: ActionSet, environment: ModelEnvironment, max_transitions: int
) -> Rollouts:
    """Run P graphs of the paper's actions on all B scenarios, as `cgtorch.simulation.rollout`."""
    (p, n), b = graphs.action.shape, environment.num_scenarios
    modules = dict(zip(actions.names, actions.actions, strict=True))
    continuous, branching = modules["ContinuousNN"], modules["BranchingNN"]
    assert isinstance(continuous, ContinuousNN)  # noqa: S101
    assert isinstance(branching, BranchingNN)  # noqa: S101
    order = torch.tensor([NAMES.index(name) for name in actions.names])
    kinds = order[graphs.action.clamp_min(0)].flatten()
    heads, parameters = graphs.edges.flatten(0, 1), graphs.parameters.flatten(0, 1)
    first = (torch.arange(p) * n).repeat_interleave(b)
    lanes = start_lanes(environment, torch.arange(b).repeat(p), 3, 0)
    node = graphs.start.repeat_interleave(b)
    ended = torch.zeros(p * b, dtype=torch.bool)
    for _ in range(max_transitions):
        row = first + node
        kind, weights = kinds[row], parameters[row]
        percept, state, moved = _moves(environment, lanes)
        chance = environment.classifier(lanes.percept) * ~environment.lost(lanes)
        message = _network(continuous, lanes.percept, weights)
        branch = _network(branching, lanes.percept, weights).sigmoid()
        outcome = torch.where(kind == MOVE, ~moved, False)
        outcome = torch.where(kind == GRASP, chance <= 0.5, outcome)
        outcome = torch.where(kind == BRANCHING, branch[:, 1] > branch[:, 0], outcome)
        drives = ((kind == MOVE) & ~ended & moved)[:, None]
        speaks = (kind == CONTINUOUS) & ~ended
        lanes = replace(
            lanes,
            percept=torch.where(drives, percept, lanes.percept),
            state=torch.where(drives, state, lanes.state),
            message=torch.where(speaks[:, None], message, lanes.message),
            has_message=lanes.has_message | speaks,
            step=lanes.step + ~ended,
        )
        head = heads[row, outcome.long()]
        node = torch.where(ended | (head == NO_NODE), node, head)
        ended = ended | (head == NO_NODE)  # the only outcome without an edge is a grasp's success
    shape = (p, b)
    return Rollouts(
        succeeded=ended.view(shape),
        timed_out=~ended.view(shape),
        percept=lanes.percept.view(*shape, -1),
        state=lanes.state.view(*shape, -1),
        transitions=lanes.step.view(shape),
        executed=int(lanes.step.sum()),
    )


def _moves(environment: ModelEnvironment, lanes: Lanes) -> tuple[Tensor, Tensor, Tensor]:
    """Percepts (n, 7) and states (n, 3) if every lane moved, and (n,) bool whether it can."""
    free = environment.possible(lanes.percept, lanes.message)
    moved = lanes.has_message & ~environment.lost(lanes) & free
    percept, novelty = environment.gamma(lanes.percept, lanes.message)
    motions = lanes.state[:, 0]
    if environment.errors is not None:
        percept = (
            percept
            + environment.errors[lanes.scenario, motions.long() % environment.errors.shape[1]]
        )
    lost = (novelty > environment.most_novel).to(motions)
    return percept, torch.stack([motions + 1, lost, torch.full_like(lost, -1)], 1), moved


def _network(action: ContinuousNN | BranchingNN, percept: Tensor, weights: Tensor) -> Tensor:
    """(n, outputs) of each lane's own weights, of whatever action they really are."""
    return one_hidden_layer(
        percept, weights[:, : action.num_parameters], action.hidden, action.outputs
    )
