"""The search for a way to each object: many grasps, first with straight ways, then planned ones."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from cgtorch.ground.counter_rng import words
from cgtorch.tabletop.kinematics.clear_ways import Places
from cgtorch.tabletop.kinematics.collision import Boxes
from cgtorch.tabletop.kinematics.grasp_lines import LINE, Grasps, Lines, grasps, nth_of_each
from cgtorch.tabletop.kinematics.grasping import (
    APPROACHES,
    CHUNK,
    GRASP_HEIGHT,
    check_rows,
    first_of_each,
    next_approaches,
    standing_in_table,
    table_slab,
    waypoints,
    within_reach,
)
from cgtorch.tabletop.kinematics.robot import Robot
from cgtorch.tabletop.kinematics.rrt_connect import VIAS, ways_planned
from cgtorch.tabletop.kinematics.scene import REACH

PLANNED = 3
"""The number of grasps of each object for which a way is planned if none is straight."""


@dataclass(frozen=True)
class FoundWays:
    """The way of an arm to each object, in parts.

    Attributes:
        rank: (B,) long, approach · arms + arm; approaches · arms if no way is found.
        vias: (B, VIAS, n) planned from home to the pre-grasp, both included, rad or m.
        count: (B,) long, the number of these, 0 if the way is straight.
        line: (B, LINE, n) from the pre-grasp over the grasp to where the object is lifted.
        held: (B, 3, 4) pose in the tool frame of the held object.
    """

    rank: Tensor
    vias: Tensor
    count: Tensor
    line: Tensor
    held: Tensor

    def fill(self, some: Grasps) -> None:
        """Enter grasps by an arm of n joints."""
        self.rank[some.row], self.held[some.row] = some.rank, some.held
        self.line[some.row, :, : some.line.shape[2]] = some.line


def found_ways(robot: Robot, position: Tensor, table: Tensor, seed: int = 0) -> FoundWays:
    """The first approach and arm with a straight way to each object, else the first with any.

    For arguments and errors see `arm_ways`.
    """
    check_rows(position, table)
    table, rows = table.to(position), len(position)
    n = max(len(arm.joint_names) for arm in robot.arms)
    ways = FoundWays(
        rank=torch.full((rows,), len(robot.arms) * len(APPROACHES), device=position.device),
        vias=position.new_zeros(rows, VIAS, n, dtype=torch.float64),
        count=torch.zeros(rows, dtype=torch.long, device=position.device),
        line=position.new_zeros(rows, LINE, n, dtype=torch.float64),
        held=position.new_zeros(rows, 3, 4, dtype=torch.float64),
    )
    every = position, table, row_keys(position, table, seed), *vars(ways).values()
    for position, table, key, *out in zip(*(each.split(CHUNK) for each in every), strict=True):
        _search(robot, position, table, key, FoundWays(*out))
    return ways


def row_keys(position: Tensor, table: Tensor, seed: int) -> Tensor:
    """(B,) long: keys of random numbers for each row, independent of other rows."""
    key = torch.full((len(position),), seed, device=position.device)
    for column in torch.cat([position, table], 1).double().view(torch.long).unbind(1):
        key = words(key ^ column, torch.zeros_like(key))
    return key


def places_of(position: Tensor, slab: Boxes) -> Places:
    """Places with tables and objects (B, 3); held objects are not filled in."""
    table = torch.cat([slab.rotation, slab.centre[..., None]], -1)[:, 0]
    up = position.new_tensor([0.0, 0.0, GRASP_HEIGHT])
    turn = torch.eye(3).to(position).expand(len(position), 3, 3)
    upright = torch.cat([turn, (position + up)[..., None]], -1)
    size = torch.nn.functional.pad(slab.half[:, 0], (0, 2))
    return Places(*(each.double() for each in (table, size, upright, upright)))


def _search(robot: Robot, position: Tensor, table: Tensor, key: Tensor, ways: FoundWays) -> None:
    """Fill in the ways of rows, independently of other rows."""
    slab, body = table_slab(table), robot.body.to(position)
    places, arms = places_of(position, slab), len(robot.arms)
    approaches, none = position.new_tensor(APPROACHES), arms * len(APPROACHES)
    blocked: list[Grasps] = []
    open_rows = (~standing_in_table(robot, table) & within_reach(robot, position)).nonzero()[:, 0]
    start = 0
    while start < len(APPROACHES) and len(open_rows):
        group = next_approaches(start, open_rows)
        start += len(group)
        for which in range(arms):
            order = group * arms + which
            row, column = (order < ways.rank[open_rows, None]).nonzero(as_tuple=True)
            at, rank = open_rows[row], order[column]
            path = waypoints(position[at], *approaches[group[column]].unbind(1))
            found = grasps(robot, which, Lines(path, at, rank), slab, body, places)
            clear = found[found.straight]
            ways.fill(clear[first_of_each(clear.row)])
            blocked.append(found[~found.straight])
        open_rows = open_rows[ways.rank[open_rows] == none]
    if blocked:
        _plan(robot, places, key, blocked, ways)


def _plan(
    robot: Robot, places: Places, key: Tensor, blocked: list[Grasps], ways: FoundWays
) -> None:
    """Plan ways to the first few grasps of rows without a straight one."""
    none = len(robot.arms) * len(APPROACHES)
    if not blocked:
        return
    row, rank = (torch.cat([getattr(b, name) for b in blocked]) for name in ("row", "rank"))
    open_ = (ways.rank[row] == none).nonzero()[:, 0]
    order = open_[(row[open_] * none + rank[open_]).argsort()]
    nth = nth_of_each(row[order])
    for turn in range(PLANNED):
        todo = set(order[(nth == turn) & (ways.rank[row[order]] == none)].tolist())
        first = 0
        for some in blocked:
            mine = [j for j in range(len(some.row)) if first + j in todo]
            first += len(some.row)
            if mine:
                _plan_some(robot, places, key, some[torch.tensor(mine)], ways)


def _plan_some(robot: Robot, places: Places, key: Tensor, some: Grasps, ways: FoundWays) -> None:
    """Plan ways to grasps (M,) by the same arm."""
    which = int(some.rank[0]) % len(robot.arms)
    ends = torch.stack(
        [robot.home[which].to(some.line).expand_as(some.line[:, 0]), some.line[:, 0]], 1
    )
    held = replace(places[some.row], held=some.held)
    keys = words(key[some.row], some.rank)
    vias, count = ways_planned(
        robot.arms[which], robot.scenes[which], held, torch.full_like(some.row, REACH), ends, keys
    )
    done = count > 0
    ways.fill(some[done])
    rows = some.row[done]
    ways.vias[rows, :, : vias.shape[2]], ways.count[rows] = vias[done], count[done]
