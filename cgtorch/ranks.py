"""Several processes that do the same, and share out what takes long.

Under `torchrun` every process, a rank, makes the whole run from the same seed: the same choices,
the same populations, the same skills. Only rows that do not depend on one another, runs of
individuals in the models and grasps in the world, are shared out, and what they come to is gathered
before it is used. So the result is that of one process, to the last bit, whatever the number of
ranks. Only the first one writes.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import torch
import torch.distributed
from torch import Tensor


@contextmanager
def together() -> Iterator[None]:
    """Join the other ranks for as long as the context lasts, if `torchrun` has started any.

    Tensors on a CPU are gathered by gloo, those on a GPU by NCCL.
    """
    if "TORCHELASTIC_RUN_ID" not in os.environ or count() > 1:
        yield
        return
    backend = "cpu:gloo,cuda:nccl" if torch.cuda.is_available() else "gloo"
    torch.distributed.init_process_group(backend)
    try:
        yield
    finally:
        torch.distributed.destroy_process_group()


def count() -> int:
    """How many ranks there are, 1 if this process is alone."""
    return torch.distributed.get_world_size() if torch.distributed.is_initialized() else 1


def first() -> bool:
    """Whether this is the rank that writes."""
    return _index() == 0


def _index() -> int:
    return torch.distributed.get_rank() if torch.distributed.is_initialized() else 0


def wait() -> None:
    """Until all ranks have come this far."""
    if count() > 1:
        torch.distributed.barrier()


def share(rows: int) -> slice:
    """This rank's part of so many rows; the parts of all ranks lie one after the other."""
    return _share(rows, _index())


def _share(rows: int, rank: int) -> slice:
    return slice(rank * rows // count(), (rank + 1) * rows // count())


def gathered(part: Tensor, rows: int) -> Tensor:
    """The rows (rows, ...) of all ranks, given this one's part of them.

    Args:
        part: as many rows as `share` says.
        rows: of all ranks together.
    """
    ranks = count()
    if ranks == 1:
        return part
    sizes = [(s := _share(rows, rank)).stop - s.start for rank in range(ranks)]
    plain = part.to(torch.uint8) if part.dtype == torch.bool else part
    mine = plain.new_zeros(max(sizes), *part.shape[1:])  # gloo wants parts of one size
    mine[: len(part)] = plain
    parts = [torch.empty_like(mine) for _ in sizes]
    torch.distributed.all_gather(parts, mine)
    whole = torch.cat([p[:n] for p, n in zip(parts, sizes, strict=True)])
    return whole.to(part.dtype)


def agreed(value: bool) -> bool:
    """What the first rank says, where ranks may differ, as their clocks do."""
    if count() == 1:
        return value
    said = torch.tensor([value], dtype=torch.uint8)
    torch.distributed.broadcast(said, 0)
    return bool(said)
