"""Networks in the frame of the table edge nearest to the object.

The frame's origin is the object. Its x points from the nearest edge into the table, and its y is
such that the robot is not at negative y, so mirrored scenes are equal. A node behaves alike
at all edges, however the table is placed and turned.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.graphs import ActionSet
from cgtorch.graphs.networks import BranchingNN, ContinuousNN, one_hidden_layer
from cgtorch.ground.environment import Lanes
from cgtorch.tabletop.actions import named_actions
from cgtorch.tabletop.world.geometry import rotate, wrap
from cgtorch.tabletop.world.percepts import BOX, TABLETOP, parts_of
from cgtorch.tabletop.world.routes import first_motion

SCENE = 9
"""The length of a scene without obstacles; see `scene`."""
OBSTACLE = 3
"""The length of each obstacle in a scene."""
NOWHERE = 3.0  # m behind the edge, where an obstacle that is not there is said to be


class EdgeNN(ContinuousNN):
    """Maps the scene to a pose of the base, both in the edge's frame; sends the motion to it.

    The pose is x, y (m) and heading (rad). Obstacles are not read: MoveBase fails if one is in the
    way, and another node can then choose another pose.
    """

    native_kind = "DOMAIN_NN"
    plain_module = "cgtorch.tabletop.plain_edge_networks"

    def __init__(self, percept_size: int = 9, hidden: int = 3):
        super().__init__(SCENE, hidden)
        self.percept_size = percept_size

    def sees(self, percept: Tensor) -> Tensor:
        """The scene without obstacles (n, inputs)."""
        return table_scene(edge_frame(percept), percept)

    def network(self, lanes: Lanes, parameters: Tensor) -> Tensor:
        """The motions (n, 3) to the network's poses."""
        frame = edge_frame(lanes.percept)
        seen = table_scene(frame, lanes.percept)
        return motion_to(frame, one_hidden_layer(seen, parameters, self.hidden, self.outputs))


class EdgeWayNN(EdgeNN):
    """An `EdgeNN` that avoids obstacles: it sends the first motion of a route to its pose.

    If the straight motion is blocked, the route leads past a corner. Visited again there, the node
    sends the next motion (`cgtorch.tabletop.world.routes`). The footprint (m) is x min, x max, y
    min, y max of the base with a margin.
    """

    native_kind = "DOMAIN_OTHER_NN"
    plain_module = "cgtorch.tabletop.plain_edge_networks"

    def __init__(
        self,
        percept_size: int,
        footprint: tuple[float, float, float, float],
        hidden: int = 3,
    ):
        super().__init__(percept_size, hidden)
        self.footprint = footprint
        self.plain_arguments = {"footprint": footprint}

    def network(self, lanes: Lanes, parameters: Tensor) -> Tensor:
        """The first motions (n, 3) of routes to the network's poses."""
        motion = super().network(lanes, parameters)
        return first_motion(lanes.percept, motion, lanes.percept.new_tensor(self.footprint))


class EdgeBranchingNN(BranchingNN):
    """Maps the scene in the edge's frame to one of two branches."""

    native_kind = "DOMAIN_BRANCHING"
    plain_module = "cgtorch.tabletop.plain_edge_networks"

    def __init__(self, percept_size: int = 9, hidden: int = 3):
        super().__init__(scene_size(percept_size), hidden)
        self.percept_size = percept_size

    def sees(self, percept: Tensor) -> Tensor:
        """The scene (n, inputs)."""
        return scene(percept)


def edge_actions(percept_size: int = 9) -> ActionSet:
    """The actions of section VI with networks in the frame of the nearest edge."""
    return named_actions(EdgeNN(percept_size), EdgeBranchingNN(percept_size))


def edge_way_actions(percept_size: int, footprint: tuple[float, float, float, float]) -> ActionSet:
    """The same for scenarios with obstacles: the networks drive around these."""
    return named_actions(EdgeWayNN(percept_size, footprint), EdgeBranchingNN(percept_size))


@dataclass(frozen=True)
class EdgeFrame:
    """n frames within the robot's base frame.

    Attributes:
        origin: (n, 2) the object (m).
        yaw: (n,) of the x axis (rad).
        mirror: (n,) -1 if y points to the right of x, else 1.
        extent: (n, 4) from the object to the nearest edge, the opposite one, and the ends of the
            table at positive and at negative y (m).
    """

    origin: Tensor
    yaw: Tensor
    mirror: Tensor
    extent: Tensor


def scene_size(percept_size: int) -> int:
    """The length of a `scene` for percepts of a size."""
    obstacles = (percept_size - TABLETOP) // BOX
    return SCENE + OBSTACLE * obstacles


def edge_frame(percept: Tensor) -> EdgeFrame:
    """The frames of percepts (n, D); for errors see `parts_of`."""
    seen = parts_of(percept)
    table, placed = seen.table, seen.object
    at = rotate(placed - table[..., :2], -table[..., 2])
    half = table[..., 3:] / 2
    # Edges at -x, -y, +x, +y of the table: a quarter turn from each to the next.
    gaps = torch.cat([half + at, half - at], -1)
    nearest = gaps.argmin(-1, keepdim=True)
    front, right, back, left = (gaps.gather(-1, (nearest + k) % 4)[..., 0] for k in range(4))
    yaw = wrap(table[..., 2] + torch.pi / 2 * nearest[..., 0].to(table))
    robot = rotate(-placed, -yaw)
    mirror = torch.where(robot[..., 1] < 0, -1.0, 1.0).to(robot)
    ends = torch.where(mirror > 0, left, right), torch.where(mirror > 0, right, left)
    return EdgeFrame(placed, yaw, mirror, torch.stack([front, back, *ends], -1))


def scene(percept: Tensor) -> Tensor:
    """The scenes (n, `scene_size`) of percepts in their own frames.

    They contain the robot's x and y (m), cosine and sine of its heading, the four extents and the
    object's height (m); and for each obstacle its centre's x and y and half its mean side (m).
    """
    frame = edge_frame(percept)
    return torch.cat([table_scene(frame, percept), obstacles(frame, percept)], -1)


def table_scene(frame: EdgeFrame, percept: Tensor) -> Tensor:
    """The scene without its obstacles (n, SCENE)."""
    robot = into(frame, torch.zeros_like(frame.origin))
    heading = -frame.mirror * frame.yaw
    turned = [heading.cos()[..., None], heading.sin()[..., None]]
    return torch.cat([robot, *turned, frame.extent, parts_of(percept).height], -1)


def obstacles(frame: EdgeFrame, percept: Tensor) -> Tensor:
    """The scene's obstacles (n, OBSTACLE each)."""
    seen = parts_of(percept)
    low, high = seen.obstacles[..., 0::2], seen.obstacles[..., 1::2]
    centre = into(frame, (low + high) / 2)
    obstacle = torch.cat([centre, (high - low).mean(-1, keepdim=True) / 2], -1)
    nothing = obstacle.new_tensor([-NOWHERE, 0.0, 0.0])
    return torch.where(seen.present[..., None], obstacle, nothing).flatten(-2)


def into(frame: EdgeFrame, point: Tensor) -> Tensor:
    """Points (n, ..., 2) of the base frame in edge frames."""
    extra = (1,) * (point.dim() - frame.origin.dim())
    shape = (*frame.yaw.shape, *extra)
    out = rotate(point - frame.origin.view(*shape, 2), -frame.yaw.view(shape))
    return torch.stack([out[..., 0], frame.mirror.view(shape) * out[..., 1]], -1)


def motion_to(frame: EdgeFrame, pose: Tensor) -> Tensor:
    """Motions (n, 3) dx, dy (m), dθ (rad) of the base to poses (n, 3) in edge frames."""
    x, y, heading = pose.unbind(-1)
    way = frame.origin + rotate(torch.stack([x, frame.mirror * y], -1), frame.yaw)
    return torch.cat([way, wrap(frame.yaw + frame.mirror * heading)[..., None]], -1)
