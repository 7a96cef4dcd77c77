"""Postures that touch something, against capsules in torch."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from cgtorch import native
from cgtorch.tabletop.kinematics.clear_ways import touches
from cgtorch.tabletop.kinematics.grasping import table_slab

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "tools"))

from benchmarks.touching import touches_in_torch

TABLE = torch.tensor([[0.9, 0.1, 0.3, 0.8, 1.2, 0.7]])
ROWS = 3000


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_postures_touch_what_they_touch_in_torch(robot_and_arm, random_joints, generator, dtype):
    """Up to a hundredth of a millimetre, by which radii are made smaller and larger."""
    robot, arm = robot_and_arm
    q = random_joints(arm, ROWS, generator).to(dtype)
    slab, body = table_slab(TABLE.to(dtype).expand(ROWS, 6)), robot.body.to(q)
    thin, thick = (
        touches_in_torch(
            replace(arm, capsules=replace(arm.capsules, radius=arm.capsules.radius + more)),
            q, slab, body,
        )
        for more in (-1e-5, 1e-5)
    )  # fmt: skip
    hit = touches(arm, q, slab, body)
    assert 0.05 < hit.float().mean() < 0.6
    assert (thin == thick).float().mean() > 0.999
    assert torch.equal(hit | thin, hit)
    assert torch.equal(hit & thick, hit)


@pytest.mark.parametrize("threads", [1, 3])
def test_what_postures_touch_does_not_depend_on_threads_or_rows(pr2, random_joints, threads):
    arm, body = pr2.arms[0], pr2.body
    q = random_joints(arm, ROWS, torch.Generator().manual_seed(1)).float()
    tables = TABLE + 0.05 * torch.randn(ROWS, 6, generator=torch.Generator().manual_seed(2))
    slab, body = table_slab(tables), body.to(q)
    native.use_threads(threads)
    hit = touches(arm, q, slab, body)
    one_by_one = [
        touches(arm, q[i : i + 1], table_slab(tables[i : i + 1]), body) for i in range(50)
    ]
    assert torch.equal(hit[:50], torch.cat(one_by_one))
    assert touches(arm, q[:0], table_slab(tables[:0]), body).shape == (0,)


def test_nothing_touches_nothing(pr2, random_joints, generator):
    q = random_joints(pr2.arms[0], 10, generator)
    none = pr2.body[:0]
    assert not touches(pr2.arms[0], q, none[None], none).any()
