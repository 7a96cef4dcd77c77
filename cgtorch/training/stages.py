"""What stages and rounds are about, and where their random numbers come from."""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch.domains.domain import Domain
from cgtorch.ground.errors import RunError, SettingsError
from cgtorch.improvement.interfaces import Draw
from cgtorch.runs.run import AUTO, Run

_SEED_STRIDE = 1_000_003
_AUTO_SEEDS = 500_000  # far from seeds that one would evaluate with


@dataclass(frozen=True)
class Exercise:
    """What a stage is to solve.

    Attributes:
        scenarios: the stage's tests, then what failed before, then practice.
        targets: (B,) bool, the tests and what failed before.
        tests: how many of these are the stage's own tests, which come first.
        draw: draws fresh scenarios that an accepted skill is tested on.
    """

    scenarios: Any
    targets: Tensor
    tests: int
    draw: Draw[Any]


def stages_up_to(domain: Domain[Any], stage: str) -> tuple[str, ...]:
    """All stages that lead to one, itself included; SettingsError if it is unknown."""
    names = tuple(domain.stages)
    if stage not in names:
        raise SettingsError(f"unknown stage {stage!r}; use one of {', '.join((*names, AUTO))}")
    return names[: names.index(stage) + 1]


def check_stages(run: Run) -> None:
    """SettingsError unless a run's scenarios are those that the domain's stages are about."""
    if run.kind != run.domain.usual_kind:
        first, last = (list(run.domain.stages)[i] for i in (0, -1))
        raise SettingsError(
            f"stages {first} to {last} are about {run.domain.usual_kind} scenarios, not "
            f"{run.kind}; use --stage {AUTO}"
        )


def stages_to_make(run: Run, stage: str) -> tuple[str, ...]:
    """All stages up to one, of a run that has them or can still make them.

    Raises:
        SettingsError: no such stage, or the run is about scenarios that have none.
        RunError: the run has gone on in rounds.
    """
    names = stages_up_to(run.domain, stage)
    check_stages(run)
    if run.rounds and not set(names) <= set(run.stages):
        raise RunError(
            f"run {str(run.folder)!r} has gone on with --stage {AUTO} and can have no further "
            f"stage; go on with --stage {AUTO} or choose another --run-dir"
        )
    return names


def stage_generator(domain: Domain[Any], seed: int, stage: str) -> Generator:
    """The randomness of one stage or round; it does not depend on how those before it went."""
    if stage in domain.stages:
        offset = list(domain.stages).index(stage) + 1
    else:
        offset = _AUTO_SEEDS + int(stage.removeprefix(f"{AUTO}-"))
    return Generator().manual_seed(seed * _SEED_STRIDE + offset)


def exercise(run: Run, stage: str, missed: Any, practice: int, generator: Generator) -> Exercise:
    """The scenarios of a stage: its tests, earlier failures, random practice."""
    kind, domain = run.domain.stages[stage], run.domain

    def draw(generator: Generator) -> Any:
        return domain.draw(kind, practice, generator)

    tests = domain.tests(kind)
    scenarios = tests.joined(missed, draw(generator))
    targets = torch.arange(len(scenarios)) < len(tests) + len(missed)
    return Exercise(scenarios, targets, len(tests), draw)
