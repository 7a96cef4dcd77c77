"""Scenarios beyond the paper's table, measured with shapely, which knows nothing of ours."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from planar import polygon
from shapely import Point, box
from support import seeded

from cgtorch.ground.errors import SettingsError
from cgtorch.tabletop.world import (
    DRAWS,
    PLACEMENTS,
    cluttered_scenarios,
    draw_of,
    general_scenarios,
    scenarios,
)
from cgtorch.tabletop.world.scenarios import (
    OBSTACLE_AWAY,
    OBSTACLE_SIDE,
    Draw,
    Scenarios,
    _in_the_way,
    _obstacles,
    beside,
)

COUNT = 2000


def is_uniform(values: torch.Tensor, low: float, high: float) -> bool:
    """Within the bounds, and of the mean and variance that a uniform draw of `COUNT` has."""
    part = (values - low) / (high - low)
    inside = bool((part > -1e-5).all() and (part < 1 + 1e-5).all())
    return inside and abs(part.mean() - 0.5) < 0.03 and abs(part.var() * 12 - 1) < 0.08


@given(
    st.floats(-math.pi, math.pi),
    st.floats(0.3, 0.7),
    st.floats(0.3, 0.7),
    st.floats(0, 3),
)
def test_points_beside_a_rectangle_are_as_far_away_as_asked(
    direction: float, hx: float, hy: float, distance: float
) -> None:
    one = [torch.tensor([x], dtype=torch.float64) for x in (direction, distance)]
    half = torch.tensor([[hx, hy]], dtype=torch.float64)
    ((x, y),) = beside(one[0], half, one[1]).tolist()
    assert box(-hx, -hy, hx, hy).exterior.distance(Point(x, y)) == pytest.approx(distance, abs=1e-6)
    assert not box(-hx, -hy, hx, hy).buffer(-1e-6).contains(Point(x, y))
    assert math.remainder(math.atan2(y, x) - direction, math.tau) == pytest.approx(0, abs=1e-6)


def test_tables_are_of_any_size_height_and_yaw() -> None:
    s = general_scenarios(COUNT, seeded(0))
    assert len(s) == COUNT
    assert not s.table[:, :2].any()
    assert is_uniform(s.table[:, 2], -math.pi, math.pi)
    assert is_uniform(s.table[:, 3], 0.6, 1.4)
    assert is_uniform(s.table[:, 4], 0.6, 1.4)
    assert is_uniform(s.table[:, 5], 0.6, 0.9)
    assert torch.corrcoef(s.table[:, 2:].T).fill_diagonal_(0).abs().max() < 0.1
    assert len(s.seed.unique()) == COUNT


def test_robots_start_on_any_side_and_see_the_table() -> None:
    s = general_scenarios(COUNT, seeded(1))
    away = [
        polygon(table).distance(Point(x, y))
        for table, (x, y, _) in zip(s.table.tolist(), s.pose.tolist(), strict=True)
    ]
    assert is_uniform(torch.tensor(away), 1.0, 2.5)
    assert is_uniform(torch.atan2(s.pose[:, 1], s.pose[:, 0]), -math.pi, math.pi)
    bearing = torch.atan2(-s.pose[:, 1], -s.pose[:, 0]) - s.pose[:, 2]
    assert is_uniform(torch.remainder(bearing + math.pi, math.tau) - math.pi, -0.7854, 0.7854)


def test_objects_stand_within_a_quarter_metre_of_an_edge() -> None:
    s = general_scenarios(COUNT, seeded(2))
    tables, objects = map(polygon, s.table.tolist()), map(Point, s.object.tolist())
    inset = [
        table.exterior.distance(at) * (1 if table.contains(at) else -1)
        for table, at in zip(tables, objects, strict=True)
    ]
    assert 0.05 - 1e-5 < min(inset) < 0.052
    assert 0.24 < max(inset) < 0.25 + 1e-5
    yaw = s.table[:, 2]
    x = yaw.cos() * s.object[:, 0] + yaw.sin() * s.object[:, 1]
    y = yaw.cos() * s.object[:, 1] - yaw.sin() * s.object[:, 0]
    share = torch.stack([x, y], 1) / (s.table[:, 3:5] / 2)
    assert share.mean(0).abs().max() < 0.05  # no edge is preferred
    quarters = torch.histc(torch.atan2(share[:, 1], share[:, 0]), 4) / COUNT
    assert (quarters - 0.25).abs().max() < 0.04


def test_half_of_the_cluttered_scenes_have_a_box_that_is_in_nobodys_place() -> None:
    s = cluttered_scenarios(COUNT, seeded(3))
    assert s.obstacles.shape == (COUNT, 1, 5)
    there = s.obstacles[:, 0, 3] > 0
    assert there.float().mean().item() == pytest.approx(0.5, abs=0.04)
    assert not s.obstacles[~there].any()
    sides = s.obstacles[there, 0, 3:]
    assert sides.min() >= 0.3
    assert sides.max() <= 0.6
    gaps = []
    for i in there.nonzero()[:, 0].tolist():
        table, obstacle = polygon(s.table[i].tolist()), polygon(s.obstacles[i, 0].tolist())
        assert table.intersection(obstacle).area < 1e-6
        assert obstacle.distance(Point(s.pose[i, :2].tolist())) > 0.55 - 1e-5
        gaps.append(table.distance(obstacle))
    assert min(gaps) < 0.05  # some leave no way between
    assert sum(gap > 0.7 for gap in gaps) > 100  # and some do


def test_boxes_of_any_size_and_yaw_are_drawn_around_a_table_at_any_distance() -> None:
    """Each independently of the others."""
    s = general_scenarios(COUNT, seeded(5))
    s.table[:, 2] = 0.0
    drawn = _obstacles(s, seeded(6))
    tables, centres = map(polygon, s.table.tolist()), map(Point, drawn[:, :2].tolist())
    away = torch.tensor([t.distance(at) for t, at in zip(tables, centres, strict=True)])
    columns = [
        (torch.atan2(drawn[:, 1], drawn[:, 0]), -math.pi, math.pi), (away, *OBSTACLE_AWAY),
        (drawn[:, 2], -math.pi, math.pi), *((side, *OBSTACLE_SIDE) for side in drawn[:, 3:].T),
    ]  # fmt: skip
    assert all(is_uniform(*column) for column in columns)
    every = torch.stack([values for values, *_ in columns])
    assert torch.corrcoef(every).fill_diagonal_(0).abs().max() < 0.1


@pytest.mark.parametrize("draw", [general_scenarios, cluttered_scenarios])
def test_the_generator_decides_and_counts_are_checked(draw: Draw) -> None:
    one, again, other = (draw(20, seeded(s)) for s in (0, 0, 1))
    for name, value in vars(one).items():
        assert torch.equal(value, getattr(again, name))
    assert not torch.equal(one.object, other.object)
    nothing = draw(0, seeded(0))
    assert len(nothing) == 0
    assert nothing.obstacles.shape[1] == one.obstacles.shape[1]
    with pytest.raises(SettingsError, match="count is -1"):
        draw(-1, seeded(0))


def test_a_box_is_in_the_way_on_the_table_or_where_the_robot_has_to_turn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(scenarios, "ROOM", 0.5)
    place = torch.tensor([[-2.0, 0.0, 0.0]]).expand(5, 3)
    table = torch.tensor([[0.0, 0.0, 0.0, 1.0, 1.0, 0.7]]).expand(5, 6)
    scene = Scenarios(place, table, torch.zeros(5, 2), torch.zeros(5, dtype=torch.long))
    at = [(-1.25, 0.0), (-1.3, 0.0), (-0.7, 0.0), (-2.0, 0.7), (-1.6, 0.6)]
    boxes = torch.tensor([[x, y, 0.0, 0.5, 0.5] for x, y in at])
    found = _in_the_way(boxes, scene)
    assert found.tolist() == [False, True, True, True, True]
    turned = boxes.clone()
    turned[:, 2] = math.pi / 4  # of which a corner leads to the robot
    turned[0, 0], turned[4, 1] = -1.2, 0.7
    assert _in_the_way(turned, scene).tolist() == [True, True, True, True, False]


def test_clutter_changes_nothing_else() -> None:
    plain, cluttered = general_scenarios(50, seeded(4)), cluttered_scenarios(50, seeded(4))
    for name in ("pose", "table", "object", "seed"):
        assert torch.equal(getattr(plain, name), getattr(cluttered, name))


def test_a_seed_gives_the_scenarios_that_it_always_gave() -> None:
    """Or what was measured on them could not be measured again."""
    paper, general = (draw_of(name)(2, seeded(0)) for name in ("perimeter", "general"))
    assert paper.pose[1].tolist() == pytest.approx([-1.382251, 0.052923, -0.026373], abs=1e-5)
    assert paper.object[1].tolist() == pytest.approx([-0.006935, 0.460356], abs=1e-5)
    assert paper.seed.tolist() == [1277901399, 243580376]
    assert general.pose[1].tolist() == pytest.approx([-1.720114, 0.410136, -0.576077], abs=1e-5)
    assert general.object[1].tolist() == pytest.approx([0.192785, -0.284236], abs=1e-5)
    wanted = [0.0, 0.0, -2.080621, 0.879115, 0.921374, 0.606698]
    assert general.table[1].tolist() == pytest.approx(wanted, abs=1e-5)
    assert general.seed.tolist() == [1340754471, 2061486254]
    boxes = draw_of("general-clutter")(9, seeded(0)).obstacles[:, 0]
    assert boxes[8].tolist() == pytest.approx(
        [1.542443, -0.245699, 1.995087, 0.437060, 0.480357], abs=1e-5
    )


def test_every_kind_has_a_name() -> None:
    assert set(DRAWS) == {*PLACEMENTS, "general", "general-clutter"}
    assert all(len(draw_of(name)(3, seeded(0))) == 3 for name in DRAWS)
    assert torch.equal(draw_of("general")(9, seeded(5)).pose, general_scenarios(9, seeded(5)).pose)
    with pytest.raises(SettingsError, match=r"'General'; use one of near, .*general-clutter$"):
        draw_of("General")
