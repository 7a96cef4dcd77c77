"""The scene from the nearest edge: the same however the table stands, and a way back to motions."""

import math

import torch
from hypothesis import given
from hypothesis import strategies as st
from support import seeded
from torch import Tensor

from cgtorch.tabletop.edge_networks import NOWHERE, edge_frame, motion_to, scene, scene_size
from cgtorch.tabletop.world import Scenarios, cluttered_scenarios
from cgtorch.tabletop.world.geometry import moved, rotate
from cgtorch.tabletop.world.percepts import obstacles_seen, percept_of, side_seen

seeds = st.integers(0, 2**31)


def scenes(seed: int, count: int = 20) -> Scenarios:
    """Random ones in float64."""
    drawn = cluttered_scenarios(count, seeded(seed))
    parts = (drawn.pose, drawn.table, drawn.object)
    return Scenarios(*(p.double() for p in parts), drawn.seed, drawn.obstacles.double())


def seen(s: Scenarios) -> Tensor:
    """Percepts (B, 13) without noise."""
    parts = percept_of(s.pose, s.table, s.object), side_seen(s.pose, s.table)
    return torch.cat([*parts, obstacles_seen(s.pose, s.obstacles)], 1)


def about_table(s: Scenarios) -> Tensor:
    """All of a scene (B, 9) but obstacles, plainly: the object's nearest edge by comparison."""
    rows = []
    for pose, table, placed in zip(s.pose.tolist(), s.table.tolist(), s.object, strict=True):
        yaw, sx, sy, height = table[2:]
        u, v = rotate(placed, torch.tensor(-yaw, dtype=torch.float64)).tolist()
        # gap to the edge, direction of the inner normal, gaps ahead, to the left and to the right
        sides = [
            (sx / 2 + u, 0.0, sx / 2 - u, sy / 2 - v, sy / 2 + v),
            (sx / 2 - u, math.pi, sx / 2 + u, sy / 2 + v, sy / 2 - v),
            (sy / 2 + v, math.pi / 2, sy / 2 - v, sx / 2 + u, sx / 2 - u),
            (sy / 2 - v, -math.pi / 2, sy / 2 + v, sx / 2 - u, sx / 2 + u),
        ]
        front, inwards, back, left, right = min(sides)
        dx, dy = pose[0] - float(placed[0]), pose[1] - float(placed[1])
        axis = yaw + inwards
        x = math.cos(axis) * dx + math.sin(axis) * dy
        y = -math.sin(axis) * dx + math.cos(axis) * dy
        heading = pose[2] - axis
        if y < 0:
            y, heading, left, right = -y, -heading, right, left
        rows.append([x, y, math.cos(heading), math.sin(heading), front, back, left, right, height])
    return torch.tensor(rows, dtype=torch.float64)


@given(seeds)
def test_a_scene_is_what_a_plain_look_says(seed: int) -> None:
    s = scenes(seed)
    found = scene(seen(s))
    assert found.shape == (20, scene_size(13))
    torch.testing.assert_close(found[:, :9], about_table(s), atol=1e-6, rtol=0)
    nobody = s.obstacles[:, 0, 3] == 0
    assert (found[nobody, 9:] == found.new_tensor([-NOWHERE, 0, 0])).all()
    distance = (s.obstacles[:, 0, :2] - s.object).norm(dim=1)
    torch.testing.assert_close(found[~nobody, 9:11].norm(dim=1), distance[~nobody])


@given(seeds, st.integers(1, 3))
def test_a_table_described_from_another_side_is_the_same(seed: int, quarters: int) -> None:
    s = scenes(seed)
    table = s.table.clone()
    table[:, 2] += quarters * math.pi / 2
    if quarters % 2:
        table[:, [3, 4]] = table[:, [4, 3]]
    other = Scenarios(s.pose, table, s.object, s.seed, s.obstacles)
    torch.testing.assert_close(scene(seen(other)), scene(seen(s)), atol=1e-6, rtol=0)


@given(seeds)
def test_what_is_mirrored_looks_the_same(seed: int) -> None:
    s = scenes(seed)
    flip = s.pose.new_tensor([1, -1, -1])
    table, obstacles = s.table.clone(), s.obstacles.clone()
    table[:, 1:3] *= -1
    obstacles[..., 1:3] *= -1
    other = Scenarios(s.pose * flip, table, s.object * flip[:2], s.seed, obstacles)
    torch.testing.assert_close(scene(seen(other)), scene(seen(s)), atol=1e-6, rtol=0)


@given(seeds, st.tuples(st.floats(-2, 2), st.floats(0.01, 2), st.floats(-3, 3)))
def test_a_motion_leads_to_the_pose_that_was_meant(seed: int, wanted: tuple[float, ...]) -> None:
    s = scenes(seed)
    pose = torch.tensor(wanted, dtype=torch.float64).expand(len(s), 3)
    motion = motion_to(edge_frame(seen(s)), pose)
    assert (motion[:, 2].abs() <= math.pi).all()
    there = Scenarios(moved(s.pose, motion), s.table, s.object, s.seed, s.obstacles)
    found = scene(seen(there))[:, :4]
    heading = math.cos(wanted[2]), math.sin(wanted[2])
    torch.testing.assert_close(
        found, found.new_tensor([*wanted[:2], *heading]).expand_as(found), atol=1e-6, rtol=0
    )


def test_the_papers_percept_has_a_table_that_is_not_turned() -> None:
    s = scenes(0)
    s.table[:, 2] = s.pose[:, 2]
    seven = percept_of(s.pose, s.table, s.object)
    torch.testing.assert_close(scene(seven), scene(seen(s))[:, :9], atol=1e-6, rtol=0)
