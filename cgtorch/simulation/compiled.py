"""Algorithm 3 compiled: Γ, C and the actions of section VI on the CPU, graph after graph.

It says what the batched engine in torch says. Graphs with other actions, or with a memory, and
other environments, are for `cgtorch.simulation.resumable`; `rollout` asks here first.
"""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cgtorch.actions import ActionSet
from cgtorch.graphs import Graphs
from cgtorch.native import WRONG_GRAPHS, alike, constants, function, structure, threads
from cgtorch.simulation.action_table import FAILURE, SUCCESS
from cgtorch.simulation.compiled_actions import LARGEST, CompiledActions
from cgtorch.simulation.model import CompiledModels, ModelEnvironment
from cgtorch.simulation.program import check_numbers
from cgtorch.simulation.rollouts import Rollouts

RESULTS = (
    "again", "percept", "state", "status", "transitions", "fitness", "score", "succeeded", "chunks",
)  # fmt: skip
NUMBERS = ("keep", "counted", "executed", "not_finite", "wrong", "num_chunks")
"""Fields of a `Task` of task.h that are not always given: pointers, and numbers."""


@dataclass(frozen=True)
class CompiledEngine:
    """Actions and models as compiled code knows them, for any graphs as long as they do not change.

    Attributes:
        actions: what a node can be.
        known: the same for compiled code.
        models: what functions of these models' name get.
        environment: a `ModelEnvironment` of models.h.
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
        """The rollouts of P graphs on scenarios (B,), or None where not all of it is compiled.

        GraphError if a graph has an action, a head or a start that is none of its own. MemoryError
        if there is none for the first percepts of so many scenarios.
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
        again: Tensor | None = None,
    ) -> tuple[Tensor, Tensor, Tensor, int, int, int] | None:
        """What P graphs achieve by eq. 3 on all scenarios (B,), of which the first `kept` are of W.

        Returned are the fields of an `Evaluation`, or None where not all of it is compiled. Scores
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
        """A `Task` of task.h that is done, or None where compiled code does not know all of it."""
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
    """Whether numbers are of the type that compiled code takes for indices."""
    return numbers.is_cpu and numbers.dtype == torch.long


def program_of(graphs: Graphs, known: CompiledActions, limits: tuple[int, int]) -> Any:
    """A `Program` of program.h, or None where graphs or limits are none that it can be made of."""
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
    """An environment's models as compiled code knows them, and a `ModelEnvironment` of models.h."""
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
