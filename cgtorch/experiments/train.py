"""Algorithm 1 over the four experiments: from a robot to a skill that has been tested."""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Generator

from cgtorch import ranks
from cgtorch.errors import CgtorchError, RunError
from cgtorch.evolution import EvolutionSettings, lexicase, tournament
from cgtorch.experiments.beginning import Working, beginning
from cgtorch.experiments.evaluate import Score, evaluate_skill, under_other_noise
from cgtorch.experiments.goal import AUTO
from cgtorch.experiments.journal import SECONDS, forget, journal_of
from cgtorch.experiments.ledger import Entry, enter, entry_of
from cgtorch.experiments.perception import networks_of
from cgtorch.experiments.progress import load_progress, save_progress
from cgtorch.experiments.run import Run, whole_folder
from cgtorch.experiments.settings import RunSettings
from cgtorch.experiments.stages import (
    PERIMETER,
    STAGES,
    check_stages,
    exercise,
    stage_generator,
    stages_up_to,
)
from cgtorch.experiments.storage import (
    load_result,
)
from cgtorch.files import write_json
from cgtorch.graphs import Skill
from cgtorch.improvement.events import (
    Event,
    EvolutionRecalled,
    GenerationDone,
    SkillAccepted,
    StageStarted,
    Watch,
)
from cgtorch.improvement.grow import grow
from cgtorch.improvement.improve import improve
from cgtorch.improvement.journal import Journal, NoJournal
from cgtorch.improvement.knowledge import learn, with_footprint
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.improvement.standing import Budget
from cgtorch.world import Scenarios, random_scenarios

FRESH, AROUND, FRESH_SEED = 40, 40, 7_000_001

METHODS = {"compose": improve, "paper": grow}


class NotImprovedError(CgtorchError, RuntimeError):
    """Within its budget a stage found no skill that meets eq. 1."""


@dataclass
class Tally:
    """What one stage cost, and the skill it accepted last."""

    generations: int = 0
    transitions: int = 0
    searching: float = 0.0  # s
    accepted: SkillAccepted[Scenarios] | None = None

    def count(self, event: Event) -> None:
        """Take note of what an event says."""
        if isinstance(event, GenerationDone):
            self.generations += 1
            self.transitions += event.generation.transitions
            self.searching += event.seconds
        elif isinstance(event, EvolutionRecalled):
            self.generations += event.generations
            self.transitions += event.transitions
            self.searching += event.seconds
        elif isinstance(event, SkillAccepted):
            self.accepted = event


def train(
    run: Run,
    stage: str,
    watch: Watch,
    working: Working,
    device: torch.device | str = "cpu",
    checkpoint_seconds: float = SECONDS,
) -> list[dict[str, Any]]:
    """Make all stages up to one, except those the run has already.

    Args:
        run: an open run.
        stage: the last stage to make.
        watch: told what happens.
        working: makes a context in which a long step runs under a message.
        device: where populations are evaluated.
        checkpoint_seconds: least time between two notes of where an evolution stands.

    Returns:
        The result of every stage, as in its result.json.

    Raises:
        NotImprovedError: a stage ended without a skill that meets eq. 1.
        RunError: a file cannot be written or read, or the run has gone on in rounds.
        SettingsError: no such stage, or the run is about scenarios that have none.
    """
    names = stages_up_to(stage)
    check_stages(run.settings.scenarios)
    if run.rounds and not set(names) <= set(run.stages):
        raise RunError(
            f"run {str(run.folder)!r} has gone on with --stage {AUTO} and can have no further "
            f"stage; go on with --stage {AUTO} or choose another --run-dir"
        )
    progress = beginning(run, watch, working)
    for name in names:
        if name in run.stages:
            progress = load_progress(run, run.folder / name)
            forget(run.folder, name)
        else:
            progress = _stage(
                run, name, names, progress, watch, working, device, checkpoint_seconds
            )
    ranks.wait()
    results = [load_result(run.folder / name / "result.json") for name in names]
    if ranks.first():
        write_json(run.folder / "summary.json", {"stages": results, **run.settings.to_dict()})
    return results


def _stage(
    run: Run,
    name: str,
    names: tuple[str, ...],
    progress: Progress[Scenarios],
    watch: Watch,
    working: Working,
    device: torch.device | str,
    checkpoint_seconds: float,
) -> Progress[Scenarios]:
    """Make one stage and keep it in the run."""
    generator = stage_generator(run.settings.seed, name)
    # The published protocol knows the five placements only.
    practice = run.settings.practice if run.settings.method == "compose" else 0
    task = exercise(name, progress.missed, practice, generator)
    sizes = (len(progress.solved), len(task.scenarios))
    watch(StageStarted(name, names, *sizes, run.settings.attempts))
    tally = Tally()

    def listen(event: Event) -> None:
        tally.count(event)
        watch(event)

    method = METHODS[run.settings.method]

    def draw(generator: Generator) -> Scenarios:
        return random_scenarios(STAGES[name], practice, generator)

    earlier, parent = len(progress.solved), progress.skill
    with journal_of(run.folder, name, watch, checkpoint_seconds) as journal:
        setup = make_setup(run, device, journal)
        progress = method(
            setup, progress, name, task.scenarios, task.targets, draw, generator, listen
        )
        if tally.accepted is not None:
            with working(f"testing {name} on fresh placements"):
                result = _result(run, name, tally.accepted, earlier, tally)
            with working(f"trying {name} under other noise"):
                entry = evidence(run, tally.accepted, parent, progress)
            keep_stage(run, name, progress, result, entry)
    if tally.accepted is None:
        raise not_improved(run, name)
    return progress


def keep_stage(
    run: Run, name: str, progress: Progress[Scenarios], result: dict[str, Any], entry: Entry | None
) -> None:
    """Write what a stage or round has come to, the first rank only."""
    if not ranks.first():
        return
    if entry is not None:
        enter(run.folder, entry)
    with whole_folder(run.folder / name) as folder:
        save_progress(folder, progress, run.settings.seed)
        write_json(folder / "result.json", result)


def evidence(
    run: Run, accepted: SkillAccepted[Scenarios], parent: Skill | None, after: Progress[Scenarios]
) -> Entry:
    """The ledger's entry of a skill that was just accepted; see `entry_of`."""
    again = under_other_noise(accepted.skill, run.world_of, after.solved, run.settings.seed)
    return entry_of(accepted, parent, after, (again.tried, again.successes))


def not_improved(run: Run, name: str) -> NotImprovedError:
    """The error of a stage that found nothing."""
    return NotImprovedError(
        f"stage {name} found no skill that keeps W and solves more within "
        f"{run.settings.attempts} attempts; raise --attempts, --generations or --population"
    )


def evolution_of(settings: RunSettings) -> EvolutionSettings:
    """How populations evolve: as published for the method of the paper, else the default way."""
    published = settings.method == "paper"
    return EvolutionSettings(
        population=settings.population,
        selection=tournament(settings.tournament) if published else lexicase,
        islands=settings.islands,
        migration=settings.migration,
    )


def make_setup(
    run: Run, device: torch.device | str = "cpu", journal: Journal | None = None
) -> Setup[Scenarios]:
    """The run's settings in the terms of improvement."""
    s, networks = run.settings, networks_of(run.settings)
    return Setup(
        actions=run.actions,
        world_of=run.world_of,
        imagine=with_footprint(torch.tensor(run.robot.description.footprint)),
        learn=learn,
        evolution=evolution_of(s),
        budget=Budget(generations=s.generations, stall=networks.stall),
        group_of=networks.group_of,
        group=networks.group,
        lanes=2 * networks.group,
        attempts=s.attempts,
        max_transitions=s.max_transitions,
        device=device,
        journal=journal or NoJournal(),
    )


def _result(
    run: Run, name: str, accepted: SkillAccepted[Scenarios], earlier: int, tally: Tally
) -> dict[str, Any]:
    """A stage's line of the final table; it began with W of `earlier`."""
    skill, succeeded = accepted.skill, accepted.succeeded
    seed = FRESH_SEED + run.settings.seed
    edge = STAGES[name]
    fresh = evaluate_skill(skill, run.world_of, edge, FRESH, seed)
    around = evaluate_skill(skill, run.world_of, PERIMETER, AROUND, seed)
    five = succeeded[accepted.targets][:5]
    return {
        "stage": name,
        "edge": edge,
        "targets_succeeded": int(five.sum()),
        "targets": len(five),
        "earlier_failures": int(accepted.targets.sum()) - len(five),
        "earlier_failures_succeeded": int(succeeded[accepted.targets].sum()) - int(five.sum()),
        "w_size": earlier,
        "w_lost": int((~succeeded[accepted.keep]).sum()),
        "nodes": skill.num_nodes,
        "depth": skill.depth,
        "generations": tally.generations,
        "transitions": tally.transitions,
        "seconds": round(accepted.seconds, 1),
        "search_seconds": round(tally.searching, 3),
        "fresh": counts(edge, fresh),
        "perimeter": counts(PERIMETER, around),
    }


def finished_generations(run: Run) -> int:
    """Generations of all finished stages."""
    return sum(load_result(run.folder / name / "result.json")["generations"] for name in run.stages)


def counts(placement: str, score: Score) -> dict[str, Any]:
    """A score as a result.json holds it."""
    return {"placement": placement, "tried": score.tried, "succeeded": score.successes}
