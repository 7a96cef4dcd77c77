"""Planar geometry against shapely, which knows nothing of ours."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from planar import polygon
from shapely import Polygon, affinity, box
from torch import Tensor

from cgtorch.tabletop.world.geometry import (
    bounding_box,
    box_rectangle,
    corners,
    moved,
    rectangle_in_frame,
    rectangles_overlap,
    rotate,
    to_frame,
    wrap,
)

metres = st.floats(-2, 2)
angles = st.floats(-2 * math.pi, 2 * math.pi)
poses = st.tuples(metres, metres, angles)
rectangles = st.tuples(metres, metres, angles, st.floats(0.1, 1.5), st.floats(0.1, 1.5))


def tensor(*rows: tuple[float, ...]) -> Tensor:
    return torch.tensor(rows, dtype=torch.float64)


def seen_from(pose: tuple[float, ...], shape: Polygon) -> Polygon:
    """What a robot at the pose sees: undo its place, then its heading."""
    x, y, theta = pose
    there = affinity.translate(shape, -x, -y)
    return affinity.rotate(there, -theta, origin=(0, 0), use_radians=True)


@given(poses, rectangles)
def test_boxes_and_corners_in_the_robots_frame(
    pose: tuple[float, ...], rectangle: tuple[float, ...]
) -> None:
    wanted = seen_from(pose, polygon(rectangle))
    found = rectangle_in_frame(tensor(pose), tensor(rectangle))
    x0, y0, x1, y1 = wanted.bounds
    assert bounding_box(found)[0].tolist() == pytest.approx([x0, x1, y0, y1], abs=1e-9)
    shape = Polygon(corners(found)[0].tolist())
    assert shape.symmetric_difference(wanted).area == pytest.approx(0, abs=1e-9)
    again = Polygon(corners(box_rectangle(bounding_box(found)))[0].tolist())
    assert again.symmetric_difference(box(*wanted.bounds)).area == pytest.approx(0, abs=1e-9)


def test_corners_go_round_from_where_both_axes_lead() -> None:
    found = corners(tensor((1.0, 2.0, math.pi / 2, 2.0, 4.0)))[0]
    wanted = [[-1.0, 3.0], [3.0, 3.0], [3.0, 1.0], [-1.0, 1.0]]
    torch.testing.assert_close(found, tensor(*map(tuple, wanted)))


@given(rectangles, rectangles)
def test_overlap_is_that_of_polygons(first: tuple[float, ...], second: tuple[float, ...]) -> None:
    overlap = rectangles_overlap(tensor(first), tensor(second)).item()
    one, two = polygon(first), polygon(second)
    if one.intersection(two).area > 1e-6:
        assert overlap
    elif one.distance(two) > 1e-6:
        assert not overlap


@given(poses, poses, st.tuples(metres, metres))
def test_frames_undo_motions(
    pose: tuple[float, ...], motion: tuple[float, ...], point: tuple[float, float]
) -> None:
    """What a moved robot sees at q, it saw before at q turned and shifted by its motion."""
    after = moved(tensor(pose), tensor(motion))
    seen = to_frame(after, tensor(point))
    before = to_frame(tensor(pose), tensor(point))
    back = rotate(seen, tensor(motion)[:, 2]) + tensor(motion)[:, :2]
    torch.testing.assert_close(back, before)
    assert -math.pi <= after[0, 2] < math.pi


@given(st.floats(-1e4, 1e4))
def test_wrapping(angle: float) -> None:
    found = wrap(tensor((angle,))).item()
    assert -math.pi <= found < math.pi + 1e-9
    assert math.cos(found) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(found) == pytest.approx(math.sin(angle), abs=1e-9)


@pytest.mark.parametrize(
    ("second", "overlap"),
    [
        ((1.4, 0.0, 0.0, 1.0, 1.0), False),
        ((0.9, 0.0, 0.0, 1.0, 1.0), True),
        ((1.0, 0.0, 0.0, 1.0, 1.0), False),
        ((1.15, 0.0, math.pi / 4, 1.0, 1.0), True),
        ((1.25, 0.0, math.pi / 4, 1.0, 1.0), False),
        ((0.8, 0.8, math.pi / 4, 1.0, 1.0), True),
        ((0.9, 0.9, math.pi / 4, 1.0, 1.0), False),
        ((0.0, 0.0, 0.3, 0.1, 0.1), True),
        ((0.0, 0.0, 0.3, 9.0, 9.0), True),
    ],
)
def test_rectangles_that_nearly_touch(second: tuple[float, ...], overlap: bool) -> None:
    unit, other = torch.tensor([[0.0, 0.0, 0.0, 1.0, 1.0]]), torch.tensor([second])
    assert rectangles_overlap(unit, other).item() is overlap
    assert rectangles_overlap(other, unit).item() is overlap
