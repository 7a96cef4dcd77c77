"""The journal of a stage as files, from which it resumes, and runs that go on with other settings.

    RUN/journal/STAGE/00007.safetensors       the result of the stage's seventh long step
    RUN/journal/STAGE/00008-3.safetensors     the third checkpoint of the eighth step
    RUN/journal/STAGE/00008-3.0.safetensors   its first part, one for each island

Every file is written whole and has a checksum. A checkpoint is written after its parts and contains
their checksums; the last two checkpoints are kept. A damaged file is reported, and it and all later
ones are ignored, so damage costs time only. The folder is removed when the stage is finished.

A run keeps the settings with which it began. Those that only control the search can be changed by
name; results depend on the others. Finished stages stay as they are. An unfinished stage is
repeated from its beginning, since a stage under mixed settings could not be reproduced; its journal
goes to RUN/set-aside/1, 2, …, and the log has a row `changed`.
"""

import hashlib
import itertools
import re
import shutil
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import safetensors.torch
import torch
from torch import Tensor

from cgtorch import __version__
from cgtorch.domains.settings import to_plain
from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import RunError
from cgtorch.ground.files import (
    JsonLines,
    notes_of,
    read_bytes,
    read_json,
    tensors_of,
    write_bytes,
    write_json,
    writing,
)
from cgtorch.improvement.checkpoint import Checkpoint, Journal
from cgtorch.improvement.events import AboutToKeep, JournalDamaged, Watch
from cgtorch.runs.log import LOG, read_log
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import AUTO, StoredRun, round_name, versions

FOLDER, ASIDE = "journal", "set-aside"
MAX_BYTES = 2**30
SECONDS = 20.0  # between two checkpoints
_STEP = re.compile(r"(\d{5})\.safetensors")
_CHECKPOINT = re.compile(r"(\d{5})-(\d+)\.safetensors")
_PART = re.compile(r"(\d{5})-(\d+)\.(\d+)\.safetensors")


class FileJournal(Journal):
    """A `Journal` in a folder; as a context manager, it writes a last checkpoint at its end.

    `damaged` lists files that could not be read.
    """

    def __init__(
        self,
        folder: Path,
        before_writing: Callable[[], None] = lambda: None,
        seconds: float = SECONDS,
    ):
        """Read a folder, which is created with the first file.

        `before_writing` is called before each write. There are at least `seconds` between
        checkpoints.
        """
        self._folder, self._before_writing, self._seconds = folder, before_writing, seconds
        self.damaged: list[Path] = []
        self._steps: list[tuple[str, dict[str, Tensor]]] = []
        self._checkpoint: tuple[str, Checkpoint] | None = None
        self._notes, self._written_at = 0, time.monotonic()
        self._unwritten: tuple[str, Checkpoint] | None = None
        self._read()
        self._next = 0

    @property
    def generations(self) -> int:
        """Number of generations that will be recalled."""
        known = [tensors for _, tensors in self._steps]
        known += [] if self._checkpoint is None else [self._checkpoint[1].about]
        counts = (tensors.get("generations", torch.zeros(0)) for tensors in known)
        return sum(int(c) for c in counts if c.numel() == 1 and c.dtype == torch.long)

    def recall(self, step: str) -> dict[str, Tensor] | None:
        """See the base class."""
        if self._next == len(self._steps):
            return None
        name, tensors = self._steps[self._next]
        self._check(step, name)
        self._next += 1
        return tensors

    def record(self, step: str, result: dict[str, Tensor]) -> None:
        """See the base class."""
        self._checkpoint = self._unwritten = None
        self._write(f"{len(self._steps):05}", {"step": step}, result)
        self._steps.append((step, {}))  # only its place is still needed
        self._next = len(self._steps)
        self._remove(self._files(_STEP)[len(self._steps) :])
        self._keep_checkpoints(0)

    def recall_checkpoint(self, step: str) -> Checkpoint | None:
        """See the base class."""
        if self._checkpoint is None:
            return None
        name, checkpoint = self._checkpoint
        self._check(step, name)
        return checkpoint

    def record_checkpoint(self, step: str, checkpoint: Checkpoint) -> None:
        """See the base class."""
        self._unwritten = step, checkpoint
        if ranks.broadcast(time.monotonic() - self._written_at >= self._seconds):
            self._write_checkpoint(step, checkpoint)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, e: BaseException | None, trace: TracebackType | None
    ) -> None:
        # A rank that ends early does so alone, so parts of other ranks are out of reach.
        unwritten = self._unwritten
        if kind is None:
            forget(self._folder)
        elif unwritten and not unwritten[1].apart and not issubclass(kind, RunError):
            self._write_checkpoint(*unwritten)

    def _check(self, step: str, name: str) -> None:
        if step != name:
            raise RunError(
                f"the journal {str(self._folder)!r} goes on with {name[:60]!r}, not {step!r}; "
                "remove it, and the stage is made again"
            )

    def _write_checkpoint(self, step: str, checkpoint: Checkpoint) -> None:
        self._notes += 1
        name, sums = f"{len(self._steps):05}-{self._notes}", []
        for i, part in enumerate(checkpoint.parts):  # one at a time, as they may be large
            sums.append(self._write(f"{name}.{i}", {"step": step}, part()))
        self._write(name, {"step": step, "parts": " ".join(sums)}, checkpoint.about)
        self._unwritten, self._written_at = None, time.monotonic()
        self._keep_checkpoints(2)

    def _keep_checkpoints(self, count: int) -> None:
        """Remove all checkpoints except the last `count`, and parts without a checkpoint."""
        notes = self._files(_CHECKPOINT)
        kept = {path.stem for path in notes[max(0, len(notes) - count) :]}
        every = (*notes, *self._files(_PART))
        self._remove([path for path in every if path.name.split(".")[0] not in kept])

    @staticmethod
    def _remove(paths: list[Path]) -> None:
        for path in paths if ranks.first() else ():
            path.unlink(missing_ok=True)

    def _write(self, name: str, about: dict[str, str], tensors: dict[str, Tensor]) -> str:
        """Write a file, on the first rank only, and return its checksum."""
        if not ranks.first():
            return ""
        self._before_writing()
        with writing(self._folder):
            self._folder.parent.mkdir(exist_ok=True)  # in the run, which may have been renamed
            self._folder.mkdir(exist_ok=True)
        plain = {key: t.detach().cpu().contiguous().clone() for key, t in tensors.items()}
        about = {**about, "version": __version__}
        about["sha256"] = checksum(plain, about)
        data = safetensors.torch.save(plain, metadata=about)
        write_bytes(self._folder / f"{name}.safetensors", data)
        return about["sha256"]

    def _files(self, pattern: re.Pattern[str]) -> list[Path]:
        """Files whose names match the pattern, in order."""
        try:
            found = [(pattern.fullmatch(p.name), p) for p in self._folder.iterdir()]
        except OSError:
            return []
        numbered = [(tuple(map(int, m.groups())), p) for m, p in found if m is not None]
        return [p for _, p in sorted(numbered)]

    def _read(self) -> None:
        """Read files in order, up to the first damaged one."""
        for i, path in enumerate(self._files(_STEP)):
            known = self._whole(path) if path.name == f"{i:05}.safetensors" else None
            if known is None:
                break
            self._steps.append((known[0]["step"], known[1]))
        for path in self._files(_CHECKPOINT):
            self._notes = max(self._notes, int(path.stem.split("-")[1]))
            if path.name.startswith(f"{len(self._steps):05}-"):
                self._checkpoint = self._whole_checkpoint(path) or self._checkpoint

    def _whole_checkpoint(self, path: Path) -> tuple[str, Checkpoint] | None:
        """The step's name and its checkpoint; None if the file or one of its parts is damaged."""
        if (known := self._whole(path)) is None:
            return None
        about, tensors = known
        sums, parts = about.get("parts", "").split(), []
        if not sums:
            self.damaged.append(path)
            return None
        for i, wanted in enumerate(sums):
            part = path.with_name(f"{path.stem}.{i}.safetensors")
            # Checked now and read when needed, as not all may fit into memory.
            if (found := self._whole(part)) is None:
                return None
            if found[0]["sha256"] != wanted:
                self.damaged.append(part)
                return None
            parts.append(partial(lambda part: tensors_of(read_bytes(part, MAX_BYTES)), part))
        return about["step"], Checkpoint(tensors, tuple(parts))

    def _whole(self, path: Path) -> tuple[dict[str, str], dict[str, Tensor]] | None:
        """The notes and tensors of a file; None if it is damaged, which is recorded."""
        try:
            data = read_bytes(path, MAX_BYTES)
            tensors, about = tensors_of(data), notes_of(data)
            rest = {key: value for key, value in about.items() if key != "sha256"}
            if about["sha256"] == checksum(tensors, rest) and "step" in about:
                return (about, tensors) if about["version"] == __version__ else None
        except (RunError, KeyError, ValueError):
            pass
        self.damaged.append(path)
        return None


def journal_of(folder: Path, name: str, watch: Watch, seconds: float = SECONDS) -> FileJournal:
    """The journal of a stage or round of the run in `folder`; damaged files are reported."""
    journal = FileJournal(folder / FOLDER / name, lambda: watch(AboutToKeep()), seconds)
    ranks.wait()  # all have read before anyone writes
    if journal.damaged:
        watch(JournalDamaged(name, tuple(str(path) for path in journal.damaged)))
    return journal


def forget(journal: Path) -> None:
    """Remove the journal of a finished stage, on the first rank."""
    if ranks.first():
        shutil.rmtree(journal, ignore_errors=True)
        with suppress(OSError):
            journal.parent.rmdir()  # of all stages, if this was the only one


def recalled_generations(folder: Path) -> int:
    """Number of generations that the run in `folder` will recall when it resumes."""
    journals = (path for path in (folder / FOLDER).glob("*") if path.is_dir())
    begun = [path for path in journals if not (folder / path.name / "skill.json").is_file()]
    return sum(FileJournal(path).generations for path in begun)


def checksum(tensors: dict[str, Tensor], about: dict[str, str]) -> str:
    """The checksum of a file: of names, types, shapes and bytes of tensors, and of its notes."""
    digest = hashlib.sha256(repr(sorted(about.items())).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        # As bytes, because numpy lacks some of the types that a file may hold.
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class TakenOver:
    """A run with its present settings, and the stage or round `before` which they changed.

    `changed` contains old and new values by name: settings, cgtorch, torch. `set_aside` is the
    folder of the old journal within the run, or None.
    """

    run: StoredRun
    changed: Mapping[str, tuple[Any, Any]]
    before: str
    set_aside: str | None


def take_over(run: StoredRun, settings: RunSettings, stage: str) -> TakenOver:
    """Continue under these settings with this version of the library, and log the changes.

    An interruption at any point can at most repeat the stage under the old settings.
    """
    about = read_json(run.folder / "run.json")
    old, new = to_plain(run.settings), to_plain(settings)
    changed = {name: (old[name], new[name]) for name in old if old[name] != new[name]}
    current = {**versions(), **run.files.made_with()}
    changed |= {k: (about.get(k), v) for k, v in current.items() if about.get(k) != v}
    before = _next(run, stage)
    if not changed:
        return TakenOver(run, {}, before, None)
    stale = set(changed) - {"torch", "engine"} and (run.folder / FOLDER).is_dir()
    names = (f"{ASIDE}/{i}" for i in itertools.count(1))
    aside = next(name for name in names if not (run.folder / name).exists()) if stale else None
    ranks.wait()  # all have read before anyone writes
    if ranks.first():
        _log_change(run.folder, before, {name: [*both] for name, both in changed.items()}, aside)
        if aside is not None:
            with writing(run.folder / ASIDE):
                (run.folder / ASIDE).mkdir(exist_ok=True)
                (run.folder / FOLDER).rename(run.folder / aside)
        write_json(run.folder / "run.json", {**about, **current, "settings": new})
    ranks.wait()
    return TakenOver(replace(run, settings=settings), changed, before, aside)


def _log_change(
    folder: Path, before: str, changed: dict[str, list[Any]], aside: str | None
) -> None:
    """Log a change, unless it was the last thing that was logged before an interruption."""
    last = (read_log(folder) or [{}])[-1]
    if (last.get("stage"), last.get("changed")) != (before, changed):
        row = {"stage": before, "changed": changed, "set_aside": aside}
        JsonLines(folder / LOG).append({"event": "changed", "time": round(time.time(), 3), **row})


def _next(run: StoredRun, stage: str) -> str:
    """The next stage or round that a run makes when asked for a stage."""
    missing = [name for name in run.domain.stages if name not in run.stages]
    if stage == AUTO or run.rounds or not missing:
        return round_name(len(run.rounds) + 1)
    return missing[0]


def goes_on_to(run: StoredRun) -> dict[str, Any]:
    """The last request for the run: the stage, and the goal of "auto"; {} before the first."""
    found = read_json(run.folder / "run.json").get("goes_on_to", {})
    if not isinstance(found, dict):
        raise RunError(f"goes_on_to of {str(run.folder / 'run.json')!r} is no object; restore it")
    return found


def remember_goal(run: StoredRun, wanted: Mapping[str, Any]) -> None:
    """Record in run.json what the run is asked for, on the first rank only."""
    if ranks.first() and goes_on_to(run) != wanted:
        about = read_json(run.folder / "run.json")
        write_json(run.folder / "run.json", {**about, "goes_on_to": dict(wanted)})
    ranks.wait()
