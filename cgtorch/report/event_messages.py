"""What events are called on the screen: one line each, without colour."""

from typing import Any

from cgtorch.improvement.events import (
    EvolutionRecalled,
    FreshTested,
    JournalDamaged,
    ModelsFitted,
    SkillAccepted,
    StageStarted,
    WorldTested,
)
from cgtorch.report.estimate import as_time, stage_number


def stage_started(event: StageStarted) -> str:
    """The line for a stage that begins."""
    number, count = stage_number(event)
    return (
        f"{event.stage}: stage {number} of {count}, "
        f"{event.size_w} scenarios to keep (W), {event.size_m} to solve"
    )


def journal_read(event: EvolutionRecalled | JournalDamaged) -> str:
    """The line for what a journal knew from before an interruption, or could not be read."""
    if isinstance(event, EvolutionRecalled):
        return f"{event.candidate}: {event.generations} generations are known from before"
    files = ", ".join(event.files)
    return f"{event.stage}: damaged, so what it held is done again: {files}"


def models_fitted(event: ModelsFitted) -> str:
    """The line for models that were trained."""
    return f"{event.stage}: {event.summary.text}, {event.seconds:.1f} s"


def world_tested(event: WorldTested) -> str:
    """The line for a candidate tried in the world."""
    text = (
        f"{event.candidate}: in the world W {event.solved_w}/{event.size_w}, "
        f"M {event.solved_m}/{event.size_m}"
    )
    if event.kept is not None and event.promised is not None:
        text += f"; of its group {event.promised} solved in the search, {event.kept} in the world"
    return text


def few_kept(solved: int, kept: int) -> str:
    """The line for scenarios of which the search has solved so many and the world has kept few."""
    return (
        f"of {solved} scenarios solved in the search, {kept} are solved in the world: Γ or C is "
        "wrong where the search goes; see 'When it does not learn' in docs/own-domain.md"
    )


def skill_accepted(event: SkillAccepted[Any]) -> str:
    """The line for a skill that was accepted."""
    w, targets = event.succeeded[event.keep], event.targets
    others = event.succeeded[~event.keep]
    nodes = f"{event.skill.num_nodes} node{'s' if event.skill.num_nodes != 1 else ''}"
    parts = [
        f"tests {int(event.succeeded[targets].sum())}/{int(targets.sum())}",
        f"W {int(w.sum())}/{len(w)}",
        f"M {int(others.sum())}/{len(others)}",
        f"{nodes} in {event.skill.depth} level{'s' if event.skill.depth != 1 else ''}",
        as_time(event.seconds),
    ]
    return f"{event.stage}: accepted; {', '.join(parts)}"


def fresh_tested(event: FreshTested) -> str:
    """The line for a skill tried on fresh scenarios."""
    share = event.succeeded / max(1, event.tried)
    kind = "to decide, " if event.decisive else ""
    mean = "" if event.mean_return is None else f", mean return {event.mean_return:.5g}"
    return (
        f"{event.stage}: {kind}{event.succeeded} of {event.tried} fresh scenarios = {share:.1%}"
        f"{mean}, the goal is {event.target:.4g}"
    )
