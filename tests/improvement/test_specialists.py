"""Specialists: on what they are evolved, how often, and what that costs."""

import itertools
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from members import nearly
from reaching import in_the_world
from support import model, random_graphs, seeded
from torch import Tensor
from walking import RewardedPath, TinyPath, Walks, walking_actions
from watched import along, first_stage, of_kind, stage_of, state_of, without_models

from cgtorch.evolution import (
    EvolutionSettings,
    Population,
    episode_return,
    initial_strategy,
    join,
    tournament,
)
from cgtorch.ground.asked import Asked, Purse
from cgtorch.improvement import specialists, team
from cgtorch.improvement.checkpoint import Found
from cgtorch.improvement.events import GenerationDone, WorldAsked
from cgtorch.improvement.improve import improve
from cgtorch.improvement.setup import Budget, Setup
from cgtorch.improvement.specialists import READABLE, evolve_candidate
from cgtorch.improvement.team import FEWEST, OTHERS, with_member
from cgtorch.runs.journal import FileJournal
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world import Scenarios, random_scenarios, stage_scenarios

ACTIONS = paper_actions()


@given(st.integers(0, 9), st.integers(0, 30), st.integers(1, 4), st.integers(1, 20))
def test_few_missed_scenarios_are_joined_by_solved_ones(
    missed: int, solved: int, replicas: int, group: int
) -> None:
    """A specialist that sees two scenarios only would learn them by heart."""
    missed = missed + 1
    told: dict[str, Any] = {}
    groups = list[int]()

    def imagine(models: None, scenarios: Scenarios, percepts: Tensor, count: int, *_: Any) -> Any:
        groups.append(len(scenarios))
        told.update(scenarios=scenarios, percepts=percepts, replicas=count)
        return in_the_world(models, scenarios, percepts, count)

    graph = nearly(0.3).graph
    found = Found(Population(graph, initial_strategy(1)), torch.ones(1) > 0, 0.5)
    scenarios = random_scenarios("perimeter", missed + solved, seeded(0))
    which = torch.randperm(missed + solved, generator=seeded(1)) < missed
    state = state_of(scenarios, (nearly(0.1),))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(specialists, "evolve_candidate", lambda *about, **how: found)
        patch.setattr(specialists, "shrunk", lambda champion, *about: champion)
        about = {"replicas": replicas, "group": group, "widest": group}
        setup = replace(without_models(**about), imagine=imagine)
        after = with_member(stage_of(setup), replace(state, number=7), which)
    rows = [scenarios.seed.tolist().index(s) for s in told["scenarios"].seed.tolist()]
    assert len(rows) == len(set(rows))
    assert groups == [len(rows)]  # at once, as it does not grow
    assert torch.equal(told["percepts"], state.percepts[rows])
    ill = [row for row in rows if which[row]]
    assert len(ill) == min(missed, group)
    assert len(rows) - len(ill) == (min(solved, OTHERS) if len(ill) < FEWEST else 0)
    assert told["replicas"] == max(replicas, replicas * group // len(rows))
    assert [m.name for m in after.members] == ["ahead 0.1", "S1.7"]
    assert torch.equal(after.trust, torch.ones(len(scenarios), 2))
    assert after.population is not None
    assert len(after.population) == 1


@pytest.mark.parametrize(
    ("best", "solved", "satisfied", "groups"),
    [
        (0.6, 7, 0.5, [8, 16, 32]),
        (0.5, 7, 0.5, [8, 16, 32]),
        (0.4, 7, 0.5, [8]),
        (0.4, 8, 0.5, [8, 16]),
        (0.4, 8, math.inf, [8, 16]),
        (0.6, 7, math.inf, [8]),
    ],
)
def test_what_is_good_enough_on_few_scenarios_goes_on_with_more(
    best: float, solved: int, satisfied: float, groups: list[int]
) -> None:
    """With a fitness that is good enough, or if all is solved, up to a number of scenarios."""
    scenarios, told = random_scenarios("perimeter", 50, seeded(0)), list[Scenarios]()
    began, names = list[Any](), list[str]()

    def imagine(models: None, some: Scenarios, percepts: Tensor, count: int, *_: Any) -> Any:
        told.append(some)
        return in_the_world(models, some, percepts, count)

    champion = Population(nearly(0.3).graph, initial_strategy(1))

    def evolved(stage: Any, name: str, environment: Any, seeds: Any = None, **how: Any) -> Found:
        names.append(name)
        began.append(seeds)
        return Found(champion, torch.arange(environment.num_scenarios) < solved, best)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(specialists, "evolve_candidate", evolved)
        patch.setattr(specialists, "shrunk", lambda champion, *about: champion)
        about = {"group": 8, "widest": 32, "replicas": 1, "searches": 1}
        setup = replace(
            without_models(budget=Budget(satisfied=satisfied), **about), imagine=imagine
        )
        with_member(stage_of(setup), state_of(scenarios), torch.ones(50, dtype=torch.bool))
    assert [len(each) for each in told] == groups
    for few, more in itertools.pairwise(told):
        assert more.seed[: len(few)].tolist() == few.seed.tolist()
    assert len(set(names)) == len(names)
    assert began == [None] + [champion] * (len(groups) - 1)


@pytest.mark.parametrize("searches", [1, 4])
def test_a_specialist_is_the_best_of_several_searches(searches: int) -> None:
    """They end with the first that solves all, and every second one begins without seeds."""
    short = Budget(generations=2)
    setup = without_models(attempts=1, searches=searches, budget=short, practice=0)
    first = improve(
        stage_of(setup, name="S0"), first_stage(), stage_scenarios("near"), along("near")
    )
    assert first.specialists is not None
    told: list[Any] = []
    improve(stage_of(setup, told.append), first, stage_scenarios("far"), along("far"))
    done: list[GenerationDone] = of_kind(told, GenerationDone)
    names = list(dict.fromkeys(e.candidate for e in done))
    assert names == ["S1.1", *(f"S1.1 search {n}" for n in range(2, len(names) + 1))]
    everything = [
        any(e.generation.succeeded.all() for e in done if e.candidate == n) for n in names
    ]
    if any(everything):
        assert everything.index(True) == len(names) - 1
    else:
        assert len(names) == searches


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=6))
def test_the_best_search_is_kept(results: list[tuple[float, bool]]) -> None:
    population = random_graphs(0, 9, ACTIONS)
    seeds = Population(population[:1], initial_strategy(1))
    given_: list[Population | None] = []
    left = [
        Found(Population(population[i : i + 1], initial_strategy(1)), torch.tensor([solved]), best)
        for i, (best, solved) in enumerate(results)
    ]
    every = list(left)

    def evolved(stage: Any, name: str, environment: Any, seeds: Population | None) -> Found:
        given_.append(seeds)
        return left.pop(0)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(specialists, "evolve_candidate", evolved)
        setup = without_models(searches=len(results))
        nothing: Any = None
        found = specialists.best_of_searches(stage_of(setup), "S1.1", nothing, seeds)
    made = len(results) - len(left)
    assert found.best == max(each.best for each in every[:made])
    assert given_ == [None if i % 2 else seeds for i in range(made)]
    best = every[0]
    for i, each in enumerate(every):
        best = max(best, each, key=lambda f: f.best)
        if best.solved.all() or i == len(every) - 1:
            assert made == i + 1
            break


def test_an_evolution_begins_with_its_seeds() -> None:
    told: list[Any] = []
    seeds = Population(nearly(0.3).graph, initial_strategy(1))
    budget = Budget(generations=3, enough=2.0, patience=9)
    setup, began = stage_of(without_models(budget=budget), told.append), time.perf_counter()
    found = evolve_candidate(setup, "S1.1", model(0, 5), seeds=seeds)
    done, *later = of_kind(told, GenerationDone)
    assert (done.limit, done.size_w, done.size_m) == (3, 0, 5)
    assert (len(later), found.generations) == (2, 3)
    assert found.transitions == sum(each.generation.transitions for each in (done, *later))
    seconds = sum(each.seconds for each in (done, *later))
    assert 0 < seconds == pytest.approx(found.seconds)
    assert seconds < time.perf_counter() - began
    action = done.generation.population.graphs.action[:, :3]
    copies = (action == seeds.graphs.action[0, :3]).all(1)
    assert int(copies.sum()) >= setup.evolution.population // 2


class CountedPath(RewardedPath):
    """A path whose steps are counted."""

    taken = 5

    @property
    def asked(self) -> Asked:
        return Asked(steps=self.taken)

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        self.taken += len(state)
        return super().next_state(state, control, scenario)


def counted(told: list[Any]) -> tuple[CountedPath, Setup[Walks]]:
    """A path, and a search on it that pays for its steps."""
    world = CountedPath(Walks(torch.zeros(3), torch.full((3,), 4.0)))
    return world, Setup(
        actions=walking_actions(), world_of=CountedPath, imagine=lambda *_: world, purse=Purse(),
        evolution=EvolutionSettings(population=20, fitness=episode_return), watch=told.append,
        budget=Budget(3, enough=math.inf), generator=seeded(0),
    )  # fmt: skip


def test_low_level_steps_of_an_evolution_are_paid_and_told_once(tmp_path: Path) -> None:
    told = list[Any]()
    world, setup = counted(told)
    found = evolve_candidate(replace(setup, journal=FileJournal(tmp_path)), "walk", world)
    taken = world.taken
    assert 0 < found.asked.steps <= taken - 5
    again = replace(setup, journal=FileJournal(tmp_path), purse=Purse())
    assert evolve_candidate(again, "walk", world).asked == found.asked
    assert world.taken == taken  # as the result is known
    for event, recalled, purse in zip(
        of_kind(told, WorldAsked), (False, True), (setup.purse, again.purse), strict=True
    ):
        assert (event.phase, event.asked, event.recalled) == ("search", found.asked, recalled)
        assert purse.spent == {"search": found.asked}


def test_low_level_steps_of_making_a_specialist_smaller_are_paid_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told = list[Any]()
    world, setup = counted(told)
    graphs = random_graphs(0, 20, setup.actions, capacity=24, nodes=(20, 24))
    large = Population(graphs[graphs.num_nodes > READABLE][:1], initial_strategy(1))
    found = Found(large, torch.zeros(3) > 0, -9.0, asked=Asked(steps=2))
    monkeypatch.setattr(specialists, "best_of_searches", lambda *_: found)
    about = world.scenarios, torch.zeros(3, 2), None
    small, _ = specialists.specialist(setup, "walk", None, *about)
    assert int(small.graphs.num_nodes) <= READABLE
    assert [event.asked for event in of_kind(told, WorldAsked)] == [Asked(steps=world.taken - 5)]
    assert setup.purse.total == Asked(steps=world.taken - 5)


def test_of_many_seeds_the_newest_begin_beside_as_many_new_individuals(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told = list[Population | None]()
    monkeypatch.setattr(specialists, "best_of_searches", lambda *about: told.append(about[-1]))
    many = join(*(Population(nearly(i / 100).graph, initial_strategy(1)) for i in range(40)))
    for remembers, seeds in ((True, many), (False, many), (True, None)):
        setup = stage_of(without_models(remembers=remembers))
        specialists._searched(setup, "S1.1", model(0, 2), seeds)
    mixed, *others = told
    half = setup.evolution.population // 2
    assert others == [many, None]
    assert mixed is not None
    assert len(mixed) == half
    ahead = mixed.graphs.parameters[: half // 2, 0, 33].tolist()
    assert ahead == pytest.approx([(39 - i) / 100 for i in range(half // 2)])


def test_a_fitness_that_is_good_enough_ends_the_searches(monkeypatch: pytest.MonkeyPatch) -> None:
    champion = Population(nearly(0.3).graph, initial_strategy(1))
    for best, wanted in ((0.5, 1), (0.4, 3)):
        names = list[str]()

        def evolved(
            stage: Any, name: str, *about: Any, seeds: Any, names: list[str] = names,
            found: Found = Found(champion, torch.zeros(2) > 0, best),  # noqa: B008
        ) -> Found:  # fmt: skip
            names.append(name)
            return found

        monkeypatch.setattr(specialists, "evolve_candidate", evolved)
        setup = without_models(searches=3, budget=Budget(satisfied=0.5))
        specialists.best_of_searches(stage_of(setup), "S1.1", model(0, 2), None)
        assert len(names) == wanted


def test_the_solved_ones_that_join_a_group_follow_from_the_generator(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told = list[list[int]]()

    def recorded(setup: Any, name: str, models: Any, group: Scenarios, *about: Any) -> Any:
        told.append(group.seed.tolist())
        return Population(nearly(0.3).graph, initial_strategy(1)), torch.zeros(1) > 0

    monkeypatch.setattr(team, "specialist", recorded)
    state = state_of(random_scenarios("near", 30, seeded(0)))
    for _ in range(2):
        with_member(stage_of(without_models()), state, torch.arange(30) == 5)
    assert len(told[0]) == 1 + OTHERS
    assert told[0] == told[1]


def test_episodes_of_an_evolution_are_no_longer_than_those_of_the_skill() -> None:
    told: list[Any] = []
    setup = without_models(max_transitions=2, budget=Budget(generations=2))
    evolve_candidate(stage_of(setup, told.append), "S1.1", model(0, 5))
    generations = of_kind(told, GenerationDone)
    assert generations
    for each in generations:
        assert each.generation.transitions <= 2 * 5 * setup.evolution.population


def test_where_rollouts_take_time_what_is_missed_and_what_is_not_come_first_in_turns() -> None:
    """The group is filled up with the nearest, no start is doubled, and the newest seed leads."""
    scenarios = random_scenarios("perimeter", 20, seeded(5))
    which, told = torch.arange(20) % 5 == 0, list[tuple[list[int], int, Population | None]]()

    def imagine(models: None, group: Scenarios, percepts: Tensor, count: int, *_: Any) -> Any:
        told.append((group.seed.tolist(), count, None))
        return in_the_world(models, group, percepts, count)

    def evolved(stage: Any, name: str, environment: Any, seeds: Any = None, **how: Any) -> Found:
        told.append((*told.pop()[:2], seeds))
        champion = Population(nearly(0.3).graph, initial_strategy(1))
        return Found(champion, torch.arange(environment.num_scenarios) < 3, 0.5)

    old, new = (Population(nearly(by).graph, initial_strategy(1)) for by in (0.1, 0.2))
    state = state_of(scenarios, (nearly(0.1),))
    state = replace(state, population=join(old, new))
    how = {"group": 12, "widest": 0, "replicas": 1, "searches": 1, "remembers": True}
    setup = stage_of(replace(without_models(**how), imagine=imagine))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(specialists, "evolve_candidate", evolved)
        for number in (1, 2):
            after = with_member(setup, replace(state, number=number), which)
        with_member(replace(setup, group=6), state, which)
    (first, count, seeds), (then, *_), (few, *_) = told
    assert len(few) == 6
    place = [scenarios.seed.tolist().index(seed) for seed in first]
    assert which[place].tolist() == [True] * 4 + [False] * 8
    assert sorted(then) == sorted(first)
    place = [scenarios.seed.tolist().index(seed) for seed in then]
    assert which[place].tolist() == [False] * 8 + [True] * 4
    assert after.outcomes[place, 1].tolist() == [1] * 3 + [-1] * 9
    assert count == 1
    assert seeds is not None
    assert len(seeds) == setup.evolution.population // 2
    for row, one in enumerate((new, old)):
        size = one.graphs.capacity
        assert torch.equal(seeds.graphs.parameters[row, :size], one.graphs.parameters[0])


def test_a_search_goes_on_while_returns_rise_in_any_unit() -> None:
    """One that saw no progress in tiny returns would end with the first champion."""
    evolution = EvolutionSettings(
        population=60, capacity=12, selection=tournament(5), fitness=episode_return
    )

    def found(place: type[RewardedPath], unit: float) -> Found:
        world = place(Walks(torch.tensor([-1.5, -0.5, 0.5, 1.5]), torch.full((4,), 8.0)))
        setup: Setup[Walks] = Setup(
            actions=walking_actions(), world_of=place, imagine=lambda *_: world,
            evolution=evolution, max_transitions=60, generator=seeded(5), watch=lambda _: None,
            budget=Budget(40, stall=12, enough=math.inf, least=1e-3 * unit),
        )  # fmt: skip
        return evolve_candidate(setup, "walk", world)

    plain, tiny = found(RewardedPath, 1.0), found(TinyPath, TinyPath.unit)
    assert plain.generations == tiny.generations > 13
    assert plain.best * TinyPath.unit == tiny.best
