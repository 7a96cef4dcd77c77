"""What a page says of a stage and of the models, by itself."""

from dataclasses import replace
from typing import Any

import pytest
from lxml import etree
from members import nearly
from report_pages import REFERENCE
from support import random_graphs, seeded

from cgtorch.graphs import Skill
from cgtorch.ground.errors import RunError
from cgtorch.report.sections import Stage, model_quality, stage_sections
from cgtorch.runs.stored_run import StoredRun, read_run
from cgtorch.tabletop.actions import paper_actions

RESULT = {"scenarios": "near", "fresh": {"tried": 3, "succeeded": 2}}
BARE: dict[str, Any] = {
    "gamma__learning_curve": {"sizes": [], "train_scores": [], "test_scores": []},
    "classifier__learning_curve": None,
    "classifier__reliability": [],
}
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def run() -> StoredRun:
    return read_run(REFERENCE)


def marks(svg: str) -> dict[str, int]:
    """How many marks a map has of each kind."""
    groups = [e for e in etree.fromstring(svg).iter() if e.get("data-part")]
    return {e.get("data-part"): len([*e.iter(f"{SVG}use")]) for e in groups}


def test_a_stage_has_a_map_a_graph_and_its_tables(run: StoredRun) -> None:
    tests = run.domain.tests("near")
    others = run.domain.draw("near", 6, seeded(0))
    stage = Stage("S0", RESULT, nearly(0.5), tests.joined(others[:4]), others[4:], None)
    sections = stage_sections(run, [stage])
    assert [section["name"] for section in sections] == ["S0", "S1", "S2", "S3"]
    assert [section["scenarios"] for section in sections] == ["near", "left", "right", "far"]
    assert all(section["tested"] and section["drawing"] for section in sections)
    assert [section["stage"] for section in sections] == [stage, None, None, None]
    found = sections[0]
    picture, words = found["map"]
    assert words == (
        "ahead 0.5: 9 scenarios reached, 2 missed, the tests of this stage marked; seen from above"
    )
    drawn = marks(picture)
    assert (drawn["reached"], drawn["missed"], drawn["targets"]) == (9, 2, 5)
    title, start, rows = found["panels"][0]
    assert title == "ahead 0.5"
    assert found["graph"][1] == f"ahead 0.5: {nearly(0.5).num_nodes} nodes, starting at {start}"
    assert "the skill succeeds" in {row[2] for row in rows}


def test_of_a_round_no_tests_are_marked_and_no_stages_are_missing(run: StoredRun) -> None:
    solved = run.domain.tests("near")
    actions = paper_actions()
    skill = Skill("auto-1", random_graphs(0, 1, actions, nodes=(1, 2)), actions)
    stage = Stage("auto-1", RESULT | {"scenarios": "any"}, skill, solved, solved[:0], None)
    sections = stage_sections(run, [stage])
    assert [(each["name"], each["tested"]) for each in sections[:1]] == [("S0", True)]
    run = replace(run, settings=replace(run.settings, scenarios="general"))
    (found,) = stage_sections(run, [stage])
    assert (found["name"], found["scenarios"], found["tested"]) == ("auto-1", "any", False)
    assert (found["drawing"], found["published"]) == ("", None)
    assert found["map"][1] == "auto-1: 5 scenarios reached, 0 missed; seen from above"
    assert found["graph"][1].startswith("auto-1: 1 node, starting at ")
    empty = Stage("auto-1", RESULT, skill, solved[:0], solved[:0], None)
    (found,) = stage_sections(run, [empty])
    assert found["map"] == ("", "auto-1: no scenarios are kept, as fresh episodes decide")


def report(**changes: Any) -> dict[str, Any]:
    """Reports of two numbers, one of which is a length."""
    curve = {"sizes": [10, 20], "train_scores": [[1, 0.5], [1, 1]], "test_scores": [[0], [0.5]]}
    gamma: dict[str, Any] = {
        "coordinates": ["place", "heat"], "units": ["m", "K"], "error": [0.01234, 3.14159],
        "baseline_error": [0.5, 10.0], "choice": [{"C": 1.0}, None], "learning_curve": curve,
    }  # fmt: skip
    classifier: dict[str, Any] = {
        "reliability": [[0.0, 1.0, 1], [1.0, 0.0, 41]],
        "learning_curve": curve,
    }
    for name, value in changes.items():
        model, _, key = name.partition("__")
        {"gamma": gamma, "classifier": classifier}[model][key] = value
    return {"seconds": 2.5, "gamma": gamma, "classifier": classifier}


def texts(svg: str) -> str:
    return " ".join(etree.fromstring(svg).itertext())


def test_the_last_reports_of_the_models_are_shown() -> None:
    rows = [
        {"seconds": 1.0, "gamma": None, "classifier": None},
        report(gamma__error=[1.0, 1.0]),
        report(),
        {"seconds": 4.0, "gamma": report()["gamma"], "classifier": None},
    ]
    found = model_quality(rows)
    assert found["seconds"] == [1.0, 2.5, 2.5, 4.0]
    assert found["errors"] == [("place", "1.23 cm", "50.00 cm"), ("heat", "3.14 K", "10 K")]
    assert found["choices"] == [(" for place", {"C": 1.0})], "heat has no machine"
    assert "C on 42 held-out labels" in texts(found["reliability"])
    said = texts(found["learning"])
    for words in ("Γ: − error of what it learns", "C: balanced accuracy", "rows learned from"):
        assert words in said
    assert (found["gamma"], found["classifier"]) == (rows[2]["gamma"], rows[2]["classifier"])


def test_units_and_names_are_said_where_they_are_known() -> None:
    unnamed = model_quality([report(**BARE, gamma__choice=[{"C": 1.0}])])
    assert unnamed["choices"] == [("", {"C": 1.0})], "one machine has learned both"
    unit = model_quality([report(**BARE, gamma__units=["", "m"])])
    assert unit["errors"][0] == ("place", "0.0123", "0.5")


def test_models_without_reports_and_curves_have_no_pictures() -> None:
    rows = [{"seconds": 1.0, "gamma": None, "classifier": None}]
    assert model_quality(rows) == {"seconds": [1.0], "gamma": None}
    assert model_quality([]) == {"seconds": [], "gamma": None}
    found = model_quality([report(**BARE)])
    assert (found["learning"], found["reliability"]) == ("", "")


@pytest.mark.parametrize(
    "changes",
    [
        {"gamma__units": ["m"]},
        {"gamma__baseline_error": [1.0, 1.0, 1.0]},
        {"classifier__reliability": [[-0.01, 0.5, 4]]},
        {"classifier__reliability": [[1.01, 0.5, 4]]},
        {"classifier__reliability": [[0.5, -0.01, 4]]},
        {"classifier__reliability": [[0.5, 1.01, 4]]},
        {"classifier__reliability": [[0.5, 0.5, 0]]},
        {"classifier__reliability": [[0.5, 0.5, 4, 4]]},
        {"gamma__learning_curve": {"sizes": [1], "train_scores": [[1]], "test_scores": [[]]}},
        {"classifier__learning_curve": {"sizes": [1], "train_scores": [], "test_scores": [[1]]}},
    ],
)
def test_reports_that_fit_nothing_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(RunError, match=r"a report of the models in the log is damaged; restore"):
        model_quality([report(**changes)])
