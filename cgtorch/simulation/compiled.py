"""Algorithm 3 compiled: Γ, C and the actions of section VI on the CPU, graph after graph.

It says what the batched engine in torch says, which runs everything else: actions, models and
worlds of others, and other devices. `rollout` asks here first.
"""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cgtorch.actions import Action, ActionSet
from cgtorch.environment import Environment
from cgtorch.graphs import Graphs
from cgtorch.native import WRONG_GRAPHS, constants, function, structure, threads
from cgtorch.native.interface import agree
from cgtorch.simulation.action_table import FAILURE, SUCCESS, TIMEOUT, action_table, ends
from cgtorch.simulation.model import ModelEnvironment
from cgtorch.simulation.program import check_numbers, skill_tables
from cgtorch.simulation.rollouts import Rollouts

EXACT = ("EDGE", "EDGE_BRANCHING")
"""Read percepts of one length only."""
LARGEST = 2**30
"""Nodes, transitions and scenarios that it can count."""
RESULTS = (
    "again", "percept", "state", "status", "transitions", "fitness", "score", "succeeded", "chunks",
)  # fmt: skip
NUMBERS = ("keep", "executed", "not_finite", "wrong", "num_chunks")
"""Fields of a `Task` of lanes.h that are not always given: pointers, and numbers."""


@dataclass(frozen=True)
class CompiledEngine:
    """Actions and models as compiled code knows them, for any graphs as long as they do not change.

    Attributes:
        actions: what a node can be.
        dtype: of all numbers.
        longest: the most transitions of any sub-skill.
        program: fields of a `Program` of program.h without those of graphs.
        models: Γ, C, errors and first percepts, a `Models` of lanes.h.
    """

    actions: ActionSet
    dtype: torch.dtype
    longest: int
    program: dict[str, Any]
    models: Any

    def rollouts(
        self, graphs: Graphs, scenarios: Tensor, max_transitions: int, max_steps: int
    ) -> Rollouts | None:
        """The rollouts of P graphs on scenarios (B,), or None where they have to be run in torch.

        GraphError if a graph has an action, a head or a start that is none of its own. MemoryError
        if there is none for the first percepts of so many scenarios.
        """
        sizes, like = (len(graphs), len(scenarios)), graphs.parameters
        percept, state = like.new_empty(*sizes, self.models.size), like.new_empty(*sizes, 3)
        status, transitions = torch.empty(2, *sizes, dtype=torch.long).unbind()
        task = self._ran(
            "rollouts", graphs, scenarios, max_transitions, max_steps,
            percept=percept, state=state, status=status, transitions=transitions,
        )  # fmt: skip
        succeeded = status == SUCCESS
        timed_out = ~succeeded & (status != FAILURE)
        return task and Rollouts(succeeded, timed_out, percept, state, transitions)

    def evaluation(
        self,
        graphs: Graphs,
        scenarios: Tensor,
        kept: int,
        max_transitions: int,
        max_steps: int,
        again: Tensor | None = None,
    ) -> tuple[Tensor, Tensor, Tensor, int, int] | None:
        """What P graphs achieve by eq. 3 on all scenarios (B,), of which the first `kept` are of W.

        Returned are the fields of an `Evaluation`, or None where it has to be done in torch. Scores
        are C(p_t), half of it without success, and 0 where W is lost. Γ, C, networks and the check
        of motions are done `again` (4,) times more, to measure how long each takes, which changes
        no result. Errors are those of `rollouts`.
        """
        sizes = len(graphs), len(scenarios)
        fitness, score = torch.empty(len(graphs)), graphs.parameters.new_empty(sizes)
        succeeded = torch.empty(sizes, dtype=torch.bool)
        task = self._ran(
            "evaluations", graphs, scenarios, max_transitions, max_steps,
            keep=kept, again=again, fitness=fitness, score=score, succeeded=succeeded,
        )  # fmt: skip
        return task and (fitness, score.float(), succeeded, task.executed, task.not_finite)

    def _ran(
        self,
        name: str,
        graphs: Graphs,
        scenarios: Tensor,
        max_transitions: int,
        max_steps: int,
        **rest: Any,
    ) -> Any:
        """A `Task` of lanes.h that is done, or None where compiled code does not know all of it."""
        whole = graphs.action, graphs.edges, graphs.start, scenarios
        nodes, longest = graphs.action.numel() + self.program["rows"], (max_transitions, max_steps)
        if (
            max(nodes, *longest, self.longest) > LARGEST
            or graphs.edges.shape[2] > self.actions.outcome_capacity
            or graphs.parameters.dtype != self.dtype
            or not graphs.parameters.is_cpu
            or not all(x.is_cpu and x.dtype == torch.long for x in whole)
        ):
            return None
        program = structure("Program", self.dtype)(
            **self.program, action=graphs.action, edges=graphs.edges, start=graphs.start,
            parameters=graphs.parameters, nodes=graphs.capacity, seen=graphs.edges.shape[2],
            each=graphs.parameters.shape[2],
        )  # fmt: skip
        task = structure("Task", self.dtype)(
            program=program, models=self.models, scenarios=scenarios, graphs=len(graphs),
            count=len(scenarios), max_transitions=max_transitions, max_steps=max_steps,
            **{**dict.fromkeys(RESULTS), **dict.fromkeys(NUMBERS, 0), **rest},
        )  # fmt: skip
        failure = function(name, self.dtype)(task, threads())
        if failure == WRONG_GRAPHS:
            check_numbers(graphs, len(self.actions))
        elif failure:
            raise MemoryError(
                f"no memory for the first percepts of {len(scenarios)} scenarios; give fewer"
            )
        return task


def compiled_engine(actions: ActionSet, environment: Environment) -> CompiledEngine | None:
    """The engine of actions in models, or None where rollouts have to be run in torch."""
    if type(environment) is not ModelEnvironment or environment.num_scenarios > LARGEST:
        return None
    dtype, size = environment.percepts.dtype, environment.percept_size
    action, table = structure("Action", dtype), action_table(actions)
    models = environment.compiled(environment) if action and environment.compiled else None
    if models is None or table.depth > constants("engine_limits", dtype)["MOST_DEPTH"]:
        return None
    agree(constants("ends", dtype), {"SUCCESS": SUCCESS, "FAILURE": FAILURE, "TIMEOUT": TIMEOUT})
    fields = [_fields(each, size, dtype) for each in table.primitives]
    if not all(fields) or any(s.graph.parameters.dtype != dtype for s in table.skills):
        return None
    tables, entry = skill_tables(table, 0, torch.device("cpu"))
    skills = [torch.cat(parts) for parts in zip(*tables, strict=True)] or [torch.empty(0)] * 3
    primitives = [action(**each) for each in fields]
    program = {
        "primitives": (type(primitives[0]) * len(primitives))(*primitives),
        "kinds": table.kinds(actions),
        "ends": ends(actions),
        **dict(zip(("kind", "heads", "learned"), skills, strict=True)),
        "entry": torch.tensor(entry, dtype=torch.long),
        "limit": torch.tensor(table.limits, dtype=torch.long),
        "actions": len(actions),
        "most": actions.outcome_capacity,
        "count": len(primitives),
        "outcomes": table.outcomes,
        "width": table.width,
        "rows": len(skills[0]),
        "depth": table.depth,
    }
    return CompiledEngine(actions, dtype, max([0, *table.limits]), program, models)


def _fields(action: Action, percept_size: int, dtype: torch.dtype) -> dict[str, int]:
    """An `Action` of program.h, empty if compiled code has no counterpart or no room for it."""
    kinds, most = constants("action_kinds", dtype), constants("engine_limits", dtype)
    kind, inputs = vars(type(action)).get("native_kind", ""), getattr(action, "percept_size", 0)
    sizes = {name: getattr(action, name, 0) for name in ("inputs", "hidden", "outputs")}
    fits = inputs == percept_size if kind in EXACT else inputs <= percept_size
    fits &= sizes["hidden"] <= most["MOST_HIDDEN"] and sizes["outputs"] <= most["MOST_MESSAGE"]
    if kind not in kinds or "forward" in vars(action) or not fits:
        return {}
    return {"kind": kinds[kind], **sizes}
