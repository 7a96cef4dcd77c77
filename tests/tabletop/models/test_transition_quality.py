"""What a percept leaves open: cases whose answer is known, and Γ beside the floor."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import FOOTPRINT, seeded

from cgtorch.domains.transition import Grid
from cgtorch.domains.transition_fit import fit_transition_model
from cgtorch.environment import start_lanes
from cgtorch.tabletop.data import Scenes
from cgtorch.tabletop.data.collect import drive
from cgtorch.tabletop.models import TableTransitionModel, transition_quality
from cgtorch.tabletop.models.geometry import to_parts
from cgtorch.tabletop.models.table_posterior import placement_density
from cgtorch.tabletop.models.transition_quality import (
    FreshTransitions,
    fresh_transitions,
    possible_next,
    weighted_median,
)
from cgtorch.tabletop.world import LAB_NOISE, Noise, Scenarios, TabletopWorld, random_scenarios
from cgtorch.tabletop.world.geometry import bounding_box

MEAN_ABSOLUTE = math.sqrt(2 / math.pi)  # of a standard normal number


def _nowhere(at, table):
    return torch.zeros(len(at), dtype=torch.bool)


def _world_of(noise):
    return lambda scenarios: TabletopWorld(scenarios, _nowhere, FOOTPRINT, noise)


QUIET = Scenes(_world_of(Noise(0.005, 0.0)))
LAB = Scenes(_world_of(LAB_NOISE))


def _floor(scenes, fresh, samples=256, seed=0):
    """Errors (n, 7) of the median, and the errors (n, 7) that the samples promise."""
    values, weight = possible_next(
        scenes, fresh.percept, fresh.motion, seeded(seed), samples=samples
    )
    median = weighted_median(values, weight)
    promised = (weight[..., None] * (values - median[:, None]).abs()).sum(1)
    return (median - fresh.next_percept).abs(), promised


def _mean(errors):
    return float(errors.mean()), float(errors.mean(1).std() / len(errors) ** 0.5)


def _without_turns(count, seed):
    """Transitions of the quiet world that drive a little and do not turn."""
    generator = seeded(seed)
    table = torch.tensor([0.0, 0, 0, 0.8, 1.2, 0.74]).repeat(count, 1)
    angle = 2 * torch.pi * torch.rand(count, generator=generator)
    pose = torch.stack([1.6 * angle.cos(), 1.6 * angle.sin(), 3 * angle], 1)
    placed = random_scenarios("perimeter", count, generator).object
    world = QUIET.world(Scenarios(pose, table, placed, torch.arange(count)))
    motion = torch.tensor([0.1, -0.1, 0.0]).repeat(count, 1)
    before = start_lanes(world, torch.arange(count), 0, 0)
    after, ok = world.step(before, motion)
    return FreshTransitions(before.percept[ok], motion[ok], after.percept[ok], after.percept[ok])


def test_without_a_turn_the_floor_is_the_noise():
    error, _ = _floor(QUIET, _without_turns(1500, 7))
    mean, deviation = _mean(error[:, 4:6])
    noise = 0.005 * math.sqrt(3) * MEAN_ABSOLUTE  # of the first look, the motion, the second look
    assert mean == pytest.approx(noise, abs=4 * deviation + 0.0001)
    mean, deviation = _mean(error[:, :4])
    # Which shapes there are says something about the box, so its numbers are known a bit better.
    assert 0.005 * math.sqrt(2) * MEAN_ABSOLUTE < mean < noise + 4 * deviation


def test_an_object_on_the_middle_line_leaves_both_yaws_open():
    yaw, turn = 0.5, math.pi / 4
    rectangle = torch.tensor([[2.0, 0.5, s * yaw, 0.8, 1.2] for s in (1, -1)])
    after = to_parts(
        torch.nn.functional.pad(bounding_box(rectangle - torch.tensor([0, 0, turn, 0, 0])), (0, 3))
    )
    apart = (after[0] - after[1]).abs()[2:4]
    percept = torch.cat([bounding_box(rectangle[0]), torch.tensor([2.0 - 0.36, 0.5, 0.74])])[None]
    motion = torch.tensor([[-0.1, 0.0, turn]])
    values, weight = possible_next(QUIET, percept, motion, seeded(0), samples=4000)
    extents = to_parts(values)[0, :, 2:4]
    first = (extents - after[0, 2:4]).norm(dim=1) < (extents - after[1, 2:4]).norm(dim=1)
    near = torch.where(first[:, None], after[0, 2:4], after[1, 2:4])
    assert float((extents - near).norm(dim=1).quantile(0.99)) < 0.05  # two yaws, nothing between
    assert float((weight[0] * first).sum()) == pytest.approx(0.5, abs=0.06)
    median = weighted_median(values, weight)
    promised = (weight[..., None] * (values - median[:, None]).abs()).sum(1)
    # Half the distance for an extent; the box's sides carry half of that.
    assert torch.allclose(promised[0, [0, 2]], apart / 4, rtol=0.25, atol=0.004)


def test_the_median_errs_as_the_samples_promise():
    fresh = fresh_transitions(LAB, 1500, seeded(3))
    error, promised = _floor(LAB, fresh)
    for columns in ([0, 1, 2, 3], [4, 5]):
        (mean, deviation), expected = _mean(error[:, columns]), float(promised[:, columns].mean())
        assert mean == pytest.approx(expected, rel=0.05, abs=3 * deviation)


def test_objects_err_by_the_noise_of_the_motions():
    """The same transitions repeated with other noise spread as far as the floor says."""
    scenes = random_scenarios("perimeter", 60, seeded(4))
    motion = torch.tensor([-0.5, 0.4, 1.0])
    spread = []
    for repeat in range(60):
        world = _world_of(LAB_NOISE)(replace(scenes, seed=scenes.seed + repeat))
        lanes = start_lanes(world, torch.arange(60), 0, 0)
        after, ok = world.step(lanes, motion.repeat(60, 1))
        assert ok.all()
        spread.append(after.percept[:, 4:6])
    around = torch.stack(spread)
    known_pose = float((around - around.median(0).values).abs().mean())
    values, weight = possible_next(LAB, lanes.percept, motion.repeat(60, 1), seeded(0))
    median = weighted_median(values, weight)
    floor = float((weight[..., None] * (values - median[:, None]).abs()).sum(1)[:, 4:6].mean())
    assert known_pose < floor < 1.15 * math.hypot(known_pose, 0.005 * MEAN_ABSOLUTE)


def test_more_is_known_with_more_samples_only_a_little():
    fresh = fresh_transitions(LAB, 400, seeded(5))
    few, many = (float(_floor(LAB, fresh, s)[0][:, :4].mean()) for s in (256, 1024))
    assert few == pytest.approx(many, rel=0.03)


def test_the_density_is_that_of_the_scenes():
    scenes = random_scenarios("perimeter", 200_000, seeded(0))
    sides = torch.tensor([0.8, 1.2])
    edges = torch.linspace(-0.7, 0.7, 57)
    counts = torch.histogramdd(scenes.object.double(), [edges.double()] * 2).hist
    middle = (edges[1:] + edges[:-1]) / 2
    grid = torch.cartesian_prod(middle, middle)
    fine = grid[:, None] + (torch.rand(len(grid), 64, 2, generator=seeded(1)) - 0.5) * 0.025
    density = placement_density(fine, sides.expand(len(grid), 64, 2)).mean(1)
    assert float(density.sum() * 0.025**2) == pytest.approx(1, abs=0.02)
    share = counts.flatten().float() / len(scenes)
    assert float((density * 0.025**2 - share).abs().sum()) < 0.06


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=9), st.integers(0, 2**31))
def test_weighted_medians_err_least(values, seed):
    sample = torch.tensor(values)[None, :, None]
    weight = torch.rand(1, len(values), generator=seeded(seed)) + 0.01
    weight = weight / weight.sum()
    median = weighted_median(sample, weight)

    def loss(at):
        return float((weight * (sample[..., 0] - at).abs()).sum())

    assert all(loss(median) <= loss(v) + 1e-5 for v in values)


def test_gamma_is_close_to_the_floor():
    model, _ = fit_transition_model(
        TableTransitionModel(), *drive(LAB, 1200, seeded(0)), grid=Grid([1.0], [8.0], [0.1], 300)
    )
    quality = transition_quality(LAB, model, 1500, seeded(10))
    assert quality.object_error < 1.03 * quality.object_floor
    assert quality.object_offset < 0.005
    slack = 2 * quality.table_excess_error
    assert quality.table_error < 1.1 * quality.table_floor + slack
    again = transition_quality(LAB, model, 1500, seeded(10))
    assert again == quality
    assert quality.rows == 1500
