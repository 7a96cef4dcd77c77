"""The position of lanes in their graphs: the node, and where each sub-skill returns to."""

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from cgtorch.ground.environment import rows_where
from cgtorch.simulation.action_table import SUCCESS, TIMEOUT
from cgtorch.simulation.program import Program


@dataclass(frozen=True)
class Frames:
    """The positions of n lanes.

    Attributes:
        node: (n,) long, row of the program's table.
        level: (n,) long, the innermost open level of sub-skills.
        caller: (n, depth) long, the sub-skill node that opened each level.
        left: (n, depth) long, the transitions left on each level.
        anchor: (n,) long, a node that the lane visited at most `since` transitions ago, and since
            when nothing has changed; -1 if there is none.
        since: (n,) long.
    """

    node: Tensor
    level: Tensor
    caller: Tensor
    left: Tensor
    anchor: Tensor
    since: Tensor

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
        if leaves.is_cpu and not leaves.any():
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
