"""What a display shows, on a terminal that keeps it or as lines, and events for it to show."""

import io
from typing import Literal

from members import nearly
from rich.console import Console

from cgtorch.ground.asked import Asked
from cgtorch.improvement.events import ChanceFound, Practised, WorldAsked
from cgtorch.report import ProgressDisplay

TRIALS = WorldAsked("S1", "trials", Asked(68, 19, 18, 18), succeeded=17)
LOOKS = WorldAsked("S1", "looks", Asked(looks=69))
CHANCE = ChanceFound("S1", 12, 30)


def practised(in_a_row: int) -> Practised:
    return Practised("S1", nearly(0.5), in_a_row, 24)


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
