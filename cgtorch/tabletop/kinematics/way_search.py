"""The search for a way to each object: many grasps, the straight way first, else a planned one."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from cgtorch.ground.counter_rng import words
from cgtorch.tabletop.kinematics.arm import ArmModel
from cgtorch.tabletop.kinematics.clear_ways import Places, ways_clear
from cgtorch.tabletop.kinematics.collision import Boxes
from cgtorch.tabletop.kinematics.grasping import (
    APPROACHES,
    CHUNK,
    GRASP_HEIGHT,
    check_rows,
    first_of_each,
    followed,
    next_approaches,
    postures_in_turn,
    standing_in_table,
    table_slab,
    waypoints,
    within_reach,
)
from cgtorch.tabletop.kinematics.robot import Robot
from cgtorch.tabletop.kinematics.rrt_connect import VIAS, ways_planned
from cgtorch.tabletop.kinematics.scene import APPROACH, LIFT, REACH

LINE = 41
"""Waypoints from the pre-grasp over the grasp to where the object is lifted, 5 mm apart."""
HALF = LINE // 2
MAX_TURN = 0.15
"""Rad or m that a joint may move between two of them, so that the tool keeps to its line."""
NEAR, TRIED = 4, 2
"""Postures of each arm at each approach that are looked at closely, those nearest to home, and of
them those whose ways are."""
NONE, BLOCKED, STRAIGHT = range(3)
PLANNED = 3
"""Grasps of each object for which a way is planned if none can be reached straight."""


@dataclass(frozen=True)
class FoundWays:
    """The way of an arm to each object, in parts.

    Attributes:
        rank: (B,) long, approach · arms + arm; where no way is found, approaches · arms.
        vias: (B, VIAS, n) planned from home to the pre-grasp, both included, rad or m.
        count: (B,) long, how many of these there are, 0 where the way is straight.
        line: (B, LINE, n) from the pre-grasp over the grasp to where the object is lifted.
        held: (B, 3, 4) pose in the tool frame of the object as it is held.
    """

    rank: Tensor
    vias: Tensor
    count: Tensor
    line: Tensor
    held: Tensor

    def fill(self, rows: Tensor, rank: Tensor, line: Tensor, held: Tensor) -> None:
        """Enter how rows (R,) are grasped, by an arm of n joints."""
        self.rank[rows], self.held[rows] = rank, held
        self.line[rows, :, : line.shape[2]] = line


@dataclass(frozen=True)
class _Blocked:
    """Grasps that can be made but not be reached straight, of rows (M,); see `FoundWays`."""

    row: Tensor
    rank: Tensor
    line: Tensor
    held: Tensor


def found_ways(robot: Robot, position: Tensor, table: Tensor, seed: int = 0) -> FoundWays:
    """The first approach and arm with a straight way to each object, else the first with any.

    Arguments and errors are those of `arm_ways`.
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
    """(B,) long: keys of random numbers that are each row's own, whatever the others."""
    key = torch.full((len(position),), seed, device=position.device)
    for column in torch.cat([position, table], 1).double().view(torch.long).unbind(1):
        key = words(key ^ column, torch.zeros_like(key))
    return key


def places_of(position: Tensor, slab: Boxes) -> Places:
    """Where tables and objects (B, 3) are; how the objects are held is not filled in."""
    table = torch.cat([slab.rotation, slab.centre[..., None]], -1)[:, 0]
    up = position.new_tensor([0.0, 0.0, GRASP_HEIGHT])
    turn = torch.eye(3).to(position).expand(len(position), 3, 3)
    upright = torch.cat([turn, (position + up)[..., None]], -1)
    size = torch.nn.functional.pad(slab.half[:, 0], (0, 2))
    return Places(*(each.double() for each in (table, size, upright, upright)))


def _search(robot: Robot, position: Tensor, table: Tensor, key: Tensor, ways: FoundWays) -> None:
    """Fill in the ways of rows, whatever the other rows."""
    slab, body = table_slab(table), robot.body.to(position)
    places, arms = places_of(position, slab), len(robot.arms)
    approaches, none = position.new_tensor(APPROACHES), arms * len(APPROACHES)
    blocked: list[_Blocked] = []
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
            state, line, held = _lines(robot, which, path, slab[at], body, places[at])
            clear = (state == STRAIGHT).nonzero()[:, 0]
            first = clear[first_of_each(row[clear])]
            ways.fill(at[first], rank[first], line[first], held[first])
            left = (state == BLOCKED).nonzero()[:, 0]
            blocked.append(_Blocked(at[left], rank[left], line[left], held[left]))
        open_rows = open_rows[ways.rank[open_rows] == none]
    if blocked:
        _plan(robot, places, key, blocked, ways)


def _lines(
    robot: Robot, which: int, path: Tensor, slab: Boxes, body: Boxes, places: Places
) -> tuple[Tensor, Tensor, Tensor]:
    """How an arm gets along the lines of waypoints (M, 5, 4, 4): best state, line and held object.

    The state (M,) is `NONE`, `BLOCKED` where the pre-grasp is not reached straight from home, or
    `STRAIGHT`; the lines are (M, LINE, n).
    """
    arm, scene = robot.arms[which], robot.scenes[which]
    home = robot.home[which].to(places.table)
    state = torch.zeros(len(path), dtype=torch.long, device=path.device)
    solved = state == STRAIGHT
    line = home.new_zeros(len(path), LINE, len(home))
    held = (torch.linalg.inv(path[:, 2].double()) @ _square(places.object))[:, :3]
    places = replace(places, held=held)
    for part in postures_in_turn(arm, path, solved):
        every, joints = _near_home(arm, *followed(arm, path, slab, body, *part), home)
        kept = ways_clear(arm, scene, places[every], _all(APPROACH, every), joints[:, 2:3])
        every, joints = every[kept], joints[kept]
        nth = _nth_of_each(every)
        for turn in range(TRIED):
            mine = (nth == turn) & (state[every] != STRAIGHT)
            if not mine.any():
                continue
            row, dense = _on_line(arm, path, every[mine], joints[mine, 2], home)
            for kind, stretch in ((APPROACH, slice(HALF + 1)), (LIFT, slice(HALF, LINE))):
                kept = ways_clear(arm, scene, places[row], _all(kind, row), dense[:, stretch])
                row, dense = row[kept], dense[kept]
            reach = torch.stack([home.expand_as(dense[:, 0]), dense[:, 0]], 1)
            straight = ways_clear(arm, scene, places[row], _all(REACH, row), reach)
            better = straight | (state[row] == NONE)
            row, straight = row[better], straight[better]
            line[row], state[row] = dense[better], torch.where(straight, STRAIGHT, BLOCKED)
            solved[row] = straight
    return state, line, held


def _near_home(arm: ArmModel, row: Tensor, joints: Tensor, home: Tensor) -> tuple[Tensor, Tensor]:
    """Of postures (M, 5, n) of ascending rows (M,) the few of each that are nearest to home."""
    away = arm.difference(joints[:, 0].double(), home).abs().amax(1)
    order = away.argsort(stable=True)
    order = order[row[order].argsort(stable=True)]
    order = order[_nth_of_each(row[order]) < NEAR]
    return row[order], joints[order]


def _nth_of_each(row: Tensor) -> Tensor:
    """(M,) how many of ascending rows (M,) before each are the same."""
    return torch.arange(len(row), device=row.device) - torch.searchsorted(row, row)


def _on_line(
    arm: ArmModel, path: Tensor, row: Tensor, q: Tensor, home: Tensor
) -> tuple[Tensor, Tensor]:
    """Rows (K,) and lines (K, LINE, n) in postures q (M, n) at the grasps of rows (M,).

    Without those in which a joint would have to turn too fast for the tool to keep to its line.
    """
    ends, share = path[row][:, :, None], torch.linspace(0, 1, HALF + 1).to(path)[:, None, None]
    there = [ends[:, i] + share * (ends[:, i + 2] - ends[:, i]) for i in (0, 2)]
    line, reached = arm.follow(q, torch.cat([there[0], there[1][:, 1:]], 1))
    line = line.double()
    first = home + arm.difference(line[:, :1], home)
    steps = arm.difference(line[:, 1:], line[:, :-1])
    smooth = reached.all(1) & (steps.abs().amax((1, 2)) < MAX_TURN)
    line = torch.cat([first, first + steps.cumsum(1)], 1)
    return row[smooth], line[smooth]


def _plan(
    robot: Robot, places: Places, key: Tensor, blocked: list[_Blocked], ways: FoundWays
) -> None:
    """Plan ways to the first few grasps of rows without a straight one."""
    none = len(robot.arms) * len(APPROACHES)
    if not blocked:
        return
    row, rank = (torch.cat([getattr(b, name) for b in blocked]) for name in ("row", "rank"))
    open_ = (ways.rank[row] == none).nonzero()[:, 0]
    order = open_[(row[open_] * none + rank[open_]).argsort()]
    nth = _nth_of_each(row[order])
    for turn in range(PLANNED):
        todo = set(order[(nth == turn) & (ways.rank[row[order]] == none)].tolist())
        first = 0
        for some in blocked:
            mine = [j for j in range(len(some.row)) if first + j in todo]
            first += len(some.row)
            if mine:
                _plan_some(
                    robot, places, key, _Blocked(*(x[mine] for x in vars(some).values())), ways
                )


def _plan_some(robot: Robot, places: Places, key: Tensor, some: _Blocked, ways: FoundWays) -> None:
    """Plan ways to grasps (M,) by the same arm."""
    which = int(some.rank[0]) % len(robot.arms)
    ends = torch.stack(
        [robot.home[which].to(some.line).expand_as(some.line[:, 0]), some.line[:, 0]], 1
    )
    held = replace(places[some.row], held=some.held)
    keys = words(key[some.row], some.rank)
    vias, count = ways_planned(
        robot.arms[which], robot.scenes[which], held, _all(REACH, some.row), ends, keys
    )
    done = count > 0
    rows = some.row[done]
    ways.fill(rows, some.rank[done], some.line[done], some.held[done])
    ways.vias[rows, :, : vias.shape[2]], ways.count[rows] = vias[done], count[done]


def _all(kind: int, like: Tensor) -> Tensor:
    return torch.full_like(like, kind)


def _square(pose: Tensor) -> Tensor:
    """(M, 4, 4) of the upper rows of poses (M, 3, 4)."""
    last = pose.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(len(pose), 1, 4)
    return torch.cat([pose, last], 1)
