"""Labels: what grasping there gives, drawn where a classifier has most to learn."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import FOOTPRINT, graspable, seeded

from cgtorch.tabletop.data import (
    NEAR,
    Scenes,
    grasp_labels,
    in_table,
    label,
    nearest_to_boundary,
    poses_around,
    poses_at_object,
)
from cgtorch.tabletop.world import LAB_NOISE, Noise, Scenarios, TabletopWorld

EXACT = Noise(0, 0)


def scenes_of(noise: Noise = EXACT) -> Scenes:
    return Scenes(lambda scenarios: TabletopWorld(scenarios, graspable, FOOTPRINT, noise))


@pytest.mark.parametrize("count", [60, 61, 300])
def test_there_are_as_many_as_asked_for_and_some_of_either(count: int) -> None:
    percept, answer = grasp_labels(scenes_of(), count, seeded(3))
    assert percept.shape == (count, 7)
    assert 0.1 < float(answer.float().mean()) < 0.9


def test_labels_are_what_grasping_there_gives() -> None:
    percept, answer = grasp_labels(scenes_of(), 300, seeded(4))
    # Without noise the percept holds the object where it is, which is all the stand-in asks for.
    assert torch.equal(answer, graspable(percept[:, 4:7], torch.empty(0)))


def test_a_label_with_noise_is_that_of_the_true_object() -> None:
    scenarios = poses_at_object(scenes_of(), 200, seeded(5))
    noisy, answer = label(scenes_of(LAB_NOISE), scenarios)
    exact, true_answer = label(scenes_of(), scenarios)
    assert torch.equal(answer, true_answer)
    assert not torch.equal(noisy, exact)
    assert (noisy - exact).abs().max() < 0.05


def test_poses_at_the_object_are_free_within_reach_and_on_all_sides() -> None:
    scenarios = poses_at_object(scenes_of(), 600, seeded(6))
    assert not in_table(scenarios, torch.tensor(FOOTPRINT)).any()
    offset = scenarios.pose[:, :2] - scenarios.object
    distance = offset.norm(dim=1)
    assert (distance >= NEAR[0] - 1e-5).all()
    assert (distance <= NEAR[1] + 1e-5).all()
    for side in (offset[:, 0] < -0.4, offset[:, 0] > 0.4, offset[:, 1] < -0.4, offset[:, 1] > 0.4):
        assert int(side.sum()) > 60
    turned = scenarios.pose[:, 2].div(math.pi / 2).floor().long() + 2
    assert (turned.bincount(minlength=4) > 100).all()


def test_labels_crowd_where_successes_border_on_failures() -> None:
    def to_border(percept: torch.Tensor) -> torch.Tensor:
        """Least displacement of the object (n,) that changes the stand-in's answer, to 2 cm."""
        ring = torch.arange(16) * (math.tau / 16)
        least = torch.full((len(percept),), torch.inf)
        for radius in torch.arange(1, 40) * 0.02:
            step = radius * torch.stack([ring.cos(), ring.sin(), 0 * ring], 1)
            moved = percept[:, None, 4:7] + step
            answer = graspable(moved.reshape(-1, 3), torch.empty(0)).view(len(percept), 16)
            changed = (answer != graspable(percept[:, 4:7], torch.empty(0))[:, None]).any(1)
            least = torch.where(changed & least.isinf(), radius, least)
        return least

    drawn = to_border(label(scenes_of(), poses_at_object(scenes_of(), 600, seeded(7)))[0])
    chosen = to_border(grasp_labels(scenes_of(), 600, seeded(7))[0])
    assert float((chosen <= 0.1).float().mean()) > 1.5 * float((drawn <= 0.1).float().mean())


def test_some_labels_are_far_away_and_none_in_the_table() -> None:
    asked: list[Scenarios] = []

    def watched(scenarios: Scenarios) -> TabletopWorld:
        asked.append(scenarios)
        return scenes_of().world(scenarios)

    percept, answer = grasp_labels(Scenes(watched), 300, seeded(8))
    far = percept[:, 4:6].norm(dim=1) > 2
    assert int(far.sum()) > 5
    assert not answer[far].any()
    for scenarios in asked:
        assert not in_table(scenarios, torch.tensor(FOOTPRINT)).any()


@given(st.integers(1, 40), st.integers(0, 2**30))
def test_the_nearest_to_the_boundary_are_as_near_to_either_label(count: int, seed: int) -> None:
    scenes = poses_around(scenes_of(), 60, seeded(seed))
    percept, answer = label(scenes_of(), poses_at_object(scenes_of(), 60, seeded(seed + 1)))
    answer[:2] = torch.tensor([True, False])
    found = nearest_to_boundary(scenes, percept, answer, count)
    assert len(found.unique()) == count
    seen = label(scenes_of(), scenes)[0]

    def uneven(row: int) -> float:
        def mean(yes: bool) -> float:
            known = percept[answer == yes]
            apart = torch.cat(
                [(seen[row, :4].clamp(-1, 1) - known[:, :4].clamp(-1, 1)),
                 2 * (seen[row, 4:6] - known[:, 4:6])], 1
            )  # fmt: skip
            nearest = sorted(apart.square().sum(1).sqrt().tolist())[:4]
            return sum(nearest) / len(nearest)

        return abs(mean(True) - mean(False)) / (mean(True) + mean(False))

    inside = set(found.tolist())
    worst = max(uneven(row) for row in inside)
    assert all(uneven(row) >= worst - 1e-4 for row in range(60) if row not in inside)
