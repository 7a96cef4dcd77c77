"""Primitives: where they move the hand, what they grasp and push, and how they end."""

from typing import Any

import pytest
import torch
from arms import chain, fetch, meta_world, starts
from torch import Tensor

from cgtorch.graphs import Graphs, Skill, SubSkill, check_action
from cgtorch.manipulation.domain import Fetch, Manipulation
from cgtorch.manipulation.primitives import OFFSET, WAY, primitives
from cgtorch.manipulation.simulator import SEEN, STEPS
from cgtorch.simulation import rollout

DOMAINS = [meta_world(), fetch()]


class Usual(Fetch):
    """FetchPush with the primitives that other tasks have."""

    def primitives(self) -> dict[str, Any]:
        return primitives(self.arm, 1 / 3)


def after(domain: Manipulation, *steps: tuple[str, tuple[float, ...]], most: int = 0) -> Tensor:
    """(2, S) what is seen before and after some actions, from one start."""
    world = domain.world(starts(domain, 5))
    runs = rollout(
        chain(domain, *steps), domain.actions(), world, max_transitions=most or len(steps)
    )
    first = world.start(torch.tensor([0]))[0]
    return torch.cat([first, runs.state[0]])


def place(row: Tensor, domain: Manipulation, name: str) -> Tensor:
    where = domain.arm.columns(name)
    return row[SEEN + where.start : SEEN + where.stop]


@pytest.mark.parametrize("domain", DOMAINS)
def test_every_primitive_keeps_the_interface(domain: Manipulation) -> None:
    world = domain.world(starts(domain, 1, 2))
    actions = domain.actions()
    for name, action in zip(actions.names, actions.actions, strict=True):
        check_action(name, action, world)


@pytest.mark.parametrize("domain", DOMAINS)
def test_the_hand_comes_where_it_should(domain: Manipulation) -> None:
    before, there = after(domain, ("ReachObject", (0.0, 1.0, 2.0)))
    wanted = place(before, domain, "object") + OFFSET * torch.tensor([0.0, 1.0, 2.0])
    assert (place(there, domain, "hand") - wanted).abs().max() < 0.025
    before, there = after(domain, ("Shift", (0.5, -0.5, 0.3)))
    wanted = place(before, domain, "hand") + WAY * torch.tensor([0.5, -0.5, 0.3])
    assert (place(there, domain, "hand") - wanted).abs().max() < 0.025


def test_what_is_picked_comes_along() -> None:
    domain = meta_world()
    steps = ("Pick", (0.0,) * 3), ("Shift", (0.0, 0.0, 1.0))
    before, there = after(domain, *steps)
    rise = place(there, domain, "object")[2] - place(before, domain, "object")[2]
    assert 0.07 < rise < 0.13
    _, dropped = after(domain, *steps, ("Open", ()), ("Open", ()))
    assert place(dropped, domain, "object")[2] < place(before, domain, "object")[2] + 0.02


@pytest.mark.parametrize("way", ["Place", "CarryGoal", "InsertGoal"])
def test_what_is_picked_can_be_brought_to_the_goal(way: str) -> None:
    domain = meta_world()
    before, there = after(domain, ("Pick", (0.0,) * 3), (way, (0.0,) * 4))
    far = (place(before, domain, "object") - place(before, domain, "goal")).norm()
    near = (place(there, domain, "object") - place(there, domain, "goal")).norm()
    assert far > 0.1
    assert near < 0.05


@pytest.mark.parametrize(
    ("domain", "way", "parameters"),
    [
        (DOMAINS[0], "PushTo", (0.0,) * 4),
        (Usual(fetch().settings), "PushTo", (0.0,) * 4),
        (DOMAINS[1], "Steer", (0.0,) * 3),
        (DOMAINS[0], "Drag", (0.0, -0.7, 0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_what_is_pushed_comes_nearer_to_the_goal(
    domain: Manipulation, way: str, parameters: tuple[float, ...]
) -> None:
    before, there = after(domain, (way, parameters))
    far = (place(before, domain, "object") - place(before, domain, "goal")).norm()
    near = (place(there, domain, "object") - place(there, domain, "goal")).norm()
    assert near < (1.0 if way == "Drag" else 0.7) * far


def test_a_skill_ends_with_the_time_and_fails() -> None:
    domain = meta_world()
    world = domain.world(starts(domain, 5))
    runs = rollout(chain(domain, ("Open", ())), domain.actions(), world, max_transitions=1000)
    assert not runs.succeeded.any()
    assert not runs.timed_out.any()
    assert runs.state[0, 0, STEPS] == 200
    assert float(domain.arm.elapsed(runs.percept[0])) == pytest.approx(1)


def test_a_skill_ends_with_success() -> None:
    domain = meta_world("reach-v3")
    world = domain.world(starts(domain, 5, 6, 7))
    runs = rollout(chain(domain, ("ReachGoal", (0.0,) * 3)), domain.actions(), world)
    assert runs.succeeded.all()
    assert (runs.state[..., STEPS] < 60).all()


@pytest.mark.parametrize(("offset", "solved"), [(0.0, True), (8.0, False)])
def test_an_episode_ends_wherever_a_skill_is(offset: float, solved: bool) -> None:
    """Even if what follows a skill within a skill would go on for ever."""
    domain = meta_world("reach-v3")
    world = domain.world(starts(domain, 5, 6))
    reach = chain(domain, ("ReachGoal", (offset, 0.0, 0.0)))
    inner = Skill("inner", reach, domain.actions(), 30)
    actions = domain.actions().extended(["inner"], [SubSkill(inner)])
    circle = torch.tensor([[[0, 0, -1]]])
    one, nothing = torch.tensor([[len(actions) - 1]]), torch.zeros(1, 1, 0)
    graph = Graphs(one, circle, nothing, torch.tensor([0]))
    runs = rollout(graph, actions, world, max_transitions=50)
    assert runs.succeeded.tolist() == [[solved] * 2]
    assert not runs.timed_out.any()
    assert ((runs.state[..., STEPS] == 200) | solved).all()


def test_offsets_of_new_nodes_are_small_but_vectors_are_not() -> None:
    actions = dict(zip(meta_world().actions().names, meta_world().actions().actions, strict=True))
    generator = torch.Generator().manual_seed(0)
    for name, small in (("Pick", True), ("Shift", False), ("Drag", True)):
        drawn = actions[name].initial_parameters(2000, generator)
        assert float(drawn[:, :3].std()) == pytest.approx(0.4 if small else 1.0, rel=0.1)
    assert float(actions["Drag"].initial_parameters(2000, generator)[:, 3:].std()) > 0.9
