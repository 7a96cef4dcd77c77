"""A skill that acts step by step does what `rollout` does."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from reaching import world_of
from support import random_graphs, random_skill, seeded
from walking import chain

from cgtorch.export.stepper import Stepper
from cgtorch.graphs import Action, Skill, SubSkill
from cgtorch.ground.environment import Environment, Lanes, start_lanes
from cgtorch.ground.errors import ActionError, DataError
from cgtorch.simulation.rollout import most_steps, rollout
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world import random_scenarios


class Counter(Action):
    """Counts its visits in its memory, and says whether they are even."""

    outcomes = ("odd", "even")
    memory_size = 1

    def forward(self, lanes: Lanes, parameters: Any, environment: Environment) -> Any:
        memory = lanes.memory + 1
        return replace(lanes, memory=memory), (memory[:, 0] % 2 == 0).long()


def run_by_steps(skill: Skill, world: Environment) -> tuple[str, int, torch.Tensor]:
    """How a skill ends on the only scenario, its world actions, and the last percept."""
    lanes = start_lanes(world, torch.tensor([0]), 0, 0)
    stepper, asked, done = Stepper(skill), 0, True
    request = stepper.act(lanes.percept[0])
    while not request.ended:
        asked += request.kind != "perceive"
        match request.kind:
            case "control":
                lanes, moved = world.step(lanes, torch.tensor([request.control]))
                done = bool(moved)
            case "perceive":
                lanes, done = world.observe(lanes), True
            case "test":
                lanes, chance = world.success(lanes)
                done = bool(chance > 0.5)
        request = stepper.act(lanes.percept[0].tolist(), done)
    return request.kind, asked, lanes.percept[0]


@given(st.integers(0, 2**20))
def test_any_skill_ends_as_in_a_rollout(seed: int) -> None:
    generator, actions = seeded(seed), paper_actions().extended(["Counter"], [Counter()])
    inner = Skill("inner", random_graphs(seed, 1, actions), actions, 5)
    outer = actions.extended(["inner"], [SubSkill(inner)])
    skill = Skill("outer", random_graphs(seed + 1, 1, outer), outer, 12)
    world = world_of(random_scenarios("perimeter", 1, generator))
    runs = rollout(skill.graph, outer, world, max_transitions=12)
    end, _, percept = run_by_steps(skill, world)
    wanted = "success" if runs.succeeded[0, 0] else "timeout" if runs.timed_out[0, 0] else "failure"
    assert end == wanted
    torch.testing.assert_close(percept, runs.percept[0, 0], rtol=0, atol=1e-4)


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
