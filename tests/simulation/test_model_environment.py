"""Lanes that the models have lost track of: they neither move nor succeed any more."""

from dataclasses import replace

import torch
from support import model, random_graphs
from torch import Tensor

from cgtorch.ground.environment import start_lanes
from cgtorch.simulation import ModelEnvironment, rollout
from cgtorch.tabletop.actions import paper_actions


def losing(count: int, seed: int = 0) -> ModelEnvironment:
    """Motions to the left are unheard of."""
    place = model(seed, count)
    simple = place.gamma

    def gamma(percept: Tensor, control: Tensor) -> tuple[Tensor, Tensor]:
        return simple(percept, control)[0], (control[:, 1] > 0.2).float()

    return ModelEnvironment(
        place.percepts, gamma, place.classifier, place.possible, errors=place.errors, most_novel=0.5
    )


def test_what_loses_a_lane() -> None:
    place = losing(1)
    edge = float(place.percepts[0, 0])
    for control, moved, lost in (
        ([0.1, 0.0, 0.3], True, False),
        ([0.1, 0.3, 0.3], True, True),  # novel
        ([edge - 0.1, 0.0, 0.0], False, False),  # blocked
        ([edge - 0.1, 0.3, 0.0], False, False),  # blocked, so it is not made
        ([float("nan"), 0.3, 0.0], False, False),
    ):
        lanes = start_lanes(place, torch.tensor([0]), 0, 0)
        after, done = place.step(lanes, torch.tensor([control]))
        assert (bool(done), bool(place.lost(after))) == (moved, lost)
        assert bool(place.success(after)[1] == 0) == lost
        again, done = place.step(after, torch.tensor([[0.1, 0.0, 0.0]]))
        assert bool(done) != lost
        assert torch.equal(again.percept, after.percept) == lost


def test_no_lane_succeeds_once_lost_and_most_do_not_get_lost() -> None:
    actions = paper_actions()
    graphs = random_graphs(3, 300, actions)
    place, careless = losing(6), model(0, 6)
    runs, before = (rollout(graphs, actions, p) for p in (place, careless))
    lost = runs.state[..., 1] > 0
    assert lost.any()
    assert not (runs.succeeded & lost).any()
    assert (before.succeeded & lost).any()
    same = ~lost
    assert torch.equal(runs.succeeded[same], before.succeeded[same])
    assert torch.equal(runs.percept[same], before.percept[same])
    assert torch.equal(runs.transitions[same], before.transitions[same])


def test_a_lane_is_lost_or_not_whatever_runs_beside_it() -> None:
    actions = paper_actions()
    graphs = random_graphs(4, 40, actions)
    place = losing(5)
    whole = rollout(graphs, actions, place)
    for i in range(5):
        alone = rollout(graphs[7:8], actions, place, scenarios=torch.tensor([i]))
        assert torch.equal(alone.state[0, 0], whole.state[7, i])
        assert torch.equal(alone.succeeded[0, 0], whole.succeeded[7, i])
    lanes = start_lanes(place, torch.arange(5), 0, 0)
    assert not place.lost(replace(lanes, state=lanes.state + torch.tensor([3.0, 0.0, 0.0]))).any()


def test_what_is_far_from_all_data_is_lost_unless_one_says_otherwise() -> None:
    """By default, whatever the domain: Γ's novelty tends to 1 away from its data."""
    percepts = torch.zeros(4, 2)

    def gamma(percept: Tensor, control: Tensor) -> tuple[Tensor, Tensor]:
        return percept + control, control[:, 0]

    def lost(**settings: float) -> list[bool]:
        place = ModelEnvironment(percepts, gamma, lambda p: p[:, 0], control_size=2, **settings)
        control = torch.tensor([[0.0, 0], [0.7, 0], [0.8, 0], [0.999, 0]])
        lanes, _ = place.step(start_lanes(place, torch.arange(4), 2, 0), control)
        return [bool(x) for x in place.lost(lanes)]

    assert lost() == [False, False, True, True]
    assert lost(most_novel=1.0) == [False] * 4
