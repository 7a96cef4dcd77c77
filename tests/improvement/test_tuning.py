"""CMA-ES tunes the holder's parameters on ever more fresh scenarios."""

from dataclasses import replace

import pytest
import torch
from lottery import ACTIONS, Lottery, PaidLottery, idle, staking, tickets
from support import seeded
from torch import Generator

from cgtorch.graphs import ActionSet, Graphs, LinearNN, widened
from cgtorch.ground.environment import Environment
from cgtorch.improvement.horizon import Horizon
from cgtorch.improvement.pace import BY_ROLLOUT, BY_STEP, Pace
from cgtorch.improvement.paired_race import Fresh
from cgtorch.improvement.tuning import (
    DOUBTFUL,
    EVERY,
    FEW,
    MOST,
    MOST_FULL,
    PARTS,
    PATIENCE,
    RELATIVE,
    SAMPLES,
    SEVERAL,
    WIDER,
    WIDEST,
    Tuning,
    begun,
    calmed,
    flat,
    mainly_lengths,
    update,
    with_parameters,
)
from cgtorch.simulation import Rollouts


def fresh(paid: bool = False) -> Fresh:
    def world(count: int, generator: Generator) -> Lottery:
        return (PaidLottery if paid else Lottery)(tickets(count, generator))

    return Fresh(world, max_transitions=3)


def updated_once(
    tuning: Tuning, place: Fresh | None = None, generator: Generator | None = None
) -> tuple[Tuning, float]:
    [found] = update([tuning], ACTIONS, place or fresh(), generator or seeded(0))
    return found


def tuned(times: float, scenarios: int, updates: int) -> Tuning:
    tuning, place, generator = begun(staking(times).graph, ACTIONS, scenarios), fresh(), seeded(0)
    assert tuning is not None
    for _ in range(updates):
        tuning, _ = updated_once(tuning, place, generator)
    return tuning


def test_it_begins_at_the_graph_with_small_steps_and_not_without_parameters() -> None:
    tuning = begun(staking(0.3, 0.1).graph, ACTIONS, 7)
    assert tuning is not None
    assert tuning.scenarios == 7
    assert torch.equal(tuning.mean(ACTIONS).parameters, staking(0.3, 0.1).graph.parameters)
    first = ACTIONS.actions[0].first_step ** 2 / 2  # as there are two parameters
    assert tuning.distribution.covariance.tolist() == [
        pytest.approx([first, 0]), pytest.approx([0, first]),
    ]  # fmt: skip
    assert begun(idle().graph, ACTIONS, 7) is None


def test_first_steps_are_larger_where_parameters_are() -> None:
    tuning = begun(staking(300.0, 400.0).graph, ACTIONS, 1)
    assert tuning is not None
    mean_square = (300**2 + 400**2) / 2
    wanted = RELATIVE**2 * mean_square / 2  # as there are two parameters
    assert tuning.distribution.covariance.diagonal().tolist() == pytest.approx([wanted, wanted])


def test_the_mean_comes_near_the_best_in_spite_of_luck() -> None:
    times, more = tuned(0.0, 200, 60).mean(ACTIONS).parameters.flatten().tolist()
    assert times == pytest.approx(1, abs=0.35)
    assert more == pytest.approx(0, abs=0.2)


def test_an_update_plays_its_scenarios_and_leaves_the_graph() -> None:
    place = fresh()
    first = begun(staking(0.5).graph, ACTIONS, 11)
    assert first is not None
    second, _ = updated_once(first, place)
    assert place.episodes == SAMPLES * 11
    assert second.graph is first.graph
    assert second.distribution.updates == 1
    assert second.level == second.recent[0]
    assert 0.5 < second.level <= 1


def test_tunings_are_updated_together_on_the_scenarios_of_the_one_that_needs_most() -> None:
    place = fresh()
    few, many = begun(staking(0.5).graph, ACTIONS, 3), begun(staking(-0.5).graph, ACTIONS, 40)
    assert few is not None
    assert many is not None
    (low, _), (high, _) = update([few, many], ACTIONS, place, seeded(0))
    assert place.episodes == 2 * SAMPLES * 40
    assert (low.graph is few.graph, high.graph is many.graph) == (True, True)
    assert low.level > high.level
    alone, _ = updated_once(few)  # by the same samples, on other scenarios
    step = alone.distribution.mean - few.distribution.mean
    assert torch.dot(low.distribution.mean - few.distribution.mean, step) > 0
    two = widened(few.graph, 2)
    flipped = two.action.flip(1), two.edges.flip(1), two.parameters.flip(1), two.start + 1
    late = replace(few, graph=Graphs(*flipped))  # whose node is in the second slot
    for tuning, _ in update([few, late], ACTIONS, fresh(), seeded(0)):
        assert 0.5 < tuning.level <= 1


class Indifferent(Fresh):
    """Only samples beyond a distance differ in what they get."""

    def runs(self, graphs: Graphs, actions: ActionSet, world: Environment) -> Rollouts:
        found = super().runs(graphs, actions, world)
        far = graphs.parameters[:, 0].abs().amax(1) > 1000
        return replace(found, succeeded=found.succeeded & far[:, None])


def wide_tuning(pace: Pace) -> tuple[Tuning, ActionSet, Fresh]:
    """A tuning of one parameter more than those of which covariances are learned."""
    actions = ActionSet(("Linear", *ACTIONS.names), (LinearNN(2, 22), *ACTIONS.actions))
    graph = Graphs(
        torch.zeros(1, 1).long(), torch.full((1, 1, 2), -1), torch.zeros(1, 1, 66),
        torch.zeros(1).long(),
    )  # fmt: skip
    found = begun(graph, actions, 2)
    assert found is not None
    assert len(found.distribution.mean) == 66 > MOST_FULL
    return found, actions, replace(fresh(), pace=pace)


@pytest.mark.parametrize(("pace", "parts"), [(BY_STEP, PARTS), (BY_ROLLOUT, 1)])
def test_an_update_of_many_parameters_is_divided_where_steps_count(pace: Pace, parts: int) -> None:
    tuning, actions, place = wide_tuning(pace)
    assert tuning.apart
    [(after, _)] = update([tuning], actions, place, seeded(0))
    assert place.episodes == 2 * parts * (SAMPLES // parts)
    assert len(after.recent) == parts
    assert after.distribution.updates == 1
    few = begun(staking(0.5).graph, ACTIONS, 2)
    assert few is not None
    assert not few.apart


def test_half_updates_count_as_halves() -> None:
    tuning, actions, place = wide_tuning(BY_STEP)
    tuning = replace(tuning, horizon=Horizon(3.0))
    [(after, _)] = update([tuning], actions, place, seeded(0))
    assert after.horizon.updates == 1


def test_steps_grow_on_a_plateau_up_to_a_limit() -> None:
    place = Indifferent(fresh().world, max_transitions=3)
    tuning = begun(staking(0.5).graph, ACTIONS, SEVERAL)
    assert tuning is not None
    usual, _ = updated_once(tuning, fresh())
    after, _ = updated_once(tuning, place)
    assert after.distribution.step > 0.8 * WIDER
    assert after.distribution.step > usual.distribution.step
    for _ in range(60):
        after, _ = updated_once(after, place)
        assert after.distribution.step <= WIDEST
    assert after.distribution.step * float(after.distribution.covariance[0, 0]) ** 0.5 > 100


def test_a_plateau_is_where_a_quarter_of_samples_is_the_best_on_every_scenario() -> None:
    values = torch.arange(20.0)[:, None] * torch.ones(1, SEVERAL)
    assert not flat(values)
    values[16:] = 19.0
    assert not flat(values)  # as these are four of twenty
    values[15] = 19.0
    assert flat(values)
    values[15, 0], values[15, 1] = 20.0, 18.0
    assert not flat(values)  # as its mean alone is that of the best
    few = torch.tensor([[1.0] * (SEVERAL - 1)] * 19 + [[0.0] * (SEVERAL - 1)])
    assert not flat(few)  # which may be luck
    assert flat(torch.ones(20, 1))


def test_luck_asks_for_more_scenarios_up_to_a_limit_and_never_for_fewer() -> None:
    assert tuned(0.5, 4, 10).scenarios > 8
    assert tuned(0.5, 1, 10).scenarios == 1  # as a single scenario tells nothing of luck
    wide = begun(staking(0.5).graph, ACTIONS, 2000)
    assert wide is not None
    known = updated_once(wide)[0]
    assert (known.scenarios, known.reliability > wide.reliability) == (2000, True)
    few = begun(staking(0.5).graph, ACTIONS, 4)
    assert few is not None
    for seed in range(20):
        [(few, _)] = update([few], ACTIONS, fresh(), seeded(seed), 6)
    assert few.scenarios == 6


def test_after_lost_races_there_are_twice_as_many_scenarios_until_that_is_no_use() -> None:
    tuning = begun(staking(0.5).graph, ACTIONS, 600)
    assert tuning is not None
    tuning = replace(tuning, mark=1.0, recent=(1.0,))
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
    small = replace(tuning, distribution=replace(tuning.distribution, step=0.01))
    assert small.more() is not None
    assert replace(small, reliability=0.9).more() is None
    assert replace(tuning, reliability=0.9).more() is not None


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
    after, worth = updated_once(tuning, place)
    assert after.distribution.mean.isfinite().all()
    assert worth == 0


def test_it_goes_on_while_its_samples_become_better() -> None:
    tuning = begun(staking(0.5).graph, ACTIONS, 600)
    assert tuning is not None
    stalled = replace(tuning, lost=PATIENCE, mark=10.0)
    better = replace(stalled, recent=(11.5, 12.5)).more()
    assert better is not None
    assert (better.scenarios, better.mark, better.lost) == (600, 12, 0)
    same = replace(stalled, recent=(10.5,)).more()
    assert same is not None
    assert (same.scenarios, same.mark) == (1200, 10.5)
    first = replace(stalled, mark=-torch.inf, recent=(-5.0,)).more()
    assert first is not None
    assert (first.scenarios, first.mark) == (600, -5)


def test_it_is_preferred_until_it_has_lost_races_in_a_row() -> None:
    tuning = begun(staking(0.5).graph, ACTIONS, 1)
    assert tuning is not None
    for _ in range(DOUBTFUL):
        assert tuning.winning
        tuning = tuning.raced(False)
    assert not tuning.winning
    assert tuning.raced(True).winning


class Lengthy(Fresh):
    """Episodes take the longer, the larger the first parameter is."""

    def runs(self, graphs: Graphs, actions: ActionSet, world: Environment) -> Rollouts:
        found = super().runs(graphs, actions, world)
        longer = found.transitions + 10 * (1 + graphs.parameters[:, 0, :1])
        return replace(found, transitions=longer)


def test_a_toll_changes_what_is_best_and_not_what_is_told() -> None:
    usual = begun(staking(1.0).graph, ACTIONS, 50)
    assert usual is not None
    place = Lengthy(fresh().world, max_transitions=3)
    free, _ = updated_once(usual, place)
    after, _ = updated_once(replace(usual, toll=3.0), place)
    assert after.toll == 3
    assert after.recent == free.recent
    assert after.distribution.mean[0] < free.distribution.mean[0] - 0.1


def test_values_that_are_mainly_lengths_are_told() -> None:
    lengths = torch.tensor([[10, 20], [30, 60], [15, 5]])
    luck = torch.tensor([[1.0, -1.0], [3.0, 2.0], [-3.0, -2.0]])
    for unit in (1.0, 1e-6):
        assert mainly_lengths(unit * (2.0 * lengths + 5 * luck), lengths)
    assert not mainly_lengths(2.0 * lengths, lengths)  # nothing else would be left
    assert not mainly_lengths(-2.0 * lengths + luck, lengths)
    assert not mainly_lengths(luck, torch.full((3, 2), 7))
    assert not mainly_lengths(100 * luck + lengths, lengths)


def test_the_mean_moves_to_a_better_graph_of_the_same_nodes() -> None:
    tuning = tuned(0.5, 2, 3).raced(False).seen(1.0)
    moved = tuning.moved(staking(0.7, 0.2).graph, ACTIONS)
    assert moved.distribution.mean.tolist() == pytest.approx([0.7, 0.2])
    assert (moved.lost, moved.trail) == (0, ())
    assert torch.equal(moved.distribution.covariance, tuning.distribution.covariance)
    stays = tuning.moved(tuning.mean(ACTIONS), ACTIONS)
    assert stays.distribution is tuning.distribution  # not rounded
    assert (stays.lost, stays.trail) == (0, (1.0,))


def test_a_graph_fits_if_it_differs_in_parameters_and_unused_slots_only() -> None:
    tuning = tuned(0.5, 2, 3)
    other = staking(0.7, 0.2).graph
    assert tuning.fits(other)
    assert tuning.fits(widened(other, 5))
    assert not tuning.fits(idle().graph)
    for name, value in (("edges", 0), ("action", 1)):
        changed = replace(other, **{name: torch.full_like(getattr(other, name), value)})
        assert not tuning.fits(changed)
    assert tuning.distance(tuning.mean(ACTIONS), ACTIONS) == 0
    mean = tuning.distribution.mean
    far = float((mean - torch.tensor([0.7, 0.2])).norm())
    assert tuning.distance(other, ACTIONS) == pytest.approx(far)


def test_random_graphs_of_many_parameters_begin_without() -> None:
    few = staking(0.3, 0.1).graph
    assert calmed(few, ACTIONS) is few
    network = ActionSet(("Linear",), (LinearNN(FEW, 1),))
    graph = replace(few, action=torch.zeros(1, 1).long(), parameters=torch.ones(1, 1, FEW + 1))
    assert not calmed(graph, network).parameters.any()
