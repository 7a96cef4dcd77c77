"""Files with data of a cart on a rail, whole and broken."""

from dataclasses import astuple
from pathlib import Path

import pytest
import torch

from cgtorch import Field, read_data
from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import DataError

PERCEPT = (Field("place", "m"), Field("wind", "m"))
CONTROL = (Field("push", "m", -1, 1),)
HEADER = "place [m],wind [m],push [m],next place [m],next wind [m],succeeded"
GOOD = f"{HEADER}\n1.5,0.1,-1,0.6,0.1,\n0.6,0.1,,,,0\n"


def written(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def refused(path: Path, content: str | bytes | None = None) -> str:
    """What is said of a file or folder that is no data of a cart."""
    if content is not None:
        written(path, content)
    with pytest.raises(DataError) as caught:
        read_data(path, PERCEPT, CONTROL)
    message = str(caught.value)
    assert "\n" not in message
    return message


def same_bits(one: Dataset, other: Dataset) -> bool:
    pairs = zip(astuple(one), astuple(other), strict=True)
    return all(
        a.shape == b.shape
        and a.dtype == b.dtype
        and a.contiguous().numpy().tobytes() == b.contiguous().numpy().tobytes()
        for a, b in pairs
    )


def some_data(moves: int = 12, tests: int = 8) -> Dataset:
    generator = torch.Generator().manual_seed(0)
    p, q = torch.randn(2, moves, 2, generator=generator)
    u, tested = torch.randn(moves, 1, generator=generator), torch.randn(tests, 2)
    return Dataset(p, u, q, tested, torch.arange(tests) % 2 == 0)
