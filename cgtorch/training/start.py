"""The state of a run before its first stage: the first data, and the models learned from them."""

import time
from dataclasses import asdict
from functools import reduce
from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch.domains.data_files import check_enough, read_data
from cgtorch.domains.exploration import EXPLORATION, Exploration
from cgtorch.domains.knowledge import (
    MOST_LABELS,
    MOST_TRANSITIONS,
    Knowledge,
    summary_of,
    taken,
)
from cgtorch.domains.live import OnRobot
from cgtorch.evolution.search import derived_generator
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import NAMES as ASKED
from cgtorch.ground.asked import Asked, Purse
from cgtorch.ground.environment import Dataset, Environment, Live
from cgtorch.ground.errors import SettingsError
from cgtorch.ground.files import whole_folder
from cgtorch.improvement.events import ModelsFitted, WorldAsked
from cgtorch.improvement.setup import Progress
from cgtorch.runs.log import read_log
from cgtorch.runs.storage import load_progress, save_progress
from cgtorch.runs.stored_run import StoredRun
from cgtorch.simulation import Recording
from cgtorch.training.context import Training

LANES = 2  # robots that explore side by side, where there can be several
GIVEN = 42  # the generator of what is left out of large files, derived like an island's


def initial_progress(training: Training) -> Progress[Any]:
    """Data, labels, Γ and C before the first stage (section V), made once and stored in the run.

    A run that evolves in the world itself has none. Work is done in parallel if compiled code may
    use threads.
    """
    run, working = training.run, training.working
    nothing = run.like()
    if not run.learns:
        return Progress(None, nothing, nothing, None)
    start = run.folder / "start"
    if start.is_dir():
        return load_progress(run, start)
    settings = run.settings
    generator = Generator().manual_seed(settings.seed)
    before = training.purse.total
    dataset = _first_data(training, generator)
    asked = training.purse.total - before
    if asked != Asked():
        training.told(WorldAsked("start", EXPLORATION, asked))
    began = time.perf_counter()
    with working("fitting Γ and C"):
        knowledge = run.models.fit(dataset, settings.seed)
    seconds = time.perf_counter() - began
    training.told(ModelsFitted("start", summary_of(knowledge), seconds))
    progress = Progress(None, nothing, nothing, knowledge)
    if ranks.first():
        with whole_folder(start) as folder:
            save_progress(folder, progress, settings.seed)
    return progress


def _first_data(training: Training, generator: Generator) -> Dataset:
    """The data for the first Γ and C: from the run's files, from its world, or both."""
    run = training.run
    if run.settings.data and run.settings.transitions == 0:
        with training.working("reading the data"):
            return given_data(run)
    with training.working("exploring: motions that teach the models most"):
        given = given_data(run) if run.settings.data else None
        parts = [part for part in (given, _explored(training)) if part is not None]
        known = reduce(Dataset.extended, parts) if parts else None
        found = run.models.explore(_exploration(training, generator, known))
    return known_at_last(known, found)


def _exploration(training: Training, generator: Generator, known: Dataset | None) -> Exploration:
    """The inputs of an exploration, whose world actions are counted."""
    run, domain = training.run, training.run.domain

    def world(kind: str, count: int) -> Environment:
        made = domain.world(domain.draw(kind, count, generator))
        if isinstance(made, Live):
            made.told(EXPLORATION, "start")
        return Recording(made, training.purse, EXPLORATION)

    def fit(data: Dataset) -> Knowledge:
        return run.models.fit(data, run.settings.seed)

    lanes = LANES if run.repeats else 1
    about = run.settings.transitions, lanes, generator, training.purse
    live = isinstance(domain, OnRobot)
    return Exploration(run.kind, world, fit, *about, known=known, live=live)


def _explored(training: Training) -> Dataset | None:
    """The data of a robot's exploration that was interrupted, which are paid for."""
    domain = training.run.domain
    if not isinstance(domain, OnRobot):
        return None
    data, asked = domain.actor.explored(len(domain.percept), len(domain.control))
    training.purse.add(EXPLORATION, asked)
    return data if asked.actions else None


def spent_of(purse: Purse) -> dict[str, dict[str, int]]:
    """World actions by phase, as plain data."""
    return {phase: asdict(asked) for phase, asked in purse.spent.items()}


def recall_spent(training: Training) -> None:
    """Fill the purse with what the finished parts of the run have asked."""
    run, spent = training.run, training.purse.spent
    spent.clear()
    if results := run.results:
        spent.update((phase, Asked(**asked)) for phase, asked in results[-1]["asked"].items())
    elif (run.folder / "start").is_dir():
        for row in read_log(run.folder):
            if (row["event"], row["stage"]) == ("asked", "start"):
                spent[row["phase"]] = Asked(**{name: row[name] for name in ASKED})


def given_data(run: StoredRun) -> Dataset:
    """The transitions (N, D) and tests (L, D) in a run's files.

    Of more rows than models are learned from, a random part is taken.

    Raises:
        SettingsError: The run learns no models.
        DataError: A file cannot be read, or holds something else than the domain's numbers; or the
            run is not to explore, and the data are not enough.
    """
    if not run.learns:
        raise SettingsError(
            "Γ and C are learned from data (--data), and this run evolves its skills in the world "
            "itself; leave data out"
        )
    data = read_data(run.settings.data, run.domain.percept, run.domain.control)
    if run.settings.transitions == 0:
        check_enough(data)
    generator = derived_generator(Generator().manual_seed(run.settings.seed), GIVEN)
    moves = _some(torch.ones(len(data.percept), dtype=torch.bool), MOST_TRANSITIONS, generator)
    few = (
        data.succeeded if int(data.succeeded.sum()) * 2 <= len(data.succeeded) else ~data.succeeded
    )
    rarer = _some(few, MOST_LABELS // 2, generator)
    tests = rarer | _some(~few, MOST_LABELS - int(rarer.sum()), generator)
    return taken(data, moves, tests)


def known_at_last(given: Dataset | None, found: Dataset) -> Dataset:
    """The data after an exploration that began with `given`.

    A domain's own way to explore may not have considered it.
    """
    if given is None or _begins_with(found, given):
        return found
    return given.extended(found)


def _begins_with(found: Dataset, given: Dataset) -> bool:
    pairs = zip(vars(found).values(), vars(given).values(), strict=True)
    return all(torch.equal(some[: len(begin)], begin) for some, begin in pairs)


def _some(rows: Tensor, most: int, generator: Generator) -> Tensor:
    """(n,) bool, at most so many of the `rows` (n,) bool, at random."""
    chosen = rows.nonzero()[:, 0]
    chosen = chosen[torch.randperm(len(chosen), generator=generator)[:most]]
    return torch.zeros_like(rows).index_fill_(0, chosen, True)
