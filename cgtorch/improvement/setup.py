"""The inputs of improvement, and the result that one stage hands to the next."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.evolution import EvolutionSettings, Population
from cgtorch.graphs import ActionSet, Skill
from cgtorch.ground.asked import Purse
from cgtorch.ground.environment import Dataset, Environment
from cgtorch.improvement.checkpoint import Found, Journal, Kept
from cgtorch.improvement.compose import local_group
from cgtorch.improvement.events import ModelSummary, S, Watch

Models: TypeAlias = Any
"""Γ and C with their data. Improvement passes them on without looking at them. For a `Domain` they
are `cgtorch.domains.knowledge.Knowledge`, or None without models."""

Imagine: TypeAlias = Callable[[Models, S, Tensor, int, Generator, torch.device | str], Environment]
"""Makes the environment of an evolution, from Γ and C or from the world itself. The arguments are
models, scenarios, their first percepts (B, D), the number of replicas of each, a generator and a
device. Scenario i gets the indices i · replicas … i · replicas + replicas - 1. Replicas may differ
by possible errors of Γ, drawn from the generator, or by noise."""

Learn: TypeAlias = Callable[[Models, Dataset, Generator], Models]
"""Maps models, new experience in the world, and a generator to models that have learned from it."""

Grouping: TypeAlias = Callable[[Tensor, Tensor, int, Generator], Tensor]
"""Maps first percepts (B, D), (B,) bool which scenarios are missed, a size, and a generator to the
indices (n,) of missed scenarios on which a specialist is evolved."""

Draw: TypeAlias = Callable[[int, Generator], S]
"""Draws a number of fresh scenarios of the stage's kind."""


@dataclass(frozen=True)
class Budget:
    """When to stop an evolution.

    Attributes:
        generations: Maximum number of generations.
        patience: Generations without a better fitness after which it stops, once all is solved.
        stall: Generations without a better fitness after which it gives up.
        enough: The fitness at which it stops at once if all is solved.
        satisfied: The fitness from which it stops after `patience` generations without a better
            one, even if not all is solved; other members solve the rest.
        transitions: Number of executed actions after which no generation begins.
        least: The smallest difference of a fitness that counts, in its unit.
    """

    generations: int = 150
    patience: int = 10
    stall: int = 40
    enough: float = 0.97
    satisfied: float = float("inf")
    transitions: float = float("inf")
    least: float = 1e-3

    def ends(self, found: Found) -> bool:
        """Whether an evolution with this result so far is finished."""
        good = found.best >= self.enough or found.since >= self.patience
        settled = found.best >= self.satisfied and found.since >= self.patience
        return (
            (bool(found.solved.all()) and good)
            or settled
            or found.since >= self.stall
            or found.generations >= self.generations
            or found.transitions >= self.transitions
        )


@dataclass(frozen=True)
class Setup(Generic[S]):
    """The constant inputs of improvement.

    Attributes:
        name: Of the stage, and of its skill.
        generator: The generator of all random choices of the stage.
        watch: Receives every event.
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
        group: Number of these scenarios at first.
        widest: Number to which the group grows, by doubling, as long as all of it is solved or the
            fitness is good enough.
        team: The largest number of members of a team.
        replicas: Copies of each scenario of a whole group, and more of a smaller one. With 2, it is
            met under different errors of Γ, or other noise.
        replays: Copies of each scenario on which skills are compared.
        repeats: Whether the world repeats itself, so that W is tried again and eq. 1 is exact.
        noisy: Whether scenarios can be tried again under other noise.
        live: Whether the world is a robot, where each episode is a step of its own.
        remembers: Whether a world that repeats itself is asked for replays, too, and takes time, so
            that what members solve there is remembered (`cgtorch.improvement.outcomes`).
        max_transitions: Of every skill.
        device: Where populations are evaluated.
        journal: Stores results, and returns those from before an interruption.
        kept: The best skill from before an interruption, which stays until the search is as far.
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
    widest: int = 0
    team: int = 8
    replicas: int = 2
    replays: int = 8
    repeats: bool = True
    noisy: bool = False
    live: bool = False
    remembers: bool = False
    max_transitions: int = 20
    device: torch.device | str = "cpu"
    journal: Journal = field(default_factory=Journal)
    kept: Kept | None = None
    purse: Purse = field(default_factory=Purse)
    name: str = "S0"
    generator: Generator = field(default_factory=Generator)
    watch: Watch = lambda _: None


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
