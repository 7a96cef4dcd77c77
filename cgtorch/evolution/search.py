"""Algorithm 2 as an endless stream of generations, of one population or of several islands.

Each island is evaluated and bred by itself, with its own random numbers. Every
`EvolutionSettings.migration` generations, the best tenth of each island replaces the worst tenth of
the next, in a ring (Fernández, Tomassini and Vanneschi, "An empirical study of multipopulation
genetic programming", Genetic Programming and Evolvable Machines 4, 2003).
"""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias
from weakref import WeakKeyDictionary

import torch
from torch import Generator, Tensor

from cgtorch.evolution import compiled
from cgtorch.evolution.evolution import EvolutionState, check_kinds, initial_state, next_state
from cgtorch.evolution.fitness import Evaluation
from cgtorch.evolution.operators import crossover, mutate
from cgtorch.evolution.population import STRATEGY, Population, join, slim
from cgtorch.evolution.racing import race
from cgtorch.evolution.selection import Evaluated
from cgtorch.evolution.settings import EvolutionSettings, check_parts
from cgtorch.graphs import Action, ActionSet, Graphs, SubSkill, check_action, widened
from cgtorch.graphs.skill import MOST_TRANSITIONS
from cgtorch.ground import distributed as ranks
from cgtorch.ground.dry_run import check_environment, check_methods
from cgtorch.ground.environment import Counting, Environment
from cgtorch.ground.given import whole_number
from cgtorch.native.gpu import launcher_of
from cgtorch.simulation import MAX_TRANSITIONS

MIGRANTS = 10  # one individual in so many
RARELY = 0.05  # the largest rate of each change of structure as soon as a scenario is solved

Environments: TypeAlias = Callable[[int], Environment]
"""Makes the environment of each generation, counted from 0, with any number of scenarios."""


@dataclass(frozen=True)
class Generation:
    """One evaluated generation of all islands.

    Attributes:
        number: Counted from 0.
        islands: The islands that this rank holds, with the individuals that were evaluated.
        fitness: (P,) of the first of these islands.
        champion: The best individual of all islands, a population of one. Of equally fit ones, the
            smallest; of these, the one of the first island.
        best: The fitness of the champion.
        succeeded: (B,) bool, the scenarios that the champion solves in the environment.
        transitions: Number of actions until the ends of all rollouts, those of endless loops
            included.
        executed: How many of these were actually executed; the rest of a loop is only counted.
        scores: (P, B) of the first of these islands, on the scenarios of this generation.
        not_finite: Number of individuals that do not count, because some of their numbers are not
            finite.
    """

    number: int
    islands: Sequence[EvolutionState]
    fitness: Tensor
    champion: Population
    best: float
    succeeded: Tensor
    transitions: int
    executed: int
    scores: Tensor
    not_finite: int = 0

    @property
    def population(self) -> Population:
        """The individuals of the first island that this rank holds."""
        return self.islands[0].population

    @property
    def distinct_parents(self) -> int:
        """Number of different parents of that island; 0 for first ones and samples of lineages."""
        return self.islands[0].distinct_parents


def evolve(
    environment: Environment | Environments,
    actions: ActionSet,
    settings: EvolutionSettings,
    generator: Generator,
    *,
    keep: Tensor | None = None,
    seeds: Population | None = None,
    islands: Sequence[EvolutionState] | None = None,
    guests: Callable[[], Population | None] | None = None,
    max_transitions: int = MAX_TRANSITIONS,
) -> Iterator[Generation]:
    """Evolve without end: the caller decides when to stop iterating.

    Args:
        environment: The scenarios, or a function that makes those of each generation
            (`Environments`), for example random starts of episodes.
        actions: What nodes can do.
        settings: How populations evolve.
        generator: The generator of all random choices. It advances only on the rank that holds the
            first island.
        keep: (B,) bool, the scenarios of W (eq. 1a), on the environment's device. By default none,
            on the CPU. A function that makes environments has none.
        seeds: Earlier individuals, which become half of each first population.
        islands: Islands of this rank to continue, in place of first populations.
        guests: Called before each later generation; the individuals that it returns take the places
            of the last ones of the first island.
        max_transitions: Transitions after which a rollout fails.

    The ranks (`cgtorch.ground.distributed`) share the islands. All ranks must pass the same
    arguments, except for `islands`.

    Raises:
        WorldError: In a dry run on two scenarios, the environment breaks its interface.
        ActionError: An action breaks its interface.
        SettingsError: A selection, crossover, mutation or fitness of the settings breaks its
            interface, or something given is of another kind.
    """
    check_kinds(settings, actions, generator)
    max_transitions = whole_number(max_transitions, "max_transitions", 1, MOST_TRANSITIONS)
    begin = islands[0].generation if islands else 0
    first = environment(begin) if callable(environment) else environment
    check_methods(first)
    if keep is None:
        keep = torch.zeros(first.num_scenarios, dtype=torch.bool)
    _dry_run(first, actions, settings, keep.device)
    count, group = settings.islands, ranks.group_of(settings.islands)
    if islands is None:
        own = [derived_generator(generator, number) for number in ranks.held(count)]
        islands = [initial_state(settings, actions, each, seeds) for each in own]
    home = home_of(settings, actions, keep.device)
    islands = [replace(each, population=each.population.to(home)) for each in islands]
    about = partial(
        settings.evaluate, actions, max_transitions=max_transitions, group=group,
        fitness=settings.fitness,
    )  # fmt: skip
    evaluation = about(environment=first, keep=keep)

    def scores_of(result: Evaluation) -> Tensor:
        # Of other scenarios, only means can be compared with those of earlier generations.
        alone = callable(environment) and settings.lineages
        return result.fitness[:, None] if alone else result.scores

    while True:
        results = [evaluation(island.population.graphs) for island in islands]
        evaluated = [
            Evaluated(island.population, result.fitness, scores_of(result))
            for island, result in zip(islands, results, strict=True)
        ]
        generation = _generation(islands, evaluated, results, settings)
        yield generation
        if count > 1 and (generation.number + 1) % settings.migration == 0:
            arrivals = _shared(ranks.ring_shift, map(emigrants, evaluated), settings)
            evaluated = [migrated(*pair) for pair in zip(evaluated, arrivals, strict=True)]
        if settings.evaluate is race and generation.succeeded.any():
            evaluated = [_settled(each) for each in evaluated]
        pairs = zip(islands, evaluated, strict=True)
        islands = [next_state(*pair, settings, actions) for pair in pairs]
        if guests is not None and (some := guests()) is not None:
            islands = [_with_guests(islands[0], some), *islands[1:]]
        if callable(environment):
            fresh = environment(generation.number + 1)
            evaluation = about(environment=fresh, keep=keep.new_zeros(fresh.num_scenarios))


_tried: WeakKeyDictionary[Action, set[tuple[type, int, int]]] = WeakKeyDictionary()
"""Kinds of environments in which actions were tried, with sizes of their percepts and controls."""


def _dry_run(
    environment: Environment, actions: ActionSet, settings: EvolutionSettings, device: torch.device
) -> None:
    """Try all parts on two rows, and an action only once in environments of a kind.

    Where low-level steps are counted, the whole is tried once, and only actions of others are.
    """
    counts = isinstance(environment, Counting)
    every = zip(actions.names, actions.actions, strict=True)
    parts = [(name, action) for name, action in every if not isinstance(action, SubSkill)]
    if counts and all(_kind(environment) in _tried.get(action, ()) for _, action in parts):
        return
    check_environment(environment, device)
    for name, action in parts:
        ours = counts and type(action).__module__.startswith(f"{__name__.split('.')[0]}.")
        if not ours and _kind(environment) not in _tried.get(action, ()):
            check_action(name, action, environment, device)
        _tried.setdefault(action, set()).add(_kind(environment))
    check_parts(settings, actions, environment, device)


def _kind(environment: Environment) -> tuple[type, int, int]:
    return type(environment), environment.percept_size, environment.control_size


def derived_generator(generator: Generator, number: int) -> Generator:
    """The generator of an island: the given one for island 0, else one derived from its state.

    Nothing is drawn from the given generator, so a single island gives the results of no islands.
    """
    if number == 0:
        return generator
    state = generator.get_state().numpy().tobytes()
    digest = hashlib.sha256(state + number.to_bytes(8, "big")).digest()
    return Generator().manual_seed(int.from_bytes(digest[:7], "big"))


def home_of(settings: EvolutionSettings, actions: ActionSet, device: torch.device) -> torch.device:
    """The device where populations are bred: the GPU if all operators run there, else the CPU.

    With several ranks, each breeds on the CPU.
    """
    own = settings.crossover is not crossover or settings.mutation is not mutate
    if own or settings.lineages or ranks.count() > 1 or launcher_of(device) is None:
        return torch.device("cpu")
    few = compiled.within_limits(settings.capacity, actions.outcome_capacity)
    return device if few else torch.device("cpu")


def _settled(evaluated: Evaluated) -> Evaluated:
    """The individuals, whose children differ in parameters rather than in structure."""
    strategy = evaluated.population.strategy.clone()
    strategy[:, : STRATEGY.index("mutate_parameter")].clamp_(max=RARELY)
    return replace(evaluated, population=replace(evaluated.population, strategy=strategy))


def _with_guests(island: EvolutionState, guests: Population) -> EvolutionState:
    """The island with other individuals in place of its last ones."""
    stay = len(island.population) - len(guests)
    return replace(island, population=slim(join(island.population[:stay], guests)))


def emigrants(evaluated: Evaluated) -> Evaluated:
    """The best tenth of an island, at least one individual."""
    return evaluated.rows(evaluated.order[: max(1, len(evaluated) // MIGRANTS)])


def migrated(evaluated: Evaluated, arrivals: Evaluated) -> Evaluated:
    """The individuals of an island, with the worst of them replaced by `arrivals`."""
    stay = evaluated.order[: len(evaluated) - len(arrivals)].sort().values
    return evaluated.rows(stay).with_others(arrivals)


def _generation(
    islands: Sequence[EvolutionState],
    evaluated: Sequence[Evaluated],
    results: Sequence[Evaluation],
    settings: EvolutionSettings,
) -> Generation:
    """The generation of all islands, given those that this rank holds and their results."""
    count, leaders = settings.islands, []
    for each, result in zip(evaluated, results, strict=True):
        # The scores of a leader are its solved scenarios.
        leaders.append(replace(each, scores=result.succeeded).rows(each.order[:1]))
    if len(leaders) < count:
        leaders = _shared(ranks.all_gather_parts, leaders, settings)
    best = min(leaders, key=lambda x: (-float(x.fitness), int(x.population.graphs.num_nodes)))
    transitions, executed, not_finite = (
        int(ranks.all_gather_parts(torch.tensor(numbers), count).sum())
        for numbers in zip(
            *((r.transitions, r.executed, r.not_finite) for r in results), strict=True
        )
    )
    return Generation(
        number=islands[0].generation,
        islands=islands,
        fitness=results[0].fitness,
        champion=best.population.to("cpu"),
        best=float(best.fitness),
        succeeded=best.scores[0].cpu(),
        transitions=transitions,
        executed=executed,
        scores=results[0].scores,
        not_finite=not_finite,
    )


def _shared(
    share: Callable[[Tensor, int], Tensor],
    mine: Iterable[Evaluated],
    settings: EvolutionSettings,
) -> list[Evaluated]:
    """Individuals of other islands, given equally many of each island that this rank holds."""
    rows = []
    for each in mine:
        graphs = widened(each.population.graphs, settings.capacity)  # as all islands' are
        tensors = *vars(graphs).values(), each.population.strategy, each.fitness, each.scores
        rows.append(tensors)
    found = [share(torch.stack(column), settings.islands) for column in zip(*rows, strict=True)]
    return [
        Evaluated(Population(Graphs(*tensors[:-3]), tensors[-3]), *tensors[-2:])
        for tensors in zip(*found, strict=True)
    ]
