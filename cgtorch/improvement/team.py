"""The team of skills that a composed skill branches to: recruiting and composing members."""

import time
from dataclasses import dataclass, replace
from typing import Any, Generic

import torch
from torch import Tensor

from cgtorch.environment import Dataset, Environment
from cgtorch.environment.dry_run import check_environment
from cgtorch.evolution import Population, join
from cgtorch.graphs import Skill, merged
from cgtorch.improvement.compose import branching_action, compose, fewest_members
from cgtorch.improvement.events import ModelsFitted, WorldTested, solved_of
from cgtorch.improvement.gating import train_gating
from cgtorch.improvement.interfaces import Models, S
from cgtorch.improvement.setup import Progress, Setup, Stage
from cgtorch.improvement.shrink import shrunk
from cgtorch.improvement.specialists import evolve_candidate
from cgtorch.improvement.stopping import Found
from cgtorch.improvement.trial import attempt, first_percepts

FEW = 8  # members of a team: 15 nodes with the branches to them
TRIES = 3  # of training the branches of one team


@dataclass(frozen=True)
class StageState(Generic[S]):
    """The state of a stage: its scenarios, and the team of skills that should solve them.

    Attributes:
        scenarios: B scenarios.
        keep: (B,) bool, W: the scenarios that must not be lost.
        targets: (B,) bool, the stage's own test scenarios.
        percepts: (B, D) first percepts.
        rest: More of W, on which composed skills are tried, but not members.
        knowledge: Data and models, with what was learned from the members' runs.
        members: M skills to branch to; the earlier skill comes first if there is one.
        rates: (B, M) share of their runs in the world that succeed.
        population: The specialists' graphs; None before the first.
        hints: A candidate that succeeded only in the models, as a seed; None if there is none.
        tried: Number of evolutions so far.
    """

    scenarios: S
    keep: Tensor
    targets: Tensor
    percepts: Tensor
    rest: S
    knowledge: Models
    members: tuple[Skill, ...]
    rates: Tensor
    population: Population | None = None
    hints: Population | None = None
    tried: int = 0


def initial_state(
    stage: Stage[S], progress: Progress[S], scenarios: S, targets: Tensor
) -> StageState[S]:
    """The state of a stage without members; WorldError if its world breaks the interface."""
    everything = progress.solved.joined(scenarios)
    keep = torch.arange(len(everything)) < len(progress.solved)
    world = stage.setup.world_of(everything)
    check_environment(world)
    return StageState(
        everything,
        keep,
        torch.cat([torch.zeros(len(progress.solved), dtype=torch.bool), targets]),
        first_percepts(world),
        everything[:0],
        progress.knowledge,
        members=(),
        rates=torch.zeros(len(everything), 0),
        population=progress.specialists,
    )


def with_fresh(setup: Setup[S], state: StageState[S], solved: Tensor, fresh: S) -> StageState[S]:
    """The state with more scenarios; those that are `solved` (B + fresh,) become W."""
    rates = [try_all(setup, member, fresh)[0] for member in state.members]
    return replace(
        state,
        scenarios=state.scenarios.joined(fresh),
        keep=solved,
        targets=torch.cat([state.targets, torch.zeros(len(fresh), dtype=torch.bool)]),
        percepts=torch.cat([state.percepts, first_percepts(setup.world_of(fresh))]),
        rates=torch.cat([state.rates, torch.stack(rates, 1)]),
    )


def try_all(setup: Setup[S], skill: Skill, scenarios: S) -> tuple[Tensor, Dataset]:
    """(B,) share of successful runs, 0 if the first one fails, and the experience of the runs.

    A skill that succeeds is tried again under other noise, `setup.trials` times in all.
    """
    trial = attempt(setup, skill, scenarios)
    rate, experience = trial.succeeded.float(), trial.experience
    rows = trial.succeeded
    for copy in range(1, setup.trials if rows.any() else 1):  # own domains may not know 0 scenarios
        trial = attempt(setup, skill, scenarios[rows].with_noise(copy))
        rate[rows] += trial.succeeded.float()
        experience = experience.extended(trial.experience)
    rate[rows] /= setup.trials
    return rate, experience


def recruit(stage: Stage[S], state: StageState[S], missed: Tensor) -> StageState[S]:
    """Evolve one specialist on a group of `missed` (B,) scenarios, and try it in the world.

    It joins the team if it solves a scenario that no member solves. If it solves less in the world
    than in the models, Γ and C learn from the runs, and the next search starts from it.
    """
    setup, tried = stage.setup, state.tried + 1
    name = f"{stage.name}.{tried}"
    group, champion, solved = _evolved(stage, state, name, missed)
    member = Skill(name, merged(champion.graphs), setup.actions, setup.max_transitions)
    rate, experience = try_all(setup, member, state.scenarios)
    kept, predicted = int((rate[group] == 1).sum()), int(solved.view(len(group), -1).all(1).sum())
    counts = solved_of(rate == 1, state.keep)
    stage.watch(WorldTested(stage.name, name, *counts, kept, predicted, len(group)))
    state = replace(state, hints=None, tried=tried)
    if (rate[missed] == 1).any():
        state = replace(
            state,
            members=(*state.members, member),
            rates=torch.cat([state.rates, rate[:, None]], 1),
            population=join(state.population, champion) if state.population else champion,
        )
    if (rate[group] < 1).any():
        knowledge = learned(stage, state.knowledge, experience)
        hints = join(champion, state.population) if state.population else champion
        state = replace(state, knowledge=knowledge, hints=hints)
    return state


def _evolved(
    stage: Stage[S], state: StageState[S], name: str, missed: Tensor
) -> tuple[Tensor, Population, Tensor]:
    """The scenarios of a specialist, the best individual on them, and what it solves in the models.

    A specialist that is good enough continues on twice as many scenarios, up to `Setup.widest`.
    This detects chance successes on a few, while most of the search runs on a few.
    """
    setup = stage.setup
    rows = setup.group_of(state.percepts, missed, max(setup.group, setup.widest), stage.generator)
    size, seeds = setup.group, state.hints or state.population
    how = setup.max_transitions, setup.evolution.fitness, setup.device
    while True:
        group = rows[:size]
        replicas = max(setup.replicas, setup.replicas * setup.group // len(group))
        about = state.knowledge, state.scenarios[group], state.percepts[group], replicas
        environment = setup.imagine(*about, stage.generator, setup.device)
        step = name if size == setup.group else f"{name} on {size}"
        found = _best_of_searches(stage, step, environment, seeds)
        if size >= len(rows) or found.best < setup.budget.satisfied:
            champion = shrunk(found.champion, setup.actions, environment, *how)
            return group, champion, found.solved
        size, seeds = 2 * size, found.champion


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


def learned(stage: Stage[Any], models: Models, experience: Dataset) -> Models:
    """The models after learning from experience; unchanged if nothing learns."""
    setup = stage.setup
    if setup.learn is None:
        return models
    began = time.perf_counter()
    models = setup.learn(models, experience, stage.generator)
    stage.watch(ModelsFitted(stage.name, setup.describe(models), time.perf_counter() - began))
    return models


def compose_team(
    stage: Stage[S], state: StageState[S], progress: Progress[S]
) -> tuple[Skill, Tensor] | None:
    """The smallest team that solves all that its members solve, and (B,) what it solves.

    If `progress` has members, teams without the earlier skill are tried first, so that skills do
    not nest deeper with every stage. A team of at most `FEW` is tried before all others. The result
    is tried in the world. None if no team with trained branching nodes solves all of W and at least
    one more scenario (eq. 1).
    """
    solves, nobody = state.rates == 1, torch.zeros(len(state.members), dtype=torch.bool)
    teams = []
    if progress.members:
        flat = (fewest_members(solves[:, 1:], nobody[1:], most) for most in (FEW, None))
        teams += [[i + 1 for i in chosen] for chosen in flat]
    if progress.skill is not None:
        # The earlier skill comes last: it gets what no specialist takes.
        first = torch.arange(len(nobody)) == 0
        teams.append([*fewest_members(solves, first)[1:], 0])
    elif state.members:
        teams.append(fewest_members(solves, nobody))
    distinct = [t for i, t in enumerate(teams) if t and t not in teams[:i]]
    made = (_composed(stage, state, chosen) for chosen in distinct)
    return next(filter(None, made), None)


def _composed(
    stage: Stage[S], state: StageState[S], chosen: list[int]
) -> tuple[Skill, Tensor] | None:
    """The `chosen` members in this order under trained branching nodes; see `compose_team`."""
    setup, members = stage.setup, [state.members[i] for i in chosen]
    _, branch = branching_action(setup.actions)
    weight = torch.where(state.keep | state.targets, 3.0, 1.0)
    for _ in range(TRIES):
        parameters, _ = train_gating(
            branch, state.percepts, state.rates[:, chosen], weight, stage.generator
        )
        skill = compose(stage.name, members, parameters, setup.actions, setup.max_transitions)
        succeeded = attempt(setup, skill, state.scenarios).succeeded
        stage.watch(WorldTested(stage.name, stage.name, *solved_of(succeeded, state.keep)))
        if succeeded[state.keep].all() and succeeded[~state.keep].any():
            return skill, succeeded
        weight = torch.where(succeeded, weight, 3 * weight)
    return None
