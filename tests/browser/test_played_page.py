"""`cgtorch-view` of a domain that draws pictures, as one sees it in a real browser."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from chromium import Visit, served, visit
from playwright.sync_api import Browser, expect
from support import circle

from cgtorch.domains.registry import make_domain
from cgtorch.graphs import save_skill

DOMAIN = "gymnasium:CartPole-v1"
NAME = '<iframe srcdoc="<script>parent.hit=1</script>"></iframe></script><b>x</b>'


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    pytest.importorskip("pygame")
    skill = replace(circle(make_domain(DOMAIN).actions(), "Linear", "Step"), name=NAME)
    path = tmp_path_factory.mktemp("view") / "skill.json"
    save_skill(path, skill)
    with served("cgtorch.commands.view", str(path), "--domain", DOMAIN, "--port", "0") as url:
        yield url


@pytest.fixture
def opened(chromium: Browser, address: str) -> Iterator[Visit]:
    with visit(chromium, address) as at:
        yield at
        assert [error for error in at.errors if "favicon" not in error] == []


def test_a_skill_is_seen_picture_by_picture_with_what_it_does(opened: Visit) -> None:
    page = opened.page
    headline, picture = page.locator("#headline"), page.locator("#picture")
    expect(headline).to_have_text("before the first step")
    first = picture.get_attribute("src")
    assert picture.evaluate("image => image.decode().then(() => image.naturalWidth)") > 100
    page.get_by_role("button", name="next").click()
    expect(headline).to_contain_text(re.compile(r"step 0 of 0 to \d+: Linear_0 → success"))
    page.get_by_role("button", name="next").click()
    expect(headline).to_contain_text("Step_1 → success")
    expect(page.locator("#percept")).to_contain_text("observation 4")
    expect(page.locator("#about")).to_contain_text("preference for action = 0")
    assert picture.get_attribute("src") != first
    page.get_by_role("button", name="back").click()
    expect(headline).to_contain_text("Linear_0")
    page.locator("#slider").press("End")
    steps = page.locator("#steps li")
    expect(steps.last).to_have_attribute("aria-current", "step")
    page.get_by_role("button", name="Play").click()
    expect(steps.last).not_to_have_attribute("aria-current", "step")
    page.get_by_role("button", name="Pause").click()
    steps.nth(3).click()
    expect(headline).to_contain_text("step 3 of")


def test_another_scenario_is_chosen(opened: Visit) -> None:
    page = opened.page
    before = page.locator("#percept").inner_text()
    page.get_by_label("Number").fill("3")
    page.get_by_role("button", name="Run").click()
    expect(page.get_by_label("Number")).to_have_value("3")
    expect(page.locator("#headline")).to_have_text("before the first step")
    assert page.locator("#percept").inner_text() != before


def test_names_are_text_and_strangers_see_nothing(
    chromium: Browser, opened: Visit, address: str, tmp_path: Path
) -> None:
    page = opened.page
    expect(page.get_by_role("heading", name=f"{NAME} ends in failure")).to_be_visible()
    assert page.evaluate("window.hit") is None
    assert page.locator("iframe, b").count() == 0
    other = tmp_path / "other.html"
    other.write_text(
        f'<iframe id="in" src="{address}"></iframe><script>'
        f"fetch('{address}').then(a => a.text()).then(() => {{ document.title = 'read' }},"
        "() => { document.title = 'refused' })</script>"
    )
    with visit(chromium, other.as_uri()) as at:
        at.page.wait_for_function("document.title")
        assert at.page.title() == "refused"
        assert "ends in" not in at.page.frames[-1].content()
