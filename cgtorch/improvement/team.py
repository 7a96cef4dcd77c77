"""A team of skills that a composed skill branches to: recruiting members, composing them."""

import time
from dataclasses import dataclass, replace
from typing import Any, Generic

import torch
from torch import Generator, Tensor

from cgtorch.environment import Dataset
from cgtorch.environment.dry_run import check_environment
from cgtorch.evolution import Population, join
from cgtorch.graphs import Skill, merged
from cgtorch.improvement.attempt import attempt
from cgtorch.improvement.compose import branching_action, compose, fewest_members
from cgtorch.improvement.events import ModelsFitted, Watch, WorldTested
from cgtorch.improvement.gating import train_branches
from cgtorch.improvement.interfaces import Models, S
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.improvement.shrink import shrunk
from cgtorch.improvement.specialists import evolve_candidate
from cgtorch.improvement.trial import first_percepts

FEW = 8  # members of a team: 15 nodes with the branches to them


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
    knowledge: Models
    hints: Population | None = None


@dataclass(frozen=True)
class Task(Generic[S]):
    """What a stage is about.

    Attributes:
        stage: name of the new skill.
        scenarios: B of them.
        keep: (B,) bool, W: what must not be lost.
        targets: (B,) bool, the stage's own test placements.
        percepts: (B, D) what the robot first sees in each.
    """

    stage: str
    scenarios: S
    keep: Tensor
    targets: Tensor
    percepts: Tensor


def make_task(
    setup: Setup[S], progress: Progress[S], stage: str, scenarios: S, targets: Tensor
) -> Task[S]:
    """W and the scenarios of a stage, with what the robot first sees in each.

    Raises:
        WorldError: the world, tried on two of them, breaks its interface.
    """
    everything = progress.solved.joined(scenarios)
    keep = torch.arange(len(everything)) < len(progress.solved)
    mask = torch.cat([torch.zeros(len(progress.solved), dtype=torch.bool), targets])
    world = setup.world_of(everything)
    check_environment(world)
    return Task(stage, everything, keep, mask, first_percepts(world))


def with_fresh(
    setup: Setup[S], task: Task[S], team: Team, solved: Tensor, fresh: S
) -> tuple[Task[S], Team]:
    """The task and team after more scenarios; what is `solved` (B + fresh,) becomes W."""
    everything = task.scenarios.joined(fresh)
    targets = torch.cat([task.targets, torch.zeros(len(fresh), dtype=torch.bool)])
    percepts = torch.cat([task.percepts, first_percepts(setup.world_of(fresh))])
    rates = [try_all(setup, member, fresh)[0] for member in team.members]
    return (
        Task(task.stage, everything, solved, targets, percepts),
        replace(team, rates=torch.cat([team.rates, torch.stack(rates, 1)])),
    )


def first_team(setup: Setup[S], progress: Progress[S], task: Task[S]) -> Team:
    """The earlier skill and those within it that may be used, or nobody."""
    if progress.skill is None:
        rates = torch.zeros(len(task.scenarios), 0)
        return Team((), rates, progress.specialists, progress.knowledge)
    rate = task.keep.float()  # W is what it succeeds on
    new = (~task.keep).nonzero()[:, 0]
    rate[new], _ = try_all(setup, progress.skill, task.scenarios[new])
    others = [try_all(setup, member, task.scenarios)[0] for member in progress.members]
    members, rates = (progress.skill, *progress.members), torch.stack([rate, *others], 1)
    return Team(members, rates, progress.specialists, progress.knowledge)


def try_all(setup: Setup[S], skill: Skill, scenarios: S) -> tuple[Tensor, Dataset]:
    """How surely a skill solves each scenario, and what was experienced.

    Where it succeeds it is tried again under other noise, `setup.trials` times in all.

    Returns:
        (B,) share of the runs that succeeded, 0 where the first one failed, and the experience.
    """
    trial = attempt(setup, skill, scenarios)
    rate, experience = trial.succeeded.float(), trial.experience
    rows = trial.succeeded.nonzero()[:, 0]
    for copy in range(1, setup.trials):
        trial = attempt(setup, skill, scenarios[rows].with_noise(copy))
        rate[rows] += trial.succeeded.float()
        experience = experience.extended(trial.experience)
    rate[rows] /= setup.trials
    return rate, experience


def recruit(
    setup: Setup[S],
    team: Team,
    task: Task[S],
    name: str,
    missed: Tensor,
    generator: Generator,
    watch: Watch,
) -> Team:
    """Evolve one specialist on a local group of what is `missed` (B,), and try it in the world.

    It joins the team if it solves anything that nobody does. Where the world does not keep what
    the models promised, Γ and C learn from it, and the next search goes on from there.
    """
    group = setup.group_of(task.percepts, missed, setup.group, generator)
    percepts = task.percepts[group]
    replicas = max(setup.replicas, setup.lanes // len(group))
    scenarios = task.scenarios[group]
    environment = setup.imagine(
        team.knowledge, scenarios, percepts, replicas, generator, setup.device
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
        journal=setup.journal,
    )
    champion = shrunk(
        champion,
        setup.actions,
        environment,
        setup.max_transitions,
        setup.evolution.fitness,
        setup.device,
    )
    member = Skill(name, merged(champion.graphs), setup.actions, setup.max_transitions)
    rate, experience = try_all(setup, member, task.scenarios)
    promised = solved.view(len(group), -1).all(1)
    watch(
        replace(
            world_tested(task, name, rate == 1),
            kept=int((rate[group] == 1).sum()),
            promised=int(promised.sum()),
        )
    )
    if (rate[missed] == 1).any():
        population = join(team.population, champion) if team.population else champion
        rates = torch.cat([team.rates, rate[:, None]], 1)
        team = replace(team, members=(*team.members, member), rates=rates, population=population)
    team = replace(team, hints=None)
    if (rate[group] < 1).any():
        knowledge = learned(setup, team.knowledge, experience, task.stage, generator, watch)
        hints = join(champion, team.population) if team.population else champion
        team = replace(team, knowledge=knowledge, hints=hints)
    return team


def learned(
    setup: Setup[S],
    models: Models,
    experience: Dataset,
    stage: str,
    generator: Generator,
    watch: Watch,
) -> Models:
    """The models with what was experienced; as they are where nothing learns."""
    if setup.learn is None:
        return models
    began = time.perf_counter()
    models = setup.learn(models, experience, generator)
    watch(ModelsFitted(stage, setup.describe(models), time.perf_counter() - began))
    return models


def compose_team(
    setup: Setup[S],
    team: Team,
    task: Task[S],
    progress: Progress[S],
    generator: Generator,
    watch: Watch,
) -> tuple[Skill, Tensor] | None:
    """The smallest team that solves what all of it solve, under trained branches.

    Where `progress` has members, teams without the earlier skill are tried first, so that skills
    do not nest deeper with every stage; and first of all one of no more than `FEW`. The world
    decides on each, as on any other, by all of W.

    Returns:
        The skill and (B,) bool what it solves in the world on the recorded noise, or None if in
        no try it solves all of W and at least one other scenario (eq. 1).
    """
    solves, nobody = team.rates == 1, torch.zeros(len(team.members), dtype=torch.bool)
    teams = []
    if progress.members:
        flat = (fewest_members(solves[:, 1:], nobody[1:], most) for most in (FEW, None))
        teams += [[i + 1 for i in chosen] for chosen in flat]
    if progress.skill is not None:
        # The earlier skill comes last: it gets what no specialist takes.
        first = torch.arange(len(nobody)) == 0
        teams.append([*fewest_members(solves, first)[1:], 0])
    elif team.members:
        teams.append(fewest_members(solves, nobody))
    distinct = [t for i, t in enumerate(teams) if t and t not in teams[:i]]
    made = (composed(setup, team, task, chosen, generator, watch) for chosen in distinct)
    return next(filter(None, made), None)


def composed(
    setup: Setup[S],
    team: Team,
    task: Task[S],
    chosen: list[int],
    generator: Generator,
    watch: Watch,
    tries: int = 3,
) -> tuple[Skill, Tensor] | None:
    """The `chosen` members in this order under trained branches; result as `compose_team`."""
    members, rates = [team.members[i] for i in chosen], team.rates[:, chosen]
    _, branch = branching_action(setup.actions)
    weight = torch.where(task.keep | task.targets, 3.0, 1.0)
    for _ in range(tries):
        parameters, _ = train_branches(branch, task.percepts, rates, weight, generator)
        skill = compose(task.stage, members, parameters, setup.actions, setup.max_transitions)
        succeeded = attempt(setup, skill, task.scenarios).succeeded
        watch(world_tested(task, task.stage, succeeded))
        if succeeded[task.keep].all() and succeeded[~task.keep].any():
            return skill, succeeded
        weight = torch.where(succeeded, weight, 3 * weight)
    return None


def world_tested(task: Task[Any], name: str, succeeded: Tensor) -> WorldTested:
    """The event for what a candidate `succeeded` (B,) on in the world."""
    w, m = succeeded[task.keep], succeeded[~task.keep]
    return WorldTested(task.stage, name, int(w.sum()), len(w), int(m.sum()), len(m))
