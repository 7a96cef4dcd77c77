"""What improvement and evolution get of a run's settings."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import driven_cart
import pytest
import torch
from reaching import TABLE, TABLE_MODELS, small_knowledge
from support import seeded
from torch import Tensor
from walking import END, PLACE, StagedWalking, Walking, Walks
from walking import Path as WalkedPath

from cgtorch.domains.domain import Specialists
from cgtorch.domains.knowledge import summary_of
from cgtorch.evolution import (
    REWARDS,
    ChanceOfSuccess,
    EvolutionSettings,
    chance_of_success,
    episode_return,
    lexicase,
    race,
)
from cgtorch.ground.asked import Asked, Purse
from cgtorch.ground.environment import Lanes
from cgtorch.improvement.checkpoint import Journal
from cgtorch.improvement.events import Event
from cgtorch.improvement.setup import Progress
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import StoredRun
from cgtorch.tabletop.actions import paper_actions
from cgtorch.training.context import (
    COST,
    LIVE_ATTEMPTS,
    LOOKS,
    NEW,
    REPLAYS,
    ROUNDS,
    SEARCHES,
    SETTLED,
    SMALL,
    STRUCTURAL,
    WITH_TEST,
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


class CountedPath(WalkedPath):
    """A path whose low-level steps are counted, on which a search may hurry."""

    def __init__(self, scenarios: Walks, slow: bool = True) -> None:
        super().__init__(scenarios)
        self.slow = slow

    @property
    def asked(self) -> Asked:
        return Asked(steps=3)

    def hurried(self) -> "CountedPath":
        return CountedPath(self.scenarios, slow=False)


class EndingPath(WalkedPath):
    """A path without rewards, whose walks end by a fall."""

    def over(self, lanes: Lanes) -> Tensor:
        return lanes.state[:, PLACE].abs() > END


class CountedWalking(Walking):
    """Walks whose low-level steps are counted, with specialists of their own."""

    specialists = Specialists(lambda *about: about[1].nonzero()[:, 0], 5, 40, 3, 9)

    def world(self, scenarios: Walks) -> Any:
        return CountedPath(scenarios)


class EndingWalking(Walking):
    def world(self, scenarios: Walks) -> Any:
        return EndingPath(scenarios)


def run_of(domain: Any, **settings: Any) -> StoredRun:
    return StoredRun(Path("none"), RunSettings(**settings), domain, domain.actions())


COUNTED = run_of(CountedWalking())


def best_share(evolution: EvolutionSettings) -> float:
    """How often the better of two individuals, whose scores are equal, becomes a parent."""
    order, scores = torch.tensor([0, 1]), torch.zeros(2, 1)
    chosen = evolution.selection(order, scores, 4000, seeded(0))
    return float((chosen == 0).float().mean())


def test_where_steps_are_counted_half_of_each_generation_is_new_and_races() -> None:
    counted = replace(COUNTED, settings=RunSettings(population=31, islands=2, migration=7))
    found = evolution_settings(counted)
    assert (found.population, found.newcomers) == (31, 31 // NEW)
    assert found.evaluate is race
    assert (found.initial_nodes, found.strategy) == (SMALL, STRUCTURAL)
    assert best_share(found) == pytest.approx(1 - 0.5**ROUNDS, abs=0.02)
    assert (found.islands, found.migration) == (2, 7)
    usual = evolution_settings(RUN)
    assert (usual.newcomers, usual.strategy) == (0, EvolutionSettings().strategy)
    assert usual.evaluate is not race


def test_where_steps_are_counted_a_search_ends_once_all_is_solved_and_remembers() -> None:
    setup = training_of(COUNTED).setup("auto-1")
    assert (setup.budget.enough, training_of(RUN).setup("S0").budget.enough) == (0.0, 0.97)
    assert (setup.looks, setup.remembers) == (setup.group, True)
    assert not training_of(replace(COUNTED, repeats=False)).setup("auto-1").remembers
    noisy = replace(RUN, settings=RunSettings(models="none"))
    assert not training_of(noisy).setup("S0").remembers


def test_a_domain_has_specialists_of_its_own() -> None:
    own, setup = CountedWalking.specialists, training_of(COUNTED).setup("auto-1")
    assert (setup.group, setup.widest, setup.team, setup.budget.stall) == (5, 40, 3, 9)
    assert setup.group_of is own.group_of


def test_a_search_hurries_where_it_may_and_the_world_does_not() -> None:
    scenarios = COUNTED.domain.draw("any", 3, seeded(0))
    setup = training_of(COUNTED).setup("auto-1")
    world: Any = setup.imagine(None, scenarios, torch.zeros(3, 2), 1, seeded(0), "cpu")
    assert not world.slow
    assert torch.equal(world.scenarios.place, scenarios.place)
    unhurried: Any = setup.world_of(scenarios)
    assert unhurried.slow
    walks = training_of(WALKS).setup("auto-1").imagine(None, scenarios, torch.zeros(3, 2), 1)  # type: ignore[call-arg]
    assert type(walks) is type(WALKING.world(scenarios))


def test_with_models_a_search_is_in_these_from_the_first_percepts() -> None:
    assert RUN.learns
    scenarios = TABLE.draw("near", 3, seeded(0))
    percepts, rows = torch.rand(3, 7, generator=seeded(1)), torch.arange(6)
    setup, known = training_of(RUN).setup("S0"), small_knowledge()
    found = setup.imagine(known, scenarios, percepts, 2, seeded(5), "cpu")
    wanted = TABLE_MODELS.imagine(known, percepts, 2, seeded(5), "cpu")
    assert type(found) is type(wanted)
    assert torch.equal(found.start(rows)[1], wanted.start(rows)[1])
    assert (setup.replays, setup.learn is not None) == (8, True)
    alone = training_of(replace(RUN, settings=RunSettings(models="none"))).setup("S0")
    assert (alone.replays, alone.replicas, alone.learn) == (2, 2, None)


def test_device_and_journal_reach_improvement() -> None:
    journal = Journal()
    training = replace(training_of(RUN), device="cuda:7")
    assert training.setup("S0", journal).journal is journal
    assert training.setup("S0").device == "cuda:7"


def test_with_rewards_the_search_goes_on_for_some_generations_beyond_the_target() -> None:
    budget = training_of(WALKS).setup("auto-1").budget
    assert budget.patience < training_of(RUN).setup("S0").budget.patience
    staged = StagedWalking()
    setup = training_of(run_of(staged)).setup("first")
    assert (setup.practice, setup.looks) == (150, LOOKS), "rounds alone try fresh episodes"


@pytest.mark.parametrize("rounds", [1, 2, 5])
def test_a_tournament_has_as_many_rounds_as_the_settings_say(rounds: int) -> None:
    """By the paper's method, with rewards, and in a search for means."""
    wanted = pytest.approx(1 - 0.5**rounds, abs=0.03)
    for run in (
        replace(RUN, settings=RunSettings(method="paper", tournament=rounds)),
        replace(WALKS, settings=RunSettings(tournament=rounds)),
        run_of(EndingWalking(), tournament=rounds),
    ):
        assert best_share(evolution_settings(run)) == wanted
    run = replace(RUN, settings=RunSettings(tournament=rounds))
    assert best_share(for_means(run, training_of(run).setup("auto-1"), 0.5).evolution) == wanted


def test_episodes_that_end_by_themselves_have_the_first_graphs_of_rewards() -> None:
    """Unless Γ and C, which have no end, are at hand, or the paper's method is asked for."""
    ending = run_of(EndingWalking())
    found = evolution_settings(ending)
    assert (found.initial_nodes, found.first_graphs) == (
        REWARDS.initial_nodes,
        REWARDS.first_graphs,
    )
    assert found.lineages == ending.settings.lineages
    assert found.fitness == ChanceOfSuccess(COST)
    for settings in ({"models": "learned"}, {"method": "paper"}, {"islands": 2}):
        other = evolution_settings(run_of(EndingWalking(), **settings))
        assert other.initial_nodes == EvolutionSettings().initial_nodes
        assert (other.selection is lexicase) is (settings == {"models": "learned"})
    means = for_means(ending, training_of(ending).setup("auto-1"), 0.5).evolution
    assert means.initial_nodes == REWARDS.initial_nodes
    assert for_means(RUN, training_of(RUN).setup("S0"), 0.5).evolution.initial_nodes == WITH_TEST


def test_a_population_for_means_is_that_of_the_domain_or_of_the_user() -> None:
    """Only the usual one gives way to that of a search for means."""
    setup = training_of(RUN).setup("auto-1")
    usual = RunSettings.population
    for chosen, wanted in ((usual, REWARDS.population), (usual + 1, usual + 1), (7, 7)):
        run = replace(RUN, settings=RunSettings(population=chosen))
        assert for_means(run, setup, 0.5).evolution.population == wanted
