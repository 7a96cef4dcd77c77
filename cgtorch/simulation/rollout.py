"""Algorithm 3: run every graph on every scenario."""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import torch
from torch import Tensor

from cgtorch.actions import ActionSet
from cgtorch.environment import Environment, Lanes, start_lanes
from cgtorch.graphs import Graphs
from cgtorch.simulation.compiled import compiled_rollout
from cgtorch.simulation.frames import TIMEOUT, first_frames, follow
from cgtorch.simulation.interpreter import interpreter
from cgtorch.simulation.program import Program, compile_graphs
from cgtorch.simulation.rollouts import Rollouts
from cgtorch.simulation.vocabulary import FAILURE, SUCCESS

MAX_TRANSITIONS = 20
MAX_STEPS = MAX_TRANSITIONS**2
"""What a skill of skills can execute if each of its transitions is a sub-skill that runs out of its
own."""

Trace: TypeAlias = Callable[[Tensor, Tensor, Tensor, Lanes], None]


def rollout(
    graphs: Graphs,
    actions: ActionSet,
    environment: Environment,
    *,
    scenarios: Tensor | None = None,
    max_transitions: int = MAX_TRANSITIONS,
    max_steps: int = MAX_STEPS,
    trace: Trace | None = None,
) -> Rollouts:
    """Run P graphs on B scenarios of the environment.

    A sub-skill counts as one transition of the skill it is in and has a limit of its own
    (`Skill.max_transitions`); `max_steps` bounds the actions a lane executes on all levels
    together. A lane that has ended leaves the batch, and one that comes back to a node
    with nothing changed can only run out of transitions, so these are counted but not executed.

    Args:
        graphs: P valid graphs.
        actions: what their action indices mean.
        environment: where they run.
        scenarios: (B,) long, indices into the environment's scenarios; all if not given.
        max_transitions: of each graph, not counting those within its sub-skills.
        max_steps: actions per lane on all levels.
        trace: called after every step with the lanes' indices (n,) into P·B, the rows (n,) of
            the program's node table that ran, their outcomes (n,), and the lanes afterwards,
            which the next step overwrites. Then every transition is executed.

    Raises:
        GraphError: a graph has an action, a head or a start that is none of its own.
    """
    if scenarios is None:
        scenarios = torch.arange(environment.num_scenarios, device=graphs.start.device)
    if trace is None and (known := interpreter(actions, environment)):
        found = compiled_rollout(known, graphs, scenarios, max_transitions, max_steps)
        if found is not None:
            return found
    program = compile_graphs(graphs, actions)
    return rollout_in_torch(program, environment, scenarios, max_transitions, max_steps, trace)


def rollout_in_torch(
    program: Program,
    environment: Environment,
    scenarios: Tensor,
    max_transitions: int,
    max_steps: int,
    trace: Trace | None = None,
) -> Rollouts:
    """The same for any actions, environment and device, all lanes in one batch."""
    p, b = len(program.start), len(scenarios)
    lanes = start_lanes(environment, scenarios.repeat(p), program.message_size, program.memory_size)
    frames = first_frames(program, b, max_transitions)
    status, transitions = torch.zeros_like(frames.node), lanes.step.clone()
    percept, state = lanes.percept.clone(), lanes.state.clone()
    active = torch.arange(p * b, device=status.device)
    while len(active):
        node = frames.node
        lanes, outcome, changed = _act(program, lanes, node, environment)
        if trace:
            trace(active, node, outcome, lanes)
            changed = torch.ones_like(changed)
        frames, end, skipped = follow(program, frames, outcome, changed)
        lanes = replace(lanes, step=lanes.step + 1 + skipped)
        out_of_steps = lanes.step >= max_steps
        end = torch.where(out_of_steps & (skipped > 0), TIMEOUT, end)
        over = (end != 0) | out_of_steps
        if over.any():
            gone, stay = over.nonzero()[:, 0], (~over).nonzero()[:, 0]
            who, last = active.index_select(0, gone), lanes.rows(gone)
            status.index_copy_(0, who, end.index_select(0, gone))
            percept.index_copy_(0, who, last.percept)
            state.index_copy_(0, who, last.state)
            transitions.index_copy_(0, who, last.step.clamp_max(max_steps))
            active = active.index_select(0, stay)
            lanes, frames = lanes.rows(stay), frames.rows(stay)
    return Rollouts(
        succeeded=(status == SUCCESS).view(p, b),
        timed_out=((status != SUCCESS) & (status != FAILURE)).view(p, b),
        percept=percept.view(p, b, percept.shape[1]),
        state=state.view(p, b, state.shape[1]),
        transitions=transitions.view(p, b),
    )


def _act(
    program: Program, lanes: Lanes, node: Tensor, environment: Environment
) -> tuple[Lanes, Tensor, Tensor]:
    """Run each lane's action, one batch per kind of action; `lanes` is overwritten.

    Returns:
        The lanes, (n,) their outcomes, and (n,) bool whether anything about a lane has changed
        on which a later action could depend.
    """
    kind = program.kind.index_select(0, node)
    outcome = torch.empty_like(node)
    changed = torch.ones_like(node, dtype=torch.bool)
    for i, action in enumerate(program.primitives):
        here = (kind == i).nonzero()[:, 0]
        if len(here):
            seen = lanes.with_memory(program.memory[i]) if program.memory_size else lanes
            nodes, before = node.index_select(0, here), seen.rows(here)
            parameters = program.parameters.index_select(0, nodes)[:, : action.num_parameters]
            after, out = action(before, parameters, environment)
            outcome.index_copy_(0, here, out)
            seen.write(here, before, after)
            if action.deterministic:
                changed.index_copy_(0, here, after.differs(before))
    return lanes, outcome, changed
