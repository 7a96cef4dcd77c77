"""A search for the best mean: what it finds, when it ends, and that it goes on to the same."""

import itertools
import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import pytest
import torch
from lottery import ACTIONS, Idle, Lottery, PaidLottery, Tickets, staking, tickets
from support import same, seeded
from watched import of_kind

from cgtorch.evolution import REWARDS, chance_of_success
from cgtorch.graphs import ActionSet, BranchingNN, Skill
from cgtorch.ground.asked import BudgetSpentError, Purse
from cgtorch.improvement import mean_search
from cgtorch.improvement.events import (
    Event,
    EvolutionRecalled,
    GenerationDone,
    MeanTested,
    SkillAccepted,
)
from cgtorch.improvement.expected import _tell, improve_expected
from cgtorch.improvement.expected_state import Spent, State
from cgtorch.improvement.pace import BY_ROLLOUT
from cgtorch.improvement.paired_race import Holder
from cgtorch.improvement.setup import Budget, Progress, Setup
from cgtorch.improvement.spread import FEWEST, Need
from cgtorch.improvement.trial import try_skill
from cgtorch.improvement.tuning import update
from cgtorch.runs.journal import FileJournal

SMALL = replace(REWARDS, population=24, initial_nodes=(1, 2), capacity=6)
NOTHING = tickets(0, seeded(0))
BEFORE: Progress[Tickets] = Progress(None, NOTHING, NOTHING, None)


class Compared(PaidLottery):
    """One whose steps count."""

    frugal = True


def setup_of(watch: Callable[[Event], Any], paid: bool = True, **others: Any) -> Setup[Tickets]:
    """A small search in the lottery, up to 30 generations."""
    evolution = SMALL if paid else replace(SMALL, fitness=chance_of_success)
    given = {"budget": Budget(30), "attempts": 1, "generator": seeded(0), "actions": ACTIONS}
    given |= others
    return Setup(
        world_of=PaidLottery if paid else Lottery,
        imagine=lambda *_: Lottery(NOTHING),
        evolution=evolution,
        max_transitions=4,
        watch=watch,
        **given,
    )


def searched(setup: Setup[Tickets], before: Progress[Tickets] = BEFORE) -> Progress[Tickets]:
    return improve_expected(setup, before, NOTHING, tickets)


def wins(skill: Skill | None) -> float:
    """The share of tickets that win."""
    assert skill is not None
    world = Lottery(tickets(20_000, seeded(99)))
    rows = torch.arange(20_000)
    state = world.first_state(rows)
    times, more = skill.graph.parameters[0, 0].tolist()
    stake = times * state[:, :1] + more
    return float(
        world.succeeded(world.next_state(state, stake, torch.arange(20_000))).float().mean()
    )


@pytest.mark.parametrize("paid", [True, False], ids=["returns", "success"])
def test_the_best_in_the_mean_is_found_and_its_mean_is_told(paid: bool) -> None:
    told: list[Event] = []
    after = searched(setup_of(told.append, paid, budget=Budget(60)))
    assert wins(after.skill) > 0.82  # of 0.9 at best, where one that stakes nothing wins 0.65
    assert after.skill is not None
    assert after.specialists is not None
    assert same(after.specialists.graphs, after.skill.graph)
    assert (len(after.solved), len(after.missed)) == (0, 0)
    means = of_kind(told, MeanTested)
    known = [each for each in means if each.tried >= 60]
    for each in known:
        assert each.mean is not None
        assert each.error is not None
        truth = (2 if paid else 1) * wins(each.skill)
        assert abs(each.mean - truth) < 5 * each.error + 0.02
    assert known
    assert [each.episodes for each in means] == sorted(each.episodes for each in means)


def test_every_generation_meets_other_scenarios_and_chance_asks_for_more() -> None:
    worlds: list[Tickets] = []

    def world(scenarios: Tickets) -> Compared:
        worlds.append(scenarios)
        return Compared(scenarios)

    told: list[Event] = []
    searched(replace(setup_of(told.append), world_of=world))
    seeds = [int(seed) for scenarios in worlds for seed in scenarios.seed]
    assert len(set(seeds)) == len(seeds)
    sizes = [each.generation.scores.shape[1] for each in of_kind(told, GenerationDone)]
    assert sizes[0] == FEWEST
    assert max(sizes) > FEWEST
    told.clear()
    searched(setup_of(told.append, budget=Budget(1)))
    (first,) = of_kind(told, GenerationDone)
    assert first.generation.scores.shape[1] == FEWEST * BY_ROLLOUT.at_once


def test_it_ends_once_the_target_is_surely_reached() -> None:
    told: list[Event] = []
    after = searched(setup_of(told.append, budget=Budget(1000, satisfied=1.6)))
    assert wins(after.skill) > 0.78
    assert len(of_kind(told, GenerationDone)) < 100
    last = of_kind(told, MeanTested)[-1]
    assert last.mean is not None
    assert last.error is not None
    assert last.mean - 2 * last.error >= 1.6


def test_it_ends_after_its_generations_and_when_the_time_is_over() -> None:
    told: list[Event] = []
    began = time.perf_counter()
    searched(setup_of(told.append, budget=Budget(2), attempts=2))
    assert len(of_kind(told, GenerationDone)) == 4
    seconds = [each.seconds for each in of_kind(told, GenerationDone)]
    assert min(seconds) > 0
    assert sum(seconds) < time.perf_counter() - began
    late, settled = Purse(until=time.monotonic()), list[bool]()
    told.clear()

    def watch(event: Event) -> None:
        told.append(event)
        if isinstance(event, GenerationDone | SkillAccepted):
            settled.append(late.settled)

    assert searched(setup_of(watch, purse=late)).skill is not None
    assert settled == [False, True]  # from then on no alarm interrupts it
    assert len(of_kind(told, GenerationDone)) == 1


def test_nothing_is_tuned_after_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    tuned = list[int]()

    def counted(*about: Any) -> Any:
        tuned.append(1)
        return update(*about)

    monkeypatch.setattr(mean_search, "update", counted)
    searched(setup_of(ignored, budget=Budget(1)))
    assert len(tuned) > 1
    tuned.clear()
    searched(setup_of(ignored, budget=Budget(1), purse=Purse(until=time.monotonic())))
    assert len(tuned) <= 1


def ignored(event: Event) -> None:
    """Nobody watches."""


def test_what_is_found_is_told_with_its_result_on_the_tests() -> None:
    told: list[Event] = []
    setup, tests = setup_of(told.append, budget=Budget(1)), tickets(30, seeded(5))
    began = time.perf_counter()
    after = improve_expected(setup, BEFORE, tests, tickets)
    (accepted,) = of_kind(told, SkillAccepted)
    (done,) = of_kind(told, GenerationDone)
    assert after.skill is accepted.skill
    assert after.skill is not None
    assert (accepted.stage, accepted.skill.name, accepted.parent) == (setup.name,) * 2 + (None,)
    assert after.specialists is not None
    assert same(after.specialists.graphs, after.skill.graph)
    trial = try_skill(after.skill, PaidLottery(tests))
    assert torch.equal(accepted.succeeded, trial.succeeded)
    assert (accepted.keep.any(), accepted.targets.all()) == (False, True)
    assert 0 < done.seconds <= accepted.seconds < time.perf_counter() - began
    assert (done.limit, done.size_w) == (1, 0)
    assert done.size_m == done.generation.scores.shape[1]
    first, *later = of_kind(told, MeanTested)
    assert first.new
    assert first.tried >= BY_ROLLOUT.known
    assert [each.new for each in later] == [
        one.skill is not two.skill for one, two in itertools.pairwise([first, *later])
    ]
    assert [each.episodes for each in later] == sorted(each.episodes for each in later)
    told.clear()
    named = replace(BEFORE, skill=staking(-1.0, name="earlier"), specialists=after.specialists)
    again = improve_expected(setup, named, NOTHING, tickets)
    for accepted in of_kind(told, SkillAccepted):
        assert accepted.parent == "earlier"
        assert len(accepted.succeeded) == 0
    assert (again.skill is named.skill) is (not of_kind(told, SkillAccepted))


@pytest.mark.hostile
def test_an_earlier_skill_stays_unless_another_is_better() -> None:
    best = staking(1.0, name="earlier")
    told: list[Event] = []
    after = searched(setup_of(told.append), replace(BEFORE, skill=best))
    assert wins(after.skill) > 0.89
    worse = replace(BEFORE, skill=staking(-1.0, name="earlier"))
    setups = [setup_of(told.append, generator=seeded(seed)) for seed in range(3)]
    assert median(wins(searched(setup, worse).skill) for setup in setups) > 0.8


@pytest.mark.parametrize("number", [1, 2, pytest.param(20, marks=pytest.mark.hostile)])
@pytest.mark.parametrize("skill", [None, staking(0.2, name="earlier")], ids=["new", "earlier"])
def test_it_is_the_same_after_an_interruption(
    number: int, skill: Skill | None, tmp_path: Path
) -> None:
    """With all that was held, beaten and tuned until then."""
    before, whole = replace(BEFORE, skill=skill), list[Event]()
    few: dict[str, Any] = {"budget": Budget(number + 5)}
    if skill is None:  # what stalls is split
        few["actions"] = ACTIONS.extended(["Branch"], [BranchingNN(2)])
    wanted = searched(setup_of(whole.append, **few), before)
    met, again = 0, list[Event]()

    def stop(event: Event) -> None:
        nonlocal met
        met += isinstance(event, GenerationDone)
        if met == number:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), FileJournal(tmp_path, seconds=0) as journal:
        searched(setup_of(stop, journal=journal, **few), before)
    with FileJournal(tmp_path) as journal:
        found = searched(setup_of(again.append, journal=journal, **few), before)
    assert found.skill is not None
    assert wanted.skill is not None
    assert same(found.skill.graph, wanted.skill.graph)
    (recalled,) = of_kind(again, EvolutionRecalled)
    assert recalled.found.generations == number - 1
    assert (recalled.found.best, recalled.found.since) == (-torch.inf, 0)
    rest = of_kind(whole, GenerationDone)[number - 1 :]
    own = of_kind(again, GenerationDone)
    assert [e.generation.best for e in own] == [e.generation.best for e in rest]
    last = [of_kind(events, MeanTested)[-1] for events in (whole, again)]
    assert replace(last[0], skill=last[1].skill) == last[1]


def test_a_mean_is_told_if_it_is_another_ones_or_better_known() -> None:
    told: list[Event] = []
    setup, first = setup_of(told.append), Holder(staking(1.0)).met(torch.tensor([1.0, 2.0]))
    later, other = first.met(torch.tensor([3.0])), Holder(staking(0.5), math.inf, 0.0, 1)
    state = State(need=Need(7), spent=Spent(episodes=40))
    for holder, before, new in (
        (None, None, None),
        (Holder(staking(1.0)), None, None),
        (first, first, None),
        (first, None, True),
        (later, first, False),
        (other, first, True),
    ):
        told.clear()
        _tell(setup, replace(state, holder=holder), before)
        assert [event.new for event in of_kind(told, MeanTested)] == [new] * (new is not None)
    (event,) = of_kind(told, MeanTested)
    assert (event.mean, event.error, event.tried) == (None, None, 1)
    assert (event.scenarios, event.episodes) == (7, 40)
    told.clear()
    _tell(setup, replace(state, holder=first), None)
    (event,) = of_kind(told, MeanTested)
    assert (event.mean, event.error) == (1.5, 0.5)


def test_an_earlier_skill_of_other_actions_becomes_no_seed() -> None:
    other = replace(staking(1.0, name="earlier"), actions=ACTIONS.extended(["More"], [Idle()]))
    before = replace(BEFORE, skill=other)
    after = searched(setup_of(ignored, budget=Budget(1)), before)
    assert after.skill is other
    assert after.specialists is None


def test_a_generation_in_which_the_time_ends_is_told_too() -> None:
    told: list[Event] = []

    def watch(event: Event) -> None:
        told.append(event)
        if isinstance(event, MeanTested):
            raise BudgetSpentError("the time is over")

    assert searched(setup_of(watch)).skill is not None
    assert len(of_kind(told, GenerationDone)) == 1


def test_who_finishes_no_episode_is_no_skill() -> None:
    told: list[Event] = []
    nothing = ActionSet(("Idle",), (Idle(),))
    nobody = replace(setup_of(told.append, budget=Budget(3)), actions=nothing)
    assert searched(nobody) == BEFORE
    assert not of_kind(told, MeanTested)
