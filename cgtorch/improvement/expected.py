"""Improving what a skill is worth in the mean, where rewards are given or success is chance.

There a skill that was good on some scenarios may have been lucky, and no scenario that was solved
once is a fact that later skills have to keep. So there is no W, and

1. all individuals of a generation meet the same fresh scenarios. How many follows from how
   reliably they tell individuals apart (`cgtorch.improvement.spread`);
2. a challenger becomes the holder, the skill of the stage, if it wins a paired race on further
   fresh scenarios (`cgtorch.improvement.race`);
3. from the second cycle of structures on, half of all actions tune the holder's parameters
   (`cgtorch.improvement.tuning`), with ever more scenarios, while the other half looks for other
   structures, so that local optima are left.
"""

import time
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import Any

import torch
from torch import Generator

from cgtorch.evolution import EvolutionState, Generation, Population, evolve
from cgtorch.evolution.lineages import tunable
from cgtorch.evolution.population import initial_strategy
from cgtorch.evolution.search import derived_generator
from cgtorch.graphs import Graphs, Skill, compacted, merged
from cgtorch.ground.environment import Environment
from cgtorch.improvement import tuning as tune
from cgtorch.improvement.checkpoint import Found, checkpoint_of, found_from, islands_from
from cgtorch.improvement.events import (
    EvolutionRecalled,
    GenerationDone,
    MeanTested,
    S,
    solved_of,
)
from cgtorch.improvement.expected_state import State, state_from_tensors, tensors_of_state
from cgtorch.improvement.race import Fresh, Holder, best_of, race
from cgtorch.improvement.setup import Draw, Progress, Setup
from cgtorch.improvement.tuning import Tuning

OFTEN = 5  # generations between two nominations
CYCLES = 2  # generations of new structures after which tuning begins
AT_LAST = 8  # the search plays so many times as many episodes as the last choice
GRACE = 3.0  # s that the last choice may take after the end of the time
KNOWN = 16  # values of the holder from which its mean is compared with the target
TRIED, CERTAIN = 100, 2.0  # values with which it has to hold, by so many standard errors


@dataclass(frozen=True)
class Search:
    """The constant parts of a search."""

    setup: Setup[Any]
    fresh: Fresh

    def skill_of(self, graphs: Graphs) -> Skill:
        """The skill of a single graph."""
        setup = self.setup
        return Skill(setup.name, merged(compacted(graphs)), setup.actions, setup.max_transitions)

    def after(self, state: State, generation: Generation, generator: Generator) -> State:
        """The state after a generation was evaluated, its nominees raced, and the holder tuned."""
        spent, lineages = state.spent, generation.islands[0].lineages
        spent = replace(
            spent,
            generations=spent.generations + 1,
            bred=spent.bred + (not lineages),
            transitions=spent.transitions + generation.transitions,
            searched=spent.searched + generation.executed,
            episodes=spent.episodes + generation.scores.numel(),
        )
        if spent.bred < CYCLES:
            spent = replace(spent, tuned=spent.searched)
        state = replace(state, need=state.need.after(generation.scores), spent=spent)
        for graphs in self._nominees(state, generation):
            state, _ = self._raced(state, self.skill_of(graphs), generator)
        while state.holder is not None and state.spent.tuned < state.spent.searched:
            after = self._tuned(state, generator)
            if after is state:
                break
            state = after
        return state

    def _nominees(self, state: State, generation: Generation) -> list[Graphs]:
        """Graphs that may be better than the holder: the champion, and the best lineage's mean."""
        champion = [generation.champion.graphs]
        if generation.number % OFTEN and state.holder is not None:
            return champion if generation.best >= self.setup.budget.satisfied else []
        lineages = generation.islands[0].lineages
        if not lineages:
            return champion
        leader = max(lineages, key=lambda each: each.recent_fitness)
        graph, mean = leader.best.graphs, leader.distribution.mean.float()[None]
        return [
            *champion,
            tune.with_parameters(graph, tunable(graph, self.setup.actions), mean),
        ]

    def _raced(self, state: State, challenger: Skill, generator: Generator) -> tuple[State, bool]:
        """The state after a race, and whether the challenger has won it."""
        if state.holder is None:
            values = self.fresh.of_skills([challenger], KNOWN, generator)
            finite = bool(values.isfinite().all())
            return (state.held_by(Holder(challenger)) if finite else state), finite
        before = self.fresh.episodes
        winner = race(self.fresh, state.holder, challenger, state.longest, generator)
        raced = state.spent.raced + self.fresh.episodes - before
        state = replace(state, spent=replace(state.spent, raced=raced))
        return state.held_by(winner), winner.skill is challenger

    def _tuned(self, state: State, generator: Generator) -> State:
        """The state after an update of the holder's parameters; the same if it has none."""
        holder, tuning, actions = state.holder, state.tuning, self.setup.actions
        assert holder is not None  # noqa: S101
        if tuning is None or holder.skill.graph is not tuning.graph:
            tuning = self._tuning_of(holder.skill, state.need.scenarios)
        if tuning is None:
            return state
        before = self.fresh.executed, self.fresh.episodes
        tuning = tune.update(tuning, actions, self.fresh, generator)
        spent = replace(
            state.spent,
            tuned=state.spent.tuned + self.fresh.executed - before[0],
            episodes=state.spent.episodes + self.fresh.episodes - before[1],
        )
        state = replace(state, tuning=tuning, spent=spent)
        if not tuning.due:
            return state
        mean = replace(holder.skill, name=self.setup.name, graph=tuning.mean(actions))
        state, won = self._raced(state, mean, generator)
        tuning = tuning.raced(won)
        if won and state.holder is not None:
            tuning = replace(tuning, graph=state.holder.skill.graph)
        return replace(state, tuning=tuning.more() if tuning.stalled else tuning)

    def _tuning_of(self, skill: Skill, scenarios: int) -> Tuning | None:
        """The tuning of a skill; None if it has other actions, as a team has, or no parameters."""
        actions = self.setup.actions
        return tune.begun(skill.graph, actions, scenarios) if skill.actions is actions else None

    def certain(self, state: State, generator: Generator) -> tuple[State, bool]:
        """The state with a mean that is known better, and whether it is at least the target."""
        holder, target = state.holder, self.setup.budget.satisfied
        if holder is None or holder.count < KNOWN or holder.mean < target:
            return state, False
        if (missing := TRIED - holder.count) > 0:
            holder = holder.met(self.fresh.of_skills([holder.skill], missing, generator)[0])
        return replace(state, holder=holder), holder.mean - CERTAIN * holder.error >= target


def improve_expected(
    setup: Setup[S], progress: Progress[S], tests: S, draw: Draw[S]
) -> Progress[S]:
    """Evolve on fresh scenarios until the mean reaches `Budget.satisfied`, or the limits.

    Args:
        setup: The inputs of the stage, whose limit are `attempts` times `Budget.generations`
            generations.
        progress: The result of earlier stages; W and M stay as they are.
        tests: The stage's own test scenarios, which have no part in it.
        draw: Draws fresh scenarios.

    Returns:
        The best skill, as a seed of later populations, too.
    """
    seed = int(torch.randint(2**62, (1,), generator=setup.generator))
    own = Generator().manual_seed(seed)

    def world(count: int, generator: Generator) -> Environment:
        return setup.world_of(draw(count, generator))

    search = Search(setup, Fresh(world, setup.max_transitions))
    state, islands = _recalled(setup, progress)
    limit, began = setup.attempts * setup.budget.generations, time.perf_counter()

    def environment(number: int) -> Environment:
        return world(state.need.scenarios, derived_generator(own, 2 * number + 1))

    for generation in evolve(
        environment,
        setup.actions,
        setup.evolution,
        setup.generator,
        seeds=progress.specialists,
        islands=islands,
        max_transitions=setup.max_transitions,
    ):
        _record(setup, progress, state, generation)
        before, generator = state.holder, derived_generator(own, 2 * generation.number + 2)
        state = search.after(state, generation, generator)
        state, certain = search.certain(state, generator)
        now = time.perf_counter()
        counts = solved_of(generation.succeeded, torch.zeros_like(generation.succeeded))
        done = generation, limit, now - began
        began = now
        setup.watch(GenerationDone(setup.name, setup.name, *counts, *done))
        _tell(setup, state, before)
        if certain or state.spent.generations >= limit or setup.purse.late():
            break
    if state.holder is None:
        return progress
    skill, generator = state.holder.skill, derived_generator(own, 2 * limit + 3)
    if not certain and state.earlier:
        every = [skill, *state.earlier]
        episodes, stop = state.spent.episodes // AT_LAST, partial(setup.purse.late, GRACE)
        skill = best_of(search.fresh, every, episodes, generator, stop)
    usual = skill.actions is setup.actions
    seeds = Population(skill.graph, initial_strategy(1)) if usual else progress.specialists
    return replace(progress, skill=skill, specialists=seeds)


def _step(setup: Setup[Any]) -> str:
    """The name of the search in the journal."""
    return f"means of {setup.name}"


def _recalled(
    setup: Setup[Any], progress: Progress[Any]
) -> tuple[State, list[EvolutionState] | None]:
    """The first state, or that of a checkpoint with its islands."""
    given = progress.skill
    checkpoint = setup.journal.recall_checkpoint(_step(setup))
    if checkpoint is None:
        return State(holder=None if given is None else Holder(given)), None
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
    champion, spent, nothing = generation.champion, state.spent, torch.zeros(0, dtype=torch.bool)
    counts = 0, spent.generations, spent.transitions
    checkpoint = checkpoint_of(
        Found(champion, nothing, -inf, *counts), generation.islands, setup.evolution.islands
    )
    about = {**checkpoint.about, **tensors_of_state(state, progress.skill)}
    setup.journal.record_checkpoint(_step(setup), replace(checkpoint, about=about))


def _tell(setup: Setup[Any], state: State, before: Holder | None) -> None:
    """Report the mean of the holder, if it is another one or its mean is better known."""
    holder = state.holder
    if holder is None or (before is not None and holder.count == before.count):
        return
    new = before is None or before.skill is not holder.skill
    mean, error = (x if abs(x) < inf else None for x in (holder.mean, holder.error))
    about = mean, error, holder.count, state.need.scenarios, state.spent.episodes
    setup.watch(MeanTested(setup.name, holder.skill, new, *about))
