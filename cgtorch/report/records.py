"""The records of a TensorBoard event file, few and written together."""

import io
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from cgtorch.ground.errors import RunError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from tensorboard.compat.proto.summary_pb2 import Summary

DPI = 80
SOON = 0.5  # s after which a record is written


class Records:
    """An open event file."""

    def __init__(
        self, folder: Path | str, settings: Mapping[str, object], metrics: Sequence[str], first: int
    ):
        """Open the file and write hyper-parameters, and the tags of the HPARAMS tab.

        TensorBoard hides data of earlier files from step `first` on, and keeps earlier data.
        RunError if the folder cannot be written.
        """
        from torch.utils.tensorboard import SummaryWriter
        from torch.utils.tensorboard.summary import hparams

        try:
            self._writer = SummaryWriter(str(folder), purge_step=first or None, flush_secs=10)
        except OSError as e:
            reason = e.strerror or str(e)
            raise RunError(
                f"cannot write TensorBoard files to {str(folder)!r} ({reason}); check the folder"
            ) from e
        self._first = first
        self._waiting: list[tuple[Mapping[str, float], int, float]] = []
        plain = {k: v if isinstance(v, bool | int | float | str) else str(v)
                 for k, v in settings.items()}  # fmt: skip
        experiment, begin, self._session_end = hparams(plain, dict.fromkeys(metrics, 0.0))
        self._writer.file_writer.add_summary(experiment)
        self._writer.file_writer.add_summary(begin)
        rows = [f"| {k} | {v} |" for k, v in plain.items()]
        self._writer.add_text("settings", "\n".join(["| setting | value |", "|---|---|", *rows]))
        self._writer.flush()

    def scalars(self, values: Mapping[str, float], step: int) -> None:
        """Write scalars as one record, which is far cheaper than one record each.

        Records within `SOON` seconds are written together, because the work between two generations
        leaves little of TensorBoard's code in the CPU's caches.
        """
        if step < self._first:
            return
        now = time.time()
        self._waiting.append((values, step, now))
        if now - self._waiting[0][2] > SOON:
            self._write_waiting()

    def picture(self, tag: str, figure: "Figure", step: int) -> None:
        """Write an image."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from tensorboard.compat.proto.summary_pb2 import Summary

        figure.set_dpi(DPI)
        canvas = FigureCanvasAgg(figure)
        width, height = canvas.get_width_height()
        out = io.BytesIO()
        canvas.print_png(out)
        image = Summary.Image(
            height=height, width=width, colorspace=4, encoded_image_string=out.getvalue()
        )
        self.write(Summary(value=[Summary.Value(tag=tag, image=image)]), step)

    def write(self, summary: "Summary", step: int) -> None:
        """Write a record of any kind."""
        if step >= self._first:
            self._write_waiting()
            self._writer.file_writer.add_summary(summary, step)

    def flush(self) -> None:
        """Write all waiting records to the file."""
        self._write_waiting()
        self._writer.flush()

    def close(self) -> None:
        """Finish the file."""
        self._write_waiting()
        self._writer.file_writer.add_summary(self._session_end)
        self._writer.close()

    def _write_waiting(self) -> None:
        from tensorboard.compat.proto.summary_pb2 import Summary

        waiting, self._waiting = self._waiting, []
        for values, step, when in waiting:
            entries = [Summary.Value(tag=tag, simple_value=v) for tag, v in values.items()]
            self._writer.file_writer.add_summary(Summary(value=entries), step, when)


def histograms(tags: Sequence[str], values: Tensor, bins: int) -> "Summary":
    """A histogram for each of S tags of finite values (P, S), with P at least 1, in one record.

    Bins have equal widths from the least to the greatest value, or around a single value with a
    total width of 1. TensorBoard's own histograms, one by one, take longer than a generation.
    """
    from tensorboard.compat.proto.summary_pb2 import HistogramProto, Summary

    values = values.double()
    least, greatest = values.amin(0), values.amax(0)
    alike = 0.5 * (greatest == least)
    low, width = least - alike, greatest - least + 2 * alike
    place = ((values - low) / width * bins).long().clamp_max(bins - 1)
    place += bins * torch.arange(len(tags))
    counts = torch.bincount(place.flatten(), minlength=bins * len(tags)).view(-1, bins)
    steps = torch.arange(bins + 1, dtype=torch.double)
    limits = torch.addcmul(low[:, None], width[:, None], steps / bins)
    about = torch.stack([least, greatest, values.sum(0), values.square().sum(0)], 1)
    rows = zip(tags, about.tolist(), limits.tolist(), counts.tolist(), strict=True)
    entries = []
    for tag, (low_end, high_end, total, squares), limit, count in rows:
        histogram = HistogramProto(
            min=low_end, max=high_end, num=len(values), sum=total, sum_squares=squares,
            bucket_limit=limit, bucket=[0, *count],  # none lies below the first limit
        )  # fmt: skip
        entries.append(Summary.Value(tag=tag, histo=histogram))
    return Summary(value=entries)
