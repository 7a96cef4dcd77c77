"""The four experiments of section VI, S0 to S3, and the rounds that go on without them."""

from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from cgtorch.errors import SettingsError
from cgtorch.experiments.goal import AUTO
from cgtorch.world import Scenarios, concatenate_scenarios, random_scenarios, stage_scenarios

STAGES = {"S0": "near", "S1": "left", "S2": "right", "S3": "far"}
"""Each stage and the edge of the table it is about."""

PERIMETER = "perimeter"
"""The scenarios that all stages together are about."""

_SEED_STRIDE = 1_000_003
_AUTO_SEEDS = 500_000  # far from seeds that one would evaluate with


@dataclass(frozen=True)
class Exercise:
    """What a stage is to solve.

    Attributes:
        scenarios: the five test placements, then what failed before, then practice.
        targets: (B,) bool, the five and what failed before.
    """

    scenarios: Scenarios
    targets: Tensor


def stages_up_to(stage: str) -> tuple[str, ...]:
    """All stages that lead to one, itself included; SettingsError if it is unknown."""
    if stage not in STAGES:
        raise SettingsError(f"unknown stage {stage!r}; use one of {', '.join((*STAGES, AUTO))}")
    names = tuple(STAGES)
    return names[: names.index(stage) + 1]


def check_stages(scenarios: str) -> None:
    """SettingsError unless a run's `scenarios` are those that the stages are about."""
    if scenarios != PERIMETER:
        raise SettingsError(
            f"stages S0 to S3 are about the paper's table, not {scenarios} scenarios; use "
            f"--stage {AUTO}"
        )


def round_name(number: int) -> str:
    """The name of a round, from 1, and of the skill it makes."""
    return f"{AUTO}-{number}"


def stage_generator(seed: int, stage: str) -> Generator:
    """The randomness of one stage or round; it does not depend on how those before it went."""
    if stage in STAGES:
        offset = list(STAGES).index(stage) + 1
    else:
        offset = _AUTO_SEEDS + int(stage.removeprefix(f"{AUTO}-"))
    return Generator().manual_seed(seed * _SEED_STRIDE + offset)


def exercise(stage: str, missed: Scenarios, practice: int, generator: Generator) -> Exercise:
    """The scenarios of a stage: its five placements, earlier failures, random practice."""
    edge = STAGES[stage]
    parts = [stage_scenarios(edge), missed, random_scenarios(edge, practice, generator)]
    scenarios = concatenate_scenarios(parts)
    return Exercise(scenarios, torch.arange(len(scenarios)) < len(parts[0]) + len(missed))
