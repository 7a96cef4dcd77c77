"""Algorithm 3: run every graph on every scenario, all in one batch."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import torch
from torch import Tensor

from cgtorch.actions import ActionSet
from cgtorch.environment import Environment, Lanes, start_lanes
from cgtorch.graphs import Graphs
from cgtorch.simulation.program import FAILURE, SUCCESS, Program, compile_graphs

MAX_TRANSITIONS = 20
MAX_STEPS = MAX_TRANSITIONS**2
"""What a skill of skills can execute if each of its transitions is a sub-skill that runs out of its
own."""
TIMEOUT = -3

Trace: TypeAlias = Callable[[Tensor, Tensor, Tensor, Lanes], None]


@dataclass(frozen=True)
class Rollouts:
    """How P graphs did on B scenarios.

    Attributes:
        succeeded: (P, B) bool, a terminal outcome with success was reached.
        timed_out: (P, B) bool, no terminal outcome within the limit of transitions.
        percept: (P, B, D), the last percept p_t.
        state: (P, B, S), what the environment kept of the lane at its end.
        transitions: (P, B) long, actions executed.
    """

    succeeded: Tensor
    timed_out: Tensor
    percept: Tensor
    state: Tensor
    transitions: Tensor


@dataclass(frozen=True)
class _Frames:
    """Where each of L lanes stands: its node and, per level of sub-skills, what it returns to.

    `level` (L,) is the innermost open level; `caller` (L, depth) the sub-skill node that opened
    each, `left` (L, depth) the transitions it has left. `anchor` (L,) is a node the lane was at
    `since` (L,) or fewer transitions ago with nothing having changed since then.
    """

    node: Tensor
    level: Tensor
    caller: Tensor
    left: Tensor
    anchor: Tensor
    since: Tensor


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
    together. A lane that has ended leaves the batch, and one that comes back to a node with
    nothing changed can only run out of transitions, so these are counted but not executed.

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
    """
    program = compile_graphs(graphs, actions)
    device = program.kind.device
    if scenarios is None:
        scenarios = torch.arange(environment.num_scenarios, device=device)
    p, b = len(graphs), len(scenarios)
    lanes = start_lanes(environment, scenarios.repeat(p), program.message_size, program.memory_size)
    frames = _enter(
        program,
        _Frames(
            node=program.start.repeat_interleave(b),
            level=torch.zeros(p * b, dtype=torch.long, device=device),
            caller=torch.zeros(p * b, program.depth, dtype=torch.long, device=device),
            left=torch.full((p * b, program.depth), max_transitions, device=device),
            anchor=torch.full((p * b,), -1, device=device),
            since=torch.zeros(p * b, dtype=torch.long, device=device),
        ),
    )
    status = torch.zeros(p * b, dtype=torch.long, device=device)
    percept, state = lanes.percept.clone(), lanes.state.clone()
    transitions = lanes.step.clone()
    active = torch.arange(p * b, device=device)
    while len(active):
        node = frames.node
        lanes, outcome, changed = _act(program, lanes, node, environment)
        if trace:
            trace(active, node, outcome, lanes)
            changed = torch.ones_like(changed)
        frames, ended, skipped = _follow(program, frames, outcome, changed)
        lanes = replace(lanes, step=lanes.step + 1 + skipped)
        out_of_steps = lanes.step >= max_steps
        ended = torch.where(out_of_steps & (skipped > 0), TIMEOUT, ended)
        done = (ended != 0) | out_of_steps
        if done.any():
            gone, stay = done.nonzero()[:, 0], (~done).nonzero()[:, 0]
            last = lanes.rows(gone)
            status[active[gone]] = ended[gone]
            percept[active[gone]] = last.percept
            state[active[gone]] = last.state
            transitions[active[gone]] = last.step.clamp_max(max_steps)
            active, lanes = active[stay], lanes.rows(stay)
            frames = _Frames(*(x.index_select(0, stay) for x in vars(frames).values()))
        frames = _enter(program, frames)
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
    kind = program.kind[node]
    outcome = torch.empty_like(node)
    changed = torch.zeros_like(node, dtype=torch.bool)
    for i, action in enumerate(program.primitives):
        here = (kind == i).nonzero()[:, 0]
        if len(here):
            rows = node.index_select(0, here)
            parameters = program.parameters[:, : action.num_parameters].index_select(0, rows)
            before = lanes.rows(here)
            after, out = action(before, parameters, environment)
            outcome.index_copy_(0, here, out)
            lanes.write(here, before, after)
            changed[here] = after.differs(before) if action.deterministic else True
    return lanes, outcome, changed


def _enter(program: Program, frames: _Frames) -> _Frames:
    """Lanes at sub-skill nodes go to the start of the sub-skill, as deep as it takes."""
    if program.depth == 1:
        return frames
    node, level = frames.node.clone(), frames.level.clone()
    caller, left = frames.caller.clone(), frames.left.clone()
    first = len(program.primitives)
    for _ in range(program.depth):
        here = (program.kind[node] >= first).nonzero()[:, 0]
        if not len(here):
            break
        level[here] += 1
        caller[here, level[here]] = node[here]
        skill = program.kind[node[here]] - first
        left[here, level[here]] = program.limit[skill]
        node[here] = program.entry[skill]
    return replace(frames, node=node, level=level, caller=caller, left=left)


def _follow(
    program: Program, frames: _Frames, outcome: Tensor, changed: Tensor
) -> tuple[_Frames, Tensor, Tensor]:
    """Follow each lane's edge, out of the sub-skills that end with it.

    Args:
        program: the node table.
        frames: where the lanes stand.
        outcome: (n,) of the action they have just executed.
        changed: (n,) bool, whether it changed anything.

    Returns:
        The frames, (n,) how each lane ended (`SUCCESS`, `FAILURE`, `TIMEOUT`, 0 if it goes on),
        and (n,) the transitions of an endless loop that need not be executed.
    """
    row = torch.arange(len(outcome), device=outcome.device)
    level, left = frames.level, frames.left.clone()
    head = program.heads[frames.node, outcome]
    left[row, level] -= 1
    loops = ~changed & (head >= 0) & (head == frames.anchor)
    skipped = torch.where(loops, left[row, level], 0)
    left[row, level] -= skipped
    for _ in range(program.depth):
        head = torch.where((head >= 0) & (left[row, level] <= 0), TIMEOUT, head)
        leaves = (head < 0) & (level > 0)
        if not leaves.any():
            break
        # A sub-skill's first outcome is success, its second failure; a timeout is a failure.
        returned = program.heads[frames.caller[row, level], (head != SUCCESS).long()]
        head = torch.where(leaves, returned, head)
        level = level - leaves.long()
        left[row, level] -= leaves.long()
    # Brent's cycle detection: anchors at growing distances meet a cycle of any length.
    enters = program.kind[head.clamp_min(0)] >= len(program.primitives)
    same = ~changed & (level == frames.level) & ~enters
    since = torch.where(same, frames.since + 1, 0)
    anchor = torch.where((since & (since - 1)) == 0, head, frames.anchor)
    frames = _Frames(head.clamp_min(0), level, frames.caller, left, anchor, since)
    return frames, head.clamp_max(0), skipped
