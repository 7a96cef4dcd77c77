"""Two servers, of which one is faster: where should the next customer wait?

    PYTHONPATH=tools cgtorch-train --domain chance.queues:Servers --models none --minutes 3

The usual rule is the queue in which the next one is served soonest.
"""

import torch
from torch import Tensor

from cgtorch import Field
from chance.game import Game, GameDomain, Rule

SLOTS = 100
ARRIVES, FAST, SLOW = 0.75, 0.65, 0.25
"""The chances in each slot that a customer arrives, and that a server ends with one."""


class Hall(Game):
    """A state is the customers at the fast and at the slow server, their waiting, and the slot."""

    def first_state(self, scenario: Tensor) -> Tensor:
        """See `World.first_state`."""
        return torch.zeros(len(scenario), 4)

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        """See `World.next_state`; a control above 0 sends who arrives to the fast server."""
        fast, slow, waited, slot = state.unbind(1)
        chance = self.chances(state, scenario, 3)
        comes, first = chance[:, 0] < ARRIVES, control[:, 0] > 0
        fast, slow = fast + (comes & first), slow + (comes & ~first)
        fast = fast - ((fast > 0) & (chance[:, 1] < FAST)).float()
        slow = slow - ((slow > 0) & (chance[:, 2] < SLOW)).float()
        after = torch.stack([fast, slow, waited + fast + slow, slot + 1], 1)
        return torch.where(self.ended(state)[:, None], state, after)

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        return torch.stack([state[:, 0] / 5 - 1, state[:, 1] / 5 - 1, 1 - state[:, 3] / SLOTS], 1)

    def ended(self, state: Tensor) -> Tensor:
        """See `Game.ended`."""
        return state[:, 3] >= SLOTS

    def gained(self, state: Tensor) -> Tensor:
        """See `Game.gained`: the mean number of customers that are there, below 0."""
        return -state[:, 2] / SLOTS


def soonest(faster: float) -> Rule:
    """Chooses the shorter wait, if one server is so many times as fast as the other."""

    def rule(percept: Tensor) -> Tensor:
        fast, slow = (5 * percept[:, :2] + 6).unbind(1)
        return torch.where(fast <= faster * slow, 1.0, -1.0)[:, None]

    return rule


class Servers(GameDomain):
    """As few customers in the hall as possible."""

    table = Hall
    target_return = -1.0
    percept = (Field("fast"), Field("slow"), Field("time left"))
    control = (Field("fast", "", -1, 1),)

    @staticmethod
    def rules() -> dict[str, Rule]:
        """See `GameDomain.rules`."""
        return {f"{faster:g} to 1": soonest(faster) for faster in (1, 1.25, 1.5, 2, 2.6, 3, 4, 6)}
