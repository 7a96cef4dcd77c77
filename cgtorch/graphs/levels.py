"""Where a run of nested skills stands: a stack of frames, one for each level it is in."""

from dataclasses import dataclass
from math import inf
from typing import TypeAlias

from cgtorch.graphs.graphs import NO_NODE
from cgtorch.graphs.skill import Skill, SubSkill

Frame: TypeAlias = tuple[int, int, float]
"""Which level, the slot of its node, its transitions left; infinite if it cannot run out."""

Stack: TypeAlias = tuple[Frame, ...]
"""Frames, outermost first, without those around one that cannot run out and so never hands back."""


@dataclass(frozen=True)
class Level:
    """A skill as plain lists by slot.

    Attributes:
        skill: the skill.
        limit: its transitions, or those of a whole run if these are fewer.
        start: slot of its start node.
        sub: the level that a node enters, `NO_NODE` if it is no sub-skill.
        heads: slots that the outcomes lead to, `NO_NODE` for terminal ones; of a sub-skill only
            that of its failure.
        cheapest: [c][slot] the fewest actions with which a run makes c more transitions.
    """

    skill: Skill
    limit: int
    start: int
    sub: list[int]
    heads: list[list[int]]
    cheapest: list[list[float]]


def levels_of(skill: Skill, most: int) -> list[Level]:
    """The skill and all in it, each once and after those in it, for runs of `most` actions."""
    levels: list[Level] = []
    place: dict[int, int] = {}
    _add(skill, most, levels, place)
    return levels


def _add(skill: Skill, most: int, levels: list[Level], place: dict[int, int]) -> None:
    for inner in skill.sub_skills.values():
        if id(inner) not in place:
            _add(inner, most, levels, place)
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
    place[id(skill)] = len(levels)
    start = int(skill.graph.start[0])
    levels.append(Level(skill, limit, start, sub, heads, cheapest))


def entered(stack: Stack, levels: list[Level]) -> Stack:
    """The stack where a sub-skill node is gone into, as deep as it takes."""
    while (sub := levels[stack[-1][0]].sub[stack[-1][1]]) != NO_NODE:
        stack = (*stack, (sub, levels[sub].start, levels[sub].limit))
    return stack


def followed(stack: Stack, head: int, levels: list[Level]) -> Stack | None:
    """The stack after an outcome that leads to `head`; none if the outermost level has run out."""
    while stack:
        level, _, left = stack[-1]
        if left > 1:
            return entered((*stack[:-1], (level, head, left - 1)), levels)
        stack = stack[:-1]
        if stack:
            head = levels[stack[-1][0]].heads[stack[-1][1]][0]
    return None


def settled(stack: Stack, done: int, most: int, levels: list[Level]) -> Stack:
    """The stack without counts that are not needed after `done` actions of `most`.

    A frame cannot run out if the fewest actions that this takes, with those of the frames within
    it, are more than there will be.
    """
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
