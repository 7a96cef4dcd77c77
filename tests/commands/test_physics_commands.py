"""A kinematic run's skill is tried in physics, and filmed."""

import shutil
from pathlib import Path

import pytest
from command_line import EVALUATE, REFERENCE, Shell, about, can_draw, edited, in_a_shell
from report_pages import thinned

from cgtorch.tabletop.kinematics import robots_folder


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The reference run with the PR2 as it is built in today, whatever it was begun with."""
    folder = tmp_path_factory.mktemp("physics") / "run"
    shutil.copytree(REFERENCE, folder)
    shutil.copy(robots_folder() / "pr2" / "robot.json", folder / "robot" / "robot.json")
    return folder


def test_a_kinematic_skill_in_physics(shell: Shell, run: Path) -> None:
    words = (EVALUATE, run, "--world", "mujoco", "--count", 3, "--seed", 5, "--scenarios", "near")
    found = shell.told(*words)
    ((name, lifted),) = found["other_measures"].items()
    assert "lifted" in name
    assert lifted["tried"] == found["tried"] == 3
    assert lifted["succeeded"] >= found["succeeded"] >= 1
    assert f"{name}: {lifted['succeeded']} / 3 succeeded" in shell.does(*words).out
    for unknown in ([EVALUATE, run], ["cgtorch-train"]):
        message = shell.refuses(*unknown, "--world", "moon")
        assert "world is 'moon'; use one of kinematic, mujoco" in message


@pytest.mark.hostile
def test_an_animated_picture_of_a_skill(run: Path, tmp_path: Path) -> None:
    film = tmp_path / "skill.gif"
    ended = in_a_shell("cgtorch-view", str(run), "--scenarios", "near", "--film", str(film))
    if not can_draw():
        assert "MuJoCo cannot draw here" in ended.err
        assert ended.code == 2
        return
    assert ended.code == 0, ended.err
    assert "ends in success" in ended.out
    assert film.read_bytes()[:3] == b"GIF"


@pytest.mark.hostile
def test_the_report_of_a_run_in_physics_has_a_film(run: Path, tmp_path: Path) -> None:
    """Or says why there is none; the page still needs nothing else."""
    folder, page = (
        thinned(tmp_path / "run", "S0", models=False, generations=False),
        tmp_path / "a.html",
    )
    shutil.copy(run / "robot" / "robot.json", folder / "robot" / "robot.json")
    edited(folder, domain_settings=about(folder)["domain_settings"] | {"world": "mujoco"})
    ended = in_a_shell("cgtorch-report", str(folder), "--output", str(page), "--quiet")
    assert ended.code == 0, ended.err
    text = page.read_text()
    if not can_draw():
        assert "There is no film of S0: MuJoCo cannot draw here" in text
        assert "<img" not in text
        return
    assert text.count('<img src="data:image/webp;base64,') == 1
    assert "img-src data:" in text
    assert "film" not in (ended.out + ended.err)
