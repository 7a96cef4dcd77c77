"""The state of a stage: what it has met, the members of its team, and the skill that acts."""

from dataclasses import dataclass, replace
from typing import Generic

import torch
from torch import Tensor

from cgtorch.evolution import Population
from cgtorch.graphs import Skill
from cgtorch.improvement.compose import branching_action
from cgtorch.improvement.events import S
from cgtorch.improvement.gating import selected_members
from cgtorch.improvement.setup import Models

BLAME = 0.8  # what a failure in the world leaves of a member's share there
MOST = 7  # world actions of a trial before successes are known
STEPS = 3  # actions of a skill, at most, for each of the world
PATIENCE = 2.0  # by which a trial may exceed what almost all successes take
FEWEST = 4  # successes that tell how many world actions one takes


@dataclass(frozen=True)
class Candidate:
    """A skill, and the places among the members of those that it branches to.

    `branches` (M - 1, K) are the parameters of its branching nodes; None for an earlier skill.
    """

    skill: Skill
    chosen: tuple[int, ...] = ()
    branches: Tensor | None = None

    def sent_to(self, percepts: Tensor) -> Tensor:
        """(B,) long, the member that each first percept (B, D) is sent to, -1 if not known."""
        if self.branches is None:
            return torch.full((len(percepts),), -1)
        _, branch = branching_action(self.skill.actions)
        return torch.tensor(self.chosen)[selected_members(branch, self.branches, percepts)]


@dataclass(frozen=True)
class StageState(Generic[S]):
    """The state of a stage: the scenarios that it has met, and the team that should solve them.

    Attributes:
        scenarios: B scenarios.
        percepts: (B, D) their first percepts.
        keep: (B,) bool, W: those that were solved in the world.
        known: (B,) bool, W at the beginning of the stage.
        tried: (B,) bool, those that were tried in the world.
        shown: (B,) long, 1 where the skill that acts has succeeded there, -1 where it has failed.
        targets: (B,) bool, the stage's own tests and earlier failures.
        rest: More of W, which is tried in the world but not replayed, with first percepts.
        waiting: Tests without a first percept yet, in a world that cannot be reset.
        knowledge: Data and models, with all that was learned in the world.
        members: M skills to branch to.
        trust: (B, M) factors of the members' shares, below 1 where one has failed in the world.
        outcomes: (B, M) long, 1 where a member has succeeded in the world, -1 where it has failed.
        population: Graphs of specialists, seeds of later ones; None before the first.
        current: The skill that acts in the world; None before the first.
        number: Number of candidates so far.
        in_a_row: Number of fresh scenarios solved one after the other.
        repeats: Whether W is tried again in the world, so that eq. 1 is exact.
        judged: The skill that has met what it solved under other noise; None before.
        other_noise: How much of that it solved, and how much it was.
        actions: World actions of each success so far.
    """

    scenarios: S
    percepts: Tensor
    keep: Tensor
    known: Tensor
    tried: Tensor
    shown: Tensor
    targets: Tensor
    rest: tuple[S, Tensor]
    waiting: S
    knowledge: Models
    members: tuple[Skill, ...]
    trust: Tensor
    outcomes: Tensor
    population: Population | None = None
    current: Candidate | None = None
    number: int = 0
    in_a_row: int = 0
    repeats: bool = True
    judged: Candidate | None = None
    other_noise: tuple[int, int] | None = None
    actions: tuple[int, ...] = ()

    @property
    def most(self) -> int:
        """World actions after which a trial is hopeless: twice those of almost all successes."""
        if len(self.actions) < FEWEST:
            return MOST
        return max(FEWEST, int(PATIENCE * torch.tensor(self.actions).float().quantile(0.9)))

    @property
    def most_steps(self) -> int | None:
        """Actions of a skill after which a replay is hopeless; None before successes are known."""
        return None if len(self.actions) < FEWEST else STEPS * self.most

    def extended(
        self, scenarios: S, percepts: Tensor, *, kept: bool = False, targets: bool = False
    ) -> "StageState[S]":
        """The state with more scenarios: of the first W if `kept`, else untried."""

        def more(column: Tensor, value: float) -> Tensor:
            return torch.cat([column, column.new_full((len(scenarios), *column.shape[1:]), value)])

        return replace(
            self,
            scenarios=self.scenarios.joined(scenarios),
            percepts=torch.cat([self.percepts, percepts]),
            keep=more(self.keep, kept),
            known=more(self.known, kept),
            tried=more(self.tried, kept),
            shown=more(self.shown, 0),
            targets=more(self.targets, targets),
            trust=more(self.trust, 1.0),
            outcomes=more(self.outcomes, 0),
        )

    def joined_by(self, member: Skill) -> "StageState[S]":
        """The state with one more member, which is trusted everywhere."""
        trust = torch.cat([self.trust, torch.ones(len(self.trust), 1)], 1)
        outcomes = torch.cat([self.outcomes, torch.zeros_like(self.shown)[:, None]], 1)
        return replace(self, members=(*self.members, member), trust=trust, outcomes=outcomes)

    def learned(self, place: int, rows: Tensor, succeeded: Tensor) -> "StageState[S]":
        """The state in which it is known whether a member succeeds (R,) on scenarios `rows`."""
        outcomes = self.outcomes.clone()
        outcomes[rows, place] = 2 * succeeded.long() - 1
        return replace(self, outcomes=outcomes)

    def after(
        self, candidate: Candidate, rows: Tensor, succeeded: Tensor, actions: Tensor
    ) -> "StageState[S]":
        """The state after `candidate` has acted on scenarios `rows` (R,) in the world.

        `succeeded` (R,) is its result there, `actions` are world actions of successes.
        """
        keep, tried, shown = self.keep.clone(), self.tried.clone(), self.shown.clone()
        keep[rows], tried[rows], shown[rows] = succeeded, True, 2 * succeeded.long() - 1
        sent, trust, outcomes = (
            candidate.sent_to(self.percepts[rows]), self.trust.clone(), self.outcomes.clone()
        )  # fmt: skip
        known = sent >= 0
        outcomes[rows[known], sent[known]] = shown[rows[known]]
        blamed = known & ~succeeded
        trust[rows[blamed], sent[blamed]] *= BLAME
        return replace(
            self, keep=keep, tried=tried, shown=shown, trust=trust, outcomes=outcomes,
            actions=(*self.actions, *actions.tolist()),
        )  # fmt: skip

    def acting(self, candidate: Candidate) -> "StageState[S]":
        """The state in which a candidate acts in the world from now on."""
        if candidate is self.current:
            return self
        return replace(self, current=candidate, shown=torch.zeros_like(self.shown))
