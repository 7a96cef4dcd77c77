"""`cgtorch-view` as one sees it: the real server, the reference run, a real browser."""

import io
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch
from chromium import Visit, served, visit
from PIL import Image
from playwright.sync_api import Browser, Locator, Page, expect
from viser import __version__ as VERSION  # noqa: N812

from cgtorch.graphs import save_skill
from cgtorch.improvement.compose import branching_action, compose
from cgtorch.runs.chosen import last_skill

REFERENCE = Path(__file__).parents[2] / "runs" / "reference"
EYE, LOOKED_AT = np.array([-2.6, -4.4, 3.6]), np.array([-0.3, -0.2, 0.3])  # as the page begins
COARSE = "?fixedDpr=0.5"  # without a graphics card, pixels take most of the time
FIRST = re.compile(r"^step 1 of \d+: S3 · EdgeBranchingNN_0")

Array = npt.NDArray[np.float64]


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with served("cgtorch.commands.view", str(REFERENCE), "--port", "0") as url:
        yield url


@pytest.fixture(scope="module")
def loaded(chromium: Browser, address: str) -> Iterator[Visit]:
    with visit(chromium, address + COARSE, 1600, 900) as at:
        expect(headline(at.page)).to_have_text(FIRST)
        close = at.page.locator(".mantine-Notification-closeButton")
        if close.count():  # it warns that WebGL runs without a graphics card
            close.first.click()
        yield at


@pytest.fixture
def opened(loaded: Visit) -> Iterator[Visit]:
    """The page at its first picture, no matter what was done to it before."""
    loaded.page.get_by_role("button", name="first").click()
    expect(headline(loaded.page)).to_have_text(FIRST)
    yield loaded
    assert loaded.errors == []


def headline(page: Page) -> Locator:
    return page.locator(".readings b").first


def picture(page: Page) -> Array:
    """The scene as pixels (H, W, 3), once it stands still."""
    box = page.locator("canvas").first.bounding_box()
    assert box is not None
    before = np.zeros(0)
    for _ in range(60):
        page.wait_for_timeout(500)
        data = page.screenshot(clip=box)
        now = np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), dtype=float)
        if before.shape == now.shape and np.abs(now - before).max() < 8:
            return now
        before = now
    raise AssertionError("the scene never stands still")


def changed(one: Array, two: Array) -> float:
    """The share of pixels that differ visibly."""
    return float((np.abs(one - two).max(-1) > 40).mean())


def pixel(page: Page, point: Array) -> tuple[float, float]:
    """Where a point of the world (m) is on the page."""
    box = page.locator("canvas").first.bounding_box()
    assert box is not None
    ahead = (LOOKED_AT - EYE) / np.linalg.norm(LOOKED_AT - EYE)
    right = np.cross(ahead, [0, 0, 1])
    right /= np.linalg.norm(right)
    way = point - EYE
    scale = box["height"] / 2 / math.tan(math.radians(22.5)) / (way @ ahead)
    x = box["x"] + box["width"] / 2 + scale * (way @ right)
    return float(x), float(box["y"] + box["height"] / 2 - scale * (way @ np.cross(right, ahead)))


def test_the_robot_moves_while_the_skill_runs(opened: Visit) -> None:
    page = opened.page
    start = picture(page)
    assert len(np.unique(start.reshape(-1, 3), axis=0)) > 500  # a scene, not an empty canvas
    page.get_by_role("button", name="last").click()
    expect(headline(page)).to_contain_text("S3 ended with success")
    expect(headline(page)).to_contain_text("Grasp")
    end = picture(page)
    assert changed(start, end) > 0.06  # without the robot it would be 0.036
    page.get_by_role("button", name="first").click()
    expect(headline(page)).to_have_text(FIRST)
    assert changed(start, picture(page)) < 0.002


@pytest.fixture
def far_down(chromium: Browser, tmp_path: Path) -> Iterator[Visit]:
    """A placement of which a skill two levels below is in charge, in a team of two teams."""
    (run, one), (_, other) = (last_skill(REFERENCE / name) for name in ("S1", "S2"))
    branches = torch.zeros(1, branching_action(run.actions)[1].num_parameters)
    team = compose("both", [one, other], branches, run.actions, one.max_transitions)
    save_skill(tmp_path / "both.json", team)
    words = str(tmp_path / "both.json"), "--scenarios", "near"
    with (
        served("cgtorch.commands.view", *words, "--port", "0") as at,
        visit(chromium, at + COARSE, 1600, 900) as opened,
    ):
        expect(headline(opened.page)).to_contain_text("step 1 of")
        yield opened


@pytest.mark.hostile
def test_the_active_node_is_lit_on_every_level(far_down: Visit) -> None:
    page = far_down.page
    levels = page.locator(".graph-levels svg")
    for step in range(2, 7):  # until a node of a sub-skill in a sub-skill is active
        page.get_by_role("button", name="next").click()
        expect(headline(page)).to_contain_text(f"step {step} of")
        if levels.count() >= 3:
            break
    node = re.search(r"· (\w+_\d+) →", headline(page).inner_text())
    assert node is not None
    count = levels.count()
    assert count >= 3
    colours = page.evaluate(
        "() => [...document.querySelectorAll('.graph-levels [data-part^=\"node:\"]')].map(node => "
        "[node.dataset.part, getComputedStyle(node.querySelector('path')).fill])"
    )
    lit = [gid for gid, fill in colours if fill == "rgb(255, 214, 10)"]
    assert len(lit) == count
    assert lit[-1].endswith(f":{node[1]}")


def test_play_pause_and_scrub(opened: Visit) -> None:
    page = opened.page
    page.get_by_role("button", name="Play").click()
    # Which step is seen first depends on how busy the machine is.
    expect(headline(page)).to_contain_text(re.compile(r"step ([3-9]|1\d) of"))
    page.get_by_role("button", name="Pause").click()
    # The server has heard of the click once the button is the other one.
    expect(page.get_by_role("button", name="Play")).to_be_visible()
    at = headline(page).inner_text()
    page.wait_for_timeout(1500)
    assert headline(page).inner_text() == at
    slider = page.get_by_role("slider").first
    slider.focus()
    slider.press("End")
    expect(headline(page)).to_contain_text("ended with")
    slider.press("Home")
    expect(headline(page)).to_have_text(FIRST)


def test_drag_the_object_and_run_again(opened: Visit) -> None:
    page = opened.page
    seen = page.locator(".readings").first.inner_text()
    at = np.array([-0.0026, -0.4732, 0.74])  # of the first scenario of seed 0
    arrow = pixel(page, at + np.array([0.16, 0, 0]))
    target = pixel(page, at + np.array([-0.14, 0, 0]))
    page.mouse.move(*arrow)
    page.wait_for_timeout(1000)
    page.mouse.down()
    for share in np.linspace(0, 1, 8):
        page.mouse.move(*(float(a + share * (b - a)) for a, b in zip(arrow, target, strict=True)))
        page.wait_for_timeout(200)
    page.mouse.up()
    expect(page.get_by_role("button", name="Pause")).to_be_visible()  # it runs again
    page.get_by_role("button", name="first").click()
    expect(headline(page)).to_have_text(FIRST)
    now = page.locator(".readings").first.inner_text()
    before, after = (float(re.search(r"object x\s+(\S+)", t)[1]) for t in (seen, now))
    assert before - after == pytest.approx(0.3, abs=0.1)


def test_compare_two_skills(opened: Visit) -> None:
    page = opened.page
    page.locator("input[role=combobox][value=nothing]").click()
    page.get_by_role("option", name="S0", exact=True).click()
    page.get_by_role("tab", name="Compared with").click()
    shown = page.locator(".readings b").filter(has_text=": S0 ·")
    expect(shown).to_be_visible()
    page.get_by_role("button", name="last").click()
    expect(page.locator(".readings b").filter(has_text="S0 ended with")).to_be_visible()
    page.locator("input[role=combobox][value=S0]").click()
    page.get_by_role("option", name="nothing", exact=True).click()
    expect(page.get_by_text("Choose a skill to compare with.")).to_be_visible()


def test_a_strangers_skill_runs_no_script_and_his_page_sees_nothing(
    chromium: Browser, tmp_path: Path
) -> None:
    _, skill = last_skill(REFERENCE)
    path, name = tmp_path / "skill.json", '<iframe srcdoc="<script>parent.hit=1</script>"></iframe>'
    save_skill(path, replace(skill, name=f"{name}**<b>x</b>**"))
    with served("cgtorch.commands.view", str(path), "--port", "0") as url:
        with visit(chromium, url + COARSE, 800, 600) as at:
            expect(headline(at.page)).to_contain_text("step 1 of")
            expect(at.page.get_by_text(name).first).to_be_attached()
            at.page.wait_for_timeout(2000)
            assert at.page.evaluate("window.hit") is None
            assert at.page.locator("iframe").count() == 0
        page = tmp_path / "other.html"
        page.write_text(
            f"<script>const s = new WebSocket('{url.replace('http', 'ws')}', 'viser-v{VERSION}');"
            "s.onopen = () => { document.title = 'open' };"
            "s.onerror = () => { document.title = 'refused' }</script>"
        )
        with visit(chromium, page.as_uri()) as other:
            other.page.wait_for_function("document.title")
            assert other.page.title() == "refused"
