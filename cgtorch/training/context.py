"""The inputs of a training, and the state before its first stage."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import torch
from torch import Generator

from cgtorch.domains.knowledge import fit_models, learn
from cgtorch.domains.summary import summary_of
from cgtorch.domains.transition import TransitionModel
from cgtorch.environment import Environment
from cgtorch.evolution import (
    REWARDS,
    EvolutionSettings,
    chance_of_success,
    episode_return,
    lexicase,
    tournament,
)
from cgtorch.evolution.islands import derived_generator
from cgtorch.ground import distributed as ranks
from cgtorch.ground.files import whole_folder
from cgtorch.improvement.checkpoint import Journal
from cgtorch.improvement.events import ModelsFitted, Watch
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.improvement.stopping import Budget
from cgtorch.runs.journal import SECONDS
from cgtorch.runs.run import Run
from cgtorch.runs.storage import load_progress, save_progress

Working: TypeAlias = Callable[[str], AbstractContextManager[None]]
"""Makes a context that shows a message during a long step."""

OWN = 40  # the generator of what C is judged by, derived like an island's


SEARCHES = 4
"""Evolutions of a specialist in the models, which take a second where a trial in the world of what
they find takes ten."""


@dataclass(frozen=True)
class Training:
    """The inputs of a training.

    Attributes:
        run: The run.
        watch: Receives all events.
        working: Shows a message during a long step.
        device: Where populations are evaluated.
        checkpoint_seconds: The least time between two checkpoints, s.
    """

    run: Run
    watch: Watch
    working: Working
    device: torch.device | str = "cpu"
    checkpoint_seconds: float = SECONDS

    def setup(self, journal: Journal | None = None) -> Setup[Any]:
        """The run's settings in the form that improvement needs."""
        run, s = self.run, self.run.settings
        domain, specialists = run.domain, run.domain.specialists
        replicas = 2 if run.learns or domain.noisy_world else 1
        budget = Budget(generations=s.generations, stall=specialists.stall)
        if domain.rewarded:
            # A return has no best value, so what solves all is improved for a little while.
            aim = domain.target_return
            budget = replace(budget, enough=float("inf"), satisfied=aim, patience=5)
        return Setup(
            actions=run.actions,
            world_of=domain.world,
            imagine=self._imagine,
            learn=learn if run.learns else None,
            describe=summary_of,
            evolution=evolution_settings(run),
            budget=budget,
            group_of=specialists.group_of,
            group=specialists.group,
            replicas=replicas,
            trials=3 if domain.noisy_world else 1,
            searches=SEARCHES if run.learns else 1,  # in the world itself they are not cheap
            attempts=s.attempts,
            max_transitions=s.max_transitions,
            device=self.device,
            journal=journal or Journal(),
        )

    def _imagine(
        self, knowledge: Any, scenarios: Any, percepts: torch.Tensor, replicas: int, *how: Any
    ) -> Environment:
        """The environment of an evolution: Γ and C, or the world itself with other noise."""
        if self.run.learns:
            return self.run.domain.imagine(knowledge, percepts, replicas, *how)
        copies = [scenarios.with_noise(copy) for copy in range(replicas)]
        rows = torch.arange(replicas * len(scenarios)).view(replicas, -1).T.flatten()
        return self.run.domain.world(copies[0].joined(*copies[1:])[rows])


def evolution_settings(run: Run) -> EvolutionSettings:
    """The settings of evolutions: as published for the paper's method, else the defaults."""
    s, rewarded = run.settings, run.domain.rewarded
    # Of continuous scores lexicase selection would leave one to three distinct parents.
    by_rank = s.method == "paper" or rewarded
    common = EvolutionSettings(
        population=s.population,
        selection=tournament(s.tournament) if by_rank else lexicase,
        fitness=episode_return if rewarded else chance_of_success,
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
    settings, domain, kind = run.settings, run.domain, run.kind
    generator = Generator().manual_seed(settings.seed)
    with working("collecting data: random transitions and labelled tests"):
        dataset = domain.explore(kind, settings.transitions, settings.labels, generator)
    own = derived_generator(generator, OWN)

    def fresh(gamma: TransitionModel) -> Any:
        return domain.try_transition(kind, gamma, settings.labels, generator)

    began = time.perf_counter()
    with working("fitting Γ and C, testing Γ on fresh transitions"):
        # Several ranks share out work in the world, which forked processes cannot.
        alone = ranks.count() > 1
        knowledge, found = fit_models(domain, dataset, settings.seed, fresh, alone)
    seconds = time.perf_counter() - began
    with working("testing C on fresh labels"):
        summary = domain.summary(kind, knowledge, found, own)
    training.watch(ModelsFitted("start", summary, seconds))
    progress = Progress(None, nothing, nothing, knowledge)
    if ranks.first():
        with whole_folder(start) as folder:
            save_progress(folder, progress, settings.seed)
    return progress
