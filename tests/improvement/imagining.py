"""A search in imagined episodes of a cart, for tests of its steps."""

from dataclasses import replace
from typing import Any, TypeAlias

import torch
from rewarded_cart import CartModels, GivenModels, Places, RewardedCart
from support import seeded
from torch import Generator

from cgtorch.evolution import REWARDS, evolve
from cgtorch.evolution.fitness import WORTHLESS
from cgtorch.graphs import Graphs, Skill
from cgtorch.ground.asked import Asked, Purse
from cgtorch.improvement.events import Event
from cgtorch.improvement.imagined_search import Search
from cgtorch.improvement.imagined_state import State
from cgtorch.improvement.pace import BY_ROLLOUT
from cgtorch.improvement.setup import Budget, Setup

DOMAIN = RewardedCart()
NOTHING = DOMAIN.draw("any", 0, seeded(0))
KNOWN = BY_ROLLOUT.known
LOOKS, EPISODES = CartModels.looks, len(CartModels.changes)


def search_of(
    satisfied: float = 8.0, told: list[Event] | None = None, kind: type[CartModels] = GivenModels
) -> Search:
    setup: Setup[Any] = Setup(
        actions=DOMAIN.actions(), world_of=DOMAIN.world, imagine=lambda *_: DOMAIN.world(NOTHING),
        evolution=replace(REWARDS, population=16), max_transitions=500, name="cart",
        budget=Budget(60, satisfied=satisfied), purse=Purse(),
        watch=lambda event: None if told is None else told.append(event),
    )  # fmt: skip

    def draw(count: int, generator: Generator) -> Places:
        return DOMAIN.draw("any", count, generator)

    return Search(setup, draw=draw, models=kind(DOMAIN))


EARLIER = Asked(motions=5, episodes=2, looks=3)  # before a search, as in earlier rounds
Beginning: TypeAlias = tuple[Search, State, list[Event]]


def told_skill(graphs: Graphs) -> Skill:
    return Skill("cart", graphs, DOMAIN.actions(), 500)


def graph_of(better: bool) -> Graphs:
    """The best or the worst of some random graphs that finish episodes in the world."""
    search = search_of()
    world = DOMAIN.world(DOMAIN.draw("any", 8, seeded(0)))
    about = world, search.setup.actions, search.setup.evolution, seeded(0)
    found = next(evolve(*about, max_transitions=500))
    fitness = torch.where(found.fitness < WORTHLESS, torch.nan, found.fitness)
    order = fitness.argsort()[: int(fitness.isfinite().sum())]  # those that finish none are last
    return found.population.graphs[order[-1:] if better else order[:1]]


GOOD, POOR = graph_of(better=True), graph_of(better=False)
