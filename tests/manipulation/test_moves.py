"""What a segment does, step by step, with a finger whose way can be told in advance."""

import numpy as np
import pytest
from finger import Finger, Patient, control, place

from cgtorch.manipulation.simulator import CLOSER, CLOSEST, SEEN, SOLVED, STEPS


@pytest.fixture
def finger() -> Finger:
    return Finger()


def test_an_episode_begins_with_nothing_done(finger: Finger) -> None:
    assert (finger.simulated, finger.requested, finger.watch) == (0, 0, None)
    finger.told = 0.25
    row = finger.start(3)
    assert row[:SEEN].tolist() == [0.0, 0.0, 0.25, 0.25, 0.0]
    assert row[SEEN : SEEN + 4].tolist() == [0.0, 0.03, 0.0, 0.0]
    assert len(row) == finger.size == SEEN + 4 + finger.states.size
    assert not finger.over(row)


@pytest.mark.parametrize(
    ("speed", "action"),
    [
        (1.0, [1.0, -0.5, 0.0]), (3.0, [1.0, -0.5, 0.0]), (0.5, [0.5, -0.25, 0.0]),
        (0.0, [0.05, -0.025, 0.0]),
    ],
)  # fmt: skip
def test_the_longest_axis_has_the_speed(speed: float, action: list[float], finger: Finger) -> None:
    finger.run(finger.start(0), 0, control(0.5, -0.25, speed=speed, grip=0.5, limit=1))
    assert finger.actions == [[*action, 0.5]]
    assert finger.lasts == [True]


def test_near_its_target_a_hand_is_slower(finger: Finger) -> None:
    after = finger.run(finger.start(0), 0, control(0.0, 0.0, 0.04, limit=3, near=0.0))
    assert finger.actions == [[0, 0, 0.4, -1], [0, 0, 0.2, -1], [0, 0, 0.1, -1]]
    assert finger.lasts == [False, False, True]
    assert place(after) == [0, 0, 0.035]


@pytest.mark.parametrize(("limit", "steps"), [(-5, 1), (0, 1), (1, 1), (2, 2), (999, 40)])
def test_a_segment_has_a_step_and_no_more_than_are_left(
    limit: float, steps: int, finger: Finger
) -> None:
    after = finger.run(finger.start(0), 0, control(-9.0, limit=limit))
    assert after[STEPS] == len(finger.actions) == steps
    again = finger.run(after, 0, control(-9.0, 1.0, limit=39))
    assert again[STEPS] == min(40, steps + 39)


@pytest.mark.parametrize(
    ("x", "near", "steps"),
    [(-0.04, 0.011, 3), (-0.04, 0.021, 2), (-0.04, 9.0, 2), (0.0, 0.011, 2), (0.0, 0.0, 9)],
)
def test_a_segment_ends_near_its_target_after_two_steps(
    x: float, near: float, steps: int, finger: Finger
) -> None:
    assert finger.run(finger.start(0), 0, control(x, near=near))[STEPS] == steps


@pytest.mark.parametrize(
    ("wall", "speed", "near", "steps"),
    [(0.03, 1.0, 0.01, 6), (0.0, 1.0, 0.01, 5), (0.03, 1.0, 0.0, 9), (9.0, 0.0, 0.01, 9)],
)
def test_a_segment_ends_where_a_hand_is_stopped(
    wall: float, speed: float, near: float, steps: int, finger: Finger
) -> None:
    """It was where it is four steps before; slow as it may be, a hand that moves goes on."""
    finger.wall, finger.goal = wall, -9.0
    assert finger.run(finger.start(0), 0, control(5.0, speed=speed, near=near))[STEPS] == steps


def test_a_task_is_solved_wherever_it_is(finger: Finger) -> None:
    after = finger.run(finger.start(0), 0, control(0.5))
    assert after[: SEEN + 1].tolist() == pytest.approx([2, 1, 1, 1, 2, 0.1])
    assert finger.over(after)
    assert finger.run(after, 0, control(0.5)) is after


def test_it_is_solved_where_that_is_looked_at(finger: Finger) -> None:
    finger.every, finger.width = 3, 0.06
    after = finger.run(finger.start(0), 0, control(0.5, limit=7))
    assert after[: SEEN + 1].tolist() == pytest.approx([3, 1, 0.5, 0.5, 3, 0.15])


def test_a_task_that_counts_at_the_end_goes_on() -> None:
    finger = Patient()
    row = finger.start(0)
    passed = finger.run(row, 0, control(0.5, limit=3))
    assert passed[: SEEN + 1].tolist() == pytest.approx([3, 0, 0.5, 0.5, 3, 0.15])
    there = finger.run(passed, 0, control(0.1, limit=30, near=0.0))
    assert there[: SEEN + 1].tolist() == pytest.approx([33, 0, 1, 1, 33, 0.1])
    assert not finger.over(there)
    stays = finger.run(there, 0, control(0.1, limit=30, near=0.0))
    assert stays[: SEEN + 1].tolist() == pytest.approx([40, 1, 1, 1, 33, 0.1])
    leaves = finger.run(there, 0, control(0.3, limit=30, near=0.0))
    assert leaves[: SEEN + 1].tolist() == pytest.approx([40, 0, 0, 0, 33, 0.3], abs=1e-2)


def test_the_closest_look_counts_and_when_it_was(finger: Finger) -> None:
    finger.width = 0.0  # never solved
    row = finger.start(0)
    near = finger.run(row, 0, control(0.5, limit=1))
    assert near[:SEEN].tolist() == pytest.approx([1, 0, 0.5, 0.5, 1])
    past = finger.run(near, 0, control(0.5, limit=4))
    assert past[:SEEN].tolist() == pytest.approx([5, 0, 0, 1, 5])  # it was there on the way
    away = finger.run(past, 0, control(0.9, limit=2))
    assert away[:SEEN].tolist() == pytest.approx([7, 0, 0, 1, 5])


@pytest.mark.parametrize(("told", "closer"), [(0.005, 0), (0.0051, 9), (0.9, 9)])
def test_hardly_closer_is_no_closer(told: float, closer: int, finger: Finger) -> None:
    finger.goal = -9.0
    row = finger.start(0)
    finger.told = told
    after = finger.run(row, 0, control(0.5))
    assert (after[CLOSEST], after[CLOSER], after[SOLVED]) == (told, closer, 0)


def test_of_many_segments_the_oldest_quarter_is_forgotten(
    finger: Finger, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cgtorch.manipulation.simulator.REMEMBERED", 8)
    row = finger.start(0)
    ways = [control(-0.1 * i, limit=1) for i in range(9)]
    rows = [finger.run(row, 0, way) for way in ways]
    assert (finger.simulated, finger.requested) == (9, 9)
    for way, known in zip(ways[2:], rows[2:], strict=True):
        assert finger.run(row, 0, way) is known
    assert (finger.simulated, finger.requested) == (9, 16)
    again = finger.run(row, 0, ways[1])
    assert np.array_equal(again, rows[1])
    assert finger.simulated == 10


def test_while_it_is_watched_nothing_is_counted(finger: Finger) -> None:
    row, seen = finger.start(0), list[float]()
    known = finger.run(row, 0, control(-0.5, limit=3))
    finger.watch = lambda: seen.append(round(float(finger.hand()[0]), 6))
    after = finger.run(row, 0, control(-0.5, limit=3))
    assert after is not known
    assert np.array_equal(after, known)
    assert seen == [-0.05, -0.1, -0.15]
    assert (finger.simulated, finger.requested) == (3, 3)


def test_a_start_is_that_of_its_seed(finger: Finger) -> None:
    """Whatever happened before; a remembered segment belongs to one seed."""
    ways = [finger.run(finger.start(seed), seed, control(-0.5, 1.0, limit=2)) for seed in (1, 4)]
    assert [place(way) for way in ways] == [[-0.050505, 0.11, 0], [-0.052083, 0.14, 0]]


def test_actions_that_are_tried_go_both_ways_on_each_axis() -> None:
    tried = np.stack([Finger.probing(number) for number in range(24)])
    assert tried.shape == (24, 4)
    assert tried.any(1).all()
    assert (tried.min(0) >= -1).all()
    assert (tried.min(0) < -0.5).all()
    assert (tried.max(0) > 0.5).all()
    assert (tried.max(0) <= 1).all()
