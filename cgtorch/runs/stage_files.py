"""Where a run stands after a stage, as files: all that the next one needs."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from cgtorch.graphs import load_skill, save_skill
from cgtorch.improvement.setup import Progress
from cgtorch.runs.run import Run
from cgtorch.runs.storage import (
    load_knowledge,
    load_population,
    load_scenarios,
    save_knowledge,
    save_population,
    save_scenarios,
)


def save_progress(folder: Path, progress: Progress[Any], seed: int) -> None:
    """Write all that the next stage needs into a folder."""
    if progress.skill is not None:
        save_skill(folder / "skill.json", progress.skill)
    save_scenarios(folder / "scenarios.json", {"W": progress.solved, "M": progress.missed})
    if progress.knowledge is not None:
        save_knowledge(folder, progress.knowledge, {"seed": str(seed)})
    if progress.specialists is not None:
        save_population(folder / "specialists.safetensors", progress.specialists)


def load_progress(run: Run, folder: Path) -> Progress[Any]:
    """Read what `save_progress` wrote."""
    solved, missed = load_scenarios(folder / "scenarios.json", ("W", "M"), run.like())
    knowledge = load_knowledge(folder, run.domain.unfitted()) if run.learns else None
    progress = Progress(None, solved, missed, knowledge)
    if (folder / "skill.json").is_file():
        progress = replace(progress, skill=load_skill(folder / "skill.json", run.actions))
    if (folder / "specialists.safetensors").is_file():
        population = load_population(folder / "specialists.safetensors", run.actions)
        progress = replace(progress, specialists=population)
    return progress
