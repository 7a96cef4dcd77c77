"""The autonomous loop where a domain gives rewards and nothing is solved yet."""

from contextlib import nullcontext
from pathlib import Path

import pytest
from support import create_run, same

from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.improvement.events import (
    Event,
    EvolutionRecalled,
    GenerationDone,
    SkillAccepted,
    WorldTested,
)
from cgtorch.runs.goal import Goal
from cgtorch.runs.run import Run, open_run
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.skills import last_skill
from cgtorch.runs.storage import load_progress
from cgtorch.training.auto import train_until
from cgtorch.training.context import Training

pytest.importorskip("gymnasium")

OUT_OF_REACH, EASY = 1e6, 9.0
GOAL = Goal(rounds=2)


def begun(folder: Path, target: float = OUT_OF_REACH) -> Run:
    settings = RunSettings(
        domain="gymnasium:CartPole-v1",
        population=12,
        generations=3,
        attempts=2,
        max_transitions=2000,
    )
    return create_run(folder, settings, GymnasiumSettings("CartPole-v1", target))


def quietly(message: str) -> nullcontext[None]:
    return nullcontext()


def test_the_fittest_individual_is_the_skill_until_one_meets_eq_1(tmp_path: Path) -> None:
    run = begun(tmp_path / "run")
    events: list[Event] = []
    results = train_until(Training(run, events.append, quietly), GOAL)
    assert run.rounds == ("auto-1", "auto-2")
    means = [result["fresh"]["mean_return"] for result in results]
    assert all(1 < mean <= 500 for mean in means)
    assert [result["targets_succeeded"] for result in results] == [0, 0]
    assert [result["skill"] for result in results] == ["auto-1", "auto-2"]
    progress = load_progress(run, run.folder / "auto-2")
    assert progress.specialists is not None
    assert not len(progress.solved)


def test_it_is_the_same_after_an_interruption(tmp_path: Path) -> None:
    """The second evolution is stopped; the first one's individuals are compared by the journal."""
    train_until(Training(begun(tmp_path / "whole"), lambda event: None, quietly), GOAL)
    stopped = begun(tmp_path / "stopped")
    tests, again = 0, list[Event]()

    def stop(event: Event) -> None:
        nonlocal tests
        tests += isinstance(event, WorldTested)
        if tests == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_until(Training(stopped, stop, quietly), GOAL)
    train_until(Training(open_run(stopped.folder), again.append, quietly), GOAL)
    assert any(isinstance(event, EvolutionRecalled) for event in again)
    graphs = [last_skill(tmp_path / name)[1].graph for name in ("whole", "stopped")]
    assert same(*graphs)


def evolved_on(events: list[Event]) -> dict[str, int]:
    """Scenarios of each evolution."""
    done = [event for event in events if isinstance(event, GenerationDone)]
    return {event.candidate: len(event.generation.succeeded) for event in done}


def test_what_reaches_the_target_on_a_few_starts_goes_on_with_more(tmp_path: Path) -> None:
    events: list[Event] = []
    train_until(Training(begun(tmp_path / "easy", EASY), events.append, quietly), Goal(rounds=1))
    first = dict(list(evolved_on(events).items())[:3])
    assert first == {"auto-1.1": 8, "auto-1.1 on 16": 16, "auto-1.1 on 32": 32}
    assert any(isinstance(event, SkillAccepted) for event in events)


def test_what_does_not_reach_it_has_a_few_starts_only(tmp_path: Path) -> None:
    events: list[Event] = []
    train_until(Training(begun(tmp_path / "hard"), events.append, quietly), Goal(rounds=1))
    assert evolved_on(events) == {"auto-1.1": 8, "auto-1.2": 8}


def test_it_is_the_same_after_an_interruption_on_more_starts(tmp_path: Path) -> None:
    goal = Goal(rounds=1)
    train_until(Training(begun(tmp_path / "whole", EASY), lambda event: None, quietly), goal)
    stopped = begun(tmp_path / "stopped", EASY)

    def stop(event: Event) -> None:
        if isinstance(event, GenerationDone) and event.candidate == "auto-1.1 on 16":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_until(Training(stopped, stop, quietly, checkpoint_seconds=0), goal)
    train_until(Training(open_run(stopped.folder), lambda event: None, quietly), goal)
    graphs = [last_skill(tmp_path / name)[1].graph for name in ("whole", "stopped")]
    assert same(*graphs)
