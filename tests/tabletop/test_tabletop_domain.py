"""The tabletop as a domain: its variants, worlds, models, actions and files."""

from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from support import graspable, seeded
from torch import Tensor

from cgtorch.domains.exploration import EXPLORATION
from cgtorch.ground.asked import Asked, Purse
from cgtorch.ground.errors import SettingsError
from cgtorch.ground.files import place_of
from cgtorch.tabletop import domain as tabletop
from cgtorch.tabletop.data import WITHIN
from cgtorch.tabletop.domain import (
    GRASPS,
    MARGIN,
    SPECIALISTS,
    WORTH_SHARING,
    Tabletop,
    TabletopModels,
    _shared,
    usual_percept,
)
from cgtorch.tabletop.kinematics import Robot, load_robot, robot_files, robots_folder
from cgtorch.tabletop.kinematics.urdf import load_urdf
from cgtorch.tabletop.physics import MujocoWorld, Physics
from cgtorch.tabletop.settings import TabletopSettings
from cgtorch.tabletop.world import TabletopWorld


@cache
def pr2() -> Robot:
    return load_robot()


def of(**settings: Any) -> Tabletop:
    return Tabletop(TabletopSettings(**settings), pr2())


def test_auto_is_what_scenarios_and_method_need() -> None:
    plain = of().for_run("near", "compose")
    assert (plain.tabletop, plain.obstacles, plain.networks) == ("box", 0, "edge")
    assert not plain.published_data
    assert plain.robot is pr2()
    paper = of().for_run("near", "paper")
    assert (paper.networks, paper.published_data) == ("percept", True)
    wide = of().for_run("general-clutter", "compose")
    assert (wide.tabletop, wide.obstacles, len(wide.percept)) == ("yaw", 1, 13)
    given = of(percept="yaw", networks="percept").for_run("far", "compose")
    assert (given.tabletop, given.networks) == ("yaw", "percept")
    assert of(percept="box", networks="edge").for_run("general", "paper").tabletop == "box"
    assert of(networks="edge").for_run("near", "paper").networks == "edge"
    assert [usual_percept(kind) for kind in ("near", "general", "general-clutter")] == [
        "box", "yaw", "yaw",
    ]  # fmt: skip
    assert plain.specialists is SPECIALISTS["edge"]
    assert paper.specialists is SPECIALISTS["percept"]


def test_a_skill_file_may_be_meant_for_any_variant_the_usual_one_first() -> None:
    found = [(each.networks, each.obstacles, each.tabletop) for each in of().variants("general")]
    assert found[:2] == [("percept", 0, "yaw"), ("percept", 0, "box")]
    assert len(found) == len(set(found)) == 8
    first = next(iter(of().variants("near")))
    assert (first.tabletop, first.robot) == ("box", pr2())


def test_worlds_and_measures_are_those_of_the_settings() -> None:
    scenes = of().draw("near", 2, seeded(0))
    world = of(position_noise=0.25, heading_noise=0.5).world(scenes)
    assert isinstance(world, TabletopWorld)
    assert (world.noise.position, world.noise.heading, world.noise.repeats) == (0.25, 0.5, True)
    assert world.footprint.tolist() == pytest.approx(pr2().description.footprint)
    fresh = of(noise="fresh")
    assert not fresh.repeats
    assert not fresh.world(scenes).noise.repeats
    assert Tabletop(robot=pr2(), tabletop="yaw").world(scenes).percept_size == 9
    physical = of().in_world("mujoco")
    inside = physical.world(scenes)
    assert isinstance(inside, MujocoWorld)
    assert (inside.physics, inside.touch) == (physical.physics, "fails")
    with pytest.raises(SettingsError, match="world is 'moon'; use one of kinematic, mujoco"):
        of().in_world("moon")
    assert of().other_measures() == {}
    ((name, lifted),) = physical.other_measures().items()
    assert (name, lifted.settings.touch) == ("lifted, whatever the arm touched", "allowed")
    ((name, strict),) = lifted.other_measures().items()
    assert (name, strict.settings.touch) == ("lifted without a touch of table or robot", "fails")
    other = Physics(pr2())
    assert physical.watched(other).physics is other
    seen: Any = physical.world_in(other, scenes)
    assert seen.physics is other


def test_a_motion_is_two_lengths_and_an_angle() -> None:
    told = [(f.name, f.unit, f.low, f.high, f.kind) for f in Tabletop.control]
    assert told == [
        ("dx", "m", -2, 2, "number"), ("dy", "m", -2, 2, "number"),
        ("dθ", "rad", -torch.pi, torch.pi, "angle"),
    ]  # fmt: skip


def test_tests_are_five_objects_along_an_edge_and_none_elsewhere() -> None:
    for kind in of().kinds:
        tests = of().tests(kind)
        assert len(tests) == (5 if kind in ("near", "left", "right", "far") else 0)
    assert of().tests("left").object[:, 1].min() > 0


def test_what_can_be_grasped_from_somewhere_is_asked_as_in_the_world(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = list[str]()

    def answer(name: str) -> Any:
        def grasps(robot: Any, position: Tensor, table: Tensor) -> Tensor:
            assert robot is pr2()
            asked.append(name)
            return torch.ones(len(position), dtype=torch.bool)

        return grasps

    monkeypatch.setattr(tabletop, "GRASPS", {name: answer(name) for name in GRASPS})
    scenes = of().draw("near", 1, seeded(0))
    for grasp in ("way", "posture"):
        domain = of(grasp=grasp)
        assert domain.solvable(scenes).tolist() == [True]
        world = domain.world(scenes)
        assert isinstance(world, TabletopWorld)
        world.graspable(torch.zeros(1, 3), torch.zeros(1, 6))
    assert asked == ["way", "way", "posture", "posture"]


@pytest.mark.parametrize("count", [WORTH_SHARING - 1, WORTH_SHARING])
def test_many_answers_are_shared(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    gathered = list[int]()

    def gather(mine: Tensor, rows: int) -> Tensor:
        gathered.append(rows)
        return mine

    monkeypatch.setattr(
        tabletop, "distributed", SimpleNamespace(share=lambda n: slice(0, n), all_gather=gather)
    )
    at, table = torch.randn(count, 3, generator=seeded(0)), torch.zeros(count, 6)
    found = _shared(lambda robot, p, t: graspable(p, t), pr2(), at, table)
    assert torch.equal(found, graspable(at, table))
    assert gathered == ([count] if count == WORTH_SHARING else [])


def models(**about: Any) -> TabletopModels:
    return TabletopModels(Tabletop(robot=pr2(), **about))


def test_a_way_is_clearer_in_the_models_than_in_the_world() -> None:
    x0, x1, y0, y1 = pr2().description.footprint
    found = models()._clear_motion("cpu").footprint.tolist()
    assert found == pytest.approx([x0 - MARGIN, x1 + MARGIN, y0 - MARGIN, y1 + MARGIN])
    percept = torch.tensor([[1.0, 2.0, -1.0, 1.0, 1.1, 0.0, 0.7]]).expand(2, 7)
    control = torch.tensor([[0.1, 0.0, 0.0], [0.9, 0.0, 0.0]])
    assert models().possible(percept, control).tolist() == [True, False]


def test_success_is_tested_where_the_object_may_be_within_reach() -> None:
    percept = torch.zeros(2, 7)
    percept[:, 4] = torch.tensor([WITHIN - 0.01, WITHIN])
    assert models().worth_testing(percept).tolist() == [True, False]


def test_boxes_of_absent_obstacles_have_no_noise() -> None:
    percept = torch.zeros(2, 13)
    percept[:, :4], percept[0, 9:] = torch.tensor([1.0, 2, -1, 1]), torch.tensor([3.0, 4, 3, 4])
    found = models(obstacles=1, tabletop="yaw").noisy(percept)
    assert found.tolist() == [[1] * 13, [1] * 9 + [0] * 4]


def test_the_papers_method_gets_as_many_data_as_it_had(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[Any]()
    monkeypatch.setattr(tabletop, "collect", lambda *about: asked.append(about) or "data")
    purse, generator = Purse(), seeded(0)
    about: Any = SimpleNamespace(purse=purse, kind="left", generator=generator)
    assert models(published_data=True).explore(about) == "data"
    ((scenes, *counts),) = asked
    assert counts == [2000, 5500, generator]
    assert (scenes.kind, scenes.thrift) == ("left", 1)
    assert purse.spent == {EXPLORATION: Asked(motions=2000, tests=5500)}
    monkeypatch.setattr(tabletop.Models, "explore", lambda self, about: "explored")
    assert models().explore(about) == "explored"
    physical = TabletopModels(of().in_world("mujoco"))
    assert physical._scenes("far").thrift == 4


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    """The files of the usual robot."""
    domain = Tabletop()
    domain.files(domain).write(tmp_path)
    domain.files(domain).write(tmp_path)  # as a run that goes on does again
    return tmp_path


def test_a_robot_is_kept_with_its_run(stored: Path) -> None:
    urdf, words = robot_files()
    assert (stored / "robot" / "robot.urdf").read_bytes() == urdf.read_bytes()
    assert (stored / "robot" / "robot.json").read_bytes() == words.read_bytes()
    again = Tabletop.files.read(Tabletop, TabletopSettings(), stored)
    assert again.robot.description == pr2().description
    files = again.files(again)
    assert files.options(stored) == {"urdf": "", "robot": "pr2"}
    other = stored / "robot" / "robot.json"
    other.write_bytes(other.read_bytes() + b"\n")
    place = place_of(stored) / "robot"
    assert files.options(stored) == {
        "urdf": (place / "robot.urdf").as_posix(),
        "robot": (place / "robot.json").as_posix(),
    }


def test_of_a_robot_with_meshes_what_is_kept_has_none(tmp_path: Path) -> None:
    fetch = robots_folder() / "fetch"
    own: Any = SimpleNamespace(
        robot=SimpleNamespace(meshes=("a.stl",), urdf=load_urdf(fetch / "fetch.urdf")),
        robot_files=lambda: (fetch / "fetch.urdf", fetch / "robot.json"),
    )
    Tabletop.files(own).write(tmp_path)
    assert (tmp_path / "robot" / "robot.urdf").read_bytes() == own.robot.urdf.xml
    assert own.robot.urdf.xml != (fetch / "fetch.urdf").read_bytes()


def test_a_urdf_has_its_description_beside_it_unless_another_is_named() -> None:
    urdf, words = robots_folder() / "fetch" / "fetch.urdf", robots_folder() / "fetch/robot.json"
    assert of().robot_files() == robot_files()
    assert of(robot="fetch").robot_files() == (urdf, words)
    assert of(urdf=str(urdf)).robot_files() == (urdf, words)
    other = robots_folder() / "pr2" / "robot.json"
    assert of(urdf=str(urdf), robot=str(other)).robot_files() == (urdf, other)
