"""A kinematic run's skill is tried in physics; what cannot be is said."""

import json
import os
import shutil
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

import pytest
from command_line import Shell, in_a_shell

from cgtorch.tabletop.kinematics import robots_folder

REFERENCE = Path(__file__).parents[2] / "runs" / "reference"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The reference run with the PR2 as it is built in today, whatever it was begun with."""
    folder = tmp_path_factory.mktemp("physics") / "run"
    shutil.copytree(REFERENCE, folder)
    shutil.copy(robots_folder() / "pr2" / "robot.json", folder / "robot" / "robot.json")
    return folder


def test_a_kinematic_skill_in_physics(shell: Shell, run: Path) -> None:
    words = (run, "--world", "mujoco", "--count", 3, "--seed", 5, "--scenarios", "near")
    ended = shell("cgtorch-evaluate", *words, "--json")
    assert (ended.code, ended.err) == (0, "")
    found = json.loads(ended.out)
    ((name, lifted),) = found["other_measures"].items()
    assert "lifted" in name
    assert lifted["tried"] == found["tried"] == 3
    assert lifted["succeeded"] >= found["succeeded"] >= 1
    text = shell("cgtorch-evaluate", *words).out
    assert f"{name}: {lifted['succeeded']} / 3 succeeded" in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["cgtorch-evaluate", REFERENCE, "--world", "moon"], "world is 'moon'; use one of kin"),
        (["cgtorch-view", REFERENCE, "--world", "moon"], "world is 'moon'; use one of kin"),
        (["cgtorch-view", REFERENCE, "--film", "skill.mp4"], "give a name that ends in .gif or"),
        (["cgtorch-train", "--world", "moon"], "world is 'moon'; use one of kinematic, mujoco"),
    ],
)
def test_what_cannot_be_is_said(shell: Shell, words: list[object], message: str) -> None:
    ended = shell(*words)
    assert ended.code == 2
    assert message in ended.err


@lru_cache
def can_draw() -> bool:
    """Whether MuJoCo can draw on this machine, asked of MuJoCo alone."""
    code = "import mujoco; mujoco.Renderer(mujoco.MjModel.from_xml_string('<mujoco/>'), 9, 9)"
    return any(
        not subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, "MUJOCO_GL": by}, capture_output=True
        ).returncode
        for by in ("egl", "osmesa")
    )


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


def test_the_report_of_a_run_in_physics_has_a_film(run: Path, tmp_path: Path) -> None:
    """Or says why there is none; the page still needs nothing else."""
    folder, page = tmp_path / "run", tmp_path / "report.html"
    shutil.copytree(run, folder)
    about = json.loads((folder / "run.json").read_text())
    about["domain_settings" if "domain_settings" in about else "settings"]["world"] = "mujoco"
    (folder / "run.json").write_text(json.dumps(about))
    ended = in_a_shell("cgtorch-report", str(folder), "--output", str(page), "--quiet")
    assert ended.code == 0, ended.err
    text = page.read_text()
    if not can_draw():
        assert "There is no film of S3: MuJoCo cannot draw here" in text
        assert "<img" not in text
        return
    assert text.count('<img src="data:image/webp;base64,') == 1
    assert "img-src data:" in text
    assert "film" not in (ended.out + ended.err)
