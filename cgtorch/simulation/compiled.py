"""Algorithm 3 compiled: Γ, C and the actions of section VI on the CPU, one graph at a time.

It gives the same results as the batched engine in torch. Graphs with other actions or with a
memory, and other environments, run in `cgtorch.simulation.resumable`; `rollout` tries this module
first.
"""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cgtorch.graphs import ActionSet, Graphs
from cgtorch.native import WRONG_GRAPHS, alike, constants, function, structure, threads
from cgtorch.simulation.action_table import FAILURE, SUCCESS
from cgtorch.simulation.compiled_actions import LARGEST, CompiledActions
from cgtorch.simulation.model import CompiledModels, ModelEnvironment
from cgtorch.simulation.program import check_numbers
from cgtorch.simulation.rollouts import Rollouts

RESULTS = (
    "again", "percept", "state", "status", "transitions", "fitness", "score", "succeeded", "chunks",
)  # fmt: skip
NUMBERS = ("keep", "cost", "counted", "executed", "not_finite", "wrong", "num_chunks")
"""Optional fields of a `Task` of task.h: pointers, and numbers."""


@dataclass(frozen=True)
class CompiledEngine:
    """Actions and models in the form of compiled code, for any graphs while they do not change.

    Attributes:
        actions: The action set of the graphs.
        known: The same in the form of compiled code.
        models: The argument of the models' compiled functions.
        environment: A `ModelEnvironment` of models.h.
        percept_size: D.
    """

    actions: ActionSet
    known: CompiledActions
    models: CompiledModels
    environment: Any
    percept_size: int

    def rollouts(
        self, graphs: Graphs, scenarios: Tensor, max_transitions: int, max_steps: int
    ) -> Rollouts | None:
        """The rollouts of P graphs on scenarios (B,), or None if not all of it is compiled.

        GraphError if a graph has an action, a head or a start that does not exist. MemoryError if
        there is not enough memory for the first percepts of all scenarios.
        """
        sizes, like = (len(graphs), len(scenarios)), graphs.parameters
        percept, state = like.new_empty(*sizes, self.percept_size), like.new_empty(*sizes, 3)
        status, transitions = torch.empty(2, *sizes, dtype=torch.long).unbind()
        task = self._ran(
            "rollouts", graphs, scenarios, max_transitions, max_steps,
            percept=percept, state=state, status=status, transitions=transitions,
        )  # fmt: skip
        succeeded = status == SUCCESS
        timed_out = ~succeeded & (status != FAILURE)
        return task and Rollouts(succeeded, timed_out, percept, state, transitions, task.executed)

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
        motions can be repeated `again` (4,) times; this does not change results.
        """
        sizes = len(graphs), len(scenarios)
        fitness, score = torch.empty(len(graphs)), graphs.parameters.new_empty(sizes)
        succeeded = torch.empty(sizes, dtype=torch.bool)
        task = self._ran(
            "evaluations", graphs, scenarios, max_transitions, max_steps,
            keep=kept, cost=cost, again=again, fitness=fitness, score=score, succeeded=succeeded,
        )  # fmt: skip
        if task is None:
            return None
        return fitness, score.float(), succeeded, task.counted, task.executed, task.not_finite

    def _ran(
        self,
        name: str,
        graphs: Graphs,
        scenarios: Tensor,
        max_transitions: int,
        max_steps: int,
        **rest: Any,
    ) -> Any:
        """A finished `Task` of task.h, or None if compiled code does not support all of it."""
        program = program_of(graphs, self.known, (max_transitions, max_steps))
        if program is None or not is_whole(scenarios) or self.known.resumable_alone(graphs):
            return None
        dtype = self.known.dtype
        task = structure("Task", dtype)(
            program=program, environment=self.environment, scenarios=scenarios, graphs=len(graphs),
            count=len(scenarios), max_transitions=max_transitions, max_steps=max_steps,
            **{**dict.fromkeys(RESULTS), **dict.fromkeys(NUMBERS, 0), **rest},
        )  # fmt: skip
        failure = function(f"{self.models.name}_{name}", dtype)(task, threads())
        if failure == WRONG_GRAPHS:
            check_numbers(graphs, len(self.actions))
        elif failure:
            raise MemoryError(
                f"no memory for the first percepts of {len(scenarios)} scenarios; give fewer"
            )
        return task


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
