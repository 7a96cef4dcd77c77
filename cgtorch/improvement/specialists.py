"""Specialists: small graphs evolved on a group of missed scenarios, without W as a constraint."""

import time
from dataclasses import astuple, replace
from math import inf
from typing import Any

import torch
from torch import Tensor

from cgtorch.evolution import (
    Fitness,
    Population,
    chance_of_success,
    evaluator,
    evolve,
    join,
)
from cgtorch.evolution.ask_and_tell import restore
from cgtorch.evolution.population import random_population, slim
from cgtorch.graphs import ActionSet, Graphs, pruned
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import LATE, NOTHING, Asked, BudgetSpentError
from cgtorch.ground.environment import Environment, asked_of
from cgtorch.improvement.checkpoint import (
    Found,
    checkpoint_of,
    found_from,
    found_tensors,
    islands_from,
)
from cgtorch.improvement.events import (
    EvolutionRecalled,
    GenerationDone,
    S,
    WorldAsked,
    solved_of,
)
from cgtorch.improvement.setup import Models, Setup

READABLE = 10  # nodes that a picture shows at a glance


def specialist(
    setup: Setup[S],
    name: str,
    models: Models,
    scenarios: S,
    percepts: Tensor,
    seeds: Population | None,
) -> tuple[Population, Tensor]:
    """The best individual on scenarios with first percepts (R, D), as small as it can be.

    If it solves all of a group, or has a fitness of `Budget.satisfied`, it goes on on twice as
    many. This detects chance successes on a few, while most of the search runs on a few. Returned
    is also what it solves (r,) of the largest group, which are the first r scenarios.
    """
    step, size = name, len(percepts)
    if setup.widest > setup.group:
        size = min(setup.group, size)
    while True:
        more = 0 if setup.remembers else setup.replicas * setup.group // size
        about = models, scenarios[:size], percepts[:size], max(setup.replicas, more)
        environment = setup.imagine(*about, setup.generator, setup.device)
        found = _searched(setup, step, environment, seeds)
        well = bool(found.solved.all()) or found.best >= setup.budget.satisfied
        if size >= len(percepts) or not well:
            break
        size, seeds = min(2 * size, len(percepts)), found.champion
        step = f"{name} on {size}"
    how = setup.max_transitions, setup.budget.least, setup.evolution.fitness, setup.device
    before = asked_of(environment)
    small = shrunk(found.champion, setup.actions, environment, *how)
    _counted(setup, replace(found, asked=_of_all_ranks(asked_of(environment) - before)))
    return small, found.solved


def _searched(
    setup: Setup[Any], name: str, environment: Environment, seeds: Population | None
) -> Found:
    """The best result of some evolutions from seeds, half of them new where rollouts take time.

    There, seeds are earlier skills, the last one first, which few new individuals are like.
    """
    if not setup.remembers or seeds is None:
        return best_of_searches(setup, name, environment, seeds)
    evolution = setup.evolution
    half, sizes = evolution.population // 2, (evolution.capacity, evolution.initial_nodes)
    about = setup.actions, *sizes, setup.generator, evolution.strategy
    seeds = seeds[torch.arange(len(seeds)).flip(0)[: half // 2]]
    mixed = join(seeds, random_population(half - len(seeds), *about))
    return best_of_searches(setup, name, environment, slim(mixed))


def best_of_searches(
    setup: Setup[Any], name: str, environment: Environment, seeds: Population | None
) -> Found:
    """The best result of some evolutions, up to one that solves everything.

    Every second one begins without `seeds`, which may have led the first to where it got stuck.
    """
    best = evolve_candidate(setup, name, environment, seeds=seeds)
    for number in range(2, setup.searches + 1):
        if best.solved.all() or best.best >= setup.budget.satisfied:
            return best
        start = None if number % 2 == 0 else seeds
        found = evolve_candidate(setup, f"{name} search {number}", environment, seeds=start)
        best = max(best, found, key=lambda each: each.best)
    return best


def evolve_candidate(
    setup: Setup[Any],
    name: str,
    environment: Environment,
    *,
    keep: Tensor | None = None,
    seeds: Population | None = None,
) -> Found:
    """Evolve until all scenarios are solved in the environment and the fitness has settled.

    The environment of B scenarios runs on the setup's device. For `keep` (B,) bool and `seeds` see
    `cgtorch.evolution.evolve`. Results in the journal are not computed again. BudgetSpentError if
    the time is over before.
    """
    generator, step = setup.generator, f"evolution {name}"
    settings, journal = setup.evolution, setup.journal
    keep = torch.zeros(environment.num_scenarios, dtype=torch.bool) if keep is None else keep
    found, islands = None, None
    if known := journal.recall(step):
        found = found_from(known, setup.actions, len(keep))
        setup.watch(EvolutionRecalled(setup.name, name, found))
        restore(generator, known)
        return _counted(setup, found, recalled=True)
    if checkpoint := journal.recall_checkpoint(step):
        found = found_from(checkpoint.about, setup.actions, len(keep))
        islands = islands_from(checkpoint, setup.actions, generator, settings.islands)
        setup.watch(EvolutionRecalled(setup.name, name, found))
    began = time.perf_counter()
    before = asked_of(environment)
    for generation in evolve(
        environment,
        setup.actions,
        settings,
        generator,
        keep=keep.to(setup.device),
        seeds=seeds,
        islands=islands,
        max_transitions=setup.max_transitions,
    ):
        found = found or Found(generation.champion, keep, -inf)
        checkpoint = checkpoint_of(found, generation.islands, settings.islands)
        journal.record_checkpoint(step, checkpoint)
        seconds, counts = time.perf_counter() - began, solved_of(generation.succeeded, keep)
        done = generation, setup.budget.generations, seconds
        setup.watch(GenerationDone(setup.name, name, *counts, *done))
        now = asked_of(environment)
        asked = _of_all_ranks(now - before)
        found = found.after(generation, seconds, setup.budget.least, asked)
        began += seconds
        before = now
        if setup.budget.ends(found) or setup.purse.late():
            break
    assert found is not None  # noqa: S101  the loop body has run
    # Where the first island is not held, its random numbers have not been drawn.
    generator.set_state(ranks.broadcast(generator.get_state()))
    counted = _counted(setup, found)
    if setup.purse.late():  # so it is not finished
        raise BudgetSpentError(LATE)
    journal.record(step, {**found_tensors(found), "generator": generator.get_state()})
    return counted


def _of_all_ranks(asked: Asked) -> Asked:
    """The sum over all ranks, of which each has simulated some individuals."""
    return Asked(*(ranks.all_reduce(n) for n in astuple(asked)))


def _counted(setup: Setup[Any], found: Found, recalled: bool = False) -> Found:
    """The result, of which the low-level steps are counted and reported."""
    if found.asked != NOTHING:
        setup.purse.add("search", found.asked)
        setup.watch(WorldAsked(setup.name, "search", found.asked, recalled=recalled))
    return found


def shrunk(
    champion: Population,
    actions: ActionSet,
    environment: Environment,
    max_transitions: int,
    slack: float,
    fitness: Fitness = chance_of_success,
    device: torch.device | str = "cpu",
) -> Population:
    """The individual with nodes removed until it is readable, as long as it does not get worse.

    For every pair of nodes, all edges into one are led to the other in the models, all pairs at
    once. Among those that still solve all scenarios, the one with the fewest nodes is taken, and so
    on. Its fitness may be less by the slack. The champion is a population of one. The environment,
    on `device`, contains its scenarios. For the rest see `cgtorch.evolution.evaluator`.
    """
    if int(champion.graphs.num_nodes) <= READABLE:
        return champion
    nothing = torch.zeros(environment.num_scenarios, dtype=torch.bool, device=device)
    evaluation = evaluator(actions, environment, nothing, max_transitions, fitness=fitness)

    def tried(graphs: Graphs) -> tuple[Tensor, Tensor]:
        result = evaluation(graphs)
        return result.fitness, result.succeeded

    before, solved = tried(champion.graphs)
    while int(champion.graphs.num_nodes) > READABLE:
        smaller = _without_each(champion.graphs)
        fitnesses, succeeded = tried(smaller)
        well = (fitnesses >= before - slack) & (succeeded | ~solved).all(1)
        if not well.any():
            break
        nodes = smaller.num_nodes.masked_fill(~well, champion.graphs.capacity)
        best = nodes == nodes.amin()
        index = int(fitnesses.masked_fill(~best, -torch.inf).argmax())
        champion = replace(champion, graphs=smaller[index : index + 1])
    return champion


def _without_each(graphs: Graphs) -> Graphs:
    """One graph with n nodes as n (n - 1) graphs: edges into node i lead to node j instead."""
    used = graphs.used[0].nonzero()[:, 0]
    gone, to = (x.flatten() for x in torch.meshgrid(used, used, indexing="ij"))
    gone, to = gone[gone != to], to[gone != to]
    many = graphs[torch.zeros_like(gone)]
    edges = torch.where(many.edges == gone[:, None, None], to[:, None, None], many.edges)
    start = torch.where(many.start == gone, to, many.start)
    return pruned(replace(many, edges=edges, start=start))
