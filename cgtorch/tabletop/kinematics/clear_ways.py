"""Whether ways of arms are clear, and planned ways, in compiled code.

`native/tabletop/arms.c` computes it, with frames that pytorch-kinematics reads from the URDF.
"""

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cgtorch.ground.errors import RobotError
from cgtorch.native import agree, required, threads_worth
from cgtorch.tabletop.kinematics.arm import ArmModel
from cgtorch.tabletop.kinematics.solids import Tensors

TABLE, OBJECT, HELD, OWN = range(4)
"""The first solids of a scene: the table, the standing object, and the held object. Those of the
arm begin at `OWN`, followed by fixed ones."""
REACH, APPROACH, LIFT, CARRY, POSTURE = 1, 2, 4, 8, 16
"""Kinds of ways: to the pre-grasp, to the grasp, up with the object, and home with it; and postures
that are clear of table and body only."""
MARGIN = 0.002  # m that is kept from everything
RESOLUTION = MARGIN  # m that two solids may come nearer without another look, so that none touch
COARSE = 0.1  # m: nearer solids are measured in the halves of a way only
SHOULDER_JOINTS = 3
"""Joint limits keep links that at most this many joints move off the body; only the table can stop
them."""
ROUNDS = 100  # of a planner
STEP = 0.7
"""The length of a planner's step, by all joints together, rad or m."""
WORTH_SHARING = 4  # ways that are worth one more thread
VIAS = 16
"""The largest number of waypoints on a planned way, including its ends."""


@dataclass(frozen=True, eq=False)
class Scene(Tensors):
    """An arm, and everything that it must keep clear of.

    Attributes:
        pose, size, radius, frame: (S, ...) of solids, see `Solids`. Those of table and objects
            differ by row.
        pairs: (P, 3) long: two solids, of which the first moves, and the kinds of ways on which
            they must stay apart.
        reach: (P, n) how much closer a unit of each joint can bring a pair at most, m.
    """

    pose: Tensor
    size: Tensor
    radius: Tensor
    frame: Tensor
    pairs: Tensor
    reach: Tensor


@dataclass(frozen=True)
class Places(Tensors):
    """The parts of a scene that differ by row.

    Attributes:
        table, table_size: (B, 3, 4) and (B, 5) of the table's slab; see `Solids`.
        object: (B, 3, 4) pose of the standing object.
        held: (B, 3, 4) pose in the tool frame of the held object, at its centre.
    """

    table: Tensor
    table_size: Tensor
    object: Tensor
    held: Tensor


def ways_clear(arm: ArmModel, scene: Scene, places: Places, kind: Tensor, ways: Tensor) -> Tensor:
    """(B,) whether an arm is clear on its ways.

    Args:
        arm: The arm.
        scene: Its scene.
        places: (B,) the parts of the scene that differ by row.
        kind: (B,) long, the kinds of ways, such as `REACH`.
        ways: (B, W, n) waypoints, between which the joints move in straight lines, rad or m.
    """
    ways, clear = ways.double(), torch.empty(len(ways), dtype=torch.bool)
    task = ways_task(arm, scene, places.to(ways), kind, ways, clear)
    shares = threads_worth(len(ways), WORTH_SHARING)
    required(torch.float64).functions["ways_clear"](task, shares)
    return clear


def ways_planned(
    arm: ArmModel, scene: Scene, places: Places, kind: Tensor, ends: Tensor, key: Tensor
) -> tuple[Tensor, Tensor]:
    """Ways (B, VIAS, n) between postures, and their numbers of waypoints (B,), 0 if none is found.

    Args:
        arm: The arm.
        scene: Its scene.
        places: (B,) the parts of the scene that differ by row.
        kind: (B,) long, the kinds of ways, such as `REACH`.
        ends: (B, 2, n) where each way begins and ends, rad or m.
        key: (B,) long, of the random numbers of each row.
    """
    ends, library = ends.double(), required(torch.float64)
    agree(library.constants["plan_limits"], {"MOST_VIAS": VIAS})
    found = ends.new_zeros(len(ends), VIAS, ends.shape[2])
    count = torch.zeros(len(ends), dtype=torch.long)
    # Random postures are within limits; of a continuous joint, half a turn beyond both ends.
    low = torch.where(arm.continuous, ends.amin(1) - math.pi, arm.lower)
    high = torch.where(arm.continuous, ends.amax(1) + math.pi, arm.upper)
    plans = library.structures["Plans"](
        ways=ways_task(arm, scene, places.to(ends), kind, ends), lower=low, upper=high, key=key,
        found=found, count=count, rounds=ROUNDS, step=STEP,
    )  # fmt: skip
    if library.functions["ways_planned"](plans, threads_worth(len(ends), 1)):
        raise MemoryError("no memory to plan ways of arms; give the process more")
    return found, count


def ways_task(
    arm: ArmModel, scene: Scene, places: Places, kind: Tensor, ways: Tensor,
    clear: Tensor | None = None,
) -> Any:  # fmt: skip
    """The arguments of `ways_clear`, in double precision, and its output, for compiled code."""
    structures, solids, count = required(ways.dtype).structures, len(scene.size), len(scene.pairs)
    sizes = {"MOST_SOLIDS": solids, "MOST_PAIRS": count, "MOST_WAYPOINTS": ways.shape[1]}
    _check_size(arm, ways, sizes)
    fixed = structures["Scene"](
        chain=_chain(arm, ways), **vars(scene), solids=solids, count=count, margin=MARGIN,
        resolution=RESOLUTION, coarse=COARSE,
    )  # fmt: skip
    return structures["Ways"](
        scene=fixed, table=places.table, size=places.table_size, object=places.object,
        held=places.held, kind=kind, q=ways, clear=clear, ways=len(ways), waypoints=ways.shape[1],
    )  # fmt: skip


def _chain(arm: ArmModel, like: Tensor) -> Any:
    table, joints = arm.chain(like)[1], len(arm.joint_names)
    frames = len(table.kind)
    _check_size(arm, like, {"MOST_FRAMES": frames, "MOST_JOINTS": joints})
    return required(like.dtype).structures["Chain"](**vars(table), frames=frames, joints=joints)


def _check_size(arm: ArmModel, like: Tensor, sizes: dict[str, int]) -> None:
    """RobotError if an arm has more of something than compiled code takes."""
    limits = required(like.dtype).constants["arm_limits"]
    for name, size in sizes.items():
        if size > limits[name]:
            what = name.removeprefix("MOST_").lower()
            raise RobotError(
                f"arm {arm.name!r} has {size} {what}, of which its checks take {limits[name]}: "
                "give it fewer links, or fewer collision shapes"
            )
