"""How long a run still takes: a bound, from speeds that are smoothed."""

from dataclasses import replace

import pytest

from cgtorch.improvement.events import Event, GenerationDone, StageStarted
from cgtorch.report.progress import Estimate, count_text


class Clock:
    """Tells the time that it is set to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture(scope="module")
def first(events: list[Event]) -> GenerationDone:
    return next(e for e in events if isinstance(e, GenerationDone))


def generation(
    first: GenerationDone, number: int, seconds: float = 2.0, executed: int = 1000
) -> GenerationDone:
    """A generation of an evolution of at most 20."""
    made = replace(first.generation, number=number, executed=executed)
    return replace(first, generation=made, limit=20, seconds=seconds)


def test_an_evolution_without_a_stage_is_all_that_is_left(first: GenerationDone) -> None:
    estimate = Estimate(Clock())
    estimate.generation_done(generation(first, 4))
    assert estimate.run_left == estimate.evolution_left == pytest.approx(15 * 2)


def test_speeds_are_smoothed_and_mostly_of_the_past(first: GenerationDone) -> None:
    estimate = Estimate(Clock())
    assert estimate.speed is None
    estimate.generation_done(generation(first, 0))
    estimate.generation_done(generation(first, 1, seconds=4.0, executed=4000))
    assert estimate.speed == pytest.approx(0.9 * 500 + 0.1 * 1000)
    assert estimate.evolution_left == pytest.approx(18 * (0.9 * 2 + 0.1 * 4))


def test_a_generation_that_took_no_time_is_no_error(first: GenerationDone) -> None:
    estimate = Estimate(Clock())
    estimate.generation_done(generation(first, 0, seconds=0.0))
    assert estimate.speed is not None
    assert estimate.speed > 1e9
    assert estimate.evolution_left == pytest.approx(0, abs=1e-6)


def test_the_longest_pause_between_evolutions_counts_for_all(
    events: list[Event], first: GenerationDone
) -> None:
    clock = Clock()
    estimate = Estimate(clock)
    started = events[0]
    assert isinstance(started, StageStarted)  # with four attempts, and one stage after it
    estimate.stage_started(started)
    for pause in (0.0, 7.0, 3.0):
        clock.now += pause + 2.0
        estimate.generation_done(generation(first, 0))
    estimate.evolution_over()
    assert estimate.run_left == pytest.approx((1 + 4) * (20 * 2 + 7))


def test_a_stage_begins_with_all_of_its_attempts(
    events: list[Event], first: GenerationDone
) -> None:
    """What lies between two stages is no pause between evolutions."""
    clock = Clock()
    estimate = Estimate(clock)
    started = events[0]
    assert isinstance(started, StageStarted)
    estimate.stage_started(started)
    estimate.generation_done(generation(first, 0))
    estimate.evolution_over()
    estimate.stage_over()
    assert estimate.run_left == pytest.approx(4 * 20 * 2)
    estimate.stage_started(replace(started, stage="S2"))
    assert estimate.run_left == pytest.approx(4 * 20 * 2)
    clock.now += 500.0
    estimate.generation_done(generation(first, 0))
    assert estimate.run_left == pytest.approx((19 + 3 * 20) * 2)


@pytest.mark.parametrize(
    ("done", "seconds", "text"),
    [
        (0, 10.0, "0 of 1,200"),
        (3, 0.0, "3 of 1,200"),
        (300, 20.0, "300 of 1,200, 15/s, left 1:00"),
        (1200, 20.0, "1,200 of 1,200, 60/s, left 0:00"),
    ],
)
def test_how_much_is_done_how_fast_and_what_is_left(done: int, seconds: float, text: str) -> None:
    assert count_text(done, 1200, seconds) == text


def test_time_left_is_a_bound(events: list[Event]) -> None:
    now = 100.0
    estimate = Estimate(clock=lambda: now)
    started = events[0]
    assert isinstance(started, StageStarted)
    first = next(e for e in events if isinstance(e, GenerationDone))
    assert estimate.run_left is None
    estimate.stage_started(started)  # S1 of S0, S1, S2, 4 attempts
    assert estimate.evolution_left is None
    for number in range(5):
        now += 2.0
        generation = replace(first.generation, number=number, executed=1000)
        estimate.generation_done(replace(first, generation=generation, limit=20, seconds=2.0))
    assert estimate.speed == pytest.approx(500)
    assert estimate.evolution_left == pytest.approx(15 * 2)
    # 15 generations here, three more attempts, and four in the last stage.
    assert estimate.run_left == pytest.approx(30 + 3 * 40 + 4 * 40)
    estimate.evolution_over()
    assert estimate.evolution_left == 0
    now += 7.0 + 2.0  # seven seconds between two evolutions
    estimate.generation_done(
        replace(first, generation=replace(first.generation, number=0), limit=20, seconds=2.0)
    )
    assert estimate.run_left == pytest.approx(19 * 2 + 6 * 47)
    estimate.evolution_over()
    estimate.stage_over()
    assert estimate.run_left == pytest.approx(4 * 47)
