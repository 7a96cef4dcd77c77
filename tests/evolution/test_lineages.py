"""Lineages: which structures they are of, what is tuned, how they race, and how searches go on."""

from dataclasses import replace
from pathlib import Path

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
from cgtorch.evolution.fitness import WORST
from cgtorch.evolution.lineages import (
    RUNGS,
    STALL,
    after_samples,
    new_lineages,
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


def test_one_of_each_kind_is_founded_first_and_none_unfinished() -> None:
    population = random_population(40, ACTIONS, 8, (2, 3), seeded(3))
    fitness = torch.rand(40, generator=seeded(4))
    fitness[:20] = WORST
    lineages = new_lineages(Evaluated(population, fitness, fitness[:, None]), ACTIONS, 6)
    kinds = [tuple(sorted(x.best.graphs.action[0].tolist())) for x in lineages]
    assert len(set(kinds[: len(set(kinds))])) == len(set(kinds))
    assert all(x.fitness >= 0 for x in lineages)


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
