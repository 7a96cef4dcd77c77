"""Histograms of columns against those that torch's writer makes of one column with NumPy."""

import pytest
import torch
from support import seeded
from torch.utils.tensorboard.summary import make_histogram

from cgtorch.report.histograms import histograms

TAGS = [f"column {i}" for i in range(5)]


@pytest.mark.parametrize("rows", [1, 2, 1000])
@pytest.mark.parametrize("bins", [1, 7, 24])
def test_columns_are_counted_as_the_writer_does(rows: int, bins: int) -> None:
    values = torch.randn(rows, 5, generator=seeded(rows)) * torch.tensor([1, 1e-3, 50, 1, 0.1])
    values[:, 3] = 0.25  # all the same
    found = histograms(TAGS, values, bins).value
    assert [entry.tag for entry in found] == TAGS
    for entry, column in zip(found, values.double().T, strict=True):
        wanted, seen = make_histogram(column.numpy(), bins), entry.histo
        for name in ("min", "max", "num", "sum", "sum_squares"):
            assert getattr(seen, name) == pytest.approx(getattr(wanted, name)), name
        assert len(seen.bucket) == len(seen.bucket_limit) == bins + 1
        assert list(seen.bucket_limit) == sorted(seen.bucket_limit)
        for limit, count in zip(wanted.bucket_limit, wanted.bucket, strict=True):
            place = min(range(bins + 1), key=lambda i: abs(seen.bucket_limit[i] - limit))
            assert seen.bucket_limit[place] == pytest.approx(limit, abs=1e-12)
            assert seen.bucket[place] == count
        assert sum(seen.bucket) == rows
