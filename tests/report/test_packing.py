"""How panels are put into one picture: apart, in order, and close together."""

import random
from itertools import combinations
from statistics import fmean

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cgtorch.report.graph_picture import MARGIN, packed

Sizes = list[tuple[float, float]]
SIDES = st.floats(0.3, 6.0)
SLACK = 1e-9


@given(st.lists(st.tuples(SIDES, SIDES), min_size=1, max_size=12))
def test_panels_are_apart_and_within_the_picture(sizes: Sizes) -> None:
    corners, width, height = packed(sizes)
    assert corners[0] == (MARGIN, MARGIN), "the first one begins the picture"
    boxes = [(x, y, x + w, y + h) for (x, y), (w, h) in zip(corners, sizes, strict=True)]
    assert max(box[2] for box in boxes) + MARGIN == pytest.approx(width)
    assert max(box[3] for box in boxes) + MARGIN == pytest.approx(height)
    assert min(min(box[:2]) for box in boxes) >= MARGIN
    for one, other in combinations(boxes, 2):
        gaps = [max(one[i] - other[i + 2], other[i] - one[i + 2]) for i in (0, 1)]
        assert max(gaps) >= MARGIN - SLACK


@pytest.mark.parametrize(
    ("sizes", "wanted"),
    [
        ([(2.0, 1.0)], [(0, 0)]),
        ([(1.0, 2.0), (1.0, 2.0)], [(0, 0), (1, 0)]),  # beside rather than below
        ([(4.0, 1.0), (4.0, 1.0)], [(0, 0), (0, 1)]),
        ([(2.0, 4.0), (2.0, 0.8), (2.0, 3.0)], [(0, 0), (1, 1), (1, 0)]),  # a column of two
    ],
)
def test_few_panels_have_the_places_that_one_would_give_them(
    sizes: Sizes, wanted: list[tuple[int, int]]
) -> None:
    corners, _, _ = packed(sizes)
    columns, rows = (sorted({corner[axis] for corner in corners}) for axis in (0, 1))
    assert [(columns.index(x), rows.index(y)) for x, y in corners] == wanted


def test_pictures_are_compact_and_rather_wide_than_tall() -> None:
    source = random.Random(3)
    used, tall = [], []
    for _ in range(300):
        count = source.randint(3, 9)
        sizes = [(source.uniform(0.8, 4.0), source.uniform(0.8, 5.0)) for _ in range(count)]
        _, width, height = packed(sizes)
        square = sum((w + MARGIN) * (h + MARGIN) for w, h in sizes) ** 0.5
        assert width <= max(1.8 * square, *(w for w, _ in sizes)) + 2 * MARGIN + SLACK
        used.append(sum(w * h for w, h in sizes) / (width * height))
        tall.append(height / width)
    assert fmean(used) > 0.69
    assert fmean(tall) < 0.8
    assert max(tall) < 2.56
