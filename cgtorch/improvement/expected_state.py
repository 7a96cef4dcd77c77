"""The state of a search for the best mean (`cgtorch.improvement.expected`), and its tensors."""

from dataclasses import astuple, dataclass, field, replace

import torch
from torch import Tensor

from cgtorch.evolution import Population
from cgtorch.evolution.ask_and_tell import VECTORS, damage, population_named, population_tensors
from cgtorch.evolution.cma import Distribution
from cgtorch.evolution.population import initial_strategy
from cgtorch.graphs import ActionSet, Graphs, Skill
from cgtorch.improvement.race import Holder
from cgtorch.improvement.spread import Need
from cgtorch.improvement.tuning import Tuning

RACING = 4  # the search plays so many times as many episodes as races
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
        settled: Whether the holder was tuned as far as possible.
        kinds: The kinds of lineages (`Lineage.kind`) that were tuned, the latest last.
        need: The number of scenarios of the next generation.
        spent: What was spent so far.
    """

    holder: Holder | None = None
    tuning: Tuning | None = None
    settled: bool = False
    kinds: tuple[tuple[int, ...], ...] = ()
    need: Need = field(default_factory=Need)
    spent: Spent = field(default_factory=Spent)

    def held_by(self, holder: Holder) -> "State":
        """The state with the winner of a race as the holder."""
        if self.holder is None or holder.skill is self.holder.skill:
            return replace(self, holder=holder)
        return replace(self, holder=holder, tuning=None, settled=False)

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
    if state.holder is None:
        return found
    holder, tuning = state.holder, state.tuning
    sums = [holder.total, holder.squares, float(holder.count)]
    found["sums"] = torch.tensor(sums, dtype=torch.float64)
    if holder.skill is not given:
        found |= population_tensors("holder", _alone(holder.skill.graph))
    if tuning is not None:
        about = tuning.distribution
        found |= population_tensors("tuning", _alone(tuning.graph))
        found |= {f"tuning.{name}": getattr(about, name) for name in VECTORS}
        found["tuning.step"] = torch.tensor(about.step, dtype=torch.float64)
        counts = about.updates, tuning.scenarios, tuning.lost, int(tuning.reliable)
        found["tuning.counts"] = torch.tensor(counts)
    return found


def state_from_tensors(
    tensors: dict[str, Tensor], actions: ActionSet, like: Skill, given: Skill | None
) -> State:
    """The state of `tensors_of_state`; its skills are named and limited like one of the stage.

    RunError if the tensors are damaged.
    """
    with damage():
        scenarios, reliability = tensors["need"].tolist()
        state = State(
            need=Need(int(scenarios), reliability),
            spent=Spent(*tensors["spent"].tolist()),
            settled=bool(tensors["settled"]),
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
        state = replace(state, holder=Holder(skill, total, squares, int(count)))
        if "tuning.step" not in tensors:
            return state
        updates, scenarios, lost, reliable = tensors["tuning.counts"].tolist()
        vectors = {name: tensors[f"tuning.{name}"] for name in VECTORS}
        about = Distribution(step=float(tensors["tuning.step"]), updates=updates, **vectors)
        graph = population_named("tuning", tensors, actions)[:1].graphs
        tuning = Tuning(graph, about, scenarios, lost, bool(reliable))
        return replace(state, tuning=tuning)


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
