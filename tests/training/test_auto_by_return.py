"""The autonomous loop where a domain gives rewards, before and after something is solved."""

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from support import create_run, same

from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.ground.asked import Asked
from cgtorch.improvement.events import (
    Event,
    EvolutionRecalled,
    GenerationDone,
    Practised,
    SkillAccepted,
    WorldAsked,
    WorldTested,
)
from cgtorch.runs.chosen import last_skill
from cgtorch.runs.settings import Goal, RunSettings
from cgtorch.runs.storage import load_progress
from cgtorch.runs.stored_run import StoredRun, read_run
from cgtorch.training.auto import train_until
from cgtorch.training.context import Training

pytest.importorskip("gymnasium")

OUT_OF_REACH, EASY = 1e6, 9.0
ROUND = Goal(rounds=1)


def begun(folder: Path, target: float = OUT_OF_REACH) -> StoredRun:
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
    results = train_until(Training(run, events.append, quietly), Goal(rounds=2))
    assert run.rounds == ("auto-1", "auto-2")
    means = [result["fresh"]["mean_return"] for result in results]
    assert all(1 < mean <= 500 for mean in means)
    assert [result["targets_succeeded"] for result in results] == [0, 0]
    assert [result["skill"] for result in results] == ["auto-1", "auto-2"]
    progress = load_progress(run, run.folder / "auto-2")
    assert progress.specialists is not None
    assert not len(progress.solved)


Made = tuple[StoredRun, list[Event], list[dict[str, Any]]]


@pytest.fixture(scope="module", params=[OUT_OF_REACH, EASY], ids=["out of reach", "easy"])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """A round that nothing interrupts, for a target that it cannot reach and for one it can."""
    run, events = begun(tmp_path_factory.mktemp("whole") / "run", request.param), list[Event]()
    return run, events, train_until(Training(run, events.append, quietly), ROUND)


@pytest.mark.parametrize(("kind", "number"), [(GenerationDone, 3), (WorldTested, 1)])
def test_it_is_the_same_after_an_interruption(
    whole: Made, tmp_path: Path, kind: type[Event], number: int
) -> None:
    """What the journal has is neither evolved nor asked of the world again."""
    run, events, results = whole
    stopped = begun(tmp_path / "stopped", run.domain.target_return)
    met, again = 0, list[Event]()

    def stop(event: Event) -> None:
        nonlocal met
        met += isinstance(event, kind)
        if met == number:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_until(Training(stopped, stop, quietly, checkpoint_seconds=0), ROUND)
    found = train_until(Training(read_run(stopped.folder), again.append, quietly), ROUND)
    known = [e.found.generations for e in again if isinstance(e, EvolutionRecalled)]
    before = next(i for i, e in enumerate(events) if isinstance(e, WorldTested))
    assert known == ([2] if kind is GenerationDone else [3] * len(evolved_on(events[:before])))
    timed = {"seconds": 0, "search_seconds": 0}
    assert [r | timed for r in found] == [r | timed for r in results]
    assert same(*(last_skill(each.folder)[1].graph for each in (run, stopped)))


def evolved_on(events: list[Event]) -> dict[str, int]:
    """Scenarios of each evolution."""
    done = [event for event in events if isinstance(event, GenerationDone)]
    return {event.candidate: len(event.generation.succeeded) for event in done}


def test_evolutions_have_a_few_starts_and_more_where_these_are_good_enough(whole: Made) -> None:
    """Whether what they find reaches the target is told by trying it on all that was missed."""
    run, events, _ = whole
    easy = run.domain.target_return == EASY
    assert set(evolved_on(events).values()) == ({8, 16, 32} if easy else {8})
    tried = next(event for event in events if isinstance(event, WorldTested))
    assert (tried.size_m, tried.size_w) == (100, 0)
    accepted = any(isinstance(event, SkillAccepted) for event in events)
    assert accepted == (run.domain.target_return == EASY)


def test_nothing_is_practised_as_rounds_try_skills_on_fresh_episodes(whole: Made) -> None:
    """Neither those episodes nor the search, both in a simulated world, count as asked."""
    _, events, results = whole
    assert {(e.in_a_row, e.wanted) for e in events if isinstance(e, Practised)} == {(0, 0)}
    for result in results:
        assert (result["in_a_row"], result["practice"]) == (0, 0)
        assert set(result["asked"]) == {"looks", "trials"}
        assert not any(result["asked"]["looks"].values())
    told = [e.asked for e in events if isinstance(e, WorldAsked) and e.phase == "trials"]
    assert results[-1]["asked"]["trials"] == vars(sum(told, Asked()))
