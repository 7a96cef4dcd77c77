"""The inputs of improvement, and the result that one stage hands to the next."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic

import torch
from torch import Generator, Tensor

from cgtorch.evolution import EvolutionSettings, Population
from cgtorch.graphs import ActionSet, Skill
from cgtorch.ground.asked import Purse
from cgtorch.ground.environment import Environment
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
        attempts: Maximum number of candidates in one stage.
        practice: Number of fresh scenarios that a skill solves in a row before a stage ends.
        looks: Number of first percepts of fresh scenarios to practise on in the models.
        core: Number of scenarios of W on which skills are compared; a new one is tried on all.
        group_of: Chooses the scenarios on which a specialist is evolved.
        group: Number of these scenarios.
        replicas: Copies of each scenario of a whole group, and more of a smaller one. With 2, it is
            met under different errors of Γ, or other noise.
        replays: Copies of each scenario on which skills are compared.
        repeats: Whether the world repeats itself, so that W is tried again and eq. 1 is exact.
        noisy: Whether scenarios can be tried again under other noise.
        live: Whether the world is a robot, where each episode is a step of its own.
        max_transitions: Of every skill.
        device: Where populations are evaluated.
        journal: Stores results, and returns those from before an interruption.
        purse: Counts what the world is asked, and refuses what the budget does not cover.
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
    practice: int = 30
    looks: int = 64
    core: int = 1000
    group_of: Grouping = local_group
    group: int = 12
    replicas: int = 2
    replays: int = 8
    repeats: bool = True
    noisy: bool = False
    live: bool = False
    max_transitions: int = 20
    device: torch.device | str = "cpu"
    journal: Journal = field(default_factory=Journal)
    purse: Purse = field(default_factory=Purse)


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
        chance: Whether what was solved was found to be chance, so that W is no fact.
        seen: (|W| + |M|, D) the first percepts of W and M; None before the first trial.
    """

    skill: Skill | None
    solved: S
    missed: S
    knowledge: Models
    specialists: Population | None = None
    seen: Tensor | None = None
    chance: bool = False
