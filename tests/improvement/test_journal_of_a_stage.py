"""A stage that is interrupted anywhere and goes on ends as if it had not been."""

import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from support import seeded
from watched import Watched, along, of_kind

from cgtorch.graphs import skill_to_dict
from cgtorch.ground.asked import Purse
from cgtorch.ground.errors import RunError
from cgtorch.improvement.events import (
    Event,
    EvolutionRecalled,
    GenerationDone,
    WorldAsked,
)
from cgtorch.improvement.grow import grow
from cgtorch.improvement.improve import improve
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.runs.journal import FileJournal
from cgtorch.tabletop.world import stage_scenarios

METHODS: dict[str, Callable[..., Progress]] = {"compose": improve, "paper": grow}


def stage(
    method: str, setup: Setup, progress: Progress, watch: Callable[[Event], None]
) -> Progress:
    about = replace(setup, name="S0", generator=seeded(0), watch=watch)
    return METHODS[method](about, progress, stage_scenarios("near"), along("near"))


def recorded(
    folder: Path, setup: Setup, before: Progress, watch: Callable[[Event], None]
) -> Progress:
    """The result of a stage that is interrupted at its very end, so that its journal stays."""
    with suppress(KeyboardInterrupt), FileJournal(folder) as journal:
        after = stage("compose", replace(setup, journal=journal), before, watch)
        raise KeyboardInterrupt
    return after


def same(one: Progress, two: Progress) -> bool:
    """Whether two stages ended alike, to the last bit."""
    skills, tensors = [], []
    for each in (one, two):
        skills.append(None if each.skill is None else skill_to_dict(each.skill))
        models = each.knowledge.gamma.state_dict().values()
        scenarios = vars(each.solved).values(), vars(each.missed).values()
        tensors.append([*models, *scenarios[0], *scenarios[1], each.seen])
    return skills[0] == skills[1] and all(map(torch.equal, *tensors))


def history(events: list[Event]) -> list[tuple[str, int, float]]:
    return [
        (e.candidate, e.generation.number, float(e.generation.fitness.mean()))
        for e in events
        if isinstance(e, GenerationDone)
    ]


@pytest.mark.parametrize(
    ("method", "repeats"), [("compose", True), ("compose", False), ("paper", True)]
)
def test_an_interrupted_stage_ends_as_if_it_had_not_been(
    method: str, repeats: bool, setup: Setup, nothing_yet: Progress, tmp_path: Path
) -> None:
    """It is interrupted again and again, after a few more events each time.

    What it asks of the world is counted as if it had not been interrupted, too. A world that does
    not repeat itself is one here, so that results can be compared.
    """
    setup = replace(setup, repeats=repeats)
    told: list[Event] = []
    whole = replace(setup, purse=Purse())
    wanted = stage(method, whole, nothing_yet, told.append)
    assert wanted.skill is not None
    found, interruptions, seen = None, 0, dict[tuple[str, int], float]()
    left, asked, recalled = 0, list[WorldAsked](), 0

    def watch(event: Event) -> None:
        nonlocal left, recalled
        left -= 1
        if isinstance(event, GenerationDone):
            name, number, mean = history([event])[0]
            assert seen.setdefault((name, number), mean) == mean
        elif isinstance(event, WorldAsked):
            asked.append(event)
            recalled += event.recalled
        if left <= 0:
            raise KeyboardInterrupt

    while found is None:
        left = 3 + 8 * interruptions
        asked.clear()
        purse = Purse()
        try:
            with FileJournal(tmp_path / "S0", seconds=0) as journal:
                again = replace(setup, journal=journal, purse=purse)
                found = stage(method, again, nothing_yet, watch)
        except KeyboardInterrupt:
            interruptions += 1
    assert interruptions >= 2
    assert same(found, wanted)
    assert [(*key, mean) for key, mean in seen.items()] == history(told)
    assert not (tmp_path / "S0").exists()
    assert recalled
    assert purse.spent == whole.purse.spent
    for one, other in zip(of_kind(told, WorldAsked), asked, strict=True):
        assert replace(other, recalled=False) == one


@pytest.mark.parametrize("method", METHODS)
def test_a_world_that_is_interrupted_is_asked_again_for_its_last_trial_only(
    method: str, setup: Setup, nothing_yet: Progress, tmp_path: Path
) -> None:
    """The process ends in the middle of a trial, again and again, some actions later each time."""
    whole = replace(setup, purse=Purse())
    wanted = stage(method, whole, nothing_yet, lambda event: None)
    found, total, purse, most = None, 0, Purse(), 25

    def stop(asked: int) -> None:
        if asked > most:
            raise KeyboardInterrupt

    while found is None:
        watched, purse = Watched(before_action=stop), Purse()
        try:
            with FileJournal(tmp_path / "S0", seconds=0) as journal:
                about = replace(setup, world_of=watched, journal=journal, purse=purse)
                found = stage(method, about, nothing_yet, lambda event: None)
        except KeyboardInterrupt:
            most += 40
        total += watched.asked
    assert most > 25
    assert same(found, wanted)
    assert purse.spent == whole.purse.spent
    assert total >= purse.total.actions


def test_what_is_recalled_is_not_computed(
    setup: Setup, nothing_yet: Progress, tmp_path: Path
) -> None:
    """Interrupted at the very end, a stage neither evolves nor tries anything again."""
    told: list[Event] = []
    wanted = recorded(tmp_path / "S0", setup, nothing_yet, told.append)
    again: list[Event] = []
    with FileJournal(tmp_path / "S0") as journal:
        assert journal.generations == len(history(told))
        # First percepts are looked at, nothing is done.
        found = stage("compose", replace(setup, journal=journal), nothing_yet, again.append)
    assert same(found, wanted)
    assert not history(again)
    recalled = [e for e in again if isinstance(e, EvolutionRecalled)]
    assert sum(e.found.generations for e in recalled) == len(history(told))
    others = [type(e) for e in again if not isinstance(e, EvolutionRecalled)]
    assert others == [type(e) for e in told if not isinstance(e, GenerationDone)]


def test_a_journal_of_another_stage_is_refused(
    setup: Setup, nothing_yet: Progress, tmp_path: Path
) -> None:
    journal = FileJournal(tmp_path)
    journal.record("trial of somebody", {"succeeded": torch.ones(5)})
    with pytest.raises(RunError, match="goes on with 'trial of somebody'"):
        stage("compose", replace(setup, journal=FileJournal(tmp_path)), nothing_yet, print)


def test_a_journal_that_makes_no_sense_is_one_error(
    setup: Setup, nothing_yet: Progress, tmp_path: Path
) -> None:
    """Whole files with nonsense in them: somebody wrote them on purpose."""
    recorded(tmp_path / "S0", setup, nothing_yet, lambda event: None)
    journal = FileJournal(tmp_path / "S0")
    looks, known = journal.recall("looks"), journal.recall("evolution S0.1")
    for name in ("solved", "counts", "generator", "champion.edges", "generations"):
        for bad in (torch.tensor(7.5), torch.full((2, 3), 99), None):
            odd = {k: v for k, v in {**known, name: bad}.items() if v is not None}
            other = tmp_path / "other"
            writer = FileJournal(other)
            writer.record("looks", looks)
            writer.record("evolution S0.1", odd)
            with pytest.raises(RunError, match="damaged"):
                stage("compose", replace(setup, journal=FileJournal(other)), nothing_yet, print)
            shutil.rmtree(other)
