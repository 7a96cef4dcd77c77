"""Algorithm 3: run every graph on every scenario."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import TypeAlias

import torch
from torch import Tensor

from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground.environment import Environment, Lanes, Rewarded, rows_where, start_lanes
from cgtorch.simulation.action_table import FAILURE, SUCCESS, TIMEOUT, action_table
from cgtorch.simulation.call_stack import advance, first_frames
from cgtorch.simulation.compiled import CompiledEngine
from cgtorch.simulation.compiled_actions import LARGEST
from cgtorch.simulation.engines import engine_of
from cgtorch.simulation.program import Program, compile_graphs
from cgtorch.simulation.resumable import resumable_rollout
from cgtorch.simulation.rollouts import Rollouts

MAX_TRANSITIONS = 20
MAX_STEPS = MAX_TRANSITIONS**2
"""The number of actions that a skill can execute if each of its transitions is a sub-skill that
uses all transitions of its own. For other limits see `most_steps`."""

LARGEST_BATCH = 2**40  # lanes
MOST_IDLE = 64
"""The number of actions in a row that may leave the state of an environment with rewards as it is.
Its episodes can be thousands of actions long, and a lane that only exchanges messages would waste
that time."""

Trace: TypeAlias = Callable[[Tensor, Tensor, Tensor, Lanes], None]


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
    (`Skill.max_transitions`). `max_steps` bounds the actions that a lane executes on all levels
    together. A lane that has ended leaves the batch. A lane that returns to a node with nothing
    changed can only run out of transitions, so the rest of its transitions is counted but not
    executed.

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
    """
    if scenarios is None:
        scenarios = torch.arange(environment.num_scenarios, device=graphs.start.device)
    max_steps = most_steps(actions, max_transitions) if max_steps is None else max_steps
    limits = max_transitions, max_steps
    if trace is None:
        engine = engine_of(actions, environment)
        found = engine and engine.rollouts(graphs, scenarios, *limits)
        given = graphs, actions, environment, scenarios, (*limits, MOST_IDLE)
        compiled = engine if isinstance(engine, CompiledEngine) else None
        if found := found or resumable_rollout(*given, compiled):
            return found
    program = compile_graphs(graphs, actions)
    return rollout_in_torch(program, environment, scenarios, *limits, trace)


def most_steps(actions: ActionSet, max_transitions: int) -> int:
    """The number of actions of a graph each of whose transitions is the longest sub-skill."""
    longest = max([max_transitions, *action_table(actions).limits])
    return max(MAX_STEPS, min(longest * max_transitions, LARGEST))


def rollout_in_torch(
    program: Program,
    environment: Environment,
    scenarios: Tensor,
    max_transitions: int,
    max_steps: int,
    trace: Trace | None = None,
) -> Rollouts:
    """`rollout` for any actions, environment and device, with all lanes in one batch.

    Before each step, lanes are sorted by their next action, so that those with the same action are
    adjacent, and lanes that have ended leave. Their counts are all that the host reads per step, so
    a GPU is synchronised once per step.
    """
    p, b = len(program.start), len(scenarios)
    sizes = program.actions.message_size, program.actions.memory_size
    lanes = start_lanes(environment, scenarios.repeat(p), *sizes)
    frames = first_frames(program, b, max_transitions)
    status, transitions = torch.zeros_like(frames.node), lanes.step.clone()
    rewards = environment if isinstance(environment, Rewarded) else None
    returns = None if rewards is None else lanes.percept.new_full((p * b,), -torch.inf)
    percept, state = lanes.percept.clone(), lanes.state.clone()
    active = torch.arange(p * b, device=status.device)
    over, idle = torch.zeros_like(active, dtype=torch.bool), torch.zeros_like(active)
    executed = 0
    while len(active):
        order, groups = _grouped(program, frames.node, active, over)
        if not len(order):
            break
        active, lanes, frames = active[order], lanes.rows(order), frames.rows(order)
        executed += len(active)
        node = frames.node
        before = None if rewards is None else lanes.state.clone()
        outcome, changed = _act(program, lanes, node, groups, environment)
        if trace:
            trace(active, node, outcome, lanes)
            changed = torch.ones_like(changed)
        frames, end, skipped = advance(program, frames, outcome, changed)
        lanes = replace(lanes, step=lanes.step + 1 + skipped)
        out_of_steps = lanes.step >= max_steps
        end = torch.where(out_of_steps & (skipped > 0), TIMEOUT, end)
        if rewards is not None and before is not None:
            idle = torch.where((lanes.state != before).any(1), 0, idle[order] + 1)
            end = torch.where((end == 0) & (idle > MOST_IDLE), TIMEOUT, end)
            end = _at_the_end(environment, rewards, lanes, end)
        over = (end != 0) | out_of_steps
        gone = rows_where(over)  # of others that are among them more will be known later
        who, last = active.index_select(0, gone), lanes.rows(gone)
        status.index_copy_(0, who, end.index_select(0, gone))
        percept.index_copy_(0, who, last.percept)
        state.index_copy_(0, who, last.state)
        transitions.index_copy_(0, who, last.step.clamp_max(max_steps))
        if rewards is not None and returns is not None:
            gained = rewards.returns(last).to(returns)
            finished = rewards.over(last) & gained.isfinite()
            returns.index_copy_(0, who, torch.where(finished, gained, -torch.inf))
    return Rollouts(
        succeeded=(status == SUCCESS).view(p, b),
        timed_out=((status != SUCCESS) & (status != FAILURE)).view(p, b),
        percept=percept.view(p, b, percept.shape[1]),
        state=state.view(p, b, state.shape[1]),
        transitions=transitions.view(p, b),
        executed=executed,
        returns=None if returns is None else returns.view(p, b),
    )


def _at_the_end(environment: Environment, rewards: Rewarded, lanes: Lanes, end: Tensor) -> Tensor:
    """How lanes end (n,) if their episodes are over, else the ends given."""
    rows = rows_where(rewards.over(lanes))
    if not len(rows):
        return end
    here = lanes.rows(rows)
    succeeded = environment.success(here)[1] > 0.5
    ends = torch.where(succeeded, SUCCESS, FAILURE)
    return end.index_copy(0, rows, torch.where(rewards.over(here), ends, end[rows]))


def _grouped(
    program: Program, node: Tensor, active: Tensor, over: Tensor
) -> tuple[Tensor, list[slice]]:
    """The k of n lanes that continue, sorted by action, and the slice of each action."""
    count = len(program.actions.primitives)
    kind = torch.where(over, count, program.kind.index_select(0, node))
    order = torch.argsort(active + kind * LARGEST_BATCH)
    bounds = torch.arange(count + 1, device=kind.device)
    ends = torch.searchsorted(kind.index_select(0, order), bounds).tolist()
    return order[: ends[-1]], [slice(*pair) for pair in pairwise(ends)]


def _act(
    program: Program, lanes: Lanes, node: Tensor, groups: list[slice], environment: Environment
) -> tuple[Tensor, Tensor]:
    """Run the lanes' actions, one batch per kind; outcomes (n,), and (n,) which lanes changed."""
    outcome = torch.empty_like(node)
    changed = torch.ones_like(node, dtype=torch.bool)
    table = program.actions
    for action, part, here in zip(table.primitives, table.memory, groups, strict=True):
        if here.start == here.stop:
            continue
        seen = lanes.with_memory(part) if table.memory_size else lanes
        before = seen.part(here)
        parameters = program.parameters.index_select(0, node[here])[:, : action.num_parameters]
        after, outcome[here] = action(before, parameters, environment)
        if action.deterministic:
            changed[here] = after.differs(before)
        seen.write(here, before, after)
    return outcome, changed
