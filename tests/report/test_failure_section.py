"""The section on where the last skill fails: three answers, and each kind of failure once."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from lxml import html
from members import nearly
from reaching import TABLE, small_knowledge
from report_pages import HOSTILE, REFERENCE, thinned, words

from cgtorch.domains.failures import Explained, Failures, Tried
from cgtorch.domains.pictures import Pictures
from cgtorch.report.failure_section import FIRST, KINDS, LAST, failure_section
from cgtorch.report.failure_words import about_kind, course_of, title_of, which_fail
from cgtorch.report.page import report_page
from cgtorch.runs.stored_run import read_run
from cgtorch.training.evaluate import evaluate_skill
from cgtorch.training.explained import explained
from cgtorch.training.failures import Background, failures_of

SKILL = nearly(0.25)


@pytest.fixture(scope="module")
def why() -> Explained:
    score = evaluate_skill(SKILL, TABLE, "perimeter", 30, 2)
    found = failures_of(SKILL, TABLE, score, Background(small_knowledge(), modelled=True))
    return Explained(found, 7, SKILL, score.scenarios, score.succeeded)


def page_of(why: Explained | None, folder: Path) -> html.HtmlElement:
    run = read_run(thinned(folder, "S0", models=False, generations=False))
    return html.document_fromstring(report_page(run, why).decode())


def test_the_section_answers_three_questions_and_shows_each_kind(
    why: Explained, tmp_path: Path
) -> None:
    page, found = page_of(why, tmp_path / "run"), why.found
    section = page.get_element_by_id("failures")
    answers = section.find_class("answers")[0]
    asked = [words(term) for term in answers.iter("dt")]
    told = [words(detail) for detail in answers.iter("dd")]
    assert asked == [
        "Which scenarios fail?", "Is Γ or the search to blame?", "What should I change?",
    ]  # fmt: skip
    assert told[0] == " ".join(which_fail(found))
    assert told[1] == found.blame
    assert all(advice.text in told[2] for advice in found.advice)
    kinds = section.findall("article")
    assert len(kinds) == min(KINDS, len(found.kinds))
    for shown, kind in zip(kinds, found.kinds, strict=False):
        assert f"{title_of(kind)} ({len(kind.scenarios)})" in words(shown)
        assert all(sentence in words(shown) for sentence in about_kind(found, kind, TABLE))
        rows = [*shown.iter("tr")][1:]
        steps = len(kind.way.acts)
        cut = steps > FIRST + LAST
        assert len(rows) == 1 + (FIRST + LAST + 1 if cut else steps)
        assert "object x" in words(rows[0])
    assert [*section.iter("svg")], "a picture where the domain draws scenarios"
    assert "#failures" in {link.get("href") for link in page.iter("a")}


def test_a_picture_marks_what_fails_in_this_way_only(why: Explained) -> None:
    seen = []

    class Looking(Pictures[None]):
        def scenarios(self, scenarios, succeeded, targets, title=""):  # type: ignore[no-untyped-def]
            seen.append((len(scenarios), int(succeeded.sum()), int(targets.sum())))

    shown = failure_section(why, TABLE, Looking(None))
    assert all(not kind["map"] for kind in shown["kinds"])
    solved = int(why.succeeded.sum())  # type: ignore[union-attr]
    for kind, counted in zip(why.found.kinds, seen, strict=False):
        assert counted == (solved + len(kind.scenarios), solved, 0)


def test_names_from_files_are_text(why: Explained, tmp_path: Path) -> None:
    kinds = tuple(
        replace(kind, node=name) for kind, name in zip(why.found.kinds, HOSTILE, strict=False)
    )
    page = page_of(replace(why, found=replace(why.found, kinds=kinds)), tmp_path / "run")
    assert not [*page.iter("script", "iframe", "img")]
    assert not [e for e in page.iter() for name in e.attrib if name.startswith("on")]


def test_nothing_is_said_of_failures_that_were_not_looked_at(tmp_path: Path) -> None:
    page = page_of(None, tmp_path / "run")
    assert page.find(".//section[@id='failures']") is None


def test_a_skill_that_solves_all_and_a_run_without_a_skill() -> None:
    why = explained(read_run(REFERENCE))
    assert why is not None
    assert why.found.failed == 0, "of all stages of the reference run"
    assert why.found.advice == ()
    assert which_fail(why.found)[0] == "0 of 160 scenarios fail."
    assert which_fail(Failures("")) == [
        "There is no skill yet that could be tried on fresh scenarios."
    ]


def test_the_course_of_a_failure_is_told_in_short(why: Explained) -> None:
    acts = why.found.kinds[0].way.acts
    still = replace(acts[0], node="Grasp", outcome="failure", motions=(), refused=None)
    moving = next(a for k in why.found.kinds for a in k.way.acts if a.motions)
    refused = replace(still, node="MoveBase", refused=torch.zeros(3))
    way = replace(why.found.kinds[0].way, acts=(moving, refused, refused, still, moving, still))
    done = 2 * len(moving.motions)
    assert course_of(way) == (
        f"In 6 steps {done} controls were carried out and 2 refused; 2 of the steps were "
        "Grasp → failure."
    )
    once = replace(way, acts=(moving, still))
    were = "1 control was" if done == 2 else f"{done // 2} controls were"
    assert course_of(once) == f"In 2 steps {were} carried out."


def test_kinds_without_a_skill_and_returns_are_named(why: Explained) -> None:
    kind = replace(why.found.kinds[0], end="failure", node="Step → success")
    titles = {(): "failure", (-3.0,): "return below the target", (float("-inf"),): "failure"}
    for returns, title in titles.items():
        found = title_of(replace(kind, returns=returns))
        assert found == f"{title}, ending at Step → success"
    tried = (Tried("near", 40, 30), Tried("left", 40, 0, made=False))
    said = which_fail(replace(why.found, tried=tried))
    assert "By kind: 10 of 40 near, 40 of 40 left (for which no skill was found yet)." in said


def test_where_prediction_and_world_part_is_told_by_number_and_unit(why: Explained) -> None:
    kind = next(k for k in why.found.kinds if any(act.motions for act in k.way.acts))
    number = next(i for i, act in enumerate(kind.way.acts) if act.motions)
    act = kind.way.acts[number]
    motion = act.motions[0]
    assert motion.errors is not None
    assert motion.predicted is not None
    errors = motion.errors.clone()
    errors[:] = 0
    errors[4] = 7.25
    wrong = replace(act, motions=(replace(motion, error=3.0, errors=errors),))
    acts = (*kind.way.acts[:number], wrong, *kind.way.acts[number + 1 :])
    parted = replace(kind, way=replace(kind.way, acts=acts))
    said = about_kind(why.found, parted, TABLE)[-1]
    assert said.startswith(f"Prediction and world part in step {number}: object x is ")
    assert f" m where Γ says {float(motion.predicted[4]):.3g} m, 7.2 times its usual" in said
