"""A mutation whose draw is its rate does not happen, compiled and in torch."""

import pytest
import torch
from support import custom_actions, seeded
from torch import Tensor

from cgtorch.evolution import STRATEGY, Population, compiled, operators_in_torch
from cgtorch.evolution.operators import breed
from cgtorch.evolution.population import random_population
from cgtorch.ground.counter_rng import individual_words, uniform_from
from cgtorch.native import available

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

ACTIONS, SIZE, KEYS = custom_actions(), 40, (17, -4)


def population_at(name: str, rate: Tensor) -> Population:
    """Individuals of nine nodes whose only rate is that one."""
    graphs = random_population(SIZE, ACTIONS, 10, (9, 9), seeded(3)).graphs
    strategy = torch.zeros(SIZE, len(STRATEGY))
    strategy[:, STRATEGY.index(name)] = rate
    return Population(graphs, strategy)


def draws(name: str) -> Tensor:
    """The first number that decides on a mutation, of each child."""
    n, o = 10, ACTIONS.outcome_capacity
    if name == "crossover":
        one = uniform_from(individual_words(KEYS[0], SIZE // 2, [1])[0])[:, 0]
        return one.repeat(2)
    sizes = [3 + o, 3, 2, n, n]
    places = ("add_node", "delete_node", "new_start", "replace_node", "change_edge")
    return uniform_from(individual_words(KEYS[1], SIZE, sizes)[places.index(name)])[:, 0]


@pytest.mark.parametrize(
    "name", ["crossover", "add_node", "delete_node", "new_start", "replace_node", "change_edge"]
)
def test_a_draw_at_the_rate_changes_nothing_and_one_below_does(name: str) -> None:
    differing = []
    for share in (0.0, 1e-6):
        whole = population_at(name, draws(name) + share)
        about = whole, torch.arange(0), torch.arange(SIZE), KEYS, ACTIONS, 10
        found, _, _ = breed(*about)
        assert compiled.takes(whole.graphs, whole.graphs.parameters, 10)
        wanted, _ = operators_in_torch.breed(*about)
        for part in ("action", "edges", "start"):
            assert torch.equal(getattr(found, part), getattr(wanted, part)), part
        still = breed(*(population_at(name, 0 * draws(name)), *about[1:]))[0]
        differing.append(
            (found.edges != still.edges).flatten(1).any(1) | (found.start != still.start)
        )
    assert int(differing[1].sum()) > SIZE // 4
    if name in ("crossover", "add_node", "delete_node", "new_start"):
        assert not differing[0].any()
