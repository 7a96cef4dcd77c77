"""Another home of a robot's arms, where no clear way leads to objects from the computed one."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from cgtorch.tabletop.kinematics import Robot, graspable
from cgtorch.tabletop.kinematics.arm import ArmModel
from cgtorch.tabletop.kinematics.scene import (
    clear_of_robot,
    shoulders_clear,
    shoulders_touching,
)
from cgtorch.tabletop.robot_folder.chains import slides_upright
from cgtorch.tabletop.robot_folder.reach import (
    AHEAD,
    FARTHER,
    FEW,
    HEIGHT,
    OTHERS,
    objects,
    progress,
)
from cgtorch.tabletop.robot_folder.structure import Structure

RAISED = 0.85  # of its range, where an upright slide holds an arm above tables


def better_home(robot: Robot) -> Robot | None:
    """The robot with the home from which most objects have a clear way; None if none has.

    The joints are all in the middle of their ranges, or at 0 as far as limits allow, or at 0 with
    upright slides raised. The robot must not touch itself there.
    """
    rows = [objects(robot, HEIGHT, ahead) for ahead in (AHEAD, *FARTHER)]
    some = [objects(robot, height) for height in OTHERS]
    rows += [(position[list(FEW)], table[list(FEW)]) for position, table in some]
    position, table = (torch.cat(parts) for parts in zip(*rows, strict=True))
    if not any(progress(robot, which, position, table)[2] for which in range(len(robot.arms))):
        return None  # as no home helps where nothing can be approached
    best, most = None, 0
    for other in _others(robot):
        count = int(graspable(other, position, table).sum())
        best, most = (other, count) if count > most else (best, most)
    return best


def _others(robot: Robot) -> Iterator[Robot]:
    """The robot with each other home in which it does not touch itself."""
    seen = list[tuple[Tensor, ...]]()
    for homes in zip(*(_postures(robot, arm) for arm in robot.arms), strict=True):
        if any(all(map(torch.equal, homes, each)) for each in seen):
            continue
        seen.append(homes)
        other = replace(robot, home=homes)
        every = zip(robot.arms, other.scenes, homes, strict=True)
        if all(
            bool(clear_of_robot(arm, scene, q[None]) & shoulders_clear(arm, robot.body, q[None]))
            for arm, scene, q in every
        ):
            yield other


def touching_at_home(robot: Robot) -> list[str]:
    """Notes on the first links of arms that touch the body at home, which ways do not check."""
    apart = {frozenset(pair) for pair in robot.description.excludes}
    notes = []
    for arm, q in zip(robot.arms, robot.home, strict=True):
        both = {
            (arm.solid_links[i], robot.body_links[k]): None
            for i, k in shoulders_touching(arm, robot.body, q)
        }
        if touch := [pair for pair in both if frozenset(pair) not in apart]:
            named = ", ".join(f"{link!r} touches {body!r}" for link, body in touch)
            notes.append(f"at home of arm {arm.name!r} {named}: give another home by --home")
    return notes


def _postures(robot: Robot, arm: ArmModel) -> tuple[Tensor, Tensor, Tensor]:
    """The middle of an arm's ranges, 0, and 0 with upright slides raised, rad or m."""
    lower, upper = arm.turn_limits
    middle = torch.where(arm.continuous, 0.0, (lower + upper) / 2)
    zero = torch.zeros_like(lower).clamp(lower, upper)
    structure, raised = Structure(robot.urdf, robot.description.base_frame), zero.clone()
    for i, name in enumerate(arm.joint_names):
        joint = robot.urdf.joint(name)
        if slides_upright(structure, joint):
            axis = structure.pose(joint.child)[:3, :3] @ np.asarray(joint.axis, dtype=np.float64)
            share = RAISED if axis[2] > 0 else 1 - RAISED
            raised[i] = lower[i] + share * (upper[i] - lower[i])
    return middle, zero, raised
