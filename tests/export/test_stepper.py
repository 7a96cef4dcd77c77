"""A skill that acts step by step; `tests/simulation/reference.py` compares it with rollouts."""

from typing import Any

import pytest
import torch
from reaching import world_of
from support import random_graphs, random_skill, seeded
from walking import chain

from cgtorch.export.stepper import Stepper
from cgtorch.graphs import Action, Skill, SubSkill
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import ActionError, DataError
from cgtorch.simulation.rollout import most_steps, rollout
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world import random_scenarios


class Nosy(Action):
    """Moves by itself."""

    def forward(self, lanes: Lanes, parameters: Any, environment: Environment) -> Any:
        return environment.step(lanes, lanes.message)


def test_what_a_robot_does_not_have_is_named() -> None:
    actions = paper_actions().extended(["Nosy"], [Nosy()])
    many = random_graphs(0, 99, actions)
    starts = many.action.gather(1, many.start[:, None])[:, 0]
    graph = many[(starts == actions.index("Nosy")).nonzero()[:1, 0]]
    with pytest.raises(ActionError, match="asks its environment for 'step'"):
        Stepper(Skill("nosy", graph, actions)).act([0.0] * 7)
    for percept in ([[0.0] * 7], 1.0, ["far"]):
        with pytest.raises(DataError, match="one row of numbers"):
            Stepper(Skill("nosy", graph, actions)).act(percept)  # type: ignore[arg-type]
    for row in ([0.0] * 6, [torch.nan, *[0.0] * 6]):
        with pytest.raises(DataError, match="give 7 or more finite numbers"):
            Stepper(random_skill(0, "S", paper_actions())).act(row)


def test_a_sub_skill_may_begin_after_more_actions_than_it_could_make() -> None:
    """Of all skills only the outermost limits the actions on all levels."""
    actions = paper_actions()
    long = Skill("long", chain(actions, "Detect"), actions, 45)
    short = Skill("short", chain(actions, "Detect", "Detect"), actions, 2)
    both = actions.extended(["long", "short"], [SubSkill(long), SubSkill(short)])
    skill = Skill("S", chain(both, *["long"] * 10, "short"), both, 11)
    stepper, asked = Stepper(skill), 0
    while not stepper.act([0.0] * 7).ended:
        asked += 1
    assert asked == 10 * 45 + 2


def test_skills_within_skills_run_out_of_actions_together() -> None:
    """Three levels of 20 transitions would be 8,000 actions; a rollout ends after 400."""
    actions = paper_actions()
    skill = Skill("looks", chain(actions, "Detect"), actions)
    for level in ("middle", "outer"):
        actions = actions.extended([skill.name], [SubSkill(skill)])
        skill = Skill(level, chain(actions, skill.name), actions)
    stepper, asked = Stepper(skill), 0
    while not (request := stepper.act([0.0] * 7)).ended:
        asked += 1
    assert (request.kind, asked) == ("timeout", most_steps(actions, 20))
    world = world_of(random_scenarios("near", 1, seeded(0)))
    runs = rollout(skill.graph, actions, world, max_transitions=20)
    assert (int(runs.transitions), bool(runs.timed_out)) == (asked, True)
