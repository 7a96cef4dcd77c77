"""What compiled rollouts need to know of actions and models, whatever the graphs."""

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cgtorch.actions import (
    Action,
    ActionSet,
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
from cgtorch.native import function
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
from cgtorch.simulation.program import skill_tables
from cgtorch.simulation.vocabulary import Vocabulary, ends, vocabulary
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


@dataclass(frozen=True)
class Interpreter:
    """Actions and models as compiled code knows them, which run any graphs of these actions.

    It is good for as long as nothing about them changes.

    Attributes:
        actions: A, how many a node can be.
        outcomes: O, the most that one of them has.
        dtype: of all numbers.
        size: D, numbers of a percept.
        longest: the most transitions of any sub-skill.
        program: a `Program` of program.h in which the graphs are missing.
        models: Γ, C, errors and first percepts.
        kept: what `program` points into.
    """

    actions: int
    outcomes: int
    dtype: torch.dtype
    size: int
    longest: int
    program: Any
    models: Compiled
    kept: tuple[object, ...]


def interpreter(actions: ActionSet, environment: Environment) -> Interpreter | None:
    """The interpreter of actions in models, or None where rollouts have to be run in torch."""
    if not isinstance(environment, ModelEnvironment) or environment.num_scenarios > LARGEST:
        return None
    if function("rollouts", environment.percepts.dtype, POINTER, WHOLE) is None:
        return None
    known, models = vocabulary(actions), _models(environment)
    size, dtype = environment.percept_size, environment.percepts.dtype
    if models is None or known.depth > MOST_DEPTH:
        return None
    if not all(_known(action, size) for action in known.primitives):
        return None
    if any(skill.graph.parameters.dtype != dtype for skill in known.skills):
        return None
    program, kept = _program(actions, known, dtype)
    return Interpreter(
        actions=len(actions),
        outcomes=actions.outcome_capacity,
        dtype=dtype,
        size=size,
        longest=max([0, *known.limits]),
        program=program,
        models=models,
        kept=kept,
    )


def _program(
    actions: ActionSet, known: Vocabulary, dtype: torch.dtype
) -> tuple[Any, tuple[object, ...]]:
    """The program without graphs, and what it points into."""
    made = structures(dtype)
    primitives = (made.Action * max(1, len(known.primitives)))(
        *(
            made.Action(
                KINDS[type(a)],
                getattr(a, "inputs", 0),
                getattr(a, "hidden", 0),
                getattr(a, "outputs", 0),
            )
            for a in known.primitives
        )
    )
    tables, entry = skill_tables(known, 0, torch.device("cpu"))
    skills = [torch.cat(parts) for parts in zip(*tables, strict=True)] or [torch.empty(0)] * 3
    kept = (
        known.kinds(actions),
        ends(actions),
        *skills[:2],
        torch.tensor(entry, dtype=torch.long),
        torch.tensor(known.limits, dtype=torch.long),
        skills[2],
    )
    program = made.Program(
        ctypes.addressof(primitives), *(tensor.data_ptr() for tensor in kept), len(actions),
        actions.outcome_capacity, len(known.primitives), known.outcomes, known.width,
        len(skills[0]), known.depth,
    )  # fmt: skip
    return program, (primitives, *kept)


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


def _models(e: ModelEnvironment) -> Compiled | None:
    """Γ, C, errors and first percepts, if compiled code knows these models."""
    gamma, classifier = getattr(e.gamma, "__self__", None), e.classifier
    if not (type(gamma) is TransitionModel and type(classifier) is SuccessClassifier):
        return None
    if type(e) is not ModelEnvironment or type(e.possible) is not ClearWay:
        return None
    if e.gamma != gamma.predict_with_novelty:
        return None
    percepts, footprint = e.percepts.contiguous(), e.possible.footprint
    errors = None if e.errors is None else e.errors.contiguous()
    given: list[Tensor] = [percepts, e.first_state, footprint]
    given += [] if errors is None else [errors]
    if not suits(*given) or e.control_size != 3 or percepts.shape[1] > MOST_PERCEPT:
        return None
    first, second = gamma.compiled(percepts, percepts[:, :3]), classifier.compiled(percepts)
    if first is None or second is None:
        return None
    structure = structures(percepts.dtype).Models(
        first.structure, second.structure, body_structure(footprint),
        percepts.data_ptr(), e.first_state.data_ptr(),
        None if errors is None else errors.data_ptr(),
        percepts.shape[1], 1 if errors is None else errors.shape[1], e.most_novel,
    )  # fmt: skip
    return Compiled(structure, (*given, *first.kept, *second.kept))
