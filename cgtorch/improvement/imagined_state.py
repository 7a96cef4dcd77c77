"""The state of a search in imagined episodes (`cgtorch.improvement.imagined`), and its tensors."""

from collections.abc import Mapping
from dataclasses import astuple, dataclass, field, replace
from math import inf
from typing import Any, Protocol, Self

import torch
from torch import Generator, Tensor

from cgtorch.evolution import Population
from cgtorch.evolution.ask_and_tell import damage, population_named, population_tensors
from cgtorch.evolution.population import initial_strategy
from cgtorch.graphs import ActionSet, Graphs, Skill
from cgtorch.ground.asked import NOTHING, Asked
from cgtorch.ground.environment import Environment
from cgtorch.improvement.played import Steps

PHASES = RANDOM, CHAMPIONS, CURIOUS, STARTS = (
    "random controls",
    "champions",
    "exploration",
    "starts",
)
"""For what the world is asked."""
PATIENCE = 10
"""Generations that a good champion is waited for at first, and by how many more once there is
nothing left to explore."""


class Known(Protocol):
    """What is known of a world with rewards, and the episodes that are imagined from it.

    For a `Domain` it is `cgtorch.domains.rewarded_models.Known`.
    """

    @property
    def steps(self) -> Steps:
        """All that happened."""
        ...

    @property
    def offered(self) -> int:
        """The number of skills that were offered, and not good enough on fresh episodes."""
        ...

    def after(self, starts: Tensor, steps: Steps) -> Self:
        """The same with further first percepts (n, D) and steps."""
        ...

    def refused(self) -> Self:
        """The same after a skill that was offered was not good enough."""
        ...

    def world(self, count: int, most_steps: int, generator: Generator) -> Environment:
        """So many imagined episodes, each with its own start and errors."""
        ...

    def curious(self, count: int, most_steps: int, generator: Generator) -> Environment:
        """The same with rewards for coming to where little is known, up to 1 a step."""
        ...

    def begun_at(
        self, start: Tensor, count: int, most_steps: int, generator: Generator
    ) -> Environment:
        """`world`, in which all episodes begin with the same percept (1, D)."""
        ...

    def summary(self) -> str:
        """A line on what was learned."""
        ...

    def tensors(self) -> dict[str, Tensor]:
        """The tensors from which it is recalled."""
        ...


class Models(Protocol):
    """How a world with rewards becomes known.

    For a `Domain` they are `cgtorch.domains.rewarded_models.RewardedModels`.
    """

    @property
    def most_steps(self) -> float:
        """Steps after which the world ends an episode by itself; inf if it never does."""
        ...

    def random_control(self, generator: Generator) -> Tensor:
        """(1, U) a random control."""
        ...

    def learned(self, starts: Tensor, steps: Steps) -> Any:
        """What first percepts (n, D) and steps tell, as `Known`."""
        ...

    def recalled(self, tensors: Mapping[str, Tensor]) -> Any:
        """What is known, from `Known.tensors`; RunError if they are damaged."""
        ...


@dataclass(frozen=True)
class State:
    """The state between two generations.

    Attributes:
        known: What is known of the world.
        skill: The best skill so far; None before any was played.
        promised: The mean return that was imagined for it when it was played.
        waited: Generations since an episode in the world.
        patience: Generations to wait for a good champion.
        generations: Generations so far.
        transitions: Transitions of generations.
        episodes: Episodes in the world.
        asked: What the world was asked, by phase (`PHASES`).
        seed: A graph with which the search begins again next.
        candidate: The champion for which most is imagined since the last episode in the world.
        hope: The mean return that is imagined for it.
        since: Generations since it was found.
    """

    known: Known
    skill: Skill | None = None
    promised: float = -inf
    waited: int = 0
    patience: int = PATIENCE
    generations: int = 0
    transitions: int = 0
    episodes: int = 0
    asked: Mapping[str, Asked] = field(default_factory=dict)
    seed: Graphs | None = None
    candidate: Graphs | None = None
    hope: float = -inf
    since: int = 0

    @property
    def steps(self) -> int:
        """The number of steps in the world."""
        return sum(each.motions for each in self.asked.values())

    def met(self, known: Known, phase: str, asked: Asked) -> "State":
        """The state after the world was asked something, from which all was learned."""
        every = {**self.asked, phase: self.asked.get(phase, NOTHING) + asked}
        episodes = self.episodes + asked.episodes
        return replace(self, known=known, asked=every, episodes=episodes)


def tensors_of_state(state: State, given: Skill | None) -> dict[str, Tensor]:
    """The tensors that `state_from_tensors` reads; the skill that was `given` is not among them."""
    counts = (
        state.waited, state.patience, state.generations, state.transitions, state.episodes,
        state.since,
    )  # fmt: skip
    found = {
        **{f"known.{name}": tensor for name, tensor in state.known.tensors().items()},
        "promised": torch.tensor([state.promised, state.hope], dtype=torch.float64),
        "spent": torch.tensor(counts),
        "world": torch.tensor([astuple(state.asked.get(phase, NOTHING)) for phase in PHASES]),
        "held": torch.tensor(state.skill is not None),
    }
    if state.skill is not None and state.skill is not given:
        found |= population_tensors("skill", _alone(state.skill.graph))
    if state.candidate is not None:
        found |= population_tensors("candidate", _alone(state.candidate))
    return found


def _alone(graphs: Graphs) -> Population:
    return Population(graphs, initial_strategy(1))


def state_from_tensors(
    tensors: dict[str, Tensor],
    models: Models,
    actions: ActionSet,
    like: Skill,
    given: Skill | None,
) -> State:
    """The state of `tensors_of_state`; its skill is named and limited like one of the stage.

    RunError if the tensors are damaged.
    """
    begin = "known."
    own = {name.removeprefix(begin): x for name, x in tensors.items() if name.startswith(begin)}
    known = models.recalled(own)
    with damage():
        waited, patience, generations, transitions, episodes, since = tensors["spent"].tolist()
        rows = zip(PHASES, tensors["world"].tolist(), strict=True)
        asked = {phase: Asked(*row) for phase, row in rows}
        every = {phase: each for phase, each in asked.items() if each != NOTHING}
        skill = given if bool(tensors["held"]) else None
        if "skill.action" in tensors:
            skill = replace(like, graph=population_named("skill", tensors, actions)[:1].graphs)
        candidate = None
        if "candidate.action" in tensors:
            candidate = population_named("candidate", tensors, actions)[:1].graphs
        promised, hope = tensors["promised"].tolist()
        spent = waited, patience, generations, transitions, episodes
        return State(known, skill, promised, *spent, every, None, candidate, hope, since)
