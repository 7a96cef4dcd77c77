"""Races: who runs on which scenarios, and what counts of those who do not."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import custom_actions, model, seeded
from torch import Tensor

from cgtorch.evolution import evaluator, race
from cgtorch.evolution.population import random_population
from cgtorch.evolution.racing import WAVE
from cgtorch.graphs import Graphs, compacted

ACTIONS = custom_actions()


def described(graph: Graphs) -> tuple[list[int], list[Tensor]]:
    """What tells a graph apart: its nodes, of which each has its action, edges and parameters.

    The same nodes may be in other slots, as there are few kinds of very small graphs.
    """
    graph = compacted(graph)
    used = graph.used[0]
    return [int(graph.start)], [x[0, used] for x in (graph.action, graph.edges, graph.parameters)]


def raced(scores: Tensor, solved: Tensor, names: list[str]) -> tuple[Tensor, Tensor, Tensor]:
    """A slow reference: what is known in the end of scores, successes and who ran, (P, B) each."""
    count, scenarios = scores.shape
    ran = torch.zeros_like(solved)

    def meets(one: int, scenario: int) -> bool:
        for other in range(count):
            ran[other, scenario] |= names[other] == names[one]
        return bool(solved[one, scenario])

    first = next((i for i in range(scenarios) if not meets(0, i)), 0)
    order = [first, *(i for i in range(scenarios) if i != first)]
    for begin in range(1, count, WAVE):
        if (solved & ran).all(1).any():
            break
        wave = range(begin, min(count, begin + WAVE))
        for one in wave:
            all(meets(one, scenario) for scenario in order)
        for one in wave:
            if scores[one, first] > scores[0, first]:
                all(meets(one, scenario) for scenario in range(first))
    return scores * ran, solved & ran, ran


@given(st.integers(0, 2**31), st.integers(1, 9), st.integers(2, 14))
def test_a_race_is_what_the_reference_says(seed: int, scenarios: int, count: int) -> None:
    some = random_population(count, ACTIONS, 12, (2, 10), seeded(seed)).graphs
    graphs = some[torch.randint(count, (count,), generator=seeded(seed + 1))]
    environment, keep = model(seed, scenarios), torch.zeros(scenarios, dtype=torch.bool)
    evaluation = evaluator(ACTIONS, environment, keep, scenarios=torch.arange(scenarios))
    if seed % 2:  # the first one solves the most, so that others may be closer to the rest
        graphs = graphs[evaluation(graphs).succeeded.sum(1).argsort(descending=True)]
    whole = evaluation(graphs)
    names = [str(described(graphs[i : i + 1])) for i in range(count)]
    evaluate = race(ACTIONS, environment, keep)
    found = evaluate(graphs)
    scores, succeeded, ran = raced(whole.scores, whole.succeeded, names)
    assert torch.equal(found.scores, scores)
    assert torch.equal(found.succeeded, succeeded)
    assert torch.allclose(found.fitness, scores.mean(1))
    assert found.transitions <= whole.transitions
    again = evaluate(graphs)
    if found.succeeded.all(1).any() or ran.all():  # so nothing is left that could be run
        assert again.transitions == again.executed == 0
    assert torch.equal(again.succeeded & ran, succeeded)


def test_a_race_ends_when_one_has_solved_all() -> None:
    graphs = random_population(400, ACTIONS, 12, (2, 10), seeded(0)).graphs
    environment, keep = model(0, 2), torch.zeros(2, dtype=torch.bool)
    whole = evaluator(ACTIONS, environment, keep)(graphs)
    good = int(whole.succeeded.all(1).nonzero()[0])
    after = graphs[torch.tensor([good, *(i for i in range(400) if i != good)])]
    found = race(ACTIONS, environment, keep)(after)
    assert found.succeeded[0].all()
    assert found.transitions <= whole.transitions / 40
    assert found.scores[1:].count_nonzero() == 0


@pytest.mark.parametrize("kept", [[True, False, False], [True]])
def test_with_some_of_w_there_is_no_race(kept: list[bool]) -> None:
    graphs = random_population(12, ACTIONS, 12, (2, 10), seeded(0)).graphs
    environment, keep = model(0, len(kept)), torch.tensor(kept)
    whole, found = (make(ACTIONS, environment, keep)(graphs) for make in (evaluator, race))
    assert torch.equal(found.scores, whole.scores)
    assert found.transitions == whole.transitions
