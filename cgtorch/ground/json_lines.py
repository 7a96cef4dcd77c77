"""An append-only file of JSON objects, one per line: the log of a run.

Every line is written at once and reaches the disk before `append` returns, so a process that is
killed loses at most the line that it was writing.
"""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cgtorch.ground.errors import RunError
from cgtorch.ground.files import writing


class JsonLines:
    """A log at a path, which is made with its first line."""

    def __init__(self, path: Path):
        """The log at `path`. Reading changes nothing, so it may be somebody else's."""
        self.path, self._whole = path, False

    def append(self, *rows: dict[str, Any]) -> None:
        """Write more lines; RunError if they cannot be written."""
        data = "".join(json.dumps(row, allow_nan=False) + "\n" for row in rows).encode()
        if not data:
            return
        if not self._whole:
            self._cut_off_torn()
        with writing(self.path):
            file = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
            try:
                os.write(file, data)
                os.fsync(file)
            finally:
                os.close(file)

    def rows(self) -> Iterator[dict[str, Any]]:
        """All rows in order; RunError for a line that is no JSON object."""
        if not self.path.is_file():
            return
        with self.path.open(encoding="utf-8", errors="replace") as file:
            for number, line in enumerate(file, 1):
                if not line.endswith("\n"):
                    return  # it is torn, or about to be written
                try:
                    row = json.loads(line)
                except ValueError:
                    row = None
                if not isinstance(row, dict):
                    raise RunError(
                        f"line {number} of {str(self.path)!r} is {line[:40]!r}; restore the file"
                    )
                yield row

    def _cut_off_torn(self) -> None:
        """Remove what is after the last whole line, which nobody has seen."""
        self._whole = True
        if self.path.is_file():
            data = self.path.read_bytes()
            if torn := len(data) - (data.rfind(b"\n") + 1):
                with writing(self.path), self.path.open("r+b") as file:
                    file.truncate(len(data) - torn)
