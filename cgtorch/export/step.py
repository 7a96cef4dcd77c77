"""A skill as one module that tells a robot, step by step, what to do next.

`torch.export` can trace it, as no Python decision depends on a number. It is for exports; on one
robot `Stepper` answers faster.
"""

from typing import Any, NoReturn, cast

import torch
from torch import Tensor, nn

from cgtorch.graphs import Action, Skill, Step
from cgtorch.graphs.action import own
from cgtorch.graphs.files import LARGEST
from cgtorch.graphs.skill import a_skill
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import ActionError, SettingsError
from cgtorch.ground.given import whole_number
from cgtorch.simulation import most_steps
from cgtorch.simulation.program import SUCCESS, TIMEOUT, Program, compile_graphs
from cgtorch.simulation.torch_engine import Frames, advance, first_frames

ENDS = ("success", "failure", "timeout")
ASKS = {"control": ("success", "failure"), "perceive": ("success",), "test": ("success", "failure")}
"""Kinds of requests to a robot (`Action.request`), and the outcomes of each."""
REQUESTS = (*ENDS, *ASKS)
"""The meaning of each value of `request`: how the skill has ended, or what the robot should do."""
CONTROL = REQUESTS.index("control")

FRESH, RUNNING = 0, 1
STATUS, NODE, LEVEL, STEP, STACK = range(5)  # columns of `place`


class Nowhere:
    """The environment of a skill without a world, which has sizes and perhaps a seed only."""

    num_scenarios = 1

    def __init__(self, who: str, percept: int, control: int, seed: int | None = None):
        self.who, self.percept_size, self.control_size = who, percept, control
        if seed is not None:
            self.seeds = torch.tensor([seed])

    def __getattr__(self, name: str) -> NoReturn:
        raise _MissingError(f"{self.who} asks its environment for {name!r}, which only a world has")


class _MissingError(ActionError, AttributeError):
    """An action asks its environment for something that only a world has."""


def control_size_of(skill: Skill) -> int:
    """U, the size of the controls that a skill asks for, or of its messages if it asks for none."""
    every = (action for level in skill.levels for action in level.actions.actions)
    asked = [action.control_size for action in every if isinstance(action, Step)]
    return max(asked, default=skill.actions.message_size)


class Computed(nn.Module):
    """An action that only computes, as a function of tensors."""

    def __init__(self, name: str, action: Action, sizes: tuple[int, int, int, int]):
        """Try the action on zeros; ActionError if it does more than compute, or fails.

        `sizes` are those of percept, control, message and the action's own memory.
        """
        super().__init__()
        self.name, self.action, self.sizes = name, action, sizes
        if not action.deterministic:
            raise self.refused("it is not deterministic")
        try:
            message, _, memory, _ = self(*self.arguments)
            for what, sent in (("message", message), ("memory", memory)):
                if sent.dtype != torch.float32:
                    raise ActionError(f"its {what} is {sent.dtype}; make it torch.float32")
        except Exception as e:  # whatever a foreign action raises
            raise self.refused(e) from e

    @property
    def arguments(self) -> tuple[Tensor, ...]:
        """Zeros as example arguments."""
        percept, _, message, memory = self.sizes
        wide = percept, message, memory, self.action.num_parameters
        seen, said, kept, values = (torch.zeros(1, width) for width in wide)
        has, step = torch.zeros(1, dtype=torch.bool), torch.zeros(1, dtype=torch.long)
        return seen, said, has, kept, step, values

    def forward(
        self,
        percept: Tensor,
        message: Tensor,
        has: Tensor,
        memory: Tensor,
        step: Tensor,
        parameters: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The message, whether there is one, the memory, and the outcome (1,) long.

        Arguments are percept (1, D), message (1, M), whether there is one (1,) bool, memory (1, C),
        step (1,) long and parameters (1, K).
        """
        nowhere = cast(Environment, Nowhere("it", *self.sizes[:2]))
        lanes = Lanes(percept, percept[:, :0], message, has, memory, torch.zeros_like(step), step)
        after, outcome = self.action(lanes, parameters, nowhere)
        for field in ("percept", "state", "scenario", "step"):
            if getattr(after, field) is not getattr(lanes, field):
                raise ActionError(f"it writes lanes.{field}, which belongs to the robot")
        return after.message, after.has_message, after.memory, outcome

    def traced(self) -> nn.Module:
        """The same function as a traced graph with its constants; ActionError if impossible."""
        try:
            return torch.export.export(self, self.arguments).module(check_guards=False)
        except Exception as e:  # whatever torch.export raises
            raise self.refused(e) from e

    def refused(self, why: str | Exception) -> ActionError:
        """The error for an action that cannot be exported: its name, the reason, and what to do."""
        text = " ".join(str(why).split())[:200]
        if isinstance(why, Exception) and not isinstance(why, ActionError):
            text = f"{type(why).__name__}: {text}"
        return ActionError(
            f"action {self.name!r} cannot be exported: {text}; export the skill as state-machine, "
            "where it is a class to fill in"
        )


class SkillStep(nn.Module):
    """One step of a skill, with the results of `rollout`.

    Networks and other actions that only compute run inside. For all others, the robot gets a
    request. The position in the skill is in `place`, messages and memory are in `mind`; the module
    stores nothing. A control that is not there or not finite fails without a request.

    Attributes:
        name: The skill's name.
        percept_size: D, the length of a percept.
        control_size: U, the length of a control; of a mobile base dx, dy (m), dθ (rad).
        place_size: Length of `place`.
        mind_size: Length of `mind`: the message, whether there is one, the common memory.
    """

    request: Tensor
    table_kind: Tensor
    table_heads: Tensor
    table_parameters: Tensor
    table_start: Tensor
    table_entry: Tensor
    table_limit: Tensor

    def __init__(self, skill: Skill, percept_size: int | None = None, max_steps: int | None = None):
        """Prepare the skill.

        Args:
            skill: The skill.
            percept_size: D; by default the length that its networks read.
            max_steps: Actions on all levels after which it times out; `most_steps` by default.

        Raises:
            ActionError: An action is neither a built-in routine nor one that only computes.
            SettingsError: What is given is no skill, or D is neither given nor can be inferred.
        """
        super().__init__()
        self.name, self.max_transitions = a_skill(skill).name, skill.max_transitions
        size = _percept_size(skill) if percept_size is None else percept_size
        self.percept_size = whole_number(size, "percept_size", 0, LARGEST)
        self.control_size = control_size_of(skill)
        most = most_steps(skill.actions, skill.max_transitions)
        self.max_steps = most if max_steps is None else max_steps
        program = compile_graphs(skill.graph, skill.actions)
        self._actions = table = program.actions
        self.depth, self.num_primitives = table.depth, len(table.primitives)
        self.message_size, self.memory_size = table.message_size, table.memory_size
        self.place_size = STACK + 2 * self.depth
        self.mind_size = self.message_size + 1 + self.memory_size
        request = torch.full((self.num_primitives + len(program.limit),), -1)
        self.asks = {each: each for each in ASKS}  # by the names that they have in the skill
        self.own: list[tuple[int, int, slice]] = []  # kind, parameters, part of the memory
        self.computed = nn.ModuleList()
        for name, action in skill.primitives:
            i = table.numbers[id(action)]
            if asks := own(action, "request"):
                request[i], self.asks[asks] = REQUESTS.index(asks), name
            else:
                part = table.memory[i]
                self.own.append((i, action.num_parameters, part))
                sizes = self.percept_size, self.control_size, self.message_size
                self.computed.append(Computed(name, action, (*sizes, part.stop - part.start)))
        values = program.parameters.detach().float()
        for key, value in (vars(program) | {"parameters": values}).items():
            if isinstance(value, Tensor):
                self.register_buffer(f"table_{key}", value)
        self.register_buffer("request", request[program.kind])

    def forward(
        self, percept: Tensor, outcome: Tensor, place: Tensor, mind: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The next request to the robot.

        Args:
            percept: (D,) the present percept.
            outcome: () long, the outcome of the last request, in the order of the action's
                outcomes. It is ignored in the first step, and after the end.
            place: (place_size,) long, from the last step; zeros in the first.
            mind: (mind_size,) float, from the last step; zeros in the first.

        Returns:
            `request` () long, an index into `REQUESTS`; `control` (U,), what to carry out,
                else zeros; and `place` and `mind` for the next step. After its end, a skill
                requests nothing and does not change.
        """
        percept, outcome, place, mind = (x[None] for x in (percept, outcome, place, mind))
        fresh = place[:, STATUS] == FRESH
        place = torch.where(fresh[:, None], self._begun(), self._advance(place, outcome))

        def thinking(place: Tensor, mind: Tensor) -> Tensor:
            return self._thinks(place, mind).any()

        def think(place: Tensor, mind: Tensor) -> tuple[Tensor, Tensor]:
            return self._think(percept, place, mind)

        if torch.compiler.is_exporting():
            place, mind = torch.while_loop(thinking, think, (place, mind))
        else:
            while thinking(place, mind):
                place, mind = think(place, mind)
        status = place[:, STATUS]
        request = torch.where(status == RUNNING, self.request[place[:, NODE]], SUCCESS - status)
        moves = (request == CONTROL)[:, None]
        control = torch.where(moves, mind[:, : self.control_size], 0.0)
        return request[0], control[0], place[0], mind[0]

    @property
    def _program(self) -> Program:
        """The engine's program, whose tables are this module's buffers."""
        return Program(
            self._actions, self.table_kind, self.table_heads, self.table_parameters,
            self.table_start, self.table_entry, self.table_limit,
        )  # fmt: skip

    def _begun(self) -> Tensor:
        """The place at the start of the outermost skill."""
        frames = first_frames(self._program, 1, self.max_transitions)
        return _place(torch.full_like(frames.node, RUNNING), torch.zeros_like(frames.node), frames)

    def _advance(self, place: Tensor, outcome: Tensor) -> Tensor:
        """The engine's `advance`; finished places stay."""
        node, level, step = place[:, NODE], place[:, LEVEL], place[:, STEP] + 1
        caller, left = place[:, STACK:].split(self.depth, 1)
        nothing = torch.zeros_like(node)
        frames = Frames(node, level, caller.clone(), left.clone(), nothing, nothing)
        frames, end, _ = advance(self._program, frames, outcome, torch.ones_like(node).bool())
        late = torch.where(step >= self.max_steps, TIMEOUT, RUNNING)
        followed = _place(torch.where(end < 0, end, late), step, frames)
        return torch.where((place[:, STATUS] == RUNNING)[:, None], followed, place)

    def _thinks(self, place: Tensor, mind: Tensor) -> Tensor:
        """(n,) bool, whether a place is at a node that needs no robot."""
        asks = self.request[place[:, NODE]]
        finite = mind[:, : self.control_size].isfinite().all(1)
        possible = (mind[:, self.message_size] > 0) & finite
        needs_robot = (asks >= 0) & ((asks != CONTROL) | possible)
        return (place[:, STATUS] == RUNNING) & ~needs_robot

    def _think(self, percept: Tensor, place: Tensor, mind: Tensor) -> tuple[Tensor, Tensor]:
        """Run one action at all places that need no robot."""
        node = place[:, NODE]
        thinks, kind = self._thinks(place, mind), self.table_kind[node]
        outcome = torch.ones_like(node)  # a control that is not possible fails
        message, has, memory = mind.split([self.message_size, 1, self.memory_size], 1)
        lanes = (percept, message, has[:, 0] > 0)
        for (i, width, part), action in zip(self.own, self.computed, strict=True):
            here, values = thinks & (kind == i), self.table_parameters[node][:, :width]
            said, has_said, memory_of, out = action(*lanes, memory[:, part], place[:, STEP], values)
            around = memory[:, : part.start], memory_of, memory[:, part.stop :]
            after = torch.cat([said, has_said[:, None].to(mind.dtype), *around], 1)
            mind = torch.where(here[:, None], after, mind)
            outcome = torch.where(here, out, outcome)
        place = torch.where(thinks[:, None], self._advance(place, outcome), place)
        return place, mind.clone()  # as loops may not return what they were given

    def first(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The first step's percept (D,), outcome (), place (place_size,) and mind (mind_size,)."""
        place = torch.zeros(self.place_size, dtype=torch.long)
        return torch.zeros(self.percept_size), torch.tensor(0), place, torch.zeros(self.mind_size)

    @property
    def carried(self) -> list[Computed]:
        """The actions that run inside."""
        return [action for action in self.computed if isinstance(action, Computed)]

    def about(self) -> dict[str, Any]:
        """Names and sizes that a user of the steps needs, as plain data."""
        return {
            "format": "cgtorch-step",
            "version": 1,
            "skill": self.name,
            "percept": self.percept_size,
            "control": self.control_size,
            "place": self.place_size,
            "mind": self.mind_size,
            "requests": [*ENDS, *self.asks.values()],
            "outcomes": {self.asks[each]: list(outcomes) for each, outcomes in ASKS.items()},
        }


def _place(status: Tensor, step: Tensor, frames: Frames) -> Tensor:
    """The places (n, place_size) of frames."""
    first = torch.stack([status, frames.node, frames.level, step], 1)
    return torch.cat([first, frames.caller, frames.left], 1)


def _percept_size(skill: Skill) -> int:
    """Inputs of the networks of a skill and of its sub-skills."""
    for _, action in skill.primitives:
        if isinstance(size := getattr(action, "percept_size", None), int):
            return size
    raise SettingsError(
        f"skill {skill.name!r} has no network that tells the length of a percept; pass percept_size"
    )
