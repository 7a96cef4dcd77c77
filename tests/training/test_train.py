"""What a stage gives to its method, and what its result says of what the method came to."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from members import nearly
from reaching import TABLE
from torch import Tensor

from cgtorch.ground.asked import Asked, Purse
from cgtorch.improvement.events import Event, Practised, SkillAccepted, StageStarted
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.improvement.trial import first_percepts
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.storage import load_progress
from cgtorch.runs.stored_run import StoredRun
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world import Scenarios
from cgtorch.tabletop.world.scenarios import TABLE_WIDTH
from cgtorch.training import train as module
from cgtorch.training.context import Training
from cgtorch.training.train import NotImprovedError, train

SKILL = nearly(0.5)
SETTINGS = RunSettings(models="none", practice=4)

Given = tuple[Progress[Scenarios], Scenarios, Scenarios]
"""What a method got: the progress, the tests, and three scenarios that were drawn."""


def run_in(folder: Path, repeats: bool = True) -> StoredRun:
    folder.mkdir()
    (folder / "run.json").write_text("{}")
    return StoredRun(folder, SETTINGS, TABLE, paper_actions(), repeats)


def training_of(run: StoredRun, events: list[Event] | None = None, **limits: float) -> Training:
    watch = (events if events is not None else list[Event]()).append
    return Training(run, watch, lambda message: nullcontext(), purse=Purse(limits))


def rows(*flags: bool) -> Tensor:
    return torch.tensor(flags, dtype=torch.bool)


class Method:
    """A method that accepts one skill, whose results on tests are given; it solves nothing else.

    It tries as many tests as it has results for, by default before what was missed earlier. With
    `last` they come after that, as where nothing can be put back. `chance` is what it finds.
    """

    def __init__(self, *succeeded: bool, last: bool = False, chance: bool = False):
        self.succeeded, self.last, self.chance = rows(*succeeded), last, chance
        self.given = list[Given]()

    def __call__(
        self,
        setup: Setup[Scenarios],
        progress: Progress[Scenarios],
        tests: Scenarios,
        draw: Callable[[int, Any], Scenarios],
    ) -> Progress[Scenarios]:
        self.given.append((progress, tests, draw(3, setup.generator)))
        setup.purse.pay("trials", Asked(motions=7, tests=2, looks=5, episodes=5))
        setup.watch(Practised(setup.name, SKILL, 4, 4))
        tried, old = tests[: len(self.succeeded)], progress.missed
        unsolved = torch.zeros(len(old), dtype=torch.bool)
        if self.last:
            every, succeeded = old.joined(tried), torch.cat([unsolved, self.succeeded])
        else:
            every, succeeded = tried.joined(old), torch.cat([self.succeeded, unsolved])
        skill = replace(SKILL, name=setup.name)
        everywhere = torch.ones(len(every), dtype=torch.bool)
        told = every, succeeded, ~everywhere, everywhere
        setup.watch(SkillAccepted(setup.name, skill, *told, 1.5))
        solved, missed = progress.solved.joined(every[succeeded]), every[~succeeded]
        seen = first_percepts(TABLE.world(solved.joined(missed)))
        about = {"solved": solved, "missed": missed, "seen": seen, "chance": self.chance}
        return replace(progress, skill=skill, **about)


def made(
    monkeypatch: pytest.MonkeyPatch, run: StoredRun, *methods: Method, **limits: float
) -> list[dict[str, Any]]:
    """The results of stages of which each has its own method."""
    each = iter(methods)
    monkeypatch.setitem(module.METHODS, "compose", lambda *given: next(each)(*given))
    return train(training_of(run, **limits), list(TABLE.stages)[len(methods) - 1])


def test_a_method_gets_tests_and_draws_of_the_stages_kind_and_what_was_missed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = Method(True, True, False, True, False), Method(*[True] * 5)
    made(monkeypatch, run_in(tmp_path / "run"), first, second)
    for method, kind in ((first, "near"), (second, "left")):
        ((_, tests, _),) = method.given
        for name, value in vars(TABLE.tests(kind)).items():
            assert torch.equal(getattr(tests, name), value)
    (before, tests, drawn), (_, old, _) = *second.given, *first.given
    assert torch.equal(before.missed.object, old.object[[2, 4]])
    assert torch.equal(before.solved.object, old.object[[0, 1, 3]])
    assert (drawn.object[:, 1] >= TABLE_WIDTH / 2 - 0.15 - 1e-6).all()  # at the left edge
    assert len({tuple(o) for o in [*drawn.object.tolist(), *tests.object.tolist()]}) == 8


def test_draws_are_the_stages_own_and_always_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = []
    for name in ("one", "other"):
        methods = Method(*[True] * 5), Method(*[True] * 5)
        made(monkeypatch, run_in(tmp_path / name), *methods)
        drawn.append([method.given[0][2].seed.tolist() for method in methods])
    assert drawn[0] == drawn[1]
    assert not {*drawn[0][0]} & {*drawn[0][1]}


COUNTS = "targets_succeeded", "targets", "earlier_failures", "earlier_failures_succeeded"


@pytest.mark.parametrize(
    ("repeats", "chance", "last"),
    [(True, False, False), (False, False, True), (True, True, True)],
    ids=["it repeats itself", "it does not", "it was found to be chance"],
)
def test_own_tests_are_not_mixed_up_with_earlier_failures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, repeats: bool, chance: bool, last: bool
) -> None:
    first = Method(True, False, False, True, False, last=last and not chance, chance=chance)
    second = Method(False, True, True, True, True, last=last)
    results = made(monkeypatch, run_in(tmp_path / "run", repeats), first, second)
    counts = [tuple(r[name] for name in COUNTS) for r in results]
    assert counts == [(2, 5, 0, 0), (4, 5, 3, 0)]
    assert [r["w_size"] for r in results] == [0, 2]


def test_the_papers_method_tries_tests_first_in_any_world(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    each = iter([Method(True, False, False, True, False), Method(False, True, True, True, True)])
    run = run_in(tmp_path / "run", repeats=False)
    run = replace(run, settings=replace(SETTINGS, method="paper"))
    monkeypatch.setitem(module.METHODS, "paper", lambda *given: next(each)(*given))
    results = train(training_of(run), "S1")
    assert tuple(results[1][name] for name in COUNTS) == (4, 5, 3, 0)


@pytest.mark.parametrize("missed", [0, 2])
@pytest.mark.parametrize("tried", [1, 3, 5])
def test_a_stage_may_end_before_all_of_its_tests_were_tried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tried: int, missed: int
) -> None:
    """Where nothing can be put back, tests come one after the other, until the budget is spent."""
    first = Method(*[True] * (5 - missed), *[False] * missed, last=True)
    second = Method(*[True] * tried, last=True)
    results = made(monkeypatch, run_in(tmp_path / "run", repeats=False), first, second)
    wanted = [(5 - missed, 5, 0, 0), (tried, 5, missed, 0)]
    assert [tuple(r[name] for name in COUNTS) for r in results] == wanted


def test_what_was_asked_adds_up_over_the_stages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = run_in(tmp_path / "run")
    results = made(monkeypatch, run, Method(*[True] * 5), Method(*[True] * 5))
    once = {"motions": 7, "tests": 2, "looks": 5, "episodes": 5}
    twice = {name: 2 * count for name, count in once.items()}
    assert [r["asked"] for r in results] == [{"trials": once}, {"trials": twice}]
    assert run.results == results


def test_a_run_that_goes_on_counts_what_was_asked_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The purse may have been used before; what counts is what the run says."""
    run = run_in(tmp_path / "run")
    made(monkeypatch, run, Method(*[True] * 5))
    training = training_of(run)
    training.purse.add("trials", Asked(99))
    monkeypatch.setitem(module.METHODS, "compose", Method(*[True] * 5))
    results = train(training, "S1")
    assert results[1]["asked"]["trials"]["motions"] == 14
    assert training.purse.total == Asked(14, 4, 10, 10)


def test_tests_for_the_report_are_not_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (result,) = made(monkeypatch, run_in(tmp_path / "run"), Method(*[True] * 5))
    assert result["fresh"]["tried"] == result["overall"]["tried"] == 40
    assert set(result["asked"]) == {"trials"}


def test_a_stage_that_accepts_nothing_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = run_in(tmp_path / "run")
    monkeypatch.setitem(module.METHODS, "compose", lambda stage, progress, *given: progress)
    events: list[Event] = []
    with pytest.raises(NotImprovedError, match="stage S0 found no skill"):
        train(training_of(run, events), "S0")
    assert [type(event) for event in events] == [StageStarted]
    assert not (run.folder / "S0").exists()


def test_a_budget_that_is_spent_ends_a_run_with_what_it_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A method takes a budget that is spent for its end; S1 has accepted nothing by then."""

    def spends(
        setup: Setup[Scenarios], progress: Progress[Scenarios], *given: Any
    ) -> Progress[Scenarios]:
        setup.purse.exhausted = True
        return progress

    run, accepts = run_in(tmp_path / "run"), Method(*[True] * 5)
    each: Any = iter([accepts, spends])
    monkeypatch.setitem(module.METHODS, "compose", lambda *given: next(each)(*given))
    results = train(training_of(run), "S3")
    assert [r["stage"] for r in results] == ["S0"]
    assert run.results == results
    assert list(each) == []  # nobody has begun S2


def test_first_percepts_are_kept_with_w_and_m(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = run_in(tmp_path / "run")
    made(monkeypatch, run, Method(True, False, True, True, False))
    progress = load_progress(run, run.folder / "S0")
    assert progress.seen is not None
    every = progress.solved.joined(progress.missed)
    assert torch.equal(progress.seen, first_percepts(TABLE.world(every)))
