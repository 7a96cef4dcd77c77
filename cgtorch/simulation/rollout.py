"""Algorithm 3: run every graph on every scenario, compiled on the CPU or a GPU, or in torch."""

from dataclasses import fields
from typing import Any

import torch
from torch import Tensor

from cgtorch.graphs import ActionSet, Graphs
from cgtorch.graphs.action_set import AN_ACTION_SET
from cgtorch.graphs.skill import MOST_TRANSITIONS
from cgtorch.ground.dry_run import check_methods
from cgtorch.ground.environment import Bounded, Environment
from cgtorch.ground.given import of_kind, whole_number
from cgtorch.native.gpu import Gpu, launcher_of
from cgtorch.simulation.compiled import (
    LARGEST,
    NETWORKS,
    ROUTINES,
    WITH_MEMORY,
    CompiledEngine,
    compiled_actions,
    compiled_models,
)
from cgtorch.simulation.gpu_engine import GpuEngine, gpu_engine
from cgtorch.simulation.model import ModelEnvironment
from cgtorch.simulation.program import action_table, compile_graphs
from cgtorch.simulation.resumable import resumable_rollout
from cgtorch.simulation.torch_engine import MOST_IDLE, Rollouts, Trace, rollout_in_torch

MAX_TRANSITIONS = 20
MAX_STEPS = MAX_TRANSITIONS**2
"""The number of actions that a skill can execute if each of its transitions is a sub-skill that
uses all transitions of its own. For other limits see `most_steps`."""


def rollout(
    graphs: Graphs,
    actions: ActionSet,
    environment: Environment,
    *,
    scenarios: Tensor | None = None,
    max_transitions: int = MAX_TRANSITIONS,
    max_steps: int | None = None,
    trace: Trace | None = None,
) -> Rollouts:
    """Run P graphs on B scenarios of the environment.

    A sub-skill counts as one transition of the skill that contains it, and has its own limit
    (`Skill.max_transitions`). A lane that returns to a node with nothing changed can only run out
    of transitions, so the rest of its transitions is counted but not executed.

    Args:
        graphs: P valid graphs.
        actions: The action set of the graphs.
        environment: Where they run.
        scenarios: (B,) long, indices of scenarios; all by default.
        max_transitions: Of each graph, not counting those within its sub-skills.
        max_steps: Actions per lane on all levels; `most_steps` by default.
        trace: Called after every step with the lanes' indices (n,) into P·B, the rows (n,) of the
            program's table that ran, their outcomes (n,), and the lanes afterwards, which the next
            step overwrites. With a trace, every transition is executed.

    Raises:
        GraphError: An action, a head or a start does not exist.
        SettingsError: Something given is of another kind.
        WorldError: The environment is none.
    """
    of_kind(graphs, Graphs, "graphs", "Graphs, such as skill.graph")
    of_kind(actions, ActionSet, "actions", AN_ACTION_SET)
    check_methods(environment)
    max_transitions = whole_number(max_transitions, "max_transitions", 0, MOST_TRANSITIONS)
    if scenarios is None:
        scenarios = torch.arange(environment.num_scenarios, device=graphs.start.device)
    most = most_steps(actions, max_transitions) if max_steps is None else max_steps
    max_steps = whole_number(most, "max_steps", 0, LARGEST)
    limits = max_transitions, max_steps
    if trace is None and isinstance(environment, Bounded):
        most = environment.most_lanes
        if len(graphs) * len(scenarios) > most and len(scenarios):
            return _in_parts(graphs, actions, environment, scenarios, limits, most)
    if trace is None:
        engine = engine_of(actions, environment)
        found = engine and engine.rollouts(graphs, scenarios, *limits)
        given = graphs, actions, environment, scenarios, (*limits, MOST_IDLE)
        compiled = None if isinstance(engine, GpuEngine) else engine
        if found := found or resumable_rollout(*given, compiled):
            return found
    program = compile_graphs(graphs, actions)
    return rollout_in_torch(program, environment, scenarios, *limits, trace)


def _in_parts(
    graphs: Graphs,
    actions: ActionSet,
    environment: Environment,
    scenarios: Tensor,
    limits: tuple[int, int],
    most: int,
) -> Rollouts:
    """`rollout` of at most so many lanes at once."""
    b, rows = min(most, len(scenarios)), list[Rollouts]()
    how: dict[str, Any] = {"max_transitions": limits[0], "max_steps": limits[1]}
    for some in torch.arange(len(graphs)).split(max(1, most // b)):
        about = graphs[some], actions, environment
        parts = [rollout(*about, scenarios=part, **how) for part in scenarios.split(b)]
        rows.append(_joined(parts, 1))
    return _joined(rows, 0)


def _joined(parts: list[Rollouts], dim: int) -> Rollouts:
    """Rollouts of more graphs (`dim` 0) or scenarios (1)."""
    columns: dict[str, list[Any]] = {
        f.name: [getattr(part, f.name) for part in parts] for f in fields(Rollouts)
    }
    executed = sum(columns.pop("executed"))
    joined: Any = {n: None if v[0] is None else torch.cat(v, dim) for n, v in columns.items()}
    return Rollouts(**joined, executed=executed)


def most_steps(actions: ActionSet, max_transitions: int) -> int:
    """The number of actions of a graph each of whose transitions is the longest sub-skill."""
    longest = max([max_transitions, *action_table(actions).limits])
    return max(MAX_STEPS, min(longest * max_transitions, LARGEST))


def engine_of(
    actions: ActionSet, environment: Environment, gpu: Gpu | None = None
) -> CompiledEngine | None:
    """The engine of actions in models, or None if the environment is not compiled.

    For models on a GPU it is an engine on that GPU, or on `gpu` if given.
    """
    if type(environment) is not ModelEnvironment or environment.compiled is None:
        return None
    device = environment.percepts.device
    gpu = gpu or launcher_of(device)
    found = compiled_models(environment) if gpu or device.type == "cpu" else None
    if found is None:
        return None
    models, own = found
    size, kinds = environment.percept_size, (*ROUTINES, *NETWORKS, *WITH_MEMORY, *models.networks)
    known = compiled_actions(actions, size, models.dtype, kinds)
    if known is None or known.table.message_size < environment.control_size:
        return None
    if gpu:
        return gpu_engine(actions, known, models, own, size, gpu)
    return CompiledEngine(actions, known, models, own, size)
