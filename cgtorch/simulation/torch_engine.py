"""Algorithm 3 in torch, for any actions, environment and device; and the results of rollouts."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import TypeAlias

import torch
from torch import Tensor

from cgtorch.ground.environment import (
    Environment,
    Episodic,
    Lanes,
    Rewarded,
    rows_where,
    start_lanes,
)
from cgtorch.ground.errors import WorldError
from cgtorch.simulation.program import FAILURE, SUCCESS, TIMEOUT, Program

LARGEST_BATCH = 2**40  # lanes
MOST_IDLE = 64
"""The number of actions in a row that may leave the state of an environment with episodes as it is,
as these can be thousands of actions long."""

Trace: TypeAlias = Callable[[Tensor, Tensor, Tensor, Lanes], None]


@dataclass(frozen=True)
class Rollouts:
    """The results of P graphs on B scenarios.

    Attributes:
        succeeded: (P, B) bool, whether the graph ended with a successful terminal outcome.
        timed_out: (P, B) bool, whether it reached the limit of transitions first.
        percept: (P, B, D), the last percept p_t.
        state: (P, B, S), the environment's last state of the lane.
        transitions: (P, B) long, actions until the end. Those of endless loops are counted, not
            executed.
        executed: Total number of actions that were executed.
        returns: (P, B) sums of rewards, -inf for an episode that did not finish; None without
            rewards.
    """

    succeeded: Tensor
    timed_out: Tensor
    percept: Tensor
    state: Tensor
    transitions: Tensor
    executed: int
    returns: Tensor | None = None


@dataclass(frozen=True)
class Frames:
    """The positions of n lanes."""

    node: Tensor  # (n,) long, row of the program's table
    level: Tensor  # (n,) long, the innermost open level of sub-skills
    caller: Tensor  # (n, depth) long, the sub-skill node that opened each level
    left: Tensor  # (n, depth) long, the transitions left on each level
    anchor: Tensor  # (n,) long, a node visited since when nothing has changed; -1 if there is none
    since: Tensor  # (n,) long, at most how many transitions ago

    def rows(self, index: Tensor) -> "Frames":
        """The frames at `index` (k,), copied."""
        return Frames(*(getattr(self, f.name).index_select(0, index) for f in fields(self)))


def first_frames(program: Program, b: int, max_transitions: int) -> Frames:
    """All P graphs at their start nodes on B scenarios, (P·B,)."""
    node = program.start.repeat_interleave(b)
    nothing = torch.zeros_like(node)
    deep = node.new_zeros(len(node), program.actions.depth)
    left = torch.full_like(deep, max_transitions)
    return enter(program, Frames(node, nothing, deep, left, nothing - 1, nothing.clone()))


def enter(program: Program, frames: Frames) -> Frames:
    """Lanes at sub-skill nodes move to the start of the sub-skill, through all levels."""
    depth, first = program.actions.depth, len(program.actions.primitives)
    if depth == 1:
        return frames
    node, level = frames.node.clone(), frames.level.clone()
    caller, left = frames.caller.clone(), frames.left.clone()
    for _ in range(depth):
        inside = program.kind[node] >= first
        here = rows_where(inside)
        if not len(here):
            break
        yes, at = inside[here], node[here]
        level[here] += yes.long()
        deepest = here, level[here]
        skill = (program.kind[at] - first).clamp_min(0)
        caller[deepest] = torch.where(yes, at, caller[deepest])
        left[deepest] = torch.where(yes, program.limit[skill], left[deepest])
        node[here] = torch.where(yes, program.entry[skill], at)
    return replace(frames, node=node, level=level, caller=caller, left=left)


def advance(
    program: Program, frames: Frames, outcome: Tensor, changed: Tensor
) -> tuple[Frames, Tensor, Tensor]:
    """Follow each lane's edge, out of sub-skills that end with it and into those it leads to.

    Args:
        program: The table of nodes.
        frames: Positions (n,), which are overwritten.
        outcome: (n,) long, the outcomes of the actions just executed.
        changed: (n,) bool, whether the action changed anything on which a later action could
            depend.

    Returned are the frames; how each lane ended (n,), as `SUCCESS`, `FAILURE`, `TIMEOUT`, or 0 if
    it continues; and (n,) the transitions of an endless loop that need not be executed.
    """
    depth, outcomes = program.actions.depth, program.heads.shape[1]
    level, left = frames.level, frames.left.view(-1)
    place = torch.arange(0, len(left), depth, device=left.device)  # of level 0 in `left`
    here = place + level
    head = program.heads.view(-1).index_select(0, frames.node * outcomes + outcome)
    remain = left.index_select(0, here) - 1
    loops = ~changed & (head >= 0) & (head == frames.anchor)
    skipped = torch.where(loops, remain, 0)
    remain = remain - skipped
    head = torch.where((head >= 0) & (remain <= 0), TIMEOUT, head)
    for _ in range(depth - 1):
        left.index_copy_(0, here, remain)
        leaves = (head < 0) & (level > 0)
        if not len(rows_where(leaves)):
            break
        # A sub-skill's first outcome is success, its second failure; a timeout is a failure.
        caller = frames.caller.view(-1).index_select(0, here)
        returned = program.heads[caller, (head != SUCCESS).long()]
        head = torch.where(leaves, returned, head)
        level = level - leaves.long()
        here = place + level
        remain = left.index_select(0, here) - leaves.long()
        head = torch.where((head >= 0) & (remain <= 0), TIMEOUT, head)
    left.index_copy_(0, here, remain)
    # Brent's cycle detection: anchors at growing distances meet a cycle of any length.
    same = ~changed & (level == frames.level)
    if depth > 1:
        same &= program.kind[head.clamp_min(0)] < len(program.actions.primitives)
    since = torch.where(same, frames.since + 1, 0)
    anchor = torch.where((since & (since - 1)) == 0, head, frames.anchor)
    frames = Frames(head.clamp_min(0), level, frames.caller, frames.left, anchor, since)
    return enter(program, frames), head.clamp_max(0), skipped


def rollout_in_torch(
    program: Program,
    environment: Environment,
    scenarios: Tensor,
    max_transitions: int,
    max_steps: int,
    trace: Trace | None = None,
) -> Rollouts:
    """`rollout` for any actions, environment and device, with all lanes in one batch.

    Before each step, lanes are sorted by their next action, and those that have ended leave. Their
    counts are all that the host reads, so a GPU is synchronised once per step.
    """
    p, b = len(program.start), len(scenarios)
    sizes = program.actions.message_size, program.actions.memory_size
    lanes = start_lanes(environment, scenarios.repeat(p), *sizes)
    frames = first_frames(program, b, max_transitions)
    status, transitions = torch.zeros_like(frames.node), lanes.step.clone()
    episodes = environment if isinstance(environment, Episodic) else None
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
        before = None if episodes is None else lanes.state.clone()
        outcome, changed = _act(program, lanes, node, groups, environment)
        if trace:
            trace(active, node, outcome, lanes)
            changed = torch.ones_like(changed)
        frames, end, skipped = advance(program, frames, outcome, changed)
        lanes = replace(lanes, step=lanes.step + 1 + skipped)
        out_of_steps = lanes.step >= max_steps
        end = torch.where(out_of_steps & (skipped > 0), TIMEOUT, end)
        if episodes is not None and before is not None:
            idle = torch.where((lanes.state != before).any(1), 0, idle[order] + 1)
            end = torch.where((end == 0) & (idle > MOST_IDLE), TIMEOUT, end)
            end = _at_the_end(environment, episodes, lanes, end)
        over = (end != 0) | out_of_steps
        gone = rows_where(over)  # of others that are among them more will be known later
        who, last = active.index_select(0, gone), lanes.rows(gone)
        status.index_copy_(0, who, end.index_select(0, gone))
        percept.index_copy_(0, who, last.percept)
        state.index_copy_(0, who, last.state)
        transitions.index_copy_(0, who, last.step.clamp_max(max_steps))
        if rewards is not None and returns is not None:
            returns.index_copy_(0, who, finished_returns(rewards, last))
    return Rollouts(
        succeeded=(status == SUCCESS).view(p, b),
        timed_out=((status != SUCCESS) & (status != FAILURE)).view(p, b),
        percept=percept.view(p, b, percept.shape[1]),
        state=state.view(p, b, state.shape[1]),
        transitions=transitions.view(p, b),
        executed=executed,
        returns=None if returns is None else returns.view(p, b),
    )


def finished_returns(world: Rewarded, lanes: Lanes) -> Tensor:
    """(n,) returns of lanes, -inf where an episode is not over; WorldError if one is not finite."""
    gained, over = world.returns(lanes).to(lanes.percept), world.over(lanes)
    wrong = over & ~gained.isfinite()
    if wrong.is_cpu and wrong.any():
        row = int(wrong.nonzero()[0])
        raise WorldError(
            f"{type(world).__name__}.returns gave {float(gained[row])} for scenario "
            f"{int(lanes.scenario[row])} after {int(lanes.step[row])} actions; give finite "
            "rewards, whose sums are below 1e38"
        )
    return torch.where(over, gained, -torch.inf)


def _at_the_end(environment: Environment, episodes: Episodic, lanes: Lanes, end: Tensor) -> Tensor:
    """How lanes end (n,) if their episodes are over, else the ends given."""
    rows = rows_where(episodes.over(lanes))
    if not len(rows):
        return end
    here = lanes.rows(rows)
    succeeded = environment.success(here)[1] > 0.5
    ends = torch.where(succeeded, SUCCESS, FAILURE)
    return end.index_copy(0, rows, torch.where(episodes.over(here), ends, end[rows]))


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
