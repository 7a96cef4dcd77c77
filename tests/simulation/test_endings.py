"""Where a skill ends on many scenarios at once, against one trace each."""

import pytest
import torch
from reaching import TABLE
from support import random_skill, seeded

from cgtorch.domains.registry import make_domain
from cgtorch.graphs import SubSkill
from cgtorch.simulation import rollout, traced
from cgtorch.simulation.endings import endings
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world import TabletopWorld


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("most", [None, 5])
def test_it_is_where_each_trace_ends(
    seed: int, most: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also in a world that runs only a few lanes at once."""
    if most is not None:
        monkeypatch.setattr(TabletopWorld, "most_lanes", most, raising=False)
    inner = random_skill(seed, "inner", paper_actions(), max_transitions=4)
    actions = paper_actions().extended(["inner"], [SubSkill(inner)])
    skill = random_skill(seed + 9, "some", actions, max_transitions=9)
    world = TABLE.world(TABLE.draw("near", 12, seeded(seed)))
    found = endings(skill, world)
    assert len(found) == 12
    for i, one in enumerate(found):
        run = traced(skill, world, i)
        assert one.end == run.end
        assert one.acts == len(run.steps)
        last = run.steps[-1]
        assert (one.step.places, one.step.name, one.step.outcome) == (
            last.places, last.name, last.outcome,
        )  # fmt: skip
        assert torch.equal(one.percept, run.lanes[-1].percept[0])
        assert one.returned is None
        failed = [
            lanes.percept[0]
            for step, lanes in zip(run.steps, run.lanes[1:], strict=True)
            if step.name == "Grasp" and step.outcome == "failure"
        ]
        assert torch.equal(one.tested, torch.stack(failed) if failed else one.tested[:0])


def test_returns_are_those_of_a_rollout_and_no_scenario_has_no_ending() -> None:
    domain = make_domain("gymnasium:CartPole-v1")
    skill = random_skill(0, "any", domain.actions())
    world = domain.world(domain.draw("starts", 3, seeded(0)))
    returns = rollout(skill.graph, skill.actions, world, max_transitions=20).returns
    assert returns is not None
    assert [one.returned for one in endings(skill, world)] == returns[0].tolist()
    assert endings(skill, domain.world(domain.draw("starts", 0, seeded(0)))) == []
