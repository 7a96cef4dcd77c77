"""Improving what a skill returns with few steps in the world; the rest is imagined.

1. First percepts of some episodes are looked at, and short episodes of random controls are played.
   A transition model Γ, rewards and ends of episodes are learned from these steps.
2. Graphs are evolved for the best mean in imagined episodes (`cgtorch.improvement.expected`), with
   other starts and errors of Γ in each generation.
3. Once the best is surely good enough there, it is played once in the world, and the models learn
   from that. It is offered if this episode is good enough, or if the world gives what was imagined
   for it, and if it still is good enough. What an offer is worth is decided by fresh episodes after
   the stage. If that is too little, the next round is more careful.
4. Where there is no such skill for some generations, the champion is played if models would
   learn from it, and else a graph that is evolved to come to where Γ is unsure (an exploration
   bonus), if there is one.

This is what PILCO does with policies of one structure (Deisenroth and Rasmussen, ICML 2011).
"""

import time
from contextlib import suppress
from dataclasses import dataclass, replace
from math import inf
from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch.evolution import EvolutionState, Generation, Population, evolve, initial_state
from cgtorch.evolution.population import initial_strategy
from cgtorch.evolution.search import derived_generator
from cgtorch.graphs import Graphs, Skill, compacted, merged
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import NOTHING, Asked, BudgetSpentError
from cgtorch.ground.environment import Environment
from cgtorch.improvement import expected
from cgtorch.improvement.checkpoint import Found, checkpoint_of, found_from, islands_from
from cgtorch.improvement.events import (
    EpisodePlayed,
    EvolutionRecalled,
    GenerationDone,
    MeanTested,
    ModelsFitted,
    ModelSummary,
    S,
    SkillAccepted,
    solved_of,
)
from cgtorch.improvement.imagined_state import (
    CHAMPIONS,
    CURIOUS,
    PATIENCE,
    RANDOM,
    STARTS,
    Known,
    Models,
    State,
    state_from_tensors,
    tensors_of_state,
)
from cgtorch.improvement.paired_race import Fresh, Holder
from cgtorch.improvement.played import OneEpisode, Steps, played, tried_out
from cgtorch.improvement.setup import Draw, Progress, Setup
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.simulation import rollout

EACH = 8
"""Imagined episodes of an individual that explores; each generation has other ones."""
EPISODES, SHORT = 4, 25
"""Episodes of random controls to begin with, and steps after which they are broken off."""
LOOKS = 500
"""First percepts of episodes that are looked at, without a step."""
CHANGES = (1.0, 0.25, 0.06)
"""Chances of another control in each step; an episode has one of them."""
HORIZON = 1000
"""Steps of an imagined episode at most."""
CURIOUS_STEPS, EXPLORING = 100, 10
"""Steps of an episode at most that is to explore, and generations of the search for its graph."""
SURE = 500
"""Imagined episodes by which a champion is judged before it is played in the world."""
FRESH = 100
"""Fresh episodes by which an offer is judged, whose mean is not that of all."""
TELLING = 0.03
"""How unsure Γ is on average, of 1 where it knows nothing, in episodes that it learns from."""
MOST_CAUTIOUS = 3
"""Standard errors by which a champion has to be better than is wanted: one at first, and one more
after each offer that was not good on fresh episodes, up to so many."""
BEGIN = 2**40  # the number of the generator of what happens before the first generation


@dataclass(frozen=True)
class Search:
    """The constant parts of a search."""

    setup: Setup[Any]
    models: Models
    draw: Draw[Any]

    def wanted(self, most_steps: int) -> float:
        """The return of episodes broken off after so many steps that goes with the target."""
        return self.setup.budget.satisfied * min(1.0, most_steps / self.models.most_steps)

    def in_models(self, known: Known) -> expected.Search:
        """A search for the best mean of imagined episodes."""

        def world(count: int, generator: Generator) -> Environment:
            return known.world(count, HORIZON, generator)

        budget = replace(self.setup.budget, satisfied=self.wanted(HORIZON))
        setup = replace(self.setup, budget=budget)
        return expected.Search(setup, Fresh(world, setup.max_transitions))

    def begun(self, generator: Generator) -> State:
        """What is known after looks and episodes of random controls."""
        setup, before = self.setup, self.setup.purse.total
        setup.purse.pay(STARTS, Asked(looks=LOOKS))
        starts = first_percepts(setup.world_of(self.draw(LOOKS, generator)))
        looks = setup.purse.total - before
        parts, total = list[Steps](), NOTHING
        for number in range(EPISODES):
            change = CHANGES[number % len(CHANGES)]
            episode, before = self._episode(RANDOM, SHORT, generator), setup.purse.total
            control = lambda: self.models.random_control(generator)  # noqa: E731
            parts.append(tried_out(episode, control, change, generator))
            total += setup.purse.total - before
        began = time.perf_counter()
        known = self.models.learned(starts, Steps.joined(parts))
        state = State(known).met(known, STARTS, looks).met(known, RANDOM, total)
        summary = ModelSummary(f"{EPISODES} episodes of random controls: {known.summary()}")
        seconds = time.perf_counter() - began
        setup.watch(ModelsFitted(setup.name, replace(summary, first=True), seconds))
        return state

    def _episode(self, phase: str, most: float, generator: Generator) -> OneEpisode:
        """A fresh episode in the world, broken off after so many steps."""
        setup = self.setup
        world = setup.world_of(self.draw(1, generator))
        return OneEpisode(world, setup.purse, phase, most, self.models.most_steps)

    def after(
        self, state: State, generation: Generation, generator: Generator
    ) -> tuple[State, bool]:
        """The state after a generation, and whether its skill is offered."""
        search = self.in_models(state.known)
        inner = search.after(state.inner, generation, generator)
        inner, certain = search.certain(inner, generator)
        state = replace(state, inner=inner, waited=state.waited + 1)
        if (
            certain
            and inner.holder is not None
            and self.surely(state, inner.holder.skill, generator)
        ):
            return self._champion_played(state, inner.holder.skill, generator)
        if state.waited < state.patience:
            return state, False
        state, graphs = replace(state, waited=0), generation.champion.graphs
        if self.telling(graphs, state.known, generator):
            return self._champion_played(state, self.skill_of(graphs), generator)
        curious = self.exploring(state.known, generator)
        if self.telling(curious, state.known, generator):
            return self._explored(state, graphs, curious, generator)
        return replace(state, patience=state.patience + PATIENCE), False

    def _explored(
        self, state: State, graphs: Graphs, curious: Graphs, generator: Generator
    ) -> tuple[State, bool]:
        """The state after an episode of a graph that explores, and whether it is offered.

        It is if it came to the target by itself. If more is imagined for it by now than for the
        champion, the search begins again with it.
        """
        state, reached, _ = self._played(state, curious, CURIOUS, CURIOUS_STEPS, generator)
        skill, worlds = self.skill_of(curious), state.known.world(SURE, HORIZON, generator)
        good = bool(state.known.steps.ended[-1]) and reached >= self.wanted(HORIZON)
        if good and self.surely(state, skill, generator):
            return replace(state, skill=skill), True
        better = self.promised(curious, worlds)[0] > self.promised(graphs, worlds)[0]
        return replace(state, seed=curious if better else None), False

    def surely(self, state: State, skill: Skill, generator: Generator) -> bool:
        """Whether enough is imagined for a skill, beyond what chance may add on fresh episodes."""
        cautious = min(1 + state.known.offered, MOST_CAUTIOUS)
        worlds = state.known.world(SURE, HORIZON, generator)
        mean, error = self.promised(skill.graph, worlds)
        return mean - self.wanted(HORIZON) >= cautious * error

    def _champion_played(
        self, state: State, skill: Skill, generator: Generator
    ) -> tuple[State, bool]:
        """The state after an episode of a champion, and whether it is offered.

        It is if the episode was good enough, or gave what was imagined for a good skill, and if
        enough is imagined for it by now.
        """
        worlds = state.known.world(SURE, HORIZON, generator)
        margin = self.promised(skill.graph, worlds)[0] - self.wanted(HORIZON)
        state, reached, short = self._played(state, skill.graph, CHAMPIONS, HORIZON, generator)
        kept = reached >= self.wanted(HORIZON) or (margin >= 0 and short <= margin)
        offered = kept and self.surely(state, skill, generator)
        told = None if reached == -inf else reached
        about = self.setup.name, skill, offered, told, None, 1
        self.setup.watch(MeanTested(*about, state.inner.need.scenarios, state.episodes))
        return (replace(state, skill=skill) if offered else state), offered

    def _played(
        self, state: State, graphs: Graphs, phase: str, most: int, generator: Generator
    ) -> tuple[State, float, float]:
        """The state after an episode in the world, its return, and how much more was imagined."""
        setup, before = self.setup, self.setup.purse.total
        episode = self._episode(phase, most, generator)
        reached, steps = played(episode, graphs, setup.actions, setup.max_transitions)
        asked, known, said = setup.purse.total - before, state.known, inf
        if len(steps):
            start = steps.percept[:1]
            here = known.begun_at(start, SURE, most, generator)
            said = float(self.imagined(graphs, here).mean())
            known = known.after(start, steps)
        state = state.met(known, phase, asked)
        returned = None if reached == -inf else reached
        about = returned, asked.motions, state.steps
        setup.watch(EpisodePlayed(setup.name, phase, *about))
        return state, reached, said - reached

    def imagined(self, graphs: Graphs, world: Environment) -> Tensor:
        """(B,) returns of a graph in imagined episodes."""
        setup = self.setup
        found = rollout(graphs, setup.actions, world, max_transitions=setup.max_transitions)
        return torch.full((1,), -torch.inf) if found.returns is None else found.returns[0]

    def promised(self, graphs: Graphs, world: Environment) -> tuple[float, float]:
        """The mean return of a graph in imagined episodes, and its standard error on fresh ones."""
        returns = self.imagined(graphs, world).double()
        error = returns.std() / FRESH**0.5
        return float(returns.mean()), float(error.nan_to_num(nan=torch.inf))

    def telling(self, graphs: Graphs, known: Known, generator: Generator) -> bool:
        """Whether the models would learn from an episode of a graph."""
        steps = min(CURIOUS_STEPS, self.models.most_steps)
        world = known.curious(SURE, CURIOUS_STEPS, generator)
        return float(self.imagined(graphs, world).mean()) >= TELLING * steps

    def exploring(self, known: Known, generator: Generator) -> Graphs:
        """A graph that comes to where Γ is unsure."""
        setup = self.setup
        worlds = lambda number: known.curious(EACH, CURIOUS_STEPS, generator)  # noqa: E731
        about = worlds, setup.actions, setup.evolution, generator
        for generation in evolve(*about, max_transitions=setup.max_transitions):
            if generation.number == EXPLORING or setup.purse.late():
                break
        return generation.champion.graphs

    def skill_of(self, graphs: Graphs) -> Skill:
        """The skill of a single graph."""
        setup = self.setup
        return Skill(setup.name, merged(compacted(graphs)), setup.actions, setup.max_transitions)


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
    about, most = (
        (environment, setup.actions, setup.evolution, setup.generator),
        setup.max_transitions,
    )
    generations = evolve(*about, islands=islands, max_transitions=most)
    with suppress(BudgetSpentError):  # when the time or the budget is over
        while not (offered or state.generations >= limit or setup.purse.late()):
            generation = next(generations)
            _record(setup, progress, state, generation)
            generator = derived_generator(own, 2 * state.generations + 2)
            state, offered = search.after(state, generation, generator)
            now = time.perf_counter()
            counts = solved_of(generation.succeeded, torch.zeros_like(generation.succeeded))
            done = generation, limit, now - began
            began = now
            setup.watch(GenerationDone(setup.name, setup.name, *counts, *done))
            if state.seed is not None:
                islands = _founded(setup, _alone(state.seed), state.generations)
                generations = evolve(*about, islands=islands, max_transitions=most)
                state = replace(state, seed=None)
    skill = state.skill
    if skill is None and state.inner.holder is not None:
        skill = state.inner.holder.skill
    known = state.known.refused() if offered else state.known  # or there is no next round
    return _ended(setup, replace(progress, knowledge=known), skill, tests, first)


def _ended(
    setup: Setup[S], progress: Progress[S], skill: Skill | None, tests: S, first: float
) -> Progress[S]:
    """The progress with the skill of the stage, which is reported with its result on the tests."""
    if skill is None or skill is progress.skill:
        return progress
    succeeded = torch.zeros(0, dtype=torch.bool)
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
        state = search.begun(generator) if known is None else State(known)
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
    champion, nothing = generation.champion, torch.zeros(0, dtype=torch.bool)
    counts = 0, state.generations, state.inner.spent.transitions
    checkpoint = checkpoint_of(
        Found(champion, nothing, -inf, *counts), generation.islands, setup.evolution.islands
    )
    about = {**checkpoint.about, **tensors_of_state(state, progress.skill)}
    setup.journal.record_checkpoint(_step(setup), replace(checkpoint, about=about))
