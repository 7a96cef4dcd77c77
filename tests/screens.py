"""What a display shows: on a terminal that keeps it, or as lines."""

import io
from typing import Literal

from rich.console import Console

from cgtorch.report import ProgressDisplay


def console(terminal: bool, width: int = 100, coloured: bool = False) -> Console:
    colours: Literal["standard"] | None = "standard" if coloured else None
    return Console(file=io.StringIO(), force_terminal=terminal, width=width, color_system=colours)


def text_of(display: ProgressDisplay) -> str:
    assert isinstance(display.console.file, io.StringIO)
    return display.console.file.getvalue()


def snapshot(display: ProgressDisplay, width: int = 100) -> list[str]:
    """The live lines as they stand."""
    screen = console(False, width)
    screen.print(display.live_lines())
    assert isinstance(screen.file, io.StringIO)
    return [line.rstrip() for line in screen.file.getvalue().splitlines()]
