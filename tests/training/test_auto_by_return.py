"""The autonomous loop where a domain gives rewards and nothing is solved yet."""

from contextlib import nullcontext
from pathlib import Path

import pytest
from support import same

from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.improvement.events import Event, EvolutionRecalled, WorldTested
from cgtorch.runs.goal import Goal
from cgtorch.runs.run import Run, create_run, open_run
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.skills import last_skill
from cgtorch.runs.storage import load_progress
from cgtorch.training.auto import train_until
from cgtorch.training.context import Training

pytest.importorskip("gymnasium")

OUT_OF_REACH = 1e6
GOAL = Goal(rounds=2)


def begun(folder: Path) -> Run:
    settings = RunSettings(
        domain="gymnasium:CartPole-v1",
        population=12,
        generations=3,
        attempts=2,
        max_transitions=1000,
    )
    return create_run(folder, settings, GymnasiumSettings("CartPole-v1", OUT_OF_REACH))


def quietly(message: str) -> nullcontext[None]:
    return nullcontext()


def test_the_fittest_individual_is_the_skill_until_one_meets_eq_1(tmp_path: Path) -> None:
    run = begun(tmp_path / "run")
    events: list[Event] = []
    results = train_until(Training(run, events.append, quietly), GOAL)
    assert run.rounds == ("auto-1", "auto-2")
    means = [result["fresh"]["mean_return"] for result in results]
    assert all(1 < mean < 500 for mean in means)
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
