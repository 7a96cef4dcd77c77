"""C on fresh labels, and the floor that noise and an ambiguous box put under every classifier."""

from functools import partial

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support import FOOTPRINT, graspable, seeded

from cgtorch.tabletop.data import Scenes, label
from cgtorch.tabletop.data.poses import in_table, poses_at_object
from cgtorch.tabletop.models.success_quality import (
    SuccessQuality,
    fresh_labels,
    scenes_behind,
    success_frequency,
    success_quality,
)
from cgtorch.tabletop.world import Noise, Scenarios, TabletopWorld
from cgtorch.tabletop.world.percepts import percept_of

BLUR = 0.03


def world_of(scenarios: Scenarios, blur: float = BLUR) -> TabletopWorld:
    return TabletopWorld(scenarios, graspable, FOOTPRINT, Noise(blur, 0.0))


SCENES = Scenes(world_of)


def quality(scenes: Scenes, count: int, seed: int) -> SuccessQuality:
    generator = seeded(seed)
    return success_quality(scenes, knows, fresh_labels(scenes, count, generator), generator)


def knows(percept: torch.Tensor) -> torch.Tensor:
    """What is most likely where only the object counts and noise has no side."""
    return graspable(percept[:, 4:7], torch.empty(0)).float() * 0.9 + 0.05


@settings(max_examples=10)
@given(st.integers(0, 2**30))
def test_scenes_behind_a_percept_look_like_it(seed: int) -> None:
    poses = poses_at_object(SCENES, 20, seeded(seed))
    percept = label(SCENES, poses)[0]
    scenes = scenes_behind(SCENES, percept, 50, seeded(seed + 1))
    assert not in_table(scenes, torch.tensor(FOOTPRINT)).any()
    assert (scenes.object[:, 0].abs() <= 0.4).all()
    assert (scenes.object[:, 1].abs() <= 0.6).all()
    exact = percept_of(scenes.pose, scenes.table, scenes.object).view(20, 50, 7)
    off = (exact - percept[:, None])[..., :6]
    assert float(off.square().mean().sqrt()) == pytest.approx(BLUR, rel=0.25)


def test_the_chance_is_how_often_the_same_percept_succeeds() -> None:
    poses = poses_at_object(SCENES, 1500, seeded(1))
    percept, answer = label(SCENES, poses)
    chance = success_frequency(SCENES, percept, 24, seeded(2))
    assert float(chance.mean()) == pytest.approx(float(answer.float().mean()), abs=0.02)
    unsure = (chance > 0.2) & (chance < 0.8)
    assert int(unsure.sum()) > 20
    assert float(chance[unsure].mean()) == pytest.approx(
        float(answer[unsure].float().mean()), abs=0.2
    )


def test_a_classifier_that_knows_the_world_is_as_good_as_is_possible() -> None:
    found = quality(SCENES, 800, 3)
    for one, few in ((found.near, 0.02), (found.overall, 0.02), (found.beside, 0.1)):
        assert one.accuracy == pytest.approx(one.possible, abs=few)
        assert one.possible <= 1
        assert one.possible_balanced <= 1
    assert found.beside.possible < found.near.possible < found.overall.possible
    assert sum(rows for _, _, rows in found.reliability) == found.near.rows == 800
    assert found.near.calibration_error == pytest.approx(0.05, abs=0.04)


def test_without_noise_all_is_possible_where_the_object_decides() -> None:
    found = quality(Scenes(partial(world_of, blur=0.0)), 300, 4)
    for one in (found.near, found.overall, found.beside):
        assert one.accuracy == one.balanced == 1
        assert one.possible > 0.98


def test_poses_beside_the_boundary_are_fresh_and_free() -> None:
    asked: list[Scenarios] = []

    def watched(scenarios: Scenarios) -> TabletopWorld:
        asked.append(scenarios)
        return world_of(scenarios)

    found = quality(Scenes(watched), 400, 5)
    assert 10 < found.beside.rows < 400
    assert 0.2 < found.beside.positive < 0.8


def test_the_generator_decides() -> None:
    one, same, other = (quality(SCENES, 100, s) for s in (6, 6, 7))
    assert one == same != other
