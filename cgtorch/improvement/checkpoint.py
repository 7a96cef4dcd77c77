"""Journals: how a stage that was interrupted goes on as if nothing had happened.

Everything here depends on seeds alone, so a stage that is made again does the same again. A journal
holds what its long steps came to, in their order, each with the state of the random numbers after
it. Made again, the stage reads them instead of computing them, and goes on computing where the
journal ends. Of an evolution there is, too, a checkpoint: where it stood a while ago, as tensors.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import partial

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution import EvolutionState, Island, Population, population_from
from cgtorch.graphs import Graphs
from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import RunError
from cgtorch.improvement.search_tensors import population_tensors as _tensors
from cgtorch.improvement.search_tensors import search_tensors, with_search
from cgtorch.improvement.stopping import Found


@dataclass(frozen=True)
class Checkpoint:
    """What a long step has come to so far, and what it goes on from.

    Each of the parts gives, when it is called, a part of that, which may be large. All ranks call
    those that they call in the same order; what is kept is what the first one gets. Where they are
    held `apart`, no rank has all without the others.
    """

    about: dict[str, Tensor]
    parts: tuple[Callable[[], dict[str, Tensor]], ...]
    apart: bool = False


class Journal:
    """What a stage has done so far, told in the order in which it was done; this one keeps nothing.

    `cgtorch.runs.journal.FileJournal` keeps it in files.
    """

    def recall(self, step: str) -> dict[str, Tensor] | None:
        """What the next step came to, None if not ended; RunError if another one came next."""
        return None

    def record(self, step: str, result: dict[str, Tensor]) -> None:
        """Keep what a step that was not recalled has come to."""

    def recall_checkpoint(self, step: str) -> Checkpoint | None:
        """Where the next step stood when it was interrupted; None if that was not kept."""
        return None

    def record_checkpoint(self, step: str, checkpoint: Checkpoint) -> None:
        """Keep where a step stands, unless that was kept a moment ago; all ranks call it."""


def found_tensors(found: Found) -> dict[str, Tensor]:
    """What `found_from` reads again."""
    return {
        **_tensors("champion", found.champion),
        "solved": found.solved,
        "generations": torch.tensor(found.generations),
        "counts": torch.tensor([found.since, found.transitions]),
        "numbers": torch.tensor([found.best, found.seconds], dtype=torch.float64),
    }


def found_from(tensors: dict[str, Tensor], actions: ActionSet, scenarios: int) -> Found:
    """What an evolution of B scenarios had come to; RunError if the tensors do not say."""
    with _damage():
        champion = _population("champion", tensors, actions)[:1]
        (since, transitions), (best, seconds) = (tensors[n].tolist() for n in ("counts", "numbers"))
        solved, generations = tensors["solved"], tensors["generations"].item()
        if type(generations) is not int or generations < 0:
            raise ValueError(f"it has had {generations} generations")
        if solved.shape != (scenarios,) or solved.dtype != torch.bool:
            raise ValueError(f"solved has shape {tuple(solved.shape)}, not ({scenarios},)")
        counts = int(since), generations, int(transitions)
        return Found(champion, solved, float(best), *counts, float(seconds))


def checkpoint_of(found: Found, islands: Sequence[Island], count: int) -> Checkpoint:
    """What is found, and of `count` islands those that this rank holds, to be evaluated next."""
    # Looked at now: what is kept when a step is interrupted is written after more was drawn.
    held = dict(zip(ranks.held(count), map(island_tensors, islands), strict=True))
    own = held[min(held)]  # for its names and types, where the part is another rank's

    def part(number: int) -> dict[str, Tensor]:
        found = ranks.gather_part(held.get(number, own), number, count)
        return {name: tensor.cpu() for name, tensor in found.items()}

    parts = tuple(partial(part, number) for number in range(count))
    return Checkpoint(found_tensors(found), parts, apart=len(held) < count)


def island_tensors(island: Island) -> dict[str, Tensor]:
    """What `island_from` reads again."""
    state = {"generator": island.generator.get_state()}
    return {
        **_tensors("population", island.state.population),
        **state,
        **search_tensors(island.state),
    }


def islands_from(
    checkpoint: Checkpoint, actions: ActionSet, generator: Generator, count: int
) -> list[Island]:
    """Of `count` islands those that this rank holds, from where they stood; RunError if damaged.

    The generator is set to what the first island's was, and is that island's, if it is held.
    """
    if len(checkpoint.parts) != count:
        raise RunError(
            f"the checkpoint of an evolution has {len(checkpoint.parts)} islands, not {count}; "
            "remove it"
        )
    done = int(checkpoint.about["generations"])
    return [
        island_from(checkpoint.parts[i](), actions, Generator() if i else generator, done)
        for i in ranks.held(count)
    ]


def island_from(
    tensors: dict[str, Tensor], actions: ActionSet, generator: Generator, generation: int
) -> Island:
    """An island that evaluates this generation next, from what may be `island_tensors`."""
    with _damage():
        population = _population("population", tensors, actions)
        state = EvolutionState(population, generation, population[:1], float("-inf"))
        state = with_search(state, tensors, partial(_population, actions=actions))
    restore(generator, tensors)
    return Island(state, generator)


def restore(generator: Generator, tensors: dict[str, Tensor]) -> None:
    """Set a generator to what `tensors` say it was; RunError if they do not."""
    with _damage():
        generator.set_state(tensors["generator"])


@contextmanager
def _damage() -> Iterator[None]:
    """A RunError for all that reading tensors that are something else can raise."""
    try:
        yield
    except (KeyError, ValueError, TypeError, RuntimeError) as e:
        reason = " ".join(str(e).split())[:200]
        raise RunError(f"the checkpoint of an evolution is damaged ({reason}); remove it") from e


def _population(part: str, tensors: dict[str, Tensor], actions: ActionSet) -> Population:
    names = [*(f.name for f in fields(Graphs)), "strategy"]
    return population_from({name: tensors[f"{part}.{name}"] for name in names}, actions)
