"""Stages: their scenarios, what each gives its method, and what its result says of the method."""

from collections.abc import Callable
from contextlib import nullcontext
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from members import nearly
from reaching import TABLE
from support import seeded
from told_by_runs import generation_rows
from torch import Tensor

from cgtorch.evolution.population import random_population
from cgtorch.ground.asked import Asked, Purse
from cgtorch.ground.errors import SettingsError
from cgtorch.improvement.checkpoint import Found
from cgtorch.improvement.events import (
    Event,
    EvolutionRecalled,
    Practised,
    SkillAccepted,
    StageFailed,
    StageStarted,
)
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.runs.log import read_log
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.storage import load_progress
from cgtorch.runs.stored_run import StoredRun, round_name
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world import Scenarios
from cgtorch.tabletop.world.scenarios import INSET_MIN, TABLE_DEPTH, TABLE_WIDTH
from cgtorch.training import train as module
from cgtorch.training.context import Training
from cgtorch.training.evaluate import evaluate_skill
from cgtorch.training.tally import Tally
from cgtorch.training.train import (
    FRESH,
    FRESH_SEED,
    NotImprovedError,
    stage_generator,
    stages_to_make,
    train,
)

SKILL = nearly(0.5)
SETTINGS = RunSettings(models="none", practice=4)

Given = tuple[Progress[Scenarios], Scenarios, Scenarios]
"""What a method got: the progress, the tests, and three scenarios that were drawn."""


@pytest.fixture
def run(tmp_path: Path) -> StoredRun:
    (tmp_path / "run.json").write_text("{}")
    return StoredRun(tmp_path, SETTINGS, TABLE, paper_actions(), True)


def training_of(run: StoredRun, events: list[Event]) -> Training:
    return Training(run, events.append, lambda message: nullcontext(), purse=Purse())


def rows(*flags: bool) -> Tensor:
    return torch.tensor(flags, dtype=torch.bool)


class Method:
    """A method that accepts one skill, whose results on tests are given.

    It solves nothing else, or with `earlier` the first of what was missed earlier.

    It tries as many tests as it has results for, by default before what was missed earlier. With
    `last` they come after that, as where nothing can be put back.
    """

    def __init__(self, *succeeded: bool, last: bool = False, earlier: bool = False):
        self.succeeded, self.last, self.earlier = rows(*succeeded), last, earlier
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
        unsolved[:1] = self.earlier
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
        about = {"solved": solved, "missed": missed, "seen": seen}
        return replace(progress, skill=skill, **about)


Make = Callable[..., list[dict[str, Any]]]


@pytest.fixture
def make(monkeypatch: pytest.MonkeyPatch) -> Make:
    """The results of a run whose stages have these methods, one each."""

    def made(
        run: StoredRun, *methods: Any, stage: str = "", training: Training | None = None
    ) -> list[dict[str, Any]]:
        each = iter(methods)
        monkeypatch.setitem(module.METHODS, run.settings.method, lambda *given: next(each)(*given))
        stage = stage or list(TABLE.stages)[len(methods) - 1]
        results = train(training or training_of(run, []), stage)
        assert not list(each)
        return results

    return made


ALL = [True] * 5


def test_a_method_gets_tests_and_draws_of_the_stages_kind_and_what_was_missed(
    make: Make, run: StoredRun
) -> None:
    first, second = Method(True, True, False, True, False), Method(*ALL)
    make(run, first, second)
    for method, kind in ((first, "near"), (second, "left")):
        ((_, tests, _),) = method.given
        for name, value in vars(TABLE.tests(kind)).items():
            assert torch.equal(getattr(tests, name), value)
    (before, tests, drawn), (_, old, _) = *second.given, *first.given
    assert torch.equal(before.missed.object, old.object[[2, 4]])
    assert torch.equal(before.solved.object, old.object[[0, 1, 3]])
    assert (drawn.object[:, 1] >= TABLE_WIDTH / 2 - 0.15 - 1e-6).all()  # at the left edge
    assert len({tuple(o) for o in [*drawn.object.tolist(), *tests.object.tolist()]}) == 8


def test_draws_are_the_stages_own_and_always_the_same(make: Make, run: StoredRun) -> None:
    drawn = []
    for name in ("one", "other"):
        folder = run.folder / name
        folder.mkdir()
        (folder / "run.json").write_text("{}")
        methods = Method(*ALL), Method(*ALL)
        make(replace(run, folder=folder), *methods)
        drawn.append([method.given[0][2].seed.tolist() for method in methods])
    assert drawn[0] == drawn[1]
    assert not {*drawn[0][0]} & {*drawn[0][1]}


def test_what_happens_in_a_stage_is_told_and_logged(make: Make, run: StoredRun) -> None:
    events: list[Event] = []
    make(run, Method(*ALL), training=training_of(run, events))
    assert [e.skill.name for e in events if isinstance(e, Practised)] == [SKILL.name]
    assert [e.skill.name for e in events if isinstance(e, SkillAccepted)] == ["S0"]
    logged = [row["event"] for row in read_log(run.folder)]
    assert logged.count("accepted") == 1


@pytest.mark.parametrize("seed", [0, 5])
def test_a_stage_tells_how_its_skill_does_on_fresh_scenarios_of_the_seed(
    seed: int, make: Make, run: StoredRun
) -> None:
    settings = replace(SETTINGS, seed=seed)
    *_, result = make(replace(run, settings=settings), Method(*ALL), Method(*ALL))
    for name, kind in (("fresh", "left"), ("overall", TABLE.kinds[0])):
        score = evaluate_skill(SKILL, TABLE, kind, FRESH, FRESH_SEED + seed)
        assert (result[name]["succeeded"], result[name]["tried"]) == (score.successes, FRESH)


COUNTS = "targets_succeeded", "targets", "earlier_failures", "earlier_failures_succeeded"


@pytest.mark.parametrize(
    ("method", "repeats", "last"),
    [("compose", True, False), ("compose", False, True), ("paper", False, False)],
    ids=["it repeats itself", "it does not", "the paper's method"],
)
def test_own_tests_are_not_mixed_up_with_earlier_failures(
    make: Make, run: StoredRun, method: str, repeats: bool, last: bool
) -> None:
    """The paper's method tries tests first in any world."""
    first = Method(True, False, False, True, False, last=last)
    second = Method(False, True, True, True, True, last=last, earlier=True)
    run = replace(run, repeats=repeats, settings=replace(SETTINGS, method=method))
    results = make(run, first, second)
    counts = [tuple(r[name] for name in COUNTS) for r in results]
    assert counts == [(2, 5, 0, 0), (4, 5, 3, 1)]
    assert [r["w_size"] for r in results] == [0, 2]


@pytest.mark.parametrize("missed", [0, 2])
@pytest.mark.parametrize("tried", [1, 3, 5])
def test_a_stage_may_end_before_all_of_its_tests_were_tried(
    make: Make, run: StoredRun, tried: int, missed: int
) -> None:
    """Where nothing can be put back, tests come one after the other, until the budget is spent."""
    first = Method(*[True] * (5 - missed), *[False] * missed, last=True)
    results = make(replace(run, repeats=False), first, Method(*[True] * tried, last=True))
    wanted = [(5 - missed, 5, 0, 0), (tried, 5, missed, 0)]
    assert [tuple(r[name] for name in COUNTS) for r in results] == wanted


def test_what_was_asked_adds_up_over_the_stages_and_from_one_process_to_the_next(
    make: Make, run: StoredRun
) -> None:
    """What counts is what the run says, but for tests for the report, whatever a purse had."""
    (first,) = make(run, Method(*ALL))
    training = training_of(run, [])
    training.purse.add("trials", Asked(99))
    results = make(run, Method(*ALL), stage="S1", training=training)
    once = {"motions": 7, "tests": 2, "looks": 5, "episodes": 5, "steps": 0, "simulated": 0}
    twice = {name: 2 * count for name, count in once.items()}
    assert [r["asked"] for r in (first, results[1])] == [{"trials": once}, {"trials": twice}]
    assert first["fresh"]["tried"] == first["overall"]["tried"] == 40
    assert run.results == results
    assert training.purse.total == Asked(14, 4, 10, 10)


def test_a_stage_that_accepts_nothing_leaves_no_folder(make: Make, run: StoredRun) -> None:
    events: list[Event] = []
    with pytest.raises(NotImprovedError, match="stage S0 found no skill"):
        make(run, lambda stage, progress, *given: progress, training=training_of(run, events))
    assert [type(event) for event in events] == [StageStarted, StageFailed]
    assert not (run.folder / "S0").exists()


@pytest.mark.parametrize(
    ("unsolved", "said"),
    [
        (1.0, r"solves more\. In 9 generations no individual solved anything .* nearer to success"),
        (0.9, "solves more within 24 attempts; raise attempts, generations or population"),
    ],
)
def test_where_nothing_was_ever_solved_more_of_the_same_is_no_advice(
    make: Make, run: StoredRun, monkeypatch: pytest.MonkeyPatch, unsolved: float, said: str
) -> None:
    log = generation_rows(9, 20, [0.0], unsolved=unsolved)
    monkeypatch.setattr(module, "read_log", lambda folder: log)
    with pytest.raises(NotImprovedError, match=said):
        make(run, lambda stage, progress, *given: progress, training=training_of(run, []))


def test_a_budget_that_is_spent_ends_a_run_with_what_it_has(make: Make, run: StoredRun) -> None:
    """A method takes a budget that is spent for its end; S1 has accepted nothing by then."""

    def spends(
        setup: Setup[Scenarios], progress: Progress[Scenarios], *given: Any
    ) -> Progress[Scenarios]:
        setup.purse.exhausted = True
        return progress

    results = make(run, Method(*ALL), spends, stage="S3")  # nobody begins S2
    assert [r["stage"] for r in results] == ["S0"]
    assert run.results == results


def test_first_percepts_are_kept_with_w_and_m(make: Make, run: StoredRun) -> None:
    make(run, Method(True, False, True, True, False))
    progress = load_progress(run, run.folder / "S0")
    assert progress.seen is not None
    every = progress.solved.joined(progress.missed)
    assert torch.equal(progress.seen, first_percepts(TABLE.world(every)))


STAGES = TABLE.stages


def test_stages_in_order(run: StoredRun) -> None:
    assert STAGES == {"S0": "near", "S1": "left", "S2": "right", "S3": "far"}
    assert [stages_to_make(run, s) for s in STAGES] == [
        ("S0",), ("S0", "S1"), ("S0", "S1", "S2"), ("S0", "S1", "S2", "S3"),
    ]  # fmt: skip


@pytest.mark.parametrize("bad", ["S4", "s0", "", "S0 ", "near", "../S0", "auto", "auto-1"])
def test_unknown_stages(run: StoredRun, bad: str) -> None:
    with pytest.raises(SettingsError, match=r"unknown stage .*; use one of S0, S1, S2, S3"):
        stages_to_make(run, bad)


def test_only_the_papers_table_has_stages(run: StoredRun) -> None:
    for scenarios in ("auto", "perimeter"):
        assert stages_to_make(replace(run, settings=RunSettings(scenarios=scenarios)), "S0")
    for other in ("general", "general-clutter"):
        with pytest.raises(SettingsError, match=f"not {other}; use stage 'auto'"):
            stages_to_make(replace(run, settings=RunSettings(scenarios=other)), "S0")


@pytest.mark.parametrize("stage", STAGES)
def test_five_evenly_spaced_from_the_centred_start(stage: str) -> None:
    tests = TABLE.tests(STAGES[stage])
    placed, pose = tests.object, tests.pose
    assert torch.equal(pose, pose[:1].expand(5, 3))
    assert pose[0].tolist() == pytest.approx([-TABLE_DEPTH / 2 - 1, 0, 0])
    along, across = (1, 0) if STAGES[stage] in ("near", "far") else (0, 1)
    length, depth = (TABLE_WIDTH, TABLE_DEPTH) if along == 1 else (TABLE_DEPTH, TABLE_WIDTH)
    gaps = placed[:, along].diff()
    assert gaps.tolist() == pytest.approx([(length - 2 * INSET_MIN) / 4] * 4)
    inside = depth / 2 - 0.1
    sign = 1 if STAGES[stage] in ("far", "left") else -1
    assert placed[:, across].tolist() == pytest.approx([sign * inside] * 5)


def test_the_right_edge_has_its_top_corner() -> None:
    placed = TABLE.tests(STAGES["S2"]).object
    corner = torch.tensor([TABLE_DEPTH / 2 - INSET_MIN, 0.1 - TABLE_WIDTH / 2])
    assert (placed - corner).norm(dim=1).min() < 1e-6


def test_a_stage_has_randomness_of_its_own() -> None:
    def drawn(seed: int, stage: str) -> tuple[float, ...]:
        return tuple(torch.rand(4, generator=stage_generator(TABLE, seed, stage)).tolist())

    names = [*STAGES, *map(round_name, range(1, 30))]
    everything = {drawn(seed, stage) for seed in range(20) for stage in names}
    assert len(everything) == 20 * len(names)
    assert drawn(3, "S2") == drawn(3, "S2")
    again = [stage_generator(TABLE, 3, "S2", failures).get_state() for failures in (0, 1)]
    assert torch.equal(stage_generator(TABLE, 3, "S2").get_state(), again[0])
    assert not torch.equal(*again)
    drawn(2**31 - 1, "S3")  # the largest seed that settings allow


def test_a_search_that_is_recalled_counts_with_all_of_its_generations() -> None:
    one, other = (random_population(1, paper_actions(), 4, (2, 4), seeded(n)) for n in (0, 1))
    tally = Tally()
    for champion, best in ((one, 0.5), (other, 0.5), (other, 0.25)):
        found = Found(champion, torch.zeros(0), best, 2, generations=7, transitions=30, seconds=1.5)
        tally.count(EvolutionRecalled("S0", "S0.1", found))
    assert (tally.generations, tally.transitions, tally.searching) == (21, 90, 4.5)
    assert tally.champion is one  # which was as good before
    assert tally.best == (0, 0.5)


def test_a_kind_that_comes_again_is_rehearsed(make: Make, run: StoredRun) -> None:
    """On a fifth of what is practised, and not by the usual method, of which there is one."""
    domain, settings = copy(TABLE), replace(SETTINGS, practice=20)
    object.__setattr__(domain, "stages", {"S0": "near", "S1": "near"})
    again = replace(run, domain=domain, settings=settings)
    first, second = make(again, Method(*ALL), stage="S1")
    assert first["fresh"]["succeeded"] >= 20
    assert second["skill"] == "S1"
    assert (second["w_size"], second["generations"]) == (len(ALL), 0)
    tests = try_skill(SKILL, TABLE.world(TABLE.tests("near"))).succeeded
    assert second["targets_succeeded"] == int(tests.sum()) >= 3
    assert (second["targets"], second["earlier_failures"]) == (len(tests), 0)
    assert second["asked"]["practice"]["episodes"] == 4 + len(tests)


@pytest.mark.parametrize(("about", "share"), [
    ({}, 0.75),
    ({"name": "auto-1"}, None),
    ({"repeats": False}, None),
])  # fmt: skip
def test_the_latest_result_tells_how_good_the_skill_was(
    about: dict[str, Any], share: float | None, run: StoredRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rounds, and worlds that do not repeat themselves, have no rehearsal."""
    shares: list[float | None] = []
    usual = {"scenarios": "near", "fresh": {"succeeded": 40, "tried": 40}}
    later = {"scenarios": "near", "fresh": {"succeeded": 30, "tried": 40}}
    other = {"scenarios": "left", "fresh": {"succeeded": 1, "tried": 40}}
    monkeypatch.setattr(StoredRun, "results", [usual, later, other, {"scenarios": "near"}])
    monkeypatch.setattr(module, "rehearse", lambda *given: shares.append(given[-1]))
    monkeypatch.setitem(module.METHODS, "compose", lambda *given: shares.append(None))
    training = training_of(run, [])
    setup = replace(training.setup("S1"), **{"name": "S1", **about})
    none = TABLE.draw("near", 0, seeded(0))
    module._improved(training, setup, "near", Progress(SKILL, none, none, None), none, None)
    assert shares == [share]
    module._improved(training, setup, "near", Progress(None, none, none, None), none, None)
    assert shares == [share, None]


@pytest.mark.parametrize("settings", [
    replace(SETTINGS, method="paper"),
    replace(SETTINGS, practice=5),
])  # fmt: skip
def test_other_kinds_and_the_papers_method_are_made_in_the_usual_way(
    settings: RunSettings, make: Make, run: StoredRun
) -> None:
    domain = copy(TABLE)
    second = "near" if settings.method == "paper" else "left"
    object.__setattr__(domain, "stages", {"S0": "near", "S1": second})
    make(replace(run, domain=domain, settings=settings), Method(*ALL), Method(*ALL), stage="S1")
