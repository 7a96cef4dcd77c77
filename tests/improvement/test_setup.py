"""When an evolution ends, and what a stage does unless it is told otherwise."""

from dataclasses import replace

import pytest
import torch
from members import nearly
from reaching import in_the_world
from support import random_graphs, seeded
from watched import Watched, keys, state_of

from cgtorch.evolution import Population, initial_strategy
from cgtorch.graphs import compacted
from cgtorch.improvement.checkpoint import Found
from cgtorch.improvement.improve import without_chance
from cgtorch.improvement.setup import Budget, Setup
from cgtorch.improvement.state import Candidate
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world import random_scenarios

BUDGET = Budget(generations=50, patience=5, stall=9, enough=0.9, satisfied=0.7, transitions=1000.0)
ONE = Population(compacted(random_graphs(0, 1, paper_actions())), initial_strategy(1))
ALL, SOME = torch.ones(3, dtype=torch.bool), torch.arange(3) > 0
BEGUN = Found(ONE, SOME, 0.1, since=1, generations=4, transitions=30)


@pytest.mark.parametrize(
    ("found", "almost"),
    [
        (replace(BEGUN, solved=ALL, best=0.9), {"best": 0.89}),
        (replace(BEGUN, solved=ALL, best=0.9), {"solved": SOME}),
        (replace(BEGUN, solved=ALL, since=5), {"since": 4}),
        (replace(BEGUN, solved=ALL, since=5), {"solved": SOME}),
        (replace(BEGUN, best=0.7, since=5), {"best": 0.69}),
        (replace(BEGUN, best=0.7, since=5), {"since": 4}),
        (replace(BEGUN, since=9), {"since": 8}),
        (replace(BEGUN, generations=50), {"generations": 49}),
        (replace(BEGUN, transitions=1000), {"transitions": 999}),
    ],
)
def test_an_evolution_ends_at_each_of_its_limits_and_not_before(
    found: Found, almost: dict[str, object]
) -> None:
    assert BUDGET.ends(found)
    assert not BUDGET.ends(replace(found, **almost))  # type: ignore[arg-type]


def test_a_stage_tries_nothing_under_other_noise_unless_that_is_possible() -> None:
    scenarios, watched = random_scenarios("near", 5, seeded(0)), Watched()
    about = {"keep": torch.ones(5, dtype=torch.bool), "current": Candidate(nearly(0.3))}
    state = state_of(scenarios, (), **about)
    setup = Setup(actions=paper_actions(), world_of=watched, imagine=in_the_world)
    assert without_chance(setup, state) is state
    assert not watched.log
    assert without_chance(replace(setup, noisy=True), state).judged is state.current
    (other,) = watched.log
    assert other.keys[0] not in keys(scenarios)
