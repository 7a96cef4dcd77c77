"""Races: who runs on which scenarios, and what counts of those who do not."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import custom_actions, model, seeded
from torch import Tensor

from cgtorch.evolution import evaluator, race
from cgtorch.evolution.population import random_population

ACTIONS = custom_actions()


def raced(scores: Tensor, solved: Tensor) -> tuple[Tensor, Tensor]:
    """A slow reference: scores and successes (P, B) of those who come that far."""
    alive = list(range(len(scores)))
    seen, won = torch.zeros_like(scores), torch.zeros_like(solved)
    begin, end = 0, 1
    while begin < scores.shape[1]:
        for one in alive:
            seen[one, begin:end] = scores[one, begin:end]
            won[one, begin:end] = solved[one, begin:end]
        ranked = sorted(alive, key=lambda one: -float(seen[one, :end].mean()))
        half = max(2, len(alive) // 2)
        better = ranked[: half if won[:, begin:end].any() else 1]
        alive = [one for one in alive if one in (0, *better) or won[one, :end].all()]
        begin, end = end, min(2 * end, scores.shape[1])
    return seen, won


@given(st.integers(0, 2**31), st.integers(2, 9), st.integers(2, 14))
def test_a_race_is_what_the_reference_says(seed: int, scenarios: int, count: int) -> None:
    graphs = random_population(count, ACTIONS, 12, (2, 10), seeded(seed)).graphs
    environment, keep = model(seed, scenarios), torch.zeros(scenarios, dtype=torch.bool)
    whole = evaluator(ACTIONS, environment, keep, scenarios=torch.arange(scenarios))(graphs)
    found = race(ACTIONS, environment, keep)(graphs)
    scores, succeeded = raced(whole.scores, whole.succeeded)
    assert torch.equal(found.scores, scores)
    assert torch.equal(found.succeeded, succeeded)
    assert torch.allclose(found.fitness, scores.mean(1))
    assert found.transitions <= whole.transitions


def test_a_race_is_shorter_than_a_whole_evaluation() -> None:
    graphs = random_population(64, ACTIONS, 12, (2, 10), seeded(0)).graphs
    environment, keep = model(0, 16), torch.zeros(16, dtype=torch.bool)
    whole, found = (make(ACTIONS, environment, keep)(graphs) for make in (evaluator, race))
    assert found.succeeded.any()
    assert found.transitions < whole.transitions / 2
    assert found.fitness.argmax() in whole.fitness.topk(32).indices


@pytest.mark.parametrize("kept", [[True, False, False], [False]])
def test_with_some_of_w_or_one_scenario_there_is_no_race(kept: list[bool]) -> None:
    graphs = random_population(12, ACTIONS, 12, (2, 10), seeded(0)).graphs
    environment, keep = model(0, len(kept)), torch.tensor(kept)
    whole, found = (make(ACTIONS, environment, keep)(graphs) for make in (evaluator, race))
    assert torch.equal(found.scores, whole.scores)
    assert found.transitions == whole.transitions
