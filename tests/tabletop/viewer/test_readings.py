from dataclasses import replace

import pytest
import torch
from support import custom_actions, random_skill, world

from cgtorch.ground.errors import DataError
from cgtorch.tabletop.kinematics import load_robot
from cgtorch.tabletop.viewer.execution import execute
from cgtorch.tabletop.viewer.postures import rest_postures
from cgtorch.tabletop.viewer.readings import headline, message_rows, percept_rows, readings_html
from cgtorch.tabletop.viewer.timeline import timeline_of


@pytest.mark.parametrize(
    ("size", "names"),
    [
        (7, ["table x min", "object z"]),
        (9, ["side x", "side y"]),
        (15, ["obstacle 1 x min", "obstacle 2 y max"]),
        (13, ["side y", "obstacle 1 y max"]),
    ],
)
def test_every_number_of_a_percept_has_a_name(size: int, names: list[str]) -> None:
    rows = percept_rows(torch.arange(size) / 10)
    assert [value for _, value in rows] == [f"{i / 10:.3f} m" for i in range(size)]
    found = [name for name, _ in rows]
    assert len(set(found)) == size
    assert set(names) <= set(found)


def test_percepts_of_another_length_are_refused() -> None:
    with pytest.raises(DataError, match="a percept has 8 numbers"):
        percept_rows(torch.zeros(8))


def test_messages() -> None:
    assert message_rows(torch.full((3,), float("nan"))) == []
    assert message_rows(torch.tensor([0.5, -1.0, 0.25, 2.0])) == [
        ("dx", "+0.500 m"),
        ("dy", "-1.000 m"),
        ("dθ", "+0.250 rad"),
        ("3", "+2.000"),
    ]


def test_what_is_shown_is_of_the_step_and_safe_as_html() -> None:
    robot = load_robot()
    rest = tuple(torch.zeros_like(q) for q in rest_postures(robot))
    skill = random_skill(3, "<b>", custom_actions())
    run = execute(skill, world(3, 1))
    line = timeline_of(run, robot, rest)
    for k, step in enumerate(run.steps):
        frame = line.start_of(k)
        slot = step.places[-1][1]
        named = f"step {k + 1} of {len(run.steps)}: <b> · {step.name}_{slot} → {step.outcome}"
        assert headline(line, frame) == named
        text = readings_html(line, frame)
        assert "<b>: " not in text
        assert "&lt;b&gt; ·" in text
        for name, value in percept_rows(run.percept[int(line.seen[frame])]):
            assert f">{name}<" in text
            assert f">{value}<" in text
    assert headline(line, len(line) - 1).endswith(f"<b> ended with {run.end}")
    quiet = replace(run, message=torch.full_like(run.message, float("nan")))
    assert "none yet" in readings_html(replace(line, execution=quiet), 0)
