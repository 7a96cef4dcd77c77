"""Animated pictures of a skill in physics, drawn by MuJoCo's renderer."""

import io
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy

from cgtorch.graphs import Skill
from cgtorch.ground.errors import SettingsError
from cgtorch.tabletop.physics.model import Model, mujoco
from cgtorch.tabletop.physics.world import Physics
from cgtorch.tabletop.viewer.execution import execute
from cgtorch.tabletop.world import ObservedTabletop, Scenarios

WIDTH, HEIGHT = 480, 360  # px
EVERY = 0.16  # s of the simulation between two pictures
LASTS, END = 80, 1200  # ms that a picture is shown, and the last one
DISTANCE, BEHIND, DOWN = 5.0, 35.0, -35.0  # m, and degrees, of the camera
CONTACT = 0.02  # m, about the size of the mark of a contact


class Camera:
    """Takes pictures of a simulation, as `Physics.watch`."""

    def __init__(self, scenario: Scenarios) -> None:
        """A camera behind the robot that looks over its shoulder at the object."""
        mj = mujoco()
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
        self.last = -1

    def __call__(self, model: Model) -> None:
        """Take a picture if it is due."""
        now = int(model.data.time / EVERY)
        if now == self.last:
            return
        self.last = now
        renderer = self.renderers.get(id(model.model)) or _renderer(model)
        self.renderers[id(model.model)] = renderer
        renderer.update_scene(model.data, self.view, self.shown)
        self.pictures.append(renderer.render().copy())


def _renderer(model: Model) -> Any:
    scale, size = model.model.vis.scale, CONTACT / model.model.stat.meansize
    scale.contactwidth, scale.contactheight = size, size / 4
    try:
        return mujoco().Renderer(model.model, HEIGHT, WIDTH)
    except Exception as e:  # whatever a graphics library raises
        raise SettingsError(
            f"MuJoCo cannot draw here ({type(e).__name__}); install libegl1 or libosmesa6"
        ) from e


WorldIn: TypeAlias = Callable[[Physics, Scenarios], ObservedTabletop]
"""Makes the world of scenarios in some physics."""


def film_of(
    skill: Skill, physics: Physics, world_in: WorldIn, scenario: Scenarios, kind: str
) -> tuple[str, bytes]:
    """The end of a skill on the first scenario, and an animated picture as `kind`, gif or webp.

    SettingsError if this machine cannot draw.
    """
    end, pictures = pictures_of(skill, physics, world_in, scenario)
    return end, animated([pictures], kind)


def pictures_of(
    skill: Skill, physics: Physics, world_in: WorldIn, scenario: Scenarios
) -> tuple[str, list[Any]]:
    """The end of a skill on the first scenario, and pictures of `WIDTH` and `HEIGHT`.

    Contact points are marked. SettingsError if this machine cannot draw.
    """
    camera = Camera(scenario)
    watched = replace(physics, watch=camera, models={})
    try:
        end = execute(skill, world_in(watched, scenario)).end
    finally:
        for renderer in camera.renderers.values():
            renderer.close()
    if not camera.pictures:
        raise SettingsError(
            f"skill {skill.name!r} moves nothing on this scenario; try another one (--seed 1)"
        )
    return end, camera.pictures


def animated(films: Sequence[Sequence[Any]], kind: str) -> bytes:
    """Films one after the other, each with its last picture shown longer, as a gif or webp."""
    from PIL import Image

    pictures = [Image.fromarray(picture) for film in films for picture in film]
    lasts = [time for film in films for time in (*[LASTS] * (len(film) - 1), END)]
    how: dict[str, Any] = {"quality": 60, "method": 4}
    if kind == "gif":
        how = {"optimize": True}
        pictures = [p.quantize(96, dither=Image.Dither.NONE) for p in pictures]
    out, (first, *more) = io.BytesIO(), pictures
    first.save(out, kind.upper(), save_all=True, append_images=more, duration=lasts, loop=0, **how)
    return out.getvalue()
