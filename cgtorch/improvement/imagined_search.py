"""The steps of a search in imagined episodes: what is tried, imagined, played and explored.

`cgtorch.improvement.imagined` says how they belong together.
"""

import time
from dataclasses import dataclass, replace
from math import inf
from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch.evolution import Generation, evolve
from cgtorch.graphs import Graphs, Skill, compacted, merged
from cgtorch.ground.asked import NOTHING, Asked
from cgtorch.ground.environment import Environment
from cgtorch.improvement.events import (
    EpisodePlayed,
    MeanTested,
    ModelsFitted,
    ModelSummary,
    Practised,
    WorldAsked,
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
)
from cgtorch.improvement.pace import BY_ROLLOUT
from cgtorch.improvement.paired_race import Fresh
from cgtorch.improvement.played import OneEpisode, Steps, played, tried_out
from cgtorch.improvement.setup import Draw, Setup
from cgtorch.improvement.side_by_side import SideBySide
from cgtorch.improvement.trial import first_percepts
from cgtorch.simulation import rollout

EACH = 8
"""Imagined episodes of an individual that explores; each generation has other ones."""
SHORT = 25
"""Steps after which the first episodes, of random controls, are broken off."""
HORIZON = 1000
"""Steps of an imagined episode at most."""
CURIOUS_STEPS, EXPLORING = 100, 10
"""Steps of an episode at most that is to explore, and generations of the search for its graph."""
SURE = 500
"""Imagined episodes by which a champion is judged before it is played in the world."""
FRESH = 100
"""Fresh episodes by which an offer is judged, whose mean is not that of all."""
IN_A_ROUND = 20
"""Good episodes in a row after which a skill is offered in a round where rewards are graded."""
TELLING = 0.03
"""How unsure Γ is on average, of 1 where it knows nothing, in episodes that it learns from."""
MOST_CAUTIOUS = 3
"""Standard errors by which a champion has to be better than is wanted: one at first, and one more
after each offer that was not good on fresh episodes, up to so many."""


@dataclass(frozen=True)
class Search:
    """The constant parts of a search."""

    setup: Setup[Any]
    models: Models
    draw: Draw[Any]

    def wanted(self, most_steps: int) -> float:
        """The return of episodes broken off after so many steps that goes with the target."""
        return self.setup.budget.satisfied * min(1.0, most_steps / self.models.most_steps)

    def in_models(self, known: Known) -> SideBySide:
        """A search for the best mean of imagined episodes."""

        def world(count: int, generator: Generator) -> Environment:
            return known.world(count, HORIZON, generator)

        budget = replace(self.setup.budget, satisfied=inf)  # what is enough is decided in `after`
        setup = replace(self.setup, budget=budget)
        return SideBySide(setup, Fresh(world, setup.max_transitions, BY_ROLLOUT))

    def first_state(self, known: Known) -> State:
        """The state before the first generation."""
        return State(known, self.in_models(known).first_state(None))

    def begun(self, generator: Generator) -> State:
        """What is known after looks and episodes of random controls."""
        setup, models, before = self.setup, self.models, self.setup.purse.total
        setup.purse.pay(STARTS, Asked(looks=models.looks))
        starts = first_percepts(setup.world_of(self.draw(models.looks, generator)))
        looks = setup.purse.total - before
        parts, total = list[Steps](), NOTHING
        for change in models.changes:
            episode, before = self._episode(RANDOM, SHORT, generator), setup.purse.total
            parts.append(tried_out(episode, models.random_control, change, generator))
            total += setup.purse.total - before
        began = time.perf_counter()
        known = models.learned(starts, Steps.joined(parts))
        state = self.first_state(known).met(known, STARTS, looks).met(known, RANDOM, total)
        summary = ModelSummary(f"{len(parts)} episodes of random controls: {known.summary()}")
        seconds = time.perf_counter() - began
        setup.watch(ModelsFitted(setup.name, replace(summary, first=True), seconds))
        if total.steps:
            good = sum(float(each.reward.sum()) >= self.wanted(HORIZON) for each in parts)
            setup.watch(WorldAsked(setup.name, RANDOM, total, good))
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
        search, poor = self.in_models(state.known), self.poor(state)
        for inner in search.after(state.inner, generation, generator):
            state = replace(state, inner=inner)
            if poor:  # so that nothing is tuned
                break
            if self.promising(state):
                state = replace(state, inner=search.known_better(inner, SURE, generator))
                if (holder := state.inner.holder) is not None and self.promising(state):
                    play = self._practised if self.models.graded else self._champion_played
                    return play(state, holder.skill, generator)
                break  # it was lucky, and the search goes on from what is known by now
        state = state.waiting(self.wanted(HORIZON))
        if state.waited < state.patience and not poor:
            return state, False
        return self._learned(state, generation, generator)

    def poor(self, state: State) -> bool:
        """Whether no reward so far adds up to what is wanted, while there is more to explore."""
        return state.patience == PATIENCE and state.known.most(HORIZON) < self.wanted(HORIZON)

    def promising(self, state: State) -> bool:
        """Whether the holder is worth enough, as far as it is known, to be played in the world."""
        holder = state.inner.holder
        if holder is None or holder.count < BY_ROLLOUT.known:
            return False
        return self._enough(state, holder.mean, holder.error * (holder.count / FRESH) ** 0.5)

    def _enough(self, state: State, mean: float, error: float) -> bool:
        """Whether a mean is as much as is wanted, beyond what chance may add on fresh episodes."""
        cautious = min(1 + state.known.offered, MOST_CAUTIOUS)
        return mean - self.wanted(HORIZON) >= cautious * error

    def _learned(
        self, state: State, generation: Generation, generator: Generator
    ) -> tuple[State, bool]:
        """The state after an episode from which the models learn, and whether it is offered."""
        if self.setup.purse.late():
            return state, False
        state, graphs = replace(state, waited=0), generation.champion.graphs
        if self.models.graded:
            holder = state.inner.holder
            best = self.skill_of(graphs) if holder is None else holder.skill
            return self._practised(state, best, generator)
        if self.telling(graphs, state.known, generator):
            return self._played(state, graphs, CURIOUS, CURIOUS_STEPS, generator)[0], False
        curious = self.exploring(state.known, generator)
        if self.telling(curious, state.known, generator):
            return self._explored(state, graphs, curious, generator)
        return replace(state, patience=state.patience + PATIENCE), False

    def _practised(self, state: State, skill: Skill, generator: Generator) -> tuple[State, bool]:
        """The state after a skill was played up to its first failure, and whether it is offered.

        It is after `Setup.practice` good episodes in a row, whatever is imagined for it, and after
        a few in a round, which tries it on fresh episodes itself.
        """
        setup, few = self.setup, self.setup.practice or IN_A_ROUND
        parts, total, good = list[Steps](), NOTHING, 0
        while good < few and not setup.purse.late():
            reached, steps, asked = self._tried(skill.graph, CHAMPIONS, HORIZON, generator)
            total += asked
            parts += [steps] if len(steps) else []
            if reached < self.wanted(HORIZON):
                break
            good += 1
        known = state.known
        if parts:
            starts = torch.cat([steps.percept[:1] for steps in parts])
            known = known.after(starts, Steps.joined(parts))
        setup.watch(WorldAsked(setup.name, CHAMPIONS, total, good))
        setup.watch(Practised(setup.name, skill, good, few))
        state = state.met(known, CHAMPIONS, total)
        return (replace(state, skill=skill), True) if good == few else (state, False)

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
        worlds = state.known.world(SURE, HORIZON, generator)
        return self._enough(state, *self.promised(skill.graph, worlds))

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
        reached, steps, asked = self._tried(graphs, phase, most, generator)
        known, said = state.known, inf
        if len(steps):
            start = steps.percept[:1]
            here = known.begun_at(start, SURE, most, generator)
            said = float(self.imagined(graphs, here).mean())
            known = known.after(start, steps)
        state = state.met(known, phase, asked)
        returned = None if reached == -inf else reached
        about = returned, asked.steps or asked.motions, state.steps
        self.setup.watch(EpisodePlayed(self.setup.name, phase, *about))
        return state, reached, said - reached

    def _tried(
        self, graphs: Graphs, phase: str, most: int, generator: Generator
    ) -> tuple[float, Steps, Asked]:
        """What a graph returns in an episode in the world, its steps, and what they cost."""
        setup, before = self.setup, self.setup.purse.total
        episode = self._episode(phase, most, generator)
        reached, steps = played(episode, graphs, setup.actions, setup.max_transitions)
        return reached, steps, setup.purse.total - before

    def imagined(self, graphs: Graphs, world: Environment) -> Tensor:
        """(B,) returns of a graph in imagined episodes."""
        setup = self.setup
        found = rollout(graphs, setup.actions, world, max_transitions=setup.max_transitions)
        assert found.returns is not None  # noqa: S101  as it gives rewards
        return found.returns[0]

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
