"""Reading and writing a run's files: completely or not at all, and as data, never as code."""

import json
import math
import os
import secrets
import shutil
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, NoReturn

from cgtorch.ground.errors import CgtorchError, RunError
from cgtorch.ground.given import any_path

if TYPE_CHECKING:
    from torch import Tensor

MAX_JSON_BYTES = 64 * 2**20
_LENGTH = 8  # bytes of a safetensors file that say how long its JSON is


@contextmanager
def writing(path: Path, error: type[CgtorchError] = RunError) -> Iterator[None]:
    """A context that turns any system error while writing a file or folder into `error`."""
    try:
        yield
    except (OSError, ValueError) as e:
        advice = "check the folder and disk"
        if isinstance(e, PermissionError):
            advice = "choose a folder that you may write to, or work on a copy that is yours"
        if isinstance(e, NotADirectoryError | FileExistsError):
            files = (each for each in path.parents if each.is_file())
            advice = next((f"{str(file)!r} is a file; choose another" for file in files), advice)
        raise error(f"cannot write {str(path)!r} ({_reason(e)}); {advice}") from e


def write_bytes(path: Path | str, data: bytes, error: type[CgtorchError] = RunError) -> None:
    """Write a file so that at any moment it has either its old content or all of the new.

    Its folder must exist. If it cannot be written, or something is there that is no file, such as a
    folder or a device, `error` is raised and nothing is left behind.
    """
    path = any_path(path)
    _check_replaceable(path, error)
    temporary = path.with_name(f".{secrets.token_hex(8)}.tmp")
    with writing(path, error):
        try:
            with temporary.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)


def _check_replaceable(path: Path, error: type[CgtorchError]) -> None:
    """Raise `error` if something is there that a whole new file must not replace."""
    with writing(path, error):
        kept = path.exists() and not path.is_file()
        what = "a folder" if path.is_dir() else "a device or a pipe"
    if kept:
        raise error(f"cannot write {str(path)!r}, which is {what}; give the path of a file")


def write_json(path: Path | str, data: object, error: type[CgtorchError] = RunError) -> None:
    """Write `data` as JSON, completely or not at all; numbers that are not finite are refused."""
    try:
        text = json.dumps(data, indent=1, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as e:
        raise error(
            f"cannot write {str(path)!r} as JSON ({_reason(e)}); give plain finite data"
        ) from e
    write_bytes(path, text.encode() + b"\n", error)


def read_bytes(path: Path | str, max_bytes: int, error: type[CgtorchError] = RunError) -> bytes:
    """Read a file; `error` if that fails, or if it has more than `max_bytes`."""
    path = any_path(path)
    try:
        if not path.is_file():
            raise error(f"cannot read {str(path)!r}, which is not a file; check the path")
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            # `read` allocates the bytes that it is asked for, so never ask for more than there are.
            raw = b"" if size > max_bytes else file.read(size + 1)
            whole = len(raw) == size
    except (OSError, ValueError) as e:
        if isinstance(e, error):
            raise
        raise error(f"cannot read {str(path)!r} ({_reason(e)}); check the path") from e
    if not whole:
        raise error(f"{str(path)!r} is larger than {max_bytes} bytes; is it the right file?")
    return raw


def read_json(
    path: Path | str, max_bytes: int = MAX_JSON_BYTES, error: type[CgtorchError] = RunError
) -> Any:
    """Read a JSON file of at most `max_bytes`.

    Duplicate keys and numbers that are not finite in float64 are errors, as any other failure.
    """
    raw = read_bytes(path, max_bytes, error)
    try:
        return strict_json(raw.decode())
    except (ValueError, RecursionError) as e:
        said = _in_place_of_json(raw) or f"is not proper JSON ({_reason(e)}); restore the file"
        raise error(f"{str(path)!r} {said}") from e


def _in_place_of_json(raw: bytes) -> str:
    """What a file is that is no JSON, and what to do, if that is seen; else ""."""
    if raw.startswith(b"PK"):
        return "is a zip file; unpack it, and give the folder or file that was in it"
    if raw.startswith(b"\x1f\x8b"):
        return "is compressed; unpack it (gunzip), and give the file that was in it"
    return "has marks of a conflict in git; resolve it first" if b"<<<<<<< " in raw else ""


def strict_json(text: str) -> Any:
    """Parse JSON; ValueError or RecursionError also for duplicate keys and infinite numbers."""
    return json.loads(text, parse_constant=_refuse, parse_float=_finite, object_pairs_hook=_unique)


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """A folder that appears under its name, or where that leads, with all its files, or not."""
    path = Path(os.path.realpath(path)) if path.is_symlink() else path
    partial_path = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        with writing(path):
            partial_path.mkdir()
        yield partial_path
        with writing(path):
            partial_path.replace(path)
    finally:
        shutil.rmtree(partial_path, ignore_errors=True)


def place_of(folder: Path) -> Path:
    """A folder for use in text: as given if it is relative, else its name only."""
    return folder if folder.name and not folder.is_absolute() else Path(folder.resolve().name)


def as_word(path: Path) -> str:
    """A path as a word of a shell, which no command takes for an option."""
    return quote(f"./{path}" if str(path).startswith("-") else str(path))


def check_name_of(folder: Path) -> None:
    """RunError for the name of a folder that is no UTF-8, which TensorBoard cannot write into."""
    try:
        str(folder).encode()
    except UnicodeEncodeError as e:
        raise RunError(
            f"the name of folder {str(folder)!r} is no valid UTF-8; rename it, or choose another"
        ) from e


def read_versioned(path: Path, form: str, version: int, what: str) -> dict[str, Any]:
    """Read a JSON object with its format and version; RunError if these differ."""
    data = read_json(path)
    if not isinstance(data, dict) or data.get("format") != form:
        raise RunError(f"{str(path)!r} is not of {what}; restore the file or give another")
    if data.get("version") != version:
        raise RunError(
            f"{str(path)!r} is of version {data.get('version')!r:.20}, this cgtorch reads "
            f"{version}; use the version that wrote it"
        )
    return data


class JsonLines:
    """An append-only file of JSON objects, one per line, which is made with its first line.

    Every line is written at once and reaches the disk before `append` returns, so a process that is
    killed loses at most the line that it was writing.
    """

    def __init__(self, path: Path):
        self.path, self._whole = path, False

    def append(self, *rows: dict[str, Any]) -> None:
        """Write more lines; RunError if they cannot be written."""
        data = "".join(json.dumps(row, allow_nan=False) + "\n" for row in rows).encode()
        if not data:
            return
        if not self._whole:
            self._cut_off_torn_line()
        with writing(self.path):
            file = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
            try:
                self._whole = False  # until all of it is on the disk, which may be full
                while data:
                    data = data[os.write(file, data) :]
                os.fsync(file)
                self._whole = True
            finally:
                os.close(file)

    def rows(self, *begin: str) -> Iterator[dict[str, Any]]:
        """All rows in order, or those whose lines `begin` with some text.

        RunError for a line that is no JSON object.
        """
        if not self.path.is_file():
            return
        with self.path.open(encoding="utf-8", errors="replace") as file:
            for number, line in enumerate(file, 1):
                if not line.endswith("\n"):
                    return  # it is torn, or about to be written
                if begin and not line.startswith(begin):
                    continue
                try:
                    row = strict_json(line)
                except (ValueError, RecursionError):
                    row = None
                if not isinstance(row, dict):
                    raise RunError(
                        f"line {number} of {str(self.path)!r} is {line[:40]!r}; restore the file"
                    )
                yield row

    def _cut_off_torn_line(self) -> None:
        data = self.path.read_bytes() if self.path.is_file() else b""
        if len(data) > (whole := data.rfind(b"\n") + 1):
            with writing(self.path):
                os.truncate(self.path, whole)


def tensors_of(data: bytes) -> dict[str, "Tensor"]:
    """The tensors of a safetensors file; ValueError if torch cannot load its bytes."""
    from safetensors import SafetensorError
    from safetensors.torch import load  # which imports torch

    try:
        return load(data)  # checks that the tensors are as large as the file and no larger
    except (SafetensorError, ValueError, RuntimeError, TypeError, KeyError) as error:
        said = (str(error).splitlines() or [type(error).__name__])[0]
        raise ValueError(said[:200]) from error


def notes_of(data: bytes) -> dict[str, Any]:
    """The notes in the JSON header of a safetensors file that has been checked."""
    length = int.from_bytes(data[:_LENGTH], "little")
    return json.loads(data[_LENGTH : _LENGTH + length]).get("__metadata__") or {}


def in_order(data: bytes) -> bytes:
    """A safetensors file with its notes in order, as the package writes several in any order."""
    length = int.from_bytes(data[:_LENGTH], "little")
    head = json.loads(data[_LENGTH : _LENGTH + length])
    head["__metadata__"] = dict(sorted((head.get("__metadata__") or {}).items()))
    text = json.dumps(head, separators=(",", ":"), ensure_ascii=False).encode()
    text = text.ljust(-(-len(text) // _LENGTH) * _LENGTH)
    return len(text).to_bytes(_LENGTH, "little") + text + data[_LENGTH + length :]


def head_of(path: Path) -> dict[str, Any]:
    """The header of a safetensors file, of which nothing else is read; {} if it has none."""
    try:
        with path.open("rb") as file:
            length = int.from_bytes(file.read(_LENGTH), "little")
            head = file.read(length) if length <= os.fstat(file.fileno()).st_size else b""
        found = json.loads(head)
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def head_notes(path: Path) -> dict[str, Any]:
    """The notes in the header of a safetensors file; {} if it has none."""
    found = head_of(path).get("__metadata__")
    return found if isinstance(found, dict) else {}


def head_rows(path: Path, name: str) -> int | None:
    """The number of rows of a tensor, by the header of a safetensors file; None if it has none."""
    about = head_of(path).get(name)
    shape = about.get("shape") if isinstance(about, dict) else None
    return shape[0] if isinstance(shape, list) and shape and isinstance(shape[0], int) else None


def _refuse(number: str) -> NoReturn:
    raise ValueError(f"number {number[:20]} is not finite")


def _finite(number: str) -> float:
    value = float(number)
    return value if math.isfinite(value) else _refuse(number)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        (twice, _), *_ = Counter(k for k, _ in pairs).most_common(1)
        raise ValueError(f"key {twice[:40]!r} comes twice")
    return found


def _reason(e: Exception) -> str:
    """The message of an error, on one line."""
    text = e.strerror if isinstance(e, OSError) and e.strerror else str(e)
    return " ".join(text.split())[:200] or type(e).__name__
