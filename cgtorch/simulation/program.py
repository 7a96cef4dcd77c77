"""The engine's program: all nodes of all graphs and sub-skills in one table."""

from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.graphs import NO_NODE, ActionSet, Graphs
from cgtorch.ground.errors import GraphError
from cgtorch.simulation.action_table import FAILURE, ActionTable, action_table, ends

Table: TypeAlias = tuple[Tensor, Tensor, Tensor]
"""Kinds (T,), heads (T, O) and parameters (T, K) of nodes; see `Program`."""


@dataclass(frozen=True)
class Program:
    """P graphs and the sub-skills that they use, each stored once, in one table of T nodes.

    Attributes:
        actions: The actions of the graphs and of all sub-skills.
        kind: (T,) long, an index into `actions.primitives`, or their number + a sub-skill's index.
        heads: (T, O) long, rows of the table, or `SUCCESS` or `FAILURE` if an outcome ends the
            graph.
        parameters: (T, K) float.
        start: (P,) long, the first node of each graph.
        entry: (number of sub-skills,) long, the first node of each sub-skill.
        limit: (number of sub-skills,) long, the maximum number of transitions of each.
    """

    actions: ActionTable
    kind: Tensor
    heads: Tensor
    parameters: Tensor
    start: Tensor
    entry: Tensor
    limit: Tensor


def compile_graphs(graphs: Graphs, actions: ActionSet) -> Program:
    """Lay out graphs for `rollout`; GraphError if an action, a head or a start does not exist."""
    known, device = action_table(actions), graphs.start.device
    start, *mine = _table(graphs, actions, 0, known)
    tables, entry = skill_tables(known, graphs.action.numel(), device)
    kind, heads, parameters = (
        torch.cat(parts) if entry else parts[0] for parts in zip(mine, *tables, strict=True)
    )
    return Program(
        actions=known,
        kind=kind,
        heads=heads,
        parameters=parameters,
        start=start,
        entry=torch.tensor(entry, dtype=torch.long, device=device),
        limit=torch.tensor(known.limits, dtype=torch.long, device=device),
    )


def skill_tables(
    known: ActionTable, offset: int, device: torch.device
) -> tuple[list[Table], list[int]]:
    """Tables and first nodes of all sub-skills, one after the other from row `offset` on."""
    tables, entry = [], []
    for skill in known.skills:
        start, *table = _table(skill.graph.to(device), skill.actions, offset, known)
        tables.append((table[0], table[1], table[2]))
        entry.append(int(start))
        offset += skill.graph.action.numel()
    return tables, entry


def _table(
    graphs: Graphs, actions: ActionSet, offset: int, known: ActionTable
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Starts (P,), and kinds (P·N,), heads (P·N, outcomes) and parameters (P·N, width) of nodes."""
    check_numbers(graphs, len(actions))
    p, n, o = graphs.edges.shape
    action, device = graphs.action.clamp_min(0), graphs.action.device
    base = offset + torch.arange(p, device=device) * n
    end = ends(actions).to(device)[:, :o][action]
    heads = torch.where(graphs.edges == NO_NODE, end, graphs.edges + base[:, None, None])
    if more := known.outcomes - o:
        heads = pad(heads, (0, more), value=FAILURE)
    parameters = graphs.parameters.flatten(0, 1)
    # Slots that nothing of this graph uses: padding a population costs no more than this.
    if more := known.width - parameters.shape[1]:
        parameters = pad(parameters, (0, more))
    kind = known.kinds(actions).to(device)[action].flatten()
    return base + graphs.start, kind, heads.flatten(0, 1), parameters


def check_numbers(graphs: Graphs, actions: int) -> None:
    """GraphError if an action index or a head does not exist."""
    nodes = graphs.capacity
    for name, given, least, count in (
        ("action", graphs.action, NO_NODE, actions),
        ("head", graphs.edges, NO_NODE, nodes),
        ("start", graphs.start, 0, nodes),
    ):
        numbers = given[:, None].flatten(1)
        wrong = (numbers < least) | (numbers >= count)
        if wrong.any():
            graph = int(wrong.any(1).nonzero()[0])
            number = int(numbers[graph][wrong[graph]][0])
            raise GraphError(
                f"graph {graph} has {name} {number}; give {least} to {count - 1} "
                "(`cgtorch.graphs.valid` tells which graphs are)"
            )
