"""Calls of compiled code keep no memory: the process grows by nothing that each of them takes."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from dual_problems import dual_problems, ones, rows
from random_models import random_models
from support import random_graphs

from cgtorch.evolution import compiled
from cgtorch.native import available
from cgtorch.simulation.rollout import engine_of
from cgtorch.svm.problems import at_zero
from cgtorch.svm.rbf import Gram
from cgtorch.svm.smo import compiled_smo_steps
from cgtorch.tabletop.actions import paper_actions

SIZE, PAGE, CALLS = Path("/proc/self/statm"), 4096, 40
MOST = CALLS * 50_000  # bytes

pytestmark = pytest.mark.skipif(
    not (available() and SIZE.exists()), reason="memory is counted as Linux tells it"
)


def selection() -> Callable[[], object]:
    scores = torch.rand(9000, 2, dtype=torch.float64)
    epsilon = compiled.deviation(scores)
    return lambda: compiled.lexicase(scores, epsilon, 8, 1)


def deviations() -> Callable[[], object]:
    scores = torch.rand(9000, 2, dtype=torch.float64)
    return lambda: compiled.deviation(scores)


def ranking() -> Callable[[], object]:
    graphs = random_graphs(0, 1, paper_actions())[torch.zeros(9000, dtype=torch.long)]
    fitness = torch.rand(9000)
    return lambda: compiled.ranking(fitness, graphs)


def solver() -> Callable[[], object]:
    x = rows(1, 20)
    problems, gram = dual_problems(x[:, 0], 1.0), Gram(x, 0.5)
    return lambda: compiled_smo_steps(
        gram.double, problems, at_zero(problems), 1e-3 * ones(1), 1e9, 1
    )


def rollouts() -> Callable[[], object]:
    environment, actions = random_models(0, 400), paper_actions()
    engine, graphs = engine_of(actions, environment), random_graphs(0, 1, actions)
    graphs.parameters.data = graphs.parameters.double()
    assert engine is not None
    return lambda: engine.rollouts(graphs, torch.arange(400), 1, 1)


@pytest.mark.parametrize("of", [selection, deviations, ranking, solver, rollouts])
def test_memory_is_given_back(of: Callable[[], Callable[[], object]]) -> None:
    def size() -> int:
        return PAGE * int(SIZE.read_text().split()[0])

    call = of()
    call()
    before = size()
    for _ in range(CALLS):
        call()
    assert size() - before < MOST
