"""What the models promise, against running each imagined scenario by itself."""

import torch
from members import nearly
from reaching import TABLE_MODELS
from support import seeded, world

from cgtorch.domains.knowledge import Knowledge
from cgtorch.simulation import rollout
from cgtorch.training.evaluate import robust_success

PERCEPTS = world(0, 20).start(torch.arange(20))[1]


def test_a_promise_holds_under_every_error_drawn(knowledge: Knowledge) -> None:
    skill = nearly(0.3)
    found = robust_success(TABLE_MODELS, skill, knowledge, PERCEPTS, seeded(3), replicas=5)
    place = TABLE_MODELS.imagine(knowledge, PERCEPTS, 5, seeded(3))
    one_by_one = [
        all(
            bool(rollout(skill.graph, skill.actions, place, scenarios=torch.tensor([i])).succeeded)
            for i in range(5 * row, 5 * row + 5)
        )
        for row in range(20)
    ]
    assert found.tolist() == one_by_one
    assert 0 < sum(one_by_one) < 20
