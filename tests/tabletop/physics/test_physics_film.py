"""Where the camera of a film stands, and when it takes a picture."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy
import pytest
import torch
from support import seeded

from cgtorch.ground.errors import SettingsError
from cgtorch.tabletop.physics import Physics, film
from cgtorch.tabletop.physics.film import (
    BEHIND,
    CONTACT,
    DISTANCE,
    DOWN,
    EVERY,
    LASTS,
    Camera,
    film_of,
)
from cgtorch.tabletop.world import Scenarios, random_scenarios, stage_scenarios


def scene(start: tuple[float, float], table: tuple[float, float], at: list[float]) -> Scenarios:
    """One scene with the robot, the table and the object there."""
    one = stage_scenarios("near", 1)
    pose, size = one.pose.clone(), one.table.clone()
    pose[0, :2], size[0, :2] = torch.tensor(start), torch.tensor(table)
    return replace(one, pose=pose, table=size, object=torch.tensor([at]))


@pytest.mark.parametrize(
    ("start", "table", "at", "azimuth"),
    [
        ((-2.0, 0.0), (2.0, 0.0), [2.0, 0.5], BEHIND),  # the object is to the left
        ((-2.0, 0.0), (2.0, 0.0), [2.0, -0.5], -BEHIND),
        ((1.0, -2.0), (1.0, 2.0), [0.5, 2.0], 90 + BEHIND),
        ((1.0, -2.0), (1.0, 2.0), [1.5, 2.0], 90 - BEHIND),
        ((0.0, 0.0), (2.0, 2.0), [2.0, 1.0], 45 - BEHIND),
    ],
)
def test_the_camera_looks_over_the_shoulder_on_the_side_of_the_object(
    start: tuple[float, float], table: tuple[float, float], at: list[float], azimuth: float
) -> None:
    """At a place between robot and table, three quarters of the way."""
    view = Camera(scene(start, table, at), 64).view
    assert view.azimuth == pytest.approx(azimuth)
    assert (view.distance, view.elevation) == (DISTANCE, DOWN)
    between = [a + 0.75 * (b - a) for a, b in zip(start, table, strict=True)]
    assert view.lookat[:2] == pytest.approx(between)
    assert 0.3 < view.lookat[2] < 1.2


class Renderer:
    """Draws the time, instead of a picture, for which a machine may have no library."""

    def __init__(self, model: Any, width: int) -> None:
        self.width, self.closed = width, False

    def close(self) -> None:
        self.closed = True

    def update_scene(self, data: Any, view: Any, shown: Any) -> None:
        self.seen = data.time

    def render(self) -> Any:
        return numpy.array([self.seen, self.width])


def test_pictures_are_taken_at_equal_times_and_belong_to_acts(
    monkeypatch: pytest.MonkeyPatch, physics: Physics
) -> None:
    monkeypatch.setattr(film, "renderer", Renderer)
    camera = Camera(stage_scenarios("near", 1), 64)
    model = physics.model(0, 0)
    stub = SimpleNamespace(model=model.model, data=SimpleNamespace(time=0.0))
    for step in range(40):
        stub.data.time = step * EVERY / 8 + 1e-6
        camera(stub)  # type: ignore[arg-type]
        if step == 20:
            camera.end_act()
    times = [picture[0] for picture in camera.pictures]
    assert times == pytest.approx([n * EVERY for n in range(5)], abs=1e-5)
    assert {picture[1] for picture in camera.pictures} == {64}
    assert camera.acts == [0, 0, 0, 1, 1]
    assert len(camera.renderers) == 1


@pytest.mark.parametrize("moves", [True, False])
def test_a_film_is_of_all_that_moves_and_its_renderers_are_closed(
    moves: bool, monkeypatch: pytest.MonkeyPatch, physics: Physics
) -> None:
    made, model = list[Renderer](), physics.model(0, 0)

    def renderer(model: Any, width: int) -> Renderer:
        made.append(Renderer(model, width))
        return made[-1]

    def execute(skill: Any, world: Any, ended: Any) -> Any:
        assert (world.robot, world.models) == (physics.robot, {})  # of its own, to be watched
        for step in range(3 * moves):
            data = SimpleNamespace(time=step * EVERY + 1e-6)
            world.watch(SimpleNamespace(model=model.model, data=data))
            ended()
        return SimpleNamespace(end="timeout")

    monkeypatch.setattr(film, "renderer", renderer)
    monkeypatch.setattr(film, "execute", execute)
    skill: Any = SimpleNamespace(name="still")
    about: Any = skill, physics, lambda watched, scenario: watched, stage_scenarios("near", 1), 32
    if not moves:
        with pytest.raises(SettingsError, match="skill 'still' moves nothing on this scenario"):
            film_of(*about)
        return
    found = film_of(*about)
    assert [width for _, width in found.frames] == [32] * 3
    assert (found.lasts, found.end, found.acts) == (LASTS, "timeout", [0, 1, 2])
    assert [each.closed for each in made] == [True]
    scale, size = model.model.vis.scale, CONTACT / model.model.stat.meansize
    assert (scale.contactwidth, scale.contactheight) == pytest.approx((size, size / 4))


def test_a_film_is_of_the_first_scenario_on_which_anything_moves(
    monkeypatch: pytest.MonkeyPatch, physics: Physics
) -> None:
    tried, model = list[float](), physics.model(0, 0)

    def execute(skill: Any, world: Any, ended: Any) -> Any:
        tried.append(float(world.object[0, 0]))
        if len(tried) == 3:
            world.watch(SimpleNamespace(model=model.model, data=SimpleNamespace(time=0.0)))
        return SimpleNamespace(end=f"end {len(tried)}")

    def world_in(watched: Any, scenario: Scenarios) -> Any:
        return SimpleNamespace(watch=watched.watch, object=scenario.object)

    monkeypatch.setattr(film, "renderer", Renderer)
    monkeypatch.setattr(film, "execute", execute)
    scenarios, skill = random_scenarios("near", 5, seeded(0)), SimpleNamespace(name="S0")
    found = film_of(skill, physics, world_in, scenarios, 32)  # type: ignore[arg-type]
    assert (found.end, len(found.frames)) == ("end 3", 1)
    assert tried == scenarios.object[:3, 0].tolist()
    with pytest.raises(SettingsError, match="moves nothing on any of 2 scenarios; try others"):
        film_of(skill, physics, world_in, scenarios[3:], 32)  # type: ignore[arg-type]
