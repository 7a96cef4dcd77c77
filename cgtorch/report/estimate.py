"""How fast a run is, and how much longer it can take at most."""

from dataclasses import dataclass

from cgtorch.improvement.events import GenerationDone, ModelsFitted, StageStarted, WorldTested

MEMORY = 0.9  # weight of the past in smoothed numbers


@dataclass
class Estimate:
    """Smoothed speed, and bounds on the time left by what is known of a run.

    Nobody knows how many generations an evolution needs, only how many it may take; so the times
    are upper bounds as long as generations and fits take as long as they did so far.
    """

    speed: float | None = None  # transitions per second
    per_generation: float | None = None  # s
    fit: float = 0.0  # s of fitting models after each evolution
    limit: int = 0
    done: int = 0
    attempts: int = 0
    tried: int = 0
    later_stages: int = 0

    def stage_started(self, event: StageStarted) -> None:
        """A stage with so many attempts begins."""
        self.attempts, self.tried, self.done = event.attempts, 0, 0
        stages = event.stages
        self.later_stages = (
            len(stages) - 1 - stages.index(event.stage) if event.stage in stages else 0
        )

    def generation_done(self, event: GenerationDone) -> None:
        """One more generation, and how long it took."""
        if event.generation.number == 0:
            self.tried += 1
        self.limit, self.done = event.limit, event.generation.number + 1
        seconds = max(event.seconds, 1e-9)
        self.per_generation = _smoothed(self.per_generation, seconds)
        self.speed = _smoothed(self.speed, event.generation.transitions / seconds)

    def models_fitted(self, event: ModelsFitted) -> None:
        """The models were fitted; later fits will take as long."""
        self.fit = event.seconds

    def world_tested(self, event: WorldTested) -> None:
        """An evolution is over."""
        self.done = self.limit

    @property
    def evolution_left(self) -> float | None:
        """The most seconds this evolution can take; None while nothing is known."""
        if self.per_generation is None:
            return None
        return (self.limit - self.done) * self.per_generation

    @property
    def run_left(self) -> float | None:
        """The most seconds the run can take; None while nothing is known."""
        left = self.evolution_left
        if left is None or self.per_generation is None:
            return None
        evolutions = max(self.attempts - self.tried, 0) + self.later_stages * self.attempts
        return left + evolutions * (self.limit * self.per_generation + self.fit)


def _smoothed(past: float | None, value: float) -> float:
    return value if past is None else MEMORY * past + (1 - MEMORY) * value


def as_time(seconds: float) -> str:
    """Seconds as 0:07, 12:05 or 1:02:30."""
    whole = round(seconds)
    hours, minutes = divmod(whole // 60, 60)
    text = f"{minutes}:{whole % 60:02d}"
    return f"{hours}:{minutes:02d}:{whole % 60:02d}" if hours else text
