"""This library on the standard tasks with a learned Γ: few steps in the world, the rest imagined.

Short episodes of random controls are played first, and Γ is fitted to their transitions. Then
graphs are evolved in Γ as `standard.ours` evolves them in the world. A champion that Γ says is good
enough is played once in the world, and Γ learns from that. Where there is none for some
generations, the best one is played if Γ would learn from it, and so is another one that is evolved
to come to where Γ is unsure. Rewards, and when an episode is over, are given (`standard.rewards`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet, reward_actions
from cgtorch.domains.posterior import Posterior
from cgtorch.domains.rewarded_model import CuriousModel, Imagined, RewardedModel
from cgtorch.domains.transition import Grid, KernelTransitionModel
from cgtorch.domains.transition_fit import fit_transition_model
from cgtorch.environment import Lanes, start_lanes
from cgtorch.environment.fields import Field, bounds_of
from cgtorch.evolution import REWARDS, evolve
from cgtorch.graphs import Graphs
from cgtorch.simulation import rollout
from cgtorch.simulation.recording import Recording
from standard.measure import CountedWorld, Trial
from standard.ours import MOST, STARTS, player_of
from standard.peers import UnsuitableError
from standard.rewards import GIVEN
from standard.task import Task

EPISODES, SHORT = 8, 25
"""Episodes of random controls to begin with, and steps after which they are broken off."""
CHANGES = (1.0, 0.25, 0.06)
"""Chances of another control in each step; an episode has one of them."""
HORIZON, LONG = 1000, 5000
"""Steps of an episode at most, and of those that a champion has to get right in Γ."""
CURIOUS = 100
"""Steps of an episode at most that is to explore."""
PATIENCE, EXPLORING = 5, 10
"""Generations that a good champion is waited for at first, and by how many more once there is
nothing left to explore, and generations of a search that explores."""
SURE = 24
"""Imagined episodes by which a champion is judged before it is played in the world."""
TELLING = 0.1
"""How unsure Γ is on average, of 1 where it knows nothing, in episodes that it learns from."""
MOST_NEW = 100
"""Transitions of an episode that Γ learns from: those that it gets most wrong."""
GRID = Grid((10.0, 100.0), (0.1, 0.3, 1.0), (0.01,), 200)
"""What cross-validation chooses from: worlds without noise, and episodes of hundreds of steps, want
narrower tubes than Γ has in general."""


def search(trial: Trial) -> None:
    """Evolve graphs in Γ until one is good in the world, and on fresh episodes, too."""
    task = trial.task
    if task.name not in GIVEN:
        raise UnsuitableError("percepts do not tell what comes next, or rewards are not given")
    generator = Generator().manual_seed(trial.seed)
    actions, known = reward_actions(task.inputs, task.outputs), begun(trial, generator)
    waited, patience = 0, PATIENCE

    def model(number: int) -> RewardedModel:
        return known.model(trial.starts(STARTS), HORIZON, generator)

    for generation in evolve(model, actions, REWARDS, generator, max_transitions=MOST):
        if not trial.open:
            return
        graphs, waited = generation.champion.graphs, waited + 1
        promising = generation.best >= wanted(task, HORIZON) and imagined(
            graphs, actions, known.model(SURE, LONG, generator)
        ) >= wanted(task, LONG)
        if not promising and waited < patience:
            continue
        waited = 0
        if promising or telling(graphs, actions, known, generator):
            reached, known = played(trial, graphs, actions, known, HORIZON)
            if reached >= wanted(task, HORIZON):
                trial.offer(player_of(graphs, actions), task.solved)
                continue
        if promising:
            continue
        graphs = exploring(known, actions, generator)
        if telling(graphs, actions, known, generator):
            _, known = played(trial, graphs, actions, known, CURIOUS)
        else:
            patience += PATIENCE


def wanted(task: Task, most_steps: int) -> float:
    """The return of episodes broken off after so many steps that goes with a solution."""
    return task.solved * min(1.0, most_steps / task.most_steps)


@dataclass(frozen=True)
class Known:
    """What is known of a task.

    Attributes:
        task: which.
        first: (E, D) percepts that episodes began with.
        rows: transitions (n, D), (n, U) and (n, D).
        posterior: Γ, and how sure it is.
        chosen: rows that there were when its hyper-parameters were chosen.
    """

    task: Task
    first: Tensor
    rows: tuple[Tensor, ...]
    posterior: Posterior
    chosen: int

    def model(
        self,
        count: int,
        most_steps: int,
        generator: Generator,
        kind: type[RewardedModel] = RewardedModel,
    ) -> RewardedModel:
        """Γ as a world of so many starts, whose episodes are no longer than the task's."""
        given, steps = GIVEN[self.task.name], min(self.task.most_steps, most_steps)
        return kind(
            Imagined.drawn(self.first, count, generator), self.posterior, given.reward, steps,
            float(given.reward(*self.rows)[0].min()), self.effect, given.valid,
        )  # fmt: skip

    def effect(self, control: Tensor) -> Tensor:
        """What counts of controls (n, U)."""
        if self.task.discrete:
            return torch.nn.functional.one_hot(control.argmax(1), control.shape[1]).to(control)
        return control.clamp(-1, 1)

    def learned(self, rows: Sequence[Tensor]) -> "Known":
        """The same after one more episode; where data have doubled, Γ is fitted anew."""
        first = torch.cat([self.first, rows[0][:1]])
        with torch.no_grad():
            p, u, q = rows[0], self.effect(rows[1]), rows[2]
            wrong = self.posterior.gamma.loss(p, u, q)
        new = wrong.argsort(descending=True)[:MOST_NEW].sort().values
        kept = tuple(torch.cat([a, b[new]]) for a, b in zip(self.rows, (p, u, q), strict=True))
        if len(kept[0]) > 2 * self.chosen:
            return fitted(self.task, first, kept)
        gamma = self.posterior.gamma.updated(*kept)
        return replace(self, first=first, rows=kept, posterior=Posterior(gamma, *kept[:2]))


class BoundedModel(KernelTransitionModel):
    """Γ of numbers that are seldom at their bounds, from where they do not tell all.

    Of a number that has come to its bound it is not known by how much it would have gone on.
    """

    def targets(
        self, percept: Tensor, control: Tensor, next_percept: Tensor
    ) -> tuple[Tensor, Tensor]:
        """See `TransitionModel.targets`."""
        target, tells = super().targets(percept, control, next_percept)
        low, high = (bound.to(next_percept) for bound in bounds_of(self.percept_fields))
        return target, tells & ((next_percept > low) & (next_percept < high)).all(1)


def fitted(task: Task, first: Tensor, rows: tuple[Tensor, ...]) -> Known:
    """What transitions tell whose controls are what counts of them."""
    percept = [Field(f"p{i}", "", *GIVEN[task.name].bounds) for i in range(task.inputs)]
    control = [Field(f"u{i}", "", -1, 1) for i in range(task.outputs)]
    model = BoundedModel(percept, control)
    gamma, _ = fit_transition_model(model, *rows, grid=GRID)
    return Known(task, first, rows, Posterior(gamma, *rows[:2]), len(rows[0]))


def begun(trial: Trial, generator: Generator) -> Known:
    """What episodes of random controls show, each held for a while."""
    episodes, task = [], trial.task
    for number in range(EPISODES):
        world = trial.world(1)
        recording, change = Recording(world), CHANGES[number % len(CHANGES)]
        lanes, control = start_lanes(recording, torch.arange(1), 0, 0), torch.zeros(1, task.outputs)
        for step in range(SHORT):
            if step == 0 or float(torch.rand((), generator=generator)) < change:
                control = 2 * torch.rand(1, task.outputs, generator=generator) - 1
            lanes, _ = recording.step(lanes, control)
            lanes = replace(lanes, step=lanes.step + 1)
            if bool(world.over(lanes).any()):
                break
        episodes.append(recording.experience()[:3])
    first = torch.cat([p[:1] for p, _, _ in episodes])
    p, u, q = (torch.cat(part) for part in zip(*episodes, strict=True))
    if task.discrete:
        u = torch.nn.functional.one_hot(u.argmax(1), task.outputs).to(u)
    return fitted(task, first, (p, u, q))


def imagined(graphs: Graphs, actions: ActionSet, model: RewardedModel) -> float:
    """The mean return of a graph in Γ."""
    found = rollout(graphs, actions, model, max_transitions=MOST).returns
    return -torch.inf if found is None else float(found.mean())


def telling(graphs: Graphs, actions: ActionSet, known: Known, generator: Generator) -> bool:
    """Whether Γ would learn from an episode of a graph."""
    model = known.model(SURE, CURIOUS, generator, CuriousModel)
    return imagined(graphs, actions, model) >= TELLING * model.most_steps


def exploring(known: Known, actions: ActionSet, generator: Generator) -> Graphs:
    """A graph that comes to where Γ is unsure."""
    for generation in evolve(
        lambda number: known.model(STARTS, CURIOUS, generator, CuriousModel),
        actions, REWARDS, generator, max_transitions=MOST,
    ):  # fmt: skip
        if generation.number == EXPLORING:
            return generation.champion.graphs
    raise AssertionError("evolution has no end")


class BrokenOff(CountedWorld):
    """A world that is counted, of which all episodes begin at once and are broken off."""

    def __init__(self, counted: CountedWorld, most_steps: int) -> None:
        """The same world, in which episodes have so many steps at most."""
        super().__init__(counted.world, counted.counts)
        self.left = most_steps

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """See `Environment.step`."""
        self.left -= 1
        return super().step(lanes, control)

    def over(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.over`."""
        return super().over(lanes) | (self.left <= 0)


def played(
    trial: Trial, graphs: Graphs, actions: ActionSet, known: Known, most_steps: int
) -> tuple[float, Known]:
    """What an episode of a graph in the world returns, and what is known after it."""
    trial.evaluated(1)
    recording = Recording(BrokenOff(trial.world(1), most_steps))
    found = rollout(graphs, actions, recording, max_transitions=MOST)
    rows = recording.experience()[:3]
    reached = -torch.inf if found.returns is None else float(found.returns[0, 0])
    return reached, known.learned(rows) if len(rows[0]) else known
