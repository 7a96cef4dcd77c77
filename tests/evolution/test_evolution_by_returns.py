"""Evolution by returns: any return counts, and an episode that is not finished counts least."""

from dataclasses import replace

import pytest
import torch
from support import model, random_graphs, seeded
from torch import Tensor
from walking import Path, RewardedPath, TinyPath, Walks, chain, path, walking_actions

from cgtorch.evolution import (
    EvolutionSettings,
    Population,
    chance_of_success,
    episode_return,
    evaluator,
    evolve,
    initial_strategy,
    lexicase,
    tournament,
)
from cgtorch.evolution.fitness import WORST, WORTHLESS
from cgtorch.evolution.selection import deviation
from cgtorch.ground.environment import Lanes
from cgtorch.ground.errors import SettingsError
from cgtorch.improvement import specialists
from cgtorch.improvement.specialists import READABLE, shrunk
from cgtorch.simulation import Rollouts, rollout
from cgtorch.tabletop.actions import paper_actions

ACTIONS = walking_actions()
NOTHING = torch.zeros(5, dtype=torch.bool)
SMALL = EvolutionSettings(
    population=60, capacity=12, selection=tournament(5), fitness=episode_return
)


def returns_of(runs: Rollouts) -> Tensor:
    assert runs.returns is not None
    return runs.returns


def test_scores_are_the_returns_and_none_is_the_worst_of_all() -> None:
    graphs, place = random_graphs(0, 200, ACTIONS), path(0, 5, longest=5)
    found = evaluator(ACTIONS, place, NOTHING, fitness=episode_return)(graphs)
    returns = returns_of(rollout(graphs, ACTIONS, place))
    whole = returns.isfinite()
    assert 20 < int(whole.sum()) < 980
    assert (returns[whole] < 0).sum() > 20
    assert torch.equal(found.scores[whole], returns[whole])
    assert (found.scores[~whole] == WORST).all()
    assert found.scores.isfinite().all()
    assert found.not_finite == 0  # an episode that was not finished is nothing that went wrong
    assert torch.equal(found.fitness > WORTHLESS, whole.all(1))
    some = whole.all(1)
    assert torch.allclose(found.fitness[some], returns[some].mean(1))


def test_who_has_lost_w_is_worth_the_least() -> None:
    graphs, place = random_graphs(1, 300, ACTIONS), path(1, 5, longest=4)
    free = evaluator(ACTIONS, place, NOTHING, fitness=episode_return)(graphs)
    keep = torch.arange(5) == int(free.succeeded.sum(0).argmax())
    found = evaluator(ACTIONS, place, keep, fitness=episode_return)(graphs)
    kept = free.succeeded[:, keep][:, 0]
    assert 5 < int(kept.sum()) < 295
    assert torch.equal(found.scores[kept], free.scores[kept])
    assert (found.scores[~kept] == WORST).all()
    assert not found.succeeded[~kept][:, ~keep].any()
    assert found.transitions < free.transitions


def test_what_is_not_finite_is_worth_the_least() -> None:
    graphs, place = random_graphs(2, 30, ACTIONS), path(2, 5)
    usual = evaluator(ACTIONS, place, NOTHING, fitness=episode_return)(graphs)
    graphs.parameters[4, 0, 0] = torch.nan

    def odd(runs: Rollouts, probability: Tensor) -> Tensor:
        worth = episode_return(runs, probability).clone()
        worth[7, 1] = torch.nan
        worth[8, 2] = torch.inf
        return worth

    found = evaluator(ACTIONS, place, NOTHING, fitness=odd)(graphs)
    assert found.not_finite == 3
    assert (found.scores[[4, 7, 8]] == WORST).all()
    assert not found.succeeded[[4, 7, 8]].any()
    rest = [i for i in range(30) if i not in (4, 7, 8)]
    assert torch.equal(found.scores[rest], usual.scores[rest])


def test_returns_need_an_environment_that_gives_them() -> None:
    graphs = random_graphs(0, 3, ACTIONS)
    with pytest.raises(SettingsError, match="but the environment gives no rewards"):
        evaluator(ACTIONS, Path(path(0, 5).scenarios), NOTHING, fitness=episode_return)(graphs)
    paper = paper_actions()
    with pytest.raises(SettingsError, match="use chance_of_success"):
        evaluator(paper, model(0, 5), NOTHING, fitness=episode_return)(random_graphs(0, 3, paper))


def test_the_chance_of_success_is_there_where_rewards_are_too() -> None:
    graphs, place = random_graphs(0, 100, ACTIONS), path(0, 5, longest=5)
    found = evaluator(ACTIONS, place, NOTHING, fitness=chance_of_success)(graphs)
    runs = rollout(graphs, ACTIONS, place)
    near = place.succeeded(runs.state.flatten(0, 1)).view(100, 5).float()
    assert torch.equal(found.scores, torch.where(runs.succeeded, near, near / 2))


@pytest.mark.parametrize("selection", [tournament(5), lexicase])
@pytest.mark.parametrize("islands", [1, 2])
def test_the_best_loses_less_and_less(selection: object, islands: int) -> None:
    """To fall soon is a way to lose little; to walk to the middle is a better one."""
    scenarios = Walks(torch.tensor([-1.5, -0.5, 0.5, 1.5]), torch.full((4,), 8.0))
    place = RewardedPath(scenarios)
    settings = replace(SMALL, selection=selection, islands=islands)  # type: ignore[arg-type]
    search = evolve(place, ACTIONS, settings, seeded(5))
    generations = [next(search) for _ in range(25)]
    best = [g.best for g in generations]
    assert best == sorted(best)  # the elite stays
    assert best[0] < -7
    assert -6 < best[-1] < 0
    assert all(g.fitness.isfinite().all() for g in generations)
    again = returns_of(rollout(generations[-1].champion.graphs, ACTIONS, place))
    assert float(again.mean()) == pytest.approx(best[-1], rel=1e-6)


def test_where_nobody_finishes_an_episode_evolution_goes_on() -> None:
    class Endless(RewardedPath):
        def over(self, lanes: Lanes) -> Tensor:
            return torch.zeros(len(lanes), dtype=torch.bool)

    search = evolve(Endless(path(0, 3).scenarios), ACTIONS, SMALL, seeded(0))
    for generation in (next(search) for _ in range(3)):
        assert (generation.fitness < WORTHLESS).all()
        assert generation.best == pytest.approx(WORST)
        assert generation.not_finite == 0


def test_differences_to_the_worst_can_be_taken() -> None:
    scores = torch.tensor([[WORST, -3.0], [WORST, WORST], [-2.0, -1.0], [-4.0, -1.5]])
    assert deviation(scores).isfinite().all()
    one = torch.tensor([[-5.0] * 1000, [-5.0] * 999 + [WORST]])
    assert (one.double().mean(1) < WORTHLESS).tolist() == [False, True]


def test_a_graph_is_made_smaller_where_it_returns_as_much() -> None:
    walk = chain(ACTIONS, "Aim", "Step", *["Branch"] * 12, speed=0.1)
    place = RewardedPath(Walks(torch.tensor([-1.0, -0.5, -0.25]), torch.full((3,), 4.0)))
    before = Population(walk, initial_strategy(1))
    after = shrunk(before, ACTIONS, place, 60, 1e-3, episode_return)
    keep = torch.zeros(3, dtype=torch.bool)
    old, new = (
        evaluator(ACTIONS, place, keep, 60, fitness=episode_return)(p.graphs)
        for p in (before, after)
    )
    assert int(after.graphs.num_nodes) <= READABLE
    assert float(old.fitness) < 0
    assert float(new.fitness) >= float(old.fitness) - 1e-3


def test_a_graph_keeps_nodes_that_rewards_are_worth_in_any_unit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A slack of another unit would let go of steps that bring the walk to the middle sooner."""
    monkeypatch.setattr(specialists, "READABLE", 1)
    walk = chain(ACTIONS, *["Aim", "Step"] * 3)
    last = ACTIONS.actions[0].num_parameters - 1
    for number, speed in enumerate((1.0, 0.7, 0.05)):
        walk.parameters[0, 2 * number, last] = speed
    scenarios = Walks(torch.tensor([-1.75, -1.7]), torch.full((2,), 3.0))

    def nodes(place: type[RewardedPath], slack: float) -> int:
        before = Population(walk, initial_strategy(1))
        about = before, ACTIONS, place(scenarios), 60, slack, episode_return
        return int(shrunk(*about).graphs.num_nodes)

    wrong = nodes(TinyPath, 1e-3)
    assert nodes(RewardedPath, 1e-3) == nodes(TinyPath, 1e-3 * TinyPath.unit) > wrong
