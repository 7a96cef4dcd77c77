"""The value of an individual: eq. 3, compiled and in torch, functions of one's own, and returns."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from random_models import random_models
from support import (
    as_double,
    as_double_actions,
    custom_actions,
    judged_by,
    model,
    nested_actions,
    random_graphs,
    seeded,
)
from torch import Tensor

from cgtorch.evolution import (
    chance_of_success,
    evaluator,
)
from cgtorch.evolution.fitness import Evaluation
from cgtorch.evolution.population import random_population
from cgtorch.graphs import ActionSet
from cgtorch.ground.numerics import row_means
from cgtorch.native import available
from cgtorch.simulation import ModelEnvironment, Rollouts, rollout
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.edge_networks import edge_actions

ACTIONS = custom_actions()
SETS = [as_double_actions(s) for s in (paper_actions(), nested_actions(0, paper_actions()))]
compiled = pytest.mark.skipif(not available(), reason="there is no C compiler")


@given(st.integers(0, 2**31), st.lists(st.booleans(), min_size=4, max_size=4))
def test_fitness_is_that_of_equation_3(seed: int, kept: list[bool]) -> None:
    graphs = random_population(12, ACTIONS, 12, (2, 10), seeded(seed)).graphs
    environment, keep = model(seed, 4), torch.tensor(kept)
    found = evaluator(ACTIONS, environment, keep)(graphs)
    runs = rollout(graphs, ACTIONS, environment)
    for i in range(12):
        lost = any(k and not s for k, s in zip(kept, runs.succeeded[i].tolist(), strict=True))
        score = [
            float(environment.classifier(runs.percept[i, j : j + 1])[0])
            * (1 if runs.succeeded[i, j] else 0.5)
            for j in range(4)
        ]
        assert float(found.fitness[i]) == pytest.approx(0 if lost else sum(score) / 4, abs=1e-6)
        if not lost:
            assert torch.equal(found.succeeded[i], runs.succeeded[i])


@pytest.mark.parametrize("most", [1, 4, 10, 39])
def test_how_many_run_at_once_changes_nothing(most: int) -> None:
    graphs = random_population(13, ACTIONS, 12, (2, 10), seeded(0)).graphs
    environment, keep = model(0, 4), torch.tensor([True, False, False, False])
    whole, parts = (
        evaluator(ACTIONS, environment, keep, **limit)(graphs)
        for limit in ({}, {"most_lanes": most})
    )
    assert 0 < whole.succeeded.sum() < whole.succeeded.numel()
    for name, value in vars(whole).items():
        assert torch.equal(torch.as_tensor(getattr(parts, name)), torch.as_tensor(value)), name


def test_what_is_not_finite_costs_its_individual_and_no_other() -> None:
    graphs = random_population(40, ACTIONS, 12, (2, 10), seeded(1)).graphs
    environment, keep = model(0, 4), torch.zeros(4, dtype=torch.bool)
    clean = evaluator(ACTIONS, environment, keep)(graphs)
    ends = rollout(graphs, ACTIONS, environment).percept
    limit = float(ends[..., 4].flatten().quantile(0.75))
    whole = environment.classifier

    def broken(percept: torch.Tensor) -> torch.Tensor:
        return torch.where(percept[:, 4] > limit, float("nan"), whole(percept))

    environment = judged_by(environment, broken)
    graphs.parameters[7, int(graphs.start[7]), 0] = float("inf")
    found = evaluator(ACTIONS, environment, keep)(graphs)
    again = rollout(graphs, ACTIONS, environment).percept
    bad = ((again[..., 4] > limit) | ~again.isfinite().all(-1)).any(1)
    bad[7] = True
    assert 2 < bad.sum() < 38
    assert found.not_finite == int(bad.sum())
    assert clean.not_finite == 0
    assert (found.fitness[bad] == 0).all()
    assert not found.succeeded[bad].any()
    untouched = ~bad & (again == ends).flatten(1).all(1)
    assert untouched.sum() > 3
    assert torch.equal(found.fitness[untouched], clean.fitness[untouched])


class InTorch(ModelEnvironment):
    """The same models, but no longer what compiled code knows."""


def both(
    seed: int, actions: ActionSet, keep: torch.Tensor, limit: int, broken: bool = False
) -> tuple[Evaluation, Evaluation]:
    environment = random_models(seed, len(keep))
    graphs = as_double(random_graphs(seed, 9, actions))
    if broken:
        graphs.parameters[2, 0, 0] = torch.nan
        graphs.parameters[3, 0, 1] = torch.inf
        environment.percepts[1, 5] = torch.nan
        environment.first_state[1, 2] = torch.nan
    compiled = evaluator(actions, environment, keep, limit, most_lanes=40)(graphs)
    environment.__class__ = InTorch
    return compiled, evaluator(actions, environment, keep, limit)(graphs)


def assert_same(found: Evaluation, wanted: Evaluation) -> None:
    for each in (found, wanted):
        assert torch.equal(each.fitness, row_means(each.scores))
    assert torch.equal(found.succeeded, wanted.succeeded)
    assert found.transitions == wanted.transitions
    assert found.not_finite == wanted.not_finite
    torch.testing.assert_close(found.scores, wanted.scores, atol=1e-6, rtol=0)
    torch.testing.assert_close(found.fitness, wanted.fitness, atol=1e-6, rtol=0)


@compiled
@given(
    seed=st.integers(0, 2**31),
    actions=st.sampled_from(SETS),
    share=st.floats(0, 1),
    limit=st.integers(1, 20),
    broken=st.booleans(),
)
@settings(max_examples=15, deadline=None)
def test_compiled_fitness_is_that_of_torch(
    seed: int, actions: ActionSet, share: float, limit: int, broken: bool
) -> None:
    keep = torch.rand(19, generator=seeded(seed)) < share  # more than a vector of lanes
    assert_same(*both(seed, actions, keep, limit, broken))


def test_the_comparison_meets_graphs_that_lose_and_keep_w() -> None:
    keep = torch.zeros(16, dtype=torch.bool)
    environment = random_models(3, 16)
    graphs = as_double(random_graphs(3, 200, SETS[0]))
    solved = evaluator(SETS[0], environment, keep)(graphs).succeeded
    keep[solved.sum(0).argsort(descending=True)[:2]] = True
    found = evaluator(SETS[0], environment, keep)(graphs)
    kept = found.succeeded[:, keep].all(1)
    assert 5 < int(kept.sum()) < 195
    assert bool((found.scores[~kept] == 0).all())
    assert not bool(found.succeeded[~kept][:, ~keep].any())


@compiled
def test_edge_networks_are_compiled_too() -> None:
    actions = as_double_actions(edge_actions(7))
    assert_same(*both(5, actions, torch.arange(8) < 2, 20))


def hurried(runs: Rollouts, probability: Tensor) -> Tensor:
    """Who needs fewer actions is better."""
    return torch.where(runs.succeeded, 1 / runs.transitions, 0.0)


def test_what_a_run_is_worth_is_ones_own() -> None:
    graphs = random_population(300, ACTIONS, 12, (2, 10), seeded(0)).graphs
    environment, keep = model(0, 5), torch.tensor([True, False, False, False, False])
    found = evaluator(ACTIONS, environment, keep, fitness=hurried)(graphs)
    runs = rollout(graphs, ACTIONS, environment)
    kept = runs.succeeded[:, 0]
    assert 0 < kept.sum() < 300
    expected = hurried(runs, torch.zeros(300, 5)) * kept[:, None]
    assert torch.equal(found.scores, expected)
    assert torch.equal(found.fitness, expected.mean(1))
    usual = evaluator(ACTIONS, environment, keep)(graphs)
    assert torch.equal(found.succeeded, usual.succeeded)
    assert not torch.equal(found.scores, usual.scores)


def test_worth_that_is_no_number_or_negative() -> None:
    def odd(runs: Rollouts, probability: Tensor) -> Tensor:
        worth = chance_of_success(runs, probability) + 0.5
        worth[3] = torch.nan
        worth[5] = -7
        return worth

    graphs = random_population(20, ACTIONS, 12, (2, 10), seeded(0)).graphs
    environment, keep = model(0, 4), torch.zeros(4, dtype=torch.bool)
    found, usual = (evaluator(ACTIONS, environment, keep, fitness=f)(graphs)
                    for f in (odd, chance_of_success))  # fmt: skip
    assert found.not_finite == usual.not_finite + 1
    assert (found.scores[[3, 5]] == 0).all()
    assert not found.succeeded[3].any()
    assert torch.equal(found.succeeded[5], usual.succeeded[5])
    rest = [i for i in range(20) if i not in (3, 5)]
    assert torch.equal(found.scores[rest], usual.scores[rest] + 0.5)
