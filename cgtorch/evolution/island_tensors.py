"""Islands as tensors by name, for files, and from such tensors, which may be damaged."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial

import torch
from torch import Generator, Tensor

from cgtorch.evolution.cma import Distribution
from cgtorch.evolution.evaluated import Evaluated
from cgtorch.evolution.islands import Island
from cgtorch.evolution.lineages import RECENT, Lineage
from cgtorch.evolution.population import Population, population_from
from cgtorch.evolution.state import EvolutionState
from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground.errors import RunError

VECTORS = ("mean", "covariance", "path", "step_path")
"""The tensors of a `Distribution`."""

Read = Callable[[str, dict[str, Tensor]], Population]
"""Reads a population from tensors named by `population_tensors`."""


def population_tensors(part: str, population: Population) -> dict[str, Tensor]:
    """The tensors of a population, by name."""
    values = {**vars(population.graphs), "strategy": population.strategy}
    return {f"{part}.{name}": value for name, value in values.items()}


def island_tensors(island: Island) -> dict[str, Tensor]:
    """The tensors that `island_from` reads."""
    return {
        **population_tensors("population", island.state.population),
        "generator": island.generator.get_state(),
        **_search_tensors(island.state),
    }


def island_from(
    tensors: dict[str, Tensor], actions: ActionSet, generator: Generator, generation: int
) -> Island:
    """An island that evaluates this generation next, from untrusted `island_tensors`."""
    with damage():
        population = population_named("population", tensors, actions)
        state = EvolutionState(population, generation, population[:1], float("-inf"))
        state = _with_search(state, tensors, partial(population_named, actions=actions))
    restore(generator, tensors)
    return Island(state, generator)


def restore(generator: Generator, tensors: dict[str, Tensor]) -> None:
    """Set a generator to the state in `tensors`; RunError if there is no valid one."""
    with damage():
        generator.set_state(tensors["generator"])


@contextmanager
def damage() -> Iterator[None]:
    """Turn any exception from reading damaged tensors into a RunError."""
    try:
        yield
    except (KeyError, ValueError, TypeError, RuntimeError) as e:
        reason = " ".join(str(e).split())[:200]
        raise RunError(f"the checkpoint of an evolution is damaged ({reason}); remove it") from e


def population_named(part: str, tensors: dict[str, Tensor], actions: ActionSet) -> Population:
    """The population that `population_tensors` named; ValueError or KeyError if there is none."""
    names = [*(f.name for f in fields(Graphs)), "strategy"]
    return population_from({name: tensors[f"{part}.{name}"] for name in names}, actions)


def _search_tensors(state: EvolutionState) -> dict[str, Tensor]:
    """The tensors that `_with_search` reads; none without lineages and parents."""
    found: dict[str, Tensor] = {}
    if state.lineages or state.parents is not None or not state.fresh:
        found["turns"] = torch.tensor([len(state.lineages), int(state.fresh)])
    if state.parents is not None:
        found |= population_tensors("parents", state.parents.population)
        found |= {"parents.fitness": state.parents.fitness, "parents.scores": state.parents.scores}
    for number, lineage in enumerate(state.lineages):
        part, about = f"lineage {number}", lineage.distribution
        recent = [*lineage.recent, *[float("nan")] * (RECENT - len(lineage.recent))]
        found |= population_tensors(part, lineage.best)
        found |= {f"{part}.{name}": getattr(about, name) for name in VECTORS}
        numbers = [lineage.fitness, lineage.level, about.step, *recent]
        found[f"{part}.numbers"] = torch.tensor(numbers, dtype=torch.float64)
        found[f"{part}.counts"] = torch.tensor([lineage.since, about.updates, len(lineage.recent)])
        found[f"{part}.scores"] = lineage.scores
    return found


def _with_search(state: EvolutionState, tensors: dict[str, Tensor], read: Read) -> EvolutionState:
    """The state with lineages and parents, if the tensors contain any.

    KeyError, ValueError, TypeError or RuntimeError if they do not fit together.
    """
    if "turns" not in tensors:
        return state
    count, fresh = tensors["turns"].tolist()
    parents = None
    if "parents.fitness" in tensors:
        parents = Evaluated(
            read("parents", tensors), tensors["parents.fitness"], tensors["parents.scores"]
        )
        if not len(parents.population) == len(parents.fitness) == len(parents.scores):
            raise ValueError("parents and what they achieved differ in number")
    lineages = tuple(_lineage(f"lineage {number}", tensors, read) for number in range(count))
    return replace(state, lineages=lineages, parents=parents, fresh=bool(fresh))


def _lineage(part: str, tensors: dict[str, Tensor], read: Read) -> Lineage:
    fitness, level, step, *recent = tensors[f"{part}.numbers"].tolist()
    since, updates, known = tensors[f"{part}.counts"].tolist()
    vectors = {name: tensors[f"{part}.{name}"] for name in VECTORS}
    sizes = {len(vector) for vector in vectors.values()}
    if len(sizes) != 1 or not all(bool(vector.isfinite().all()) for vector in vectors.values()):
        raise ValueError("a lineage's distribution is not one of finite numbers")
    return Lineage(
        best=read(part, tensors)[:1],
        fitness=fitness,
        scores=tensors[f"{part}.scores"],
        distribution=Distribution(step=step, updates=updates, **vectors),
        recent=tuple(recent[:known]),
        level=level,
        since=since,
    )
