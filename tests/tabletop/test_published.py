"""The paper's drawings of its experiments, and what is said and filmed of the tabletop."""

from types import SimpleNamespace
from typing import Any

import pytest
from lxml import etree
from support import seeded

from cgtorch.tabletop import published
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.published import EXPERIMENTS, ROOM, TabletopPictures, stage_drawing
from cgtorch.tabletop.world import random_scenarios, stage_scenarios

FOOTPRINT = (-0.2, 0.3, -0.25, 0.35)


def boxes_of(drawing: str) -> list[list[float]]:
    names = "x", "y", "width", "height"
    rects = etree.fromstring(drawing.encode()).iter("{*}rect")
    return [[float(rect.get(name)) for name in names] for rect in rects]


@pytest.mark.parametrize("edge", ["near", "left", "right", "far"])
def test_an_experiment_is_drawn_as_the_robot_sees_it(edge: str) -> None:
    drawing = stage_drawing(edge, FOOTPRINT)
    boxes = boxes_of(drawing)
    assert [-60, -40, 120, 80] in boxes  # the table's left is left, and what is far is up
    assert [-35, 140 - 30, 60, 50] in boxes
    root = etree.fromstring(drawing.encode())
    left, top, width, height = map(float, root.get("viewBox").split())
    assert (left, top) == (-60 - ROOM, -40 - ROOM)
    assert width == 120 + 2 * ROOM
    assert top + height == pytest.approx(140 - 30 + 50 + ROOM)
    (ellipse,) = root.iter("{*}ellipse")
    objects = -100 * stage_scenarios(edge).object.flip(1)
    low, high = objects.amin(0), objects.amax(0)
    centre = [float(ellipse.get(name)) for name in ("cx", "cy")]
    assert centre == pytest.approx(((low + high) / 2).tolist(), abs=0.1)
    for x, y in objects.tolist():
        assert f"{x:.1f}" in drawing
        assert f"{y:.1f}" in drawing


def test_what_was_published_is_known_by_stage() -> None:
    assert set(EXPERIMENTS) == {"", "S0", "S1", "S2", "S3"}
    assert (EXPERIMENTS["S2"].succeeded, EXPERIMENTS["S2"].tried) == (4, 5)
    assert [words for words, _ in EXPERIMENTS["S0"].details] == ["Figure 3", "Figure 4, the graph"]


def pictures(world: str, touch: str = "fails") -> Any:
    description = SimpleNamespace(name="Robbie", footprint=FOOTPRINT)
    return TabletopPictures(
        SimpleNamespace(
            settings=SimpleNamespace(world=world, touch=touch), stages=Tabletop.stages,
            robot=SimpleNamespace(description=description), physics="physics", world_in="world in",
        )
    )  # fmt: skip


def test_the_robot_and_its_world_are_told() -> None:
    assert pictures("kinematic").about() == [("Robot", "Robbie"), ("World", "kinematic")]
    about = pictures("mujoco", "allowed").about()
    assert about[1] == ("World", "mujoco, a touch allowed")
    assert pictures("kinematic").stage("S1") == stage_drawing("left", FOOTPRINT)


def test_only_what_is_in_physics_is_filmed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    filmed = list[Any]()
    monkeypatch.setattr(published, "film_of", lambda *about: filmed.append(about) or "film")
    scenarios, skill = random_scenarios("near", 3, seeded(0)), object()
    assert pictures("kinematic").film(skill, scenarios, 50) is None
    assert pictures("mujoco").film(skill, scenarios, 50) == "film"
    ((shown, physics, world_in, drawn, width),) = filmed
    assert (shown, physics, world_in, width) == (skill, "physics", "world in", 50)
    assert drawn is scenarios


def test_scenes_are_drawn_with_the_robot_s_own_footprint(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = list[Any]()
    monkeypatch.setattr(
        published, "draw_placements", lambda *what, **how: drawn.append((what, how)) or "figure"
    )
    assert pictures("kinematic").scenarios("some", "good", "targets", title="S2") == "figure"
    wanted = ("some", "good", "targets"), {"footprint": FOOTPRINT, "title": "S2"}
    assert drawn == [wanted]
