"""Rivals of the best skill are compared at equally many updates, the worse half ends."""

from dataclasses import replace

import torch
from lottery import ACTIONS, idle, staking
from support import custom_actions, same, seeded
from torch import Tensor

from cgtorch.evolution import Population
from cgtorch.evolution.first_graphs import looping
from cgtorch.evolution.fitness import WORST
from cgtorch.evolution.population import initial_strategy, random_population
from cgtorch.evolution.racing import contents
from cgtorch.graphs import (
    NO_NODE,
    ActionSet,
    Graphs,
    LinearNN,
    RecurrentNN,
    concatenate,
    reward_actions,
)
from cgtorch.improvement.rivals import (
    SEVERAL,
    best,
    candidates,
    compared,
    halved,
    next_rival,
    simplest,
)
from cgtorch.improvement.tuning import Tuning, begun

RUNGS = 5, 15


def tuning(level: float, updates: int, toll: float = 0.0) -> Tuning:
    """A tuning of one kind that has come to this level after so many updates."""
    found = begun(staking(level).graph, ACTIONS, 1, toll, alone=toll > 0)
    assert found is not None
    distribution = replace(found.distribution, updates=updates)
    return replace(found, distribution=distribution, recent=(level,))


def firsts(graphs: list[Graphs], fitness: list[float], count: int, random: Tensor) -> list[Graphs]:
    """The graphs of the first rivals of these individuals."""
    population = Population(concatenate(graphs), initial_strategy(len(graphs)))
    worth = torch.tensor(fitness)
    order = worth.argsort(descending=True)
    found = candidates(population, worth, order, random, count, ACTIONS, 7)[:count]
    assert {each.scenarios for each in found} <= {7}
    return [each.graph for each in found]


def test_the_best_with_parameters_become_rivals_and_not_who_finishes_nothing() -> None:
    graphs = [staking(0.1).graph, idle().graph, staking(0.2).graph, staking(0.3).graph]
    nobody = torch.zeros(4, dtype=torch.bool)
    found = firsts(graphs, [1.0, 9.0, 3.0, 2.0], 2, nobody)
    assert [float(each.parameters[0, 0, 0]) for each in found] == torch.tensor([0.2, 0.3]).tolist()
    assert len(firsts(graphs, [1.0, 9.0, WORST, 2.0], 9, nobody)) == 2


def test_the_best_of_each_kind_come_first_in_the_order_of_their_fitness() -> None:
    actions = custom_actions()
    many = random_population(60, actions, 4, (1, 3), seeded(0))
    worth, nobody = torch.linspace(1, 0, 60), torch.zeros(60, dtype=torch.bool)
    about = many, worth, torch.arange(60), nobody
    every = candidates(*about, 60, actions, 7)
    kinds = [each.kind for each in every]
    count = len(set(kinds))
    assert 2 < count < len(kinds)
    assert len(set(kinds[:count])) == count
    place = {contents(many[i : i + 1].graphs)[0]: i for i in reversed(range(60))}
    order = [place[contents(each.graph)[0]] for each in every]
    assert order[:count] == sorted(order[:count])
    assert order[count:] == sorted(order[count:])
    assert [each.kind for each in candidates(*about, 2, actions, 7)][:2] == kinds[:2]
    assert len(candidates(*about, 2, actions, 7)) == 2 * SEVERAL


def test_a_loop_is_another_kind_than_what_repeats_its_first_action_and_simpler() -> None:
    actions = reward_actions(2, 1)
    names = [type(action).__name__ for action in actions.actions]
    linear, step = names.index("LinearNN"), names.index("Step")
    action = torch.tensor([[linear, step], [linear, step]])
    edges = torch.full((2, 2, actions.outcome_capacity), NO_NODE)
    edges[:, 0, 0], edges[:, 1, 0] = 1, torch.tensor([1, 0])  # the first one repeats its step
    edges[:, 1, 1] = 0
    parameters = actions.parameters_of(action, seeded(0))
    both = Graphs(action, edges, parameters, torch.zeros(2, dtype=torch.long))
    assert looping(both, actions).tolist() == [False, True]
    many = Population(both[torch.tensor([0, 0, 1])], initial_strategy(3))
    worth, nobody = torch.tensor([3.0, 2.0, 1.0]), torch.zeros(3, dtype=torch.bool)
    found = candidates(many, worth, torch.arange(3), nobody, 2, actions, 1)
    assert [bool(looping(each.graph, actions)) for each in found][:2] == [False, True]
    assert simplest(found, actions) is found[1]


def test_the_best_is_one_that_is_compared() -> None:
    rivals = [tuning(1.0, 5), tuning(3.0, 5), tuning(9.0, 5, toll=1.0), tuning(2.0, 5)]
    assert best(rivals) is rivals[1]
    assert best(rivals[2:3]) is None


def test_the_worse_half_ends_at_each_rung_and_those_with_a_toll_go_on() -> None:
    levels = [1.0, 4.0, 2.0, 3.0]
    rivals = [*(tuning(level, RUNGS[0]) for level in levels), tuning(0.0, 2, toll=1.0)]
    assert [each.level for each in halved(rivals, RUNGS)] == [4, 3, 0]
    assert [each.level for each in halved(rivals[:3], RUNGS)] == [4, 2]
    later = [tuning(1.0, RUNGS[0] + 1), tuning(2.0, RUNGS[0] + 1)]
    assert len(halved(later, RUNGS)) == 2
    unequal = [tuning(1.0, RUNGS[0]), tuning(2.0, RUNGS[0] - 1)]
    assert len(halved(unequal, RUNGS)) == 2
    last = [tuning(1.0, RUNGS[1]), tuning(2.0, RUNGS[1])]
    assert [each.level for each in halved(last, RUNGS)] == [2]
    assert len(halved(last[:1], RUNGS)) == 1


def test_the_one_with_the_fewest_updates_is_next_and_several_are_compared() -> None:
    rivals = [tuning(1.0, 4), tuning(2.0, 3), tuning(3.0, 3)]
    assert next_rival(rivals) == 1
    assert next_rival([*rivals, tuning(0.0, 9, toll=1.0)]) == 3
    assert compared(rivals)
    assert not compared([rivals[0], tuning(1.0, 1, toll=2.0)])
    assert not compared([])


def test_the_simplest_has_no_memory_and_few_parameters() -> None:
    actions = ActionSet(
        ("Recur", "Large", "Small"), (RecurrentNN(1, 1, 1), LinearNN(9, 1), LinearNN(3, 1))
    )
    graph = replace(staking(1.0).graph, parameters=torch.ones(1, 1, actions.parameter_capacity))
    every = [
        begun(replace(graph, action=torch.tensor([[action]])), actions, 1) for action in range(3)
    ]
    rivals = [each for each in every if each is not None]
    assert simplest(rivals, actions) is rivals[2]
    assert simplest(rivals[:2], actions) is rivals[1]


def test_chosen_parameters_stay_and_random_ones_of_few() -> None:
    graphs = [staking(0.1).graph]
    for random in (False, True):
        (found,) = firsts(graphs, [1.0], 1, torch.tensor([random]))
        assert same(found, graphs[0])
