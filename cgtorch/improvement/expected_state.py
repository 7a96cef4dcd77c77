"""The state of a search for the best mean (`cgtorch.improvement.expected`), and its tensors."""

from collections.abc import Iterable
from dataclasses import astuple, dataclass, field, replace

import torch
from torch import Tensor

from cgtorch.evolution import Population
from cgtorch.evolution.ask_and_tell import VECTORS, damage, population_named, population_tensors
from cgtorch.evolution.cma import Distribution
from cgtorch.evolution.population import initial_strategy
from cgtorch.graphs import ActionSet, Graphs, Skill
from cgtorch.improvement.paired_race import Holder
from cgtorch.improvement.spread import Need
from cgtorch.improvement.tuning import Tuning

RACING = 4  # the search plays so many times as many episodes as races
CANDIDATES = 8
END = -2  # of a kind, among the numbers of a tensor


@dataclass(frozen=True)
class Spent:
    """What a search has spent.

    Attributes:
        generations: Generations so far.
        bred: How many of them had new structures.
        transitions: Transitions of generations.
        searched: Actions that were executed in generations.
        tuned: Actions that were executed in tuning, and in generations before that began.
        episodes: Episodes of generations and of tuning.
        raced: Episodes of races.
    """

    generations: int = 0
    bred: int = 0
    transitions: int = 0
    searched: int = 0
    tuned: int = 0
    episodes: int = 0
    raced: int = 0


@dataclass(frozen=True)
class State:
    """The state between two generations.

    Attributes:
        holder: The best skill so far; None before any finished an episode.
        tuning: What is being tuned; None if that is to be chosen.
        candidates: The latest lineage of each kind, the latest ones first.
        settled: Whether it is a candidate's turn to be tuned, and not the holder's.
        kinds: The kinds of candidates that were tuned, the latest last.
        need: The number of scenarios of the next generation.
        spent: What was spent so far.
    """

    holder: Holder | None = None
    tuning: Tuning | None = None
    candidates: tuple[Tuning, ...] = ()
    settled: bool = False
    kinds: tuple[tuple[int, ...], ...] = ()
    need: Need = field(default_factory=Need)
    spent: Spent = field(default_factory=Spent)

    def held_by(self, holder: Holder) -> "State":
        """The state with the winner of a race as the holder."""
        if self.holder is None or holder.skill is self.holder.skill:
            return replace(self, holder=holder)
        return replace(self, holder=holder, tuning=None, settled=False)

    def with_candidates(self, latest: Iterable[Tuning]) -> "State":
        """The state with further candidates, of which only the first of each kind stays."""
        first: dict[tuple[int, ...], Tuning] = {}
        for each in (*latest, *self.candidates):
            first.setdefault(each.kind, each)
        return replace(self, candidates=tuple(first.values())[:CANDIDATES])

    @property
    def longest(self) -> int:
        """The number of pairs that the next race may have."""
        return (self.spent.episodes // RACING - self.spent.raced) // 2


def tensors_of_state(state: State, given: Skill | None) -> dict[str, Tensor]:
    """The tensors that `state_from_tensors` reads; the skill that was `given` is not among them."""
    found = {
        "need": torch.tensor([state.need.scenarios, state.need.reliability], dtype=torch.float64),
        "spent": torch.tensor(astuple(state.spent)),
        "settled": torch.tensor(state.settled),
        "kinds": torch.tensor([number for kind in state.kinds for number in (*kind, END)]).long(),
    }
    for number, candidate in enumerate(state.candidates):
        found |= _tensors_of(f"candidate {number}", candidate)
    if state.tuning is not None:
        found |= _tensors_of("tuning", state.tuning)
    if state.holder is not None:
        holder = state.holder
        sums = [holder.total, holder.squares, float(holder.count)]
        found["sums"] = torch.tensor(sums, dtype=torch.float64)
        if holder.skill is not given:
            found |= population_tensors("holder", _alone(holder.skill.graph))
    return found


def _tensors_of(part: str, tuning: Tuning) -> dict[str, Tensor]:
    """The tensors of something that is tuned, or may be."""
    about = tuning.distribution
    counts = about.updates, tuning.scenarios, tuning.lost, int(tuning.reliable)
    return {
        **population_tensors(part, _alone(tuning.graph)),
        **{f"{part}.{name}": getattr(about, name) for name in VECTORS},
        f"{part}.step": torch.tensor(about.step, dtype=torch.float64),
        f"{part}.counts": torch.tensor(counts),
    }


def _from_tensors(part: str, tensors: dict[str, Tensor], actions: ActionSet) -> Tuning | None:
    """What `_tensors_of` wrote; None if there is no such part."""
    if f"{part}.step" not in tensors:
        return None
    updates, scenarios, lost, reliable = tensors[f"{part}.counts"].tolist()
    vectors = {name: tensors[f"{part}.{name}"] for name in VECTORS}
    about = Distribution(step=float(tensors[f"{part}.step"]), updates=updates, **vectors)
    graph = population_named(part, tensors, actions)[:1].graphs
    return Tuning(graph, about, scenarios, lost, bool(reliable))


def state_from_tensors(
    tensors: dict[str, Tensor], actions: ActionSet, like: Skill, given: Skill | None
) -> State:
    """The state of `tensors_of_state`; its skills are named and limited like one of the stage.

    RunError if the tensors are damaged.
    """
    with damage():
        scenarios, reliability = tensors["need"].tolist()
        numbers = range(CANDIDATES)
        candidates = [_from_tensors(f"candidate {i}", tensors, actions) for i in numbers]
        state = State(
            need=Need(int(scenarios), reliability),
            spent=Spent(*tensors["spent"].tolist()),
            settled=bool(tensors["settled"]),
            tuning=_from_tensors("tuning", tensors, actions),
            candidates=tuple(each for each in candidates if each is not None),
            kinds=_kinds(tensors["kinds"].tolist()),
        )
        if "sums" not in tensors:
            return state
        skill = given
        if "holder.action" in tensors:
            graph = population_named("holder", tensors, actions)[:1].graphs
            skill = replace(like, graph=graph)
        if skill is None:
            raise ValueError("it has a holder that is not there")
        total, squares, count = tensors["sums"].tolist()
        return replace(state, holder=Holder(skill, total, squares, int(count)))


def _kinds(numbers: list[int]) -> tuple[tuple[int, ...], ...]:
    """The kinds in a list of numbers, where each of them is followed by `END`."""
    found: list[tuple[int, ...]] = []
    kind: list[int] = []
    for number in numbers:
        if number == END:
            found.append(tuple(kind))
            kind = []
        else:
            kind.append(number)
    return tuple(found)


def _alone(graph: Graphs) -> Population:
    return Population(graph, initial_strategy(1))
