"""An environment that records transitions and tests, to learn from, and counts what it is asked."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

import torch
from torch import Tensor

from cgtorch.ground.asked import NOTHING, Asked, Purse
from cgtorch.ground.environment import (
    Bounded,
    Environment,
    Episodic,
    Lanes,
    Rewarded,
    asked_of,
    seeds_of,
)

T = TypeVar("T")


class Recording:
    """Wraps an environment, with rewards or without, and records its transitions and tests.

    `experience` sorts them by the lanes' step, then by scenario, because learning depends on the
    order of the data. What is asked is paid from `purse` before it is asked, so BudgetSpentError
    can end a rollout; low-level steps are known, and counted, afterwards only. A scenario that has
    had `most` world actions is broken off: nothing more is carried out or succeeds there, and
    nothing more is asked.
    """

    def __init__(
        self,
        environment: Environment,
        purse: Purse | None = None,
        phase: str = "trials",
        most: int | None = None,
    ):
        self.environment, self.phase, self.most = environment, phase, most
        self.purse = Purse() if purse is None else purse
        self.transitions: list[tuple[Tensor, Tensor, Tensor, Tensor]] = []  # key, p, u, p′
        self.tests: list[tuple[Tensor, Tensor, Tensor]] = []  # key, p, success
        self.num_scenarios, self.percept_size = environment.num_scenarios, environment.percept_size
        self.control_size = environment.control_size
        self.actions = torch.zeros(self.num_scenarios, dtype=torch.long)
        self.seeds = seeds_of(environment, torch.arange(self.num_scenarios))
        self.first = torch.zeros(self.num_scenarios, self.percept_size)
        self.observe = environment.observe
        if isinstance(environment, Bounded):
            self.most_lanes = environment.most_lanes
        if isinstance(environment, Episodic):  # of which this is then one, too
            self.over = environment.over
        if isinstance(environment, Rewarded):
            self.returns = environment.returns

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        self.purse.pay(self.phase, Asked(looks=len(scenario)))
        state, percept = self.environment.start(scenario)
        self.first[scenario] = percept.to(self.first)
        return state, percept

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """See `Environment.step`."""
        able = control.isfinite().all(1)  # a control that is not finite is not carried out
        if self.most is not None:
            able &= self._able(lanes)
        if not able.all():
            return self._step_of(lanes, control, able)
        self.purse.pay(self.phase, Asked(motions=len(lanes)))
        self.actions.index_add_(0, lanes.scenario, torch.ones_like(lanes.scenario))
        after, done = self._counted(self.environment.step, lanes, control)
        when = self._when(lanes)[done]
        self.transitions.append((when, lanes.percept[done], control[done], after.percept[done]))
        return after, done

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """See `Environment.success`."""
        if self.most is not None and not (able := self._able(lanes)).all():
            return self._success_of(lanes, able)
        self.purse.pay(self.phase, Asked(tests=len(lanes)))
        self.actions.index_add_(0, lanes.scenario, torch.ones_like(lanes.scenario))
        when = self._when(lanes)
        lanes, result = self._counted(self.environment.success, lanes)
        self.tests.append((when, lanes.percept.clone(), result > 0.5))
        return lanes, result

    def _counted(self, method: Callable[..., T], *about: Any) -> T:
        """What a method returns, after its low-level steps are counted."""
        before = asked_of(self.environment)
        found = method(*about)
        if (more := asked_of(self.environment) - before) != NOTHING:
            self.purse.add(self.phase, more)
        return found

    def _able(self, lanes: Lanes) -> Tensor:
        """(n,) bool, the lanes whose scenarios are not broken off."""
        return self.actions[lanes.scenario] < (self.most or 0)

    def _step_of(self, lanes: Lanes, control: Tensor, able: Tensor) -> tuple[Lanes, Tensor]:
        """`step` of the lanes that are `able` (n,); the others stay."""
        rows, done = able.nonzero()[:, 0], torch.zeros_like(able)
        if len(rows):
            after, done[rows] = self.step(lanes.rows(rows), control[rows])
            lanes = lanes.with_rows(rows, after)
        return lanes, done

    def _success_of(self, lanes: Lanes, able: Tensor) -> tuple[Lanes, Tensor]:
        """`success` of the lanes that are `able` (n,); the others have failed."""
        rows, result = able.nonzero()[:, 0], torch.zeros(len(lanes))
        if len(rows):
            after, found = self.success(lanes.rows(rows))
            result, lanes = result.to(found), lanes.with_rows(rows, after)
            result[rows] = found
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
