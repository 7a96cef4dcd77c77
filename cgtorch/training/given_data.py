"""The data that a run is given in files, from which its first models are learned (`--data`)."""

import torch
from torch import Generator, Tensor

from cgtorch.domains.data_files import check_enough, read_data
from cgtorch.domains.knowledge import MOST_LABELS, MOST_TRANSITIONS, taken
from cgtorch.evolution.search import derived_generator
from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import SettingsError
from cgtorch.runs.stored_run import StoredRun

GIVEN = 42  # the generator of what is left out of large files, derived like an island's


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
            "--data is what Γ and C are learned from, and this run evolves its skills in the world "
            "itself; leave it out"
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
    """What is known after an exploration that began with `given`.

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
