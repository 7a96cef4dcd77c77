"""Algorithm 3 compiled: Γ, C and the actions of section VI on the CPU, graph after graph.

It says what the batched engine in torch says, which runs everything else: actions, models and
worlds of others, and other devices. `rollout` asks here first.
"""

import ctypes
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from cgtorch.graphs import Graphs
from cgtorch.native import function, threads
from cgtorch.native.structures import POINTER, WHOLE, structures
from cgtorch.simulation.action_table import FAILURE, SUCCESS
from cgtorch.simulation.engine_inputs import LARGEST, Interpreter
from cgtorch.simulation.program import check_numbers
from cgtorch.simulation.rollouts import Rollouts

NO_MEMORY, WRONG_GRAPHS = 1, 2  # as in rollout.c


def compiled_rollout(
    interpreter: Interpreter,
    graphs: Graphs,
    scenarios: Tensor,
    max_transitions: int,
    max_steps: int,
) -> Rollouts | None:
    """The rollouts of P graphs on B scenarios, or None where they have to be run in torch.

    Args:
        interpreter: of the graphs' actions in the models.
        graphs: P of them.
        scenarios: (B,) long.
        max_transitions: see `cgtorch.simulation.rollout`.
        max_steps: likewise.

    Raises:
        GraphError: a graph has an action, a head or a start that is none of its own.
        MemoryError: there is none for the first percepts of so many scenarios.
    """
    p, b, like = len(graphs), len(scenarios), graphs.parameters
    percept, state = like.new_empty(p, b, interpreter.size), like.new_empty(p, b, 3)
    status, transitions = torch.empty(2, p, b, dtype=torch.long).unbind()

    def run(task: Any) -> int:
        made = (percept, state, status, transitions)
        task.percept, task.state, task.status, task.transitions = (x.data_ptr() for x in made)
        return _function("rollouts", like.dtype)(ctypes.addressof(task), threads())

    if not _done(run, interpreter, graphs, scenarios, max_transitions, max_steps):
        return None
    succeeded = status == SUCCESS
    return Rollouts(
        succeeded=succeeded,
        timed_out=~succeeded & (status != FAILURE),
        percept=percept,
        state=state,
        transitions=transitions,
    )


def compiled_evaluation(
    interpreter: Interpreter,
    graphs: Graphs,
    scenarios: Tensor,
    kept: int,
    max_transitions: int,
    max_steps: int,
    again: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor, int, int] | None:
    """What P graphs achieve on all B scenarios, by eq. 3.

    W comes first: a graph that has failed there is not run on the rest.

    Args:
        interpreter: of the graphs' actions in the models.
        graphs: P of them.
        scenarios: (B,) long, all of them, those of W first.
        kept: how many are of W.
        max_transitions: see `cgtorch.simulation.rollout`.
        max_steps: likewise.
        again: (4,) long, how often more Γ, C, networks and the check of motions are done, which
            changes no result: how much longer it takes says how long each of them does.

    Returns:
        Fitness (P,), the means of scores (P, B), which are C(p_t) or half of it without success,
        and 0 where W is lost; successes (P, B); actions executed by all; and of how many graphs
        some number was not finite, whose scores and successes are 0. Or None, where it has to be
        done in torch.

    Raises:
        GraphError: see `compiled_rollout`.
        MemoryError: likewise.
    """
    p, b, like = len(graphs), len(scenarios), graphs.parameters
    score, succeeded = like.new_empty(p, b), torch.empty(p, b, dtype=torch.bool)
    fitness = torch.empty(p)
    given = structures(like.dtype).Evaluation()

    def run(task: Any) -> int:
        task.again = None if again is None else again.data_ptr()
        given.task, given.keep = task, kept
        made = fitness, score, succeeded
        given.fitness, given.score, given.succeeded = (x.data_ptr() for x in made)
        return _function("evaluations", like.dtype)(ctypes.addressof(given), threads())

    if not _done(run, interpreter, graphs, scenarios, max_transitions, max_steps):
        return None
    return fitness, score.float(), succeeded, given.transitions, given.not_finite


def _done(
    run: Callable[[Any], int],
    interpreter: Interpreter,
    graphs: Graphs,
    scenarios: Tensor,
    max_transitions: int,
    max_steps: int,
) -> bool:
    """Whether compiled code knows all of it, and `run` has run the `Task` (lanes.h) that it is.

    Where to write is for `run` to say.
    """
    if not _takes(interpreter, graphs, scenarios, max(max_transitions, max_steps)):
        return False
    tensors = graphs.action, graphs.edges, graphs.start, graphs.parameters, scenarios
    kept = [x.contiguous() for x in tensors]
    made, pointers = structures(interpreter.dtype), [x.data_ptr() for x in kept]
    program = made.Program.from_buffer_copy(interpreter.program)
    program.action, program.edges, program.start, program.parameters, first = pointers
    (_, program.nodes, program.seen), program.each = graphs.edges.shape, kept[3].shape[2]
    why = run(
        made.Task(
            program=ctypes.addressof(program),
            models=interpreter.models.address,
            scenarios=first,
            graphs=len(graphs),
            count=len(scenarios),
            max_transitions=max_transitions,
            max_steps=max_steps,
        )
    )
    if why == WRONG_GRAPHS:
        check_numbers(graphs, interpreter.actions)
    if why == NO_MEMORY:
        raise MemoryError(
            f"there is no memory for the first percepts of {len(scenarios)} scenarios; give fewer"
        )
    return True


def _takes(interpreter: Interpreter, graphs: Graphs, scenarios: Tensor, longest: int) -> bool:
    """Whether these graphs are of sizes and types that compiled code knows."""
    nodes = graphs.action.numel() + interpreter.program.rows
    whole = graphs.action, graphs.edges, graphs.start, scenarios
    return (
        max(nodes, longest, interpreter.longest) <= LARGEST
        and graphs.edges.shape[2] <= interpreter.outcomes
        and graphs.parameters.dtype == interpreter.dtype
        and graphs.parameters.is_cpu
        and all(x.is_cpu and x.dtype == torch.long for x in whole)
    )


def _function(name: str, dtype: torch.dtype) -> Any:
    return function(name, dtype, POINTER, WHOLE)
