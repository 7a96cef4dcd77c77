"""An animated picture of a skill in physics, as MuJoCo's renderer sees it."""

import io
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
DISTANCE, BEHIND, DOWN = 4.2, 30.0, -32.0  # m, and degrees, of the camera


class Camera:
    """Takes pictures of what is simulated."""

    def __init__(self, scenario: Scenarios) -> None:
        """A camera that looks at the table and the robot from behind it."""
        mj = mujoco()
        self.view, self.pictures, self.renderers = mj.MjvCamera(), list[Any](), dict[int, Any]()
        start, table = scenario.pose[0], scenario.table[0]
        middle = (start[:2] + 2 * table[:2]) / 3
        self.view.lookat[:] = [float(middle[0]), float(middle[1]), 0.7]
        away = table[:2] - start[:2]
        heading = float(numpy.degrees(numpy.arctan2(float(away[1]), float(away[0]))))
        self.view.distance, self.view.azimuth = DISTANCE, heading + BEHIND
        self.view.elevation = DOWN
        self.last = -1

    def __call__(self, model: Model) -> None:
        """Take a picture if it is time to."""
        now = int(model.data.time / EVERY)
        if now == self.last:
            return
        self.last = now
        key = id(model.model)
        if key not in self.renderers:
            self.renderers[key] = _renderer(model)
        self.renderers[key].update_scene(model.data, self.view)
        self.pictures.append(self.renderers[key].render().copy())

    def close(self) -> None:
        """Free what the pictures were drawn with."""
        for renderer in self.renderers.values():
            renderer.close()


def _renderer(model: Model) -> Any:
    try:
        return mujoco().Renderer(model.model, HEIGHT, WIDTH)
    except Exception as e:  # whatever a graphics library raises
        raise SettingsError(
            f"MuJoCo cannot draw here ({type(e).__name__}); install libegl1, or libosmesa6 with "
            "MUJOCO_GL=osmesa"
        ) from e


def film_of(skill: Skill, domain: Tabletop, scenario: Scenarios, kind: str) -> tuple[str, bytes]:
    """How a skill ends on the first scenario, and a picture of a kind, gif or webp.

    SettingsError if nothing can be drawn on this machine.
    """
    from PIL import Image

    camera = Camera(scenario)
    physics = replace(domain.physics, watch=camera, memo={}, models={})
    watched = domain.watched(physics)
    try:
        end = execute(skill, watched.world(scenario)).end
    finally:
        camera.close()
    if not camera.pictures:
        raise SettingsError(f"skill {skill.name!r} moves nothing on this scenario; try --seed 1")
    pictures = [Image.fromarray(picture) for picture in camera.pictures]
    if kind == "gif":
        pictures = [p.quantize(96, dither=Image.Dither.NONE) for p in pictures]
    out = io.BytesIO()
    lasts = [LASTS] * (len(pictures) - 1) + [END]
    how = {"quality": 60, "method": 4} if kind == "webp" else {"optimize": True}
    pictures[0].save(
        out, kind.upper(), save_all=True, append_images=pictures[1:], duration=lasts, loop=0, **how
    )
    return end, out.getvalue()
