"""What a percept leaves open where tables are of any size: samples that are what they claim."""

from functools import partial

import pytest
import torch
from support import FOOTPRINT, graspable, seeded

from cgtorch.domains.transition import Grid
from cgtorch.domains.transition_fit import fit_transition_model
from cgtorch.tabletop.data import Scenes, label
from cgtorch.tabletop.data.poses import poses_at_object
from cgtorch.tabletop.models import TableTransitionModel, transition_quality
from cgtorch.tabletop.models.success_quality import scenes_behind, success_frequency
from cgtorch.tabletop.models.table_posterior import tables_behind
from cgtorch.tabletop.models.transition_quality import (
    fresh_transitions,
    possible_next,
    weighted_median,
)
from cgtorch.tabletop.world import TabletopWorld, percept_of
from cgtorch.tabletop.world.percepts import side_seen

PERCEPTS = ("box", "yaw")


def scenes_of(percept):
    world = partial(TabletopWorld, graspable=graspable, footprint=FOOTPRINT, percept=percept)
    return Scenes(world, "general")


@pytest.mark.parametrize("percept", PERCEPTS)
def test_what_is_behind_a_percept_looks_like_it(percept):
    poses = poses_at_object(scenes_of(percept), 200, seeded(0))
    seen, _ = label(scenes_of(percept), poses)
    scenes = scenes_behind(scenes_of(percept), seen, 8, seeded(1))
    again = percept_of(scenes.pose, scenes.table, scenes.object)
    again = torch.cat([again, side_seen(scenes.pose, scenes.table)], 1)[:, : seen.shape[1]]
    off = (again - seen.repeat_interleave(8, 0)).abs()
    assert float(off.quantile(0.99)) < 0.03
    assert 0.002 < float(off.mean()) < 0.006
    sides, height = scenes.table[:, 3:5], scenes.table[:, 5]
    assert ((sides >= 0.6) & (sides <= 1.4)).all()
    assert ((height >= 0.6) & (height <= 0.9)).all()


def test_the_true_table_is_among_those_behind_its_box():
    """The yaw of the truth lies within the yaws that are likely, whichever they are."""
    poses = poses_at_object(scenes_of("box"), 400, seeded(2))
    seen, _ = label(scenes_of("box"), poses)
    table, _, weight = tables_behind(seen, 0.005, 2000, seeded(3))
    truth = poses.table[:, 3:5].prod(1)
    area = table[..., 3:5].prod(-1)
    below = (weight * (area < truth[:, None])).sum(1) / weight.sum(1)
    assert float(below.mean()) == pytest.approx(0.5, abs=0.05)  # uniform, as ranks of draws are
    assert float(below.var()) == pytest.approx(1 / 12, rel=0.25)


@pytest.mark.parametrize("percept", PERCEPTS)
def test_the_median_errs_as_the_samples_promise(percept):
    fresh = fresh_transitions(scenes_of(percept), 1000, seeded(4))
    values, weight = possible_next(scenes_of(percept), fresh.percept, fresh.motion, seeded(5))
    median = weighted_median(values, weight)
    promised = (weight[..., None] * (values - median[:, None]).abs()).sum(1)
    error = (median - fresh.next_percept[:, :7]).abs()
    for columns in (slice(0, 4), slice(4, 6)):
        mean = error[:, columns].mean(1)
        slack = 3 * float(mean.std()) / len(mean) ** 0.5
        assert float(mean.mean()) == pytest.approx(float(promised[:, columns].mean()), abs=slack)


def test_nothing_is_left_to_learn_where_the_yaw_is_seen():
    grid = Grid([1.0], [4.0], [0.1], 200)
    quality = {}
    for percept in PERCEPTS:
        data = fresh_transitions(scenes_of(percept), 500, seeded(6))
        model, _ = fit_transition_model(
            TableTransitionModel(), data.percept, data.motion, data.next_percept, grid=grid
        )
        quality[percept] = transition_quality(scenes_of(percept), model, 1000, seeded(7))
    assert quality["yaw"].table_error < 1.03 * quality["yaw"].table_floor
    assert quality["yaw"].object_error < 1.03 * quality["yaw"].object_floor
    assert quality["box"].table_floor > 2 * quality["yaw"].table_floor
    assert quality["box"].table_error > quality["box"].table_floor


def test_a_grasp_that_the_noise_cannot_change_is_certain():
    poses = poses_at_object(scenes_of("yaw"), 300, seeded(8))
    seen, truth = label(scenes_of("yaw"), poses)
    chance = success_frequency(scenes_of("yaw"), seen, 8, seeded(9))
    sure = (chance == 0) | (chance == 1)
    assert float(sure.float().mean()) > 0.8
    assert float(((chance > 0.5) == truth)[sure].float().mean()) > 0.98
