"""The console on which a program of the user's sees the progress of a training."""

import os
from contextlib import suppress
from io import UnsupportedOperation

from rich.console import Console


class LastingConsole(Console):
    """Standard error, whose loss does not end the program.

    Where nobody reads it any more, `Console` ends the program and takes its standard output too,
    which is right for a command only.
    """

    def __init__(self) -> None:
        super().__init__(stderr=True)

    def on_broken_pipe(self) -> None:
        """Show no more; what is left to write goes nowhere, as it would fail again at the end."""
        self.quiet = True
        with suppress(UnsupportedOperation), open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), self.file.fileno())
