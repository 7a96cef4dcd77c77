import re
from functools import cache
from pathlib import Path

from lxml import html
from support import custom_actions, random_skill, world

from cgtorch.graphs import Skill
from cgtorch.runs.skills import last_skill
from cgtorch.tabletop.viewer.choice import scenario_of
from cgtorch.tabletop.viewer.execution import Execution, execute
from cgtorch.tabletop.viewer.graph_levels import LIT, levels_html

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
    assert deepest == 4


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
