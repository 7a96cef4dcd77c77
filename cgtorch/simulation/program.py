"""What the engine runs: every node of every graph and sub-skill in one table."""

import ctypes
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.actions import Action, ActionSet
from cgtorch.actions.memory import memory_parts
from cgtorch.graphs import NO_NODE, Graphs, Skill, SubSkill
from cgtorch.native import function, threads
from cgtorch.native.structures import POINTER, WHOLE, structures

SUCCESS, FAILURE = -1, -2
WORTH_SHARING = 2**16
"""Nodes that are worth one more thread: about a quarter of a millisecond."""


@dataclass(frozen=True)
class Program:
    """P graphs and the sub-skills they use, as one table of T nodes.

    Heads are rows of the table, or `SUCCESS` or `FAILURE` where an outcome ends the graph it is
    in. A sub-skill is stored once however many nodes use it.

    Attributes:
        primitives: the actions that run as one step, without duplicates.
        kind: (T,) long, index into `primitives`, or len(primitives) + sub-skill index.
        heads: (T, O) long.
        parameters: (T, K) float.
        nodes: slots of each graph; those of the first graph come first.
        start: (P,) long, first node of each graph.
        entry: (number of sub-skills,) long, first node of each sub-skill.
        limit: (number of sub-skills,) long, the most transitions of each.
        depth: levels of skills within skills, 1 if there are none.
        message_size: length of the longest message.
        memory: where each primitive's part of the common memory lies.
        memory_size: length of all of it.
    """

    primitives: tuple[Action, ...]
    kind: Tensor
    heads: Tensor
    parameters: Tensor
    nodes: int
    start: Tensor
    entry: Tensor
    limit: Tensor
    depth: int
    message_size: int
    memory: tuple[slice, ...]
    memory_size: int


def compile_graphs(graphs: Graphs, actions: ActionSet) -> Program:
    """Lay out a population for `rollout`."""
    skills = _skills(actions, {})
    sets = [actions, *(s.actions for s in skills.values())]
    primitives = list(
        {id(a): a for s in sets for a in s.actions if not isinstance(a, SubSkill)}.values()
    )
    order = {id(a): i for i, a in enumerate(primitives)}
    index = {id(s): len(primitives) + i for i, s in enumerate(skills.values())}
    memory, memory_size = memory_parts(primitives)
    outcomes = max(2, *(s.outcome_capacity for s in sets))
    width = max(s.parameter_capacity for s in sets)

    tables = [_table(graphs, actions, 0, outcomes, width, order, index)]
    offset, entry = graphs.action.numel(), []
    for skill in skills.values():
        tables.append(_table(skill.graph, skill.actions, offset, outcomes, width, order, index))
        entry.append(offset + int(skill.graph.start[0]))
        offset += skill.graph.action.numel()
    kind, heads, parameters = (
        torch.cat(parts) if skills else parts[0] for parts in zip(*tables, strict=True)
    )
    rows = torch.arange(len(graphs), device=graphs.start.device) * graphs.capacity
    return Program(
        primitives=tuple(primitives),
        kind=kind,
        heads=heads,
        parameters=parameters,
        nodes=graphs.capacity,
        start=rows + graphs.start,
        entry=torch.tensor(entry, dtype=torch.long, device=kind.device),
        limit=torch.tensor(
            [s.max_transitions for s in skills.values()], dtype=torch.long, device=kind.device
        ),
        depth=1 + max((s.depth for s in skills.values()), default=0),
        message_size=max(s.message_size for s in sets),
        memory=memory,
        memory_size=memory_size,
    )


def _skills(actions: ActionSet, found: dict[int, Skill]) -> dict[int, Skill]:
    """All sub-skills of an action set, also those within others, each once."""
    for action in actions.actions:
        if isinstance(action, SubSkill) and id(action.skill) not in found:
            found[id(action.skill)] = action.skill
            _skills(action.skill.actions, found)
    return found


def _table(
    graphs: Graphs,
    actions: ActionSet,
    offset: int,
    outcomes: int,
    width: int,
    order: dict[int, int],
    index: dict[int, int],
) -> tuple[Tensor, Tensor, Tensor]:
    """Kinds (P·N,), heads (P·N, outcomes) and parameters (P·N, width) of the nodes of `graphs`."""
    device = graphs.action.device
    kinds = torch.tensor(
        [index[id(a.skill)] if isinstance(a, SubSkill) else order[id(a)] for a in actions.actions],
        device=device,
    )
    o = graphs.edges.shape[2]
    ends = torch.where(actions.succeeds[:, :o], SUCCESS, FAILURE).to(device)
    given = graphs, kinds, ends, offset, outcomes
    kind, heads = _laid_out(*given) or _laid_out_in_torch(*given)
    parameters = graphs.parameters.flatten(0, 1)
    # Slots that nothing of this graph uses: padding a population costs no more than this.
    if more := width - parameters.shape[1]:
        parameters = pad(parameters, (0, more))
    return kind, heads, parameters


def _laid_out_in_torch(
    graphs: Graphs, kinds: Tensor, ends: Tensor, offset: int, outcomes: int
) -> tuple[Tensor, Tensor]:
    """Kinds and heads, given kinds (A,) of all actions and the ends (A, O) of their outcomes."""
    p, n, o = graphs.edges.shape
    action = graphs.action.clamp_min(0)
    base = offset + torch.arange(p, device=action.device)[:, None, None] * n
    heads = torch.where(graphs.edges == NO_NODE, ends[action], graphs.edges + base)
    if more := outcomes - o:
        heads = pad(heads, (0, more), value=FAILURE)
    return kinds[action].flatten(), heads.flatten(0, 1)


def _laid_out(
    graphs: Graphs, kinds: Tensor, ends: Tensor, offset: int, outcomes: int
) -> tuple[Tensor, Tensor] | None:
    """The same, compiled, where that is possible."""
    call = function("program", "lay_out", torch.float32, POINTER, WHOLE)
    action, edges, ends = graphs.action.contiguous(), graphs.edges.contiguous(), ends.contiguous()
    if call is None or not all(t.dtype == torch.long and t.is_cpu for t in (action, edges, ends)):
        return None
    p, n, o = edges.shape
    if ends.shape[1] != o:
        return None
    kind = torch.empty(p * n, dtype=torch.long)
    heads = kind.new_empty(p * n, outcomes)
    pointers = (t.data_ptr() for t in (action, edges, kinds, ends))
    tables = structures(torch.float32).Tables(
        *pointers, p, n, o, outcomes, offset, kind.data_ptr(), heads.data_ptr()
    )
    call(ctypes.addressof(tables), max(1, min(threads(), p * n // WORTH_SHARING)))
    return kind, heads
