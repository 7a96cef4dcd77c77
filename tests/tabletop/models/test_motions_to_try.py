"""Motions from which Γ and C of a tabletop learn: most end near the object."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from reaching import TABLE_MODELS
from support import seeded, world

from cgtorch.tabletop.data import BLIND, FARTHEST, NEAR, WITHIN, motions_to_try, random_motions

PERCEPTS = world(0, 40).start(torch.arange(40))[1]


@given(st.integers(0, 2**31), st.integers(1, 60), st.integers(0, 39))
def test_motions_stay_within_their_bounds(seed: int, count: int, row: int) -> None:
    found = motions_to_try(PERCEPTS[row], count, seeded(seed))
    assert found.shape == (count, 3)
    assert found.isfinite().all()
    assert float(found[:, :2].norm(dim=1).max()) <= FARTHEST + 1e-5
    assert float(found[:, 2].abs().max()) <= torch.pi + 1e-5
    assert torch.equal(found, TABLE_MODELS.worth_trying(PERCEPTS[row], count, seeded(seed)))


def test_most_end_near_the_object_in_all_directions() -> None:
    """Or as near as one motion leads; the others, drawn all at once, go anywhere."""
    percept = PERCEPTS[0].clone()
    percept[4:6] = torch.tensor([0.6, -0.2])
    drawn = [motions_to_try(percept, 50, seeded(s)) for s in range(300)]
    away = [(m[:, :2] - percept[4:6]).norm(dim=1) for m in drawn]
    near = torch.tensor([bool(((a >= NEAR[0] - 1e-4) & (a <= NEAR[1] + 1e-4)).all()) for a in away])
    assert float(near.float().mean()) == pytest.approx(1 - BLIND, abs=0.08)
    at = torch.cat([m for m, yes in zip(drawn, near.tolist(), strict=True) if yes])
    offset = at[:, :2] - percept[4:6]
    side = torch.atan2(offset[:, 1], offset[:, 0]).histc(8, -torch.pi, torch.pi)
    turn = at[:, 2].histc(8, -torch.pi, torch.pi)
    distance = offset.norm(dim=1).histc(5, *NEAR)
    for counts in (side, turn, distance):
        share = counts / counts.sum()
        assert share.tolist() == pytest.approx([1 / len(share)] * len(share), abs=0.02)
    blind = torch.cat([m for m, yes in zip(drawn, near.tolist(), strict=True) if not yes])
    assert float(blind[:, :2].norm(dim=1).mean()) == pytest.approx(FARTHEST / 2, abs=0.1)


def test_what_is_too_far_for_one_motion_is_approached() -> None:
    percept = PERCEPTS[0].clone()
    percept[4:6] = torch.tensor([6.0, 0.0])
    drawn = torch.cat([motions_to_try(percept, 20, seeded(s)) for s in range(100)])
    ahead = drawn[(drawn[:, :2].norm(dim=1) - FARTHEST).abs() < 1e-4]
    assert len(ahead) / len(drawn) == pytest.approx(1 - BLIND, abs=0.15)
    assert (torch.atan2(ahead[:, 1], ahead[:, 0]).abs() < 0.3).all()


def test_a_seed_gives_the_motions_that_it_always_gave() -> None:
    """Or data that were collected could not be collected again."""
    one, other = random_motions(2, seeded(0)).tolist()
    assert one == pytest.approx([0.113386, -0.986015, -0.215473], abs=1e-5)
    assert other == pytest.approx([-0.409268, -0.458841, -0.062245], abs=1e-5)


def test_random_motions_go_anywhere_and_a_third_turn_little() -> None:
    found = random_motions(6000, seeded(0))
    assert float(found[:, :2].norm(dim=1).max()) <= FARTHEST
    assert float(found[:, 2].abs().max()) <= torch.pi
    little = float((found[:, 2].abs() <= torch.pi / 12).float().mean())
    assert little == pytest.approx(1 / 3 + 2 / 3 / 12, abs=0.03)
    side = torch.atan2(found[:, 1], found[:, 0]).histc(4, -torch.pi, torch.pi) / 6000
    assert side.tolist() == pytest.approx([0.25] * 4, abs=0.03)


def test_grasps_are_tested_where_the_object_may_be_within_reach() -> None:
    percepts = PERCEPTS.clone()
    percepts[:, 4] = torch.linspace(-2, 2, 40)
    percepts[:, 5] = torch.linspace(1, 0, 40)
    found = TABLE_MODELS.worth_testing(percepts)
    assert found.tolist() == [(x**2 + y**2) ** 0.5 < WITHIN for x, y in percepts[:, 4:6].tolist()]
    assert 0 < int(found.sum()) < 40
