"""What improvement and evolution get of a run's settings."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import driven_cart
import pytest
import torch
from reaching import TABLE
from support import seeded
from walking import Walking

from cgtorch.domains.knowledge import summary_of
from cgtorch.evolution import (
    REWARDS,
    ChanceOfSuccess,
    EvolutionSettings,
    chance_of_success,
    episode_return,
    lexicase,
)
from cgtorch.ground.asked import Purse
from cgtorch.improvement.events import Event
from cgtorch.improvement.setup import Progress
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import StoredRun
from cgtorch.tabletop.actions import paper_actions
from cgtorch.training.context import (
    COST,
    LIVE_ATTEMPTS,
    LOOKS,
    REPLAYS,
    SEARCHES,
    SETTLED,
    Training,
    evolution_settings,
    for_means,
)

RUN = StoredRun(Path("none"), RunSettings(), TABLE, paper_actions())


def ignore(event: Event) -> None:
    """Nobody watches."""


def training_of(run: StoredRun, purse: Purse | None = None) -> Training:
    return Training(run, ignore, lambda message: nullcontext(), purse=purse or Purse())


@pytest.mark.parametrize(
    ("repeats", "chosen", "stage", "rounds"),
    [(True, 0, 150, 150), (False, 0, 10, 20), (True, 7, 7, 7), (False, 7, 7, 7)],
)
def test_so_many_fresh_scenarios_are_to_be_solved_in_a_row(
    repeats: bool, chosen: int, stage: int, rounds: int
) -> None:
    run = replace(RUN, settings=RunSettings(practice=chosen), repeats=repeats)
    training = training_of(run)
    assert [training.practice(name) for name in ("S0", "S3", "auto-1")] == [stage, stage, rounds]
    for name in ("S0", "auto-1"):
        assert training.setup(name).practice == training.practice(name)
        assert training.setup(name).repeats == repeats


@pytest.mark.parametrize("chosen", [0, 7])
def test_with_rewards_there_is_no_practice(chosen: int) -> None:
    """Rounds try skills on fresh episodes by themselves."""
    domain = Walking()
    run = StoredRun(Path("none"), RunSettings(practice=chosen), domain, domain.actions())
    setup = training_of(run).setup("auto-1")
    assert (setup.practice, setup.looks) == (0, 0)


def test_the_smallest_return_that_counts_is_a_share_of_the_target() -> None:
    class Tiny(Walking):
        target_return = -1e-12

    for domain, least in ((TABLE, 1e-3), (Walking(), 1e-3), (Tiny(), 1e-15)):
        run = StoredRun(Path("none"), RunSettings(), domain, domain.actions())
        assert training_of(run).setup("auto-1").budget.least == pytest.approx(least)


def test_all_that_is_asked_is_paid_from_one_purse() -> None:
    training = training_of(RUN, Purse({"motions": 3}))
    assert training.setup("S0").purse is training.purse


def test_only_the_method_of_the_paper_selects_by_tournament() -> None:
    def evolution_of(**values: Any) -> EvolutionSettings:
        return evolution_settings(replace(RUN, settings=RunSettings(**values)))

    assert evolution_of(population=30).population == 30
    assert evolution_of().selection is lexicase
    paper = evolution_of(method="paper", tournament=1000, population=30)
    assert paper.population == 30
    scores = torch.tensor([[9.0], [0.0], [0.0]])  # which a tournament does not look at
    assert (paper.selection(torch.tensor([2, 0, 1]), scores, 50, seeded(0)) == 2).all()


WALKING = Walking()
WALKS = StoredRun(Path("none"), RunSettings(), WALKING, WALKING.actions())


def test_settings_of_a_run_reach_improvement() -> None:
    some = RunSettings(generations=33, max_transitions=9, attempts=5)
    setup = training_of(replace(RUN, settings=some)).setup("S0")
    assert (setup.budget.generations, setup.max_transitions, setup.attempts) == (33, 9, 5)
    assert (setup.device, setup.live, setup.remembers, setup.noisy) == ("cpu", False, False, True)
    assert setup.describe is summary_of
    sure = training_of(replace(RUN, settings=RunSettings(chance="no"))).setup("S0")
    assert not sure.noisy
    assert (setup.replicas, setup.searches, setup.looks) == (2, SEARCHES, LOOKS)
    specialists = RUN.domain.specialists
    about = "group", "widest", "team", "group_of"
    assert [getattr(setup, x) for x in about] == [getattr(specialists, x) for x in about]
    assert setup.budget.stall == specialists.stall
    live = training_of(replace(RUN, settings=some, repeats=False)).setup("S0")
    assert live.attempts == 5 * LIVE_ATTEMPTS
    assert live.searches == 2 * SEARCHES
    assert (live.budget.patience, live.replays) == (SETTLED, REPLAYS)
    returns = training_of(replace(WALKS, settings=some)).setup("auto-1")
    assert returns.budget.satisfied == WALKING.target_return
    assert returns.budget.enough == torch.inf
    assert (returns.learn, returns.replicas, returns.searches) == (None, 1, 1)
    assert (setup.learn is None) is (not RUN.learns)


def test_settings_of_a_run_reach_evolution() -> None:
    some = RunSettings(islands=3, migration=7, population=30)
    found = evolution_settings(replace(RUN, settings=some))
    assert (found.islands, found.migration, found.lineages) == (3, 7, 0)
    assert found.fitness == ChanceOfSuccess(COST)
    returns = evolution_settings(WALKS)
    assert returns.fitness is episode_return
    assert returns.selection is not lexicase
    assert returns.lineages == WALKS.settings.lineages > 0
    assert returns.initial_nodes == REWARDS.initial_nodes
    assert evolution_settings(replace(WALKS, settings=some)).lineages == 0
    paper = replace(WALKS, settings=RunSettings(method="paper"))
    assert evolution_settings(paper).lineages == 0
    tabletop = replace(RUN, settings=RunSettings(method="paper"))
    assert evolution_settings(tabletop).fitness is chance_of_success


@pytest.mark.parametrize("run", [RUN, WALKS], ids=["success", "returns"])
def test_a_search_for_means_has_its_own_settings_unless_others_are_chosen(run: StoredRun) -> None:
    setup = training_of(run).setup("auto-1")
    means = for_means(run, setup, 0.77)
    assert means.budget.satisfied == 0.77
    assert replace(means.budget, satisfied=setup.budget.satisfied) == setup.budget
    assert means.evolution.population == REWARDS.population
    assert (means.evolution.fitness is episode_return) is (run is WALKS)
    assert (means.evolution.initial_nodes == REWARDS.initial_nodes) is (run is WALKS)
    assert means.evolution.lineages == run.settings.lineages > 0
    own = replace(run, settings=RunSettings(population=31, islands=2, migration=5))
    chosen = for_means(own, setup, 0.5).evolution
    assert (chosen.population, chosen.islands, chosen.migration) == (31, 2, 5)
    assert chosen.lineages == 0


def test_means_count_where_rewards_are_given_or_success_is_chance() -> None:
    none = WALKING.draw("any", 0, seeded(0))
    before: Progress[Any] = Progress(None, none, none, None)
    luck = replace(before, chance=True)
    assert training_of(WALKS).by_mean(before)
    assert not training_of(RUN).by_mean(before)
    assert training_of(RUN).by_mean(luck)
    assert training_of(replace(RUN, settings=RunSettings(chance="yes"))).by_mean(before)
    for other in ({"method": "paper"}, {}):
        run = replace(RUN, settings=RunSettings(**other), repeats=bool(other))
        assert not training_of(run).by_mean(luck)


def test_without_models_each_scenario_has_its_replicas_beside_it_in_the_world() -> None:
    domain = TABLE
    run = replace(RUN, settings=RunSettings(models="none"))
    assert not run.learns
    scenarios = domain.draw("near", 3, seeded(0))
    world: Any = training_of(run).setup("S0").imagine(None, scenarios, torch.zeros(3, 7), 2)
    seeds = [each for i in range(3) for copy in range(2)
             for each in scenarios.with_noise(copy).seed[i : i + 1].tolist()]  # fmt: skip
    assert world.scenarios.seed.tolist() == seeds


def test_a_robot_is_improved_as_one(tmp_path: Path) -> None:
    domain = driven_cart.cart(tmp_path / "log")
    run = StoredRun(tmp_path / "run", RunSettings(), domain, domain.actions(), repeats=False)
    setup = training_of(run).setup("auto-1")
    assert (setup.live, setup.repeats, setup.remembers) == (True, False, False)
