"""Films of a skill at work: pictures are collected, and written as one animated picture."""

import io
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray

from cgtorch.graphs import Skill
from cgtorch.ground.environment import Environment
from cgtorch.ground.errors import SettingsError
from cgtorch.simulation import traced

WIDTH = 480  # px
END = 1200  # ms that the last picture is shown
MOST = 100  # pictures of a film; at twice as many, every second one is left out
WEBP = {"quality": 60, "method": 4}  # of 100, and how hard to try to make it small, up to 6
COLOURS = 96  # of a GIF

Picture: TypeAlias = NDArray[np.uint8]
"""Red, green and blue of pixels, (H, W, 3)."""


@dataclass(frozen=True)
class Film:
    """A film of an episode.

    Attributes:
        frames: Its pictures, of one size.
        lasts: ms that each is shown.
        end: How the skill ended: success, failure or timeout.
        acts: The number of the skill's action, from 0, during which each picture was taken; () if
            that is not known.
    """

    frames: Sequence[Picture]
    lasts: int
    end: str
    acts: Sequence[int] = ()


class Reel:
    """Collects the pictures of one episode, with fewer pictures per second if it is long."""

    def __init__(self, draw: Callable[[], Picture], every: float, slow: float = 1.0) -> None:
        """A picture every so many seconds of an episode, which is shown so many times as slowly."""
        self._draw, self._first, self._slow, self._act = draw, every, slow, 0
        self.begin()

    def begin(self) -> None:
        """Begin with another episode."""
        self._frames, self._acts = list[Picture](), list[int]()
        self._every, self._last = self._first, -1

    def take(self, now: float) -> None:
        """Take a picture if one is due at this time of the episode, s."""
        number = int(now / self._every + 1e-6)
        if number == self._last:
            return
        self._last = number
        self._frames.append(self._draw())
        self._acts.append(self._act)
        if len(self._frames) >= 2 * MOST:
            self._frames, self._acts = self._frames[::2], self._acts[::2]
            self._every, self._last = 2 * self._every, number // 2

    def end_act(self) -> None:
        """An action of the skill has ended."""
        self._act += 1

    def play(self, skill: Skill, world: Environment) -> Film:
        """The film of a skill in a world of one scenario, of which pictures are taken."""
        with torch.no_grad():
            return self.film(traced(skill, world, ended=self.end_act).end)

    def film(self, end: str) -> Film:
        """The film of the episode, with a last picture of how it is now."""
        frames, acts = [*self._frames, self._draw()], [*self._acts, max(0, self._act - 1)]
        return Film(frames, round(1000 * self._slow * self._every), end, acts)


def renderer(model: Any, width: int) -> Any:
    """A renderer of pictures of a MuJoCo model, which has to be closed.

    SettingsError if this machine cannot draw.
    """
    import mujoco

    # Without these, one that could not be made complains when it is deleted.
    closed = {"_gl_context": None, "_mjr_context": None}
    kind = type("Renderer", (mujoco.Renderer,), closed)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of GLFW, before it raises
            return kind(model, width * 3 // 4, width)
    except Exception as e:  # whatever a graphics library raises
        raise SettingsError(
            f"MuJoCo cannot draw here ({type(e).__name__}); install libegl1 or libosmesa6, and "
            "outside of commands set MUJOCO_GL to egl or osmesa before MuJoCo is imported"
        ) from e


def pillow() -> Any:
    """Pillow's module of images; SettingsError if it is missing."""
    try:
        from PIL import Image
    except ImportError as e:
        raise SettingsError("a film needs package pillow; pip install pillow") from e
    return Image


def shrunk(picture: Picture, width: int) -> Picture:
    """A picture of at most that width."""
    if picture.shape[1] <= width:
        return picture
    size = width, max(1, picture.shape[0] * width // picture.shape[1])
    return np.asarray(pillow().fromarray(picture).resize(size))


def animated(films: Sequence[Film], kind: str) -> bytes:
    """Films one after the other, each with its last picture shown longer, as a gif or webp.

    SettingsError if Pillow is missing.
    """
    image = pillow()
    pictures = [image.fromarray(picture) for film in films for picture in film.frames]
    lasts = [time for f in films for time in (*[f.lasts] * (len(f.frames) - 1), END)]
    how = WEBP if kind == "webp" else {}
    if kind == "gif":
        pictures = [p.quantize(COLOURS) for p in pictures]
    out, (first, *more) = io.BytesIO(), pictures
    first.save(out, kind.upper(), save_all=True, append_images=more, duration=lasts, loop=0, **how)
    return out.getvalue()
