"""Improving what a skill returns with few steps in the world; the rest is imagined.

1. First percepts of some episodes are looked at, and short episodes of random controls are played.
   A transition model Γ, rewards and ends of episodes are learned from these steps.
2. Graphs are evolved for the best mean in imagined episodes (`cgtorch.improvement.expected`), with
   other starts and errors of Γ in each generation.
3. Once the best is surely good enough there, it is played once in the world, and the models learn
   from that. It is offered if this episode is good enough, or if the world gives what was imagined
   for it, and if it still is good enough. What an offer is worth is decided by fresh episodes after
   the stage. If that is too little, the next round is more careful.
4. Where the search makes no progress for some generations, or where no reward so far can add up to
   what is wanted, the champion is played if models would learn from it, and else a graph that is
   evolved to come to where Γ is unsure (an exploration bonus), if there is one.

This is what PILCO does with policies of one structure (Deisenroth and Rasmussen, ICML 2011).
"""

import time
from contextlib import suppress
from dataclasses import replace
from math import inf
from typing import Any

import torch
from torch import Generator

from cgtorch.evolution import EvolutionState, Generation, Population, evolve, initial_state
from cgtorch.evolution.population import initial_strategy
from cgtorch.evolution.search import derived_generator
from cgtorch.graphs import Graphs, Skill
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import BudgetSpentError
from cgtorch.ground.environment import Environment
from cgtorch.improvement.checkpoint import Found, checkpoint_of, found_from, islands_from
from cgtorch.improvement.events import (
    EvolutionRecalled,
    GenerationDone,
    S,
    SkillAccepted,
    solved_of,
)
from cgtorch.improvement.imagined_search import HORIZON, Search
from cgtorch.improvement.imagined_state import (
    Models,
    State,
    state_from_tensors,
    tensors_of_state,
)
from cgtorch.improvement.paired_race import Holder
from cgtorch.improvement.setup import Draw, Progress, Setup
from cgtorch.improvement.trial import try_skill

BEGIN = 2**40  # the number of the generator of what happens before the first generation


def improve_imagined(
    setup: Setup[S], progress: Progress[S], tests: S, draw: Draw[S], models: Models
) -> Progress[S]:
    """Evolve in imagined episodes until a skill is good in the world, or until the limits.

    Args:
        setup: The inputs of the stage, whose limit are `attempts` times `Budget.generations`
            generations. `Budget.satisfied` is the mean return to reach.
        progress: The result of earlier rounds; its knowledge is what is known of the world.
        tests: The stage's own test scenarios, on which the result is tried at the end.
        draw: Draws fresh scenarios.
        models: How the world becomes known.

    Returns:
        The skill that is offered, else the best one, and all that is known.
    """
    seed = int(torch.randint(2**62, (1,), generator=setup.generator))
    own, search = Generator().manual_seed(seed), Search(setup, models, draw)

    def environment(number: int) -> Environment:
        generator = derived_generator(own, 2 * state.generations + 1)
        return state.known.world(state.inner.need.scenarios, HORIZON, generator)

    limit, first = setup.attempts * setup.budget.generations, time.perf_counter()
    began, offered = first, False
    try:
        state, islands = _recalled(search, progress, derived_generator(own, BEGIN))
    except BudgetSpentError:  # before anything is known
        return progress
    inner = search.in_models(state.known)
    about = environment, setup.actions, inner.structures, setup.generator
    how: Any = {
        "guests": lambda: inner.guests(state.inner), "max_transitions": setup.max_transitions,
    }  # fmt: skip
    generations = evolve(*about, islands=islands, **how)
    with suppress(BudgetSpentError):  # when the time or the budget is over
        while not (offered or state.generations >= limit or setup.purse.late()):
            generation = next(generations)
            _record(setup, progress, state, generation)
            generator = derived_generator(own, 2 * state.generations + 2)
            over = True
            with suppress(BudgetSpentError):  # so that the generation is told in any case
                state, offered = search.after(state, generation, generator)
                over = False
            now = time.perf_counter()
            counts = solved_of(generation.succeeded, torch.zeros_like(generation.succeeded))
            done = generation, limit, now - began
            began = now
            setup.watch(GenerationDone(setup.name, setup.name, *counts, *done))
            if over:
                break
            if state.seed is not None:
                islands = _founded(setup, _alone(state.seed), state.generations)
                generations = evolve(*about, islands=islands, **how)
                state = replace(state, seed=None)
    setup.purse.settled = True  # so that no alarm breaks off what is told
    skill = state.skill
    if skill is None and state.inner.holder is not None:
        skill = state.inner.holder.skill
    if not offered and setup.kept is not None and setup.kept.ahead_of(state.generations):
        skill = setup.kept.skill
    known = state.known.refused() if offered else state.known  # or there is no next round
    return _ended(setup, replace(progress, knowledge=known), skill, tests, first)


def _ended(
    setup: Setup[S], progress: Progress[S], skill: Skill | None, tests: S, first: float
) -> Progress[S]:
    """The progress with the skill of the stage, which is reported with its result on the tests."""
    if skill is None or skill is progress.skill:
        return progress
    succeeded = torch.empty(0, dtype=torch.bool)
    if len(tests):
        succeeded = try_skill(skill, setup.world_of(tests)).succeeded
    keep, targets = torch.zeros_like(succeeded), torch.ones_like(succeeded)
    parent = None if progress.skill is None else progress.skill.name
    about = tests, succeeded, keep, targets, time.perf_counter() - first, None, parent
    setup.watch(SkillAccepted(setup.name, skill, *about))
    return replace(progress, skill=skill, specialists=_alone(skill.graph))


def _alone(graphs: Graphs) -> Population:
    return Population(graphs, initial_strategy(1))


def _founded(setup: Setup[Any], seeds: Population | None, number: int) -> list[EvolutionState]:
    """The islands that this rank holds, of which the first generation has this number."""
    count, actions = setup.evolution.islands, setup.actions
    own = [derived_generator(setup.generator, island) for island in ranks.held(count)]
    states = [initial_state(setup.evolution, actions, each, seeds) for each in own]
    return [replace(each, generation=number) for each in states]


def _step(setup: Setup[Any]) -> str:
    """The name of the search in the journal."""
    return f"imagined episodes of {setup.name}"


def _recalled(
    search: Search, progress: Progress[Any], generator: Generator
) -> tuple[State, list[EvolutionState]]:
    """The first state, or that of a checkpoint, with its islands."""
    setup, known = search.setup, progress.knowledge
    checkpoint = setup.journal.recall_checkpoint(_step(setup))
    if checkpoint is None:
        state = search.begun(generator) if known is None else search.first_state(known)
        if (skill := progress.skill) is not None:
            state = replace(state, inner=replace(state.inner, holder=Holder(skill)))
        return state, _founded(setup, progress.specialists, 0)
    about, count = checkpoint.about, setup.evolution.islands
    found = found_from(about, setup.actions, 0)
    setup.watch(EvolutionRecalled(setup.name, setup.name, found))
    like = Skill(setup.name, found.champion.graphs, setup.actions, setup.max_transitions)
    state = state_from_tensors(about, search.models, setup.actions, like, progress.skill)
    for phase, asked in state.asked.items():
        setup.purse.add(phase, asked)
    return state, islands_from(checkpoint, setup.actions, setup.generator, count)


def _record(
    setup: Setup[Any], progress: Progress[Any], state: State, generation: Generation
) -> None:
    """Record a checkpoint from which the generation is evaluated again."""
    champion, nothing = generation.champion, torch.empty(0, dtype=torch.bool)
    counts = 0, state.generations, state.inner.spent.transitions
    checkpoint = checkpoint_of(
        Found(champion, nothing, -inf, *counts), generation.islands, setup.evolution.islands
    )
    about = {**checkpoint.about, **tensors_of_state(state, progress.skill)}
    setup.journal.record_checkpoint(_step(setup), replace(checkpoint, about=about))
