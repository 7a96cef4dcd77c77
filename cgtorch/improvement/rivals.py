"""Rivals of the best skill: other structures, whose parameters are tuned side by side.

The best individuals of a generation become rivals, those of different kinds first. All have equally
many updates. After each rung the better half goes on (successive halving: Jamieson and
Talwalkar, "Non-stochastic best arm identification and hyperparameter optimization", AISTATS 2016),
until one is left, which goes on for as long as its mean does not lose races in a row.
"""

from collections.abc import Sequence

from torch import Tensor

from cgtorch.evolution import Population
from cgtorch.evolution.first_graphs import looping
from cgtorch.evolution.fitness import WORTHLESS
from cgtorch.evolution.population import slim
from cgtorch.graphs import ActionSet, compacted
from cgtorch.improvement.tuning import Tuning, begun, calmed

SEVERAL = 8  # individuals considered for each rival


def candidates(
    population: Population,
    fitness: Tensor,
    order: Tensor,
    random: Tensor,
    count: int,
    actions: ActionSet,
    scenarios: int,
) -> tuple[Tuning, ...]:
    """Possible rivals of the P individuals with this fitness (P,), the best of each kind first.

    Args:
        population: The individuals.
        fitness: (P,), of which those that did not finish an episode become no rivals.
        order: The individuals to consider, the best one first.
        random: (P,) bool, which of them are random graphs, whose parameters nothing has chosen.
        count: The number of rivals that are wanted, from `SEVERAL` times as many individuals.
        actions: What nodes can do.
        scenarios: Number of fresh scenarios of an update.
    """
    found: list[Tuning] = []
    for row in order.tolist():
        if len(found) == SEVERAL * count or float(fitness[row]) < WORTHLESS:
            break
        one = population[row : row + 1]
        graph = slim(Population(compacted(one.graphs), one.strategy)).graphs
        graph = calmed(graph, actions) if random[row] else graph
        if (tuning := begun(graph, actions, scenarios)) is not None:
            found.append(tuning)
    kinds = ((each.kind, _loops(each, actions)) for each in reversed(found))
    first = dict(zip(kinds, reversed(found), strict=True)).values()
    found.sort(key=lambda each: all(each is not one for one in first))
    return tuple(found)


def _loops(rival: Tuning, actions: ActionSet) -> bool:
    """Whether a rival acts by all that it sees, and not for ever by what it saw first."""
    return bool(looping(rival.graph, actions))


def halved(rivals: Sequence[Tuning], rungs: Sequence[int]) -> tuple[Tuning, ...]:
    """The rivals that go on once all have the updates of a rung; those alone do anyway."""
    usual = [each for each in rivals if not each.alone]
    updates = {each.distribution.updates for each in usual}
    if not compared(rivals) or len(updates) > 1 or not updates & set(rungs):
        return tuple(rivals)
    left = sorted(usual, key=lambda each: -each.level)[: -(len(usual) // 2)]
    return tuple(each for each in rivals if each.alone or any(each is one for one in left))


def compared(rivals: Sequence[Tuning]) -> bool:
    """Whether there are several rivals of which one will be left."""
    return sum(not each.alone for each in rivals) > 1


def best(rivals: Sequence[Tuning]) -> Tuning | None:
    """The rival of those that are compared whose samples are worth most."""
    usual = [each for each in rivals if not each.alone]
    return max(usual, key=lambda each: each.level, default=None)


def next_rival(rivals: Sequence[Tuning]) -> int:
    """The place of the rival that is updated next: one with a toll, else the least updated one."""

    def turn(place: int) -> tuple[bool, int]:
        return not rivals[place].toll, rivals[place].distribution.updates

    return min(range(len(rivals)), key=turn)


def simplest(rivals: Sequence[Tuning], actions: ActionSet) -> Tuning:
    """The rival with the least memory; of these a loop, then the one with fewest parameters."""

    def size(rival: Tuning) -> tuple[int, bool, int]:
        used = rival.graph.action[0].unique()
        memory = sum(actions.actions[place].memory_size for place in used[used >= 0].tolist())
        return memory, not _loops(rival, actions), len(rival.distribution.mean)

    return min(rivals, key=size)
