"""Ways around what is seen."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support import FOOTPRINT, graspable, seeded
from torch import Tensor

from cgtorch.ground.environment import start_lanes
from cgtorch.tabletop.world import ClearMotion, Noise, Scenarios, TabletopWorld, cluttered_scenarios
from cgtorch.tabletop.world.geometry import to_frame, wrap
from cgtorch.tabletop.world.routes import LONGEST, _shortest, first_motion

BASE = torch.tensor(FOOTPRINT)


def world(scenarios: Scenarios) -> TabletopWorld:
    """Without noise, so that what is seen is what is there."""
    return TabletopWorld(scenarios, graspable, FOOTPRINT, Noise(0, 0), percept="yaw")


def motion_to(pose: Tensor, goal: Tensor) -> Tensor:
    turn = wrap(goal[:, 2:] - pose[:, 2:])
    return torch.cat([to_frame(pose, goal[:, :2]), turn], 1)


@given(st.integers(0, 2**31 - 1))
@settings(max_examples=20, deadline=None)
def test_it_is_clear_of_what_is_seen_or_what_was_asked_for(seed: int) -> None:
    percept = world(cluttered_scenarios(30, seeded(seed))).start(torch.arange(30))[1]
    asked = 2 * torch.randn(30, 3, generator=seeded(seed))
    found = first_motion(percept, asked, BASE)
    same, short = (found == asked).all(1), asked[:, :2].norm(dim=1) <= LONGEST
    clear = ClearMotion(BASE)
    assert torch.equal(same | clear(percept, found), torch.ones_like(same))
    assert same[clear(percept, asked) & short].all()
    assert (found[~same, :2].norm(dim=1) <= LONGEST + 1e-6).all()


@pytest.mark.parametrize("obstacle", [[0.0] * 5, [0.1, 1.2, 0.0, 0.4, 0.4]])
def test_it_leads_around_the_table_and_past_a_box(obstacle: list[float]) -> None:
    """The box stands on the left, where the robot comes from."""
    scene = Scenarios(
        torch.tensor([[-1.2, 0.4, 0.0]]),
        torch.tensor([[0.0, 0, 0, 0.8, 1.2, 0.74]]),
        torch.tensor([[0.3, 0.0]]),
        torch.tensor([0]),
        torch.tensor([[obstacle]]),
    )
    place, goal = world(scene), torch.tensor([[0.9, 0.1, torch.pi]])
    lanes, drove = start_lanes(place, torch.arange(1), 3, 0), []
    for _ in range(6):
        motion = first_motion(lanes.percept, motion_to(lanes.state[:, :3], goal), BASE)
        lanes, moved = place.step(lanes, motion)
        drove.append(bool(moved))
    assert all(drove)
    assert motion_to(lanes.state[:, :3], goal)[:, :2].norm() < 1e-3
    start = start_lanes(place, torch.arange(1), 3, 0)
    assert not place.step(start, motion_to(scene.pose, goal))[1].any()


def test_a_route_leads_past_two_corners_where_there_is_no_room_to_turn() -> None:
    """Along three sides of a wall, with a box beside the second corner."""
    corner = torch.tensor([[[0.0, 2.0], [3.0, 2.0], [0.01, 0.0]]])
    wall, box = [1.5, 0.5, 0.0, 1.0, 2.0], [3.5, 2.0, 0.0, 0.2, 0.2]
    seen, goal = torch.tensor([[wall, box]]), torch.tensor([[3.0, 0.0, 0.5]])

    def found(*there: bool) -> tuple[float, int]:
        still, known = torch.zeros(1), torch.tensor([there])
        length, first = _shortest(seen, corner, known, goal, still, BASE)
        return float(length), int(first)

    assert found(True, True, True) == (pytest.approx(7.0), 0)
    assert found(True, False, True)[0] == found(False, True, True)[0] == torch.inf
    turned = goal.clone()
    turned[0, 2] = torch.pi
    whole = _shortest(seen, corner, torch.ones(1, 3, dtype=torch.bool), turned, goal[:, 2], BASE)
    assert float(whole[0]) == torch.inf  # who turns at first cannot pass the box


def test_who_is_shut_in_stays() -> None:
    walls = [[-1.4, y, 0, 2.4, 0.1] for y in (-0.7, 0.7)]
    walls += [[x, 0, 0, 0.1, 1.3] for x in (-2.1, -0.7)]
    scene = Scenarios(
        torch.tensor([[-1.4, 0, 0]]),
        torch.tensor([[0.0, 0, 0, 0.8, 1.2, 0.74]]),
        torch.tensor([[0.3, 0.0]]),
        torch.tensor([0]),
        torch.tensor([walls]),
    )
    asked = torch.tensor([[2.3, 0.0, 1.0], [torch.nan, 0, 0]])
    percept = world(scene).start(torch.zeros(2, dtype=torch.long))[1]
    found = first_motion(percept, asked, BASE)
    assert torch.equal(found[0], asked[0])
    assert found[1].isnan().any()
