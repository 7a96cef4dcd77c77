"""An action set in the form of compiled rollouts: a `Program` of program.h without graphs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

from cgtorch.graphs import Action, ActionSet, Graphs, SubSkill
from cgtorch.native import agree, constants, function, structure
from cgtorch.simulation.action_table import (
    FAILURE,
    SUCCESS,
    TIMEOUT,
    ActionTable,
    action_table,
    ends,
)
from cgtorch.simulation.program import skill_tables

LARGEST = 2**30
"""The largest number of nodes, transitions or scenarios in compiled code."""
SIZES = ("inputs", "hidden", "delays", "outputs")
"""The sizes of a network in an `Action` of program.h; 0 if it does not have them."""
ROUTINES = ("STEP", "TEST", "PERCEIVE")
"""Kinds of actions that call the environment."""
NETWORKS = ("CONTINUOUS", "BRANCHING")
WITH_MEMORY = ("RECURRENT", "DELAY")
"""Networks that use a lane's memory; only resumable rollouts have one (`resumable.py`)."""


@dataclass(frozen=True)
class CompiledActions:
    """An action set in the form of compiled code, for numbers of one type.

    Attributes:
        table: All actions and sub-skills.
        dtype: The type of all numbers.
        in_python: (K,) bool, the table's primitives that Python has to run.
        only_resumable: (A + 1,) long, 1 for the actions that are or contain a primitive which only
            resumable rollouts can run, because it is in Python or has a memory. The last entry is
            0, for slots without an action.
        some_only_resumable: Whether there is any such action.
        longest: The largest number of transitions of a sub-skill.
        program: The fields of a `Program`, except those of graphs.
        memory: (K, 2) long, offset and size of each primitive's part of the memory.
        deterministic: (K,) long.
    """

    table: ActionTable
    dtype: torch.dtype
    in_python: tuple[bool, ...]
    only_resumable: Tensor
    some_only_resumable: bool
    longest: int
    program: dict[str, Any]
    memory: Tensor
    deterministic: Tensor

    def networks(self) -> list[Any]:
        """The `Action` of each primitive that is a network without memory."""
        kinds = constants("action_kinds", self.dtype)
        others = [kinds[name] for name in (*ROUTINES, *WITH_MEMORY, "IN_PYTHON")]
        return [each for each in self.program["primitives"] if each.kind not in others]

    def resumable_alone(self, graphs: Graphs) -> bool:
        """Whether any of the graphs uses an action that only resumable rollouts can run."""
        if not self.some_only_resumable:
            return False
        flags, action = self.only_resumable, graphs.action.contiguous()
        if not action.is_cpu:
            outside = (action < 0) | (action >= len(flags) - 1)
            return bool(flags[torch.where(outside, len(flags) - 1, action)].any())
        call = function("any_flagged", self.dtype)
        return bool(call(action, action.numel(), flags, len(flags) - 1))

    def to(self, device: torch.device) -> "CompiledActions":
        """The same set with all tables of `program`, and `only_resumable`, on a device."""
        moved = {
            name: value.to(device) if isinstance(value, Tensor) else value
            for name, value in self.program.items()
        }
        rows = bytearray(bytes(self.program["primitives"]))
        moved["primitives"] = torch.frombuffer(rows, dtype=torch.uint8).to(device)
        return replace(self, program=moved, only_resumable=self.only_resumable.to(device))


@lru_cache(maxsize=16)  # it is asked for with every call of `rollout`
def compiled_actions(
    actions: ActionSet, percept_size: int, dtype: torch.dtype, kinds: tuple[str, ...]
) -> CompiledActions | None:
    """The action set if actions of these kinds are compiled, else None.

    None is returned without a compiler, for sub-skills with another type of numbers, and for too
    many levels of nesting.
    """
    action, table = structure("Action", dtype), action_table(actions)
    if action is None or any(s.graph.parameters.dtype != dtype for s in table.skills):
        return None
    limits = constants("engine_limits", dtype)
    if table.depth > limits["MOST_DEPTH"]:
        return None
    agree(constants("ends", dtype), {"SUCCESS": SUCCESS, "FAILURE": FAILURE, "TIMEOUT": TIMEOUT})
    fields = [_fields(each, percept_size, dtype, kinds) for each in table.primitives]
    tables, entry = skill_tables(table, 0, torch.device("cpu"))
    skills = [torch.cat(parts) for parts in zip(*tables, strict=True)] or [torch.empty(0)] * 3
    primitives = [action(**each) for each in fields]
    program = {
        "primitives": (type(primitives[0]) * len(primitives))(*primitives),
        "kinds": table.kinds(actions),
        "ends": ends(actions),
        **dict(zip(("kind", "heads", "learned"), skills, strict=True)),
        "entry": torch.tensor(entry, dtype=torch.long),
        "began": torch.tensor([0, *(len(t[0]) for t in tables)]).cumsum(0),
        "limit": torch.tensor(table.limits, dtype=torch.long),
        "actions": len(actions),
        "most": actions.outcome_capacity,
        "count": len(primitives),
        "outcomes": table.outcomes,
        "width": table.width,
        "rows": len(skills[0]),
        "depth": table.depth,
    }
    numbers = constants("action_kinds", dtype)
    apart = [numbers[name] for name in (*WITH_MEMORY, "IN_PYTHON")]
    only = [each["kind"] in apart for each in fields]
    flags = [int(_uses_any(each, table, only)) for each in actions.actions]
    return CompiledActions(
        table=table,
        dtype=dtype,
        in_python=tuple(each["kind"] == numbers["IN_PYTHON"] for each in fields),
        only_resumable=torch.tensor([*flags, 0]),
        some_only_resumable=any(flags),
        longest=max([0, *table.limits]),
        program=program,
        memory=torch.tensor([[part.start, part.stop - part.start] for part in table.memory]),
        deterministic=torch.tensor([int(each.deterministic) for each in table.primitives]),
    )


def _fields(
    action: Action, percept_size: int, dtype: torch.dtype, known: Sequence[str]
) -> dict[str, int]:
    """An `Action` of program.h."""
    kinds, most = constants("action_kinds", dtype), constants("engine_limits", dtype)
    kind, inputs = vars(type(action)).get("native_kind", ""), getattr(action, "percept_size", 0)
    sizes = {name: getattr(action, name, 0) for name in SIZES}
    ordinary = kind in (*ROUTINES, *NETWORKS, *WITH_MEMORY)
    fits = inputs <= percept_size if ordinary else inputs == percept_size
    fits &= inputs <= most["MOST_PERCEPT"] and sizes["hidden"] <= most["MOST_HIDDEN"]
    fits &= sizes["outputs"] <= most["MOST_MESSAGE"]
    fits &= action.num_parameters <= most["MOST_WEIGHTS"]
    window = sizes["inputs"] * (sizes["delays"] + 1)
    fits &= kind != "DELAY" or window <= most["MOST_DELAYED"]
    memory = sizes["hidden"] + sizes["inputs"] * sizes["delays"]
    fits &= kind not in WITH_MEMORY or action.memory_size >= memory
    if kind not in known or "forward" in vars(action) or not fits:
        numbers = action.num_parameters
        return {"kind": kinds["IN_PYTHON"], **dict.fromkeys(SIZES, 0), "outputs": numbers}
    return {"kind": kinds[kind], **sizes}


def _uses_any(action: Action, table: ActionTable, marked: Sequence[bool]) -> bool:
    """Whether an action is, or contains, one of the marked primitives (K,)."""
    if not isinstance(action, SubSkill):
        return marked[table.numbers[id(action)]]
    skill = action.skill
    used = (skill.actions.actions[i] for i in skill.graph.action.unique().tolist() if i >= 0)
    return any(_uses_any(each, table, marked) for each in used)
