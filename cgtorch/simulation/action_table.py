"""What actions and sub-skills there are behind an action set, however deep."""

from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor

from cgtorch.actions import Action, ActionSet
from cgtorch.actions.action import memory_parts
from cgtorch.graphs import Skill, SubSkill

SUCCESS, FAILURE, TIMEOUT = -1, -2, -3
"""How graphs end, in place of a node."""


@dataclass(frozen=True)
class ActionTable:
    """What a program needs to know of an action set and of all sub-skills in it.

    Attributes:
        skills: the sub-skills, also those within others, each once.
        primitives: the actions that run as one step, without duplicates.
        numbers: by an action's identity, its place among `primitives` and then `skills`.
        outcomes: of the action with most.
        width: parameters of the action with most.
        limits: the most transitions of each sub-skill.
        depth: levels of skills within skills, 1 if there are none.
        message_size: length of the longest message.
        memory: where each primitive's part of the common memory lies.
        memory_size: length of all of it.
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
        """(A,) long, the numbers of an action set's actions."""
        return torch.tensor([self.numbers[id(a)] for a in actions.actions])


def ends(actions: ActionSet) -> Tensor:
    """(A, O) long, `SUCCESS` or `FAILURE`, how outcomes without a head end a graph."""
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
    """All sub-skills of an action set, also those within others, each once."""
    for action in actions.actions:
        if isinstance(action, SubSkill) and id(action.skill) not in found:
            found[id(action.skill)] = action.skill
            _skills(action.skill.actions, found)
    return found
