"""An environment that keeps what happened in it, to learn from."""

import torch
from torch import Tensor

from cgtorch.environment import Environment, Lanes, Rewarded, seeds_of


class Recording:
    """Passes everything on to an environment and keeps its transitions and tests.

    `transitions` are (p, u, p′) of the controls that were carried out, `tests` are (p, success).
    """

    def __init__(self, environment: Environment):
        self.environment = environment
        self.transitions: list[tuple[Tensor, Tensor, Tensor]] = []
        self.tests: list[tuple[Tensor, Tensor]] = []

    @property
    def num_scenarios(self) -> int:
        """See `Environment.num_scenarios`."""
        return self.environment.num_scenarios

    @property
    def percept_size(self) -> int:
        """See `Environment.percept_size`."""
        return self.environment.percept_size

    @property
    def control_size(self) -> int:
        """See `Environment.control_size`."""
        return self.environment.control_size

    @property
    def seeds(self) -> Tensor:
        """See `Seeded.seeds`."""
        return seeds_of(self.environment, torch.arange(self.num_scenarios))

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        return self.environment.start(scenario)

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """See `Environment.step`."""
        after, done = self.environment.step(lanes, control)
        self.transitions.append((lanes.percept[done], control[done], after.percept[done]))
        return after, done

    def observe(self, lanes: Lanes) -> Lanes:
        """See `Environment.observe`."""
        return self.environment.observe(lanes)

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """See `Environment.success`."""
        lanes, result = self.environment.success(lanes)
        self.tests.append((lanes.percept.clone(), result > 0.5))
        return lanes, result

    def experience(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """All p (N, D), u (N, U), p′ (N, D), tested p (L, D) and their success (L,) bool."""
        d, u = self.percept_size, self.control_size
        empty = (torch.zeros(0, d), torch.zeros(0, u), torch.zeros(0, d))
        nothing = (torch.zeros(0, d), torch.zeros(0, dtype=torch.bool))
        moved = [torch.cat(x) for x in zip(*[empty, *self.transitions], strict=True)]
        tested = [torch.cat(x) for x in zip(*[nothing, *self.tests], strict=True)]
        return moved[0], moved[1], moved[2], tested[0], tested[1]


class RewardedRecording(Recording):
    """The same around an environment that gives rewards."""

    def __init__(self, environment: Environment, rewards: Rewarded):
        super().__init__(environment)
        self.rewards = rewards

    def over(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.over`."""
        return self.rewards.over(lanes)

    def returns(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.returns`."""
        return self.rewards.returns(lanes)


def recording_of(environment: Environment) -> Recording:
    """A recording around an environment."""
    if isinstance(environment, Rewarded):
        return RewardedRecording(environment, environment)
    return Recording(environment)
