"""An environment that keeps what happened in it, to learn from."""

import torch
from torch import Tensor

from cgtorch.environment import Environment, Lanes, Rewarded, seeds_of


class Recording:
    """Passes everything on to an environment, also rewards, and keeps its transitions and tests.

    `transitions` are (p, u, p′) of the controls that were carried out, `tests` are (p, success).
    """

    def __init__(self, environment: Environment):
        self.environment = environment
        self.transitions: list[tuple[Tensor, Tensor, Tensor]] = []
        self.tests: list[tuple[Tensor, Tensor]] = []
        self.num_scenarios, self.percept_size = environment.num_scenarios, environment.percept_size
        self.control_size = environment.control_size
        self.seeds = seeds_of(environment, torch.arange(self.num_scenarios))
        self.start, self.observe = environment.start, environment.observe
        if isinstance(environment, Rewarded):  # of which this is then one, too
            self.over, self.returns = environment.over, environment.returns

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """See `Environment.step`."""
        after, done = self.environment.step(lanes, control)
        self.transitions.append((lanes.percept[done], control[done], after.percept[done]))
        return after, done

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """See `Environment.success`."""
        lanes, result = self.environment.success(lanes)
        self.tests.append((lanes.percept.clone(), result > 0.5))
        return lanes, result

    def experience(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """All p (N, D), u (N, U), p′ (N, D), tested p (L, D) and their success (L,) bool."""
        d, u = self.percept_size, self.control_size
        empty = (torch.zeros(0, d), torch.zeros(0, u), torch.zeros(0, d))
        nothing = (torch.zeros(0, d), torch.zeros(0, dtype=torch.bool))
        p, control, after = map(torch.cat, zip(empty, *self.transitions, strict=True))
        tested, success = map(torch.cat, zip(nothing, *self.tests, strict=True))
        return p, control, after, tested, success
