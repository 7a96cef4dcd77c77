"""The lines of a display where there is no terminal, and what all displays print."""

import re
import threading
import time
from dataclasses import replace

import pytest
from members import nearly
from screens import console, snapshot, text_of

from cgtorch.domains.surroundings import surroundings
from cgtorch.ground.asked import Asked
from cgtorch.improvement.events import (
    ChanceFound,
    Event,
    GenerationDone,
    JournalDamaged,
    MeanTested,
    ModelsFitted,
    Practised,
    SkillAccepted,
    StageFailed,
    StageStarted,
    WorldAsked,
)
from cgtorch.report import ProgressDisplay
from cgtorch.report.messages import message_of


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
@pytest.mark.parametrize(("seconds", "said"), [(24, False), (25, True)])
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


def test_it_is_told_where_thirty_episodes_are_reached(events: list[Event]) -> None:
    with ProgressDisplay(console(False)) as display:
        display(next(e for e in events if isinstance(e, ModelsFitted)))
        for _ in range(4):
            display(WorldAsked("S1", "trials", Asked(20, 12, 0, 15), 1))
    assert text_of(display).count("succeeded in the world") == 1
    assert "of 30 episodes that skills were evolved for, 2 succeeded" in text_of(display)


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


TRIALS = WorldAsked("S1", "trials", Asked(68, 19, 18, 18), succeeded=17)
LOOKS = WorldAsked("S1", "looks", Asked(looks=69))
CHANCE = ChanceFound("S1", 12, 30)


def practised(in_a_row: int) -> Practised:
    return Practised("S1", nearly(0.5), in_a_row, 24)


def test_without_a_terminal_what_was_asked_is_a_line_each() -> None:
    with ProgressDisplay(console(False)) as display:
        for event in (LOOKS, TRIALS, practised(3), CHANCE):
            display(event)
    told = [message_of(event) for event in (TRIALS, practised(3), CHANCE)]
    assert text_of(display).splitlines() == told


def test_work_is_heard_of_where_there_is_no_terminal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    display = ProgressDisplay(console(False))
    for done in range(0, 101, 2):
        display.counted("grasps", done, 100)
        clock[0] += 2.5
    lines = text_of(display).splitlines()
    assert lines == [
        "grasps: 20 of 100, 0.8/s, left 1:40",
        "grasps: 40 of 100, 0.8/s, left 1:15",
        "grasps: 60 of 100, 0.8/s, left 0:50",
        "grasps: 80 of 100, 0.8/s, left 0:25",
    ]


def test_work_that_does_not_go_on_is_told_to_be_slow(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    display = ProgressDisplay(console(False))
    display.counted("episodes", 0, 20)
    clock[0] += 0.1
    display.counted("episodes", 10, 20)
    clock[0] += 99.9
    assert display._present().startswith("episodes: 10 of 20, 0.1/s, left 1:40, ")


def test_without_a_terminal_there_is_a_line_wherever_nothing_is_said(
    monkeypatch: pytest.MonkeyPatch, events: list[Event]
) -> None:
    monkeypatch.setattr("cgtorch.report.progress.SILENCE", 0.1)
    monkeypatch.setattr("cgtorch.report.progress.LOOKED", 0.01)
    with ProgressDisplay(console(False)) as display:
        time.sleep(0.2)
        display(StageStarted("S1", ("S0", "S1"), 0, 3, 24))
        display(next(e for e in events if isinstance(e, GenerationDone)))
        time.sleep(0.2)
        with display.working("collecting"), display.working("fitting"):
            time.sleep(0.2)
    lines = text_of(display).splitlines()
    said = r"0:.. elapsed", r"S1, S1\.1, generation 1, 0:.. elapsed", r"S1, fitting, 0:.. elapsed"
    heard = [[line for line in lines if re.fullmatch(each, line)] for each in said]
    assert all(1 <= len(each) <= 5 for each in heard)
    assert sum(map(len, heard)) == len(lines) - 3, "the others are those of events"


@pytest.mark.parametrize("terminal", [True, False])
def test_a_step_that_does_not_return_is_named(
    monkeypatch: pytest.MonkeyPatch, terminal: bool
) -> None:
    monkeypatch.setattr("cgtorch.report.progress.SILENCE", 0.0)
    display = ProgressDisplay(console(terminal))

    def shown() -> str:
        with display.console.capture() as caught:
            display.console.print(display.live_lines() if terminal else display._present())
        return caught.get()

    text = surroundings.call(shown, lambda: "environment 'Slow-v0' in step 3 after reset(seed=0)")
    assert "'Slow-v0' in step 3 after reset(seed=0) has not returned for 0 s" in text
    assert "returned" not in shown()


def test_nothing_is_said_of_silence_before_it_lasts_nor_after_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("cgtorch.report.progress.LOOKED", 0.01)
    others = {*threading.enumerate()}
    display = ProgressDisplay(console(False))
    for _ in range(2):  # as it can be used again
        with display:
            (looking,) = {*threading.enumerate()} - others
            assert looking.daemon, "a program does not wait for it"
            time.sleep(0.1)
            assert looking.is_alive()
        looking.join(5)
        assert not looking.is_alive()
    assert text_of(display) == ""


def test_time_counts_from_where_the_display_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    display = ProgressDisplay(console(False), quiet=True)
    clock[0] += 50
    with display:
        clock[0] += 7
        display(StageStarted("S1", ("S0", "S1"), 0, 3, 24))
        assert snapshot(display) == ["S1  stage 2 of 2  W 0, to solve 3  elapsed 0:07"]


def test_lines_go_to_standard_error_and_have_colours_by_what_they_tell(
    capsys: pytest.CaptureFixture[str], events: list[Event]
) -> None:
    ProgressDisplay().say("a line")
    assert capsys.readouterr() == ("", "a line\n")
    display = ProgressDisplay(console(True, 300, coloured=True))
    accepted = next(e for e in events if isinstance(e, SkillAccepted))
    told = {StageFailed("S1", 4): 33, CHANCE: 33, accepted: 32, JournalDamaged("S1", ("a",)): 0}
    for event in told:
        display(event)
    display(next(e for e in events if isinstance(e, ModelsFitted)))
    display(WorldAsked("S1", "practice", Asked(20, 12, 0, 40)))
    lines = text_of(display).splitlines()
    for line, colour in zip(lines, (33, 33, 32, 0, 0, 33), strict=True):
        assert line.startswith(f"\x1b[{colour}m") == bool(colour)


def test_a_search_by_means_is_heard_of_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    display = ProgressDisplay(console(False))
    means = [MeanTested("S1", nearly(0.5), True, i / 2, 0.1, 10, 12, 40) for i in range(5)]
    for event in means:
        display(event)
        clock[0] += 12.5
    assert text_of(display).splitlines() == [message_of(means[2]), message_of(means[4])]
    assert snapshot(display) == [f"  {message_of(means[4])}"]
