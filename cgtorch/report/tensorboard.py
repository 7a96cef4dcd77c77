"""TensorBoard event files of a run; docs/report.md explains each tag.

The step is that of the generation, counted from 0 over all stages. Other data have the step of the
next generation. The end of a stage has its own step, so that a resumed run can hide exactly what an
unfinished stage wrote. With several islands, the best individual, speeds and numbers that are not
finite are those of all islands. All other data are those of the first, which the first rank always
holds.
"""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from cgtorch.evolution.fitness import WORTHLESS
from cgtorch.evolution.population import STRATEGY, Population
from cgtorch.graphs import NO_NODE, ActionSet, Graphs, Skill
from cgtorch.improvement import events
from cgtorch.report.graph_picture import draw_skill
from cgtorch.report.records import Records, histograms
from cgtorch.report.reliability_picture import draw_reliability
from cgtorch.svm import LearningCurve

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BINS = 24
STRATEGY_TAGS = [f"strategy/{name}" for name in STRATEGY]
BY_ROWS = "by_rows"
METRICS = ("fitness/best", "world/solved_W", "world/solved_M", "stage/targets")


class TensorBoardWatch:
    """A `Watch` that writes event files; see docs/report.md for its tags."""

    def __init__(
        self,
        folder: Path | str,
        settings: Mapping[str, object],
        first_step: int = 0,
        *,
        recalled: int = 0,
        actions: ActionSet | None = None,
        draw_scenarios: Callable[..., "Figure | None"] | None = None,
        histogram_every: int = 20,
        picture_seconds: float = 60.0,
    ):
        """Open a new event file in a folder, made if missing; RunError if that cannot be written.

        Args:
            folder: The folder of the event files.
            settings: Hyper-parameters by name, as for `Records`.
            first_step: Number of first models (one step), generations and stages so far, if a run
                is resumed. TensorBoard hides data of earlier files from this step on.
            recalled: Number of these generations that will be reported as recalled.
            actions: The actions of evolved graphs; without them, graphs are drawn only when a skill
                is accepted.
            draw_scenarios: Draws what an accepted skill has solved (`Pictures.scenarios`).
            histogram_every: Generations between histograms of one evolution.
            picture_seconds: Least time between pictures of later models, and of graphs that are not
                accepted yet.
        """
        self._records = Records(folder, settings, METRICS, first_step)
        self.step, self._first, self._folder = first_step - recalled, first_step, Path(folder)
        self._actions, self._draw_scenarios = actions, draw_scenarios
        self._histogram_every, self._picture_seconds = histogram_every, picture_seconds
        self._last_picture = dict[str, float]()
        self._latest: tuple[str, Population] | None = None
        self._in_stage = False

    def __call__(self, event: events.Event) -> None:
        """Write the data of an event."""
        match event:
            case events.GenerationDone():
                self._generation(event)
                return
            case events.EvolutionRecalled():
                self.step += event.found.generations
                self._latest = event.candidate, event.found.champion
                return
            case events.AboutToKeep():
                self._records.flush()
                return
        self._evolution_over()
        match event:
            case events.StageStarted():
                self.step += self._in_stage  # the stage before has ended
                self._in_stage = True
            case events.ModelsFitted():
                self._models(event)
            case events.WorldTested():
                solved = {"world/solved_W": event.solved_w, "world/solved_M": event.solved_m}
                self._scalars(solved)
            case events.SkillAccepted():
                self._accepted(event)
            case events.FreshTested():
                self._scalars({"world/fresh_rate": event.succeeded / max(1, event.tried)})
                if event.mean_return is not None:
                    self._scalars({"world/mean_return": event.mean_return})

    def close(self) -> None:
        """Draw the remaining pictures, and finish the file."""
        self._evolution_over()
        self._records.close()

    def __enter__(self) -> Self:
        """The watch itself."""
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the file."""
        self.close()

    def _generation(self, event: events.GenerationDone) -> None:
        if self._latest is not None and self._latest[0] != event.candidate:
            self._evolution_over()
        generation = event.generation
        population, size = generation.population, len(generation.fitness)
        # NumPy says so of arrays this small in half the time that torch takes.
        fitness = generation.fitness.cpu().numpy()
        counts = fitness[fitness > WORTHLESS]
        self._scalars(
            {
                "fitness/best": generation.best if generation.best > WORTHLESS else np.nan,
                "fitness/mean": float(counts.mean(dtype=np.float64)) if len(counts) else np.nan,
                "solved/W": event.solved_w,
                "solved/M": event.solved_m,
                "graph/nodes_best": _nodes(generation.champion.graphs),
                "graph/nodes_mean": _nodes(population.graphs) / size,
                "population/unsolved": (size - len(counts) + np.count_nonzero(counts == 0)) / size,
                "population/not_finite": generation.not_finite,
                "population/distinct_parents": generation.distinct_parents,
                "speed/transitions_per_second": generation.executed / max(event.seconds, 1e-9),
            }
        )
        if generation.number % self._histogram_every == 0:
            self._records.write(
                histograms(STRATEGY_TAGS, population.strategy.cpu(), BINS), self.step
            )
        self._latest = event.candidate, generation.champion
        self.step += 1

    def _evolution_over(self) -> None:
        """Draw the best graph of the evolution that has just ended, unless it was just drawn."""
        latest, self._latest = self._latest, None
        if latest is None or self._actions is None or self.step < self._first:
            return
        if self._soon("graph/best"):
            return
        name, champion = latest
        self._picture("graph/best", draw_skill(Skill(name, champion.graphs, self._actions)))

    def _soon(self, tag: str) -> bool:
        """Whether it is too soon for another picture of something that is replaced quickly."""
        now = time.monotonic()
        if now - self._last_picture.get(tag, float("-inf")) < self._picture_seconds:
            return True
        self._last_picture[tag] = now
        return False

    def _models(self, event: events.ModelsFitted) -> None:
        self._scalars({"models/fit_seconds": event.seconds})
        summary = event.summary
        self._scalars(summary.scalars)
        if summary.reliability and not self._soon("classifier/reliability"):
            picture = draw_reliability(summary.reliability, of="held-out labels")
            self._picture("classifier/reliability", picture)
        if summary.curves:
            self._curves(summary.curves)
        if summary.first:
            self._records.flush()
            self.step += 1  # so that all generations can be hidden, not the first models

    def _curves(self, curves: Mapping[str, LearningCurve | None]) -> None:
        """Write learning curves to their own file, as their step is the number of rows."""
        from torch.utils.tensorboard import SummaryWriter

        with SummaryWriter(str(self._folder / BY_ROWS)) as writer:
            for name, curve in curves.items():
                if curve is None:
                    continue
                for kind, scores in (("train", curve.train_scores), ("test", curve.test_scores)):
                    for size, folds in zip(curve.sizes, scores, strict=True):
                        tag = f"{name}/learning_curve/{kind}"
                        writer.add_scalar(tag, sum(folds) / len(folds), size)

    def _accepted(self, event: events.SkillAccepted[Any]) -> None:
        self._scalars({"stage/targets": int(event.succeeded[event.targets].sum())})
        self._picture("graph/best", draw_skill(event.skill))
        if self._draw_scenarios is not None:
            about = event.scenarios, event.succeeded, event.targets, event.stage
            if (picture := self._draw_scenarios(*about)) is not None:
                self._picture("scenarios/solved", picture)
        self._records.flush()

    def _scalars(self, values: Mapping[str, float]) -> None:
        self._records.scalars(values, self.step)

    def _picture(self, tag: str, figure: "Figure") -> None:
        self._records.picture(tag, figure, self.step)


def _nodes(graphs: Graphs) -> int:
    """The total number of nodes of all graphs."""
    return int(np.count_nonzero(graphs.action.numpy() != NO_NODE))
