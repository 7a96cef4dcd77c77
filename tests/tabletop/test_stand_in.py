"""The stand-in for a robot: its scene, and its driver over a connection."""

import json
import socket
import threading
import time
from pathlib import Path

import pytest
import torch

from cgtorch.ground.errors import RobotError
from cgtorch.ground.files import JsonLines
from cgtorch.tabletop import stand_in
from cgtorch.tabletop.settings import TabletopSettings
from cgtorch.tabletop.stand_in import ADDRESS, CALLS, Scene, StandIn

SETTINGS = TabletopSettings(noise="fresh", position_noise=0.0, heading_noise=0.0)


def test_a_scene_is_another_one_each_time_and_moves_as_it_is_told(tmp_path: Path) -> None:
    scene = Scene(SETTINGS, 0.0, JsonLines(tmp_path / "done.jsonl"))
    first = scene.perceive()
    assert len(first) == 7
    assert scene.perceive() == pytest.approx(first, abs=1e-5)
    scene.arrange("perimeter")
    before = scene.perceive()
    assert before != pytest.approx(first, abs=1e-3)
    assert scene.move_base([-0.25, 0.0, 0.0])
    moved = [0.25, 0.25, 0, 0, 0.25, 0, 0]
    assert scene.perceive() == pytest.approx(
        [a + b for a, b in zip(before, moved, strict=True)], abs=1e-5
    )
    ahead = max(before[1], 0.0) + 1.0
    assert not scene.move_base([ahead, 0.0, 0.0]), "the table is in the way"
    assert scene.perceive()[4] == pytest.approx(before[4] + 0.25, abs=1e-5)
    noted = [json.loads(line)["what"] for line in (tmp_path / "done.jsonl").open()]
    assert noted == ["motion", "motion"]


def test_a_grasp_succeeds_where_an_arm_reaches_the_object(tmp_path: Path) -> None:
    """From afar none does; from before the nearest edge some do, as the world itself says."""
    scene, found = Scene(SETTINGS, 0.0, None), list[bool]()
    scene.perceive()
    scene.move_base([-1.5, 0.0, 0.0])
    assert scene.grasp() is False
    for _ in range(30):
        scene.arrange("near")
        seen = scene.perceive()
        scene.move_base([seen[0] - 0.4, seen[5] + 0.2, 0.0])
        wanted = bool(scene.world.success(scene.lanes)[1] > 0.5)
        found.append(scene.grasp())
        assert found[-1] is wanted
        if {*found} == {True, False} or sum(found) > 2:
            break
    assert any(found)


@pytest.mark.parametrize(("speed", "slept"), [(0.0, []), (4.0, [2.5, 5.0])])
def test_a_motion_takes_ten_seconds_and_a_grasp_twenty(
    speed: float, slept: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    took = list[float]()
    scene = Scene(SETTINGS, speed, None)
    monkeypatch.setattr(time, "sleep", took.append)
    scene.move_base([-0.1, 0.0, 0.0])
    scene.grasp()
    assert took == slept


def test_a_driver_asks_the_robot_over_a_connection(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    about = {"port": 0, "robot": "pr2", "world": "kinematic", "speed": 0.0}
    serve = threading.Thread(
        target=stand_in.main.callback,
        kwargs={**about, "count": tmp_path / "done.jsonl"},
        daemon=True,
    )
    threads = torch.get_num_threads()
    serve.start()
    said, patience = "", time.monotonic() + 60
    while "\n" not in said and time.monotonic() < patience:
        time.sleep(0.02)
        said += capsys.readouterr().out
    torch.set_num_threads(threads)
    monkeypatch.setenv(ADDRESS, said.removeprefix("a robot is at ").strip())
    robot = StandIn()
    robot.arrange("near")
    before = robot.perceive()
    assert len(before) == 7
    assert robot.move_base((-0.5, 0.0, 0.0)) is True
    assert robot.perceive()[4] == pytest.approx(before[4] + 0.5, abs=0.06)  # 12 deviations
    assert robot.move_base((9.0, 0.0, 0.0)) is False
    assert robot.grasp() is False
    for name in ("_wait", "settings", "__init__"):
        assert name not in CALLS
        assert robot._call(name, 99.0) is None
    other = StandIn()  # a second driver finds the robot where the first has left it
    assert other.perceive()[4] == pytest.approx(robot.perceive()[4], abs=0.06)
    assert [json.loads(line)["what"] for line in (tmp_path / "done.jsonl").open()] == [
        "motion",
        "motion",
        "test",
    ]


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere", "127.0.0.1:many"])
def test_no_robot_is_one_error_with_the_address(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(ADDRESS, address)
    with pytest.raises(RobotError, match=f"no stand-in robot answers at '{address}'; start it"):
        StandIn()


def test_a_robot_that_answers_no_more_is_an_error_with_its_address(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        monkeypatch.setenv(ADDRESS, address)
        robot = StandIn()
        connection, _ = server.accept()
        connection.shutdown(socket.SHUT_WR)
        with pytest.raises(ConnectionError, match=f"robot at '{address}' does not answer"):
            robot.perceive()
        assert json.loads(connection.recv(99)) == ["perceive"]
        connection.close()


def test_a_robot_may_begin_again_at_once_and_ends_with_its_process() -> None:
    assert stand_in._Server.allow_reuse_address
    assert stand_in._Server.daemon_threads


def test_the_robot_is_the_one_that_is_asked_for_and_its_noise_never_repeats(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    about = list[TabletopSettings]()

    def seen(settings: TabletopSettings, speed: float, done: JsonLines | None) -> None:
        about.append(settings)
        assert (speed, done) == (2.0, None)
        assert torch.get_num_threads() == 1
        raise KeyboardInterrupt

    monkeypatch.setattr(stand_in, "Scene", seen)
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    with pytest.raises(KeyboardInterrupt):
        stand_in.main.callback(port=0, robot="fetch", world="kinematic", speed=2.0, count=None)
    torch.set_num_threads(threads)
    (found,) = about
    assert (found.robot, found.world, found.noise) == ("fetch", "kinematic", "fresh")
