"""Pages of runs in rounds, around the paper's table and around any."""

import json
from pathlib import Path

import pytest
from lxml import html
from report_pages import parsed, rewrite, words
from support import create_run, random_graphs, seeded

from cgtorch.graphs import Skill, save_skill
from cgtorch.runs.run import Run, open_run
from cgtorch.runs.settings import RunSettings, defaults_of
from cgtorch.runs.storage import save_scenarios
from cgtorch.tabletop.settings import TabletopSettings
from cgtorch.training.auto import act


def auto_run(folder: Path, scenarios: str, count: int) -> Run:
    """A run with one round, whose skill nobody evolved but the world has tried."""
    run = create_run(
        folder, RunSettings(**{**defaults_of(TabletopSettings), "scenarios": scenarios})
    )
    graphs = random_graphs(3, 1, run.actions)
    skill = Skill("auto-1", graphs, run.actions)
    score = act(run, skill, count, seeded(0), enough=count)
    solved, missed = (score.scenarios[rows] for rows in (score.succeeded, ~score.succeeded))
    (folder / "auto-1").mkdir()
    save_skill(folder / "auto-1" / "skill.json", skill)
    save_scenarios(folder / "auto-1" / "scenarios.json", solved, missed)
    tested = {"scenarios": scenarios, "tried": score.tried, "succeeded": score.successes}
    numbers = dict.fromkeys(
        ("targets_succeeded", "targets", "earlier_failures", "earlier_failures_succeeded",
         "w_size", "w_lost", "generations", "transitions"), 0,
    )  # fmt: skip
    names = {"stage": "auto-1", "scenarios": scenarios, "skill": "auto-1"}
    size = {"nodes": skill.num_nodes, "depth": skill.depth, "seconds": 1.5}
    tests = {"fresh": tested, "overall": tested, "decisive": None}
    rewrite(folder / "auto-1" / "result.json", {**names, **numbers, **size, **tests})
    goal = {"target": 0.9, "minutes": 5.0, "rounds": 30}
    rewrite(folder / "summary.json", {"stages": [], "reached": False, **goal})
    return run


def a_map(page: html.HtmlElement) -> html.HtmlElement:
    return next(e for e in page.iter("svg") if "from above" in e.get("aria-label"))


@pytest.mark.parametrize("scenarios", ["general", "general-clutter"])
def test_tables_that_differ_are_drawn_one_by_one(tmp_path: Path, scenarios: str) -> None:
    run = auto_run(tmp_path / "run", scenarios, 30)
    page = parsed(run.folder)
    drawn = a_map(page)
    tables = [e for e in drawn.iter("g") if e.get("data-part") == "table"]
    assert len(tables) == 24
    assert "; seen from above, 24 of them drawn" in words(page.get_element_by_id("stage-1"))
    obstacles = [e for e in drawn.iter("g") if e.get("data-part") == "obstacle"]
    assert bool(obstacles) == (scenarios == "general-clutter")
    assert page.find_class("paper") == []  # which has no such experiment
    assert page.xpath("//h3/text()") == [f"auto-1: {scenarios}"]
    text = words(page.get_element_by_id("reproduce"))
    assert (
        f"cgtorch-train --stage auto --target 0.9 --minutes 5.0 --rounds 1 --seed 0 "
        f"--scenarios {scenarios} --run-dir runs/again" in text
    )


def test_of_many_placements_all_missed_and_some_reached_are_drawn(tmp_path: Path) -> None:
    run = auto_run(tmp_path / "run", "perimeter", 20)
    path = run.folder / "auto-1" / "scenarios.json"
    known = json.loads(path.read_text())
    everything = known["W"] + known["M"]
    assert len(everything) == 20
    rewrite(path, {"W": everything * 100, "M": everything[:7]})
    page = parsed(open_run(run.folder).folder)
    drawn = {e.get("data-part"): len([*e.iter("use")]) for e in a_map(page).iter("g")}
    assert (drawn["reached"], drawn["missed"]) == (1493, 7)
    text = words(page.get_element_by_id("stage-1"))
    assert "2000 scenarios reached, 7 missed; seen from above, 1500 of them drawn" in text
    assert "34 of 40 reached" in words(page.get_element_by_id("overall"))
    assert next(words(e) for e in page.iter("article")).startswith("auto-1: perimeter")
