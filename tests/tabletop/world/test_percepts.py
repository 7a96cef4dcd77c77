"""Obstacles as they are perceived, beside a plain look at their corners."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from planar import plain_box, plain_percept, plain_point

from cgtorch.ground.errors import DataError
from cgtorch.tabletop.world.percepts import (
    obstacles_seen,
    parts_of,
    percept_fields,
    percept_of,
    side_seen,
)

metres = st.floats(-3, 3)
angles = st.floats(-7, 7)
boxes = st.tuples(metres, metres, angles, st.floats(0.1, 1), st.floats(0.1, 1))


def test_an_obstacle_is_present_wherever_one_of_its_sides_is_not_at_nought() -> None:
    boxes = [[0.0, 1.0, 0.0, 2.0], [0.0] * 4, [-1.0, 0.0, 0.0, 0.5], [0.0, 0.0, 0.0, 0.1]]
    percept = torch.tensor([*[0.0] * 7, *(x for box in boxes for x in box)])
    assert parts_of(percept).present.tolist() == [True, False, True, True]


@given(
    st.tuples(metres, metres, angles),
    st.tuples(metres, metres, angles, st.floats(0.1, 2), st.floats(0.1, 2), st.floats(0.3, 1.2)),
    st.tuples(metres, metres),
)
def test_percepts_are_what_a_plain_look_gives(
    pose: tuple[float, ...], table: tuple[float, ...], placed: tuple[float, float]
) -> None:
    found = percept_of(*(torch.tensor([x], dtype=torch.float64) for x in (pose, table, placed)))
    assert found[0].tolist() == pytest.approx(plain_percept(pose, table, placed), abs=1e-9)


@given(st.tuples(metres, metres, angles), st.lists(st.one_of(st.none(), boxes), max_size=3))
def test_obstacles_are_boxes_and_nothing_is_four_zeros(
    pose: tuple[float, ...], things: list[tuple[float, ...] | None]
) -> None:
    rows = torch.tensor([t or (0.0,) * 5 for t in things], dtype=torch.float64).view(-1, 5)
    seen = obstacles_seen(torch.tensor(pose, dtype=torch.float64), rows)
    wanted = [plain_box(pose, t) if t else [0.0] * 4 for t in things]
    assert seen.tolist() == pytest.approx([v for row in wanted for v in row], abs=1e-9)
    assert all((v == 0) == (t is None) for v, t in zip(seen[::4].tolist(), things, strict=True))


@given(st.tuples(metres, metres, angles), boxes, boxes)
def test_what_is_seen_can_be_read_back_as_rectangles(
    pose: tuple[float, ...], table: tuple[float, ...], obstacle: tuple[float, ...]
) -> None:
    at = torch.tensor(pose, dtype=torch.float64)
    top = torch.tensor([*table, 0.7], dtype=torch.float64)
    others = torch.tensor([obstacle, (0.0,) * 5], dtype=torch.float64)
    percept = torch.cat([percept_of(at, top, at[:2]), obstacles_seen(at, others)])
    things = parts_of(percept).things
    assert things.shape == (3, 5)
    for found, shape in zip(things[:2].tolist(), (table, obstacle), strict=True):
        x0, x1, y0, y1 = plain_box(pose, shape)
        middle = [(x0 + x1) / 2, (y0 + y1) / 2, 0, x1 - x0, y1 - y0]
        assert found == pytest.approx(middle, abs=1e-9)
    assert not things[2].any()


@given(st.tuples(metres, metres, angles), boxes)
def test_the_side_and_the_box_give_the_table_back(
    pose: tuple[float, ...], table: tuple[float, ...]
) -> None:
    at = torch.tensor(pose, dtype=torch.float64)
    top = torch.tensor([*table, 0.7], dtype=torch.float64)
    seen = parts_of(torch.cat([percept_of(at, top, at[:2]), side_seen(at, top)]))
    found = seen.table
    assert found[:2].tolist() == pytest.approx(plain_point(pose, table), abs=1e-9)
    half_turns = (float(found[2]) - (table[2] - pose[2])) / math.pi
    assert half_turns == pytest.approx(round(half_turns), abs=1e-6)
    assert found[3:].tolist() == pytest.approx(table[3:], abs=1e-9)
    assert torch.equal(seen.things[0], found)


@pytest.mark.parametrize(
    ("size", "parts"), [(7, (0, 0)), (9, (2, 0)), (11, (0, 1)), (13, (2, 1)), (15, (0, 2))]
)
def test_a_percepts_length_tells_what_it_holds(size: int, parts: tuple[int, int]) -> None:
    percept = torch.arange(2.0 * size).view(2, size)
    seen = parts_of(percept)
    assert seen.side.shape == (2, parts[0])
    assert seen.obstacles.shape == (2, parts[1], 4)
    every = seen.box, seen.object, seen.height, seen.side, seen.obstacles.flatten(1)
    assert torch.equal(torch.cat(every, 1), percept)
    assert len(percept_fields(size)) == size


@pytest.mark.parametrize("size", [0, 3, 6, 8, 10, 12, 14])
def test_other_lengths_are_no_percepts(size: int) -> None:
    with pytest.raises(DataError, match=f"a percept has {size} numbers; give 7, or 9"):
        parts_of(torch.zeros(2, size))
