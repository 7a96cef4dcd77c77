"""What is learned of an arm's task: Γ of segments, and how close a state is to success.

A segment mostly brings the hand to its target, and leaves things where they are. So Γ learns what
happens otherwise, from where things are as seen from the hand and from the target.
"""

from math import sqrt
from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch.domains.gaussian_process import GaussianProcess
from cgtorch.domains.learned_reward import Margin, Usual
from cgtorch.domains.rewarded_models import RewardedModels
from cgtorch.improvement.played import Steps
from cgtorch.manipulation.arm import Arm
from cgtorch.manipulation.primitives import ARRIVED, FAR
from cgtorch.manipulation.world import GRADED

AROUND = 0.08
"""The standard deviation of random targets around a place, in m."""
RELEVANT = 8
"""The number of features, of those that tell of grades, for which the width of success is meant."""
NARROW, WIDE = 0.3, 30.0
"""The smallest and largest length scales of features of success."""


class ArmModels(RewardedModels[Any]):
    """Γ and grades of a single task of an arm, whose steps are segments."""

    graded = True
    looks = 100
    changes = (1.0,) * 6

    def __init__(self, domain: Any) -> None:
        """The models of a `Manipulation` with a single task."""
        super().__init__(domain)
        self.arm: Arm = domain.arm
        self.most_steps = domain.settings.horizon

    def random_control(self, percept: Tensor, generator: Generator) -> Tensor:
        """See `RewardedModels.random_control`: a segment to somewhere around one of the places."""
        places = "hand", *self.arm.places
        place = places[int(torch.randint(len(places), (), generator=generator))]
        target = self.arm.position(percept, place)
        target = target + AROUND * torch.randn(1, 3, generator=generator)
        grip = 2.0 * torch.randint(2, (1, 1), generator=generator) - 1
        more = torch.tensor([[FAR, 1.0, ARRIVED]])
        return torch.cat([target, grip, more], 1)

    def fit_gamma(self, steps: Steps, free: Tensor | None) -> GaussianProcess:
        """See `RewardedModels.fit_gamma`."""
        return SegmentProcess(self.arm, steps.percept, steps.control, steps.after, free)

    def fit_reward(self, steps: Steps, free: Tensor | None, starts: Tensor) -> "LearnedGrade":
        """See `RewardedModels.fit_reward`."""
        return LearnedGrade(self.arm, steps, free)


class SegmentProcess(GaussianProcess):
    """Γ of segments."""

    def __init__(self, arm: Arm, percept: Tensor, control: Tensor, *more: Any) -> None:
        """Fit steps of an arm, as `GaussianProcess` does."""
        self.arm = arm
        been = torch.cat([each[:, arm.columns("hand")] for each in (percept, more[0])]).double()
        self._low, self._high = been.amin(0), been.amax(0)
        super().__init__(percept, control, *more)

    def features(self, percept: Tensor, control: Tensor) -> Tensor:
        """See `GaussianProcess.features`. Goals are not there, so they make no difference."""
        arm, target = self.arm, self._target(control)
        hand = percept[:, arm.columns("hand")]
        things = [percept[:, arm.columns(place)] for place in arm.places if place != "goal"]
        seen = [thing - end for thing in things for end in (hand, target)]
        way = target - hand
        own = [i for i, name in enumerate(arm.names) if name == "opening" or " q" in name]
        parts = way, way.norm(dim=1, keepdim=True), hand, target, *seen, percept[:, own]
        return torch.cat([*parts, control[:, 3:]], 1)

    def expected(self, percept: Tensor, control: Tensor) -> Tensor:
        """See `GaussianProcess.expected`: the hand is at its target, and nothing else has moved.

        It is not expected where it has never been, as targets may be out of reach.
        """
        after = percept.clone()
        after[:, self.arm.columns("hand")] = self._target(control)
        return after

    def folded(self, f: int, d: int) -> Tensor:
        """See `GaussianProcess.folded`: nothing, as `predict` adds what is expected."""
        return torch.zeros(f, d, dtype=torch.float64)

    def predict(self, percept: Tensor, control: Tensor) -> tuple[Tensor, Tensor]:
        """See `GaussianProcess.predict`."""
        change, unsure = super().predict(percept, control)
        return self.expected(percept.double(), control.double()) + change, unsure

    def _target(self, control: Tensor) -> Tensor:
        centre = torch.tensor(self.arm.centre, dtype=control.dtype)
        target = (control[:, :3] - centre) / self.arm.unit
        return target.clamp(self._low.to(target), self._high.to(target))


class LearnedGrade:
    """The grades of states as a `Reward`: each step gives what the grade changes by.

    The grade of a state in which the task is not solved is a Gaussian process of where the hand and
    things are from each other. Whether the task is solved is told by a support vector machine, to
    which numbers count as much as to grades.

    Attributes:
        free: (F + 3,) the parameters of the Gaussian process, with which a later fit can begin.
    """

    def __init__(self, arm: Arm, steps: Steps, free: Tensor | None = None) -> None:
        """Fit at least one step."""
        self.arm = arm
        rows, grades = self._features(steps.after), grades_after(arm, steps)
        solved = grades > GRADED
        some = ~solved if not bool(solved.all()) else torch.ones_like(solved)
        self._usual = Usual(rows[some], grades[some], free)
        self.free = self._usual.free
        self._always, self._solved = bool(solved.all()), None
        if bool(solved.any()) and not self._always:
            self._solved = Margin(self._relevant(rows), solved)

    def __call__(self, before: Tensor, control: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:
        """Changes of grades (n,), and (n,) bool, which steps end their episodes."""
        began = self.arm.elapsed(before) <= 0  # when the return is 0
        earlier = torch.where(began, 0.0, self.grade(before)[0].clamp_max(GRADED))
        grade, solved = self.grade(after)
        late = self.arm.elapsed(after) >= 1
        return (grade - earlier).to(before), solved | late

    def grade(self, percept: Tensor) -> tuple[Tensor, Tensor]:
        """(n,) the grades of percepts (n, D), and (n,) bool, whether the task is solved."""
        rows = self._features(percept)
        grade = self._usual(rows).clamp(0, GRADED)
        solved = torch.full((len(rows),), self._always)
        if self._solved is not None:
            solved = self._solved(self._relevant(rows))
        return torch.where(solved, 1.0, grade), solved

    def _features(self, percept: Tensor) -> Tensor:
        """(n, F) where the hand and the places are from each other, and what the hand holds."""
        percept, arm = percept.double(), self.arm
        places = [percept[:, arm.columns(place)] for place in ("hand", *arm.places)]
        ways = [a - b for i, a in enumerate(places) for b in places[i + 1 :]]
        long = torch.stack([way.norm(dim=1) for way in ways], 1)
        opening = percept[:, [arm.names.index("opening")]]
        return torch.cat([*ways, long, long.square(), opening, *places[:2]], 1)

    def _relevant(self, rows: Tensor) -> Tensor:
        """Features (n, F) in units in which they count as much as for grades."""
        usual = self._usual
        rows = (rows - usual.mean) / usual.scale
        if not usual.constant:
            rows = rows / usual.kernel.length.clamp(NARROW, WIDE)
        return rows * sqrt(rows.shape[1] / RELEVANT)


def grades_after(arm: Arm, steps: Steps) -> Tensor:
    """(n,) the grades after steps, which are what their episodes gave up to there."""
    found, total = [], 0.0
    began = (arm.elapsed(steps.percept) <= 0).tolist()
    for first, reward in zip(began, steps.reward.tolist(), strict=True):
        total = reward if first else total + reward
        found.append(total)
    return torch.tensor(found, dtype=torch.float64)
