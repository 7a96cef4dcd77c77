"""What the engine runs: every node of every graph and sub-skill in one table."""

import ctypes
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.actions import Action, ActionSet
from cgtorch.actions.memory import memory_parts
from cgtorch.errors import GraphError
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
    """Lay out a population for `rollout`.

    Raises:
        GraphError: a graph has an action, a head or a start that is none of its own.
    """
    known, device = _vocabulary(actions), graphs.start.device
    tables, offset, entry = [_table(graphs, actions, 0, known)], graphs.action.numel(), []
    for skill in known.skills:
        tables.append(_table(skill.graph, skill.actions, offset, known))
        entry.append(int(tables[-1][0]))
        offset += skill.graph.action.numel()
    _, kind, heads, parameters = (
        torch.cat(parts) if entry else parts[0] for parts in zip(*tables, strict=True)
    )
    return Program(
        primitives=known.primitives,
        kind=kind,
        heads=heads,
        parameters=parameters,
        nodes=graphs.capacity,
        start=tables[0][0],
        entry=torch.tensor(entry, dtype=torch.long, device=device),
        limit=torch.tensor(known.limits, dtype=torch.long, device=device),
        depth=known.depth,
        message_size=known.message_size,
        memory=known.memory,
        memory_size=known.memory_size,
    )


@dataclass(frozen=True)
class _Vocabulary:
    """What a program needs to know of an action set and of all sub-skills in it.

    Attributes:
        skills: the sub-skills, also those within others, each once.
        primitives: see `Program`, as what is not said here.
        numbers: in place of actions, by their identity, what `Program.kind` says of them.
        outcomes: of the action with most.
        width: parameters of the action with most.
        limits: the most transitions of each sub-skill.
    """

    skills: tuple[Skill, ...]
    primitives: tuple[Action, ...]
    numbers: dict[int, int]
    outcomes: int
    width: int
    limits: tuple[int, ...]
    depth: int
    message_size: int
    memory: tuple[slice, ...]
    memory_size: int


@lru_cache(maxsize=16)  # an evolution asks once in every generation
def _vocabulary(actions: ActionSet) -> _Vocabulary:
    skills = _skills(actions, {})
    sets = [actions, *(s.actions for s in skills.values())]
    own = {id(a): a for s in sets for a in s.actions if not isinstance(a, SubSkill)}
    places = {id(s): len(own) + i for i, s in enumerate(skills.values())}
    numbers = {key: i for i, key in enumerate(own)}
    uses = [a for s in sets for a in s.actions if isinstance(a, SubSkill)]
    memory, memory_size = memory_parts(list(own.values()))
    return _Vocabulary(
        skills=tuple(skills.values()),
        primitives=tuple(own.values()),
        numbers=numbers | {id(a): places[id(a.skill)] for a in uses},
        outcomes=max(2, *(s.outcome_capacity for s in sets)),
        width=max(s.parameter_capacity for s in sets),
        limits=tuple(s.max_transitions for s in skills.values()),
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
    graphs: Graphs, actions: ActionSet, offset: int, known: _Vocabulary
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Starts (P,), and kinds (P·N,), heads (P·N, outcomes) and parameters (P·N, width) of nodes."""
    device = graphs.action.device
    kinds = torch.tensor([known.numbers[id(a)] for a in actions.actions], device=device)
    ends = torch.where(actions.succeeds[:, : graphs.edges.shape[2]], SUCCESS, FAILURE).to(device)
    given = graphs, kinds, ends, offset, known.outcomes
    laid_out = _laid_out(*given) or _laid_out_in_torch(*given)
    parameters = graphs.parameters.flatten(0, 1)
    # Slots that nothing of this graph uses: padding a population costs no more than this.
    if more := known.width - parameters.shape[1]:
        parameters = pad(parameters, (0, more))
    return *laid_out, parameters


def _laid_out_in_torch(
    graphs: Graphs, kinds: Tensor, ends: Tensor, offset: int, outcomes: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Starts, kinds and heads, given kinds (A,) of actions and ends (A, O) of their outcomes."""
    p, n, o = graphs.edges.shape
    _check(graphs, len(kinds))
    action = graphs.action.clamp_min(0)
    base = offset + torch.arange(p, device=action.device) * n
    heads = torch.where(graphs.edges == NO_NODE, ends[action], graphs.edges + base[:, None, None])
    if more := outcomes - o:
        heads = pad(heads, (0, more), value=FAILURE)
    return base + graphs.start, kinds[action].flatten(), heads.flatten(0, 1)


def _laid_out(
    graphs: Graphs, kinds: Tensor, ends: Tensor, offset: int, outcomes: int
) -> tuple[Tensor, Tensor, Tensor] | None:
    """The same, compiled, where that is possible."""
    call = function("lay_out", torch.float32, POINTER, WHOLE)
    given = *(x.contiguous() for x in (graphs.action, graphs.edges, graphs.start)), kinds, ends
    p, n, o = graphs.edges.shape
    if call is None or not all(t.dtype == torch.long and t.is_cpu for t in given):
        return None
    if ends.shape[1] != o:
        return None
    kind, start = given[0].new_empty(p * n), given[0].new_empty(p)
    heads = given[0].new_empty(p * n, outcomes)
    tables = structures(torch.float32).Tables(
        *(t.data_ptr() for t in given), p, n, o, len(kinds), outcomes, offset,
        *(t.data_ptr() for t in (kind, heads, start)), 0,
    )  # fmt: skip
    if call(ctypes.addressof(tables), max(1, min(threads(), p * n // WORTH_SHARING))):
        _check(graphs, len(kinds))
    return start, kind, heads


def _check(graphs: Graphs, actions: int) -> None:
    """GraphError where a number stands for no action or no node of its graph."""
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
