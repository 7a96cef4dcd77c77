"""A node is doubled behind a branch, and the graph does what it did."""

import torch
from lottery import ACTIONS, PaidLottery, idle, staking, tickets
from support import seeded

from cgtorch.evolution import REWARDS
from cgtorch.evolution.lineages import tunable
from cgtorch.evolution.population import random_population
from cgtorch.graphs import (
    ActionSet,
    BranchingNN,
    Graphs,
    LinearNN,
    Step,
    pruned,
    resized,
    reward_actions,
    valid,
)
from cgtorch.improvement.split import split
from cgtorch.simulation import rollout


def returns(graph: Graphs, actions: ActionSet) -> torch.Tensor:
    found = rollout(graph, actions, PaidLottery(tickets(50, seeded(0))), max_transitions=6)
    assert found.returns is not None
    return found.returns


def test_a_split_graph_does_what_it_did_and_has_twice_the_parameters() -> None:
    actions = reward_actions(2, 1)
    size, capacity, nodes = 60, REWARDS.capacity, (2, 3)
    many = random_population(size, actions, capacity, nodes, seeded(1)).graphs
    done = 0
    for row in range(size):
        graph = pruned(many[row : row + 1])
        tuned = tunable(graph, actions)
        found = split(graph, actions)
        if int(tuned.any(1).sum()) != 1:
            assert found is None
            continue
        assert found is not None
        done += 1
        assert bool(valid(found, actions).all())
        assert int(found.num_nodes) == int(graph.num_nodes) + 2
        branch = actions.actions[actions.names.index("Branch")]
        assert int(tunable(found, actions).sum()) == 2 * int(tuned.sum()) + branch.num_parameters
        assert torch.equal(returns(found, actions), returns(graph, actions))
        other = found.parameters.clone()
        other[0, -2] = torch.randn(other[0, -2].shape, generator=seeded(row))
        other[0, -2, branch.num_parameters :] = 0
        turned = Graphs(found.action, found.edges, other, found.start)
        assert torch.equal(returns(turned, actions), returns(graph, actions))  # copies are equal
    assert done > 10


def test_nothing_is_split_without_parameters_or_without_a_branch() -> None:
    assert split(idle().graph, ACTIONS) is None
    assert split(staking(1.0).graph, ACTIONS) is None
    branching = ACTIONS.extended(["Branch"], [BranchingNN(2)])
    whole = split(staking(1.0).graph, branching)
    assert whole is not None
    assert int(whole.num_nodes) == 3  # though the graph had no free slot
    wide = split(resized(staking(1.0).graph, 1, 3, 2), branching)
    assert wide is not None
    assert wide.edges[0, 1].tolist() == [0, 2, -1]  # of three outcomes, as others have
    plain = ActionSet(("Linear", "Step"), (LinearNN(2, 1), Step(1)))
    graph = Graphs(
        torch.tensor([[0, 1]]), torch.tensor([[[1, -1], [0, 0]]]), torch.zeros(1, 2, 3),
        torch.zeros(1, dtype=torch.long),
    )  # fmt: skip
    assert split(graph, plain) is None
