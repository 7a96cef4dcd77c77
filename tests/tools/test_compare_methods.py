"""The comparison of methods: one small seed, and the table."""

import json
import math
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import pytest
from compare_methods import METHODS, beginning, compare, published, quietly
from comparison.table import LABELS, cost_of, spread, table
from told_by_runs import asked_at_start
from trained import SMALL

from cgtorch.runs.storage import load_dataset
from cgtorch.runs.stored_run import read_run
from cgtorch.training.context import Training

pytestmark = pytest.mark.hostile

SEED = f"seed-{SMALL.seed}"

HASTY = replace(SMALL, transitions=100, attempts=2, generations=4)


Result = dict[str, Any]


@pytest.fixture(scope="module", autouse=True)
def few_data() -> Iterator[None]:
    """The paper's method begins with a hundred random data in place of some thousand."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cgtorch.tabletop.domain.TRANSITIONS", 100)
        patch.setattr("cgtorch.tabletop.domain.LABELS", 120)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One seed of the default, too hasty to get far."""
    folder = tmp_path_factory.mktemp("comparison")
    compare(folder, HASTY, ("stages",), 0, 20)
    return folder


@pytest.fixture(scope="module")
def begin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the paper's method begins with."""
    return beginning(tmp_path_factory.mktemp("paper"), replace(HASTY, method="paper")).folder


@pytest.fixture
def begun(tmp_path: Path, begin: Path) -> Path:
    """A comparison with data and models of the seed, but no method yet."""
    shutil.copytree(begin, tmp_path / SEED / begin.name)
    return tmp_path


def result(folder: Path, method: str) -> Result:
    return json.loads((folder / f"{SEED}-{method}.json").read_text())


def check_costs(found: Result) -> None:
    """Costs only grow, and every skill was tried."""
    costs = [*found["points"], found]
    for cost in ("transitions", "generations", "search_seconds", "seconds"):
        assert [c[cost] for c in costs] == sorted(c[cost] for c in costs)
    assert found["search_seconds"] <= found["seconds"]
    assert all(0 <= p["succeeded"] <= 20 for p in found["points"])
    assert found["settings"]["seed"] == SMALL.seed
    assert found["settings"]["method"] == ("compose" if found["method"] == "stages" else "paper")


def test_every_skill_of_the_default_is_measured(folder: Path) -> None:
    found = result(folder, "stages")
    check_costs(found)
    assert found["budget"] is None
    stages = [p["stage"] for p in found["points"]]
    assert stages == ["S0", "S1", "S2", "S3"][: len(stages)]
    assert (len(stages) < 4) == (found["failure"] is not None)
    before = {p: p.stat().st_mtime_ns for p in folder.rglob("*")}
    compare(folder, HASTY, ("stages",), 0, 20)  # which makes nothing again
    assert {p: p.stat().st_mtime_ns for p in folder.rglob("*")} == before


@pytest.mark.parametrize(("method", "asked"), [("paper", 0), ("paper-here", 30_000)])
def test_the_paper_gets_a_budget_or_what_the_default_took(
    method: str, asked: int, begun: Path
) -> None:
    for default, spent in (("stages", 90_000), ("auto", 60_000)):
        (begun / f"{SEED}-{default}.json").write_text(json.dumps({"transitions": spent}))
    compare(begun, HASTY, (method,), asked, 20)
    found, budget = result(begun, method), asked or 90_000
    check_costs(found)
    assert found["budget"] == budget
    assert found["transitions"] >= budget or found["failure"] is not None
    assert found["transitions"] <= budget + 200 * 20 * 20  # a generation on 20 scenarios
    names = "begin-paper", method
    models = [(begun / SEED / name / "start" / "gamma.safetensors") for name in names]
    assert models[0].read_bytes() == models[1].read_bytes()


def test_a_budget_needs_a_default_to_take_it_from(begun: Path) -> None:
    with pytest.raises(click.ClickException, match="make stages or auto first"):
        compare(begun, HASTY, ("paper",), 0, 20)


def test_each_method_begins_with_its_own_data(folder: Path, begin: Path) -> None:
    places = folder / SEED / "begin-compose", begin
    explored, given = (load_dataset(place / "start" / "data.safetensors") for place in places)
    assert len(explored.percept) <= HASTY.transitions + 1
    asked = asked_at_start(begin)["exploration"]
    assert (len(given.percept), len(given.tested)) == (asked["motions"], asked["tests"])
    assert (asked["motions"], asked["tests"]) == (100, 120)


def test_the_published_settings(folder: Path) -> None:
    training = Training(read_run(folder / SEED / "stages"), lambda event: None, quietly)
    setup = published(training.setup("S0"))
    evolution = setup.evolution
    assert (evolution.population, evolution.elite, evolution.tau) == (200, 1, 0.05)
    assert (setup.budget.generations, setup.max_transitions) == (10_000, 20)


def made(method: str, *points: tuple[int, float]) -> Result:
    """A result with skills that solve so many of 100 after so many million transitions."""
    told = [
        {"succeeded": s, "transitions": t * 1e6, "seconds": 10 * t, "search_seconds": 5 * t}
        for s, t in points
    ]
    last = told[-1] if told else {"transitions": 9e6, "seconds": 90, "search_seconds": 45}
    return {"method": method, "placements": 100, **last, "points": told}


def test_the_first_skill_that_reaches_the_target_counts() -> None:
    found = made("auto", (50, 1), (85, 2), (84, 3), (99, 4))
    assert cost_of(found, 0.85, "transitions") == 2e6
    assert cost_of(found, 0.99, "seconds") == 40
    assert cost_of(made("auto", (98, 1)), 0.99, "seconds") == math.inf
    assert cost_of(made("auto"), 0.85, "seconds") == math.inf


def test_the_table_has_medians_and_ranges() -> None:
    results = [made("auto", (90, 1), (99, n)) for n in (2, 3, 8)]
    results += [made("paper", (60, 9)), made("paper", (86, 9)), made("paper")]
    lines = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in table(results).splitlines()
    ]
    assert len({len(line) for line in lines}) == 1
    auto, paper = lines[2:]
    assert auto[1:5] == ["3", "99.0 %", "3.0, 2.0–8.0", "30, 20–80 (15, 10–40)"]
    assert auto[5:8] == ["3 of 3", "1.0", "10 (5)"]
    assert auto[8:] == ["3 of 3", "3.0, 2.0–8.0", "30, 20–80 (15, 10–40)"]
    assert paper[2] == "60.0 %, 0.0 %–86.0 %"
    assert paper[5:7] == ["1 of 3", "never, 9.0–never"]
    assert paper[8:10] == ["0 of 3", "never"]
    assert spread([1.0, 1.0], "{:.0f}") == "1"
    assert set(LABELS) == set(METHODS)
