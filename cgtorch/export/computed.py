"""Actions that only compute, and so can be contained in an exported skill."""

from collections.abc import Iterator
from typing import NamedTuple, NoReturn, cast

import torch
from torch import Tensor, nn

from cgtorch.graphs import NO_NODE, Action, Skill, Step, SubSkill
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import ActionError

INSTEAD = "export the skill as state-machine, where it is a class to fill in"


def named_primitives(skill: Skill, seen: set[int] | None = None) -> Iterator[tuple[str, Action]]:
    """The primitive actions of a skill's nodes at all levels, with their names, each once."""
    seen = set() if seen is None else seen
    for i in sorted(set(skill.graph.action[0].tolist()) - {NO_NODE}):
        name, action = skill.actions.names[i], skill.actions.actions[i]
        if id(action) in seen:
            continue
        seen.add(id(action))
        if isinstance(action, SubSkill):
            yield from named_primitives(action.skill, seen)
        else:
            yield name, action


def request_of(action: Action) -> str:
    """The request of an action, for exactly its class (`Action.request`); "" without one."""
    return str(vars(type(action)).get("request", ""))


def control_size_of(skill: Skill) -> int:
    """U, the size of the controls that a skill asks for, or of its messages if it asks for none."""
    asked = [a.control_size for a in skill.actions.actions if isinstance(a, Step)]
    return max(asked, default=skill.actions.message_size)


class Sizes(NamedTuple):
    """Sizes of what an action reads and writes: percept, control, message, own memory."""

    percept: int
    control: int
    message: int
    memory: int


class Computed(nn.Module):
    """An action that only computes, as a function of tensors."""

    def __init__(self, name: str, action: Action, sizes: Sizes):
        """Try the action on zeros; ActionError if it does more than compute, or fails."""
        super().__init__()
        self.name, self.action, self.sizes = name, action, sizes
        if not action.deterministic:
            raise refused(name, "it is not deterministic")
        try:
            self(*self.arguments)
        except Exception as e:  # whatever a foreign action raises
            raise refused(name, _reason(e)) from e

    @property
    def arguments(self) -> tuple[Tensor, ...]:
        """Zeros as example arguments."""
        size = self.sizes
        wide = (size.percept, size.message, size.memory, self.action.num_parameters)
        percept, message, memory, values = (torch.zeros(1, width) for width in wide)
        has, step = torch.zeros(1, dtype=torch.bool), torch.zeros(1, dtype=torch.long)
        return percept, message, has, memory, step, values

    def forward(
        self,
        percept: Tensor,
        message: Tensor,
        has: Tensor,
        memory: Tensor,
        step: Tensor,
        parameters: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Maps lanes as tensors to lanes after the action and its outcome (1,) long.

        Arguments are percept (1, D), message (1, M), whether there is one (1,) bool, memory (1, C),
        step (1,) long and parameters (1, K). Returned are message, whether there is one, memory,
        and the outcome.
        """
        nowhere = cast(Environment, _Nowhere(self.sizes))
        lanes = Lanes(percept, percept[:, :0], message, has, memory, torch.zeros_like(step), step)
        after, outcome = self.action(lanes, parameters, nowhere)
        for field in ("percept", "state", "scenario", "step"):
            if getattr(after, field) is not getattr(lanes, field):
                raise ActionError(f"it writes lanes.{field}, which belongs to the robot")
        return after.message, after.has_message, after.memory, outcome


def traced(computed: Computed) -> nn.Module:
    """The same function as a traced graph with its constants; ActionError if that is impossible."""
    try:
        program = torch.export.export(computed, computed.arguments)
    except Exception as e:  # whatever torch.export raises
        raise refused(computed.name, _reason(e)) from e
    return program.module(check_guards=False)


class _MissingError(ActionError, AttributeError):
    """An action asks its environment for something that an exported skill does not have."""


class _Nowhere:
    """The environment of an exported skill, which has sizes only."""

    def __init__(self, sizes: Sizes):
        self.percept_size, self.control_size = sizes.percept, sizes.control

    def __getattr__(self, name: str) -> NoReturn:
        raise _MissingError(f"it asks its environment for {name!r}")


def refused(name: str, reason: str) -> ActionError:
    """The error for an action that cannot be exported: its name, the reason, and what to do."""
    return ActionError(f"action {name!r} cannot be exported: {reason}; {INSTEAD}")


def _reason(e: Exception) -> str:
    text = " ".join(str(e).split())[:200]
    return text if isinstance(e, ActionError) else f"{type(e).__name__}: {text}"
