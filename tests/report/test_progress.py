import io
import re
import time
from contextlib import suppress
from dataclasses import replace

import pytest
import torch
from members import nearly
from rich.console import Console

from cgtorch.domains.knowledge import Knowledge, summary_of
from cgtorch.evolution.fitness import WORST
from cgtorch.ground.asked import Asked, Purse
from cgtorch.ground.statistics import Acceptance
from cgtorch.improvement.events import (
    ChanceFound,
    Event,
    FreshTested,
    GenerationDone,
    MeanTested,
    ModelsFitted,
    ModelSummary,
    Practised,
    SkillAccepted,
    StageFailed,
    StageStarted,
    WorldAsked,
)
from cgtorch.report import ProgressDisplay
from cgtorch.report.messages import asked_of, message_of
from cgtorch.report.progress import Estimate


def console(terminal: bool, width: int = 100) -> Console:
    return Console(file=io.StringIO(), force_terminal=terminal, width=width, color_system=None)


def text_of(display: ProgressDisplay) -> str:
    assert isinstance(display.console.file, io.StringIO)
    return display.console.file.getvalue()


def snapshot(display: ProgressDisplay, width: int = 100) -> list[str]:
    """The live lines as they stand."""
    screen = console(False, width)
    screen.print(display.live_lines())
    assert isinstance(screen.file, io.StringIO)
    return [line.rstrip() for line in screen.file.getvalue().splitlines()]


def test_what_models_have_learned_is_told(events: list[Event], knowledge: Knowledge) -> None:
    fitted = next(e for e in events if isinstance(e, ModelsFitted))
    said = Acceptance(True, 20, 0.02, 0.01, 0.001), Acceptance(False, 20, 0.03, 0.04, 0.001)
    learned = replace(knowledge, acceptances=said)
    assert message_of(replace(fitted, summary=summary_of(learned))).startswith(
        "S1: Γ was trained on more data; C stays as it was, since its error on earlier data would "
        "be 0.0400 instead of 0.0300; now from 120 transitions"
    )


def test_plain_lines_one_for_each_event_that_matters(events: list[Event]) -> None:
    with ProgressDisplay(console(False)) as display:
        for event in events:
            display(event)
        with display.working("Collecting data"):
            pass
    lines = text_of(display).splitlines()
    assert len(lines) == sum(not isinstance(e, GenerationDone) for e in events) + 1
    assert lines[0] == "S1: stage 2 of 3, 6 scenarios to keep (W), 5 to solve"
    assert re.fullmatch(
        r"S1: Γ errs by .* m on .*, the balanced accuracy of C is \d+\.\d %; "
        r"120 transitions and \d+ labels, 1\.5 s",
        lines[1],
    )
    assert re.fullmatch(
        r"S1\.1: in the world W \d/6, M \d/5(; not accepted.*)?",
        lines[2],
    )
    assert lines[-3] == "S1: 30 of 40 fresh scenarios = 75.0%, the goal is 0.9"
    accepted = events[-1]
    assert isinstance(accepted, SkillAccepted)
    targets = int(accepted.succeeded[6:].sum())
    w = int(accepted.succeeded[:6].sum())
    assert lines[-2] == (f"S1: accepted; W {w}/6, M {targets}/5, 3 nodes in 2 levels, 1:02")
    assert lines[-1] == "Collecting data …"
    assert "\x1b" not in text_of(display)
    some = accepted.targets.clone()
    some[6] = False  # a scenario to practise on, which is no test of the stage
    tests = int(accepted.succeeded[some].sum())
    assert message_of(replace(accepted, targets=some)).startswith(
        f"S1: accepted; tests {tests}/4, W {w}/6, M {targets}/5, "
    )


@pytest.mark.parametrize("terminal", [True, False])
@pytest.mark.parametrize(("seconds", "said"), [(24, False), (26, True)])
def test_a_long_evolution_is_heard_of_where_there_is_no_terminal(
    events: list[Event], monkeypatch: pytest.MonkeyPatch, seconds: float, said: bool, terminal: bool
) -> None:
    """Before half a minute is over, if nothing else is said."""
    now = 100.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    display = ProgressDisplay(console(terminal))
    generation = next(e for e in events if isinstance(e, GenerationDone))
    display.say("begun")
    for _ in range(2):
        now += seconds
        display(generation)
        display(generation)
    lines = [line for line in text_of(display).splitlines() if "generation" in line]
    assert len(lines) == (2 * said or 1) * (not terminal)
    wanted = f"{generation.candidate}: generation {generation.generation.number + 1} of"
    assert all(line.startswith(wanted) and "fitness best" in line for line in lines)


@pytest.mark.parametrize("terminal", [True, False])
def test_a_stage_that_fails_is_told_of(terminal: bool) -> None:
    with ProgressDisplay(console(terminal)) as display:
        display(StageFailed("S1", 4))
    said = "S1: no skill keeps W and solves more after 4 attempts; the stage comes back if another"
    assert said in text_of(display).replace("\n", " ")


@pytest.mark.parametrize("models", [True, False])
@pytest.mark.parametrize(("solved", "said"), [(2, True), (3, False)])
def test_it_is_told_once_that_little_succeeds(
    events: list[Event], solved: int, said: bool, models: bool
) -> None:
    """If there are models, whose fault it may be."""
    said &= models
    with ProgressDisplay(console(False)) as display:
        if models:
            display(next(e for e in events if isinstance(e, ModelsFitted)))
        display(WorldAsked("S1", "exploration", Asked(90, 90)))
        display(WorldAsked("S1", "other noise", Asked(90, 90, 90, 90), 90))
        for _ in range(6):
            display(WorldAsked("S1", "practice", Asked(20, 12, 12, 12), solved))
    hint = "of 36 episodes that skills were evolved for, 6 succeeded in the world: Γ or C is wrong"
    assert text_of(display).count(hint) == int(said)
    assert text_of(display).count("When it does not learn") == int(said)


def test_a_long_line_is_not_broken_where_there_is_no_terminal(events: list[Event]) -> None:
    with ProgressDisplay(console(False, width=30)) as display:
        for event in events[:2]:
            display(event)
    assert len(text_of(display).splitlines()) == 2


@pytest.mark.parametrize("terminal", [True, False])
def test_quiet_prints_nothing(events: list[Event], terminal: bool) -> None:
    with ProgressDisplay(console(terminal), quiet=True) as display:
        for event in events:
            display(event)
        with display.working("Collecting data"):
            display.say("a line")
    assert text_of(display) == ""


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
    assert "S1: stage 2" not in shown


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


def test_a_round_without_a_new_skill_says_which_one_was_tested() -> None:
    tested = FreshTested("auto-5", "auto-4", 390, 400, 0.99, decisive=False)
    assert message_of(tested) == (
        "auto-5: no skill was accepted; auto-4 was tested again, 390 of 400 fresh scenarios = "
        "97.5%, the goal is 0.99"
    )
    final = replace(tested, decisive=True)
    assert message_of(final).startswith("auto-5: final test, 390 of 400 fresh scenarios")
    own = replace(tested, skill="auto-5")
    assert message_of(own).startswith("auto-5: 390 of 400 fresh scenarios")


TRIALS = WorldAsked("S1", "trials", Asked(68, 19, 18, 18), succeeded=17)
LOOKS = WorldAsked("S1", "looks", Asked(looks=69))
CHANCE = ChanceFound("S1", 12, 30)


def practised(in_a_row: int) -> Practised:
    return Practised("S1", nearly(0.5), in_a_row, 24)


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (TRIALS, "S1: trials: 68 motions and 19 tests, 17 of 18 succeeded"),
        (replace(TRIALS, recalled=True), "S1: trials: 68 motions and 19 tests, 17 of 18 succeeded"),
        (
            WorldAsked("start", "exploration", Asked(84, 65, 14)),
            "start: exploration: 84 motions and 65 tests",
        ),
        (
            WorldAsked("S1", "practice", Asked(0, 0, 1, 1)),
            "S1: practice: 0 motions and 0 tests, 0 of 1 succeeded",
        ),
        (LOOKS, ""),  # percepts that were only looked at take a robot no time
        (practised(7), "ahead 0.5: 7 of 24 fresh scenarios solved in a row"),
        (
            CHANCE,
            "S1: under other noise the same skill solves 40% of the 30 scenarios that it solved: "
            "this world is chance; from now on skills are evolved in it on fresh scenarios, and "
            "means count (--chance no overrules it)",
        ),
        (
            MeanTested("S1", nearly(0.5), True, 2.8567, 0.0104, 4096, 12, 123456),
            "S1: mean 2.86 ± 0.02 on 4,096 fresh episodes; 12 in each generation, 123,456 played",
        ),
        (
            MeanTested("S1", nearly(0.5), True, None, None, 0, 4, 192),
            "S1: mean – on 0 fresh episodes; 4 in each generation, 192 played",
        ),
        (
            FreshTested("auto-2", "auto-2", 5, 16384, 3.0, True, 2.8567, 0.0104),
            "auto-2: final test, mean return 2.86 ± 0.02 on 16384 fresh episodes, the goal is 3",
        ),
    ],
)
def test_messages(event: Event, message: str) -> None:
    assert message_of(event) == message


def test_without_a_terminal_what_was_asked_is_a_line_each() -> None:
    with ProgressDisplay(console(False)) as display:
        for event in (LOOKS, TRIALS, practised(3), CHANCE):
            display(event)
    told = [message_of(event) for event in (TRIALS, practised(3), CHANCE)]
    assert text_of(display).splitlines() == told


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


def test_all_that_was_asked_is_summed_up_with_the_time_it_takes_a_robot() -> None:
    purse = Purse()
    purse.add("exploration", Asked(84, 65, 14))
    purse.add("looks", Asked(looks=69))
    purse.add("trials", Asked(61, 30, 20, 20))
    assert asked_of("world", purse) == (
        "asked of the world: 145 motions, 95 tests, 2.0 h at 30 s (exploration 149, trials 91); "
        "103 scenes were looked at"
    )


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


def test_work_is_heard_of_where_there_is_no_terminal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    display = ProgressDisplay(console(False))
    for done in range(0, 101, 2):
        display.counted("grasps", done, 100)
        clock[0] += 3
    lines = text_of(display).splitlines()
    assert lines == [
        "grasps: 18 of 100, 0.667/s, left 2:03",
        "grasps: 36 of 100, 0.667/s, left 1:36",
        "grasps: 54 of 100, 0.667/s, left 1:09",
        "grasps: 72 of 100, 0.667/s, left 0:42",
        "grasps: 90 of 100, 0.667/s, left 0:15",
    ]


def test_without_a_terminal_there_is_a_line_wherever_nothing_is_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("cgtorch.report.progress.SILENCE", 0.5)
    with ProgressDisplay(console(False)) as display:
        display(StageStarted("S1", ("S0", "S1"), 0, 3, 24))
        with display.working("fitting"):
            time.sleep(2.5)
    assert "S1, fitting, 0:0" in text_of(display)
