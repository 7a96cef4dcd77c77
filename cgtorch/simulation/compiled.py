"""Algorithm 3 compiled: Γ, C and the actions of section VI on the CPU, one graph at a time.

It gives the same results as the batched engine in torch. Graphs with other actions or with a
memory, and other environments, run in `cgtorch.simulation.resumable`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

from cgtorch.graphs import Action, ActionSet, Graphs, SubSkill
from cgtorch.graphs.action import own
from cgtorch.native import WRONG_GRAPHS, agree, alike, constants, function, structure, threads
from cgtorch.simulation.model import CompiledModels, ModelEnvironment
from cgtorch.simulation.program import (
    FAILURE,
    SUCCESS,
    TIMEOUT,
    ActionTable,
    action_table,
    check_numbers,
    ends,
    skill_tables,
)
from cgtorch.simulation.torch_engine import Rollouts

LARGEST = 2**30  # number of nodes, transitions or scenarios
SIZES = ("inputs", "hidden", "delays", "outputs")  # of a network, 0 if it does not have them
ROUTINES = ("STEP", "TEST", "PERCEIVE")  # kinds of actions that call the environment
NETWORKS = ("CONTINUOUS", "BRANCHING")
WITH_MEMORY = ("RECURRENT", "DELAY")  # networks with a memory, as only resumable rollouts have


@dataclass(frozen=True)
class CompiledActions:
    """An action set in the form of compiled code, for numbers of one type.

    Attributes:
        table: All actions and sub-skills.
        in_python: (K,) bool, the table's primitives that Python has to run.
        only_resumable: (A + 1,) long, 1 for the actions that are or contain a primitive which only
            resumable rollouts can run, because it is in Python, has a memory, or is large. The last
            entry is 0, for slots without an action.
        some_only_resumable: Whether there is any such action.
        longest: The largest number of transitions of a sub-skill.
        program: The fields of a `Program`, except those of graphs.
        memory: (K, 2) long, offset and size of each primitive's part of the memory.
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


@lru_cache(maxsize=16)  # every call of `rollout` needs it
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
    only = [
        each["kind"] in apart
        or each["inputs"] > limits["MOST_PERCEPT"]
        or each["outputs"] > limits["MOST_MESSAGE"]
        for each in fields
    ]
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
    kinds, most = constants("action_kinds", dtype), constants("engine_limits", dtype)
    kind, inputs = own(action, "native_kind"), getattr(action, "percept_size", 0)
    sizes = {name: getattr(action, name, 0) for name in SIZES}
    ordinary = kind in (*ROUTINES, *NETWORKS, *WITH_MEMORY)
    fits = inputs <= percept_size if ordinary else inputs == percept_size
    fits &= inputs <= most["MOST_READ"] and sizes["hidden"] <= most["MOST_HIDDEN"]
    fits &= sizes["outputs"] <= most["MOST_SENT"]
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


RESULTS = (
    "again", "percept", "state", "status", "transitions", "fitness", "score", "succeeded", "chunks",
)  # fmt: skip
NUMBERS = ("keep", "cost", "counted", "executed", "not_finite", "wrong", "num_chunks")
"""Optional fields of a `Task` of lanes.h: pointers, and numbers."""


@dataclass(frozen=True)
class CompiledEngine:
    """Actions and models in the form of compiled code, for any graphs while they do not change."""

    actions: ActionSet  # of the graphs
    known: CompiledActions  # the same in the form of compiled code
    models: CompiledModels
    environment: Any  # a `ModelEnvironment` of models.h
    percept_size: int  # D

    def rollouts(
        self, graphs: Graphs, scenarios: Tensor, max_transitions: int, max_steps: int
    ) -> Rollouts | None:
        """The rollouts of P graphs on scenarios (B,), or None if not all of it is compiled.

        GraphError if a graph has an action, a head or a start that does not exist. MemoryError if
        there is not enough memory for the first percepts of all scenarios.
        """
        sizes, like = (len(graphs), len(scenarios)), graphs.parameters
        percept, state = like.new_empty(*sizes, self.percept_size), like.new_empty(*sizes, 3)
        status, transitions = like.new_empty(2, *sizes, dtype=torch.long).unbind()
        counts = self._ran(
            "rollouts", graphs, scenarios, max_transitions, max_steps,
            percept=percept, state=state, status=status, transitions=transitions,
        )  # fmt: skip
        succeeded = status == SUCCESS
        timed_out = ~succeeded & (status != FAILURE)
        return counts and Rollouts(succeeded, timed_out, percept, state, transitions, counts[1])

    def evaluation(
        self,
        graphs: Graphs,
        scenarios: Tensor,
        kept: int,
        max_transitions: int,
        max_steps: int,
        cost: float = 0.0,
        again: Tensor | None = None,
    ) -> tuple[Tensor, Tensor, Tensor, int, int, int] | None:
        """The evaluation of P graphs by eq. 3 on scenarios (B,), of which the first `kept` are W.

        Returned are the fields of an `Evaluation`, or None if not all of it is compiled. Scores are
        C(p_t), half of it without success, less the `cost` of transitions, and 0 if W is lost.
        Errors are those of `rollouts`. To measure their time, Γ, C, networks and the check of
        motions can be repeated `again` (4,) times on a CPU; this does not change results.
        """
        home, graphs = graphs.start.device, graphs.to(self.known.only_resumable.device)
        score = graphs.parameters.new_empty(len(graphs), len(scenarios))
        fitness = score.new_empty(len(graphs), dtype=torch.float)
        succeeded = torch.zeros_like(score, dtype=torch.bool)
        counts = self._ran(
            "evaluations", graphs, scenarios, max_transitions, max_steps,
            keep=kept, cost=cost, again=again, fitness=fitness, score=score, succeeded=succeeded,
        )  # fmt: skip
        return counts and (fitness.to(home), score.float().to(home), succeeded.to(home), *counts)

    def _ran(
        self,
        name: str,
        graphs: Graphs,
        scenarios: Tensor,
        max_transitions: int,
        max_steps: int,
        **rest: Any,
    ) -> tuple[int, int, int] | None:
        """Runs a `Task` of lanes.h; None if compiled code does not support all of it.

        Returned are the transitions that count, those that were executed, and the number of graphs
        with a number that is not finite.
        """
        program = program_of(graphs, self.known, (max_transitions, max_steps))
        if program is None or not is_whole(scenarios) or self.known.resumable_alone(graphs):
            return None
        limits = {"max_transitions": max_transitions, "max_steps": max_steps}
        task = task_of(self, graphs, scenarios, program=program, **limits, **rest)
        failure = function(f"{self.models.name}_{name}", self.known.dtype)(task, threads())
        if failure == WRONG_GRAPHS:
            check_numbers(graphs, len(self.actions))
        elif failure:
            raise MemoryError(
                f"no memory for the first percepts of {len(scenarios)} scenarios; give fewer"
            )
        return task.counted, task.executed, task.not_finite


def task_of(engine: CompiledEngine, graphs: Graphs, scenarios: Tensor, **given: Any) -> Any:
    """A `Task` of lanes.h with these fields; the others are empty."""
    fields = {**dict.fromkeys(RESULTS), **dict.fromkeys(NUMBERS, 0), **given}
    sizes = {"graphs": len(graphs), "count": len(scenarios), "scenarios": scenarios}
    environment = engine.environment if given["program"] is not None else None
    return structure("Task", engine.known.dtype)(environment=environment, **sizes, **fields)


def is_whole(numbers: Tensor) -> bool:
    """Whether a tensor has the type of indices in compiled code: long, on the CPU."""
    return numbers.is_cpu and numbers.dtype == torch.long


def program_of(graphs: Graphs, known: CompiledActions, limits: tuple[int, int]) -> Any:
    """A `Program` of program.h, or None if the graphs or limits are not supported."""
    whole = graphs.action, graphs.edges, graphs.start
    nodes = graphs.action.numel() + known.program["rows"]
    if (
        max(nodes, *limits, known.longest) > LARGEST
        or graphs.edges.shape[2] > known.program["most"]
        or graphs.parameters.dtype != known.dtype
        or any(x.device != known.only_resumable.device for x in (graphs.parameters, *whole))
        or any(x.dtype != torch.long for x in whole)
    ):
        return None
    return structure("Program", known.dtype)(
        **known.program, action=graphs.action, edges=graphs.edges, start=graphs.start,
        parameters=graphs.parameters, nodes=graphs.capacity, seen=graphs.edges.shape[2],
        each=graphs.parameters.shape[2],
    )  # fmt: skip


def compiled_models(e: ModelEnvironment) -> tuple[CompiledModels, Any] | None:
    """The compiled models of an environment and a `ModelEnvironment` of models.h, or None."""
    errors, limits = e.errors, constants("engine_limits", e.percepts.dtype)
    given = [e.percepts, e.first_state, *([] if errors is None else [errors])]
    if not limits or not alike(*given) or e.num_scenarios > LARGEST:
        return None
    if e.percept_size > limits["MOST_PERCEPT"] or e.control_size > limits["MOST_MESSAGE"]:
        return None
    models = e.compiled and e.compiled(e)
    if not models:
        return None
    return models, structure("ModelEnvironment", models.dtype)(
        models=models.structure, percepts=e.percepts, state=e.first_state, errors=errors,
        size=e.percept_size, error_draws=1 if errors is None else errors.shape[1],
        controls=e.control_size, most_novel=e.most_novel,
    )  # fmt: skip
