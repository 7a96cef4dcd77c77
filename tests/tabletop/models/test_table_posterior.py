"""Γ and C on tables of any size: what is known exactly is exact, and fits take any percept."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import FOOTPRINT, graspable, seeded

from cgtorch.domains.success import fit_success_classifier
from cgtorch.domains.transition import Grid
from cgtorch.domains.transition_fit import fit_transition_model
from cgtorch.environment import start_lanes
from cgtorch.ground.errors import DataError
from cgtorch.svm import load_model, save_model
from cgtorch.svm.scores import balanced_accuracy
from cgtorch.tabletop.data import Scenes, grasp_labels
from cgtorch.tabletop.data.collect import drive
from cgtorch.tabletop.models import (
    GraspClassifier,
    TableTransitionModel,
    geometry,
)
from cgtorch.tabletop.world import LAB_NOISE, Noise, TabletopWorld, cluttered_scenarios

QUIET = Noise(0, 0)
KINDS = {"TableTransitionModel": TableTransitionModel}
GRID = Grid([1.0], [4.0], [0.1], 200)


def world_of(percept, noise=LAB_NOISE):
    return lambda scenarios: TabletopWorld(scenarios, graspable, FOOTPRINT, noise, percept=percept)


@pytest.fixture(scope="module")
def fitted():
    """Γ from 500 transitions among clutter, where percepts tell the yaw."""
    data = drive(Scenes(world_of("yaw"), "general-clutter"), 500, seeded(0))
    return *fit_transition_model(TableTransitionModel(), *data, grid=GRID), data


def moved_without_noise(scenes, motion):
    """What is seen before and after a motion without noise, in float64."""
    double = {name: getattr(scenes, name).double() for name in ("pose", "table", "object")}
    scenes = replace(scenes, **double, obstacles=scenes.obstacles.double())
    world = world_of("yaw", QUIET)(scenes)
    world.footprint = world.footprint.double()
    before = start_lanes(world, torch.arange(len(scenes)), 0, 0)
    after, ok = world.step(before, motion)
    return before.percept[ok], motion[ok], after.percept[ok]


def test_where_the_yaw_is_seen_tables_and_objects_move_exactly(fitted):
    motion = torch.randn(400, 3, generator=seeded(1), dtype=torch.float64)
    scenes = cluttered_scenarios(400, seeded(2))
    p, u, q = moved_without_noise(scenes, motion)
    assert len(p) > 200
    model = fitted[0]
    assert torch.allclose(model(p, u)[:, :9], q[:, :9], atol=1e-6)
    assert model(p, u).dtype == torch.float64


def test_obstacles_keep_their_centres_and_absent_ones_stay_away(fitted):
    motion = torch.randn(400, 3, generator=seeded(3), dtype=torch.float64)
    quarter = torch.pi / 2
    motion[::2, 2] = quarter * torch.randint(-2, 3, (200,), generator=seeded(4)).double()
    p, u, q = moved_without_noise(cluttered_scenarios(400, seeded(5)), motion)
    found, there = fitted[0](p, u), (p[:, 9:] != 0).any(1)
    assert not found[~there, 9:].any()
    assert not q[~there, 9:].any()
    middle = [(x[there, 9:12:2] + x[there, 10:13:2]) / 2 for x in (found, q)]
    assert torch.allclose(*middle, atol=1e-6)
    turns = u[:, 2] / quarter
    straight = there & ((turns - turns.round()).abs() < 1e-9)
    assert int(straight.sum()) > 20
    assert torch.allclose(found[straight, 9:], q[straight, 9:], atol=1e-6)
    assert float((found - q)[there, 9:].abs().mean()) < 0.03


@given(st.floats(0.3, 1.4), st.floats(0, 3.2), st.floats(-7, 7))
def test_a_box_turned_loosely_is_exact_for_squares_and_quarter_turns(side, other, turn):
    square = geometry.loosely_turned(torch.tensor([side, side]), torch.tensor(turn))
    assert square.tolist() == pytest.approx([side, side], abs=1e-5)
    extents = torch.tensor([side, other], dtype=torch.float64)
    once, twice = (
        geometry.loosely_turned(extents, torch.tensor(k * math.pi / 2, dtype=torch.float64))
        for k in (1, 2)
    )
    assert once.tolist() == pytest.approx([other, side], abs=1e-9)
    assert twice.tolist() == pytest.approx([side, other], abs=1e-9)


def test_errors_are_those_of_the_noise(fitted):
    """Of motion and both looks: 5 mm each and 0.5° at some metres."""
    model, report, _ = fitted
    assert report.choice == (None,)
    assert float(model.trust) == 1
    assert report.coordinates[7:] == (
        "side x", "side y",
        "obstacle 1 x min", "obstacle 1 x max", "obstacle 1 y min", "obstacle 1 y max",
    )  # fmt: skip
    p, u, q = drive(Scenes(world_of("yaw"), "general-clutter"), 1000, seeded(6))
    error = (model(p, u) - q).abs().mean(0)
    assert float(error[:4].mean()) < 0.016
    assert float(error[4:6].mean()) < 0.016
    assert float(error[7:9].mean()) < 0.013
    assert float(model.novelty(p, u).median()) < 0.3
    far = p + torch.tensor([4.0, 4.0, 0, 0, 4.0, 0, 0, 0, 0, 0, 0, 0, 0]) * p[:, 4:5].sign()
    assert float(model.novelty(far, u).median()) > 0.8


def test_such_models_are_kept_shrunk_and_learn_on(fitted, tmp_path):
    model, report, (p, u, q) = fitted
    save_model(tmp_path / "gamma", model, report)
    assert torch.equal(load_model(tmp_path / "gamma", KINDS)(p, u), model(p, u))
    small = model.with_fewer_centres(32, p, u)
    assert torch.allclose(small(p, u), model(p, u), atol=1e-6)
    kept, start = model.coreset(p, u, q, limit=300)
    assert len(kept) == 300
    again = start.updated(p[kept], u[kept], q[kept])
    assert torch.allclose(again(p, u), model(p, u), atol=1e-5)


def test_boxes_of_any_table_are_better_turned_than_kept():
    data = drive(Scenes(world_of("box"), "general"), 600, seeded(7))
    model, _ = fit_transition_model(TableTransitionModel(), *data, grid=GRID)
    p, u, q = drive(Scenes(world_of("box"), "general"), 1000, seeded(8))
    kept = geometry.from_parts(geometry.move_rigidly(geometry.to_parts(p), u))
    error, rigid = ((x - q).abs()[:, :4].mean() for x in (model(p, u), kept))
    assert float(error) < 0.95 * float(rigid)
    with pytest.raises(DataError, match="a percept has 8 numbers"):
        model(p[:, [0, 1, 2, 3, 4, 5, 6, 6]], u)


@pytest.mark.parametrize(("percept", "features"), [("box", 8), ("yaw", 10)])
def test_grasps_depend_on_the_height(percept, features):
    def arms(at, table):
        return (at[:, :2].norm(dim=1) < 0.6 + 2 * (0.9 - at[:, 2])) & (at[:, 0] > 0)

    def worlds(scenarios):
        return TabletopWorld(scenarios, arms, FOOTPRINT, percept=percept)

    scenes = Scenes(worlds, "general")
    rows, answer = grasp_labels(scenes, 500, seeded(0))
    model, _ = fit_success_classifier(GraspClassifier(), rows, answer, C=[100.0], gamma=[0.5])
    assert len(model.mean) == features
    fresh, truth = grasp_labels(scenes, 500, seeded(1))
    assert float(balanced_accuracy(model(fresh) - 0.5, truth.float() - 0.5)) > 0.9
    low, high = (fresh.clone() for _ in range(2))
    low[:, 6], high[:, 6] = 0.6, 0.9
    assert float((model(low) - model(high)).mean()) > 0.1


def test_obstacles_say_nothing_about_grasps():
    """Obstacles are reached over, so C says the same beside them."""
    rows, answer = grasp_labels(Scenes(world_of("yaw"), "general"), 200, seeded(2))
    model, _ = fit_success_classifier(GraspClassifier(), rows, answer, C=[100.0], gamma=[0.5])
    box = torch.tensor([1.0, 1.4, -0.2, 0.3]).expand(len(rows), 4)
    assert torch.equal(model(torch.cat([rows, box], 1)), model(rows))
    assert torch.equal(model(torch.cat([rows, box, box], 1)), model(rows))
    with pytest.raises(DataError, match="which make 8 features; the classifier was fitted on 10"):
        model(rows[:, :7])
