"""A search as an object: ask for graphs, tell what they are worth; and its state in files."""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Self

import torch
from safetensors.torch import save
from torch import Generator, Tensor

from cgtorch.evolution.cma import Distribution
from cgtorch.evolution.evolution import EvolutionState, ask, initial_state, tell
from cgtorch.evolution.lineages import RECENT, Lineage
from cgtorch.evolution.population import Population, population_from
from cgtorch.evolution.selection import Evaluated
from cgtorch.evolution.settings import EvolutionSettings
from cgtorch.graphs import ActionSet, Graphs, Skill, merged
from cgtorch.graphs.action_set import AN_ACTION_SET
from cgtorch.ground.dry_run import kind
from cgtorch.ground.errors import DataError, RunError, SettingsError
from cgtorch.ground.files import notes_of, read_bytes, strict_json, tensors_of, write_bytes
from cgtorch.ground.given import given_path, given_seed, known_options, of_kind, shown
from cgtorch.ground.replacing import check_no_part

MAX_BYTES = 2**30
"""The size of the largest file that `Search.load` reads."""
NOTE = "cgtorch-search"
"""The name of the note in such a file that says with what the search began."""
VECTORS = ("mean", "covariance", "path", "step_path")
"""The tensors of a `Distribution`."""


class Search:
    """A search with a fitness of your own, generation by generation.

        search = Search(actions, population=100, seed=0)
        for _ in range(20):
            search.tell(fitness_of(search.ask()))
        skill = search.skill("mine")

    With the fitness of eq. 3 it is the same search as `evolve`.

    Attributes:
        actions: What nodes can do.
        settings: How the population evolves.
        best: The best individual so far, one graph; the first of the population before any is told.
        best_fitness: Its fitness, -inf before the first generation.
    """

    def __init__(
        self, actions: ActionSet, *, seed: int = 0, seeds: Population | None = None, **settings: Any
    ):
        """Begin a search.

        Args:
            actions: What nodes can do.
            seed: The seed of all its random numbers.
            seeds: Earlier individuals, which become half of the first population.
            settings: Of `EvolutionSettings`, such as `population` and `capacity`.

        Raises:
            SettingsError: Something given cannot work.
        """
        self.actions, self.settings = _given(actions, settings)
        generator = Generator().manual_seed(given_seed(seed))
        state = initial_state(self.settings, actions, generator, seeds)
        self._state, self.best, self.best_fitness = state, state.best, state.best_fitness
        self._asked = False

    @property
    def generation(self) -> int:
        """The number of generations that were told."""
        return self._state.generation

    def ask(self) -> Graphs:
        """The P graphs to evaluate next; the same ones until `tell` is called."""
        self._asked = True
        return ask(self._state).graphs

    def tell(
        self,
        fitness: Tensor | Sequence[float],
        scores: Tensor | Sequence[Sequence[float]] | None = None,
    ) -> None:
        """Breed the next generation from the fitness (P,) of this one.

        More is better, and NaN is the worst. With `scores` (P, B), one column for each scenario or
        objective, these choose the parents. DataError for other shapes, for what is no numbers, or
        if no one has asked for this generation.
        """
        if not self._asked:
            raise DataError(
                f"fitness is told of generation {self.generation}, which nobody has asked for; "
                "call ask, evaluate its graphs, and tell what they are worth"
            )
        values = _numbers(fitness, "fitness is").float()
        scores = None if scores is None else _numbers(scores, "scores are")
        own = self.settings, self.actions, self._state.generator
        self._state = after = tell(self._state, values, *own, scores)
        self._asked = False
        if after.best_fitness > self.best_fitness:
            self.best, self.best_fitness = after.best, after.best_fitness

    def skill(self, name: str, max_transitions: int = 20) -> Skill:
        """The best individual as a skill; SettingsError for a name or limit that cannot work."""
        return Skill(name, merged(self.best.graphs), self.actions, max_transitions)

    def save(self, path: Path | str) -> None:
        """Write the whole state of the search to one file; RunError if that is not possible.

        That is also so if it would replace a file of a run.
        """
        check_no_part(output := given_path(path))
        numbers = torch.tensor([self.generation, self.best_fitness], dtype=torch.float64)
        best = population_tensors("best", self.best)
        found = {**state_tensors(self._state), **best, "numbers": numbers}
        about = {NOTE: json.dumps(_about(self.actions, self.settings))}
        write_bytes(output, save({name: value.clone() for name, value in found.items()}, about))

    @classmethod
    def load(cls, path: Path | str, actions: ActionSet, **settings: Any) -> Self:
        """A search as it was saved, which goes on to the same results.

        Actions and settings have to be the same; of functions among them, this is not checked.
        SettingsError if they are not, RunError if the file holds no search.
        """
        search = cls.__new__(cls)
        search.actions, search.settings = _given(actions, settings)
        data, place = read_bytes(path, MAX_BYTES), repr(str(path))
        with damage(f"{place} holds no whole search", "give a file that Search.save wrote"):
            tensors = tensors_of(data)
            _check_same(place, notes_of(data), _about(actions, search.settings))
            generation, search.best_fitness = tensors["numbers"].tolist()
            search.best = population_named("best", tensors, actions)
            if not 0 <= generation < 2**53:
                raise ValueError(f"it has had {generation} generations")
            search._state = _state(tensors, actions, Generator(), int(generation))
            search._asked = True  # perhaps before it was saved
        return search


def _given(actions: object, settings: dict[str, Any]) -> tuple[ActionSet, EvolutionSettings]:
    """The actions and settings of a search; SettingsError for those that cannot work."""
    checked = of_kind(actions, ActionSet, "actions", AN_ACTION_SET)
    return checked, EvolutionSettings(**known_options(EvolutionSettings, settings))


def _numbers(values: Any, what: str) -> Tensor:
    """A tensor of real numbers on the CPU; DataError for what holds none."""
    try:
        dtype = None if hasattr(values, "dtype") else torch.float32
        found = torch.as_tensor(values, dtype=dtype).detach().cpu()
        if found.layout != torch.strided:
            raise TypeError("a sparse tensor is not indexed as others are")
    except (TypeError, ValueError, RuntimeError, OverflowError) as e:
        raise DataError(f"{what} {shown(values)}; give a dense tensor or a list of numbers") from e
    if found.is_complex():
        raise DataError(f"{what} {kind(found)}; give real numbers")
    return found


def _about(actions: ActionSet, settings: EvolutionSettings) -> dict[str, Any]:
    """What a saved search is to be continued with, as plain data: all but functions."""
    found = {name: value for name, value in vars(settings).items() if not callable(value)}
    return {"actions": list(actions.names), **json.loads(json.dumps(found))}


def _check_same(place: str, notes: dict[str, Any], now: dict[str, Any]) -> None:
    """SettingsError if a search was saved with others; KeyError or ValueError if it was none."""
    if NOTE not in notes:
        raise ValueError("it does not say with which actions and settings one began")
    before = strict_json(notes[NOTE])
    for name, value in now.items():
        if (was := before[name]) != value:
            said = f"{name} {was!r:.80}, not {value!r:.80}"
            raise SettingsError(f"{place} is a search with {said}; give the same as when it began")


def population_tensors(part: str, population: Population) -> dict[str, Tensor]:
    """The tensors of a population, by name."""
    values = {**vars(population.graphs), "strategy": population.strategy}
    return {f"{part}.{name}": value for name, value in values.items()}


def state_tensors(state: EvolutionState) -> dict[str, Tensor]:
    """The tensors that `state_from` reads, of the state of an evolution or of one island."""
    return {
        **population_tensors("population", state.population),
        "generator": state.generator.get_state(),
        **_lineage_tensors(state),
    }


def state_from(
    tensors: dict[str, Tensor], actions: ActionSet, generator: Generator, generation: int
) -> EvolutionState:
    """A state that evaluates this generation next, from untrusted `state_tensors`."""
    with damage():
        return _state(tensors, actions, generator, generation)


def _state(
    tensors: dict[str, Tensor], actions: ActionSet, generator: Generator, generation: int
) -> EvolutionState:
    """`state_from` with the errors that reading damaged tensors has."""
    population = population_named("population", tensors, actions)
    best = population[:1], float("-inf")
    state = EvolutionState(population, generation, *best, generator=generator)
    state = _with_lineages(state, tensors, actions)
    generator.set_state(tensors["generator"])
    return state


def restore(generator: Generator, tensors: dict[str, Tensor]) -> None:
    """Set a generator to the state in `tensors`; RunError if there is no valid one."""
    with damage():
        generator.set_state(tensors["generator"])


@contextmanager
def damage(
    what: str = "the checkpoint of an evolution is damaged", advice: str = "remove it"
) -> Iterator[None]:
    """Turn any exception from reading damaged tensors into a RunError."""
    try:
        yield
    except SettingsError:
        raise
    except (KeyError, ValueError, TypeError, RuntimeError) as e:
        reason = " ".join(str(e).split())[:200]
        raise RunError(f"{what} ({reason}); {advice}") from e


def population_named(part: str, tensors: dict[str, Tensor], actions: ActionSet) -> Population:
    """The population that `population_tensors` named; ValueError or KeyError if there is none."""
    names = [*(f.name for f in fields(Graphs)), "strategy"]
    return population_from({name: tensors[f"{part}.{name}"] for name in names}, actions)


def _lineage_tensors(state: EvolutionState) -> dict[str, Tensor]:
    """The tensors that `_with_lineages` reads; none without lineages and parents."""
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


def _with_lineages(
    state: EvolutionState, tensors: dict[str, Tensor], actions: ActionSet
) -> EvolutionState:
    """The state with lineages and parents, if the tensors contain any.

    KeyError, ValueError, TypeError or RuntimeError if they do not fit together.
    """
    if "turns" not in tensors:
        return state
    count, fresh = tensors["turns"].tolist()
    parents = None
    if "parents.fitness" in tensors:
        parents = Evaluated(
            population_named("parents", tensors, actions),
            tensors["parents.fitness"],
            tensors["parents.scores"],
        )
        if not len(parents.population) == len(parents.fitness) == len(parents.scores):
            raise ValueError("parents and what they achieved differ in number")
    lineages = tuple(_lineage(f"lineage {number}", tensors, actions) for number in range(count))
    return replace(state, lineages=lineages, parents=parents, fresh=bool(fresh))


def _lineage(part: str, tensors: dict[str, Tensor], actions: ActionSet) -> Lineage:
    fitness, level, step, *recent = tensors[f"{part}.numbers"].tolist()
    since, updates, known = tensors[f"{part}.counts"].tolist()
    vectors = {name: tensors[f"{part}.{name}"] for name in VECTORS}
    sizes = {len(vector) for vector in vectors.values()}
    if len(sizes) != 1 or not all(bool(vector.isfinite().all()) for vector in vectors.values()):
        raise ValueError("a lineage's distribution is not one of finite numbers")
    return Lineage(
        best=population_named(part, tensors, actions)[:1],
        fitness=fitness,
        scores=tensors[f"{part}.scores"],
        distribution=Distribution(step=step, updates=updates, **vectors),
        recent=tuple(recent[:known]),
        level=level,
        since=since,
    )
