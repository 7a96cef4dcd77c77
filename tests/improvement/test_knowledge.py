"""Models as an environment, learning on, local groups, trials."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from members import nearly
from support import FOOTPRINT, seeded, world

from cgtorch.data import Dataset
from cgtorch.environment import start_lanes
from cgtorch.improvement.knowledge import MOST_NEW, Knowledge, imagine, learn, sampled
from cgtorch.improvement.setup import Setup
from cgtorch.improvement.specialists import local_group
from cgtorch.improvement.team import try_all, with_noise
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.world import random_scenarios

PERCEPTS = world(0, 4).start(torch.arange(4))[1]


@pytest.mark.parametrize("replicas", [1, 3])
def test_scenarios_are_imagined_several_times(knowledge: Knowledge, replicas: int) -> None:
    place = imagine(knowledge, PERCEPTS, torch.tensor(FOOTPRINT), replicas, seeded(0))
    assert place.num_scenarios == 4 * replicas
    seen = place.start(torch.arange(4 * replicas))[1]
    for i in range(4):
        assert (seen[i * replicas : (i + 1) * replicas] == PERCEPTS[i]).all()


def test_errors_are_those_that_gamma_makes(knowledge: Knowledge) -> None:
    place = imagine(knowledge, PERCEPTS, torch.tensor(FOOTPRINT), 3, seeded(0))
    data = knowledge.dataset
    made = data.next_percept - knowledge.swift(data.percept, data.motion).detach()
    assert place.errors is not None
    errors = place.errors.flatten(0, 1)
    assert (
        torch.cdist(errors, made, compute_mode="donot_use_mm_for_euclid_dist").amin(1).max() < 1e-5
    )
    assert len({tuple(row) for row in place.errors[:, 0].tolist()}) > 6  # replicas differ
    # A motion ends where Γ says, and off by that error.
    lanes = start_lanes(place, torch.arange(12), 0, 0)
    back = torch.tensor([-0.3, 0.0, 0.0]).repeat(12, 1)
    after, done = place.step(lanes, back)
    assert done.all()
    expected = knowledge.swift(lanes.percept, back) + place.errors[:, 0]
    assert torch.allclose(after.percept, expected, atol=1e-6)


def test_imagined_tables_are_in_the_way(knowledge: Knowledge) -> None:
    place = imagine(knowledge, PERCEPTS, torch.tensor(FOOTPRINT), 1, seeded(0))
    lanes = start_lanes(place, torch.arange(4), 0, 0)
    for ahead, free in ((0.2, True), (1.2, False), (-3.0, False), (float("nan"), False)):
        motion = torch.tensor([ahead, 0.0, 0.0]).repeat(4, 1)
        after, done = place.step(lanes, motion)
        assert done.tolist() == [free] * 4
        assert free or torch.equal(after.percept, lanes.percept)


def test_imagining_leaves_the_models_alone(knowledge: Knowledge) -> None:
    before = {k: v.clone() for k, v in knowledge.gamma.state_dict().items()}
    place = imagine(knowledge, PERCEPTS, torch.tensor(FOOTPRINT), 1, seeded(0))
    assert place.gamma is not knowledge.swift
    assert all(torch.equal(v, before[k]) for k, v in knowledge.gamma.state_dict().items())


def test_learning_adds_rows_at_the_end(setup: Setup, knowledge: Knowledge) -> None:
    scenarios = random_scenarios("near", 30, seeded(1))
    experience = try_skill(nearly(0.3), setup.world_of(scenarios)).experience
    after = learn(knowledge, experience, seeded(2))
    for name, rows in vars(knowledge.dataset).items():
        assert torch.equal(vars(after.dataset)[name][: len(rows)], rows)
    new = len(after.dataset.percept) - len(knowledge.dataset.percept)
    assert new == min(MOST_NEW, len(experience.percept)) > 0
    assert after.gamma_report is knowledge.gamma_report
    assert after.classifier is not knowledge.classifier


def test_nothing_experienced_changes_nothing_much(knowledge: Knowledge) -> None:
    nothing = Dataset(*(rows[:0] for rows in vars(knowledge.dataset).values()))
    after = learn(knowledge, nothing, seeded(0))
    data = knowledge.dataset
    assert torch.allclose(
        after.gamma(data.percept, data.motion),
        knowledge.gamma(data.percept, data.motion),
        atol=0.01,
    )
    assert len(after.dataset.percept) == len(data.percept)


@given(st.integers(0, 30), st.integers(0, 20), st.integers(0, 2**31))
def test_samples(most: int, odd: int, seed: int) -> None:
    """So many transitions, so many grasps that were a surprise, and so many others."""
    rows = torch.arange(30.0)[:, None]
    data = Dataset(rows, rows + 100, rows + 200, rows[:20], torch.arange(20) % 2 == 0)
    some = sampled(data, torch.arange(20) < odd, most, seeded(seed))
    assert len(some.percept) == min(most, 30)
    assert len(set(some.percept[:, 0].tolist())) == len(some.percept)
    assert torch.equal(some.motion, some.percept + 100)
    assert torch.equal(some.next_percept, some.percept + 200)
    grasps = some.grasp_percept[:, 0]
    assert int((grasps < odd).sum()) == min(most, odd)
    assert int((grasps >= odd).sum()) == min(most, 20 - odd)
    assert len(set(grasps.tolist())) == len(grasps)
    assert torch.equal(some.graspable, grasps % 2 == 0)


@given(
    st.lists(st.booleans(), min_size=1, max_size=12).filter(any),
    st.integers(1, 15),
    st.integers(0, 2**31),
)
def test_local_groups(missed: list[bool], size: int, seed: int) -> None:
    percepts = torch.randn(len(missed), 7, generator=seeded(seed))
    group = local_group(percepts, torch.tensor(missed), size, seeded(seed)).tolist()
    rows = [i for i, m in enumerate(missed) if m]
    assert set(group) <= set(rows)
    assert len(group) == len(set(group)) == min(size, len(rows))
    # Its first is the one it was made around: nobody outside is nearer than anybody within.
    distance = (percepts - percepts[group[0]]).norm(dim=1).tolist()
    outside = [distance[i] for i in rows if i not in group]
    assert max(distance[i] for i in group) <= min(outside, default=float("inf")) + 1e-4


def test_any_missed_scenario_may_be_the_middle_of_a_group() -> None:
    percepts, missed = torch.eye(6, 7), torch.tensor([True, False, True, True, False, True])
    found = {int(local_group(percepts, missed, 1, seeded(s))[0]) for s in range(60)}
    assert found == {0, 2, 3, 5}


def test_trials_meet_other_noise(setup: Setup) -> None:
    scenarios = random_scenarios("near", 40, seeded(3))
    seeds = torch.cat([with_noise(scenarios, i).seed for i in range(3)])
    assert torch.equal(with_noise(scenarios, 0).seed, scenarios.seed)
    assert len(set(seeds.tolist())) == 120
    first = [first_percepts(setup.world_of(with_noise(scenarios, i))) for i in range(2)]
    assert 0 < float((first[0] - first[1]).abs().max()) < 0.06


def test_who_succeeds_is_tried_again(setup: Setup) -> None:
    scenarios = random_scenarios("near", 60, seeded(3))
    skill = nearly(0.3)
    share, experience = try_all(replace(setup, trials=3), skill, scenarios)
    trials = [try_skill(skill, setup.world_of(with_noise(scenarios, i))) for i in range(3)]
    runs = torch.stack([t.succeeded for t in trials]).float()
    assert torch.allclose(share, torch.where(runs[0] == 1, runs.mean(0), 0.0))
    assert len(set(share.tolist())) >= 2
    assert len(experience.percept) >= len(trials[0].experience.percept) > 0
