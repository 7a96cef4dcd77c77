"""Where an evolution of islands stands, kept and read again; nonsense in it is one error."""

from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from support import custom_actions, model, same, seeded
from torch import Tensor
from watched import of_kind, stage_of, without_models

from cgtorch.evolution import EvolutionSettings, Generation, evolve
from cgtorch.evolution.population import slim
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import Asked
from cgtorch.ground.errors import RunError
from cgtorch.improvement.checkpoint import (
    Checkpoint,
    Found,
    checkpoint_of,
    found_from,
    found_tensors,
    islands_from,
    state_tensors,
)
from cgtorch.improvement.events import EvolutionRecalled, GenerationDone
from cgtorch.improvement.setup import Budget
from cgtorch.improvement.specialists import evolve_candidate
from cgtorch.runs.journal import FileJournal

ACTIONS, ASKED = custom_actions(), Asked(steps=7, motions=2)


def second_generation(count: int) -> Generation:
    settings = EvolutionSettings(6, capacity=8, initial_nodes=(2, 6), islands=count, migration=1)
    search = evolve(model(0, 3), ACTIONS, settings, seeded(0))
    next(search)
    return next(search)


def stands(generation: Generation) -> Checkpoint:
    solved = torch.tensor([True, False, True])
    found = Found(generation.champion, solved, 0.1, 1, 1, 99, 1.7, ASKED)
    return checkpoint_of(found, generation.islands, len(generation.islands))


@pytest.mark.parametrize("interrupted", [False, True])
@pytest.mark.parametrize("count", [1, 3])
def test_what_is_kept_is_what_is_read(count: int, interrupted: bool, tmp_path: Path) -> None:
    """Interruptions come at any moment, most of them while the next generation is drawn."""
    generation = second_generation(count)
    states = [island.generator.get_state() for island in generation.islands]
    with suppress(KeyboardInterrupt), FileJournal(tmp_path, seconds=99 * interrupted) as journal:
        journal.record_checkpoint("x", stands(generation))
        if interrupted:
            for island in generation.islands:
                torch.rand(1000, generator=island.generator)
        raise KeyboardInterrupt
    checkpoint = FileJournal(tmp_path).recall_checkpoint("x")
    assert checkpoint is not None
    found = found_from(checkpoint.about, ACTIONS, 3)
    assert (found.best, found.since, found.generations, found.transitions) == (0.1, 1, 1, 99)
    assert (found.seconds, found.asked) == (1.7, ASKED)
    assert found.solved.tolist() == [True, False, True]
    assert same(found.champion.graphs, generation.champion.graphs)
    generator = seeded(9)
    islands = islands_from(checkpoint, ACTIONS, generator, count)
    assert islands[0].generator is generator
    for island, wanted, state in zip(islands, generation.islands, states, strict=True):
        assert same(island.population.graphs, wanted.population.graphs)
        assert torch.equal(island.population.strategy, wanted.population.strategy)
        assert island.generation == wanted.generation == 1
        assert torch.equal(island.generator.get_state(), state)


def test_another_count_of_islands_is_refused() -> None:
    with pytest.raises(RunError, match="has 3 islands, not 2; remove it"):
        islands_from(stands(second_generation(3)), ACTIONS, seeded(0), 2)


@pytest.mark.parametrize(
    "bad",
    [
        {"generator": torch.zeros(3)},
        {"generator": None},
        {"population.edges": torch.full((6, 8, 3), 99)},
        {"population.strategy": torch.zeros(5, 8)},
        {"population.action": None},
    ],
)
def test_an_island_that_makes_no_sense_is_one_error(bad: dict[str, Any]) -> None:
    """Whole files with nonsense in them: somebody wrote them on purpose."""
    generation = second_generation(2)
    tensors: dict[str, Tensor] = state_tensors(generation.islands[1])
    odd = {name: value for name, value in {**tensors, **bad}.items() if value is not None}
    checkpoint = stands(generation)
    parts = (checkpoint.parts[0], partial(dict, odd))
    with pytest.raises(RunError, match="the checkpoint of an evolution is damaged") as caught:
        islands_from(replace(checkpoint, parts=parts), ACTIONS, seeded(0), 2)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["champion.start", "solved", "counts", "numbers", "generations"])
def test_what_it_has_come_to_and_makes_no_sense_is_one_error(name: str) -> None:
    about = found_tensors(Found(second_generation(1).champion, torch.ones(3) > 0, 0.5))
    without = {k: v for k, v in about.items() if k != name}
    for bad in (without, {**about, name: torch.full((2, 2), 1j)}, {**about, name: torch.ones(3)}):
        with pytest.raises(RunError, match="the checkpoint of an evolution is damaged"):
            found_from(bad, ACTIONS, 3)


def test_what_is_solved_is_told_of_each_scenario() -> None:
    found = Found(second_generation(1).champion, torch.ones(3) > 0, 0.5)
    assert found_from(found_tensors(found), ACTIONS, 3).solved.all()
    with pytest.raises(RunError, match="damaged"):
        found_from(found_tensors(found), ACTIONS, 4)


def test_islands_of_other_ranks_are_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    generation = second_generation(3)
    assert not stands(generation).apart
    assert not Checkpoint({}, ()).apart
    monkeypatch.setattr(ranks, "held", lambda count: range(1))
    found = Found(generation.champion, torch.ones(3) > 0, 0.5)
    assert checkpoint_of(found, generation.islands[:1], 3).apart


def test_only_clearly_more_fitness_is_a_better_champion() -> None:
    generation = second_generation(1)
    nobody = generation.population[:1]
    for ahead, better in ((0.2, True), (0.05, False), (-1.0, False)):
        before = Found(nobody, torch.zeros(3, dtype=torch.bool), generation.best - ahead)
        after = before.after(generation, 2.0, 0.1, Asked(steps=3)).after(generation, 0.5, 0.1)
        assert (after.generations, after.transitions) == (2, 2 * generation.transitions)
        assert (after.seconds, after.asked) == (2.5, Asked(steps=3))
        assert after.since == (1 if better else 2)
        assert after.best == (generation.best if better else before.best)
        wanted = generation.champion if better else nobody
        assert same(after.champion.graphs, slim(wanted).graphs) or not better
        assert torch.equal(after.solved, generation.succeeded if better else before.solved)
    as_good = Found(nobody, generation.succeeded, generation.best)
    assert as_good.after(generation, 1.0, 0.0).since == 1


def test_an_interrupted_evolution_goes_on_with_its_last_generation(tmp_path: Path) -> None:
    told: list[Any] = []
    setup = without_models(budget=Budget(generations=3, enough=2.0, patience=9))
    whole = evolve_candidate(stage_of(setup), "S1.1", model(0, 5))

    def watch(event: Any) -> None:
        told.append(event)
        if len(of_kind(told, GenerationDone)) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), FileJournal(tmp_path, seconds=0) as journal:
        evolve_candidate(replace(stage_of(setup, watch), journal=journal), "S1.1", model(0, 5))
    told.clear()
    with FileJournal(tmp_path) as journal:
        again = replace(stage_of(setup, told.append), journal=journal)
        found = evolve_candidate(again, "S1.1", model(0, 5))
    (recalled,) = of_kind(told, EvolutionRecalled)
    assert recalled.found.generations == 1
    assert [each.generation.number for each in of_kind(told, GenerationDone)] == [1, 2]
    assert same(found.champion.graphs, whole.champion.graphs)
    assert replace(found, champion=whole.champion, solved=whole.solved, seconds=0.0) == replace(
        whole, seconds=0.0
    )
