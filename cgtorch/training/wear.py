"""Whether an environment is still as it was before a training, which tests of skills rely on."""

from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Generator, Tensor

from cgtorch.domains.check import trial_controls
from cgtorch.domains.domain import Domain
from cgtorch.ground.dry_run import LITTLE, MOTIONS, first_difference
from cgtorch.ground.environment import Copied, Named
from cgtorch.ground.errors import WorldError
from cgtorch.ground.whole_episode import episode_shown


@dataclass(frozen=True)
class Beginning:
    """The beginning of an episode of random controls, as a world showed it before a training.

    Attributes:
        scenarios: The scenario that it begins with; None of a world whose lanes are no copies of
            something that keeps a state.
        shown: Percepts and returns by what they are.
    """

    scenarios: Any
    shown: dict[str, Tensor]

    @classmethod
    def of(cls, domain: Domain[Any], kind: str) -> Self:
        """What a domain shows now; of a world that does not repeat itself nothing is asked."""
        scenarios = domain.draw(kind, 1, Generator().manual_seed(0))
        if not domain.repeats or not isinstance(domain.world(scenarios), Copied):
            return cls(None, {})
        return cls(scenarios, _shown(domain, scenarios))

    def check(self, domain: Domain[Any]) -> None:
        """WorldError if the domain shows something else now, after all that was tried in it."""
        if self.scenarios is None:
            return
        world, again = domain.world(self.scenarios), _shown(domain, self.scenarios)
        before = {what: seen for what, seen in self.shown.items() if what in again}
        if differs := first_difference(world, before, again, LITTLE):
            what = world.what if isinstance(world, Named) else type(world).__name__
            raise WorldError(
                f"{what} does not show the same any more as before the training ({differs}), so no "
                "result can be believed: something is kept from one episode to the next, such as a "
                "charge or a counter; set all of it anew in reset()"
            )


def _shown(domain: Domain[Any], scenarios: Any) -> dict[str, Tensor]:
    """The first percepts and returns of an episode of random controls."""
    row, controls = torch.zeros(1, dtype=torch.long), trial_controls(domain)
    return episode_shown(domain.world(scenarios), row, controls[:MOTIONS])
