"""This library on the standard tasks with a learned Γ: few steps in the world, the rest imagined.

It is what `cgtorch-train --models learned` does (`cgtorch.improvement.imagined`), with rewards and
ends of episodes that are given (`standard.rewards`). What a stage offers is tried on fresh
episodes, and another round follows if it is not good enough.
"""

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch import Field
from cgtorch.domains.percept_limits import Limits
from cgtorch.domains.rewarded_models import RewardedModels
from cgtorch.evolution import REWARDS
from cgtorch.graphs import reward_actions
from cgtorch.ground.asked import BudgetSpentError
from cgtorch.improvement.events import Event, GenerationDone
from cgtorch.improvement.imagined import improve_imagined
from cgtorch.improvement.setup import Budget, Progress, Setup
from standard.measure import CountedWorld, Trial
from standard.ours import MOST, player_of
from standard.peers import UnsuitableError
from standard.rewards import GIVEN, Given
from standard.task import Starts, Task


@dataclass(frozen=True)
class Numbers:
    """The numbers of a task's percepts and controls."""

    percept: tuple[Field, ...]
    control: tuple[Field, ...]


class TaskModels(RewardedModels[Numbers]):
    """Γ of a task, whose rewards and possible percepts are given."""

    def __init__(self, task: Task, given: Given) -> None:
        """The models of a task."""
        low, high = given.bounds
        percept = tuple(Field(f"number {i}", low=low, high=high) for i in range(task.inputs))
        control = tuple(Field(f"control {i}", low=-1, high=1) for i in range(task.outputs))
        super().__init__(Numbers(percept, control))
        self.task, self.given = task, given
        self.reward, self.most_steps = given.reward, task.most_steps

    def effect(self, control: Tensor) -> Tensor:
        """See `RewardedModels.effect`."""
        if self.task.discrete:
            return torch.nn.functional.one_hot(control.argmax(1), control.shape[1]).to(control)
        return super().effect(control)

    def limits(self, percepts: Tensor) -> Limits:
        """See `RewardedModels.limits`."""
        found = super().limits(percepts[:0])
        return replace(found, circles=tuple((i, i + 1, 1.0) for i in self.given.circles))


def search(trial: Trial) -> None:
    """Evolve graphs in Γ until one is good in the world, and on fresh episodes, too."""
    task = trial.task
    if task.name not in GIVEN:
        raise UnsuitableError("percepts do not tell what comes next, or rewards are not given")
    nothing = Starts(torch.zeros(0, dtype=torch.long))
    progress: Progress[Any] = Progress(None, nothing, nothing, None)
    models = TaskModels(task, GIVEN[task.name])
    setup, number = setup_of(trial), 0
    while trial.open:
        number += 1
        setup = replace(setup, generator=Generator().manual_seed(trial.seed + 1000 * number))
        before = progress.skill
        progress = improve_imagined(setup, progress, nothing, drawn, models)
        if progress.skill is not None and progress.skill is not before:
            trial.offer(player_of(progress.skill.graph, setup.actions), task.solved)


def setup_of(trial: Trial) -> Setup[Any]:
    """A round of the search, which ends when the trial is not open any more."""

    def world(starts: Starts) -> CountedWorld:
        return trial.world(len(starts))

    def watch(event: Event) -> None:
        if isinstance(event, GenerationDone) and not trial.open:
            raise BudgetSpentError("the trial is over")

    return Setup(
        actions=reward_actions(trial.task.inputs, trial.task.outputs),
        world_of=world,
        imagine=lambda *_: world(drawn(1, Generator())),
        evolution=REWARDS,
        budget=Budget(10**6, satisfied=trial.task.solved),
        max_transitions=MOST,
        watch=watch,
    )


def drawn(count: int, generator: Generator) -> Starts:
    """So many starts; the trial draws their seeds."""
    return Starts(torch.zeros(count, dtype=torch.long))
