"""The speed of a run, and upper bounds of the remaining time."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from cgtorch.improvement.events import GenerationDone, StageStarted
from cgtorch.runs.stored_run import AUTO

MEMORY = 0.9  # weight of the past in smoothed numbers


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

    def stage_started(self, event: StageStarted) -> None:
        """Update at the beginning of a stage."""
        self._attempts, self._tried, self._done, self._latest = event.attempts, 0, 0, None
        number, count = stage_number(event)
        self._later_stages = count - number

    def generation_done(self, event: GenerationDone) -> None:
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


@dataclass(frozen=True)
class Count:
    """So much of some work is done, of so much in all, `seconds` after it began."""

    done: int
    total: int
    seconds: float

    @property
    def text(self) -> str:
        """How much is done, how fast, and how much longer it takes if it goes on like that."""
        text = f"{self.done:,} of {self.total:,}"
        if not self.done or self.seconds <= 0:
            return text
        speed = self.done / self.seconds
        return f"{text}, {speed:.3g}/s, left {as_time((self.total - self.done) / speed)}"


def stage_number(event: StageStarted) -> tuple[int, int]:
    """The number of the stage in the run, from 1, and the number of stages."""
    known = event.stage in event.stages
    return (event.stages.index(event.stage) + 1 if known else 1), max(len(event.stages), 1)


def place_of(event: StageStarted) -> str:
    """The place of a stage in its run, such as "stage 2 of 3" or "round 1"."""
    if event.stage.startswith(f"{AUTO}-"):
        return f"round {event.stage.removeprefix(f'{AUTO}-')}"
    number, count = stage_number(event)
    return f"stage {number} of {count}"


def _smoothed(past: float | None, value: float) -> float:
    return value if past is None else MEMORY * past + (1 - MEMORY) * value


def as_time(seconds: float) -> str:
    """Seconds as 0:07, 12:05 or 1:02:30; files have tenths, which give the same text."""
    whole = int(round(seconds, 1) + 0.5)
    hours, minutes = divmod(whole // 60, 60)
    text = f"{minutes}:{whole % 60:02d}"
    return f"{hours}:{minutes:02d}:{whole % 60:02d}" if hours else text
