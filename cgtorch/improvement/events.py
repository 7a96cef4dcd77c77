"""What happens during improvement, for whoever watches: display, TensorBoard, ledger."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeAlias

from torch import Tensor

from cgtorch.evolution import Generation
from cgtorch.graphs import Skill
from cgtorch.improvement.interfaces import S
from cgtorch.improvement.stopping import Found
from cgtorch.svm import LearningCurve


class Event:
    """Something that happens during improvement."""


@dataclass(frozen=True)
class StageStarted(Event):
    """A stage begins: so many scenarios in W, so many to be solved anew.

    `stages` are all stages of this run, in order; `attempts` bounds the evolutions in each.
    """

    stage: str
    stages: tuple[str, ...]
    size_w: int
    size_m: int
    attempts: int


@dataclass(frozen=True)
class ModelSummary:
    """What watchers are told of Γ and C.

    Attributes:
        text: one line for a display.
        scalars: numbers by their tag in TensorBoard.
        curves: learning curves by the name of the model.
        reliability: mean probability, frequency of success and rows of bins of C's probability.
        first: whether these are the first models of a run.
    """

    text: str
    scalars: Mapping[str, float] = field(default_factory=dict)
    curves: Mapping[str, LearningCurve | None] = field(default_factory=dict)
    reliability: tuple[tuple[float, float, int], ...] = ()
    first: bool = False


@dataclass(frozen=True)
class ModelsFitted(Event):
    """Γ and C were trained, in `seconds`."""

    stage: str
    summary: ModelSummary
    seconds: float


@dataclass(frozen=True)
class CandidateTested(Event):
    """A candidate solves `solved_w` of the `size_w` scenarios of W, and the same of M."""

    stage: str
    candidate: str
    solved_w: int
    size_w: int
    solved_m: int
    size_m: int


@dataclass(frozen=True)
class GenerationDone(CandidateTested):
    """A generation was evaluated in the models, on the scenarios that `candidate` is evolved on.

    The counts are its best individual's. It took `seconds`; there are `limit` generations at most.
    """

    generation: Generation
    limit: int
    seconds: float


@dataclass(frozen=True)
class EvolutionRecalled(Event):
    """What an evolution has `found` is known from before an interruption."""

    stage: str
    candidate: str
    found: Found


@dataclass(frozen=True)
class AboutToKeep(Event):
    """What has been told so far is about to be kept, so that it will not be told again."""


@dataclass(frozen=True)
class JournalDamaged(Event):
    """Files of a stage's journal cannot be read; what they held is done again."""

    stage: str
    files: tuple[str, ...]


@dataclass(frozen=True)
class WorldTested(CandidateTested):
    """A candidate solves `kept` of its group in the world, and `predicted` of it in the models."""

    kept: int | None = None
    predicted: int | None = None


@dataclass(frozen=True)
class SkillAccepted(Event, Generic[S]):
    """Eq. 1 holds in the world for a new skill.

    `succeeded` (B,) is its result on each of `scenarios`; `keep` (B,) bool marks those that are W,
    `targets` (B,) bool the test placements of the stage.
    """

    stage: str
    skill: Skill
    scenarios: S
    succeeded: Tensor
    keep: Tensor
    targets: Tensor
    seconds: float


@dataclass(frozen=True)
class FreshTested(Event):
    """A round's skill was tried on fresh placements: it solved `succeeded` of `tried`.

    `target` is the share that is aimed at, `decisive` whether this is the test that says if it
    holds. Where the domain gives rewards, the target is one of the mean return.
    """

    stage: str
    succeeded: int
    tried: int
    target: float
    decisive: bool
    mean_return: float | None = None


Watch: TypeAlias = Callable[[Event], None]


def solved_of(succeeded: Tensor, keep: Tensor) -> tuple[int, int, int, int]:
    """What `succeeded` (B,) of W, the scenarios to `keep` (B,), and how many these are; of M."""
    w, m = succeeded[keep], succeeded[~keep]
    return int(w.sum()), len(w), int(m.sum()), len(m)
