"""Algorithm 3 compiled: Γ, C and the actions of section VI on the CPU, one lane after the other.

It says what the batched engine in torch says, which runs everything else: actions, models and
worlds of others, and other devices. `rollout` asks here first.
"""

import ctypes
from collections.abc import Mapping

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
"""What rollout.c knows, in the order of its enumeration."""


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
        ticks: (4,) long to which ticks of the CPU's clock are added that Γ, C, networks and the
            check of motions take; then one thread runs.
    """
    if not isinstance(environment, ModelEnvironment):
        return None
    nodes, models = _program(program, environment.percept_size), _models(environment)
    call = function("rollout", "rollouts", environment.percepts.dtype, POINTER, WHOLE)
    if nodes is None or models is None or call is None:
        return None
    if program.parameters.dtype != environment.percepts.dtype or scenarios.device.type != "cpu":
        return None
    p, b, like = len(program.start), len(scenarios), environment.percepts
    percept, state = like.new_empty(p, b, like.shape[1]), like.new_empty(p, b, 3)
    status, transitions = torch.empty(2, p, b, dtype=torch.long).unbind()
    scenarios = scenarios.contiguous()
    task = structures(like.dtype).Task(
        nodes.address, models.address, scenarios.data_ptr(), p, b, max_transitions, max_steps,
        percept.data_ptr(), state.data_ptr(), status.data_ptr(), transitions.data_ptr(),
        None if ticks is None else ticks.data_ptr(),
    )  # fmt: skip
    call(ctypes.addressof(task), threads())
    succeeded = status == SUCCESS
    return Rollouts(
        succeeded=succeeded,
        timed_out=~succeeded & (status != FAILURE),
        percept=percept,
        state=state,
        transitions=transitions,
    )


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
        program.parameters.shape[1], program.depth,
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
    """Γ, C, errors and first percepts, if compiled code knows these models."""
    e, percepts = environment, environment.percepts.contiguous()
    gamma, known = getattr(e.gamma, "__self__", None), type(e) is ModelEnvironment
    if not (known and type(gamma) is TransitionModel and type(e.classifier) is SuccessClassifier):
        return None
    if e.gamma != gamma.predict_with_novelty or type(e.possible) is not ClearWay:
        return None
    errors = None if e.errors is None else e.errors.contiguous()
    given = (percepts, e.first_state, e.possible.footprint, *([] if errors is None else [errors]))
    if not suits(*given) or e.control_size != 3 or percepts.shape[1] > MOST_PERCEPT:
        return None
    first, second = gamma.compiled(percepts, percepts[:, :3]), e.classifier.compiled(percepts)
    if first is None or second is None:
        return None
    structure = structures(percepts.dtype).Models(
        first.structure, second.structure, body_structure(e.possible.footprint),
        percepts.data_ptr(), e.first_state.data_ptr(),
        None if errors is None else errors.data_ptr(),
        percepts.shape[1], 1 if errors is None else errors.shape[1], e.most_novel,
    )  # fmt: skip
    return Compiled(structure, (*given, *first.kept, *second.kept))
