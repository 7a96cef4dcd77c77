"""Random search: graphs are drawn one after the other, until one meets the criterion.

They are drawn as the first graphs of `ours` are. Each meets one start after the other, and is
dropped at its first failure, which costs at most one episode.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from cgtorch.evolution import EvolutionSettings
from cgtorch.evolution.population import random_graphs
from cgtorch.graphs import Graphs
from cgtorch.training.context import SMALL
from robot_tasks.problem import Found, Problem

GIVEN = "nothing more, and no grade: its graphs are drawn as the first ones of ours"
C = TypeVar("C")


def search(problem: Problem) -> Found:
    """See the module."""
    tried = (problem.player(graph) for graph in graphs(problem))
    best, row = first_good(tried, problem.in_a_row, problem.wanted, lambda: problem.over)
    return problem.found(best, row == problem.wanted)


def graphs(problem: Problem) -> Iterator[Graphs]:
    """Random graphs without end."""
    actions, capacity = problem.domain.actions(), EvolutionSettings().capacity
    while True:
        yield random_graphs(1, actions, capacity, SMALL, problem.generator)


def first_good(
    candidates: Iterable[C],
    in_a_row: Callable[[C], int],
    wanted: int,
    over: Callable[[], bool] = lambda: False,
) -> tuple[C | None, int]:
    """The first candidate that solves as many starts in a row as are wanted, and their number.

    If there is none before it is `over`, or before there are no more, it is the first one that
    solved the most.
    """
    best, most = None, -1
    for candidate in candidates:
        if over():
            break
        row = in_a_row(candidate)
        if row > most:
            best, most = candidate, row
        if most == wanted:
            break
    return best, most
