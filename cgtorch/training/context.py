"""The inputs of a training, and the state before its first stage."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field, replace
from functools import partial, reduce
from typing import Any, TypeAlias

import torch
from torch import Generator

from cgtorch.domains.exploration import EXPLORATION, Exploration
from cgtorch.domains.knowledge import Knowledge, fit_models, learn
from cgtorch.domains.live import OnRobot
from cgtorch.domains.summary import summary_of
from cgtorch.evolution import (
    COST,
    REWARDS,
    ChanceOfSuccess,
    EvolutionSettings,
    Fitness,
    chance_of_success,
    episode_return,
    lexicase,
    tournament,
)
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import Asked, Purse
from cgtorch.ground.environment import Dataset, Environment, Live
from cgtorch.ground.files import whole_folder, write_json
from cgtorch.improvement.checkpoint import Journal
from cgtorch.improvement.events import ModelsFitted, Watch, WorldAsked
from cgtorch.improvement.setup import Budget, Progress, Setup
from cgtorch.runs.journal import SECONDS
from cgtorch.runs.storage import load_progress, read_asked, save_progress
from cgtorch.runs.stored_run import StoredRun
from cgtorch.simulation import Recording
from cgtorch.training.given_data import given_data, known_at_last

Working: TypeAlias = Callable[[str], AbstractContextManager[None]]
"""Makes a context that shows a message during a long step."""

LANES = 2  # robots that explore side by side, where there can be several

SEARCHES = 2
"""Evolutions of a specialist in the models, which take a second where trials in the world of what
they find take a robot minutes."""
LOOKS = 64  # first percepts of fresh scenarios
REPLAYS = 16  # of each scenario in the models, by which skills are compared
LIVE_ATTEMPTS = 4  # times as many, where a candidate acts up to its first failure only
IN_A_ROW, LIVE_IN_A_ROW = 150, 20
"""The default number of fresh scenarios to solve in a row, in a world that can be put back into any
scenario, and in one where each trial takes its time. A stage there asks for half as many, since
other stages follow."""
SETTLED = 20  # generations without a better fitness after which a solved group is left


@dataclass(frozen=True)
class Training:
    """The inputs of a training.

    Attributes:
        run: The run.
        watch: Receives all events.
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
        return self.run.domain.rewarded and name not in self.run.domain.stages

    def setup(self, name: str, journal: Journal | None = None) -> Setup[Any]:
        """The run's settings in the form that improvement needs for a stage or round."""
        run, s = self.run, self.run.settings
        domain, specialists = run.domain, run.domain.specialists
        replicas = 2 if run.learns or domain.noisy_world else 1
        budget = Budget(s.generations, stall=specialists.stall)
        if not run.repeats:  # where an action costs more than a generation
            budget = replace(budget, patience=SETTLED)
        if domain.rewarded:
            # A return has no best value, so what solves all is improved for a little while.
            aim = domain.target_return
            budget = replace(budget, enough=float("inf"), satisfied=aim, patience=5)
        return Setup(
            actions=run.actions,
            world_of=domain.world,
            imagine=self._imagine,
            learn=partial(learn, domain) if run.learns else None,
            describe=summary_of,
            evolution=evolution_settings(run),
            budget=budget,
            group_of=specialists.group_of,
            group=specialists.group,
            replicas=replicas,
            replays=(8 if run.repeats else REPLAYS) if run.learns else replicas,
            practice=self.practice(name),
            looks=0 if self._tests_by_rounds(name) else LOOKS,
            repeats=run.repeats,
            noisy=domain.noisy_world,
            live=domain.live,
            searches=self._searches(),
            attempts=self.attempts,
            max_transitions=s.max_transitions,
            device=self.device,
            journal=journal or Journal(),
            purse=self.purse,
        )

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
            return self.run.domain.imagine(knowledge, percepts, replicas, *how)
        copies = [scenarios.with_noise(copy) for copy in range(replicas)]
        rows = torch.arange(replicas * len(scenarios)).view(replicas, -1).T.flatten()
        return self.run.domain.world(copies[0].joined(*copies[1:])[rows])


def evolution_settings(run: StoredRun) -> EvolutionSettings:
    """The settings of evolutions: as published for the paper's method, else the defaults."""
    s, rewarded = run.settings, run.domain.rewarded
    # Of continuous scores lexicase selection would leave one to three distinct parents.
    by_rank = s.method == "paper" or rewarded
    common = EvolutionSettings(
        population=s.population,
        selection=tournament(s.tournament) if by_rank else lexicase,
        fitness=_fitness(s.method, rewarded),
        islands=s.islands,
        migration=s.migration,
    )
    if not rewarded or s.method == "paper" or s.islands > 1:
        return common
    return replace(
        common,
        initial_nodes=REWARDS.initial_nodes,
        first_graphs=REWARDS.first_graphs,
        lineages=s.lineages,
    )


def _fitness(method: str, rewarded: bool) -> Fitness:
    if rewarded:
        return episode_return
    return chance_of_success if method == "paper" else ChanceOfSuccess(COST)


def initial_progress(training: Training) -> Progress[Any]:
    """Data, labels, Γ and C before the first stage (section V), made once and stored in the run.

    A run that evolves in the world itself has none. Work is done in parallel if compiled code may
    use threads.
    """
    run, working = training.run, training.working
    nothing = run.like()
    if not run.learns:
        return Progress(None, nothing, nothing, None)
    start = run.folder / "start"
    if start.is_dir():
        return load_progress(run, start)
    settings = run.settings
    generator = Generator().manual_seed(settings.seed)
    before = training.purse.total
    dataset = _first_data(training, generator)
    asked = training.purse.total - before
    if asked != Asked():
        training.watch(WorldAsked("start", EXPLORATION, asked))
    began = time.perf_counter()
    with working("fitting Γ and C"):
        knowledge = fit_models(run.domain, dataset, settings.seed)
    seconds = time.perf_counter() - began
    training.watch(ModelsFitted("start", summary_of(knowledge), seconds))
    progress = Progress(None, nothing, nothing, knowledge)
    if ranks.first():
        with whole_folder(start) as folder:
            save_progress(folder, progress, settings.seed)
            write_json(folder / "result.json", {"asked": spent_of(training.purse)})
    return progress


def _first_data(training: Training, generator: Generator) -> Dataset:
    """The data for the first Γ and C: from the run's files, from its world, or both."""
    run = training.run
    if run.settings.data and run.settings.transitions == 0:
        with training.working("reading the data"):
            return given_data(run)
    with training.working("exploring: motions that teach the models most"):
        given = given_data(run) if run.settings.data else None
        parts = [part for part in (given, _explored(training)) if part is not None]
        known = reduce(Dataset.extended, parts) if parts else None
        found = run.domain.explore(_exploration(training, generator, known))
    return known_at_last(known, found)


def _exploration(training: Training, generator: Generator, known: Dataset | None) -> Exploration:
    """What an exploration works with; all that it asks is counted."""
    run, domain = training.run, training.run.domain

    def world(kind: str, count: int) -> Environment:
        made = domain.world(domain.draw(kind, count, generator))
        if isinstance(made, Live):
            made.told(EXPLORATION, "start")
        return Recording(made, training.purse, EXPLORATION)

    def fit(data: Dataset) -> Knowledge:
        return fit_models(domain, data, run.settings.seed)

    lanes = LANES if run.repeats else 1
    about = run.settings.transitions, lanes, generator, training.purse
    return Exploration(run.kind, world, fit, *about, known=known)


def _explored(training: Training) -> Dataset | None:
    """The data of a robot's exploration that was interrupted, which are paid for."""
    domain = training.run.domain
    if not isinstance(domain, OnRobot):
        return None
    data, asked = domain.actor.explored(len(domain.percept), len(domain.control))
    training.purse.add(EXPLORATION, asked)
    return data if asked.actions else None


def spent_of(purse: Purse) -> dict[str, dict[str, int]]:
    """What was asked, by phase, as plain data."""
    return {phase: asdict(asked) for phase, asked in purse.spent.items()}


def recall_spent(training: Training) -> None:
    """Fill the purse with what the finished parts of the run have asked."""
    run = training.run
    last = (run.folder / name / "result.json" for name in (*reversed(run.stages), "start"))
    known = next((path for path in last if path.is_file()), None)
    training.purse.spent.clear()
    if known is not None:
        for phase, asked in read_asked(known).items():
            training.purse.add(phase, Asked(**asked))
