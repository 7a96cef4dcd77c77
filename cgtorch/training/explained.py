"""Why the last skill of a run fails, from the run's folder alone."""

from dataclasses import replace
from pathlib import Path

from cgtorch.domains.domain import counting
from cgtorch.domains.failures import Explained, Failures, Searched, Tried
from cgtorch.graphs import Skill, load_skill, skill_to_dict
from cgtorch.ground.errors import SettingsError
from cgtorch.runs.chosen import folder_of_last
from cgtorch.runs.log import Row, read_log
from cgtorch.runs.settings import defaults_of, option_of
from cgtorch.runs.storage import load_scenarios, stage_knowledge
from cgtorch.runs.stored_run import SKILL, StoredRun
from cgtorch.training.advice import MODELS, unskilled
from cgtorch.training.evaluate import Score, evaluate_skill, joined, try_on
from cgtorch.training.failures import Background, failures_of
from cgtorch.training.searched import searched_of
from cgtorch.training.train import FRESH, FRESH_SEED

SEARCH = "generations", "attempts", "population"
LITTLE = 0.5  # of the usual, at most, is little
EPISODES = 100  # fresh scenarios of a run in rounds
KNOWN = 24  # scenarios that training has missed, the last ones
MISSED = "missed in training"


def explained(run: StoredRun) -> Explained | None:
    """Why the last skill of a run fails; None for a robot, which cannot be put back.

    It is tried on fresh scenarios of every stage so far, and on some that training has missed.
    """
    if run.settings.driver:
        return None
    log, folder = read_log(run.folder), folder_of_last(run)
    if folder is None:
        return Explained(unskilled(_searched(run, log, ""), _where(run)))
    skill = load_skill(folder / SKILL, run.actions)
    seed = FRESH_SEED + run.settings.seed
    scores = {
        kind: evaluate_skill(skill, run.domain, kind, count, seed)
        for kind, count in _wanted(run, log).items()
    }
    if (folder / "scenarios.json").is_file():
        _, missed = load_scenarios(folder / "scenarios.json", run.like())
        if len(missed):
            scores[MISSED] = try_on(skill, run.domain, missed[-KNOWN:])
    made = {MISSED, *(run.domain.stages.get(name, run.kind) for name in run.stages)}
    tried = tuple(
        Tried(kind, each.tried, each.successes, kind in made) for kind, each in scores.items()
    )
    score = joined([*scores.values()])
    found = failures_of(skill, run.domain, score, background_of(run, folder, log), tried)
    return Explained(found, seed, skill, score.scenarios, score.succeeded)


def failures_in(run: StoredRun, score: Score, skill: Skill | None = None) -> Failures:
    """Why a skill fails in a score on the run's scenarios: a given one, or one of the run.

    SettingsError if the score is of another skill, or of other scenarios.
    """
    wanted = type(run.like()), len(run.domain.percept)
    if (type(score.scenarios), score.percepts.shape[1]) != wanted:
        raise SettingsError(
            f"score is of scenarios of another domain than {run.settings.domain!r}; give one that "
            "this run's evaluate returns"
        )
    tried, last = score.skill or skill, folder_of_last(run)
    if skill is not None and tried is not None and not _same(skill, tried):
        raise SettingsError(
            f"score is of skill {tried.name!r:.80}, and skill is another one, {skill.name!r:.80}; "
            "give the one that was evaluated"
        )
    every = [folder for folder in (last, *(run.folder / name for name in run.stages)) if folder]
    own = ((folder, load_skill(folder / SKILL, run.actions)) for folder in every)
    folder, found = next((f for f in own if tried is None or _same(f[1], tried)), (last, skill))
    if found is None:
        name = "" if tried is None else f" {tried.name!r:.80}"
        raise SettingsError(
            f"score is of a skill{name} that run {str(run.folder)!r} does not have; give a score "
            "of this run, or also the skill"
        )
    known = Background() if folder is None else background_of(run, folder)
    return failures_of(found, run.domain, score, known)


def _same(skill: Skill, other: Skill) -> bool:
    """Whether two skills are the same in all that is stored of them."""
    return skill is other or skill_to_dict(skill) == skill_to_dict(other)


def background_of(run: StoredRun, folder: Path, log: list[Row] | None = None) -> Background:
    """What is known of the skill in the folder of a stage or round.

    Of the last skill of a run, it is the search for a better one that is told, if it has begun.
    """
    known, modelled = stage_knowledge(run, folder), run.learns or run.imagines
    log = read_log(run.folder) if log is None else log
    begun = [str(row["stage"]) for row in log if row["event"] == "stage"]
    last = begun[-1] if begun and _is_last(run, folder) else folder.name
    return Background(known, modelled, _searched(run, log, last))


def _searched(run: StoredRun, log: list[Row], stage: str) -> Searched | None:
    """What the log says of the search for the skill of a stage, and which settings were low."""
    found, usual = searched_of(log, stage), defaults_of(type(run.domain.settings))
    given = {name: getattr(run.settings, name) for name in SEARCH}
    scarce = tuple(
        f"{option_of(name)} {value} (usually {usual[name]})"
        for name, value in given.items()
        if value <= LITTLE * usual[name]
    )
    return found and replace(found, scarce=scarce)


def _is_last(run: StoredRun, folder: Path) -> bool:
    """Whether a folder is that of the last skill of a run."""
    last = folder_of_last(run)
    return last is not None and last.resolve() == folder.resolve()


def _where(run: StoredRun) -> str:
    """Where the skills of a run are evolved."""
    if run.learns:
        return MODELS
    return "a Γ with rewards" if run.imagines else "the world itself, so no model is to blame"


def _wanted(run: StoredRun, log: list[Row]) -> dict[str, int]:
    """The kinds of scenarios to try, with their numbers: those of all stages that have begun."""
    stages = run.domain.stages
    begun = [row["stage"] for row in log if row["event"] == "stage" and row["stage"] in stages]
    if begun and not run.rounds:
        return dict.fromkeys((stages[name] for name in begun), FRESH)
    return {run.kind: FRESH if counting(run.domain) else EPISODES}
