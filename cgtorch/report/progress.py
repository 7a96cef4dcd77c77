"""The live display of a run; plain lines without a terminal."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Self, cast

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from cgtorch.domains.surroundings import surroundings
from cgtorch.evolution.fitness import WORTHLESS
from cgtorch.ground.errors import printable
from cgtorch.improvement import events
from cgtorch.native.processes import listening
from cgtorch.report.messages import as_time, few_solved, message_of, place_of, stage_number

SILENCE = 15.0  # s without a line after which one tells what goes on
OFTEN = 25.0  # s at least between two lines on the same work where there is no terminal
MEMORY = 0.9  # weight of the past in smoothed numbers
LOOKED = 1.0  # s between two looks at whether it is silent
ENOUGH = 30  # episodes, to say how many of them succeeded


@dataclass
class Estimate:
    """Smoothed speed, and bounds of the time left if nothing takes longer than so far."""

    clock: Callable[[], float] = time.monotonic
    speed: float | None = None  # transitions that are executed per second
    _per_generation: float | None = None  # s
    _between: float = 0.0  # s from the end of one evolution to the beginning of the next
    _limit: int = 0
    _done: int = 0
    _attempts: int = 0
    _tried: int = 0
    _later_stages: int = 0
    _latest: float | None = None

    def stage_started(self, event: events.StageStarted) -> None:
        """Update at the beginning of a stage."""
        self._attempts, self._tried, self._latest = event.attempts, 0, None
        self._done = self._limit  # no evolution has begun
        number, count = stage_number(event)
        self._later_stages = count - number

    def generation_done(self, event: events.GenerationDone) -> None:
        """Update after a generation."""
        now, seconds = self.clock(), max(event.seconds, 1e-9)
        if event.generation.number == 0:
            self._tried += 1
            if self._latest is not None:
                self._between = max(self._between, now - seconds - self._latest)
        self._limit, self._done, self._latest = event.limit, event.generation.number + 1, now
        self._per_generation = _smoothed(self._per_generation, seconds)
        self.speed = _smoothed(self.speed, event.generation.executed / seconds)

    def evolution_over(self) -> None:
        """Update after an evolution, when its candidate is tested."""
        self._done = self._limit

    def stage_over(self) -> None:
        """Update after a stage."""
        self._tried = self._attempts

    @property
    def evolution_left(self) -> float | None:
        """The most seconds this evolution can still take; None if unknown."""
        if self._per_generation is None:
            return None
        return (self._limit - self._done) * self._per_generation

    @property
    def run_left(self) -> float | None:
        """The most seconds the run can still take; None if unknown."""
        left = self.evolution_left
        if left is None or self._per_generation is None:
            return None
        evolutions = max(self._attempts - self._tried, 0) + self._later_stages * self._attempts
        return left + evolutions * (self._limit * self._per_generation + self._between)


def count_text(done: int, total: int, seconds: float) -> str:
    """How much is done `seconds` after work began, how fast, and how much longer it takes."""
    text = f"{done:,} of {total:,}"
    if not done or seconds <= 0:
        return text
    speed = done / seconds
    return f"{text}, {speed:.3g}/s, left {as_time((total - done) / speed)}"


def _smoothed(past: float | None, value: float) -> float:
    return value if past is None else MEMORY * past + (1 - MEMORY) * value


class ProgressDisplay:
    """A `Watch` that shows events on a console, as a context manager; nothing if `quiet`.

    On a terminal, a few lines are updated, and accepted skills stay above them. Otherwise there is
    a line for each stage, fit, test in the world and accepted skill, and for long evolutions.
    """

    def __init__(self, console: Console | None = None, quiet: bool = False):
        """Set up the display on `console`, which is standard error by default."""
        self.console = console or Console(stderr=True)
        self._quiet, self._live_mode = quiet, self.console.is_terminal and not quiet
        self._live: Live | None = None
        self._began = time.monotonic()
        self._ended, self._within = threading.Event(), ExitStack()
        self._estimate = Estimate()
        self._stage: events.StageStarted | None = None
        self._generation: events.GenerationDone | None = None
        self._world = ""
        # Episodes of candidates that the models expected to succeed, and those that did.
        self._tried = self._solved = 0
        self._has_models, self._told = False, time.monotonic()
        self._working: list[tuple[str, float, Spinner]] = []
        # Of counted work: when it began, when a line last told of it, and how much is done of what.
        self._counts: dict[str, tuple[float, float, int, int]] = {}

    def __enter__(self) -> Self:
        """Begin; elapsed time counts from here."""
        self._began = self._told = time.monotonic()
        self._within.enter_context(listening(self.counted))
        if self._live_mode:
            self._live = Live(get_renderable=self.live_lines, console=self.console, transient=True)
            self._live.start()
        elif not self._quiet:
            self._ended = threading.Event()
            signs = threading.Thread(target=self._signs_of_life, daemon=True)
            signs.start()
            self._within.callback(signs.join)  # no process is forked while it prints
            self._within.callback(self._ended.set)
        return self

    def __exit__(self, *exception: object) -> None:
        """Remove the live lines; printed lines stay."""
        if self._live is not None:
            self._live.stop()
            self._live = None
        self._within.close()

    def _signs_of_life(self) -> None:
        """Print a line wherever nothing has been printed for a while, until the end."""
        while not self._ended.wait(LOOKED):
            if time.monotonic() - self._told >= SILENCE:
                self.say(self._present())

    def _present(self) -> str:
        """What is going on, in a line."""
        parts = [self._stage.stage] if self._stage else []
        parts += [message for message, _, _ in list(self._working)[-1:]]
        if not self._working and self._generation is not None:
            done = self._generation.generation.number + 1
            parts.append(f"{self._generation.candidate}, generation {done}")
        parts += self._counted()
        parts += filter(None, [surroundings.unreturned(SILENCE)])
        parts.append(f"{as_time(time.monotonic() - self._began)} elapsed")
        return ", ".join(parts)

    def __call__(self, event: events.Event) -> None:
        """Show an event."""
        message = message_of(event)
        match event:
            case events.GenerationDone():
                self._generation = event
                self._estimate.generation_done(event)
                if time.monotonic() - self._told >= OFTEN:
                    done, limit = event.generation.number + 1, event.limit
                    numbers = _numbers(event, None).plain.strip()
                    self._plain(f"{event.candidate}: generation {done} of ≤ {limit}, {numbers}")
            case (
                events.EvolutionRecalled()
                | events.JournalDamaged()
                | events.FreshTested()
                | events.EpisodePlayed()
            ):
                self.say(message)
            case events.StageStarted():
                self._stage, self._generation, self._world = event, None, ""
                self._estimate.stage_started(event)
                self._plain(message)
            case events.ModelsFitted():
                self._has_models = True
                # The quality of the first Γ and C is a result, so its line stays.
                (self.say if event.summary.first else self._plain)(message)
            case events.WorldAsked() | events.Practised():
                if isinstance(event, events.WorldAsked) and event.phase in ("trials", "practice"):
                    self._compare(event.asked.episodes, event.succeeded)
                if message:
                    self._world = message
                    self._plain(message)
            case events.MeanTested():
                self._world = message
                if time.monotonic() - self._told >= OFTEN:
                    self._plain(message)
            case events.ChanceFound() | events.StageFailed():
                self.say(message, style="yellow")
            case events.WorldTested():
                self._estimate.evolution_over()
                self._world = message
                self._plain(message)
            case events.SkillAccepted():
                self._estimate.stage_over()
                self.say(message, style="green")

    def _compare(self, tried: int, solved: int) -> None:
        """Say once that little succeeds in the world."""
        before = self._tried
        self._tried, self._solved = self._tried + tried, self._solved + solved
        few = self._solved < self._tried / 4
        if self._has_models and few and before < ENOUGH <= self._tried:
            self.say(few_solved(self._tried, self._solved), style="yellow")

    @contextmanager
    def working(self, message: str) -> Iterator[None]:
        """Show a message while the context lasts."""
        entry = (message, time.monotonic(), Spinner("dots", style="cyan"))
        self._working.append(entry)
        self._plain(f"{message} …")
        try:
            yield
        finally:
            self._working.remove(entry)

    def counted(self, what: str, done: int, total: int) -> None:
        """Show how much is done of long work, until all is; see `cgtorch.native.processes`."""
        now = time.monotonic()
        began, told, *_ = self._counts.pop(what, (now, now)) if done else (now, now)
        if done < total:
            if now - told >= OFTEN:
                self._plain(f"{what}: {count_text(done, total, now - began)}")
                told = now
            self._counts[what] = began, told, done, total

    def _counted(self) -> list[str]:
        """How far counted work is by now, which is slower the longer nothing more is done."""
        now, counts = time.monotonic(), list(self._counts.items())
        return [f"{what}: {count_text(d, n, now - began)}" for what, (began, _, d, n) in counts]

    def say(self, line: str, style: str = "") -> None:
        """Print a line that stays, unless quiet."""
        self._told = time.monotonic()
        if not self._quiet:
            self.console.print(Text(printable(line), style=style), soft_wrap=True)

    def _plain(self, line: str) -> None:
        """Print a line if there is no live display."""
        if not self._live_mode:
            self.say(line)

    def live_lines(self) -> RenderableType:
        """The present content of the live lines."""
        lines: list[RenderableType] = []
        now = time.monotonic()
        if (stage := self._stage) is not None:
            left = self._estimate.run_left
            lines.append(
                _line(
                    (stage.stage, "bold"),
                    f"  {place_of(stage)}  W {stage.size_w}, to solve {stage.size_m}",
                    (f"  elapsed {as_time(now - self._began)}", "dim"),
                    ("" if left is None else f"  left ≤ {as_time(left)}", "dim"),
                )
            )
        if self._generation is not None:
            lines.append(_bar(self._generation, self._estimate.evolution_left or 0.0))
            lines.append(_numbers(self._generation, self._estimate.speed))
        if self._world:
            lines.append(_line((f"  {self._world}", "dim")))
        for message, began, spinner in list(self._working):
            frame = cast(Text, spinner.render(now))
            lines.append(_line(frame, f" {message} … {as_time(now - began)}"))
        lines += [_line((f"  {text}", "dim")) for text in self._counted()]
        if late := surroundings.unreturned(SILENCE):
            lines.append(_line((f"  {late}", "yellow")))
        return Group(*lines)


def _line(*parts: str | Text | tuple[str, str]) -> Text:
    """One line, cut at the width of the terminal."""
    known = (
        part if isinstance(part, Text) else _styled(*([part] if isinstance(part, str) else part))
        for part in parts
    )
    return Text.assemble(*known, no_wrap=True, overflow="ellipsis")


def _styled(text: str, style: str = "") -> tuple[str, str]:
    return printable(text), style


def _bar(event: events.GenerationDone, left: float) -> Table:
    """The progress of an evolution, with the most seconds it can still take."""
    done = event.generation.number + 1
    grid = Table.grid(padding=(0, 1))
    for _ in range(4):
        grid.add_column(no_wrap=True)
    grid.add_row(
        Text(printable(f"  {event.candidate}"), style="cyan"),
        ProgressBar(total=event.limit, completed=done, width=24),
        Text(f"generation {done} of ≤ {event.limit}"),
        Text(f"left ≤ {as_time(left)}", style="dim"),
    )
    return grid


def _numbers(event: events.GenerationDone, speed: float | None) -> Text:
    generation = event.generation
    counts = generation.fitness[generation.fitness > WORTHLESS]
    best = f"{generation.best:.3f}" if generation.best > WORTHLESS else "–"
    mean = f"{float(counts.mean()):.3f}" if len(counts) else "–"
    return _line(
        f"  fitness best {best} mean {mean}",
        f"  W {event.solved_w}/{event.size_w}" if event.size_w else "",
        f"  M {event.solved_m}/{event.size_m}",
        f"  not finite {generation.not_finite}" if generation.not_finite else "",
        "" if speed is None else f"  {_short(speed)} transitions/s",
    )


def _short(number: float) -> str:
    """A number with about three digits: 412, 9.1 k, 1.3 M."""
    for size, unit in ((1e6, " M"), (1e3, " k")):
        if number >= size:
            return f"{number / size:.3g}{unit}"
    return f"{number:.0f}"
