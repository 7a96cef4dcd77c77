"""How a robot is named: by its name, its folder, its description or its URDF."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import description as words_of_robots
from cgtorch.tabletop.kinematics import load_robot, robot_files, robots_folder
from cgtorch.tabletop.kinematics.clear_ways import OWN

FETCH = robots_folder() / "fetch"
BOTH = (FETCH / "fetch.urdf", FETCH / "robot.json")


def test_without_a_word_it_is_the_pr2():
    pr2 = robots_folder() / "pr2"
    assert robot_files() == (pr2 / "pr2.urdf", pr2 / "robot.json")
    assert load_robot().description.name == "PR2"


@pytest.mark.parametrize("robot", ["fetch", Path("fetch"), FETCH, str(FETCH), BOTH[1]])
def test_one_word_is_enough(robot):
    assert robot_files(description=robot) == BOTH
    assert load_robot(description=robot).description.name == "Fetch"


def test_the_description_beside_a_urdf():
    assert robot_files(BOTH[0]) == BOTH


def test_another_urdf_or_description(tmp_path):
    words = Path(shutil.copy(BOTH[1], tmp_path / "words.json"))
    assert robot_files(BOTH[0], words) == (BOTH[0], words)
    assert robot_files(tmp_path / "mine.urdf", "fetch") == (tmp_path / "mine.urdf", BOTH[1])


def test_names_come_before_folders(tmp_path, monkeypatch):
    shutil.copytree(robots_folder() / "pr2", tmp_path / "fetch")
    monkeypatch.chdir(tmp_path)
    assert robot_files(description="fetch") == BOTH
    assert robot_files(description="fetch/robot.json")[0] == Path("fetch/pr2.urdf")


@pytest.mark.parametrize("robot", ["fetsch", "fetsch" * 1000, "a\0b"])
def test_an_unknown_robot(robot):
    message = r"robot '.*' is no description, no folder.*\(fetch, pr2\): give one"
    with pytest.raises(RobotError, match=message):
        robot_files(description=robot)


def test_a_folder_with_no_urdf_or_with_two(tmp_path):
    shutil.copy(BOTH[1], tmp_path)
    with pytest.raises(RobotError, match="0 URDFs lie beside"):
        robot_files(description=tmp_path)
    for name in ("one.urdf", "two.urdf"):
        shutil.copy(BOTH[0], tmp_path / name)
    with pytest.raises(RobotError, match="2 URDFs lie beside"):
        robot_files(description=tmp_path)


def test_a_folder_without_a_description(tmp_path):
    with pytest.raises(RobotError, match="is no description, no folder with one"):
        robot_files(description=tmp_path)


def test_a_missing_file_is_named_when_it_is_read(tmp_path):
    urdf, words = robot_files(tmp_path / "none.urdf")
    assert robot_files(urdf, words) == (urdf, words)
    with pytest.raises(RobotError, match=r"cannot read '.*none\.urdf'"):
        load_robot(tmp_path / "none.urdf")
    with pytest.raises(RobotError, match=r"cannot read '.*robot\.json'"):
        load_robot(BOTH[0], words)


def test_links_that_never_collide_are_no_pairs_of_a_scene():
    robot = load_robot()

    def scene_without(*excludes):
        words = replace(robot.description, excludes=excludes)
        return replace(robot, description=words).scenes[0]

    every = scene_without()
    named = dict(enumerate([*[""] * OWN, *robot.arms[0].solid_links, *robot.body_links]))
    links = [{named.get(a), named.get(b)} for a, b, _ in every.pairs.tolist()]
    apart = next(both for both in links if len(both) == 2 and all(both))
    kept = torch.tensor([both != apart for both in links])
    fewer = scene_without(tuple(apart))
    assert 0 < len(fewer.pairs) < len(every.pairs)
    assert torch.equal(fewer.pairs, every.pairs[kept])
    assert torch.equal(fewer.reach, every.reach[kept])


def test_built_in_robots_are_in_the_package_or_else_beside_it(tmp_path, monkeypatch):
    monkeypatch.setattr(
        words_of_robots, "__file__", str(tmp_path / "site" / "cgtorch" / "a" / "b" / "c")
    )
    beside, within = tmp_path / "site" / "robots", tmp_path / "site" / "cgtorch" / "robots"
    with pytest.raises(RobotError, match=r"no built-in robots in '.*': install cgtorch again") as e:
        robots_folder()
    assert repr(str(within)) in str(e.value)
    assert repr(str(beside)) in str(e.value)
    for folder in (beside, within):
        (folder / "pr2").mkdir(parents=True)
        shutil.copy(BOTH[1], folder / "pr2")
        assert robots_folder() == folder


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"urdf": 3}, "urdf is 3; give a path"),
        ({"urdf": b"pr2.urdf"}, "urdf is b'pr2.urdf'; give a path"),
        ({"description": 3}, "description is 3; give a path, or the name of a robot"),
        ({"packages": "meshes"}, "packages is 'meshes'; give a list of folders"),
        ({"packages": None}, "packages is None; give a list of folders"),
        ({"packages": [3]}, "a folder of packages is 3; give a path"),
    ],
)
def test_what_names_no_robot_is_said(given, message):
    with pytest.raises(RobotError, match=message):
        load_robot(**given)
