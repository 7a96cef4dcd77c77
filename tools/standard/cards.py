"""Two memory games of POPGym: RepeatFirstEasy and RepeatPreviousEasy.

Morad et al., "POPGym: Benchmarking partially observable reinforcement learning", ICLR 2023. A deck
of 52 cards is dealt one by one, and only the suit of a card is seen. The control names one of the
four suits, by preferences among them. Returns are between -1 and 1. POPGym has no threshold; its
authors publish mean returns of recurrent networks for comparison.
"""

import torch
from torch import Tensor

from cgtorch.ground.counter_rng import uniform
from standard.task import TaskWorld

CARDS, SUITS = 52, 4
ALL_SUITS = torch.arange(SUITS).double()


class RepeatFirst(TaskWorld):
    """Name the suit of the card that was dealt first, in each of 51 steps.

    A suit named rightly counts 1/51, wrongly -1/51. Taken as solved at 0.99, which allows no more
    than a slip in a few episodes. A state holds the suits of the deck in the order in which they
    are dealt, then the one that is seen.
    """

    control_size, most_steps, solved_return = SUITS, CARDS - 1, 0.99

    def begin(self, seed: Tensor) -> Tensor:
        """See `TaskWorld.begin`: the deck's order is that of random keys."""
        keys = uniform(seed, "deck", torch.zeros_like(seed), CARDS)
        deck = (keys.argsort(stable=True, dim=1) % SUITS).double()
        return torch.cat([deck, deck[:, :1]], 1)

    def advance(
        self, physics: Tensor, control: Tensor, step: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See `TaskWorld.advance`."""
        reward = self.reward(control.argmax(1), physics, step)
        shown = physics.gather(1, (step + 1).clamp_max(CARDS - 1)[:, None])
        after = torch.cat([physics[:, :CARDS], shown], 1)
        return after, reward, torch.zeros_like(step, dtype=torch.bool)

    def reward(self, named: Tensor, deck: Tensor, step: Tensor) -> Tensor:
        """(n,) what suits named (n,) bring after so many steps (n,), with decks (n, 52)."""
        return (2 * (named == deck[:, 0]).double() - 1) / (CARDS - 1)

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        return (state[:, CARDS : CARDS + 1] == ALL_SUITS).double()


class RepeatPrevious(RepeatFirst):
    """Name the suit that was seen three cards before the one that is seen.

    POPGym counts the card that is seen as the first of k = 4 cards. While fewer than four have been
    dealt nothing counts; later a suit named rightly counts 1/48, wrongly -1/48. Taken as solved at
    0.9, which is a mistake in one of twenty steps.
    """

    solved_return = 0.9
    back = 4

    def reward(self, named: Tensor, deck: Tensor, step: Tensor) -> Tensor:
        """See `RepeatFirst.reward`."""
        at = step + 1 - self.back
        wanted = deck.gather(1, at.clamp_min(0)[:, None])[:, 0]
        right = (2 * (named == wanted).double() - 1) / (CARDS - self.back)
        return torch.where(at < 0, 0.0, right)
