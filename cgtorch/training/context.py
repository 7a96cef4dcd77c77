"""The inputs of a training, and the state before its first stage."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import torch

from cgtorch.domains.domain import counting, episodic, noisy, rewarded
from cgtorch.domains.knowledge import summary_of
from cgtorch.domains.live import OnRobot
from cgtorch.evolution import (
    COST,
    REWARDS,
    ChanceOfSuccess,
    EvolutionSettings,
    Fitness,
    chance_of_success,
    episode_return,
    lexicase,
    race,
    tournament,
)
from cgtorch.ground.asked import Purse
from cgtorch.ground.environment import Environment, Hurried
from cgtorch.improvement.checkpoint import Journal
from cgtorch.improvement.events import Event, Watch
from cgtorch.improvement.setup import Budget, Progress, Setup
from cgtorch.runs.journal import SECONDS
from cgtorch.runs.log import LogWatch
from cgtorch.runs.settings import RunSettings, defaults_of
from cgtorch.runs.stored_run import StoredRun

Working: TypeAlias = Callable[[str], AbstractContextManager[None]]
"""Makes a context that shows a message during a long step."""


SEARCHES = 2
"""Evolutions of a specialist in the models: a search takes 1 s, a trial on a robot minutes."""
LOOKS = 64  # first percepts of fresh scenarios
REPLAYS = 16  # of each scenario in the models, by which skills are compared
LIVE_ATTEMPTS = 4  # times as many, where a candidate acts up to its first failure only
IN_A_ROW, LIVE_IN_A_ROW = 150, 20
"""The default number of fresh scenarios to solve in a row, in a world that can be put back into any
scenario, and in one where each trial takes its time. A stage there asks for half as many, since
other stages follow."""
STRUCTURAL = (0.5, 0.3, 0.15, 0.1, 0.3, 0.3, 0.2, 0.5)
"""The first strategy there: nodes are added and replaced three times as often as elsewhere."""
NEW, SMALL, ROUNDS = 2, (3, 8), 16
"""Where low-level steps are counted: one individual in so many is new in each generation, the
fewest and most nodes of first graphs, and rounds of tournaments, since lexicase selection on one
scenario would leave one parent."""
USUAL = RunSettings.population
"""The default population, in place of which `REWARDS` has its own where means count."""
WITH_TEST = 3, 6  # fewest and most nodes of first graphs of which one ends the skill
SETTLED = 20  # generations without a better fitness after which the search for a solved group ends


@dataclass(frozen=True)
class Training:
    """The inputs of a training, and the log of the run, into which it writes all events.

    Attributes:
        run: The run.
        watch: Receives all events, too.
        purse: Counts what the world is asked, and refuses what the budget does not cover.
        working: Shows a message during a long step.
        device: Where populations are evaluated.
        checkpoint_seconds: The least time between two checkpoints, s.
    """

    run: StoredRun
    watch: Watch
    working: Working
    device: torch.device | str = "cpu"
    checkpoint_seconds: float = SECONDS
    purse: Purse = field(default_factory=Purse)
    log: LogWatch = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "log", LogWatch(self.run.folder))

    def told(self, event: Event) -> None:
        """Log an event, and pass it on."""
        self.purse.telling = True
        try:
            self.log(event)
            self.watch(event)
        finally:
            self.purse.telling = False

    def practice(self, name: str) -> int:
        """Number of fresh scenarios to solve in a row in a stage or round."""
        if self._tests_by_rounds(name):
            return 0
        if chosen := self.run.settings.practice:
            return chosen
        few = LIVE_IN_A_ROW // 2 if name in self.run.domain.stages else LIVE_IN_A_ROW
        return IN_A_ROW if self.run.repeats else few

    def _tests_by_rounds(self, name: str) -> bool:
        """Whether fresh episodes are tried by rounds themselves, as with rewards."""
        return rewarded(self.run.domain) and name not in self.run.domain.stages

    def by_mean(self, progress: Progress[Any]) -> bool:
        """Whether skills are judged by means on fresh scenarios, so that there is no W.

        They are where rewards are given or success is chance, in a world that can be simulated.
        """
        chance = progress.chance or self.run.settings.chance == "yes"
        compose = self.run.settings.method == "compose"
        return compose and self.run.repeats and (chance or rewarded(self.run.domain))

    def setup(self, name: str, journal: Journal | None = None) -> Setup[Any]:
        """The run's settings in the form that improvement needs for a stage or round."""
        run, s = self.run, self.run.settings
        domain, specialists = run.domain, run.domain.specialists
        replicas = 2 if run.learns or noisy(domain) else 1
        budget = Budget(s.generations, stall=specialists.stall)
        if not run.repeats:  # where an action costs more than a generation
            budget = replace(budget, patience=SETTLED)
        if counting(domain):  # where a further generation costs more than it gains
            budget = replace(budget, enough=0.0)
        if rewarded(domain):
            # Returns have no maximum, so the search continues for a number of generations.
            aim, endless = domain.target_return, float("inf")
            least = budget.least * abs(aim)
            budget = replace(budget, enough=endless, satisfied=aim, patience=5, least=least)
        return Setup(
            actions=run.actions,
            world_of=domain.world,
            imagine=self._imagine,
            learn=run.models.learn if run.learns else None,
            describe=summary_of,
            evolution=evolution_settings(run),
            budget=budget,
            group_of=specialists.group_of,
            group=specialists.group,
            widest=specialists.widest,
            team=specialists.team,
            replicas=replicas,
            replays=(8 if run.repeats else REPLAYS) if run.learns else replicas,
            practice=self.practice(name),
            looks=self._looks(name),
            repeats=run.repeats,
            noisy=noisy(domain) and s.chance == "auto",
            live=isinstance(domain, OnRobot),
            remembers=counting(domain) and run.repeats and not (run.learns or noisy(domain)),
            searches=self._searches(),
            attempts=self.attempts,
            max_transitions=s.max_transitions,
            device=self.device,
            journal=journal or Journal(),
            purse=self.purse,
        )

    def _looks(self, name: str) -> int:
        """Fresh scenarios to think about; with low-level steps, those to evolve on."""
        few = self.run.domain.specialists.group if counting(self.run.domain) else LOOKS
        return 0 if self._tests_by_rounds(name) else few

    @property
    def attempts(self) -> int:
        """The largest number of candidates in a stage."""
        chosen = self.run.settings.attempts
        return chosen if self.run.repeats else LIVE_ATTEMPTS * chosen

    def _searches(self) -> int:
        """More where an action costs more than a search; one in the world itself."""
        return (SEARCHES if self.run.repeats else 2 * SEARCHES) if self.run.learns else 1

    def _imagine(
        self, knowledge: Any, scenarios: Any, percepts: torch.Tensor, replicas: int, *how: Any
    ) -> Environment:
        """The environment of an evolution: Γ and C, or the world itself with other noise."""
        if self.run.learns:
            return self.run.models.imagine(knowledge, percepts, replicas, *how)
        copies = [scenarios.with_noise(copy) for copy in range(replicas)]
        rows = torch.arange(replicas * len(scenarios)).view(replicas, -1).T.flatten()
        world = self.run.domain.world(copies[0].joined(*copies[1:])[rows])
        return world.hurried() if isinstance(world, Hurried) else world


def evolution_settings(run: StoredRun) -> EvolutionSettings:
    """The settings of evolutions: as published for the paper's method, else the defaults."""
    s, returns = run.settings, rewarded(run.domain)
    graded = returns or (episodic(run.domain) and not run.learns)
    # Of continuous scores lexicase selection would leave one to three distinct parents.
    by_rank = s.method == "paper" or graded
    common = EvolutionSettings(
        population=s.population,
        selection=tournament(s.tournament) if by_rank else lexicase,
        fitness=_fitness(s.method, returns),
        islands=s.islands,
        migration=s.migration,
    )
    if counting(run.domain):
        new = s.population // NEW
        few = replace(common, evaluate=race, newcomers=new, initial_nodes=SMALL)
        return replace(few, selection=tournament(ROUNDS), strategy=STRUCTURAL)
    if not graded or s.method == "paper" or s.islands > 1:
        return common
    return replace(
        common,
        initial_nodes=REWARDS.initial_nodes,
        first_graphs=REWARDS.first_graphs,
        lineages=s.lineages,
    )


def for_means(run: StoredRun, setup: Setup[Any], target: float) -> Setup[Any]:
    """The setup for `cgtorch.improvement.expected`, until the mean reaches a target."""
    s, domain = run.settings, run.domain
    ends = episodic(domain)  # else a skill has to test whether it has succeeded
    usual = defaults_of(type(domain.settings))["population"] == s.population == USUAL
    evolution = replace(
        REWARDS,
        population=REWARDS.population if usual else s.population,
        selection=tournament(s.tournament),
        fitness=episode_return if rewarded(domain) else chance_of_success,
        initial_nodes=REWARDS.initial_nodes if ends else WITH_TEST,
        islands=s.islands,
        migration=s.migration,
        lineages=0 if s.islands > 1 else s.lineages,
    )
    return replace(setup, evolution=evolution, budget=replace(setup.budget, satisfied=target))


def _fitness(method: str, returns: bool) -> Fitness:
    if returns:
        return episode_return
    return chance_of_success if method == "paper" else ChanceOfSuccess(COST)
