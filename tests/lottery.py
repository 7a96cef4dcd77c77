"""A world of chance: what is staked decides how likely a ticket wins, and noise whether it does."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Generator, Tensor

from cgtorch import Action, ActionSet, Domain, Field, Lanes, ScenarioBatch, Skill, World
from cgtorch.graphs import BranchingNN, Graphs
from cgtorch.ground.counter_rng import uniform
from cgtorch.ground.environment import Environment

MARK, DRAWN, WON = range(3)


@dataclass(frozen=True)
class Tickets(ScenarioBatch):
    """The marks of tickets, and the seeds of their draws."""

    mark: Tensor
    seed: Tensor

    def with_noise(self, copy: int) -> Self:
        return replace(self, seed=self.seed + (copy << 32))


def tickets(count: int, generator: Generator) -> Tickets:
    """Random tickets with marks from -1 to 1."""
    mark = 2 * torch.rand(count, generator=generator) - 1
    return Tickets(mark, torch.randint(2**32, (count,), generator=generator))


class Lottery(World):
    """A single draw for each ticket."""

    control_size = 1
    surest = 0.9  # how likely the best stake, which is the ticket's mark, wins

    def first_state(self, scenario: Tensor) -> Tensor:
        mark = self.scenarios.mark[scenario]
        return torch.stack([mark, torch.zeros_like(mark), torch.zeros_like(mark)], 1)

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        likely = self.surest - (control[:, 0].clamp(-1, 1) - state[:, MARK]).abs() / 2
        luck = uniform(self.scenarios.seed[scenario], "draw", state[:, DRAWN].long(), 1)[:, 0]
        won = (luck < likely).float()
        after = torch.stack([state[:, MARK], torch.ones_like(won), won], 1)
        return torch.where(state[:, DRAWN:WON] > 0, state, after)

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        return state[:, : DRAWN + 1]

    def succeeded(self, state: Tensor) -> Tensor:
        return state[:, WON] > 0


class HardLottery(Lottery):
    """One in which the best stake often loses, too."""

    surest = 0.6


class PaidLottery(Lottery):
    """One that pays two for each ticket that wins; nothing tells of success."""

    def succeeded(self, state: Tensor) -> Tensor:
        return torch.zeros(len(state), dtype=torch.bool)

    def over(self, lanes: Lanes) -> Tensor:
        return lanes.state[:, DRAWN] > 0

    def returns(self, lanes: Lanes) -> Tensor:
        return 2 * lanes.state[:, WON]


class Stake(Action):
    """Stakes a multiple of the mark and a constant; it is known at once whether the ticket won."""

    outcomes: tuple[str, ...] = ("won", "lost")
    terminal: Mapping[str, bool] = {"won": True, "lost": False}
    num_parameters: int = 2

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        stake = parameters[:, :1] * lanes.percept[:, MARK : MARK + 1] + parameters[:, 1:2]
        lanes, _ = environment.step(lanes, stake)
        lanes, chance = environment.success(lanes)
        return lanes, (chance < 0.5).long()


class Idle(Action):
    """Does nothing; its skill has failed."""

    outcomes: tuple[str, ...] = ("nothing",)
    terminal: Mapping[str, bool] = {"nothing": False}

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        return lanes, torch.zeros(len(lanes), dtype=torch.long)


ACTIONS = ActionSet(("Stake", "Idle"), (Stake(), Idle()))


def staking(times: float, more: float = 0.0, name: str = "staking") -> Skill:
    """A skill that stakes so many times the mark, and more."""
    return Skill(name, alone(0, [times, more]), ACTIONS)


def idle() -> Skill:
    """A skill that finishes no episode."""
    return Skill("idle", alone(1, [0.0, 0.0]), ACTIONS)


def alone(action: int, parameters: list[float]) -> Graphs:
    """A graph of one node."""
    edges = torch.full((1, 1, ACTIONS.outcome_capacity), -1)
    start = torch.zeros(1, dtype=torch.long)
    return Graphs(torch.tensor([[action]]), edges, torch.tensor([[parameters]]), start)


class Tombola(Domain[Tickets]):
    """The domain in which success counts."""

    models = None
    percept = (Field("mark"), Field("drawn", kind="discrete"))
    control = (Field("stake", "", -1, 1),)

    def draw(self, kind: str, count: int, generator: Generator) -> Tickets:
        return tickets(count, generator)

    def world(self, scenarios: Tickets) -> Lottery:
        return HardLottery(scenarios)

    def actions(self) -> ActionSet:
        return ACTIONS.extended(["Branch"], [BranchingNN(2)])


class PaidTombola(Tombola):
    """The domain that pays."""

    target_return = 1.7

    def world(self, scenarios: Tickets) -> PaidLottery:
        return PaidLottery(scenarios)
