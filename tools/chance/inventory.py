"""A store that orders goods for an unknown demand, which arrive two days later.

    PYTHONPATH=tools cgtorch-train --domain chance.inventory:Store --models none --minutes 3

Every order costs a fixed sum, and every article that is kept costs something each night. So rules
order up to a level S as soon as what there is falls below a level s. With endless time such a rule
is the best one (Scarf, "The optimality of (s, S) policies in the dynamic inventory problem", 1960).
"""

import torch
from torch import Tensor

from cgtorch import Field
from chance.game import Game, GameDomain, Rule

DAYS, MOST = 40, 40.0
DEMAND, LARGEST = 3.0, 12
PRICE, COST, ORDER, KEEP = 1.0, 0.4, 3.0, 0.03
"""What an article is sold and bought for, what an order costs, and a night in store."""


def poisson(mean: float, most: int) -> Tensor:
    """(most,) the chances of at most 0, 1, … most - 1."""
    counts = torch.arange(most).double()
    chances = counts * torch.tensor(mean).double().log() - mean - (counts + 1).lgamma()
    return chances.exp().cumsum(0).float()


ATMOST = poisson(DEMAND, LARGEST)


class Shelf(Game):
    """A state is the stock, what arrives tomorrow and the day after, the gain, and the day."""

    def first_state(self, scenario: Tensor) -> Tensor:
        """See `World.first_state`."""
        return torch.tensor([10.0, 0, 0, 0, 0]).repeat(len(scenario), 1)

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        """See `World.next_state`; a control of 1 orders ten articles."""
        stock, soon, later, gain, day = state.unbind(1)
        order = (10 * control[:, 0]).round().clamp(0, MOST)
        wanted = (self.chances(state, scenario, 1) >= ATMOST).float().sum(1)
        sold = torch.minimum(stock, wanted)
        left = stock - sold
        gain = gain + PRICE * sold - COST * order - ORDER * (order > 0) - KEEP * left
        after = torch.stack([left + soon, later, order, gain, day + 1], 1)
        return torch.where(self.ended(state)[:, None], state, after)

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`: what there is, with what was ordered, and the time left."""
        stock, soon, later, _, day = state.unbind(1)
        return torch.stack([stock / 10, (stock + soon + later) / 10, 1 - day / DAYS], 1)

    def ended(self, state: Tensor) -> Tensor:
        """See `Game.ended`."""
        return state[:, 4] >= DAYS

    def gained(self, state: Tensor) -> Tensor:
        """See `Game.gained`."""
        return state[:, 3]


def up_to(low: int, level: int) -> Rule:
    """Orders up to a level where there are at most so few articles, counting what was ordered."""

    def rule(percept: Tensor) -> Tensor:
        there = percept[:, 1:2]
        return torch.where(10 * there < low + 0.5, level / 10 - there, -1.0)

    return rule


class Store(GameDomain):
    """The gain of forty days."""

    table = Shelf
    target_return = 60.0
    percept = (Field("stock"), Field("with orders"), Field("time left"))
    control = (Field("order", "", -1, 4),)

    @staticmethod
    def rules() -> dict[str, Rule]:
        """See `GameDomain.rules`."""
        return {
            f"below {low + 1} up to {level}": up_to(low, level)
            for low in range(6, 15)
            for level in range(18, 42, 2)
        }
