"""What a stage has cost, counted from what is told of it, and the numbers of its result."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from members import nearly
from support import seeded
from torch import Tensor

from cgtorch.evolution import Generation, Population
from cgtorch.evolution.population import random_population
from cgtorch.improvement.checkpoint import Found
from cgtorch.improvement.events import (
    EvolutionRecalled,
    GenerationDone,
    MeanTested,
    Practised,
    SkillAccepted,
)
from cgtorch.improvement.setup import Progress
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world import random_scenarios
from cgtorch.training.tally import Tally

SKILL = nearly(0.5)
ASKED = {"trials": {"motions": 7}}


def before(solved: int) -> Progress[Any]:
    return Progress(
        None, random_scenarios("near", solved, seeded(0)), random_scenarios("near", 3, seeded(1)),
        None,
    )  # fmt: skip


def accepted(succeeded: Tensor, keep: Tensor) -> SkillAccepted[Any]:
    scenarios = random_scenarios("near", len(keep), seeded(0))
    return SkillAccepted("S0", SKILL, scenarios, succeeded, keep, ~keep, 1.5)


def result_of(tally: Tally, seconds: float = 0.0) -> dict[str, Any]:
    return tally.result(before(6), SKILL, seconds, ASKED)


def test_a_stage_that_has_done_nothing_has_cost_nothing() -> None:
    tally = Tally()
    assert (tally.champion, tally.skill, tally.in_a_row, tally.episodes) == (None, None, 0, 0)
    assert tally.seconds == 0
    assert result_of(tally) == {
        "skill": SKILL.name,
        "w_size": 6,
        "w_lost": 0,
        "nodes": int(SKILL.graph.num_nodes),
        "depth": SKILL.depth,
        "generations": 0,
        "transitions": 0,
        "seconds": 0.0,
        "search_seconds": 0.0,
        "asked": ASKED,
    }


def test_times_are_told_to_a_tenth_and_those_of_searches_to_a_millisecond() -> None:
    found = result_of(Tally(searching=1.23456), seconds=12.3456)
    assert (found["seconds"], found["search_seconds"]) == (12.3, 1.235)


def test_what_w_has_lost_is_that_of_the_last_skill() -> None:
    """Of other scenarios none can be lost."""
    keep = torch.tensor([True, True, True, False, False])
    first = torch.tensor([False, False, False, False, True])
    last = torch.tensor([True, False, True, False, False])
    tally = Tally()
    for succeeded in (first, last):
        tally.count(accepted(succeeded, keep))
    assert result_of(tally)["w_lost"] == 1


def done(best: float, transitions: int, champion: Population, solved: int = 1) -> GenerationDone:
    """A generation with this champion, which took a quarter of a second."""
    generation = Generation(
        number=0,
        islands=(),
        fitness=torch.tensor([best]),
        champion=champion,
        best=best,
        succeeded=torch.tensor([True]),
        transitions=transitions,
        executed=transitions,
        scores=torch.tensor([[best]]),
        not_finite=0,
    )
    return GenerationDone("S0", "S0.1", 0, 0, solved, 8, generation, limit=9, seconds=0.25)


@pytest.mark.parametrize("best", [[0.1, 0.4, 0.4, 0.2], [-5.0, -2.0, -2.0, -3.0]])
def test_generations_add_up_and_the_first_of_the_fittest_stays(best: list[float]) -> None:
    champions = [random_population(1, paper_actions(), 4, (2, 4), seeded(n)) for n in range(4)]
    tally = Tally()
    for i, (each, champion) in enumerate(zip(best, champions, strict=True)):
        tally.count(done(each, 10 + i, champion))
    assert (tally.generations, tally.transitions, tally.searching) == (4, 46, 1.0)
    assert tally.champion is champions[1]
    assert tally.best == (1, best[1])


def test_what_is_recalled_counts_as_if_it_had_been_searched_for() -> None:
    champion = random_population(1, paper_actions(), 4, (2, 4), seeded(0))
    found = Found(
        champion,
        torch.tensor([True, False, True]),
        0.5,
        2,
        generations=5,
        transitions=30,
        seconds=1.5,
    )
    tally = Tally()
    tally.count(done(0.1, 10, champion))
    tally.count(EvolutionRecalled("S0", "S0.1", found))
    assert (tally.generations, tally.transitions, tally.searching) == (6, 40, 1.75)
    assert (tally.champion, tally.best) == (champion, (2, 0.5))


def test_who_solves_more_of_many_is_better_than_who_solves_few() -> None:
    few, many = (random_population(1, paper_actions(), 4, (2, 4), seeded(n)) for n in range(2))
    tally = Tally()
    tally.count(done(1.0, 10, few, solved=4))
    tally.count(done(0.6, 10, many, solved=5))
    tally.count(done(0.9, 10, few, solved=4))
    assert tally.champion is many


def test_the_last_skill_that_was_tried_is_known_with_what_it_came_to() -> None:
    tally, other = Tally(), replace(SKILL, name="other")
    tally.count(Practised("S0", SKILL, 3, 4))
    assert (tally.skill, tally.in_a_row) == (SKILL, 3)
    tally.count(Practised("S0", other, 0, 4))
    assert (tally.skill, tally.in_a_row) == (other, 0)
    tally.count(MeanTested("auto-1", SKILL, True, None, None, 7, 9, episodes=120))
    assert (tally.skill, tally.episodes) == (SKILL, 120)
