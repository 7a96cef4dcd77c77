"""Merging nodes that behave the same, and finding skills that behave the same.

Graphs are minimised like automata, by refining a partition of the nodes (Moore 1956).
"""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.graphs.action import Action
from cgtorch.graphs.graphs import NO_NODE, Graphs, heads_in, resized, without
from cgtorch.graphs.skill import Skill, SubSkill


def merged(graphs: Graphs) -> Graphs:
    """The same graphs with nodes of equal behaviour merged into the first of their slots.

    Two nodes behave the same if they have the same action, bitwise equal parameters, and outcomes
    that lead to nodes that behave the same. No smaller graph behaves the same.
    """
    label = node_classes(graphs)
    slot = torch.arange(graphs.capacity, device=label.device).expand_as(label)
    first = torch.full((label.numel(),), graphs.capacity, device=label.device)
    first.scatter_reduce_(0, label.flatten(), slot.flatten(), "amin")
    stands = first[label]
    start = stands.gather(1, graphs.start[:, None])[:, 0]
    return without(
        replace(graphs, edges=heads_in(graphs.edges, stands), start=start), stands != slot
    )


def node_classes(graphs: Graphs) -> Tensor:
    """(P, N) long, equal numbers for nodes of one graph that behave the same.

    Numbers start at 0 in each graph; all unused slots of a graph have the same.
    """
    number = torch.arange(len(graphs), device=graphs.action.device)[:, None].expand_as(
        graphs.action
    )
    bits = torch.int64 if graphs.parameters.element_size() == 8 else torch.int32
    parameters = graphs.parameters.view(bits).long()  # which tells 0.0 from -0.0
    label = _numbered(torch.cat([number[..., None], graphs.action[..., None], parameters], 2))
    while True:
        finer = _numbered(torch.cat([label[..., None], heads_in(graphs.edges, label)], 2))
        if torch.equal(finer, label):
            return label
        label = finer


def _numbered(keys: Tensor) -> Tensor:
    """(P, N) long, the rank of each key (P, N, ·) among the sorted distinct keys."""
    return torch.unique(keys.flatten(0, 1), dim=0, return_inverse=True)[1].view(keys.shape[:2])


def same_behaviour(first: Skill, second: Skill) -> bool:
    """Whether two skills do the same in the same number of transitions, whatever their names.

    Actions are the same if they are the same modules, sub-skills if they behave the same.
    """
    if first is second:
        return True
    if first.max_transitions != second.max_transitions:
        return False
    a, b = first.graph, second.graph
    o, k = (
        max(x.shape[2], y.shape[2]) for x, y in ((a.edges, b.edges), (a.parameters, b.parameters))
    )
    a, b = resized(a, a.capacity, o, k), resized(b, b.capacity, o, k)
    kind = torch.tensor([_index(first, action) for action in second.actions.actions])
    action = torch.where(b.used, kind.to(b.action.device)[b.action.clamp_min(0)], NO_NODE)
    edges = torch.where(b.edges == NO_NODE, NO_NODE, b.edges + a.capacity)
    both = Graphs(
        torch.cat([a.action, action], 1),
        torch.cat([a.edges, edges], 1),
        torch.cat([a.parameters, b.parameters], 1),
        a.start,
    )
    label = node_classes(both)[0]
    return bool(label[a.start] == label[b.start + a.capacity])


def _index(skill: Skill, action: Action) -> int:
    """The index of the same action in a skill's set, or the set's length if there is none."""
    for i, own in enumerate(skill.actions.actions):
        if own is action or (
            isinstance(own, SubSkill)
            and isinstance(action, SubSkill)
            and same_behaviour(own.skill, action.skill)
        ):
            return i
    return len(skill.actions)
