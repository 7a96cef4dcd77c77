"""What happens during improvement, for whoever watches: display, TensorBoard, ledger."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeAlias

from torch import Tensor

from cgtorch.evolution import Generation, Population
from cgtorch.graphs import Skill
from cgtorch.improvement.interfaces import S
from cgtorch.improvement.model_summary import ModelSummary


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
class ModelsFitted(Event):
    """Γ and C were trained, in `seconds`."""

    stage: str
    summary: ModelSummary
    seconds: float


@dataclass(frozen=True)
class GenerationDone(Event):
    """A generation was evaluated in the models.

    It belongs to the evolution of `candidate`, which ends after `limit` generations at the latest.
    `solved_w` and `solved_m` are what the best individual solves of the scenarios it is evolved
    on, `size_w` and `size_m` how many these are; `seconds` is what the generation took.
    """

    stage: str
    candidate: str
    generation: Generation
    limit: int
    solved_w: int
    size_w: int
    solved_m: int
    size_m: int
    seconds: float


@dataclass(frozen=True)
class EvolutionRecalled(Event):
    """The first `generations` of an evolution are known from before an interruption.

    They executed `transitions` actions in the models and took `seconds`; `champion` is the best
    individual of them, as a population of one, and `best` its fitness.
    """

    stage: str
    candidate: str
    generations: int
    transitions: int
    seconds: float
    champion: Population
    best: float


@dataclass(frozen=True)
class AboutToKeep(Event):
    """What has been told so far is about to be kept, so that it will not be told again."""


@dataclass(frozen=True)
class JournalDamaged(Event):
    """Files of a stage's journal cannot be read; what they held is done again."""

    stage: str
    files: tuple[str, ...]


@dataclass(frozen=True)
class WorldTested(Event):
    """A candidate was tried in the world: what it solves of W and of M.

    Of the group it was evolved on, it solved `promised` in the models and `kept` in the world.
    """

    stage: str
    candidate: str
    solved_w: int
    size_w: int
    solved_m: int
    size_m: int
    kept: int | None = None
    promised: int | None = None


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
