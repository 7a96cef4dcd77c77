"""Algorithm 1: nothing that was solved is lost, whatever the search brings."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import pytest
import torch
from reaching import small_knowledge, small_setup
from support import FOOTPRINT, seeded
from torch import Tensor
from watched import NONE, Watched, along, first_stage, keys, of_kind, stage_of, without_models

from cgtorch.domains.knowledge import summary_of
from cgtorch.evolution import EvolutionSettings
from cgtorch.ground.asked import Asked, Purse
from cgtorch.ground.environment import Dataset
from cgtorch.improvement.events import (
    Event,
    GenerationDone,
    ModelsFitted,
    SkillAccepted,
    WorldAsked,
    WorldTested,
)
from cgtorch.improvement.grow import grow
from cgtorch.improvement.improve import improve
from cgtorch.improvement.setup import Budget, Progress, Setup
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.tabletop.world import Scenarios, TabletopWorld, random_scenarios, stage_scenarios

METHODS: dict[str, Callable[..., Progress]] = {"compose": improve, "paper": grow}
Told = list[Event]


def stage(
    method: str, setup: Setup, progress: Progress, name: str, edge: str, seed: int
) -> tuple[Progress, Told]:
    """One stage on an edge: five placements, and fresh ones to practise on."""
    told: Told = []
    about = replace(setup, name=name, generator=seeded(seed), watch=told.append)
    after = METHODS[method](about, progress, stage_scenarios(edge), along(edge))
    return after, told


def solves(setup: Setup, progress: Progress, scenarios: Scenarios) -> Tensor:
    assert progress.skill is not None
    return try_skill(progress.skill, setup.world_of(scenarios)).succeeded


@pytest.mark.parametrize("how", ["compose", "paper", "of a coreset", "in the world"])
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.hostile)])
def test_nothing_that_was_solved_is_lost(
    setup: Setup, nothing_yet: Progress, how: str, seed: int
) -> None:
    """Eq. 1 over two stages, measured in the world by running the skills again."""
    method, progress, accepted = "paper" if how == "paper" else "compose", nothing_yet, 0
    setup = replace(setup, core=4) if how == "of a coreset" else setup
    if how == "in the world":
        few = EvolutionSettings(population=30, capacity=12)
        setup = without_models(evolution=few, budget=Budget(generations=5), attempts=3)
        progress = first_stage()
    for name, edge in (("S0", "near"), ("S1", "left")):
        after, told = stage(method, setup, progress, name, edge, seed)
        events: list[SkillAccepted] = of_kind(told, SkillAccepted)
        if not events:
            assert after.skill is progress.skill
            assert after.solved is progress.solved
            assert after.missed is progress.missed
            continue
        accepted += 1
        (event,) = events
        assert after.skill is event.skill
        assert after.skill.name == name
        assert solves(setup, after, progress.solved).all()  # eq. 1a
        assert len(after.solved) > len(progress.solved)  # eq. 1b
        assert solves(setup, after, after.solved).all()
        assert not solves(setup, after, after.missed).any()
        assert set(keys(after.solved)) >= set(keys(progress.solved))
        both = keys(after.solved) + keys(after.missed)
        assert len(both) == len(set(both))
        assert set(both) >= set(keys(stage_scenarios(edge)) + keys(progress.missed))
        assert after.seen is not None
        seen = first_percepts(setup.world_of(after.solved.joined(after.missed)))
        assert torch.equal(after.seen, seen)
        assert int(event.keep.sum()) == len(progress.solved)
        assert event.parent == (None if progress.skill is None else progress.skill.name)
        assert 0 < event.seconds < 100
        assert event.succeeded[event.keep].all()
        assert event.succeeded[~event.keep].any()
        assert int(event.targets.sum()) == 5 + len(progress.missed)
        assert torch.equal(solves(setup, after, event.scenarios), event.succeeded)
        progress = after
    assert accepted >= 1


@cache
def begun(method: str) -> Progress:
    """What a first stage comes to."""
    none = stage_scenarios("near", 0)
    before = Progress(None, none, none, small_knowledge())
    return stage(method, small_setup(), before, "S0", "near", 1)[0]


@pytest.mark.parametrize("method", METHODS)
def test_the_generator_decides(setup: Setup, nothing_yet: Progress, method: str) -> None:
    first, again = begun(method), stage(method, setup, nothing_yet, "S0", "near", 1)[0]
    assert first.skill is not None
    for name, value in vars(first.skill.graph).items():
        assert torch.equal(value, getattr(again.skill.graph, name))
    for one, other in ((first.solved, again.solved), (first.missed, again.missed)):
        assert torch.equal(one.object, other.object)


def out_of_reach(scenarios: Scenarios) -> TabletopWorld:
    """A world that the models have got all wrong."""

    def never(at: Tensor, table: Tensor) -> Tensor:
        return torch.zeros(len(at), dtype=torch.bool)

    return TabletopWorld(scenarios, never, FOOTPRINT)


def grown(before: Dataset, after: Dataset) -> int:
    """How many rows are new; the old ones must come first."""
    for name, rows in vars(before).items():
        assert torch.equal(vars(after)[name][: len(rows)], rows), name
    return len(after.succeeded) - len(before.succeeded)


@pytest.mark.parametrize("method", METHODS)
def test_where_nothing_can_be_solved_all_stays_and_the_models_learn(
    setup: Setup, nothing_yet: Progress, method: str
) -> None:
    """From every trial: all rows are there, also those that are held out."""
    hopeless = replace(setup, world_of=out_of_reach, attempts=3, purse=Purse(), describe=summary_of)
    after, told = stage(method, hopeless, nothing_yet, "S0", "near", 0)
    assert after.skill is None
    assert len(after.solved) == len(after.missed) == 0
    assert not of_kind(told, SkillAccepted)
    fitted: list[ModelsFitted] = of_kind(told, ModelsFitted)
    assert [event.summary.first for event in fitted] == [False] * 3  # of the run
    assert all(0 <= event.seconds < 100 for event in fitted)
    before = nothing_yet.knowledge
    rows = [len(k.dataset.tested) + len(k.aside.tested) for k in (before, after.knowledge)]
    assert rows[1] - rows[0] == hopeless.purse.total.tests > 0
    assert grown(before.dataset, after.knowledge.dataset) > 0
    seen = after.knowledge.dataset
    new = slice(len(before.dataset.succeeded), None)
    assert not seen.succeeded[new].any()
    # Where grasping failed, C no longer believes in it as it did; the old one is as it was.
    where = seen.tested[new]
    doubt = before.classifier(where).mean() - after.knowledge.classifier(where).mean()
    assert float(doubt) > 0.05


@pytest.mark.parametrize("method", METHODS)
def test_a_skill_that_cannot_be_improved_is_kept(setup: Setup, method: str) -> None:
    first = begun(method)
    hasty = replace(setup, attempts=1, budget=Budget(generations=1), world_of=out_of_reach)
    after, told = stage(method, hasty, first, "S1", "far", 1)
    for name in ("skill", "solved", "missed", "seen"):
        assert getattr(after, name) is getattr(first, name)
    assert not of_kind(told, SkillAccepted)


@pytest.mark.parametrize("method", METHODS)
def test_the_budget_is_kept(setup: Setup, nothing_yet: Progress, method: str) -> None:
    small = replace(setup, attempts=2, budget=Budget(generations=3))
    _, told = stage(method, small, nothing_yet, "S0", "far", 2)
    done: list[GenerationDone] = of_kind(told, GenerationDone)
    assert 0 < len({e.candidate for e in done}) <= 2
    for name in {e.candidate for e in done}:
        numbers = [e.generation.number for e in done if e.candidate == name]
        assert numbers == list(range(len(numbers)))
        assert len(numbers) <= 3


def test_an_evolution_ends_once_its_transitions_are_spent(
    setup: Setup, nothing_yet: Progress
) -> None:
    one = replace(setup, attempts=1, budget=Budget(generations=8, enough=2.0, patience=8))
    _, told = stage("paper", one, nothing_yet, "S0", "far", 2)
    spent = [e.generation.transitions for e in told if isinstance(e, GenerationDone)]
    assert len(spent) == 8
    less = replace(one, budget=replace(one.budget, transitions=sum(spent[:3]) - 1))
    _, told = stage("paper", less, nothing_yet, "S0", "far", 2)
    assert [e.generation.transitions for e in told if isinstance(e, GenerationDone)] == spent[:3]


def test_the_papers_way_evolves_under_a_hard_w(setup: Setup) -> None:
    """Who loses a scenario of W in the models is worth nothing, and the last skill is a seed."""
    first = begun("paper")
    after, told = stage("paper", setup, first, "S1", "left", 1)
    done: list[GenerationDone] = of_kind(told, GenerationDone)
    assert {e.size_w for e in done} >= {len(first.solved)}
    for event in done:
        best = event.generation.fitness.max()
        assert (event.solved_w == event.size_w) or float(best) == 0
    start = done[0].generation.population.graphs
    n = first.skill.num_nodes
    copies = (start.action[:, :n] == first.skill.graph.action[0, :n]).all(1)
    assert int(copies.sum()) >= setup.evolution.population // 2
    for event in of_kind(told, WorldTested):
        assert event.size_w + event.size_m == len(first.solved) + len(first.missed) + 5
    if after.skill is not first.skill:
        assert after.skill is not None
        assert after.skill.depth == 1


def test_a_stage_whose_every_scenario_is_w(setup: Setup) -> None:
    """Nothing is missed at first; the skill is improved or kept, and W is not lost."""
    first = begun("compose")
    after = improve(stage_of(setup), first, NONE, along("near"))
    assert solves(setup, after, first.solved).all()
    assert len(after.solved) >= len(first.solved)


@pytest.mark.parametrize("method", METHODS)
def test_what_is_asked_is_counted_and_told(
    setup: Setup, nothing_yet: Progress, method: str
) -> None:
    """As the world itself counts it, in all phases, and once in events."""
    watched = Watched(setup.world_of)
    counting = replace(setup, world_of=watched, purse=Purse())
    progress, told = stage(method, counting, nothing_yet, "S0", "near", 1)
    _, more = stage(method, counting, progress, "S1", "left", 1)
    asked = counting.purse.total
    assert asked.actions == watched.asked > 0
    assert asked.looks == sum(each.looks.total() for each in watched.log)
    trials = sum(len(each.actions) for each in watched.trials)
    assert asked.episodes == trials
    events: list[WorldAsked] = of_kind(told + more, WorldAsked)
    assert sum((e.asked for e in events), Asked()) == asked
    for phase, spent in counting.purse.spent.items():
        assert sum((e.asked for e in events if e.phase == phase), Asked()) == spent
    assert sum(e.succeeded for e in events) == sum(len(each.succeeded) for each in watched.log)
    assert not any(e.recalled for e in events)
    assert all(e.asked != Asked() for e in events)


def test_first_percepts_to_practise_on_are_looks_at_fresh_scenarios(
    setup: Setup, nothing_yet: Progress
) -> None:
    drawn: list[int] = []

    def draw(count: int, generator: torch.Generator) -> Scenarios:
        drawn.append(count)
        return random_scenarios("near", count, generator)

    for repeats, looks in ((True, setup.looks + 5), (False, setup.looks)):
        about = replace(setup, repeats=repeats, purse=Purse(), attempts=1)
        improve(stage_of(about), nothing_yet, stage_scenarios("near"), draw)
        assert drawn[0] == setup.looks
        assert about.purse.spent["looks"] == Asked(looks=looks)
        drawn.clear()


def test_the_papers_method_draws_scenarios_where_there_is_nothing_else_to_solve() -> None:
    """As in a first round; else only what is given is tried."""
    drawn: list[int] = []

    def draw(count: int, generator: torch.Generator) -> Scenarios:
        drawn.append(count)
        return random_scenarios("near", count, generator)

    few = without_models(group=5, attempts=1, evolution=EvolutionSettings(population=30))
    setup = stage_of(replace(few, budget=Budget(generations=3)))
    after = grow(setup, first_stage(), NONE, draw)
    assert drawn == [5]
    assert len(after.solved) + len(after.missed) in (0, 5)
    one = random_scenarios("near", 1, seeded(3))
    grow(setup, first_stage(), one, draw)
    grow(setup, first_stage(missed=one), NONE, draw)
    grow(setup, first_stage(missed=one), one, draw)
    assert drawn == [5]
