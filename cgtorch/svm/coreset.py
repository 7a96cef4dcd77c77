"""Fewer rows that cover as much: what a machine keeps of its data when there is too much of it.

A dual solution does not change when rows that are no support vectors are left out, so support
vectors are kept. The places left go to the rows farthest from all kept so far (the greedy
k-centre of Gonzalez 1985), so that of the rows left out none is farther from a kept one than
twice what the best choice of as many rows could reach.
"""

import torch
from torch import Tensor

from cgtorch.ground.errors import SettingsError
from cgtorch.svm.machine import KernelMachine


def coreset(rows: Tensor, keep: Tensor, limit: int) -> Tensor:
    """Indices, ascending, of at most `limit` of the rows (n, d).

    Those to `keep` (n,) bool, such as support vectors, are wanted before all others; if they are
    more than the limit, the same choice is made among them. SettingsError if that is below 1.
    """
    if limit < 1:
        raise SettingsError(f"the coreset's limit is {limit}; keep at least 1 row")
    everything = torch.arange(len(rows), device=rows.device)
    if len(rows) <= limit:
        return everything
    if int(keep.sum()) > limit:
        chosen, pool = everything[:0], everything[keep]
    else:
        chosen, pool = everything[keep], everything[~keep]
    more = _farthest_first(rows[pool], rows[chosen], limit - len(chosen))
    return torch.cat([chosen, pool[more]]).sort().values


def _farthest_first(rows: Tensor, covered: Tensor, count: int) -> Tensor:
    """Indices (count,) of rows (n, d), each farthest from `covered` (m, d) and those before."""
    if len(covered):
        nearest = torch.cdist(rows, covered).amin(1)
    else:
        nearest = -(rows - rows.mean(0)).norm(dim=1)
    chosen = []
    for _ in range(count):
        pick = int(nearest.argmax())
        chosen.append(pick)
        distance = (rows - rows[pick]).norm(dim=1)
        first = len(chosen) == 1 and not len(covered)
        nearest = distance if first else torch.minimum(nearest, distance)
        nearest[pick] = -torch.inf
    return torch.tensor(chosen, dtype=torch.long, device=rows.device)


def shrink_to_coreset(machine: KernelMachine, features: Tensor, limit: int) -> Tensor:
    """Keep at most `limit` training rows (n, d) of a machine, in place: indices (m,), ascending."""
    keep = torch.zeros(len(features), dtype=torch.bool, device=features.device)
    keep[machine.support] = True
    chosen = coreset(features, keep, limit)
    place = torch.searchsorted(chosen, machine.support).clamp_max(len(chosen) - 1)
    kept = chosen[place] == machine.support
    machine.support = place[kept]
    machine.centres, machine.weights = machine.centres[kept], machine.weights[kept]
    return chosen
