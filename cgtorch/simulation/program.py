"""The engine's program: all actions, and all nodes of all graphs and sub-skills in one table."""

from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.graphs import NO_NODE, Action, ActionSet, Graphs, Skill, SubSkill
from cgtorch.graphs.action import memory_parts
from cgtorch.ground.errors import GraphError

SUCCESS, FAILURE, TIMEOUT = -1, -2, -3
"""Negative heads: how a graph ends, in place of the next node."""


@dataclass(frozen=True)
class ActionTable:
    """The actions and sub-skills of an action set, with the sizes that a program needs."""

    skills: tuple[Skill, ...]  # the sub-skills at all levels, each once
    primitives: tuple[Action, ...]  # the actions that run as one step, each once
    numbers: dict[int, int]  # for an action's identity, its index among primitives, then skills
    outcomes: int  # the largest number of outcomes of an action
    width: int  # the largest number of parameters of an action
    limits: tuple[int, ...]  # the maximum number of transitions of each sub-skill
    depth: int  # levels of skills within skills, 1 without sub-skills
    message_size: int  # the length of the longest message
    memory: tuple[slice, ...]  # the part of the common memory of each primitive
    memory_size: int  # the length of the common memory

    def kinds(self, actions: ActionSet) -> Tensor:
        """(A,) long, the table's numbers of an action set's actions."""
        return torch.tensor([self.numbers[id(a)] for a in actions.actions])


def ends(actions: ActionSet) -> Tensor:
    """(A, O) long, `SUCCESS` or `FAILURE`: how a graph ends by an outcome that has no edge."""
    return torch.where(actions.succeeds, SUCCESS, FAILURE)


@lru_cache(maxsize=16)  # in torch every generation needs it
def action_table(actions: ActionSet) -> ActionTable:
    """The table of an action set."""
    skills = tuple(_skills(actions, {}).values())
    sets = [actions, *(s.actions for s in skills)]
    every = {id(a): a for s in sets for a in s.actions}
    primitives = [a for a in every.values() if not isinstance(a, SubSkill)]
    place = {id(a): i for i, a in enumerate([*primitives, *skills])}
    memory, memory_size = memory_parts(primitives)
    return ActionTable(
        skills=skills,
        primitives=tuple(primitives),
        numbers={
            key: place[id(a.skill) if isinstance(a, SubSkill) else key] for key, a in every.items()
        },
        outcomes=max(2, *(s.outcome_capacity for s in sets)),
        width=max(s.parameter_capacity for s in sets),
        limits=tuple(s.max_transitions for s in skills),
        depth=1 + max((s.depth for s in skills), default=0),
        message_size=max(s.message_size for s in sets),
        memory=memory,
        memory_size=memory_size,
    )


def _skills(actions: ActionSet, found: dict[int, Skill]) -> dict[int, Skill]:
    """All sub-skills of an action set, at every level, each once."""
    for action in actions.actions:
        if isinstance(action, SubSkill) and id(action.skill) not in found:
            found[id(action.skill)] = action.skill
            _skills(action.skill.actions, found)
    return found


Table: TypeAlias = tuple[Tensor, Tensor, Tensor]
"""Kinds (T,), heads (T, O) and parameters (T, K) of nodes; see `Program`."""


@dataclass(frozen=True)
class Program:
    """P graphs and the sub-skills that they use, each stored once, in one table of T nodes.

    Attributes:
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
