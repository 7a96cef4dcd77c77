from dataclasses import replace

import torch
from support import judged_by, model, seeded, world

from cgtorch.ground.environment import start_lanes
from cgtorch.tabletop.actions import Detect, Grasp, MoveBase
from cgtorch.tabletop.world import Noise

NO_PARAMETERS = torch.zeros(4, 0)


def test_move_base_moves_by_its_message_or_stays() -> None:
    environment = world(0, 4, Noise(0, 0))
    lanes = start_lanes(environment, torch.arange(4), 3, 0)
    message = torch.tensor([[-0.2, 0.1, 0.3], [1.5, 0, 0], [-0.2, 0.1, 0.3], [torch.nan, 0, 0]])
    has_message = torch.tensor([True, True, False, True])
    lanes = replace(lanes, message=message, has_message=has_message)
    after, outcome = MoveBase()(lanes, NO_PARAMETERS, environment)
    assert outcome.tolist() == [0, 1, 1, 1]
    assert torch.equal(after.percept[1:], lanes.percept[1:])
    assert torch.equal(after.state[1:], lanes.state[1:])
    assert not torch.equal(after.percept[0], lanes.percept[0])
    assert after.message is message


def test_detect_looks_again_with_new_noise_and_stays_where_it_is() -> None:
    environment = world(0, 4)
    lanes = start_lanes(environment, torch.arange(4), 0, 0)
    after, outcome = Detect()(lanes, NO_PARAMETERS, environment)
    assert outcome.tolist() == [0] * 4
    assert torch.equal(after.state[:, :11], lanes.state[:, :11])
    difference = (after.percept - lanes.percept).abs()
    assert difference.max() < 0.05
    assert (difference > 0).any(1).all()


def test_grasp_succeeds_above_one_half() -> None:
    environment = model(0, 4)
    environment = judged_by(environment, lambda p: torch.tensor([0.0, 0.5, 0.51, 1.0])[: len(p)])
    lanes = start_lanes(environment, torch.arange(4), 0, 0)
    after, outcome = Grasp()(lanes, NO_PARAMETERS, environment)
    assert outcome.tolist() == [1, 1, 0, 0]
    assert after is lanes


def test_actions_of_the_paper_do_not_change_what_they_are_given() -> None:
    environment = world(1, 4)
    lanes = start_lanes(environment, torch.arange(4), 3, 0)
    lanes.has_message[:] = True
    lanes.message[:] = torch.randn(4, 3, generator=seeded(0)) / 10
    kept = {name: value.clone() for name, value in vars(lanes).items()}
    for action in (MoveBase(), Detect(), Grasp()):
        action(lanes, NO_PARAMETERS, environment)
        assert all(torch.equal(value, getattr(lanes, name)) for name, value in kept.items())
