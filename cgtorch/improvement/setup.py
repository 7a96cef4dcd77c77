"""What improvement works with, and what it hands on."""

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
    """What improvement works with and never changes.

    Attributes:
        world_of: makes the world of given scenarios.
        imagine: makes the environment that skills are evolved in.
        learn: teaches the models what was experienced in the world; None if there are none.
        describe: tells of models that have learned on.
        evolution: settings of each evolution, which ends with its `budget`.
        attempts: the most evolutions in one stage.
        idle: evolutions without a new member after which no more are tried.
        rounds: how often at most a stage's skill is tried on fresh scenarios and improved again.
        group_of: chooses the scenarios that a specialist is evolved on.
        group: how many these are.
        widest: how many they become, by doubling, for one with a fitness of `Budget.satisfied`.
        replicas: of each scenario of a whole group, of fewer ones more: 2 so that it is met under
            different errors of Γ, or other noise.
        trials: runs in the world, with different noise, that a member must all pass to count as
            solving a scenario.
        core: scenarios of W at most that members are tried on; a new skill is tried on all.
        max_transitions: of every skill.
        device: where populations are evaluated.
        journal: what is known of the stage from before an interruption, and keeps what is new.
    """

    actions: ActionSet
    world_of: Callable[[S], Environment]
    imagine: Imagine[S]
    learn: Learn | None = None
    describe: Callable[[Models], ModelSummary] = lambda _: ModelSummary("the models have learned")
    evolution: EvolutionSettings = field(default_factory=EvolutionSettings)
    budget: Budget = field(default_factory=Budget)
    attempts: int = 24
    idle: int = 4
    rounds: int = 3
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
    """What one stage works with; its name is that of the skill that it makes, too."""

    setup: Setup[S]
    name: str
    generator: Generator
    watch: Watch


@dataclass(frozen=True)
class Progress(Generic[S]):
    """What one stage hands on to the next.

    Attributes:
        skill: the last accepted skill, None before the first.
        solved: W, what it succeeds on in the world.
        missed: M, what it was tried on and failed.
        knowledge: experience and models.
        specialists: graphs evolved so far, seeds of later populations; None before the first.
        members: skills within the last one that the next may use beside it or in its place.
    """

    skill: Skill | None
    solved: S
    missed: S
    knowledge: Models
    specialists: Population | None = None
    members: tuple[Skill, ...] = ()
