"""`cgtorch-view --film`: films of skills in other people's simulators, and why there is none."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import VIEW, Shell, can_draw, in_a_shell
from support import circle

from cgtorch.domains.registry import make_domain
from cgtorch.graphs import save_skill

TASK, CART = "metaworld:reach-v3", "examples.cart:Cart"


@pytest.fixture(scope="module")
def skill(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A skill that reaches."""
    pytest.importorskip("metaworld")
    path = tmp_path_factory.mktemp("reach") / "reach.json"
    save_skill(path, circle(make_domain(TASK).actions(), "ReachGoal"))
    return path


def test_an_arm_is_filmed(skill: Path) -> None:
    film = skill.with_name("reach.webp")
    ended = in_a_shell(VIEW, str(skill), "--domain", TASK, "--film", str(film), "--seed", "1")
    if not can_draw():
        assert "MuJoCo cannot draw here" in ended.err
        assert ended.code == 2
        return
    image = pytest.importorskip("PIL.Image")
    assert ended.code == 0, ended.err
    assert f"circle ends in success: {film}" in ended.out
    read = image.open(film)
    assert read.size == (480, 360)
    assert 4 < read.n_frames < 40
    first, last = (frame(read, number) for number in (0, read.n_frames - 1))
    assert np.abs(first - last).max() > 50
    assert first.std() > 20
    assert film.stat().st_size < 400_000


def frame(film: Any, number: int) -> Any:
    film.seek(number)
    return np.asarray(film.convert("RGB")).astype(float)


def test_what_draws_nothing_is_refused(shell: Shell, tmp_path: Path) -> None:
    path = tmp_path / "cart.json"
    save_skill(path, circle(make_domain(CART).actions(), "Test"))
    words = VIEW, path, "--domain", CART, "--film", tmp_path / "cart.gif"
    assert "Cart draws nothing in this world, so leave --film out" in shell.refuses(*words)
    assert "scenarios is 'moon'; use one of any" in shell.refuses(*words, "--scenarios", "moon")
