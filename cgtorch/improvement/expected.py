"""Improving what a skill is worth in the mean, where rewards are given or success is chance.

There a skill that was good on some scenarios may have been lucky, and no scenario that was solved
once is a fact that later skills have to keep. So there is no W, and

1. all individuals of a generation meet the same fresh scenarios. How many follows from how
   reliably they tell individuals apart (`cgtorch.improvement.spread`);
2. a challenger becomes the holder, the skill of the stage, if it wins a paired race on further
   fresh scenarios (`cgtorch.improvement.paired_race`);
3. from the second cycle of structures on, half of all actions tune parameters with ever more
   scenarios (`cgtorch.improvement.tuning`): the holder's, and then those of other structures. The
   other half looks for new structures, so that local optima are left.
"""

import time
from contextlib import suppress
from dataclasses import dataclass, replace
from math import inf
from typing import Any

import torch
from torch import Generator

from cgtorch.evolution import EvolutionState, Generation, Population, evolve
from cgtorch.evolution.population import initial_strategy
from cgtorch.evolution.search import derived_generator
from cgtorch.graphs import Graphs, Skill, compacted, merged
from cgtorch.ground.asked import BudgetSpentError
from cgtorch.ground.environment import Environment
from cgtorch.improvement import tuning as tune
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
from cgtorch.improvement.paired_race import Fresh, Holder, paired_race
from cgtorch.improvement.setup import Draw, Progress, Setup
from cgtorch.improvement.trial import try_skill
from cgtorch.improvement.tuning import Tuning

OFTEN = 5  # generations between two nominations
CYCLES = 2  # generations of new structures after which tuning begins
LARGEST = 8  # the search has played so many times as many episodes as an update or a generation
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
        most = spent.episodes // (LARGEST * len(generation.scores))
        state = replace(state, need=state.need.after(generation.scores, most), spent=spent)
        state = state.with_candidates(map(tune.continued, lineages))
        for graphs in self._nominees(state, generation):
            state, _ = self._raced(state, self.skill_of(graphs), generator)
        state = self._met(state, generation.number, generator)
        while state.holder is not None and state.spent.tuned < state.spent.searched:
            if state.tuning is None:
                state = self._tuning(state)
            if state.tuning is None:
                break
            state = self._tuned(state, state.tuning, generator)
        return state

    def _met(self, state: State, number: int, generator: Generator) -> State:
        """The state with further values of the holder, at once if it is new, else now and then."""
        holder = state.holder
        if holder is None or (number % OFTEN and holder.count):
            return state
        count = max(KNOWN, state.need.scenarios)
        values = self.fresh.of_skills([holder.skill], count, generator)[0]
        return replace(state, holder=holder.met(values))

    def _nominees(self, state: State, generation: Generation) -> list[Graphs]:
        """Graphs that may be better than the holder: the champion, and the best lineage's mean."""
        champion = [generation.champion.graphs]
        if generation.number % OFTEN and state.holder is not None:
            return champion if generation.best >= self.setup.budget.satisfied else []
        lineages = generation.islands[0].lineages
        if not lineages:
            return champion
        leader = max(lineages, key=lambda each: each.recent_fitness)
        return [*champion, tune.continued(leader).mean(self.setup.actions)]

    def _raced(self, state: State, challenger: Skill, generator: Generator) -> tuple[State, bool]:
        """The state after a race, and whether the challenger has won it."""
        if state.holder is None:
            values = self.fresh.of_skills([challenger], KNOWN, generator)
            finite = bool(values.isfinite().all())
            return (state.held_by(Holder(challenger)) if finite else state), finite
        before = self.fresh.episodes
        winner = paired_race(self.fresh, state.holder, challenger, state.longest, generator)
        raced = state.spent.raced + self.fresh.episodes - before
        state = replace(state, spent=replace(state.spent, raced=raced))
        return state.held_by(winner), winner.skill is challenger

    def _tuning(self, state: State) -> State:
        """The state with a graph to tune next: the holder's and a candidate's in turn.

        Of candidates, it is the one whose kind was tuned longest ago, so that a promising structure
        gets the care that the holder has had.
        """
        holder, actions, scenarios = state.holder, self.setup.actions, state.need.scenarios
        if not state.settled and holder is not None and holder.skill.actions is actions:
            return replace(state, tuning=tune.begun(holder.skill.graph, actions, scenarios))
        if not state.candidates:
            return state
        kinds = state.kinds
        chosen = min(state.candidates, key=lambda each: _place(each.kind, kinds))
        kinds = (*(kind for kind in kinds if kind != chosen.kind), chosen.kind)
        return replace(state, tuning=replace(chosen, scenarios=scenarios), kinds=kinds)

    def _tuned(self, state: State, tuning: Tuning, generator: Generator) -> State:
        """The state after an update of what is tuned, and a race of its mean if that is due."""
        actions, before = self.setup.actions, (self.fresh.executed, self.fresh.episodes)
        tuning = tune.update(tuning, actions, self.fresh, generator)
        episodes = self.fresh.episodes - before[1]
        spent = replace(
            state.spent,
            tuned=state.spent.tuned + self.fresh.executed - before[0],
            episodes=state.spent.episodes + episodes,
        )
        state = replace(state, spent=spent)
        if not tuning.due:
            return replace(state, tuning=tuning)
        setup = self.setup
        mean = Skill(setup.name, tuning.mean(actions), actions, setup.max_transitions)
        state, won = self._raced(state, mean, generator)
        tuning = tuning.raced(won)
        if won:  # so that it is the holder that is tuned
            return replace(state, tuning=replace(tuning, graph=mean.graph))
        if not tuning.stalled:
            return replace(state, tuning=tuning)
        more = tuning.more() if LARGEST * episodes <= spent.episodes else None
        settled = state.settled if more else not state.settled
        return replace(state, tuning=more, settled=settled)

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

    search = Search(setup, Fresh(world, setup.max_transitions))
    state, islands = _recalled(setup, progress)
    limit, first = setup.attempts * setup.budget.generations, time.perf_counter()
    began = first
    how: Any = {"seeds": progress.specialists, "islands": islands}
    about = environment, setup.actions, setup.evolution, setup.generator
    with suppress(BudgetSpentError):  # when the time is over
        for generation in evolve(*about, **how, max_transitions=setup.max_transitions):
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
    skill = state.holder.skill
    _report(setup, progress, skill, tests, time.perf_counter() - first)
    usual = skill.actions is setup.actions
    seeds = Population(skill.graph, initial_strategy(1)) if usual else progress.specialists
    return replace(progress, skill=skill, specialists=seeds)


def _place(kind: tuple[int, ...], kinds: tuple[tuple[int, ...], ...]) -> int:
    """The place of a kind in order, from 1; 0 if it is not there."""
    return kinds.index(kind) + 1 if kind in kinds else 0


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


def _report(setup: Setup[S], before: Progress[S], skill: Skill, tests: S, seconds: float) -> None:
    """Report another skill than before, with its result on the stage's tests."""
    if skill is before.skill:
        return
    succeeded = torch.zeros(0, dtype=torch.bool)
    if len(tests):
        succeeded = try_skill(skill, setup.world_of(tests)).succeeded
    keep, targets = torch.zeros_like(succeeded), torch.ones_like(succeeded)
    parent = None if before.skill is None else before.skill.name
    about = tests, succeeded, keep, targets, seconds, None, parent
    setup.watch(SkillAccepted(setup.name, skill, *about))


def _tell(setup: Setup[Any], state: State, before: Holder | None) -> None:
    """Report the mean of the holder, if it is another one or its mean is better known."""
    holder = state.holder
    if holder is None or (before is not None and holder.count == before.count):
        return
    new = before is None or before.skill is not holder.skill
    mean, error = (x if abs(x) < inf else None for x in (holder.mean, holder.error))
    about = mean, error, holder.count, state.need.scenarios, state.spent.episodes
    setup.watch(MeanTested(setup.name, holder.skill, new, *about))
