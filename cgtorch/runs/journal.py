"""The journal of a stage as files, from which an interrupted stage resumes.

    RUN/journal/STAGE/00007.safetensors       the result of the stage's seventh long step
    RUN/journal/STAGE/00008-3.safetensors     the third checkpoint of the eighth step
    RUN/journal/STAGE/00008-3.0.safetensors   its first part, one for each island

Every file is written whole and has a checksum. A checkpoint is written after its parts and contains
their checksums; the last two checkpoints are kept. A damaged file is reported, and it and all later
ones are ignored, so damage costs time only. The folder is removed when the stage is finished.
"""

import hashlib
import re
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

import safetensors.torch
import torch
from torch import Tensor

from cgtorch import __version__
from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import RunError
from cgtorch.ground.files import notes_of, read_bytes, tensors_of, write_bytes, writing
from cgtorch.improvement.checkpoint import Checkpoint, Journal
from cgtorch.improvement.events import AboutToKeep, JournalDamaged, Watch

FOLDER = "journal"
MAX_BYTES = 2**30
SECONDS = 20.0  # between two notes of where a step stands
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
        return sum(int(t["generations"]) for t in known if _counts(t))

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
        self._steps.append((step, {}))  # only its place is needed any more
        self._next = len(self._steps)
        for path in self._files(_STEP)[len(self._steps) :]:
            self._remove(path)
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
        # Who ends early does so alone, so what other ranks hold cannot be had any more.
        unwritten = self._unwritten
        if kind is None:
            if ranks.first():
                _forget(self._folder)
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
        for path in (*notes, *self._files(_PART)):
            if path.name.split(".")[0] not in kept:
                self._remove(path)

    @staticmethod
    def _remove(path: Path) -> None:
        if ranks.first():
            path.unlink(missing_ok=True)

    def _write(self, name: str, about: dict[str, str], tensors: dict[str, Tensor]) -> str:
        """Write a file, on the first rank only, and return its checksum."""
        if not ranks.first():
            return ""
        self._before_writing()
        with writing(self._folder):
            self._folder.mkdir(parents=True, exist_ok=True)
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
        known = self._whole(path)
        if known is None:
            return None
        about, tensors = known
        sums, parts = about.get("parts", "").split(), []
        if not sums:
            self.damaged.append(path)
            return None
        for i, wanted in enumerate(sums):
            part = path.with_name(f"{path.stem}.{i}.safetensors")
            # Looked at now and read when it is needed: not all may fit into memory.
            if (found := self._whole(part)) is None:
                return None
            if found[0]["sha256"] != wanted:
                self.damaged.append(part)
                return None
            parts.append(partial(_tensors, part))
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


def forget(folder: Path, name: str) -> None:
    """Remove the journal of a finished stage, in case its process was killed before it could."""
    if ranks.first() and (folder / FOLDER / name).is_dir():
        _forget(folder / FOLDER / name)


def _forget(journal: Path) -> None:
    shutil.rmtree(journal, ignore_errors=True)
    with suppress(OSError):
        journal.parent.rmdir()  # of all stages, if this was the only one


def recalled_generations(folder: Path) -> int:
    """Number of generations that the run in `folder` will recall when it resumes."""
    journals = (path for path in (folder / FOLDER).glob("*") if path.is_dir())
    begun = [path for path in journals if not (folder / path.name / "skill.json").is_file()]
    return sum(FileJournal(path).generations for path in begun)


def _tensors(path: Path) -> dict[str, Tensor]:
    return tensors_of(read_bytes(path, MAX_BYTES))


def checksum(tensors: dict[str, Tensor], about: dict[str, str]) -> str:
    """The checksum of a file: of names, types, shapes and bytes of tensors, and of its notes."""
    digest = hashlib.sha256(repr(sorted(about.items())).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        # As bytes, because numpy lacks some of the types that a file may hold.
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def _counts(tensors: dict[str, Tensor]) -> bool:
    count = tensors.get("generations")
    return count is not None and count.numel() == 1 and count.dtype == torch.long
