"""The inputs of improvement, and the result that one stage hands to the next."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic

import torch
from torch import Generator

from cgtorch.actions import ActionSet
from cgtorch.environment import Environment
from cgtorch.evolution import EvolutionSettings, Population
from cgtorch.graphs import Skill
from cgtorch.improvement.checkpoint import Journal
from cgtorch.improvement.events import ModelSummary, Watch
from cgtorch.improvement.grouping import local_group
from cgtorch.improvement.interfaces import Grouping, Imagine, Learn, Models, S
from cgtorch.improvement.stopping import Budget


@dataclass(frozen=True)
class Setup(Generic[S]):
    """The constant inputs of improvement.

    Attributes:
        world_of: Makes the world of given scenarios.
        imagine: Makes the environment in which skills are evolved.
        learn: Trains the models on new experience; None without models.
        describe: Summarises models after learning.
        evolution: The settings of each evolution, which ends by its `budget`.
        searches: Evolutions of a specialist, of which the best result is kept, as long as none
            solves its whole group.
        attempts: Maximum number of specialists that are evolved in one stage.
        idle: Number of evolutions without a new member after which a stage stops.
        rounds: How often at most a stage's skill is tried on fresh scenarios and improved again.
        clean_batches: Number of batches of fresh scenarios, all of which it has to solve to be left
            as it is.
        group_of: Chooses the scenarios on which a specialist is evolved.
        group: Number of these scenarios.
        widest: Number to which they grow, by doubling, for a specialist with a fitness of
            `Budget.satisfied`.
        replicas: Copies of each scenario of a whole group, and more of a smaller one. With 2, it is
            met under different errors of Γ, or other noise.
        trials: Runs in the world with different noise, all of which must succeed for a member to
            count as solving a scenario.
        core: Maximum number of scenarios of W on which members are tried. A new skill is tried on
            all.
        max_transitions: Of every skill.
        device: Where populations are evaluated.
        journal: Stores results, and returns those from before an interruption.
    """

    actions: ActionSet
    world_of: Callable[[S], Environment]
    imagine: Imagine[S]
    learn: Learn | None = None
    describe: Callable[[Models], ModelSummary] = lambda _: ModelSummary("the models have learned")
    evolution: EvolutionSettings = field(default_factory=EvolutionSettings)
    budget: Budget = field(default_factory=Budget)
    searches: int = 1
    attempts: int = 24
    idle: int = 4
    rounds: int = 6
    clean_batches: int = 3
    group_of: Grouping = local_group
    group: int = 12
    widest: int = 32
    replicas: int = 2
    trials: int = 3
    core: int = 1000
    max_transitions: int = 20
    device: torch.device | str = "cpu"
    journal: Journal = field(default_factory=Journal)


@dataclass(frozen=True)
class Stage(Generic[S]):
    """The inputs of one stage; its skill has the same name."""

    setup: Setup[S]
    name: str
    generator: Generator
    watch: Watch


@dataclass(frozen=True)
class Progress(Generic[S]):
    """The result that one stage hands to the next.

    Attributes:
        skill: The last accepted skill, None before the first.
        solved: W, the scenarios on which it succeeds in the world.
        missed: M, the scenarios on which it fails.
        knowledge: Data and models.
        specialists: Graphs evolved so far, seeds of later populations; None before the first.
        members: Skills within the last one, which the next may use beside it or instead of it.
    """

    skill: Skill | None
    solved: S
    missed: S
    knowledge: Models
    specialists: Population | None = None
    members: tuple[Skill, ...] = ()
