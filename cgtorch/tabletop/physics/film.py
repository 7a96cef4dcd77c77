"""Animated pictures of a skill in physics, drawn by MuJoCo's renderer."""

import io
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy

from cgtorch.graphs import Skill
from cgtorch.ground.errors import SettingsError
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.physics.engine import mujoco
from cgtorch.tabletop.physics.model import Model
from cgtorch.tabletop.viewer.execution import execute
from cgtorch.tabletop.world import Scenarios

WIDTH, HEIGHT = 480, 360  # px
EVERY = 0.16  # s of the simulation between two pictures
LASTS = 80  # ms that each is shown
END = 1200  # ms that the last one is
DISTANCE, BEHIND, DOWN = 5.0, 35.0, -35.0  # m, and degrees, of the camera
CONTACT = 0.02  # m, about the size of the mark of a contact


class Camera:
    """Takes pictures of a simulation."""

    def __init__(self, scenario: Scenarios) -> None:
        """A camera behind the robot that looks over its shoulder at the object."""
        mj = mujoco()
        self.view, self.pictures, self.renderers = mj.MjvCamera(), list[Any](), dict[int, Any]()
        start, table = scenario.pose[0], scenario.table[0]
        middle = (start[:2] + 3 * table[:2]) / 4
        self.view.lookat[:] = [float(middle[0]), float(middle[1]), 0.65]
        self.shown = mj.MjvOption()
        self.shown.flags[mj.mjtVisFlag.mjVIS_CONTACTPOINT] = True
        away = table[:2] - start[:2]
        heading = float(numpy.degrees(numpy.arctan2(float(away[1]), float(away[0]))))
        thing = scenario.object[0] - start[:2]
        side = 1.0 if float(away[0] * thing[1] - away[1] * thing[0]) > 0 else -1.0
        self.view.distance, self.view.azimuth = DISTANCE, heading + side * BEHIND
        self.view.elevation = DOWN
        self.last = -1

    def __call__(self, model: Model) -> None:
        """Take a picture if it is due."""
        now = int(model.data.time / EVERY)
        if now == self.last:
            return
        self.last = now
        key = id(model.model)
        if key not in self.renderers:
            self.renderers[key] = _renderer(model)
        self.renderers[key].update_scene(model.data, self.view, self.shown)
        self.pictures.append(self.renderers[key].render().copy())

    def close(self) -> None:
        """Free the renderer."""
        for renderer in self.renderers.values():
            renderer.close()


def _renderer(model: Model) -> Any:
    scale, size = model.model.vis.scale, CONTACT / model.model.stat.meansize
    scale.contactwidth, scale.contactheight = size, size / 4
    try:
        return mujoco().Renderer(model.model, HEIGHT, WIDTH)
    except Exception as e:  # whatever a graphics library raises
        raise SettingsError(
            f"MuJoCo cannot draw here ({type(e).__name__}); install libegl1 or libosmesa6"
        ) from e


def film_of(skill: Skill, domain: Tabletop, scenario: Scenarios, kind: str) -> tuple[str, bytes]:
    """The end of a skill on the first scenario, and an animated picture as `kind`, gif or webp.

    SettingsError if this machine cannot draw.
    """
    end, pictures = pictures_of(skill, domain, scenario)
    return end, animated([pictures], kind)


def pictures_of(skill: Skill, domain: Tabletop, scenario: Scenarios) -> tuple[str, list[Any]]:
    """The end of a skill on the first scenario, and pictures of `WIDTH` and `HEIGHT`.

    Contact points are marked. SettingsError if this machine cannot draw.
    """
    camera = Camera(scenario)
    physics = replace(domain.physics, watch=camera, memo={}, models={})
    watched = domain.watched(physics)
    try:
        end = execute(skill, watched.world(scenario)).end
    finally:
        camera.close()
    if not camera.pictures:
        raise SettingsError(f"skill {skill.name!r} moves nothing on this scenario; try --seed 1")
    return end, camera.pictures


def animated(films: Sequence[Sequence[Any]], kind: str) -> bytes:
    """Films one after the other, each with its last picture shown longer, as a gif or webp."""
    from PIL import Image

    pictures = [Image.fromarray(picture) for film in films for picture in film]
    if kind == "gif":
        pictures = [p.quantize(96, dither=Image.Dither.NONE) for p in pictures]
    out = io.BytesIO()
    lasts = [time for film in films for time in (*[LASTS] * (len(film) - 1), END)]
    how = {"quality": 60, "method": 4} if kind == "webp" else {"optimize": True}
    pictures[0].save(
        out, kind.upper(), save_all=True, append_images=pictures[1:], duration=lasts, loop=0, **how
    )
    return out.getvalue()
