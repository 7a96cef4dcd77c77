"""Histograms of many columns as one TensorBoard record: NumPy's takes longer than a generation."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from tensorboard.compat.proto.summary_pb2 import Summary


def histograms(tags: Sequence[str], values: Tensor, bins: int) -> "Summary":
    """A histogram for each of S tags of finite values (P, S), P at least 1.

    Bins are of equal widths from the least to the greatest value; where all of a column is one
    value, they are around it, 1 wide together.
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
