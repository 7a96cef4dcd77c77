"""Networks in the frame of an edge in plain Python, against those of torch."""

import math

import pytest
import torch
from support import graspable, seeded
from torch import Tensor

from cgtorch.tabletop import plain_edge_networks as plain
from cgtorch.tabletop.edge_networks import (
    EdgeBranchingNN,
    EdgeNN,
    edge_frame,
    into,
    motion_to,
    obstacles,
    table_scene,
)
from cgtorch.tabletop.world import TabletopWorld, draw_of, routes
from cgtorch.tabletop.world.clear_motion import motion_possible
from cgtorch.tabletop.world.geometry import corners
from cgtorch.tabletop.world.percepts import parts_of
from cgtorch.tabletop.world.routes import first_motion

FOOTPRINT = (-0.3, 0.35, -0.25, 0.28)
COUNT = 40


def percepts(kind: str, percept: str) -> Tensor:
    """(n, D) what is seen of random scenes, in float64."""
    scenarios = draw_of(kind)(COUNT, seeded(4))
    world = TabletopWorld(scenarios, graspable, FOOTPRINT, percept=percept)
    return world.start(torch.arange(COUNT))[1].double()


@pytest.mark.parametrize("kind", ["general", "general-clutter"])
@pytest.mark.parametrize("percept", ["box", "yaw"])
def test_the_frame_of_an_edge_and_what_is_seen_in_it(kind: str, percept: str) -> None:
    seen = percepts(kind, percept)
    frames = edge_frame(seen)
    assert {*frames.mirror.tolist()} == {-1.0, 1.0}
    things, points = parts_of(seen), torch.randn(COUNT, 2, generator=seeded(1)).double()
    placed, scenes = into(frames, points), table_scene(frames, seen)
    there = obstacles(frames, seen) if things.obstacles.shape[1] else torch.zeros(COUNT, 0)
    for i, one in enumerate(seen.tolist()):
        frame = plain.edge_frame(one)
        assert frame.mirror == frames.mirror[i]
        for ours, theirs in (
            (frame.origin, frames.origin[i]),
            (frame.extent, frames.extent[i]),
            (plain.table(one), things.table[i]),
            (plain.into(frame, tuple(points[i].tolist())), placed[i]),
            (plain.table_scene(frame, one), scenes[i]),
            (plain.obstacles(frame, one), there[i]),
        ):
            assert list(ours) == pytest.approx(theirs.tolist(), abs=1e-6)
        turn = frame.yaw - float(frames.yaw[i])
        assert math.remainder(turn, 2 * math.pi) == pytest.approx(0, abs=1e-6)


def test_a_network_sends_the_motion_to_its_pose() -> None:
    seen = percepts("general", "yaw")
    pose = torch.randn(COUNT, 3, generator=seeded(2)).double()
    wanted = motion_to(edge_frame(seen), pose)
    for one, to, motion in zip(seen.tolist(), pose.tolist(), wanted.tolist(), strict=True):
        network = plain.EdgeNN([0.0] * 30 + [0.0] * 9 + to, 9, 3, 3)
        found = network.motion(one)
        assert found[:2] == pytest.approx(motion[:2], abs=1e-6)
        assert math.remainder(found[2] - motion[2], 2 * math.pi) == pytest.approx(0, abs=1e-6)
        assert -math.pi <= found[2] < math.pi


def test_a_motion_is_possible_where_the_library_says_so() -> None:
    """Also beside things that stand at any angle, and with turns."""
    drawn = torch.rand(400, 2, 5, generator=seeded(3)).double()
    things = torch.cat([4 * drawn[..., :2] - 2, 3 * drawn[..., 2:3], 0.2 + drawn[..., 3:]], 2)
    motion = torch.randn(400, 3, generator=seeded(5)).double()
    motion[::4, 2] = 0
    footprint = torch.tensor(FOOTPRINT).double()
    wanted = motion_possible(motion, things, footprint, torch.inf).tolist()
    found = [
        plain.possible(motion[i].tolist(), [tuple(t) for t in things[i].tolist()], FOOTPRINT)
        for i in range(400)
    ]
    assert found == wanted
    assert 40 < sum(found) < 360
    for bad in (math.nan, math.inf):
        assert not plain.possible([bad, 0.0, 0.0], [], FOOTPRINT)


def test_ways_around_things_are_those_of_the_library() -> None:
    seen = percepts("general-clutter", "yaw")
    motion = 1.5 * torch.randn(COUNT, 3, generator=seeded(6)).double()
    motion[:2, :2] = torch.tensor([[-4.0, 0.1], [0.1, 5.0]])
    wanted = first_motion(seen, motion, torch.tensor(FOOTPRINT).double())
    assert not torch.equal(wanted, motion)
    for i, one in enumerate(seen.tolist()):
        found = plain.first_motion(plain.things(one), motion[i].tolist(), FOOTPRINT)
        assert found == pytest.approx(wanted[i].tolist(), abs=1e-6)


SMALL = (-0.05, 0.05, -0.05, 0.05)
BLOCK = (0.5, 0.5, 0.0, 0.2, 0.2)


@pytest.mark.parametrize("motion", [[0.1, 0.0, 0.0], [0.1, 0.0, 0.5], [0.02, 0.01, -2.0]])
def test_no_corner_is_passed_on_a_motion_that_is_possible(motion: list[float]) -> None:
    """However near a corner is, past which there would be a short way as well."""
    assert plain.shortest([BLOCK], motion, 0.0, SMALL)[0] < 1
    assert plain.first_motion([BLOCK], motion, SMALL) == motion


@pytest.mark.parametrize("size", [7, 9])
def test_all_obstacles_that_are_present_are_seen_also_beside_an_axis(size: int) -> None:
    boxes = [[0.0, 1.0, 0.0, 2.0], [0.0] * 4, [-1.0, 0.0, 0.5, 0.75]]
    seen = percepts("general", "box" if size == 7 else "yaw")[0].tolist()
    found = plain.things([*seen, *(x for box in boxes for x in box)])
    assert found[1:] == [(0.5, 1.0, 0.0, 1.0, 2.0), (-0.5, 0.625, 0.0, 1.0, 0.25)]
    percept = [*seen, *(x for box in boxes for x in box)]
    whole = torch.tensor([percept]).double()
    wanted = obstacles(edge_frame(whole), whole)[0].tolist()
    assert plain.obstacles(plain.edge_frame(percept), percept) == pytest.approx(wanted, abs=1e-6)


def test_who_is_shut_in_has_no_way_and_no_corner() -> None:
    walls = [(x, y, 0.0, 0.1 + 2 * abs(y), 0.1 + 2 * abs(x)) for x, y in ((1, 0), (-1, 0))]
    walls += [(0.0, y, 0.0, 2.0, 0.1) for y in (-1, 1)]
    assert plain.shortest(walls, [3.0, 0.0, 0.0], 0.0, SMALL) == (math.inf, (0.0, 0.0))
    assert plain.first_motion(walls, [3.0, 0.0, 0.0], SMALL) == [3.0, 0.0, 0.0]


BAFFLES = [(1.3, 2.8, 0.0, 0.1, 6.4), (3.3, -3.3, 0.0, 0.1, 7.4)]


@pytest.mark.parametrize("turn", [0.0, 0.3])
@pytest.mark.parametrize(
    ("goal", "corner", "least", "most"),
    [
        ((2.6, 0.3), (0.75, -0.9), 3, 4),  # past the two near corners of one baffle
        ((3.5, 1.5), (0.75, -0.9), 5, 6),  # and past one of the other
        ((4.6, 0.0), (0.75, 6.5), 14, 15),  # between both would be four
    ],
)
def test_a_way_leads_past_three_corners_at_most(
    goal: tuple[float, float], corner: tuple[float, float], least: float, most: float, turn: float
) -> None:
    length, via = plain.shortest(BAFFLES, [*goal, turn], turn, FOOTPRINT)
    footprint, things = (torch.tensor(each).double() for each in (FOOTPRINT, [BAFFLES]))
    every = corners(routes._wider(things, footprint)).flatten(1, 2)
    about = torch.tensor([[*goal, turn]]).double(), torch.tensor([turn]).double(), footprint
    wanted, first = routes._shortest(things, every, torch.ones(1, 8, dtype=torch.bool), *about)
    assert length == pytest.approx(float(wanted), abs=1e-6)
    assert list(via) == pytest.approx(every[0, int(first)].tolist(), abs=1e-6)
    if not turn:
        assert least < length < most
        assert list(via) == pytest.approx(corner, abs=0.01)


@pytest.mark.parametrize("size", [7, 9, 13])
def test_networks_see_what_those_of_the_library_see(size: int) -> None:
    percept = torch.randn(6, size, generator=seeded(7)).double()
    percept[:, :4] = torch.tensor([-0.5, 0.5, -0.3, 0.7])
    for ours, theirs in (
        (plain.EdgeNN([0.0] * 50, 9, 3, 3), EdgeNN(size)),
        (plain.EdgeBranchingNN([0.0] * 50, 9, 3, 1), EdgeBranchingNN(size)),
    ):
        wanted = theirs.sees(percept).tolist()
        for one, values in zip(percept.tolist(), wanted, strict=True):
            assert ours.sees(one) == pytest.approx(values, abs=1e-6)
