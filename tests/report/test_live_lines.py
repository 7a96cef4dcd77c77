"""The live lines of a terminal: where the run is, and how long it still takes."""

import re
from contextlib import suppress
from dataclasses import replace

import pytest
import torch
from members import nearly
from screens import CHANCE, LOOKS, TRIALS, console, practised, snapshot, text_of

from cgtorch.evolution.fitness import WORST
from cgtorch.improvement.events import (
    EpisodePlayed,
    Event,
    FreshTested,
    GenerationDone,
    JournalDamaged,
    MeanTested,
    ModelsFitted,
    ModelSummary,
    SkillAccepted,
    StageStarted,
    WorldTested,
)
from cgtorch.report import ProgressDisplay
from cgtorch.report.messages import message_of


def test_live_lines_say_where_the_run_is(events: list[Event]) -> None:
    display = ProgressDisplay(console(True))
    assert snapshot(display) == []
    tenth = next(e for e in events if isinstance(e, GenerationDone) and e.generation.number == 9)
    for event in events[: events.index(tenth) + 1]:
        display(event)
    head, bar, numbers = snapshot(display)
    assert head.startswith("S1  stage 2 of 3  W 6, to solve 5  elapsed 0:0")
    assert re.search(r"left ≤ \d+:\d\d$", head)
    assert re.search(r"S1\.1 .* generation 10 of ≤ 45 left ≤ \d:\d\d", bar)
    fitness = tenth.generation.fitness
    assert f"best {float(fitness.max()):.3f} mean {float(fitness.mean()):.3f}" in numbers
    assert f"M {tenth.solved_m}/11" in numbers
    assert "W " not in numbers  # this candidate has none to keep
    assert re.search(r"[\d.]+( k| M)? transitions/s$", numbers)
    for event in events[:-1]:
        display(event)
    assert snapshot(display)[3].startswith("  S1: in the world W ")
    last = [e for e in events if isinstance(e, GenerationDone)][-1]
    assert last.size_w > 0
    assert f"W {last.solved_w}/{last.size_w}  M " in snapshot(display)[2]


@pytest.mark.parametrize("width", [20, 50, 80])
def test_live_lines_do_not_wrap(events: list[Event], width: int) -> None:
    display = ProgressDisplay(console(True, width))
    for event in events[:-1]:
        display(event)
    with display.working("Fitting Γ and C to a great many transitions and labels"):
        lines = snapshot(display, width)
    assert len(lines) == 5
    assert all(len(line) <= width for line in lines)
    assert width > 20 or all(line.endswith("…") for line in lines)


def test_waiting_is_shown_for_as_long_as_it_lasts() -> None:
    display = ProgressDisplay(console(True))
    with display.working("Collecting data"):
        (line,) = snapshot(display)
        assert re.search(r"Collecting data … 0:00", line)
        with suppress(ValueError), display.working("Fitting"):
            assert len(snapshot(display)) == 2
            raise ValueError
        assert len(snapshot(display)) == 1
    assert snapshot(display) == []


def test_accepted_skills_stay_above_the_live_lines(events: list[Event]) -> None:
    with ProgressDisplay(console(True)) as display:
        for event in events:
            display(event)
    shown = text_of(display)
    assert shown.count("S1: accepted; ") == 1
    assert "\x1b[?25l" in shown  # there was a live display
    assert "S1  stage 2 of 3  W 6, to solve 5  elapsed 0:" in shown
    assert "S1: stage 2" not in shown
    assert shown.endswith("\x1b[1A\x1b[2K"), "and nothing of it is left"


def test_how_good_the_first_models_are_stays_above_the_live_lines(
    events: list[Event],
) -> None:
    later = next(e for e in events if isinstance(e, ModelsFitted))
    assert later.stage == "S1"
    with ProgressDisplay(console(terminal=True)) as display:
        learned = ModelSummary("Γ was trained on more data; C was trained on more data")
        for event in (replace(later, stage="start"), replace(later, summary=learned)):
            display(event)
    shown = text_of(display)
    assert "start: Γ errs by " in shown
    assert "S1: " not in shown


def test_the_display_is_taken_away_when_a_run_fails(events: list[Event]) -> None:
    display = ProgressDisplay(console(True))
    with suppress(KeyboardInterrupt), display:
        display(events[0])
        raise KeyboardInterrupt
    assert "\x1b[?25h" in text_of(display)  # the cursor is back


def test_what_an_unfinished_episode_is_worth_is_on_no_line(events: list[Event]) -> None:
    told = next(e for e in events if isinstance(e, GenerationDone))

    def shown(fitness: list[float]) -> str:
        display = ProgressDisplay(console(True))
        values = torch.tensor(fitness)
        generation = replace(told.generation, fitness=values, best=float(values.max()))
        for event in (events[0], replace(told, generation=generation)):
            display(event)
        return snapshot(display)[2]

    assert "fitness best -2.000 mean -3.000  M " in shown([-4.0, -2.0, WORST, WORST / 1000])
    assert "fitness best – mean –  M " in shown([WORST, WORST / 1000])


def test_on_a_terminal_only_chance_stays_above_the_live_lines(events: list[Event]) -> None:
    with ProgressDisplay(console(True, width=300)) as display:
        display(events[0])
        for event in (TRIALS, LOOKS):
            display(event)
            assert snapshot(display, 300)[-1] == f"  {message_of(TRIALS)}"
        display(practised(3))
        assert snapshot(display, 300)[-1] == f"  {message_of(practised(3))}"
        display(CHANCE)
        assert snapshot(display, 300)[-1] == f"  {message_of(practised(3))}"
        display(events[0])  # the next stage
        assert len(snapshot(display, 300)) == 1
    assert text_of(display).count(message_of(CHANCE)) == 1
    assert "S1: stage 2" not in text_of(display)


def test_long_work_shows_how_much_is_done_how_fast_and_what_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    display = ProgressDisplay(console(True))
    display.counted("grasps in physics", 0, 1200)
    assert snapshot(display) == ["  grasps in physics: 0 of 1,200"]
    clock[0] += 20
    display.counted("labels", 0, 50)
    display.counted("grasps in physics", 300, 1200)
    line = "  grasps in physics: 300 of 1,200, 15/s, left 1:00"
    assert snapshot(display) == ["  labels: 0 of 50", line]
    display.counted("labels", 50, 50)
    assert snapshot(display) == [line]
    display.counted("grasps in physics", 0, 10)  # others
    assert snapshot(display) == ["  grasps in physics: 0 of 10"]


def test_what_is_left_is_told_until_the_skill_is_accepted(
    events: list[Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    display = ProgressDisplay(console(True))
    first = next(e for e in events if isinstance(e, GenerationDone))
    began, told = (
        replace(first, generation=replace(first.generation, number=n), limit=40, seconds=2.0)
        for n in (0, 9)
    )
    display(StageStarted("S1", ("S0", "S1"), 6, 5, attempts=3))
    assert snapshot(display) == ["S1  stage 2 of 2  W 6, to solve 5  elapsed 0:00"]
    display(began)
    display(told)
    head, bar, _ = snapshot(display)
    assert head.endswith("left ≤ 3:40"), "30 generations here, and two evolutions of 80 s"
    assert bar.endswith("generation 10 of ≤ 40 left ≤ 1:00")
    assert bar.startswith("  S1.1 ")
    assert bar.count("━") == 24 * 10 // 40
    display(WorldTested("S1", "S1.1", 6, 6, 3, 5))
    head, bar, _, world = snapshot(display)
    assert (head[-11:], bar[-11:]) == ("left ≤ 2:40", "left ≤ 0:00")
    assert world == "  S1.1: in the world W 6/6, M 3/5"
    display(next(e for e in events if isinstance(e, SkillAccepted)))
    assert snapshot(display)[0].endswith("left ≤ 0:00")


@pytest.mark.parametrize(
    ("executed", "text"),
    [
        (412, "412 transitions/s"),
        (999, "999 transitions/s"),
        (1000, "1 k transitions/s"),
        (9123, "9.12 k transitions/s"),
        (1_000_000, "1 M transitions/s"),
        (1_300_000, "1.3 M transitions/s"),
    ],
)
def test_a_speed_has_three_digits(events: list[Event], executed: int, text: str) -> None:
    first = next(e for e in events if isinstance(e, GenerationDone))
    generation = replace(first.generation, executed=executed, not_finite=0)
    display = ProgressDisplay(console(True))
    display(replace(first, generation=generation, seconds=1.0))
    assert snapshot(display)[1].endswith(f"  M {first.solved_m}/{first.size_m}  {text}")
    display(replace(first, generation=replace(generation, not_finite=3), seconds=1.0))
    assert snapshot(display)[1].endswith(f"  not finite 3  {text}")


def test_what_must_not_be_missed_stays_above_the_live_lines() -> None:
    display = ProgressDisplay(console(True, 300))
    told = [
        JournalDamaged("S1", ("a.json",)),
        FreshTested("S1", "S1", 30, 40, 0.9, decisive=False),
        EpisodePlayed("auto-1", "curious", 1.5, 200, 12345),
    ]
    for event in told:
        display(event)
    mean = MeanTested("S1", nearly(0.5), True, 2.5, 0.1, 10, 12, 40)
    display(mean)
    assert text_of(display).splitlines() == [message_of(event) for event in told]
    assert snapshot(display) == [f"  {message_of(mean)}"]
