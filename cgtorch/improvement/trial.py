"""Trying a skill in the world (Algorithm 1, line 2), and what it means that it succeeds.

A scenario is a placement and the noise that is met there, drawn from the scenario's seed. A skill
succeeds on it if one run reaches a terminal outcome with success; run again it does the same, so W
and eq. 1a are statements without a confidence. What is said of placements, whatever the noise, is
a share with Wilson's 95 % interval: of fresh scenarios (`cgtorch-evaluate`, the tests of a round),
and of W when it is met by other noise (`w_other_noise` in the ledger). A specialist counts as
solving a scenario only if it does so under `Setup.trials` draws of noise.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from cgtorch.environment import Dataset, Environment
from cgtorch.graphs import Skill
from cgtorch.simulation import Recording, recording_of, rollout


@dataclass(frozen=True)
class Trial:
    """What a skill did on B scenarios of a world.

    Attributes:
        succeeded: (B,) bool.
        transitions: (B,) long, actions executed.
        experience: the transitions and tests it went through, none if nobody learns from them.
        returns: (B,) of its episodes; None where the world gives no rewards.
    """

    succeeded: Tensor
    transitions: Tensor
    experience: Dataset
    returns: Tensor | None = None


def try_skill(skill: Skill, world: Environment) -> Trial:
    """Run a skill once on every scenario, and keep what it experiences."""
    recording = recording_of(world)
    trial = run_skill(skill, recording)
    return replace(trial, experience=Dataset(*recording.experience()))


def run_skill(skill: Skill, world: Environment) -> Trial:
    """The same without keeping anything: long episodes are a lot to keep."""
    runs = rollout(skill.graph, skill.actions, world, max_transitions=skill.max_transitions)
    nothing = Dataset(*Recording(world).experience())
    returns = None if runs.returns is None else runs.returns[0]
    return Trial(runs.succeeded[0], runs.transitions[0], nothing, returns)


def first_percepts(world: Environment) -> Tensor:
    """(B, D) what the robot sees at the start of each scenario."""
    return world.start(torch.arange(world.num_scenarios))[1]
