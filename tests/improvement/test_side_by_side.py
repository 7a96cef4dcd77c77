"""A search where lanes cost little: everything is tuned at once, with long first steps."""

from dataclasses import replace

import pytest
from lottery import ACTIONS, PaidLottery, staking, tickets
from support import same, seeded
from torch import Generator

from cgtorch.evolution import REWARDS, evolve
from cgtorch.improvement.expected_state import Spent, State
from cgtorch.improvement.pace import BY_ROLLOUT
from cgtorch.improvement.paired_race import Fresh, Holder
from cgtorch.improvement.setup import Budget, Setup
from cgtorch.improvement.side_by_side import SideBySide, lengthened
from cgtorch.improvement.tuning import SAMPLES, Tuning, begun

SMALL = replace(REWARDS, population=24, initial_nodes=(1, 2), capacity=6, lineages=3)


def world(count: int, generator: Generator) -> PaidLottery:
    return PaidLottery(tickets(count, generator))


def search() -> SideBySide:
    setup = Setup(
        actions=ACTIONS, world_of=PaidLottery, imagine=lambda *_: world(0, seeded(0)),
        evolution=SMALL, max_transitions=4, budget=Budget(30, satisfied=9.0),
    )  # fmt: skip
    return SideBySide(setup, Fresh(world, 4, BY_ROLLOUT))


def tuned(stake: float, scenarios: int) -> Tuning:
    found = begun(staking(stake).graph, ACTIONS, scenarios)
    assert found is not None
    return found


def updated(state: State) -> State:
    """The state after one turn of tuning."""
    one = search()
    generation = next(evolve(world(2, seeded(0)), ACTIONS, one.structures, seeded(0)))
    _, second, *_ = one.after(state, generation, seeded(1))
    return second


@pytest.mark.parametrize("scenarios", [8, 9])
def test_the_holder_is_tuned_beside_its_rivals_unless_it_needs_more_scenarios(
    scenarios: int,
) -> None:
    rivals = tuned(0.2, 8), tuned(0.5, 8)
    state = State(
        holder=Holder(staking(1.0)), tuning=tuned(1.0, scenarios), rivals=rivals, settled=True
    )
    after = updated(state)
    assert after.tuning is not None
    counts = [each.distribution.updates for each in (after.tuning, *after.rivals)]
    assert counts == ([1, 1, 1] if scenarios == 8 else [0, 1, 1])
    assert after.spent.episodes >= sum(counts) * SAMPLES * 8


def test_first_steps_are_as_long_as_actions_ask_for() -> None:
    tuning = tuned(1.0, 8)
    size = len(tuning.distribution.mean)
    assert lengthened(tuning).distribution.step == pytest.approx(size**0.5)
    old = replace(tuning, distribution=replace(tuning.distribution, updates=1, step=0.3))
    assert lengthened(old) is old


def test_further_values_of_the_holder_count_beside_earlier_ones() -> None:
    one, skill = search(), staking(1.0)
    assert one.known_better(State(), 5, seeded(1)) == State()
    state = State(holder=Holder(skill, 3.0, 5.0, 2), spent=Spent(generations=1))
    after = one.known_better(state, 5, seeded(1)).holder
    values = one.fresh.of_skills([skill], 5, seeded(1))[0]
    assert after is not None
    assert after.count == 7
    assert after.total == pytest.approx(3 + float(values.sum()))
    assert same(after.skill.graph, skill.graph)
