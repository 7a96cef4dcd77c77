import pytest
import torch
from support import FOOTPRINT, seeded

from cgtorch.graphs import BranchingNN, ContinuousNN
from cgtorch.ground.environment import start_lanes
from cgtorch.simulation import ModelEnvironment
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.edge_networks import (
    SCENE,
    EdgeBranchingNN,
    EdgeNN,
    EdgeWayNN,
    edge_actions,
    edge_frame,
    edge_way_actions,
    motion_to,
    scene,
)
from cgtorch.tabletop.world.routes import first_motion


def environment(size: int) -> ModelEnvironment:
    """Some percepts with nothing to do in them."""
    percepts = torch.randn(6, size, generator=seeded(1))
    return ModelEnvironment(
        percepts, lambda p, u: (p, p[:, 0]), lambda p: p[:, 0], lambda p, u: p[:, 0] > 0
    )


@pytest.mark.parametrize("size", [7, 9, 13])
def test_they_are_the_papers_networks_on_the_scene(size: int) -> None:
    here = environment(size)
    lanes = start_lanes(here, torch.arange(6), 3, 0)
    seen = start_lanes(here, torch.arange(6), 3, 0)
    seen = type(seen)(**{**vars(seen), "percept": scene(here.percepts)})
    edge, plain = EdgeNN(size), ContinuousNN(SCENE)
    parameters = edge.initial_parameters(6, seeded(2))
    after, outcome = edge(lanes, parameters, here)
    meant, _ = plain(seen, parameters, here)
    assert torch.equal(after.message, motion_to(edge_frame(here.percepts), meant.message))
    assert torch.equal(edge.sees(here.percepts), scene(here.percepts)[:, :SCENE])
    assert after.has_message.all()
    assert not outcome.any()
    assert torch.equal(after.percept, lanes.percept)
    edge_branch, branch = EdgeBranchingNN(size), BranchingNN(seen.percept.shape[1])
    parameters = edge_branch.initial_parameters(6, seeded(3))
    found, wanted = edge_branch(lanes, parameters, here)[1], branch(seen, parameters, here)[1]
    assert torch.equal(found, wanted)


def test_the_set_differs_in_its_networks_only() -> None:
    actions = edge_actions(13)
    assert actions.names == ("MoveBase", "Detect", "Grasp", "EdgeNN", "EdgeBranchingNN")
    assert [getattr(a, "percept_size", None) for a in actions.actions] == [None] * 3 + [13] * 2


@pytest.mark.parametrize("size", [9, 13])
def test_one_that_drives_around_sends_the_first_motion_of_a_way(size: int) -> None:
    here = environment(size)
    lanes = start_lanes(here, torch.arange(6), 3, 0)
    straight, around = EdgeNN(size), EdgeWayNN(size, FOOTPRINT)
    parameters = straight.initial_parameters(6, seeded(2))
    asked = straight(lanes, parameters, here)[0].message
    sent = around(lanes, parameters, here)[0].message
    assert torch.equal(sent, first_motion(here.percepts, asked, torch.tensor(FOOTPRINT)))
    assert around.num_parameters == straight.num_parameters


def test_where_there_are_obstacles_networks_drive_around() -> None:
    """With the room that the models keep, whatever the robot."""
    wide = Tabletop(obstacles=1, tabletop="yaw")
    assert wide.actions().names == edge_way_actions(13, FOOTPRINT).names
    x0, x1, y0, y1 = wide.actions().actions[3].footprint  # type: ignore[union-attr]
    kept = wide.models(wide)._clear_motion("cpu").footprint
    assert (x0, x1, y0, y1) == pytest.approx(kept.tolist())
    assert Tabletop().actions().names == edge_actions().names
