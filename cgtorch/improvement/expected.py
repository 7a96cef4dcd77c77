"""Improving what a skill is worth in the mean, where rewards are given or success is chance.

There a skill that was good on some scenarios may have been lucky, and no scenario that was solved
once is a fact that later skills have to keep. So there is no W, and

1. all individuals of a generation meet the same fresh scenarios. How many follows from how
   reliably they tell individuals apart (`cgtorch.improvement.spread`);
2. a challenger becomes the holder, the skill of the stage, if it wins a paired race on further
   fresh scenarios (`cgtorch.improvement.paired_race`);
3. most actions tune parameters with ever more scenarios (`cgtorch.improvement.tuning`): the
   holder's, and those of its rivals (`cgtorch.improvement.rivals`), which are the best individuals
   of a generation. What is tuned is evaluated again among the individuals of each generation, and
   has children there. Where steps are what costs, most updates play truncated episodes
   (`cgtorch.improvement.horizon`), and the latest means may decide in place of a race.
"""

import time
from contextlib import suppress
from dataclasses import replace
from math import inf
from typing import Any

import torch
from torch import Generator

from cgtorch.evolution import (
    EvolutionState,
    Generation,
    Population,
    evolve,
)
from cgtorch.evolution.population import initial_strategy
from cgtorch.evolution.search import derived_generator
from cgtorch.graphs import Skill
from cgtorch.ground.asked import BudgetSpentError
from cgtorch.ground.environment import Environment
from cgtorch.improvement.checkpoint import Found, checkpoint_of, found_from, islands_from
from cgtorch.improvement.events import (
    EvolutionRecalled,
    GenerationDone,
    MeanTested,
    S,
    SkillAccepted,
    solved_of,
)
from cgtorch.improvement.expected_state import State, state_from_tensors, tensors_of_state
from cgtorch.improvement.mean_search import MeanSearch
from cgtorch.improvement.pace import pace_of
from cgtorch.improvement.paired_race import Fresh, Holder
from cgtorch.improvement.setup import Draw, Progress, Setup
from cgtorch.improvement.trial import try_skill


def improve_expected(
    setup: Setup[S], progress: Progress[S], tests: S, draw: Draw[S]
) -> Progress[S]:
    """Evolve on fresh scenarios until the mean reaches `Budget.satisfied`, or the limits.

    Args:
        setup: The inputs of the stage, whose limit are `attempts` times `Budget.generations`
            generations.
        progress: The result of earlier stages; W and M stay as they are.
        tests: The stage's own test scenarios, on which the result is tried at the end.
        draw: Draws fresh scenarios.

    Returns:
        The best skill, as a seed of later populations, too.
    """
    seed = int(torch.randint(2**62, (1,), generator=setup.generator))
    own = Generator().manual_seed(seed)

    def world(count: int, generator: Generator) -> Environment:
        return setup.world_of(draw(count, generator))

    def environment(number: int) -> Environment:
        return world(state.need.scenarios, derived_generator(own, 2 * number + 1))

    pace = pace_of(world(1, derived_generator(own, 0)))
    fresh = Fresh(world, setup.max_transitions, pace)
    search = MeanSearch(setup, fresh)
    state, islands = _recalled(search, progress)
    limit, first = setup.attempts * setup.budget.generations, time.perf_counter()
    began = first
    how: Any = {"seeds": progress.specialists, "islands": islands}
    about = environment, setup.actions, search.structures, setup.generator
    how |= {"guests": lambda: search.guests(state), "max_transitions": setup.max_transitions}
    with suppress(BudgetSpentError):  # when the time is over
        for generation in evolve(*about, **how):
            _record(setup, progress, state, generation)
            before, generator = state.holder, derived_generator(own, 2 * generation.number + 2)
            certain, over = False, True
            with suppress(BudgetSpentError):  # so that the generation is told in any case
                for state in search.after(state, generation, generator):  # noqa: B020  it follows
                    _tell(setup, state, before)
                    before = state.holder
                    if setup.purse.late():
                        break
                else:
                    state, certain = search.certain(state, generator)
                    over = setup.purse.late()
            now = time.perf_counter()
            counts = solved_of(generation.succeeded, torch.zeros_like(generation.succeeded))
            done = generation, limit, now - began
            began = now
            setup.watch(GenerationDone(setup.name, setup.name, *counts, *done))
            _tell(setup, state, before)
            if certain or over or state.spent.generations >= limit:
                break
    spent, kept = state.spent, setup.kept
    skill = None if state.holder is None else state.holder.skill
    if kept is not None and kept.ahead_of(spent.generations, spent.episodes):
        skill = kept.skill
    if skill is None:
        return progress
    setup.purse.settled = True
    _report(setup, progress, skill, tests, time.perf_counter() - first)
    usual = skill.actions is setup.actions
    seeds = Population(skill.graph, initial_strategy(1)) if usual else progress.specialists
    return replace(progress, skill=skill, specialists=seeds)


def _step(setup: Setup[Any]) -> str:
    """The name of the search in the journal."""
    return f"means of {setup.name}"


def _recalled(
    search: MeanSearch, progress: Progress[Any]
) -> tuple[State, list[EvolutionState] | None]:
    """The first state, or that of a checkpoint with its islands."""
    setup, given = search.setup, progress.skill
    checkpoint = setup.journal.recall_checkpoint(_step(setup))
    if checkpoint is None:
        return search.first_state(None if given is None else Holder(given)), None
    about, count = checkpoint.about, setup.evolution.islands
    found = found_from(about, setup.actions, 0)
    setup.watch(EvolutionRecalled(setup.name, setup.name, found))
    like = Skill(setup.name, found.champion.graphs, setup.actions, setup.max_transitions)
    state = state_from_tensors(about, setup.actions, like, given)
    return state, islands_from(checkpoint, setup.actions, setup.generator, count)


def _record(
    setup: Setup[Any], progress: Progress[Any], state: State, generation: Generation
) -> None:
    """Record a checkpoint from which the generation is evaluated again."""
    champion, spent, nothing = generation.champion, state.spent, torch.empty(0, dtype=torch.bool)
    counts = 0, spent.generations, spent.transitions
    checkpoint = checkpoint_of(
        Found(champion, nothing, -inf, *counts), generation.islands, setup.evolution.islands
    )
    about = {**checkpoint.about, **tensors_of_state(state, progress.skill)}
    setup.journal.record_checkpoint(_step(setup), replace(checkpoint, about=about))


def _report(setup: Setup[S], before: Progress[S], skill: Skill, tests: S, seconds: float) -> None:
    """Report another skill than before, with its result on the stage's tests."""
    if skill is before.skill:
        return
    succeeded = torch.empty(0, dtype=torch.bool)
    if len(tests):
        succeeded = try_skill(skill, setup.world_of(tests)).succeeded
    keep, targets = torch.zeros_like(succeeded), torch.ones_like(succeeded)
    parent = None if before.skill is None else before.skill.name
    about = tests, succeeded, keep, targets, seconds, None, parent
    setup.watch(SkillAccepted(setup.name, skill, *about))


def _tell(setup: Setup[Any], state: State, before: Holder | None) -> None:
    """Report the mean of the holder, if it is another one or its mean is better known."""
    holder = state.holder
    if holder is None or not holder.count or holder == before:
        return
    new = before is None or before.skill is not holder.skill
    mean, error = (x if abs(x) < inf else None for x in (holder.mean, holder.error))
    about = mean, error, holder.count, state.need.scenarios, state.spent.episodes
    setup.watch(MeanTested(setup.name, holder.skill, new, *about))
