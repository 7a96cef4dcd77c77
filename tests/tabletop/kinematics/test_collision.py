import math

import pytest
import torch

from cgtorch.tabletop.kinematics.collision import (
    Boxes,
    collide,
    segment_box_distance,
)


def test_segment_to_box_distance_equals_dense_sampling():
    generator = torch.Generator().manual_seed(0)
    a, b = (torch.randn(500, 3, generator=generator, dtype=torch.float64) for _ in range(2))
    half = 0.1 + torch.rand(500, 3, generator=generator, dtype=torch.float64)
    share = torch.linspace(0, 1, 4001, dtype=torch.float64)[:, None, None]
    points = a + share * (b - a)
    dense = (points.abs() - half).clamp_min(0).norm(dim=-1).amin(dim=0)
    error = (segment_box_distance(a, b, half) - dense).abs() / (b - a).norm(dim=1)
    assert error.max() < 1 / 400
    assert error.median() < 1e-3
    assert 0.2 < (dense == 0).double().mean() < 0.8


@pytest.mark.parametrize(
    ("start", "end", "distance"),
    [
        ((2.0, 0.0, 0.0), (3.0, 0.0, 0.0), 1.0),
        ((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), 0.0),
        ((-3.0, 0.5, 0.2), (3.0, 0.5, 0.2), 0.0),
        ((2.0, 2.0, 2.0), (2.0, 2.0, 2.0), math.sqrt(3)),
        ((-5.0, 1.5, 0.0), (5.0, 1.5, 0.0), 0.5),
    ],
)
def test_segment_to_unit_box_distance(start, end, distance):
    got = segment_box_distance(torch.tensor(start), torch.tensor(end), torch.ones(3))
    assert got == pytest.approx(distance, abs=1e-6)


def test_capsules_touch_turned_boxes():
    half = math.sqrt(0.5)
    turned = torch.tensor([[half, -half, 0.0], [half, half, 0.0], [0.0, 0.0, 1.0]])
    boxes = Boxes(torch.tensor([[[1.0, 0, 0]]]), turned[None, None], torch.full((1, 1, 3), 0.5))
    point = torch.tensor([[[1 - half - 0.1, 0.0, 0.0]]])
    assert collide(point, point, torch.tensor([0.11]), boxes).tolist() == [True]
    assert collide(point, point, torch.tensor([0.09]), boxes).tolist() == [False]


def turned(count, generator):
    """(count, 3, 3) random rotations."""
    q, r = torch.linalg.qr(torch.randn(count, 3, 3, generator=generator, dtype=torch.float64))
    q = q * r.diagonal(dim1=1, dim2=2).sign()[:, None]
    return q * q.det()[:, None, None]


@pytest.mark.parametrize("shared", [True, False], ids=["the same boxes", "boxes of each row"])
def test_looking_closely_only_where_it_is_near_changes_nothing(shared):
    generator = torch.Generator().manual_seed(0)
    rows, boxes = 400, 1 if shared else 400

    def random(*shape):
        return torch.rand(*shape, 3, generator=generator, dtype=torch.float64)

    start, radius = 2 * random(rows, 4), 0.05 + 0.2 * random(4)[:, 0]
    end = start + random(rows, 4) - 0.5
    things = Boxes(
        2 * random(boxes, 5),
        turned(5 * boxes, generator).view(boxes, 5, 3, 3),
        0.02 + 0.2 * random(boxes, 5),
    )
    axes = things.rotation.transpose(-1, -2)[:, None]
    a, b = (
        (axes @ (point[:, :, None] - things.centre[:, None])[..., None]).squeeze(-1)
        for point in (start, end)
    )
    every = segment_box_distance(a, b, things.half[:, None]) < radius[:, None]
    hit = collide(start, end, radius, things)
    assert torch.equal(hit, every.flatten(1).any(dim=1))
    assert 0.2 < hit.double().mean() < 0.9


def test_nothing_touches_nothing():
    none = Boxes(torch.zeros(1, 0, 3), torch.zeros(1, 0, 3, 3), torch.zeros(1, 0, 3))
    ends = torch.zeros(4, 2, 3)
    assert not collide(ends, ends, torch.ones(2), none).any()
