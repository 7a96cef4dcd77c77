"""Blackjack with an endless deck, where one can hit or stick only, in two ways to count.

    PYTHONPATH=tools cgtorch-train --domain chance.blackjack:Paid --models none --minutes 3

The dealer draws to 17. An ace counts eleven where that is no bust.
"""

import torch
from torch import Tensor

from cgtorch import Field
from cgtorch.ground.counter_rng import uniform
from chance.game import Game, GameDomain, Rule

PLAYING, WON, LOST, DRAWN = 0.0, 1.0, 2.0, 3.0
CARDS = 14
MIDDLE = 16.0, 6.0
"""The total and the dealer's card from which percepts are counted."""


def card(number: Tensor) -> Tensor:
    """The value of a card, of which ten is four times as likely, from numbers in [0, 1)."""
    return (number * 13).floor().add(1).clamp(max=10)


def with_card(total: Tensor, soft: Tensor, value: Tensor) -> tuple[Tensor, Tensor]:
    """A hand after one more card, and whether an ace counts eleven in it."""
    eleven = (value == 1) & (total + 11 <= 21)
    total = total + torch.where(eleven, 11.0, value)
    soft = soft | eleven
    rescued = soft & (total > 21)
    return torch.where(rescued, total - 10, total), soft & ~rescued


class Table(Game):
    """A state is the total, whether it is soft, the dealer's card, the result, and the step."""

    def first_state(self, scenario: Tensor) -> Tensor:
        """See `World.first_state`."""
        cards = card(uniform(self.scenarios.seed[scenario], "hands", torch.zeros(1).long(), 3))
        nothing, hard = torch.zeros(len(cards)), torch.zeros(len(cards), dtype=torch.bool)
        hand = with_card(*with_card(nothing, hard, cards[:, 0]), cards[:, 1])
        return torch.stack([hand[0], hand[1].float(), cards[:, 2], nothing, nothing], 1)

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        """See `World.next_state`; a control above 0 hits."""
        total, soft, up, result, step = state.unbind(1)
        cards = card(self.chances(state, scenario, CARDS))
        more, softer = with_card(total, soft > 0, cards[:, 0])
        dealer, rescue = with_card(torch.zeros_like(up), torch.zeros_like(up).bool(), up)
        for value in cards[:, 1:].unbind(1):
            drawn = with_card(dealer, rescue, value)
            goes = dealer < 17
            dealer, rescue = (
                torch.where(goes, drawn[0], dealer),
                torch.where(goes, *(drawn[1], rescue)),
            )
        stuck = torch.where(total == dealer, DRAWN, LOST)
        stuck = torch.where((dealer > 21) | (total > dealer), WON, stuck)
        hit, on = control[:, 0] > 0, result == PLAYING
        after = torch.where(hit, torch.where(more > 21, LOST, PLAYING), stuck)
        takes = on & hit
        new = torch.where(takes, more, total), torch.where(takes, softer.float(), soft)
        return torch.stack([*new, up, torch.where(on, after, result), step + on], 1)

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        total, soft, up, result, _ = state.unbind(1)
        shown = total - MIDDLE[0], soft, up - MIDDLE[1], result == WON, result >= LOST
        return torch.stack([x.float() for x in shown], 1)

    def ended(self, state: Tensor) -> Tensor:
        """See `Game.ended`."""
        return state[:, 3] != PLAYING

    def gained(self, state: Tensor) -> Tensor:
        """See `Game.gained`: 1 for a hand that is won."""
        return (state[:, 3] == WON).float()

    def succeeded(self, state: Tensor) -> Tensor:
        """See `World.succeeded`."""
        return state[:, 3] == WON


class SignedTable(Table):
    """A table where lost hands cost 1."""

    def gained(self, state: Tensor) -> Tensor:
        """See `Game.gained`."""
        return (state[:, 3] == WON).float() - (state[:, 3] == LOST).float()


def below(total: int) -> Rule:
    """Hits below a total."""
    return lambda percept: (total - MIDDLE[0] - 0.5 - percept[:, :1]).sign()


class Paid(GameDomain):
    """One point for a hand that is won, and none for a draw."""

    table = Table
    target_return = 0.43
    percept = tuple(
        Field(name, kind="discrete") for name in ("total", "soft", "dealer", "won", "not won")
    )
    control = (Field("hit", "", -1, 1),)

    @staticmethod
    def rules() -> dict[str, Rule]:
        """See `GameDomain.rules`."""
        return {f"hit below {total}": below(total) for total in range(12, 19)}


class Signed(Paid):
    """One point for a hand that is won, and one less for a hand that is lost."""

    table = SignedTable
    target_return = 0.0
