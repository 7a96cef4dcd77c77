"""The best grasp for each line of the tool: along the line to the object, and up with it.

The arm postures nearest to home are tested closely: whether the arm is clear along the line, and on
the straight way from home to its beginning. Arms with a closed form are searched in
`native/tabletop/grasps.c`, line after line; for others, all lines are searched at once.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from cgtorch.native import required, threads_worth
from cgtorch.tabletop.kinematics.arm import ArmModel
from cgtorch.tabletop.kinematics.clear_ways import (
    APPROACH,
    LIFT,
    REACH,
    Places,
    Scene,
    ways_clear,
    ways_task,
)
from cgtorch.tabletop.kinematics.grasping import (
    FEW,
    MAX_STEP,
    SPARSE,
    Lines,
    followed,
    nth_of_each,
    postures_in_turn,
)
from cgtorch.tabletop.kinematics.inverse_kinematics import PAN_SAMPLES, SphericalArm, form_structure
from cgtorch.tabletop.kinematics.robot import Robot
from cgtorch.tabletop.kinematics.solids import Tensors

LINE = 41
"""Waypoints from the pre-grasp over the grasp to where the object is lifted, 5 mm apart."""
HALF = LINE // 2
MAX_TURN = 0.14
"""The largest motion of a joint (rad or m) between two waypoints, so that the tool stays on its
line."""
NEAR, TRIED = 12, 6
"""The number of postures of each arm and approach that are tested closely, those nearest to home;
and of these, the number whose ways are tested."""
WORTH_SHARING = 64  # lines that are worth one more thread
STRAIGHT = 2  # what compiled code says of lines with a straight way from home; 0 where there's none


@dataclass(frozen=True)
class Grasps(Tensors):
    """Grasps by lines that an arm can follow; see `Lines` and `FoundWays`.

    Attributes:
        straight: (M,) whether the pre-grasp is reached straight from home.
    """

    row: Tensor
    rank: Tensor
    straight: Tensor
    line: Tensor
    held: Tensor


def grasps(robot: Robot, which: int, lines: Lines, places: Places) -> Grasps:
    """The best grasp for each line that an arm can follow: one with a straight way, else the first.

    Places are (B, ...) of objects; `which` is the arm's index.
    """
    form = robot.arms[which].closed_form
    if form is None:
        return grasps_of_any_arm(robot, which, lines, places)
    return _grasps_in_closed_form(form, robot, which, lines, places)


def grasps_of_any_arm(robot: Robot, which: int, lines: Lines, places: Places) -> Grasps:
    """The same as `grasps` for any arm, with all lines at once, posture after posture."""
    arm, scene, path = robot.arms[which], robot.scenes[which], lines.path
    home, solved = robot.home[which].double(), torch.zeros(len(path), dtype=torch.bool)
    found = [(lines.row[:0], solved[:0], home.new_empty(0, LINE, len(home)))]
    for part in postures_in_turn(arm, path, solved):
        near = _near_home(arm, *followed(robot, which, path, places[lines.row], *part), home)
        every, joints = near
        here = _held(places[lines.row[every]], path[every, 2])
        kept = ways_clear(arm, scene, here, _all(APPROACH, every), joints[:, 2:3])
        every, joints, here = every[kept], joints[kept], here[kept]
        nth = nth_of_each(every)
        for turn in range(TRIED):
            mine = ((nth == turn) & ~solved[every]).nonzero()[:, 0]
            row, q = every[mine], joints[mine, 2]
            found.append(_along(arm, scene, here[mine], path[row], row, q, home))
            row, straight, _ = found[-1]
            solved[row] = straight
    row, straight, line = (torch.cat(each) for each in zip(*found, strict=True))
    order = (2 * row + ~straight).argsort(stable=True)
    best = order[nth_of_each(row[order]) == 0]
    row = row[best]
    held = _held(places[lines.row[row]], path[row, 2]).held
    return Grasps(lines.row[row], lines.rank[row], straight[best], line[best], held)


def _held(places: Places, grasp: Tensor) -> Places:
    """Places with objects held where the tool frame has poses (M, 4, 4)."""
    turn, shift = grasp[:, :3, :3].double(), grasp[:, :3, 3:].double()
    from_tool = torch.cat([places.object[..., :3], places.object[..., 3:] - shift], -1)
    return replace(places, held=turn.transpose(1, 2) @ from_tool)


def _near_home(arm: ArmModel, row: Tensor, joints: Tensor, home: Tensor) -> tuple[Tensor, Tensor]:
    """The few postures of each row nearest to home, of postures (M, n) with ascending rows (M,)."""
    away = arm.difference(joints[:, 0].double(), home).abs().amax(1)
    order = away.argsort(stable=True)
    order = order[row[order].argsort(stable=True)]
    order = order[nth_of_each(row[order]) < NEAR]
    return row[order], joints[order]


def _along(
    arm: ArmModel, scene: Scene, places: Places, path: Tensor, row: Tensor, q: Tensor, home: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Rows, whether they are reached straight, and lines (K, LINE, n), for postures q (M, n)."""
    kept, line = _on_line(arm, path, q, home)
    for kind, stretch in ((APPROACH, slice(HALF + 1)), (LIFT, slice(HALF, LINE))):
        clear = ways_clear(arm, scene, places[kept], _all(kind, kept), line[:, stretch])
        kept, line = kept[clear], line[clear]
    reach = torch.stack([home.expand_as(line[:, 0]), line[:, 0]], 1)
    return row[kept], ways_clear(arm, scene, places[kept], _all(REACH, kept), reach), line


def _on_line(arm: ArmModel, path: Tensor, q: Tensor, home: Tensor) -> tuple[Tensor, Tensor]:
    """Which waypoints (M, 5, 4, 4) can be followed from postures q (M, n), and lines (K, LINE, n).

    Lines on which a joint would move too fast for the tool to stay on its line are left out.
    """
    ends, share = path[:, :, None], torch.linspace(0, 1, HALF + 1).to(path)[:, None, None]
    there = [ends[:, i] + share * (ends[:, i + 2] - ends[:, i]) for i in (0, 2)]
    line, reached = arm.follow(q, torch.cat([there[0], there[1][:, 1:]], 1))
    line = line.double()
    first = home + arm.difference(line[:, :1], home)
    steps = arm.difference(line[:, 1:], line[:, :-1])
    smooth = reached.all(1) & (steps.abs().amax((1, 2)) < MAX_TURN)
    line = torch.cat([first, first + steps.cumsum(1)], 1)
    return smooth.nonzero()[:, 0], line[smooth]


def _all(kind: int, like: Tensor) -> Tensor:
    return torch.full_like(like, kind)


def _grasps_in_closed_form(
    form: SphericalArm, robot: Robot, which: int, lines: Lines, places: Places
) -> Grasps:
    """The same in double precision, with no more postures than needed."""
    arm, scene, library = robot.arms[which], robot.scenes[which], required(torch.float64)
    home, count, like = robot.home[which].double(), len(lines.path), places.table
    none = like.new_empty(0, LINE, len(home))
    line, held = home.new_empty(count, LINE, len(home)), home.new_empty(count, 3, 4)
    state = torch.empty(count, dtype=torch.long)
    task = library.structures["Grasps"](
        ways=ways_task(arm, scene, places, lines.row[:0], none),
        form=form_structure(form, arm.mount, PAN_SAMPLES), path=lines.path.to(like), home=home,
        at=lines.row, continuous=arm.continuous, line=line, held=held, state=state, lines=count,
        steps=LINE, near=NEAR, tried=TRIED, few=FEW, sparse=SPARSE, most_step=MAX_STEP,
        most_turn=MAX_TURN,
    )  # fmt: skip
    if library.functions["grasps_found"](task, threads_worth(count, WORTH_SHARING)):
        raise MemoryError("no memory to look for grasps; give the process more")
    kept = state.nonzero()[:, 0]
    straight = state[kept] == STRAIGHT
    return Grasps(lines.row[kept], lines.rank[kept], straight, line[kept], held[kept])
