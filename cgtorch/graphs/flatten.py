"""Flattening: a skill with nested skills as one graph of primitive actions.

A graph has no counters of transitions, so it has a copy of a node for every count that matters.
"""

from dataclasses import dataclass
from math import inf
from typing import TypeAlias

import torch

from cgtorch.graphs.action import Action
from cgtorch.graphs.action_set import ActionSet
from cgtorch.graphs.files import MAX_NODES
from cgtorch.graphs.graphs import NO_NODE, Graphs
from cgtorch.graphs.merge import merged
from cgtorch.graphs.networks import BranchingNN
from cgtorch.graphs.skill import Skill, SubSkill
from cgtorch.ground.errors import GraphError

Frame: TypeAlias = tuple[int, int, float]
"""The level, the slot of its node, and the transitions left; infinite if it cannot run out."""

Stack: TypeAlias = tuple[Frame, ...]
"""A node of the flat graph: frames of open levels, outermost first, without those around a frame
that cannot run out and so never returns."""


@dataclass(frozen=True)
class Level:
    """A skill as plain lists by slot.

    Attributes:
        skill: The skill.
        limit: Its number of transitions, or that of a whole run if this is smaller.
        start: The slot of its start node.
        sub: The level that a node enters, `NO_NODE` if it is no sub-skill.
        heads: The slots that outcomes lead to, `NO_NODE` for terminal ones; of a sub-skill, only
            that of its failure.
        cheapest: `[c][slot]` is the fewest actions in which a run makes c more transitions.
    """

    skill: Skill
    limit: int
    start: int
    sub: list[int]
    heads: list[list[int]]
    cheapest: list[list[float]]


def flattened(skill: Skill, max_transitions: int) -> Skill:
    """The same skill without nested skills.

    On any scenario, it behaves like the nested skill with at most `max_transitions` actions on all
    levels together (`max_steps` of `cgtorch.simulation.rollout`). One thing differs: where the
    nested skill runs out of transitions on the outermost level, the flat one stays at a
    `BranchingNN` that leads to itself until its own transitions are used up.

    Fewer actions need fewer nodes: a count is left out if its skill cannot run out before the whole
    does. Nodes that behave the same are merged. The flat skill has the same name, and the primitive
    actions of all levels, those of the outermost first.

    Raises:
        GraphError: An action ends a sub-skill without success; a name has different actions at
            different levels; the graph would have more nodes than a file may; or there is no
            `BranchingNN` to stay at.
    """
    levels = _add(skill, max_transitions, [])
    for level in levels[:-1]:
        _check_ends(level.skill)
    actions = _primitives(levels)
    graph = _graph(_nodes(levels, max_transitions), levels, actions, skill)
    return Skill(skill.name, merged(graph), actions, max_transitions)


def _nodes(levels: list[Level], most: int) -> dict[Stack | None, list[int]]:
    """All stacks that a run of `most` actions can reach, and where their outcomes lead.

    None is the state after the outermost level has run out of transitions.
    """
    outermost = len(levels) - 1, levels[-1].start, levels[-1].limit
    begin = _settled(_entered((outermost,), levels), 0, most, levels)
    row: dict[Stack | None, int] = {begin: 0}
    nodes: dict[Stack | None, list[int]] = {}
    wave: list[Stack | None] = [begin]
    for done in range(1, most + 1):
        for stack in wave:
            after = _after(stack, done, most, levels)
            for other in after:
                if other != () and row.setdefault(other, len(row)) >= MAX_NODES:
                    raise GraphError(
                        f"flat skill {levels[-1].skill.name!r} would have more than {MAX_NODES} "
                        "nodes; give fewer transitions or leave it nested"
                    )
            nodes[stack] = [NO_NODE if other == () else row[other] for other in after]
        wave = list(row)[len(nodes) :]
    return nodes


def _after(stack: Stack | None, done: int, most: int, levels: list[Level]) -> list[Stack | None]:
    """Where each outcome of action number `done` leads, () for a terminal one."""
    if stack is None:
        return [None, None]
    level, slot, _ = stack[-1]
    found: list[Stack | None] = []
    for head in levels[level].heads[slot]:
        after: Stack | None = ()
        if head != NO_NODE and done == most:
            after = stack  # no matter where, as nothing is executed any more
        elif head != NO_NODE:
            after = _followed(stack, head, levels)
            after = after and _settled(after, done, most, levels)
        found.append(after)
    return found


def _graph(
    nodes: dict[Stack | None, list[int]], levels: list[Level], actions: ActionSet, skill: Skill
) -> Graphs:
    """The nodes as one graph that starts at the first."""
    action = torch.full((1, len(nodes)), NO_NODE)
    edges = torch.full((1, len(nodes), actions.outcome_capacity), NO_NODE)
    parameters = skill.graph.parameters.new_zeros(1, len(nodes), actions.parameter_capacity)
    for i, (stack, heads) in enumerate(nodes.items()):
        edges[0, i, : len(heads)] = torch.tensor(heads, dtype=torch.long)
        if stack is None:
            action[0, i] = _idle(actions)
            continue
        inner, slot = levels[stack[-1][0]].skill, stack[-1][1]
        action[0, i] = kind = actions.index(inner.actions.names[inner.graph.action[0, slot]])
        count = int(actions.num_parameters[kind])
        parameters[0, i, :count] = inner.graph.parameters[0, slot, :count]
    return Graphs(action, edges, parameters, torch.zeros(1, dtype=torch.long))


def _add(skill: Skill, most: int, levels: list[Level]) -> list[Level]:
    """The levels with a skill and all in it, each once, after those that it contains."""
    for inner in skill.sub_skills.values():
        if all(level.skill is not inner for level in levels):
            _add(inner, most, levels)
    place = {id(level.skill): i for i, level in enumerate(levels)}
    actions, edges = skill.actions.actions, skill.graph.edges[0].tolist()
    sub, heads, cost = [], [], []
    for kind, to in zip(skill.graph.action[0].tolist(), edges, strict=True):
        action = actions[kind] if kind != NO_NODE else None
        if isinstance(action, SubSkill):
            inside = levels[place[id(action.skill)]]
            sub.append(place[id(action.skill)])
            heads.append(to[1:2])
            cost.append(inside.cheapest[inside.limit][inside.start])
        else:
            sub.append(NO_NODE)
            heads.append(to[: len(action.outcomes)] if action else [])
            cost.append(1.0)
    limit = min(skill.max_transitions, most)
    cheapest = [[0.0] * len(cost)]
    for _ in range(limit):
        then = [min((cheapest[-1][h] for h in to if h != NO_NODE), default=inf) for to in heads]
        cheapest.append([own + rest for own, rest in zip(cost, then, strict=True)])
    levels.append(Level(skill, limit, int(skill.graph.start[0]), sub, heads, cheapest))
    return levels


def _entered(stack: Stack, levels: list[Level]) -> Stack:
    """The stack after entering sub-skill nodes, through all levels."""
    while (sub := levels[stack[-1][0]].sub[stack[-1][1]]) != NO_NODE:
        stack = (*stack, (sub, levels[sub].start, levels[sub].limit))
    return stack


def _followed(stack: Stack, head: int, levels: list[Level]) -> Stack | None:
    """The stack after an outcome that leads to `head`; None if the outermost level has run out."""
    while stack:
        level, _, left = stack[-1]
        if left > 1:
            return _entered((*stack[:-1], (level, head, left - 1)), levels)
        stack = stack[:-1]
        if stack:
            head = levels[stack[-1][0]].heads[stack[-1][1]][0]
    return None


def _settled(stack: Stack, done: int, most: int, levels: list[Level]) -> Stack:
    """The stack without counts of frames that cannot run out after `done` actions of `most`."""
    least = float(done)
    for i in reversed(range(len(stack))):
        level, slot, left = stack[i]
        if left == inf:
            return stack
        if i == len(stack) - 1:
            least += levels[level].cheapest[int(left)][slot]
        else:
            least += levels[level].cheapest[int(left) - 1][levels[level].heads[slot][0]]
        if least >= most:
            return ((level, slot, inf), *stack[i + 1 :])
    return stack


def _idle(actions: ActionSet) -> int:
    """An action that changes nothing."""
    for i, action in enumerate(actions.actions):
        if isinstance(action, BranchingNN):
            return i
    raise GraphError(
        f"no BranchingNN among {', '.join(actions.names)} for a flat skill to idle at; give no "
        "more transitions than the nested skill has at its outermost level"
    )


def _primitives(levels: list[Level]) -> ActionSet:
    found: dict[str, Action] = {}
    for skill in (level.skill for level in reversed(levels)):
        for name, action in zip(skill.actions.names, skill.actions.actions, strict=True):
            if not isinstance(action, SubSkill) and found.setdefault(name, action) is not action:
                raise GraphError(
                    f"skill {skill.name!r} has another action {name!r} than the skill that it is "
                    "in; make both with the same actions"
                )
    return ActionSet(tuple(found), tuple(found.values()))


def _check_ends(skill: Skill) -> None:
    """Refuse a sub-skill that an action can end without success."""
    for name, action in skill.node_actions.items():
        for outcome, success in action.terminal.items():
            if not success:
                raise GraphError(
                    f"{name} ends sub-skill {skill.name!r} with outcome "
                    f"{outcome!r} and the skill that it is in goes on, which one graph cannot say; "
                    "leave it nested"
                )
