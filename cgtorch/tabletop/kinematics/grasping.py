"""Postures in which an arm can grasp an object on a table from the robot's position.

As in the PR2's manipulation pipeline, a posture is suitable if three conditions hold. The arm
reaches the grasp and a pre-grasp behind it. It can follow the way between the two, and a straight
lift, without changing posture. Nothing touches the table, the torso or the base at five places of
that way. `arm_way` plans the way of the arm to the pre-grasp.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics.arm import ArmModel
from cgtorch.tabletop.kinematics.clear_ways import POSTURE, Places, ways_clear
from cgtorch.tabletop.kinematics.robot import Robot
from cgtorch.tabletop.kinematics.solids import Tensors
from cgtorch.tabletop.world.geometry import box_rectangle, rectangles_overlap

GRASP_HEIGHT = 0.05  # m above the table top: the middle of an object 0.10 m high
PRE_GRASP = 0.10  # m behind the grasp, where the straight approach starts
LIFT = 0.10  # m straight up
TABLE_THICKNESS = 0.04  # m, of the table's slab
MAX_STEP = 0.6  # rad or m that a joint may move between waypoints 0.05 m apart
CHUNK = 2048
_GROUP = 256
FEW, SPARSE = 16, 8
"""If there are more postures at a grasp than `FEW`, a subset is tried first, as one of it is mostly
suitable."""

SIDES = tuple(
    sign * math.tau * step / 12 for step in range(7) for sign in ((1, -1) if 0 < step < 6 else (1,))
)
"""The 12 directions around an object, as angles from the line base to object, nearest first,
rad."""

APPROACHES = (
    (math.pi / 2, 0.0),
    *((math.pi / 4, side) for side in SIDES),
    *((0.0, side) for side in SIDES),
)
"""Approaches as (steepness, angle from the line base to object), rad: one from above, twelve
slanted, twelve from the side."""


@dataclass(frozen=True)
class Lines(Tensors):
    """Lines of the tool to objects, and up with them.

    Attributes:
        path: (M, 5, 4, 4) waypoints of the tool; see `waypoints`.
        row: (M,) long, ascending, the object of each line.
        rank: (M,) long, approach · arms + arm of each line.
    """

    path: Tensor
    row: Tensor
    rank: Tensor


def has_posture(robot: Robot, position: Tensor, table: Tensor) -> Tensor:
    """(B,) whether an arm has a suitable posture at each object, however it gets there.

    For arguments and errors see `arm_ways`.
    """
    check_rows(position, table)
    table = table.to(position)
    none = len(robot.arms) * len(APPROACHES)
    rank = torch.full((len(position),), none)
    for part in zip(*(each.split(CHUNK) for each in (position, table, rank)), strict=True):
        places = places_of(*part[:2])
        for which, lines in lines_to_try(robot, *part):
            solved = _has_posture(robot, which, lines.path, places[lines.row])
            part[2][lines.row[solved]] = lines.rank[solved]
    return rank < none


def check_rows(position: Tensor, table: Tensor) -> None:
    """RobotError unless objects and tables have the right shapes, and finite values on the CPU."""
    for what, value, width in (("position", position, 3), ("table", table, 6)):
        if value.ndim != 2 or value.shape[1] != width or len(value) != len(position):
            raise RobotError(
                f"{what} has the shape {tuple(value.shape)}: give (B, {width}), "
                "as many rows of both"
            )
        if not value.is_cpu:
            raise RobotError(f"{what} is on {value.device}: move it to the CPU, where arms are")
        if not bool(torch.isfinite(value).all()):
            raise RobotError(f"{what} has a value that is not finite: give finite numbers")


def lines_to_try(
    robot: Robot, position: Tensor, table: Tensor, rank: Tensor
) -> Iterator[tuple[int, Lines]]:
    """Lines of arms, by index, to objects whose rank (B,) they would lower, first approaches first.

    The caller lowers the rank of each object that a line solves, which is then not tried again.
    """
    approaches, arms = position.new_tensor(APPROACHES), len(robot.arms)
    possible = ~standing_in_table(robot, table) & within_reach(robot, position)
    open_rows, start = possible.nonzero().squeeze(1), 0
    while start < len(APPROACHES) and len(open_rows):
        # The more approaches at once, the fewer rows there are.
        count = max(1, _GROUP // len(open_rows))
        group = torch.arange(start, min(start + count, len(APPROACHES)))
        start += count
        for which in range(arms):
            order = group * arms + which
            row, column = (order < rank[open_rows, None]).nonzero(as_tuple=True)
            at = open_rows[row]
            path = waypoints(position[at], *approaches[group[column]].unbind(1))
            path, aimed = robot.arms[which].aimed(path)
            yield which, Lines(path, at[aimed], order[column][aimed])
        open_rows = open_rows[rank[open_rows] == arms * len(APPROACHES)]


def _has_posture(robot: Robot, which: int, path: Tensor, places: Places) -> Tensor:
    """(M,) whether an arm can follow waypoints (M, 5, 4, 4) without changing posture."""
    solved = torch.zeros(len(path), dtype=torch.bool)
    for row, q in postures_in_turn(robot.arms[which], path, solved):
        solved[followed(robot, which, path, places, row, q)[0]] = True
    return solved


def postures_in_turn(
    arm: ArmModel, path: Tensor, solved: Tensor
) -> Iterator[tuple[Tensor, Tensor]]:
    """Ascending rows (M,) and postures q (M, n) at the grasps of waypoints (B, 5, 4, 4).

    First come some of each row, then all others of rows that are not `solved` (B,) by then.
    """
    row, q = arm.candidates(path[:, 2])
    nth = nth_of_each(row)
    few = torch.bincount(row, minlength=len(path))[row] <= FEW
    soon = few | (nth % SPARSE == 0)
    for part in (soon, ~soon):
        part = part & ~solved[row]
        if part.any():
            yield row[part], q[part]


def followed(
    robot: Robot, which: int, path: Tensor, places: Places, row: Tensor, q: Tensor
) -> tuple[Tensor, Tensor]:
    """Rows (K,) and joints (K, 5, n) of the postures q (M, n) that can follow their paths."""
    arm, scene = robot.arms[which], robot.scenes[which]

    def clear(row: Tensor, q: Tensor) -> Tensor:
        return ways_clear(arm, scene, places[row], torch.full_like(row, POSTURE), q[:, None])

    free = clear(row, q)
    row, q = row[free], q[free]
    joints, reached = arm.follow(q, path[row])
    steps = arm.difference(joints[:, 1:], joints[:, :-1]).abs().amax(dim=(1, 2))
    smooth = reached.all(dim=1) & (steps < MAX_STEP)
    row, joints = row[smooth], joints[smooth]
    for step in (0, 4, 1, 3):
        free = clear(row, joints[:, step])
        row, joints = row[free], joints[free]
    return row, joints


def nth_of_each(row: Tensor) -> Tensor:
    """(M,) the number of earlier entries with the same value in ascending rows (M,)."""
    return torch.arange(len(row)) - torch.searchsorted(row, row)


def waypoints(position: Tensor, steepness: Tensor | float, side: Tensor | float) -> Tensor:
    """Poses (B, 5, 4, 4) at pre-grasp, half-way, grasp, half-way up and lifted of objects (B, 3).

    The tool's x is along the approach, its y horizontal. The approach points `steepness` downwards,
    from 0 to pi / 2 (from above), and is turned by `side` from the line base to object, rad; each
    is one angle or (B,).
    """
    heading = torch.atan2(position[:, 1], position[:, 0]) + side
    cos, sin = heading.cos(), heading.sin()
    zero = torch.zeros_like(cos)
    steep = torch.as_tensor(steepness).to(position).expand(len(position))
    level, down = steep.cos(), steep.sin()
    along = torch.stack([level * cos, level * sin, -down], dim=1)
    across = torch.stack([-sin, cos, zero], dim=1)
    upward = torch.linalg.cross(along, across)
    up = torch.stack([zero, zero, zero + 1], dim=1)
    grasp, behind, above = position + GRASP_HEIGHT * up, PRE_GRASP * along, LIFT * up
    points = [grasp - behind, grasp - behind / 2, grasp, grasp + above / 2, grasp + above]
    pose = position.new_zeros(len(position), 5, 4, 4)
    pose[:, :, :3, :3] = torch.stack([along, across, upward], dim=2)[:, None]
    pose[:, :, :3, 3] = torch.stack(points, dim=1)
    pose[:, :, 3, 3] = 1
    return pose


def places_of(position: Tensor, table: Tensor) -> Places:
    """Places with tables (B, 6) and objects (B, 3); held objects are not filled in."""
    cos, sin, zero = table[:, 2].cos(), table[:, 2].sin(), torch.zeros_like(table[:, 2])
    turn = torch.stack([cos, -sin, zero, sin, cos, zero, zero, zero, zero + 1], 1).view(-1, 3, 3)
    thickness = torch.full_like(table[:, 5:], TABLE_THICKNESS)
    centre = torch.cat([table[:, :2], table[:, 5:] - TABLE_THICKNESS / 2], 1)
    size = pad(torch.cat([table[:, 3:5], thickness], 1) / 2, (0, 2))
    up = position.new_tensor([0.0, 0.0, GRASP_HEIGHT])
    upright = torch.cat([torch.eye(3).to(turn).expand_as(turn), (position + up)[..., None]], -1)
    slab = torch.cat([turn, centre[..., None]], -1)
    return Places(*(each.double() for each in (slab, size, upright, upright)))


def within_reach(robot: Robot, position: Tensor) -> Tensor:
    """(B,) whether an arm is long enough, which is false for most rows that a skill tries."""
    grasp = position + position.new_tensor([0.0, 0.0, GRASP_HEIGHT])
    near = [(grasp - arm.mount[:3, 3].to(grasp)).norm(dim=1) <= arm.reach for arm in robot.arms]
    return torch.stack(near).any(0)


def standing_in_table(robot: Robot, table: Tensor) -> Tensor:
    """(B,) whether the robot's footprint overlaps the table."""
    footprint = torch.tensor(robot.description.footprint, dtype=torch.float64)
    footprint = box_rectangle(footprint).to(table)
    return rectangles_overlap(footprint.expand(len(table), 5), table[:, :5])
