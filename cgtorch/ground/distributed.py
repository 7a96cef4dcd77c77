"""Several processes that do the same, and share out what takes long.

Under `torchrun` every process, a rank, makes the whole run from the same seed: the same choices,
the same populations, the same skills. Only rows that do not depend on one another, runs of
individuals in the models and grasps in the world, are shared out, and what they come to is gathered
before it is used. So the result is that of one process, to the last bit, whatever the number of
ranks. Only the first one writes.

Where there are several islands (`cgtorch.evolution.islands`), each rank holds some of them only. A
process group is the ranks that hold the same: one rank where there are at least as many islands as
ranks, all ranks where there is one island. Rows of an island are shared out within its group.
"""

import os
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from functools import cache
from itertools import pairwise
from typing import TypeVar

import torch
import torch.distributed
from torch import Tensor
from torch.distributed.constants import default_pg_timeout
from torch.distributed.distributed_c10d import PrefixStore, Store
from torch.distributed.rendezvous import rendezvous

T = TypeVar("T")


@contextmanager
def together() -> Iterator[None]:
    """Join the other ranks for as long as the context lasts, if `torchrun` has started any.

    Tensors on a CPU are gathered by gloo, those on a GPU by NCCL.
    """
    if "TORCHELASTIC_RUN_ID" not in os.environ or count() > 1:
        yield
        return
    backend = "cpu:gloo,cuda:nccl" if torch.cuda.is_available() else "gloo"
    store, rank, size = next(rendezvous("env://"))
    mine = PrefixStore(name_of_start(store, rank, size), store)
    torch.distributed.init_process_group(backend, store=mine, rank=rank, world_size=size)
    try:
        yield
    finally:
        _groups.cache_clear()
        torch.distributed.destroy_process_group()


def name_of_start(store: Store, rank: int, size: int) -> str:
    """What this start of all ranks is called, on each of them: as no start before.

    After a restart torchrun keeps the store with what the ranks before have left in it, their
    addresses among it, so ranks of now would look for those of then and never meet
    (https://github.com/pytorch/pytorch/issues/135712). How often it has restarted is no name, as
    each machine counts for itself. So every rank makes a word up, and all are agreed as soon as
    each has seen the words of all others: words from before are not seen by everyone. Where a rank
    does not come within the time that torch allows, this is torch's DistStoreError.
    """
    latest = time.monotonic() + default_pg_timeout.total_seconds()
    store.set(f"word of {rank}", uuid.uuid4().hex)
    while True:
        words = store.multi_get([f"word of {each}" for each in range(size)])
        name = uuid.uuid5(uuid.NAMESPACE_OID, b" ".join(words).decode()).hex
        store.set(f"{name} seen by {rank}", "")
        try:
            store.wait([f"{name} seen by {each}" for each in range(size)], LOOK_AGAIN)
        except torch.distributed.DistStoreError:
            if time.monotonic() > latest:
                raise
        else:
            return name


LOOK_AGAIN = timedelta(seconds=0.1)


def cores() -> int:
    """How many of this machine's cores each rank on it can have to itself, at least 1."""
    mine = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, mine // int(os.environ.get("LOCAL_WORLD_SIZE", 1)))


@dataclass(frozen=True)
class Group:
    """Ranks that share out rows, the index of this one, and torch's handle, None for all or one."""

    index: int
    size: int
    handle: torch.distributed.ProcessGroup | None = None


def all_ranks() -> Group:
    """The group of all ranks."""
    return Group(_index(), count())


def held(parts: int, rank: int | None = None) -> range:
    """The parts, out of so many, that a rank, this one if not given, holds: at least one.

    They are shared out evenly, in order; of more ranks than parts, neighbours hold the same one.
    """
    rank = _index() if rank is None else rank
    first = rank * parts // count()
    return range(first, max(first + 1, (rank + 1) * parts // count()))


def group_of(parts: int) -> Group:
    """The ranks that hold the same parts, out of so many, as this one; to be asked for by all."""
    if parts == 1:
        return all_ranks()
    if count() <= parts:
        return Group(0, 1)
    mine = held(parts)
    members = [rank for rank in range(count()) if held(parts, rank) == mine]
    return Group(members.index(_index()), len(members), _groups(parts)[mine.start])


@cache
def _groups(parts: int) -> list[torch.distributed.ProcessGroup]:
    """For each part the group of the ranks that hold it, where ranks are more than parts."""
    holders: list[list[int]] = [[] for _ in range(parts)]
    for rank in range(count()):
        holders[held(parts, rank).start].append(rank)
    return [torch.distributed.new_group(each) for each in holders]


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


def share(rows: int, group: Group | None = None) -> slice:
    """The part of so many rows that this rank has of a group's, in order."""
    group = group or all_ranks()
    return slice(group.index * rows // group.size, (group.index + 1) * rows // group.size)


def all_gather(part: Tensor, rows: int, group: Group | None = None) -> Tensor:
    """The rows (rows, ...) of a whole group, given this rank's `share` of them."""
    group = group or all_ranks()
    if group.size == 1:
        return part
    ends = [index * rows // group.size for index in range(group.size + 1)]
    return _all_gather(part, [end - begin for begin, end in pairwise(ends)], group.handle)


def all_reduce(number: int, group: Group | None = None) -> int:
    """The sum of a number that each rank of a group has, given this one's."""
    group = group or all_ranks()
    if group.size == 1:
        return number
    total = torch.tensor(number)
    torch.distributed.all_reduce(total, group=group.handle)
    return int(total)


def all_gather_parts(mine: Tensor, parts: int) -> Tensor:
    """Of all parts (parts, ...), given one row for each that this rank holds."""
    if len(mine) == parts:  # on every rank
        return mine
    holds = [held(parts, rank) for rank in range(count())]
    # Where several ranks hold a part, the first of them speaks.
    sizes = [0 if each in holds[:rank] else len(each) for rank, each in enumerate(holds)]
    return _all_gather(mine, sizes, None)


def ring_shift(mine: Tensor, parts: int) -> Tensor:
    """For each part held, of so many, the row of the part before, given rows (held, ...) of these.

    The first part has the row of the last.
    """
    holds, me = [held(parts, rank) for rank in range(count())], _index()
    # Of the ranks that hold a part, the first one sends it.
    sources = [
        next(rank for rank, each in enumerate(holds) if (hold.start - 1) % parts in each)
        for hold in holds
    ]
    plain = mine.to(torch.uint8) if mine.dtype == torch.bool else mine
    last = plain[-1:].contiguous()
    receivers = [rank for rank, source in enumerate(sources) if source == me != rank]
    sent = [torch.distributed.isend(last, rank) for rank in receivers]
    first = last
    if sources[me] != me:
        first = torch.empty_like(last)
        torch.distributed.recv(first, sources[me])
    for each in filter(None, sent):
        each.wait()
    return torch.cat([first, plain[:-1]]).to(mine.dtype)


def _all_gather(
    part: Tensor, sizes: Sequence[int], handle: torch.distributed.ProcessGroup | None
) -> Tensor:
    """The first rows of each rank's part, as many as `sizes` says, one after the other."""
    plain = part.to(torch.uint8) if part.dtype == torch.bool else part
    mine = plain.new_zeros(max(sizes), *part.shape[1:])  # gloo wants parts of one size
    mine[: len(part)] = plain
    parts = [torch.empty_like(mine) for _ in sizes]
    torch.distributed.all_gather(parts, mine, group=handle)
    whole = torch.cat([p[:n] for p, n in zip(parts, sizes, strict=True)])
    return whole.to(part.dtype)


def gather_part(tensors: dict[str, Tensor], part: int, parts: int) -> dict[str, Tensor]:
    """A part, out of so many, that some rank holds, on the first rank; to be called by all.

    Others give any tensors of the same names, numbers of dimensions and types, which they get back.
    """
    holder = next(rank for rank in range(count()) if part in held(parts, rank))
    if holder == 0 or _index() not in (0, holder):
        return tensors
    if _index() == holder:
        for name in sorted(tensors):
            torch.distributed.send(torch.tensor(tensors[name].shape, dtype=torch.long), 0)
            torch.distributed.send(tensors[name].contiguous(), 0)
        return tensors
    found = {}
    for name in sorted(tensors):
        shape = torch.empty(tensors[name].dim(), dtype=torch.long)
        torch.distributed.recv(shape, holder)
        found[name] = tensors[name].new_empty(shape.tolist())
        torch.distributed.recv(found[name], holder)
    return found


def broadcast(value: T) -> T:
    """What the first rank has, on all of them: also where they may differ, as their clocks do."""
    if count() == 1:
        return value
    values = [value]
    torch.distributed.broadcast_object_list(values, 0)
    return values[0]
