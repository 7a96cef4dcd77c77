"""The stages and rounds of a run, and their random numbers."""

from typing import Any

from torch import Generator

from cgtorch.domains.domain import Domain
from cgtorch.ground.errors import RunError, SettingsError
from cgtorch.runs.stored_run import AUTO, StoredRun

_SEED_STRIDE = 1_000_003
_AUTO_SEEDS = 500_000  # far from seeds that one would evaluate with


def stages_to_make(run: StoredRun, stage: str) -> tuple[str, ...]:
    """All stages up to `stage`, which the run must have or still be able to make.

    SettingsError if there is no such stage, RunError if the run has continued in rounds.
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
    """The generator of one stage or round; it does not depend on the results of earlier ones."""
    if stage in domain.stages:
        offset = list(domain.stages).index(stage) + 1
    else:
        offset = _AUTO_SEEDS + int(stage.removeprefix(f"{AUTO}-"))
    return Generator().manual_seed(seed * _SEED_STRIDE + offset)
