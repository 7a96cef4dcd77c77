"""One skill on one scenario in plain numbers: the state machine that exports write."""

import torch

from cgtorch.export import Stepper
from cgtorch.graphs import ActionSet, Graphs, Skill
from cgtorch.ground.environment import Environment, seeds_of, start_lanes


def run(
    graphs: Graphs,
    actions: ActionSet,
    environment: Environment,
    scenario: int,
    max_transitions: int,
    max_steps: int | None = None,
) -> tuple[str, int, list[float]]:
    """How the first graph ends on a scenario, after how many actions, and the last percept."""
    which = torch.tensor([scenario])
    lanes = start_lanes(environment, which, 0, 0)
    skill = Skill("one", graphs, actions, max_transitions)
    stepper, done = Stepper(skill, int(seeds_of(environment, which)), max_steps), True
    while not (request := stepper.act(lanes.percept[0], done)).ended:
        if request.kind == "control":
            control = lanes.percept.new_tensor([request.control])
            lanes, moved = environment.step(lanes, control)
            done = bool(moved)
        elif request.kind == "test":
            lanes, chance = environment.success(lanes)
            done = bool(chance > 0.5)
        else:
            lanes = environment.observe(lanes)
    return request.kind, stepper._userdata.steps, lanes.percept[0].tolist()
