import random

import torch
from hypothesis import given
from hypothesis import strategies as st

from cgtorch.report.estimate import as_time
from cgtorch.report.layers import Link, crossings, in_rows
from cgtorch.report.placing import monotone

numbers = st.lists(st.tuples(st.floats(-9, 9), st.floats(0.1, 5)), min_size=1, max_size=12)


@given(numbers)
def test_monotone_is_the_nearest_ascending_sequence(pairs: list[tuple[float, float]]) -> None:
    values, weights = (torch.tensor(x, dtype=torch.float64) for x in zip(*pairs, strict=True))
    found = torch.tensor(monotone(values.tolist(), weights.tolist()), dtype=torch.float64)
    assert (found.diff() >= -1e-9).all()
    # Optimal if no ascending direction improves: partial sums of the residual from the right.
    residual = weights * (values - found)
    tail = residual.flip(0).cumsum(0).flip(0)
    assert abs(tail[0]) < 1e-6
    assert (tail <= 1e-6).all()
    assert abs((residual * found).sum()) < 1e-5


@given(st.integers(1, 12), st.randoms(use_true_random=False))
def test_rows_keep_every_link_and_go_down(n: int, source: random.Random) -> None:
    draw = source.randrange
    links = [Link(draw(i), i, "tree") for i in range(1, n)]
    links += [Link(draw(n), draw(n), f"extra {k}") for k in range(n)]
    links += [Link(draw(n), None, "end")]
    rows = in_rows(list(range(n)), 0, links)
    row_of = {item: r for r, row in enumerate(rows.rows) for item in row}
    assert sorted(row_of) == list(range(len(row_of)))  # each item once
    assert row_of[rows.node[0]] == 0
    labels = list(rows.labels.values())
    assert len(set(labels)) == len(labels)
    for k, link in enumerate(links):
        if link.head == link.tail:
            assert k not in rows.chains
            continue
        chain = rows.chains[k]
        ranks = [row_of[i] for i in chain]
        assert ranks == list(range(ranks[0], ranks[0] + len(chain)))
        assert row_of[rows.labels[k]] % 2 == 1
        ends = chain[::-1] if rows.upward[k] else chain
        assert ends[0] == rows.node[link.tail]
        assert rows.labels[k] == ends[1]
        if link.head is not None:
            assert ends[-1] == rows.node[link.head]
    assert all(rows.above[i] for i in row_of if row_of[i])


def test_a_tree_is_drawn_without_crossings() -> None:
    links = [Link((i - 1) // 2, i, "") for i in (1, 6, 3, 2, 5, 4)]
    rows = in_rows([0, 4, 2, 6, 3, 1, 5], 0, links)
    node_of = {item: n for n, item in rows.node.items()}
    parents = [(node_of[i] - 1) // 2 for i in rows.rows[4]]  # type: ignore[operator]
    middle = [node_of[i] for i in rows.rows[2]]
    assert [p for i, p in enumerate(parents) if i in (0, 2)] == middle


def test_few_pieces_cross_in_tangled_graphs() -> None:
    """Unordered rows have 663 crossings, sweeps without swaps 44."""
    total = 0
    for seed in range(30):
        draw = random.Random(seed).randrange
        links = [Link(draw(i), i, "") for i in range(1, 10)]
        links += [Link(draw(10), draw(10), "") for _ in range(8)]
        total += crossings(in_rows(list(range(10)), 0, links))
    assert total <= 43


def test_times() -> None:
    assert [as_time(s) for s in (0, 7.4, 59.6, 725, 3750)] == [
        "0:00", "0:07", "1:00", "12:05", "1:02:30",
    ]  # fmt: skip
