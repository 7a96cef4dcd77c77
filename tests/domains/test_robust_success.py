"""What the models promise, against running each imagined scenario by itself."""

import torch
from members import nearly
from support import FOOTPRINT, seeded, world

from cgtorch.domains.knowledge import Knowledge, imagine
from cgtorch.improvement.robust_success import promised
from cgtorch.simulation import rollout

PERCEPTS = world(0, 20).start(torch.arange(20))[1]


def test_a_promise_holds_under_every_error_drawn(knowledge: Knowledge) -> None:
    skill, foot = nearly(0.3), torch.tensor(FOOTPRINT)
    found = promised(skill, knowledge, PERCEPTS, foot, seeded(3), replicas=5)
    place = imagine(knowledge, PERCEPTS, foot, 5, seeded(3))
    one_by_one = [
        all(
            bool(rollout(skill.graph, skill.actions, place, scenarios=torch.tensor([i])).succeeded)
            for i in range(5 * row, 5 * row + 5)
        )
        for row in range(20)
    ]
    assert found.tolist() == one_by_one
    assert 0 < sum(one_by_one) < 20
