"""The data of a run: all transitions and tests that a stage, or the start, is stored with."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import RunError
from cgtorch.runs.storage import ASIDE, DATA, load_dataset
from cgtorch.runs.stored_run import StoredRun, read_run

START = "start"


@dataclass(frozen=True)
class StoredData:
    """The data of a part of a run, such as "auto-1" or "start"."""

    run: StoredRun
    part: str
    dataset: Dataset


def stored_data(
    path: Path, name: str | None = None, trusted: Sequence[str] = (), domain: str | None = None
) -> StoredData:
    """The data of a run, or of a stage such as RUN/S1, those kept aside to judge models last.

    Args:
        path: A run, or a stage in it.
        name: A stage or round of the run, or "start"; by default the last one.
        trusted: See `read_run`.
        domain: See `read_run`.

    Raises:
        RunError: There is no such run or stage, or it is stored without data.
    """
    if name is None and path.is_dir() and not (path / "run.json").exists():
        run, part = read_run(path.absolute().parent, trusted, domain), path.absolute().name
    else:
        run = read_run(path, trusted, domain)
        part = name or (*run.stages, START)[max(0, len(run.stages) - 1)]
    if part not in (START, *run.stages):
        known = ", ".join((START, *run.stages))
        raise RunError(f"run {str(run.folder)!r} has no part {part!r:.40}; give one of {known}")
    folder = run.folder / part
    if not (folder / DATA).is_file():
        raise RunError(
            f"{str(folder)!r} has no data: the run is stored without them, or no models were "
            "learned; give another run"
        )
    data = load_dataset(folder / DATA).extended(load_dataset(folder / ASIDE))
    return StoredData(run, part, data)
