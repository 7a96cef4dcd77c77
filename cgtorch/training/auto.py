"""The automatic loop: try the skill, collect successes and failures, improve, until a goal is met.

There are no stages. A round improves the skill on the scenarios missed so far and tries it on fresh
scenarios. Successes join W, failures join M. A skill is tested many times, and one of many tests
would succeed by chance. So the goal is decided on scenarios that are drawn for nothing else, and
each further decision requires more confidence.
"""

import time
from dataclasses import replace
from math import isfinite, sqrt
from statistics import NormalDist, fmean, stdev
from typing import Any

import torch
from torch import Generator

from cgtorch.domains.domain import Domain, rewarded
from cgtorch.evolution.search import derived_generator
from cgtorch.graphs import Skill
from cgtorch.ground.asked import Purse
from cgtorch.ground.statistics import wilson
from cgtorch.improvement.events import FreshTested, StageStarted, TrainingEnded
from cgtorch.improvement.setup import Progress
from cgtorch.improvement.trial import first_percepts
from cgtorch.runs.settings import Goal
from cgtorch.runs.storage import load_progress
from cgtorch.runs.stored_run import AUTO, StoredRun, round_name
from cgtorch.training.context import Training
from cgtorch.training.evaluate import Score, joined, try_on
from cgtorch.training.start import initial_progress, recall_spent, spent_of
from cgtorch.training.tally import Tally
from cgtorch.training.train import (
    Made,
    NotImprovedError,
    counts,
    make_stage,
    stage_generator,
)
from cgtorch.training.wear import Beginning

TESTS = 41  # the generator of tests, derived like an island's
BATCH = 400  # scenarios tried before the next look at how many were missed
DOUBT = 0.05
"""The probability of error of all two-sided intervals of one run together."""
SLACK = 0.25  # of `Goal.fine`, by which the bound of the interval may be below the target
EPISODES, DECISIVE_EPISODES = 100, 200
"""The least number of episodes of the screening test and of the decisive test of a mean."""
MOST_EPISODES, SHARE = 2**14, 10
"""The largest, and the share of those of the search (one in so many) that they are otherwise."""
TESTING = 5.0  # s after the end of the time in which tests may go on
ENOUGH = 12  # missed scenarios to learn from; a specialist's group has as many


def train_until(training: Training, goal: Goal) -> list[dict[str, Any]]:
    """Improve in rounds until the goal is reached or its limits are.

    A run with stages or rounds continues from its last one. `goal.minutes` limits this call,
    `goal.rounds` the whole run; a round that the time ends has the best skill so far. Returned are
    the results of all stages and rounds.

    Raises:
        NotImprovedError: A round ended, and there is still no skill.
        RunError: A file cannot be written or read.
    """
    run, began = training.run, time.monotonic()
    recall_spent(training)
    last = run.folder / run.stages[-1] if run.stages else None
    progress = load_progress(run, last) if last else initial_progress(training)
    training.purse.until = began + 60 * goal.minutes  # first data are worth nothing by halves
    results = run.results
    first, made = len(results) - len(run.rounds), len(run.rounds)
    beginning = Beginning.of(run.domain, run.kind)
    while not reached(goal, results[first:]) and made < goal.rounds and not training.purse.late():
        made += 1
        decisions = len(_decisions(results[first:]))
        try:
            progress, result = _round(training, goal, made, decisions, progress, beginning)
        except NotImprovedError:
            if not training.purse.exhausted:
                raise
            break
        results.append(result)
        if training.purse.exhausted:
            break
    training.log(TrainingEnded(AUTO, reached(goal, results[first:]), **vars(goal)))
    return results


def reached(goal: Goal, rounds: list[dict[str, Any]]) -> bool:
    """Whether the last round's skill reaches the goal, given the results of all rounds.

    Where the world does not repeat itself there is no test but practice: the skill has solved
    enough fresh scenarios in a row. Without practice, nothing is known.
    """
    if rounds and rounds[-1].get("fresh") is None:
        practice = rounds[-1].get("practice")
        return bool(practice and (rounds[-1].get("in_a_row") or 0) >= practice)
    last = _decisions(rounds[-1:])
    if not last:
        return False
    if rounds[-1].get("mean_holds") is not None:
        return bool(rounds[-1]["mean_holds"])
    return holds(goal, *last[0], decision=len(_decisions(rounds)))


def _decisions(rounds: list[dict[str, Any]]) -> list[tuple[int, int]]:
    """Successes and trials of each decisive test."""
    tests = [r.get("decisive") for r in rounds]
    return [(t["succeeded"], t["tried"]) for t in tests if t is not None]


def _round(
    training: Training,
    goal: Goal,
    number: int,
    decisions: int,
    progress: Progress[Any],
    beginning: Beginning,
) -> Made:
    """Make one round and store it in the run, after `decisions` decisive tests.

    WorldError if the `beginning` of an episode is not as before the first round.
    """
    run, name = training.run, round_name(number)
    missed, names = progress.missed, tuple(map(round_name, range(1, number + 1)))
    sizes = len(progress.solved), len(missed)
    training.told(StageStarted(name, names, *sizes, training.attempts))

    def test(after: Progress[Any], tally: Tally) -> Made | None:
        beginning.check(run.domain)
        skill = after.skill
        if skill is None:
            return None
        accepted, scores, met = tally.accepted, list[Score](), False
        by_mean = rewarded(run.domain) or training.by_mean(after)
        if run.repeats:
            with training.working(f"testing {skill.name} on fresh scenarios"):
                about = training, goal, name, decisions
                if by_mean:
                    scores, met = _mean_tested(*about, skill, tally.episodes)
                else:
                    after, scores, met = _tested(*about, after, _tests_generator(run, name))
        tests = [counts(run.kind, score) for score in scores]
        won = 0 if accepted is None else int(accepted.succeeded[accepted.targets].sum())
        return after, {
            "stage": name,
            "scenarios": run.kind,
            "targets_succeeded": won,
            "targets": len(missed),
            "earlier_failures": 0,
            "earlier_failures_succeeded": 0,
            **tally.result(progress, skill, tally.seconds, spent_of(training.purse)),
            "fresh": tests[0] if tests else None,
            "overall": tests[-1] if tests else None,
            "decisive": tests[1] if len(tests) > 1 else None,
            "mean_holds": met if by_mean else None,
            "in_a_row": tally.in_a_row,
            "practice": training.practice(name),
        }

    return make_stage(training, name, run.kind, progress, run.like(), test, target=goal.target)


def _tests_generator(run: StoredRun, name: str) -> Generator:
    """The generator of the fresh scenarios on which a round's skill is tested."""
    return derived_generator(stage_generator(run.domain, run.settings.seed, name), TESTS)


def _tested(
    training: Training,
    goal: Goal,
    name: str,
    decisions: int,
    progress: Progress[Any],
    generator: Generator,
) -> tuple[Progress[Any], list[Score], bool]:
    """Try a round's skill on fresh scenarios, which join W or M.

    Returned are the progress, the scores of the tests, and whether the goal is reached. If the
    first test is good enough, a second one decides.
    """
    scores, sizes, n = list[Score](), (goal.screening, goal.decisive), goal.decisive
    skill = name if progress.skill is None else progress.skill.name
    enough = ENOUGH, next(m for m in range(n + 1) if not holds(goal, n - m, n, decisions + 1))
    for most, failures in zip(sizes, enough, strict=True):
        score = act(training.run, progress.skill, most, generator, failures)
        counted, decisive = (score.successes, score.tried), bool(scores)
        training.told(FreshTested(name, skill, *counted, goal.target, decisive))
        progress = _with(progress, score)
        scores.append(score)
        if not worth_deciding(goal, *counted):
            break
    return progress, scores, len(scores) == 2 and holds(goal, *counted, decisions + 1)


def _mean_tested(
    training: Training, goal: Goal, name: str, decisions: int, skill: Skill, played: int
) -> tuple[list[Score], bool]:
    """Try a round's skill on fresh scenarios, where its mean counts.

    Returned are the scores of the tests, and whether the goal is reached. The more episodes the
    search has `played`, the more the tests have. If the first one is good enough, a second one
    decides.
    """
    run, scores, met = training.run, list[Score](), False
    generator = _tests_generator(run, name)
    most = min(MOST_EPISODES, played // SHARE)
    for least in (EPISODES, DECISIVE_EPISODES):
        count = max(least, most)
        score = act(run, skill, count, generator, count + 1, training.purse)
        about = score.successes, score.tried, goal.target, bool(scores)
        training.told(FreshTested(name, skill.name, *about, score.mean_return, score.error))
        scores.append(score)
        values = score.values.tolist()
        if not (all(map(isfinite, values)) and fmean(values) >= goal.target):
            break
        met = len(scores) == 2 and mean_holds(values, goal.target, decisions + 1)
    return scores, met


def act(
    run: StoredRun,
    skill: Skill | None,
    most: int,
    generator: Generator,
    enough: int = ENOUGH,
    purse: Purse | None = None,
) -> Score:
    """Try a skill on up to `most` fresh scenarios, until `enough` are missed.

    Without a skill, all are missed. `TESTING` seconds after the end of the purse's time, `EPISODES`
    have to do.
    """
    domain: Domain[Any] = run.domain
    parts = list[Score]()
    while (tried := sum(p.tried for p in parts)) < most and (
        sum(p.tried - p.successes for p in parts) < enough
    ):
        if purse is not None and purse.late(TESTING):
            if tried >= EPISODES:
                break
            most = EPISODES
        fresh = domain.draw(run.kind, min(BATCH, most - tried), generator)
        if skill is None:
            seen = first_percepts(domain.world(fresh))
            parts.append(Score(fresh, seen, torch.zeros(len(fresh), dtype=torch.bool)))
        else:
            parts.append(try_on(skill, domain, fresh))
    return joined(parts)


def _with(progress: Progress[Any], score: Score) -> Progress[Any]:
    """W and M with the successes and failures."""
    solved = progress.solved.joined(score.scenarios[score.succeeded])
    missed = progress.missed.joined(score.scenarios[~score.succeeded])
    seen = torch.cat([score.percepts[score.succeeded], score.percepts[~score.succeeded]])
    known = seen[:0] if progress.seen is None else progress.seen
    old, new = len(progress.solved), int(score.succeeded.sum())
    parts = known[:old], seen[:new], known[old:], seen[new:]
    return replace(progress, solved=solved, missed=missed, seen=torch.cat(parts))


def mean_holds(returns: list[float], target: float, decision: int) -> bool:
    """Whether the mean of the returns, less some standard errors, is at least the target.

    It is False if an episode has no return because it did not finish. The first decision of a run
    (`decision` counts from 1) subtracts one standard error; later ones subtract more, as in
    `holds`.
    """
    if len(returns) < 2 or not all(map(isfinite, returns)):
        return False
    errors = NormalDist().inv_cdf(NormalDist().cdf(-1) * 2 / (decision * (decision + 1)))
    return fmean(returns) + errors * stdev(returns) / sqrt(len(returns)) >= target


def holds(goal: Goal, succeeded: int, tried: int, decision: int) -> bool:
    """Whether a decisive test shows that the goal is reached.

    Two conditions must hold. The share solved is at least the target, and the lower end of Wilson's
    interval is below it by at most `SLACK` of `Goal.fine`. For 99 %, this end is at least 98.75 %,
    which takes about 99.1 % of 4000.

    Decision number j (from 1) of a run has confidence 1 - 0.05 / (j (j + 1)), so the errors of all
    decisions sum to at most 0.05. A run whose skills are all below the bound therefore ends with
    success with a probability of at most 2.5 % (intervals are two-sided, and Wilson's are
    approximate). A goal that holds means: at least 98.75 %, with confidence 97.5 %.
    """
    low, _ = wilson(succeeded, tried, 1 - DOUBT / (decision * (decision + 1)))
    enough = goal.target - SLACK * goal.fine
    return tried > 0 and succeeded >= goal.target * tried and low >= enough


def worth_deciding(goal: Goal, succeeded: int, tried: int) -> bool:
    """Whether the screening test was good enough for a decisive test."""
    return tried >= goal.screening and succeeded >= goal.target * tried
