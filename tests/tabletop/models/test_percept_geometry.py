"""Percepts by geometry alone, against what is seen after motions of the true world."""

import math

import pytest
import torch
from support import seeded
from torch import Tensor

from cgtorch.ground.errors import DataError
from cgtorch.tabletop.models.geometry import (
    CENTRE,
    EXTENTS,
    OBJECT,
    boxes_moved,
    check_shapes,
    extremes,
    from_parts,
    loosely_turned,
    mirror_yaws,
    move_rigidly,
    next_percept,
    places_on_table,
    scene_of,
    side_turned,
    table_sides,
    to_parts,
    turned_extents,
)
from cgtorch.tabletop.world.geometry import bounding_box, moved, rectangle_in_frame, to_frame
from cgtorch.tabletop.world.percepts import percept_of, side_seen

SIDES = torch.tensor([0.8, 1.2]).double()
COUNT = 50


def drawn(seed: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Poses, tables, objects and motions of random scenes, float64."""
    draw = 2 * torch.rand(COUNT, 12, generator=seeded(seed)).double() - 1
    pose = draw[:, :3] * torch.tensor([2.0, 2.0, math.pi])
    table = torch.cat([draw[:, 3:6], SIDES.expand(COUNT, 2), 0.7 + 0 * draw[:, :1]], 1)
    motion = draw[:, 8:11] * torch.tensor([1.0, 1.0, math.pi])
    return pose, table, table[:, :2] + 0.4 * draw[:, 6:8], motion


POSE, TABLE, AT, MOTION = drawn(0)
SEEN = percept_of(POSE, TABLE, AT)
AFTER = percept_of(moved(POSE, MOTION), TABLE, AT)
WHOLE = torch.cat([SEEN, side_seen(POSE, TABLE)], 1)


def test_parts_are_centre_extents_and_object() -> None:
    percept = torch.tensor([1.0, 3.0, -1.0, 2.0, 0.5, 0.6, 0.7])
    parts = to_parts(percept)
    assert parts.tolist() == pytest.approx([2, 0.5, 2, 3, 0.5, 0.6, 0.7])
    assert torch.equal(from_parts(parts), percept)
    assert (parts[CENTRE].tolist(), parts[EXTENTS].tolist()) == ([2, 0.5], [2, 3])
    assert torch.equal(parts[OBJECT], percept[4:6])


def test_centre_and_object_move_like_points() -> None:
    before, after = to_parts(SEEN), to_parts(AFTER)
    found = move_rigidly(before, MOTION)
    torch.testing.assert_close(found[:, CENTRE], after[:, CENTRE])
    torch.testing.assert_close(found[:, 4:], after[:, 4:])
    assert torch.equal(found[:, EXTENTS], before[:, EXTENTS])


def test_extents_are_those_of_a_turned_rectangle() -> None:
    yaw = TABLE[:, 2]
    boxes = bounding_box(torch.cat([0 * TABLE[:, :2], yaw[:, None], TABLE[:, 3:5]], 1))
    torch.testing.assert_close(turned_extents(yaw, SIDES), 2 * boxes[:, 1::2])
    sides = table_sides(turned_extents(yaw, SIDES))
    torch.testing.assert_close(sides, SIDES, atol=1e-6, rtol=0)
    torch.testing.assert_close(
        table_sides(turned_extents(yaw, SIDES.flip(0))), SIDES, atol=1e-6, rtol=0
    )
    odd = torch.tensor([[4.0, 1.0], [1.0, 1.0]])  # as no table has at any two yaws
    assert table_sides(odd).tolist() == [1.0, 2.5]


def test_a_box_of_unknown_shape_is_turned_loosely() -> None:
    extents = torch.tensor([3.0, 1.0])
    turns = torch.tensor([0.0, math.pi / 4, math.pi / 2, -math.pi / 2, math.pi])
    found = loosely_turned(extents.expand(5, 2), turns)
    wanted = torch.tensor([[3.0, 1], [2, 2], [1, 3], [1, 3], [3, 1]])
    torch.testing.assert_close(found, wanted)


def test_obstacles_move_and_absent_ones_stay_absent() -> None:
    boxes = torch.tensor([[[1.0, 2.0, -1.0, 3.0], [0.0] * 4]])
    ahead = boxes_moved(boxes, torch.tensor([[0.5, 1.0, 0.0]]))
    assert ahead[0, 0].tolist() == pytest.approx([0.5, 1.5, -2, 2])
    assert ahead[0, 1].tolist() == [0] * 4
    turned = boxes_moved(boxes, torch.tensor([[0.0, 0.0, math.pi / 2]]))
    assert turned[0, 0].tolist() == pytest.approx([-1, 3, -2, -1], abs=1e-6)


def test_a_side_turns_with_the_robot_s_view() -> None:
    wanted = side_seen(moved(POSE, MOTION), TABLE)
    torch.testing.assert_close(side_turned(WHOLE[:, 7:], MOTION), wanted)
    assert side_turned(SEEN[:, 7:], MOTION).shape == (COUNT, 0)
    assert side_turned(SEEN[:1, 7:], MOTION).shape == (COUNT, 0)


def test_a_box_tells_the_yaw_but_for_its_sign() -> None:
    parts = to_parts(SEEN)
    yaws = mirror_yaws(parts, SIDES)
    assert torch.equal(yaws[:, 0], -yaws[:, 1])
    for yaw in yaws.unbind(1):
        torch.testing.assert_close(turned_extents(yaw, SIDES), parts[:, EXTENTS])
    true = rectangle_in_frame(POSE, TABLE[:, :5])[:, 2, None]
    away = torch.remainder(yaws - true + math.pi / 2, math.pi) - math.pi / 2
    assert away.abs().amin(1).max() < 1e-5
    aside = (parts[:, OBJECT] - parts[:, CENTRE]).prod(1)
    assert torch.equal(yaws[:, 0] < 0, (aside < 0) & (yaws[:, 0] != 0))
    scene = scene_of(SEEN, SIDES)
    places = places_on_table(scene).view(COUNT, 2, 2)
    local = to_frame(TABLE[:, :3], AT).abs()
    off = (places - local[:, None]).norm(dim=2)
    assert off.amin(1).max() < 1e-5


def chosen() -> Tensor:
    """(n,) 1 where the first of two yaws is the true one, else -1."""
    true = rectangle_in_frame(POSE, TABLE[:, :5])[:, 2, None]
    away = torch.remainder(mirror_yaws(to_parts(SEEN), SIDES) - true + math.pi / 2, math.pi)
    off = (away - math.pi / 2).abs()
    return torch.where(off[:, 0] < off[:, 1], 1.0, -1.0).double()


def test_who_knows_the_yaw_knows_the_next_percept() -> None:
    one, none = torch.ones(()).double(), torch.zeros(()).double()
    known = next_percept(scene_of(SEEN, SIDES), MOTION, chosen(), one)
    torch.testing.assert_close(known, AFTER, atol=1e-5, rtol=0)
    whole = next_percept(scene_of(WHOLE, SIDES), MOTION, torch.zeros(COUNT).double(), one)
    torch.testing.assert_close(whole[:, :7], AFTER, atol=1e-5, rtol=0)
    torch.testing.assert_close(whole[:, 7:], side_turned(WHOLE[:, 7:], MOTION))
    loose = to_parts(next_percept(scene_of(SEEN, SIDES), MOTION, chosen(), none))
    wanted = loosely_turned(to_parts(SEEN)[:, EXTENTS], MOTION[:, 2])
    torch.testing.assert_close(loose[:, EXTENTS], wanted)
    doubtful = to_parts(
        next_percept(scene_of(SEEN, SIDES), MOTION, torch.zeros(COUNT).double(), one)
    )
    both = to_parts(next_percept(scene_of(SEEN, SIDES), MOTION, -chosen(), one)) + to_parts(AFTER)
    torch.testing.assert_close(doubtful[:, EXTENTS], both[:, EXTENTS] / 2, atol=1e-5, rtol=0)
    boxes = torch.tensor([[1.0, 2.0, -1.0, 3.0]]).double().expand(COUNT, 4)
    more = next_percept(scene_of(torch.cat([SEEN, boxes], 1), SIDES), MOTION, chosen(), one)
    torch.testing.assert_close(more[:, 7:], boxes_moved(boxes[:, None], MOTION).flatten(1))


def test_extremes_are_distances_turns_and_a_misfit() -> None:
    found = extremes(scene_of(WHOLE, SIDES), MOTION)
    torch.testing.assert_close(found[:, 0], SEEN[:, 4:6].norm(dim=1))
    torch.testing.assert_close(found[:, 1], MOTION[:, :2].norm(dim=1))
    assert torch.equal(found[:, 2], MOTION[:, 2].abs())
    assert found[:, 3].max() < 1e-6
    with pytest.raises(DataError, match=r"motion has shape \(50, 2\); pass"):
        check_shapes(SEEN, MOTION[:, :2])
    with pytest.raises(DataError, match="a percept has 8 numbers"):
        check_shapes(WHOLE[:, :8], MOTION)
    plain = torch.tensor([[0.0, 0.5, 0.0, 0.5, 3.0, 4.0, 0.7]]).double()
    box = extremes(scene_of(plain, torch.tensor([0.5, 0.9]).double()), MOTION[:1])
    assert float(box[0, 0]) == 5
    assert float(box[0, 3]) > 0.1
