"""Algorithm 1: nothing that was solved is lost, whatever the search brings."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from members import nearly
from support import FOOTPRINT, seeded
from torch import Generator, Tensor

from cgtorch.environment import Dataset
from cgtorch.improvement.compose import branching_action, compose
from cgtorch.improvement.events import (
    Event,
    GenerationDone,
    ModelsFitted,
    SkillAccepted,
    WorldTested,
)
from cgtorch.improvement.gating import train_gating
from cgtorch.improvement.grow import grow
from cgtorch.improvement.improve import improve
from cgtorch.improvement.setup import Progress, Setup, Stage
from cgtorch.improvement.stopping import Budget
from cgtorch.improvement.team import StageState, compose_team
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.tabletop.world import (
    Scenarios,
    TabletopWorld,
    random_scenarios,
    stage_scenarios,
)

METHODS: dict[str, Callable[..., Progress]] = {"compose": improve, "paper": grow}
Told = list[Event]


def stage(
    method: str, setup: Setup, progress: Progress, name: str, edge: str, seed: int
) -> tuple[Progress, Told]:
    """One stage on an edge: five placements and five of practice."""
    scenarios = stage_scenarios(edge).joined(random_scenarios(edge, 5, seeded(seed)))
    told: Told = []
    after = METHODS[method](
        Stage(setup, name, seeded(seed), told.append),
        progress,
        scenarios,
        torch.arange(10) < 5,
        lambda generator: random_scenarios(edge, 5, generator),
    )
    return after, told


def unwatched(setup: Setup) -> Stage:
    return Stage(setup, "S1", seeded(0), lambda event: None)


def solves(setup: Setup, progress: Progress, scenarios: Scenarios) -> Tensor:
    assert progress.skill is not None
    return try_skill(progress.skill, setup.world_of(scenarios)).succeeded


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", range(3))
def test_nothing_that_was_solved_is_lost(
    setup: Setup, nothing_yet: Progress, method: str, seed: int
) -> None:
    """Eq. 1 over two stages, measured in the world by running the skills again."""
    progress, accepted = nothing_yet, 0
    for name, edge in (("S0", "near"), ("S1", "left")):
        after, told = stage(method, setup, progress, name, edge, seed)
        events = [e for e in told if isinstance(e, SkillAccepted)]
        if not events:
            assert after.skill is progress.skill
            assert after.solved is progress.solved
            assert after.missed is progress.missed
            continue
        accepted += 1
        assert after.skill is events[-1].skill
        assert after.skill.name == name
        assert solves(setup, after, progress.solved).all()  # eq. 1a
        assert len(after.solved) > len(progress.solved)  # eq. 1b
        assert solves(setup, after, after.solved).all()
        assert not solves(setup, after, after.missed).any()
        for event in events:
            assert event.succeeded[event.keep].all()
            assert event.succeeded[~event.keep].any()
            assert int(event.targets.sum()) == 5
        progress = after
    assert accepted >= 1


@pytest.mark.parametrize("method", METHODS)
def test_the_generator_decides(setup: Setup, nothing_yet: Progress, method: str) -> None:
    first, again = (stage(method, setup, nothing_yet, "S0", "near", 1)[0] for _ in range(2))
    assert first.skill is not None
    assert again.skill is not None
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
    hopeless = replace(setup, world_of=out_of_reach)
    after, told = stage(method, hopeless, nothing_yet, "S0", "near", 0)
    assert after.skill is None
    assert len(after.solved) == len(after.missed) == 0
    assert not any(isinstance(e, SkillAccepted) for e in told)
    assert sum(isinstance(e, ModelsFitted) for e in told) >= 1
    before = nothing_yet.knowledge
    assert grown(before.dataset, after.knowledge.dataset) > 0
    seen = after.knowledge.dataset
    new = slice(len(before.dataset.succeeded), None)
    assert not seen.succeeded[new].any()
    # Where grasping failed, C no longer believes in it as it did.
    where = seen.tested[new]
    doubt = before.classifier(where).mean() - after.knowledge.classifier(where).mean()
    assert float(doubt) > 0.05
    # The knowledge that the stage began with is as it was.
    assert before is nothing_yet.knowledge
    assert not torch.equal(before.classifier(where), after.knowledge.classifier(where))


@pytest.mark.parametrize("method", METHODS)
def test_a_skill_that_cannot_be_improved_is_kept(
    setup: Setup, nothing_yet: Progress, method: str
) -> None:
    first, _ = stage(method, setup, nothing_yet, "S0", "near", 1)
    assert first.skill is not None
    hasty = replace(setup, attempts=1, budget=Budget(generations=1))
    hopeless = replace(hasty, world_of=out_of_reach)
    after, told = stage(method, hopeless, first, "S1", "far", 1)
    assert after.skill is first.skill
    assert after.solved is first.solved
    assert after.missed is first.missed
    assert not any(isinstance(e, SkillAccepted) for e in told)


@pytest.mark.parametrize("method", METHODS)
def test_the_budget_is_kept(setup: Setup, nothing_yet: Progress, method: str) -> None:
    small = replace(setup, attempts=2, budget=Budget(generations=3))
    _, told = stage(method, small, nothing_yet, "S0", "far", 2)
    done = [e for e in told if isinstance(e, GenerationDone)]
    assert len({e.candidate for e in done}) <= 2
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


def test_the_papers_way_evolves_under_a_hard_w(setup: Setup, nothing_yet: Progress) -> None:
    """Who loses a scenario of W in the models is worth nothing, and the last skill is a seed."""
    first, _ = stage("paper", setup, nothing_yet, "S0", "near", 1)
    assert first.skill is not None
    after, told = stage("paper", setup, first, "S1", "left", 1)
    done = [e for e in told if isinstance(e, GenerationDone)]
    assert {e.size_w for e in done} >= {len(first.solved)}
    for event in done:
        best = event.generation.fitness.max()
        assert (event.solved_w == event.size_w) or float(best) == 0
    start = done[0].generation.population.graphs
    n = first.skill.num_nodes
    copies = (start.action[:, :n] == first.skill.graph.action[0, :n]).all(1)
    assert int(copies.sum()) >= setup.evolution.population // 2
    for event in told:
        if isinstance(event, WorldTested):
            assert event.size_w + event.size_m == len(first.solved) + 10
    if after.skill is not first.skill:
        assert after.skill is not None
        assert after.skill.depth == 1


def test_a_stage_whose_every_scenario_is_w(setup: Setup, nothing_yet: Progress) -> None:
    """Nothing is missed at first; the skill is improved or kept, and W is not lost."""
    first, _ = stage("compose", setup, nothing_yet, "S0", "near", 1)
    none = stage_scenarios("near", 0)
    after = improve(
        unwatched(setup), first, none, torch.zeros(0, dtype=torch.bool), lambda generator: none
    )
    assert solves(setup, after, first.solved).all()
    assert len(after.solved) >= len(first.solved)


def test_a_team_that_would_lose_something_is_not_accepted(
    setup: Setup, nothing_yet: Progress
) -> None:
    """Even where the members are believed to solve everything, the world has the last word."""
    scenarios = random_scenarios("near", 40, seeded(5))
    idle, member = nearly(0.0), nearly(0.3)
    percepts = first_percepts(setup.world_of(scenarios))
    rates = torch.tensor([[0.0, 1.0]]).repeat(40, 1)
    _, branch = branching_action(setup.actions)
    always, _ = train_gating(branch, percepts, rates.flip(1), torch.ones(40), seeded(0))
    whole = compose("S1", [member, idle], always, setup.actions, setup.max_transitions)
    solved = try_skill(whole, setup.world_of(scenarios)).succeeded
    assert 0 < int(solved.sum()) < 40
    nobody = torch.zeros(40, dtype=torch.bool)
    models, members = nothing_yet.knowledge, (idle, member)
    for keep, accepted in (
        (~solved, False),
        (solved, False),
        (nobody, True),
        (solved & (torch.arange(40) > 20), True),
    ):
        about = scenarios, keep, nobody, percepts, scenarios[:0]
        state = StageState(*about, models, members, rates)
        progress = replace(nothing_yet, skill=nearly(0.0))
        found = compose_team(unwatched(setup), state, progress)
        assert (found is not None) == accepted


def test_members_take_the_earlier_skills_place_and_idle_ones_are_dropped(
    setup: Setup, nothing_yet: Progress
) -> None:
    """What is left is flat and small, and the world says that nothing of W is lost."""
    scenarios = random_scenarios("perimeter", 60, seeded(5))
    world, none = setup.world_of(scenarios), torch.zeros(60, dtype=torch.bool)
    near, twin, far, useless = (
        replace(nearly(ahead), name=name)
        for ahead, name in ((0.25, "near"), (0.25, "twin"), (0.55, "far"), (-1.0, "useless"))
    )
    earlier = replace(near, name="S0")
    members = (near, useless, twin, far)
    results = [try_skill(m, world).succeeded for m in (earlier, *members)]
    assert not results[2].any()
    assert (results[4] & ~results[0]).any()
    about = scenarios, results[0], none, first_percepts(world), scenarios[:0]
    rates = torch.stack(results, 1).float()
    state = StageState(*about, nothing_yet.knowledge, (earlier, *members), rates)
    progress = replace(nothing_yet, skill=earlier, members=members)
    found = compose_team(unwatched(setup), state, progress)
    assert found is not None
    skill, succeeded = found
    assert set(skill.sub_skills) == {"near", "far"}
    assert (skill.num_nodes, skill.depth) == (3, 2)
    assert torch.equal(try_skill(skill, world).succeeded, succeeded)
    assert succeeded[results[0]].all()


def test_where_members_would_lose_something_the_earlier_skill_stays(
    setup: Setup, nothing_yet: Progress
) -> None:
    scenarios = random_scenarios("perimeter", 60, seeded(5))
    world, none = setup.world_of(scenarios), torch.zeros(60, dtype=torch.bool)
    earlier, far = replace(nearly(0.25), name="S0"), replace(nearly(0.55), name="far")
    results = [try_skill(m, world).succeeded for m in (earlier, far)]
    assert (results[0] & ~results[1]).any()
    about = scenarios, results[0], none, first_percepts(world), scenarios[:0]
    rates = torch.stack(results, 1).float()
    state = StageState(*about, nothing_yet.knowledge, (earlier, far), rates)
    progress = replace(nothing_yet, skill=earlier, members=(far,))
    found = compose_team(unwatched(setup), state, progress)
    assert found is not None
    assert "S0" in found[0].sub_skills
    assert found[1][results[0]].all()


def test_a_specialist_is_the_best_of_several_searches(setup: Setup, nothing_yet: Progress) -> None:
    """They end with the first that solves all, and every second one begins without seeds."""
    short = Budget(generations=2)
    several = replace(setup, attempts=1, searches=4, rounds=1, budget=short)
    first, _ = stage("compose", replace(setup, budget=short), nothing_yet, "S0", "near", 1)
    assert first.specialists is not None
    after, told = stage("compose", several, first, "S1", "far", 2)
    done = [e for e in told if isinstance(e, GenerationDone)]
    names = list(dict.fromkeys(e.candidate for e in done))
    assert names == ["S1.1", *(f"S1.1 search {n}" for n in range(2, len(names) + 1))]
    best = [max(e.generation.best for e in done if e.candidate == name) for name in names]
    everything = [
        any(e.generation.succeeded.all() for e in done if e.candidate == n) for n in names
    ]
    assert everything.index(True) == len(names) - 1 if any(everything) else len(names) == 4
    assert len(set(best)) > 1
    alone, told = stage("compose", replace(several, searches=1), first, "S1", "far", 2)
    assert {e.candidate for e in told if isinstance(e, GenerationDone)} == {"S1.1"}
    assert after.knowledge is not None
    assert alone.knowledge is not None


@pytest.mark.parametrize("clean", [1, 3])
def test_a_stage_ends_after_so_many_clean_batches(
    setup: Setup, nothing_yet: Progress, clean: int
) -> None:
    """All placements are the same one, so each batch is clean once the skill solves it."""
    careful, drawn = replace(setup, clean_batches=clean), []
    first, _ = stage("compose", setup, nothing_yet, "S0", "near", 1)
    same = first.solved[torch.tensor([1, 1, 1])]  # within reach from the start

    def draw(generator: Generator) -> Scenarios:
        drawn.append(1)
        return same

    everything = torch.ones(3, dtype=torch.bool)
    after = improve(unwatched(careful), nothing_yet, same, everything, draw)
    assert after.skill is not None
    assert len(drawn) == clean
    assert len(after.solved) == 3 + 3 * clean
    assert not len(after.missed)
