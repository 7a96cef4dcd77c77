"""This library on the standard tasks with a learned Γ: few steps in the world, the rest imagined.

Short episodes of random controls are played first, and Γ is fitted to their transitions. Then
graphs are evolved in Γ as `standard.ours` evolves them in the world. A champion that is good enough
in Γ, beyond what chance may have added, is played once in the world, and Γ learns from that. It is
offered if this episode is good enough, or if the world gives what Γ has promised for it. Where
there is none for some generations, the best one is played if it could be good or Γ would learn from
it, and else a graph that is evolved to come to where Γ is unsure, or if there is no such graph, the
best one for a few steps, to see another start. Rewards, and when an episode is
over, are given (`standard.rewards`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from cgtorch.domains.gaussian_process import GaussianProcess
from cgtorch.domains.rewarded_model import CuriousModel, Imagined, RewardedModel
from cgtorch.evolution import REWARDS, evolve
from cgtorch.graphs import ActionSet, Graphs, reward_actions
from cgtorch.ground.environment import Lanes, start_lanes
from cgtorch.simulation import rollout
from cgtorch.simulation.recording import Recording
from standard.measure import CountedWorld, Trial
from standard.ours import MOST, player_of
from standard.peers import UnsuitableError
from standard.rewards import GIVEN
from standard.task import Task

STARTS = 8
"""Episodes of an individual in Γ; each generation has other ones."""
EPISODES, SHORT = 8, 25
"""Episodes of random controls to begin with, and steps after which they are broken off, and after
which episodes are that only show another start."""
CHANGES = (1.0, 0.25, 0.06)
"""Chances of another control in each step; an episode has one of them."""
HORIZON, LONG = 1000, 2000
"""Steps of an episode at most, and of those that a champion has to get right in Γ."""
CURIOUS = 100
"""Steps of an episode at most that is to explore."""
PATIENCE, EXPLORING = 10, 10
"""Generations that a good champion is waited for at first, and by how many more once there is
nothing left to explore, and generations of a search that explores."""
SURE = 64
"""Imagined episodes by which a champion is judged before it is played in the world."""
TELLING = 0.03
"""How unsure Γ is on average, of 1 where it knows nothing, in episodes that it learns from."""
MOST_CAUTIOUS = 3
"""Standard errors by which a champion has to be better than is wanted: one at first, and one more
after each that was not good on fresh episodes, up to so many."""


def search(trial: Trial) -> None:
    """Evolve graphs in Γ until one is good in the world, and on fresh episodes, too."""
    task = trial.task
    if task.name not in GIVEN:
        raise UnsuitableError("percepts do not tell what comes next, or rewards are not given")
    generator = Generator().manual_seed(trial.seed)
    actions, known = reward_actions(task.inputs, task.outputs), begun(trial, generator)
    waited, patience, cautious, enough = 0, PATIENCE, 1, wanted(task, HORIZON)

    def model(number: int) -> RewardedModel:
        return known.model(trial.starts(STARTS), HORIZON, generator)

    for generation in evolve(model, actions, REWARDS, generator, max_transitions=MOST):
        if not trial.open:
            return
        graphs, waited = generation.champion.graphs, waited + 1
        good, margin, error = generation.best >= enough, -torch.inf, torch.inf
        if good:
            mean, error = promised(graphs, actions, known.model(SURE, LONG, generator))
            margin = mean - wanted(task, LONG)
        if margin < cautious * error and waited < patience:
            continue
        waited = 0
        if good or telling(graphs, actions, known, generator):
            reached, short, known = played(trial, graphs, actions, known, HORIZON, generator)
            if good and (reached >= enough or short <= margin):
                trial.offer(player_of(graphs, actions), task.solved)
                cautious = min(cautious + 1, MOST_CAUTIOUS)
            continue
        curious = exploring(known, actions, generator)
        if telling(curious, actions, known, generator):
            *_, known = played(trial, curious, actions, known, CURIOUS, generator)
        else:  # what is still unknown is where episodes begin
            *_, known = played(trial, graphs, actions, known, SHORT, generator)
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
        gamma: what happens, and how sure that is.
    """

    task: Task
    first: Tensor
    rows: tuple[Tensor, ...]
    gamma: GaussianProcess

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
            Imagined.drawn(self.first.double(), count, generator), self.gamma, given.reward, steps,
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
        p, u, q = rows[0], self.effect(rows[1]), rows[2]
        kept = tuple(torch.cat(pair) for pair in zip(self.rows, (p, u, q), strict=True))
        return fitted(self.task, first, kept, self.gamma.free)


def fitted(
    task: Task, first: Tensor, rows: tuple[Tensor, ...], free: Tensor | None = None
) -> Known:
    """What transitions tell whose controls are what counts of them."""
    low, high = GIVEN[task.name].bounds
    tell = ((rows[2] > low) & (rows[2] < high)).all(1)
    return Known(task, first, rows, GaussianProcess(*(part[tell] for part in rows), free))


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


def imagined(graphs: Graphs, actions: ActionSet, model: RewardedModel) -> Tensor:
    """(B,) returns of a graph in Γ."""
    found = rollout(graphs, actions, model, max_transitions=MOST).returns
    return torch.full((1,), -torch.inf) if found is None else found[0]


def promised(graphs: Graphs, actions: ActionSet, model: RewardedModel) -> tuple[float, float]:
    """What a graph returns on average in Γ, and the standard error of that."""
    returns = imagined(graphs, actions, model).double()
    error = returns.std() / len(returns) ** 0.5
    return float(returns.mean()), float(error.nan_to_num(nan=torch.inf))


def telling(graphs: Graphs, actions: ActionSet, known: Known, generator: Generator) -> bool:
    """Whether Γ would learn from an episode of a graph."""
    model = known.model(SURE, CURIOUS, generator, CuriousModel)
    return float(imagined(graphs, actions, model).mean()) >= TELLING * model.most_steps


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
    trial: Trial,
    graphs: Graphs,
    actions: ActionSet,
    known: Known,
    most_steps: int,
    generator: Generator,
) -> tuple[float, float, Known]:
    """What an episode in the world returns, how much more Γ had said, and what is known then."""
    trial.evaluated(1)
    recording = Recording(BrokenOff(trial.world(1), most_steps))
    found = rollout(graphs, actions, recording, max_transitions=MOST)
    rows = recording.experience()[:3]
    if found.returns is None or not len(rows[0]):
        return -torch.inf, torch.inf, known
    here = replace(known, first=rows[0][:1]).model(SURE, most_steps, generator)
    reached, said = float(found.returns[0, 0]), float(imagined(graphs, actions, here).mean())
    return reached, said - reached, known.learned(rows)
