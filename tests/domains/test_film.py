"""Films: how pictures are collected and written, and what Gymnasium environments draw."""

import io
import sys
import warnings
from typing import Any

import numpy as np
import pytest
from support import circle, seeded

from cgtorch.domains.film import COLOURS, MOST, Film, Reel, animated, renderer, shrunk
from cgtorch.domains.gymnasium import Gymnasium
from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.registry import make_domain
from cgtorch.ground.errors import DomainError, SettingsError

Image = pytest.importorskip("PIL.Image")


def picture(value: int, width: int = 8) -> Any:
    return np.full((6, width, 3), value, np.uint8)


def test_a_reel_takes_pictures_at_their_times() -> None:
    now = [0]
    reel = Reel(lambda: picture(now[0]), every=0.1, slow=2.0)
    for now[0] in range(10):  # steps of 0.05 s
        reel.take(now[0] * 0.05)
    film = reel.film("success")
    assert [int(frame[0, 0, 0]) for frame in film.frames] == [0, 2, 4, 6, 8, 9]
    assert film.lasts == 200
    reel.begin()
    reel.take(0.0)
    assert len(reel.film("failure").frames) == 2


def test_a_long_film_has_fewer_pictures_which_last_longer() -> None:
    drawn = list[int]()
    reel = Reel(lambda: picture(len(drawn) % 250), every=0.1)
    for step in range(20 * MOST):
        drawn.append(step)
        reel.take(step * 0.1)
    film = reel.film("timeout")
    assert MOST <= len(film.frames) <= 2 * MOST
    assert film.lasts == 1600
    assert film.lasts * len(film.frames) == pytest.approx(200 * MOST * 10, rel=0.02)


def test_a_picture_is_of_the_act_during_which_it_was_taken() -> None:
    reel = Reel(lambda: picture(0), every=0.1)
    assert reel.film("success").acts == [0]  # the last picture, before any act
    for act in range(3):
        for step in range(2):
            reel.take(0.1 * (2 * act + step))
        reel.end_act()
    film = reel.film("failure")
    assert (list(film.acts), film.end) == ([0, 0, 1, 1, 2, 2, 2], "failure")
    assert len(film.frames) == 7
    reel.begin()
    reel.take(0.0)
    assert reel.film("success").acts == [3, 2]


def test_pictures_that_are_left_out_take_their_acts_with_them() -> None:
    now = [0]
    reel = Reel(lambda: picture(now[0]), every=1.0)
    for now[0] in range(2 * MOST - 1):
        reel.take(now[0])
        reel.end_act()
    assert list(reel.film("x").acts) == [*range(2 * MOST - 1), 2 * MOST - 2]
    now[0] = 2 * MOST - 1
    reel.take(now[0])
    film = reel.film("x")
    assert [int(frame[0, 0, 0]) for frame in film.frames[:-1]] == list(range(0, 2 * MOST, 2))
    assert list(film.acts[:-1]) == list(range(0, 2 * MOST, 2))
    assert film.lasts == 2000
    reel.take(now[0])  # which is no time for another picture
    reel.take(2 * MOST)
    assert len(reel.film("x").frames) == MOST + 2


def test_where_nothing_can_be_drawn_there_is_one_error_and_no_warning(
    monkeypatch: pytest.MonkeyPatch, recwarn: pytest.WarningsRecorder
) -> None:
    mujoco = pytest.importorskip("mujoco")

    def made(self: Any, model: Any, height: int, width: int) -> None:
        assert (height, width) == (30, 40)
        warnings.warn("no display", stacklevel=1)
        raise RuntimeError("no context")

    monkeypatch.setattr(mujoco.Renderer, "__init__", made)
    with pytest.raises(SettingsError, match=r"cannot draw here \(RuntimeError\); install libegl1"):
        renderer(None, 40)
    assert not recwarn.list


@pytest.mark.parametrize("kind", ["gif", "webp"])
def test_films_are_written_one_after_the_other(kind: str) -> None:
    one, other = ([picture(value + k) for k in range(0, 90, 30)] for value in (0, 100))
    data = animated([Film(one, 80, "success"), Film(other, 40, "failure")], kind)
    read = Image.open(io.BytesIO(data))
    assert read.format == kind.upper()
    assert read.n_frames == 6
    lasts = []
    for number in range(6):
        read.seek(number)
        read.load()
        lasts.append(read.info["duration"])
    assert lasts == [80, 80, 1200, 40, 40, 1200]
    assert read.info["loop"] == 0
    read.seek(4)
    assert abs(int(np.asarray(read.convert("RGB")).mean()) - 130) < 12


@pytest.mark.parametrize("kind", ["gif", "webp"])
def test_a_gif_has_few_colours(kind: str) -> None:
    rainbow = np.arange(768, dtype=np.uint32).astype(np.uint8).reshape(16, 16, 3)
    data = animated([Film([rainbow], 80, "success")], kind)
    colours = Image.open(io.BytesIO(data)).convert("RGB").getcolors()
    assert (len(colours) <= COLOURS) == (kind == "gif")


def test_wide_pictures_are_shrunk() -> None:
    assert shrunk(picture(3, 80), 20).shape == (1, 20, 3)
    assert shrunk(picture(3, 80), 200).shape == (6, 80, 3)
    assert shrunk(wide := picture(3, 80), 80) is wide
    assert shrunk(picture(3, 80), 10).shape == (1, 10, 3)  # and never to nothing


def test_without_pillow_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(SettingsError, match="pip install pillow"):
        animated([Film([picture(0)], 80, "success")], "webp")


def filmed(domain: Gymnasium, width: int) -> Any:
    """The film of a skill that does the same in each step."""
    skill = circle(domain.actions(), "Linear", "Step")
    return domain.pictures(domain).film(skill, domain.draw("starts", 1, seeded(0)), width)


def made(name: str, **settings: Any) -> Gymnasium:
    domain = make_domain(f"gymnasium:{name}", GymnasiumSettings(target_return=-1.0, **settings))
    assert isinstance(domain, Gymnasium)
    return domain


def test_what_a_gymnasium_environment_draws() -> None:
    pytest.importorskip("gymnasium")
    from tiny_worlds import DRAWN, GOAL

    film = filmed(made(DRAWN), 500)
    assert film.frames[0].shape == (30, 500, 3)
    assert [int(frame.mean()) for frame in film.frames] == [*range(13), 12]
    assert list(film.acts[:4]) == [0, 1, 3, 5]  # two actions for each step after the first
    assert film.lasts == 100
    assert filmed(made(GOAL), 500) is None
    with pytest.raises(DomainError, match=r"drew 'a cat'; in render_mode 'rgb_array', return an"):
        filmed(made(DRAWN, env={"drawn": "a cat"}), 500)


def test_the_pole_is_filmed() -> None:
    pytest.importorskip("pygame")
    film = filmed(made("CartPole-v1"), 240)
    assert film.frames[0].shape == (160, 240, 3)
    assert 3 < len(film.frames) < MOST * 2
    assert film.frames[0].std() > 5
    assert not np.array_equal(film.frames[0], film.frames[-1])
