"""Where a run stands after a stage, as files: all that the next one needs."""

from dataclasses import replace
from pathlib import Path

from cgtorch.experiments.run import Run
from cgtorch.experiments.storage import (
    load_knowledge,
    load_population,
    load_scenarios,
    save_knowledge,
    save_population,
    save_scenarios,
)
from cgtorch.graphs import load_skill, save_skill
from cgtorch.improvement.setup import Progress
from cgtorch.world import Scenarios


def save_progress(folder: Path, progress: Progress[Scenarios], seed: int) -> None:
    """Write all that the next stage needs into a folder."""
    if progress.skill is not None:
        save_skill(folder / "skill.json", progress.skill)
    save_scenarios(folder / "scenarios.json", {"W": progress.solved, "M": progress.missed})
    save_knowledge(folder, progress.knowledge, {"seed": str(seed)})
    if progress.specialists is not None:
        save_population(folder / "specialists.safetensors", progress.specialists)


def load_progress(run: Run, folder: Path) -> Progress[Scenarios]:
    """Read what `save_progress` wrote."""
    solved, missed = load_scenarios(folder / "scenarios.json", ("W", "M"))
    progress = Progress(None, solved, missed, load_knowledge(folder))
    if (folder / "skill.json").is_file():
        progress = replace(progress, skill=load_skill(folder / "skill.json", run.actions))
    if (folder / "specialists.safetensors").is_file():
        population = load_population(folder / "specialists.safetensors", run.actions)
        progress = replace(progress, specialists=population)
    return progress
