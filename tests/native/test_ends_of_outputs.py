"""Nothing is written behind the rows that a call is about."""

from collections.abc import Callable

import pytest
import torch
from random_models import first_percepts, random_classifier, random_gamma
from support import FOOTPRINT, random_graphs, seeded
from torch import Tensor

from cgtorch.native import available, function
from cgtorch.svm.rbf import machine_structure
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world.clear_motion import body_structure

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

KIND = torch.float64
ROOM, UNTOUCHED = 40, 77
"""Rows behind those that are written, and what they hold."""


def outputs(n: int) -> dict[str, tuple[list[Tensor], Callable[[], int]]]:
    """By function, tensors of n rows and more, and a call that fills the n rows."""
    g, seen = seeded(n), first_percepts(n, n, "box", 0)
    motion, thing = (
        torch.rand(n, 3, generator=g).to(KIND),
        torch.rand(n, 1, 5, generator=g).to(KIND),
    )
    gamma, classifier = random_gamma(0), random_classifier(0, seen.repeat(3, 1))
    centres, weights = (
        torch.rand(9, 3, generator=g).to(KIND),
        torch.rand(9, 2, generator=g).to(KIND),
    )
    machine = machine_structure(centres, weights, weights[0], torch.tensor(0.5))
    body = body_structure(torch.tensor(FOOTPRINT, dtype=KIND))
    graphs = random_graphs(n, n, paper_actions())

    def room(*shape: int, kind: torch.dtype = KIND) -> Tensor:
        return torch.full((n + ROOM, *shape), UNTOUCHED, dtype=kind)

    def call(
        name: str, made: list[Tensor], *about: object
    ) -> tuple[list[Tensor], Callable[[], int]]:
        run = function(name, KIND)
        return made, lambda: run(*about)

    after, novelty, chance, free = room(7), room(), room(), room(kind=torch.uint8)
    values, nearest, matrix, spread = room(2), room(), room(24), room()
    order, place, parent = (room(kind=torch.long) for _ in range(3))
    given = gamma.compiled(seen, motion), classifier.compiled(seen)
    return {
        "transitions": call(
            "transitions", [after, novelty], given[0], 7, seen, motion, n, after, novelty, 1
        ),
        "successes": call("successes", [chance], given[1], 7, seen, n, chance, 1),
        "motions": call("motions_possible", [free], motion, thing, body, n, 1, free, 1),
        "values": call("rbf_values", [values, nearest], machine, motion, n, values, nearest, 1),
        "gram": call("rbf_gram", [matrix], torch.rand(2, 24).double(), n, 2, 24, matrix, 1),
        "deviation": call("deviation", [spread], torch.rand(3, n).to(KIND), 3, n, spread, 1),
        "ranking": call(
            "ranking", [order], torch.rand(n).to(KIND), graphs.action, graphs.capacity, n, order
        ),
        "shuffled": call("shuffled_order", [place], n, 5, place, 1),
        "lexicase": call(
            "lexicase", [parent], torch.rand(6, 2).to(KIND), 6, 2, torch.rand(2).to(KIND), 3, n,
            parent, 1,
        ),
    }  # fmt: skip


@pytest.mark.parametrize("n", [1, 3, 4, 5, 11, 24])
def test_nothing_is_written_behind_the_last_row(n: int) -> None:
    for name, (made, run) in outputs(n).items():
        assert run() == 0, name
        for tensor in made:
            assert bool((tensor[:n] != UNTOUCHED).all()), name
            assert bool((tensor[n:] == UNTOUCHED).all()), name
