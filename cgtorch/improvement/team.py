"""The team of skills that a composed skill branches to: how well members do, and who is chosen."""

import time
from dataclasses import dataclass, replace
from math import inf
from typing import Any, Generic

import torch
from torch import Tensor

from cgtorch.evolution import Population, join
from cgtorch.graphs import Skill, merged
from cgtorch.ground.environment import Dataset, Environment
from cgtorch.improvement.compose import branching_action, compose, fewest_members
from cgtorch.improvement.events import ModelsFitted
from cgtorch.improvement.gating import selected_members, train_gating
from cgtorch.improvement.interfaces import Models, S
from cgtorch.improvement.setup import Stage
from cgtorch.improvement.shrink import shrunk
from cgtorch.improvement.specialists import evolve_candidate
from cgtorch.improvement.stopping import Found
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
        waiting: Tests that nobody has looked at, in a world that cannot be put back.
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
        """The state with more scenarios: of the first W if `kept`, else tried by nobody."""
        n = len(scenarios)
        known, wanted = torch.full((n,), kept), torch.full((n,), targets)
        return replace(
            self,
            scenarios=self.scenarios.joined(scenarios),
            percepts=torch.cat([self.percepts, percepts]),
            keep=torch.cat([self.keep, known]),
            known=torch.cat([self.known, known]),
            tried=torch.cat([self.tried, known]),
            shown=torch.cat([self.shown, torch.zeros(n).long()]),
            targets=torch.cat([self.targets, wanted]),
            trust=torch.cat([self.trust, torch.ones(len(scenarios), len(self.members))]),
        )

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


def shares(stage: Stage[S], state: StageState[S], skills: list[Skill]) -> Tensor:
    """(B, K) share of replays in the models in which each of K skills solves each scenario.

    All skills meet the same errors of Γ, so differences between them are differences of pairs. A
    replay is broken off about where a trial in the world would be.
    """
    setup, count = stage.setup, len(state.percepts)
    if not skills:
        return torch.zeros(count, 0)
    about = state.knowledge, state.scenarios, state.percepts, setup.replays
    environment = setup.imagine(*about, stage.generator, "cpu")
    found, steps = [], None if state.repeats else state.most_steps
    with torch.no_grad():
        for skill in skills:
            who, most = (skill.graph, skill.actions), skill.max_transitions
            runs = rollout(*who, environment, max_transitions=most, max_steps=steps)
            found.append(runs.succeeded[0].view(count, setup.replays).float().mean(1))
    return torch.stack(found, 1)


def with_member(stage: Stage[S], state: StageState[S], missed: Tensor) -> StageState[S]:
    """The state with a specialist evolved in the models on `missed` (B,) scenarios."""
    setup, name = stage.setup, f"{stage.name}.{state.number}"
    most = max(setup.group, WIDEST) if setup.budget.satisfied < inf else setup.group
    rows = setup.group_of(state.percepts, missed, most, stage.generator)
    if len(rows) < FEWEST:
        solved = (~missed).nonzero()[:, 0]
        some = torch.randperm(len(solved), generator=stage.generator)[:OTHERS]
        rows = torch.cat([rows, solved[some]])
    champion = _specialist(stage, state, name, rows)
    member = Skill(name, merged(champion.graphs), setup.actions, setup.max_transitions)
    return replace(
        state,
        members=(*state.members, member),
        trust=torch.cat([state.trust, torch.ones(len(state.trust), 1)], 1),
        population=join(state.population, champion) if state.population else champion,
    )


def _specialist(stage: Stage[S], state: StageState[S], name: str, rows: Tensor) -> Population:
    """The best individual on scenarios `rows` (R,), as small as it can be.

    With a fitness of `Budget.satisfied` on a group it goes on on twice as many. This detects chance
    successes on a few, while most of the search runs on a few.
    """
    setup, step, seeds = stage.setup, name, state.population
    size = setup.group if setup.budget.satisfied < inf else len(rows)
    while True:
        group = rows[:size]
        replicas = max(setup.replicas, setup.replicas * setup.group // len(group))
        about = state.knowledge, state.scenarios[group], state.percepts[group], replicas
        environment = setup.imagine(*about, stage.generator, setup.device)
        found = _best_of_searches(stage, step, environment, seeds)
        if size >= len(rows) or found.best < setup.budget.satisfied:
            break
        size, seeds = 2 * size, found.champion
        step = f"{name} on {size}"
    how = setup.max_transitions, setup.evolution.fitness, setup.device
    return shrunk(found.champion, setup.actions, environment, *how)


def _best_of_searches(
    stage: Stage[S], name: str, environment: Environment, seeds: Population | None
) -> Found:
    """The best result of some evolutions, up to one that solves everything.

    Every second one begins without `seeds`, which may have led the first to where it got stuck.
    """
    budget, best = stage.setup.budget, evolve_candidate(stage, name, environment, seeds=seeds)
    for number in range(2, stage.setup.searches + 1):
        if best.solved.all() or best.best >= budget.satisfied:
            break
        start = None if number % 2 == 0 else seeds
        found = evolve_candidate(stage, f"{name} search {number}", environment, seeds=start)
        best = max(best, found, key=lambda each: each.best)
    return best


def composed(stage: Stage[S], state: StageState[S], rates: Tensor) -> Candidate:
    """The smallest team that solves what its members solve, given their shares (B, M)."""
    setup, nobody = stage.setup, torch.zeros(len(state.members), dtype=torch.bool)
    chosen = fewest_members(rates >= RELIABLE, nobody, FEW) or [int(rates.mean(0).argmax())]
    _, branch = branching_action(setup.actions)
    weight = torch.where(state.tried | state.targets, 3.0, 1.0)
    about = state.percepts, rates[:, chosen], weight
    branches, _ = train_gating(branch, *about, stage.generator)
    name, members = f"{stage.name}-{state.number}", [state.members[i] for i in chosen]
    skill = compose(name, members, branches, setup.actions, setup.max_transitions)
    return Candidate(skill, tuple(chosen), branches)


def learned(stage: Stage[Any], models: Models, experience: Dataset) -> Models:
    """The models after learning from experience; unchanged if nothing learns."""
    setup = stage.setup
    if setup.learn is None:
        return models
    began = time.perf_counter()
    models = setup.learn(models, experience, stage.generator)
    summary = replace(setup.describe(models), first=False)
    stage.watch(ModelsFitted(stage.name, summary, time.perf_counter() - began))
    return models
