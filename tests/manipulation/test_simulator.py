"""Segments in simulators: what they do, what is counted, and what the benchmarks say of it."""

from typing import Any

import numpy as np
import pytest
from arms import fetch, meta_world

from cgtorch.manipulation.simulator import CLOSEST, SEEN, SOLVED, STEPS

MW, FETCH = meta_world("push-v3").simulators[0], fetch().simulators[0]


def to(row: np.ndarray, by: tuple[float, float, float], limit: int, near: float = 0.01) -> Any:
    return np.array([*(row[SEEN : SEEN + 3] + by), -1.0, limit, 1.0, near])


@pytest.mark.parametrize("simulator", [MW, FETCH], ids=["Meta-World", "Fetch"])
def test_the_hand_comes_to_its_target_and_stops_there(simulator: Any) -> None:
    row = simulator.start(7)
    control = to(row, (0.05, 0.04, 0.03), 60)
    after = simulator.run(row, 7, control)
    assert np.abs(after[SEEN : SEEN + 3] - control[:3]).max() < 0.02
    assert 3 < after[STEPS] < (60 if simulator is MW else 50)
    longer = simulator.run(row, 7, to(row, (0.05, 0.04, -0.03), 30, near=0.0))
    assert longer[STEPS] == 30


@pytest.mark.parametrize("simulator", [MW, FETCH], ids=["Meta-World", "Fetch"])
def test_an_episode_ends_after_its_steps_and_then_changes_no_more(simulator: Any) -> None:
    row = simulator.start(8)
    after = simulator.run(row, 8, to(row, (0.0, 0.0, 0.0), 10_000, near=0.0))
    assert after[STEPS] == simulator.horizon
    assert simulator.over(after)
    assert simulator.run(after, 8, to(row, (0.1, 0.1, 0.1), 5)) is after


def test_what_was_done_before_is_remembered_and_counted_as_asked() -> None:
    row = MW.start(9)
    controls = [to(row, (0.01 * i, 0.0, 0.0), 5, near=0.0) for i in range(3)]
    before = MW.requested, MW.simulated
    once = [MW.run(row, 9, control) for control in controls]
    again = [MW.run(row, 9, control) for control in controls]
    assert all(one is other for one, other in zip(once, again, strict=True))
    assert (MW.requested - before[0], MW.simulated - before[1]) == (30, 15)


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cgtorch.manipulation.simulator.REMEMBERED", 8)
    row = MW.start(10)
    MW._known.clear()
    for i in range(30):
        MW.run(row, 10, to(row, (0.001 * i, 0.0, 0.0), 1))
        assert len(MW._known) <= 8


def test_a_task_of_meta_world_is_solved_where_its_environment_says_so() -> None:
    """Played once more, step by step, in another environment of the benchmark."""
    import metaworld

    simulator = meta_world("reach-v3").simulators[0]
    row = simulator.start(11)
    goal = row[SEEN + 18 : SEEN + 21]
    actions = list[np.ndarray]()
    move = simulator.move

    def told(action: np.ndarray, last: bool) -> Any:
        actions.append(action)
        return move(action, last)

    simulator.move = told  # type: ignore[method-assign]
    after = simulator.run(row, 11, np.array([*goal, -1.0, 150, 1.0, 0.0]))
    simulator.move = move  # type: ignore[method-assign]
    assert after[SOLVED] == 1
    assert after[CLOSEST] == 1
    assert row[CLOSEST] < 0.5
    other: Any = metaworld.MT1("reach-v3").train_classes["reach-v3"]()
    other._set_task_called, other._partially_observable, other.seeded_rand_vec = True, False, True
    other._freeze_rand_vec = False
    other.seed(11)
    other.reset()
    found = [other.step(action)[4]["success"] for action in actions]
    assert found[-1]
    assert len(actions) == after[STEPS]


def test_a_task_of_fetch_counts_at_the_last_step_only() -> None:
    simulator = fetch("FetchReach-v4").simulators[0]
    row = simulator.start(12)
    goal = row[SEEN + 6 : SEEN + 9]
    there = simulator.run(row, 12, np.array([*goal, -1.0, 20, 1.0, 0.0]))
    assert there[CLOSEST] > 0.8
    assert there[SOLVED] == 0
    stays = simulator.run(there, 12, np.array([*goal, -1.0, 50, 1.0, 0.0]))
    assert (stays[STEPS], stays[SOLVED]) == (50, 1)
    leaves = simulator.run(there, 12, np.array([*goal - 0.2, -1.0, 50, 1.0, 0.0]))
    assert (leaves[STEPS], leaves[SOLVED]) == (50, 0)
    assert leaves[CLOSEST] < 0.6
