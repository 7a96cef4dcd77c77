"""Algorithm 3 compiled: Γ, C and the actions of section VI on the CPU, graph after graph.

It says what the batched engine in torch says, which runs everything else: actions, models and
worlds of others, and other devices. `rollout` asks here first.
"""

import ctypes
from collections.abc import Mapping
from typing import TypeAlias
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from cgtorch.actions import (
    Action,
    BranchingNN,
    ContinuousNN,
    Detect,
    EdgeBranchingNN,
    EdgeNN,
    Grasp,
    MoveBase,
)
from cgtorch.environment import Environment
from cgtorch.models import SuccessClassifier, TransitionModel
from cgtorch.models.compiled import Compiled
from cgtorch.native import function, threads
from cgtorch.native.structures import (
    MOST_DEPTH,
    MOST_HIDDEN,
    MOST_MESSAGE,
    MOST_PERCEPT,
    POINTER,
    WHOLE,
    structures,
    suits,
)
from cgtorch.simulation.model import ModelEnvironment
from cgtorch.simulation.program import FAILURE, SUCCESS, Program
from cgtorch.simulation.rollouts import Rollouts
from cgtorch.world.clear_way import ClearWay, body_structure

KINDS: Mapping[type, int] = {
    kind: number
    for number, kind in enumerate(
        (MoveBase, Detect, Grasp, ContinuousNN, BranchingNN, EdgeNN, EdgeBranchingNN)
    )
}
"""What compiled code knows, in the order of its enumeration."""
LARGEST = 2**30
"""Nodes, transitions and scenarios that it can count."""
NO_MEMORY = "there is no memory for the first percepts of {} scenarios; give fewer"


def compiled_rollout(
    program: Program,
    environment: Environment,
    scenarios: Tensor,
    max_transitions: int,
    max_steps: int,
    ticks: Tensor | None = None,
) -> Rollouts | None:
    """The rollouts of P graphs on B scenarios, or None where they have to be run in torch.

    Args:
        program: the graphs.
        environment: where they run.
        scenarios: (B,) long.
        max_transitions: see `cgtorch.simulation.rollout`.
        max_steps: likewise.
        ticks: (2, 4) long to which ticks of the CPU's clock are added that Γ, C, networks and the
            check of motions take, and how often each was timed; then one thread runs.
    """
    call = function("rollouts", program.parameters.dtype, POINTER, WHOLE)
    task = _task(program, environment, scenarios, max_transitions, max_steps, ticks)
    if call is None or task is None:
        return None
    p, b, like = len(program.start), len(scenarios), program.parameters
    percept, state = like.new_empty(p, b, environment.percept_size), like.new_empty(p, b, 3)
    status, transitions = torch.empty(2, p, b, dtype=torch.long).unbind()
    given, made = task.structure, (percept, state, status, transitions)
    given.percept, given.state, given.status, given.transitions = (x.data_ptr() for x in made)
    if call(task.address, threads()):
        raise MemoryError(NO_MEMORY.format(len(scenarios)))
    succeeded = status == SUCCESS
    return Rollouts(
        succeeded=succeeded,
        timed_out=~succeeded & (status != FAILURE),
        percept=percept,
        state=state,
        transitions=transitions,
    )


def compiled_evaluation(
    program: Program,
    environment: Environment,
    keep: Tensor,
    max_transitions: int,
    max_steps: int,
    ticks: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor, Tensor] | None:
    """What P graphs of as many slots each achieve on all B scenarios, by eq. 3.

    W comes first: a graph that has failed there is not run on the rest.

    Args:
        program: the graphs.
        environment: the models.
        keep: (B,) bool, the scenarios of W.
        max_transitions: see `cgtorch.simulation.rollout`.
        max_steps: likewise.
        ticks: as for `compiled_rollout`.

    Returns:
        Scores (P, B), C(p_t) or half of it without success, and 0 where W is lost; successes
        (P, B); actions executed (P,); whether all numbers were finite (P,). Or None, where it has
        to be done in torch.
    """
    call = function("evaluations", program.parameters.dtype, POINTER, WHOLE)
    if call is None or keep.device.type != "cpu":
        return None
    kept = keep.tolist()
    order = torch.tensor(sorted(range(len(kept)), key=lambda i: not kept[i]), dtype=torch.long)
    task = _task(program, environment, order, max_transitions, max_steps, ticks)
    if task is None:
        return None
    p, b = len(program.start), len(keep)
    score = program.parameters.new_zeros(p, b)
    succeeded = torch.zeros(p, b, dtype=torch.bool)
    finite, transitions = torch.empty(p, dtype=torch.bool), torch.empty(p, dtype=torch.long)
    made = (score, succeeded, finite, transitions)
    evaluation = structures(score.dtype).Evaluation(
        task.structure, sum(kept), *(x.data_ptr() for x in made)
    )
    if call(ctypes.addressof(evaluation), threads()):
        raise MemoryError(NO_MEMORY.format(b))
    return score.float(), succeeded, transitions, finite


def _task(
    program: Program,
    environment: Environment,
    scenarios: Tensor,
    max_transitions: int,
    max_steps: int,
    ticks: Tensor | None,
) -> Compiled | None:
    """What there is to do, without where to write, if compiled code knows all of it."""
    if not isinstance(environment, ModelEnvironment) or scenarios.device.type != "cpu":
        return None
    if program.parameters.dtype != environment.percepts.dtype:
        return None
    longest = max([max_transitions, *program.limit.tolist()])
    if max(len(program.kind), longest, max_steps, environment.num_scenarios) > LARGEST:
        return None
    nodes, models = _program(program, environment.percept_size), _models(environment)
    if nodes is None or models is None:
        return None
    scenarios = scenarios.contiguous()
    made = structures(program.parameters.dtype).Task(
        program=nodes.address,
        models=models.address,
        scenarios=scenarios.data_ptr(),
        graphs=len(program.start),
        count=len(scenarios),
        max_transitions=max_transitions,
        max_steps=max_steps,
        ticks=None if ticks is None else ticks.data_ptr(),
    )
    made.parts = nodes, models  # they must live as long
    return Compiled(made, (scenarios,))


def _program(program: Program, percept_size: int) -> Compiled | None:
    """The node table, if compiled code knows all actions in it and has room for them."""
    actions = program.primitives
    if not all(_known(action, percept_size) for action in actions):
        return None
    if program.depth > MOST_DEPTH:
        return None
    made = structures(program.parameters.dtype)
    table = (made.Action * max(1, len(actions)))(
        *(
            made.Action(
                KINDS[type(a)],
                getattr(a, "inputs", 0),
                getattr(a, "hidden", 0),
                getattr(a, "outputs", 0),
            )
            for a in actions
        )
    )
    kept = tuple(
        tensor.contiguous()
        for tensor in (
            program.kind, program.heads, program.start, program.entry, program.limit,
            program.parameters,
        )
    )  # fmt: skip
    pointers = (tensor.data_ptr() for tensor in kept)
    structure = made.Program(
        ctypes.addressof(table), *pointers, len(actions), program.heads.shape[1],
        program.parameters.shape[1], program.depth, program.nodes,
    )  # fmt: skip
    structure.table = table  # it must live as long
    return Compiled(structure, kept)


def _known(action: Action, percept_size: int) -> bool:
    kind = type(action)
    if kind not in KINDS or "forward" in vars(action):
        return False
    if isinstance(action, EdgeNN | EdgeBranchingNN):
        fits = action.percept_size == percept_size
    elif isinstance(action, ContinuousNN | BranchingNN):
        fits = action.inputs <= percept_size
    else:
        return True
    return fits and action.hidden <= MOST_HIDDEN and action.outputs <= MOST_MESSAGE


def _models(environment: ModelEnvironment) -> Compiled | None:
    """Γ, C, errors and first percepts, if compiled code knows these models.

    An evolution asks for the same ones in every generation, so the last are remembered for as long
    as none of their numbers is written to.
    """
    e, gamma = environment, getattr(environment.gamma, "__self__", None)
    classifier, possible = e.classifier, e.possible
    if not (type(gamma) is TransitionModel and type(classifier) is SuccessClassifier):
        return None
    if type(e) is not ModelEnvironment or type(possible) is not ClearWay:
        return None
    if e.gamma != gamma.predict_with_novelty:
        return None
    mine = (e.percepts, e.first_state, e.errors, possible.footprint)
    tensors = [t for t in (*mine, *gamma.tensors(), *classifier.tensors()) if t is not None]
    state = (torch.is_grad_enabled(), e.most_novel, e.control_size, *map(_state, tensors))
    last = _LAST.get(e)
    if last is None or last[0] != state:
        _LAST[e] = last = state, tensors, _models_now(e, gamma, classifier, possible)
    return last[2]


_Known: TypeAlias = tuple[object, list[Tensor], Compiled | None]
_LAST: WeakKeyDictionary[ModelEnvironment, _Known] = WeakKeyDictionary()
"""Of each environment its tensors' state, these tensors, so that no others can be mistaken for
them, and what compiled code knows of them."""


def _state(tensor: Tensor) -> tuple[int, int, int]:
    """What is another where a tensor is another, or has been written to."""
    return id(tensor), tensor.data_ptr(), 0 if tensor.is_inference() else tensor._version


def _models_now(
    e: ModelEnvironment, gamma: TransitionModel, classifier: SuccessClassifier, possible: ClearWay
) -> Compiled | None:
    percepts = e.percepts.contiguous()
    errors = None if e.errors is None else e.errors.contiguous()
    given = (percepts, e.first_state, possible.footprint, *([] if errors is None else [errors]))
    if not suits(*given) or e.control_size != 3 or percepts.shape[1] > MOST_PERCEPT:
        return None
    first, second = gamma.compiled(percepts, percepts[:, :3]), classifier.compiled(percepts)
    if first is None or second is None:
        return None
    structure = structures(percepts.dtype).Models(
        first.structure, second.structure, body_structure(possible.footprint),
        percepts.data_ptr(), e.first_state.data_ptr(),
        None if errors is None else errors.data_ptr(),
        percepts.shape[1], 1 if errors is None else errors.shape[1], e.most_novel,
    )  # fmt: skip
    return Compiled(structure, (*given, *first.kept, *second.kept))
