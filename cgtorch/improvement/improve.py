"""Algorithm 1, line 4: a new skill that forgets nothing and solves something new.

Growing one graph under a hard W stalls, so the default is to divide, evolve and compose: local
groups of missed scenarios get specialists of their own, and branching nodes, trained by gradient,
send each scenario to a member that solves it. `grow` is the paper's own way.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.data import Dataset
from cgtorch.evolution import EvolutionSettings, Population, join
from cgtorch.graphs import Skill
from cgtorch.improvement.compose import branching_action, compose, fewest_members
from cgtorch.improvement.events import (
    ModelsFitted,
    SkillAccepted,
    Watch,
    WorldTested,
)
from cgtorch.improvement.gate import train_branches
from cgtorch.improvement.knowledge import Knowledge, imagine, learn
from cgtorch.improvement.specialists import Budget, evolve_candidate, local_group
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.world import Scenarios, TabletopWorld, concatenate_scenarios


@dataclass(frozen=True)
class Setup:
    """What improvement works with and never changes.

    Attributes:
        actions: the primitive actions.
        world_of: makes the world of given scenarios.
        footprint: (4,) of the base (m).
        evolution: settings of each evolution.
        budget: when each evolution ends.
        attempts: the most evolutions in one stage.
        group: scenarios a specialist is evolved on.
        replicas: how often each of them, with different errors of Γ.
        trials: runs in the world, with different noise, that a member must all pass to count as
            solving a scenario.
        max_transitions: of every skill.
        device: where populations are evaluated.
    """

    actions: ActionSet
    world_of: Callable[[Scenarios], TabletopWorld]
    footprint: Tensor
    evolution: EvolutionSettings = field(default_factory=EvolutionSettings)
    budget: Budget = field(default_factory=Budget)
    attempts: int = 24
    group: int = 12
    replicas: int = 2
    trials: int = 3
    max_transitions: int = 20
    device: torch.device | str = "cpu"


@dataclass(frozen=True)
class Progress:
    """What one stage hands on to the next.

    Attributes:
        skill: the last accepted skill, None before the first.
        solved: W, what it succeeds on in the world.
        missed: M, what it was tried on and failed.
        knowledge: experience and models.
        specialists: graphs evolved so far, seeds of later populations; None before the first.
    """

    skill: Skill | None
    solved: Scenarios
    missed: Scenarios
    knowledge: Knowledge
    specialists: Population | None = None


@dataclass(frozen=True)
class Team:
    """Skills that a composed skill may branch to, and what each does in the world.

    Attributes:
        members: M skills, the earlier skill first if there is one.
        rates: (B, M) share of runs in the world that succeed.
        population: the specialists' graphs; None while there is none.
        knowledge: experience and models, with what the members' runs have taught.
        hints: a candidate that held in the models only, to go on from; None if there is none.
    """

    members: tuple[Skill, ...]
    rates: Tensor
    population: Population | None
    knowledge: Knowledge
    hints: Population | None = None


@dataclass(frozen=True)
class Task:
    """What a stage is about.

    Attributes:
        stage: name of the new skill.
        scenarios: B of them, W first.
        targets: (B,) bool, the stage's own test placements.
        size_w: how many are W.
        percepts: (B, D) what the robot first sees in each.
    """

    stage: str
    scenarios: Scenarios
    targets: Tensor
    size_w: int
    percepts: Tensor

    @property
    def keep(self) -> Tensor:
        """(B,) bool, W."""
        return torch.arange(len(self.scenarios)) < self.size_w


def improve(
    setup: Setup,
    progress: Progress,
    stage: str,
    scenarios: Scenarios,
    targets: Tensor,
    generator: Generator,
    watch: Watch,
) -> Progress:
    """Divide, evolve and compose until nothing of `scenarios` is missed or the attempts end.

    Args:
        setup: what to work with.
        progress: where the earlier stages ended.
        stage: name of the new skill.
        scenarios: what the new skill shall solve.
        targets: their bool mask of the stage's own test placements.
        generator: of all random choices.
        watch: told what happens.

    Returns:
        The new skill with what it solves and misses; the old one where eq. 1 could not be met.
    """
    began = time.perf_counter()
    task = make_task(setup, progress, stage, scenarios, targets)
    team = _team(setup, progress, task)
    for attempt in range(setup.attempts):
        missed = (team.rates < 1).all(1) & ~task.keep
        if not missed.any():
            break
        team = recruit(setup, team, task, f"{stage}.{attempt + 1}", missed, generator, watch)
    composed = compose_team(setup, team, task, progress.skill is not None, generator, watch)
    if composed is None:
        return replace(progress, knowledge=team.knowledge, specialists=team.population)
    skill, succeeded = composed
    seconds = time.perf_counter() - began
    watch(
        SkillAccepted(stage, skill, task.scenarios, succeeded, task.targets, task.size_w, seconds)
    )
    return Progress(
        skill=skill,
        solved=task.scenarios[succeeded.nonzero()[:, 0]],
        missed=task.scenarios[(~succeeded).nonzero()[:, 0]],
        knowledge=team.knowledge,
        specialists=team.population,
    )


def make_task(
    setup: Setup, progress: Progress, stage: str, scenarios: Scenarios, targets: Tensor
) -> Task:
    """W and the scenarios of a stage, with what the robot first sees in each."""
    size_w = len(progress.solved)
    everything = concatenate_scenarios([progress.solved, scenarios])
    mask = torch.cat([torch.zeros(size_w, dtype=torch.bool), targets])
    return Task(stage, everything, mask, size_w, first_percepts(setup.world_of(everything)))


def _team(setup: Setup, progress: Progress, task: Task) -> Team:
    """The earlier skill, or nobody."""
    if progress.skill is None:
        rates = torch.zeros(len(task.scenarios), 0)
        return Team((), rates, progress.specialists, progress.knowledge)
    rate, _ = try_often(setup, progress.skill, task.scenarios)
    return Team((progress.skill,), rate[:, None], progress.specialists, progress.knowledge)


def with_noise(scenarios: Scenarios, copy: int) -> Scenarios:
    """The same placements met by other noise; copy 0 is the scenarios themselves."""
    return replace(scenarios, seed=(scenarios.seed + copy * 0x9E3779B1) % 2**31)


def try_often(setup: Setup, skill: Skill, scenarios: Scenarios) -> tuple[Tensor, Dataset]:
    """(B,) share of `setup.trials` runs in the world that succeed, and what was experienced."""
    trials = [
        try_skill(skill, setup.world_of(with_noise(scenarios, i))) for i in range(setup.trials)
    ]
    experience = trials[0].experience
    for trial in trials[1:]:
        experience = experience.extended(trial.experience)
    return torch.stack([t.succeeded for t in trials]).float().mean(0), experience


def recruit(
    setup: Setup,
    team: Team,
    task: Task,
    name: str,
    missed: Tensor,
    generator: Generator,
    watch: Watch,
) -> Team:
    """Evolve one specialist on a local group of what is `missed` (B,), and try it in the world.

    It joins the team if it solves anything that nobody does. Where the world does not keep what
    the models promised, Γ and C learn from it, and the next search goes on from there.
    """
    group = local_group(task.percepts, missed, setup.group, generator)
    percepts = task.percepts[group]
    environment = imagine(
        team.knowledge, percepts, setup.footprint, setup.replicas, generator, setup.device
    )
    champion, solved = evolve_candidate(
        environment,
        setup.actions,
        setup.evolution,
        setup.budget,
        generator,
        watch,
        task.stage,
        name,
        seeds=team.hints or team.population,
        max_transitions=setup.max_transitions,
        device=setup.device,
    )
    member = Skill(name, champion.graphs, setup.actions, setup.max_transitions)
    rate, experience = try_often(setup, member, task.scenarios)
    promised = solved.view(len(group), -1).all(1)
    watch(world_tested(task, name, rate == 1, int((rate[group] == 1).sum()), int(promised.sum())))
    if (rate[missed] == 1).any():
        population = join(team.population, champion) if team.population else champion
        rates = torch.cat([team.rates, rate[:, None]], 1)
        team = replace(team, members=(*team.members, member), rates=rates, population=population)
    team = replace(team, hints=None)
    if (rate[group] < 1).any():
        began = time.perf_counter()
        knowledge = learn(team.knowledge, experience, generator)
        watch(ModelsFitted(task.stage, knowledge, time.perf_counter() - began))
        hints = join(champion, team.population) if team.population else champion
        team = replace(team, knowledge=knowledge, hints=hints)
    return team


def compose_team(
    setup: Setup,
    team: Team,
    task: Task,
    has_earlier: bool,
    generator: Generator,
    watch: Watch,
    tries: int = 3,
) -> tuple[Skill, Tensor] | None:
    """The smallest team that solves what all of it solve, under trained branches.

    Returns:
        The skill and (B,) bool what it solves in the world on the recorded noise, or None if in
        no try it solves all of W and at least one other scenario (eq. 1).
    """
    if not team.members:
        return None
    stay = torch.zeros(len(team.members), dtype=torch.bool)
    stay[0] = has_earlier
    chosen = fewest_members(team.rates == 1, stay)
    # The earlier skill comes last: it gets what no specialist takes.
    order = sorted(chosen, key=lambda i: (i == 0 and has_earlier, i))
    members, rates = [team.members[i] for i in order], team.rates[:, order]
    _, branch = branching_action(setup.actions)
    weight = torch.where(task.keep | task.targets, 3.0, 1.0)
    for _ in range(tries):
        parameters, _ = train_branches(branch, task.percepts, rates, weight, generator)
        skill = compose(task.stage, members, parameters, setup.actions, setup.max_transitions)
        succeeded = try_skill(skill, setup.world_of(task.scenarios)).succeeded
        watch(world_tested(task, task.stage, succeeded))
        if succeeded[: task.size_w].all() and succeeded[task.size_w :].any():
            return skill, succeeded
        weight = torch.where(succeeded, weight, 3 * weight)
    return None


def world_tested(
    task: Task,
    name: str,
    succeeded: Tensor,
    kept: int | None = None,
    promised: int | None = None,
) -> WorldTested:
    """The event for what a candidate `succeeded` (B,) on in the world."""
    w, m = succeeded[: task.size_w], succeeded[task.size_w :]
    return WorldTested(task.stage, name, int(w.sum()), len(w), int(m.sum()), len(m), kept, promised)
