"""The way of an arm: from home to an object, up with it, and home again.

Many grasps are tried, first with straight ways from home, then with planned ones. A way is a path
in joint space, straight between waypoints.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.ground.counter_rng import words
from cgtorch.tabletop.kinematics.clear_ways import (
    CARRY,
    REACH,
    VIAS,
    Places,
    ways_clear,
    ways_planned,
)
from cgtorch.tabletop.kinematics.grasp_lines import HALF, LINE, Grasps, grasps
from cgtorch.tabletop.kinematics.grasping import (
    APPROACHES,
    CHUNK,
    check_rows,
    lines_to_try,
    nth_of_each,
    places_of,
)
from cgtorch.tabletop.kinematics.robot import Robot
from cgtorch.tabletop.kinematics.solids import Tensors

PLANNED = 3
"""The number of grasps of each object for which a way is planned if none is straight."""


@dataclass(frozen=True)
class ArmWay:
    """The ways of arms to B objects: paths in joint space, straight between waypoints.

    Attributes:
        found: (B,) whether there is a way; if not, all other values of the row are meaningless.
        arm: (B,) index into the robot's arms.
        approach: (B,) index into `APPROACHES`.
        joints: (B, W, n) waypoints from home to where the object is lifted, rad or m, in the order
            of the arm's joints. n is the largest number of joints of any arm, and missing joints
            are 0. A row's last waypoint is repeated.
        pre_grasp, grasp, lifted: (B,) indices of these waypoints; `lifted` is a row's last one.
            Before `pre_grasp`, the way is free in space; after it, the tool keeps to its line.
        back: (B, V, n) waypoints with the object, from where it is lifted to home.
        home_again: (B,) index of the last waypoint of `back`.
        returns: (B,) whether the arm can bring the object home; if not, `back` ends where the
            object is lifted.
    """

    found: Tensor
    arm: Tensor
    approach: Tensor
    joints: Tensor
    pre_grasp: Tensor
    grasp: Tensor
    lifted: Tensor
    back: Tensor
    home_again: Tensor
    returns: Tensor


@dataclass(frozen=True)
class _Found(Tensors):
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


def arm_ways(robot: Robot, position: Tensor, table: Tensor, seed: int = 0) -> ArmWay:
    """The way of an arm to each object, and back with it.

    Args:
        robot: The robot, with its arms at home.
        position: (B, 3) objects on the table in the base frame, at the height of its top, m.
        table: (B, 6) centre x, centre y, yaw, size x, size y, height of the top, in the base frame,
            m and rad.
        seed: Of the planner's random numbers, which are independent for each row.

    Raises:
        RobotError: A shape is wrong, or a value is not finite.
        CompilerError: There is neither a C compiler nor compiled code for this machine.
    """
    ways, arms = _found_ways(robot, position, table, seed), len(robot.arms)
    found, arm = ways.rank < arms * len(APPROACHES), ways.rank % arms
    n = ways.line.shape[2]
    home = torch.stack([pad(q, (0, n - len(q))) for q in robot.home]).to(ways.line)[arm]
    planned = ways.count > 0
    before = torch.where(planned, ways.count - 1, 1)
    index = torch.arange(VIAS - 1 + LINE).expand(len(arm), -1)
    vias = torch.where(planned[:, None, None], ways.vias, home[:, None])
    both = torch.cat([vias[:, : VIAS - 1], ways.line], 1)
    lifted = before + LINE - 1
    which = index.minimum(lifted[:, None])
    which = torch.where(which < before[:, None], which, which - before[:, None] + VIAS - 1)
    joints = both.gather(1, which[..., None].expand(-1, -1, n))
    back, count = _ways_back(robot, position, table, ways, home, found, seed)
    most = int(lifted[found].max()) + 1 if bool(found.any()) else 1
    return ArmWay(
        found, arm, ways.rank // arms, joints[:, :most].to(position), before, before + HALF, lifted,
        back.to(position), count - 1, found & (count > 1),
    )  # fmt: skip


def graspable(robot: Robot, position: Tensor, table: Tensor) -> Tensor:
    """(B,) whether an arm has a way to each object and up with it; see `arm_ways`."""
    return _found_ways(robot, position, table).rank < len(robot.arms) * len(APPROACHES)


def _ways_back(
    robot: Robot, position: Tensor, table: Tensor, ways: _Found, home: Tensor, found: Tensor,
    seed: int,
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Ways (B, VIAS, n) home with the object, straight if that is clear, and their lengths (B,)."""
    back = ways.line[:, -1:].repeat(1, VIAS, 1)
    count = torch.ones_like(ways.rank)
    places = replace(places_of(position, table.to(position)), held=ways.held)
    keys = row_keys(position, table, seed)
    for which, arm in enumerate(robot.arms):
        n, scene = len(arm.joint_names), robot.scenes[which]
        rows = (found & (ways.rank % len(robot.arms) == which)).nonzero()[:, 0]
        ends = torch.stack([ways.line[rows, -1, :n], home[rows, :n]], 1)
        kind = torch.full_like(rows, CARRY)
        straight = ways_clear(arm, scene, places[rows], kind, ends)
        done = rows[straight]
        back[done, 1:, :n], count[done] = home[done, None, :n], 2
        left, ends = rows[~straight], ends[~straight]
        key = words(keys[left], torch.full_like(left, -1))
        vias, length = ways_planned(arm, scene, places[left], kind[: len(left)], ends, key)
        planned = length > 0
        last = torch.arange(VIAS).minimum(length[planned, None] - 1)
        vias = vias[planned].gather(1, last[..., None].expand(-1, -1, n))
        back[left[planned], :, :n], count[left[planned]] = vias, length[planned]
    return back, count


def _found_ways(robot: Robot, position: Tensor, table: Tensor, seed: int = 0) -> _Found:
    """The first approach and arm with a straight way to each object, else the first with any."""
    check_rows(position, table)
    table, rows = table.to(position), len(position)
    n = max(len(arm.joint_names) for arm in robot.arms)
    ways = _Found(
        rank=torch.full((rows,), len(robot.arms) * len(APPROACHES)),
        vias=torch.zeros(rows, VIAS, n, dtype=torch.float64),
        count=torch.zeros(rows, dtype=torch.long),
        line=torch.zeros(rows, LINE, n, dtype=torch.float64),
        held=torch.zeros(rows, 3, 4, dtype=torch.float64),
    )
    every = position, table, row_keys(position, table, seed), *vars(ways).values()
    for position, table, key, *out in zip(*(each.split(CHUNK) for each in every), strict=True):
        _search(robot, position, table, key, _Found(*out))
    return ways


def row_keys(position: Tensor, table: Tensor, seed: int) -> Tensor:
    """(B,) long: keys of random numbers for each row, independent of other rows."""
    key = torch.full((len(position),), seed)
    for column in torch.cat([position, table], 1).double().view(torch.long).unbind(1):
        key = words(key ^ column, torch.zeros_like(key))
    return key


def _search(robot: Robot, position: Tensor, table: Tensor, key: Tensor, ways: _Found) -> None:
    """Fill in the ways of rows, independently of other rows."""
    places = places_of(position, table)
    blocked: list[Grasps] = []
    for which, lines in lines_to_try(robot, position, table, ways.rank):
        found = grasps(robot, which, lines, places)
        clear = found[found.straight]
        ways.fill(clear[nth_of_each(clear.row) == 0])
        blocked.append(found[~found.straight])
    if blocked:
        _plan(robot, places, key, blocked, ways)


def _plan(robot: Robot, places: Places, key: Tensor, blocked: list[Grasps], ways: _Found) -> None:
    """Plan ways to the first few grasps of rows without a straight one."""
    none = len(robot.arms) * len(APPROACHES)
    row, rank = (torch.cat([getattr(b, name) for b in blocked]) for name in ("row", "rank"))
    open_ = (ways.rank[row] == none).nonzero()[:, 0]
    order = open_[(row[open_] * none + rank[open_]).argsort()]
    nth = nth_of_each(row[order])
    for turn in range(PLANNED):
        todo = torch.zeros(len(row), dtype=torch.bool)
        todo[order] = (nth == turn) & (ways.rank[row[order]] == none)
        for some, mine in zip(blocked, todo.split([len(b.row) for b in blocked]), strict=True):
            if mine.any():
                _plan_some(robot, places, key, some[mine], ways)


def _plan_some(robot: Robot, places: Places, key: Tensor, some: Grasps, ways: _Found) -> None:
    """Plan ways to grasps (M,) by the same arm."""
    which, begin = int(some.rank[0]) % len(robot.arms), some.line[:, 0]
    ends = torch.stack([robot.home[which].to(begin).expand_as(begin), begin], 1)
    keys, kind = words(key[some.row], some.rank), torch.full_like(some.row, REACH)
    here = places[some.row]
    vias, count = ways_planned(robot.arms[which], robot.scenes[which], here, kind, ends, keys)
    done = count > 0
    ways.fill(some[done])
    rows = some.row[done]
    ways.vias[rows, :, : vias.shape[2]], ways.count[rows] = vias[done], count[done]
