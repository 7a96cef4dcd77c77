"""An environment that records transitions and tests, to learn from."""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from cgtorch.environment import Environment, Lanes, Rewarded, seeds_of


class Recording:
    """Wraps an environment, with rewards or without, and records its transitions and tests.

    Transitions are (key, p, u, p′) of the controls that were carried out; tests are (key, p,
    success). `experience` sorts them by the lanes' step, then by scenario, because learning depends
    on the order of the data, and lanes run in any order.
    """

    def __init__(self, environment: Environment):
        self.environment = environment
        self.transitions: list[tuple[Tensor, Tensor, Tensor, Tensor]] = []
        self.tests: list[tuple[Tensor, Tensor, Tensor]] = []
        self.num_scenarios, self.percept_size = environment.num_scenarios, environment.percept_size
        self.control_size = environment.control_size
        self.seeds = seeds_of(environment, torch.arange(self.num_scenarios))
        self.start, self.observe = environment.start, environment.observe
        if isinstance(environment, Rewarded):  # of which this is then one, too
            self.over, self.returns = environment.over, environment.returns

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """See `Environment.step`."""
        after, done = self.environment.step(lanes, control)
        when = self._when(lanes)[done]
        self.transitions.append((when, lanes.percept[done], control[done], after.percept[done]))
        return after, done

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """See `Environment.success`."""
        when = self._when(lanes)
        lanes, result = self.environment.success(lanes)
        self.tests.append((when, lanes.percept.clone(), result > 0.5))
        return lanes, result

    def experience(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """All p (N, D), u (N, U), p′ (N, D), tested p (L, D) and their success (L,) bool."""
        d, u = self.percept_size, self.control_size
        never = torch.zeros(0, dtype=torch.long)
        empty = (never, torch.zeros(0, d), torch.zeros(0, u), torch.zeros(0, d))
        nothing = (never, torch.zeros(0, d), torch.zeros(0, dtype=torch.bool))
        p, control, after = _in_order([empty, *self.transitions])
        tested, success = _in_order([nothing, *self.tests])
        return p, control, after, tested, success

    def _when(self, lanes: Lanes) -> Tensor:
        """(n,) keys by which rows are sorted."""
        return lanes.step * self.num_scenarios + lanes.scenario


def _in_order(parts: Sequence[tuple[Tensor, ...]]) -> Iterator[Tensor]:
    """All columns except the first, sorted by the first."""
    when, *columns = map(torch.cat, zip(*parts, strict=True))
    order = when.argsort(stable=True)
    return (column[order] for column in columns)
