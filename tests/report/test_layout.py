import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cgtorch.graphs.clusters import Edge
from cgtorch.report.layout import crossings, in_rows, place
from cgtorch.report.messages import as_time


@given(st.integers(1, 12), st.randoms(use_true_random=False))
def test_rows_keep_every_link_and_go_down(n: int, source: random.Random) -> None:
    draw = source.randrange
    links = [Edge(draw(i), i, "tree") for i in range(1, n)]
    links += [Edge(draw(n), draw(n), f"extra {k}") for k in range(n)]
    links += [Edge(draw(n), None, "end")]
    rows = in_rows(list(range(n)), 0, links)
    row_of = {item: r for r, row in enumerate(rows.rows) for item in row}
    assert sorted(row_of) == list(range(len(row_of)))  # each item once
    assert row_of[rows.node[0]] == 0
    labels = [rows.label(k) for k in rows.chains]
    assert len(set(labels)) == len(labels)
    for k, link in enumerate(links):
        if link.head == link.tail:
            assert k not in rows.chains
            continue
        chain = rows.chains[k]
        ranks = [row_of[i] for i in chain]
        assert ranks == list(range(ranks[0], ranks[0] + len(chain)))
        assert row_of[rows.label(k)] % 2 == 1
        ends = chain[::-1] if k in rows.upward else chain
        assert ends[0] == rows.node[link.tail]
        assert rows.label(k) == ends[1]
        if link.head is not None:
            assert ends[-1] == rows.node[link.head]
    assert all(rows.above[i] for i in row_of if row_of[i])


def test_a_tree_is_drawn_without_crossings() -> None:
    links = [Edge((i - 1) // 2, i, "") for i in (1, 6, 3, 2, 5, 4)]
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
        links = [Edge(draw(i), i, "") for i in range(1, 10)]
        links += [Edge(draw(10), draw(10), "") for _ in range(8)]
        total += crossings(in_rows(list(range(10)), 0, links))
    assert total <= 43


def test_what_is_alone_stands_in_a_column_and_a_node_between_those_it_leads_to() -> None:
    widths = {"a": 0.8, "b": 1.0, "c": 0.7, "d": 0.9}
    chain = [Edge("a", "b", ""), Edge("b", "c", ""), Edge("c", "d", "")]
    found = place(widths, "a", chain, [0.3, 0.1, 0.2])
    assert [box.x for box in found.boxes.values()] == pytest.approx([found.boxes["a"].x] * 4)
    assert all(len({x for x, _ in route.points}) == 1 for route in found.routes)
    fork = [Edge("a", "b", ""), Edge("a", "c", ""), Edge("c", "d", "")]
    boxes = place(widths, "a", fork, [0.2] * 3).boxes
    assert boxes["b"].x < boxes["a"].x < boxes["c"].x
    assert boxes["d"].x == pytest.approx(boxes["c"].x)


def test_times() -> None:
    assert [as_time(s) for s in (0, 7.4, 59.6, 725, 3750)] == [
        "0:00", "0:07", "1:00", "12:05", "1:02:30",
    ]  # fmt: skip


def test_a_time_and_its_tenths_in_a_file_are_the_same_text() -> None:
    assert all(as_time(s / 100) == as_time(round(s / 100, 1)) for s in range(1000))
