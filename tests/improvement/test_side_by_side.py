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


def test_all_have_a_turn_unless_any_rival_needs_fewer_scenarios_or_there_is_nobody_else() -> None:
    one, few, many = tuned(1.0, 9), tuned(0.2, 8), tuned(0.5, 10)
    spent = Spent(rivals=10)  # so that the holder's tuning is behind
    for tuning, rivals, turn in (
        (one, (many, few), (one,)),
        (one, (many, many), (many, many, one)),
        (one, (), (one,)),
        (None, (many, few), (many, few)),
        (None, (), ()),
    ):
        assert search()._turn(State(tuning=tuning, rivals=rivals, spent=spent)) == turn


def test_what_begins_to_be_tuned_has_long_first_steps() -> None:
    one = search()
    generation = next(evolve(world(2, seeded(0)), ACTIONS, one.structures, seeded(0)))
    state = one._with_rivals(State(), generation)
    assert state.tuning is not None
    for each in (state.tuning, *state.rivals):
        about = each.distribution
        assert about.step == pytest.approx(len(about.mean) ** 0.5)
    later = one._with_rivals(State(), replace(generation, number=1))
    assert later.tuning is None
    assert {each.distribution.step > 1 for each in later.rivals} == {True}


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
