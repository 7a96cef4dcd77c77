"""Coresets: which training rows a machine keeps if there are too many.

A dual solution does not change if rows that are not support vectors are left out, so support
vectors are kept. The remaining places go to the rows farthest from all kept ones (the greedy
k-centre of Gonzalez 1985). No omitted row is then farther from a kept one than twice the optimum
for as many rows.
"""

import torch
from torch import Tensor

from cgtorch.ground.errors import SettingsError
from cgtorch.svm.machine import KernelMachine


def coreset(rows: Tensor, keep: Tensor, limit: int) -> Tensor:
    """Indices, ascending, of at most `limit` of the rows (n, d).

    Rows in `keep` (n,) bool, such as support vectors, come first. If they are more than the limit,
    the same choice is made among them. SettingsError for a limit below 1.
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
    """Indices (count,) of rows (n, d), each farthest from `covered` (m, d) and the rows before."""
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
    """Keep at most `limit` training rows (n, d) of a machine, in place; ascending indices (m,)."""
    keep = torch.zeros(len(features), dtype=torch.bool, device=features.device)
    keep[machine.support] = True
    chosen = coreset(features, keep, limit)
    place = torch.searchsorted(chosen, machine.support).clamp_max(len(chosen) - 1)
    kept = chosen[place] == machine.support
    machine.support = place[kept]
    machine.centres, machine.weights = machine.centres[kept], machine.weights[kept]
    return chosen
