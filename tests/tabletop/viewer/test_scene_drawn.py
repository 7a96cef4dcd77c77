"""What a scene asks its server to draw: contacts, goals, percepts, the table and the way."""

from math import pi
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from cgtorch.tabletop.kinematics.grasping import GRASP_HEIGHT
from cgtorch.tabletop.viewer.scene import (
    AHEAD,
    BOX_COLOUR,
    CONTACT,
    DONE,
    FLOOR,
    GOAL,
    GRIP,
    LEG_SIDE,
    OBSTACLE_HEIGHT,
    REFUSED,
    SEEN,
    WOOD,
    Scene,
    _about_z,
    _segments,
)


class Drawn:
    """A server that notes what would be drawn, by its name."""

    def __init__(self) -> None:
        self.scene, self.known = self, dict[str, Any]()

    def __getattr__(self, kind: str) -> Any:
        def add(name: str, *given: Any, **how: Any) -> None:
            self.known[name.removeprefix("/one/")] = SimpleNamespace(kind=kind, given=given, **how)

        return add


def plain_scene() -> tuple[Any, dict[str, Any]]:
    """A scene without a robot's links, and what is drawn of it."""
    scene, server = Scene.__new__(Scene), Drawn()
    scene.server, scene.name, scene.marked, scene.frame = server, "/one", 0, -1  # type: ignore[assignment]
    footprint = (-0.2, 0.3, -0.1, 0.1)
    scene.robot = SimpleNamespace(description=SimpleNamespace(footprint=footprint))  # type: ignore[assignment]
    return scene, server.known


def test_contacts_are_marked_while_there_are_some() -> None:
    scene, known = plain_scene()
    scene._contacts(np.zeros((0, 4)))
    assert not known
    scene._contacts(np.array([[1.0, 2.0, 3.0, 0.0], [4.0, 5.0, 6.0, 1.0]]))
    points, colours = known["contacts"].given
    assert points.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert colours.tolist() == [list(GRIP), list(REFUSED)]
    assert (known["contacts"].visible, known["contacts"].point_size) == (True, CONTACT)
    scene._contacts(np.zeros((0, 4)))
    assert known["contacts"].visible is False
    assert known["contacts"].given[0].tolist() == [[0, 0, 0]]  # as there has to be a point


def lines_of(drawn: Any) -> list[Any]:
    assert drawn.kind == "add_line_segments"
    assert drawn.thickness_units == "screen"
    return [[[round(x, 4) for x in end] for end in line] for line in drawn.given[0].tolist()]


def step_of(outcome: str, name: str = "MoveBase") -> SimpleNamespace:
    return SimpleNamespace(name=name, outcome=outcome)


def test_the_pose_that_is_asked_for_is_drawn_and_red_if_it_is_refused() -> None:
    scene, known = plain_scene()
    nan = torch.full((3,), float("nan"))
    run = SimpleNamespace(
        message=torch.stack([nan, torch.tensor([0.5, 0.0, pi / 2]), nan]),
        pose=torch.tensor([[1.0, 2.0, pi / 2], [0.0, 0.0, 0.0]]),
        steps=[step_of("success"), step_of("failure")],
    )
    scene._asked(SimpleNamespace(execution=run), 0)
    z = round(3 * FLOOR, 4)
    *outline, nose = lines_of(known["asked"])
    assert [end[:2] for end in nose] == [[1.0, 2.5], [0.67, 2.5]]  # it has turned to -x
    assert {tuple(end) for line in outline for end in line} == {
        (1.2, 2.6, z), (1.2, 2.4, z), (0.7, 2.6, z), (0.7, 2.4, z)
    }  # fmt: skip
    assert len(outline) == 4
    assert known["asked"].given[1] == GOAL
    assert known["asked"].visible is True
    scene._asked(SimpleNamespace(execution=run), 1)
    assert known["asked"].visible is False
    assert known["asked"].given[1] == REFUSED
    run.steps[1] = step_of("failure", "Grasp")
    scene._asked(SimpleNamespace(execution=run), 1)
    assert known["asked"].given[1] == GOAL
    run.message = run.message[:, :2]
    scene._asked(SimpleNamespace(execution=run), 0)
    assert known["asked"].visible is False
    run.message = torch.cat([torch.zeros(3, 3), nan[:, None]], 1)  # of which three are a motion
    scene._asked(SimpleNamespace(execution=run), 0)
    assert known["asked"].visible is True


def test_what_is_perceived_is_drawn_where_it_seems_to_be() -> None:
    scene, known = plain_scene()
    run = SimpleNamespace(
        scenario=SimpleNamespace(table=torch.tensor([[0.0, 0.0, 0.0, 1.0, 1.0, 0.7]])),
        pose=torch.tensor([[0.0, 0.0, 0.0], [1.0, 2.0, pi / 2]]),
        percept=torch.tensor([[0.0] * 7, [0.5, 1.5, -0.5, 0.5, 1.0, 0.25, 0.8]]),
    )
    scene._perceived(SimpleNamespace(execution=run), 1)
    z = round(0.7 + FLOOR, 4)
    box = lines_of(known["perceived"])
    assert {tuple(line[0]) for line in box} == {
        (0.5, 2.5, z), (0.5, 3.5, z), (1.5, 2.5, z), (1.5, 3.5, z)
    }  # fmt: skip
    assert {end[2] for line in box for end in line} == {z}
    assert all((one[0] == other[0]) is not (one[1] == other[1]) for one, other in box)
    cross = lines_of(known["perceived-object"])
    ends = {tuple(end) for line in cross for end in line}
    high = round(0.8 + 2 * FLOOR, 4)
    assert ends == {(0.75, 2.94, high), (0.75, 3.06, high), (0.69, 3.0, high), (0.81, 3.0, high)}
    assert known["perceived"].given[1] == known["perceived-object"].given[1] == SEEN


def test_a_table_its_legs_and_obstacles_are_boxes() -> None:
    scene, known = plain_scene()
    scene.actuated, scene.show = ["a", "b"], lambda frame: known.update(shown=frame)
    scenario = SimpleNamespace(
        table=torch.tensor([[1.0, 2.0, pi / 2, 0.8, 1.2, 0.7]]),
        obstacles=torch.tensor([[[0.5, 0.6, 0.0, 0.3, 0.4], [0.0] * 5]]),
    )
    pose = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    run = SimpleNamespace(scenario=scenario, skill=SimpleNamespace(name="Reach"), pose=pose)
    scene.load(SimpleNamespace(execution=run, names=("b", "a"), pose=pose))
    assert scene.columns == [1, 0]
    assert known["shown"] == 0
    table = known["table"]
    assert table.dimensions[:2] == pytest.approx((0.8, 1.2))
    assert table.position[2] + table.dimensions[2] / 2 == pytest.approx(0.7)
    assert table.position[:2] == (1.0, 2.0)
    assert table.color == WOOD
    assert table.wxyz == pytest.approx(_about_z(pi / 2))
    legs = [known[f"leg-{k}"] for k in range(4)]
    for leg in legs:
        assert leg.dimensions[:2] == (LEG_SIDE, LEG_SIDE)
        assert leg.position[2] == pytest.approx(leg.dimensions[2] / 2)
        assert leg.dimensions[2] + table.dimensions[2] == pytest.approx(0.7)
        off = sorted(abs(a - b) for a, b in zip(leg.position[:2], (1.0, 2.0), strict=True))
        assert off == pytest.approx([0.4 - LEG_SIDE, 0.6 - LEG_SIDE])
    assert len({leg.position for leg in legs}) == 4
    box = known["obstacle-0"]
    assert box.position == pytest.approx((0.5, 0.6, OBSTACLE_HEIGHT / 2))
    assert box.dimensions == pytest.approx((0.3, 0.4, OBSTACLE_HEIGHT))
    assert (box.visible, box.color) == (True, BOX_COLOUR)
    assert known["obstacle-1"].visible is False
    assert known["label"].given == ("Reach",)
    assert known["label"].anchor == "bottom-center"  # so that it is above its place
    assert known["label"].font_screen_scale > 1
    assert known["label"].position == pytest.approx((0.0, 0.0, 1.2))
    stops, way = lines_of(known["stops"]), lines_of(known["way"])
    assert len(stops) == 2 * 4  # as it stays for a step
    assert way == [[[0.0, 0.0, FLOOR], [1.0, 0.0, FLOOR]]]
    assert known["stops"].given[1] == known["way"].given[1] == AHEAD
    assert 1 < known["stops"].thickness < known["way"].thickness < 4


def test_where_there_are_no_lines_one_of_no_length_is_drawn() -> None:
    scene, known = plain_scene()
    scene._lines("driven", _segments(torch.zeros(3, 2)), DONE, 0.5, 5)
    assert lines_of(known["driven"]) == [[[0.0] * 3] * 2]
    assert known["driven"].thickness == 5


def test_a_quarter_turn_about_the_vertical() -> None:
    assert _about_z(pi / 2) == pytest.approx((0.5**0.5, 0, 0, 0.5**0.5))


class Line(SimpleNamespace):
    """A time line of three pictures."""

    def __len__(self) -> int:
        return 3


def test_a_picture_is_shown_once_and_joints_are_moved_only_if_they_differ() -> None:
    scene, known = plain_scene()
    told, moved = list[tuple[str, int]](), list[list[float]]()
    scene.base, scene.object = SimpleNamespace(), SimpleNamespace()
    scene.drawn = SimpleNamespace(update_cfg=lambda rest: moved.append(rest.tolist()))
    scene.rest, scene.columns, scene.timeline = np.array([7.0, 8.0, 9.0]), [2, 0], None
    scene._perceived = lambda line, seen: told.append(("seen", seen))
    scene._asked = lambda line, step: told.append(("step", step))
    scene.show(0)
    assert not told
    half = 0.5**0.5
    scene.timeline = Line(
        pose=torch.tensor([[1.0, 2.0, pi], [1.0, 2.0, 0.0], [3.0, 2.0, 0.0]]),
        turned=torch.tensor([[1.0, 0, 0, 0], [half, half, 0, 0], [1.0, 0, 0, 0]]),
        object=torch.tensor([[0.5, 0.6, 0.7]] * 3), contacts=[torch.zeros(0, 4)] * 3,
        joints=torch.tensor([[9.0, 7.0], [9.0, 7.0], [1.0, 2.0]]),
        seen=torch.tensor([0, 1, 1]), step=torch.tensor([0, 0, 1]),
    )  # fmt: skip
    scene.show(0)
    assert scene.base.position.tolist() == [1, 2, 0]
    assert scene.base.wxyz.tolist() == pytest.approx(_about_z(pi), abs=1e-6)
    assert scene.object.position.tolist() == pytest.approx([0.5, 0.6, 0.7 + GRASP_HEIGHT])
    assert moved == [[7, 8, 9]]  # at first always
    assert lines_of(known["driven"]) == [[[0.0] * 3] * 2]
    scene.show(0)
    assert told == [("seen", 0), ("step", 0)]
    scene.show(1)
    assert scene.object.position.tolist() == pytest.approx([0.5, 0.6 - GRASP_HEIGHT, 0.7])
    assert scene.object.wxyz.tolist() == pytest.approx([half, half, 0, 0])
    assert len(moved) == 1
    for frame in (2, 3, 99):
        scene.show(frame)
    assert moved[1:] == [[2, 8, 1]]
    assert told[2:] == [("seen", 1), ("step", 0), ("seen", 1), ("step", 1)]
    assert lines_of(known["driven"]) == [[[1.0, 2.0, 2 * FLOOR], [3.0, 2.0, 2 * FLOOR]]]
