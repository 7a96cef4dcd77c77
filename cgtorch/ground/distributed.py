"""Several processes (ranks) that do the same work and share what takes long.

Under `torchrun` every rank makes the whole run from the same seed: the same choices, populations
and skills. Only independent rows are shared: rollouts of individuals in the models, and grasps in
the world. Their results are gathered before they are used. So the result is that of a single
process, bit for bit, for any number of ranks. Only the first rank writes files.

With several islands (`cgtorch.evolution.islands`), each rank holds only some of them. A process
group consists of the ranks that hold the same islands: one rank if there are at least as many
islands as ranks, all ranks if there is one island. Rows of an island are shared within its group.
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
    """Join the other ranks while the context lasts, if `torchrun` has started any.

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
    """A name for this start of all ranks, equal on all ranks and different from earlier starts.

    After a restart, torchrun keeps the store with data of earlier ranks, such as their addresses.
    New ranks would try to reach the old ones and never meet
    (https://github.com/pytorch/pytorch/issues/135712). The number of restarts is no usable name, as
    each machine has its own count. So every rank makes up a random word, and the ranks agree as
    soon as each has seen the words of all others; nobody has seen words of earlier starts from
    every rank. If a rank does not arrive within torch's timeout, this raises torch's
    DistStoreError.
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
    """The number of this machine's cores for each rank on it, at least 1."""
    mine = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, mine // int(os.environ.get("LOCAL_WORLD_SIZE", 1)))


@dataclass(frozen=True)
class Group:
    """Ranks that share rows, the index of this one, and torch's handle, None for all or one."""

    index: int
    size: int
    handle: torch.distributed.ProcessGroup | None = None


def all_ranks() -> Group:
    """The group of all ranks."""
    return Group(_index(), count())


def held(parts: int, rank: int | None = None) -> range:
    """The range of parts, out of `parts`, that a rank (by default this one) holds: at least one.

    Parts are shared evenly, in order. If there are more ranks than parts, neighbours hold the same.
    """
    rank = _index() if rank is None else rank
    first = rank * parts // count()
    return range(first, max(first + 1, (rank + 1) * parts // count()))


def group_of(parts: int) -> Group:
    """The group of ranks that hold the same parts as this one; all ranks must call it."""
    if parts == 1:
        return all_ranks()
    if count() <= parts:
        return Group(0, 1)
    mine = held(parts)
    members = [rank for rank in range(count()) if held(parts, rank) == mine]
    return Group(members.index(_index()), len(members), _groups(parts)[mine.start])


@cache
def _groups(parts: int) -> list[torch.distributed.ProcessGroup]:
    """For each part the group of the ranks that hold it, if there are more ranks than parts."""
    holders: list[list[int]] = [[] for _ in range(parts)]
    for rank in range(count()):
        holders[held(parts, rank).start].append(rank)
    return [torch.distributed.new_group(each) for each in holders]


def count() -> int:
    """The number of ranks, 1 for a single process."""
    return torch.distributed.get_world_size() if torch.distributed.is_initialized() else 1


def first() -> bool:
    """Whether this is the rank that writes."""
    return _index() == 0


def _index() -> int:
    return torch.distributed.get_rank() if torch.distributed.is_initialized() else 0


def wait() -> None:
    """Wait until all ranks have reached this point."""
    if count() > 1:
        torch.distributed.barrier()


def share(rows: int, group: Group | None = None) -> slice:
    """The slice of `rows` rows that belongs to this rank of a group, in order."""
    group = group or all_ranks()
    return slice(group.index * rows // group.size, (group.index + 1) * rows // group.size)


def all_gather(part: Tensor, rows: int, group: Group | None = None) -> Tensor:
    """The rows (rows, ...) of the whole group, given this rank's `share` of them."""
    group = group or all_ranks()
    if group.size == 1:
        return part
    ends = [index * rows // group.size for index in range(group.size + 1)]
    return _all_gather(part, [end - begin for begin, end in pairwise(ends)], group.handle)


def all_reduce(number: int, group: Group | None = None) -> int:
    """The sum of a number over all ranks of a group, given this rank's."""
    group = group or all_ranks()
    if group.size == 1:
        return number
    total = torch.tensor(number)
    torch.distributed.all_reduce(total, group=group.handle)
    return int(total)


def all_gather_parts(mine: Tensor, parts: int) -> Tensor:
    """The rows of all parts (parts, ...), given one row for each part that this rank holds."""
    if len(mine) == parts:  # on every rank
        return mine
    holds = [held(parts, rank) for rank in range(count())]
    # Where several ranks hold a part, the first of them speaks.
    sizes = [0 if each in holds[:rank] else len(each) for rank, each in enumerate(holds)]
    return _all_gather(mine, sizes, None)


def ring_shift(mine: Tensor, parts: int) -> Tensor:
    """For each held part, the row of the part before it, given the rows (held, ...) of held parts.

    The first part gets the row of the last.
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
    """The first `sizes` rows of the parts of all ranks, one after the other."""
    plain = part.to(torch.uint8) if part.dtype == torch.bool else part
    mine = plain.new_zeros(max(sizes), *part.shape[1:])  # gloo wants parts of one size
    mine[: len(part)] = plain
    parts = [torch.empty_like(mine) for _ in sizes]
    torch.distributed.all_gather(parts, mine, group=handle)
    whole = torch.cat([p[:n] for p, n in zip(parts, sizes, strict=True)])
    return whole.to(part.dtype)


def gather_part(tensors: dict[str, Tensor], part: int, parts: int) -> dict[str, Tensor]:
    """The tensors of a part on the first rank, from a rank that holds it; all ranks must call it.

    Other ranks pass any tensors with the same names, numbers of dimensions and types, and get these
    back.
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
    """The first rank's value on all ranks, for values that may differ, such as clocks."""
    if count() == 1:
        return value
    values = [value]
    torch.distributed.broadcast_object_list(values, 0)
    return values[0]
