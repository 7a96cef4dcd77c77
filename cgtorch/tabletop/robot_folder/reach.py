"""What a robot can grasp on a table before it, and where it cannot, why."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from cgtorch.tabletop.kinematics import Robot, graspable
from cgtorch.tabletop.kinematics.clear_ways import POSTURE, ways_clear
from cgtorch.tabletop.kinematics.grasping import (
    APPROACHES,
    GRASP_HEIGHT,
    followed,
    places_of,
    waypoints,
)
from cgtorch.tabletop.kinematics.scene import random_postures
from cgtorch.tabletop.kinematics.urdf import MOVING, at_rest
from cgtorch.tabletop.robot_folder.structure import Structure

DEPTH, WIDTH, HEIGHT = 0.8, 1.6, 0.75  # m, of the table on which a robot is tried
OTHERS = (1.2, 0.9, 0.6, 0.45, 0.3, 0.15, 0.05)
"""Other heights (m), where nothing on that table is grasped."""
BELOW = (-0.1, -0.2, -0.3, -0.5)
"""Such heights (m) below the floor, for an arm that works below its base: a stand lifts it."""
BETWEEN = 12  # heights within those of an arm's tool, where nothing is grasped at these either
POSTURES = 512  # random ones of an arm, by which it is seen how high its tool comes
AHEAD = 0.05  # m from the footprint to that table
FARTHER = (0.2, 0.35, 0.5, 0.65)
"""Other such distances (m), where an arm that is long when it is retracted may grasp something."""
FEW_WAYS = 4  # in which an arm moves its tool, where that is told
TURNED = 60  # degrees from x at rest that are told
SIDEWAYS = 0.2  # of an arm's length, how far it leads to the side at least to point somewhere
DEPTHS, ASIDE = (0.1, 0.2, 0.3), (-0.3, 0.0, 0.3)  # m: where objects are on it
OBJECTS = len(DEPTHS) * len(ASIDE)
FEW = (1, 3, 4, 5)
"""Those of these by which other heights are compared: the nearest, and all at the middle depth."""


@dataclass(frozen=True)
class Reached:
    """Which objects on a table right before a robot it can grasp.

    Attributes:
        grasps: (9,) bool.
        why: Why there is none, and what suits better, in a sentence; "" if there is one.
        somewhere: Whether it can grasp one of these, or one at another height or distance.
        about: How long and high the arm is that is nearest to an object, if there is none.
    """

    grasps: Tensor
    why: str = ""
    somewhere: bool = True
    about: str = ""


def reached(robot: Robot, stand: float = 0.0) -> Reached:
    """What a robot, on a stand of some height (m), can grasp on a table of usual height, and why.

    Why it can grasp nothing is told with numbers, and with a height of tables that suits it.
    """
    grasps = graspable(robot, *objects(robot, HEIGHT))
    if grasps.any():
        return Reached(grasps)
    lacks = [_lacking(robot, number) for number in range(len(robot.arms))]
    nearest = min(range(len(lacks)), key=lambda number: lacks[number][0])
    far, about, shoulder = lacks[nearest]
    if (height := _better_height(robot)) is not None:
        most = int(graspable(robot, *objects(robot, height)).sum())
        reason = "" if far else f"; {_hindered(robot, nearest, HEIGHT)}"
        advice = _better(height, most, stand) + _lifted(robot, height)
        return Reached(grasps, f"{about}{reason}; {advice}", about=about)
    if not _approached(robot, nearest) and (farther := _farther(robot)):
        return Reached(grasps, f"{about}; {farther}", about=about)
    reason = f"; nor can it at any height that was tried, from {min(OTHERS):g} to {max(OTHERS):g} m"
    suits = min((HEIGHT, *OTHERS), key=lambda height: abs(height - shoulder))
    hindered = _beside_footprint(robot, nearest) or _hindered(robot, nearest, suits)
    return Reached(grasps, f"{about}{reason}; {hindered}", somewhere=False, about=about)


def objects(robot: Robot, height: float, ahead: float = AHEAD) -> tuple[Tensor, Tensor]:
    """Objects (9, 3) on a table of some height, and the table (9, 6), in the base frame.

    The table is some distance ahead of the footprint, m.
    """
    edge = robot.description.footprint[1] + ahead
    position = torch.tensor([[edge + x, y, height] for x in DEPTHS for y in ASIDE])
    table = torch.tensor([edge + DEPTH / 2, 0.0, 0.0, DEPTH, WIDTH, height])
    return position, table.expand(OBJECTS, 6)


def _better_height(robot: Robot) -> float | None:
    """The height at which most of a few objects can be grasped, m; None if none can.

    It is below the floor only if there is no other.
    """
    above = _best_of(robot, OTHERS) or _best_of(robot, _heights_of_tools(robot))
    return above or _best_of(robot, BELOW)


def _approached(robot: Robot, which: int) -> bool:
    """Whether an arm could come to an object right before the robot, if only its home allowed."""
    return progress(robot, which, *objects(robot, HEIGHT))[2] > 0


def _farther(robot: Robot) -> str:
    """From which distance on objects at a usual height can be grasped; "" if none can."""
    rows = [objects(robot, HEIGHT, ahead) for ahead in FARTHER]
    position, table = (torch.cat(parts) for parts in zip(*rows, strict=True))
    grasps = graspable(robot, position, table)
    if not grasps.any():
        return ""
    counts = grasps.view(len(FARTHER), OBJECTS).sum(1)
    best, nearest = int(counts.argmax()), float(position[grasps, 0].min())
    return (
        f"it does not reach nearer than about {nearest:.2f} m from its base frame: from "
        f"{FARTHER[best]:g} m before the table it can grasp {int(counts[best])} of {OBJECTS}"
    )


def _best_of(robot: Robot, heights: tuple[float, ...]) -> float | None:
    tables = [[part[list(FEW)] for part in objects(robot, height)] for height in heights]
    every = graspable(robot, *(torch.cat(parts) for parts in zip(*tables, strict=True)))
    counts = every.view(len(heights), len(FEW)).sum(1)
    return heights[int(counts.argmax())] if counts.any() else None


def _heights_of_tools(robot: Robot) -> tuple[float, ...]:
    """Heights of tables, m, evenly over those on which an arm's tool comes to an object.

    They are close to each other where an arm moves its tool up and down by little, as a SCARA.
    """
    rng, found = torch.Generator().manual_seed(0), list[Tensor]()
    for arm in robot.arms:
        lower, upper = arm.turn_limits
        share = torch.rand(POSTURES, len(lower), generator=rng).to(lower)
        found.append(arm.frames(lower + share * (upper - lower))[-1, :, 2, 3] - GRASP_HEIGHT)
    ends = torch.cat(found).clamp(min(OTHERS), max(OTHERS)).aminmax()
    return tuple(round(height, 2) for height in torch.linspace(*ends, BETWEEN).tolist())


def _lifted(robot: Robot, height: float) -> str:
    """Where the torso has the arms as high above a usual table as above one of some height."""
    words = robot.description
    if words.torso_joint is None or words.torso_position is None:
        return ""
    joint = robot.urdf.joint(words.torso_joint)
    axis = Structure(robot.urdf, words.base_frame).pose(joint.child)[:3, :3] @ joint.axis
    at = round(words.torso_position + math.copysign(1.0, axis[2]) * (HEIGHT - height), 2)
    within = joint.limit is None or joint.limit.lower <= at <= joint.limit.upper
    return f", or move its torso by --torso-position {at:g}" if within else ""


def _better(height: float, count: int, stand: float) -> str:
    """What to do where objects can be grasped at another height."""
    lifted = f"put it on a stand by --stand {round(stand + HEIGHT - height, 2):g}"
    if height < 0:
        return f"below its base it can grasp {count} of {OBJECTS}, so {lifted}"
    found = f"at {height:g} m it can grasp {count} of {OBJECTS}, so make tables of that height"
    if height > HEIGHT:
        return found
    return f"{found}, or {lifted}"


def _hindered(robot: Robot, which: int, height: float) -> str:
    """What hinders an arm on a table of some height, with how many approaches come how far."""
    posed, clear, follows = progress(robot, which, *objects(robot, height))
    name, ways = robot.arms[which].name, robot.arms[which].freedom
    few = f"; it moves its tool in {ways} ways only, so it can approach from few sides"
    few = few if ways <= FEW_WAYS else ""
    if not posed:
        return (
            "no posture within the limits of the joints brings the tool frame to an object "
            f"at {height:g} m, so correct the tool frame or the limits if that is wrong{few}"
        )
    total = OBJECTS * len(APPROACHES)
    come = f"arm {name!r} has a posture at {posed} of {total} approaches at {height:g} m"
    if not clear:
        return f"{come}, but all touch the table or the robot: look for shapes that are too big"
    if not follows:
        return (
            f"{come}, clear ones at {clear}, but from none of these it can move 0.10 m back from "
            f"the object and up within the limits of its joints{few}"
        )
    return (
        f"{come}, clear ones at {clear}, and follows {follows} of them, but no clear way leads "
        "there from home: give another one by --home"
    )


def _beside_footprint(robot: Robot, which: int) -> str:
    """That an arm's tool comes nowhere beyond the footprint to objects, if it does not; or ""."""
    arm = robot.arms[which]
    along = arm.frames(random_postures(arm, POSTURES))[:, :, 0, 3]
    farthest, shoulder = float(along[-1].max()), float(along[1].min())
    edge, before = robot.description.footprint[1], AHEAD + DEPTHS[0]
    if farthest >= edge + before or farthest < shoulder + before:  # as it is too short anyway
        return ""
    return (
        f"in none of {POSTURES} postures its tool is more than {farthest:.2f} m ahead of the base "
        f"frame, but the footprint ends at {edge:.2f} m, and objects begin {before:.2f} "
        "m before it: give a smaller one by --footprint if a table may stand in it"
    )


def progress(robot: Robot, which: int, position: Tensor, table: Tensor) -> tuple[int, int, int]:
    """How many approaches to objects on tables have postures, clear ones, and are followed."""
    arm = robot.arms[which]
    paths = torch.cat([waypoints(position, *approach) for approach in APPROACHES])
    places = places_of(position, table)
    path, kept = arm.aimed(paths)
    which_object = torch.arange(len(position)).repeat(len(APPROACHES))[kept]
    row, q = arm.candidates(path[:, 2])
    here, kind = places[which_object[row]], torch.full_like(row, POSTURE)
    clear = ways_clear(arm, robot.scenes[which], here, kind, q[:, None])
    follows, _ = followed(robot, which, path, places[which_object], row, q)
    return len(row.unique()), len(row[clear].unique()), len(follows.unique())


def _lacking(robot: Robot, number: int) -> tuple[float, str, float]:
    """How far an arm is too short for the nearest object, what that says, and its height, m."""
    words = robot.description
    arm, structure = words.arms[number], Structure(robot.urdf, words.base_frame)
    joints = robot.urdf.joints_between(arm.base_link, arm.tool_frame)
    moving = [joint for joint in joints if joint.type in MOVING]
    robot.urdf.model.update_cfg({joint.name: at_rest(joint) for joint in moving})
    places = np.stack(
        [structure.pose(link)[:3, 3] for link in [*(j.child for j in moving), arm.tool_frame]]
    )
    slides = [joint for joint in moving[1:] if joint.type == "prismatic"]
    drawn = sum(max(abs(joint.limit.lower), abs(joint.limit.upper)) for joint in slides)
    length = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum() + drawn)
    away = np.linalg.norm(objects(robot, HEIGHT)[0].numpy() - places[0], axis=1)
    about = f"arm {arm.name!r} is {length:.2f} m long from its shoulder, {places[0, 2]:.2f} m high"
    near, (x, y) = float(away.min()), (places[-1] - places[0])[:2]
    if (
        math.hypot(x, y) > SIDEWAYS * length
        and abs(turn := math.degrees(math.atan2(y, x))) > TURNED
    ):
        about += f", and at rest it points {turn:.0f} degrees away from x"
    if near > length:
        about += f", and the nearest object {near:.2f} m away from that"
    return max(near - length, 0.0), about, float(places[0, 2])
