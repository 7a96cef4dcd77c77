"""States that hold tensors are equal to themselves only, and can be asked."""

import copy

from support import custom_actions, nested_actions, random_graphs, random_skill, seeded

from cgtorch.evolution.population import random_population


def test_graphs_skills_and_populations_can_be_compared_and_kept_in_sets() -> None:
    actions = custom_actions()
    for one in (
        random_graphs(0, 3, actions),
        random_skill(0, "one", nested_actions()),
        random_population(3, actions, 12, (3, 10), seeded(0)),
    ):
        other = copy.deepcopy(one)
        assert one == one
        assert one != other
        assert one in [other, one]
        assert len({one, other, one}) == 2
