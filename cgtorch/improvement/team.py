"""The team of skills that a composed skill branches to, and the next skill to act in the world.

The models tell how well members do, what specialist is missing, and whether a candidate is better.
"""

import time
from dataclasses import dataclass, replace
from math import inf
from typing import Any, Generic

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.evolution import Population, join
from cgtorch.graphs import Skill, merged, same_behaviour
from cgtorch.ground.environment import Dataset
from cgtorch.improvement.compose import branching_action, compose, fewest_members
from cgtorch.improvement.events import ModelsFitted, S
from cgtorch.improvement.gating import selected_members, train_gating
from cgtorch.improvement.setup import Models, Setup
from cgtorch.improvement.specialists import specialist
from cgtorch.improvement.trial import Trial
from cgtorch.simulation import rollout

FEW = 8  # members of a team: 15 nodes with the branches to them
RELIABLE = 0.9  # share of replays from which a skill counts as solving a scenario
BLAME = 0.8  # what a failure in the world leaves of a member's share there
MOST = 7  # world actions of a trial before successes are known
STEPS = 3  # actions of a skill, at most, for each of the world
PATIENCE = 2.0  # by which a trial may exceed what almost all successes take
FEWEST = 4  # missed scenarios, to which solved ones are added for a group
OTHERS = 8  # solved scenarios that are added
WIDEST = 32  # scenarios to which a group grows, by doubling, where a fitness is good enough
REFLECT = 8  # episodes after which the models learn, however well all went
THOUGHTS = 3  # candidates in the models before one acts, where trials take a robot's time
WORTH = 0.02  # least share of replays by which a candidate replaces a skill that does not fail
ERRORS = 2.0  # standard errors by which a candidate may be worse on W
MOST_WORSE = 0.05  # share of replays by which it may be worse, however few there are
CLEAR = 0.7  # standard errors by which it has to be better on all scenarios together


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
        )

    def joined_by(self, member: Skill) -> "StageState[S]":
        """The state with one more member, which is trusted everywhere."""
        trust = torch.cat([self.trust, torch.ones(len(self.trust), 1)], 1)
        return replace(self, members=(*self.members, member), trust=trust)

    def after(self, candidate: Candidate, rows: Tensor, trial: Trial) -> "StageState[S]":
        """The state after `candidate` has acted on scenarios `rows` (R,) in the world."""
        succeeded = trial.succeeded
        keep, tried, shown = self.keep.clone(), self.tried.clone(), self.shown.clone()
        keep[rows], tried[rows], shown[rows] = succeeded, True, 2 * succeeded.long() - 1
        lost, trust = rows[~succeeded], self.trust.clone()
        blamed = candidate.sent_to(self.percepts[lost])
        known = blamed >= 0
        trust[lost[known], blamed[known]] *= BLAME
        actions = (*self.actions, *trial.actions[succeeded].tolist())
        return replace(self, keep=keep, tried=tried, shown=shown, trust=trust, actions=actions)

    def acting(self, candidate: Candidate) -> "StageState[S]":
        """The state in which a candidate acts in the world from now on."""
        if candidate is self.current:
            return self
        return replace(self, current=candidate, shown=torch.zeros_like(self.shown))


def shares(setup: Setup[S], state: StageState[S], skills: list[Skill]) -> Tensor:
    """(B, K) share of replays in the models in which each of K skills solves each scenario.

    All skills meet the same errors of Γ, so differences between them are differences of pairs. A
    replay is broken off about where a trial in the world would be.
    """
    count = len(state.percepts)
    if not skills:
        return torch.zeros(count, 0)
    about = state.knowledge, state.scenarios, state.percepts, setup.replays
    environment = setup.imagine(*about, setup.generator, "cpu")
    found, steps = [], None if state.repeats else state.most_steps
    with torch.no_grad():
        for skill in skills:
            who, most = (skill.graph, skill.actions), skill.max_transitions
            runs = rollout(*who, environment, max_transitions=most, max_steps=steps)
            found.append(runs.succeeded[0].view(count, setup.replays).float().mean(1))
    return torch.stack(found, 1)


def proposed(setup: Setup[S], state: StageState[S]) -> tuple[Candidate, StageState[S]]:
    """The skill to act next, and the state that knows the members it may have been made of.

    Where nothing repeats itself, it is the best of several candidates in the models.
    """
    candidate, state = _candidate(setup, state)
    if state.repeats:
        return candidate, state
    for _ in range(1, THOUGHTS):
        candidate, state = _candidate(setup, state.acting(candidate))
    return candidate, state.acting(candidate)


def _candidate(setup: Setup[S], state: StageState[S]) -> tuple[Candidate, StageState[S]]:
    """The skill that acts, or one that is better in the models."""
    state = replace(state, number=state.number + 1)
    rates = _rates(setup, state)
    missed = (rates < RELIABLE).all(1)
    if missed.any():
        state = with_member(setup, state, missed)
        rates = _rates(setup, state)
    best, current = rates[:, :-1].amax(1), state.current
    if current is not None and bool((rates[:, -1] >= best.clamp(max=RELIABLE)).all()):
        return current, state
    new = composed(setup, state, rates[:, :-1])
    if current is None:
        return new, state
    if same_behaviour(new.skill, current.skill):
        return current, state
    now = shares(setup, state, [current.skill, new.skill])
    # The models may not know the failures that the world has shown.
    now[state.shown < 0, 0] *= 0.0 if state.repeats else BLAME
    gain = 0.0
    if not state.repeats:  # else the world decides on W
        now[state.shown > 0, 0] = now[state.shown > 0, 0].clamp(min=RELIABLE)
        gain = WORTH if state.in_a_row >= REFLECT else 0.0
    better = no_worse(now[:, 0], now[:, 1], state.keep, gain)
    return (new if better else current), state


def _rates(setup: Setup[S], state: StageState[S]) -> Tensor:
    """(B, M + 1) how surely members, and last the current skill, solve each scenario.

    These are shares of replays in the models, corrected by what has happened in the world.
    """
    current, members = state.current, list(state.members)
    if current is None:
        rates = pad(shares(setup, state, members), (0, 1))
    else:
        rates = shares(setup, state, [*members, current.skill])
    rates[:, :-1] *= state.trust
    rates[state.shown < 0, -1] = 0.0
    if not state.repeats:
        return rates
    rates[state.keep, -1] = 1.0
    if current is not None:
        sent = current.sent_to(state.percepts)
        sure = (state.keep & (sent >= 0)).nonzero()[:, 0]
        rates[sure, sent[sure]] = 1.0
        same = [i for i, member in enumerate(members) if member is current.skill]
        rates[:, same] = rates[:, -1:]
    return rates


def with_member(setup: Setup[S], state: StageState[S], missed: Tensor) -> StageState[S]:
    """The state with a specialist evolved in the models on `missed` (B,) scenarios."""
    name = f"{setup.name}.{state.number}"
    most = max(setup.group, WIDEST) if setup.budget.satisfied < inf else setup.group
    rows = setup.group_of(state.percepts, missed, most, setup.generator)
    if len(rows) < FEWEST:
        solved = (~missed).nonzero()[:, 0]
        some = torch.randperm(len(solved), generator=setup.generator)[:OTHERS]
        rows = torch.cat([rows, solved[some]])
    about = state.knowledge, state.scenarios[rows], state.percepts[rows], state.population
    champion = specialist(setup, name, *about)
    graphs = join(state.population, champion) if state.population else champion
    member = Skill(name, merged(champion.graphs), setup.actions, setup.max_transitions)
    return replace(state, population=graphs).joined_by(member)


def no_worse(old: Tensor, new: Tensor, keep: Tensor, gain: float = 0.0) -> bool:
    """Whether a candidate is not worse on W and better elsewhere, by shares (B,) of replays.

    Both skills meet the same errors of Γ, so the differences on W (`keep` (B,) bool) are those of
    pairs. Their mean may be at most `ERRORS` standard errors below 0, and at most `MOST_WORSE`. On
    all scenarios together the candidate has to be better by `CLEAR` standard errors, and by `gain`.
    """
    change = new - old
    inside, outside = change[keep], change[~keep]
    if len(inside):
        slack = ERRORS * float(inside.std(correction=0)) / len(inside) ** 0.5
        if float(inside.mean()) < -min(slack, MOST_WORSE) - 1e-6:
            return False
    clear = CLEAR * float(change.std(correction=0)) / len(change) ** 0.5
    return float(outside.sum()) > 0 and float(change.mean()) > max(clear, gain)


def composed(setup: Setup[S], state: StageState[S], rates: Tensor) -> Candidate:
    """The smallest team that solves what its members solve, given their shares (B, M)."""
    chosen = fewest_members(rates >= RELIABLE, FEW) or [int(rates.mean(0).argmax())]
    _, branch = branching_action(setup.actions)
    weight = torch.where(state.tried | state.targets, 3.0, 1.0)
    branches = train_gating(branch, state.percepts, rates[:, chosen], weight, setup.generator)
    name, members = f"{setup.name}-{state.number}", [state.members[i] for i in chosen]
    skill = compose(name, members, branches, setup.actions, setup.max_transitions)
    return Candidate(skill, tuple(chosen), branches)


def learned(setup: Setup[Any], models: Models, experience: Dataset) -> Models:
    """The models after learning from experience; unchanged if nothing learns."""
    if setup.learn is None:
        return models
    began = time.perf_counter()
    models = setup.learn(models, experience, setup.generator)
    summary = replace(setup.describe(models), first=False)
    setup.watch(ModelsFitted(setup.name, summary, time.perf_counter() - began))
    return models
