"""TensorBoard event files of a run; docs/report.md explains each tag.

The step is that of the generation, counted from 0 over all stages. Other data have the step of the
next generation. The end of a stage has its own step, so that a resumed run can hide exactly what an
unfinished stage wrote. Nothing here is read back: numbers are those of the log.
"""

import io
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from torch import Tensor

from cgtorch.evolution.population import STRATEGY, Population
from cgtorch.graphs import ActionSet, Skill
from cgtorch.ground.errors import RunError
from cgtorch.improvement import events
from cgtorch.report.graph_picture import draw_skill
from cgtorch.report.plots import draw_reliability
from cgtorch.runs.log import SPREAD_EVERY, Row, generation_row

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from tensorboard.compat.proto.summary_pb2 import Summary

DPI = 80
SOON = 0.5  # s after which a record is written
BINS = 24
BY_ROWS = "by_rows"
METRICS = ("fitness/best", "world/solved_W", "world/solved_M", "stage/targets")
COLUMNS = {
    "best": "fitness/best",
    "mean": "fitness/mean",
    "solved_w": "solved/W",
    "solved_m": "solved/M",
    "nodes": "graph/nodes_best",
    "nodes_mean": "graph/nodes_mean",
    "unsolved": "population/unsolved",
    "not_finite": "population/not_finite",
    "distinct_parents": "population/distinct_parents",
}
"""The tags of columns of a generation's row in the log."""


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
        picture_seconds: float = 60.0,
    ):
        """Open a new event file in a folder, made if missing; RunError if that cannot be written.

        Args:
            folder: The folder of the event files.
            settings: Hyper-parameters by name, also for the HPARAMS tab.
            first_step: Number of first models (one step), generations and stages so far, if a run
                is resumed. TensorBoard hides data of earlier files from this step on.
            recalled: Number of these generations that will be reported as recalled.
            actions: The actions of evolved graphs; without them, graphs are drawn only when a skill
                is accepted.
            draw_scenarios: Draws what an accepted skill has solved (`Pictures.scenarios`).
            picture_seconds: Least time between pictures of later models, and of graphs that are not
                accepted yet.
        """
        from torch.utils.tensorboard import SummaryWriter
        from torch.utils.tensorboard.summary import hparams

        try:
            self._writer = SummaryWriter(str(folder), purge_step=first_step or None, flush_secs=10)
        except OSError as e:
            reason = e.strerror or str(e)
            raise RunError(
                f"cannot write TensorBoard files to {str(folder)!r} ({reason}); check the folder"
            ) from e
        self.step, self._first, self._folder = first_step - recalled, first_step, Path(folder)
        self._actions, self._draw_scenarios = actions, draw_scenarios
        self._picture_seconds, self._last_picture = picture_seconds, dict[str, float]()
        self._latest: tuple[str, Population] | None = None
        self._in_stage = False
        self._waiting: list[tuple[Mapping[str, float], int, float]] = []
        plain = {k: v if isinstance(v, bool | int | float | str) else str(v)
                 for k, v in settings.items()}  # fmt: skip
        experiment, begin, self._session_end = hparams(plain, dict.fromkeys(METRICS, 0.0))
        self._writer.file_writer.add_summary(experiment)
        self._writer.file_writer.add_summary(begin)
        rows = [f"| {k} | {v} |" for k, v in plain.items()]
        self._writer.add_text("settings", "\n".join(["| setting | value |", "|---|---|", *rows]))
        self._writer.flush()

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
                self.flush()
                return
        self._evolution_over()
        match event:
            case events.StageStarted():
                self.step += self._in_stage  # the stage before has ended
                self._in_stage = True
            case events.ModelsFitted():
                self._models(event)
            case events.WorldTested():
                self.scalars({"world/solved_W": event.solved_w, "world/solved_M": event.solved_m})
            case events.SkillAccepted():
                self._accepted(event)
            case events.FreshTested():
                self.scalars({"world/fresh_rate": event.succeeded / max(1, event.tried)})
                if event.mean_return is not None:
                    self.scalars({"world/mean_return": event.mean_return})

    def close(self) -> None:
        """Draw the remaining pictures, and finish the file."""
        self._evolution_over()
        self._write_waiting()
        self._writer.file_writer.add_summary(self._session_end)
        self._writer.close()

    def __enter__(self) -> Self:
        """The watch itself."""
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the file."""
        self.close()

    def _generation(self, event: events.GenerationDone) -> None:
        if self._latest is not None and self._latest[0] != event.candidate:
            self._evolution_over()
        generation, row = event.generation, generation_row(event)
        values = {tag: _number(row, column) for column, tag in COLUMNS.items()}
        speed = generation.executed / max(event.seconds, 1e-9)
        self.scalars(values | {"speed/transitions_per_second": speed})
        if generation.number % SPREAD_EVERY == 0:
            self._strategy(generation.population.strategy)
        self._latest = event.candidate, generation.champion
        self.step += 1

    def _strategy(self, values: Tensor) -> None:
        """Write a histogram of each column of values (P, S) in one record."""
        from tensorboard.compat.proto.summary_pb2 import Summary
        from torch.utils.tensorboard.summary import histogram

        columns = zip(STRATEGY, values.cpu().numpy().T, strict=True)
        each = (histogram(f"strategy/{name}", column, BINS).value for name, column in columns)
        self.write(Summary(value=[value for (value,) in each]))

    def _evolution_over(self) -> None:
        """Draw the best graph of the evolution that has just ended, unless it was just drawn."""
        latest, self._latest = self._latest, None
        if latest is None or self._actions is None or self.step < self._first:
            return
        if not self._soon("graph/best"):
            name, champion = latest
            self.picture("graph/best", draw_skill(Skill(name, champion.graphs, self._actions)))

    def _soon(self, tag: str) -> bool:
        """Whether it is too soon for another picture of something that is replaced quickly."""
        now = time.monotonic()
        if now - self._last_picture.get(tag, float("-inf")) < self._picture_seconds:
            return True
        self._last_picture[tag] = now
        return False

    def _models(self, event: events.ModelsFitted) -> None:
        self.scalars({"models/fit_seconds": event.seconds})
        summary = event.summary
        self.scalars(summary.scalars)
        if not summary.first:
            return
        if "classifier" in summary.reports and not self._soon("classifier/reliability"):
            curve = summary.reports["classifier"].reliability
            self.picture("classifier/reliability", draw_reliability(curve, of="held-out labels"))
        self._curves(summary.reports)
        self.flush()
        self.step += 1  # so that all generations can be hidden, not the first models

    def _curves(self, reports: Mapping[str, Any]) -> None:
        """Write learning curves to their own file, as their step is the number of rows."""
        from torch.utils.tensorboard import SummaryWriter

        with SummaryWriter(str(self._folder / BY_ROWS)) as writer:
            curves = {name: report.learning_curve for name, report in reports.items()}
            for name, curve in curves.items():
                every = () if curve is None else (curve.train_scores, curve.test_scores)
                for kind, scores in zip(("train", "test"), every, strict=False):
                    for size, folds in zip(curve.sizes, scores, strict=True):
                        tag = f"{name}/learning_curve/{kind}"
                        writer.add_scalar(tag, sum(folds) / len(folds), size)

    def _accepted(self, event: events.SkillAccepted[Any]) -> None:
        self.scalars({"stage/targets": int(event.succeeded[event.targets].sum())})
        self.picture("graph/best", draw_skill(event.skill))
        if self._draw_scenarios is not None:
            about = event.scenarios, event.succeeded, event.targets, event.stage
            if (picture := self._draw_scenarios(*about)) is not None:
                self.picture("scenarios/solved", picture)
        self.flush()

    def scalars(self, values: Mapping[str, float]) -> None:
        """Write scalars as one record, which is far cheaper than one record each.

        Records within `SOON` seconds are written together, because the work between two generations
        leaves little of TensorBoard's code in the CPU's caches.
        """
        if self.step < self._first:
            return
        now = time.time()
        self._waiting.append((values, self.step, now))
        if now - self._waiting[0][2] > SOON:
            self._write_waiting()

    def picture(self, tag: str, figure: "Figure") -> None:
        """Write an image."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from tensorboard.compat.proto.summary_pb2 import Summary

        figure.set_dpi(DPI)
        canvas, out = FigureCanvasAgg(figure), io.BytesIO()
        width, height = canvas.get_width_height()
        canvas.print_png(out)
        about = {"height": height, "width": width, "colorspace": 4}
        image = Summary.Image(**about, encoded_image_string=out.getvalue())
        self.write(Summary(value=[Summary.Value(tag=tag, image=image)]))

    def write(self, summary: "Summary") -> None:
        """Write a record of any kind."""
        if self.step >= self._first:
            self._write_waiting()
            self._writer.file_writer.add_summary(summary, self.step)

    def flush(self) -> None:
        """Write all waiting records to the file."""
        self._write_waiting()
        self._writer.flush()

    def _write_waiting(self) -> None:
        from tensorboard.compat.proto.summary_pb2 import Summary

        waiting, self._waiting = self._waiting, []
        for values, step, when in waiting:
            entries = [Summary.Value(tag=tag, simple_value=v) for tag, v in values.items()]
            self._writer.file_writer.add_summary(Summary(value=entries), step, when)


def _number(row: Row, column: str) -> float:
    return float("nan") if row[column] is None else row[column]
