"""The state of a search in imagined episodes (`cgtorch.improvement.imagined`), and its tensors."""

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from math import inf
from typing import Any, Protocol, Self

import torch
from torch import Generator, Tensor

from cgtorch.evolution.ask_and_tell import damage
from cgtorch.graphs import ActionSet, Graphs, Skill
from cgtorch.ground.asked import NOTHING, Asked
from cgtorch.ground.environment import Environment
from cgtorch.improvement import expected_state as expected
from cgtorch.improvement.paired_race import Holder
from cgtorch.improvement.played import Steps

PHASES = RANDOM, CHAMPIONS, CURIOUS, STARTS = (
    "random controls",
    "champions",
    "exploration",
    "starts",
)
"""For what the world is asked."""
KNOWN = "known."
"""Begins the names of tensors of what is known."""
PATIENCE = 6
"""Generations without progress after which an episode is played to learn from it at first, and by
how many more once there is nothing left to explore."""
PROGRESS = 0.1
"""How much nearer the best mean comes to the target, as a share of what it lacks, in progress."""


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

    def most(self, steps: int) -> float:
        """A return that no imagined episode of so many steps exceeds; inf if none is known."""
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

    @property
    def graded(self) -> bool:
        """Whether rewards tell of any state how close it is to success."""
        ...

    @property
    def looks(self) -> int:
        """First percepts of episodes that are looked at, without a step."""
        ...

    @property
    def changes(self) -> Sequence[float]:
        """Chances of another control in each step, of each of the first episodes."""
        ...

    def random_control(self, percept: Tensor, generator: Generator) -> Tensor:
        """(1, U) a random control at a percept (1, D)."""
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
        inner: The search for the best mean in imagined episodes.
        skill: The skill that is offered, if there is one.
        waited: Generations since an episode in the world, or since progress.
        patience: Generations to wait for progress.
        episodes: Episodes in the world.
        asked: What the world was asked, by phase (`PHASES`).
        seed: A graph with which the search begins again next.
        mark: The mean of the holder at the last progress with these models, -inf before.
    """

    known: Known
    inner: expected.State
    skill: Skill | None = None
    waited: int = 0
    patience: int = PATIENCE
    episodes: int = 0
    asked: Mapping[str, Asked] = field(default_factory=dict)
    seed: Graphs | None = None
    mark: float = -inf

    @property
    def generations(self) -> int:
        """The number of generations so far."""
        return self.inner.spent.generations

    @property
    def steps(self) -> int:
        """The number of steps in the world, of low-level ones where these are counted."""
        return sum(each.steps or each.motions for each in self.asked.values())

    def met(self, known: Known, phase: str, asked: Asked) -> "State":
        """The state after the world was asked something, from which all was learned."""
        every = {**self.asked, phase: self.asked.get(phase, NOTHING) + asked}
        inner, episodes = self.inner, self.episodes + asked.episodes
        if inner.holder is not None:  # of which other returns are imagined by now
            inner = replace(inner, holder=Holder(inner.holder.skill))
        return replace(
            self, known=known, asked=every, episodes=episodes, inner=inner, waited=0, mark=-inf
        )

    def waiting(self, target: float) -> "State":
        """The state after a generation of a search for a mean."""
        mean = -inf if self.inner.holder is None else self.inner.holder.mean
        lacks = 0.0 if self.mark == -inf else abs(target - self.mark)
        if mean > self.mark + PROGRESS * lacks:
            return replace(self, waited=0, mark=mean)
        return replace(self, waited=self.waited + 1)


def tensors_of_state(state: State, given: Skill | None) -> dict[str, Tensor]:
    """The tensors that `state_from_tensors` reads; the skill that was `given` is not among them."""
    counts = state.waited, state.patience, state.episodes
    return {
        **{f"{KNOWN}{name}": tensor for name, tensor in state.known.tensors().items()},
        **expected.tensors_of_state(state.inner, given),
        "waited": torch.tensor(counts),
        "mark": torch.tensor(state.mark, dtype=torch.float64),
        "world": torch.tensor([astuple(state.asked.get(phase, NOTHING)) for phase in PHASES]),
    }


def state_from_tensors(
    tensors: dict[str, Tensor],
    models: Models,
    actions: ActionSet,
    like: Skill,
    given: Skill | None,
) -> State:
    """The state of `tensors_of_state`, which has offered nothing yet.

    Its skills are named and limited like one of the stage. RunError if the tensors are damaged.
    """
    own = {n.removeprefix(KNOWN): x for n, x in tensors.items() if n.startswith(KNOWN)}
    known, inner = models.recalled(own), expected.state_from_tensors(tensors, actions, like, given)
    with damage():
        waited, patience, episodes = tensors["waited"].tolist()
        rows = zip(PHASES, tensors["world"].tolist(), strict=True)
        asked = {phase: Asked(*row) for phase, row in rows}
        every = {phase: each for phase, each in asked.items() if each != NOTHING}
        about = waited, patience, episodes, every, None, float(tensors["mark"])
        return State(known, inner, None, *about)
