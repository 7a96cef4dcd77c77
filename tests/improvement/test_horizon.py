"""The horizon is the shortest by which samples that are worth almost as much are selected."""

from math import inf

import pytest
import torch
from lottery import ACTIONS as LOTTERY
from lottery import Lottery, staking, tickets
from support import seeded
from torch import Generator
from walking import RewardedPath, chain, walking_actions, walks

from cgtorch.evolution.fitness import WORST
from cgtorch.graphs import concatenate
from cgtorch.improvement import horizon as module
from cgtorch.improvement.horizon import HORIZONS, Played, played_until, selected_gain
from cgtorch.improvement.pace import BY_ROLLOUT, BY_STEP
from cgtorch.improvement.paired_race import Fresh

COUNT = 20


def known(early: list[torch.Tensor], values: torch.Tensor, steps: torch.Tensor) -> Played:
    """What single episodes get; the return of later horizons is that of the whole episode."""
    table = torch.stack([*early, *[values] * (len(HORIZONS) - len(early))], 1)
    return Played(values[:, None], 2 * steps[:, None], steps[:, None], table[:, None])


def whole(steps: float = 1000.0) -> torch.Tensor:
    return torch.full((COUNT,), steps, dtype=torch.float64)


def test_the_gain_of_selection_is_that_of_the_weighted_better_half() -> None:
    values = torch.tensor([1.0, 5.0, 2.0, 0.0], dtype=torch.float64)
    assert selected_gain(values, values) == 1
    assert selected_gain(values.exp(), values) == 1  # as ranks alone count
    first, second = 0.8042, 0.1958  # ln 2.5 - ln 1 and ln 2.5 - ln 2, whose sum is 1
    best, chosen = first * 5 + second * 2 - 2, first * 2 + second * 5 - 2
    assert selected_gain(torch.tensor([0.0, 1, 2, 0]), values) == pytest.approx(
        chosen / best, abs=1e-3
    )
    assert selected_gain(-values, values) < 0
    assert selected_gain(values, torch.ones(4).double()) == 0  # where nothing can be gained
    assert selected_gain(torch.zeros(4), values) < 1


def test_the_horizon_is_the_shortest_from_which_on_selection_is_good() -> None:
    values = torch.randn(COUNT, generator=seeded(0)).double()
    luck = torch.randn(COUNT, generator=seeded(1)).double()
    nothing = torch.zeros(COUNT).double()
    for early, worth, wanted in (
        ([], values, HORIZONS[0]),
        ([luck, luck], values, HORIZONS[2]),
        ([luck, values, luck], values, HORIZONS[3]),
        ([values + 0.1 * luck], values, HORIZONS[0]),
        ([luck] * len(HORIZONS), values, inf),
        ([], nothing, inf),  # as nothing is known
    ):
        assert known(early, worth, whole(128)).horizon(0.0, 0.0) == wanted


def test_a_gain_that_is_just_enough_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    values = torch.randn(COUNT, generator=seeded(0)).double()
    luck = torch.randn(COUNT, generator=seeded(1)).double()
    monkeypatch.setattr(module, "KEPT", selected_gain(luck, values))
    assert known([luck], values, whole(128)).horizon(0.0, 0.0) == HORIZONS[0]


def test_of_samples_that_seem_alike_the_first_ones_are_selected() -> None:
    seen, values = torch.arange(100) % 3.0, torch.arange(100).double()
    order = sorted(range(100), key=lambda row: -float(seen[row]))
    ranks = torch.empty(100).scatter_(0, torch.tensor(order), torch.arange(100.0).flip(0))
    assert selected_gain(seen, values) == selected_gain(ranks, values)


def test_it_is_longer_than_most_episodes_that_end_early() -> None:
    values, steps = torch.randn(COUNT, generator=seeded(0)).double(), whole()
    steps[:10], steps[10:12] = 100.0, 160.0
    assert known([], values, steps).horizon(0.0, 0.0) == pytest.approx(2 * 110)
    assert known([], values, whole(128)).horizon(0.0, 0.0) == HORIZONS[0]  # as all are as long


def test_it_is_at_least_half_as_long_as_before_and_an_eighth_of_the_longest_episode() -> None:
    values = torch.randn(COUNT, generator=seeded(0)).double()
    luck = torch.randn(COUNT, generator=seeded(1)).double()
    found = known([], values, whole())
    for before, wanted in ((inf, 500), (700.0, 350), (250.0, 125), (40.0, 125)):
        assert found.horizon(before, 0.0) == wanted
    assert known([luck] * 5, values, whole()).horizon(40.0, 0.0) == HORIZONS[5]  # it may be longer


def test_a_toll_is_taken_from_early_returns_for_the_share_of_the_transitions() -> None:
    steps = torch.linspace(64, 4096, COUNT).double()
    values = steps.flip(0) + 8 * steps  # mostly lengths, which the toll of 2 · 4 takes away
    early = [8 * steps.clamp_max(horizon) + steps.flip(0) for horizon in HORIZONS]
    found = known(early, values, steps)
    free = found.horizon(0.0, 0.0)
    assert found.worth(4.0).tolist() == steps.flip(0).tolist()
    assert found.horizon(0.0, 4.0) < free
    assert found.horizon(0.0, 4.0) == 2 * float(steps[:-1].mean())


def test_a_toll_is_taken_from_early_returns_by_what_was_played_until_then() -> None:
    steps, lengths = whole(64), torch.linspace(10, 90, COUNT).double()
    shares = torch.tensor(HORIZONS).double().div(64).clamp_max(1)
    early = 8 * lengths[:, None] * shares
    found = Played(8 * lengths[:, None], lengths[:, None], steps[:, None], early[:, None])
    assert found.horizon(0.0, 4.0) == HORIZONS[0]


def walkers(place: Fresh, horizon: float) -> Played:
    actions = walking_actions()
    speeds = -20.0, 0.0, 10.0, 30.0
    graphs = concatenate([chain(actions, "Aim", "Step", speed=speed) for speed in speeds])
    return played_until(horizon, place, graphs, actions, place.world(6, seeded(3)))


def paths(count: int, generator: Generator) -> RewardedPath:
    return RewardedPath(walks(count, generator, longest=40))


def test_what_was_played_is_told_and_counted() -> None:
    place = Fresh(paths, 99, BY_STEP)
    found, short = walkers(place, inf), walkers(place, 3)
    assert found.early.shape == (4, 6, len(HORIZONS))
    assert torch.equal(found.steps, found.lengths / 2)
    assert torch.equal(found.early[..., -1], found.values)
    assert short.early.shape == (4, 6, 0)
    assert short.steps.max() == 3
    assert (short.values >= found.values).all()  # as each step costs
    assert place.executed == int(found.lengths.sum() + short.lengths.sum())
    together = walkers(Fresh(paths, 99, BY_ROLLOUT), 3)  # where steps are not what costs
    assert torch.equal(together.values, found.values)
    assert together.early.shape == (4, 6, 0)
    first, second = found.split([1, 3])
    assert torch.equal(first.early, found.early[:1])
    assert torch.equal(second.values, found.values[1:])


def test_without_rewards_success_counts_and_unfinished_episodes_are_worst() -> None:
    world = Lottery(tickets(50, seeded(0)))
    place = Fresh(lambda count, generator: world, 3, BY_STEP)
    found = played_until(2.0, place, staking(1.0).graph, LOTTERY, world)
    assert set(found.values.unique().tolist()) == {0.0, 1.0}
    idle = Fresh(paths, 1, BY_STEP)
    assert walkers(idle, inf).values.max() == pytest.approx(WORST)
