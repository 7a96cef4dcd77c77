"""Lineages: which structures they are of, what is tuned, how they race, and how searches go on."""

from dataclasses import replace
from pathlib import Path

import lottery
import pytest
import torch
from support import custom_actions, model, seeded
from torch import Tensor

from cgtorch.evolution import (
    REWARDS,
    EvolutionSettings,
    EvolutionState,
    ask,
    evolve,
    initial_state,
    tell,
    tournament,
)
from cgtorch.evolution.cma import usual_count
from cgtorch.evolution.fitness import WORST, WORTHLESS
from cgtorch.evolution.lineages import (
    LEAST_PROGRESS,
    LEAST_STEP,
    MOST_UPDATES,
    RECENT,
    RUNGS,
    SEVERAL,
    STALL,
    Lineage,
    after_samples,
    new_lineages,
    one_of_each_kind_first,
    samples,
    successive_halving,
    tunable,
)
from cgtorch.evolution.population import random_population
from cgtorch.evolution.selection import Evaluated
from cgtorch.ground.errors import SettingsError
from cgtorch.improvement.checkpoint import Found, checkpoint_of, islands_from
from cgtorch.runs.journal import FileJournal

ACTIONS = custom_actions()
SETTINGS = EvolutionSettings(
    20, selection=tournament(3), capacity=8, initial_nodes=(2, 5), lineages=3
)


def fitness_of(state: EvolutionState) -> Tensor:
    """A fitness (P,) that is the better the nearer parameters of networks are to 0.3."""
    graphs = ask(state).graphs
    many = ACTIONS.num_parameters[graphs.action.clamp_min(0)] * graphs.used
    counts = torch.where(many > 20, many, 0)
    within = torch.arange(graphs.parameters.shape[2]) < counts[..., None]
    away = ((graphs.parameters - 0.3).square() * within).flatten(1).double().sum(1)
    total = counts.sum(1)
    return torch.where(total > 0, -away / total.clamp_min(1), -1000.0).float()


def test_lineages_keep_their_structure_and_change_only_parameters_of_nodes() -> None:
    population = random_population(30, ACTIONS, 8, (2, 6), seeded(0))
    fitness = torch.rand(30, generator=seeded(1))
    lineages = new_lineages(Evaluated(population, fitness, fitness[:, None]), ACTIONS, 4)
    assert len(lineages) == 4
    drawn = samples(lineages, ACTIONS, seeded(2))
    begin = 0
    for lineage in lineages:
        where = tunable(lineage.best.graphs, ACTIONS)
        n, (nodes, k) = int(where.sum()), where.shape
        rows = drawn[begin : begin + 4 + int(3 * torch.tensor(n).log())]
        begin += len(rows)
        graphs = lineage.best.graphs
        assert (rows.graphs.action[:, :nodes] == graphs.action).all()
        assert (rows.graphs.edges[:, :nodes] == graphs.edges).all()
        same_place = rows.graphs.parameters[:, :nodes, :k] == graphs.parameters[:, :, :k]
        assert same_place[:, ~where].all()
        assert not same_place[:, where].any()
    assert begin == len(drawn)


def test_only_what_a_node_uses_is_tuned() -> None:
    staked, nothing = lottery.staking(0.3).graph, lottery.idle().graph
    assert tunable(staked, lottery.ACTIONS).tolist() == [[True, True]]
    assert tunable(nothing, lottery.ACTIONS).tolist() == [[False, False]]
    free = replace(staked, action=torch.full((1, 1), -1))
    assert not tunable(free, lottery.ACTIONS).any()


def evaluated(fitness: Tensor, count: int = 0) -> Evaluated:
    """Random individuals with a fitness (P,), each on two scenarios of different scores."""
    population = random_population(count or len(fitness), ACTIONS, 8, (2, 3), seeded(3))
    return Evaluated(population, fitness, torch.stack([fitness - 1, fitness + 1], 1))


def few_lineages(count: int) -> tuple[Lineage, ...]:
    """Lineages of individuals in the order of their fitness, from 1 down."""
    found = new_lineages(evaluated(torch.linspace(1, 0, 40)), ACTIONS, count)
    assert len(found) == count
    return found


def test_one_of_each_kind_is_founded_first_and_none_unfinished() -> None:
    fitness = torch.rand(40, generator=seeded(4))
    fitness[:20] = WORST
    fitness[20] = WORTHLESS * 0.99
    everyone = evaluated(fitness)
    lineages = new_lineages(everyone, ACTIONS, 40)
    able = tunable_rows(everyone)
    assert len(lineages) == len([row for row in able if row >= 20])
    firsts = len({x.kind for x in lineages})
    assert len({x.kind for x in lineages[:firsts]}) == firsts
    for part in (lineages[:firsts], lineages[firsts:]):
        values = [x.fitness for x in part]
        assert values == sorted(values, reverse=True)
    best: dict[tuple[int, ...], float] = {}
    for each in lineages:
        best[each.kind] = max(best.get(each.kind, -torch.inf), each.fitness)
        assert each.scores.tolist() == pytest.approx([each.fitness - 1, each.fitness + 1])
        used = each.best.graphs.action[0] >= 0
        assert used.all()
        steps = [ACTIONS.actions[a].first_step for a in each.best.graphs.action[0].tolist()]
        many = ACTIONS.num_parameters[each.best.graphs.action[0]].tolist()
        wanted = [s**2 for s, n in zip(steps, many, strict=True) for _ in range(n)]
        variance = each.distribution.covariance
        variance = variance.diagonal() if variance.dim() == 2 else variance
        assert variance.tolist() == pytest.approx(wanted)
    assert [x.fitness for x in lineages[:firsts]] == [best[x.kind] for x in lineages[:firsts]]


def tunable_rows(everyone: Evaluated) -> list[int]:
    graphs = everyone.population.graphs
    return [i for i in range(len(everyone)) if tunable(graphs[i : i + 1], ACTIONS).any()]


def test_other_kinds_are_looked_for_among_several_of_the_best_only() -> None:
    everyone = evaluated(torch.zeros(200))
    kinds: dict[tuple[int, ...], list[int]] = {}
    for row in tunable_rows(everyone):
        action = everyone.population.graphs.action[row]
        kinds.setdefault(tuple(sorted(action[action >= 0].tolist())), []).append(row)
    usual, rare = sorted(kinds.values(), key=len)[::-1][:2]
    for same, expected in ((2 * SEVERAL - 1, 2), (2 * SEVERAL, 1)):
        rows = torch.tensor([usual[i % len(usual)] for i in range(same)] + rare[:1])
        fitness = torch.linspace(1, 0, len(rows))
        chosen = Evaluated(everyone.population[rows], fitness, fitness[:, None])
        lineages = new_lineages(chosen, ACTIONS, 2)
        assert len({x.kind for x in lineages}) == expected
        assert lineages[0].fitness == 1


def test_a_lineage_is_over_at_each_of_its_limits_and_not_before() -> None:
    (lineage,) = few_lineages(1)
    assert not lineage.over
    for about, limit in (("step", LEAST_STEP), ("updates", MOST_UPDATES)):
        before, at = (limit, limit * 0.99) if about == "step" else (limit - 1, limit)
        for value, over in ((before, False), (at, True)):
            distribution = replace(lineage.distribution, **{about: value})
            assert replace(lineage, distribution=distribution).over is over
    assert not replace(lineage, since=STALL - 1).over
    assert replace(lineage, since=STALL).over


def after(lineage: Lineage, fitness: Tensor) -> Lineage:
    """The lineage after samples with a fitness."""
    drawn = samples([lineage], ACTIONS, seeded(1))
    scores = torch.stack([fitness - 1, fitness + 1], 1)
    (found,) = after_samples([lineage], Evaluated(drawn, fitness, scores), ACTIONS)
    return found


def test_a_lineage_keeps_its_best_and_the_mean_of_its_better_quarter() -> None:
    (lineage,) = few_lineages(1)
    assert lineage.recent_fitness == lineage.fitness
    count = usual_count(len(lineage.distribution.mean))
    fitness = torch.arange(count) / count - 3
    same = after(lineage, fitness)
    top = fitness[-(count // 4) :]
    assert count // 4 > 1
    assert same.recent == (pytest.approx(float(top.mean())),)
    assert same.level == same.recent_fitness == same.recent[0]
    assert (same.since, same.distribution.updates) == (0, 1)
    assert same.best is lineage.best
    assert after(replace(lineage, fitness=float(fitness[-1])), fitness).best is lineage.best
    better = after(replace(lineage, fitness=float(fitness[-2])), fitness)
    drawn = samples([lineage], ACTIONS, seeded(1))
    nodes = better.best.graphs.num_nodes
    assert torch.equal(
        better.best.graphs.parameters[0, :nodes], drawn.graphs.parameters[-1, :nodes]
    )
    assert better.fitness == fitness[-1]
    assert better.scores.tolist() == [fitness[-1] - 1, fitness[-1] + 1]
    full = after(replace(lineage, recent=tuple(float(i) for i in range(RECENT))), fitness)
    assert full.recent == (*(float(i) for i in range(1, RECENT)), same.recent[0])
    assert full.recent_fitness == pytest.approx(sum(full.recent) / RECENT)


@pytest.mark.parametrize("level", [-2.0, 2.0])
def test_only_a_hundredth_more_is_progress(level: float) -> None:
    (lineage,) = few_lineages(1)
    count = usual_count(len(lineage.distribution.mean))
    for more, since in ((0.9, 4), (1.1, 0)):
        value = level + more * LEAST_PROGRESS * abs(level)
        found = after(replace(lineage, level=level, since=3), torch.full((count,), value))
        assert found.since == since
        assert found.level == pytest.approx(level if since else value)


def test_the_better_half_with_each_kind_first_stays_at_a_rung() -> None:
    lineages = few_lineages(7)
    twin = replace(lineages[0], fitness=lineages[0].fitness - 1e-6)
    several = (twin, *lineages)
    for updates in (RUNGS[0] - 1, *RUNGS, RUNGS[0] + 1):
        at = [
            replace(each, distribution=replace(each.distribution, updates=updates))
            for each in several
        ]
        for count in (1, 4, 7, 8):
            going, ended = successive_halving(at[:count])
            if updates not in RUNGS:
                assert (going, ended) == (tuple(at[:count]), ())
                continue
            best = one_of_each_kind_first(sorted(at[:count], key=lambda each: -each.fitness))
            assert len(going) == (count + 1) // 2
            assert {id(each) for each in going} == {id(x) for x in best[: (count + 1) // 2]}
            assert {id(each) for each in (*going, *ended)} == {id(x) for x in at[:count]}
    stalled = replace(lineages[1], since=STALL)
    assert successive_halving([lineages[0], stalled]) == ((lineages[0],), (stalled,))


def test_the_better_half_stays_after_each_rung_and_a_stalled_one_goes() -> None:
    population = random_population(30, ACTIONS, 8, (2, 6), seeded(5))
    fitness = torch.rand(30, generator=seeded(6))
    lineages = new_lineages(Evaluated(population, fitness, fitness[:, None]), ACTIONS, 4)
    generator, sizes = seeded(7), []
    while lineages:
        sizes.append(len(lineages))
        drawn = samples(lineages, ACTIONS, generator)
        flat = torch.zeros(len(drawn))
        lineages, _ = successive_halving(
            after_samples(lineages, Evaluated(drawn, flat, flat[:, None]), ACTIONS)
        )
    assert sizes == [4] * RUNGS[0] + [2] * (RUNGS[1] - RUNGS[0]) + [1] * (STALL + 1 - RUNGS[1])


def test_tuning_reaches_what_mutation_does_not() -> None:
    best = {}
    for name, settings in (("tuned", SETTINGS), ("bred", replace(SETTINGS, lineages=0))):
        generator, used = seeded(8), 0
        state = initial_state(settings, ACTIONS, generator)
        best[name] = -1e9
        while used < 3000:
            fitness = fitness_of(state)
            used += len(fitness)
            best[name] = max(best[name], float(fitness.max()))
            state = tell(state, fitness, settings, ACTIONS, generator)
    assert 0 > best["tuned"] > 0.2 * best["bred"]


def test_random_populations_and_children_take_turns_and_nothing_good_is_lost() -> None:
    generator = seeded(9)
    state = initial_state(SETTINGS, ACTIONS, generator)
    turns, best = [], -1e9
    for _ in range(500):
        fitness = fitness_of(state)
        if not state.lineages:
            turns.append((state.distinct_parents > 0, len(fitness)))
        best = max(best, float(fitness.max()))
        state = tell(state, fitness, SETTINGS, ACTIONS, generator)
        if state.parents is not None and state.lineages:
            known = [float(state.parents.fitness.max()), *(x.fitness for x in state.lineages)]
            assert max(known) == pytest.approx(best)
    assert len(turns) >= 3
    assert {size for _, size in turns} == {SETTINGS.population}
    assert [is_bred for is_bred, _ in turns][:3] == [False, False, True]


@pytest.mark.parametrize("cut", [0, 4, 30])
def test_a_search_goes_on_from_a_checkpoint_with_the_same_bits(cut: int, tmp_path: Path) -> None:
    def following(search: object, count: int) -> list[Tensor]:
        return [next(search).population.graphs.parameters for _ in range(count)]  # type: ignore[call-overload]

    environment, generator = model(0, 3), seeded(10)
    search = evolve(environment, ACTIONS, SETTINGS, generator)
    for _ in range(cut):
        next(search)
    generation = next(search)
    found = Found(generation.champion, torch.zeros(3, dtype=torch.bool), 0.5)
    kept = FileJournal(tmp_path, seconds=0)
    kept.record_checkpoint("x", checkpoint_of(found, generation.islands, 1))
    wanted = [generation.population.graphs.parameters, *following(search, 6)]
    checkpoint = FileJournal(tmp_path).recall_checkpoint("x")
    assert checkpoint is not None
    other = seeded(11)
    islands = islands_from(checkpoint, ACTIONS, other, 1)
    again = evolve(environment, ACTIONS, SETTINGS, other, islands=islands)
    assert all(torch.equal(one, two) for one, two in zip(wanted, following(again, 7), strict=True))


def test_each_generation_can_have_an_environment_of_its_own() -> None:
    asked: list[int] = []

    def environment(number: int) -> object:
        asked.append(number)
        return model(number, 3)

    search = evolve(environment, ACTIONS, SETTINGS, seeded(13))  # type: ignore[arg-type]
    for _ in range(4):
        next(search)
    assert asked == [0, 1, 2, 3]


def test_settings_that_cannot_work_are_refused() -> None:
    for wrong in ({"lineages": -1}, {"lineages": 2, "islands": 3}):
        with pytest.raises(SettingsError, match="lineages is"):
            replace(REWARDS, **wrong)
