import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import torch
from lxml import html
from support import custom_actions, random_skill, world

from cgtorch.graphs import Skill
from cgtorch.ground.errors import DataError
from cgtorch.runs.skills import last_skill
from cgtorch.tabletop.kinematics import load_robot
from cgtorch.tabletop.viewer.choice import scenario_of
from cgtorch.tabletop.viewer.execution import Execution, execute
from cgtorch.tabletop.viewer.panel import (
    LIT,
    headline,
    levels_html,
    message_rows,
    percept_rows,
    readings_html,
)
from cgtorch.tabletop.viewer.timeline import timeline_of

REFERENCE = Path(__file__).parents[3] / "runs" / "reference"
LIT_RULE = re.compile(rf'\[data-part="(node:[^"]+)"\] path {{ fill: {LIT}')
EDGE_RULE = re.compile(r'\[data-part="((?:edge|end):[^"]+)"\]')


@cache
def executions() -> list[Execution]:
    run, skill = last_skill(REFERENCE)
    scenarios = [scenario_of("perimeter", 8, 0, i) for i in (0, 3, 5)]
    return [execute(skill, run.domain.world(s)) for s in scenarios]


def label(skill: Skill, slot: int) -> str:
    return f"{skill.actions.names[int(skill.graph.action[0, slot])]}_{slot}"


def test_every_level_is_drawn_and_its_node_lit() -> None:
    deepest = 0
    for run in executions():
        for step in run.steps:
            text = levels_html(run.skill, step)
            page = html.fromstring(text)
            assert len(page.xpath(".//svg")) == len(step.places)
            deepest = max(deepest, len(step.places))
            lit = LIT_RULE.findall(text)
            assert [node.rsplit(":", 1)[1] for node in lit] == [label(*p) for p in step.places]
            for node in lit:
                (group,) = page.xpath(".//*[@data-part=$id]", id=node)
                assert group.xpath(".//path"), node
    assert 1 < deepest <= run.skill.depth


def test_the_edge_of_the_outcome_is_lit() -> None:
    for run in executions():
        for k, step in enumerate(run.steps):
            text = levels_html(run.skill, step)
            (edge,) = EDGE_RULE.findall(text)
            (group,) = html.fromstring(text).xpath(".//*[@data-part=$id]", id=edge)
            assert group.xpath(".//path")
            kind, _, tail, outcome, *head = edge.split(":")
            assert (tail, outcome) == (label(*step.places[-1]), step.outcome)
            assert (kind == "end") == (not head)
            if head and len(run.steps[k + 1].places) == len(step.places) == 1:
                assert head == [label(*run.steps[k + 1].places[-1])]
        assert kind == "end"


def test_names_that_look_like_markup_stay_names() -> None:
    name = 'S<img src=x>"]</style><b>\\'
    run = execute(random_skill(3, name, custom_actions()), world(3, 1))
    page = html.fromstring(levels_html(run.skill, run.steps[0]))
    assert not page.xpath(".//img") + page.xpath(".//b")
    assert page.xpath(".//*[starts-with(@data-part, $id)]", id=f"node:{name}:")
    (style,) = (s.text for s in page.xpath(".//style") if LIT in (s.text or ""))
    assert name not in style


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
    skill = random_skill(3, "<b>", custom_actions())
    run = execute(skill, world(3, 1))
    line = timeline_of(run, robot)
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
