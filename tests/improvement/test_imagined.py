"""A search in imagined episodes: few steps in the world, and the same after an interruption."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from rewarded_cart import CartModels, GivenModels, Places, RewardedCart, Track
from support import same, seeded
from torch import Generator, Tensor
from watched import of_kind

from cgtorch.evolution import REWARDS, Generation
from cgtorch.evolution.population import random_population
from cgtorch.evolution.search import derived_generator
from cgtorch.graphs import Skill, compacted
from cgtorch.ground.asked import Asked, BudgetSpentError, Purse
from cgtorch.ground.environment import Lanes, start_lanes
from cgtorch.improvement import imagined
from cgtorch.improvement.events import (
    EpisodePlayed,
    Event,
    EvolutionRecalled,
    GenerationDone,
    MeanTested,
    ModelsFitted,
    SkillAccepted,
)
from cgtorch.improvement.imagined import _ended, _founded, _recalled, improve_imagined
from cgtorch.improvement.imagined_search import SHORT, Search
from cgtorch.improvement.imagined_state import State
from cgtorch.improvement.paired_race import Holder
from cgtorch.improvement.played import OneEpisode, Steps, tried_out
from cgtorch.improvement.setup import Budget, Progress, Setup
from cgtorch.improvement.trial import try_skill
from cgtorch.runs.journal import FileJournal
from cgtorch.simulation import rollout

DOMAIN = RewardedCart()
NOTHING = DOMAIN.draw("any", 0, seeded(0))
BEFORE: Progress[Places] = Progress(None, NOTHING, NOTHING, None)
SMALL = replace(REWARDS, population=16)
LOOKS, EPISODES = CartModels.looks, len(CartModels.changes)


def setup_of(watch: Callable[[Event], Any], **others: Any) -> Setup[Places]:
    given = {
        "budget": Budget(60, satisfied=8.0), "attempts": 1, "generator": seeded(0),
        "purse": Purse(), **others,
    }  # fmt: skip
    return Setup(
        actions=DOMAIN.actions(),
        world_of=DOMAIN.world,
        imagine=lambda *_: DOMAIN.world(NOTHING),
        evolution=SMALL,
        max_transitions=500,
        watch=watch,
        **given,
    )


def draw(count: int, generator: Generator) -> Places:
    return DOMAIN.draw("any", count, generator)


def searched(
    setup: Setup[Places],
    before: Progress[Places] = BEFORE,
    kind: type[CartModels] = CartModels,
    tests: Places = NOTHING,
) -> Progress[Places]:
    return improve_imagined(setup, before, tests, draw, kind(DOMAIN))


def mean_return(skill: Skill | None) -> float:
    assert skill is not None
    world = DOMAIN.world(DOMAIN.draw("any", 200, seeded(99)))
    found = rollout(skill.graph, skill.actions, world, max_transitions=500).returns
    assert found is not None
    return float(found.mean())


@pytest.mark.parametrize("kind", [CartModels, GivenModels], ids=["learned", "given"])
def test_a_skill_is_found_within_few_steps_and_all_of_them_are_counted(
    kind: type[CartModels],
) -> None:
    told: list[Event] = []
    setup = setup_of(told.append)
    after = searched(setup, kind=kind)
    assert mean_return(after.skill) >= 8
    asked = setup.purse.total
    assert asked.motions == len(after.knowledge.steps) <= 300
    assert asked.looks == LOOKS
    episodes = of_kind(told, EpisodePlayed)
    assert asked.episodes == EPISODES + len(episodes)
    assert episodes[-1].total == asked.motions
    assert sum(each.steps for each in episodes) + EPISODES * SHORT >= asked.motions
    assert of_kind(told, ModelsFitted)[0].summary.first
    assert of_kind(told, SkillAccepted)[0].skill is after.skill
    assert after.knowledge.offered == 1


def test_it_ends_with_its_budget_and_its_time_and_keeps_a_skill() -> None:
    little = Purse({"motions": 20})
    assert searched(setup_of(lambda _: None, purse=little)) == BEFORE
    told: list[Event] = []
    late = Purse()

    def watch(event: Event) -> None:
        told.append(event)
        if isinstance(event, GenerationDone):
            late.until = time.monotonic()

    hopeless = Budget(60, satisfied=1e6)
    began = time.perf_counter()
    tests = DOMAIN.draw("any", 5, seeded(7))
    after = searched(setup_of(watch, purse=late, budget=hopeless), tests=tests)
    assert after.skill is not None
    (accepted,) = of_kind(told, SkillAccepted)
    assert accepted.skill is after.skill
    assert torch.equal(accepted.succeeded, try_skill(after.skill, DOMAIN.world(tests)).succeeded)
    assert (accepted.keep.any(), accepted.targets.all(), accepted.parent) == (False, True, None)
    assert after.specialists is not None
    assert same(after.specialists.graphs, after.skill.graph)
    (done,) = of_kind(told, GenerationDone)
    assert done.generation.number == 0
    assert 0 < done.seconds < time.perf_counter() - began
    told.clear()
    again = searched(setup_of(told.append, budget=replace(hopeless, generations=2)), after)
    before = after.knowledge.steps.percept  # nothing begins anew
    assert torch.equal(again.knowledge.steps.percept[: len(before)], before)
    assert not of_kind(told, ModelsFitted)


def test_a_generation_in_which_the_time_ends_is_told_and_no_alarm_rings_then(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def late(*about: Any) -> Any:
        raise BudgetSpentError("the time is over")

    monkeypatch.setattr(Search, "after", late)
    told: list[Event] = []
    purse = Purse()
    after = searched(setup_of(told.append, purse=purse))
    assert after.knowledge is not None
    assert after.skill is None
    assert len(of_kind(told, GenerationDone)) == 1
    assert purse.settled


@pytest.mark.parametrize("number", [1, pytest.param(7, marks=pytest.mark.hostile)])
def test_it_is_the_same_after_an_interruption(number: int, tmp_path: Path) -> None:
    whole, again, met = list[Event](), list[Event](), 0
    budget = Budget(number + 2, satisfied=1e6)  # which is never reached
    first, second = Purse(), Purse()
    wanted = searched(setup_of(whole.append, budget=budget, purse=first))
    assert len(of_kind(whole, GenerationDone)) >= number

    def stop(event: Event) -> None:
        nonlocal met
        met += isinstance(event, GenerationDone)
        if met == number:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), FileJournal(tmp_path, seconds=0) as journal:
        searched(setup_of(stop, budget=budget, journal=journal))
    with FileJournal(tmp_path) as journal:
        setup = setup_of(again.append, budget=budget, journal=journal, purse=second)
        found = searched(setup)
    (recalled,) = of_kind(again, EvolutionRecalled)
    known = recalled.found
    assert (known.best, known.since, known.generations) == (-torch.inf, 0, number - 1)
    rest = of_kind(whole, GenerationDone)[number - 1 :]
    own = of_kind(again, GenerationDone)
    assert [e.generation.best for e in own] == [e.generation.best for e in rest]
    assert found.skill is not None
    assert wanted.skill is not None
    assert same(found.skill.graph, wanted.skill.graph)
    assert torch.equal(found.knowledge.steps.after, wanted.knowledge.steps.after)
    assert first.spent == second.spent


def test_champions_of_the_world_are_told() -> None:
    told: list[Event] = []
    searched(setup_of(told.append))
    played = [e for e in of_kind(told, EpisodePlayed) if e.phase == "champions"]
    assert [e.mean for e in of_kind(told, MeanTested)] == [e.returned for e in played]


def test_another_skill_is_told_with_its_tests_and_becomes_a_seed() -> None:
    told: list[Event] = []
    setup, tests = setup_of(told.append), DOMAIN.draw("any", 4, seeded(7))
    graphs = random_population(2, setup.actions, 6, (2, 4), seeded(0)).graphs
    old, new = (Skill(name, graphs[:1], setup.actions, 50) for name in ("old", "new"))
    before, first = replace(BEFORE, skill=old), time.perf_counter()
    for skill in (None, old):
        assert _ended(setup, before, skill, tests, first) is before
    assert not told
    after = _ended(setup, before, new, tests, first)
    assert after.skill is new
    assert after.specialists is not None
    assert same(after.specialists.graphs, new.graph)
    assert len(after.specialists.strategy) == 1
    _ended(setup, BEFORE, new, NOTHING, first)
    one, other = of_kind(told, SkillAccepted)
    wanted = try_skill(new, DOMAIN.world(tests)).succeeded
    assert (one.succeeded.tolist(), one.parent) == (wanted.tolist(), "old")
    assert (one.keep.tolist(), one.targets.tolist()) == ([False] * 4, [True] * 4)
    assert (one.other_noise, len(other.succeeded), other.parent) == (None, 0, None)
    assert 0 <= one.seconds < time.perf_counter() - first


def test_islands_are_founded_with_seeds_and_go_on_from_a_generation() -> None:
    evolution = replace(SMALL, islands=2, lineages=0)
    setup = replace(setup_of(lambda _: None), evolution=evolution)
    seed = random_population(1, setup.actions, 6, (2, 4), seeded(0))
    islands = _founded(setup, seed, 7)
    assert [each.generation for each in islands] == [7, 7]
    first, second = (each.population.graphs.parameters for each in islands)
    assert not torch.equal(first, second)
    for each, other in zip(islands, _founded(setup, None, 7), strict=True):
        assert len(each.population) == evolution.population
        assert not torch.equal(each.population.graphs.action, other.population.graphs.action)


@pytest.fixture(scope="module")
def known() -> Any:
    """What is known after the first episodes."""
    search = Search(setup_of(lambda _: None), GivenModels(DOMAIN), draw)
    return search.begun(seeded(0)).known


def test_a_search_begins_with_what_earlier_rounds_have_found(known: Any) -> None:
    setup = setup_of(lambda _: None)
    seeds = random_population(1, setup.actions, 6, (2, 4), seeded(0))
    seeds = replace(seeds, graphs=compacted(seeds.graphs))
    old = Skill("old", seeds.graphs, setup.actions, 50)
    search = Search(setup, GivenModels(DOMAIN), draw)
    for skill, specialists in ((None, None), (old, seeds)):
        before = replace(BEFORE, skill=skill, knowledge=known, specialists=specialists)
        state, (island,) = _recalled(search, before, seeded(0))
        assert state.known is known
        assert state.inner.holder == (None if skill is None else Holder(skill))
        assert (state.generations, island.generation) == (0, 0)
    nodes = int(seeds.graphs.num_nodes)
    copies = (island.population.graphs.action[:, :nodes] == seeds.graphs.action[:, :nodes]).all(1)
    assert int(copies.sum()) >= SMALL.population // 2


def only_counted(
    search: Search, state: State, generation: Generation, generator: Generator
) -> tuple[State, bool]:
    """The state after a generation from which nothing follows."""
    spent = replace(state.inner.spent, generations=state.generations + 1)
    return replace(state, inner=replace(state.inner, spent=spent)), False


def test_it_has_so_many_generations_and_each_has_its_own_random_numbers(
    known: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    told, numbers, best = list[Event](), list[int](), list[list[float]]()

    def derived(generator: Generator, number: int) -> Generator:
        numbers.append(number)
        return derived_generator(generator, number)

    monkeypatch.setattr(imagined, "derived_generator", derived)
    monkeypatch.setattr(Search, "after", only_counted)
    before = replace(BEFORE, knowledge=known)
    for _ in range(2):
        told.clear()
        numbers.clear()
        setup = setup_of(told.append, budget=Budget(2, satisfied=1e6), attempts=2)
        assert searched(setup, before, GivenModels).skill is None
        done = of_kind(told, GenerationDone)
        assert [(each.generation.number, each.limit) for each in done] == [
            (0, 4), (1, 4), (2, 4), (3, 4),
        ]  # fmt: skip
        assert {(each.size_w, each.size_m) for each in done} == {
            (0, len(done[0].generation.scores[0]))
        }
        assert len(set(numbers)) == len(numbers)
        best.append([each.generation.best for each in done])
    assert best[0] == best[1]


def test_a_search_that_begins_again_does_so_once_and_its_generations_are_counted_on(
    known: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[Event] = []
    setup = setup_of(told.append, budget=Budget(3, satisfied=1e6))
    seed = compacted(random_population(1, setup.actions, 6, (2, 4), seeded(0)).graphs)

    def begins_again(search: Search, state: State, *about: Any) -> tuple[State, bool]:
        state, _ = only_counted(search, state, *about)
        return (replace(state, seed=seed) if state.generations == 1 else state), False

    monkeypatch.setattr(Search, "after", begins_again)
    searched(setup, replace(BEFORE, knowledge=known), GivenModels)
    first, again, last = (each.generation for each in of_kind(told, GenerationDone))
    assert [first.number, again.number, last.number] == [0, 1, 2]
    nodes = int(seed.num_nodes)
    copies = (again.population.graphs.action[:, :nodes] == seed.action[0, :nodes]).all(1)
    assert int(copies.sum()) >= SMALL.population // 2
    assert [each.distinct_parents > 0 for each in (first, again, last)] == [False, False, True]


def test_what_is_not_carried_out_costs_nothing_and_is_no_step() -> None:
    purse = Purse()
    episode = OneEpisode(DOMAIN.world(Places(torch.tensor([0.95]))), purse, "trials", 9, 30)
    lanes = start_lanes(episode, torch.arange(1), 0, 0)
    lanes, done = episode.step(lanes, torch.full((1, 1), torch.nan))
    assert (done.tolist(), purse.total.motions) == ([False], 0)
    lanes, done = episode.step(lanes, torch.ones(1, 1))
    assert (done.tolist(), purse.total.motions) == ([True], 1)
    assert float(episode.returns(lanes)) == 19
    episode.step(lanes, torch.ones(1, 1))
    assert purse.total.motions == 1  # as it is over
    (second,) = episode.steps
    assert second.rows(torch.tensor([True])).reward.tolist() == [19]
    assert (
        Steps.joined([second, second.rows(torch.zeros(2, dtype=torch.long))]).ended.tolist()
        == [True] * 3
    )


class Clock(Track):
    """A track that remembers the numbers of its steps."""

    def step(self, lanes: Lanes, control: torch.Tensor) -> tuple[Lanes, torch.Tensor]:
        self.met = [*getattr(self, "met", []), int(lanes.step)]
        return super().step(lanes, control)


def test_the_steps_of_random_controls_are_numbered_as_those_of_a_skill() -> None:
    track = Clock(Places(torch.tensor([-5.0])))
    episode = OneEpisode(track, Purse(), "trials", 4, 30)
    tried_out(episode, lambda *_: torch.ones(1, 1), 0.5, seeded(0))
    assert track.met == [0, 1, 2, 3]


def test_random_controls_are_drawn_at_what_is_perceived() -> None:
    track, seen = Track(Places(torch.tensor([-5.0]))), list[float]()

    def draw(percept: Tensor, generator: Generator) -> Tensor:
        seen.append(float(percept[0, 0]))
        return torch.ones(1, 1)

    steps = tried_out(OneEpisode(track, Purse(), "trials", 3, 30), draw, 1.0, seeded(0))
    assert seen == [-5.0, *steps.after[:, 0].tolist()]


def test_nothing_is_kept_or_counted_after_the_end_of_an_episode() -> None:
    purse, track = Purse(), Track(Places(torch.tensor([0.95])))
    episode = OneEpisode(track, purse, "trials", 9, 30)
    lanes = start_lanes(episode, torch.arange(1), 0, 0)
    push = torch.ones(1, 1)
    lanes, done = episode.step(lanes, push)
    assert (bool(episode.over(lanes)), done.tolist()) == (True, [True])
    after, done = episode.step(lanes, push)  # as an action of several steps goes on
    assert (done.tolist(), torch.equal(after.state, lanes.state)) == ([False], True)
    assert (len(episode.steps), purse.total.motions) == (1, 1)


class LowLevel(Track):
    """A track each step of which takes seven low-level ones."""

    steps = 0

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        self.steps += 7
        return super().next_state(state, control, scenario)

    @property
    def asked(self) -> Asked:
        return Asked(steps=self.steps, simulated=self.steps)


def test_low_level_steps_are_counted() -> None:
    purse, track = Purse(), LowLevel(Places(torch.tensor([-5.0])))
    tried_out(OneEpisode(track, purse, "trials", 3, 30), lambda *_: torch.ones(1, 1), 1, seeded(0))
    assert (purse.total.motions, purse.total.steps, purse.total.simulated) == (3, 21, 21)


class TwoNumbers(Track):
    """A track whose pushes have a second number, which changes nothing."""

    control_size = 2


def test_a_step_is_one_motion_however_many_numbers_a_control_has() -> None:
    purse, place = Purse(), TwoNumbers(Places(torch.tensor([0.0])))
    episode = OneEpisode(place, purse, "trials", 9, 30)
    lanes = start_lanes(episode, torch.arange(1), 0, 0)
    for second, motions in ((0.5, 1), (torch.nan, 1), (0.5, 2)):
        lanes, _ = episode.step(lanes, torch.tensor([[0.5, second]]))
        assert purse.total.motions == motions


def test_an_episode_is_broken_off_and_only_its_own_end_is_one() -> None:
    def steps_of(place: float, most: int, limit: int) -> tuple[int, list[bool], int]:
        purse = Purse()
        world = DOMAIN.world(Places(torch.tensor([place])))
        episode = OneEpisode(world, purse, "trials", most, limit)
        steps = tried_out(episode, lambda *_: torch.ones(1, 1), 0.5, seeded(0))
        return len(steps), steps.ended.tolist(), purse.total.motions

    assert steps_of(-5.0, 3, 30) == (3, [False] * 3, 3)
    assert steps_of(0.95, 9, 30) == (1, [True], 1)
    assert steps_of(0.95, 9, 1) == (1, [False], 1)
    count, ended, _ = steps_of(-50.0, 99, 30)
    assert (count, any(ended)) == (30, False)
