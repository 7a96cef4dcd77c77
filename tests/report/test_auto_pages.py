"""Pages of runs in rounds, around the paper's table and around any."""

import json
from pathlib import Path

import pytest
from lxml import html
from report_pages import parsed, rewrite, words, write_log
from support import create_run, random_graphs, seeded

from cgtorch.graphs import Skill, save_skill
from cgtorch.runs.settings import RunSettings, defaults_of
from cgtorch.runs.storage import save_scenarios
from cgtorch.runs.stored_run import StoredRun, read_run
from cgtorch.tabletop.settings import TabletopSettings
from cgtorch.training.auto import act

NO_STEPS = {"steps": 0, "simulated": 0}
ASKED = {
    "exploration": {"motions": 20, "tests": 15, "looks": 4, "episodes": 0} | NO_STEPS,
    "looks": {"motions": 0, "tests": 0, "looks": 64, "episodes": 0} | NO_STEPS,
    "practice": {"motions": 9, "tests": 8, "looks": 7, "episodes": 7} | NO_STEPS,
}


def auto_run(folder: Path, scenarios: str, count: int, tested: bool = True) -> StoredRun:
    """A run with one round, whose skill nobody evolved but the world has tried.

    Unless it was `tested` on fresh scenarios, its trials were practice.
    """
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
    test = {"scenarios": scenarios, "tried": score.tried, "succeeded": score.successes}
    numbers = dict.fromkeys(
        ("targets_succeeded", "targets", "earlier_failures", "earlier_failures_succeeded",
         "w_size", "w_lost", "generations", "transitions", "search_seconds"), 0,
    )  # fmt: skip
    names = {"stage": "auto-1", "scenarios": scenarios, "skill": "auto-1"}
    size = {"nodes": skill.num_nodes, "depth": skill.depth, "seconds": 1.5}
    test = test if tested else None
    more = {"fresh": test, "overall": test, "decisive": None, "asked": ASKED}
    practice = {"in_a_row": 3, "practice": 20}
    result = {**names, **numbers, **size, **more, **practice}
    goal = {"stage": "auto", "reached": False, "target": 0.9, "minutes": 5.0, "rounds": 30}
    write_log(folder, [{"event": "result", **result}, {"event": "ended", **goal}])
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
    page = parsed(read_run(run.folder).folder)
    drawn = {e.get("data-part"): len([*e.iter("use")]) for e in a_map(page).iter("g")}
    assert (drawn["reached"], drawn["missed"]) == (1493, 7)
    text = words(page.get_element_by_id("stage-1"))
    assert "2000 scenarios reached, 7 missed; seen from above, 1500 of them drawn" in text
    assert "34 of 40 reached" in words(page.get_element_by_id("overall"))
    assert next(words(e) for e in page.iter("article")).startswith("auto-1: perimeter")


@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize("tested", [True, False])
def test_what_was_asked_is_a_table(tmp_path: Path, tested: bool) -> None:
    page = parsed(auto_run(tmp_path / "run", "perimeter", 7, tested).folder)
    (table,) = [e for e in page.iter("table") if "asked of the world" in words(e.find("caption"))]
    head, *rows = [[words(cell) for cell in row.iter("th", "td")] for row in table.iter("tr")]
    assert head == ["phase", "motions", "tests", "scenes looked at", "episodes"]
    counts = [[phase, *map(str, [*asked.values()][:4])] for phase, asked in ASKED.items()]
    assert rows == [*counts, ["all", "29", "23", "75", "7"]]


def test_a_round_without_tests_on_fresh_scenarios_claims_nothing(tmp_path: Path) -> None:
    """Where a world does not repeat itself, a skill is judged by practice and not tested again."""
    run = auto_run(tmp_path / "run", "general", 7, tested=False)
    page = parsed(run.folder)
    head, row = ([words(c) for c in line.iter("th", "td")] for line in
                 page.get_element_by_id("results").find(".//table").iter("tr"))  # fmt: skip
    shown = dict(zip(head, row, strict=True))
    assert (shown["stage"], shown["fresh"], shown["overall"]) == ("auto-1", "–", "–")
    cards = {words(e.find("dt")): words(e.find("dd")) for e in page.find_class("cards")[0]}
    assert cards["Reached, general"] == "–"  # of no test there is no interval
    pictures = page.get_element_by_id("results").find_class("picture")
    assert not [words(each) for each in pictures if not list(each.iter("svg", "img"))]
    known = json.loads((run.folder / "auto-1" / "scenarios.json").read_text())
    counts = f"{len(known['W'])} scenarios reached, {len(known['M'])} missed"
    assert counts in words(page.get_element_by_id("stage-1"))
