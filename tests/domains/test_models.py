"""What a domain's models imagine: errors, obstacles and novelty, of the tabletop and of a rail."""

from dataclasses import replace
from typing import Any

import torch
from rail import GEAR, LAMP, PLACE, WIND, Cart, Rail
from reaching import BASE, TABLE_MODELS, Reaching, fitted_to, world_of
from support import models_of, seeded, world
from torch import Tensor

from cgtorch.domains.compiled_models import compiled_models
from cgtorch.domains.knowledge import (
    Knowledge,
)
from cgtorch.domains.models import Models
from cgtorch.evolution import EvolutionSettings, evolve
from cgtorch.graphs import Skill
from cgtorch.ground.environment import start_lanes
from cgtorch.improvement.trial import first_percepts
from cgtorch.simulation import ModelEnvironment, rollout
from cgtorch.tabletop.data import Scenes, collect
from cgtorch.tabletop.world import cluttered_scenarios
from cgtorch.training.evaluate import robust_success

PERCEPTS = world(0, 4).start(torch.arange(4))[1]


def test_errors_are_those_that_gamma_makes(knowledge: Knowledge) -> None:
    before = {k: v.clone() for k, v in knowledge.gamma.state_dict().items()}
    place = TABLE_MODELS.imagine(knowledge, PERCEPTS, 3, seeded(0))
    assert place.classifier is not knowledge.classifier
    assert all(torch.equal(v, before[k]) for k, v in knowledge.gamma.state_dict().items())
    data = knowledge.dataset
    made = data.next_percept - knowledge.swift(data.percept, data.control).detach()
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
    place = TABLE_MODELS.imagine(knowledge, PERCEPTS, 1, seeded(0))
    lanes = start_lanes(place, torch.arange(4), 0, 0)
    for ahead, free in ((0.2, True), (1.2, False), (-3.0, False), (float("nan"), False)):
        motion = torch.tensor([ahead, 0.0, 0.0]).repeat(4, 1)
        after, done = place.step(lanes, motion)
        assert done.tolist() == [free] * 4
        assert free or torch.equal(after.percept, lanes.percept)


def test_a_seen_yaw_and_obstacles_count_in_the_models() -> None:
    """A square table of 1 m, turned by 45°, whose box is also in the way where it is not."""
    half = 0.5**0.5
    seven = [1.2 - half, 1.2 + half, -half, half, 1.2, 0.0, 0.8]
    turned, behind, none = [0.0, 1.0], [-1.0, -0.5, -0.2, 0.2], [0.0] * 4
    possible = TABLE_MODELS.possible
    forwards, aside, back = [0.6, 0.0, 0.0], [0.2, 0.9, 0.0], [-0.4, 0.0, 0.0]
    for extra, free in (
        ([], [False, False, True]),
        (turned, [False, True, True]),
        (turned + behind, [False, True, False]),
        (turned + none, [False, True, True]),
    ):
        percept = torch.tensor([seven + extra]).repeat(3, 1)
        assert possible(percept, torch.tensor([forwards, aside, back])).tolist() == free


def test_with_few_data_nearly_all_fresh_transitions_are_within_them(knowledge: Knowledge) -> None:
    """The training data alone would say otherwise: each is a centre and not novel at all."""
    fresh = collect(Scenes(world_of), 400, 120, seeded(8))
    place = TABLE_MODELS.imagine(knowledge, PERCEPTS, 1, seeded(0))
    with torch.no_grad():
        _, novelty = place.gamma(fresh.percept, fresh.control)
    assert float((novelty <= place.most_novel).float().mean()) > 0.9


def test_a_rollout_that_leaves_the_data_fails(knowledge: Knowledge) -> None:
    """Driving back, again and again, the robot comes to where no data are."""
    place = TABLE_MODELS.imagine(knowledge, PERCEPTS, 1, seeded(0))
    lanes = start_lanes(place, torch.arange(4), 0, 0)
    back = torch.tensor([-1.2, 0.0, 0.0]).repeat(4, 1)
    lost = [place.lost(lanes)]
    for _ in range(6):
        before = lanes
        lanes, moved = place.step(lanes, back)
        lost.append(place.lost(lanes))
        assert (lost[-1] | ~lost[-2]).all()  # for good
        assert torch.equal(lanes.percept[lost[-2]], before.percept[lost[-2]])
        assert not moved[lost[-2]].any()
        assert (place.success(lanes)[1][lost[-1]] == 0).all()
    assert not lost[0].any()
    assert lost[-1].all()


def test_obstacles_that_are_not_there_are_never_imagined() -> None:
    table = Reaching(robot=BASE, tabletop="yaw", obstacles=1)
    knowledge = fitted_to(collect(Scenes(table.world, "general-clutter"), 80, 120, seeded(0)))
    percepts = first_percepts(table.world(cluttered_scenarios(12, seeded(1))))
    there = (percepts[:, 9:] != 0).any(1)
    assert 0 < int(there.sum()) < 12
    place = table.models(table).imagine(knowledge, percepts, 1, seeded(2))
    assert place.errors is not None
    assert place.errors[:, :, :9].abs().amin(2).gt(0).all()
    lanes = start_lanes(place, torch.arange(12), 0, 0)
    for _ in range(3):
        lanes, _ = place.step(lanes, torch.tensor([[0.01, 0.0, 0.2]]).repeat(12, 1))
    assert torch.equal((lanes.percept[:, 9:] != 0).any(1), there)


CARTS = Cart().world(Cart().draw("any", 5, seeded(9))).start(torch.arange(5))[1]


def test_a_domain_is_imagined_with_its_own_controls_and_errors(known: Knowledge) -> None:
    place = models_of(Cart()).imagine(known, CARTS, 2, seeded(2))
    assert isinstance(place, ModelEnvironment)
    assert (place.num_scenarios, place.percept_size, place.control_size) == (10, 4, 3)
    assert torch.equal(place.percepts, CARTS.repeat_interleave(2, 0))
    assert place.compiled is compiled_models
    assert place.errors is not None
    assert place.errors[..., WIND].abs().max() < 1e-6  # of which Γ knows all
    assert place.errors[..., PLACE].abs().max() > 1e-3
    assert place.errors[..., LAMP].abs().max() <= torch.pi


class CarefulModels(Models[Cart]):
    """It cannot be pushed back, and of its lamp and its gear Γ is believed."""

    def possible(self, percept: Tensor, control: Tensor) -> Tensor:
        return control[:, 0] >= 0

    def noisy(self, percept: Tensor) -> Tensor:
        exact = torch.ones_like(percept)
        exact[..., [LAMP, GEAR]] = 0
        return exact


class Careful(Cart):
    """One with these models."""

    models = CarefulModels


def test_what_a_domain_says_is_possible_and_noisy_counts(known: Knowledge) -> None:
    place: Any = models_of(Careful()).imagine(known, CARTS, 1, seeded(2))
    assert not place.errors[..., [LAMP, GEAR]].any()
    assert place.errors[..., PLACE].abs().mean() > 0.005
    lanes = start_lanes(place, torch.arange(5), 0, 0)
    push = torch.tensor([[0.5, 0, 0], [-0.5, 0, 0]])[[0, 1, 0, 1, 0]]
    after, done = place.step(lanes, push)
    assert done.tolist() == [True, False, True, False, True]
    assert torch.equal(after.percept[~done], lanes.percept[~done])
    assert set(after.percept[:, GEAR].tolist()) <= {0, 1, 2}


def test_what_is_imagined_is_much_like_the_world(known: Knowledge) -> None:
    place = models_of(Cart()).imagine(known, CARTS, 1, seeded(2))
    world = Cart().world(Cart().draw("any", 5, seeded(9)))
    push = torch.tensor([[0.6, -0.4, 0.0]]).expand(5, -1)
    ends = [e.step(start_lanes(e, torch.arange(5), 0, 0), push)[0].percept for e in (place, world)]
    assert float((ends[0] - ends[1])[:, PLACE].abs().mean()) < 0.5
    assert torch.allclose(ends[0][:, WIND], ends[1][:, WIND], atol=1e-5)


def test_a_skill_that_was_evolved_in_the_models_works_in_the_world(known: Knowledge) -> None:
    """The lamp is left alone, so that where it is turned back nothing can be expected."""
    domain, generator = Cart(), seeded(7)
    carts = domain.draw("any", 30, generator)
    carts = replace(carts, lamp=carts.lamp / 4, gear=carts.gear.clamp(min=1))
    percepts = domain.world(carts).start(torch.arange(30))[1]
    place = models_of(domain).imagine(known, percepts, 1, generator)
    settings = EvolutionSettings(population=80, capacity=8, initial_nodes=(3, 6))
    for generation in evolve(place, domain.actions(), settings, generator):
        if generation.number == 12:
            break
    graph, actions = generation.champion.graphs, domain.actions()
    tried = rollout(graph, actions, Rail(carts)).succeeded[0]
    at_once = Rail(carts).succeeded(percepts)
    assert int(tried.sum()) > int(at_once.sum())
    robust = robust_success(
        models_of(domain), Skill("stop", graph, actions), known, percepts, generator, 4
    )
    assert robust.shape == (30,)
    assert tried[robust].float().mean() > 0.6
