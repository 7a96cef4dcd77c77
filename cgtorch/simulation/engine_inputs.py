"""What compiled rollouts need to know of actions and models, whatever the graphs."""

import ctypes
from dataclasses import dataclass
from typing import Any

import torch

from cgtorch.actions import Action, ActionSet
from cgtorch.environment import Environment
from cgtorch.native import function
from cgtorch.native.structures import (
    ACTION_KINDS,
    MOST_DEPTH,
    MOST_HIDDEN,
    MOST_MESSAGE,
    POINTER,
    WHOLE,
    structures,
)
from cgtorch.simulation.action_table import Vocabulary, ends, vocabulary
from cgtorch.simulation.model import ModelEnvironment
from cgtorch.simulation.program import skill_tables
from cgtorch.svm.compiled import Compiled

EXACT = ("EDGE", "EDGE_BRANCHING")
"""Read percepts of one length only."""
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
                ACTION_KINDS.index(a.native_kind),
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
    """Whether compiled code has a counterpart of this action, with room for its sizes."""
    kind = vars(type(action)).get("native_kind")
    if kind not in ACTION_KINDS or "forward" in vars(action):
        return False
    inputs = getattr(action, "percept_size", 0)
    fits = inputs == percept_size if kind in EXACT else inputs <= percept_size
    hidden, outputs = getattr(action, "hidden", 0), getattr(action, "outputs", 0)
    return fits and hidden <= MOST_HIDDEN and outputs <= MOST_MESSAGE


def _models(environment: ModelEnvironment) -> Compiled | None:
    """Γ, C, errors and first percepts, if the domain has them for compiled code."""
    if type(environment) is not ModelEnvironment or environment.compiled is None:
        return None
    found: Compiled | None = environment.compiled(environment)
    return found
