"""Networks that see and act from the edge nearest to the object, as `world.edge_frame` has it.

They need not learn that a table that is turned, or seen from another side, is still the same table:
what a node says of one edge holds for all.
"""

from torch import Tensor

from cgtorch.actions import ActionSet, named_actions
from cgtorch.actions.networks import BranchingNN, ContinuousNN, one_hidden_layer
from cgtorch.environment import Lanes
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
    """From the scene to a pose to stand at, both in the edge's frame; sent as a motion to there.

    The pose is x, y (m) and heading (rad) of the base. Obstacles are not looked at: whether one is
    in the way is MoveBase's to say, and where else to go then another node's.
    """

    native_kind = "EDGE"
    plain_module = "cgtorch.tabletop.plain_edge_networks"

    def __init__(self, percept_size: int = 9, hidden: int = 3):
        super().__init__(SCENE, hidden)
        self.percept_size = percept_size

    def sees(self, percept: Tensor) -> Tensor:
        """The scene without obstacles (n, inputs)."""
        return table_scene(edge_frame(percept), percept)

    def network(self, lanes: Lanes, parameters: Tensor) -> Tensor:
        """The motions (n, 3) to the poses that the network says."""
        frame = edge_frame(lanes.percept)
        seen = table_scene(frame, lanes.percept)
        return motion_to(frame, one_hidden_layer(seen, parameters, self.hidden, self.outputs))


class EdgeWayNN(EdgeNN):
    """An `EdgeNN` that looks at obstacles: it sends the first motion of a route to its pose.

    Where the straight way is blocked by what is seen, that leads past a corner; asked again from
    there, it sends the next one (`cgtorch.tabletop.world.routes`). The footprint (m) is x min,
    x max, y min, y max of the base with the room that it keeps.
    """

    native_kind = "EDGE_WAY"
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
        """The first motions (n, 3) of routes to the poses that the network says."""
        motion = super().network(lanes, parameters)
        return first_motion(lanes.percept, motion, lanes.percept.new_tensor(self.footprint))


class EdgeBranchingNN(BranchingNN):
    """From the scene in the edge's frame to one of two branches."""

    native_kind = "EDGE_BRANCHING"
    plain_module = "cgtorch.tabletop.plain_edge_networks"

    def __init__(self, percept_size: int = 9, hidden: int = 3):
        super().__init__(scene_size(percept_size), hidden)
        self.percept_size = percept_size

    def sees(self, percept: Tensor) -> Tensor:
        """The scene (n, inputs)."""
        return scene(percept)


def edge_actions(percept_size: int = 9) -> ActionSet:
    """The actions of section VI with networks that see and act from the nearest edge."""
    return named_actions(EdgeNN(percept_size), EdgeBranchingNN(percept_size))


def edge_way_actions(percept_size: int, footprint: tuple[float, float, float, float]) -> ActionSet:
    """The same where there may be obstacles: networks that drive around what is seen."""
    return named_actions(EdgeWayNN(percept_size, footprint), EdgeBranchingNN(percept_size))
