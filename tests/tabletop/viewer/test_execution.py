from itertools import pairwise

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import Visits, custom_actions, nested_actions, random_skill, world

from cgtorch.graphs import ActionSet, Graphs, Skill
from cgtorch.ground.environment import Lanes
from cgtorch.ground.errors import SettingsError
from cgtorch.simulation import rollout
from cgtorch.simulation.tracing import Step
from cgtorch.tabletop.actions import Detect
from cgtorch.tabletop.viewer.execution import FROM_EDGE, execute, put_object, scenario_of
from cgtorch.tabletop.world import draw_of
from cgtorch.tabletop.world.geometry import rotate
from cgtorch.tabletop.world.scenarios import DRAWS

COUNT = 6


@pytest.mark.parametrize("kind", DRAWS)
def test_scenarios_are_those_that_evaluation_tries(kind: str) -> None:
    drawn = draw_of(kind)(5, torch.Generator().manual_seed(7))
    for number in range(5):
        one = scenario_of(kind, 5, 7, number)
        assert len(one) == 1
        for name, value in vars(drawn).items():
            assert torch.equal(getattr(one, name)[0], value[number]), name
    with pytest.raises(SettingsError, match="unknown placement 'moon'"):
        scenario_of("moon", 5, 0, 0)


@given(st.integers(0, 9), st.floats(-3, 3), st.floats(-3, 3))
def test_an_object_stays_on_the_table_wherever_it_is_dragged(n: int, x: float, y: float) -> None:
    before, at = scenario_of("general", 10, 0, n), torch.tensor([x, y])
    after = put_object(before, at)
    table = after.table[0]
    room = table[3:5] / 2 - FROM_EDGE
    placed, wanted = (rotate(p - table[:2], -table[2]).abs() for p in (after.object[0], at))
    assert (placed <= room + 1e-5).all()
    if (wanted < room).all():
        torch.testing.assert_close(after.object[0], at, atol=1e-5, rtol=0)
    for name in vars(before).keys() - {"object"}:
        assert torch.equal(getattr(after, name), getattr(before, name))


KINDS = {
    "flat": lambda seed: random_skill(seed, "flat", custom_actions()),
    "nested": lambda seed: random_skill(seed, "nested", nested_actions(seed), max_transitions=7),
    "memories": lambda seed: random_skill(
        seed, "memories", nested_actions(seed, custom_actions().extended(["Visits"], [Visits()]))
    ),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(5))
def test_an_execution_is_that_of_a_rollout(kind: str, seed: int) -> None:
    skill, place = KINDS[kind](seed), world(seed, COUNT)
    seen: list[list[tuple[int, Lanes]]] = [[] for _ in range(COUNT)]

    def trace(
        active: torch.Tensor, node: torch.Tensor, outcome: torch.Tensor, lanes: Lanes
    ) -> None:
        for row, lane in enumerate(active.tolist()):
            seen[lane].append((int(outcome[row]), lanes.rows(torch.tensor([row]))))

    runs = rollout(
        skill.graph, skill.actions, place, max_transitions=skill.max_transitions, trace=trace
    )
    for i in range(COUNT):
        one = execute(skill, place, i)
        assert len(one.steps) == int(runs.transitions[0, i]) == len(seen[i])
        assert (one.end == "success") == bool(runs.succeeded[0, i])
        assert (one.end == "timeout") == bool(runs.timed_out[0, i])
        for k, (outcome, lanes) in enumerate(seen[i]):
            assert one.steps[k].outcome == one.steps[k].action.outcomes[outcome]
            assert torch.equal(one.percept[k + 1], lanes.percept[0])
            assert torch.equal(one.pose[k + 1], lanes.state[0, :3])
            sent = bool(lanes.has_message)
            assert torch.equal(one.message[k + 1], lanes.message[0]) == sent
            assert bool(one.message[k + 1].isnan().all()) != sent


def joined(one: Step, two: Step) -> bool:
    """Whether an edge on some level leads from one step to the next, which begins what it enters.

    Of the innermost level it must be the edge of the outcome.
    """
    for level, ((skill, tail), (other, head)) in enumerate(
        zip(one.places, two.places, strict=False)
    ):
        edges = skill.graph.edges[0, tail].tolist()
        if level == len(one.places) - 1:
            edges = [edges[one.action.outcomes.index(one.outcome)]]
        begins = all(int(inner.graph.start) == slot for inner, slot in two.places[level + 1 :])
        if skill is other and head in edges and begins:
            return True
        if (skill, tail) != (other, head):
            return False
    return False


@pytest.mark.parametrize("seed", range(5))
def test_the_nodes_of_an_execution_are_joined_by_edges(seed: int) -> None:
    skill, place = KINDS["nested"](seed), world(seed, COUNT)
    deepest = 0
    for i in range(COUNT):
        run = execute(skill, place, i)
        assert all(joined(a, b) for a, b in pairwise(run.steps))
        for step in run.steps:
            deepest = max(deepest, len(step.places))
            assert step.places[0][0] is skill
            inner, slot = step.places[-1]
            named = inner.actions.names[int(inner.graph.action[0, slot])]
            assert named == step.name
            assert inner.actions.actions[inner.actions.index(named)] is step.action
            for (outer, at), (within, _) in zip(step.places, step.places[1:], strict=False):
                assert skill_at(outer, at) is within
    assert deepest >= 2


def skill_at(skill: Skill, slot: int) -> Skill:
    return skill.sub_skills[skill.actions.names[int(skill.graph.action[0, slot])]]


def test_a_skill_runs_as_long_as_its_own_limit() -> None:
    actions = ActionSet(("Detect",), (Detect(),))
    loop = torch.zeros(1, 1, dtype=torch.long)
    graph = Graphs(loop, loop[None], torch.zeros(1, 1, 0), torch.tensor([0]))
    run = execute(Skill("loop", graph, actions, max_transitions=450), world(0, 1))
    assert (len(run.steps), run.end) == (450, "timeout")
