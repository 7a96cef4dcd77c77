"""A search for the best mean in the lottery, its first generation, and tunings."""

from dataclasses import replace
from typing import Any

import torch
from lottery import ACTIONS, PaidLottery, idle, staking, tickets
from support import seeded
from torch import Generator

from cgtorch.evolution import REWARDS, Generation, evolve
from cgtorch.graphs import ActionSet, Skill
from cgtorch.improvement.expected_state import Spent, State
from cgtorch.improvement.mean_search import MeanSearch
from cgtorch.improvement.pace import BY_STEP, Pace
from cgtorch.improvement.paired_race import Fresh, Holder
from cgtorch.improvement.setup import Budget, Setup
from cgtorch.improvement.spread import FEWEST
from cgtorch.improvement.tuning import Tuning, begun

SMALL = replace(REWARDS, population=24, initial_nodes=(1, 2), capacity=6, lineages=3)


def search_of(
    satisfied: float = 9.0, pace: Pace = BY_STEP, actions: ActionSet = ACTIONS, **evolution: Any
) -> MeanSearch:
    """A search in the lottery whose best skill is worth 1.8."""

    def world(count: int, generator: Generator) -> PaidLottery:
        return PaidLottery(tickets(count, generator))

    setup: Setup[Any] = Setup(
        actions=actions, world_of=PaidLottery, imagine=lambda *_: world(0, seeded(0)),
        evolution=replace(SMALL, **evolution), max_transitions=4,
        budget=Budget(30, satisfied=satisfied),
    )  # fmt: skip
    return MeanSearch(setup, Fresh(world, 4, pace))


def generation_of(search: MeanSearch, seed: int = 0) -> Generation:
    """A first generation on a few fresh tickets."""
    environment = search.fresh.world(FEWEST, seeded(seed))
    return next(evolve(environment, ACTIONS, search.structures, seeded(seed), max_transitions=4))


def tuned(skill: Skill, toll: float = 0.0, **about: Any) -> Tuning:
    found = begun(skill.graph, ACTIONS, 2, toll)
    assert found is not None
    updates = about.pop("updates", 0)
    return replace(found, distribution=replace(found.distribution, updates=updates), **about)


def after_one(state: State, pace: Pace = BY_STEP, actions: ActionSet = ACTIONS) -> State:
    """The state after one update following a generation whose champion wins nothing."""
    search = search_of(pace=pace, actions=actions)
    generation = generation_of(search)
    champion = replace(generation.champion, graphs=idle().graph)
    states = search.after(state, replace(generation, champion=champion, number=1), seeded(1))
    next(states)
    return next(states)


HELD = Holder(staking(1.0)).met(torch.full((50,), 1.8))
PLAYED = Spent(searched=10**5, rivals=10, episodes=10**5)
