"""The autonomous loop: act, collect what succeeds and what fails, improve, until a goal is met.

Nobody tells the robot about edges or stages. A round improves the skill on what was missed so far
and tries it on fresh placements, around the paper's table or around any; what succeeds joins W,
what fails joins M.
"""

import time
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch
from torch import Generator

from cgtorch import ranks
from cgtorch.experiments.beginning import Working, beginning
from cgtorch.experiments.evaluate import Score
from cgtorch.experiments.goal import Goal, holds, worth_deciding
from cgtorch.experiments.journal import SECONDS, journal_of
from cgtorch.experiments.progress import load_progress
from cgtorch.experiments.run import Run
from cgtorch.experiments.stages import round_name, stage_generator
from cgtorch.experiments.storage import load_result
from cgtorch.experiments.train import (
    METHODS,
    Tally,
    counts,
    evidence,
    keep_stage,
    make_setup,
    not_improved,
)
from cgtorch.files import write_json
from cgtorch.graphs import Skill
from cgtorch.improvement.compose import specialists_of
from cgtorch.improvement.events import Event, FreshTested, StageStarted, Watch
from cgtorch.improvement.setup import Progress
from cgtorch.improvement.trial import try_skill
from cgtorch.world import Scenarios, concatenate_scenarios, draw_of

BATCH = 400  # placements tried before the next look at how many were missed
ENOUGH = 12  # missed placements to learn from; a specialist's group has as many


@dataclass(frozen=True)
class Tests:
    """How a round's skill did on fresh placements.

    Attributes:
        screening: on up to `Goal.screening` of them.
        decisive: on as many again as decide; None where that was not worth it.
    """

    screening: Score
    decisive: Score | None


def train_until(
    run: Run,
    goal: Goal,
    watch: Watch,
    working: Working,
    device: torch.device | str = "cpu",
    checkpoint_seconds: float = SECONDS,
) -> list[dict[str, Any]]:
    """Improve in rounds until the goal holds or what may be spent is spent.

    A run that has stages or rounds goes on from its last one. `goal.minutes` are those of this
    call, `goal.rounds` all the run's; a round that has begun is finished.

    Returns:
        The result of every stage and round, as in its result.json.

    Raises:
        NotImprovedError: a round ended and there is still no skill at all.
        RunError: a file cannot be written or read.
    """
    began = time.monotonic()
    progress = load_progress(run, run.folder / run.stages[-1]) if run.stages else None
    progress = progress or beginning(run, watch, working)
    results = [load_result(run.folder / name / "result.json") for name in run.stages]
    first, made = len(results) - len(run.rounds), len(run.rounds)
    while (
        not reached(goal, results[first:])
        and made < goal.rounds
        and ranks.agreed(time.monotonic() - began < 60 * goal.minutes)
    ):
        made += 1
        decisions = len(_decisions(results[first:]))
        progress, result = _round(
            run, goal, made, decisions, progress, watch, working, device, checkpoint_seconds
        )
        results.append(result)
    summary = {"stages": results, "reached": reached(goal, results[first:])}
    if ranks.first():
        write_json(run.folder / "summary.json", {**summary, **vars(goal), **run.settings.to_dict()})
    return results


def reached(goal: Goal, rounds: list[dict[str, Any]]) -> bool:
    """Whether the last round's skill meets the goal, given the results of all rounds."""
    last = _decisions(rounds[-1:])
    return bool(last) and holds(goal, *last[0], decision=len(_decisions(rounds)))


def _decisions(rounds: list[dict[str, Any]]) -> list[tuple[int, int]]:
    """How many placements succeeded and how many were tried in each decisive test."""
    tests = [r.get("decisive") for r in rounds]
    return [(t["succeeded"], t["tried"]) for t in tests if t is not None]


def _round(
    run: Run,
    goal: Goal,
    number: int,
    decisions: int,
    progress: Progress[Scenarios],
    watch: Watch,
    working: Working,
    device: torch.device | str,
    checkpoint_seconds: float,
) -> tuple[Progress[Scenarios], dict[str, Any]]:
    """Make one round and keep it in the run; `decisions` were made before."""
    name = round_name(number)
    generator = stage_generator(run.settings.seed, name)
    if not len(progress.missed):  # as at the very beginning
        first = act(run, progress.skill, goal.screening, generator)
        progress = _joined(progress, first)
    missed, earlier, parent = progress.missed, len(progress.solved), progress.skill
    names = tuple(map(round_name, range(1, number + 1)))
    watch(StageStarted(name, names, earlier, len(missed), run.settings.attempts))
    tally, began = Tally(), time.perf_counter()

    def listen(event: Event) -> None:
        tally.count(event)
        watch(event)

    if parent is not None:
        progress = replace(progress, members=specialists_of(parent))
    everything = torch.ones(len(missed), dtype=torch.bool)
    method, placement = METHODS[run.settings.method], run.settings.scenarios
    nothing = partial(draw_of(placement), 0)  # fresh placements are drawn at the round's end
    with journal_of(run.folder, name, watch, checkpoint_seconds) as journal:
        setup = make_setup(run, device, journal)
        progress = method(setup, progress, name, missed, everything, nothing, generator, listen)
        seconds = time.perf_counter() - began
        skill = progress.skill
        if skill is not None:
            with working(f"testing {name} on fresh placements"):
                progress, tests = _tested(run, goal, name, decisions, progress, generator, watch)
            entry = None
            if tally.accepted is not None:
                with working(f"trying {name} under other noise"):
                    entry = evidence(run, tally.accepted, parent, progress)
            result = _result(name, placement, skill, tally, tests, earlier, len(missed), seconds)
            keep_stage(run, name, progress, result, entry)
    if skill is None:
        raise not_improved(run, name)
    return progress, result


def _tested(
    run: Run,
    goal: Goal,
    name: str,
    decisions: int,
    progress: Progress[Scenarios],
    generator: Generator,
    watch: Watch,
) -> tuple[Progress[Scenarios], Tests]:
    """Try a round's skill on fresh placements, all of which join W or M."""
    screening = act(run, progress.skill, goal.screening, generator)
    counted = screening.successes, screening.tried
    watch(FreshTested(name, *counted, goal.target, decisive=False))
    progress = _joined(progress, screening)
    if not worth_deciding(goal, *counted):
        return progress, Tests(screening, None)
    tried = goal.decisive
    most = next(m for m in range(tried + 1) if not holds(goal, tried - m, tried, decisions + 1))
    decisive = act(run, progress.skill, tried, generator, enough=most)
    watch(FreshTested(name, decisive.successes, decisive.tried, goal.target, decisive=True))
    return _joined(progress, decisive), Tests(screening, decisive)


def act(
    run: Run, skill: Skill | None, most: int, generator: Generator, enough: int = ENOUGH
) -> Score:
    """Try a skill on fresh placements, batch by batch, until `enough` were missed.

    Args:
        run: whose world.
        skill: what to try; without one everything is missed.
        most: placements at most.
        generator: of the placements.
        enough: missed placements after which no batch is tried any more.
    """
    draw, parts = draw_of(run.settings.scenarios), list[Score]()
    while (tried := sum(p.tried for p in parts)) < most and (
        sum(p.tried - p.successes for p in parts) < enough
    ):
        fresh = draw(min(BATCH, most - tried), generator)
        if skill is None:
            nobody = torch.zeros(len(fresh), dtype=torch.bool)
            parts.append(Score(fresh, nobody, nobody.long()))
        else:
            trial = try_skill(skill, run.world_of(fresh))
            parts.append(Score(fresh, trial.succeeded, trial.transitions))
    return Score(
        concatenate_scenarios([p.scenarios for p in parts]),
        torch.cat([p.succeeded for p in parts]),
        torch.cat([p.transitions for p in parts]),
    )


def _joined(progress: Progress[Scenarios], score: Score) -> Progress[Scenarios]:
    """W and M with what succeeded and what failed."""
    solved, missed = (
        score.scenarios[rows.nonzero()[:, 0]] for rows in (score.succeeded, ~score.succeeded)
    )
    return replace(
        progress,
        solved=concatenate_scenarios([progress.solved, solved]),
        missed=concatenate_scenarios([progress.missed, missed]),
    )


def _result(
    name: str,
    placement: str,
    skill: Skill,
    tally: Tally,
    tests: Tests,
    earlier: int,
    missed: int,
    seconds: float,
) -> dict[str, Any]:
    """A round's line of the final table; it began with W of `earlier` and M of `missed`."""
    accepted = tally.accepted
    won = 0 if accepted is None else int(accepted.succeeded[~accepted.keep].sum())
    lost = 0 if accepted is None else int((~accepted.succeeded[accepted.keep]).sum())
    decisive = tests.decisive
    return {
        "stage": name,
        "edge": placement,
        "skill": skill.name,
        "targets_succeeded": won,
        "targets": missed,
        "earlier_failures": 0,
        "earlier_failures_succeeded": 0,
        "w_size": earlier,
        "w_lost": lost,
        "nodes": skill.num_nodes,
        "depth": skill.depth,
        "generations": tally.generations,
        "transitions": tally.transitions,
        "seconds": round(seconds, 1),
        "search_seconds": round(tally.searching, 3),
        "fresh": counts(placement, tests.screening),
        "perimeter": counts(placement, decisive or tests.screening),
        "decisive": None if decisive is None else counts(placement, decisive),
    }
