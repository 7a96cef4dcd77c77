"""Animated pictures of a skill in physics, drawn by MuJoCo's renderer."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

import numpy

from cgtorch.domains.film import WIDTH, Film, renderer
from cgtorch.graphs import Skill
from cgtorch.ground.errors import SettingsError
from cgtorch.tabletop.physics.model import Model, mujoco
from cgtorch.tabletop.physics.world import Physics
from cgtorch.tabletop.viewer.execution import execute
from cgtorch.tabletop.world import ObservedTabletop, Scenarios

EVERY = 0.16  # s of the simulation between two pictures
LASTS = 80  # ms that a picture is shown
DISTANCE, BEHIND, DOWN = 5.0, 35.0, -35.0  # m, and degrees, of the camera
CONTACT = 0.02  # m, about the size of the mark of a contact


class Camera:
    """Takes pictures of a simulation, as `Physics.watch`."""

    def __init__(self, scenario: Scenarios, width: int) -> None:
        """A camera behind the robot that looks over its shoulder at the object."""
        mj, self.width = mujoco(), width
        self.view, self.shown = mj.MjvCamera(), mj.MjvOption()
        self.shown.flags[mj.mjtVisFlag.mjVIS_CONTACTPOINT] = True
        start, table = scenario.pose[0, :2].double(), scenario.table[0, :2].double()
        (x, y), (ahead, aside) = (scenario.object[0] - start).tolist(), (table - start).tolist()
        side = 1.0 if ahead * y - aside * x > 0 else -1.0
        self.view.lookat[:] = [*((start + 3 * table) / 4).tolist(), 0.65]
        self.view.distance, self.view.elevation = DISTANCE, DOWN
        self.view.azimuth = float(numpy.degrees(numpy.arctan2(aside, ahead))) + side * BEHIND
        self.pictures: list[Any] = []
        self.renderers: dict[int, Any] = {}
        self.acts: list[int] = []
        self.act, self.last = 0, -1

    def __call__(self, model: Model) -> None:
        """Take a picture if it is due."""
        now = int(model.data.time / EVERY)
        if now == self.last:
            return
        self.last = now
        if id(model.model) not in self.renderers:
            scale, size = model.model.vis.scale, CONTACT / model.model.stat.meansize
            scale.contactwidth, scale.contactheight = size, size / 4
            self.renderers[id(model.model)] = renderer(model.model, self.width)
        mine = self.renderers[id(model.model)]
        mine.update_scene(model.data, self.view, self.shown)
        self.pictures.append(mine.render().copy())
        self.acts.append(self.act)

    def end_act(self) -> None:
        """An action of the skill has ended."""
        self.act += 1


WorldIn: TypeAlias = Callable[[Physics, Scenarios], ObservedTabletop]
"""Makes the world of scenarios in some physics."""


def film_of(
    skill: Skill, physics: Physics, world_in: WorldIn, scenarios: Scenarios, width: int = WIDTH
) -> Film:
    """The film of a skill on the first scenario on which it moves anything, with contacts marked.

    SettingsError if this machine cannot draw, or the skill moves nothing on any of them.
    """
    for number in range(len(scenarios)):
        if film := _film_of_one(skill, physics, world_in, scenarios[number : number + 1], width):
            return film
    which = "this scenario" if len(scenarios) == 1 else f"any of {len(scenarios)} scenarios"
    raise SettingsError(
        f"skill {skill.name!r} moves nothing on {which}; try others, as those that it was trained "
        "on (--scenarios near for one of S0)"
    )


def _film_of_one(
    skill: Skill, physics: Physics, world_in: WorldIn, scenario: Scenarios, width: int
) -> Film | None:
    """The film of a skill on one scenario; None if it moves nothing there."""
    camera = Camera(scenario, width)
    watched = replace(physics, watch=camera, models={})
    try:
        end = execute(skill, world_in(watched, scenario), ended=camera.end_act).end
    finally:
        for each in camera.renderers.values():
            each.close()
    return Film(camera.pictures, LASTS, end, camera.acts) if camera.pictures else None
