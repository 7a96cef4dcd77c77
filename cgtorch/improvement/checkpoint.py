"""The result of an evolution so far, and journals, by which an interrupted stage resumes.

A journal stores the result of each long step, in order, with the state of the random numbers after
it, and a checkpoint of an evolution in progress. As all results depend on seeds alone, a repeated
stage reads these instead of computing them, and goes on from where the journal ends.
"""

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, replace
from functools import partial
from math import inf

import torch
from torch import Generator, Tensor

from cgtorch.evolution import EvolutionState, Generation, Population
from cgtorch.evolution.ask_and_tell import (
    damage,
    population_named,
    population_tensors,
    state_from,
    state_tensors,
)
from cgtorch.evolution.population import slim
from cgtorch.graphs import ActionSet, Skill
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import NOTHING, Asked
from cgtorch.ground.errors import RunError


@dataclass(frozen=True)
class Found:
    """The result of an evolution so far.

    Attributes:
        champion: The best individual, a population of one without unused slots.
        solved: (B,) bool, what it solves in the environment.
        best: Its fitness, -inf before the first generation.
        since: Generations since the fitness last improved.
        generations: Number of generations so far.
        transitions: Number of actions executed so far.
        seconds: Time so far.
        asked: Low-level steps so far, if the environment counts any.
    """

    champion: Population
    solved: Tensor
    best: float
    since: int = 0
    generations: int = 0
    transitions: int = 0
    seconds: float = 0.0
    asked: Asked = NOTHING

    def after(
        self, generation: Generation, seconds: float, least: float, asked: Asked = NOTHING
    ) -> "Found":
        """The result after one more generation, which took `seconds` and the steps `asked`.

        A fitness is better only if it is larger by more than `least`.
        """
        counted = replace(
            self,
            since=self.since + 1,
            generations=self.generations + 1,
            transitions=self.transitions + generation.transitions,
            seconds=self.seconds + seconds,
            asked=self.asked + asked,
        )
        fitness = generation.best
        if fitness <= self.best + least:
            return counted
        champion, solved = slim(generation.champion), generation.succeeded  # on any rank the same
        return replace(counted, champion=champion, solved=solved, best=fitness, since=0)


@dataclass(frozen=True)
class Checkpoint:
    """The intermediate result of a long step, and the state from which it continues.

    Each of `parts` is a function that returns a part of the state, which may be large. All ranks
    call the parts that they call in the same order; the first rank's return values are stored. With
    `apart`, the parts are distributed over the ranks.
    """

    about: dict[str, Tensor]
    parts: tuple[Callable[[], dict[str, Tensor]], ...]
    apart: bool = False


@dataclass(frozen=True)
class Kept:
    """The best skill of a search that was interrupted, and how far that search had come.

    Attributes:
        skill: The skill.
        generations: Generations that were told.
        episodes: Episodes that a search for the best mean had played when it was told of a skill.
    """

    skill: Skill
    generations: int = 0
    episodes: int = 0

    def ahead_of(self, generations: int, episodes: float = inf) -> bool:
        """Whether the same search, which has begun again, has not come as far yet."""
        return generations < self.generations or episodes < self.episodes


class Journal:
    """The results of a stage so far, in order. This base class stores nothing.

    `cgtorch.runs.journal.FileJournal` stores them in files.
    """

    def recall(self, step: str) -> dict[str, Tensor] | None:
        """The result of the next step, or None if it is not finished; RunError if names differ."""
        return None

    def record(self, step: str, result: dict[str, Tensor]) -> None:
        """Store the result of a step that was not recalled."""

    def recall_checkpoint(self, step: str) -> Checkpoint | None:
        """The last checkpoint of the next step, or None if there is none."""
        return None

    def record_checkpoint(self, step: str, checkpoint: Checkpoint) -> None:
        """Store a checkpoint of a step, unless the last one is recent; all ranks call it."""


def found_tensors(found: Found) -> dict[str, Tensor]:
    """The tensors that `found_from` reads."""
    return {
        **population_tensors("champion", found.champion),
        "solved": found.solved,
        "generations": torch.tensor(found.generations),
        "counts": torch.tensor([found.since, found.transitions]),
        "asked": torch.tensor(astuple(found.asked)),
        "numbers": torch.tensor([found.best, found.seconds], dtype=torch.float64),
    }


def found_from(tensors: dict[str, Tensor], actions: ActionSet, scenarios: int) -> Found:
    """The intermediate result of an evolution on B scenarios; RunError for damaged tensors."""
    with damage():
        champion = population_named("champion", tensors, actions)[:1]
        (since, transitions), (best, seconds) = (tensors[n].tolist() for n in ("counts", "numbers"))
        solved, generations = tensors["solved"], tensors["generations"].item()
        if type(generations) is not int or generations < 0:
            raise ValueError(f"it has had {generations} generations")
        if solved.shape != (scenarios,) or solved.dtype != torch.bool:
            raise ValueError(f"solved has shape {tuple(solved.shape)}, not ({scenarios},)")
        counts = int(since), generations, int(transitions)
        asked = Asked(*tensors["asked"].tolist())
        return Found(champion, solved, float(best), *counts, float(seconds), asked)


def checkpoint_of(found: Found, islands: Sequence[EvolutionState], count: int) -> Checkpoint:
    """A checkpoint of a result and of those of `count` islands that this rank holds."""
    # Read now, because an interrupted step is stored after further draws.
    held = dict(zip(ranks.held(count), map(state_tensors, islands), strict=True))

    def part(number: int) -> dict[str, Tensor]:
        mine = {name: tensor.cpu() for name, tensor in held.get(number, {}).items()}
        return ranks.part_of_holder(mine, number, count)

    parts = tuple(partial(part, number) for number in range(count))
    return Checkpoint(found_tensors(found), parts, apart=len(held) < count)


def islands_from(
    checkpoint: Checkpoint, actions: ActionSet, generator: Generator, count: int
) -> list[EvolutionState]:
    """The islands that this rank holds, of `count` in a checkpoint; RunError if it is damaged.

    If this rank holds the first island, the generator becomes that island's and gets its state.
    """
    if len(checkpoint.parts) != count:
        raise RunError(
            f"the checkpoint of an evolution has {len(checkpoint.parts)} islands, not {count}; "
            "remove it"
        )
    done = int(checkpoint.about["generations"])
    return [
        state_from(checkpoint.parts[i](), actions, Generator() if i else generator, done)
        for i in ranks.held(count)
    ]
