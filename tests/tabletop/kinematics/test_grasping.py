import math
from types import SimpleNamespace

import pytest
import torch

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import grasping, has_posture
from cgtorch.tabletop.kinematics.grasping import (
    APPROACHES,
    lines_to_try,
    nth_of_each,
    places_of,
    postures_in_turn,
    waypoints,
)

HEIGHT = 0.74


def scene(gap, sideways, yaw, inset, along):
    """Objects near the edge of a table 0.8 m deep and 1.2 m wide, seen from a base before it.

    Args:
        gap: (B,) from the base's centre to the near edge, m.
        sideways: (B,) where the base stands along the edge, m.
        yaw: (B,) heading of the base, rad.
        inset: (B,) how far in from the edge the object is, m.
        along: (B,) where the object is along the edge, m.
    """

    def seen(x, y):
        x, y = x + gap, y - sideways
        return yaw.cos() * x + yaw.sin() * y, yaw.cos() * y - yaw.sin() * x

    one = torch.ones_like(gap)
    table = torch.stack(
        [*seen(0.4 * one, 0 * one), -yaw, 0.8 * one, 1.2 * one, HEIGHT * one], dim=1
    )
    return torch.stack([*seen(inset, along), HEIGHT * one], dim=1), table


def random_scene(count, seed, dtype=torch.float32):
    generator = torch.Generator().manual_seed(seed)

    def between(low, high):
        return (
            low + (high - low) * torch.rand(count, generator=generator, dtype=torch.float64)
        ).to(dtype)

    return scene(
        between(0.36, 0.9), between(-0.6, 0.6), between(-0.7, 0.7), between(0.05, 0.25),
        between(-0.55, 0.55),
    )  # fmt: skip


def one_scene(gap, inset, sideways=0.0, along=0.0, yaw=0.0):
    return scene(*(torch.tensor([v]) for v in (gap, sideways, yaw, inset, along)))


@pytest.mark.parametrize(("x", "y"), [(0.5, 0.0), (0.55, 0.2), (0.55, -0.2)])
def test_object_at_the_edge_before_the_robot_is_in_reach(pr2, x, y):
    position, table = one_scene(gap=x - 0.1, inset=0.1, along=y)
    torch.testing.assert_close(position, torch.tensor([[x, y, HEIGHT]]))
    assert has_posture(pr2, position, table).tolist() == [True]


@pytest.mark.parametrize(("gap", "inset"), [(1.1, 0.1), (0.4, 0.8), (0.9, 0.25)])
def test_object_too_far_away_is_not(pr2, gap, inset):
    assert has_posture(pr2, *one_scene(gap, inset)).tolist() == [False]


def test_object_behind_the_robot_is_not(pr2):
    assert has_posture(pr2, *one_scene(0.4, 0.1, yaw=math.pi)).tolist() == [False]


def test_standing_in_the_table_is_not_allowed(pr2):
    assert has_posture(pr2, *one_scene(0.345, 0.15)).tolist() == [True]
    assert has_posture(pr2, *one_scene(0.325, 0.17)).tolist() == [False]
    assert has_posture(pr2, *one_scene(0.36, 0.15, yaw=math.pi / 4)).tolist() == [False]


def test_the_table_stands_in_the_way(pr2):
    """The same object is out of reach once it lies under a higher table's top."""
    position, table = one_scene(0.4, 0.1)
    table[:, 5] = HEIGHT + 0.12
    assert has_posture(pr2, position, table).tolist() == [False]


def test_too_high_and_too_low_tables(pr2):
    for height in (0.0, 1.6):
        position, table = one_scene(0.4, 0.1)
        position[:, 2] = table[:, 5] = height
        assert has_posture(pr2, position, table).tolist() == [False]


def test_left_and_right_are_mirrored(pr2):
    position, table = random_scene(1500, seed=1)
    mirrored = table.clone()
    mirrored[:, 1:3] *= -1
    label = has_posture(pr2, position, table)
    other = has_posture(pr2, position * torch.tensor([1.0, -1.0, 1.0]), mirrored)
    assert 0.2 < label.float().mean() < 0.8
    assert (label == other).float().mean() >= 0.99


def test_a_row_does_not_depend_on_the_others(pr2):
    position, table = random_scene(2100, seed=2)
    label = has_posture(pr2, position, table)
    order = torch.randperm(2100, generator=torch.Generator().manual_seed(0))
    shuffled = torch.empty_like(label)
    shuffled[order] = has_posture(pr2, position[order], table[order])
    assert (label == shuffled).float().mean() >= 0.999
    assert torch.equal(label, has_posture(pr2, position, table))


def test_float64_agrees_with_float32(pr2):
    position, table = random_scene(400, seed=3, dtype=torch.float64)
    double = has_posture(pr2, position, table)
    single = has_posture(pr2, position.float(), table.float())
    assert (double == single).float().mean() >= 0.995


def test_the_default_dtype_is_left_alone_and_ignored(pr2):
    position, table = random_scene(50, seed=3)
    before = has_posture(pr2, position, table)
    torch.set_default_dtype(torch.float64)
    try:
        assert torch.equal(has_posture(pr2, position, table), before)
    finally:
        torch.set_default_dtype(torch.float32)


def test_there_is_one_approach_from_above_and_two_rings_of_twelve():
    steep = [round(math.degrees(steepness)) for steepness, _ in APPROACHES]
    assert [steep.count(angle) for angle in (90, 45, 0)] == [1, 12, 12]
    for ring in (45, 0):
        sides = sorted(
            round(math.degrees(side)) % 360
            for (_, side), angle in zip(APPROACHES, steep, strict=True)
            if angle == ring
        )
        assert sides == list(range(0, 360, 30))


def test_waypoints_go_straight_in_and_straight_up():
    way = waypoints(torch.tensor([[0.5, 0.2, HEIGHT]]), math.pi / 4, 0.3)[0]
    torch.testing.assert_close(way[2, :3, 3], torch.tensor([0.5, 0.2, HEIGHT + 0.05]))
    torch.testing.assert_close(way[0, :3, 3] + 0.10 * way[0, :3, 0], way[2, :3, 3])
    torch.testing.assert_close(way[4, :3, 3] - way[2, :3, 3], torch.tensor([0.0, 0.0, 0.10]))
    torch.testing.assert_close(way[:, :3, :3].det(), torch.ones(5))
    torch.testing.assert_close(way[:, 2, 1], torch.zeros(5))


def test_no_rows(pr2):
    assert has_posture(pr2, torch.zeros(0, 3), torch.zeros(0, 6)).shape == (0,)


@pytest.mark.parametrize(
    ("position", "table", "message"),
    [
        (torch.zeros(2, 2), torch.ones(2, 6), r"position has the shape \(2, 2\)"),
        (torch.zeros(2, 3), torch.ones(3, 6), r"table has the shape \(3, 6\)"),
        (torch.full((1, 3), math.nan), torch.ones(1, 6), "position has a value that is not finite"),
        (torch.zeros(1, 3), torch.full((1, 6), math.inf), "table has a value that is not finite"),
        (torch.zeros(1, 3, device="meta"), torch.ones(1, 6), "position is on meta: move it to"),
        (
            torch.zeros(1, 3),
            torch.ones(1, 6, device="meta"),
            "table is on meta: move it to",
        ),
    ],
)
def test_bad_input(pr2, position, table, message):
    with pytest.raises(RobotError, match=message):
        has_posture(pr2, position, table)


def test_leaving_out_what_is_too_far_away_changes_nothing(pr2, monkeypatch):
    position, table = random_scene(4000, 7)
    stretch = torch.linspace(1, 1.8, 4000)[:, None]
    position[:, :2] *= stretch
    table[:, :2] *= stretch
    near = grasping.within_reach(pr2, position)
    assert 500 < int(near.sum()) < 3500
    found = has_posture(pr2, position, table)
    monkeypatch.setattr(
        grasping, "within_reach", lambda robot, at: torch.ones_like(near[: len(at)])
    )
    assert torch.equal(has_posture(pr2, position, table), found)
    assert (found & ~near).sum() == 0
    assert found.any()


def test_how_many_earlier_entries_are_alike():
    assert nth_of_each(torch.tensor([0, 0, 2, 5, 5, 5])).tolist() == [0, 1, 0, 0, 1, 2]
    assert nth_of_each(torch.zeros(0, dtype=torch.long)).tolist() == []


def test_of_many_postures_a_part_is_tried_first_and_the_rest_where_none_was_good():
    """Of the second grasp there are seventeen and of the last as many, which is one too many."""
    row = torch.tensor([0] * 16 + [1] * 17 + [3] * 17)
    q, asked = torch.arange(50)[:, None], list[torch.Tensor]()

    def candidates(pose):
        asked.append(pose)
        return row, q

    path, solved = torch.rand(4, 5, 4, 4), torch.zeros(4, dtype=torch.bool)
    turns = postures_in_turn(SimpleNamespace(candidates=candidates), path, solved)
    rows, first = next(turns)
    assert torch.equal(asked[0], path[:, 2])
    assert first[:, 0].tolist() == [*range(16), 16, 24, 32, 33, 41, 49]
    assert rows.tolist() == [0] * 16 + [1] * 3 + [3] * 3
    solved[1] = True
    rows, rest = next(turns)
    assert rest[:, 0].tolist() == [k for k in range(33, 50) if k not in (33, 41, 49)]
    assert rows.tolist() == [3] * 14
    assert next(turns, None) is None
    solved[:] = True
    assert not [*postures_in_turn(SimpleNamespace(candidates=candidates), path, solved)]


def test_places_are_a_slab_and_an_object_that_stands_on_it():
    position = torch.tensor([[0.5, 0.2, 0.7]])
    places = places_of(position, torch.tensor([[0.8, 0.1, math.pi / 2, 0.6, 1.2, 0.7]]))
    turn = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]).double()
    torch.testing.assert_close(places.table[0, :, :3], turn, atol=1e-6, rtol=0)
    assert places.table[0, :, 3].tolist() == pytest.approx([0.8, 0.1, 0.68])
    assert places.table_size[0].tolist() == pytest.approx([0.3, 0.6, 0.02, 0, 0])
    assert torch.equal(places.object[0, :, :3], torch.eye(3).double())
    assert places.object[0, :, 3].tolist() == pytest.approx([0.5, 0.2, 0.75])


def test_an_arm_is_long_enough_for_what_is_no_farther_than_its_reach():
    def arm(reach, *at):
        mount = torch.eye(4, dtype=torch.float64)
        mount[:3, 3] = torch.tensor(at)
        return SimpleNamespace(reach=reach, mount=mount)

    robot = SimpleNamespace(arms=(arm(1.0, 0.0, 0.0, 0.05), arm(0.5, 0.0, 2.0, 0.05)))
    at = torch.tensor([[0.9, 0, 0], [1.1, 0, 0], [0, 1.6, 0], [0, 1.3, 0], [0, 0, 1.01]])
    assert grasping.within_reach(robot, at).tolist() == [True, False, True, False, False]


def test_a_robot_stands_in_a_table_that_its_footprint_overlaps():
    robot = SimpleNamespace(description=SimpleNamespace(footprint=(-0.2, 0.4, -0.1, 0.3)))
    tables = [[x, y, 0.0, 0.2, 0.2, 0.7] for x, y in ((0.45, 0.0), (0.55, 0.0), (0.0, 0.35))]
    tables += [[0.0, -0.25, 0.0, 0.2, 0.2, 0.7], [-0.35, 0, 0, 0.2, 0.2, 0.7]]
    found = grasping.standing_in_table(robot, torch.tensor(tables))
    assert found.tolist() == [True, False, True, False, False]


def test_lines_are_tried_until_each_object_is_solved(pr2):
    """First approaches first; an object that a line has solved is not tried again."""
    position, table = random_scene(3, seed=4)
    position[:, :2], table[:, :3] = torch.tensor([0.55, 0.1]), torch.tensor([0.85, 0.0, 0.0])
    position[1, 0] = 3.0  # out of reach
    table[2, 0] = 0.3  # the robot would stand in it
    arms, none = len(pr2.arms), len(pr2.arms) * len(APPROACHES)
    rank = torch.full((3,), none)
    met = [(which, lines) for which, lines in lines_to_try(pr2, position, table, rank)]
    assert {int(row) for _, lines in met for row in lines.row} == {0}
    ranks = sorted(int(each) for _, lines in met for each in lines.rank)
    assert ranks == [*range(none)]
    for which, lines in met:
        assert (lines.rank % arms == which).all()
        for path, each in zip(lines.path, lines.rank.tolist(), strict=True):
            wanted = waypoints(position[:1], *APPROACHES[each // arms])[0]
            torch.testing.assert_close(path, wanted)
    rank[0] = 3
    met = [(which, lines) for which, lines in lines_to_try(pr2, position, table, rank)]
    assert sorted(int(each) for _, lines in met for each in lines.rank) == [0, 1, 2]
