"""CMA-ES tunes the holder's parameters on ever more fresh scenarios."""

from dataclasses import replace

import pytest
import torch
from lottery import ACTIONS, Lottery, PaidLottery, idle, staking, tickets
from support import seeded
from torch import Generator

from cgtorch.improvement.paired_race import Fresh
from cgtorch.improvement.tuning import (
    CAREFUL,
    EVERY,
    LONG,
    MOST,
    PATIENCE,
    Tuning,
    begun,
    update,
    with_parameters,
)


def fresh(paid: bool = False) -> Fresh:
    def world(count: int, generator: Generator) -> Lottery:
        return (PaidLottery if paid else Lottery)(tickets(count, generator))

    return Fresh(world, max_transitions=3)


def tuned(times: float, scenarios: int, updates: int) -> Tuning:
    tuning, place, generator = begun(staking(times).graph, ACTIONS, scenarios), fresh(), seeded(0)
    assert tuning is not None
    for _ in range(updates):
        tuning = update(tuning, ACTIONS, place, generator)
    return tuning


def test_it_begins_at_the_graph_with_small_steps_and_not_without_parameters() -> None:
    tuning = begun(staking(0.3, 0.1).graph, ACTIONS, 7)
    assert tuning is not None
    assert tuning.scenarios == 7
    assert torch.equal(tuning.mean(ACTIONS).parameters, staking(0.3, 0.1).graph.parameters)
    first = CAREFUL * ACTIONS.actions[0].first_step
    assert tuning.distribution.covariance.tolist() == [[first**2, 0], [0, first**2]]
    assert begun(idle().graph, ACTIONS, 7) is None


def test_the_mean_comes_near_the_best_in_spite_of_luck() -> None:
    times, more = tuned(0.0, 200, 60).mean(ACTIONS).parameters.flatten().tolist()
    assert times == pytest.approx(1, abs=0.35)
    assert more == pytest.approx(0, abs=0.2)


def test_an_update_plays_its_scenarios_and_leaves_the_graph() -> None:
    place = fresh()
    first = begun(staking(0.5).graph, ACTIONS, 11)
    assert first is not None
    second = update(first, ACTIONS, place, seeded(0))
    assert place.episodes % 11 == 0
    assert place.episodes > 4 * 11
    assert second.graph is first.graph
    assert second.distribution.updates == 1


def test_reliable_is_whether_samples_could_be_told_apart() -> None:
    assert not tuned(0.5, 4, 1).reliable
    wide = begun(staking(0.5).graph, ACTIONS, 2000)
    assert wide is not None
    assert update(wide, ACTIONS, fresh(), seeded(0)).reliable


def test_after_lost_races_there_are_twice_as_many_scenarios_until_that_is_no_use() -> None:
    tuning = begun(staking(0.5).graph, ACTIONS, 600)
    assert tuning is not None
    for _ in range(PATIENCE - 1):
        tuning = tuning.raced(False)
        assert not tuning.stalled
    assert not tuning.raced(True).raced(False).stalled  # as a race was won in between
    tuning = tuning.raced(False)
    assert tuning.stalled
    more = tuning.more()
    assert more is not None
    assert (more.scenarios, more.stalled) == (1200, False)
    last = more.more()
    assert last is not None
    assert last.scenarios == MOST
    assert last.more() is None
    known = replace(tuning, reliable=True).more()
    assert known is not None
    assert (known.scenarios, known.stalled) == (600, False)
    long = replace(tuning.distribution, updates=LONG)
    assert replace(tuning, reliable=True, distribution=long).more() is None


def test_races_come_after_some_updates() -> None:
    due = [tuned(0.5, 2, updates).due for updates in range(1, 2 * EVERY + 1)]
    assert [number + 1 for number, each in enumerate(due) if each] == [EVERY, 2 * EVERY]


def test_parameters_take_their_places() -> None:
    where = torch.tensor([[False, True]])
    graphs = with_parameters(staking(3.0, 4.0).graph, where, torch.tensor([[5.0], [6.0]]))
    assert graphs.parameters.tolist() == [[[3, 5]], [[3, 6]]]


def test_unfinished_episodes_are_the_worst_and_do_no_harm() -> None:
    tuning = begun(staking(0.5).graph, ACTIONS, 3)
    assert tuning is not None
    place = replace(fresh(paid=True), max_transitions=0)
    after = update(tuning, ACTIONS, place, seeded(0))
    assert after.distribution.mean.isfinite().all()
