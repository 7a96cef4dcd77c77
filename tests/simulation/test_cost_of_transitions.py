"""Eq. 3 with a cost of transitions: in torch, compiled, and in so many words."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from random_kernel_models import DOMAINS, actions_for, random_kernel_models
from random_models import models_as, random_models
from support import as_double, as_double_actions, nested_actions, random_graphs, seeded
from torch import Tensor

from cgtorch.evolution import COST, ChanceOfSuccess, chance_of_success
from cgtorch.evolution.fitness import LEAST, Evaluation, Parts, _by_rollouts, evaluator
from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground.environment import start_lanes
from cgtorch.native import available
from cgtorch.simulation import ModelEnvironment, Rollouts
from cgtorch.simulation.rollout import engine_of
from cgtorch.tabletop.actions import paper_actions

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

SETS = [paper_actions(), nested_actions(0, paper_actions())]
COSTS = st.sampled_from([0.0, COST, 1.0]) | st.floats(0, 0.3)


def plainly(cost: float, runs: Rollouts, chance: Tensor) -> list[list[float]]:
    """The values lane by lane."""
    return [
        [
            (p if success else p / 2) * max(LEAST, 1 - cost * steps)
            for p, success, steps in zip(*row, strict=True)
        ]
        for row in zip(
            chance.tolist(), runs.succeeded.tolist(), runs.transitions.tolist(), strict=True
        )
    ]


def some_runs(seed: int) -> tuple[Rollouts, Tensor]:
    g = seeded(seed)
    succeeded = torch.rand(3, 5, generator=g) < 0.5
    transitions = torch.randint(0, 400, (3, 5), generator=g)
    nothing = torch.zeros(3, 5, 1)
    runs = Rollouts(succeeded, ~succeeded, nothing, nothing, transitions, 0)
    return runs, torch.rand(3, 5, generator=g)


def by_rollouts(
    graphs: Graphs,
    actions: ActionSet,
    place: ModelEnvironment,
    keep: Tensor,
    limit: int,
    cost: float,
) -> Parts:
    """The evaluation in torch, on all scenarios."""
    every = torch.arange(len(keep))
    return _by_rollouts(graphs, actions, place, keep, limit, ChanceOfSuccess(cost), every)


@given(st.integers(0, 2**20), COSTS)
def test_values_are_what_they_are_said_to_be(seed: int, cost: float) -> None:
    runs, chance = some_runs(seed)
    found = ChanceOfSuccess(cost)(runs, chance)
    torch.testing.assert_close(found, torch.tensor(plainly(cost, runs, chance)))
    assert ((found >= 0) & (found <= 1)).all()
    free = chance_of_success(runs, chance)
    assert (found <= free).all()
    assert (found >= LEAST * free - 1e-6).all()


def test_without_a_cost_it_is_eq_3_as_published() -> None:
    runs, chance = some_runs(0)
    wanted = torch.where(runs.succeeded, chance, chance / 2)
    assert torch.equal(chance_of_success(runs, chance), wanted)
    assert chance_of_success == ChanceOfSuccess(0.0)


def engine_evaluation(
    graphs: Graphs,
    actions: ActionSet,
    environment: ModelEnvironment,
    keep: Tensor,
    limit: int,
    cost: float,
) -> tuple[Tensor, Tensor, Tensor, int, int, int]:
    engine = engine_of(actions, environment)
    assert engine is not None
    order = torch.argsort(~keep, stable=True)
    found = engine.evaluation(graphs, order, int(keep.sum()), limit, 400, cost)
    assert found is not None
    return found


def scored(found: tuple[Tensor, Tensor, Tensor, int, int, int]) -> Tensor:
    assert not found[5]
    return found[1]


class InTorch(ModelEnvironment):
    """The same models, but no longer what compiled code knows."""


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**31),
    dtype=st.sampled_from([torch.float32, torch.float64]),
    actions=st.sampled_from(SETS),
    share=st.sampled_from([0.0, 0.1, 0.4]),
    limit=st.integers(1, 20),
    cost=COSTS,
)
def test_compiled_values_are_those_of_torch(
    seed: int, dtype: torch.dtype, actions: ActionSet, share: float, limit: int, cost: float
) -> None:
    """In float32, where rollouts in torch may part from compiled ones, those of the same."""
    environment, graphs = models_as(random_models(seed, 7), dtype), random_graphs(seed, 9, actions)
    if dtype == torch.float64:
        graphs, actions = as_double(graphs), as_double_actions(actions)
    keep = torch.rand(7, generator=seeded(seed)) < share
    found = engine_evaluation(graphs, actions, environment, keep, limit, cost)
    if dtype == torch.float64:
        environment.__class__ = InTorch
    wanted = by_rollouts(graphs, actions, environment, keep, limit, cost)
    assert torch.equal(found[2], wanted[2])
    torch.testing.assert_close(found[1], wanted[1].to(found[1]), atol=1e-6, rtol=0)
    torch.testing.assert_close(found[0], wanted[0], atol=1e-6, rtol=0)
    assert found[3] == wanted[3]
    assert found[5] == wanted[5]


@pytest.mark.parametrize("domain", DOMAINS)
def test_compiled_values_of_any_domain_are_those_of_torch(domain: str) -> None:
    environment = random_kernel_models(3, 7, *DOMAINS[domain])
    actions, keep = actions_for(environment, 4, True), torch.zeros(7, dtype=torch.bool)
    graphs = as_double(random_graphs(4, 20, actions))
    for cost in (0.0, COST, 0.2):
        found = engine_evaluation(graphs, actions, environment, keep, 20, cost)
        wanted = by_rollouts(graphs, actions, environment, keep, 20, cost)
        torch.testing.assert_close(found[1], wanted[1].to(found[1]), atol=1e-6, rtol=0)


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**31),
    dtype=st.sampled_from([torch.float32, torch.float64]),
    limit=st.integers(1, 20),
    cost=COSTS,
)
def test_compiled_values_are_what_they_are_said_to_be(
    seed: int, dtype: torch.dtype, limit: int, cost: float
) -> None:
    """From the rollouts of the same engine, whose chances are asked in torch."""
    environment, actions = models_as(random_models(seed, 7), dtype), paper_actions()
    graphs = random_graphs(seed, 9, actions)
    graphs = graphs if dtype == torch.float32 else as_double(graphs)
    keep, engine = torch.zeros(7, dtype=torch.bool), engine_of(actions, environment)
    assert engine is not None
    runs = engine.rollouts(graphs, torch.arange(7), limit, 400)
    assert runs is not None
    lanes = start_lanes(environment, torch.arange(7).repeat(9), 0, 0)
    lanes = lanes.moved(runs.state.flatten(0, 1), runs.percept.flatten(0, 1))
    chance = environment.success(lanes)[1].view(9, 7)
    found = scored(engine_evaluation(graphs, actions, environment, keep, limit, cost))
    wanted = torch.tensor(plainly(cost, runs, chance))
    torch.testing.assert_close(found.float(), wanted, atol=2e-5, rtol=0)
    free = scored(engine_evaluation(graphs, actions, environment, keep, limit, 0.0))
    left = (1 - cost * runs.transitions.to(free)).clamp_min(LEAST)
    torch.testing.assert_close(found, free * left, atol=1e-6, rtol=0)


def test_an_evaluator_hands_the_cost_on() -> None:
    """Whichever engine runs, and in however many parts."""
    environment, actions = random_models(5, 8), as_double_actions(paper_actions())
    graphs, keep = as_double(random_graphs(5, 60, actions)), torch.zeros(8, dtype=torch.bool)
    solved = evaluator(actions, environment, keep)(graphs).succeeded
    keep[solved.sum(0).argmax()] = True
    assert solved[:, keep].any()

    def evaluated(fitness: ChanceOfSuccess, lanes: int) -> Evaluation:
        return evaluator(actions, environment, keep, most_lanes=lanes, fitness=fitness)(graphs)

    dear, free = (evaluated(ChanceOfSuccess(cost), 10**6) for cost in (0.05, 0.0))
    assert (dear.fitness <= free.fitness).all()
    assert (dear.fitness < free.fitness).any()
    parts = evaluated(ChanceOfSuccess(0.05), 20)
    assert torch.equal(parts.scores, dear.scores)
    wanted = by_rollouts(graphs, actions, environment, keep, 20, 0.05)
    torch.testing.assert_close(dear.scores, wanted[1].to(dear.scores), atol=1e-6, rtol=0)


def test_of_two_that_succeed_the_shorter_is_fitter() -> None:
    runs, chance = some_runs(1)
    runs.succeeded[:], chance[:] = True, 1.0
    runs.transitions[0], runs.transitions[1] = 2, 9
    value = ChanceOfSuccess(COST)(runs, chance)
    assert (value[0] > value[1]).all()
    assert torch.equal(*chance_of_success(runs, chance)[:2])


def test_evaluations_count_what_their_rollouts_would_until_one_of_the_kept_is_lost() -> None:
    environment, actions = random_models(4, 21), SETS[0]
    engine, graphs = engine_of(actions, environment), as_double(random_graphs(4, 60, actions))
    assert engine is not None
    for number in range(21):
        some = torch.arange(21).roll(number)
        runs = engine.rollouts(graphs, some, 20, 60)
        assert runs is not None
        steps, lost = runs.transitions, ~runs.succeeded[:, 0]
        if 5 < int(lost.sum()) < 55:
            break
    for kept, counted in (
        (0, steps.sum()), (1, steps[~lost].sum() + steps[lost, 0].sum()), (21, steps.sum()),
    ):  # fmt: skip
        found = engine.evaluation(graphs, some, kept, 20, 60)
        assert found is not None
        assert found[3] == int(counted)
        assert found[4] == runs.executed if kept != 1 else 0 < found[4] < runs.executed
        assert found[5] == 0
    graphs.parameters[7, 3, 0] = torch.nan
    graphs.parameters[9, 0, 1] = torch.inf
    spoilt = engine.evaluation(graphs, some, 0, 20, 60)
    assert spoilt is not None
    assert spoilt[5] == 2
    assert float(spoilt[1][[7, 9]].abs().max()) == 0
    assert not bool(spoilt[2][[7, 9]].any())
