"""Several processes (ranks) that do the same work and share what takes long.

Every rank makes the whole run from the same seed. They are started by `torchrun`, or by a command
itself (`cgtorch.native.rank_processes`). Only independent rows are
shared: rollouts of individuals, and grasps in the world. Their results are gathered
before they are used, so the result is that of a single process, bit for bit, for any number of
ranks. Only the first rank writes files.

With several islands (`cgtorch.evolution.search`), each rank holds only some of them. A process
group consists of the ranks that hold the same islands, and shares the rows of these.
"""

import os
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from functools import cache
from typing import TypeVar

import torch
import torch.distributed
from torch import Tensor
from torch.distributed.constants import default_pg_timeout
from torch.distributed.distributed_c10d import PrefixStore, Store
from torch.distributed.rendezvous import rendezvous

from cgtorch.ground.errors import CgtorchError

T = TypeVar("T")
LOOK_AGAIN = timedelta(seconds=0.1)
PAUSE = 1e-3  # s between two looks at common work, at most


class RankLostError(CgtorchError, RuntimeError):
    """Another rank has ended in the midst of common work."""


@contextmanager
def together() -> Iterator[None]:
    """Join the other ranks while the context lasts, if `torchrun` has started any."""
    if "TORCHELASTIC_RUN_ID" not in os.environ or count() > 1:
        yield
        return
    store, rank, size = next(rendezvous("env://"))
    with joined(PrefixStore(name_of_start(store, rank, size), store), rank, size):
        yield


@contextmanager
def joined(store: Store, rank: int, size: int) -> Iterator[None]:
    """Be one of so many ranks, which meet at a store, while the context lasts.

    Tensors on a CPU are gathered by gloo, those on a GPU by NCCL. RankLostError is raised if
    another rank ends before all have met: one that has met all others may fail at once.
    """
    backend = "cpu:gloo,cuda:nccl" if torch.cuda.is_available() else "gloo"
    with _others_there():
        torch.distributed.init_process_group(backend, store=store, rank=rank, world_size=size)
    try:
        yield
    finally:
        leave()


def leave() -> None:
    """Be a single process from now on; the other ranks wait for this one in vain."""
    _groups.cache_clear()
    if torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()


def name_of_start(store: Store, rank: int, size: int) -> str:
    """A name for this start of all ranks, equal on all ranks and different from earlier starts.

    After a restart, torchrun keeps the store with addresses of earlier ranks, which new ranks would
    try to reach (https://github.com/pytorch/pytorch/issues/135712). Each machine counts restarts
    for itself, so their number is no name. Every rank makes up a random word, and the ranks agree
    as soon as each has seen the words of all others. If a rank does not arrive within torch's
    timeout, this raises torch's DistStoreError.
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


def cores() -> int:
    """The number of this machine's cores for each rank on it, at least 1."""
    mine = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, mine // int(os.environ.get("LOCAL_WORLD_SIZE", 1)))


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
        with _others_there():
            torch.distributed.barrier()


def broadcast(value: T, source: int = 0) -> T:
    """A rank's value, such as the first one's clock, on all ranks, which must all call this."""
    if count() == 1:
        return value
    values = [value]
    with _others_there():
        torch.distributed.broadcast_object_list(values, source)
    return values[0]


@contextmanager
def _others_there() -> Iterator[None]:
    """A context that ends with a RankLostError if another rank is gone."""
    try:
        yield
    except CgtorchError:
        raise
    except RuntimeError as e:
        raise RankLostError(
            "another rank has ended in the midst of common work; its own error says why"
        ) from e


def _finish(work: torch.distributed.Work) -> None:
    """Wait for common work such that a signal, such as Ctrl-C, is heard meanwhile."""
    pause = 0.0
    with _others_there():
        while not work.is_completed():
            time.sleep(pause)
            pause = min(pause + PAUSE / 20, PAUSE)
        work.wait()


@dataclass(frozen=True)
class Group:
    """Ranks that share rows, the index of this one, and torch's handle, None for all or one."""

    index: int
    size: int
    handle: torch.distributed.ProcessGroup | None = None

    def begin(self, index: int, rows: int) -> int:
        """The first of `rows` rows that belongs to the member at an index."""
        return index * rows // self.size


def _all_ranks() -> Group:
    return Group(_index(), count())


def share(rows: int, group: Group | None = None) -> slice:
    """The slice of `rows` rows that belongs to this rank of a group, in order."""
    group = group or _all_ranks()
    return slice(group.begin(group.index, rows), group.begin(group.index + 1, rows))


def all_gather(part: Tensor, rows: int, group: Group | None = None) -> Tensor:
    """The rows (rows, ...) of the whole group, given this rank's `share` of them."""
    group = group or _all_ranks()
    sizes = [group.begin(i + 1, rows) - group.begin(i, rows) for i in range(group.size)]
    return _all_gather(part, sizes, group.handle)


def _all_gather(
    part: Tensor, sizes: Sequence[int], handle: torch.distributed.ProcessGroup | None = None
) -> Tensor:
    """The first `sizes` rows of the parts of all ranks, one after the other."""
    if len(sizes) == 1:
        return part
    plain = part.to(torch.uint8) if part.dtype == torch.bool else part
    mine = plain.new_zeros(max(sizes), *part.shape[1:])  # gloo wants parts of one size
    mine[: len(part)] = plain
    parts = [torch.empty_like(mine) for _ in sizes]
    _finish(torch.distributed.all_gather(parts, mine, group=handle, async_op=True))
    return torch.cat([p[:n] for p, n in zip(parts, sizes, strict=True)]).to(part.dtype)


def all_reduce(number: int, group: Group | None = None) -> int:
    """The sum of a number over all ranks of a group, given this rank's."""
    group = group or _all_ranks()
    total = torch.tensor(number)
    if group.size > 1:
        _finish(torch.distributed.all_reduce(total, group=group.handle, async_op=True))
    return int(total)


def held(parts: int, rank: int | None = None) -> range:
    """The range of parts, out of `parts`, that a rank (by default this one) holds: at least one.

    Parts are shared evenly, in order. If there are more ranks than parts, neighbours hold the same.
    """
    rank = _index() if rank is None else rank
    begin = rank * parts // count()
    return range(begin, max(begin + 1, (rank + 1) * parts // count()))


def group_of(parts: int) -> Group:
    """The group of ranks that hold the same parts as this one; all ranks must call it."""
    if parts == 1:
        return _all_ranks()
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


def all_gather_parts(mine: Tensor, parts: int) -> Tensor:
    """The rows of all parts (parts, ...), given one row for each part that this rank holds."""
    if len(mine) == parts:  # on every rank
        return mine
    holds = [held(parts, rank) for rank in range(count())]
    # Where several ranks hold a part, the first of them speaks.
    return _all_gather(mine, [0 if h in holds[:i] else len(h) for i, h in enumerate(holds)])


def ring_shift(mine: Tensor, parts: int) -> Tensor:
    """For each held part, the row of the part before it, given the rows (held, ...) of held parts.

    The first part gets the row of the last.
    """
    return all_gather_parts(mine, parts)[[part - 1 for part in held(parts)]]


def part_of_holder(value: T, part: int, parts: int) -> T:
    """On all ranks, the value of the first rank that holds a part.

    All ranks must call this, except if there is one part only, which each of them has.
    """
    if parts == 1:
        return value
    return broadcast(value, next(r for r in range(count()) if part in held(parts, r)))
