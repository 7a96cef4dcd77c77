"""Networks in the frame of the table edge nearest to the object (`world.edge_frame`).

They do not have to learn that a turned table, or one seen from another side, is the same: what a
node does at one edge, it does at all.
"""

from torch import Tensor

from cgtorch.graphs import ActionSet
from cgtorch.graphs.networks import BranchingNN, ContinuousNN, one_hidden_layer
from cgtorch.ground.environment import Lanes
from cgtorch.tabletop.actions import named_actions
from cgtorch.tabletop.world.edge_frame import (
    SCENE,
    edge_frame,
    motion_to,
    scene,
    scene_size,
    table_scene,
)
from cgtorch.tabletop.world.routes import first_motion


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
