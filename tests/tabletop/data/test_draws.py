"""How poses for data are spread."""

import math

import pytest
import torch
from support import FOOTPRINT, graspable, seeded

from cgtorch.tabletop.data import (
    ARENA,
    NEAR,
    Scenes,
    in_table,
    poses_around,
    poses_at_object,
)
from cgtorch.tabletop.world import TabletopWorld

SCENES = Scenes(lambda scenarios: TabletopWorld(scenarios, graspable, FOOTPRINT))


def spread(values: torch.Tensor, low: float, high: float) -> None:
    """Check that values are about uniform between two ends."""
    assert low - 1e-5 <= float(values.min()) < low + 0.03 * (high - low)
    assert high - 0.03 * (high - low) < float(values.max()) <= high + 1e-5
    assert float(values.mean()) == pytest.approx((low + high) / 2, abs=0.03 * (high - low))


def test_poses_at_the_object_are_on_any_side_of_it_and_free() -> None:
    found = poses_at_object(SCENES, 2000, seeded(1))
    offset = found.pose[:, :2] - found.object
    assert len(found) == 2000
    assert not in_table(found, SCENES.footprint).any()
    away = offset.norm(dim=1)
    assert NEAR[0] <= float(away.min())
    assert 0.95 * NEAR[1] < float(away.max()) <= NEAR[1] + 1e-5
    spread(torch.atan2(offset[:, 1], offset[:, 0]), -math.pi, math.pi)
    spread(found.pose[:, 2], -math.pi, math.pi)


@pytest.mark.parametrize("wider", [1.0, 2.0])
def test_poses_around_fill_the_arena(wider: float) -> None:
    found = poses_around(SCENES, 2000, seeded(2), wider)
    assert not in_table(found, SCENES.footprint).any()
    for column in range(2):
        spread(found.pose[:, column], -wider * ARENA, wider * ARENA)
    spread(found.pose[:, 2], -math.pi, math.pi)
