"""Whether arms are clear of everything on their ways, also between waypoints.

A way is halved until each half is known to be clear. Two solids need no further test if, in the
middle of a part, they are too far apart for the joints to bring them together before its ends
(Schwarzer, Saha & Latombe, "Adaptive dynamic collision checking for single and multiple articulated
robots in complex environments", 2005).
"""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cgtorch.native import constants, function, structure, threads
from cgtorch.tabletop.kinematics.arm import ArmModel
from cgtorch.tabletop.kinematics.collision import Tensors
from cgtorch.tabletop.kinematics.scene import HELD, OBJECT, TABLE, Scene
from cgtorch.tabletop.kinematics.solid_distance import distance_of
from cgtorch.tabletop.kinematics.solids import ball_radius

MARGIN = 0.002  # m that is kept from everything
RESOLUTION = MARGIN  # m that two solids may come nearer without another look, so that none touch
COARSE = 0.1  # m: what may come nearer than that is measured in the halves of a way only
HALVINGS = 24


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

    def __getitem__(self, rows: Tensor) -> "Places":
        """Some rows."""
        return Places(*(each[rows] for each in vars(self).values()))


def ways_clear(arm: ArmModel, scene: Scene, places: Places, kind: Tensor, ways: Tensor) -> Tensor:
    """(B,) whether an arm is clear on its ways.

    Args:
        arm: The arm.
        scene: Its scene.
        places: (B,) the parts of the scene that differ by row.
        kind: (B,) long, the kinds of ways, such as `scene.REACH`.
        ways: (B, W, n) waypoints, between which the joints move in straight lines, rad or m.
    """
    places, ways = places.to(ways.double()), ways.double()
    task = ways_task(arm, scene, places, kind, ways)
    if task is None:
        return ways_clear_in_torch(arm, scene, places, kind, ways)
    task.made = torch.empty(len(ways), dtype=torch.bool)
    task.clear = task.made.data_ptr()
    function("ways_clear", torch.float64)(task, max(1, min(threads(), len(ways) // 4)))
    made: Tensor = task.made
    return made


def ways_task(
    arm: ArmModel, scene: Scene, places: Places, kind: Tensor, ways: Tensor
) -> Any | None:
    """The input of compiled code, without its output; None if it is not supported."""
    most = constants("way_limits", torch.float64)
    chain, n, count = arm.chain(ways)[1], ways.shape[2], ways.shape[1]
    sizes = {
        "MOST_FRAMES": len(chain.kind), "MOST_JOINTS": n, "MOST_SOLIDS": len(scene.size),
        "MOST_PAIRS": len(scene.pairs), "MOST_WAYPOINTS": count,
    }  # fmt: skip
    if not most or not ways.is_cpu or any(size > most[name] for name, size in sizes.items()):
        return None
    made = structure("Chain", torch.float64)(**vars(chain), frames=len(chain.kind), joints=n)
    fixed = structure("Scene", torch.float64)(
        chain=made, **vars(scene), solids=len(scene.size), count=len(scene.pairs), margin=MARGIN,
        resolution=RESOLUTION, coarse=COARSE,
    )  # fmt: skip
    return structure("Ways", torch.float64)(
        scene=fixed, table=places.table, size=places.table_size, object=places.object,
        held=places.held, kind=kind, first=count * torch.arange(len(ways) + 1), q=ways, clear=None,
        ways=len(ways),
    )  # fmt: skip


def ways_clear_in_torch(
    arm: ArmModel, scene: Scene, places: Places, kind: Tensor, ways: Tensor
) -> Tensor:
    """The same as `ways_clear` on any device, with all intervals of all ways halved together."""
    scene = scene.to(ways)
    steps = (ways[:, 1:] - ways[:, :-1]).abs().cumsum(1)
    gone = torch.cat([torch.zeros_like(ways[:, :1]), steps], 1)
    clear = torch.ones(len(ways), dtype=torch.bool, device=ways.device)
    row, pair = (scene.pairs[:, 2] & kind[:, None] > 0).nonzero(as_tuple=True)
    begin = torch.zeros(len(row), dtype=ways.dtype, device=ways.device)
    end = begin + ways.shape[1] - 1
    for halving in range(HALVINGS + 1):
        at = (begin + end) / 2
        here = _at(gone, row, at)
        travel = torch.maximum(here - _at(gone, row, begin), _at(gone, row, end) - here)
        nearer = (scene.reach[pair] * travel).sum(1)
        solids = _placed(arm, scene, places, ways, row, pair, at)
        gap = _ball_distance(*solids)
        near = (gap < MARGIN + nearer) & (nearer <= COARSE)
        gap[near] = distance_of(*(each[near] for each in solids))
        clear[row[near & (gap < MARGIN)]] = False
        left = clear[row] & (gap < MARGIN + nearer) & (nearer > RESOLUTION)
        if halving == HALVINGS or not left.any():
            break
        row, pair, begin, at, end = (x[left] for x in (row, pair, begin, at, end))
        row, pair = row.repeat(2), pair.repeat(2)
        begin, end = torch.cat([begin, at]), torch.cat([at, end])
    return clear


def _at(rows: Tensor, row: Tensor, at: Tensor) -> Tensor:
    """(M, n) linear interpolation between rows (B, W, n)."""
    first = at.long().clamp_max(max(rows.shape[1] - 2, 0))
    second = (first + 1).clamp_max(rows.shape[1] - 1)
    share = (at - first)[:, None]
    return rows[row, first] + share * (rows[row, second] - rows[row, first])


def _placed(
    arm: ArmModel, scene: Scene, places: Places, ways: Tensor, row: Tensor, pair: Tensor, at: Tensor
) -> list[Tensor]:
    """Poses (M, 3, 4) and sizes (M, 5) of both solids of pairs at places of ways."""
    moments, which = torch.unique(torch.stack([row.to(at), at], 1), dim=0, return_inverse=True)
    where = moments[:, 0].long()
    frames = arm.frames(_at(ways, where, moments[:, 1]))[:, which]
    solids: list[Tensor] = []
    for solid in scene.pairs[pair, :2].unbind(1):
        pose, size, frame = scene.pose[solid].clone(), scene.size[solid].clone(), scene.frame[solid]
        own = {TABLE: places.table, OBJECT: places.object, HELD: places.held}
        for number, of_rows in own.items():
            is_it = solid == number
            pose[is_it] = of_rows[row[is_it]]
        size[solid == TABLE] = places.table_size[row[solid == TABLE]]
        carrier = frames[frame, torch.arange(len(frame), device=frame.device)]
        moved = carrier[:, :3, :3] @ pose
        moved[..., 3] += carrier[:, :3, 3]
        solids += [torch.where((frame >= 0)[:, None, None], moved, pose), size]
    return solids


def _ball_distance(pose: Tensor, size: Tensor, other_pose: Tensor, other_size: Tensor) -> Tensor:
    """(M,) the distance between the balls around solids, m."""
    apart = (pose[..., 3] - other_pose[..., 3]).norm(dim=1)
    return apart - ball_radius(size) - ball_radius(other_size)
