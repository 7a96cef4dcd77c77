"""A task as all searches meet it: its starts, its criterion, its budget, and what is counted."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from measure_robot_tasks import Play, player_of
from torch import Generator, Tensor

from cgtorch.domains.registry import make_domain
from cgtorch.graphs import Action, Graphs, Skill
from cgtorch.ground.asked import Asked
from cgtorch.manipulation.domain import Manipulation
from cgtorch.manipulation.simulator import CLOSEST, SOLVED
from cgtorch.manipulation.world import GRADED, Starts

BUDGET = 300_000  # low-level steps that are requested
GROUP, PRACTICE = 32, 50
"""Starts of the group, and fresh ones, that are to be solved in a row."""
DRAWN = 4096  # parameters of new nodes, from which their deviations are told


@dataclass(frozen=True)
class Found:
    """The result of a search: what it plays with, if anything, and whether it met the criterion.

    `asked` is what had been asked of the world by then.
    """

    play: Play | None
    met: bool
    asked: Asked


class Problem:
    """One task, one seed, and a budget of low-level steps; each search has a problem of its own.

    Attributes:
        domain: Its simulators count what this search asks.
        task: The task.
        seed: Of all random choices.
        generator: Of all random choices but those of `ours` and of a learner's own.
        group: The starts that are to be solved first, the same for a seed.
        practice: How many fresh starts are to be solved after them.
    """

    def __init__(self, name: str, seed: int, budget: int = BUDGET, practice: int = PRACTICE):
        """A task such as metaworld:push-v3; ValueError if that is several."""
        domain = make_domain(name)
        if not isinstance(domain, Manipulation) or len(domain.tasks) != 1:
            raise ValueError(f"{name!r} is no single task of an arm; give one, such as push-v3")
        self.domain, self.task = domain, domain.tasks[0]
        self.seed, self.budget, self.practice = seed, budget, practice
        self.generator = Generator().manual_seed(seed)
        self.group = domain.draw(self.task, GROUP, self.generator)

    @property
    def asked(self) -> Asked:
        """The low-level steps so far."""
        return self.domain.simulators.asked

    @property
    def over(self) -> bool:
        """Whether the budget is spent; the episode that spends the rest of it is played on."""
        return self.asked.steps >= self.budget

    @property
    def wanted(self) -> int:
        """The starts that are to be solved in a row."""
        return len(self.group) + self.practice

    def drawn(self, count: int) -> Starts:
        """Fresh starts."""
        return self.domain.draw(self.task, count, self.generator)

    def in_a_row(self, play: Play) -> int:
        """The starts that are solved before the first failure; `wanted` meets the criterion.

        Every start is met alone, so that a failure costs no more than itself. The group comes
        first, then fresh starts. It counts as a failure if the budget is spent.
        """

        def solves(number: int) -> bool:
            if self.over:
                return False
            row = number - len(self.group)
            starts = self.drawn(1) if row >= 0 else self.group[number : number + 1]
            return bool(play(self.domain.world(starts))[SOLVED] > 0)

        return first_failure(solves, self.wanted)

    @property
    def most(self) -> int:
        """The transitions of a graph, at most; the default of trainings."""
        return int(self.domain.settings.run_defaults["max_transitions"])

    def skill(self, graph: Graphs) -> Skill:
        """A graph of this domain's actions as a skill."""
        return Skill(self.task, graph, self.domain.actions(), self.most)

    def player(self, graph: Graphs) -> Play:
        """What plays one graph."""
        return player_of(self.skill(graph))

    def found(self, play: Play | None, met: bool) -> Found:
        """A result at the present costs."""
        return Found(play, met, self.asked)


def first_failure(solves: Callable[[int], bool], count: int) -> int:
    """How many of the numbers from 0 on are solved before the first that is not; `count` if all."""
    return next((number for number in range(count) if not solves(number)), count)


def deviation_of(action: Action) -> Tensor:
    """(k,) the standard deviations of the parameters of new nodes of an action."""
    if not action.num_parameters:
        return torch.zeros(0)
    return action.initial_parameters(DRAWN, Generator().manual_seed(0)).std(0)


def grade(state: Tensor) -> Tensor:
    """The graded success of states (..., S), as `ArmWorld.success` tells it."""
    graded = GRADED * state[..., CLOSEST].clamp(0, 1)
    return torch.where(state[..., SOLVED] > 0, 1.0, graded)
