"""Events of a training, for observers: the log, the display, TensorBoard."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeAlias, TypeVar

from torch import Tensor

from cgtorch.evolution import Generation
from cgtorch.graphs import Skill
from cgtorch.ground.asked import Asked
from cgtorch.ground.environment import ScenarioBatch
from cgtorch.improvement.checkpoint import Found

S = TypeVar("S", bound=ScenarioBatch)
"""The scenarios of a world."""


class Event:
    """An event of improvement."""


@dataclass(frozen=True)
class StageStarted(Event):
    """A stage begins, with `size_w` scenarios in W and `size_m` to solve.

    `stages` are all stages of the run, in order; `attempts` is the maximum number of candidates per
    stage.
    """

    stage: str
    stages: tuple[str, ...]
    size_w: int
    size_m: int
    attempts: int


@dataclass(frozen=True)
class ModelSummary:
    """A summary of Γ and C for observers.

    Attributes:
        text: One line for a display.
        scalars: Numbers by their TensorBoard tag.
        reports: The reports of the fits, "gamma" and "classifier" (`cgtorch.domains.reports`).
        first: Whether these are the first models of a run.
    """

    text: str
    scalars: Mapping[str, float] = field(default_factory=dict)
    reports: Mapping[str, Any] = field(default_factory=dict)
    first: bool = False


@dataclass(frozen=True)
class ModelsFitted(Event):
    """Γ and C were trained, in `seconds`."""

    stage: str
    summary: ModelSummary
    seconds: float


@dataclass(frozen=True)
class CandidateTested(Event):
    """A candidate solves `solved_w` of `size_w` scenarios of W, and `solved_m` of `size_m` of M."""

    stage: str
    candidate: str
    solved_w: int
    size_w: int
    solved_m: int
    size_m: int


@dataclass(frozen=True)
class GenerationDone(CandidateTested):
    """A generation was evaluated in the models, on the scenarios on which `candidate` evolves.

    The counts are those of its best individual. It took `seconds`; there are at most `limit`
    generations.
    """

    generation: Generation
    limit: int
    seconds: float


@dataclass(frozen=True)
class EvolutionRecalled(Event):
    """The result `found` of an evolution was read from the journal of an interrupted run."""

    stage: str
    candidate: str
    found: Found


@dataclass(frozen=True)
class AboutToKeep(Event):
    """The events so far are about to be stored, and will not be repeated after an interruption."""


@dataclass(frozen=True)
class JournalDamaged(Event):
    """Files of a stage's journal cannot be read; their work is repeated."""

    stage: str
    files: tuple[str, ...]


@dataclass(frozen=True)
class WorldTested(CandidateTested):
    """A candidate was tried in the world."""


@dataclass(frozen=True)
class WorldAsked(Event):
    """A `phase` of a stage asked something of the world; `succeeded` of its episodes did.

    `recalled` is whether this was asked before an interruption.
    """

    stage: str
    phase: str
    asked: Asked
    succeeded: int = 0
    recalled: bool = False


@dataclass(frozen=True)
class Practised(Event):
    """`skill` has solved `in_a_row` fresh scenarios, of the `wanted` after which a stage ends."""

    stage: str
    skill: Skill
    in_a_row: int
    wanted: int


@dataclass(frozen=True)
class MeanTested(Event):
    """What `skill`, the best of a search, is worth on scenarios that it was not chosen on.

    `mean` is that of `tried` returns, or of successes as 0 and 1, and `error` its standard error;
    None if an episode did not finish, or nothing is known yet. `new` is whether the skill has just
    won a race. The next generation has `scenarios`; the search has played `episodes` so far.
    """

    stage: str
    skill: Skill
    new: bool
    mean: float | None
    error: float | None
    tried: int
    scenarios: int
    episodes: int


@dataclass(frozen=True)
class EpisodePlayed(Event):
    """An episode in the world, from which models with rewards have learned.

    It was played in a `phase` (`cgtorch.improvement.imagined_state.PHASES`), and `returned` is what
    it gave, None if it was not finished. It had `steps`, and all episodes so far had `total`.
    """

    stage: str
    phase: str
    returned: float | None
    steps: int
    total: int


@dataclass(frozen=True)
class ChanceFound(Event):
    """Of `tried` scenarios that a skill has solved, it solves `succeeded` under other noise.

    So few are chance: what was solved once is no fact, and the run judges by means from now on
    (`cgtorch.improvement.expected`).
    """

    stage: str
    succeeded: int
    tried: int


@dataclass(frozen=True)
class SkillAccepted(Event, Generic[S]):
    """A new skill meets eq. 1 in the world.

    `succeeded` (B,) is its result on each of `scenarios`; `keep` (B,) bool marks those of W,
    `targets` (B,) bool the stage's test scenarios. `other_noise` is how much of what it had solved
    it solved under other noise, and how much that was; None if it was not tried. `parent` is the
    name of the skill that it improves, None for the first.
    """

    stage: str
    skill: Skill
    scenarios: S
    succeeded: Tensor
    keep: Tensor
    targets: Tensor
    seconds: float
    other_noise: tuple[int, int] | None = None
    parent: str | None = None


@dataclass(frozen=True)
class FreshTested(Event):
    """`skill` was tried at a round's end on fresh scenarios: it solved `succeeded` of `tried`.

    It is the round's own skill, or the earlier one if none was accepted. `target` is the share to
    reach, or the mean return if the domain gives rewards. `decisive` is whether this is the final
    test, which decides whether the target is met. `error` is the standard error of the mean return.
    """

    stage: str
    skill: str
    succeeded: int
    tried: int
    target: float
    decisive: bool
    mean_return: float | None = None
    error: float | None = None


@dataclass(frozen=True)
class StageFinished(Event):
    """A stage or round is stored, with this `result`: the row of the log."""

    stage: str
    result: Mapping[str, Any]


@dataclass(frozen=True)
class StageFailed(Event):
    """A stage found no skill in its `attempts`. Others follow, and it comes back after them."""

    stage: str
    attempts: int


@dataclass(frozen=True)
class TrainingEnded(Event):
    """A training ended after what was asked for: up to `stage`, or "auto" with a goal.

    `reached` is whether the goal was reached, None without one.
    """

    stage: str
    reached: bool | None = None
    target: float | None = None
    minutes: float | None = None
    rounds: int | None = None


Watch: TypeAlias = Callable[[Event], None]


def solved_of(succeeded: Tensor, keep: Tensor) -> tuple[int, int, int, int]:
    """The number of W solved and its size, and the same of M, from `succeeded` and `keep` (B,)."""
    w, m = succeeded[keep], succeeded[~keep]
    return int(w.sum()), len(w), int(m.sum()), len(m)
