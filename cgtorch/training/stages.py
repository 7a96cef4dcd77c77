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
    """What a stage is to solve: so many tests of its own, then what failed before, then practice.

    `targets` (B,) bool are all but practice; `draw` gives fresh scenarios to test accepted skills.
    """

    scenarios: Any
    targets: Tensor
    tests: int
    draw: Draw[Any]


def stages_to_make(run: Run, stage: str) -> tuple[str, ...]:
    """All stages up to one, of a run that has them or can still make them.

    SettingsError if its scenarios have no such stage, RunError if it has gone on in rounds.
    """
    every, usual = tuple(run.domain.stages), run.domain.usual_kind
    if stage not in every:
        raise SettingsError(f"unknown stage {stage!r}; use one of {', '.join((*every, AUTO))}")
    if run.kind != usual:
        raise SettingsError(
            f"stages {every[0]} to {every[-1]} use {usual} scenarios, not {run.kind}; use "
            f"--stage {AUTO}"
        )
    names = every[: every.index(stage) + 1]
    if run.rounds and not set(names) <= set(run.stages):
        raise RunError(
            f"run {str(run.folder)!r} has continued with --stage {AUTO} and cannot make a single "
            f"stage any more; continue with --stage {AUTO} or choose another --run-dir"
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
