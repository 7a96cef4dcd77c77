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
from cgtorch.improvement.horizon import (
    HORIZONS,
    KEPT,
    USUAL,
    Horizon,
    Played,
    played_until,
    selection_gain,
)
from cgtorch.improvement.pace import BY_ROLLOUT, BY_STEP
from cgtorch.improvement.paired_race import Fresh

COUNT = 20


def known(early: list[torch.Tensor], values: torch.Tensor, steps: torch.Tensor) -> Played:
    """What single episodes get; the return of later horizons is that of the whole episode."""
    table = torch.stack([*early, *[values] * (len(HORIZONS) + 1 - len(early))], 1)
    return Played(values[:, None], 2 * steps[:, None], steps[:, None], table[:, None])


def whole(steps: float = 1000.0) -> torch.Tensor:
    return torch.full((COUNT,), steps, dtype=torch.float64)


def chosen(played: Played, before: float = 0.0, toll: float = 0.0, gain: float = 0.0) -> float:
    return Horizon(before, gain=gain).chosen(played, toll).steps


VALUES = torch.randn(COUNT, generator=seeded(0)).double()
LUCK = torch.randn(COUNT, generator=seeded(1)).double()


def test_the_gain_of_selection_is_that_of_the_weighted_better_half() -> None:
    values = torch.tensor([1.0, 5.0, 2.0, 0.0], dtype=torch.float64)
    first, second = 0.8042, 0.1958  # ln 2.5 - ln 1 and ln 2.5 - ln 2, whose sum is 1
    best, less = first * 5 + second * 2 - 2, first * 2 + second * 5 - 2
    assert selection_gain(values, values) == pytest.approx(best, abs=1e-3)
    assert selection_gain(values.exp(), values) == selection_gain(values, values)  # ranks count
    assert selection_gain(torch.tensor([0.0, 1, 2, 0]), values) == pytest.approx(less, abs=1e-3)
    assert selection_gain(-values, values) < 0


def test_the_horizon_is_the_shortest_from_which_on_selection_is_good() -> None:
    nothing = torch.zeros(COUNT).double()
    for early, worth, wanted in (
        ([], VALUES, HORIZONS[0]),
        ([LUCK, LUCK], VALUES, HORIZONS[2]),
        ([LUCK, VALUES, LUCK], VALUES, HORIZONS[3]),
        ([VALUES + 0.1 * LUCK], VALUES, HORIZONS[0]),
        ([LUCK] * len(HORIZONS), VALUES, inf),
        ([], nothing, inf),  # as nothing is known
        ([LUCK, LUCK], 1e-3 * VALUES, HORIZONS[2]),  # in whatever unit
    ):
        assert chosen(known(early, worth, whole(128))) == wanted


@pytest.mark.parametrize(("more", "wanted"), [(1e-9, HORIZONS[1]), (-1e-9, HORIZONS[0])])
def test_a_share_of_the_gain_is_enough(
    monkeypatch: pytest.MonkeyPatch, more: float, wanted: float
) -> None:
    share = selection_gain(LUCK, VALUES) / selection_gain(VALUES, VALUES)
    monkeypatch.setattr(module, "KEPT", share + more)
    assert chosen(known([LUCK], VALUES, whole(128))) == wanted


def test_what_is_lost_counts_in_units_of_the_usual_gain() -> None:
    played = known([LUCK, LUCK], VALUES, whole(128))
    most = selection_gain(VALUES, VALUES)
    lost = most - selection_gain(LUCK, VALUES)
    enough = lost / (1 - KEPT) / USUAL
    assert chosen(played, gain=1.01 * enough) == HORIZONS[0]
    assert chosen(played, gain=0.99 * enough) == HORIZONS[2]
    assert Horizon(16.0, gain=100.0).chosen(played, 0.0).gain == pytest.approx(USUAL * 100)
    assert Horizon(16.0, gain=0.1 * most).chosen(played, 0.0).gain == pytest.approx(most)
    alike = known([LUCK], torch.zeros(COUNT).double(), whole(128))
    assert chosen(alike, gain=1.0) == HORIZONS[0]  # as there is nothing to lose


def test_of_samples_that_seem_alike_the_first_ones_are_selected() -> None:
    seen, values = torch.arange(100) % 3.0, torch.arange(100).double()
    order = sorted(range(100), key=lambda row: -float(seen[row]))
    ranks = torch.empty(100).scatter_(0, torch.tensor(order), torch.arange(100.0).flip(0))
    assert selection_gain(seen, values) == selection_gain(ranks, values)


def test_while_most_samples_end_early_it_is_longer_than_these() -> None:
    steps = whole()
    steps[:10], steps[10:18] = 100.0, 160.0
    early = float(steps[:18].mean())
    assert float(steps.mean()) < 250
    assert chosen(known([], VALUES, steps)) == pytest.approx(2 * early)
    steps[16:18] = 1000.0
    assert float(steps.mean()) > 250
    assert chosen(known([], VALUES, steps)) == 62.5  # as many live for long
    early = float(steps[:16].mean())
    assert chosen(known([], VALUES, steps), toll=1e-9) == pytest.approx(2 * early)
    assert chosen(known([], VALUES, whole(128))) == HORIZONS[0]  # as all are as long
    one = whole()
    one[0] = 100.0
    assert chosen(known([], VALUES, one), toll=1e-9) == 200


def test_it_is_at_least_half_as_long_as_before_and_a_sixteenth_of_the_longest_episode() -> None:
    found = known([], VALUES, whole())
    for before, wanted in ((inf, 500), (700.0, 350), (250.0, 125), (40.0, 62.5)):
        assert chosen(found, before) == wanted
    assert chosen(known([LUCK] * 5, VALUES, whole()), 40.0) == HORIZONS[5]  # it may be longer


def test_there_are_as_many_starts_as_a_quarter_of_an_episode_pays_for() -> None:
    for steps, before, starts in ((1000.0, 40.0, 4), (1000.0, 500.0, 1), (1000.0, 250.0, 2)):
        found = Horizon(before).chosen(known([], VALUES, whole(steps)), 0.0)
        assert (found.starts, found.cost) == (starts, steps)
    some = whole(16.0)
    some[:3] = 4096.0
    found = Horizon(1.0).chosen(known([], VALUES, some), 0.0)
    assert found.starts == 1  # as most are short
    assert Horizon(1.0).chosen(known([], VALUES, whole(8000.0)), 0.0).starts == 4
    assert Horizon(starts=3).chosen(known([], VALUES, whole()), 0.0).starts == 1


def test_whole_episodes_come_once_others_have_cost_as_much_and_after_some_updates() -> None:
    short = known([], VALUES, whole(30.0))
    horizon = Horizon(30.0, cost=100.0)
    assert Horizon().whole
    seen = []
    for _ in range(6):
        seen.append(horizon.whole)
        horizon = horizon.truncated(short, alike=False, share=1.0)
    assert seen == [False] * 4 + [True] * 2
    dear = Horizon(30.0, cost=175.0)
    for _ in range(12):  # each of which is half of an update
        assert not dear.whole
        dear = dear.truncated(short, alike=False, share=0.5)
    assert (dear.updates, dear.since) == (6, 180)
    assert dear.whole
    after = dear.chosen(known([], VALUES, whole()), 0.0)
    assert (after.updates, after.since, after.whole) == (0, 0, False)
    told = Horizon(30.0, starts=4).truncated(short, alike=True, share=1.0)  # it is nothing
    assert (told.whole, told.starts) == (True, 1)


def test_a_toll_is_taken_from_early_returns_for_the_share_of_the_transitions() -> None:
    steps = torch.linspace(64, 4096, COUNT).double()
    values = steps.flip(0) + 8 * steps  # mostly lengths, which the toll of 2 · 4 takes away
    early = [8 * steps.clamp_max(horizon) + steps.flip(0) for horizon in HORIZONS]
    found = known(early, values, steps)
    assert found.worth(4.0).tolist() == steps.flip(0).tolist()
    assert chosen(found, toll=4.0) < chosen(found)
    assert chosen(found, toll=4.0) == 2 * float(steps[:-1].mean())


def test_a_toll_is_taken_from_early_returns_by_what_was_played_until_then() -> None:
    steps, lengths = whole(64), torch.linspace(10, 90, COUNT).double()
    shares = torch.tensor([*HORIZONS, 64]).double().div(64).clamp_max(1)
    early = 8 * lengths[:, None] * shares
    found = Played(8 * lengths[:, None], lengths[:, None], steps[:, None], early[:, None])
    assert chosen(found, toll=4.0) == HORIZONS[0]


def test_whole_episodes_are_cut_and_joined_with_others() -> None:
    steps, early = whole(), [LUCK] * (len(HORIZONS) + 1)
    steps[:5] = 20.0
    steps[4] = 0.0  # as of an episode without a step in the world
    cut = known(early, VALUES, steps).until(50.0)
    assert torch.equal(cut.values, LUCK[:, None])
    assert torch.equal(cut.steps, steps.clamp_max(50)[:, None])
    assert cut.lengths[:, 0].tolist() == pytest.approx((2 * steps.clamp_max(50)).tolist())
    assert cut.early.shape == (COUNT, 1, 0)
    unfinished = torch.full_like(VALUES, WORST)
    steps[5:8] = 50.0
    stuck = known(early, unfinished, steps).until(50.0)  # where the first five had fewer steps
    assert (stuck.values[:5] == WORST).all()
    assert torch.equal(stuck.values[5:], LUCK[5:, None])
    both = cut.beside(known([], VALUES, steps))
    assert torch.equal(both.values, torch.stack([LUCK, VALUES], 1))
    assert torch.equal(both.steps[:, 1], steps)
    assert torch.equal(both.worth(1.0), (both.values - both.lengths).mean(1))
    assert both.early.shape == (COUNT, 2, 0)


def walkers(place: Fresh, horizon: float, before: float = inf) -> Played:
    actions = walking_actions()
    speeds = -20.0, 0.0, 10.0, 30.0
    graphs = concatenate([chain(actions, "Aim", "Step", speed=speed) for speed in speeds])
    world = place.world(6, seeded(3))
    return played_until(horizon, place, graphs, actions, world, before)


def paths(count: int, generator: Generator) -> RewardedPath:
    return RewardedPath(walks(count, generator, longest=40))


def test_what_was_played_is_told_and_counted() -> None:
    place = Fresh(paths, 99, BY_STEP)
    found, short = walkers(place, inf), walkers(place, 3)
    assert found.early.shape == (4, 6, len(HORIZONS) + 1)
    assert torch.equal(found.steps, found.lengths / 2)
    assert torch.equal(found.early[..., -1], found.values)
    assert short.early.shape == (4, 6, 0)
    assert short.steps.max() == 3
    assert (short.values >= found.values).all()  # as each step costs
    assert place.executed == int(found.lengths.sum() + short.lengths.sum())
    marked = walkers(Fresh(paths, 99, BY_STEP), inf, 2.5)
    assert torch.equal(marked.until(2.5).values, short.values)  # as each step is played to its end
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
