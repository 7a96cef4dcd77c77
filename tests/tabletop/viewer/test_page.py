"""The page takes from browsers only what it can use, and shows foreign text as text."""

import io
import time
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cgtorch.ground.errors import SettingsError
from cgtorch.runs.chosen import last_skill
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.viewer.page import NONE, Page, Wish, open_page
from cgtorch.tabletop.viewer.timeline import Candidate

REFERENCE = Path(__file__).parents[3] / "runs" / "reference"
HOSTILE = '<iframe srcdoc="<script>alert(1)</script>"> **a** ![](x) \x1b[2J'


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    _, skill = last_skill(REFERENCE)
    candidates = {HOSTILE: Candidate(replace(skill, name=HOSTILE), Tabletop())}
    with redirect_stdout(io.StringIO()):
        made, _ = open_page(candidates, Wish(HOSTILE, None, "near", 4, 0), "127.0.0.1", 0)
    yield made
    made.server.stop()


def sent(handle: Any, value: object) -> None:
    """What a browser sends, of which viser checks only the type."""
    handle._impl.value = value


def test_names_are_text(page: Page) -> None:
    shown = page.note.content
    assert type(shown) is str
    assert "&lt;iframe srcdoc=" in shown
    assert "<iframe" not in shown
    assert "<script" not in "".join(part.content for pair in page.graphs for part in pair)
    assert "\\x1b[2J" in shown


def test_a_reason_why_nothing_runs_is_text(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(scenario: object) -> None:
        raise SettingsError("<b>no</b>")

    with monkeypatch.context() as patched:
        patched.setattr(page, "_run", fail)
        page.run()
    assert "<b>Not run</b>: &lt;b&gt;no&lt;/b&gt;" in page.note.content


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -1e300, 0.0])
def test_what_is_no_speed_or_picture_ends_nothing(page: Page, bad: object) -> None:
    page.run()
    sent(page.speed, bad)
    page.toggle()
    page.clock = time.monotonic() - 0.5
    page.tick()
    assert page.clock is not None
    assert 0 < page._picture() <= page.frame.max
    sent(page.frame, bad)
    page._wind()
    page.tick()
    page.step("next")
    page._seek(SimpleNamespace(client=None))
    sent(page.frame, bad)
    page.toggle()
    page.pause()
    sent(page.speed, 1.0)
    page.frame.value = 0


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -5, 1e9])
def test_what_is_no_number_of_a_scenario_is_the_nearest_one(page: Page, bad: object) -> None:
    sent(page.number, bad)
    sent(page.seed, bad)
    page.choose()
    sent(page.number, 1)
    sent(page.seed, 0)
    page.choose()


def test_choices_that_do_not_exist_change_nothing(page: Page) -> None:
    before = page.scenario
    for menu in (page.kind, page.against):
        kept = menu.value
        sent(menu, "<nowhere>")
        page.choose() if menu is page.kind else page.run()
        sent(menu, kept)
    assert page.scenario is before
    assert page.against.value == NONE
    kept = page.skill.value
    sent(page.skill, "<nobody>")
    page.run()
    sent(page.skill, kept)
    assert page.timelines


def test_an_object_is_dragged_to_a_place(page: Page) -> None:
    for place, moves in (((np.nan, 0, 0), False), ((0.1, -0.4, 0.7), True)):
        before = page.scenario
        page._dragged(SimpleNamespace(phase="end", target=SimpleNamespace(position=place)))
        assert (page.scenario is not before) == moves
