"""All actions and sub-skills of an action set, at every level of nesting."""

from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor

from cgtorch.graphs import Action, ActionSet, Skill, SubSkill
from cgtorch.graphs.action import memory_parts

SUCCESS, FAILURE, TIMEOUT = -1, -2, -3
"""Negative heads: how a graph ends, in place of the next node."""


@dataclass(frozen=True)
class ActionTable:
    """The actions and sub-skills of an action set, with the sizes that a program needs.

    Attributes:
        skills: The sub-skills at all levels, each once.
        primitives: The actions that run as one step, each once.
        numbers: For an action's identity, its index among `primitives` followed by `skills`.
        outcomes: The largest number of outcomes of an action.
        width: The largest number of parameters of an action.
        limits: The maximum number of transitions of each sub-skill.
        depth: Levels of skills within skills, 1 without sub-skills.
        message_size: The length of the longest message.
        memory: The slice of the common memory that belongs to each primitive.
        memory_size: The length of the common memory.
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

    def kinds(self, actions: ActionSet) -> Tensor:
        """(A,) long, the table's numbers of an action set's actions."""
        return torch.tensor([self.numbers[id(a)] for a in actions.actions])


def ends(actions: ActionSet) -> Tensor:
    """(A, O) long, `SUCCESS` or `FAILURE`: how a graph ends by an outcome that has no edge."""
    return torch.where(actions.succeeds, SUCCESS, FAILURE)


@lru_cache(maxsize=16)  # in torch it is asked for in every generation
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
