"""Pig for one: a hundred points in as few turns as possible.

    PYTHONPATH=tools cgtorch-train --domain chance.pig:Pig --models none --minutes 3

A turn rolls a die as often as one likes. All that was rolled counts when the turn is ended, and a 1
ends the turn with nothing (Neller & Presser, "Optimal play of the dice game Pig", UMAP Journal
25(1), 2004).
"""

import torch
from torch import Tensor

from cgtorch import Field
from chance.game import Game, GameDomain, Rule

GOAL, MOST_TURNS = 100.0, 60.0


class Dice(Game):
    """A state is the score, what the turn has rolled, the turns that are over, and the step."""

    def first_state(self, scenario: Tensor) -> Tensor:
        """See `World.first_state`."""
        return torch.zeros(len(scenario), 4)

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        """See `World.next_state`; a control above 0 rolls."""
        score, turn, turns, step = state.unbind(1)
        die = (6 * self.chances(state, scenario, 1)[:, 0]).floor() + 1
        rolls = control[:, 0] > 0
        bad = rolls & (die == 1)
        score = torch.where(rolls, score, score + turn)
        turn = torch.where(rolls & ~bad, turn + die, 0.0)
        after = torch.stack([score, turn, turns + (bad | ~rolls), step + 1], 1)
        return torch.where(self.ended(state)[:, None], state, after)

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        score, turn, _, _ = state.unbind(1)
        return torch.stack([turn / 10 - 2, (GOAL - score - turn) / 50], 1)

    def ended(self, state: Tensor) -> Tensor:
        """See `Game.ended`; who never ends a turn has lost after so many."""
        return (
            (state[:, 0] >= GOAL) | (state[:, 2] >= MOST_TURNS) | (state[:, 3] >= 10 * MOST_TURNS)
        )

    def gained(self, state: Tensor) -> Tensor:
        """See `Game.gained`; turns cost one each, and a turn that is not over costs nothing yet."""
        lost = self.ended(state) & (state[:, 0] < GOAL)
        return -torch.where(lost, MOST_TURNS, state[:, 2])


def hold_at(points: float) -> Rule:
    """Ends a turn that has rolled so many points, or enough for the goal."""

    def rule(percept: Tensor) -> Tensor:
        going = (percept[:, :1] < points / 10 - 2 - 1e-4) & (percept[:, 1:2] > 0)
        return torch.where(going, 1.0, -1.0)

    return rule


class Pig(GameDomain):
    """As few turns as possible, so the return is their number below 0."""

    table = Dice
    target_return = -12.0
    percept = (Field("turn"), Field("missing"))
    control = (Field("roll", "", -1, 1),)

    @staticmethod
    def rules() -> dict[str, Rule]:
        """See `GameDomain.rules`."""
        return {f"hold at {points}": hold_at(points) for points in range(15, 31)}
